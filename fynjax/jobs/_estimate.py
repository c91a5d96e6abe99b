"""What a command would read and write, and about how long and how much memory it takes.

From counts (area, voxels, pixels, bands, steps, spectra) times costs measured on the example plot
on one core of a server: the page `docs/validation.md` and the comments below. Rough by
nature: right within a factor of two to three.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.memory import free_memory
from fynjax.assembly import stand_size
from fynjax.io.instruments import load_instrument
from fynjax.io.plot import Plot
from fynjax.io.raster import open_raster
from fynjax.io.text import existing_file
from fynjax.jobs._build import resized
from fynjax.jobs._result import Record
from fynjax.scene import visible_sensor
from fynjax.sensors import FlashGeometry, Lidar, Sensor

_START_S = 20.0
"""Reading, imports, tracing, planting and figures [CPU s]: `render` of 5 m takes 25 in all, once
compiled (busy machine)."""
_COMPILE_IMAGE_S, _COMPILE_GRADIENT_S, _COMPILE_SEARCH_S = 12.0, 40.0, 75.0
"""Compilation of an image, of its gradient, and of all programs of a calibration [CPU s]; it is
kept for later runs of the same sizes."""
_GRADIENT_IMAGES = 2.7
"""A gradient in images, at 10 and 20 m."""
_STEP_IMAGES = 2.6
"""A step of a search in images, were all steps taken: the example takes 250 CPU s with
compilation, its rounds at fresh draws of plants included, of which 9 of 30 steps were taken."""
_SLOPE_IMAGES = 0.3
"""A parameter's slopes in images: `information` takes 263 CPU s for two stands of the example."""
_PLANTINGS, _PLANTING_IMAGES, _METRIC_IMAGES = 8, 0.6, 0.11
"""`sensitivity`: plantings that the example needs, one of them in images, and the slopes of a
metric: planting 10 m takes 1.8 CPU s, slopes of four metrics 1.2."""
_PLOT_S, _COMPILE_PLOT_S = 72.0, 53.0
"""`calibrate-plots`: 18 plots of 5 m in voxels of 25 cm take 23 CPU minutes, 2 take 142 CPU s."""
_VALIDATED_S = 26.0
"""`validate-plots`: 2 plots of 5 m in voxels of 10 cm take 75 CPU s."""
_TRAIN_S, _SPECTRUM_S = 40.0, 0.018
"""`train`: 6000 steps, and a spectrum; 2000 spectra take 115 CPU s with compilation."""
_PIXEL_S = 1.0 / 23_000.0
"""`map`: a pixel of 425 bands."""
_PIXEL_STEP_S = 1.9
"""A step of the 16 walkers of a pixel's posterior: a stand each, planted and lit."""
_LEAF_START_S, _LEAF_S, _LEAF_BYTES = 10.0, 0.006, 17e3
"""What few leaves take and each of many that are fitted together [CPU s], and the least that a file
holds of one: 2151 bands of 8 bytes."""
_BUILD_S, _BUILD_AREA_S = 17.0, 0.013
"""`build`: reading, compilation and pictures, and a square metre of the example plot; 10 m take 17
CPU s, 20 m 22, a hectare some 150."""
_BUILD_GIB, _BUILD_AREA_GIB = 1.9, 6.2e-4
"""The same of memory: 10 m take 2.1, 20 m 2.4, a hectare 8.0."""
_LIDAR_S, _PULSE_S, _COMPILE_FLASH_S = 17.0, 3e-4, 18.0
"""A LiDAR over the example plot: reading, planting and figures, a pulse, and what a flash compiles
besides; a scanner's 314 pulses take 19 CPU s, 10 404 of a flash 38, 65 540 52."""
_LIDAR_GIB, _PULSE_GIB = 1.1, 1.3e-5
"""The same of memory: 1.0, 1.4 and 2.0."""
_POINT_BYTES = {".laz": 6.0, ".las": 30.0, ".ply": 15.0}
"""Of a point in a file of a cloud; of other files some 30, as text."""
_POINT_S, _POINT_GIB = 2.5e-6, 1.5e-7
"""`terrain`: 2 million points take 10 CPU s and 0.8 GiB, of which 5 and 0.5 are the start."""
_CLUSTERED_S, _CLUSTERED_GIB = 4.5e-7, 9e-8
"""`pattern`: a pixel; 4.3 million in four bands take 7.3 CPU s and 0.9 GiB, of which 5.5 and 0.55
are the start."""
_ELEMENT_S = 1.5e-5
"""`plant`: 5000 elements take 5.8 CPU s, 200 000 8.4."""
_PARAMETERS = 8
"""Parameters of a species that are free by default, those of the ground counted with them."""
_LONG_S = 60.0
"""Work that takes longer is announced."""
_START_GIB = 1.0
"""Memory of a process that has loaded everything."""


