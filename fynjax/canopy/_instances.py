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
    """Azimuth and tilt of `n` plants [degrees], for `instantiate`.

    Azimuths are uniform in [0, 360). Tilts are the sizes of normal numbers whose standard
    deviation is `rotation_spread` (sigma_rot, degrees), at most 90. The same seed gives the same
    plants the same orientation, however many there are.
    """
    azimuth = 360.0 * np.random.default_rng([seed, 0]).random(n)
    tilt = rotation_spread * np.abs(np.random.default_rng([seed, 1]).standard_normal(n))
    return azimuth, np.minimum(tilt, 90.0)


def stack_plants(
    plants: Sequence[PlantModel], model_index: Int[np.ndarray, " plant"]
) -> PlantModel:
    """One shape for each plant: a `PlantModel` whose arrays have a leading axis `plant`.

    `model_index` names the model of each plant; all models must have as many elements. Raises
    `InputError` otherwise.
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
    """Stand a plant model on every site: positions [m], areas [m2] and organs of all elements.

    **Arguments:**

    - `plant`: the shape, with k elements; or one shape for each plant (`stack_plants`), to stand
      many species in one call, which compiles much faster than a call for each.
    - `sites`: x, y of the n plants [m].
    - `azimuth`: turn of each plant about the vertical [degrees], clockwise from above: the model's
      north side then faces that azimuth.
    - `weight`: how much of each plant stands there [-], 0 to 1 (`soft_weights`). It scales the
      areas, not the size.
    - `diameter`, `height`: of the crown and of the plant [m], for all or for each.
    - `leaf_area`, `wood_area`, `flower_area`: one-sided area of a plant of weight 1 [m2], for all
      or for each.
    - `tilt`: lean of each plant's axis from the vertical towards its azimuth [degrees].

    The elements of a plant lie side by side: the results have the shapes [n k, 3], [n k], [n k].
    The dtype follows `sites`. Differentiable in everything but `organ`. Raises `InputError` where
    the azimuths look like radians (if they are known before tracing).
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

    An element then stands at site + diameter times the one + height times the other. `position`
    is that of a `PlantModel`; `azimuth` and `tilt` [degrees] are those of `instantiate`;
    `numpy` is the library that computes, numpy or jax.numpy.
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
