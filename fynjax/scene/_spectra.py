"""Reflectance of soil, litter and bark."""

from functools import lru_cache
from importlib import resources

import numpy as np
import pandas as pd
from jaxtyping import Float


def background_spectrum(
    name: str, wavelength: Float[np.ndarray, " wavelength"]
) -> Float[np.ndarray, " wavelength"]:
    """A shipped spectrum at `wavelength` [nm, 400-2500], linearly interpolated [-].

    `name` is dry_soil, wet_soil, bark, litter or char; sources in `data/README.md`.
    """
    frame = _table()
    return np.interp(wavelength, frame["wavelength_nm"], frame[name])


@lru_cache(maxsize=1)
def _table() -> pd.DataFrame:
    with (resources.files("fynjax.scene") / "data" / "background.csv").open() as table:
        return pd.read_csv(table)
