"""Sensor noise: how far a measured radiance may lie from the true one.

A noise model is a distribution. It gives the standard deviation that an inversion or an information
analysis needs, and draws from a seed for an image with the noise of a measurement. Radiance is in
W m-2 sr-1 µm-1 throughout, with bands on the last axis.
"""

import abc
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax._core.math import square_root
from fynjax._core.spectral import check_wavelength

RADIANCE_UNITS = {
    "W m-2 sr-1 um-1": 1.0,
    "mW m-2 sr-1 nm-1": 1.0,
    "uW cm-2 sr-1 nm-1": 10.0,
    "W m-2 sr-1 nm-1": 1000.0,
}
"""What one unit of a noise table is in W m-2 sr-1 µm-1."""


def _values(value: Any) -> Any:
    return value if isinstance(value, jax.Array) else np.asarray(value, dtype=np.float64)


def _floating(radiance: Any) -> Array:
    array = jnp.asarray(radiance)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


class AbstractNoise(eqx.Module):
    """Noise that is independent between pixels and between bands.

    `standard_deviation` and `draw` are differentiable in the radiance.
    """

    @abc.abstractmethod
    def pixel_deviation(self, radiance: Float[Array, "*batch band"]) -> Float[Array, "*batch band"]:
        """Standard deviation of one pixel [W m-2 sr-1 µm-1]."""

    def standard_deviation(
        self,
        radiance: Float[Array | np.ndarray, "*batch band"],
        *,
        averaged: float | Float[Array, ""] = 1.0,
    ) -> Float[Array, "*batch band"]:
        """Standard deviation of the mean of `averaged` pixels [W m-2 sr-1 µm-1]."""
        deviation = self.pixel_deviation(_floating(radiance))
        return deviation / jnp.sqrt(jnp.asarray(averaged, deviation.dtype))

    def draw(
        self,
        key: Array | int,
        radiance: Float[Array | np.ndarray, "*batch band"],
        *,
        averaged: float | Float[Array, ""] = 1.0,
    ) -> Float[Array, "*batch band"]:
        """Noisy radiance [W m-2 sr-1 µm-1] of means of `averaged` pixels: the same for the same key
        (or seed) and shape.

        Normally distributed. The random numbers do not depend on the radiance, so a draw is a
        smooth function of it. A dark pixel may come out negative.
        """
        radiance = _floating(radiance)
        key = jax.random.key(key) if isinstance(key, int | np.integer) else key
        normal = jax.random.normal(key, radiance.shape, radiance.dtype)
        return radiance + self.standard_deviation(radiance, averaged=averaged) * normal


class RadiometricNoise(AbstractNoise):
    """Noise of an imaging spectrometer, |a sqrt(b + L) + c| (as ISOFIT tabulates it).

    The square root is photon noise over an offset b of dark signal; c takes up the rest. Where
    b + L is negative its root counts as zero.
    """

    a: Float[Array, " band"] = eqx.field(converter=_values)
    """Photon noise [(W m-2 sr-1 µm-1)^(1/2)]."""
    b: Float[Array, " band"] = eqx.field(converter=_values)
    """Dark signal as radiance [W m-2 sr-1 µm-1]."""
    c: Float[Array, " band"] = eqx.field(converter=_values)
    """Constant part [W m-2 sr-1 µm-1]."""
    integrations: float = eqx.field(static=True, converter=float, default=1.0)
    """Frames that one pixel averages [-]; noise falls with their square root."""

    def pixel_deviation(self, radiance: Float[Array, "*batch band"]) -> Float[Array, "*batch band"]:
        a, b, c = (jnp.asarray(v, radiance.dtype) for v in (self.a, self.b, self.c))
        root = square_root(jnp.maximum(b + radiance, 0.0))
        return jnp.abs(a * root + c) / math.sqrt(self.integrations)


def radiometric_noise(
    wavelength: ArrayLike,
    a: ArrayLike,
    b: ArrayLike,
    c: ArrayLike,
    *,
    centre: ArrayLike,
    unit: str = "uW cm-2 sr-1 nm-1",
    integrations: float = 1.0,
) -> RadiometricNoise:
    """Noise of bands, from a table of its coefficients over wavelength.

    **Arguments:**

    - `wavelength`: of the table [nm], increasing.
    - `a`, `b`, `c`: coefficients of `RadiometricNoise` on it, for radiance in `unit`; they are
      interpolated linearly.
    - `centre`: of the bands [nm].
    - `unit`: of the table, one of `RADIANCE_UNITS`.
    - `integrations`: frames that one pixel averages.

    **Returns:** a `RadiometricNoise`, in W m-2 sr-1 µm-1. Not differentiable.

    **Raises:** `InputError` for an unknown unit, a bad wavelength grid, and bands that lie beyond
    the table by more than its nearest step.
    """
    if unit not in RADIANCE_UNITS:
        raise InputError(
            f"expected a unit of radiance among {', '.join(map(repr, RADIANCE_UNITS))}, but got "
            f"{unit!r}."
        )
    grid = check_wavelength(wavelength, "the wavelengths of the noise table")
    centres = np.atleast_1d(np.asarray(centre, dtype=np.float64))
    # A band may lie beyond the table by its nearest step: there the outermost value holds.
    steps = np.diff(grid) if grid.size > 1 else np.zeros(1)
    low, high = grid[0] - steps[0], grid[-1] + steps[-1]
    outside = (centres < low) | (centres > high)
    if outside.any():
        raise InputError(
            f"the noise table must cover all bands, but runs from {grid[0]:g} to {grid[-1]:g} nm "
            f"and the band at {centres[outside][0]:g} nm lies outside."
        )
    at_bands: list[Any] = [np.interp(centres, grid, np.asarray(v, np.float64)) for v in (a, b, c)]
    # With L = k l:  k |a sqrt(b + l) + c| = |sqrt(k) a sqrt(k b + L) + k c|.
    scale = RADIANCE_UNITS[unit]
    first, second, third = at_bands
    return RadiometricNoise(np.sqrt(scale) * first, scale * second, scale * third, integrations)


class CameraNoise(AbstractNoise):
    """Shot noise, read noise and quantisation of a digital camera."""

    saturation: Float[Array, " band"] = eqx.field(converter=_values)
    """Radiance that fills a pixel, at the exposure used [W m-2 sr-1 µm-1]."""
    full_well: Float[Array, " band"] = eqx.field(converter=_values)
    """Electrons of a full pixel [-]."""
    read_noise: Float[Array, " band"] = eqx.field(converter=_values)
    """Standard deviation of the reading [electrons]."""
    bits: int = eqx.field(static=True)
    """Bits of the digital number, which spans the full well."""

    def pixel_deviation(self, radiance: Float[Array, "*batch band"]) -> Float[Array, "*batch band"]:
        well, read = (jnp.asarray(v, radiance.dtype) for v in (self.full_well, self.read_noise))
        gain = well / jnp.asarray(self.saturation, radiance.dtype)  # electrons per radiance
        step = well / float(2**self.bits - 1)  # electrons per digital number
        # A Poisson count varies by its mean; rounding to steps q by q²/12.
        electrons = jnp.maximum(gain * radiance, 0.0)
        return jnp.sqrt(electrons + read**2 + step**2 / 12.0) / gain
