"""`fynjax calibrate-plots`."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from fynjax.cli._bioscape import SHIPPED, OnlyPlots, PriorFile, TraitLibrary
from fynjax.cli._runtime import Checkpoint, Job, SchedulerAddress, Seed, WorkerCount, command
from fynjax.cli._validate_plots import Size, Tables, Voxel, check_voxel, field_tables


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return field_tables([given["folder"]], given)


@command("calibrate-plots", forget=True, work=_work)
def calibrate_plots(
    folder: Tables,
    plot: OnlyPlots = None,
    traits: TraitLibrary = None,
    prior: PriorFile = SHIPPED,
    size: Size = 5.0,
    voxel: Voxel = 0.25,
    realisations: Annotated[
        int,
        typer.Option(
            min=3,
            max=50,
            help="Stand realisations used to estimate sampling variance.",
        ),
    ] = 3,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
    seed: Seed = 0,
) -> Job:
    """Infer covers, leaf area, dead tissue, gap and leaf traits of plots from measured spectra.

    Once with the plot's own tables as a weak prior, once with the other plots' means. Compares
    with the field's community-weighted means, and with a published regression (*LMA*model*.json)
    if the folder has it. Writes a report page, tables and figures. An interrupted run goes on when
    the same command is given again.

    Example:  fynjax calibrate-plots tables --output inference
    """
    check_voxel(size, voxel)
    assert checkpoint is not None  # `command` gives the folder
    from fynjax.jobs import Workers
    from fynjax.studies.bioscape import Resolution
    from fynjax.studies.bioscape import calibrate_plots as run_calibrate_plots

    return lambda target: run_calibrate_plots(
        folder,
        target,
        plots=plot or None,
        traits=traits,
        prior=prior,
        resolution=Resolution(size, voxel),
        realisations=realisations,
        seed=seed,
        checkpoint=checkpoint,
        workers=Workers(workers, scheduler),
    )
