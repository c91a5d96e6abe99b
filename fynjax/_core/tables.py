"""Tables as text, as people, instruments and their programs write them: one reader for all."""

import codecs
import csv
import io
import itertools
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fynjax._core.errors import InputError, listed
from fynjax._core.extras import require
from fynjax._core.files import LARGEST_TEXT, existing_file, read_bytes
from fynjax._core.validation import number_slip

if TYPE_CHECKING:
    import pandas as pd

_MARKS = "\t;|,"
"""Separators, the likelier first; where none of them serves, blanks separate."""
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WITH_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
_IN_PERCENT = re.compile(r"%|percent|pct|prozent", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+")
_COMMENT = re.compile(r"\s*(#|//)\s*")
_SHEET_ERROR = re.compile(r"#(N/A|DIV/0!|REF!|NAME\?|VALUE!|NUM!|NULL!)")
_NO_TEXT = re.compile(rb"[\0-\x08\x0e-\x19\x1b-\x1f\x7f]")
_SEPARATOR_LINE = re.compile(r"sep=(.)\s*", re.IGNORECASE)
_SAMPLE_LINES, _SAMPLE_SIZE = 200, 1 << 20
_MOST_TITLES = 20
_LARGEST_WORKBOOK = 1 << 26
"""Bytes that a workbook may unfold to: openpyxl needs 27 of memory for each, and half a minute of a
core for so many."""
_LARGEST_SHEET = 1 << 24
"""Cells that a sheet may reach over."""
_LONGEST_NAME, _LONGEST_LINE = 1000, 1 << 15
_LEAST = -900.0
"""A number below it may stand for none, such as -999."""


@dataclass
class TextTable:
    """A table and how it is written."""

    path: Path
    data: bytes
    """Text of the file as UTF-8."""
    separator: str
    """Mark between the cells of a row; a blank stands for any number of blanks and tabs."""
    names: tuple[str, ...] = ()
    """Names of the columns: the header, or what the reader calls those of a table without one."""
    headed: bool = True
    """Whether the file has a header."""
    row: int = 1
    """Line of the header in the file, or of the first row, from 1."""
    skip: int = 0
    """Lines before the first row."""
    _decimal: str = "."
    """The likely decimal mark."""
    _first: tuple[str, str, int] | None = None
    """Decimal mark of the first number that has one, its cell and its row."""

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names)

    def _file(self, skip: int) -> io.TextIOWrapper:
        file = io.TextIOWrapper(io.BytesIO(self.data), "utf-8")
        for _ in itertools.islice(file, skip):
            pass
        return file

    def rows(self, skip: int | None = None) -> Iterator[tuple[int, list[str]]]:
        """Line in the file, from 1, and cells of each row behind `skip` lines.

        Blank rows and lines that start with `#` are left out but counted. Cells may hold line ends
        between double quotes; such a row has the number of its first line.

        **Raises:** `InputError` for quotes that do not end, and cells of over 131 072 characters.
        """
        skip = self.skip if skip is None else skip
        return ((start, cells) for start, _, cells in self._rows(skip))

    def _rows(self, skip: int) -> Iterator[tuple[int, int, list[str]]]:
        """First and last line of each row, and its cells."""
        line = start = skip
        between = True

        def lines() -> Iterator[str]:
            nonlocal line, start, between
            for text in self._file(skip):
                line += 1
                if between:
                    plain = text.lstrip()
                    if not plain or (plain[0] == "#" and not _SHEET_ERROR.match(plain)):
                        continue
                    if line == 1 and _SEPARATOR_LINE.fullmatch(plain):
                        continue
                    start, between = line, False
                if self.separator == " ":
                    text = text.strip().replace("\t", " ") + "\n"
                yield text
            if not between:
                words = "a quotation mark opens a cell in this row, and none closes it"
                raise InputError(words, file=self.path, row=start)

        reader = csv.reader(lines(), delimiter=self.separator, skipinitialspace=True)
        try:
            for cells in reader:
                between = True
                cells = [cell.strip() for cell in cells]
                if any(cells):
                    yield start, line, cells
        except csv.Error as error:
            longest = f"{csv.field_size_limit():_}".replace("_", " ")
            raise InputError(
                f"expected cells of at most {longest} characters, but one is longer. Does a "
                "quotation mark open a cell and none close it, or is this no table?",
                file=self.path,
                row=start,
            ) from error

    def records(self) -> Iterator[tuple[int, list[str]]]:
        """Line and cells of each row, as many as the header has.

        **Raises:** `InputError` for a row with more or fewer, and as `rows`.
        """
        return ((row, self._fitted(row, cells)) for row, cells in self.rows())

    def _fitted(self, row: int, cells: list[str]) -> list[str]:
        if len(cells) == self.width:
            return cells
        beyond = itertools.takewhile(lambda cell: cell[:1] != "#", cells[self.width :])
        count = min(len(cells), self.width) + len(trimmed(list(beyond)))
        if count == self.width:
            return cells[: self.width]
        if self.headed and self.width == 1:
            hint = " Is the first row a title? Delete what is above the header."
        elif self.separator == " ":
            hint = " A blank inside a name? Put the name in double quotes."
        elif count < self.width:
            hint = " Is the file cut short, or a separator missing?"
        elif self.separator == "," and any(
            a.lstrip("+-").isdigit() and b.isdigit() for a, b in itertools.pairwise(cells)
        ):
            hint = " A decimal comma? Write numbers with a point, or separate cells by semicolons."
        else:
            hint = " A separator inside a name? Put the name in double quotes."
        first = "header" if self.headed else "first row"
        shown = self.separator.join(cells)[:60]
        raise InputError(
            f"expected {self.width} cells as in the {first}, but this row has {count}: "
            f"{shown!r}.{hint}",
            file=self.path,
            row=row,
        )

    def plain(self, cell: str, row: int, column: str) -> str:
        """The cell of a column of numbers, a decimal comma written as a point.

        Between commas a decimal comma cannot be, and the cell stays as it is.

        **Raises:** `InputError` where other numbers of the table have the other decimal mark.
        """
        if self.separator == ",":
            return cell
        mark = "," if _WITH_COMMA.fullmatch(cell) else "."
        if mark == "," or ("." in cell and _NUMBER.fullmatch(cell)):
            self._first = self._first or (mark, cell, row)
            if self._first[0] != mark:
                raise InputError(
                    f"expected one decimal mark in the whole table, but got {cell!r} here and "
                    f"{self._first[1]!r} in row {self._first[2]}. Is one of them a mark between "
                    "thousands? Leave it out.",
                    file=self.path,
                    row=row,
                    column=column,
                )
        return cell.replace(",", ".") if mark == "," else cell

    def number(self, cell: str, row: int, column: str, missing: Collection[str] = ()) -> float:
        """The number in a cell; NaN for a word of `missing`, in small letters. In a column named in
        percent a cell may have the sign.

        **Raises:** `InputError` with the likely slip, and as `plain`.
        """
        if missing and cell.lower().replace(",", ".") in missing:
            return nan
        in_percent = cell.endswith("%") and _IN_PERCENT.search(column)
        plain = self.plain(cell[:-1].rstrip() if in_percent else cell, row, column)
        if _NUMBER.fullmatch(plain) and isfinite(value := float(plain)):
            return value
        words = f"expected a number, but got {cell!r}.{number_slip(cell)}"
        raise InputError(words, file=self.path, row=row, column=column)

    def columns(
        self, numbers: Sequence[int], words: Sequence[int] = (), missing: Collection[str] = ()
    ) -> "pd.DataFrame":
        """Columns by their place, from 0.

        **Arguments:**

        - `numbers`: places of columns of numbers, which come as float64.
        - `words`: places of columns that come as text.
        - `missing`: words, in small letters, that stand for a number that is missing (NaN).

        **Returns:** a frame of a row for each of the table and the columns named.

        **Raises:** `InputError` for a table without rows, for a row that has more or fewer cells
        than the header or the first, and as `number`.
        """
        import pandas as pd

        if (needed := max((*numbers, *words), default=-1) + 1) > self.width:
            raise InputError(
                f"expected {needed} columns, but the first row has {self.width}. Is a separator "
                "missing?",
                file=self.path,
                row=self.skip + 1,
            )
        frame = self._clean_columns(numbers, bool(missing))
        if frame is not None:
            for place in words:
                frame[place] = frame[place].str.strip()
            return frame[[*numbers, *words]]
        texts = []

        def cell_by_cell() -> Iterator[float]:
            for row, cells in self.records():
                texts.append([cells[k] for k in words])
                yield from (self.number(cells[k], row, self.names[k], missing) for k in numbers)

        values = np.fromiter(cell_by_cell(), np.float64).reshape(-1, len(numbers))
        if not len(values):
            raise InputError("expected rows of numbers, but there is only a header", file=self.path)
        table = pd.DataFrame(values, columns=list(numbers))
        if not words:
            return table
        return table.join(pd.DataFrame(texts, columns=list(words), index=table.index))

    def _clean_columns(self, numbers: Sequence[int], gaps: bool) -> "pd.DataFrame | None":
        """All columns, where pandas finds nothing but finite numbers and full rows; else `None`."""
        import pandas as pd  # late: the command line need not wait for it

        # Without it versions before 3.1 lose the last digit now and then; later ones deprecate it.
        old = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
        chosen = set(numbers)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # one is of cells beyond the last column
                frame = pd.read_csv(
                    self._file(self.skip),
                    sep=r"\s+" if self.separator == " " else self.separator,
                    decimal=self._decimal,
                    header=None,
                    names=range(self.width),
                    index_col=False,
                    dtype={k: np.float64 if k in chosen else str for k in range(self.width)},
                    na_filter=False,  # a cell that is missing or empty is then ""
                    skipinitialspace=True,
                    float_precision="round_trip" if old else None,
                )
        except (ValueError, Warning):  # the first are pandas' own errors too
            return None
        values, last = frame[list(numbers)].to_numpy(), frame[self.width - 1]
        # A short row ends in an empty cell.
        whole = len(values) and np.isfinite(values).all() and not (gaps and (values < _LEAST).any())
        whole = whole and (self.width - 1 in chosen or not (last.str.strip() == "").any())
        # pandas takes a comment for a row where its cells are as many.
        whole = whole and (0 in chosen or not frame[0].str.startswith("#").any())
        return frame if whole else None

    def line(self, row: int) -> str:
        """A line of the file, from 1, as it is written."""
        return next(self._file(row - 1), "").strip()


