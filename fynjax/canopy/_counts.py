"""How many plants of a species stand on a plot: equations (1)-(10) of the paper.

Axes. The paper takes a plant model's three extents from the bounding box of its mesh: `width`
(x), `height` (y) and `depth` (z). Eq. (7) averages width and height to a crown diameter and
eq. (5) lets the depth lean sideways by the rotation spread. Both make sense only if x and y are
horizontal and z is vertical, so that is the reading here: "height" in eq. (7) is the northward
extent y, and "depth" in eq. (5) is how tall the plant stands. For a mesh stored with y upwards
the two equations contradict each other; turn such a mesh (`up="y"` in
`plant_model_from_mesh`) before its extents are taken.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax.canopy._sites import SITES, site_evenness

_SINGLE_SLACK = 5e-7
"""A number that is whole but for this share of it is not lifted to the next plant [-]."""


def modelled_diameter(width: Any, height: Any) -> Any:
    """Crown diameter D of a plant model, eq. (7) of the fynbos scene paper [m].

    **Arguments:**

    - `width`, `height`: its two horizontal extents (x and y of the bounding box) [m], arrays or
      numbers; see the note on axes of this module.

    Their mean: linear, hence differentiable.
    """
    return (width + height) / 2.0


def instance_area(
    diameter: Any,
    height: Any,
    rotation_spread: Any = 0.0,
    packing: Any = 0.0,
    fill: Any = 1.0,
    minimum_area: Any = 0.0,
) -> Any:
    """Ground area A of one instance of a plant of known size [m2].

    Equations (5)-(9), in which the scale s of eq. (6) brings a plant model to its real size: s D is
    the real diameter and s depth the real height.

    **Arguments:**

    - `diameter`: of the real crown [m], positive.
    - `height`: of the real plant [m], positive; see the note on axes of this module.
    - `rotation_spread`: sigma_rot [degrees], 0 to 90.
    - `packing`: PE / 100 [-], 0 to below 1: crowns that overlap count for less, so there are more
      of them.
    - `fill`: FF / 100 [-], above 0: crowns with gaps count for less.
    - `minimum_area`: least area that one instance counts for [m2]. The paper names the term without
      giving its equation: here it is a lower bound on A, and 0 leaves eq. (9) as it is.

    **Returns:** the area. Arrays broadcast.

    Differentiable in every argument; where the minimum area takes over, the slope in the others is
    zero.
    """
    # Eq. (5)-(8): the crown reaches as far as its radius and, leaning, as its height carries it.
    disc = jnp.pi * (diameter / 2.0 + height * jnp.sin(jnp.deg2rad(rotation_spread))) ** 2
    return jnp.maximum(disc * (1.0 - packing) * fill, minimum_area)


def target_area(scene_area: Any, cover: Any) -> Any:
    """Area that a species is to cover, eq. (1) [m2].

    **Arguments:**

    - `scene_area`: area of the plot [m2].
    - `cover`: cover of the species [-], 0 to 1.

    Their product. Differentiable in both.
    """
    return scene_area * cover


def soft_count(
    target_area: Any, projected_area: Any, branches: Any = 1.0
) -> Float[Array, "*species"]:
    """Real number of instances of a species, eq. (10) without its ceiling [-].

    **Arguments:**

    - `target_area`: area to be covered [m2], not negative (`target_area`).
    - `projected_area`: ground area of one instance [m2], positive (`instance_area`).
    - `branches`: number of copies that make one plant [-].

    Arrays, one value a species, broadcast. Differentiable in every argument; zero target gives
    zero, with a finite slope.

    >>> from fynjax.canopy import instance_area, soft_count, target_area
    >>> area = instance_area(diameter=0.5, height=0.8)  # m2 of one crown
    >>> round(float(soft_count(target_area(100.0, cover=0.1), area)), 2)
    50.93
    """
    return jnp.asarray(branches * target_area / projected_area)


MOST_PROJECTED = 0.99
"""Largest projected cover that is planted, of the ground where plants may stand [-]."""


_SPARE_SITE = 0.5
"""Sites that each plant beyond the whole ones counts for: spare ones are between these, nearer than
the whole ones are to each other but farther than at random. As counted on plots."""


def most_projected(clumping: Any = 1.0) -> Any:
    """Largest projected cover that `projected_count` counts plants for [-].

    **Arguments:** `clumping` of each species as `fynjax.canopy.clumping` has it, [..., part].
    """
    return MOST_PROJECTED * jnp.mean(jnp.atleast_1d(jnp.asarray(clumping)) > 0.0, axis=-1)


def projected_count(
    cover: Any,
    crown: Any,
    ground: Any,
    *,
    spacing: Any = 0.0,
    whole: Any = jnp.inf,
    clumping: Any = 1.0,
) -> Float[Array, "*species"]:
    """Real number of plants whose crowns together lie over a share of the ground [-].

    Crowns of area a at random over ground A leave free the share exp(-N a / A) (Boolean model,
    Matheron 1975). The plants of a scene differ from that in three ways. Their number N is given:
    a becomes -A ln(1 - a / A). They stand on some of the sites of `poisson_disk`, no two nearer
    than `spacing`: each of n sites in a crown's disc is free of plants with probability 1 - N / P,
    P of all sites, and with n of variance (1 - q) times its mean the free share is
    (1 - N h / A)^(a / h), h = q A / P. Each plant beyond the whole ones adds half a site; more
    plants than sites have a site each, which are then nearer to each other.
    A map or groups make them clump, w times as dense in equal parts of the ground: the free share
    is the mean of (1 - N h w / A)^(a / h) over these.

    **Arguments:**

    - `cover`: share of the ground below the crowns of the species, overlap counted once [-]; above
      `most_projected` it counts as that.
    - `crown`: area of one crown within the plot [m2], positive.
    - `ground`: area of the plot [m2].
    - `spacing`: least distance of the sites [m]; 0: at random.
    - `whole`: plants of the species for which the sites are [-].
    - `clumping`: w [-], [..., part] (`fynjax.canopy.clumping`); 1: alike everywhere.

    Arrays, one value a species, broadcast. **Returns:** N such that the mean cover of whole plants,
    the next lower number or the next higher one, is `cover`: between these the mean is a line.
    Differentiable in cover and crown, slopes those of this line.

    >>> from fynjax.canopy import projected_count, soft_count, target_area
    >>> round(float(projected_count(0.45, 0.2, 1e4)))
    29891
    >>> round(float(soft_count(target_area(1e4, 0.45), 0.2)))
    22500
    """
    part = jnp.atleast_1d(jnp.asarray(clumping, jnp.result_type(float)))
    bare = 1.0 - jnp.minimum(jnp.asarray(cover), most_projected(part))
    # With the number of plants given, each leaves free the share 1 - a / A: a as a rate.
    area = -ground * jnp.log1p(-jnp.minimum(jnp.asarray(crown) / ground, 0.9))
    radius = jnp.sqrt(crown / jnp.pi) / jnp.maximum(spacing, 1e-9)
    # Where there are many more sites than fit in a crown it makes no difference how many.
    most = 1e4 * site_evenness(radius) / area
    sites = ground * jnp.minimum(SITES / jnp.maximum(spacing, 1e-9) ** 2, most)
    # Which whole number lies below has no derivative; the way from it to the next has.
    given = area / ground, radius, sites, jnp.asarray(whole)
    target, *fixed = jax.lax.stop_gradient((bare, *given))
    lower = jnp.floor(_inverse(target, *fixed, part))
    free, taken = _bare(lower, *given[:3], fixed[-1], part)
    return lower + (free - bare) / taken


@jax.jit
def _inverse(
    bare: Array, crown: Array, radius: Array, sites: Array, whole: Array, part: Array
) -> Array:
    """The number that leaves the share `bare` free, by Newton's method on the logarithm of that
    share, from that of plants on sites for all of them that do not clump."""

    def step(_: Array, count: Array) -> Array:
        free, taken = _bare(count, crown, radius, sites, whole, part)
        return jnp.maximum(count + free * jnp.log(free / bare) / taken, 0.0)

    even = site_evenness(radius)
    wanted, full = even * jnp.log(bare) / (crown * sites), jnp.log1p(-even)
    first = sites * jnp.where(wanted > full, -jnp.expm1(wanted) / even, wanted / full)
    return jax.lax.fori_loop(0, 20, step, first)


_EXACT = 300.0
"""Number of plants up to which the difference that one more makes is that of two shares; of more
plants, in single precision, it is the slope half-way."""


def _bare(
    count: Array, crown: Array, radius: Array, sites: Array, whole: Array, part: Array
) -> tuple[Array, Array]:
    """Share of the ground without crowns, and what one plant more takes of it [-].

    **Arguments:** `count` of plants; `crown`, area of one over that of the ground, as a rate;
    `radius` of a crown over the distance of the sites; `sites`; `whole` and `part` as
    `projected_count` has `whole` and `clumping`.
    """
    crown, radius, sites, whole = (value[..., None] for value in (crown, radius, sites, whole))

    def logarithm(count: Array) -> Array:
        there = sites + _SPARE_SITE * jnp.maximum(count - whole, 0.0)
        taken = count / there * part
        # Where plants would be more than sites there are as many sites as plants, and these nearer.
        even = site_evenness(radius * jnp.sqrt(jnp.maximum(taken, 1.0)))
        some = there * jnp.log1p(-even * jnp.minimum(taken, 1.0))
        return crown / even * jnp.where(taken < 1.0, some, count * part * jnp.log1p(-even))

    count = count[..., None]
    # At the number, at one more and half-way, all at once.
    steps = jnp.stack([count, count + 1.0, count + 0.5])
    (here, more, _), (*_, half_way) = jax.jvp(logarithm, (steps,), (jnp.ones_like(steps),))
    change = jnp.where(count < _EXACT, more - here, half_way)
    free = jnp.exp(here)
    return free.mean(axis=-1), -(free * jnp.expm1(change)).mean(axis=-1)


def rounded_count(count: Any, lessened: Any = 0.0) -> Float[Array, "*species"]:
    """Whole number of plants from a real one [-].

    **Arguments:**

    - `count`: real number of plants [-], at least 0 (`soft_count`).
    - `lessened`: what it is lessened by before it is rounded up [-], 0 to 1: 0 is the ceiling of
      eq. (10); drawn evenly from 0 to 1, the mean of the whole numbers is `count`.

    Arrays broadcast. The slope is zero. A number that is whole but for the rounding of single
    precision is not lifted to the next.

    >>> from fynjax.canopy import rounded_count
    >>> float(rounded_count(2.3)), float(rounded_count(2.3, 0.2)), float(rounded_count(2.3, 0.4))
    (3.0, 3.0, 2.0)
    """
    count = jnp.asarray(count)
    # Rounding in single precision must not plant one more, however large the number.
    slack = jnp.minimum(_SINGLE_SLACK * count, 1e-3)
    return jnp.maximum(jnp.ceil(count - slack - lessened), 0.0)


def expected_count(count: Any, lessened: Any) -> Float[Array, "*species"]:
    """Number of plants of a stand in expectation, the last of which stands in part [-].

    N + 1/2 - U of a real number N and a number U that is drawn evenly from 0 to 1: `rounded_count`
    is the whole number nearest to it. Over U its mean is N, and the share of the last plant takes
    every value from 0 to 1 alike. What a stand gives is then, in the mean over U, that of whole
    plants, and so is its derivative by N: the difference that one plant more makes, whatever N is.
    Of fewer than half a plant it is 2 N (1 - U).

    **Arguments:**

    - `count`: real number of plants N [-], at least 0.
    - `lessened`: U, as of `rounded_count` [-], 0 to 1.

    Arrays broadcast. Differentiable; the slope by `count` has the mean 1 over U.

    >>> from fynjax.canopy import expected_count
    >>> [round(float(expected_count(2.3, u)), 2) for u in (0.0, 0.2, 0.8)]
    [2.8, 2.6, 2.0]
    """
    count, lessened = jnp.asarray(count), jnp.asarray(lessened)
    return jnp.where(count > 0.5, count + 0.5 - lessened, 2.0 * count * (1.0 - lessened))


def share_from_above(crowns: Any) -> Any:
    """Share of the area of crowns that is seen from above where they stand at random [-].

    **Arguments:**

    - `crowns`: area of each crown over that of the ground, a_i [m2 m-2], 0 or more. One that is as
      large as the ground or larger hides all others.

    **Returns:** (1 - product of (1 - a_i)) / sum of a_i: the part of the ground that no crown
    covers is the product of what each leaves free. Of many small crowns it is (1 - exp(-t)) / t
    with t the sum (Boolean model, Matheron 1975); of a single one 1, as without crowns.
    Differentiable; the slope is zero where no crown stands.

    >>> import jax.numpy as jnp
    >>> from fynjax.canopy import share_from_above
    >>> round(float(share_from_above(jnp.full(10, 0.2))), 4)  # in all twice the ground
    0.4463
    """
    crowns = jnp.asarray(crowns)
    total = jnp.sum(crowns)
    stands = total > 0.0
    most = 1.0 - jnp.finfo(crowns.dtype).eps  # of the whole ground: finite in log and slope
    free = jnp.sum(jnp.log1p(-jnp.minimum(crowns, most)))
    return jnp.where(stands, -jnp.expm1(free) / jnp.where(stands, total, 1.0), 1.0)