class Estimate(Record):
    """What a command would do. Writes nothing."""

    command: str
    reads: list[str]
    writes: str
    """Folder of the results."""
    counts: dict[str, str]
    """What there is to compute, by its name."""
    seconds: float | None
    """Time of one core, without compilation [s]; None where it was never measured."""
    compilation_s: float
    """Time of compilation where nothing is kept from earlier runs [s]."""
    memory_gib: float | None
    free_gib: float
    """Memory that this machine has free now."""

    def is_long(self) -> bool:
        """Whether a user wants to know the time before."""
        return self.seconds is not None and self.seconds + self.compilation_s >= _LONG_S

    def sentence(self) -> str:
        """Time and memory in a sentence."""
        if self.seconds is None or self.memory_gib is None:
            return "How long it takes was not measured for this command."
        return (
            f"Roughly {_shown(self.seconds)} of one core"
            + (
                f", and {_shown(self.compilation_s)} of compilation the first time"
                if self.compilation_s
                else ""
            )
            + f"; {self.memory_gib:.1f} GiB of memory ({self.free_gib:.1f} are free)."
        )


@dataclass(frozen=True)
class _Cost:
    counts: dict[str, str]
    seconds: float | None
    compilation: float
    memory: float | None


def estimate(
    command: str,
    output: str | Path,
    *,
    plot: Plot | None = None,
    files: Sequence[str | Path] = (),
    plots: int = 0,
    **options: Any,
) -> Estimate:
    """What a command would read and write, and about how long and how much memory it takes.

    **Arguments:**

    - `command`: its name on the command line.
    - `output`: folder of the results.
    - `plot`: as read, for commands that take a plot file.
    - `files`: what is read besides.
    - `plots`: number of plots, for commands that take field tables.
    - `options`: those of the job that change its cost; others are ignored.

    **Returns:** `Estimate`: numbers are right within a factor of two to three.

    **Raises:** `InputError` for a sensor that there is not, a pixel or an altitude that is no
    positive number, and a file that is read for its size and is none.

    Example: `jobs.estimate("render", "output", plot=read_plot("plot.toml")).sentence()`.
    """
    if plot is not None:
        cost = _plot_cost(command, plot, options)
    elif command == "fit-leaf":
        cost = _leaf_cost(files, options)
    elif command == "train":
        count = int(options["simulations"])
        seconds = _START_S + _TRAIN_S + _SPECTRUM_S * count
        cost = _Cost({"spectra": _count(count)}, seconds, _COMPILE_IMAGE_S, 1.5)
    elif command == "plant":
        elements = int(options["elements"])
        counts = {"plant": f"{_count(elements)} area elements"}
        cost = _Cost(counts, 6.0 + _ELEMENT_S * elements, 0.0, 0.7)
    elif command == "terrain":
        cost = _cloud_cost(files)
    elif command == "pattern":
        cost = _pattern_cost(files)
    elif command == "map":
        pixels, bands = int(options["pixels"]), int(options["bands"])
        counts = {"cube": f"{_count(pixels)} pixels in {bands} bands"}
        seconds, steps = _PIXEL_S * pixels * bands / 425.0, int(options.get("steps", 0))
        if steps:
            counts["posteriors"] = f"{_count(steps)} steps of emcee"
        compilation = 2.0 * _COMPILE_IMAGE_S if steps else 0.0
        cost = _Cost(counts, _START_S + seconds + _PIXEL_STEP_S * steps, compilation, 1.5)
    else:
        cost = _tables_cost(command, plots, options)
    inputs = [] if plot is None else [plot.file, *plot.inputs]
    return Estimate(
        command=command,
        reads=list(dict.fromkeys(str(p) for p in (*inputs, *files))),
        writes=str(output),
        counts=cost.counts,
        seconds=cost.seconds,
        compilation_s=cost.compilation,
        memory_gib=cost.memory,
        free_gib=free_memory() / 2**30,
    )