def open_table(
    path: str | Path, what: str, *, data: bytes | None = None, titled: bool = True
) -> TextTable:
    """Find how a table is written; its first row is the header.

    Tabs, semicolons, bars, commas or blanks separate, cells may stand in double quotes, and
    separators may end rows. Decimals have a point, or a comma where no commas separate. Text is
    UTF-8, UTF-16 or Windows-1252, and may be compressed (gzip). Lines that start with `#` are
    comments. A title above the header is left out where that is plain, with a warning. Of an Excel
    workbook the one sheet that has cells is read.

    **Arguments:**

    - `path`: the file.
    - `what`: names the file in errors, such as "a species table".
    - `data`: its bytes, where they have been read.
    - `titled`: whether to look for a title above the header.

    **Returns:** the table; its numbers have not been looked at.

    **Raises:** `InputError` for a file that is missing, empty or no table; `MissingExtraError` for
    a workbook without the extra `tables`. Warns of decimals that may be thousands.
    """
    table, _ = _open(path, what, LARGEST_TEXT, data)
    table.row, table.skip, names = _header(table) if titled else next(table._rows(0))
    table.names = tuple(trimmed(names))
    if max(map(len, table.names), default=0) > _LONGEST_LINE:  # words are looked for in them
        words = f"expected names of columns of at most {_LONGEST_LINE} characters"
        raise InputError(f"{words}. Does a quotation not end?", file=path, row=table.row)
    below = [cells for _, cells in itertools.islice(table.rows(), 3)]
    first = [cells[0] for cells in below]
    without_name = all(len(cells) == table.width + 1 for cells in below)
    if below and without_name and first == [str(k + 1) for k in range(len(first))]:
        table.names = ("", *table.names)  # R's write.table names no column of row names
    return table


