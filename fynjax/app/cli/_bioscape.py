"""The group `fynjax bioscape`: field tables and spectra of BioSCape's plots."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.app.cli._runtime import (
    SHIPPED,
    PriorFile,
    command,
    option,
)

OnlyPlots = Annotated[
    list[str] | None,
    option("NAME", "Only this plot; may be given again. All if left out.", "--plot"),
]
TraitLibrary = Annotated[Path | None, option("FILE", "Trait library, if it is not in the folder.")]
Tables = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help="Folder with *CoverData.csv, *VegData.csv, *TraitLibrary.csv and, for the measured "
        "spectra, *VegCenters.csv and *waves.csv.",
    ),
]
Size = Annotated[float, option("M", "Side of a simulated plot [m].", "--size", min=1.0, max=100.0)]
Voxel = Annotated[float, option("M", "Edge of a voxel [m].", "--voxel", min=0.02, max=1.0)]
_STUDY = "fynjax.studies.bioscape"
_RESOLUTION = {"resolution": (f"{_STUDY}:Resolution", ("size_m", "voxel_m"))}


@command("bioscape plots", f"{_STUDY}:run_bioscape")
def plots_of_tables(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Folder with the tables as published, bioscape_veg_*_vYYYYMMDD.csv, or "
            "*CoverData.csv and *VegData.csv; with *TraitLibrary.csv and, for place and time, "
            "*VegCenters.csv.",
        ),
    ],
    plots: OnlyPlots = None,
    traits: TraitLibrary = None,
    prior: PriorFile = SHIPPED,
) -> None:
    """Make plot files from the field tables of BioSCape.

    Writes a folder for each plot, to be rendered, with a table of where each number came from;
    and a table of all plots.

    Example:  fynjax bioscape plots tables --output plots && fynjax render plots/T068/plot.toml
    """


@command(
    "bioscape learn",
    f"{_STUDY}:learn",
    "seed",
    "checkpoint",
    "workers",
    forget=True,
    records=_RESOLUTION,
)
def learn(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...",
            help="Folders with *CoverData.csv, *VegData.csv, *TraitLibrary.csv, *VegCenters.csv "
            "and *waves.csv.",
        ),
    ],
    plots: OnlyPlots = None,
    traits: TraitLibrary = None,
    size_m: Size = 5.0,
    voxel_m: Voxel = 0.1,
    slope_voxel_m: Annotated[
        float,
        option("M", "Edge of a voxel for derivatives [m].", "--slope-voxel", min=0.02, max=1.0),
    ] = 0.25,
    title: Annotated[str, typer.Option(help="What the plots are.")] = "Plots of low shrubland",
    licence: Annotated[str, typer.Option(help="Of the numbers, for the prior file.")] = "",
    sources: Annotated[
        list[str] | None,
        typer.Option("--source", help="Where the data are from; may be given again."),
    ] = None,
) -> None:
    """Learn what plots share, and how they vary, from the spectra of all at once.

    Growth forms' leaf area, dead tissue and clumping, leaf chemistry, brightness of soil and dead
    tissue, and the model's remaining error. Writes prior.toml, which --prior of other commands
    takes, tables, and a report page with scores of plots left out. An interrupted run goes on when
    the same command is given again.

    Example:  fynjax bioscape learn tables --output population
    """


@command(
    "bioscape validate",
    f"{_STUDY}:validate_plots",
    "seed",
    "checkpoint",
    "workers",
    forget=True,
    records=_RESOLUTION,
)
def validate_plots(
    folder: Tables,
    plots: OnlyPlots = None,
    traits: TraitLibrary = None,
    prior: PriorFile = SHIPPED,
    size_m: Size = 5.0,
    voxel_m: Voxel = 0.1,
) -> None:
    """Simulate plots from field tables alone, and compare with their measured spectra.

    Writes a report page, tables, spectra as NetCDF, figures, and the plot files. An interrupted run
    goes on when the same command is given again.

    Example:  fynjax bioscape validate tables --output validation
    """


@command(
    "bioscape calibrate",
    f"{_STUDY}:calibrate_plots",
    "seed",
    "checkpoint",
    "workers",
    forget=True,
    records=_RESOLUTION,
)
def calibrate_plots(
    folder: Tables,
    plots: OnlyPlots = None,
    traits: TraitLibrary = None,
    prior: PriorFile = SHIPPED,
    size_m: Size = 5.0,
    voxel_m: Voxel = 0.25,
    realisations: Annotated[
        int,
        typer.Option(
            min=3,
            max=50,
            help="Stand realisations used to estimate sampling variance.",
        ),
    ] = 3,
) -> None:
    """Infer covers, leaf area, dead tissue, gap and leaf traits of plots from measured spectra.

    Once with the plot's own tables as a weak prior, once with the other plots' means. Compares
    with the field's community-weighted means, and with a published regression (*LMA*model*.json)
    if the folder has it. Writes a report page, tables and figures. An interrupted run goes on when
    the same command is given again.

    Example:  fynjax bioscape calibrate tables --output inference
    """
