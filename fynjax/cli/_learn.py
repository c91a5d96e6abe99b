"""`fynjax learn`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax.cli._bioscape import OnlyPlots, TraitLibrary
from fynjax.cli._runtime import Checkpoint, Job, SchedulerAddress, Seed, WorkerCount, command
from fynjax.cli._validate_plots import Size, Voxel, check_voxel, field_tables


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return field_tables(given["folders"], given)


@command("learn", forget=True, work=_work)
def learn(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...",
            help="Folders with *CoverData.csv, *VegData.csv, *TraitLibrary.csv, *VegCenters.csv "
            "and *waves.csv.",
        ),
    ],
    plot: OnlyPlots = None,
    traits: TraitLibrary = None,
    size: Size = 5.0,
    voxel: Voxel = 0.1,
    slope_voxel: Annotated[
        float,
        typer.Option(min=0.02, max=1.0, metavar="M", help="Edge of a voxel for derivatives [m]."),
    ] = 0.25,
    title: Annotated[str, typer.Option(help="What the plots are.")] = "Plots of low shrubland",
    licence: Annotated[str, typer.Option(help="Of the numbers, for the prior file.")] = "",
    source: Annotated[
        list[str] | None, typer.Option(help="Where the data are from; may be given again.")
    ] = None,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
    seed: Seed = 0,
) -> Job:
    """Learn what plots share, and how they vary, from the spectra of all at once.

    Growth forms' leaf area, dead tissue and clumping, leaf chemistry, brightness of soil and dead
    tissue, and the model's remaining error. Writes prior.toml, which --prior of other commands
    takes, tables, and a report page with scores of plots left out. An interrupted run goes on when
    the same command is given again.

    Example:  fynjax learn tables --output population
    """
    check_voxel(size, voxel)
    check_voxel(size, max(slope_voxel, voxel))
    assert checkpoint is not None  # `command` gives the folder
    from fynjax.jobs import Workers
    from fynjax.studies.bioscape import Resolution
    from fynjax.studies.bioscape import learn as run_learn

    return lambda target: run_learn(
        folders,
        target,
        plots=plot or None,
        traits=traits,
        resolution=Resolution(size, voxel),
        slope_voxel_m=slope_voxel,
        title=title,
        licence=licence,
        sources=source or [],
        seed=seed,
        checkpoint=checkpoint,
        workers=Workers(workers, scheduler),
    )
