"""Columns of numbers in text files, as scanners and point cloud programs write them."""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fynjax._core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

_COMMENT = re.compile(r"\s*(#|//)\s*")


@dataclass(frozen=True)
class TextColumns:
    """A text file of columns, read but not yet understood."""

    path: str | Path
    """Where it came from, for errors."""
    header: tuple[str, ...] | None
    """Names of the columns as written; None without a header."""
    cells: "pd.DataFrame"
    """One row a line, columns numbered from 0."""
    rows: np.ndarray
    """Row in the file of each line, from 1."""

    def numbers(self, place: int, name: str) -> np.ndarray:
        """Column `place` as finite numbers [line]; `InputError` with the row of one that is not."""
        import pandas as pd

        values = pd.to_numeric(self.cells[place], errors="coerce").to_numpy(np.float64)
        bad = ~np.isfinite(values)
        if bad.any():
            first = int(np.argmax(bad))
            found = str(self.cells[place].iloc[first]).strip()
            comma = re.fullmatch(r"-?\d+,\d+", found)
            raise InputError(
                f"expected a number, but found {found!r} ({int(bad.sum())} such rows)"
                + (f". A decimal comma? Write {found.replace(',', '.')}" if comma else ""),
                file=self.path,
                row=int(self.rows[first]),
                column=name,
            )
        return values


def read_columns(path: str | Path, what: str, known: Sequence[str]) -> TextColumns:
    """Read text whose columns are separated by commas, semicolons, tabs or blanks.

    Lines that start with `#` or `//` may come first, the last of which is the header if it has as
    many names as there are columns and one of the names in `known` (CloudCompare writes
    `//X Y Z ...`, and may write the number of points under it). UTF-8, with or without
    byte-order mark. `what` names the content in errors.

    Raises `InputError` for a file that cannot be read, is empty, or has a row with more or fewer
    cells than the first.
    """
    import pandas as pd  # late: it is slow to import

    try:
        raw = Path(path).read_bytes()
        text = raw.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{what} cannot be read as text: {error}", file=path) from error
    if "\0" in text:
        raise InputError(f"{what} must be text, but this is a binary file", file=path)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip()]
    comment = ""
    while lines and _COMMENT.match(lines[0][1]):
        comment = _COMMENT.sub("", lines.pop(0)[1], count=1)
    if len(lines) > 1 and lines[0][1].strip().isdigit() and not lines[1][1].strip().isdigit():
        lines.pop(0)  # the number of points
    if not lines:
        raise InputError(f"{what} must have numbers, but the file is empty", file=path)
    separator = next((mark for mark in ";\t," if mark in lines[0][1]), None)

    def cells(line: str) -> list[str]:
        return [cell.strip().strip('"') for cell in _bare(line, separator).split(separator)]

    first = cells(lines[0][1])
    header = None
    if not all(_is_number(cell) for cell in first) and _lower(first) & set(known):
        header = first
        lines.pop(0)
    else:
        names = next((n for n in (cells(comment), comment.split()) if len(n) == len(first)), [])
        header = names if _lower(names) & set(known) else None
    if not lines:
        raise InputError(f"{what} must have numbers, but there is only a header", file=path)
    for number, line in lines:
        if (count := len(cells(line))) != len(first):
            raise InputError(
                f"expected {len(first)} cells as in the first row, but this row has {count}: "
                f"{line.strip()[:60]!r}",
                file=path,
                row=number,
            )
    table = pd.read_csv(
        io.StringIO("\n".join(_bare(line, separator) for _, line in lines)),
        sep=separator or r"\s+",
        header=None,
        names=range(len(first)),
        skipinitialspace=True,
        low_memory=False,
    )
    return TextColumns(
        path, None if header is None else tuple(header), table, np.array([k for k, _ in lines])
    )


def _bare(line: str, separator: str | None) -> str:
    """A line without blanks round it and without a separator at its end."""
    return line.strip().removesuffix(separator or " ")


def _lower(cells: Sequence[str]) -> set[str]:
    return {cell.lower() for cell in cells}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
