"""Statistics and distances of pixel distributions: exact, and smooth for inversion.

Every function reduces all elements of its arrays to one distribution; for several indices at once
use `jax.vmap`. `valid` is a boolean mask of the pixels that count. A masked pixel may hold NaN and
gets the gradient zero; a NaN that is not masked makes the result NaN, so that it cannot
pass unnoticed. With no valid pixel at all the result is NaN.

The two-sample functions call the samples `real` and `simulated`, as a comparison does; all are
symmetric but the histograms' range, which pools both.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from fynjax._core.errors import InputError

Sample = Float[Array, "*pixel"]
Mask = Bool[Array, "*pixel"]
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
    variance = jnp.sum(deviation**2) / count
    spread = ~(variance == 0.0)  # true for NaN, which must show
    return jnp.where(spread, jnp.sqrt(jnp.where(spread, variance, 1.0)), 0.0)


QUANTILE_WINDOW = 0.05
"""Share of the pixels about a quantile that its derivative is taken over by default [-]."""


def quantiles(
    values: Sample,
    probabilities: Float[Array, " q"],
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
    middle = at * (count - 1) + 0.5
    half = jnp.maximum(0.5 * QUANTILE_WINDOW * count, 0.5)
    _, by_value = jax.jvp(
        lambda x: _rank_means(x, weight, middle - half, middle + half), (x,), tangents[:1]
    )
    return value, by_value + by_share


def histogram_intersection(
    real: Sample,
    simulated: Sample,
    *,
    bins: int = 256,
    limits: tuple[Any, Any] | None = None,
    real_valid: Mask | None = None,
    simulated_valid: Mask | None = None,
) -> Scalar:
    """Overlap of two normalised histograms, the sum over bins of the smaller share [-], in [0, 1].

    Bins are equal and span the pooled range of the valid pixels, as in `numpy.histogram` (the last
    one closed); 256 of them reproduce the equal values that the paper prints for indices that are
    monotone functions of each other. One minus it is the total variation distance of the
    histograms.

    **Arguments:**

    - `real`, `simulated`: the two samples, pixels of any shape and in one unit.
    - `bins`: number of bins, at least 1.
    - `limits`: lower and upper edge of the histograms, in the values' unit; pixels beyond count in
      the outermost bins. The pooled range unless given.
    - `real_valid`, `simulated_valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` for no pixel, or a mask of another shape.

    Piecewise constant, so its gradient is zero: see `smooth_histogram_intersection`. Swain and
    Ballard (1991).

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import histogram_intersection
    >>> real, simulated = jnp.array([0.1, 0.2, 0.3, 0.4]), jnp.array([0.3, 0.4, 0.4, 0.5])
    >>> float(histogram_intersection(real, simulated, bins=4))
    0.5
    """
    x, wx = _flat(real, real_valid)
    y, wy = _flat(simulated, simulated_valid)
    low, high = (
        _pooled_range(x, wx, y, wy)
        if limits is None
        else (jnp.asarray(limit, x.dtype) for limit in limits)
    )
    edges = jnp.arange(bins + 1, dtype=low.dtype) * ((high - low) / bins) + low
    edges = edges.at[-1].set(high)

    def shares(values: Sample, weight: Sample) -> Float[Array, " bin"]:
        index = jnp.clip(jnp.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
        count = jnp.zeros(bins, dtype=int).at[index].add(weight > 0)
        return count / jnp.sum(weight)

    overlap = jnp.sum(jnp.minimum(shares(x, wx), shares(y, wy)))
    return jnp.where(_usable(x, wx, y, wy), overlap, jnp.nan)


def ks_distance(
    real: Sample,
    simulated: Sample,
    *,
    real_valid: Mask | None = None,
    simulated_valid: Mask | None = None,
) -> Scalar:
    """Two-sample Kolmogorov-Smirnov distance, the largest gap of the two distributions [-].

    Equal to the statistic of `scipy.stats.ks_2samp`.

    **Arguments:**

    - `real`, `simulated`: the two samples, pixels of any shape and in one unit.
    - `real_valid`, `simulated_valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` for no pixel, or a mask of another shape.

    It depends on ranks only, so its gradient is zero: see `smooth_ks_distance`.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import ks_distance
    >>> float(ks_distance(jnp.array([0.1, 0.2, 0.3, 0.4]), jnp.array([0.3, 0.4, 0.4, 0.5])))
    0.5
    """
    x, wx = _flat(real, real_valid)
    y, wy = _flat(simulated, simulated_valid)
    ordered, gap, _ = _distribution_gap(x, wx, y, wy)
    last_of_ties = jnp.append(ordered[1:] != ordered[:-1], True)
    distance = jnp.max(jnp.where(last_of_ties, jnp.abs(gap), 0.0))
    return jnp.where(_usable(x, wx, y, wy), distance, jnp.nan)


def wasserstein_distance(
    real: Sample,
    simulated: Sample,
    *,
    real_valid: Mask | None = None,
    simulated_valid: Mask | None = None,
) -> Scalar:
    """First Wasserstein (earth mover's) distance, in the values' unit.

    The integral of the gap between the two distributions, equal to
    `scipy.stats.wasserstein_distance`.

    **Arguments:**

    - `real`, `simulated`: the two samples, pixels of any shape and in one unit.
    - `real_valid`, `simulated_valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` for no pixel, or a mask of another shape.

    Differentiable in both samples almost everywhere as it stands.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import wasserstein_distance
    >>> distance = wasserstein_distance(jnp.array([0.1, 0.2, 0.3]), jnp.array([0.3, 0.4, 0.5]))
    >>> round(float(distance), 6)
    0.2
    """
    x, wx = _flat(real, real_valid)
    y, wy = _flat(simulated, simulated_valid)
    ordered, gap, counted = _distribution_gap(x, wx, y, wy)
    # Masked pixels come last, where the gap is exactly 0: any finite value will do for them.
    finite = jnp.where(counted, ordered, 0.0)
    distance = jnp.sum(jnp.abs(gap[:-1]) * (finite[1:] - finite[:-1]))
    return jnp.where(_usable(x, wx, y, wy), distance, jnp.nan)


def soft_histogram(
    values: Sample,
    limits: tuple[Any, Any],
    *,
    bins: int = 256,
    smoothing: float = 0.0,
    valid: Mask | None = None,
) -> Float[Array, " bin"]:
    """Share of pixels near each bin's centre [-], summing to one, continuous in the values.

    Every pixel is divided between the two bin centres it lies between, in proportion to nearness
    (linear binning), and each bin may then be spread by a Gaussian.

    **Arguments:**

    - `values`: pixels of any shape.
    - `limits`: lower and upper edge of the histogram, in the values' unit: pixels beyond them count
      in the edge bin, without gradient.
    - `bins`: number of bins, at least 2.
    - `smoothing`: standard deviation of the Gaussian [bins], at least 0 (none).
    - `valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` for a number out of range, for no pixel, or a mask of another shape.

    Continuous and piecewise linear in `values`, differentiable but where a pixel crosses a bin
    centre; with `smoothing` of 1 or more the jumps of the slope there are small. Memory is a few
    numbers for each pixel, never pixels times bins.
    """
    if bins < 2 or smoothing < 0.0:
        raise InputError(
            f"a histogram needs at least 2 bins and smoothing of at least 0, but has {bins} bins "
            f"and smoothing {smoothing:g}."
        )
    x, weight = _flat(values, valid)
    low, high = (jnp.asarray(limit, x.dtype) for limit in limits)
    width = (high - low) / bins
    flat_range = width <= 0.0
    place = (x - low) / jnp.where(flat_range, 1.0, width) - 0.5
    place = jnp.clip(place, 0.0, bins - 1.0)
    below = jnp.clip(jnp.floor(place).astype(int), 0, bins - 2)
    share = (place - below) * weight
    counts = jnp.zeros(bins, x.dtype).at[below].add(weight - share).at[below + 1].add(share)
    histogram = counts / jnp.sum(weight)
    if smoothing > 0.0:
        histogram = jnp.matmul(_spreading(bins, smoothing, x.dtype), histogram, precision="highest")
    return jnp.where(_sound(x), histogram, jnp.nan)


def smooth_histogram_intersection(
    real: Sample,
    simulated: Sample,
    *,
    bins: int = 256,
    smoothing: float = 2.0,
    limits: tuple[Any, Any] | None = None,
    real_valid: Mask | None = None,
    simulated_valid: Mask | None = None,
) -> Scalar:
    """Differentiable counterpart of `histogram_intersection` [-], in [0, 1] to 0.001.

    Soft histograms instead of hard ones, and a smallest value rounded off where the two are
    within 1e-3 of a bin's mean share. For distributions that are wide against a bin it lies within
    -0.005 and +0.01 of the exact one, plus the counting noise of the exact one's bins that the
    smoothing removes: at most sqrt(bins / (pi n)) for n pixels (0.09 for 10 000 and 0.02 for
    160 000; up to 0.046 and 0.012 measured on NDVI-like samples).

    **Arguments:**

    - `real`, `simulated`: the two samples, pixels of any shape and in one unit.
    - `bins`, `smoothing`: of the histograms, as in `soft_histogram`.
    - `limits`: range of the histograms, in the values' unit. If not given it is the pooled range of
      the valid pixels and is held constant in the derivative; an inversion should fix it.
    - `real_valid`, `simulated_valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` as `soft_histogram`.

    Differentiable in both samples, once, as `soft_histogram` is.
    """
    both = _soft_pair(real, simulated, bins, smoothing, limits, real_valid, simulated_valid)
    overlap = 1.0 - 0.5 * jnp.sum(_rounded_abs(both[0] - both[1], 1e-3 / bins))
    return overlap


def smooth_ks_distance(
    real: Sample,
    simulated: Sample,
    *,
    bins: int = 256,
    smoothing: float = 0.0,
    sharpness: float = 500.0,
    limits: tuple[Any, Any] | None = None,
    real_valid: Mask | None = None,
    simulated_valid: Mask | None = None,
) -> Scalar:
    """Differentiable counterpart of `ks_distance` [-].

    The gap of two soft distributions at the bin centres, its largest value replaced by a mean
    weighted with exp(sharpness * gap). Within 0.01 of the exact one for samples whose
    distributions are wide against a bin, and mostly below it.

    **Arguments:**

    - `real`, `simulated`: the two samples, pixels of any shape and in one unit.
    - `bins`, `smoothing`: of the histograms, as in `soft_histogram`.
    - `sharpness`: of the maximum, in units of one over the distance: the value is low by a few
      times its inverse at most.
    - `limits`: as in `smooth_histogram_intersection`.
    - `real_valid`, `simulated_valid`: true where a pixel counts; all unless given.

    **Raises:** `InputError` as `soft_histogram`.

    Differentiable in both samples, once, as `soft_histogram` is.
    """
    both = _soft_pair(real, simulated, bins, smoothing, limits, real_valid, simulated_valid)
    gap = _rounded_abs(jnp.cumsum(both[0] - both[1]), 1e-4)
    return jnp.sum(gap * jax.nn.softmax(sharpness * gap))


def _soft_pair(
    real: Sample,
    simulated: Sample,
    bins: int,
    smoothing: float,
    limits: tuple[Any, Any] | None,
    real_valid: Mask | None,
    simulated_valid: Mask | None,
) -> tuple[Float[Array, " bin"], Float[Array, " bin"]]:
    if limits is None:
        pooled = _pooled_range(*_flat(real, real_valid), *_flat(simulated, simulated_valid))
        limits = jax.lax.stop_gradient(pooled)
    return (
        soft_histogram(real, limits, bins=bins, smoothing=smoothing, valid=real_valid),
        soft_histogram(simulated, limits, bins=bins, smoothing=smoothing, valid=simulated_valid),
    )


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


def _usable(
    x: Float[Array, " a"], wx: Float[Array, " a"], y: Float[Array, " b"], wy: Float[Array, " b"]
) -> Bool[Array, ""]:
    return _sound(x) & _sound(y) & jnp.any(wx > 0) & jnp.any(wy > 0)


def _pooled_range(
    x: Float[Array, " a"], wx: Float[Array, " a"], y: Float[Array, " b"], wy: Float[Array, " b"]
) -> tuple[Scalar, Scalar]:
    low = jnp.minimum(
        jnp.min(jnp.where(wx > 0, x, jnp.inf)), jnp.min(jnp.where(wy > 0, y, jnp.inf))
    )
    high = jnp.maximum(
        jnp.max(jnp.where(wx > 0, x, -jnp.inf)), jnp.max(jnp.where(wy > 0, y, -jnp.inf))
    )
    return low, high


def _distribution_gap(
    x: Float[Array, " a"], wx: Float[Array, " a"], y: Float[Array, " b"], wy: Float[Array, " b"]
) -> tuple[Float[Array, " pooled"], Float[Array, " pooled"], Bool[Array, " pooled"]]:
    """Pooled values in order (masked ones last, as infinity), F_x - F_y just after each, and
    which of them are not masked. Counts are integers, so the gap is exact."""
    pooled = jnp.concatenate([x, y])
    counted = jnp.concatenate([wx, wy]) > 0
    order = jnp.argsort(jax.lax.stop_gradient(jnp.where(counted, pooled, jnp.inf)))
    from_x = (jnp.arange(pooled.size) < x.size)[order] & counted[order]
    from_y = counted[order] & ~from_x

    def distribution(member: Bool[Array, " pooled"]) -> Float[Array, " pooled"]:
        rank: Int[Array, " pooled"] = jnp.cumsum(member)
        return rank.astype(pooled.dtype) / rank[-1].astype(pooled.dtype)

    ordered = jnp.where(counted, pooled, jnp.inf)[order]
    return ordered, distribution(from_x) - distribution(from_y), counted[order]


def _rounded_abs(x: Float[Array, " n"], radius: float) -> Float[Array, " n"]:
    """|x| with its corner rounded over `radius`; between |x| - radius and |x|, 0 at 0."""
    return jnp.sqrt(x**2 + radius**2) - radius


def _spreading(bins: int, smoothing: float, dtype: Any) -> Float[Array, "bin bin"]:
    centre = jnp.arange(bins, dtype=dtype)
    kernel = jnp.exp(-0.5 * ((centre[:, None] - centre[None, :]) / smoothing) ** 2)
    return kernel / jnp.sum(kernel, axis=0)  # each bin keeps its share, also at the edges
