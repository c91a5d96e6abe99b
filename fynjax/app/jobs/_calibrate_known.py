"""The job of `fynjax calibrate` where plants are known: the image counts pixel by pixel."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax.app.assembly import Prepared, aim_without_air, prepare
from fynjax.app.compare import read_drone_image
from fynjax.app.io.plot import Plot, drone_sensor, sensor_place
from fynjax.app.jobs._calibration_page import (
    doubt_first,
    pair_of_errors,
    parameter_section,
    parameter_sentences,
    search_section,
    write_results,
)
from fynjax.app.jobs._calibration_tables import offered_stand, parameter_table
from fynjax.app.jobs._doubt import doubt_spectrum
from fynjax.app.jobs._follow import follow
from fynjax.app.jobs._render import check_finite, image_views
from fynjax.app.jobs._run import Run, peak_memory_mib
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.inversion import (
    KnownPlants,
    PixelSettings,
    block_of,
    known_plants_search,
    stand_sentence,
)
from fynjax.scene import AimedSensor


def known_plants(
    plot: Plot,
    path: Path,
    run: Run,
    bands: Sequence[str] | None,
    checkpoint: Path | None,
) -> tuple[KnownPlants, pd.DataFrame, pd.DataFrame, list[str]]:
    """Calibrate a plot with crowns to an image, pixel by pixel, and write what comes out.

    **Arguments:**

    - `plot`: with `Plot.known_crowns`.
    - `path`: the image, GeoTIFF; it covers the plot and nothing else, its rows from the north.
    - `run`: the job at work.
    - `bands`: of the image, as `read_drone_image` has them.
    - `checkpoint`: folder that keeps every step; None keeps none.

    **Returns:** the calibration, the tables of its parameters and of the bands, and its headline.

    **Raises:** `InputError` for an image that does not cover the plot, and as the readers.
    """
    with run.stage("Build the plot", "build"):
        ready = prepare(plot, None, seed=run.seed)
    camera, image = image_and_camera(run, ready, path, bands)
    settings = plot.calibration
    block = _block(plot, len(image), camera.shape, camera.pixel)
    begin_work(
        {"parameters.csv": f"{len(ready.space.names)} parameters", "statistics.csv": ""}
        | dict.fromkeys(["image_before.tif", "image_after.tif"], "")
        | {"report.html": f"after at most {settings.max_iterations} steps of the search"}
    )
    with run.stage("Calibrate", "calibrate", total=settings.max_iterations):
        search = known_plants_search(
            ready.scene,
            ready.parameters,
            image,
            ready.space,
            camera,
            PixelSettings(block, settings.pixel_sd, max_steps=settings.max_iterations),
            error=ready.error,
        )
        result = search.result(follow(search, [None], run, checkpoint)[0])
    check_finite(jnp.asarray(result.image_after), plot)
    parameters, table = parameter_table(result), band_table(result)
    mean = np.nanmean(result.measured, axis=(1, 2), keepdims=True)
    rmse = [
        100.0 * float(np.sqrt(np.nanmean(((image - result.measured) / mean) ** 2)))
        for image in (result.image_before, result.image_after, result.image_with_error)
    ]
    stand = offered_stand(result.stand(), result)
    headline = [
        *result.doubts(),
        stand_sentence(stand),
        f"{plot.name}: {result.degrees} means of {result.block} x {result.block} pixels compared; "
        f"their relative error {rmse[0]:.2f} % before, {rmse[1]:.2f} % after, {rmse[2]:.2f} % with "
        "the camera's gains and the model's error as estimated.",
        *([] if plot.crowns_note is None else [plot.crowns_note]),
        "Covers follow from the crowns and are not free.",
        *parameter_sentences(result),
    ]
    with run.stage("Write"):
        record = run.record([*plot.inputs, path])
        blocks = dataclasses.replace(camera, pixel=camera.pixel * result.block)
        tables = stand, parameters, table
        write_results(run, plot, result, tables, blocks, record, ("every band", "plot file"))
        run.page(
            Page(
                f"Calibration: {plot.name}",
                doubt_first(result, " ".join(headline[:2])),
                [
                    Section("The image", _pictures(result, blocks.pixel)),
                    Section("", [Table(table, "Every band.", folded=True)]),
                    parameter_section(result, stand, parameters),
                    search_section(run, result, peak_memory_mib()),
                ],
                {
                    "relative error, before → after": pair_of_errors(*rmse[:2]),
                    "wall time": f"{run.total():.0f} s",
                },
                record,
            )
        )
    return result, parameters, table, headline


def image_and_camera(
    run: Run, ready: Prepared, path: Path, bands: Sequence[str] | None
) -> tuple[AimedSensor, Float[np.ndarray, "band y x"]]:
    """The camera over the whole plot, and the image in its bands; doubts one of no shrubland."""
    plot = ready.plot
    drone = drone_sensor(plot)
    image = read_drone_image(path, bands=bands, camera=drone.bands, most_pixels=None)
    pixel = sensor_place(plot)[1] if image.pixel_m is None else image.pixel_m
    drone = drone_sensor(plot, image.bands)
    camera = aim_without_air(plot, ready.scene, ready.parameters, drone, pixel=pixel)
    if camera.shape != image.mask.shape:
        raise InputError(
            f"expected an image of the whole plot and nothing else, {camera.shape[0]} rows and "
            f"{camera.shape[1]} columns of {pixel:g} m, but it has {image.mask.shape[0]} and "
            f"{image.mask.shape[1]}. Cut it: gdal_translate -projwin",
            file=path,
        )
    order = [image.bands.index(name) for name in camera.sensor.bands.names]
    mean = image.pixels.mean(axis=1)[order]
    doubt_spectrum(run, mean, camera.sensor.bands, camera.sensor)
    return camera, image.values[order]


def _block(plot: Plot, bands: int, shape: tuple[int, int], pixel: float) -> int:
    """Pixels along the edge of a block."""
    stated = plot.calibration.block_m
    if stated is None:
        return block_of(bands, shape)
    block = round(stated / pixel)
    if not 1 <= block <= min(shape) or abs(stated - block * pixel) > 1e-3 * pixel:
        raise InputError(
            f"expected blocks of a whole number of pixels of {pixel:g} m, no larger than the plot, "
            f"but got {stated:g} m",
            file=plot.file,
            column="calibration.block_m",
        )
    return block


def band_table(result: KnownPlants) -> pd.DataFrame:
    """Mean of each band over the compared blocks, and the root mean square of their errors."""
    real = result.measured
    images = {
        "real": real,
        "before": result.image_before,
        "after": result.image_after,
        "with_error": result.image_with_error,
    }
    compared = {name: np.where(np.isfinite(real), image, np.nan) for name, image in images.items()}
    table = {name: np.nanmean(image, axis=(1, 2)) for name, image in compared.items()}
    for name in ("before", "after", "with_error"):
        error = (compared[name] - real) ** 2
        table[f"{name}_rmse"] = np.sqrt(np.nanmean(error, axis=(1, 2)))
    names = [f"{band}.mean" for band in result.camera.sensor.bands.names]
    return pd.DataFrame({"statistic": names, "fitted": True, **table})


def _pictures(result: KnownPlants, pixel: float) -> list[Part]:
    bands = result.camera.sensor.bands
    images = {
        "Measured": result.measured,
        "Before": result.image_before,
        "After": result.image_after,
        "With gains and error": result.image_with_error,
    }
    residuals = {title: images[title] - result.measured for title in list(images)[1:]}
    return [
        "All with one stretch, that of the measured image, and one scale of length. What is "
        "compared is the last, times the camera's gains and the model's error as estimated.",
        image_views(images, bands, pixel, "Measured"),
        "Plants stand where they were mapped, so that each pixel of the simulation has its partner "
        "in the measured image, and their difference says what is off where.",
        Picture(
            "residual.png",
            figures.residual_maps(residuals, bands.names, pixel_m=pixel),
            "simulated less measured, before, after, and with gains and the model's error",
            "Simulated less measured, in each band with one scale.",
        ),
    ]
