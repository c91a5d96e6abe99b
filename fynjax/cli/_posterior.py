"""`fynjax posterior`."""

from typing import Annotated, Literal

import typer

from fynjax.cli._bioscape import PriorFile
from fynjax.cli._calibrate import Bands, Targets, work
from fynjax.cli._runtime import Checkpoint, Job, OwnSeed, PlotPath, command

Free = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PATTERN",
        help="Parameters to free, such as species.*.cover; may be repeated. The plot file's if "
        "left out.",
    ),
]


@command("posterior", work=work)
def posterior(
    plot: PlotPath,
    target: Targets,
    bands: Bands = None,
    method: Annotated[
        Literal["emcee", "nuts", "laplace"],
        typer.Option(
            help="An ensemble of walkers, Hamiltonian sampling, or the Gaussian about the fit."
        ),
    ] = "emcee",
    free: Free = None,
    draws: Annotated[int, typer.Option(min=1, help="Effective draws to reach.")] = 400,
    steps: Annotated[int, typer.Option(min=1, help="Most steps of the chain.")] = 5000,
    prior: PriorFile = "none",
    checkpoint: Checkpoint = None,
    seed: OwnSeed = None,
) -> Job:
    """Sample which parameters of a plot real measurements leave possible.

    By one sensor or several at once. Writes every draw (NetCDF), the parameters with their
    intervals, figures and a report page. An interrupted run goes on when the same command is given
    again.

    Example:  fynjax posterior plot.toml --target statistics.csv --method laplace
    """
    assert checkpoint is not None  # `command` gives the folder
    from fynjax.io.text import existing_file

    for path in target:
        existing_file(path, "an image, a spectrum, a point cloud or a table of their statistics")
    from fynjax import jobs

    return lambda folder: jobs.posterior(
        plot,
        target,
        folder,
        bands=None if bands is None else bands.split(","),
        method=method,
        free=free,
        target_size=draws,
        max_steps=steps,
        prior=prior,
        checkpoint=checkpoint,
        seed=seed,
    )
