"""Spectra of a scene: those shipped of soil, litter and bark, and those that were given."""

from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.sensors import BandSet, Sensor

LOWEST, HIGHEST = 400.0, 2500.0
"""Range of the spectra of leaves and ground, and so of a scene [nm]."""


class Spectrum(eqx.Module):
    """A spectrum that was given for a scene, in steps of 1 nm. `Spectrum.of` makes one.

    `values` hold the last known value beyond the range that was given; `check` tells where that
    would be used.
    """

    values: Float[np.ndarray, " wavelength"]
    """Values in steps of 1 nm from 400 to 2500 nm [-]."""
    what: str = eqx.field(static=True)
    """Name of the material, for errors, such as "a soil spectrum"."""
    known: tuple[float, float] = eqx.field(static=True)
    """Lowest and highest wavelength that was given [nm]."""
    file: Path | None = eqx.field(static=True, default=None)
    """File that it was read from."""

    @classmethod
    def of(
        cls,
        wavelength: Float[np.ndarray, " wavelength"],
        values: Float[np.ndarray, " wavelength"],
        what: str = "a spectrum",
        file: Path | None = None,
    ) -> "Spectrum":
        """From values [-] at rising `wavelength` [nm], linear between them.

        **Raises:** `InputError` for wavelengths that do not rise, other numbers of values, and what
        is not finite.
        """
        if np.shape(values) != np.shape(wavelength) or not np.all(np.diff(wavelength) > 0.0):
            raise InputError(
                f"expected {what} as one value for each of some rising wavelengths [nm], but got "
                f"{np.size(values)} values for {np.size(wavelength)} wavelengths"
                f"{'' if np.shape(values) != np.shape(wavelength) else ' that do not rise'}",
                file=file,
            )
        if not np.isfinite(values).all():
            raise InputError(f"expected {what} of finite numbers: leave gaps out", file=file)
        grid = np.arange(LOWEST, HIGHEST + 1.0)
        known = float(wavelength[0]), float(wavelength[-1])
        return cls(np.interp(grid, wavelength, values), what, known, file)

    def at(self, wavelength: Float[np.ndarray, " wavelength"]) -> Any:
        """The values at `wavelength`, whole numbers of nm [-]."""
        place = np.round(np.asarray(wavelength) - LOWEST).astype(int)
        return self.values[np.clip(place, 0, int(HIGHEST - LOWEST))]

    def check(self, lowest: float, highest: float) -> None:
        """Raise `InputError` unless it is known from `lowest` to `highest` [nm]."""
        if self.known[0] > lowest or self.known[1] < highest:
            raise InputError(
                f"{self.what} must cover {lowest:g}-{highest:g} nm for this sensor, but covers "
                f"{self.known[0]:g}-{self.known[1]:g} nm",
                file=self.file,
            )


def band_wavelengths(bands: BandSet) -> Float[np.ndarray, " wavelength"]:
    """A grid fine enough for the responses of `bands`, inside 400-2500 nm, in whole nm [nm]."""
    centre, width = np.asarray(bands.centre), np.asarray(bands.fwhm)
    low, high = (centre - 2.2 * width).min(), (centre + 2.2 * width).max()
    if bands.curves is not None:
        low = min(points[0] for points, _ in bands.curves)
        high = max(points[-1] for points, _ in bands.curves)
    step = max(1.0, round(float(width.min()) / 10))
    return np.arange(max(LOWEST, np.floor(low)), min(HIGHEST, np.ceil(high)) + step / 2, step)


def visible_sensor(sensor: Sensor) -> Sensor:
    """A sensor without the bands that the spectra of a plot do not cover (400 to 2500 nm).

    **Arguments:** `sensor`, as of `fynjax.sensors.shipped_sensor`.

    **Returns:** `sensor` itself where they cover all of its bands.

    **Raises:** `InputError` where they cover none.
    """
    places = sensor.bands.covered(np.arange(LOWEST, HIGHEST + 1.0))
    if not places:
        raise InputError(
            f"sensor {sensor.name!r} has no band within {LOWEST:g} to {HIGHEST:g} nm, where leaves "
            "and ground have spectra"
        )
    return sensor if len(places) == len(sensor.bands) else sensor.select(places)


def background_spectrum(
    name: str, wavelength: Float[np.ndarray, " wavelength"]
) -> Float[np.ndarray, " wavelength"]:
    """A shipped spectrum at `wavelength` [nm, 400-2500], linearly interpolated [-].

    `name` is dry_soil, wet_soil, bark, litter or char; sources in `data/README.md`.
    """
    frame = _table("background.csv")
    return np.interp(wavelength, frame["wavelength_nm"], frame[name])


def soil_shapes(
    wavelength: Float[np.ndarray, " wavelength"],
) -> Float[np.ndarray, "shape wavelength"]:
    """How soils differ in shape, beside brightness and moisture [-], at `wavelength`
    [nm, 400-2500].

    Four vectors: the logarithm of a soil's reflectance changes by their sum, each times a number
    that is 0 for the shipped dry soil and 1 as root mean square over 111 soils of the world. With
    brightness and moisture they leave 0.015 and 0.026 of error (root mean square) in soils of two
    other sets, where these alone leave 0.065 and 0.078. Source: `data/README.md`.
    """
    frame = _table("soil_shapes.csv")
    vectors = frame.drop(columns="wavelength_nm").to_numpy().T
    return np.stack([np.interp(wavelength, frame["wavelength_nm"], row) for row in vectors])


@lru_cache(maxsize=2)
def _table(name: str) -> pd.DataFrame:
    with (resources.files("fynjax.scene") / "data" / name).open() as table:
        return pd.read_csv(table)
