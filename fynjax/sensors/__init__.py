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
from fynjax.sensors._noise import (
    RADIANCE_UNITS,
    AbstractNoise,
    CameraNoise,
    RadiometricNoise,
    radiometric_noise,
)
from fynjax.sensors._psf import PointSpread
from fynjax.sensors._pushbroom import PushbroomCamera
from fynjax.sensors._rays import camera_rays
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
from fynjax.sensors._sixs_table import table_limits, tabulated_atmosphere
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
    "ClearAir",
    "FrameCamera",
    "OrthographicCamera",
    "PointSpread",
    "PushbroomCamera",
    "RadiometricNoise",
    "Sensor",
    "SunPosition",
    "at_sensor_radiance",
    "band_atmosphere",
    "band_set_of_curves",
    "build_sensor",
    "camera_rays",
    "check_ground_sample_distance",
    "clear_sky_atmosphere",
    "ground_irradiance",
    "is_transparent",
    "mavic_3m",
    "mavic_3m_camera",
    "mavic_3m_paper_camera",
    "radiometric_noise",
    "sensor_folder",
    "shipped_sensor",
    "shipped_sensors",
    "sun_position",
    "surface_reflectance",
    "table_limits",
    "tabulated_atmosphere",
]
