"""What a misfit is made of: an offset, a gain, and what neither repairs."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fynjax._core.math import square_root
from fynjax.metrics._spectral import Mask, Scalar, Spectrum, _pair


class Misfit(eqx.Module):
    """A squared error in parts, and what single corrections would leave of it.

    The regression line `simulated = offset + gain * real` splits the mean squared error into three
    parts that are orthogonal and add up to it (Gauch, Hwang and Fick 2003, eq. 7-9):

        level    = (mean(simulated) - mean(real))^2
        contrast = (gain - 1)^2 var(real)
        shape    = (1 - r^2) var(simulated)

    An offset can repair the level and nothing else; after it, a gain about the mean the contrast;
    neither the shape. Where a spectrum's mean is large beside its range an offset and a gain
    through zero change its level alike, so the level alone cannot separate them. What separates
    them are the two paths by which the line moves the mean,

        mean(simulated) - mean(real) = offset + (gain - 1) mean(real),

    and the errors that are left when one correction is fitted alone. The spectral angle and the
    correlation show neither: a gain leaves the first unchanged, gain and offset the second.
    """

    mean_squared_error: Scalar
    """Squared RMSE, in the squared unit of the spectra."""
    gain: Scalar
    """Slope of the regression of simulated on real [-]."""
    offset: Scalar
    """Value of the regression line at real = 0, in the spectra's unit: the part of the difference
    of the means that goes by the offset."""
    level: Scalar
    """Squared difference of the means, in the squared unit."""
    contrast: Scalar
    """Squared error by a gain about the mean, in the squared unit."""
    shape: Scalar
    """Squared error that no gain and offset can repair, in the squared unit."""
    mean_by_gain: Scalar
    """Difference of the means that goes by the gain: (gain - 1) mean(real), in that unit."""
    rmse_without_offset: Scalar
    """RMSE left when the best offset is taken off the simulated spectrum."""
    rmse_without_gain: Scalar
    """RMSE left of simulated = k real with the best k: no offset allowed."""
    rmse_without_both: Scalar
    """RMSE left of the regression line, the root of `shape`."""

    @property
    def shares(self) -> Float[Array, "3"]:
        """Level, contrast and shape over the mean squared error [-]; they sum to one.

        Zero where the two spectra are equal.
        """
        parts = jnp.stack([self.level, self.contrast, self.shape])
        some = self.mean_squared_error > 0.0
        return jnp.where(some, parts / jnp.where(some, self.mean_squared_error, 1.0), 0.0)


def misfit_decomposition(real: Spectrum, simulated: Spectrum, valid: Mask | None = None) -> Misfit:
    """Split the squared error of a simulated spectrum into level, contrast and shape (`Misfit`).

    **Arguments:**

    - `real`, `simulated`: spectra on one grid, in one unit.
    - `valid`: true where a wavelength counts; all unless given. A masked value may be NaN.

    **Raises:** `InputError` if the shapes differ.

    Differentiable in both spectra, but for the roots where the error left is exactly zero: there
    they are 0 with the gradient 0. A constant real spectrum has no slope: its gain is NaN, and all
    that rests on it, with the gradient 0.

    Source: Gauch, Hwang and Fick (2003), Agronomy Journal 95, 1442-1446, with the real spectrum as
    the independent variable.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import misfit_decomposition
    >>> real = jnp.array([0.1, 0.2, 0.4])
    >>> misfit = misfit_decomposition(real, 1.5 * real + 0.02)
    >>> round(float(misfit.gain), 6), round(float(misfit.offset), 6)
    (1.5, 0.02)
    >>> misfit.shares.round(3)  # level, contrast, shape
    Array([0.828, 0.172, 0.   ], dtype=float32)
    """
    x, y, count = _pair(real, simulated, valid)
    keep: Bool[Array, " wavelength"] = (
        jnp.ones(x.shape, bool) if valid is None else jnp.asarray(valid, dtype=bool)
    )
    mean_x, mean_y = jnp.sum(x) / count, jnp.sum(y) / count
    dx, dy = jnp.where(keep, x - mean_x, 0.0), jnp.where(keep, y - mean_y, 0.0)
    variety, some = jnp.sum(dx**2), jnp.sum(x**2)
    # By the range: rounding leaves a constant spectrum some variance.
    low, high = jnp.min(x, where=keep, initial=jnp.inf), jnp.max(x, where=keep, initial=-jnp.inf)
    varies = high > low
    # The regression of simulated on real, about the means.
    gain = jnp.sum(dx * dy) / jnp.where(varies, variety, 1.0)
    through_zero = jnp.sum(x * y) / jnp.where(some != 0.0, some, 1.0)
    shape = jnp.sum((dy - gain * dx) ** 2) / count

    def sloped(value: Scalar) -> Scalar:
        return jnp.where(varies, value, jnp.nan)

    without_gain = square_root(jnp.sum((y - through_zero * x) ** 2) / count)
    return Misfit(
        mean_squared_error=jnp.sum((y - x) ** 2) / count,
        gain=sloped(gain),
        offset=sloped(mean_y - gain * mean_x),
        level=(mean_y - mean_x) ** 2,
        contrast=sloped((gain - 1.0) ** 2 * variety / count),
        shape=sloped(shape),
        mean_by_gain=sloped((gain - 1.0) * mean_x),
        rmse_without_offset=square_root(jnp.sum((dy - dx) ** 2) / count),
        rmse_without_gain=jnp.where(some != 0.0, without_gain, jnp.nan),
        rmse_without_both=sloped(square_root(shape)),
    )
