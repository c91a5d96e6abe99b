"""The job of `fynjax simulate` with an imaging sensor: radiance, reflectance, their record."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work, image_size
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import aim_at_plot, build_plot
from fynjax.app.io.instruments import load_instrument
from fynjax.app.io.plot import AtmosphereTable, Place, Plot, as_plot, plot_place
from fynjax.app.io.raster import Cube, write_cube_envi, write_cube_geotiff, write_cubes_netcdf
from fynjax.app.io.text import write_text
from fynjax.app.jobs._render import check_finite, cube_pictures, write_truth
from fynjax.app.jobs._result import JobResult
from fynjax.app.jobs._run import Run
from fynjax.app.jobs._simulate_angles import SimulateAnglesResult, simulate_angles
from fynjax.app.jobs._simulate_lidar import SimulateLidarResult, simulate_lidar
from fynjax.app.jobs._simulate_record import run_record, warnings_of
from fynjax.app.report.pages import Page, Picture, Section
from fynjax.scene import (
    AimedSensor,
    Observation,
    PlotParameters,
    Scene,
    check_image,
    hard_scene,
    truth_of_pixels,
)
from fynjax.sensors import Lidar, Sensor

AIR_MODELS = ("table", "clear-sky", "none")
"""Models of the air that stand in place of a file."""
PRODUCTS = ("reflectance", "radiance")
"""Image products that can be written."""


class SimulateResult(JobResult):
    """What `simulate` measured with an imaging sensor."""

    command: Literal["simulate"] = "simulate"
    bands: int
    pixels: tuple[int, int]
    """Rows and columns of the image."""
    pixel_m: float
    noise: bool


@double_precision
def simulate(
    plot: Plot | str | Path,
    output: str | Path,
    *,
    sensor: str | Path | Sensor | Lidar | None = None,
    altitude: float | None = None,
    pixel: float | None = None,
    atmosphere: str | Path | None = None,
    noise: bool | None = None,
    products: Sequence[str] = PRODUCTS,
    truth: bool = False,
    angles: bool = False,
    seed: Seed | None = None,
) -> SimulateResult | SimulateLidarResult | SimulateAnglesResult:
    """Simulate what any sensor measures over a plot: a camera, a spectrometer or a LiDAR.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `output`: folder of the results, made if missing.
    - `sensor`: name of a shipped sensor (aviris_ng, emit, mavic_3m, flash_lidar_paper, ...) or a
      sensor file; the plot file's if left out. From Python a sensor or a LiDAR, too.
    - `altitude`: height above the ground [m]; that of the plot file, where it names this sensor, or
      else of the sensor file, if left out.
    - `pixel`: side of a pixel [m]; as `altitude`, or else from the optics, if left out.
    - `atmosphere`: kind of atmosphere: table (6S), clear-sky or none, or a file of curves of your
      own (CSV, NetCDF); the plot file's if left out, or else table.
    - `noise`: draw noise; left out, as the plot file says, or else if the sensor has a model of it.
    - `products`: image to write, reflectance or radiance; both if left out.
    - `truth`: also write which species each pixel sees, and how much, and of the ground, as
      `truth.tif` and `truth.nc`; of a LiDAR's returns it is written always.
    - `angles`: in place of an image, the reflectance factor of the plot from every direction, under
      the sun alone, in the sensor's bands.
    - `seed`: seed of plants and noise; the plot file's if left out.

    **Returns:** `SimulateResult` for an imaging sensor, with radiance and reflectance (GeoTIFF,
    ENVI, NetCDF); `SimulateLidarResult` for a LiDAR. Writes the products, `run.json`, figures and a
    page into `output`. A LiDAR, whose file says where it flies and
    how noisy it is (`noise=False`: the receiver without noise), gives waveforms and a point cloud;
    `angles` a `SimulateAnglesResult`, `angles.nc` and `principal_plane.csv`.

    **Raises:** `InputError` as `read_plot`, `load_instrument` and `aim_at_plot`, for noise of a
    sensor that has no model of it, for altitude, pixel, atmosphere or a choice of products with a
    LiDAR or `angles`, and for truth or noise with `angles`; `MissingExtraError` for a LiDAR without
    laspy and lazrs.

    Example: `jobs.simulate("plot.toml", Path("results"), sensor="mavic_3m")`.
    """
    read = as_plot(plot)
    run = Run(output, seed=seed, plot=read)
    name = sensor or read.sensor.path or read.sensor.name
    instrument = name if isinstance(name, (Sensor, Lidar)) else load_instrument(name)
    files = [] if isinstance(name, (Sensor, Lidar)) or not Path(name).is_file() else [Path(name)]
    if angles or isinstance(instrument, Lidar):
        given = {"altitude": altitude, "pixel": pixel, "atmosphere": atmosphere}
        given |= {"truth": truth or None, "noise": noise or None} if angles else {}
        wrong = [option for option, value in given.items() if value is not None]
        _refuse([*wrong, *["product"] * (tuple(products) != PRODUCTS)], instrument, angles)
        if isinstance(instrument, Lidar):
            return simulate_lidar(run, read, instrument, noise=noise is not False, files=files)
        return simulate_angles(run, read, instrument, files=files)
    air = read.air or AtmosphereTable()
    if atmosphere is not None:
        named = str(atmosphere) in AIR_MODELS
        air = (
            air.replace(model=str(atmosphere), file=None)
            if named
            else AtmosphereTable(file=Path(atmosphere))
        )
    asked = read.sensor.noise if noise is None and _is_own(read, instrument) else noise
    noisy = instrument.noise is not None and air.source != "none" if asked is None else asked
    _check(read, instrument, air, noisy, products)
    with run.stage("Build the plot", "build"):
        scene, parameters = build_plot(read, seed=run.seed)
        aimed = aim_at_plot(
            read, scene, parameters, instrument, altitude=altitude, pixel=pixel, air=air
        )
        check_image(aimed, scene, parameters)
    size = image_size(aimed.shape, len(instrument.bands))
    written = [name for name in products if name != "radiance" or air.source != "none"]
    layers = image_size(aimed.shape, 4 * len(scene.taxa) + 2)
    shares = {"truth.tif": layers, "truth.nc": layers} if truth else {}
    files_made = {f"{name}.tif": size for name in written} | {"product.nc": size}
    begin_work(files_made | {"report.html": "", **shares})
    with run.stage("Measure"):
        # Plants that do not stand take time and memory only.
        stand = hard_scene(scene, parameters)
        observation = _measure(aimed, stand, parameters, run.seed if noisy else None, run)
        seen = truth_of_pixels(aimed, stand, parameters) if truth else None
    cubes = _cubes(aimed, instrument, observation, products, plot_place(read))
    for name, cube in cubes.items():
        check_finite(cube.values[cube.good], read, name)
    record = run.record([*read.inputs, *files, air.file])
    made = run_record(read, instrument, aimed, air, noisy, observation, run.seconds)
    with run.stage("Write"):
        picture = [] if seen is None else [write_truth(run, read, scene, seen, record)]
        as_text = {k: json.dumps(made[k]) for k in ("plot", "sensor", "atmosphere", "accuracy")}
        said = _headline(read, instrument, aimed, cubes, run.seconds)[0]
        _write(run, read, instrument, cubes, picture, {**record, **as_text}, said)
        text = json.dumps({**record, **made}, indent=2, ensure_ascii=False, allow_nan=False)
        path = run.path("run.json", "versions, seed, sensor, atmosphere, accuracy, times")
        write_text(path, text + "\n")
    return run.result(
        SimulateResult,
        headline=_headline(read, instrument, aimed, cubes, run.seconds),
        bands=len(aimed.sensor.bands),
        pixels=aimed.shape,
        pixel_m=aimed.pixel,
        noise=bool(noisy),
        warnings=warnings_of(read, aimed, instrument),
    )


def _refuse(options: Sequence[str], instrument: Sensor | Lidar, angles: bool) -> None:
    """Say what a LiDAR, or reflectance by angle, has no use for."""
    lidar = isinstance(instrument, Lidar)
    if lidar and angles:
        raise InputError(f"expected a sensor with bands, but {instrument.name!r} is a LiDAR")
    if options and lidar:
        raise InputError(
            f"expected no {options[0]} with the LiDAR {instrument.name!r}: its file says all of it"
        )
    if options:
        raise InputError(
            f"expected no {options[0]} with angles: they are of the plot, not of an image"
        )


def _is_own(plot: Plot, instrument: Sensor) -> bool:
    return plot.sensor.name == instrument.name


def _check(
    plot: Plot, instrument: Sensor, air: AtmosphereTable, noisy: bool, products: Sequence[str]
) -> None:
    if not products or any(product not in PRODUCTS for product in products):
        got = ", ".join(products) or "none"
        raise InputError(f"expected products among {', '.join(PRODUCTS)}, but got {got}")
    if air.source == "none":
        if plot.sensor.panels and _is_own(plot, instrument):
            raise InputError("expected an atmosphere: panels calibrate radiance", file=plot.file)
        if "reflectance" not in products:
            raise InputError("expected an atmosphere: without air there is no radiance")
        if noisy:
            raise InputError("expected an atmosphere: noise is that of radiance")
    if noisy and instrument.noise is None:
        raise InputError(
            f"expected a sensor with a model of its noise, but {instrument.name!r} has none. Leave "
            "noise out (--no-noise), or give a sensor file of your own a [noise] table.",
            file=plot.file if _is_own(plot, instrument) else None,
        )


def _measure(
    aimed: AimedSensor, scene: Scene, parameters: PlotParameters, seed: int | None, job: Run
) -> Observation:
    """The observation, with the noise of `seed`; times of compiling and of measuring apart."""
    # The air is the same for all bands and pixels: its table need not be compiled with them.
    aimed = dataclasses.replace(aimed, air=aimed.check(parameters))
    key = None if seed is None else jax.random.key(seed)
    observe: Any = _observe
    with job.timed("compile_bands"):
        compiled = observe.lower(aimed, scene, parameters, key).compile()
    with job.timed("bands"):
        return jax.block_until_ready(compiled(aimed, scene, parameters, key))


@eqx.filter_jit
def _observe(
    aimed: AimedSensor, scene: Scene, parameters: PlotParameters, key: Array | None
) -> Observation:
    return aimed.observe(scene, parameters, key=key)


def _cubes(
    aimed: AimedSensor,
    instrument: Sensor,
    observation: Observation,
    products: Sequence[str],
    place: Place,
) -> dict[str, Cube]:
    """Images of all of the sensor's bands; those that were left out are bad."""
    every, bands = instrument.bands, aimed.sensor.bands
    places = [every.names.index(name) for name in bands.names]

    def cube(name: str, image: Array, good: Bool[np.ndarray, " band"]) -> Cube:
        values = np.full((len(every), *aimed.shape), np.nan)
        flags = np.zeros(len(every), bool)
        flags[places] = good
        values[places] = np.where(good[:, None, None], image, np.nan)
        return Cube(
            values,
            every.names,
            np.asarray(every.centre),
            np.asarray(every.fwhm),
            flags,
            aimed.pixel,
            place.corner(aimed.origin),
            name,
            place.crs,
        )

    cubes = {}
    if "reflectance" in products:
        clear = np.asarray(observation.transparent)
        cubes["reflectance"] = cube("reflectance", observation.reflectance, clear)
        if observation.reflectance_sd is not None:
            cubes["reflectance_sd"] = cube("reflectance_sd", observation.reflectance_sd, clear)
    if "radiance" in products and observation.radiance is not None:
        cubes["radiance"] = cube("radiance", observation.radiance, np.ones(len(bands), bool))
    return cubes


