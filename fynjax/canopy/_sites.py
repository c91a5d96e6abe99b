"""Where plants stand: blue noise, shared out among the species, and their soft weights."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real
from scipy.spatial import cKDTree

from fynjax._core.errors import InputError
from fynjax._core.seeds import generator
from fynjax.canopy._bridson import fill_disks


def poisson_disk(
    extent: tuple[float, float],
    radius: float,
    *,
    attempts: int = 30,
    seed: int,
    periodic: bool = False,
    start: Float[np.ndarray, "given 2"] | None = None,
) -> Float[np.ndarray, "n 2"]:
    """Blue-noise points on a rectangle: no two closer than a given distance [m].

    Bridson's (2007) dart throwing on a grid of cells r / sqrt(2): around an active point candidates
    are drawn uniformly by area from the annulus r to 2 r until one fits, which becomes active too,
    and a point retires when `attempts` of its candidates in a row have not. Here all active points
    draw in turn, so that they are computed together. With 30 attempts n r^2 / area is 0.615, within
    0.5 % that of the printed steps, which choose one of the active points at random. Positions have
    the same digits on every machine.

    The points come in the order in which they were drawn, neighbours near neighbours: shuffle
    before taking a part (`assign_sites` does).

    **Arguments:**

    - `extent`: (lx, ly) [m], positive.
    - `radius`: least distance r [m], positive; at most half of the shorter side if periodic.
    - `attempts`: k of Bridson, at least 1.
    - `seed`: the same seed gives the same points.
    - `periodic`: measure distances on the torus, for a plot that repeats itself.
    - `start`: points that are there already, at least r apart: the others come between them.

    **Returns:** `start` and the points drawn after it, on [0, lx) x [0, ly) [m]. Not
    differentiable.

    **Raises:** `InputError` for a value outside these ranges, for points of `start` that are nearer
    or outside, and where more than 2e8 points would be needed (a radius in other units than the
    extent).

    >>> from fynjax.canopy import poisson_disk
    >>> points = poisson_disk((10.0, 10.0), 0.5, seed=1, periodic=True)
    >>> points.shape
    (243, 2)
    """
    lx, ly = (float(side) for side in extent)
    if not (np.isfinite([lx, ly, radius]).all() and min(lx, ly, radius) > 0.0):
        raise InputError(
            f"`extent` and `radius` must be positive [m], but are {(lx, ly)} and {radius}"
        )
    if attempts < 1:
        raise InputError(f"`attempts` must be at least 1, but is {attempts}")
    if periodic and 2.0 * radius > min(lx, ly):
        raise InputError(
            f"`radius` must be at most half of the shorter side of a periodic extent, but "
            f"{radius} m is over half of {min(lx, ly)} m: a point would meet its own image"
        )
    if lx * ly / radius**2 > 3e8:
        raise InputError(
            f"a radius of {radius} m on {lx} m x {ly} m needs about "
            f"{SITES * lx * ly / radius**2:.0f} points: are both in metres?"
        )
    return fill_disks(generator(seed), lx, ly, float(radius), int(attempts), bool(periodic), start)


def clark_evans(
    points: Float[np.ndarray, "n 2"], extent: tuple[float, float], *, periodic: bool
) -> float:
    """How evenly points stand: index of Clark and Evans (1954) [-].

    The mean distance of a point to the nearest other one, over that of as many points at random:
    1 at random, below it in groups, above it where they keep apart; 2.15 at most, in a triangular
    lattice. Points that Bridson's steps make have 1.70.

    **Arguments:**

    - `points`: places [m].
    - `extent`: (lx, ly) [m], on which they lie.
    - `periodic`: whether the extent repeats itself; otherwise points near the border have no
      neighbour beyond it, for which the mean at random is corrected (Donnelly 1978).

    **Returns:** the index; NaN of fewer than two points. Not differentiable.

    >>> from fynjax.canopy import clark_evans, poisson_disk
    >>> points = poisson_disk((10.0, 10.0), 0.2, seed=1, periodic=True)
    >>> round(clark_evans(points, (10.0, 10.0), periodic=True), 1)
    1.7
    """
    number, (lx, ly) = len(points), extent
    if number < 2:
        return float("nan")
    points = np.asarray(points, float)
    if periodic:  # a point beyond the border is one within
        points = np.minimum(points % extent, np.nextafter(extent, 0.0))
    near = cKDTree(points, boxsize=extent if periodic else None).query(points, k=2)[0][:, 1]
    random = 0.5 * np.sqrt(lx * ly / number)
    if not periodic:
        random += (0.0514 + 0.041 / np.sqrt(number)) * 2.0 * (lx + ly) / number
    return float(near.mean() / random)


SITES = 0.615
"""Points of `poisson_disk` over the area, times the square of their least distance [-]."""
_EVENNESS = (
    (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0),
    (SITES * np.pi / 4.0, 0.695, 0.748, 0.812, 0.838, 0.869, 0.883, 0.898, 0.906, 0.918),
)
"""Radius of a disc over the least distance, and `site_evenness` counted there."""


def site_evenness(radius: Any) -> Any:
    """Share by which the number of sites in a disc scatters less than at random [-].

    One less its variance over its mean. In discs smaller than half the least distance there is one
    site or none, so that it is their mean number; in larger ones it was counted.

    **Arguments:** `radius`, of the disc over the least distance of `poisson_disk` [-].

    Differentiable.
    """
    at, evenness = map(np.array, _EVENNESS)
    # Straight between these, as the sum of what each piece brings: `interp` searches in loops.
    passed = jnp.clip((jnp.asarray(radius)[..., None] - at[:-1]) / np.diff(at), 0.0, 1.0)
    larger = evenness[0] + jnp.sum(passed * np.diff(evenness), axis=-1)
    return jnp.where(radius < 0.5, SITES * jnp.pi * radius**2, larger)


def clumping(
    probability: Real[np.ndarray, "y x"] | None,
    extent: tuple[float, float],
    diameter: float,
    *,
    periodic: bool,
) -> Float[np.ndarray, " part"]:
    """Relative density of plants within reach of a crown over equal parts of the ground [-].

    **Arguments:**

    - `probability`: map of 0-255 as of `assign_sites`; None: alike everywhere.
    - `extent`: (lx, ly) [m] that it covers.
    - `diameter`: of a crown [m], over whose disc the map is averaged.
    - `periodic`: whether the map repeats itself; else no plant stands beyond it.

    **Returns:** `PARTS` values from the sparsest to the densest, with a mean of 1: what
    `projected_count` counts by.

    **Raises:** `InputError` for a map that is nowhere above 0.
    """
    radius = diameter / 2.0
    if probability is None:
        probability = np.ones([min(512, int(np.ceil(16.0 * l / diameter))) for l in extent[::-1]])
    values = np.asarray(probability, float)
    if not values.max() > 0.0:
        raise InputError(
            "a probability map must be above 0 somewhere, or no plant can stand, but its largest "
            f"value is {values.max():g}"
        )
    ny, nx = values.shape
    across = []  # places of the pixels, forward and back from the first [m]
    for side, n in ((extent[0], nx), (extent[1], ny)):
        beyond = 0 if periodic else int(np.ceil(radius * n / side))
        across.append(np.fft.fftfreq(n + beyond, n / side / (n + beyond)))
    # Mean of the map over a crown about each pixel, by Fourier transforms; beyond an open border
    # there are as many zeros as a crown reaches, lest it reach round to the other side.
    disc = np.hypot(*np.meshgrid(*across)) <= radius
    both = np.fft.fft2(values, disc.shape) * np.fft.fft2(disc / disc.sum())
    near = np.fft.ifft2(both).real[:ny, :nx]
    near = np.sort(np.where(near > 1e-9 * values.max(), near, 0.0), axis=None)
    # Means of equal parts: what the sum grows by along each.
    edges = np.linspace(0.0, near.size, PARTS + 1)
    grown = np.interp(edges, np.arange(near.size + 1), np.append(0.0, near.cumsum()))
    return np.diff(grown) * PARTS / grown[-1]


PARTS = 32
"""Parts of the ground by which `clumping` describes a map."""


def assign_sites(
    points: Float[np.ndarray, "n 2"],
    needed: Sequence[int] | np.ndarray,
    *,
    probability: Real[np.ndarray, "y x"] | None = None,
    extent: tuple[float, float] | None = None,
    names: Sequence[str] | None = None,
    groups: Sequence[float] | None = None,
    spare: bool = False,
    periodic: bool = False,
    seed: int,
) -> list[Float[np.ndarray, "site 2"]]:
    """Share one set of points out among the species: an ordered, disjoint list of sites for each.

    The species choose in sequence. Each goes through the points still free in a random order of its
    own and accepts a point if a uniform number in [0, 255) is below the probability map's value
    there; it repeats this, with new numbers, until it has what it needs. So the map sets the
    pattern and `needed` the abundance, independently. A value of 0 never accepts.

    A species' list begins the same however long it is, and asking more for one species moves
    another's sites only where both wanted the same point. Where a cover is to be calibrated ask
    for as many sites as its upper bound could need: then nothing moves at all.

    **Arguments:**

    - `points`: places [m], for instance from `poisson_disk`.
    - `needed`: number of sites for each species.
    - `probability`: None (the same everywhere), or an array [y, x] of 0-255 with row 0 at the
      southern edge.
    - `extent`: (lx, ly) [m] that the array covers; required with one.
    - `names`: of the species, for errors.
    - `groups`: radius of the groups in which the plants of each species stand [m], 0 without any;
      see `grouped`. It is given with `extent`.
    - `spare`: whether these are sites beside those of a call before, with the same seed: groups are
      then filled from the other end, so that more plants are more groups.
    - `periodic`: whether groups reach over the borders, for a plot that repeats itself.
    - `seed`: the same seed gives the same sites.

    **Returns:** for each species its sites, [site, 2] [m]. Not differentiable.

    **Raises:** `InputError` where a species cannot reach its number, and for a bad map.

    >>> from fynjax.canopy import assign_sites, poisson_disk
    >>> points = poisson_disk((10.0, 10.0), 0.5, seed=1)
    >>> [len(sites) for sites in assign_sites(points, [20, 50], seed=1)]
    [20, 50]
    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"`points` must have shape [n, 2], but has {points.shape}")
    wanted = [int(number) for number in needed]
    if any(number < 0 for number in wanted):
        raise InputError(f"`needed` must not be negative, but is {wanted}")
    chance = _acceptance(points, probability, extent)
    free = np.ones(len(points), bool)
    sites: list[np.ndarray] = []
    for species, number in enumerate(wanted):
        if number == 0:
            sites.append(np.empty((0, 2)))
            continue
        # Numbers of its own: the order of one species does not depend on what others need.
        rng = generator(seed, species)
        order, accepted = rng.permutation(len(points)), chance
        if groups is not None and groups[species] > 0.0:
            assert extent is not None
            group = _groups(points, extent, groups[species], periodic, seed, species)
            order = order[np.argsort(-group[order] if spare else group[order], kind="stable")]
            accepted = GROUP_SHARE * chance
        passes = _rounds_until_accepted(accepted[order], rng)
        usable = free[order] & np.isfinite(passes)
        order, passes = order[usable], passes[usable]
        if len(order) < number:
            label = f"species {species} (counted from 0)" if names is None else repr(names[species])
            raise InputError(
                f"{label} wanted {number} sites but got {len(order)}: "
                f"of {len(points)} points {np.count_nonzero(chance)} have a probability above "
                f"zero and {np.count_nonzero(free)} were still free. Use a smaller radius, a "
                "lower cover, or a probability map with a wider area above zero"
            )
        # In the order of rounds, and within a round of the random order (the sort is stable).
        taken = order[np.argsort(passes, kind="stable")[:number]]
        free[taken] = False
        sites.append(points[taken])
    return sites


