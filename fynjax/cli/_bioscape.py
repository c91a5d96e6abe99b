"""`fynjax bioscape`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.cli._runtime import Job, command

Tables = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help="Folder with the tables as published, bioscape_veg_*_vYYYYMMDD.csv, or *CoverData.csv "
        "and *VegData.csv; with *TraitLibrary.csv and, for place and time, *VegCenters.csv.",
    ),
]
OnlyPlots = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Only this plot; may be given again. All if left out."),
]
TraitLibrary = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Trait library, if it is not in the folder."),
]
PriorFile = Annotated[
    str,
    typer.Option(
        metavar="FILE",
        help="Population that the plots are of: a shipped one, a file that `fynjax learn` wrote, "
        "or none.",
    ),
]
SHIPPED = "fynbos_2023"


@command("bioscape")
def bioscape(
    folder: Tables,
    plot: OnlyPlots = None,
    traits: TraitLibrary = None,
    prior: PriorFile = SHIPPED,
) -> Job:
    """Make plot files from the field tables of BioSCape.

    Writes a folder for each plot, to be rendered, with a table of where each number came from;
    and a table of all plots.

    Example:  fynjax bioscape tables --output plots && fynjax render plots/T068/plot.toml
    """
    from fynjax.studies.bioscape import run_bioscape

    return lambda target: run_bioscape(
        folder, target, plots=plot or None, traits=traits, prior=prior
    )