def _write(
    run: Run,
    plot: Plot,
    instrument: Sensor,
    cubes: dict[str, Cube],
    more: list[Picture],
    record: dict[str, Any],
    said: str,
) -> None:
    """Write the products and the page, with `more` pictures at its end."""
    for name, cube in cubes.items():
        write_cube_geotiff(run.path(f"{name}.tif", f"{name}, GeoTIFF"), cube, record)
        header = run.path(f"{name}.hdr", f"{name}, ENVI: header of {name}.dat")
        write_cube_envi(header, cube, record)
    path = run.path("product.nc", f"{' and '.join(cubes)}, NetCDF")
    write_cubes_netcdf(path, cubes, record)
    lead = f"What {instrument.name} measures of the plot."
    sections = [Section("", [*cube_pictures(cubes, plot.name), *more])]
    run.page(Page("simulate", plot.name, lead, sections, record=record, result=said))


def _headline(
    plot: Plot,
    instrument: Sensor,
    aimed: AimedSensor,
    cubes: dict[str, Cube],
    seconds: dict[str, float],
) -> list[str]:
    rows, columns = aimed.shape
    count = len(aimed.sensor.bands)
    lines = [
        f"{plot.name}: {count} bands of {instrument.name}, {columns} x {rows} pixels of "
        f"{aimed.pixel:.4g} m."
    ]
    for cube in cubes.values():
        mean = float(cube.values[cube.good].mean())
        unit = " W m-2 sr-1 um-1" if cube.quantity == "radiance" else ""
        lines.append(f"Mean {cube.quantity} of {int(cube.good.sum())} bands: {mean:.4g}{unit}.")
    lines.append(f"{seconds['bands']:.1f} s; compilation {seconds['compile_bands']:.1f} s.")
    return lines
