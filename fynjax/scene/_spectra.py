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


def shipped_covers(
    wavelength: Float[np.ndarray, " wavelength"],
) -> Float[np.ndarray, "cover wavelength"]:
    """Reflectance of litter, char and rock [-] where none is given.

    Rock, of which no spectrum is shipped, is as the dry soil: an assumption for the pale
    sandstone that sandy soil comes from.
    """
    return np.stack([background_spectrum(n, wavelength) for n in ("litter", "char", "dry_soil")])


@lru_cache(maxsize=1)
def _table() -> pd.DataFrame:
    with (resources.files("fynjax.scene") / "data" / "background.csv").open() as table:
        return pd.read_csv(table)
