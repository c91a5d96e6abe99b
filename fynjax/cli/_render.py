"""`fynjax render`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.cli._runtime import Json, Output, OwnSeed, Quiet, run_job

PlotPath = Annotated[
    Path, typer.Argument(metavar="PLOT.toml", help="Plot file; `fynjax init` writes one.")
]


def render(
    plot: PlotPath,
    output: Output = Path("output/render"),
    seed: OwnSeed = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Render what the drone sees of a plot.

    Writes the reflectance image (GeoTIFF), the run (NetCDF) and a report page.

    Example:  fynjax render plot.toml --output render
    """
    from fynjax import jobs

    run_job(
        "render",
        lambda folder, progress: jobs.render(plot, folder, seed=seed, progress=progress),
        output,
        as_json=json,
        quiet=quiet,
    )