def _plot_cost(command: str, plot: Plot, options: Mapping[str, Any]) -> _Cost:
    if command == "build":
        size = options.get("size")
        plot = plot if size is None else resized(plot, size)
        area = float(np.prod(plot.size_m))
        memory = _BUILD_GIB + _BUILD_AREA_GIB * area
        return _Cost(_scene_counts(plot), _BUILD_S + _BUILD_AREA_S * area, 0.0, memory)
    chosen = options.get("sensor") or plot.sensor.path or plot.sensor.name
    sensor = chosen if isinstance(chosen, (Sensor, Lidar)) else load_instrument(chosen)
    counts, seconds, gradient = _scene_counts(plot), 0.0, command not in ("render", "simulate")
    if isinstance(sensor, Lidar):
        top = max(plot.height_m, default=0.0)
        pulses = len(sensor.beams(plot.size_m, top=top, seed=plot.seed))
        counts["sensor"] = f"LiDAR {sensor.name}, {_count(pulses)} pulses"
        compilation = _COMPILE_FLASH_S if isinstance(sensor.geometry, FlashGeometry) else 0.0
        memory = _LIDAR_GIB + _PULSE_GIB * pulses
        return _Cost(counts, _LIDAR_S + _PULSE_S * pulses, compilation, memory)
    bands, pixels = len(visible_sensor(sensor).bands), _pixels(plot, sensor, options)
    counts["image"] = f"{_count(pixels)} pixels in {bands} bands"
    image = _image_seconds(plot, pixels, bands)
    compilation = _COMPILE_GRADIENT_S if gradient else _COMPILE_IMAGE_S
    if command in ("calibrate", "demo", "posterior"):
        steps = plot.calibration.max_iterations * plot.calibration.starts
        counts["search"] = f"at most {steps} steps"
        seconds, compilation = _STEP_IMAGES * steps * image, _COMPILE_SEARCH_S
    elif command == "sensitivity":
        parameters = _PARAMETERS * len(plot.species)
        samples = int(options.get("derivative_samples", 0))
        renders = int(options.get("sobol_samples", 0)) * (parameters + 2)
        counts["samples"] = f"{samples} with derivatives, {renders} renders"
        most = int(options.get("plantings", _PLANTINGS))
        counts["plantings"] = f"at most {most}, of which slopes are taken"
        plantings = min(most, _PLANTINGS)
        slopes = _METRIC_IMAGES * len(options.get("metrics", ("one",)))
        seconds = image * (_PLANTING_IMAGES * plantings + slopes * (plantings + samples) + renders)
    elif command == "information":
        suns = options.get("sun_zenith") or (0.0,)
        stands = len(suns) * int(options.get("realisations", 4))
        counts["stands"] = f"{stands} of which slopes are taken"
        seconds = stands * _PARAMETERS * len(plot.species) * _SLOPE_IMAGES * image
    else:
        seconds = image
    memory = _image_gib(plot, gradient=gradient)
    return _Cost(counts, _START_S + seconds, compilation, memory)


def _scene_counts(plot: Plot) -> dict[str, str]:
    """Voxels and plants of a plot."""
    plants, elements = stand_size(plot)
    side = [round(size / plot.voxel_m) for size in plot.size_m]
    layers = math.ceil(max(plot.height_m, default=0.0) / plot.voxel_m)
    return {
        "plot": f"{plot.size_m[0]:g} m x {plot.size_m[1]:g} m, {side[0]} x {side[1]} x {layers} "
        f"voxels of {100 * plot.voxel_m:g} cm",
        "plants": f"{_count(plants)} of {len(plot.species)} species, {_count(elements)} area "
        "elements",
    }


def _pixels(plot: Plot, sensor: Sensor, options: Mapping[str, Any]) -> float:
    own = plot.sensor.name == sensor.name
    for name in ("pixel", "altitude"):
        given = options.get(name)
        if given is not None and not 0.0 < given < math.inf:
            raise InputError(f"`{name}` must be a positive number of m, but is {given:g}")
    pixel = options.get("pixel") or (plot.sensor.pixel_m if own else None)
    if pixel is None:
        height = options.get("altitude") or (plot.sensor.altitude_m if own else None)
        pixel = float(sensor.pixel(height))
    return float(np.prod(np.ceil(np.array(plot.size_m) / pixel)))


