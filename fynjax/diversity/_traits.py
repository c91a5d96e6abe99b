"""Diversity from distances between species: of traits, growth forms and descent."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike, NDArray

from fynjax._core.errors import InputError, did_you_mean, listed
from fynjax._core.extras import require
from fynjax.diversity._species import PerPlot, species_shares


def gower_distance(traits: pd.DataFrame | ArrayLike) -> NDArray[np.float64]:
    """Gower's distance of each two species from traits of any kind [-], 0 to 1.

    The mean over traits of |x_i - x_j| / range for numbers, and of 0 (the same) or 1 for all else,
    such as growth forms. Traits that either species lacks are left out of their pair. Ranks are
    taken as the numbers they are.

    **Arguments:** `traits`: a row for each species, a column for each trait. Columns of numbers
    are numbers, others are categories; NaN or None is not known.

    **Returns:** [species, species]. Not differentiable.

    **Raises:** `InputError` for no trait, infinite numbers, one species, a trait of numbers that is
    the same for all, and two species that have no known trait in common.

    Source: Gower (1971), Biometrics 27, 857.

    >>> import pandas as pd
    >>> from fynjax.diversity import gower_distance
    >>> table = pd.DataFrame({"height": [0.5, 1.0, 1.5], "form": ["shrub", "shrub", "tussock"]})
    >>> [float(d) for d in gower_distance(table)[0]]
    [0.0, 0.25, 1.0]
    """
    table = traits if isinstance(traits, pd.DataFrame) else pd.DataFrame(np.asarray(traits))
    if len(table) < 2 or table.shape[1] == 0:
        raise InputError(f"expected traits of two species or more, but got shape {table.shape}")
    apart = np.zeros((len(table), len(table)))
    known = np.zeros_like(apart)
    for name, column in table.items():
        both = column.notna().to_numpy()
        both = both[:, None] & both
        if pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column):
            value = column.to_numpy(np.float64, na_value=np.nan)
            if np.isinf(value).any():
                raise InputError(f"trait {name!r} must be finite, but has an infinite value")
            if not (span := float(np.nanmax(value) - np.nanmin(value))) > 0.0:
                raise InputError(f"trait {name!r} is the same for all species: leave it out")
            step = np.abs(value[:, None] - value) / span
        else:
            value = column.to_numpy(object)
            step = (value[:, None] != value).astype(float)
        # A trait that either species lacks is left out of the mean of their pair.
        apart += np.where(both, step, 0.0)
        known += both
    if (known == 0.0).any():
        first, second = np.argwhere(known == 0.0)[0]
        raise InputError(
            f"species {table.index[first]!r} and {table.index[second]!r} have no known trait in "
            "common"
        )
    return apart / known


def rao_entropy(cover: ArrayLike, distance: ArrayLike) -> PerPlot:
    """Rao's quadratic entropy: mean distance of two draws, sum_ij p_i p_j d_ij.

    Over all ordered pairs, in the unit of the distance; with 1 between all species it is
    `simpson`. Tools differ: ade4 and FD take half of the squared distance in place of d.

    **Arguments:**

    - `cover`: [..., species], as for `hill_number`.
    - `distance`: [species, species] of any unit, symmetric, 0 on the diagonal: `gower_distance`,
      or `Phylogeny.distance`.

    **Returns:** [...] for each plot.

    **Raises:** `InputError` as `hill_number`, and for a distance of another shape, or that is
    negative, not finite, not symmetric or not 0 on its diagonal.

    Differentiable in both, at zero cover too.

    Source: Rao (1982), Theoretical Population Biology 21, 24; Botta-Dukát (2005), Journal of
    Vegetation Science 16, 533.

    >>> from fynjax.diversity import rao_entropy
    >>> round(float(rao_entropy([10.0, 10.0], [[0.0, 0.4], [0.4, 0.0]])), 4)
    0.2
    """
    share = species_shares(cover)
    return jnp.sum(share * (share @ _checked_distance(distance, share)), axis=-1)


def functional_dispersion(cover: ArrayLike, distance: ArrayLike) -> PerPlot:
    """Functional dispersion: mean distance of species to their centroid, weighted by cover.

    With z_j the distance of species j to the plot's centroid in the space of principal coordinates,
    FDis = sum_j p_j z_j. The coordinates themselves are not needed (Gower 1966): z_j^2 =
    sum_i p_i d_ij^2 - sum_ik p_i p_k d_ik^2 / 2. Of a distance that fits into no Euclidean space
    this is the squared distance on real axes less that on imaginary ones; the root is taken of its
    absolute value, as FD::fdisp of R does without a correction. 0 for one species.

    **Arguments:** `cover`, `distance`, and errors, as for `rao_entropy`.

    **Returns:** [...] for each plot, in the unit of the distance.

    Differentiable in both but where a species lies on the centroid, as the only one of its plot
    does: there its own distance has the slope 0.

    Source: Laliberté and Legendre (2010), Ecology 91, 299.
    """
    share = species_shares(cover)
    squared = _checked_distance(distance, share) ** 2
    # Squared distance to the centroid by that to all species (Gower 1966), without coordinates.
    to_others = share @ squared
    spread = jnp.sum(share * to_others, axis=-1, keepdims=True)
    square = to_others - 0.5 * spread
    # What is left of the subtraction for a species on the centroid is rounding.
    apart = jnp.abs(square) > 8.0 * jnp.finfo(square.dtype).eps * to_others
    root = jnp.sqrt(jnp.where(apart, jnp.abs(square), 1.0))
    return jnp.sum(share * jnp.where(apart, root, 0.0), axis=-1)


def _checked_distance(distance: ArrayLike, share: Array) -> Float[Array, "species species"]:
    apart = jnp.asarray(distance).astype(share.dtype)
    count = share.shape[-1]
    if apart.shape != (count, count):
        raise InputError(
            f"`distance` must be of the {count} species with covers, but has shape {apart.shape}"
        )
    if not isinstance(apart, jax.core.Tracer):
        values = np.asarray(apart)
        if not (np.isfinite(values).all() and (values >= 0.0).all()):
            raise InputError("`distance` must be finite and not negative")
        if np.diag(values).any() or not np.allclose(values, values.T):
            raise InputError("`distance` must be symmetric, with 0 on its diagonal")
    return apart


@dataclass(frozen=True)
class Phylogeny:
    """Branches of a tree of descent, and which taxa are on each."""

    taxa: tuple[str, ...]
    """Names, in the order of the covers."""
    length: Float[np.ndarray, " branch"]
    """Length of each branch, in the tree's unit."""
    carries: Bool[np.ndarray, "branch taxon"]
    """Whether a taxon descends from a branch."""

    @property
    def distance(self) -> Float[np.ndarray, "taxon taxon"]:
        """Length of the path between each two taxa, in the tree's unit."""
        on = self.carries.astype(np.float64)
        # The path between two taxa is what leads to each, less twice what leads to both.
        shared = on.T @ (self.length[:, None] * on)
        own = np.diag(shared)
        return own[:, None] + own - 2.0 * shared


