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

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError

# A count that is whole but for rounding must not be lifted to the next plant by the ceiling.
_CEILING_SLACK = 1e-12
_SINGLE_SLACK = 5e-7


def modelled_diameter(width: Any, height: Any) -> Any:
    """Crown diameter D of a plant model, eq. (7) of the fynbos scene paper [m].

    **Arguments:**

    - `width`, `height`: its two horizontal extents (x and y of the bounding box) [m], arrays or
      numbers; see the note on axes of this module.

    Their mean: linear, hence differentiable.
    """
    return (width + height) / 2.0


def crown_scale(crown_diameter: Any, modelled_diameter: Any) -> Any:
    """Scale s that brings a plant model to the real crown diameter, eq. (6) [-].

    **Arguments:**

    - `crown_diameter`: of the real plant [m].
    - `modelled_diameter`: of the model, positive [m] (`modelled_diameter`).

    Their ratio. Differentiable in both.
    """
    return crown_diameter / modelled_diameter


def projected_area(
    scale: Any,
    modelled_diameter: Any,
    depth: Any,
    rotation_spread: Any = 0.0,
    packing: Any = 0.0,
    fill: Any = 1.0,
) -> Any:
    """Ground area A that one instance counts for, eq. (5), (8) and (9) [m2].

    **Arguments:**

    - `scale`: s of eq. (6) [-].
    - `modelled_diameter`: D of eq. (7) [m].
    - `depth`: vertical extent of the model [m]; see the note on axes of this module.
    - `rotation_spread`: sigma_rot [degrees], 0 to 90.
    - `packing`: PE / 100 [-], 0 to below 1: crowns that overlap count for less, so there are more
      of them.
    - `fill`: FF / 100 [-], above 0: crowns with gaps count for less.

    Differentiable in every argument.
    """
    lean = scale * depth * jnp.sin(jnp.deg2rad(rotation_spread))
    disc = jnp.pi * (scale * modelled_diameter / 2.0 + lean) ** 2
    return disc * (1.0 - packing) * fill


def instance_area(
    diameter: Any,
    height: Any,
    rotation_spread: Any = 0.0,
    packing: Any = 0.0,
    fill: Any = 1.0,
    minimum_area: Any = 0.0,
) -> Any:
    """Ground area A of one instance of a plant of known size [m2].

    Equations (5)-(9) for a model whose proportions are already those of the plant (a parametric
    form), so that s D is the diameter and s depth the height.

    **Arguments:**

    - `diameter`: of the real crown [m], positive.
    - `height`: of the real plant [m], positive.
    - `rotation_spread`, `packing`, `fill`: as `projected_area` has them.
    - `minimum_area`: least area that one instance counts for [m2]. The paper names the term without
      giving its equation: here it is a lower bound on A, and 0 leaves eq. (9) as it is.

    **Returns:** the area. Arrays broadcast.

    Differentiable in every argument; where the minimum area takes over, the slope in the others is
    zero.
    """
    area = projected_area(1.0, diameter, height, rotation_spread, packing, fill)
    return jnp.maximum(area, minimum_area)


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
    slack = jnp.minimum(_SINGLE_SLACK * count, 1e-3)
    return jnp.maximum(jnp.ceil(count - slack - lessened), 0.0)


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


def hard_count(
    target_area: Any, projected_area: Any, branches: Any = 1
) -> Int[np.ndarray, "*species"] | int:
    """Number of instances of a species, eq. (10) with its ceiling [-].

    **Arguments:**

    - `target_area`: area to be covered [m2], not negative; zero gives zero.
    - `projected_area`: ground area of one instance [m2], positive.
    - `branches`: number of copies that make one plant [-].

    **Returns:** an int, or an int array where the arguments are arrays.

    For concrete numbers, in float64. Not differentiable: see `soft_count`.

    **Raises:** `InputError` for a projected area that is not positive, or a negative target.

    >>> from fynjax.canopy import hard_count
    >>> hard_count(target_area=10.0, projected_area=0.196)
    52
    """
    target = np.asarray(target_area, float)
    area = np.asarray(projected_area, float)
    if not np.all(np.isfinite(area) & (area > 0.0)):
        raise InputError(
            f"`projected_area` must be positive [m2], but is {area}; a packing of 1, a fill of "
            "0 or a crown without diameter gives zero"
        )
    if not np.all(np.isfinite(target) & (target >= 0.0)):
        raise InputError(f"`target_area` must not be negative [m2], but is {target}")
    count = np.asarray(branches, float) * target / area
    whole = np.ceil(count * (1.0 - _CEILING_SLACK)).astype(np.int64)
    return int(whole) if whole.ndim == 0 else whole
