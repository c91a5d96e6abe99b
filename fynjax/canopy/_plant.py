"""One plant as a weighted cloud of area elements, and the organs that they belong to."""

import enum
import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax._core.seeds import generator


class Organ(enum.IntEnum):
    """What an area element belongs to."""

    LEAF = 0
    WOOD = 1
    FLOWER = 2


_WORDS = {
    Organ.LEAF: "leaf leaves foliage foliar needle frond blade lamina phyllode culm thread",
    Organ.WOOD: "wood bark stem branch branches twig trunk bole stalk shoot limb deadwood "
    "cladode root",
    Organ.FLOWER: "flower floral petal blossom bloom inflorescence spikelet corolla calyx tepal",
}
_ORGANS = {word: organ for organ, words in _WORDS.items() for word in words.split()}


def organ_of_name(name: str) -> Organ | None:
    """The organ that the words of a name stand for: "Leaves", "oak_bark.001", "PetalMat".

    **Arguments:**

    - `name`: of a material or a part, in English.

    **Returns:** the organ; None where no word is known, or where the words stand for several organs
    ("leaf_stem").
    """
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    bare = [re.sub(r"(material|mat|texture|tex)$", "", word.lower()) for word in words]
    organs = {_ORGANS.get(word, _ORGANS.get(word.rstrip("s"))) for word in bare}
    organs.discard(None)
    return organs.pop() if len(organs) == 1 else None


def organ_named(organ: Organ | str | int, name: str = "") -> Organ:
    """The organ given as a word, a number or itself; `name` is the material it is of."""
    of = f"the organ of material {name!r}" if name else "an organ"
    if isinstance(organ, str):
        if organ.upper() not in Organ.__members__:
            raise InputError(f"{of} must be leaf, wood or flower, but is {organ!r}")
        return Organ[organ.upper()]
    return Organ(organ)


class PlantModel(eqx.Module):
    """The shape of a plant, free of its size: area elements in crown coordinates.

    One instance is one plant. `unit_shapes` turns and leans it.
    """

    position: Float[Array | np.ndarray, "element 3"]
    """x and y in crown diameters from the plant's axis (lobes reach beyond 0.5), z in plant heights
    (0-1)."""
    area_fraction: Float[Array | np.ndarray, " element"]
    """Part of its organ's area that an element carries [-]; sums to 1 within each organ."""
    normal: Float[Array | np.ndarray, "element 3"]
    """Unit normal, z upward or level."""
    organ: Int[Array | np.ndarray, " element"]
    """`Organ` of each element."""
    material: Int[Array | np.ndarray, " element"] | None = None
    """Place of each element's material among those of its species; below 0: that of its organ.
    None: of all elements."""


def thin_plant(plant: PlantModel, n_elements: int, *, seed: int) -> PlantModel:
    """The same plant with fewer elements.

    **Arguments:**

    - `plant`: the plant; one of no more than `n_elements` is returned as it is.
    - `n_elements`: number of elements wanted. Each organ, and each material of it, keeps its share
      of them, at least one.
    - `seed`: fixes the start of the draw.

    Elements are drawn in even steps along the list, in proportion to their areas; those of an organ
    and material have equal areas afterwards, together as before. Not differentiable.
    """
    organ, area = np.asarray(plant.organ), np.asarray(plant.area_fraction, float)
    if len(organ) <= n_elements:
        return plant
    material = np.zeros_like(organ) if plant.material is None else np.asarray(plant.material)
    rng = generator(seed, 401)
    chosen, fraction = [], []
    for kind, of in np.unique(np.stack([organ, material], axis=1), axis=0).tolist():
        elements = np.flatnonzero((organ == kind) & (material == of))
        count = max(1, round(n_elements * len(elements) / len(organ)))
        share = area[elements]
        steps = (np.arange(count) + rng.random()) / count
        total = share.sum()
        if total > 0.0:
            drawn = np.searchsorted(np.cumsum(share) / total, steps)
        else:  # an organ without area stays one
            drawn = (steps * len(elements)).astype(int)
        chosen.append(elements[np.minimum(drawn, len(elements) - 1)])
        part = total / area[organ == kind].sum() if total > 0.0 else 0.0  # 1 of a single material
        fraction.append(np.full(count, part / count))
    index = np.concatenate(chosen)
    return PlantModel(
        jnp.asarray(plant.position[index]),
        jnp.asarray(np.concatenate(fraction), plant.area_fraction.dtype),
        jnp.asarray(plant.normal[index]),
        jnp.asarray(plant.organ[index]),
        None if plant.material is None else jnp.asarray(plant.material[index]),
    )
