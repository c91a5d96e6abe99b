"""Agreement of spectra: spectral angle, errors, correlation, by spectral region."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax._core.math import square_root
from fynjax._core.spectral import check_wavelength

Spectrum = Float[Array | np.ndarray, " wavelength"]
Mask = Bool[Array | np.ndarray, " wavelength"]
Scalar = Float[Array, ""]

WATER_WINDOWS: tuple[tuple[float, float], ...] = ((1340.0, 1460.0), (1790.0, 2100.0))
"""Wavelengths [nm] lost to atmospheric water vapour, left out of a comparison."""

SPECTRAL_REGIONS: dict[str, tuple[float, float]] = {
    "full": (400.0, 2450.0),
    "vnir": (400.0, 1000.0),
    "swir1": (1000.0, 1790.0),
    "swir2": (2100.0, 2450.0),
}
"""Regions of the paper's table 5, lower and upper wavelength [nm]."""


class SpectralAgreement(eqx.Module):
    """How well a simulated spectrum agrees with a real one over one region."""

    spectral_angle: Scalar
    """Angle between the two as vectors [degrees]; blind to a common factor."""
    rmse: Scalar
    """Root mean square error, in the spectra's unit."""
    nrmse: Scalar
    """`rmse` over the range of the real spectrum [-]; NaN of a constant one."""
    correlation: Scalar
    """Pearson correlation [-]; blind to gain and offset. NaN where a spectrum is constant."""
    relative_mean_difference: Scalar
    """(simulated - real) / real of the means [-]; NaN where the real mean is zero."""


def spectral_mask(
    wavelength: ArrayLike,
    region: str | tuple[float, float] = "full",
    exclude: Sequence[tuple[float, float]] = WATER_WINDOWS,
) -> Bool[np.ndarray, " wavelength"]:
    """Wavelengths inside a region and outside all excluded windows, as true and false.

    **Arguments:**

    - `wavelength`: of the spectrum [nm], increasing.
    - `region`: a name in `SPECTRAL_REGIONS`, or its lower and upper end [nm]; both included.
    - `exclude`: windows (lower, upper) [nm] that are left out, ends included.

    **Raises:** `InputError` for an unknown region, a window that is no (lower, upper) in nm, or if
    fewer than two wavelengths are left.

    >>> import numpy as np
    >>> from fynjax.metrics import spectral_mask
    >>> wavelength = np.arange(400.0, 2451.0, 10.0)
    >>> int(spectral_mask(wavelength, "swir2").sum()), int(spectral_mask(wavelength).sum())
    (35, 161)
    """
    grid = check_wavelength(wavelength)
    if isinstance(region, str):
        if region not in SPECTRAL_REGIONS:
            raise InputError(
                f"a spectral region must be one of {', '.join(SPECTRAL_REGIONS)} or (lower, upper) "
                f"in nm, but is {region!r}."
            )
        region = SPECTRAL_REGIONS[region]
    for low, high in (region, *exclude):
        if not 100.0 <= low < high:
            raise InputError(
                f"a spectral window must be (lower, upper) in nm, but is ({low:g}, {high:g})."
            )
    mask = (grid >= region[0]) & (grid <= region[1])
    for low, high in exclude:
        mask &= ~((grid >= low) & (grid <= high))
    if np.count_nonzero(mask) < 2:
        raise InputError(
            f"a comparison needs at least two wavelengths, but {np.count_nonzero(mask)} of the "
            f"grid {grid[0]:g} to {grid[-1]:g} nm lie in {region[0]:g} to {region[1]:g} nm outside "
            "the excluded windows."
        )
    return mask


