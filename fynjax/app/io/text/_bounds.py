"""What files may take of memory and state as numbers, and that rows of a GeoPackage stand in it."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from fynjax._core.errors import InputError, is_odd_number
from fynjax._core.memory import total_memory


def check_fits(needed: float, what: str, advice: str, file: str | Path | None = None) -> None:
    """Refuse with `InputError` what memory cannot hold: `needed` bytes for `what`, such as "a row
    of 30 pixels"; `advice` ends the error, which names `file`."""
    if needed > (there := total_memory()):
        raise InputError(
            f"{what} need {needed / 2**30:.3g} GiB, but this machine has {there / 2**30:.3g} GiB "
            f"for this process. {advice}",
            file=file,
        )


def stated_number(value: Any) -> float:
    """A number as a file states it, also as text.

    **Arguments:** `value`, a number or a text.

    **Raises:** `ValueError` for a list, and for a text that is no number, also where Python would
    take it for one, such as 1_0 and digits of other scripts.
    """
    if isinstance(value, list | tuple | dict) or (isinstance(value, str) and is_odd_number(value)):
        raise ValueError(f"no number: {str(value)[:60]!r}")
    return float(value)


def check_geopackage(path: Path) -> None:
    """Refuse a GeoPackage (SQLite) with views or computed columns, whose rows may be without end.

    **Arguments:** `path`, a file that exists.

    **Raises:** `InputError`, also for what is no SQLite file.
    """
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            views = base.execute("SELECT name FROM sqlite_master WHERE type = 'view'").fetchall()
            made = base.execute(
                "SELECT m.name || '.' || c.name FROM sqlite_master m, "
                "pragma_table_xinfo(m.name) c WHERE m.type = 'table' AND c.hidden > 1"
            ).fetchall()
    except sqlite3.DatabaseError as error:
        raise InputError(f"expected a GeoPackage (SQLite), but: {error}", file=path) from error
    for (name,) in [*views, *made]:
        raise InputError(
            f"expected a GeoPackage whose layers hold their rows, but {name[:60]!r} is computed. "
            "Export the layer into a new GeoPackage",
            file=path,
        )
