"""What `fynjax simulate` does with an imaging sensor: radiance, reflectance, products, record."""

import dataclasses
import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from fynjax._core.errors import InputError, MissingExtraError
from fynjax._core.progress import NullProgress, Progress
from fynjax.io import Plot, load_sensor, provenance, read_plot, write_text
from fynjax.io._plot import Air
from fynjax.io._plot_sensing import build_sensing
from fynjax.io._plot_sensor import optical_pixel
from fynjax.io._products import Cube, write_cube_envi, write_cube_geotiff, write_cubes_netcdf
from fynjax.report._figure_style import save_figure
from fynjax.report._jobs import _Clock, peak_memory_mib
from fynjax.report._page import Page
from fynjax.report._simulate_figures import quick_looks, spectrum_figure
from fynjax.scene import Observation, PlotAir, PlotParameters, PlotSensing
from fynjax.sensors import OrthographicCamera, Sensor, frame_of

AIR_MODELS = ("table", "clear-sky", "none")
"""What an atmosphere may be named by, instead of a file."""
PRODUCTS = ("reflectance", "radiance")
_ONE_BAND = 860.0  # nm, of the band that the time of all is compared with


def run_simulate(
    plot: str | Path,
    output: Path,
    *,
    sensor: str | Path | None = None,
    altitude: float | None = None,
    pixel: float | None = None,
    atmosphere: str | Path | None = None,
    noise: bool | None = None,
    products: Sequence[str] = PRODUCTS,
    seed: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Simulate what an imaging sensor measures over a plot file, into the folder `output`.

    **Arguments:**

    - `sensor`: name of a shipped sensor or path of a sensor file; the plot file's if left out.
    - `altitude` above the ground and `pixel` on it [m]: instead of those of the plot file, where
      it names this sensor, or else of the sensor's own file.
    - `atmosphere`: 'table', 'clear-sky' or 'none', or a file of curves (`read_atmosphere`); the
      plot file's if left out, or else 'table'.
    - `noise`: whether to draw it; left out, as the plot file says, or else if the sensor has a
      model of it.
    - `products`: any of `PRODUCTS`.
    - `seed`: of plants and noise; the plot file's if left out.

    **Returns:** the summary: headline, files, times [s], memory [MiB], warnings.

    **Raises:** `InputError` as `read_plot`, `load_sensor` and `build_sensing`, and for noise of a
    sensor that has no model of it.
    """
    progress = NullProgress() if progress is None else progress
    read = read_plot(plot)
    chosen = read.seed if seed is None else seed
    name = sensor or read.sensor.path or read.sensor.name
    instrument = load_sensor(name)
    air = _chosen_air(read, atmosphere)
    asked = read.sensor.noise if noise is None and _is_own(read, instrument) else noise
    noisy = instrument.noise is not None and air.model != "none" if asked is None else asked
    _check(read, instrument, air, noisy, products)
    seconds: dict[str, float] = {}
    with progress.stage("Build the plot"), _Clock(seconds, "build"):
        place: dict[str, Any] = {"seed": chosen, "altitude": altitude, "pixel": pixel, "air": air}
        sensing, parameters = build_sensing(read, instrument, **place)
    with progress.stage("Measure"):
        seen = _measure(sensing, parameters, chosen if noisy else None, seconds, "bands")
    reduced = _is_reduced(sensing)
    if reduced:
        with progress.stage("Measure one band, for comparison"):
            _measure_one(read, instrument, sensing, place, seconds)
    cubes = _cubes(sensing, instrument, seen, products)
    _check_finite(cubes, read)
    inputs = [*read.inputs, *(Path(p) for p in (name, air.file) if p and Path(p).is_file())]
    record = provenance(seed=chosen, inputs=dict.fromkeys(inputs))
    run = _record(read, instrument, sensing, air, noisy, seen, seconds)
    with progress.stage("Write"):
        files, warnings = _write(output, read, instrument, cubes, {**record, **_short(run)})
        text = json.dumps({**record, **run}, indent=2, ensure_ascii=False, allow_nan=False)
        write_text(output / "run.json", text + "\n")
    return {
        "headline": _headline(read, instrument, sensing, cubes, seconds, reduced),
        "files": files,
        "timings_s": seconds,
        "bands": len(sensing.sensor.bands),
        "pixels": list(sensing.shape),
        "pixel_m": sensing.pixel,
        "noise": bool(noisy),
        "peak_memory_mib": peak_memory_mib(),
        "warnings": [
            *_left_out(sensing, instrument),
            *_of_other_pixels(sensing),
            *_of_slant(sensing),
            *warnings,
        ],
    }


def _is_own(plot: Plot, instrument: Sensor) -> bool:
    return plot.sensor.name == instrument.name


def _chosen_air(plot: Plot, atmosphere: str | Path | None) -> Air:
    given = plot.air or Air()
    if atmosphere is None:
        return given
    if str(atmosphere) in AIR_MODELS:
        return dataclasses.replace(given, model=str(atmosphere), file=None)
    return Air(model="file", file=Path(atmosphere))


def _check(plot: Plot, instrument: Sensor, air: Air, noisy: bool, products: Sequence[str]) -> None:
    if strange := [p for p in products if p not in PRODUCTS] or not products:
        raise InputError(f"expected products among {', '.join(PRODUCTS)}, but got {strange}")
    if air.model == "none":
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
    sensing: PlotSensing,
    parameters: PlotParameters,
    key: int | None,
    seconds: dict[str, float],
    name: str,
) -> Observation:
    """The observation; times of compiling and of measuring apart."""
    # The air is the same for all bands and pixels: its table need not be compiled with them.
    sensing = dataclasses.replace(sensing, air=sensing.check(parameters))

    def run(sensing: PlotSensing, parameters: PlotParameters) -> Observation:
        return sensing.observe(parameters, key=key)

    observe: Any = eqx.filter_jit(run)
    with _Clock(seconds, f"compile_{name}"):
        compiled = observe.lower(sensing, parameters).compile()
    with _Clock(seconds, name):
        return jax.block_until_ready(compiled(sensing, parameters))


def _is_reduced(sensing: PlotSensing) -> bool:
    solves = sensing.model.accuracy.solves
    return solves is not None and len(sensing.sensor.bands) > solves


def _measure_one(
    plot: Plot,
    instrument: Sensor,
    sensing: PlotSensing,
    place: dict[str, Any],
    seconds: dict[str, float],
) -> None:
    """Time the same with one band."""
    centre = np.asarray(sensing.sensor.bands.centre)
    name = sensing.sensor.bands.names[int(np.argmin(np.abs(centre - _ONE_BAND)))]
    one = instrument.select([instrument.bands.names.index(name)])
    place = {**place, "pixel": sensing.pixel}
    alone, parameters = build_sensing(plot, one, **place, quiet=True)
    _measure(alone, parameters, None, seconds, "one_band")
    seconds["ratio_to_one_band"] = seconds["bands"] / seconds["one_band"]


def _cubes(
    sensing: PlotSensing, instrument: Sensor, seen: Observation, products: Sequence[str]
) -> dict[str, Cube]:
    """Images of all of the sensor's bands; those that were left out are bad."""
    every, bands = instrument.bands, sensing.sensor.bands
    places = [every.names.index(name) for name in bands.names]

    def cube(name: str, image: Any, good: Any) -> Cube:
        values = np.full((len(every), *sensing.shape), np.nan)
        flags = np.zeros(len(every), bool)
        flags[places] = good
        values[places] = np.where(np.asarray(good)[:, None, None], image, np.nan)
        return Cube(
            values,
            every.names,
            np.asarray(every.centre),
            np.asarray(every.fwhm),
            flags,
            sensing.pixel,
            sensing.origin,
            name,
        )

    found = {}
    if "reflectance" in products:
        found["reflectance"] = cube("reflectance", seen.reflectance, np.asarray(seen.transparent))
    if "radiance" in products and seen.radiance is not None:
        found["radiance"] = cube("radiance", seen.radiance, np.ones(len(bands), bool))
    return found


def _check_finite(cubes: dict[str, Cube], plot: Plot) -> None:
    for name, cube in cubes.items():
        bad = int((~np.isfinite(cube.values[cube.good])).sum())
        if bad:
            raise InputError(
                f"{bad} values of the {name} are not finite. Is the sun near the horizon, or a "
                "parameter at the end of its range?",
                file=plot.file,
            )


def _record(
    plot: Plot,
    instrument: Sensor,
    sensing: PlotSensing,
    air: Air,
    noisy: bool,
    seen: Observation,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """What made the product, for `run.json`."""
    camera, accuracy = sensing.sensor.camera, sensing.model.accuracy
    optics = optical_pixel(instrument, sensing.sensor_height)
    frame, angles = frame_of(camera), {}
    if frame is not None:
        angles = {"tilt_deg": frame.tilt, "heading_deg": frame.heading}
    elif isinstance(camera, OrthographicCamera):
        angles = {"view_zenith_deg": camera.view_zenith, "view_azimuth_deg": camera.view_azimuth}
    residual = np.asarray(seen.residual)
    return {
        "versions": {n: version(n) for n in ("jax", "equinox", "numpy", "rasterio", "xarray")},
        "plot": {
            "name": plot.name,
            "size_m": list(plot.size_m),
            "voxel_m": plot.voxel_m,
            "boundary": plot.boundary,
            "sun_zenith_deg": plot.sun.zenith_deg,
            "sun_azimuth_deg": plot.sun.azimuth_deg,
            "solar_factor": plot.sun.solar_factor,
        },
        "sensor": {
            "name": instrument.name,
            "source": instrument.source,
            "kind": type(camera).__name__,
            "bands": len(instrument.bands),
            "bands_simulated": len(sensing.sensor.bands),
            "altitude_m": sensing.sensor_height,
            "pixel_m": sensing.pixel,
            "pixel_of_the_optics_m": optics,
            "rows_columns": list(sensing.shape),
            "south_west_corner_m": list(sensing.origin),
            **{k: float(v) for k, v in angles.items()},
            "point_spread": sensing.sensor.psf is not None,
            "noise": bool(noisy),
        },
        "atmosphere": {
            "model": air.model,
            "file": None if air.file is None else air.file.name,
            **(
                {}
                if air.model in ("file", "none")
                else {
                    "water_vapour_cm": air.water_vapour_cm,
                    "aerosol_optical_depth_550": air.aerosol_optical_depth,
                    "aerosol_optical_depth_500_of_sky": plot.sky.aerosol_optical_depth,
                    "ozone_cm_atm": air.ozone_cm_atm,
                    "pressure_hpa": air.pressure_hpa,
                }
            ),
        },
        "accuracy": {
            **{f.name: getattr(accuracy, f.name) for f in dataclasses.fields(accuracy)},
            "bands_reduced_to_few_solves": _is_reduced(sensing),
            "largest_residual": float(residual.max()),
            "precision": sensing.model.dtype,
        },
        "timings_s": dict(seconds),
    }


def _short(run: dict[str, Any]) -> dict[str, str]:
    """The record's parts as text, for the attributes of a file."""
    return {key: json.dumps(run[key]) for key in ("plot", "sensor", "atmosphere", "accuracy")}


def _write(
    folder: Path, plot: Plot, instrument: Sensor, cubes: dict[str, Cube], record: dict[str, Any]
) -> tuple[dict[str, str], list[str]]:
    """Write all files; their names with what they hold, and warnings."""
    files, warnings = {}, []
    for name, cube in cubes.items():
        write_cube_geotiff(folder / f"{name}.tif", cube, record)
        files[f"{name}.tif"] = f"{name}, GeoTIFF"
        try:
            write_cube_envi(folder / f"{name}.hdr", cube, record)
            files[f"{name}.hdr"] = f"{name}, ENVI: header of {name}.dat"
        except MissingExtraError as error:
            warnings = [f"no ENVI files were written. {error}"]
    write_cubes_netcdf(folder / "product.nc", cubes, record)
    files["product.nc"] = f"{' and '.join(cubes)}, NetCDF"
    page = Page(plot.name, f"What {instrument.name} measures of the plot.")
    first = next(iter(cubes.values()))
    for file, figure in quick_looks(first, plot.name).items():
        save_figure(figure, folder / file)
        files[file] = "quick look"
        page.figure(folder / file, f"{first.quantity.capitalize()}, {file[:-4].replace('_', ' ')}.")
    save_figure(spectrum_figure(cubes), folder / "spectrum.png")
    files["spectrum.png"] = "mean and range of the pixels by wavelength"
    page.figure(folder / "spectrum.png", "Mean over the pixels, and their range.")
    page.footer(record)
    page.write(folder / "report.html")
    files["report.html"] = "pictures on one page"
    files["run.json"] = "versions, seed, sensor, atmosphere, accuracy, times"
    return files, warnings


def _headline(
    plot: Plot,
    instrument: Sensor,
    sensing: PlotSensing,
    cubes: dict[str, Cube],
    seconds: dict[str, float],
    reduced: bool,
) -> list[str]:
    rows, columns = sensing.shape
    count = len(sensing.sensor.bands)
    lines = [
        f"{plot.name}: {count} bands of {instrument.name}, {columns} x {rows} pixels of "
        f"{sensing.pixel:.4g} m."
    ]
    for cube in cubes.values():
        mean = float(cube.values[cube.good].mean())
        unit = "" if cube.quantity == "reflectance" else " W m-2 sr-1 um-1"
        lines.append(f"Mean {cube.quantity} of {int(cube.good.sum())} bands: {mean:.4g}{unit}.")
    if reduced:
        lines.append(
            f"{seconds['bands']:.1f} s for {count} bands, {seconds['ratio_to_one_band']:.1f} times "
            f"as long as one band ({seconds['one_band']:.2f} s); compilation "
            f"{seconds['compile_bands']:.1f} s."
        )
    else:
        lines.append(f"{seconds['bands']:.1f} s; compilation {seconds['compile_bands']:.1f} s.")
    return lines


def _left_out(sensing: PlotSensing, instrument: Sensor) -> list[str]:
    lost = [
        f"{name} ({centre:.5g} nm)"
        for name, centre in zip(instrument.bands.names, instrument.bands.centre)
        if name not in sensing.sensor.bands.names
    ]
    if not lost:
        return []
    named = ", ".join(lost if len(lost) <= 4 else [*lost[:3], "...", lost[-1]])
    return [
        f"{len(lost)} of {len(instrument.bands)} bands of {instrument.name} reach beyond the "
        f"spectra of leaves and ground, 400 to 2500 nm, and hold no data: {named}"
    ]


def _of_other_pixels(sensing: PlotSensing) -> list[str]:
    sizes = sensing.sensor.band_pixel
    if sizes is None or len(set(sizes)) == 1:
        return []
    return [
        f"bands of {sensing.sensor.name} have pixels of {min(sizes):g} to {max(sizes):g} m in its "
        f"products; here all have {sensing.pixel:g} m"
    ]


def _of_slant(sensing: PlotSensing) -> list[str]:
    slant = 1.0 / float(np.min(sensing.rays.cosine))
    if not isinstance(sensing.air, PlotAir) or slant < 1.05:
        return []
    return [
        f"the air is that of a view straight down, but lines of sight are up to {slant:.2f} times "
        "as long: their radiance lacks the difference (give curves of your own for that view)"
    ]
