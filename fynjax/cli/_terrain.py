"""`fynjax terrain`."""

import inspect
import re
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from fynjax._core.errors import InputError
from fynjax.cli._runtime import Job, command

T = TypeVar("T")


class Method(StrEnum):
    """How ground is classified."""

    smrf = "smrf"
    cloth = "cloth"
    labels = "labels"


class Unit(StrEnum):
    """Units that coordinates may be stated in."""

    metre = "metre"
    centimetre = "centimetre"
    millimetre = "millimetre"
    foot = "foot"
    us_survey_foot = "us_survey_foot"


def _naming_options(job: Callable[..., T], *given: Any, **named: Any) -> T:
    """What `job` returns; its errors name options instead of arguments: `--largest-gap`."""
    try:
        return job(*given, **named)
    except InputError as error:
        names = "|".join(inspect.signature(job).parameters)
        message = re.sub(
            f"`({names})`", lambda match: f"`--{match[1].replace('_', '-')}`", str(error)
        )
        error.args = (message,)
        raise


InputPath = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help="Point cloud (LAS, LAZ, PLY, XYZ, CSV) or height raster (GeoTIFF)."
    ),
]


@command("terrain", work=lambda given: {"files": [given["file"]]})
def terrain(
    file: InputPath,
    cell: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a cell [m]; 0.25 for a cloud, a raster's own."),
    ] = None,
    size: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a square plot in the middle of the file [m]."),
    ] = None,
    bounds: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="W S E N", help="Edges of the plot, in the file's coordinates [m]."),
    ] = None,
    method: Annotated[
        Method | None,
        typer.Option(
            help="Ground by the file's labels (the usual, where it has them) or by a filter."
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Largest distance of ground from the lowest points [m]; 0.3."
        ),
    ] = None,
    slope: Annotated[
        float | None,
        typer.Option(help="SMRF slope threshold [m/m]; 0.15."),
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Radius of the widest closed stand [m] (smrf); 5, or half of a smaller cloud.",
        ),
    ] = None,
    largest_gap: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Largest distance of a cell from the nearest ground point [m]; 10."
        ),
    ] = None,
    unit: Annotated[
        Unit | None, typer.Option(help="Unit of a cloud's coordinates, if not metres.")
    ] = None,
    height_unit: Annotated[Unit | None, typer.Option(help="Unit of heights, if another.")] = None,
    crs: Annotated[
        str | None,
        typer.Option(metavar="EPSG:N", help="Reference system of a file that states none."),
    ] = None,
    fill_gaps: Annotated[
        bool, typer.Option("--fill-gaps", help="Interpolate cells of a raster without height.")
    ] = False,
    band: Annotated[
        int | None, typer.Option(metavar="N", help="Band of a raster that has the heights, from 1.")
    ] = None,
) -> Job:
    """Make the ground of a plot from a point cloud or a height raster.

    Writes the ground as GeoTIFF and OBJ, a picture and, from a cloud, the height of the canopy.

    Example:  fynjax terrain plot.laz --size 66 --output terrain
    """
    from fynjax import jobs

    return lambda folder: _naming_options(
        jobs.terrain,
        file,
        folder,
        cell=cell,
        bounds=bounds,
        size=size,
        method=None if method is None else method.value,
        tolerance=tolerance,
        slope=slope,
        window=window,
        largest_gap=largest_gap,
        unit=None if unit is None else unit.value,
        height_unit=None if height_unit is None else height_unit.value,
        crs=crs,
        fill_gaps=fill_gaps,
        band=band,
    )
