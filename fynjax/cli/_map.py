"""`fynjax map`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax._core.errors import InputError
from fynjax.cli._runtime import Checkpoint, Job, SchedulerAddress, Seed, WorkerCount, command


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """What tells the cost of maps: the size of the cube."""
    from fynjax.io.raster import open_blocks

    with open_blocks(given["cube"]) as source:
        rows, columns = source.shape[:2]
        bands = len(source.wavelength)
    files = [given["cube"], given["training"]]
    pixels = {"pixels": rows * columns, "bands": bands}
    return {"files": files, **pixels, "steps": len(given["pixel"] or ()) * given["pixel_steps"]}


def _place(text: str) -> tuple[int, int]:
    """Row and column of a pixel, as 12,40."""
    try:
        row, column = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--pixel: expected a row and a column, such as 12,40, but got {text!r}"
        ) from None
    return row, column


@command("map", work=_work)
def map_command(
    cube: Annotated[
        Path,
        typer.Argument(
            metavar="CUBE", help="Surface reflectance: ENVI, GeoTIFF, NetCDF or zarr, of any size."
        ),
    ],
    training: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Training for this sensor and sun (`fynjax train`)."),
    ],
    likely: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Pixels less like the simulations than this share of these are masked.",
        ),
    ] = 0.99,
    keep_unlike: Annotated[
        bool, typer.Option("--keep-unlike", help="Do not mask them; the map of it stays.")
    ] = False,
    skip_damaged: Annotated[
        bool,
        typer.Option("--skip-damaged", help="Leave rows that cannot be read without data."),
    ] = False,
    zarr: Annotated[
        bool, typer.Option("--zarr", help="Write maps.zarr as well, a variable each.")
    ] = False,
    pixel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COLUMN",
            help="Sample the full posterior of this pixel by emcee as well, counted from 1 at the "
            "upper left of the cube; some 13 minutes of a core. May be given again.",
        ),
    ] = None,
    pixel_steps: Annotated[
        int, typer.Option(metavar="N", min=12, help="Steps of each of its 16 walkers.")
    ] = 400,
    prior: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="For --pixel: the prior of the training, if not the shipped one.",
        ),
    ] = None,
    seed: Seed = 0,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
) -> Job:
    """Map covers, leaf area and leaf traits of a cube, each with its uncertainty.

    Writes one cloud-optimised GeoTIFF: of each quantity mean, standard deviation and 5 and 95 %
    quantile, and how unlike the simulations a pixel is. The cube is read block by block. Of pixels
    that are asked for, the full posterior stands beside it.

    Example:  fynjax map flight.hdr --training emit_30/training.nc --output maps
    """
    from fynjax import jobs
    from fynjax.io.plot import DEFAULT_PRIOR

    assert checkpoint is not None
    pixels = [_place(text) for text in pixel or ()]
    return lambda folder: jobs.map_cube(
        cube,
        training,
        folder,
        likely=likely,
        keep_unlike=keep_unlike,
        skip_damaged=skip_damaged,
        zarr=zarr,
        pixels=pixels,
        pixel_steps=pixel_steps,
        prior=DEFAULT_PRIOR if prior is None else prior,
        seed=seed,
        checkpoint=checkpoint,
        workers=jobs.Workers(workers, scheduler),
    )
