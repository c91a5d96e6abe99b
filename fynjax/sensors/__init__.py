"""Sensors: bands, lines of sight, point spread and noise."""

from fynjax.sensors._atmosphere import (
    SPACE,
    Atmosphere,
    ClearAir,
    at_sensor_radiance,
    band_atmosphere,
    ground_irradiance,
    is_transparent,
    surface_reflectance,
)
from fynjax.sensors._bands import BandSet, band_set_of_curves
from fynjax.sensors._camera import (
    AbstractCamera,
    FrameCamera,
    OrthographicCamera,
    check_ground_sample_distance,
)
from fynjax.sensors._camera_counts import (
    CameraRadiometry,
    counts_to_radiance,
    radiance_to_counts,
)
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
from fynjax.sensors._lidar import (
    Lidar,
    LidarNoise,
    build_lidar,
    lidar_folder,
    shipped_lidar,
    shipped_lidars,
)
from fynjax.sensors._lidar_beams import FlashGeometry, LidarBeams, ScanGeometry
from fynjax.sensors._lidar_returns import (
    LidarReturns,
    detect_returns,
    received_electrons,
)
from fynjax.sensors._lidar_waveform import Waveforms, expected_returns, lidar_waveforms
from fynjax.sensors._noise import (
    RADIANCE_UNITS,
    AbstractNoise,
    CameraNoise,
    RadiometricNoise,
    radiometric_noise,
)
from fynjax.sensors._psf import PointSpread
from fynjax.sensors._pushbroom import PushbroomCamera, frame_of
from fynjax.sensors._rays import camera_rays, map_rays
from fynjax.sensors._sensor import Sensor
from fynjax.sensors._shipped import (
    build_sensor,
    mavic_3m,
    mavic_3m_camera,
    mavic_3m_paper_camera,
    sensor_folder,
    shipped_sensor,
    shipped_sensors,
)
from fynjax.sensors._sixs_table import check_within_table, table_limits, tabulated_atmosphere
from fynjax.sensors._spectrl2 import clear_sky_atmosphere
from fynjax.sensors._sun import SunPosition, sun_position

__all__ = [
    "RADIANCE_UNITS",
    "SPACE",
    "AbstractCamera",
    "AbstractNoise",
    "Atmosphere",
    "BandSet",
    "CameraNoise",
    "CameraRadiometry",
    "ClearAir",
    "EmpiricalLine",
    "FlashGeometry",
    "FrameCamera",
    "Lidar",
    "LidarBeams",
    "LidarNoise",
    "LidarReturns",
    "OrthographicCamera",
    "Panel",
    "PanelReading",
    "PointSpread",
    "PushbroomCamera",
    "RadiometricNoise",
    "ScanGeometry",
    "Sensor",
    "SunPosition",
    "Waveforms",
    "at_sensor_radiance",
    "band_atmosphere",
    "band_set_of_curves",
    "build_lidar",
    "build_sensor",
    "camera_rays",
    "check_ground_sample_distance",
    "check_within_table",
    "clear_sky_atmosphere",
    "counts_to_radiance",
    "detect_returns",
    "empirical_line",
    "expected_returns",
    "frame_of",
    "ground_irradiance",
    "irradiance_line",
    "is_transparent",
    "lidar_folder",
    "lidar_waveforms",
    "map_rays",
    "mavic_3m",
    "mavic_3m_camera",
    "mavic_3m_paper_camera",
    "one_panel_line",
    "panel_coverage",
    "panel_reading",
    "place_panels",
    "radiance_to_counts",
    "radiometric_noise",
    "received_electrons",
    "sensor_folder",
    "shipped_lidar",
    "shipped_lidars",
    "shipped_sensor",
    "shipped_sensors",
    "sun_position",
    "surface_reflectance",
    "table_limits",
    "tabulated_atmosphere",
]
