"""The job of `fynjax crowns`: which plants stand where, found in an orthophoto."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float
from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax.app.assembly import (
    FREE_OF_PLANTS,
    aim_without_air,
    blocks_of,
    placed_by_image,
    plot_problem,
)
from fynjax.app.compare import read_drone_image
from fynjax.app.io.plot import (
    Place,
    Plot,
    as_plot,
    drone_sensor,
    plot_place,
    sensor_place,
    write_crowns,
)
from fynjax.app.io.raster import open_raster, read_over_plot, write_geotiff
from fynjax.app.jobs._doubt import doubt_spectrum
from fynjax.app.jobs._render import image_views
from fynjax.app.jobs._result import JobResult, Number, Rows
from fynjax.app.jobs._run import Run, peak_memory_mib
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.inversion import FoundMaps, FoundPlants, PlacesSettings, find_places
from fynjax.scene import AimedSensor, Scene

_STRUCTURE = 0.05
"""Edge of the voxels that sun and sight follow the plants on, where the plot states none [m]."""
_CELL = 0.05
"""Cells of the maps, at most [m]."""
_UNDESCRIBED = 2.0
"""Misfit of a value from which on the model does not describe the plot [-]: plants of the table in
other places have 5 to 10, found ones about 1."""


class CrownsResult(JobResult):
    """Result of `crowns`: plants and covers beside the field table."""

    command: Literal["crowns"] = "crowns"
    crowns: int = Field(description="Rows of crowns.gpkg.")
    plants: Rows = Field(description="Rows of plants.csv.")
    misfit: Number = Field(
        description="Squared misfit of a value over what is expected of it: about 1 where species "
        "table and model describe the plot."
    )


def crowns(
    image: str | Path,
    output: str | Path,
    *,
    plot: Plot | str | Path,
    bands: Names | None = None,
    heights: str | Path | None = None,
    rounds: Annotated[int, Field(ge=2)] = 48,
    free: Sequence[str] | None = None,
    seed: Seed | None = None,
) -> CrownsResult:
    """Find which plants stand where in an orthophoto of a plot.

    **Arguments:**

    - `image`: GeoTIFF of reflectance; it covers the plot and nothing else, its rows from the north.
    - `output`: folder of the results, made if missing.
    - `plot`: plot file of the plot, or a plot that was read; its species table says what may stand
      there.
    - `bands`: what each band of the image is, as `read_drone_image` has it; known by name or
      wavelength by default.
    - `heights`: raster of the height of the canopy above the ground [m] that covers the plot; none
      by default.
    - `rounds`: of each chain of whole stands.
    - `free`: patterns of parameters that are found beside the plants; by default sizes, leaf area,
      dead tissue and leaves of the species, and the ground's brightness.
    - `seed`: seed of every random number; that of the plot file by default.

    **Returns:** `CrownsResult`. Writes `crowns.gpkg`, `species.tif`, `crowns.tif`, `expected.tif`,
    `plants.csv`, figures and a page into `output`.

    **Raises:** `InputError` as `read_plot` and `read_drone_image`, for an image that does not cover
    the plot, and for a plot whose crowns are known; `MissingExtraError` without the packages of the
    extras map and tables.

    Example: `jobs.crowns("ortho.tif", Path("results"), plot="plot.toml")`.
    """
    for module, extra in (("optax", "map"), ("pyogrio", "tables"), ("shapely", "tables")):
        require(module, extra)
    path = Path(image)
    read = placed_by_image(as_plot(plot), [path])
    if read.known_crowns is not None:
        raise InputError(
            "expected a plot whose plants are to be found, but it has crowns: leave them out of "
            "the plot file, or calibrate to them with `fynjax calibrate`",
            file=read.file,
        )
    if read.structure_m is None:
        read = read.replace(structure_m=min(_STRUCTURE, read.voxel_m))
    run = Run(output, seed=seed, plot=read)
    with run.stage("Build the plot", "build"):
        free = FREE_OF_PLANTS if free is None else free
        problem = plot_problem(read, None, free, seed=run.seed)
    scene = problem.scene
    means, camera = _image_and_camera(run, read, scene, path, bands)
    height = None if heights is None else _heights(read, Path(heights), scene.class_grid.shape)
    settings = PlacesSettings(rounds=rounds, seed=run.seed)
    begin_work(
        dict.fromkeys(["crowns.gpkg", "species.tif", "crowns.tif", "expected.tif"], "")
        | {"plants.csv": f"{len(scene.taxa)} species"}
        | {"report.html": f"after {settings.steps} steps and {settings.chains * rounds} rounds"}
    )
    with run.timed("find"):
        found = find_places(
            scene, means, camera, problem.free, settings, height=height, error=problem.error
        )
    table, every = found.table(), found.crowns()
    maps = found.maps(_cell(read))
    undescribed = found.misfit > _UNDESCRIBED
    doubt = (
        f"The image is not explained: the misfit is {found.misfit:.1f} times what is expected. "
        "Is the species list complete, and is the image where the plot is?"
    )
    headline = [*([doubt] if undescribed else []), str(found), _sure(every, maps)]
    with run.stage("Write"):
        record = run.record([*read.inputs, path, None if heights is None else Path(heights)])
        run.table("plants.csv", table, "plants and covers, of the field table and found")
        what = "found crowns with probabilities of species, for a GIS"
        place = _place(read, path)
        write_crowns(run.path("crowns.gpkg", what), every, place)
        _write_maps(run, place, found, maps, record)
        title, sections = f"Crowns: {read.name}", _sections(run, found, maps, table, every)
        keys = {"misfit of a value": f"{found.misfit:.2f}", "wall time": f"{run.total():.0f} s"}
        run.page(Page("crowns", title, " ".join(headline), sections, keys, record))
    return run.result(
        CrownsResult,
        headline=headline,
        status="the model does not describe the plot" if undescribed else "ok",
        crowns=len(every),
        plants=table,
        misfit=found.misfit,
    )


def _image_and_camera(
    run: Run, plot: Plot, scene: Scene, path: Path, bands: Sequence[str] | None
) -> tuple[Float[np.ndarray, "band y x"], AimedSensor]:
    """Means of blocks of pixels, and the camera that sees them; doubts an image of no shrubland."""
    image = read_drone_image(path, bands=bands, camera=drone_sensor(plot).bands, most_pixels=None)
    pixel = sensor_place(plot)[1] if image.pixel_m is None else image.pixel_m
    rows, columns = (round(side / pixel) for side in plot.size_m[::-1])
    if (rows, columns) != image.mask.shape:
        raise InputError(
            f"expected an image of the whole plot and nothing else, {rows} rows and {columns} "
            f"columns of {pixel:g} m, but it has {image.mask.shape[0]} and "
            f"{image.mask.shape[1]}. Cut it: gdal_translate -projwin",
            file=path,
        )
    values, block = blocks_of(image.values, pixel)
    drone = drone_sensor(plot, image.bands)
    camera = aim_without_air(plot, scene, scene.parameters, drone, pixel=block)
    seen = camera.sensor.bands
    order = [image.bands.index(name) for name in seen.names]
    doubt_spectrum(run, image.pixels.mean(axis=1)[order], seen, camera.sensor)
    return values[order], camera


def _heights(plot: Plot, path: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "y x"]:
    """Height of the canopy in the voxel columns [m]."""
    part = read_over_plot(
        path, "a raster of heights", plot.size_m, origin_m=plot.map_origin_m, option="map_origin_m"
    )
    part.check_single("a raster of one band, the height of the canopy", "Choose one.")
    height = part.in_cells((shape[1], shape[0]))[0]
    most = max(one.height for one in plot.species)
    if np.median(height) > 3.0 * most:
        raise InputError(
            f"expected heights above the ground, up to {most:g} m by the species table, but half "
            f"of the plot is above {np.median(height):g} m. Subtract the height of the ground.",
            file=path,
        )
    return height


def _cell(plot: Plot) -> float:
    """Side of the cells of maps: the largest up to 5 cm that divides the voxels."""
    return plot.voxel_m / int(np.ceil(plot.voxel_m / _CELL - 1e-6))


def _sure(every: pd.DataFrame, maps: FoundMaps) -> str:
    sure = int((every["presence"] >= 0.9).sum()) if len(every) else 0
    kind = (
        int(((every["presence"] >= 0.9) & (every["taxon_probability"] >= 0.9)).sum()) if sure else 0
    )
    return (
        f"{sure} of {len(every)} crowns are in nine of ten stands, {kind} of them of one species "
        f"there; over {maps.likeliest[1].mean():.0%} of the plot another species, or none, is the "
        "tallest than the map says, if stands are what they claim."
    )


def _place(plot: Plot, image: Path) -> Place:
    """Where the image lies on Earth, or else the plot."""
    with open_raster(image, "an image") as file:
        if file.crs is not None and file.on_earth:
            bounds = file.dataset.bounds
            return Place((float(bounds.left), float(bounds.bottom)), file.crs.to_wkt())
    return plot_place(plot)


def _write_maps(
    run: Run, place: Place, found: FoundPlants, maps: FoundMaps, record: dict[str, str | int]
) -> None:
    (kind, doubt), taxa, bands = maps.likeliest, found.scene.taxa, found.camera.sensor.bands
    legend = ", ".join(f"{i + 1} {taxon}" for i, taxon in enumerate(taxa))
    layers = {
        "species": (
            np.stack([kind + 1.0, doubt, *maps.species]),
            ["species", "probability of another", *(f"probability of {taxon}" for taxon in taxa)],
            "likeliest species (0 bare, then in the order of the table), probability that it is "
            "another, and of each",
        ),
        "crowns": (
            np.stack([maps.crown, *maps.height]),
            ["crown", "height, 5 %", "height, median", "height, 95 %"],
            "probability of a crown, and height of the tallest plant [m]",
        ),
        "expected": (found.expected, list(bands.names), "image of the found plants"),
    }
    for name, (values, names, what) in layers.items():
        of_camera = name == "expected"
        write_geotiff(
            run.path(f"{name}.tif", what),
            values,
            names,
            pixel_m=found.camera.pixel if of_camera else maps.cell,
            origin_m=place.corner(found.camera.origin if of_camera else (0.0, 0.0)),
            crs=place.crs,
            wavelengths=list(bands.centre) if of_camera else None,
            tags={k: str(v) for k, v in record.items()} | {"legend": legend},
        )


def _sections(
    run: Run, found: FoundPlants, maps: FoundMaps, table: pd.DataFrame, every: pd.DataFrame
) -> list[Section]:
    bands, pixel = found.camera.sensor.bands, found.camera.pixel
    images = {"Measured": found.measured, "Expected": found.expected}
    kind, doubt = maps.likeliest
    scene = found.scene
    order = np.argsort(bands.centre)
    sd = ", ".join(f"{bands.names[k]} {100 * found.pixel_sd[k]:.0f} %" for k in order)
    residual = np.asarray(found.expected - found.measured)[order]
    return [
        Section(
            "Crowns",
            [
                Picture(
                    "species_map.png",
                    figures.species_map(
                        kind, 1.0 - doubt, scene.taxa, scene.forms, pixel_m=maps.cell
                    ),
                    "likeliest species over the plot, the paler the less sure",
                ),
                Picture(
                    "crown_maps.png",
                    figures.layer_map(
                        {
                            "Probability of a crown": maps.crown,
                            "Probability of another species": doubt,
                        },
                        "Probability [-]",
                        pixel_m=maps.cell,
                    ),
                    "probability of a crown, and of another species than the map's",
                ),
                Picture(
                    "height_map.png",
                    figures.layer_map(
                        dict(zip(("5 %", "Median", "95 %"), maps.height, strict=True)),
                        "Height of the tallest plant [m]",
                        pixel_m=maps.cell,
                    ),
                    "height of the tallest plant: 5 %, median and 95 % of the stands",
                ),
                Table(
                    every.drop(columns=[c for c in every if str(c).startswith("p_")]),
                    "Every crown that is in a fifth of the stands.",
                    digits=3,
                    folded=True,
                ),
            ],
        ),
        Section("Plants and covers", [Table(table, "Of the field table, and found.", digits=3)]),
        Section(
            "The image",
            [
                "All with one stretch and one scale of length. Expected is the mean image of the "
                f"stands, times the camera's gains as estimated. Blocks of {100 * pixel:.3g} cm "
                f"are expected to be off by {sd} of their values, mostly by lobes and shoots of "
                "plants, which are not known.",
                image_views(images, bands, pixel, "Measured"),
                Picture(
                    "residual.png",
                    figures.residual_maps(
                        {"Expected": residual}, [bands.names[k] for k in order], pixel_m=pixel
                    ),
                    "expected less measured",
                    "Expected less measured. What is missing is as large and round as a crown.",
                ),
            ],
        ),
        Section(
            "The search",
            [
                f"{len(found.stands)} stands; {found.together:.2g} blocks err as one. Largest "
                f"memory {peak_memory_mib():.0f} MiB.",
                run.times(),
            ],
        ),
    ]