def _image_seconds(plot: Plot, pixels: float, bands: int) -> float:
    """Time of an image on one core [s], after compilation.

    The example plot of 10 m takes 3 s, whatever its voxels, a hectare 185 s with all files; 416
    bands take 7.2 times one.
    """
    area = float(np.prod(plot.size_m))
    own = 0.5 + 1.6 * area / 100.0 + 0.4 * area / plot.voxel_m**2 / 1e4 + 0.4 * pixels / 1.6e5
    return own * (min(bands, 8) / 4.0 + max(bands - 8, 0) / 40.0)


def _image_gib(plot: Plot, *, gradient: bool) -> float:
    """Memory of an image, or of its gradient [GiB].

    The example plot takes 0.9 (10 m), 2.4 (20 m), with voxels of 2.5 cm 2.0, a hectare, whose
    plants are made window by window, 8.7; a gradient 2.3, 4.8, and 4.3.
    """
    area = float(np.prod(plot.size_m)) / 100.0
    structured = area if area <= 9.0 else 9.0 + 0.04 * (area - 9.0)
    own = 0.4 * structured + 0.07 * area * 0.01 / plot.voxel_m**2
    return _START_GIB + (_GRADIENT_IMAGES * own if gradient else own)


def _cloud_cost(files: Sequence[str | Path]) -> _Cost:
    """Of a cloud, or of a height raster, which costs less, by the size of the file."""
    size = sum(existing_file(p, "a cloud or a height raster").stat().st_size for p in files)
    points = sum(
        Path(p).stat().st_size / _POINT_BYTES.get(Path(p).suffix.lower(), 30.0) for p in files
    )
    counts = {"file": f"{size / 1e6:.3g} MB, about {_count(points)} points if it is a cloud"}
    return _Cost(counts, 5.0 + _POINT_S * points, 0.0, 0.5 + _POINT_GIB * points)


def _pattern_cost(files: Sequence[str | Path]) -> _Cost:
    with open_raster(files[0], "an image") as raster:
        pixels, bands = raster.dataset.width * raster.dataset.height, raster.dataset.count
    counts = {"image": f"{_count(pixels)} pixels in {max(bands, len(files))} bands"}
    return _Cost(counts, 5.5 + _CLUSTERED_S * pixels, 0.0, 0.55 + _CLUSTERED_GIB * pixels)


def _leaf_cost(files: Sequence[str | Path], options: Mapping[str, Any]) -> _Cost:
    there = [p for f in map(Path, files) for p in (f.rglob("*") if f.is_dir() else [f])]
    size = sum(p.stat().st_size for p in there if p.is_file())
    most = max(1, round(size / _LEAF_BYTES))
    counts = {"spectra": f"at most about {most} in {len(there)} files of {size / 1e6:.3g} MB"}
    if options.get("posterior", "none") != "none":
        return _Cost(counts, None, 0.0, None)
    return _Cost(counts, _LEAF_START_S + _LEAF_S * most, 30.0, _START_GIB + most * 4e5 / 2**30)


def _tables_cost(command: str, plots: int, options: Mapping[str, Any]) -> _Cost:
    counts = {"plots": str(plots)}
    resolution = options.get("resolution")
    if command not in ("calibrate-plots", "validate-plots") or resolution is None:
        return _Cost(counts, None, 0.0, None)
    columns = (resolution.size_m / resolution.voxel_m) ** 2
    counts["voxels"] = f"{columns:g} columns a plot"
    if command == "validate-plots":
        seconds = _START_S + plots * _VALIDATED_S * columns / 2500.0
        return _Cost(counts, seconds, _COMPILE_IMAGE_S, 1.7)
    return _Cost(counts, plots * _PLOT_S * columns / 400.0, _COMPILE_PLOT_S, 2.1)


def _count(number: float) -> str:
    """A count to two digits, such as 4 200."""
    return f"{float(f'{number:.2g}'):,.0f}".replace(",", " ")


def _shown(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 90.0:
        return f"{seconds:.1g} s" if seconds < 10.0 else f"{round(seconds, -1):g} s"
    minutes = seconds / 60.0
    if minutes < 90.0:
        return f"{minutes:.1g} min" if minutes < 10.0 else f"{round(minutes, -1):g} min"
    return f"{minutes / 60.0:.2g} h"
