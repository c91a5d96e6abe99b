"""`fynjax sensitivity`."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from fynjax.cli._posterior import Free
from fynjax.cli._runtime import (
    Checkpoint,
    Job,
    OwnSeed,
    PlotPath,
    SchedulerAddress,
    WorkerCount,
    command,
)


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return {
        "plot": given["plot"],
        "metrics": given["metrics"].split(","),
        "plantings": given["plantings"],
        "derivative_samples": given["derivatives"],
        "sobol_samples": given["sobol"],
    }


@command("sensitivity", forget=True, work=_work)
def sensitivity(
    plot: PlotPath,
    metrics: Annotated[
        str, typer.Option(metavar="NAME,...", help="Statistics of the image.")
    ] = "red.mean,nir.mean,NDVI.mean,NDVI.std",
    free: Free = None,
    plantings: Annotated[
        int,
        typer.Option(
            min=2,
            metavar="N",
            help="Plantings over which slopes are taken, at most; fewer where the errors of each "
            "metric's three largest elasticities are below 10 %.",
        ),
    ] = 64,
    derivatives: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="Samples for derivative-based global sensitivity (DGSM), a power of two; 0: none.",
        ),
    ] = 0,
    sobol: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="Points of the Sobol design, a power of two; takes N (parameters + 2) renders.",
        ),
    ] = 0,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
    seed: OwnSeed = None,
) -> Job:
    """Find which parameters of a plot change which statistics of its image.

    Writes slopes and elasticities at the plot's parameters, means over plantings with their
    errors, shares of variance over the priors if asked for, figures and a report page.

    Example:  fynjax sensitivity plot.toml --metrics NDVI.mean,nir.mean --derivatives 64
    """
    from fynjax import jobs

    return lambda folder: jobs.sensitivity(
        plot,
        folder,
        metrics=[name.strip() for name in metrics.split(",")],
        free=free,
        plantings=plantings,
        derivative_samples=derivatives,
        sobol_samples=sobol,
        seed=seed,
        checkpoint=checkpoint,
        workers=jobs.Workers(workers, scheduler),
    )
