"""What `fynjax build` does: the hard scene of a plot, its cover, its voxels and its pictures."""

import dataclasses
import time
from functools import partial
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np
import pandas as pd
import xarray as xr

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.assembly import build_plot
from fynjax.io.instruments import scene_meshes, write_scene_mesh
from fynjax.io.plot import Plot, as_plot
from fynjax.io.raster import provenance, write_run
from fynjax.io.text import write_text
from fynjax.jobs._calibrate import _Clock, peak_memory_mib
from fynjax.report.figures import (
    check_view,
    mesh_image,
    oblique_view,
    plan_view,
    profile_view,
    rgb,
    save_figure,
    species_colours,
)
from fynjax.report.pages import Page
from fynjax.scene import (
    Instances,
    PlotModel,
    PlotParameters,
    ProjectedCover,
    hard_instances,
    hard_model,
    height_profile,
    leafy_species,
    projected_cover,
)

_VIEW_TRIANGLES = 20_000_000
_COVER_HEADERS = {
    "asked_percent": "asked",
    "counted_percent": "counted",
    "crowns_percent": "crowns in full",
    "species_percent": "ground under the species",
    "seen_percent": "seen from above",
}


def build(
    plot: Plot | str | Path,
    output: Path,
    *,
    seed: int | None = None,
    size: float | None = None,
    cell: float = 0.01,
    mesh: bool = False,
    max_triangles: int = 5_000_000,
    view: Literal["points", "meshes"] = "points",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Build the hard scene of a plot file into the folder `output`.

    **Arguments:**

    - `seed`: of everything random; the plot file's if left out.
    - `size`: side of a square plot [m] instead of the file's; its maps must cover it.
    - `cell`: side of the cells that cover is measured on [m].
    - `mesh`, `max_triangles`: write the scene as OBJ, of at most so many triangles.
    - `view`: what the oblique picture shows: clouds of area elements, or the generated meshes of
      the taxa (needs PyVista, the extra `view`).

    **Returns:** the summary: headline, files, counts, cover, times [s], memory [MiB].
    """
    progress = NullProgress() if progress is None else progress
    if view == "meshes":
        check_view()
    read = as_plot(plot)
    read = read if size is None else _resized(read, size)
    chosen = read.seed if seed is None else seed
    seconds: dict[str, float] = {}
    began = time.perf_counter()
    with progress.stage("Plant the plot"), _Clock(seconds, "plants"):
        model, parameters = build_plot(read, seed=chosen)
        real = np.asarray(model.counts(parameters), float)
        instances = hard_instances(model, parameters)
        hard = hard_model(model, parameters)
        del model  # its spare plants
    meshes, triangles, paint = None, 0, None
    if view == "meshes":
        with progress.stage("Grow the meshes"), _Clock(seconds, "meshes_of_the_view"):
            shown, _ = scene_meshes(
                instances, hard, parameters, max_triangles=_VIEW_TRIANGLES, seed=chosen
            )
            paint = partial(mesh_image, instances, shown, hard.forms, hard.terrain)
    if mesh:  # early: it may be refused
        with progress.stage("Grow the meshes"), _Clock(seconds, "meshes"):
            meshes, triangles = scene_meshes(
                instances, hard, parameters, max_triangles=max_triangles, seed=chosen
            )
    with progress.stage("Fill the voxels"), _Clock(seconds, "voxels"):
        density = eqx.filter_jit(lambda m, p: m.area_density(p))(hard, parameters)
        jax.block_until_ready(density)
    memory = peak_memory_mib()
    seconds["build"] = seconds["plants"] + seconds["voxels"]
    periodic = hard.boundary == "periodic"
    with progress.stage("Measure the cover"), _Clock(seconds, "cover"):
        cover = projected_cover(instances, cell=cell, periodic=periodic)
        table = cover_table(read, parameters, instances, real, cover)
    record = provenance(seed=chosen, inputs=read.inputs)
    files = {
        "instances.csv": "every plant: place, turn, size",
        "cover.csv": "cover of each species, asked and measured",
        "voxels.nc": "area density of each optical class, NetCDF",
        "plan.png": "the plants from above",
        "oblique.png": "the plants from obliquely above",
        "profile.png": "leaf and wood area density against height",
        "report.html": "all of it on one page",
    }
    extra: dict[str, Any] = {}
    with progress.stage("Write"), _Clock(seconds, "write"):
        write_text(output / "instances.csv", instance_table(instances).to_csv(index=False))
        write_text(output / "cover.csv", table.to_csv(index=False, float_format="%.4f"))
        write_run(output / "voxels.nc", voxel_dataset(hard, density), record)
        del density
    with progress.stage("Draw"), _Clock(seconds, "figures"):
        edges = _layers(instances, hard)
        profile = height_profile(hard, parameters, edges)
        figures = {
            "plan": plan_view(
                instances, hard.forms, periodic=periodic,
                title=f"{read.name}: {len(instances)} plants from above",
            ),
            "oblique": oblique_view(
                instances, hard.forms, periodic=periodic, ground=hard.terrain,
                title=f"{read.name}: from the south-south-west", paint=paint,
            ),
            "profile": profile_view(profile, edges, instances, hard.forms),
        }  # fmt: skip
        for name, figure in figures.items():
            save_figure(figure, output / f"{name}.png")
    if meshes is not None:
        with progress.stage("Write the mesh"), _Clock(seconds, "write_mesh"):
            colours = [tuple(rgb(c).tolist()) for c in species_colours(hard.forms)]
            write_scene_mesh(output / "scene.obj", instances, meshes, colours)
        files |= {
            "scene.obj": f"the plants as {triangles} triangles, metres",
            "scene.mtl": "their materials",
        }
        extra["triangles"] = triangles
    seconds["total"] = time.perf_counter() - began
    headline = _headline(read, instances, table)
    _page(output, read, table, headline, seconds, memory, record)
    return {
        "headline": headline,
        "files": files,
        "size_m": list(read.size_m),
        "seed": chosen,
        "plants": dict(zip(instances.taxa, instances.counts.tolist())),
        "cover": table.to_dict("records"),
        "timings_s": seconds,
        "build_memory_mib": memory,
        "peak_memory_mib": peak_memory_mib(),
        **extra,
    }


def _layers(instances: Instances, model: PlotModel) -> np.ndarray:
    """Borders of the voxel layers that plants reach from level ground [m]."""
    step = model.grid.vertical_size
    return np.arange(np.ceil(1.1 * instances.height.max(initial=step) / step) + 1.0) * step


def _resized(plot: Plot, size: float) -> Plot:
    """The plot with another side; voxels must divide it and crowns fit."""
    widest = float(plot.diameter_m.max())
    count = round(size / plot.voxel_m) if np.isfinite(size) else 0
    if count < 1 or abs(count * plot.voxel_m - size) > 1e-6 * size:
        raise InputError(
            f"`size` must be a whole number of voxels of {plot.voxel_m:g} m, but is {size:g} m"
        )
    if size < widest:
        raise InputError(f"`size` must be at least the widest crown, {widest:g} m, but is {size:g}")
    if not 0.5 <= size <= 1000.0:
        raise InputError(f"`size` must be 0.5 to 1000 m, but is {size:g} m")
    return dataclasses.replace(plot, size_m=(float(size), float(size)))


def cover_table(
    plot: Plot,
    parameters: PlotParameters,
    instances: Instances,
    real: np.ndarray,
    cover: ProjectedCover,
) -> pd.DataFrame:
    """Cover of each species and of all, asked and measured [%], with the numbers of plants.

    `counted` is `crowns` less what eq. (8) and (9) take off for packing and gaps: what eq. (10)
    steers to the cover asked for.
    """
    species = parameters.species
    share = (1.0 - np.asarray(species.packing)) * np.asarray(species.fill)
    columns = {
        "asked_percent": plot.cover,
        "counted_percent": cover.crowns * share,
        "crowns_percent": cover.crowns,
        "species_percent": cover.species,
        "seen_percent": cover.seen,
    }
    table = pd.DataFrame(
        {
            "taxon": [*plot.taxa, "all"],
            "equation_10_without_ceiling": [*real, real.sum()],
            "plants": [*instances.counts, len(instances)],
        }
    )
    for name, values in columns.items():
        # What all species cover together is no sum: where they overlap ground counts once.
        whole = cover.total if name == "species_percent" else float(np.sum(values))
        table[name] = 100.0 * np.array([*values, whole])
    return table


def instance_table(instances: Instances) -> pd.DataFrame:
    """Every plant, with units in the names of the columns."""
    return pd.DataFrame(
        {
            "taxon": np.array(instances.taxa, dtype=object)[instances.species],
            "x_m": instances.x.round(4),
            "y_m": instances.y.round(4),
            "z_m": instances.z.round(4),
            "azimuth_deg": instances.azimuth.round(2),
            "tilt_deg": instances.tilt.round(2),
            "diameter_m": instances.diameter.round(4),
            "height_m": instances.height.round(4),
        }
    )


def voxel_dataset(model: PlotModel, density: Any) -> xr.Dataset:
    """Area density [class, z, y, x] with its coordinates, ready for `write_run`."""
    x, y, z = model.grid.centres
    names = [f"{model.taxa[one]}, leaf" for one in leafy_species(model.forms)] + ["wood", "flower"]

    def axis(letter: str, values: np.ndarray, what: str) -> tuple[str, np.ndarray, dict[str, str]]:
        standard = {
            "standard_name": "height" if letter == "z" else f"projection_{letter}_coordinate",
            **({"positive": "up"} if letter == "z" else {}),
        }
        return letter, values, {"units": "m", "axis": letter.upper(), "long_name": what} | standard

    level = model.terrain is None
    found: dict[str, Any] = {
        "area_density": (
            ("class", "z", "y", "x"),
            np.asarray(density),
            {"long_name": "one-sided area per volume", "units": "m2 m-3"},
        )
    }
    if not level:
        told = {"long_name": "height of the ground above its lowest", "units": "m"}
        found["ground"] = (("y", "x"), model.terrain, told)
    return xr.Dataset(
        found,
        coords={
            "class": ("class", names, {"long_name": "optical class"}),
            "z": axis(
                "z", z, f"height of the voxel's centre above {'' if level else 'the lowest '}ground"
            ),
            "y": axis("y", y, "distance north of the south-west corner"),
            "x": axis("x", x, "distance east of the south-west corner"),
        },
    )


def _headline(plot: Plot, instances: Instances, table: pd.DataFrame) -> list[str]:
    species, whole = table.iloc[:-1], table.iloc[-1]
    worst = (species.counted_percent - species.asked_percent).abs().max()
    lx, ly = plot.size_m
    return [
        f"{plot.name}, {lx:g} m x {ly:g} m: {len(instances)} plants of {len(species)} species, "
        "as many as eq. (10) says.",
        f"Covers asked for sum to {whole.asked_percent:.1f} %, crowns in full to "
        f"{whole.crowns_percent:.1f} %; overlapping, they leave "
        f"{100 - whole.species_percent:.1f} % of the ground bare.",
        f"Cover counted as eq. (10) does is within {worst:.2f} % of the ground of what was asked, "
        "for every species.",
    ]


def _page(
    folder: Path,
    plot: Plot,
    table: pd.DataFrame,
    headline: list[str],
    seconds: dict[str, float],
    memory: float,
    record: Any,
) -> None:
    page = Page(f"Scene: {plot.name}", headline[0])
    whole = table.iloc[-1]
    page.key_figures(
        {
            "plants": str(whole.plants),
            "ground under crowns": f"{whole.species_percent:.1f} %",
            "crowns in full": f"{whole.crowns_percent:.1f} %",
            "time of the build": f"{seconds['build']:.1f} s",
            "its memory": f"{memory / 1024:.1f} GiB",
        }
    )
    page.paragraph(" ".join(headline[1:]))
    page.figure(folder / "plan.png", "The crowns from above, the tallest on top.")
    page.figure(folder / "oblique.png", "The plants from the south-south-west.")
    page.figure(
        folder / "profile.png",
        "Leaf area (seen from outside the shoots) and wood area against height.",
    )
    page.table(
        table,
        headers=_COVER_HEADERS,
        units=dict.fromkeys(_COVER_HEADERS, "%"),
        caption="Cover. Counted: crowns less packing and gaps, what eq. (10) steers to the cover "
        "asked for. Ground under the species: overlap counts once.",
    )
    page.table(
        pd.DataFrame({"what": list(seconds), "seconds": list(seconds.values())}),
        caption=f"Wall time; peak memory of the build {memory:.0f} MiB.",
        folded=True,
    )
    page.footer(record)
    page.write(folder / "report.html")