def read_phylogeny(tree: Path | str, taxa: Sequence[str]) -> Phylogeny:
    """Read the branches of a tree that lead to the given taxa.

    **Arguments:**

    - `tree`: a Newick file with branch lengths.
    - `taxa`: names, in the order of the covers. Underscores and blanks are the same; the tree may
      hold further taxa.

    **Returns:** a `Phylogeny`.

    **Raises:** `InputError` for a file that is missing or no Newick tree, a taxon that the tree
    lacks or that is there twice, and a branch whose length is missing, negative or no number;
    `MissingExtraError` without scikit-bio (extra `analysis`).
    """
    skbio = require("skbio", "analysis", "scikit-bio")
    path = Path(tree)
    if not path.is_file():
        raise InputError("expected a Newick file, but there is none", file=path)
    try:
        root = skbio.TreeNode.read(str(path), format="newick")
    except Exception as error:  # scikit-bio has no common class for what it cannot read
        raise InputError(f"expected a tree in Newick form: {error}", file=path) from error
    wanted = [" ".join(name.replace("_", " ").split()) for name in taxa]
    tips = [" ".join((tip.name or "").replace("_", " ").split()) for tip in root.tips()]
    for name in wanted:
        if (found := tips.count(name)) != 1 or wanted.count(name) != 1:
            fault = "is there twice"
            if not found:
                fault = f"is not in the tree.{did_you_mean(name, tips)} It has {listed(tips)}."
            raise InputError(f"the taxon {name!r} {fault}", file=path)
    column = {name: k for k, name in enumerate(wanted)}
    length, carries = [], []
    below: dict[int, NDArray[np.bool_]] = {}
    # From the tips up: a branch carries what those below it carry.
    for node in root.postorder(include_self=False):
        on = np.zeros(len(wanted), bool)
        if node.is_tip():
            place = column.get(" ".join((node.name or "").replace("_", " ").split()))
            on[[] if place is None else [place]] = True
        for child in node.children:
            on |= below[id(child)]
        below[id(node)] = on
        if not on.any():
            continue
        if node.length is None or not 0.0 <= node.length < np.inf:
            where = f"above {wanted[int(np.argmax(on))]!r}"
            raise InputError(
                f"expected a length of at least 0 for every branch, but one {where} has "
                f"{'none' if node.length is None else f'{node.length:g}'}",
                file=path,
            )
        length.append(float(node.length))
        carries.append(on)
    return Phylogeny(tuple(taxa), np.array(length), np.array(carries))


