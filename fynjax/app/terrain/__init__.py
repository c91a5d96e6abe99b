"""Terrain: from a point cloud or a height raster to the ground of a plot.

cloud = read_cloud("plot.laz")
ground = find_ground(cloud)
terrain = terrain_from_points(cloud, ground, cell=0.25)
write_terrain("terrain.tif", terrain)
"""

from fynjax.app.terrain._cloud import (
    CLOUD_SUFFIXES,
    GROUND_CLASSES,
    PointCloud,
    is_normalised,
    read_cloud,
)
from fynjax.app.terrain._files import middle_of_raster, read_terrain, write_mesh, write_terrain
from fynjax.app.terrain._filter import TOLERANCE, WINDOW, GroundMethod, find_ground, labelled_ground
from fynjax.app.terrain._raster import Terrain, whole_cells
from fynjax.app.terrain._surface import (
    canopy_height,
    check_covered,
    heights_above_ground,
    terrain_from_points,
    terrain_mesh,
)
from fynjax.app.terrain._units import Bounds, check_bounds, check_positive

__all__ = [
    "CLOUD_SUFFIXES",
    "GROUND_CLASSES",
    "TOLERANCE",
    "WINDOW",
    "Bounds",
    "GroundMethod",
    "PointCloud",
    "Terrain",
    "canopy_height",
    "check_bounds",
    "check_covered",
    "check_positive",
    "find_ground",
    "heights_above_ground",
    "is_normalised",
    "labelled_ground",
    "middle_of_raster",
    "read_cloud",
    "read_terrain",
    "terrain_from_points",
    "terrain_mesh",
    "whole_cells",
    "write_mesh",
    "write_terrain",
]
