"""From counts of returns in layers to foliage height diversity and leaf area density.

One piece of code for NumPy (exact, on counts of returns) and JAX (smooth, on expected counts): `xp`
is the array module. Results are pairs of a value, finite everywhere, and how far it is defined:
true or false, or a weight between 0 and 1.
"""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fynjax.metrics.structure._settings import StructureSettings

Pair = tuple[Any, Any]


def foliage_height_diversity(
    amount: ArrayLike, *, normalised: bool = False, least_share: float = 0.0
) -> Any:
    """Foliage height diversity, -sum p ln p over layers [-] (MacArthur and MacArthur 1961).

    **Arguments:**

    - `amount`: [..., layer], returns or leaf area in each layer, of any unit, not negative. NaN
      counts as none.
    - `normalised`: divide by the logarithm of the number of layers.
    - `least_share`: leave out layers with less than this over the number of layers; the rest is
      not scaled up.

    **Returns:** the diversity in natural units, at least 0 and at most the logarithm of the number
    of layers; NaN where there is nothing. Not differentiable (NumPy).

    >>> from fynjax.metrics.structure import foliage_height_diversity
    >>> round(float(foliage_height_diversity([10, 10, 0, 0])), 4)  # two layers alike: ln 2
    0.6931
    """
    given = np.nan_to_num(np.asarray(amount, np.float64), nan=0.0)
    layers = np.full(given.shape[:-1], given.shape[-1])
    value, defined = _layer_entropy(np, given, layers, normalised, least_share)
    return np.where(defined, value, np.nan)[()]


def _layer_entropy(
    xp: ModuleType,
    amount: Any,
    layers: Any,
    normalised: bool,
    least_share: float,
    floor: float = 0.0,
) -> Pair:
    """Entropy of the shares of `amount` [..., layer] among `layers` [...] that count."""
    total = xp.sum(amount, axis=-1)
    share = ratio(xp, amount, total[..., None])
    if least_share > 0.0:
        enough = share >= ratio(xp, least_share + 0.0 * layers, layers)[..., None]
        share = xp.where(enough, share, 0.0)
    value = 0.0 - xp.sum(share * log(xp, share + floor), axis=-1)
    defined = total > 0.0
    if normalised:
        several = layers > 2.5
        value = value / log(xp, xp.where(several, layers, 3.0))
        defined = defined & several
    return value, defined


def profile_metrics(
    xp: ModuleType,
    counts: Any,
    under: Any,
    present: Any,
    passed: Any,
    settings: StructureSettings,
    floor: float = 0.0,
) -> tuple[dict[str, Pair], Any, Any]:
    """Metrics of layers, leaf area density and where it is defined.

    **Arguments:**

    - `counts`: [cell, layer] returns in the layers from `settings.base` up.
    - `under`: [cell] returns below them, those on the ground weighted.
    - `present`: [cell, layer] 1 for layers at or below the top, 0 above.
    - `passed`: [cell, layer] 1 where something got through the layer.
    - `floor`: added to shares before their logarithm is taken [-].

    MacArthur and Horn (1969): N_in returns are in a layer or below, N_out below, and the density
    is ln(N_in / N_out) / (k dz). A layer that no light passed is only known to be dense: it is
    left out, which makes the mean of dense canopies too small.
    """
    # Returns of a layer or below are of light that entered it from above.
    entered = under[:, None] + xp.cumsum(counts, axis=1)
    left = entered - counts
    fall = ratio(xp, entered, xp.where(left > 0.0, left, 1.0))
    thickness = settings.extinction * settings.layer
    density = xp.where((left > 0.0) & (fall > 0.0), log(xp, fall), 0.0) / thickness
    first = settings.first_layer(settings.lowest)
    # Smooth forms have weights between 0 and 1 here, exact ones 0 or 1.
    use = present[:, first:] * passed[:, first:]
    inside = density[:, first:]
    number = xp.sum(use, axis=1)
    mean = ratio(xp, xp.sum(use * inside, axis=1), number)
    squares = xp.sum(use * (inside - mean[:, None]) ** 2, axis=1)
    freedom = number - settings.degrees_lost
    metrics = {
        "leaf_area_density_mean": (mean, number > 0.0),
        "leaf_area_density_std": (root(xp, ratio(xp, squares, freedom)), freedom > 0.0),
    }
    amount, start = counts, settings.first_layer(settings.diversity_lowest)
    if settings.diversity_of == "leaf_area":
        amount, start = density * passed, max(start, first)
    metrics["foliage_height_diversity"] = _layer_entropy(
        xp,
        (amount * present)[:, start:],
        xp.sum(present[:, start:], axis=1),
        settings.diversity_normalised,
        settings.diversity_least_share,
        floor,
    )
    return metrics, density, present * passed


def leaf_area_gap(
    xp: ModuleType, density: Any, defined: Any, settings: StructureSettings, total: Any
) -> Pair:
    """Gap fraction from the leaf area index above the threshold, in layers that begin there."""
    above = (settings.gap_height - settings.base) / settings.layer
    start = max(int(np.ceil(above - 1e-6)), settings.first_layer(settings.lowest))
    index = settings.layer * xp.sum((density * defined)[:, start:], axis=1)
    return xp.exp(-settings.gap_extinction * index), total > 0.0


def ratio(xp: ModuleType, above: Any, below: Any) -> Any:
    """a / b, and 0 with slope 0 where b is not positive."""
    positive = below > 0.0
    return xp.where(positive, above / xp.where(positive, below, 1.0), 0.0)


def log(xp: ModuleType, value: Any) -> Any:
    """ln a, and 0 with slope 0 where a is not positive."""
    positive = value > 0.0
    return xp.where(positive, xp.log(xp.where(positive, value, 1.0)), 0.0)


def root(xp: ModuleType, value: Any) -> Any:
    """Square root, and 0 with slope 0 where a is not positive."""
    positive = value > 0.0
    return xp.where(positive, xp.sqrt(xp.where(positive, value, 1.0)), 0.0)
