"""`fynjax init`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax._core.errors import InputError
from fynjax.cli._bioscape import SHIPPED, PriorFile
from fynjax.cli._runtime import Json, Quiet, Seed, show

Folder = Annotated[Path | None, typer.Argument(metavar="DIR", help="Folder to make.")]


def init(
    folder: Folder = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The same as the argument DIR.")
    ] = None,
    burnt: Annotated[
        int,
        typer.Option(
            metavar="YEAR",
            help="Year of the plot's last fire. 2006 is the published plot; 2016, 2019 and others "
            "are built on assumptions about recovery, which their files state.",
        ),
    ] = 2006,
    prior: PriorFile = SHIPPED,
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented example plot that runs as it is.

    Never overwrites a file.

    Example:  fynjax init my_plot && fynjax render my_plot/plot.toml
    """
    from fynjax.studies import fynbos_2006

    if folder is not None and output is not None and folder != output:
        raise InputError(f"expected one folder, but got {str(folder)!r} and {str(output)!r}")
    target = folder or output or Path("fynjax_plot")
    result = fynbos_2006.init(target, burnt=burnt, prior=prior, seed=seed)
    if json:
        print(result.model_dump_json(indent=2))
    elif not quiet:
        show(result)
        print(f"Next: fynjax render {target / 'plot.toml'}")