def _header(table: TextTable) -> tuple[int, int, list[str]]:
    """First and last line of the header, and its cells: those of the first row, or of one of words
    alone with numbers below it and rows of one or two cells above it."""
    rows = list(itertools.islice(table._rows(0), _MOST_TITLES + 5))
    filled = [[cell for cell in cells if cell] for _, _, cells in rows]
    dated = False
    for k, cells in enumerate(filled[:_MOST_TITLES]):
        alone = k > 0 and len(filled[k - 1]) == 1
        below = [row for row in filled[k + 1 :] if 1 < len(row) <= len(cells)]
        if (
            (alone or (dated and k > 0))
            and table.separator != " "
            and len(cells) > (1 if alone else 2)
            and rows[k][2][: len(cells)] == cells
            and len({*cells}) == len(cells)
            and not any(map(is_number, cells))
            and len(below) == len(filled[k + 1 :])
            and any(is_number(cell) for row in below for cell in row)
        ):
            warnings.warn(
                f"{table.path}: row {rows[k][0]} is taken for the header, and what is above it for "
                "a title.",
                UserWarning,
                stacklevel=4,
            )
            return rows[k]
        with_digits = any(re.search(r"\d", cell) for cell in cells)
        if len(cells) > 2 and not with_digits:
            break
        dated |= with_digits
    return rows[0]


