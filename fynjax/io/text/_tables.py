"""CSV tables, row by row, with errors that point at the cell."""

import csv
import io
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from pydantic import BaseModel

from fynjax._core.errors import InputError
from fynjax._core.validation import Row, check_header, checked_rows
from fynjax.io.text._files import existing_file, read_bytes

_DELIMITERS = {";": "semicolons", "\t": "tabs", "|": "bars"}


def read_text(path: Path) -> str:
    """The text of a UTF-8 or UTF-16 file, without its byte-order mark, its lines ended by `\\n`.

    **Arguments:**

    - `path`: a file that exists.

    **Raises:** `InputError` for other encodings, spreadsheets and binary files.
    """
    raw = read_bytes(path)
    if raw[:4] == b"PK\x03\x04":
        raise InputError(
            "expected text, but this is a zip or Excel file. Save the sheet as CSV UTF-8.",
            file=path,
        )
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(
            f"expected UTF-8 text, but byte 0x{raw[error.start]:02x} is none. Save the file again "
            "as UTF-8; Excel calls it CSV UTF-8.",
            file=path,
            row=raw[: error.start].count(b"\n") + 1,
        ) from error
    if "\0" in text:
        raise InputError("expected text, but this is a binary file", file=path)
    return text.replace("\r\n", "\n").replace("\r", "\n")  # \r alone ended lines on old Macs


def broken_row(path: Path, row: int | None = None) -> InputError:
    """The error for a row that Python's reader of tables gives up: one with a cell too long.

    **Arguments:** `path` of the table; `row`, where it is known.
    """
    longest = f"{csv.field_size_limit():_}".replace("_", " ")
    return InputError(
        f"expected cells of at most {longest} characters, but one is longer. Does a quotation mark "
        "open a cell and none close it, or is this no table?",
        file=path,
        row=row,
    )


def split_line(line: str, path: Path, row: int, separator: str = ",") -> list[str]:
    """Cells of a line of a CSV file, without blanks around them.

    **Arguments:**

    - `line`: of the file `path`, in row `row`.
    - `separator`: between cells.

    **Raises:** `InputError` for a line that is no row of a table, such as one with a cell of over
    131 072 characters.
    """
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error as error:
        raise broken_row(path, row) from error
    return [cell.strip() for cell in cells]


def foreign_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Rows of a CSV file of another program, whose cells may hold line ends within quotes.

    Rows of empty cells are left out. Each comes with the number of its last line.

    **Arguments:**

    - `path`: a file that exists.

    **Raises:** `InputError` as `read_text` and `split_line`.
    """
    reader = csv.reader(io.StringIO(read_text(path)), skipinitialspace=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells
    except csv.Error as error:
        raise broken_row(path, reader.line_num) from error


def split_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Rows of a CSV file, each with its number as an editor counts.

    Empty lines and lines that start with `#` are left out but counted.

    **Arguments:**

    - `path`: a file that exists.

    **Raises:** `InputError` as `read_text` and `split_line`.
    """
    for number, line in enumerate(io.StringIO(read_text(path)), start=1):
        if line.strip(" ,\n") and not line.lstrip().startswith("#"):
            yield number, split_line(line, path, number)


def _check_header(header: Sequence[str], model: type[BaseModel], path: Path, row: int) -> None:
    if len(header) == 1:
        for mark, word in _DELIMITERS.items():
            if mark in header[0]:
                raise InputError(
                    f"expected columns separated by commas, but this header has {word}. "
                    "Save as CSV with commas, and with points in numbers.",
                    file=path,
                    row=row,
                )
    check_header(header, model, file=path, row=row)


def _cells(
    lines: Iterable[tuple[int, list[str]]], header: Sequence[str], path: Path
) -> Iterator[tuple[int, dict[str, str]]]:
    """Cells of each row by column, without empty ones."""
    for number, cells in lines:
        if len(cells) != len(header):
            raise _uneven(cells, header, path, number)
        yield number, {name: cell for name, cell in zip(header, cells, strict=True) if cell}


def _uneven(cells: Sequence[str], header: Sequence[str], path: Path, row: int) -> InputError:
    hint = ""
    if len(cells) > len(header):
        pairs = itertools.pairwise(cells)
        if any(a.strip().lstrip("-").isdigit() and b.strip().isdigit() for a, b in pairs):
            hint = " A decimal comma? Write numbers with a point."
        else:
            hint = " A comma inside a name? Put the name in double quotes."
    return InputError(
        f"expected {len(header)} cells as in the header, but this row has {len(cells)}.{hint}",
        file=path,
        row=row,
    )


def read_rows(path: str | Path, model: type[Row], what: str) -> list[tuple[int, Row]]:
    """Read a CSV file as rows of `model`, each with its row number.

    Commas separate, points are decimal, UTF-8 (with or without byte-order mark) or UTF-16.
    Empty lines and lines that start with `#` are skipped but counted.

    **Arguments:**

    - `path`: the file.
    - `model`: the record of a row; its fields are the columns.
    - `what`: names the file in errors, such as "a species table".

    **Returns:** for each row its number, as an editor counts, and its record.

    **Raises:** `InputError` with file, row, column, value and what was expected.
    """
    path = existing_file(path, what)
    lines = split_lines(path)
    number, header = next(lines, (0, None))
    if header is None:
        raise InputError(f"expected {what}, but the file is empty", file=path)
    _check_header(header, model, path, number)
    rows = checked_rows(_cells(lines, header, path), model, path)
    if not rows:
        raise InputError(f"expected {what}, but there is only a header", file=path)
    return rows
