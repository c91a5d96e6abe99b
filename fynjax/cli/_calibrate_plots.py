"""`fynjax calibrate-plots`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.cli._bioscape import OnlyPlots, TraitLibrary
from fynjax.cli._runtime import Checkpoint, Json, Output, Quiet, Seed, checkpoint_beside, run_job
from fynjax.cli._validate_plots import Size, Tables, Voxel, check_voxel


def calibrate_plots(
    folder: Tables,
    output: Output = Path("output/calibrate_plots"),
    plot: OnlyPlots = None,
    traits: TraitLibrary = None,
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
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Infer cover, leaf mass per area and leaf water of plots from their measured spectra.

    Once with the plot's own tables as a weak prior, once with the other plots' means. Compares
    with the field's community-weighted means, and with a published regression (*LMA*model*.json)
    if the folder has it. Writes a report page, tables and figures. An interrupted run goes on when
    the same command is given again.

    Example:  fynjax calibrate-plots tables --output inference
    """
    check_voxel(size, voxel)
    own = checkpoint_beside(output, checkpoint)
    from fynjax._core.checkpoint import forget_journal
    from fynjax.studies.bioscape import Resolution
    from fynjax.studies.bioscape import calibrate_plots as run_calibrate_plots

    run_job(
        "calibrate-plots",
        lambda target, progress: run_calibrate_plots(
            folder,
            target,
            plots=plot or None,
            traits=traits,
            resolution=Resolution(size, voxel),
            realisations=realisations,
            seed=seed,
            checkpoint=own,
            progress=progress,
        ),
        output,
        as_json=json,
        quiet=quiet,
        checkpoint=own,
    )
    forget_journal(own)
