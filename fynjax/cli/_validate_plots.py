"""`fynjax validate-plots`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax.cli._bioscape import SHIPPED, OnlyPlots, PriorFile, TraitLibrary
from fynjax.cli._runtime import Checkpoint, Job, SchedulerAddress, Seed, WorkerCount, command

Tables = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help="Folder with *CoverData.csv, *VegData.csv, *TraitLibrary.csv and, for the measured "
        "spectra, *VegCenters.csv and *waves.csv.",
    ),
]
Size = Annotated[
    float, typer.Option(min=1.0, max=100.0, metavar="M", help="Side of a simulated plot [m].")
]
Voxel = Annotated[float, typer.Option(min=0.02, max=1.0, metavar="M", help="Edge of a voxel [m].")]


def check_voxel(size: float, voxel: float) -> None:
    """Whether voxels fill a plot; `InputError` if not."""
    from fynjax._core.errors import InputError

    if abs(round(size / voxel) * voxel - size) > 1e-6 * size:
        raise InputError(f"`--voxel` must divide `--size`, but {voxel:g} does not divide {size:g}")


def field_tables(folders: Sequence[Path], given: Mapping[str, Any]) -> Mapping[str, Any]:
    """What tells the cost of work on the plots of field tables."""
    from fynjax.studies.bioscape import Resolution, read_bioscape

    chosen = given["plot"] or None
    plots = sum(len(read_bioscape(f, chosen, traits=given["traits"])) for f in folders)
    files = [path for folder in folders for path in sorted(folder.glob("*.csv"))]
    resolution = Resolution(given["size"], given["voxel"])
    return {"files": files, "plots": plots, "resolution": resolution}


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return field_tables([given["folder"]], given)


@command("validate-plots", forget=True, work=_work)
def validate_plots(
    folder: Tables,
    plot: OnlyPlots = None,
    traits: TraitLibrary = None,
    prior: PriorFile = SHIPPED,
    size: Size = 5.0,
    voxel: Voxel = 0.1,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
    seed: Seed = 0,
) -> Job:
    """Simulate plots from field tables alone, and compare with their measured spectra.

    Writes a report page, tables, spectra as NetCDF, figures, and the plot files. An interrupted run
    goes on when the same command is given again.

    Example:  fynjax validate-plots tables --output validation
    """
    check_voxel(size, voxel)
    from fynjax.jobs import Workers
    from fynjax.studies.bioscape import Resolution
    from fynjax.studies.bioscape import validate_plots as run_validate_plots

    return lambda target: run_validate_plots(
        folder,
        target,
        plots=plot or None,
        traits=traits,
        prior=prior,
        resolution=Resolution(size, voxel),
        seed=seed,
        checkpoint=checkpoint,
        workers=Workers(workers, scheduler),
    )
