"""Which organ of a plant a name stands for."""

import re

from fynjax._core.errors import InputError
from fynjax.canopy._plant import Organ

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
