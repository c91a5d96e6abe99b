"""Tables of numbers as text: XYZ, CSV and their like, as scanners and their programs write them."""

import csv
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

_BLANKS = r"\s+"
_COMMENT = re.compile(r"\s*(#|//)\s*")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_HEAD_LINES = 50
_LONGEST_LINE = 100_000
_CHUNK_ROWS = 1_000_000


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

    def columns(
        self, places: Mapping[str, int], words: Collection[str] = ()
    ) -> dict[str, NDArray[Any]]:
        """The columns at `places` (from 0), under the names given: finite numbers as float64.

        Columns named in `words` come as text. Rows whose cells are all empty are left out.

        **Raises:** `InputError` for a file without rows, with the row of a line that has more or
        fewer cells than the first, and with the row and column of a cell that is no number.
        """
        import pandas as pd

        table = self._read(set(places.values()), {places[name] for name in words if name in places})
        columns: dict[str, NDArray[Any]] = {}
        for name, place in places.items():
            if name in words:
                columns[name] = table[place].to_numpy(str)
                continue
            values = pd.to_numeric(table[place], errors="coerce").to_numpy(np.float64)
            bad = ~np.isfinite(values)
            if bad.any():
                index = int(np.argmax(bad))
                cell = str(table[place].iloc[index]).strip()
                comma = _DECIMAL_COMMA.fullmatch(cell)
                raise InputError(
                    f"expected a number, but got {cell!r} ({int(bad.sum())} such rows)"
                    + (
                        f". Are these decimal commas? Write {cell.replace(',', '.')}"
                        if comma
                        else ""
                    ),
                    file=self.path,
                    row=self.row_of(index),
                    column=self.names[place] if self.names else name,
                )
            columns[name] = values
        return columns

    def row_of(self, index: int) -> int:
        """Row in the file, from 1, of what stands at `index` in the columns, from 0."""
        return next(islice(self._rows(), index, None))[0]

    def _read(self, needed: Collection[int], words: Collection[int]) -> "pd.DataFrame":
        """Cells of the columns `needed`.

        One column more than the first row has is read: it is empty, for a separator may end a row.
        """
        import pandas as pd

        wanted, last = sorted(needed), self.width - 1
        parts, may_be_short, fault = [], False, ""
        try:
            with pd.read_csv(
                self.path,
                sep=self.separator,
                header=None,
                names=range(self.width + 1),
                skiprows=self.skip,
                dtype=dict.fromkeys(words, str),
                na_filter=False,  # a cell that is missing or empty is then ""
                encoding="utf-8-sig",
                comment="#",
                skipinitialspace=True,
                low_memory=False,
                chunksize=_CHUNK_ROWS,
            ) as chunks:
                for chunk in chunks:
                    # pandas makes an index of the cells too many in the first row.
                    if (
                        not isinstance(chunk.index, pd.RangeIndex)
                        or not _is_empty(chunk[last + 1]).all()
                    ):
                        fault = "rows differ in their cells"
                        break
                    empty = chunk[_is_empty(chunk[last])]
                    if len(empty):
                        may_be_short = True
                        blank = empty.apply(_is_empty).all(axis=1)
                        chunk = chunk.drop(index=empty.index[blank])
                    parts.append(chunk[wanted])
        except ValueError as error:  # as are pandas' own errors, and those of decoding
            fault = " ".join(str(error).split())
        if fault or may_be_short:
            self._check_widths()
        if fault:
            raise InputError(f"cannot be read as columns of numbers ({fault})", file=self.path)
        table = pd.concat(parts)
        if not len(table):
            raise InputError("expected rows of numbers, but there is only a header", file=self.path)
        return table

    def _check_widths(self) -> None:
        """`InputError` at the first row with more or fewer cells than the first."""
        for row, cells in self._rows():
            count = len(cells) - (not cells[-1])
            if not count <= self.width <= len(cells):  # the last may be empty, or not there
                line = (" " if self.separator == _BLANKS else self.separator).join(cells)
                raise InputError(
                    f"expected {self.width} cells as in the first row, but this row has {count}: "
                    f"{line[:60]!r}",
                    file=self.path,
                    row=row,
                )

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Row in the file and cells of each line of numbers, without empty ones and comments."""
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            for row, line in enumerate(islice(file, self.skip, None), self.skip + 1):
                cells = _split(line.split("#")[0], self.separator)
                if any(cells):
                    yield row, cells


def open_text_table(
    path: str | Path, what: str = "a point cloud", needed: Collection[str] = ("x", "y", "z")
) -> TextTable:
    """Find how a table of numbers is written, from its first lines.

    Commas, semicolons, tabs or blanks separate, and may end a row; points are decimal; a
    byte-order mark may stand first. Lines that start with `#` are comments, and those with `//`
    too before the first numbers. The last comment there is the header, if it has all the columns
    `needed` and one name for each number. Otherwise a first row that starts with a word or has the
    columns needed is the header. A whole number alone on a line before the first row, as
    CloudCompare writes it, is the number of points.

    **Raises:** `InputError`, which calls the file `what`, for one that cannot be read, is binary,
    has no numbers, or fewer columns than needed and no header.
    """
    path = Path(path)
    lines = _head(path, what)
    filled = [k for k, line in enumerate(lines) if line.strip() and not _COMMENT.match(line)]
    if [lines[k].strip().isdigit() for k in filled[:2]] == [True, False]:
        del filled[0]
    if not filled:
        raise InputError(f"expected {what} as text, but it has no numbers: is it empty?", file=path)
    start, first = filled[0], lines[filled[0]]
    separator = next((mark for mark in (";", "\t", ",") if mark in first), _BLANKS)
    if len(first.split()) > 1 and all(map(_DECIMAL_COMMA.fullmatch, first.split())):
        separator = _BLANKS
    tokens = _trimmed(_split(first.split("#")[0], separator))
    if not all(map(_is_number, tokens)):
        named = _trimmed(_split(first, separator))
        starts_with_word = not _is_number(next(filter(None, tokens)))
        if starts_with_word or set(needed) <= _plain(named):
            return TextTable(path, tuple(named), len(named), start + 1, separator, start + 1)
    above = next((k for k in reversed(range(start)) if _COMMENT.match(lines[k])), None)
    if above is not None:
        comment = _COMMENT.sub("", lines[above], count=1)
        for named in (_trimmed(_split(comment, separator)), comment.split()):
            if len(named) == len(tokens) and set(needed) <= _plain(named):
                return TextTable(path, tuple(named), len(tokens), above + 1, separator, start)
    if len(tokens) < len(needed):
        *most, last = needed
        raise InputError(
            f"expected {', '.join(most)} and {last} in each row, but got {first.strip()[:40]!r}",
            file=path,
            row=start + 1,
        )
    return TextTable(path, None, len(tokens), start + 1, separator, start)


def places_of(names: Iterable[str], aliases: Mapping[str, Iterable[str]]) -> dict[str, int]:
    """Where columns stand among `names`: the first of its `aliases` that is there, in any case."""
    plain = [name_and_unit(name)[0] for name in names]
    return {
        wanted: next(plain.index(alias) for alias in known if alias in plain)
        for wanted, known in aliases.items()
        if not set(plain).isdisjoint(known)
    }


def name_and_unit(header: str) -> tuple[str, str]:
    """A column's name and its unit, in small letters: "X [cm]" is ("x", "cm")."""
    match = re.fullmatch(
        r"(.*?[^\s_\[(])?[\s_\[(]+(m|cm|mm|ft|feet|foot|us_?ft|deg|degrees?|metres?|meters?)[\])]*",
        header.strip().lower(),
    )
    if match is None:
        return header.strip().lower(), ""
    return (match.group(1) or "").strip(), match.group(2)


