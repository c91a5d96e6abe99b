"""All shipped sensors in one table."""

import tomllib
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from fynjax.sensors._shipped import sensor_folder, shipped_sensor, shipped_sensors
from fynjax.sensors.lidar import FlashGeometry, lidar_folder, shipped_lidar, shipped_lidars

if TYPE_CHECKING:
    import pandas as pd

_MANY = 30
"""Bands of an imaging spectrometer, at least."""


def sensor_reference() -> "pd.DataFrame":
    """A table of the shipped sensors and LiDAR systems.

    Columns: name, kind (multispectral, spectrometer, flash LiDAR, scanning LiDAR), bands (their
    number), lower_nm and upper_nm (of their centres), pixel_m
    (on the ground, from altitude_m; of a LiDAR the width of a footprint), altitude_m (NaN: it does
    not matter) and description.

    >>> from fynjax.sensors import sensor_reference
    >>> sensor_reference().set_index("name").kind["mavic_3m"]
    'multispectral'
    """
    import pandas as pd  # late: the command line need not wait for it

    imagers = [_imager(name) for name in shipped_sensors()]
    return pd.DataFrame(imagers + [_lidar(name) for name in shipped_lidars()])


def _imager(name: str) -> dict[str, Any]:
    about = tomllib.loads((sensor_folder() / f"{name}.toml").read_text("utf-8"))
    with warnings.catch_warnings():
        # That a file states another pixel than its optics give is said to who uses the sensor.
        warnings.simplefilter("ignore", UserWarning)
        sensor = shipped_sensor(name)
    count, centres = len(sensor.bands), sensor.bands.centre
    return {
        "name": name,
        "kind": "spectrometer" if count >= _MANY else "multispectral",
        "bands": count,
        "lower_nm": min(centres),
        "upper_nm": max(centres),
        "pixel_m": float(sensor.pixel()),
        "altitude_m": float(about["geometry"].get("altitude_m", np.nan)),
        "description": about.get("description", ""),
    }


def _lidar(name: str) -> dict[str, Any]:
    about = tomllib.loads((lidar_folder() / f"{name}.toml").read_text("utf-8"))
    lidar = shipped_lidar(name)
    at = lidar.geometry
    if isinstance(at, FlashGeometry):
        kind, angle = "flash LiDAR", at.pixel_pitch_um / at.focal_length_mm  # [mrad]
    else:
        kind, angle = (
            "scanning LiDAR",
            float(np.prod(at.divergence_mrad) ** (1 / len(at.divergence_mrad))),
        )
    return {
        "name": name,
        "kind": kind,
        "bands": 1,
        "lower_nm": lidar.wavelength,
        "upper_nm": lidar.wavelength,
        "pixel_m": 1e-3 * angle * at.altitude,
        "altitude_m": at.altitude,
        "description": about.get("description", ""),
    }
