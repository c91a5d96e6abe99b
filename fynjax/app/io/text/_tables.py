"""Tables as text, row by row, with errors that point at the cell."""

from pathlib import Path

from fynjax._core.errors import InputError
from fynjax._core.files import read_bytes
from fynjax._core.tables import as_utf8, numbers_rows, open_table
from fynjax._core.validation import Row, check_header, checked_rows, columns, is_of_numbers

_SIGNS = {"percent": "%", "deg": "°"}
"""Signs of units in cells by the last word of a column's name, where they are not that word."""


def _without_unit(cell: str, column: str) -> str:
    """A number without the unit of its column, which some write in every cell: '5 %' or '30 cm'."""
    unit = column.rpartition("_")[2]
    number = cell.removesuffix(_SIGNS.get(unit, unit)).rstrip()
    return number if number and number[-1].isdigit() else cell


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, UTF-16 or Windows-1252, its lines ended by `\\n`.

    **Arguments:** `path`: a file that exists.

    **Raises:** `InputError` for other encodings and binary files.
    """
    text = as_utf8(read_bytes(path), path).decode()
    return text.replace("\r\n", "\n").replace("\r", "\n")  # \r alone ended lines on old Macs


def read_rows(
    path: str | Path, model: type[Row], what: str, *, within: Path | None = None
) -> list[tuple[int, Row]]:
    """Read a table as rows of `model`, each with its row number.

    The table may be written as `fynjax._core.tables.open_table` has it: as CSV with any separator,
    as text of several encodings, or as an Excel workbook. A first column without a name that counts
    the rows is left out.

    **Arguments:**

    - `path`: the file.
    - `model`: the record of a row; its fields are the columns. Further columns are skipped if it
      ignores what it does not name; else they are an error.
    - `what`: names the file in errors, such as "a species table".
    - `within`: folder in which files must lie that a `NamedFile` of the record names; `None` allows
      any place.

    **Returns:** for each row its number, as an editor counts, and its record.

    **Raises:** `InputError` with file, row, column, value and what was expected.
    """
    table = open_table(path, what)
    if table.width > 1 and numbers_rows(table):
        table.names = ("note: number of the row", *table.names[1:])
    check_header(table.names, model, file=table.path, row=table.row)
    known = columns(model)
    numbers = {name for name, field in known.items() if is_of_numbers(field)}
    cells = (
        (
            row,
            {
                name: table.plain(_without_unit(cell, name), row, name) if name in numbers else cell
                for name, cell in zip(table.names, found, strict=True)
                if cell and name in known
            },
        )
        for row, found in table.records()
    )
    rows = checked_rows(cells, model, table.path, within=within)
    if not rows:
        raise InputError(f"expected {what}, but there is only a header", file=table.path)
    return rows
