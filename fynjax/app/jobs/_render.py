"""The job of `fynjax render`: the image that a plot file describes, of whatever sensor it names."""

import itertools
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
from numpy.typing import ArrayLike

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work, image_size
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax.app.assembly import aim_without_air, build_plot
from fynjax.app.io.plot import Place, Plot, as_plot, plot_instrument, plot_place
from fynjax.app.io.raster import Cube, image_array, write_geotiff, write_run
from fynjax.app.jobs._result import JobResult, StatisticSummary
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table, Views
from fynjax.metrics import BANDS, vegetation_indices
from fynjax.scene import (
    AimedSensor,
    PixelTruth,
    PlotParameters,
    Scene,
    TiledPicture,
    check_image,
    hard_counts,
    hard_scene,
    is_large,
    truth_of_layers,
    truth_of_pixels,
)
from fynjax.sensors import BandSet

SHOWN_INDICES = ("NDVI", "GNDVI", "SR", "GCI", "ARI2", "OSAVI", "GSAVI", "NormR")
"""Vegetation indices whose histograms are drawn."""

_MAPPED = ("NDVI", "GNDVI", "OSAVI")
"""Vegetation indices that a page shows as maps as well."""

_LOOKS = {"true_like.png": "nearly natural colours", "false_colour.png": "near infrared as red"}
"""Words for a quick look, by its file."""

_FEW_BANDS = 8
"""Most bands whose means the headline lists."""


class RenderResult(JobResult):
    """Result of `render`: mean reflectance of each band."""

    command: Literal["render"] = "render"
    statistics: list[StatisticSummary]


@double_precision
def render_plot(
    plot: Plot | str | Path,
    output: str | Path,
    *,
    seed: Seed | None = None,
    checkpoint: Path | None = None,
    truth: bool = False,
) -> RenderResult:
    """Render what the drone sees of a plot.

    A large image is rendered in tiles; an interrupted run goes on with the same command.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `output`: folder of the results, made if missing.
    - `seed`: seed of everything random; the plot file's if left out.
    - `checkpoint`: folder that keeps the tiles of a large image, from which an interrupted run goes
      on; none by default.
    - `truth`: also write which species each pixel sees, and how much, and of the ground.

    **Returns:** `RenderResult`. Writes `image.tif` and `run.nc` (reflectance factor [-]), figures
    and a page into `output`; with `truth` also `truth.tif` and `truth.nc` (`PixelTruth`).

    **Raises:** `InputError` as `read_plot`, for an image that is not finite or does not fit in
    memory, and for a checkpoint of another run.

    Example: `jobs.render_plot("plot.toml", Path("results")).headline`.
    """
    read = as_plot(plot)
    run = Run(output, seed=seed, plot=read)
    instrument = plot_instrument(read)
    with run.stage("Build the plot", "build"):
        scene, parameters = build_plot(read, seed=run.seed)
        camera = aim_without_air(read, scene, parameters, instrument)
        tiled = is_large(camera, scene)
        check_image(camera, scene, parameters, tiled=tiled)
    size = image_size(camera.shape, len(camera.sensor.bands))
    layers = image_size(camera.shape, 4 * len(scene.taxa) + 2)
    shares = {"truth.tif": layers, "truth.nc": layers} if truth else {}
    begin_work({"image.tif": size, "run.nc": size, "report.html": "", **shares})
    with run.stage("Render", "render"):
        if tiled:
            journal = run.journal(checkpoint, read, files=read.inputs)
            picture = TiledPicture(camera, scene, parameters)
            if journal is None:
                image = picture.image()
            else:
                tiles = track(picture.tiles, "Tiles")
                image = picture.image(journal(picture.render, tile) for tile in tiles)
            seen = None
            if truth:
                seen = truth_of_layers(picture.sight(), camera, scene, parameters)
        else:
            # Plants that do not stand take time and memory only.
            stand = hard_scene(scene, parameters)
            image = jax.block_until_ready(_measure(camera, stand, parameters))
            seen = truth_of_pixels(camera, scene, parameters) if truth else None
        counts = hard_counts(scene, parameters)
    check_finite(image, read)
    with run.stage("Write"):
        _write(run, read, scene, camera, np.asarray(image), counts, seen)
    names = camera.sensor.bands.names
    means = dict(zip(names, np.asarray(jnp.mean(image, axis=(1, 2))).tolist(), strict=True))
    shown = dict(itertools.islice(means.items(), _FEW_BANDS))
    named = ", ".join(f"{band} {value:.4f}" for band, value in shown.items())
    named += "" if len(means) == len(shown) else f" and {len(means) - len(shown)} bands more"
    return run.result(
        RenderResult,
        headline=[f"{read.name}: mean reflectance {named}."],
        statistics=[
            StatisticSummary(statistic=f"{band}.mean", target=None, before=value, after=None)
            for band, value in means.items()
        ],
    )