def numbers_rows(table: TextTable) -> bool:
    """Whether the first column of a table has no name of its own and counts the rows, from 0 or 1,
    as R's write.csv and pandas' to_csv write it by default."""
    if table.names[:1] and not re.fullmatch(r"|unnamed: ?0|\.\.\.1|index", table.names[0].lower()):
        return False
    first = [cells[0] for _, cells in itertools.islice(table.rows(), _SAMPLE_LINES)]
    return any(first == [str(k + start) for k in range(len(first))] for start in (0, 1))


def open_points(path: str | Path, what: str, needed: Collection[str]) -> TextTable:
    """Find how a table of numbers is written that may have no header, such as a point cloud.

    As `open_table`, and lines that start with `//` are comments too before the first numbers. The
    last comment there is the header, if it has all the columns `needed` and one name for each
    number. Otherwise a first row that starts with a word or has the columns needed is the header. A
    whole number alone on a line before the first row, as CloudCompare writes it, is the number of
    points.

    **Raises:** `InputError` as `open_table`, for a file without numbers, and for fewer columns than
    needed, or numbers that can be read in two ways, without a header.
    """
    path = existing_file(path, what)
    table, lines = _open(path, what, max(LARGEST_TEXT, path.stat().st_size), None)
    filled = [k for k, line in enumerate(lines) if line.strip() and not _COMMENT.match(line)]
    if [lines[k].strip().isdigit() for k in filled[:2]] == [True, False]:
        del filled[0]
    if not filled:
        raise InputError(f"expected {what} as text, but it has no numbers: is it empty?", file=path)
    start, first = filled[0], lines[filled[0]]
    table.row = start + 1
    cells = trimmed(split_line(first, table.separator))
    if not all(not cell or is_number(cell) for cell in cells):
        starts_with_word = not is_number(next(filter(None, cells)))
        if starts_with_word or set(needed) <= _plain(cells):
            table.names, table.skip = tuple(cells), start + 1
            return table
    table.skip = start
    cells = trimmed(split_line(re.split(r"\s#", first)[0], table.separator))
    above = next((k for k in reversed(range(start)) if _COMMENT.match(lines[k])), None)
    if above is not None:
        comment = _COMMENT.sub("", lines[above], count=1)
        for named in (trimmed(split_line(comment, table.separator)), comment.split()):
            if len(named) == len(cells) and set(needed) <= _plain(named):
                table.names, table.row = tuple(named), above + 1
                return table
    if len(cells) < len(needed):
        *most, last = needed
        words = f"expected {', '.join(most)} and {last} in each row, but got {first.strip()[:40]!r}"
        raise InputError(words, file=path, row=start + 1)
    without_header(table, [f"{k + 1}" for k in range(len(cells))], len(needed))
    return table


