"""Tables of numbers as text: XYZ, CSV and their like, as scanners and their programs write them."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError

_HEAD = 50


@dataclass(frozen=True)
class TextTable:
    """Where the numbers of a text file stand."""

    path: Path
    names: tuple[str, ...] | None
    """Its header; `None` where it has none."""
    width: int
    """Columns in its first row."""
    row: int
    """The header's row, or that of the first numbers, from 1."""
    separator: str
    """A character, or the pattern of blanks."""
    skip: int
    """Lines before the first numbers."""

    def columns(self, places: Mapping[str, int]) -> dict[str, NDArray[np.float64]]:
        """Finite numbers of the columns at `places` (from 0), under the names given.

        **Raises:** `InputError` with the row and column of a cell that is no number.
        """
        import pandas as pd

        try:
            table = pd.read_csv(
                self.path,
                sep=self.separator,
                header=None,
                skiprows=self.skip,
                usecols=sorted(set(places.values())),
                encoding="utf-8-sig",
                comment="#",
                low_memory=False,
            )
        except (ValueError, UnicodeDecodeError) as error:  # pandas' own errors are ValueErrors
            reason = " ".join(str(error).split())
            raise InputError(
                f"cannot be read as columns of numbers ({reason})", file=self.path
            ) from error
        found = {}
        for name, place in places.items():
            values = pd.to_numeric(table[place], errors="coerce").to_numpy(np.float64)
            bad = ~np.isfinite(values)
            if bad.any():
                row = int(np.argmax(bad))
                raise InputError(
                    f"expected a number, but got {str(table[place].iloc[row])!r}"
                    f" ({int(bad.sum())} such rows)",
                    file=self.path,
                    row=self._row(row),
                    column=name,
                )
            found[name] = values
        return found

    def _row(self, index: int) -> int:
        """Row in the file of numbers counted from 0, without blank lines and comments."""
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            lines = enumerate(islice(file, self.skip, None), self.skip + 1)
            rows = (row for row, line in lines if line.split("#")[0].strip())
            return next(islice(rows, index, None))


def open_text_table(
    path: Path, what: str = "a point cloud", needed: Collection[str] = ("x", "y", "z")
) -> TextTable:
    """Tell how a table of numbers is written, from its first lines.

    Commas, semicolons, tabs or blanks separate; points are decimal; a byte-order mark may stand
    first. Lines that start with `#` are comments, and those with `//` too before the first
    numbers. The last comment there is the header, if it has all the columns `needed` and one name
    for each number. A first row that is not all numbers is the header otherwise.

    **Raises:** `InputError`, which calls the file `what`, for one that is binary, has no numbers,
    has decimal commas, or fewer columns than needed and no header.
    """
    lines = _head(path, what)
    start = next((k for k, line in enumerate(lines) if not re.match(r"\s*(#|//|$)", line)), None)
    if start is None:
        raise InputError(f"expected {what} as text, but it has no numbers", file=path)
    first = lines[start]
    separator = next((mark for mark in (";", "\t", ",") if mark in first), r"\s+")
    tokens = _split(first, separator)
    if not all(_is_number(token) for token in tokens if token):
        if separator != "," and any(re.fullmatch(r"-?\d+,\d+", token) for token in tokens):
            raise InputError(
                "expected points in numbers, but these have decimal commas",
                file=path,
                row=start + 1,
            )
        return TextTable(path, tuple(tokens), len(tokens), start + 1, separator, start + 1)
    if start and (comment := re.sub(r"^\s*(#|//)\s*", "", lines[start - 1])):
        named = _split(comment, separator)
        if len(named) == len(tokens) and set(needed) <= {name_and_unit(n)[0] for n in named}:
            return TextTable(path, tuple(named), len(tokens), start, separator, start)
    if len(tokens) < len(needed):
        *most, last = needed
        raise InputError(
            f"expected {', '.join(most)} and {last} in each row, but got {first.strip()[:40]!r}",
            file=path,
            row=start + 1,
        )
    return TextTable(path, None, len(tokens), start + 1, separator, start)


def name_and_unit(header: str) -> tuple[str, str]:
    """A column's name and its unit, in small letters: "X [cm]" is ("x", "cm")."""
    found = re.fullmatch(
        r"(.*?)[\s_\[(]+(m|cm|mm|ft|feet|foot|us_?ft|deg|degrees?|metres?|meters?)[\])]*",
        header.strip().lower(),
    )
    return (found.group(1).strip(), found.group(2)) if found else (header.strip().lower(), "")


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


def _split(line: str, separator: str) -> list[str]:
    tokens = line.split() if separator == r"\s+" else line.split(separator)
    return [token.strip().strip('"') for token in tokens]


def _head(path: Path, what: str) -> list[str]:
    """The first lines; `InputError` for a file that is no text."""
    with path.open("rb") as file:
        raw = b"".join(file.readline(10_000) for _ in range(_HEAD))
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise InputError(f"expected {what} as text, but this is a binary file", file=path)
    return text.splitlines()
