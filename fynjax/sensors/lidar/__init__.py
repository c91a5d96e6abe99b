"""LiDAR: the system, its beams, waveforms and discrete returns."""

from fynjax.sensors.lidar._beams import FlashGeometry, LidarBeams, ScanGeometry
from fynjax.sensors.lidar._returns import (
    GROUND,
    VEGETATION,
    LidarReturns,
    detect_returns,
    received_electrons,
)
from fynjax.sensors.lidar._shares import shares_of_returns
from fynjax.sensors.lidar._system import (
    Lidar,
    LidarNoise,
    build_lidar,
    lidar_folder,
    shipped_lidar,
    shipped_lidars,
)
from fynjax.sensors.lidar._waveform import Waveforms, expected_returns, lidar_waveforms

__all__ = [
    "FlashGeometry",
    "Lidar",
    "LidarBeams",
    "LidarNoise",
    "LidarReturns",
    "ScanGeometry",
    "Waveforms",
    "shipped_lidar",
    "shipped_lidars",
]