def without_header(table: TextTable, names: Sequence[str], needed: int) -> None:
    """Name the columns of a table that has no header.

    **Arguments:** `table`: whose `skip` is set; `names`: of its columns; `needed`: how many of them
    are needed.

    **Raises:** `InputError` where commas separate more columns, and stand between digits only:
    "1,5" may be two numbers, or one.
    """
    table.names, table.headed = tuple(names), False
    if table.separator == "," and len(names) > needed:
        rows = [cells for _, cells in itertools.islice(table.rows(), _SAMPLE_LINES)]
        if all(cell.lstrip("+-").isdigit() for cells in rows for cell in cells if cell):
            raise InputError(
                f"expected a header, or numbers with a decimal point: {','.join(rows[0])[:40]!r} "
                "can be read with commas between numbers and within them. Name the columns in a "
                "first line, or separate them by semicolons.",
                file=table.path,
                row=table.skip + 1,
            )


def places_of(
    names: Iterable[str], aliases: Mapping[str, Iterable[str]], **where: Any
) -> dict[str, int]:
    """Where columns stand among `names`: the first of its `aliases` that is there, in any case.

    **Raises:** `InputError` for one that is there twice; `where` says of which file and row.
    """
    plain = [name_and_unit(name)[0] for name in names]
    places = {}
    for wanted, known in aliases.items():
        if alias := next((alias for alias in known if alias in plain), None):
            if plain.count(alias) > 1:
                raise InputError("this column is there twice", **where, column=alias)
            places[wanted] = plain.index(alias)
    return places


def name_and_unit(header: str) -> tuple[str, str]:
    """A column's name and its unit, in small letters: "X [cm]" is ("x", "cm")."""
    match = len(header) <= _LONGEST_NAME and re.fullmatch(
        r"(.*?[^\s_\[(])?[\s_\[(]+(m|cm|mm|ft|feet|foot|us_?ft|deg|degrees?|metres?|meters?)[\])]*",
        header.strip().lower(),
    )
    if not match:
        return header.strip().lower(), ""
    return (match.group(1) or "").strip(), match.group(2)