def faith_diversity(cover: ArrayLike, phylogeny: Phylogeny) -> NDArray[np.float64]:
    """Faith's phylogenetic diversity: length of all branches from the root to what is there.

    The root is that of the whole tree, so one species has the length from it to the root
    (picante with `include.root`, scikit-bio).

    **Arguments:**

    - `cover`: [..., taxon] of the tree's taxa; only whether it is above 0 counts.
    - `phylogeny`: from `read_phylogeny`.

    **Returns:** [...] for each plot, in the tree's unit. Not differentiable: presence steps.

    **Raises:** `InputError` as `hill_number`, and for covers of another number of taxa.

    Source: Faith (1992), Biological Conservation 61, 1.
    """
    there = np.asarray(_of_taxa(cover, phylogeny)) > 0.0
    used = (there[..., None, :] & phylogeny.carries).any(axis=-1)
    return np.asarray(used @ phylogeny.length)


def mean_pairwise_distance(cover: ArrayLike, phylogeny: Phylogeny) -> NDArray[np.float64]:
    """Mean path between two different taxa that are there, whatever their cover.

    Weighted by cover it is `rao_entropy(cover, phylogeny.distance)`, which counts pairs of the
    same taxon too and is differentiable.

    **Arguments:** `cover`, `phylogeny`: as for `faith_diversity`.

    **Returns:** [...] for each plot, in the tree's unit. Not differentiable.

    **Raises:** `InputError` as `faith_diversity`, and for a plot of one taxon.

    Source: Webb (2000), American Naturalist 156, 145.
    """
    there = (np.asarray(_of_taxa(cover, phylogeny)) > 0.0).astype(np.float64)
    count = there.sum(axis=-1)
    if (count < 2.0).any():
        raise InputError("a mean distance needs two taxa or more in every plot")
    total = np.sum(there * (there @ phylogeny.distance), axis=-1)
    return np.asarray(total / (count * (count - 1.0)))


def _of_taxa(cover: ArrayLike, phylogeny: Phylogeny) -> Array:
    share = species_shares(cover)
    if share.shape[-1] != len(phylogeny.taxa):
        raise InputError(
            f"expected covers of the {len(phylogeny.taxa)} taxa of the tree, but got "
            f"{share.shape[-1]}"
        )
    return share
