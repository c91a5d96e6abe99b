"""AVIRIS-NG over Pasadena on 8 November 2017: radiance of a lawn and a walk, and what is known of
the air.

Of the walk there is no field spectrum: its reflectance is what its own radiance gives."""

import json
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pandas as pd

from fynjax.sensors import (
    Atmosphere,
    BandSet,
    ClearAir,
    at_sensor_radiance,
    band_atmosphere,
    sun_position,
    surface_reflectance,
    tabulated_atmosphere,
)

WATER_BANDS = ((900, 1000), (1090, 1190))
WAVELENGTH = np.arange(400.0, 2501.0, 2.5)
"""Of the table of atmospheres [nm]."""


class Flight(NamedTuple):
    """What was measured from the aeroplane and on the ground."""

    bands: BandSet
    lawn: np.ndarray
    """At-sensor radiance of the lawn in the bands [W m-2 sr-1 um-1]."""
    walk: np.ndarray
    """And of the walk."""
    reflectance: np.ndarray
    """Of the lawn by field spectrometer, mean of 68 spectra, at `WAVELENGTH` [-]."""
    reflectance_sd: np.ndarray
    """Standard deviation of the spectra [-]."""
    sun: tuple[float, float, float]
    """Zenith and azimuth [degrees], sunlight over that at one astronomical unit [-]."""

    @property
    def centre(self) -> np.ndarray:
        """Centres of the bands [nm]."""
        return np.asarray(self.bands.centre)

    def air(self, water: jax.Array | float) -> ClearAir:
        """The air with a column of water vapour [g cm-2]: aerosol and pressure of the sun
        photometer of that day, heights of the file for MODTRAN."""
        zenith, _, factor = self.sun
        return ClearAir(
            sun_zenith=zenith, water_vapour=water, aerosol_optical_depth=0.035, ozone=0.3,
            pressure=976.0, sensor_height=1950.0, solar_factor=factor,
        )  # fmt: skip

    def in_bands(self, atmosphere: Atmosphere, surroundings: jax.Array | None) -> jax.Array:
        """Radiance of the lawn in the bands [W m-2 sr-1 um-1]; `surroundings` at `WAVELENGTH`,
        `None`: the lawn's own."""
        radiance = at_sensor_radiance(atmosphere, self.reflectance, surroundings)
        return self.bands.average(atmosphere.wavelength, radiance)


def read_flight(shared_data: Path) -> Flight:
    """The flight's files in the folder of shared data. Needs pvlib for the sun."""
    folder = shared_data / "eco" / "avirisng"
    width = np.loadtxt(folder / "wavelength_fit.txt")[:, 2] * 1000.0
    name = "ang20171108t184227"
    (centre, lawn), (_, walk) = (
        np.loadtxt(folder / f"{name}_rdn_Beckman{target}.txt", unpack=True)
        for target in ("Lawn", "Walk")
    )
    keep = (centre > 420.0) & (centre < 2480.0)
    centre, width = centre[keep], width[keep]
    field = np.loadtxt(folder / "insitu_BeckmanLawn.txt", comments="#", unpack=True)
    scene = json.loads((folder / f"{name}_modtran.json").read_text("utf-8"))
    place = scene["MODTRAN"][0]["MODTRANINPUT"]["GEOMETRY"]
    time = pd.Timestamp("2017-11-08", tz="UTC") + pd.Timedelta(hours=place["GMTIME"])
    # The file counts longitude to the west.
    sun = sun_position(place["PARM1"], -place["PARM2"], time, altitude=350.0)
    return Flight(
        BandSet(tuple(f"{c:.1f}" for c in centre), tuple(centre), tuple(width)),
        10.0 * lawn[keep],
        10.0 * walk[keep],
        np.interp(WAVELENGTH, field[0], field[1]),
        np.interp(WAVELENGTH, field[0], field[2]),
        tuple(sun),
    )


def in_windows(wave: np.ndarray, windows: tuple[tuple[int, int], ...]) -> np.ndarray:
    """Which of the wavelengths [nm] are in any of the windows."""
    return np.any([(wave >= low) & (wave <= high) for low, high in windows], axis=0)


def band_sums(flight: Flight, radiance: jax.Array | np.ndarray) -> jax.Array:
    """Radiance summed over each band of water vapour.

    Whole bands, not channels: 6SV knows 0.9 to 1.3 nm out of every 2.5 nm here, too little for a
    channel of 5.8 nm.
    """
    windows = [in_windows(flight.centre, (band,)) for band in WATER_BANDS]
    return jnp.stack([jnp.asarray(radiance)[window].sum() for window in windows])


def fitted_water(flight: Flight) -> float:
    """Column of water vapour that closes the light of both water bands over the lawn, by least
    squares of the logarithms [g cm-2]. The one number that is fitted; it leaves the light below
    680 nm as it is."""

    def residual(root: jax.Array, _: None) -> jax.Array:
        model = flight.in_bands(tabulated_atmosphere(flight.air(root**2)), None)
        return jnp.log(band_sums(flight, model) / band_sums(flight, flight.lawn))

    solver = optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
    solution = optx.least_squares(residual, solver, jnp.asarray(1.2), max_steps=50)
    return float(solution.value) ** 2


def half_walk(flight: Flight, atmosphere: Atmosphere) -> np.ndarray:
    """Surroundings that are half lawn and half walk, at `WAVELENGTH` [-].

    Surroundings and walk are each other's: the walk's reflectance by its own radiance amid them,
    found by iteration, which contracts as the air sends little on (0.1 a step in the blue). In
    bands of water vapour, where the air is opaque, reflectance is interpolated.
    """
    by_band = band_atmosphere(atmosphere, flight.bands)
    lawn = flight.bands.average(tuple(WAVELENGTH), flight.reflectance)
    around = lawn
    for _ in range(8):
        walk = surface_reflectance(by_band, flight.walk, around, threshold=0.02)
        around = 0.5 * (lawn + jnp.maximum(walk, 0.0))
    known = np.asarray(walk) > 0.0
    known &= ~in_windows(flight.centre, (*WATER_BANDS, (1340, 1460), (1780, 1990)))
    walk = np.interp(WAVELENGTH, flight.centre[known], np.asarray(walk)[known])
    return 0.5 * (flight.reflectance + walk)


def window_error(flight: Flight, model: jax.Array, window: tuple[int, int]) -> float:
    """Median of modelled over measured radiance of the lawn in a window, less one [-]."""
    inside = in_windows(flight.centre, (window,))
    return float(np.median((np.asarray(model) / flight.lawn)[inside]) - 1.0)