def _plain(names: Iterable[str]) -> set[str]:
    return {name_and_unit(name)[0] for name in names}


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with either decimal mark."""
    return bool(_NUMBER.fullmatch(cell) or _WITH_COMMA.fullmatch(cell))


def split_line(line: str, separator: str) -> list[str]:
    """Cells of a line, without blanks around them; the last is empty where a separator ends it."""
    if '"' not in line:  # the usual, and faster
        return [cell.strip() for cell in line.split(None if separator == " " else separator)]
    if separator == " ":
        line = " ".join(line.split())
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # whoever reads the row says what is wrong
        cells = [line]
    return [cell.strip() for cell in cells]


def trimmed(cells: Sequence[str]) -> list[str]:
    """Cells without the empty ones at the end."""
    count = max((k + 1 for k, cell in enumerate(cells) if cell), default=0)
    return list(cells[:count])


def as_utf8(data: bytes, path: Path) -> bytes:
    """Text in UTF-8, UTF-16 or Windows-1252 as UTF-8 without byte-order mark.

    **Raises:** `InputError` for other encodings and binary files. Warns where letters of
    Windows-1252 look like those of another encoding.
    """
    encoding, head = "utf-8", data[:4096]
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        encoding = "utf-16"
    for offset, name in enumerate(("utf-16-be", "utf-16-le")):  # every second byte is zero
        if 2 * head[offset::2].count(0) > len(head) // 2 and 0 not in head[1 - offset :: 2]:
            encoding = encoding if encoding == "utf-16" else name
    try:
        if encoding != "utf-8" or not data.isascii():
            data = data.decode(encoding).encode()
    except UnicodeError as error:
        at = getattr(error, "start", 0)
        # A letter of two bytes shows that it is UTF-8, but damaged.
        damaged = encoding != "utf-8" or re.search(rb"[\xc3-\xdf][\x80-\xbf]", data)
        if damaged or re.search(rb"[\x81\x8d\x8f\x90\x9d]", data):
            raise InputError(
                f"expected text, but byte 0x{data[at]:02x} is none in {encoding.upper()}. Save "
                "the file again as UTF-8; Excel calls it CSV UTF-8. Or is it a binary file?",
                file=path,
                row=data[:at].count(b"\n") + 1,
            ) from error
        if rare := re.search(rb"[\x82-\x84\x86-\x8e\x98\x9a-\x9f]\w*", data):
            warnings.warn(
                f"{path}: the text is no UTF-8 and read as Windows-1252, with "
                f"{rare[0].decode('cp1252')!r} in it. If that is wrong, save it again as UTF-8.",
                UserWarning,
                stacklevel=4,
            )
        data = data.decode("cp1252").encode()
    data = data.removeprefix(codecs.BOM_UTF8).rstrip(b"\x1a")  # which ended files on DOS
    if _NO_TEXT.search(data):
        raise InputError("expected text, but this is a binary file", file=path)
    return data


def _open(
    path: str | Path, what: str, largest: int, data: bytes | None
) -> tuple[TextTable, list[str]]:
    """A table whose header is not known yet, and its first lines."""
    path = existing_file(path, what)
    data = read_bytes(path, largest) if data is None else data
    if book := data[:4] == b"PK\3\4":
        data = _workbook(data, path, what)
    elif data[:4] == b"\xd0\xcf\x11\xe0":
        raise InputError(
            f"expected {what}, but this is a workbook of Excel before 2007, or one with a "
            "password. Save it as .xlsx or as CSV.",
            file=path,
        )
    table, lines, size = TextTable(path, as_utf8(data, path), ","), [], 0
    for line in itertools.islice(table._file(0), _SAMPLE_LINES):
        lines.append(line.rstrip("\n"))
        size += len(line)
        if size > _SAMPLE_SIZE:
            break
    if next(table.rows(), None) is None:
        raise InputError(f"expected {what}, but the file is empty", file=path)
    if stated := _SEPARATOR_LINE.fullmatch(lines[0]):
        lines[0] = ""
    filled = [line for line in lines if line.strip() and not _COMMENT.match(line)]
    if stated:
        table.separator = stated[1]
    elif not book:
        table.separator = _separator(filled)
    if table.separator != ",":
        _find_decimals(table, filled)
    return table, lines


def _separator(lines: Sequence[str]) -> str:
    """What separates the cells of most lines, into the same number of them."""
    best, most = " ", 0
    for mark in _MARKS:
        widths = Counter(len(split_line(line, mark)) for line in lines)
        widths.pop(1, None)
        alike = max(widths.values(), default=0)
        if alike > most and (alike > 1 or 2 * widths.total() > len(lines)):
            best, most = mark, alike
    in_blanks = 2 * sum(len(line.split()) > 1 for line in lines) > len(lines)
    if best == "," and in_blanks and _numbers(lines, " ") > _numbers(lines, ","):
        return " "  # and commas are decimal
    return best


def _numbers(lines: Iterable[str], separator: str) -> float:
    """Share of the cells of lines that are numbers."""
    cells = [cell for line in lines for cell in split_line(line, separator) if cell]
    return sum(map(is_number, cells)) / max(len(cells), 1)


def _find_decimals(table: TextTable, lines: Iterable[str]) -> None:
    """Find the likely decimal mark; warn where it may as well part thousands."""
    cells = {cell for line in lines for cell in split_line(line, table.separator)}
    marked = [cell for cell in cells if is_number(cell) and ("," in cell or "." in cell)]
    commas = [cell for cell in marked if "," in cell]
    if commas:
        table._decimal = ","
    if marked and (commas or table.separator == ";") and all(map(_THOUSANDS.fullmatch, marked)):
        shown = min(marked)
        warnings.warn(
            f"{table.path}: numbers such as {shown} are read as {shown.replace(',', '.')}. If the "
            "marks part thousands, leave them out.",
            UserWarning,
            stacklevel=4,
        )


def _workbook(data: bytes, path: Path, what: str) -> bytes:
    """The sheet of an Excel workbook as CSV, a line for each of its rows."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as parts:
            size = sum(part.file_size for part in parts.infolist())
            excel_file = "xl/workbook.xml" in parts.namelist()
    except (OSError, RuntimeError, ValueError, zipfile.BadZipFile) as error:
        raise InputError("this Excel workbook is damaged or cut short", file=path) from error
    if not excel_file:
        raise InputError(f"expected {what}, but this is a zip file", file=path)
    if size > _LARGEST_WORKBOOK:
        raise InputError(f"the workbook unfolds to {size >> 20} MiB: save it as CSV", file=path)
    excel = require("openpyxl", "tables")
    sheets = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and rules that are of no matter here
            book = excel.load_workbook(io.BytesIO(data), data_only=True, read_only=True)
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # which may be stated wrongly
                rows, width, letters = list[list[str]](), 0, 0
                for row in sheet.iter_rows():
                    rows.append([_cell(cell) for cell in row])
                    width = max(width, len(row))
                    letters += sum(map(len, rows[-1]))
                    if letters > _LARGEST_WORKBOOK:  # cells may share one text
                        raise ValueError(f"{sheet.title!r} holds over {letters >> 20} MiB of text")
                    if len(rows) * max(width, 1) > _LARGEST_SHEET:
                        raise ValueError(f"{sheet.title!r} reaches to row {len(rows)} or beyond")
                text = io.StringIO()
                whole = (row + [""] * (width - len(row)) for row in rows)
                csv.writer(text, lineterminator="\n").writerows(whole)
                if text.getvalue().strip(',"\n'):
                    sheets[sheet.title] = text.getvalue().encode()
    except Exception as error:  # openpyxl raises whatever it stumbles over
        reason = " ".join(str(error).split())
        raise InputError(
            f"cannot be read as an Excel workbook ({reason}). Save the sheet as CSV.", file=path
        ) from error
    if len(sheets) > 1:
        raise InputError(
            f"expected one sheet, but {listed(sheets)} have cells. Leave {what} alone in the "
            "workbook, or save its sheet as CSV.",
            file=path,
        )
    return next(iter(sheets.values()), b"")


def _cell(cell: Any) -> str:
    """A cell of a workbook as a CSV file has it: one that shows 12 % holds the number 0.12."""
    value = cell.value
    of_numbers = isinstance(value, int | float) and not isinstance(value, bool)
    if of_numbers and "%" in re.sub(r'"[^"]*"|\\.', "", cell.number_format):  # its text apart
        return f"{100 * value:.15g}%"
    return "" if value is None else " ".join(str(value).split())
