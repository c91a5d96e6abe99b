"""`fynjax calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.cli._render import PlotPath
from fynjax.cli._runtime import Json, Output, OwnSeed, Quiet, run_job

Target = Annotated[
    Path,
    typer.Option(
        metavar="IMAGE.tif|STATS.csv",
        help="Real image (GeoTIFF, reflectance), or a table with statistic, value, sd.",
    ),
]


def calibrate(
    plot: PlotPath,
    target: Target,
    output: Output = Path("output/calibrate"),
    seed: OwnSeed = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the parameters of a plot that explain a real image.

    Writes every parameter with prior, estimate and standard deviation, the statistics before and
    after, images, figures and a report page.

    Example:  fynjax calibrate plot.toml --target statistics.csv
    """
    from fynjax.io._plot_file import read_plot
    from fynjax.io._tables import existing_file

    # Before the heavy imports: a slip in a file shows at once.
    read = read_plot(plot)
    number = read.seed if seed is None else seed
    existing_file(target, "an image or a table of statistics")
    from fynjax.report._jobs import run_calibrate

    run_job(
        "calibrate",
        lambda folder, progress: run_calibrate(
            plot, target, folder, seed=number, progress=progress
        ),
        output,
        seed=number,
        as_json=json,
        quiet=quiet,
    )
