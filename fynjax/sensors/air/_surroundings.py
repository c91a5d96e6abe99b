"""How far around a pixel the light comes from that the air scatters into its line of sight."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.math import real_array

# 6S's environment functions, fitted to Monte Carlo runs for straight views (subroutine ENVIRO of
# its code). Share of the scattered light that comes from within r km, for a sensor at each height:
# of air 1 - a exp(-b r) - (1 - a) exp(-0.08 r), of aerosol 1 - c exp(-d r) - (1 - c) exp(-e r).
_HEIGHT = (0.5, 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 18, 20, 60)  # km
_AIR_NEAR = (
    0.730, 0.710, 0.656, 0.606, 0.560, 0.516, 0.473, 0.433,
    0.395, 0.323, 0.258, 0.209, 0.171, 0.142, 0.122, 0.070,
)  # fmt: skip
_AIR_NEAR_RATE = (
    2.8, 1.51, 0.845, 0.634, 0.524, 0.465, 0.429, 0.405,
    0.390, 0.386, 0.409, 0.445, 0.488, 0.545, 0.608, 0.868,
)  # fmt: skip
_AIR_FAR_RATE = 0.08
_AEROSOL_FAR = (
    0.239, 0.396, 0.588, 0.626, 0.612, 0.505, 0.454, 0.448,
    0.444, 0.445, 0.444, 0.448, 0.448, 0.448, 0.448, 0.448,
)  # fmt: skip
_AEROSOL_FAR_RATE = (
    1.40, 1.20, 1.02, 0.86, 0.74, 0.56, 0.46, 0.42,
    0.38, 0.34, 0.30, 0.28, 0.27, 0.27, 0.27, 0.27,
)  # fmt: skip
_AEROSOL_NEAR_RATE = (
    9.17, 6.26, 5.48, 5.16, 4.74, 3.65, 3.24, 3.15,
    3.07, 2.97, 2.88, 2.83, 2.83, 2.83, 2.83, 2.83,
)  # fmt: skip


def mean_surroundings(
    reflectance: Float[Array, "*batch y x wavelength"],
    pixel: float,
    sensor_height: float,
    *,
    aerosol_share: Float[Array, " #wavelength"] | float = 0.7,
) -> Float[Array, "*batch y x wavelength"]:
    """Reflectance of each pixel's surroundings, weighted by distance: for `at_sensor_radiance` [-].

    Of the light that air scatters into the line of sight of a sensor 2 km high, half comes from
    within 1.5 km (air) and 0.3 km (aerosol): a picture narrower than that has one mean.

    **Arguments:**

    - `reflectance`: of a picture, wavelengths on the last axis [-]. Beyond its edges it goes on
      periodically: where that is wrong, add a rim of what is there.
    - `pixel`: edge of a pixel on the ground [m], above 0.
    - `sensor_height`: above the ground [m]. Below 500 m and above 60 km as at these.
    - `aerosol_share`: of the scattered light, what aerosol scattered [-], 0 to 1; one number, or
      one for each wavelength. 0.7: a clear day at 550 nm.

    **Raises:** `InputError` for a picture without rows and columns, and a pixel or height that is
    not above 0.

    Differentiable in `reflectance` and `aerosol_share`. The environment functions of 6S: Vermote et
    al. (1997), IEEE Transactions on Geoscience and Remote Sensing 35, 675-686, for a sensor in the
    air by its code. The density of exp(-b r) around a point is a product in Fourier space,
    1 / sqrt(1 + (k / b)²) at the wave number k.

    >>> import jax.numpy as jnp
    >>> from fynjax.sensors import mean_surroundings
    >>> picture = jnp.zeros((32, 32, 1)).at[:, 16:].set(0.4)  # a coast
    >>> around = mean_surroundings(picture, pixel=200.0, sensor_height=2000.0)
    >>> bool(around[0, 8, 0] < around[0, 15, 0] < around[0, 16, 0]), round(float(around.mean()), 6)
    (True, 0.2)
    """
    picture = real_array(reflectance)
    if picture.ndim < 3:
        raise InputError(
            "`reflectance` must have rows, columns and wavelengths, but its shape is "
            f"{picture.shape}."
        )
    for name, value in (("pixel", pixel), ("sensor_height", sensor_height)):
        if not value > 0.0:
            raise InputError(f"`{name}` must be a positive number of m, but is {value:g}.")
    shape = picture.shape[-3], picture.shape[-2]
    along_y, along_x = np.fft.fftfreq(shape[0], pixel), np.fft.rfftfreq(shape[1], pixel)
    square = (2.0 * np.pi * 1000.0) ** 2 * (along_y[:, None] ** 2 + along_x**2)  # (rad/km)²

    def response(share: float, rate: float, other: float) -> np.ndarray:
        """Of share x exp(-rate r) + (1 - share) x exp(-other r) [y, x, 1]."""
        first, second = (1.0 / np.sqrt(1.0 + square / b**2) for b in (rate, other))
        return (share * first + (1.0 - share) * second)[..., None]

    def at(values: tuple[float, ...]) -> float:
        return float(np.interp(sensor_height / 1000.0, _HEIGHT, values))

    air = response(at(_AIR_NEAR), at(_AIR_NEAR_RATE), _AIR_FAR_RATE)
    aerosol = response(at(_AEROSOL_FAR), at(_AEROSOL_FAR_RATE), at(_AEROSOL_NEAR_RATE))
    share = jnp.asarray(aerosol_share, picture.dtype)
    spectrum = jnp.fft.rfft2(picture, axes=(-3, -2))
    spectrum = spectrum * (share * aerosol + (1.0 - share) * air).astype(picture.dtype)
    return jnp.fft.irfft2(spectrum, s=shape, axes=(-3, -2))
