"""Sensors: bands, lines of sight, point spread and noise."""

from fynjax.sensors._bands import BandSet
from fynjax.sensors._camera import (
    AbstractCamera,
    FrameCamera,
    OrthographicCamera,
    PushbroomCamera,
    frame_of,
)
from fynjax.sensors._camera_counts import CameraRadiometry, counts_to_radiance
from fynjax.sensors._channels import Channels, group_bands
from fynjax.sensors._empirical_line import (
    EmpiricalLine,
    Panel,
    PanelReading,
    empirical_line,
    irradiance_line,
    one_panel_line,
    panel_coverage,
    panel_reading,
    place_panels,
)
from fynjax.sensors._gains import ASSUMED, Gains
from fynjax.sensors._noise import AbstractNoise, CameraNoise, RadiometricNoise
from fynjax.sensors._pose import Frame, Lens, Pose, lens_of, pose_of_axes
from fynjax.sensors._psf import PointSpread
from fynjax.sensors._rays import map_rays
from fynjax.sensors._reference import sensor_reference
from fynjax.sensors._sensor import Sensor
from fynjax.sensors._shipped import (
    build_sensor,
    mavic_3m,
    sensor_folder,
    shipped_sensor,
    shipped_sensors,
)
from fynjax.sensors.air import (
    SPACE,
    Atmosphere,
    ClearAir,
    SunPosition,
    at_sensor_radiance,
    band_atmosphere,
    check_within_table,
    clear_sky_atmosphere,
    is_transparent,
    sun_position,
    surface_reflectance,
    tabulated_atmosphere,
)
from fynjax.sensors.lidar import (
    FlashGeometry,
    Lidar,
    LidarBeams,
    LidarNoise,
    LidarReturns,
    ScanGeometry,
    Waveforms,
    build_lidar,
    detect_returns,
    expected_returns,
    lidar_folder,
    lidar_waveforms,
    received_electrons,
    shipped_lidar,
    shipped_lidars,
)

__all__ = [
    "AbstractCamera",
    "AbstractNoise",
    "Atmosphere",
    "BandSet",
    "CameraNoise",
    "ClearAir",
    "FlashGeometry",
    "Frame",
    "FrameCamera",
    "Gains",
    "Lens",
    "Lidar",
    "LidarBeams",
    "LidarNoise",
    "LidarReturns",
    "OrthographicCamera",
    "Panel",
    "PointSpread",
    "Pose",
    "PushbroomCamera",
    "RadiometricNoise",
    "ScanGeometry",
    "Sensor",
    "SunPosition",
    "Waveforms",
    "shipped_lidar",
    "shipped_lidars",
    "shipped_sensor",
    "shipped_sensors",
    "sun_position",
]
