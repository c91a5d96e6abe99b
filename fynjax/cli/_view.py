"""`fynjax view`."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from fynjax._core.errors import InputError

_PAGE = "report.html"


def view(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder of a finished run, or its page.")
    ],
    print_path: Annotated[
        bool, typer.Option("--print", help="Print the path of the page and open nothing.")
    ] = False,
) -> None:
    """Open the report page of a run in the browser.

    Where there is no browser its path is printed.

    Example:  fynjax view output/demo
    """
    from fynjax.io.text import existing_file

    if run.is_dir() and not (run / _PAGE).is_file():
        written = sorted(p.name for p in run.iterdir() if p.is_file())
        raise InputError(
            f"expected the folder of a run with {_PAGE}, but this has "
            + (f"{', '.join(written[:8])}" if written else "no files"),
            file=run,
        )
    page = existing_file(run / _PAGE if run.is_dir() else run, "a report page").resolve()
    if print_path or not webbrowser.open(page.as_uri()):
        print(page)
