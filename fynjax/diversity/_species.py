"""Diversity from covers or counts of species: Hill numbers, evenness, alpha, beta and gamma."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist, squareform

from fynjax._core.errors import InputError

Cover = Float[Array, "*plot species"]
PerPlot = Float[Array, "*plot"]


def species_shares(cover: ArrayLike) -> Cover:
    """Share of each species in the cover of its plot [-], as every index here takes it."""
    amount = jnp.asarray(cover)
    amount = amount.astype(jnp.result_type(amount.dtype, jnp.float32))
    if amount.ndim == 0 or amount.shape[-1] == 0 or amount.size == 0:
        raise InputError(
            f"`cover` must have species on its last axis, but has shape {amount.shape}"
        )
    total = jnp.sum(amount, axis=-1, keepdims=True)
    if not isinstance(amount, jax.core.Tracer):
        values = np.asarray(amount)
        wrong = ~(np.isfinite(values) & (values >= 0.0))
        if wrong.any():
            place = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise InputError(
                "`cover` must be finite and not negative, but species "
                f"{place[-1] + 1}{_of_plot(place[:-1])} has {values[place]:g}"
            )
        if not (filled := np.asarray(total)[..., 0] > 0.0).all():
            place = tuple(int(i) for i in np.argwhere(~filled)[0])
            raise InputError(f"expected some cover, but every species{_of_plot(place)} has 0")
    return amount / total


def hill_number(cover: ArrayLike, order: float = 1.0) -> PerPlot:
    """Hill number: how many equally common species would be as diverse [species].

    D = (sum_i p_i^q)^(1 / (1 - q)) with the shares p and the order q; for q = 1 its limit,
    exp(-sum_i p_i ln p_i), and for infinity 1 / max p. Order 0 is richness, 1 the exponential of
    Shannon's entropy, 2 the inverse of Simpson's concentration.

    **Arguments:**

    - `cover`: [..., species] covers or counts, of any unit, not negative; shares are taken of them.
    - `order`: q, at least 0; infinity too. Orders as near to 1 as they may be lose no digits.

    **Returns:** [...] one number for each plot.

    **Raises:** `InputError` for a cover that is NaN, infinite or negative, for a plot without any,
    and for an order below 0 or NaN. Inside `jax.jit` and `jax.grad` values cannot be looked at:
    there a plot without cover has NaN.

    Differentiable in `cover`, but for the orders 0 (a step) and infinity (a corner where two
    species lead). At a cover of exactly 0 the slope of orders up to 1 is infinite; there the
    species counts as absent, and its slope is the finite one by which it makes the others rarer.

    Source: Hill (1973), Ecology 54, 427; Jost (2006), Oikos 113, 363.

    >>> from fynjax.diversity import hill_number
    >>> [round(float(hill_number([50.0, 25.0, 25.0], q)), 3) for q in (0, 1, 2)]
    [3.0, 2.828, 2.667]
    """
    if not order >= 0.0:
        raise InputError(f"`order` must be at least 0, but is {order:g}")
    share = species_shares(cover)
    if order == 0.0:
        return jnp.sum(share > 0.0, axis=-1).astype(share.dtype)
    if np.isinf(order):
        return 1.0 / jnp.max(share, axis=-1)
    return jnp.exp(_mean_rarity(share, share, order))


def _mean_rarity(share: Cover, weight: Cover, order: float) -> PerPlot:
    """ln(sum w p^(q - 1)) / (1 - q), for q = 1 -sum w ln p, over shares above zero."""
    there = share > 0.0
    log = jnp.log(jnp.where(there, share, 1.0))
    power = order - 1.0
    if power == 0.0:
        return -jnp.sum(weight * log, axis=-1)
    # Near q = 1 the sum is 1 and a little, of which expm1 keeps the digits; elsewhere logsumexp
    # keeps it within the range of numbers.
    if abs(power) < 0.5:
        return -jnp.log1p(jnp.sum(weight * jnp.expm1(power * log), axis=-1)) / power
    return -logsumexp(power * log, axis=-1, b=jnp.where(there, weight, 0.0)) / power


def richness(cover: ArrayLike) -> PerPlot:
    """Number of species with any cover [species]. Not differentiable.

    **Arguments:** `cover`, and errors, as for `hill_number`.
    """
    return hill_number(cover, 0.0)


def shannon(cover: ArrayLike) -> PerPlot:
    """Shannon's entropy -sum_i p_i ln p_i, in natural units [-].

    **Arguments:** `cover`, errors and slopes as for `hill_number` of order 1.

    Source: Shannon (1948), Bell System Technical Journal 27, 379.

    >>> from fynjax.diversity import shannon
    >>> round(float(shannon([10.0, 10.0])), 4)  # ln 2
    0.6931
    """
    share = species_shares(cover)
    return _mean_rarity(share, share, 1.0)


def simpson(cover: ArrayLike) -> PerPlot:
    """Simpson's diversity 1 - sum_i p_i^2, the chance that two draws differ [-].

    Tools differ: others call the sum, its inverse (`hill_number` of order 2) or the form for
    counts without replacement by this name. This is that of vegan, scikit-bio and biodivMapR.

    **Arguments:** `cover`, and errors, as for `hill_number`. Differentiable, at zero cover too.

    Source: Simpson (1949), Nature 163, 688.
    """
    return 1.0 - jnp.sum(species_shares(cover) ** 2, axis=-1)


def pielou_evenness(cover: ArrayLike) -> PerPlot:
    """Pielou's evenness: Shannon's entropy over ln(richness) [-], from 0 to 1.

    **Arguments:** `cover`: as for `hill_number`.

    **Raises:** `InputError` as `hill_number`, and for a plot of one species, for which evenness
    is not defined.

    Differentiable but where a species comes or goes, as richness steps there.

    Source: Pielou (1966), Journal of Theoretical Biology 13, 131.
    """
    return shannon(cover) / jnp.log(_several(cover))


def diversity_indices(cover: ArrayLike) -> dict[str, NDArray[np.float64]]:
    """Usual indices of the diversity of plots: richness [species], Shannon's entropy, Simpson's
    diversity, Pielou's evenness [-], and the sum of the covers, in their unit.

    **Arguments:** `cover`: [plot, species] covers, not negative; plots may be bare.

    **Returns:** by name, [plot] each; NaN where an index has no value: of a bare plot all but
    richness and cover, of one species evenness. Not differentiable.

    **Raises:** `InputError` for covers of another shape, NaN, infinite or negative.

    >>> from fynjax.diversity import diversity_indices
    >>> found = diversity_indices([[0.2, 0.2], [0.3, 0.0]])
    >>> found["richness"].tolist(), found["evenness"].tolist()
    ([2.0, 1.0], [1.0, nan])
    """
    amount = np.asarray(cover, np.float64)
    if amount.ndim != 2 or amount.size == 0:
        raise InputError(f"`cover` must be [plot, species], but has shape {amount.shape}")
    total = amount.sum(axis=1)
    there = ~(total == 0.0)  # true for NaN, which must show
    found: dict[str, NDArray[np.float64]] = {"richness": (amount > 0.0).sum(axis=1).astype(float)}
    several = there & (found["richness"] > 1.0)
    for name, index, has in (
        ("shannon", shannon, there),
        ("simpson", simpson, there),
        ("evenness", pielou_evenness, several),
    ):
        found[name] = np.full(len(amount), np.nan)
        if has.any():
            found[name][has] = np.asarray(index(amount[has]))
    return found | {"cover": total}


def hill_evenness(cover: ArrayLike, order: float = 1.0) -> PerPlot:
    """Hill number less one over richness less one [-], from 0 (one rules) to 1 (all alike).

    Unlike D / S, its least value does not depend on how many species there are.

    **Arguments:** `cover`, `order`: as for `hill_number`.

    **Raises:** `InputError` as `hill_number`, and for a plot of one species.

    Differentiable but where a species comes or goes.

    Source: Chao and Ricotta (2019), Ecology 100, e02852, class E3.
    """
    return (hill_number(cover, order) - 1.0) / (_several(cover) - 1.0)


def _several(cover: ArrayLike) -> PerPlot:
    count = richness(cover)
    if not isinstance(count, jax.core.Tracer) and (alone := np.asarray(count) < 2.0).any():
        place = tuple(int(i) for i in np.argwhere(alone)[0])
        raise InputError(f"evenness needs two species or more, but there is one{_of_plot(place)}")
    return count


def _of_plot(place: tuple[int, ...]) -> str:
    """Words for a place on the axes before the species, counted from 1."""
    return f" of plot {', '.join(str(i + 1) for i in place)}" if place else ""


class DiversityParts(eqx.Module):
    """Diversity within plots, between them and of all."""

    alpha: Float[Array, ""]
    """Mean diversity within plots."""
    beta: Float[Array, ""]
    """Gamma over alpha (how many distinct plots there are in effect), or gamma less alpha."""
    gamma: Float[Array, ""]
    """Diversity of all plots together."""


def hill_partition(cover: ArrayLike, order: float = 1.0) -> DiversityParts:
    """Hill numbers within plots, between them and of all: gamma = alpha * beta.

    Every plot counts alike, whatever its total cover. With N plots and their shares p_ij, alpha is
    (sum_j sum_i p_ij^q / N)^(1 / (1 - q)), for q = 1 the exponential of the mean Shannon entropy;
    gamma is the Hill number of the mean shares. Beta lies between 1 (all plots alike) and N (no
    species shared). Chao et al. (2012) define alpha otherwise, from the pooled table.

    **Arguments:**

    - `cover`: [..., plot, species]; all axes but the last are plots, so windows of a map serve.
    - `order`: q, at least 0 and finite.

    **Raises:** `InputError` as `hill_number`, for an infinite order, and for one plot only.

    Differentiable as `hill_number`, but for order 0.

    Source: Jost (2007), Ecology 88, 2427, equation 11 with equal weights.

    >>> from fynjax.diversity import hill_partition
    >>> parts = hill_partition([[10.0, 10.0, 0.0, 0.0], [0.0, 0.0, 5.0, 5.0]])
    >>> [round(float(part), 3) for part in (parts.alpha, parts.beta, parts.gamma)]
    [2.0, 2.0, 4.0]
    """
    share = _plots(cover)
    if not 0.0 <= order < np.inf:
        raise InputError(f"`order` must be at least 0 and finite, but is {order:g}")
    if order == 0.0:
        alpha = jnp.mean(richness(share))
    else:
        # All plots as one list, each species weighted by its share and 1 / N.
        alpha = jnp.exp(_mean_rarity(share.ravel(), share.ravel() / len(share), order))
    gamma = hill_number(jnp.mean(share, axis=0), order)
    return DiversityParts(alpha=alpha, beta=gamma / alpha, gamma=gamma)


def additive_partition(
    cover: ArrayLike, index: Callable[[Array], Array] = shannon
) -> DiversityParts:
    """Any index within plots, between them and of all: gamma = alpha + beta.

    Alpha is the mean of the plots' indices, gamma the index of their mean shares. Every plot
    counts alike.

    **Arguments:**

    - `cover`: as for `hill_partition`.
    - `index`: of covers [..., species], such as `shannon`, `simpson`, `richness` or
      `lambda cover: rao_entropy(cover, distance)`.

    **Raises:** `InputError` as `hill_number`, and for one plot only.

    Differentiable where `index` is.

    Source: Lande (1996), Oikos 76, 5.
    """
    share = _plots(cover)
    alpha, gamma = jnp.mean(index(share)), index(jnp.mean(share, axis=0))
    return DiversityParts(alpha=alpha, beta=gamma - alpha, gamma=gamma)


def _plots(cover: ArrayLike) -> Float[Array, "plot species"]:
    share = species_shares(cover)
    share = share.reshape(-1, share.shape[-1])
    if len(share) < 2:
        raise InputError(f"expected covers of two plots or more, but got shape {np.shape(cover)}")
    return share


def bray_curtis(cover: ArrayLike) -> NDArray[np.float64]:
    """Bray-Curtis dissimilarity of each two plots [-], sum |a - b| / sum (a + b).

    From covers as they are, not from shares: plots with more cover differ for that too.

    **Arguments:** `cover`: [plot, species] covers or counts, not negative.

    **Returns:** [plot, plot], from 0 (alike) to 1 (no species shared). Not differentiable.

    **Raises:** `InputError` as `hill_partition`.

    Source: Bray and Curtis (1957), Ecological Monographs 27, 325.
    """
    # The checks alone: covers are compared as they are, not as shares.
    _plots(cover)
    amount = np.asarray(cover, np.float64)
    return squareform(pdist(amount.reshape(-1, amount.shape[-1]), "braycurtis"))
