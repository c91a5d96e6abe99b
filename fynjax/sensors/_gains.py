"""What the calibration of a sensor's bands to reflectance may be off by."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError


def _one_or_many(sd: Any) -> float | tuple[float, ...]:
    return float(sd) if np.ndim(sd) == 0 else tuple(float(v) for v in sd)


@dataclass(frozen=True)
class Gains:
    """Errors of the gains of a sensor's bands: factors by which reflectance may be off.

    Their logarithms are normal, with mean zero. Raises `InputError` for values out of range.
    """

    sd: float | Sequence[float]
    """Standard deviation of the logarithm of the gain of all bands, or of each in order [-]."""
    shared: float = 0.5
    """Share of the variance that all bands have in common, as by light and exposure [-]."""
    way: str = "assumed"
    """Way in which the bands were calibrated, such as 'panels' or 'light_sensor'."""
    drift: float = 0.02
    """Standard deviation of the logarithm of a factor on all bands by which views of one camera
    differ, as light and exposure change between frames and flights [-]; an assumption."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd", _one_or_many(self.sd))
        sd = np.atleast_1d(self.sd)
        if not np.isfinite(self.drift) or self.drift < 0.0:
            raise InputError(f"expected a drift of gains of at least 0, but got {self.drift}")
        if not (np.isfinite(sd).all() and (sd >= 0.0).all() and 0.0 <= self.shared <= 1.0):
            raise InputError(
                "expected deviations of gains of at least 0 and a share of 0 to 1 that bands have "
                f"in common, but got {self.sd} and {self.shared}"
            )

    def __str__(self) -> str:
        sd = sorted(100.0 * v for v in set(np.atleast_1d(self.sd)))
        span = f"{sd[0]:.3g}" if len(sd) == 1 else f"{sd[0]:.3g} to {sd[-1]:.3g}"
        shared = f"{100.0 * self.shared:.0f} % of the variance in common"
        return f"{span} % a band, {shared} ({self.way.replace('_', ' ')})"

    def of_bands(self, count: int) -> Float[np.ndarray, " band"]:
        """Standard deviation of the logarithm of the gain of each of `count` bands [-].

        Raises `InputError` where there are deviations of another number of bands.
        """
        if np.size(self.sd) not in (1, count):
            raise InputError(
                f"expected one deviation of gains, or one for each of {count} bands, but got "
                f"{np.size(self.sd)}"
            )
        return np.broadcast_to(np.asarray(self.sd, float), (count,))

    def covariance(self, count: int) -> Float[np.ndarray, "band band"]:
        """Covariance of the logarithms of the gains of `count` bands; errors as `of_bands`."""
        sd = self.of_bands(count)
        return sd[:, None] * sd * (self.shared + (1.0 - self.shared) * np.eye(count))

    def select(self, places: Sequence[int]) -> "Gains":
        """The same of the bands at `places` alone, in that order."""
        if isinstance(self.sd, float):
            return self
        return replace(self, sd=tuple(self.sd[i] for i in places))


ASSUMED = Gains(0.05, 0.5)
"""Errors of the gains of a sensor whose file states none."""
