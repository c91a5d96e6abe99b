"""Statistics of pixel distributions, differentiable, and the overlap of two of them.

Every function reduces all elements of its arrays to one distribution; for several indices at once
use `jax.vmap`. `valid` is a boolean mask of the pixels that count. A masked pixel may hold NaN and
gets the gradient zero; a NaN that is not masked makes the result NaN, so that it cannot
pass unnoticed. With no valid pixel at all the result is NaN.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax._core.math import square_root

Sample = Float[Array | np.ndarray, "*pixel"]
Mask = Bool[Array | np.ndarray, "*pixel"]
Scalar = Float[Array, ""]


def mean(values: Sample, valid: Mask | None = None) -> Scalar:
    """Mean of the valid pixels, in their unit.

    **Arguments:**

    - `values`: pixels of any shape.
    - `valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` for no pixel, or a mask of another shape.

    Linear in `values`, hence differentiable to any order.
    """
    x, weight = _flat(values, valid)
    return jnp.sum(x) / jnp.sum(weight)


def standard_deviation(values: Sample, valid: Mask | None = None) -> Scalar:
    """Population standard deviation of the valid pixels (divided by n), in their unit.

    **Arguments:**

    - `values`: pixels of any shape.
    - `valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` for no pixel, or a mask of another shape.

    Differentiable in `values`; where all pixels are equal it is 0 with the gradient 0.
    """
    x, weight = _flat(values, valid)
    count = jnp.sum(weight)
    # Counted from one of the pixels, equal ones deviate by exactly nothing.
    origin = jax.lax.stop_gradient(jnp.max(jnp.where(weight > 0, x, -jnp.inf)))
    shifted = jnp.where(weight > 0, x - origin, 0.0)
    deviation = jnp.where(weight > 0, shifted - jnp.sum(shifted) / count, 0.0)
    return square_root(jnp.sum(deviation**2) / count)


QUANTILE_WINDOW = 0.05
"""Share of the pixels about a quantile that its derivative is taken over by default [-]."""


def quantiles(
    values: Sample,
    probabilities: float | Float[Array | np.ndarray, " q"],
    valid: Mask | None = None,
    *,
    window: float | None = None,
) -> Float[Array, " q"]:
    """Quantiles of the valid pixels by linear interpolation, in their unit (NumPy's default).

    **Arguments:**

    - `values`: pixels of any shape.
    - `probabilities`: in [0, 1].
    - `valid`: true where a pixel counts; all unless given.
    - `window`: share of the pixels, about that at the quantile, whose mean is taken instead [-];
      0 for none. Left out, the value is the quantile itself and its derivative in `values` that of
      the mean over a window of 0.05, though of no fewer pixels than the quantile lies on.

    **Raises:** `InputError` for no pixel, or a mask of another shape.

    Differentiable in `values` almost everywhere, by sorting, and in `probabilities`. A quantile
    moves with the one or two pixels that it lies on, and the slopes of so few are chance: how much
    a leaf there moves, not how the distribution does. Within a window there are many, whose mean
    slope is near that of the distribution; near the ends of [0, 1] it is cut, and lopsided. So by
    default the derivative is not that of the value to the last digit: a difference quotient over
    a small step is that of `window=0`, one over a wide step that of the default.
    """
    x, weight = _flat(values, valid)
    at = jnp.atleast_1d(jnp.asarray(probabilities, x.dtype))
    if window is None:
        return _smooth_quantiles(x, weight, at)
    if window > 0.0:
        count = jnp.sum(weight > 0)
        return _rank_means(x, weight, count * (at - 0.5 * window), count * (at + 0.5 * window))
    return _quantiles(x, weight, at)


def _quantiles(x: Array, weight: Array, at: Float[Array, " q"]) -> Float[Array, " q"]:
    count = jnp.sum(weight > 0)
    ordered = jnp.sort(jnp.where(weight > 0, x, jnp.inf))
    # NumPy's default, linear between the ranks on either side.
    place = at * (count - 1)
    below = jnp.clip(jnp.floor(place).astype(int), 0, jnp.maximum(count - 1, 0))
    above = jnp.minimum(below + 1, jnp.maximum(count - 1, 0))
    share = place - below
    result = ordered[below] * (1.0 - share) + ordered[above] * share
    return jnp.where((count > 0) & _sound(x), result, jnp.nan)


def _rank_means(
    x: Array, weight: Array, low: Float[Array, " q"], high: Float[Array, " q"]
) -> Float[Array, " q"]:
    """Means of the valid pixels of ranks from `low` to `high`, of which the ends are parts."""
    count = jnp.sum(weight > 0)
    ordered = jnp.sort(jnp.where(weight > 0, x, jnp.inf))
    low, high = jnp.maximum(low, 0.0)[:, None], jnp.minimum(high, count)[:, None]
    # Rank i fills [i, i + 1]: its share of the interval from `low` to `high`.
    rank = jnp.arange(x.size, dtype=x.dtype)
    share = jnp.clip(jnp.minimum(rank + 1.0, high) - jnp.maximum(rank, low), 0.0, 1.0)
    finite = jnp.where(jnp.arange(x.size) < count, ordered, 0.0)
    means = share @ finite / jnp.maximum(high - low, jnp.finfo(x.dtype).tiny)[:, 0]
    return jnp.where((count > 0) & _sound(x), means, jnp.nan)


@jax.custom_jvp
def _smooth_quantiles(x: Array, weight: Array, at: Float[Array, " q"]) -> Float[Array, " q"]:
    """Quantiles with the derivative of the means over `QUANTILE_WINDOW`, or over one pixel if that
    is more: the plain derivative."""
    return _quantiles(x, weight, at)


@_smooth_quantiles.defjvp
def _smooth_quantiles_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    x, weight, at = primals
    value, by_share = jax.jvp(lambda at: _quantiles(x, weight, at), (at,), tangents[2:])
    count = jnp.sum(weight > 0)
    # By the pixels the slope is that of the means, by the probabilities that of the value.
    middle = at * (count - 1) + 0.5
    half = jnp.maximum(0.5 * QUANTILE_WINDOW * count, 0.5)
    _, by_value = jax.jvp(
        lambda x: _rank_means(x, weight, middle - half, middle + half), (x,), tangents[:1]
    )
    return value, by_value + by_share


def histogram_intersection(
    real: ArrayLike,
    simulated: ArrayLike,
    *,
    bins: int = 256,
    limits: tuple[float, float] | None = None,
) -> float:
    """Overlap of two normalised histograms, the sum over bins of the smaller share [-], in [0, 1].

    Bins are equal and span the pooled range of both samples (the last one closed); 256 of them
    reproduce the equal values that the paper prints for indices that are monotone functions of
    each other. One minus it is the total variation distance of the histograms (Swain and Ballard
    1991).

    **Arguments:**

    - `real`, `simulated`: the two samples, pixels of any shape and in one unit.
    - `bins`: number of bins, at least 1.
    - `limits`: lower and upper edge of the histograms, in the values' unit; pixels beyond count in
      the outermost bins. The pooled range unless given.

    **Returns:** the overlap; NaN where a sample is empty or holds a value that is not finite. It is
    piecewise constant, and has no gradient: NumPy.

    >>> from fynjax.metrics import histogram_intersection
    >>> histogram_intersection([0.1, 0.2, 0.3, 0.4], [0.3, 0.4, 0.4, 0.5], bins=4)
    0.5
    """
    both = [np.ravel(sample) for sample in (real, simulated)]
    if not all(sample.size and np.isfinite(sample).all() for sample in both):
        return float("nan")
    if limits is None:
        limits = min(sample.min() for sample in both), max(sample.max() for sample in both)
    shares = [
        np.histogram(np.clip(sample, *limits), bins, limits)[0] / sample.size for sample in both
    ]
    return float(np.minimum(*shares).sum())


def _flat(
    values: Sample, valid: Mask | None
) -> tuple[Float[Array, " pixel"], Float[Array, " pixel"]]:
    """Values with masked pixels set to 0, and their weights 1 or 0."""
    x = jnp.asarray(values)
    x = x.astype(jnp.result_type(x.dtype, jnp.float32)).ravel()
    if x.size == 0:
        raise InputError("a distribution needs at least one pixel, but the array is empty.")
    if valid is None:
        return x, jnp.ones_like(x)
    mask = jnp.asarray(valid, dtype=bool)
    if mask.shape != jnp.shape(values):
        raise InputError(
            f"the mask must have the values' shape {jnp.shape(values)}, but has {mask.shape}."
        )
    mask = mask.ravel()
    return jnp.where(mask, x, 0.0), mask.astype(x.dtype)


def _sound(x: Float[Array, " pixel"]) -> Bool[Array, ""]:
    return jnp.all(jnp.isfinite(x))
