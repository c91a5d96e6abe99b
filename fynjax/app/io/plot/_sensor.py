"""The sensor that a plot file names: its bands, and from where it looks."""

import dataclasses
import warnings
from collections.abc import Collection

from fynjax._core.errors import InputError, did_you_mean
from fynjax.app.io.instruments import load_sensor
from fynjax.app.io.plot._plot import Plot
from fynjax.app.io.plot._plot_tables import SensorTable
from fynjax.metrics import BANDS, bands_needed
from fynjax.scene import visible_sensor
from fynjax.sensors import Gains, Sensor

DRONE = "mavic_3m"
"""The sensor of a plot file that names none."""
_DRONE_PIXEL = 0.025  # m, of the paper


def named_sensor(table: SensorTable) -> SensorTable:
    """The sensor `table` with the name that its sensor file, where there is one, states."""
    return table if table.path is None else table.replace(name=_load(table).name)


def sensor_place(plot: Plot) -> tuple[float, float]:
    """Height above the ground, and side of a pixel on it [m], of a plot's sensor: what its file
    leaves out, as the sensor's file has it, or as the paper flew the drone that is the default.

    **Arguments:** `plot`: as of `read_plot`.

    **Raises:** `InputError` for a sensor file that cannot be read.
    """
    table = plot.sensor
    instrument = _load(table)
    altitude = instrument.altitude if table.altitude_m is None else table.altitude_m
    if table.pixel_m is not None:
        return altitude, table.pixel_m
    of_paper = table.path is None and table.name == DRONE
    return altitude, _DRONE_PIXEL if of_paper else float(instrument.pixel(altitude))


def _load(table: SensorTable) -> Sensor:
    with warnings.catch_warnings():  # whoever uses the sensor warns again
        warnings.simplefilter("ignore", UserWarning)
        return load_sensor(table.path or table.name)


def plot_instrument(plot: Plot) -> Sensor:
    """The sensor that the file of `plot` names, with the bands that can be simulated.

    **Raises:** `InputError` as `fynjax.app.io.instruments.load_sensor` and
    `fynjax.scene.visible_sensor`.
    """
    return visible_sensor(load_sensor(plot.sensor.path or plot.sensor.name))


def drone_sensor(plot: Plot, bands: Collection[str] | None = None) -> Sensor:
    """A plot's camera, with the errors of its calibration as the plot's file has them.

    **Arguments:**

    - `plot`: as of `read_plot`.
    - `bands`: and indices that are needed beside green, red, red edge and near infrared; every
      band by default.

    **Returns:** the sensor with these four bands, in this order, and then the others.

    **Raises:** `InputError` for a sensor without them, for pixels wider than the plot, and for a
    way of calibration or a band that the sensor does not have.
    """
    instrument = plot_instrument(plot)
    names = instrument.bands.names
    if missing := [name for name in BANDS if name not in names]:
        raise InputError(
            f"expected a sensor with bands {', '.join(BANDS)}, but {plot.sensor.name!r} has no "
            f"{missing[0]}. Rename the bands of a file of yours. Products of any bands are made by "
            f"`fynjax simulate {plot.file.name}`.",
            file=plot.file,
            column="sensor.path" if plot.sensor.path else "sensor.name",
        )
    pixel = sensor_place(plot)[1]
    if pixel > min(plot.size_m):
        raise InputError(
            f"expected a pixel of at most the plot's side, {min(plot.size_m):g} m, but "
            f"{plot.sensor.name!r} has {pixel:g} m. Its products are made by "
            f"`fynjax simulate {plot.file.name}`.",
            file=plot.file,
            column="sensor.pixel_m",
        )
    others = [n for n in names if n not in BANDS]
    drone = instrument.select([names.index(name) for name in (*BANDS, *others)])
    drone = dataclasses.replace(drone, calibrations=(_gains(plot, drone),))
    if bands is None:
        return drone
    needed = bands_needed({*BANDS, *bands}, drone.bands)
    return drone.select([i for i, n in enumerate(drone.bands.names) if n in needed])


def _gains(plot: Plot, drone: Sensor) -> Gains:
    """Errors of the drone's calibration: of its file, but for what the plot's file states."""
    names, sd, shared = drone.bands.names, plot.calibration.gain_sd, plot.calibration.gain_shared
    try:
        found = drone.gains(plot.sensor.calibrated_by)
    except InputError as error:
        raise InputError(str(error), file=plot.file, column="sensor.calibrated_by") from error
    stated = sd if isinstance(sd, dict) else {}
    if unknown := [name for name in stated if name not in names]:
        raise InputError(
            f"expected bands that are compared ({', '.join(names)}), but got {unknown[0]!r}."
            f"{did_you_mean(unknown[0], names)}",
            file=plot.file,
            column="calibration.gain_sd",
        )
    each = zip(names, found.of_bands(len(names)), strict=True)
    one_or_many = sd if isinstance(sd, float) else tuple(stated.get(n, own) for n, own in each)
    shared = found.shared if shared is None else shared
    return dataclasses.replace(found, sd=one_or_many, shared=shared)
