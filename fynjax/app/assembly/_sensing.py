"""From a plot's files and a sensor to a simulation of what it measures."""

import dataclasses
import warnings

from fynjax._core.errors import InputError, in_file
from fynjax.app.io.instruments import read_atmosphere
from fynjax.app.io.plot import AtmosphereTable, Plot, sensor_place
from fynjax.scene import AimedSensor, Placement, PlotAir, PlotParameters, Scene, aim, visible_sensor
from fynjax.sensors import Atmosphere, OrthographicCamera, Sensor, frame_of

_DISAGREE = 0.02  # share by which a pixel may differ from the optics without a warning


def aim_at_plot(
    plot: Plot,
    scene: Scene,
    parameters: PlotParameters,
    instrument: Sensor,
    *,
    altitude: float | None = None,
    pixel: float | None = None,
    air: AtmosphereTable | None = None,
    quiet: bool = False,
) -> AimedSensor:
    """A sensor over the scene of a plot, from where the plot file has it.

    What the plot file says of its sensor counts where `instrument` has the same name. Bands that
    the spectra of a plot do not cover are left out.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `scene`, `parameters`: of the plot, from `build_plot`.
    - `instrument`: from `load_sensor`.
    - `altitude`: above the ground, and `pixel`: on it [m], instead of the plot file's.
    - `air`: instead of the plot file's.
    - `quiet`: without warnings.

    **Returns:** an `AimedSensor`. Warns where altitude and pixel are both given and the sensor
    has another (the given one is used), and where the plot is wider than an image of the sensor.

    **Raises:** `InputError` as `fynjax.scene.aim` and where the air does not reach to the sun of
    `parameters`.
    """
    own = plot.sensor.name == instrument.name
    place = plot.sensor.placement if own else Placement()
    altitude = place.altitude if altitude is None else altitude
    pixel = place.pixel if pixel is None else pixel
    if not quiet and pixel is not None:
        _check_pixel(instrument, instrument.altitude if altitude is None else altitude, pixel)
    air = air or plot.air or AtmosphereTable()
    if air.source != "none" and scene.sky is not None and plot.air is not None:
        raise InputError(
            "expected a table of the sky's share in [sky] or an [atmosphere], which has its own, "
            "but got both: leave one out",
            file=plot.file,
            column="sky.table",
        )
    with in_file(plot.file):
        aimed = aim(
            scene,
            parameters,
            visible_sensor(instrument),
            dataclasses.replace(place, altitude=altitude, pixel=pixel),
            air=_air(plot, air),
            point_spread=plot.sensor.point_spread,
            panels=plot.sensor.panels if own and air.source != "none" else (),
        )
        aimed.check(parameters)
    if not quiet:
        _check_swath(plot, instrument, aimed.pixel)
    return aimed


def aim_without_air(
    plot: Plot,
    scene: Scene,
    parameters: PlotParameters,
    instrument: Sensor,
    *,
    pixel: float | None = None,
) -> AimedSensor:
    """A sensor over the scene of a plot as its file has it, for reflectance under the plot's own
    sky: what `render` shows and a calibration compares.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `scene`, `parameters`: of the plot, from `build_plot`.
    - `instrument`: from `load_sensor`.
    - `pixel`: on the ground [m], instead of the plot file's.

    **Raises:** `InputError` as `aim_at_plot`.
    """
    altitude, usual = sensor_place(plot)
    return aim_at_plot(
        plot,
        scene,
        parameters,
        instrument,
        altitude=altitude,
        pixel=usual if pixel is None else pixel,
        air=AtmosphereTable(model="none"),
        quiet=True,
    )


def _check_pixel(instrument: Sensor, height: float, pixel: float) -> None:
    """Warn where the sensor's own pixel at a height above the ground [m] is another [m]."""
    usual = float(instrument.pixel(height))
    fixed = isinstance(instrument.camera, OrthographicCamera)
    if not fixed and abs(pixel / usual - 1.0) > _DISAGREE:
        warnings.warn(
            f"{instrument.name}: the pixel of {pixel:g} m is used, but the sensor has one of "
            f"{usual:.4g} m at {height:g} m above the ground; the pixel would need an altitude "
            f"of {height * pixel / usual:.4g} m.",
            UserWarning,
            stacklevel=3,
        )


def _check_swath(plot: Plot, instrument: Sensor, pixel: float) -> None:
    """Warn where a plot is wider than the sensor's image."""
    frame = frame_of(instrument.camera)
    if frame is None:
        return
    rows, columns = frame.shape
    across = pixel * columns
    along = across if rows == 1 else pixel * rows
    if plot.size_m[0] > across + pixel or plot.size_m[1] > along + pixel:
        warnings.warn(
            f"{instrument.name}: the plot of {plot.size_m[0]:g} m x {plot.size_m[1]:g} m is larger "
            f"than an image of the sensor, {across:.4g} m x {along:.4g} m; what lies beyond is "
            "simulated as if its field of view were wider.",
            UserWarning,
            stacklevel=3,
        )


def _air(plot: Plot, air: AtmosphereTable) -> PlotAir | Atmosphere | None:
    if air.file is not None:
        return read_atmosphere(air.file)
    if air.model == "none":
        return None
    return PlotAir(
        model=air.model,
        water_vapour=air.water_vapour_cm,
        ozone=air.ozone_cm_atm,
        pressure=air.pressure_hpa,
        solar_factor=plot.sun.solar_factor,
        aerosol=air.aerosol_optical_depth,
    )
