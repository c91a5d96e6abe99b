"""`fynjax init`."""

import json as json_text
import re
import shutil
from pathlib import Path
from typing import Annotated

import typer

import fynjax
from fynjax._core.errors import InputError
from fynjax.cli._runtime import Json, Quiet, Seed, tell

FILES = {
    "plot.toml": "the plot, its light and sensor, and what to calibrate",
    "species.csv": "taxon, crown diameter, cover, height",
    "leaves.csv": "leaf chemistry by taxon, or measured spectra",
    "statistics.csv": "what the drone saw, as numbers",
    "README.txt": "what to do with them",
}

Folder = Annotated[Path | None, typer.Argument(metavar="DIR", help="Folder to make.")]


def init(
    folder: Folder = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The same as the argument DIR.")
    ] = None,
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented example plot that runs as it is.

    Never overwrites a file.

    Example:  fynjax init my_plot && fynjax render my_plot/plot.toml
    """
    from fynjax.io._atomic import staged_folder
    from fynjax.io._plot_file import example_folder

    if folder is not None and output is not None and folder != output:
        raise InputError(f"expected one folder, but got {str(folder)!r} and {str(output)!r}")
    target = folder or output or Path("fynjax_plot")
    there = [name for name in FILES if (target / name).exists()]
    if there:
        raise InputError(
            f"expected a folder without {there[0]!r}; `init` overwrites nothing. Name another.",
            file=target,
        )
    with staged_folder(target) as staged:
        for name in FILES:
            shutil.copyfile(example_folder() / name, staged / name)
        plot = staged / "plot.toml"
        text = plot.read_text(encoding="utf-8")
        plot.write_text(re.sub(r"(?m)^seed = 0 ", f"seed = {seed} ", text), encoding="utf-8")
    summary = {
        "command": "init",
        "version": fynjax.__version__,
        "output": str(target),
        "seed": seed,
        "status": "ok",
        "headline": [],
        "files": FILES,
        "warnings": [],
    }
    if json:
        print(json_text.dumps(summary, indent=2))
    elif not quiet:
        tell(summary)
        print(f"Next: fynjax render {target / 'plot.toml'}")