def spectral_angle(real: Spectrum, simulated: Spectrum, valid: Mask | None = None) -> Scalar:
    """Angle between two spectra as vectors [degrees], in [0, 180] (Kruse et al. 1993).

    **Arguments:**

    - `real`, `simulated`: spectra on one grid.
    - `valid`: true where a wavelength counts; all unless given. A masked value may be NaN.

    **Raises:** `InputError` if the shapes differ.

    Computed from the half angle's tangent (Kahan), so it is accurate and has bounded slopes at
    small angles, where the arc cosine has neither. Differentiable in both but where they are
    proportional, a corner: there it is 0 to rounding and its gradient finite. NaN if a spectrum
    is all zero.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import spectral_angle
    >>> round(float(spectral_angle(jnp.array([1.0, 0.0]), jnp.array([1.0, 1.0]))), 6)
    45.0
    """
    x, y, _ = _pair(real, simulated, valid)
    long_x, long_y = _norm(x), _norm(y)
    some = (long_x != 0.0) & (long_y != 0.0)
    x, y = (
        jnp.where(some, v / jnp.where(some, of, 1.0), 1.0) for v, of in ((x, long_x), (y, long_y))
    )
    # tan(angle / 2) = |u - v| / |u + v| of unit vectors u and v.
    angle = jnp.rad2deg(2.0 * jnp.arctan2(_norm(x - y), _norm(x + y)))
    return jnp.where(some, angle, jnp.nan)


def spectral_agreement(
    real: Spectrum, simulated: Spectrum, valid: Mask | None = None
) -> SpectralAgreement:
    """All measures of agreement of two spectra over the valid wavelengths.

    **Arguments:**

    - `real`, `simulated`: spectra on one grid, in one unit.
    - `valid`: true where a wavelength counts (`spectral_mask`); all unless given. A masked value
      may be NaN.

    **Returns:** a `SpectralAgreement`.

    **Raises:** `InputError` if the shapes differ.

    Differentiable in both spectra. Where they are equal RMSE and NRMSE are 0 with the gradient 0;
    of the angle see `spectral_angle`. What is NaN has the gradient 0, and leaves those of the
    others as they are.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import spectral_agreement
    >>> agreement = spectral_agreement(jnp.array([0.1, 0.2, 0.4]), jnp.array([0.1, 0.2, 0.5]))
    >>> round(float(agreement.rmse), 4), round(float(agreement.relative_mean_difference), 4)
    (0.0577, 0.1429)
    """
    x, y, count = _pair(real, simulated, valid)
    keep = jnp.ones(x.shape, bool) if valid is None else jnp.asarray(valid)
    error = _norm(y - x) / jnp.sqrt(count)
    ranges = [
        jnp.max(v, where=keep, initial=-jnp.inf) - jnp.min(v, where=keep, initial=jnp.inf)
        for v in (x, y)
    ]
    # By the range: rounding leaves a constant spectrum some variance.
    both = (ranges[0] > 0.0) & (ranges[1] > 0.0)
    dx, dy = (jnp.where(keep, v - jnp.sum(v) / count, 0.0) for v in (x, y))
    return SpectralAgreement(
        spectral_angle=spectral_angle(real, simulated, valid),
        rmse=error,
        nrmse=_ratio(error, ranges[0]),
        correlation=_ratio(jnp.sum(dx * dy), jnp.where(both, _norm(dx) * _norm(dy), 0.0)),
        relative_mean_difference=_ratio(jnp.sum(y) - jnp.sum(x), jnp.sum(x)),
    )


def _pair(
    real: Spectrum, simulated: Spectrum, valid: Mask | None
) -> tuple[Spectrum, Spectrum, Scalar]:
    """Both spectra with masked values set to 0, and the number of valid wavelengths."""
    x, y = jnp.asarray(real), jnp.asarray(simulated)
    keep = jnp.ones(x.shape, bool) if valid is None else jnp.asarray(valid, dtype=bool)
    if not x.shape == y.shape == keep.shape:
        raise InputError(
            f"spectra and mask must be on one grid, but have the shapes {x.shape} (real), "
            f"{y.shape} (simulated) and {keep.shape} (mask)."
        )
    dtype = jnp.result_type(x.dtype, y.dtype, jnp.float32)
    x, y = x.astype(dtype), y.astype(dtype)
    return jnp.where(keep, x, 0.0), jnp.where(keep, y, 0.0), jnp.sum(keep).astype(dtype)


def _ratio(over: Scalar, under: Scalar) -> Scalar:
    """A quotient; NaN with the gradient 0 where it divides by zero."""
    some = under != 0.0
    return jnp.where(some, over / jnp.where(some, under, 1.0), jnp.nan)


def _norm(x: Spectrum) -> Scalar:
    return square_root(jnp.sum(x**2))
