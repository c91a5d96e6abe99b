"""`fynjax build`."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any

import typer

from fynjax.cli._runtime import Job, OwnSeed, PlotPath, command


class SceneView(StrEnum):
    """What the oblique picture shows of a plant."""

    points = "points"
    meshes = "meshes"


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return {key: given[key] for key in ("plot", "size")}


@command("build", work=_work)
def build(
    plot: PlotPath,
    seed: OwnSeed = None,
    size: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of the plot [m]; the plot file's if left out."),
    ] = None,
    cell: Annotated[
        float, typer.Option(metavar="M", help="Cells that cover is measured on [m].")
    ] = 0.01,
    mesh: Annotated[
        bool, typer.Option("--mesh", help="Also write the scene as a mesh (OBJ, MTL).")
    ] = False,
    triangles: Annotated[
        int, typer.Option(min=2000, help="Most triangles of that mesh.")
    ] = 5_000_000,
    view: Annotated[
        SceneView, typer.Option(help="Oblique picture of points, or of meshes (the extra `view`).")
    ] = SceneView.points,
) -> Job:
    """Plant a plot: whole plants, as many as its covers ask for.

    Writes the plants and their cover (CSV), the voxels (NetCDF), pictures and a report page.

    Example:  fynjax build plot.toml --size 20 --output scene
    """
    from fynjax import jobs

    return lambda folder: jobs.build(
        plot,
        folder,
        seed=seed,
        size=size,
        cell=cell,
        mesh=mesh,
        max_triangles=triangles,
        view=view.value,
    )