@eqx.filter_jit
def _measure(
    camera: AimedSensor, scene: Scene, parameters: PlotParameters
) -> Float[Array, "band y x"]:
    return camera.observe(scene, parameters).reflectance


def _write(
    run: Run,
    plot: Plot,
    scene: Scene,
    camera: AimedSensor,
    image: np.ndarray,
    counts: np.ndarray,
    truth: PixelTruth | None,
) -> None:
    record = run.record(plot.inputs)
    bands = camera.sensor.bands
    path = run.path("image.tif", "simulated reflectance, GeoTIFF")
    write_image(path, image, plot_place(plot), camera, record)
    reflectance = image_array(
        image,
        list(bands.names),
        list(bands.centre),
        pixel_m=camera.pixel,
        long_name="simulated reflectance factor",
    )
    write_run(
        run.path("run.nc", "image and plant counts, NetCDF"),
        xr.Dataset({"reflectance": reflectance, "plants": plant_counts(scene, counts)}),
        record,
    )
    caption = "Plants, as many as their covers ask for."
    if plot.crowns_note is not None:
        caption = "Plants, which are known."
    plants = pd.DataFrame({"taxon": scene.taxa, "plants": counts.astype(int)})
    if set(BANDS) <= set(bands.names):
        histograms = figures.pixel_histograms({"simulated": index_images(image, bands)})
        pictures: list[Part] = [
            image_views({plot.name: image}, bands, camera.pixel),
            Picture("indices.png", histograms, "histograms of vegetation indices"),
        ]
    else:
        cube = Cube(
            image,
            bands.names,
            np.asarray(bands.centre),
            np.asarray(bands.fwhm),
            np.ones(len(bands), bool),
            camera.pixel,
            camera.origin,
            "reflectance",
            None,
        )
        pictures = [*cube_pictures({"reflectance": cube}, plot.name)]
    parts: list[Part] = [
        *pictures,
        *([] if truth is None else [write_truth(run, plot, scene, truth, record)]),
        Table(plants, caption),
    ]
    few = np.argsort(bands.centre[:_FEW_BANDS])
    keys = {f"mean {bands.names[k].replace('_', ' ')}": f"{image[k].mean():.3f}" for k in few}
    lead = f"What {camera.sensor.name} sees of the plot, without air and noise."
    means = ", ".join(f"{name.removeprefix('mean ')} {value}" for name, value in keys.items())
    first, sections = f"Mean reflectance by {camera.sensor.name}: {means}", [Section("", parts)]
    run.page(Page("render", plot.name, lead, sections, keys, record, first))


def write_truth(
    run: Run, plot: Plot, scene: Scene, truth: PixelTruth, record: Mapping[str, str | int]
) -> Picture:
    """Write the shares of each species in the pixels; gives a map of the leading ones."""
    write_run(run.path("truth.nc", "what each pixel sees, NetCDF"), truth.to_xarray(), record)
    organs = {
        name: np.asarray(getattr(truth, name)) for name in ("live", "dead", "wood", "flowers")
    }
    ground = np.stack([truth.sunlit_ground, truth.shaded_ground])
    names = [f"{organ}: {taxon}" for organ in organs for taxon in truth.taxa]
    place = plot_place(plot)
    write_geotiff(
        run.path("truth.tif", "share of each pixel that is each species, GeoTIFF"),
        np.concatenate([*organs.values(), ground]),
        [*names, "ground in the sun", "ground in shade"],
        pixel_m=truth.pixel,
        origin_m=place.corner(truth.origin),
        crs=place.crs,
        tags={k: str(v) for k, v in record.items()},
    )
    figure = figures.species_map(*truth.leading(), truth.taxa, scene.forms, pixel_m=truth.pixel)
    return Picture("species.png", figure, "species that leads in each pixel")


