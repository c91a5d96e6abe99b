"""Canopy: plants, where they stand, and the voxel grid they fill."""

from fynjax.canopy._angles import (
    AbstractLeafAngle,
    EllipsoidalLeafAngle,
    SphericalLeafAngle,
    TabulatedLeafAngle,
    TrigonometricLeafAngle,
    leaf_angle,
)

__all__ = [
    "AbstractLeafAngle",
    "EllipsoidalLeafAngle",
    "SphericalLeafAngle",
    "TabulatedLeafAngle",
    "TrigonometricLeafAngle",
    "leaf_angle",
]
