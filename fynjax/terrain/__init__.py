"""Terrain: from a point cloud or a height raster to the ground of a plot.

cloud = read_cloud("plot.laz")
ground = find_ground(cloud)
terrain = terrain_from_points(cloud, ground, cell=0.25)
write_terrain("terrain.tif", terrain)
"""

from fynjax.terrain._cloud import GROUND_CLASSES, PointCloud, read_cloud
from fynjax.terrain._files import read_terrain, write_mesh, write_terrain
from fynjax.terrain._filter import find_ground
from fynjax.terrain._job import run_terrain
from fynjax.terrain._raster import Terrain
from fynjax.terrain._surface import (
    canopy_height,
    heights_above_ground,
    terrain_from_points,
    terrain_mesh,
)
from fynjax.terrain._units import UNITS, Bounds

__all__ = [
    "GROUND_CLASSES",
    "UNITS",
    "Bounds",
    "PointCloud",
    "Terrain",
    "canopy_height",
    "find_ground",
    "heights_above_ground",
    "read_cloud",
    "read_terrain",
    "run_terrain",
    "terrain_from_points",
    "terrain_mesh",
    "write_mesh",
    "write_terrain",
]