GROUP_SHARE = 0.75
"""Share of the sites in a group that the plants of its species take [-]. An assumption."""
_OVERLAP = 8.0
"""Groups that a place is in, of which the first counts: 0.03 % of the places are in none."""


def _centres(
    extent: tuple[float, float], radius: float, rng: np.random.Generator
) -> Float[np.ndarray, "group 2"]:
    """Centres of groups in the order in which a species fills them, all over an extent [m]."""
    number = int(np.ceil(_OVERLAP * extent[0] * extent[1] / (np.pi * radius**2)))
    return rng.random((number, 2)) * extent


def _groups(
    points: Float[np.ndarray, "n 2"],
    extent: tuple[float, float],
    radius: float,
    periodic: bool,
    seed: int,
    species: int,
) -> Int[np.ndarray, " n"]:
    """Number of the first group of a species that each point is in, that of all for none."""
    centres = _centres(extent, radius, generator(seed, 113, species))
    tree = cKDTree(centres, boxsize=extent if periodic else None)
    most = min(len(centres), 32)
    _, near = tree.query(points, k=np.arange(1, most + 1), distance_upper_bound=radius)
    return near.min(axis=1, initial=len(centres))


def grouped(
    probability: Real[np.ndarray, "y x"] | None,
    extent: tuple[float, float],
    radius: float,
    share: float,
) -> Float[np.ndarray, "y x"]:
    """Map of where plants of a species that stand in groups are likely to be, 0 to 255.

    Groups are discs about centres at random (Matérn 1960), filled one after the other: in each the
    species takes three of four sites (`GROUP_SHARE`) that are free. So many are needed as hold its
    plants; how densely they stand there does not depend on their number. A species that has three
    of four plants of a plot, or more, can stand in none.

    **Arguments:**

    - `probability`: map that they stand by besides, as of `assign_sites`; None: alike everywhere.
    - `extent`: (lx, ly) [m] that it covers.
    - `radius`: of a group [m], above 0.
    - `share`: plants of the species over all sites, 0 to 1 [-].

    **Returns:** a map of an extent like it, with groups of their own.
    """
    count = [min(512, max(8, int(np.ceil(8.0 * side / radius)))) for side in extent]
    x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip(count, extent, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    group = _groups(points, extent, radius, True, 0, 0)
    inside = np.argsort(group, kind="stable")[: int(np.ceil(share / GROUP_SHARE * group.size))]
    held = np.zeros(group.size)
    held[inside] = 255.0
    chance = _acceptance(points, probability, extent)
    return (held * chance).reshape(count[::-1])


def _rounds_until_accepted(chance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """In which round each point is accepted: geometric in its chance; inf where that is 0.

    Drawing the round at once is the same in law as going round again and again, and lets a list
    of any length begin the same.
    """
    uniform = 1.0 - rng.random(len(chance))  # (0, 1]
    with np.errstate(divide="ignore"):
        rounds = np.ceil(np.log(uniform) / np.log1p(-np.minimum(chance, 1.0)))
    return np.where(chance > 0.0, np.where(chance >= 1.0, 1.0, np.maximum(rounds, 1.0)), np.inf)


def _acceptance(
    points: np.ndarray, raster: Real[np.ndarray, "y x"] | None, extent: tuple[float, float] | None
) -> np.ndarray:
    """Chance [0, 1] that a point is accepted in one round."""
    if raster is None:
        return np.ones(len(points))
    if raster.ndim != 2:
        raise InputError(f"a probability map must have axes [y, x], but has {raster.shape}")
    if extent is None:
        raise InputError("`extent` (lx, ly) in metres must be given with a probability raster")
    rows, columns = raster.shape
    column = np.floor(points[:, 0] / extent[0] * columns).astype(int)
    row = np.floor(points[:, 1] / extent[1] * rows).astype(int)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    if not inside.all():
        raise InputError(
            f"the probability map covers {extent[0]} m x {extent[1]} m, but "
            f"{np.count_nonzero(~inside)} of {len(points)} points lie outside"
        )
    value = raster[row, column]
    value = value.astype(float)
    if not np.all((value >= 0.0) & (value <= 255.0)):
        raise InputError(
            "a probability map must lie in 0-255 without NaN, but ranges from "
            f"{np.min(value)} to {np.max(value)}"
        )
    if value.size and value.max() <= 1.0 and np.any((value > 0.0) & (value < 1.0)):
        raise InputError(
            "a probability map must lie in 0-255, but its largest value is "
            f"{value.max():.3g}: fractions were probably given; multiply by 255"
        )
    return value / 255.0


def site_weight(
    count: Any, index: Any, *, width: Any = 1.0, softness: Any = 0.0
) -> Float[Array, "*site"]:
    """Weight in [0, 1] of a site in a species' ordered list, for a real number of plants.

    Weights fall from 1 to 0 along a ramp of S plants about the `count` N, and a site weighs the
    mean of the ramp over its unit of the list. So the weights sum to N with slope 1, whatever N and
    S are: their derivative by N is one plant, spread over the plants of the ramp. S is softness N
    + (width - 1), rounded off where there are too few plants, for it must not exceed 2 N: the ramp
    would begin before the first site. Without a ramp (`width` 1, `softness` 0) whole plants weigh
    1 and the last one the fraction. `width` 0 with `softness` 0 is the hard scene: ceil(count)
    whole plants, whose slope is 0.

    **Arguments:**

    - `count`: number of plants N [-], at least 0.
    - `index`: place of the site in the list, from 0; broadcasts with `count`.
    - `width`: of the ramp where there are few plants [plants], at least 0; up to 1 there is none.
    - `softness`: how the ramp widens with the number of plants [-], from 0 to 2.

    Differentiable in `count`, `width` and `softness`, with continuous slopes where there is a ramp;
    without one the slope at a kink is the one to the right.

    >>> import jax.numpy as jnp
    >>> from fynjax.canopy import site_weight
    >>> site_weight(2.3, jnp.arange(4)).round(3)
    Array([1. , 1. , 0.3, 0. ], dtype=float32)
    >>> site_weight(2.3, jnp.arange(4), softness=1.0).round(3)
    Array([1.   , 0.843, 0.413, 0.044], dtype=float32)
    """
    return _site_weight(count, index, width, softness)


@partial(jax.jit, inline=True)
def _site_weight(count: Any, index: Any, width: Any, softness: Any) -> Float[Array, "*n"]:
    count = jnp.asarray(count)
    dtype = count.dtype if jnp.issubdtype(count.dtype, jnp.floating) else jnp.result_type(float)
    count = count.astype(dtype)
    index, width, softness = (jnp.asarray(value, dtype) for value in (index, width, softness))
    # A ramp of share N + extra plants, of at most 2 N.
    share = jnp.minimum(softness, 2.0)
    extra, most = jnp.maximum(width - 1.0, 0.0), (2.0 - share) * count
    # The smaller of both, rounded off: half their harmonic mean.
    together = extra + most
    few = jnp.where(together > 0.0, extra * most / jnp.where(together > 0.0, together, 1.0), 0.0)
    ramp = share * count + few
    hard = (width <= 0.0) & (softness <= 0.0)
    soft = _mean_of_ramp(index, 1.0, count, ramp)
    return jnp.where(hard, (count > index).astype(dtype), soft)


def _mean_of_ramp(start: Any, length: Any, middle: Any, width: Any) -> Array:
    """Mean over a stretch of `length` from `start` on of a line that falls from 1 to 0 over `width`
    about `middle`; the slopes at kinks are those of a rising `middle`."""
    begin, end = middle - 0.5 * width - start, middle + 0.5 * width - start
    some = jnp.where(length > 0.0, length, 1.0)
    full = _clipped(begin / some)
    wide = width > 0.0
    scale = jnp.where(wide, width, 1.0)
    # The line's height at both ends of the stretch; its area between is a trapezium.
    high = jnp.where(wide, _clipped(end / scale), begin >= 0.0)
    low = jnp.where(wide, _clipped((end - length) / scale), begin >= length)
    return full + 0.5 * (width / some) * (high - low) * (high + low)


def _clipped(value: Array) -> Array:
    """To [0, 1]. Not `clip`, whose slope at a kink is the mean of both sides."""
    return jnp.where(value < 0.0, 0.0, jnp.where(value >= 1.0, 1.0, value))
