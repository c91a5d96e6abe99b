"""What the model of a plot is off by."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision, in_double


class ModelError(eqx.Module):
    """What a model of a plot is off by: a factor on reflectance, over wavelength.

    Its logarithm is normal, with mean zero: what no parameter of a plot explains, as it was found
    on plots that were measured (`LearnedPrior.model_error`). A whole region of the spectrum errs
    together, so that neighbouring bands are correlated.

    **Raises:** `InputError` for wavelengths that do not grow, and a covariance that is none.

    **Example:** a model that is off by 10 % in the visible and by as much, independently, in the
    near infrared.

    >>> from fynjax.scene import ModelError
    >>> error = ModelError([550.0, 850.0], [0.1, 0.1], [[1.0, 0.0], [0.0, 1.0]])
    >>> error.covariance([500.0, 700.0]).round(4).tolist()
    [[0.01, 0.0071], [0.0071, 0.01]]
    """

    wavelength: Float[Array | np.ndarray, " wavelength"] = eqx.field(converter=in_double)
    """[nm], ascending."""
    sd: Float[Array | np.ndarray, " wavelength"] = eqx.field(converter=in_double)
    """Standard deviation of the logarithm of the factor [-]."""
    correlation: Float[Array | np.ndarray, "wavelength wavelength"] = eqx.field(converter=in_double)
    """Between these logarithms [-]."""

    def __check_init__(self) -> None:
        at, sd, correlation = map(np.asarray, (self.wavelength, self.sd, self.correlation))
        count = at.size
        if at.ndim != 1 or sd.shape != (count,) or correlation.shape != (count, count):
            raise InputError(
                "expected a standard deviation for each wavelength and a correlation for each pair "
                f"of them, but got shapes {at.shape}, {sd.shape} and {correlation.shape}"
            )
        if not (count and (np.diff(at) > 0).all() and (sd >= 0).all() and np.isfinite(sd).all()):
            raise InputError("expected ascending wavelengths and deviations of 0 or more")
        if not np.isfinite(correlation).all() or np.linalg.eigvalsh(correlation)[0] < -1e-4:
            raise InputError("expected correlations that some errors can have together")

    @double_precision
    def covariance(
        self, wavelength: Float[np.ndarray, " band"] | Sequence[float]
    ) -> Float[np.ndarray, "band band"]:
        """Covariance of the logarithms of the factors at any wavelengths.

        Between those of the record errors are interpolated, beyond them they are those of the ends.

        **Arguments:** `wavelength` [nm].
        """
        at, known = np.asarray(wavelength, float), np.asarray(self.wavelength)
        sd = np.asarray(self.sd)
        covariance = np.asarray(self.correlation) * np.outer(sd, sd)
        shares = np.stack([np.interp(at, known, row) for row in np.eye(len(known))], axis=1)
        between = shares @ covariance @ shares.T
        # Interpolation would make errors half-way between two wavelengths smaller than at both.
        variance = np.diagonal(between)
        own = np.interp(at, known, sd)
        scale = own / np.sqrt(np.where(variance > 0.0, variance, 1.0))
        return between * np.outer(scale, scale)

    def wider(self, factor: float) -> "ModelError":
        """The same with standard deviations of so many times those of this one."""
        return ModelError(self.wavelength, factor * self.sd, self.correlation)