def image_views(
    images: Mapping[str, np.ndarray],
    bands: BandSet,
    pixel_m: float | Mapping[str, float],
    stretch: str | None = None,
) -> Views:
    """Images of a drone side by side, to be chosen from: colours, its `bands`, indices.

    **Arguments:**

    - `images`: [band, y, x] with y to the north, by title; NaN in a band that an image lacks, of
      which it is then not shown.
    - `bands`: of the images.
    - `pixel_m`, `stretch`: as of `figures.composites`.
    """
    has = {title: np.isfinite(image).any(axis=(1, 2)) for title, image in images.items()}
    common = np.flatnonzero(np.all(list(has.values()), axis=0))
    coloured = {title: image[common] for title, image in images.items()}
    names = [bands.names[k] for k in common]
    views = {
        "Nearly natural": Picture(
            "true_like.png",
            figures.composites(coloured, names, pixel_m=pixel_m, kind="true_like", stretch=stretch),
            "image, nearly natural colours",
        ),
        "False colour": Picture(
            "false_colour.png",
            figures.composites(coloured, names, pixel_m=pixel_m, stretch=stretch),
            "image, near infrared as red",
        ),
    }

    def of_layer(layers: Mapping[str, np.ndarray], file: str, what: str, words: str) -> Picture:
        seen = {title: layer for title, layer in layers.items() if np.isfinite(layer).any()}
        by = stretch if stretch in seen else None
        return Picture(file, figures.layer_map(seen, what, pixel_m=pixel_m, stretch=by), words)

    for k in np.argsort(bands.centre):
        band = bands.names[k]
        label = figures.words(band)
        label = f"{label[0].upper()}{label[1:]}"
        views[label] = of_layer(
            {title: image[k] for title, image in images.items()},
            f"band_{band}.png",
            f"{label}: reflectance [-]",
            f"reflectance in the band {figures.words(band)}",
        )
    indices = {title: index_images(image, bands, _MAPPED) for title, image in images.items()}
    for name in _MAPPED:
        views[name] = of_layer(
            {title: of_image[name] for title, of_image in indices.items()},
            f"index_{name}.png",
            f"{name} [-]",
            f"map of the index {name}",
        )
    return Views(views)


def cube_pictures(cubes: Mapping[str, Cube], title: str) -> list[Picture]:
    """Quick looks of the first of some cubes, and the spectra of all."""
    first = next(iter(cubes.values()))
    looks = [
        Picture(file, figure, "quick look", f"{first.quantity.capitalize()}, {_LOOKS[file]}.")
        for file, figure in figures.quick_looks(first, title).items()
    ]
    spectrum = Picture(
        "spectrum.png",
        figures.spectrum_figure(cubes),
        "mean and range of the pixels by wavelength",
        "Mean over the pixels and their range; of few pixels, each.",
    )
    return [*looks, spectrum]


def index_images(
    image: np.ndarray, bands: BandSet, names: tuple[str, ...] = SHOWN_INDICES
) -> dict[str, np.ndarray]:
    """Vegetation indices of every pixel [y, x] of an image in `bands`, by name."""
    values = vegetation_indices(image, names, bands)
    return dict(zip(names, np.asarray(values), strict=True))


def write_image(
    path: Path,
    image: np.ndarray,
    place: Place,
    camera: AimedSensor,
    record: Mapping[str, str | int],
) -> None:
    """Write an image of `camera` as GeoTIFF, where the plot lies."""
    bands = camera.sensor.bands
    write_geotiff(
        path,
        image,
        list(bands.names),
        pixel_m=camera.pixel,
        origin_m=place.corner(camera.origin),
        crs=place.crs,
        wavelengths=list(bands.centre),
        tags={k: str(v) for k, v in record.items()},
    )


def plant_counts(
    scene: Scene, counts: np.ndarray, what: str = "plants on the plot"
) -> xr.DataArray:
    """Plants of each species; `what` they are, in words."""
    return xr.DataArray(
        np.asarray(counts, float),
        dims="species",
        coords={"species": ("species", list(scene.taxa), {"long_name": "taxon"})},
        attrs={"long_name": what, "units": "1"},
    )


def check_finite(image: ArrayLike, plot: Plot | None, what: str = "rendered image") -> None:
    """No NaN reaches a product: raises `InputError` for an image that holds one, of `what`."""
    bad = int(np.sum(~np.isfinite(np.asarray(image))))
    if bad:
        raise InputError(
            f"{bad} values of the {what} are not finite. Is the sun near the horizon, or a "
            "parameter at the end of its range?",
            file=None if plot is None else plot.file,
        )
