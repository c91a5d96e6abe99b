"""Sensors: bands, lines of sight, point spread and noise."""

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
from fynjax.sensors._sun import SunPosition, sun_position

__all__ = [
    "RADIANCE_UNITS",
    "AbstractCamera",
    "AbstractNoise",
    "BandSet",
    "CameraNoise",
    "FrameCamera",
    "OrthographicCamera",
    "PointSpread",
    "PushbroomCamera",
    "RadiometricNoise",
    "Sensor",
    "SunPosition",
    "band_set_of_curves",
    "build_sensor",
    "camera_rays",
    "check_ground_sample_distance",
    "mavic_3m",
    "mavic_3m_camera",
    "mavic_3m_paper_camera",
    "radiometric_noise",
    "sensor_folder",
    "shipped_sensor",
    "shipped_sensors",
    "sun_position",
]
