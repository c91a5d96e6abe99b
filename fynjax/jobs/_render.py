"""What `fynjax render` does: the drone image that a plot file describes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.progress import Progress
from fynjax.assembly import build_plot
from fynjax.io.plot import Plot, as_plot, drone_bands, plot_place
from fynjax.io.raster import image_array, write_geotiff, write_run
from fynjax.jobs._result import JobResult, StatisticSummary
from fynjax.jobs._run import Run
from fynjax.metrics import BANDS, vegetation_indices
from fynjax.report.figures import composites, index_histograms
from fynjax.report.pages import Page, Part, Picture, Section, Table
from fynjax.scene import PlotModel

SHOWN_INDICES = ("NDVI", "GNDVI", "SR", "GCI", "ARI2", "OSAVI", "GSAVI", "NormR")
"""Vegetation indices whose histograms are drawn."""


class RenderResult(JobResult):
    """Result of `render`: mean reflectance of each band."""

    command: Literal["render"] = "render"
    statistics: list[StatisticSummary]


def render(
    plot: Plot | str | Path,
    output: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> RenderResult:
    """Render the reflectance image of a plot.

    **Arguments:**

    - `plot`: a plot, or the path of its plot file.
    - `output`: folder of the results, made if missing.
    - `seed`: seed of every random number; that of the plot file by default.
    - `progress`: where to report the stages; nowhere by default.

    **Returns:** `RenderResult`. Writes `image.tif` and `run.nc` (reflectance factor [-]), figures
    and a page into `output`.

    **Raises:** `InputError` as `read_plot`, and for an image that is not finite.

    Example: `jobs.render("plot.toml", Path("results")).headline`.
    """
    read = as_plot(plot)
    run = Run(output, seed=read.seed if seed is None else seed, progress=progress)
    with run.stage("Build the plot", "build"):
        model, parameters = build_plot(read, seed=run.seed, bands=drone_bands(read))
    render = eqx.filter_jit(lambda m, p: (m.image(p), m.counts(p)))
    with run.stage("Render", "render"):
        image, counts = jax.block_until_ready(render(model, parameters))
    check_finite(image, read)
    with run.stage("Write"):
        _write(run, read, model, np.asarray(image), np.asarray(counts))
    means = dict(zip(BANDS, np.asarray(jnp.mean(image, axis=(1, 2))).tolist(), strict=True))
    named = ", ".join(f"{band} {value:.4f}" for band, value in means.items())
    return run.result(
        RenderResult,
        headline=[f"{read.name}: mean reflectance {named}."],
        statistics=[
            StatisticSummary(statistic=f"{band}.mean", target=None, before=value, after=None)
            for band, value in means.items()
        ],
    )


def _write(run: Run, plot: Plot, model: PlotModel, image: np.ndarray, counts: np.ndarray) -> None:
    record = run.record(plot.inputs)
    write_image(run.path("image.tif", "simulated reflectance, GeoTIFF"), image, plot, model, record)
    reflectance = image_array(
        image,
        list(BANDS),
        list(model.camera.bands.centre),
        pixel_m=plot.sensor.pixel_m,
        long_name="simulated reflectance factor",
    )
    write_run(
        run.path("run.nc", "image and plant counts, NetCDF"),
        xr.Dataset({"reflectance": reflectance, "plants": plant_counts(model, counts)}),
        record,
    )
    named, pixel = {plot.name: image}, plot.sensor.pixel_m
    parts: list[Part] = [
        Picture(
            "true_like.png",
            composites(named, BANDS, pixel_m=pixel, kind="true_like"),
            "image, nearly natural colours",
        ),
        Picture(
            "false_colour.png",
            composites(named, BANDS, pixel_m=pixel),
            "image, near infrared as red",
        ),
        Picture(
            "indices.png", index_histograms(index_images(image)), "histograms of vegetation indices"
        ),
        Table(pd.DataFrame({"taxon": model.taxa, "plants": counts}), "Plants, equation (10)."),
    ]
    means = zip(BANDS, image.mean((1, 2)), strict=True)
    run.page(
        Page(
            plot.name,
            "The drone image that the plot file describes.",
            [Section("", parts)],
            {f"mean {band.replace('_', ' ')}": f"{value:.3f}" for band, value in means},
            record,
        )
    )


def index_images(
    image: np.ndarray, names: tuple[str, ...] = SHOWN_INDICES
) -> dict[str, np.ndarray]:
    """Vegetation indices of every pixel [y, x], by name."""
    return dict(zip(names, np.asarray(vegetation_indices(jnp.asarray(image), names)), strict=True))


def write_image(
    path: Path, image: np.ndarray, plot: Plot, model: PlotModel, record: Mapping[str, str | int]
) -> None:
    """Write an image of the drone's bands as GeoTIFF, where the plot lies."""
    place = plot_place(plot)
    write_geotiff(
        path,
        image,
        list(BANDS),
        pixel_m=plot.sensor.pixel_m,
        origin_m=place.origin_m,
        crs=place.crs,
        wavelengths=list(model.camera.bands.centre),
        tags={k: str(v) for k, v in record.items()},
    )


def plant_counts(model: PlotModel, counts: np.ndarray) -> xr.DataArray:
    """Plants of each species."""
    return xr.DataArray(
        np.asarray(counts, float),
        dims="species",
        coords={"species": ("species", list(model.taxa), {"long_name": "taxon"})},
        attrs={"long_name": "plants on the plot, eq. (10) without its ceiling", "units": "1"},
    )


def check_finite(image: Float[Array, "band y x"], plot: Plot) -> None:
    """No NaN reaches a product: raises `InputError` for an image that holds one."""
    bad = int(np.sum(~np.isfinite(np.asarray(image))))
    if bad:
        raise InputError(
            f"{bad} values of the rendered image are not finite. Is the sun near the horizon, or a "
            "parameter at the end of its range?",
            file=plot.file,
        )
