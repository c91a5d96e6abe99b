"""The simple spectral model of a clear sky, SPCTRL2 (Bird and Riordan 1984, 1986).

Equation numbers are those of the report (Bird and Riordan 1984, SERI/TR-215-2436). Where report
and the authors' later program spectrl2_2.c differ, the program is followed, as pvlib does: 1.3366
for 1.335 in eq. 2-4, 118.3 for 118.93 in eq. 2-11, the air mass of Kasten and Young (1989) in
eq. 2-5, the mixed gases for the ozone in eq. 3-8.
"""

import math
from collections.abc import Sequence
from functools import cache, partial
from importlib import resources
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax.sensors.air._atmosphere import Atmosphere, ClearAir

_REFERENCE_PRESSURE = 1013.0  # hPa
_DIFFUSE_AIR_MASS = 1.8  # of light from all over the sky, eq. 3-8 and 3-15
_ASYMMETRY = 0.65  # of rural aerosol, as the next three
_ANGSTROM_EXPONENT = 1.14
_AEROSOL_ALBEDO = 0.945  # at 400 nm
_ALBEDO_VARIATION = 0.095
_AIR_SCALE_HEIGHT = 8000.0  # m
_AEROSOL_SCALE_HEIGHT = 2000.0
_WATER_SCALE_HEIGHT = 2000.0


@cache
def _table() -> dict[str, np.ndarray]:
    path = resources.files("fynjax.sensors") / "data" / "spectrl2.csv"
    with resources.as_file(path) as file:
        table = pd.read_csv(file, comment="#")
    return {str(name): table[name].to_numpy(np.float64) for name in table}


