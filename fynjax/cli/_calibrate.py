"""`fynjax calibrate`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax.cli._bioscape import PriorFile
from fynjax.cli._runtime import Checkpoint, Job, OwnSeed, PlotPath, command

Targets = Annotated[
    list[Path],
    typer.Option(
        metavar="FILE",
        help="What was measured; may be given once for each kind. Drone image (GeoTIFF, "
        "reflectance) or a table with statistic, value, sd. Spectrum (CSV, ASD, ENVI library) or "
        "image of many bands (ENVI, NetCDF, GeoTIFF), of which the mean counts. Point cloud (LAS, "
        "LAZ) or a table with metric, value, sd, grain_m, returns_m2.",
    ),
]

Bands = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,...",
        help="What each band of the drone image is, where it does not say: green, red, red_edge, "
        "nir, and any other name for bands that are not used.",
    ),
]


def work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """What tells the cost of an inversion."""
    return {"plot": given["plot"], "files": given["target"]}


@command("calibrate", forget=True, work=work)
def calibrate(
    plot: PlotPath,
    target: Targets,
    bands: Bands = None,
    prior: PriorFile = "none",
    checkpoint: Checkpoint = None,
    seed: OwnSeed = None,
) -> Job:
    """Find the parameters of a plot that explain what was measured of it.

    By one sensor or several at once. Writes every parameter with prior, estimate and standard
    deviation, the statistics before and after, images, figures and a report page. An interrupted
    run goes on when the same command is given again.

    Example:  fynjax calibrate plot.toml --target statistics.csv --target cloud.laz
    """
    from fynjax.io.text import existing_file

    for path in target:
        existing_file(path, "an image, a spectrum, a point cloud or a table of their statistics")
    from fynjax import jobs

    return lambda folder: jobs.calibrate(
        plot,
        target,
        folder,
        bands=None if bands is None else bands.split(","),
        prior=prior,
        seed=seed,
        checkpoint=checkpoint,
    )
