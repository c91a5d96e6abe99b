"""Any sensor by its name."""

from pathlib import Path

from fynjax.app.io.instruments import load_instrument
from fynjax.sensors import Lidar, Sensor


def sensor(name: str | Path) -> Sensor | Lidar:
    """An imaging sensor or a LiDAR, by its shipped name or from a file.

    **Arguments:** `name`, one of `fynjax.sensors.shipped_sensors()` or
    `fynjax.sensors.shipped_lidars()`; or the path of a sensor or LiDAR file (TOML;
    `data_schemas/sensor.schema.json`, `lidar.schema.json`).

    **Returns:** a `fynjax.sensors.Sensor` or `fynjax.sensors.Lidar`.

    **Raises:** `InputError` for an unknown name, with the nearest of all names, and for a file
    that cannot be used.

    >>> import fynjax as fx
    >>> fx.sensor("mavic_3m").bands.names
    ('green', 'red', 'red_edge', 'nir')
    """
    return load_instrument(name)