def relative_air_mass(zenith: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Length of the sun's path through the air over that straight up [-].

    Kasten and Young (1989), eq. 3. `zenith` in degrees, below 90. Differentiable.
    """
    return 1.0 / (jnp.cos(jnp.deg2rad(zenith)) + 0.50572 * (96.07995 - zenith) ** -1.6364)


def rayleigh_depth(wavelength: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
    """Optical depth of air at 1013 hPa (eq. 2-4) [-]. `wavelength` in nm."""
    square = (wavelength / 1000.0) ** 2
    return 1.0 / (square * (115.6406 * square - 1.3366))


def aerosol_depth(
    wavelength: Float[Array, " wavelength"], depth: Float[Array, ""], at: float
) -> Float[Array, " wavelength"]:
    """Optical depth of aerosol by Ångström's law (eq. 2-7) [-], from that at `at` nm."""
    return depth * (wavelength / at) ** -_ANGSTROM_EXPONENT


class Scattered(NamedTuple):
    """Light under air and aerosol alone, over a black ground, for one at the top of the air."""

    direct: Float[Array, " wavelength"]
    """Horizontal irradiance by the sun [-]."""
    diffuse: Float[Array, " wavelength"]
    """Horizontal irradiance by the sky [-]."""
    albedo: Float[Array, " wavelength"]
    """Albedo of the sky for light from the ground, before gas absorbs (in eq. 3-8) [-]."""


def scattered_light(
    wavelength: Float[Array, " wavelength"],
    sun_zenith: Float[Array, ""],
    rayleigh: Float[Array, " wavelength"],
    aerosol: Float[Array, " wavelength"],
) -> Scattered:
    """Sunlight that air and aerosol leave in the beam and scatter down (eq. 3-1 to 3-17).

    **Arguments:** `wavelength` [nm]; `sun_zenith` [degrees]; `rayleigh` and `aerosol`, optical
    depths straight up [-]. Differentiable.
    """
    cosine = jnp.cos(jnp.deg2rad(sun_zenith))
    mass = relative_air_mass(sun_zenith)
    albedo = aerosol_albedo(wavelength)
    # Share of the aerosol's scattering that goes down, eq. 3-11 to 3-15.
    logarithm = float(np.log(1.0 - _ASYMMETRY))
    a = logarithm * (1.459 + logarithm * (0.1595 + logarithm * 0.4129))
    b = logarithm * (0.0783 + logarithm * (-0.3824 - logarithm * 0.5874))
    forward = 1.0 - 0.5 * jnp.exp((a + b * cosine) * cosine)
    mean = 1.0 / _DIFFUSE_AIR_MASS
    forward_mean = 1.0 - 0.5 * float(np.exp((a + b * mean) * mean))
    # Transmittances along the beam: of air, of what aerosol absorbs, of what it scatters.
    air = jnp.exp(-rayleigh * mass)
    absorbed = jnp.exp(-(1.0 - albedo) * aerosol * mass)
    scattered = jnp.exp(-albedo * aerosol * mass)
    from_air = 0.5 * (1.0 - air**0.95)  # eq. 3-5
    from_aerosol = air**1.5 * (1.0 - scattered) * forward  # eq. 3-6
    # Eq. 3-17: the single scattering of above is too little in the blue.
    blue = jnp.where(wavelength <= 450.0, ((wavelength + 550.0) / 1000.0) ** 1.8, 1.0)
    # Light from the ground is scattered back as if it rose at the mean air mass of diffuse light.
    air_mean = jnp.exp(-rayleigh * _DIFFUSE_AIR_MASS)
    scattered_mean = jnp.exp(-albedo * aerosol * _DIFFUSE_AIR_MASS)
    back = 0.5 * (1.0 - air_mean) + (1.0 - forward_mean) * air_mean * (1.0 - scattered_mean)
    return Scattered(
        cosine * air * jnp.exp(-aerosol * mass),
        cosine * absorbed * (from_air + from_aerosol) * blue,
        back * jnp.exp(-(1.0 - albedo) * aerosol * _DIFFUSE_AIR_MASS),
    )


def aerosol_albedo(wavelength: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
    """Single-scattering albedo of rural aerosol (eq. 3-16) [-]. `wavelength` in nm."""
    return _AEROSOL_ALBEDO * jnp.exp(-_ALBEDO_VARIATION * jnp.log(wavelength / 400.0) ** 2)


def gas_depth(
    absorption: Sequence[Float[Array, " wavelength"]], water: Array, ozone: Array, mixed: Array
) -> Float[Array, " wavelength"]:
    """-ln of the transmittance of water vapour, ozone and mixed gases (eq. 2-8, 2-9, 2-11) [-].

    **Arguments:** `absorption` coefficients of the three; the others are their air masses times
    their columns. Differentiable.
    """
    vapour, other = absorption[0] * water, absorption[2] * mixed
    return (
        0.2385 * vapour / (1.0 + 20.07 * vapour) ** 0.45
        + absorption[1] * ozone
        + 1.41 * other / (1.0 + 118.3 * other) ** 0.45
    )


def clear_sky_atmosphere(air: ClearAir) -> Atmosphere:
    """Atmosphere by SPCTRL2 at its 122 wavelengths, 300 to 4000 nm.

    The light on the ground and the sky's albedo are the model's. It has no sensor; the other
    curves extend it by the same optical depths: the upward transmittances are those of the vertical
    path below the sensor, diffuse the light that is scattered forward; the path radiance is single
    scattering of the sun below the sensor. They are good for a sensor near the ground, where path
    radiance and scattering are small; for high ones use `tabulated_atmosphere`. Between the model's
    wavelengths (19 nm apart, up to 90 nm in the near infrared) curves are meant to be linear.

    **Arguments:**

    - `air`: the atmosphere, with a sun zenith below 85 degrees.

    Differentiable in all fields of `air`. Bird and Riordan (1986), Journal of Climate and Applied
    Meteorology 25, 87-97.

    >>> from fynjax.sensors import ClearAir, clear_sky_atmosphere
    >>> atmosphere = clear_sky_atmosphere(ClearAir(sun_zenith=30.0))
    >>> len(atmosphere.wavelength), bool((atmosphere.direct >= 0.0).all())
    (122, True)
    """
    dtype = jnp.result_type(*vars(air).values())
    wavelength, solar, *absorption = (jnp.asarray(c, dtype) for c in _table().values())
    gases = partial(gas_depth, absorption)
    mass = relative_air_mass(air.sun_zenith)
    relative_pressure = air.pressure / _REFERENCE_PRESSURE
    rayleigh = rayleigh_depth(wavelength) * relative_pressure
    aerosol = aerosol_depth(wavelength, air.aerosol_optical_depth, 550.0)

    # Ozone lies about 22 km high, where the earth's curvature shortens the path (eq. 2-10).
    height = 22.0 / 6370.0
    cosine = jnp.cos(jnp.deg2rad(air.sun_zenith))
    ozone_mass = air.ozone * (1.0 + height) / jnp.sqrt(cosine**2 + 2.0 * height)
    down = (air.water_vapour * mass, ozone_mass, relative_pressure * mass)
    light = scattered_light(wavelength, air.sun_zenith, rayleigh, aerosol)
    # Gases dim direct and diffuse light on the ground alike.
    on_top = solar * air.solar_factor
    on_ground = on_top * jnp.exp(-gases(*down))
    mean = _DIFFUSE_AIR_MASS
    zero = jnp.zeros((), dtype)
    sky_gas = gases(air.water_vapour * mean, zero, relative_pressure * mean)

    # What lies below the sensor: of the air, of the aerosol, of the water.
    below = [
        -jnp.expm1(-air.sensor_height / scale)
        for scale in (_AIR_SCALE_HEIGHT, _AEROSOL_SCALE_HEIGHT, _WATER_SCALE_HEIGHT)
    ]
    # Ozone lies above aeroplanes and below satellites: a logistic curve about 22 km.
    ozone_below = (1.0 + math.exp(5.5)) / (1.0 + jnp.exp(5.5 - air.sensor_height / 4000.0))
    over_ozone = (ozone_below - 1.0) / math.exp(5.5)
    # Masses down and up again: those below the sensor are passed twice.
    both = (
        down[0] + air.water_vapour * below[2],
        ozone_mass + air.ozone * over_ozone,
        down[2] + relative_pressure * below[0],
    )
    albedo = aerosol_albedo(wavelength)
    air_up, aerosol_up = rayleigh * below[0], aerosol * below[1]
    # What goes up unscattered, and what scattering sends on upward.
    unscattered = jnp.exp(-air_up - aerosol_up)
    forward = light_kept_upward(air_up, aerosol_up, albedo) - unscattered
    # Phase functions at the angle between sunbeam and upward path: Rayleigh, Henyey-Greenstein.
    phase_air = 0.75 * (1.0 + cosine**2)
    phase_aerosol = (1.0 - _ASYMMETRY**2) / (1.0 + _ASYMMETRY**2 + 2.0 * _ASYMMETRY * cosine) ** 1.5
    # The sunbeam is dimmed above the layer, by half of the layer on the mean.
    path_depth = (rayleigh + aerosol - 0.5 * (air_up + aerosol_up)) * mass
    path_depth = path_depth + 0.5 * (air_up + aerosol_up)
    path = (air_up * phase_air + albedo * aerosol_up * phase_aerosol) * jnp.exp(-path_depth)
    both_gases = jnp.exp(-gases(*both))
    # Lines already dark on the way down cannot take away light again on the way up.
    gases_up = both_gases / jnp.exp(-gases(*down))
    return Atmosphere(
        tuple(_table()["wavelength"]),
        on_ground * light.direct,
        on_ground * light.diffuse,
        unscattered * gases_up,
        forward * gases_up,
        on_top * both_gases * path / (4.0 * jnp.pi),
        light.albedo * jnp.exp(-sky_gas),
    )


def light_kept_upward(
    rayleigh: Float[Array, " wavelength"],
    aerosol: Float[Array, " wavelength"],
    albedo: Float[Array, " wavelength"],
) -> Float[Array, " wavelength"]:
    """Share of a wide ground's light that reaches a sensor through these depths [-].

    Half of what air scatters goes on upward, and most of what aerosol does.
    """
    forward = 0.5 * (1.0 + _ASYMMETRY)
    return jnp.exp(-0.5 * rayleigh - (1.0 - albedo * forward) * aerosol)


def clear_sky_diffuse_fraction(
    wavelength: Float[Array, " wavelength"],
    sun_zenith: Float[Array, ""],
    aerosol_optical_depth: Float[Array, ""],
) -> Float[Array, " wavelength"]:
    """Diffuse over global irradiance on a horizontal plane under a clear sky [-].

    **Arguments:**

    - `wavelength`: [nm], 400 to 2500.
    - `sun_zenith`: zenith angle of the sun [degrees], below 85.
    - `aerosol_optical_depth`: at 500 nm [-], 0 to about 0.5.

    The scattering part of SPCTRL2 (Bird and Riordan 1984) at sea level over a black ground. Gases
    absorb direct and diffuse light alike there, and so leave the share as it is.

    Differentiable in all arguments.
    """
    aerosol = aerosol_depth(wavelength, aerosol_optical_depth, 500.0)
    light = scattered_light(wavelength, sun_zenith, rayleigh_depth(wavelength), aerosol)
    return light.diffuse / (light.direct + light.diffuse)
