"""What a plot file says of its sun, its sensor and the air between, as plain records."""

import warnings
from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError
from fynjax.io.instruments import load_sensor
from fynjax.io.plot._plot import Air, Plot, Sensor, Sun
from fynjax.io.plot._plot_tables import AtmosphereTable, SensorTable, SunTable
from fynjax.io.text import did_you_mean, line_of
from fynjax.metrics import BANDS
from fynjax.scene import PARAMETERS
from fynjax.sensors import (
    SPACE,
    OrthographicCamera,
    Panel,
    frame_of,
    shipped_sensors,
    sun_position,
)
from fynjax.sensors import Sensor as Instrument

DRONE = "mavic_3m"
"""The sensor of a plot file that names none."""
_DRONE_ALTITUDE, _DRONE_PIXEL = 50.0, 0.025  # m, of the paper


def sensor_altitude(instrument: Instrument) -> float:
    """Usual height of a sensor above the ground [m]; in space where its file has none.

    **Arguments:**

    - `instrument`: as of `fynjax.io.instruments.load_sensor`.
    """
    frame = frame_of(instrument.camera)
    return SPACE if frame is None else float(frame.position[2])


def sensor_pixel(instrument: Instrument, altitude: float) -> float:
    """Side of a sensor's pixel on the ground straight below [m]: as its file states, else from its
    optics.

    **Arguments:**

    - `instrument`: as of `fynjax.io.instruments.load_sensor`.
    - `altitude`: above the ground [m]; without effect on a sensor with parallel lines of sight.
    """
    if isinstance(instrument.camera, OrthographicCamera):
        return instrument.camera.pixel_size
    return float(instrument.pixel(altitude))


def plot_sensor(table: SensorTable, sensor_file: Path | None, path: Path, text: str) -> Sensor:
    """The sensor of the plot file `path`, whose contents are `text`; `sensor_file` the
    sensor file that it names, if any."""
    name = table.name
    if sensor_file is None and name not in shipped_sensors():
        raise InputError(
            f"expected a shipped sensor ({', '.join(shipped_sensors())}) or a path, but got "
            f"{name!r}.{did_you_mean(name, shipped_sensors())}",
            file=path,
            row=line_of(text, ("sensor", "name")),
            column="sensor.name",
        )
    altitude, pixel = table.altitude_m, table.pixel_m
    if sensor_file is None and name == DRONE:
        altitude = _DRONE_ALTITUDE if altitude is None else altitude
        pixel = _DRONE_PIXEL if pixel is None else pixel
    else:
        with warnings.catch_warnings():  # whoever uses the sensor warns again
            warnings.simplefilter("ignore", UserWarning)
            instrument = load_sensor(name if sensor_file is None else sensor_file)
        name = instrument.name
        altitude = sensor_altitude(instrument) if altitude is None else altitude
        pixel = sensor_pixel(instrument, altitude) if pixel is None else pixel
    return Sensor(
        name,
        altitude,
        pixel,
        sensor_file,
        table.altitude_m,
        table.pixel_m,
        table.tilt_deg,
        table.heading_deg,
        table.noise,
        table.point_spread,
        tuple(Panel(**panel.model_dump()) for panel in table.panels),
    )


SPECTRA = (400.0, 2500.0)
"""Range of the spectra of leaves and ground, and so of a simulated plot [nm]."""


def visible_sensor(instrument: Instrument) -> Instrument:
    """A sensor without the bands that the spectra of a plot do not cover (400 to 2500 nm).

    **Arguments:**

    - `instrument`: as of `fynjax.io.instruments.load_sensor`.

    **Returns:** `instrument` itself where they cover all of its bands.

    **Raises:** `InputError` where they cover none.
    """
    places = instrument.bands.covered(np.arange(SPECTRA[0], SPECTRA[1] + 1.0))
    if not places:
        raise InputError(
            f"sensor {instrument.name!r} has no band within {SPECTRA[0]:g} to {SPECTRA[1]:g} nm, "
            "where leaves and ground have spectra"
        )
    return instrument if len(places) == len(instrument.bands) else instrument.select(places)


def plot_instrument(plot: Plot) -> Instrument:
    """The sensor that the file of `plot` names, with the bands that can be simulated.

    **Raises:** `InputError` as `fynjax.io.instruments.load_sensor` and `visible_sensor`.
    """
    return visible_sensor(load_sensor(plot.sensor.path or plot.sensor.name))


def drone_sensor(plot: Plot) -> Instrument:
    """A plot's sensor with its bands green, red, red edge and near infrared.

    **Arguments:**

    - `plot`: as of `read_plot`.

    **Returns:** the sensor with these four bands, in this order.

    **Raises:** `InputError` for a sensor without them, and for pixels wider than the plot.
    """
    instrument = plot_instrument(plot)
    bands = instrument.bands
    if missing := [name for name in BANDS if name not in bands.names]:
        raise InputError(
            f"expected a sensor with bands {', '.join(BANDS)}, but {plot.sensor.name!r} has no "
            f"{missing[0]}. Its products are made by `fynjax simulate {plot.file.name}`.",
            file=plot.file,
            column="sensor.name",
        )
    if plot.sensor.pixel_m > min(plot.size_m):
        raise InputError(
            f"expected a pixel of at most the plot's side, {min(plot.size_m):g} m, but "
            f"{plot.sensor.name!r} has {plot.sensor.pixel_m:g} m. Its products are made by "
            f"`fynjax simulate {plot.file.name}`.",
            file=plot.file,
            column="sensor.pixel_m",
        )
    return instrument.select([bands.names.index(name) for name in BANDS])


def plot_sun(table: SunTable, path: Path, text: str) -> Sun:
    """The sun of the plot file `path`, whose contents are `text`, from its angles or its time."""
    if table.time is None or table.latitude_deg is None or table.longitude_deg is None:
        return Sun(table.zenith_deg, table.azimuth_deg)

    def refused(message: str) -> InputError:
        row = line_of(text, ("sun", "time"))
        return InputError(message, file=path, row=row, column="sun.time")

    try:
        sun = sun_position(table.latitude_deg, table.longitude_deg, table.time)
    except InputError as error:
        raise refused(str(error)) from error
    lowest = PARAMETERS["sun_zenith"].upper
    if sun.zenith > lowest:
        raise refused(
            f"expected the sun at least {90.0 - lowest:g} degree above the horizon, but it is "
            f"{90.0 - sun.zenith:.2f} degrees above it at that time"
        )
    return Sun(sun.zenith, sun.azimuth, sun.solar_factor)


def plot_air(table: AtmosphereTable | None, file: Path | None) -> Air | None:
    """The air of a plot file; `None` where it says nothing of it."""
    if table is None:
        return None
    return Air(
        "file" if file is not None else table.model,
        file,
        table.water_vapour_cm,
        table.aerosol_optical_depth,
        table.ozone_cm_atm,
        table.pressure_hpa,
    )