def _plain(names: Iterable[str]) -> set[str]:
    return {name_and_unit(name)[0] for name in names}


def _is_number(token: str) -> bool:
    """Whether this is meant as a number: it may be missing, or have a decimal comma."""
    try:
        float(token or "0")
    except ValueError:
        return bool(_DECIMAL_COMMA.fullmatch(token))
    return True


def _is_empty(cells: "pd.Series[Any]") -> NDArray[np.bool_]:
    if cells.dtype.kind in "iuf":
        return np.zeros(len(cells), bool)
    return (cells.astype(str).str.strip() == "").to_numpy(bool)


def _split(line: str, separator: str) -> list[str]:
    """Cells of a line; the last is empty where a separator ends it."""
    if '"' not in line:  # the usual, and faster
        return [cell.strip() for cell in line.split(None if separator == _BLANKS else separator)]
    if separator == _BLANKS:
        line, separator = " ".join(line.split()), " "
    reader = csv.reader([line[:_LONGEST_LINE]], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in next(reader, [])]


def _trimmed(cells: list[str]) -> list[str]:
    return cells[:-1] if cells and not cells[-1] else cells


def _head(path: Path, what: str) -> list[str]:
    """The first lines; `InputError` for a file that is no text."""
    try:
        with path.open("rb") as file:
            raw = b"".join(file.readline(_LONGEST_LINE) for _ in range(_HEAD_LINES))
    except OSError as error:
        raise InputError(f"{what} cannot be read: {error.strerror}", file=path) from error
    if b"\0" in raw:
        raise InputError(f"expected {what} as UTF-8 text, but this is a binary file", file=path)
    try:
        return raw.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(
            f"expected {what} as UTF-8 text, but byte 0x{raw[error.start]:02x} is none. Save the "
            "file again as UTF-8, or is it a binary file?",
            file=path,
            row=raw[: error.start].count(b"\n") + 1,
        ) from error
