"""The job of `fynjax build`: the plants of a plot, its cover, its voxels and its pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import equinox as eqx
import jax
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Array, Float
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import build_plot, check_memory
from fynjax.app.io.instruments import check_triangles, scene_meshes, write_scene_mesh
from fynjax.app.io.plot import Plot, as_plot
from fynjax.app.io.raster import write_run
from fynjax.app.jobs._result import JobResult, Rows
from fynjax.app.jobs._run import Run, peak_memory_mib
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.canopy import PlantModel
from fynjax.scene import (
    GroundParameters,
    Instances,
    PlotParameters,
    ProjectedCover,
    Scene,
    StandArea,
    clark_evans_indices,
    hard_counts,
    hard_instances,
    hard_scene,
    height_profile,
    leaf_classes,
    material_classes,
    projected_cover,
    stand_area,
)

_DEFINITIONS = {
    "projected": "Cover of a species is the share of the ground below its crowns, overlap among "
    "them counted once, as a relevé notes it (projected).",
    "article": "Cover of a species is its crowns in full, less packing and gaps, over the ground, "
    "as the article on the example plot counts it; overlap counts more than once.",
}

_COVER_HEADERS = {
    "asked_percent": "asked",
    "planted_percent": "planted",
    "crowns_percent": "crowns in full",
    "species_percent": "ground under the species",
    "visible_percent": "seen from above",
    "clark_evans": "Clark-Evans index",
}

_STAND_HEADERS = {
    "leaf_area_index": "live leaf area index",
    "dead_area_index": "dead tissue in live shoots",
    "wood_area_index": "wood area index",
    "leaf_mass_g_m2": "leaf mass",
}
_STAND_UNITS = dict.fromkeys(_STAND_HEADERS, "m2 m-2") | {"leaf_mass_g_m2": "g m-2"}

_area_density = eqx.filter_jit(Scene.area_density)


def _files(scene: Scene, plants: int, triangles: int | None) -> dict[str, str]:
    """Files that a build writes, each with how much is in it."""
    rows = f"{len(scene.taxa)} species"
    files = {"instances.csv": f"{plants} plants", "cover.csv": rows, "stand.csv": rows}
    files["voxels.nc"] = f"{' x '.join(map(str, scene.grid.shape))} voxels"
    mesh = {} if triangles is None else {"scene.obj": f"at most some {triangles} triangles"}
    return files | mesh


class BuildResult(JobResult):
    """Result of `build`: plants of each taxon and their cover."""

    command: Literal["build"] = "build"
    size_m: tuple[float, float]
    plants: dict[str, int]
    cover: Rows = Field(description="Rows of cover.csv.")
    stand: Rows = Field(description="Rows of stand.csv.")
    gap_fraction: float = Field(
        description="Share of the ground seen from straight above, between leaves and stems [-]."
    )
    build_memory_mib: float = Field(description="Largest memory before pictures and meshes [MiB].")
    triangles: int | None = None


@double_precision
def build(
    plot: Plot | str | Path,
    output: str | Path,
    *,
    seed: Seed | None = None,
    size: float | None = None,
    cell: float = 0.01,
    mesh: bool = False,
    max_triangles: Annotated[int, Field(ge=2000)] = 5_000_000,
    view: Literal["points", "meshes"] = "points",
) -> BuildResult:
    """Plant a plot: whole plants, as many as its covers ask for.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `output`: folder of the results, made if missing.
    - `seed`: seed of everything random; the plot file's if left out.
    - `size`: side of a square plot [m]; the plot file's if left out. Its maps must cover it.
    - `cell`: side of the cells that cover is measured on [m].
    - `mesh`: also write the scene as a mesh (OBJ, MTL).
    - `max_triangles`: most triangles of that mesh.
    - `view`: oblique picture of points, or of the generated meshes of the taxa in sun and sky.

    **Returns:** `BuildResult`. Writes tables of the plants and of the cover of each species, the
    area density in voxels (`voxels.nc`), areas, leaf mass and gap of the stand (`stand.csv`),
    pictures and a page into `output`, and with `mesh` the scene as `scene.obj` and `scene.mtl`.
    Warns of areas outside what shrublands have.

    **Raises:** `InputError` as `read_plot`, for maps that do not cover the plot, and for a mesh of
    too many triangles.

    Example: `jobs.build("plot.toml", Path("results"), mesh=True)`.
    """
    read = as_plot(plot)
    read = read if size is None else resized(read, size)
    run = Run(output, seed=seed, plot=read)
    check_memory(read, listed=True)
    with run.stage("Plant the plot", "plants"):
        scene, parameters = build_plot(read, seed=run.seed)
        plants = int(hard_counts(scene, parameters).sum())
        if mesh:  # early: it may be refused
            check_triangles(plants, max_triangles)
        begin_work(_files(scene, plants, max_triangles if mesh else None))
        real = np.asarray(scene.counts(parameters), float)
        instances = hard_instances(scene, parameters)
        hard = hard_scene(scene, parameters)
        del scene  # its spare plants
    meshes, triangles = None, 0
    if mesh:
        with run.stage("Grow the meshes", "meshes"):
            meshes, triangles = scene_meshes(
                instances, hard, parameters, max_triangles=max_triangles, seed=run.seed
            )
    with run.stage("Fill the voxels", "voxels"):
        density = _area_density(hard, parameters)
        jax.block_until_ready(density)
    memory = peak_memory_mib()
    run.seconds["build"] = run.seconds["plants"] + run.seconds["voxels"]
    with run.stage("Measure the cover", "cover"):
        cover = projected_cover(instances, cell=cell, periodic=hard.boundary == "periodic")
        table = cover_table(read, parameters, instances, real, cover)
        area = stand_area(hard, parameters)
        stand = species_stand(hard.taxa, area)
    record = run.record(read.inputs)
    with run.stage("Write", "write"):
        run.table(
            "instances.csv", instance_table(instances), "every plant: place, turn, size", None
        )
        run.table("cover.csv", table, "cover of each species, asked and measured", "%.4f")
        run.table("stand.csv", stand, "leaf, dead and wood area, leaf mass", "%.4f")
        voxels = run.path("voxels.nc", "area density of each optical class, NetCDF")
        write_run(voxels, voxel_dataset(hard, density), record)
        del density
    with run.stage("Draw", "figures"):
        pictures = _pictures(read, hard, parameters, instances, run.seed, view)
    if meshes is not None:
        with run.stage("Write the mesh", "write_mesh"):
            # Each species in its colour.
            colours = [tuple(figures.rgb(c).tolist()) for c in figures.species_colours(hard.forms)]
            obj = run.path("scene.obj", f"the plants as {triangles} triangles, metres")
            write_scene_mesh(obj, instances, meshes, colours)
            run.path("scene.mtl", "their materials")
    headline = _headline(read, table, area, parameters)
    run.total()
    parts: list[Part] = [" ".join(headline[1:]), *pictures, *_tables(read, table, stand)]
    times = run.times(f"Wall time; peak memory of the build {memory:.0f} MiB.", folded=True)
    whole = table.iloc[-1]
    keys = {
        "plants": str(whole.plants),
        "ground under crowns": f"{whole.species_percent:.1f} %",
        "ground seen from above": f"{100.0 * area.gap:.1f} %",
        "crowns in full": f"{whole.crowns_percent:.1f} %",
        "time of the build": f"{run.seconds['build']:.1f} s",
        "its memory": f"{memory / 1024:.1f} GiB",
    }
    sections = [Section("", [*parts, times])]
    run.page(Page("build", f"Scene: {read.name}", headline[0], sections, keys, record))
    return run.result(
        BuildResult,
        headline=headline,
        size_m=read.size_m,
        plants=dict(zip(instances.taxa, instances.counts.tolist())),
        cover=table,
        stand=stand,
        gap_fraction=area.gap,
        warnings=area.warnings(),
        build_memory_mib=memory,
        triangles=triangles if mesh else None,
    )


def _pictures(
    plot: Plot,
    scene: Scene,
    parameters: PlotParameters,
    instances: Instances,
    seed: int,
    view: Literal["points", "meshes"],
) -> list[Picture]:
    """The plants from above and from obliquely above, and their areas against height."""
    periodic = scene.boundary == "periodic"
    # Borders of the voxel layers that plants reach from level ground.
    step = scene.grid.vertical_size
    edges = np.arange(np.ceil(1.1 * instances.height.max(initial=step) / step) + 1.0) * step
    profile = height_profile(scene, parameters, edges)
    drawn = drawn_plants(plot, scene, parameters, instances, seed)
    above = f"{plot.name}: {len(instances)} plants from above"
    title = f"{plot.name}: from the south-south-west"
    oblique = (
        figures.lit_figure(instances, scene, title)
        if view == "meshes" and len(instances)
        else figures.oblique_view(drawn, periodic=periodic, ground=scene.terrain, title=title)
    )
    return [
        Picture(
            "plan.png",
            figures.plan_view(drawn, periodic=periodic, title=above),
            "the plants from above",
            "The crowns from above, the tallest on top.",
        ),
        Picture(
            "oblique.png",
            oblique,
            "the plants from obliquely above",
            "The plants from the south-south-west.",
        ),
        Picture(
            "profile.png",
            figures.profile_view(profile, edges, instances, scene.forms),
            "leaf and wood area density against height",
            "Leaf area (seen from outside the shoots) and wood area against height.",
        ),
    ]


def drawn_plants(
    plot: Plot, scene: Scene, parameters: PlotParameters, instances: Instances, seed: int
) -> figures.DrawnPlants:
    """The plants as they are drawn: with the area that they have in the hard `scene`, and shapes
    of their own where the species table names one."""
    first = np.asarray(scene.planting.first)
    species = np.asarray(scene.planting.species)
    models: list[PlantModel | None] = [None] * len(plot.species)
    for i in np.unique(species):
        if plot.species[i].plant is not None:
            plant = np.flatnonzero(species == i)[0]
            own = slice(first[plant], first[plant] + int(scene.planting.count[plant]))
            models[i] = jax.tree.map(lambda values, own=own: values[own], scene.planting.shapes)
    index = np.asarray(scene.organ_index(parameters), float) * float(scene.crown_share(parameters))
    return figures.DrawnPlants(
        instances,
        scene.forms,
        index / np.asarray(scene.branches)[:, None],
        np.asarray(parameters.species.dead_fraction, float),
        models,
        seed,
    )


def resized(plot: Plot, size: float) -> Plot:
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
    return plot.replace(size_m=(float(size), float(size)))


def cover_table(
    plot: Plot,
    parameters: PlotParameters,
    instances: Instances,
    real: np.ndarray,
    cover: ProjectedCover,
) -> pd.DataFrame:
    """Cover of each species and of all, asked and measured [%], with the numbers of plants.

    What is planted is of the kind that is asked for: the ground under the species, or `crowns` less
    what eq. (8) and (9) take off for packing and gaps. `real` are numbers of plants that covers ask
    for, before they are rounded.
    """
    species, planted = parameters.species, cover.species
    if plot.cover_definition == "article":
        planted = cover.crowns * (1.0 - np.asarray(species.packing)) * np.asarray(species.fill)
    columns = {
        "asked_percent": plot.cover,
        "planted_percent": planted,
        "crowns_percent": cover.crowns,
        "species_percent": cover.species,
        "visible_percent": cover.visible,
    }
    table = pd.DataFrame(
        {
            "taxon": [*plot.taxa, "all"],
            "plants_asked": [*real, real.sum()],
            "plants": [*instances.counts, len(instances)],
        }
    )
    for name, values in columns.items():
        # What all species cover together is no sum: where they overlap ground counts once.
        whole = cover.total if name == "species_percent" else float(np.sum(values))
        table[name] = 100.0 * np.array([*values, whole])
    table["clark_evans"] = clark_evans_indices(instances, periodic=plot.boundary == "periodic")
    return table


def species_stand(taxa: Sequence[str], area: StandArea) -> pd.DataFrame:
    """Leaf, dead and wood area over the ground of the plot and mass of the leaves, of each species
    and of all."""
    table = pd.DataFrame(
        {
            "taxon": taxa,
            "leaf_area_index": area.leaf,
            "dead_area_index": area.dead,
            "wood_area_index": area.wood,
            "leaf_mass_g_m2": area.leaf_mass,
        }
    )
    whole = {"taxon": "all"} | table.drop(columns="taxon").sum().to_dict()
    return pd.concat([table, pd.DataFrame([whole])], ignore_index=True)


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
        | ({} if instances.leaf is None else {"leaf": instances.leaf})
    )


def voxel_dataset(scene: Scene, density: Float[Array, "class z y x"]) -> xr.Dataset:
    """Area density [class, z, y, x] with its coordinates, ready for `write_run`."""
    names = [
        f"{scene.taxa[k]}, leaf" + f" {leaf}" * (len(own) > 1)
        for k, own in leaf_classes(scene.species).items()
        for leaf in range(len(own))
    ]
    others = material_classes(scene.species).values()
    names += ["wood", "flower", *(f"{scene.taxa[i]}, {one.name}" for _, i, one in others)]
    above = "ground" if scene.terrain is None else "the lowest ground"
    axes = {
        "x": {"long_name": "distance east of the south-west corner"},
        "y": {"long_name": "distance north of the south-west corner"},
        "z": {"long_name": f"height of the voxel's centre above {above}", "positive": "up"},
    }
    for letter, about in axes.items():
        standard = "height" if letter == "z" else f"projection_{letter}_coordinate"
        about |= {"units": "m", "axis": letter.upper(), "standard_name": standard}
    of_area = {"long_name": "one-sided area per volume", "units": "m2 m-3"}
    variables: dict[str, Any] = {
        "area_density": (("class", "z", "y", "x"), np.asarray(density), of_area)
    }
    if scene.terrain is not None:
        of_ground = {"long_name": "height of the ground above its lowest", "units": "m"}
        variables["ground"] = (("y", "x"), scene.terrain, of_ground)
    centres = zip(axes.items(), scene.grid.centres, strict=True)
    return xr.Dataset(
        variables,
        coords={
            "class": ("class", names, {"long_name": "optical class"}),
            **{letter: (letter, values, about) for (letter, about), values in centres},
        },
    )


def _headline(
    plot: Plot, table: pd.DataFrame, area: StandArea, parameters: PlotParameters
) -> list[str]:
    species, whole = table.iloc[:-1], table.iloc[-1]
    worst = (species.planted_percent - species.asked_percent).abs().max()
    lx, ly = plot.size_m
    how = "as many as their covers ask for." if plot.crowns_note is None else "which are known."
    known = [] if plot.crowns_note is None else [plot.crowns_note]
    even = [
        f"The nearest plants are {index:.2f} times as far apart as at random (index of Clark and "
        "Evans)."
        for index in [whole.clark_evans]
        if index == index  # not NaN, of fewer than two plants
    ]
    none = species[(species.plants == 0) & (species.asked_percent > 0.0)]
    absent = [
        f"No plant of {', '.join(map(str, none.taxon))}: less than one is asked for, and chance "
        "left it out. Another seed may plant it."
    ]
    return [
        f"{plot.name}, {lx:g} m x {ly:g} m: {whole.plants} plants of "
        f"{(species.plants > 0).sum()} species, {how}",
        *absent[: len(none)],
        *known,
        f"{_DEFINITIONS[plot.cover_definition]} Summed over species: asked "
        f"{whole.asked_percent:.1f} %, planted {whole.planted_percent:.1f} %, seen from above "
        f"{whole.visible_percent:.1f} %, where the highest crown hides what is below; "
        f"{100 - whole.species_percent:.1f} % of the ground has no crown over it.",
        f"Of every species what is planted is within {worst:.2f} % of the ground of what was "
        "asked: plants are whole, and stand by chance.",
        *even,
        f"Over the ground of the plot: live leaf area {area.leaf.sum():.2f}, dead tissue of live "
        f"shoots {area.dead.sum():.2f}, wood {area.wood.sum():.2f} m2 m-2; leaves, live and dead, "
        f"of {area.leaf_mass.sum():.0f} g m-2. From straight above {100 * area.gap:.1f} % of the "
        "ground shows: what has no crown over it, and what is seen through crowns, between leaves "
        "and stems.",
        _of_ground(plot, parameters.ground),
    ]


def _of_ground(plot: Plot, ground: GroundParameters) -> str:
    """Soil of the plot, measured or assumed, and the shares of litter, char and rock on it, in a
    sentence."""
    stated, covers = plot.ground, []
    for name in ("litter", "char", "rock"):
        if (share := float(getattr(ground, f"{name}_fraction"))) > 0.0:
            covers.append(f"{100.0 * share:.3g} % {name}")
    if stated.map is not None:
        covers = ["covers as its map has them"]
    lies = f" with {' and '.join(covers)}" if covers else ", nothing on it"
    if stated.soil in ("dry", "wet"):
        return f"Ground: assumed, as the shipped {stated.soil} soil{lies}."
    return f"Ground: the soil of {Path(stated.soil).name}{lies}."


def _tables(plot: Plot, cover: pd.DataFrame, stand: pd.DataFrame) -> list[Table]:
    """Cover, areas and leaf mass, for the page."""
    return [
        Table(
            cover.drop(columns="plants_asked"),
            f"Cover. {_DEFINITIONS[plot.cover_definition]} Crowns in full: all overlap counts. "
            "Ground under the species: overlap among its crowns counts once. Seen from above: "
            "where a crown of the species is the highest. Clark-Evans index: distance of a plant "
            "to the nearest of its species over that at random, 1; below it they are in groups.",
            headers=_COVER_HEADERS,
        ),
        Table(
            stand,
            "Area and leaf mass over the ground of the plot: one-sided area of leaves and of the "
            "dead tissue among them, half of the surface of wood; dry mass of leaves, live and "
            "dead.",
            headers=_STAND_HEADERS,
            units=_STAND_UNITS,
        ),
    ]
