"""One plant as a weighted cloud of area elements."""

import enum

import equinox as eqx
from jaxtyping import Array, Float, Int


class Organ(enum.IntEnum):
    """What an area element belongs to."""

    LEAF = 0
    WOOD = 1
    FLOWER = 2


class PlantModel(eqx.Module):
    """The shape of a plant, free of its size: area elements in crown coordinates.

    One instance is one plant. Placed plants are `instantiate(plant, sites, ...)`.
    """

    position: Float[Array, "element 3"]
    """x and y in crown diameters from the plant's axis (-0.5 to 0.5), z in plant heights (0-1)."""
    area_fraction: Float[Array, " element"]
    """Part of its organ's area that an element carries [-]; sums to 1 within each organ."""
    normal: Float[Array, "element 3"]
    """Unit normal, z upward or level."""
    organ: Int[Array, " element"]
    """`Organ` of each element."""
