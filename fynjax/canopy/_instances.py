"""Plants at their places: area elements of one species in the frame of the plot."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax.canopy._plant import Organ, PlantModel


def random_orientation(
    n: int, *, seed: int, rotation_spread: float = 0.0
) -> tuple[Float[np.ndarray, " plant"], Float[np.ndarray, " plant"]]:
    """Azimuth and tilt of plants [degrees], for `instantiate`.

    **Arguments:**

    - `n`: number of plants.
    - `seed`: the same seed gives the same plants the same orientation, however many there are.
    - `rotation_spread`: standard deviation sigma_rot of the tilts [degrees], at least 0.

    **Returns:** azimuths, uniform in [0, 360), and tilts, the sizes of normal numbers with the
    standard deviation `rotation_spread`, at most 90. NumPy arrays; the tilts are linear in
    `rotation_spread` up to that limit.
    """
    azimuth = 360.0 * np.random.default_rng([seed, 0]).random(n)
    tilt = rotation_spread * np.abs(np.random.default_rng([seed, 1]).standard_normal(n))
    return azimuth, np.minimum(tilt, 90.0)


def stack_plants(
    plants: Sequence[PlantModel], model_index: Int[np.ndarray, " plant"]
) -> PlantModel:
    """One shape for each plant: a `PlantModel` whose arrays have a leading axis `plant`.

    **Arguments:**

    - `plants`: the models, each with as many elements as the others.
    - `model_index`: index into `plants` of each plant.

    **Returns:** the model that `instantiate` takes for plants of several species in one call.

    **Raises:** `InputError` where the models differ in their number of elements.
    """
    sizes = {plant.position.shape[0] for plant in plants}
    if len(sizes) != 1:
        raise InputError(
            f"`plants` must all have the same number of elements, but have {sorted(sizes)}"
        )
    return jax.tree.map(lambda *leaves: jnp.stack(leaves)[np.asarray(model_index)], *plants)


def instantiate(
    plant: PlantModel,
    sites: Float[Array, "plant 2"],
    azimuth: Float[Array, " plant"],
    weight: Float[Array, " plant"],
    diameter: Float[Array, " plant"] | float,
    height: Float[Array, " plant"] | float,
    leaf_area: Float[Array, " plant"] | float,
    wood_area: Float[Array, " plant"] | float = 0.0,
    flower_area: Float[Array, " plant"] | float = 0.0,
    tilt: Float[Array, " plant"] | None = None,
) -> tuple[Float[Array, "element 3"], Float[Array, " element"], Int[Array, " element"]]:
    """Area elements of a plant model placed on every site.

    **Arguments:**

    - `plant`: the shape, with k elements; or one shape for each plant (`stack_plants`), to place
      many species in one call, which compiles much faster than a call for each.
    - `sites`: x, y of the n plants [m].
    - `azimuth`: turn of each plant about the vertical [degrees], clockwise from above: the model's
      north side then faces that azimuth.
    - `weight`: weight of each plant [-], 0 to 1 (`soft_weights`). It scales the areas, not the
      size.
    - `diameter`, `height`: of the crown and of the plant [m], for all or for each.
    - `leaf_area`, `wood_area`, `flower_area`: one-sided area of a plant of weight 1 [m2], for all
      or for each.
    - `tilt`: lean of each plant's axis from the vertical towards its azimuth [degrees].

    **Returns:** positions [m], one-sided areas [m2] and organs of all elements, of the shapes
    [n k, 3], [n k] and [n k]; the elements of a plant lie side by side. The dtype follows `sites`.

    Differentiable, to any order, in every floating argument.

    **Raises:** `InputError` where the azimuths look like radians (if they are known before
    tracing).

    >>> import jax.numpy as jnp
    >>> from fynjax.canopy import instantiate, plant_model
    >>> position, area, organ = instantiate(
    ...     plant_model("tussock", 50, seed=1),
    ...     sites=jnp.array([[1.0, 1.0], [3.0, 2.0]]),
    ...     azimuth=jnp.array([0.0, 90.0]),
    ...     weight=jnp.array([1.0, 0.5]),
    ...     diameter=0.6,
    ...     height=0.5,
    ...     leaf_area=0.4,
    ... )
    >>> position.shape, round(float(area.sum()), 6)
    ((100, 3), 0.6)
    """
    _check_degrees(azimuth)
    sites = jnp.asarray(sites)
    dtype = sites.dtype
    n, k = sites.shape[0], plant.position.shape[-2]

    def per_plant(value: Any) -> Array:
        return jnp.broadcast_to(jnp.asarray(value, dtype), (n,))[:, None]

    lean = jnp.zeros(1, dtype) if tilt is None else per_plant(tilt)[:, 0]
    per_diameter, per_height = unit_shapes(
        plant.position.astype(dtype), per_plant(azimuth)[:, 0], lean, jnp
    )
    foot = jnp.pad(sites, ((0, 0), (0, 1)))[:, None, :]
    positions = (
        foot
        + per_plant(diameter)[..., None] * per_diameter
        + per_plant(height)[..., None] * per_height
    ).reshape(n * k, 3)

    # One column an organ, each element picks its own: no gather over plants.
    areas = {Organ.LEAF: leaf_area, Organ.WOOD: wood_area, Organ.FLOWER: flower_area}
    fraction = plant.area_fraction.astype(dtype)
    area = jnp.zeros((n, k), dtype)
    for organ, of_organ in areas.items():
        area = area + jnp.where(plant.organ == organ, fraction, 0.0) * per_plant(of_organ)
    area = (area * per_plant(weight)).reshape(n * k)
    return positions, area, jnp.broadcast_to(plant.organ, (n, k)).reshape(n * k)


def unit_shapes(position: Any, azimuth: Any, tilt: Any, numpy: Any = np) -> tuple[Any, Any]:
    """Turned and leaning plants of unit size: [plant, element, 3] per diameter and per height.

    An element of a plant is at site + diameter times the first array + height times the second.

    **Arguments:**

    - `position`: that of a `PlantModel`, [element, 3] or [plant, element, 3].
    - `azimuth`, `tilt`: those of `instantiate` [degrees], one value a plant.
    - `numpy`: the library that computes, `numpy` or `jax.numpy`.

    Differentiable, with `jax.numpy`, in every array.
    """
    x, y, z = (position[..., axis] for axis in range(3))
    turn, lean = numpy.deg2rad(azimuth)[:, None], numpy.deg2rad(tilt)[:, None]
    east, north = numpy.sin(turn), numpy.cos(turn)

    def stand(right: Any, ahead: Any, up: Any) -> Any:
        shape = (turn.shape[0], position.shape[-2])
        parts = (right * north + ahead * east, ahead * north - right * east, up)
        return numpy.stack([numpy.broadcast_to(part, shape) for part in parts], axis=-1)

    per_diameter = stand(x, y * numpy.cos(lean), -y * numpy.sin(lean))
    return per_diameter, stand(0.0 * x, z * numpy.sin(lean), z * numpy.cos(lean))


def _check_degrees(azimuth: Any) -> None:
    """Random azimuths that all lie in [0, 2 pi] can only be radians."""
    if isinstance(azimuth, jax.core.Tracer) or np.size(azimuth) < 16:
        return
    known = np.asarray(azimuth)
    if known.min() >= 0.0 and 3.5 < known.max() <= 2.0 * np.pi and np.ptp(known) > 3.0:
        raise InputError(
            f"`azimuth` must be in degrees, but {known.size} plants range from {known.min():.2f} "
            f"to {known.max():.2f}: these look like radians"
        )
