"""Which statistics of an image a calibration compares, and with what errors."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.inversion._fit_result import Data
from fynjax.metrics import BANDS

IMAGE_STATISTICS = tuple(
    f"{layer}.{kind}"
    for layer in (*BANDS, "NDVI", "GNDVI", "GSAVI", "NormR")
    for kind in ("mean", "std", "q10", "q50", "q90")
)
"""What is compared with a whole image: centre, spread and tails of bands and some indices."""

_SAME_BANDS = {
    "N/R": {"NDVI", "SR", "MSR", "WDRVI", "GDVI", "TVI", "RDVI", "IPVI"},
    "N/G": {"GNDVI", "GCI", "RVI", "NDWI"},
    "N, R, G": {"NormNIR", "NormR", "NormG", "GRNDVI"},
}
_SPREAD = 25.0


def weigh_targets(
    names: Sequence[str],
    value: Float[np.ndarray, " statistic"],
    relative_sd: float,
    *,
    sd: Float[np.ndarray, " statistic"] | None = None,
) -> Data:
    """Targets with the errors that a calibration gives them.

    A stated `sd` is kept. Without one, or where it is NaN, a mean or quantile gets the share
    `relative_sd` of its value, and a standard deviation 25 times that, because sensor noise and
    blur, which the model leaves out, change spreads first. Indices that are functions of the same
    ratio of two bands repeat one measurement: a group of n has its errors widened by sqrt(n). So
    are those of the three bands' shares, although they hold two ratios.

    **Arguments:** `names`, such as "NDVI.mean"; `value`, what was measured; `relative_sd`, above 0.

    Raises `InputError` if `relative_sd` is not positive or a value is not finite.
    """
    if not relative_sd > 0:
        raise InputError(f"`relative_sd` must be positive, but is {relative_sd:g}")
    keys = []
    for name in names:
        layer, kind = name.split(".")
        group = next((g for g, members in _SAME_BANDS.items() if layer in members), layer)
        keys.append((group, kind))
    error = np.full(len(names), np.nan) if sd is None else np.array(sd, float)
    for i, key in enumerate(keys):
        if np.isnan(error[i]):
            share = relative_sd * (_SPREAD if key[1] == "std" else 1.0)
            error[i] = max(share * abs(value[i]), 1e-4) * np.sqrt(keys.count(key))
    return Data(tuple(names), jnp.asarray(value), jnp.asarray(error))
