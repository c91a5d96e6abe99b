"""Files of instruments: sensors, LiDAR systems and clouds, atmospheres; scenes as meshes."""

from fynjax.io.instruments._atmosphere_file import read_atmosphere
from fynjax.io.instruments._lidar_cloud import write_cloud
from fynjax.io.instruments._lidar_file import LidarFile, load_lidar
from fynjax.io.instruments._scene_mesh import scene_meshes, write_scene_mesh
from fynjax.io.instruments._sensor_file import load_instrument, load_sensor
from fynjax.io.instruments._sensor_tables import (
    BandRow,
    CurveRow,
    NoiseRow,
    SensorFile,
    WayOfCalibration,
)

__all__ = [
    "BandRow",
    "CurveRow",
    "LidarFile",
    "NoiseRow",
    "SensorFile",
    "WayOfCalibration",
    "load_instrument",
    "load_lidar",
    "load_sensor",
    "read_atmosphere",
    "scene_meshes",
    "write_cloud",
    "write_scene_mesh",
]
