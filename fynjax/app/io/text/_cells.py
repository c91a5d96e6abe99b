"""Tables for spreadsheets, in which a name from a file stays a name."""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

_FORMULA = re.compile(r"[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20].", re.DOTALL)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def _as_text(value: Any) -> Any:
    """A cell that no spreadsheet computes: what would be a formula begins with an apostrophe."""
    if isinstance(value, str) and _FORMULA.match(value) and not _NUMBER.fullmatch(value):
        return f"'{value}"
    return value


def table_text(table: "pd.DataFrame", form: str | None = None) -> str:
    """A table as CSV, of which no cell is a formula: names come from files of anybody.

    **Arguments:** `table`; `form`, format of its numbers, such as "%.6g".

    **Returns:** the text. Text that begins with `=`, `+`, `-`, `@`, a tab or a carriage return, and
    is neither a number nor that sign alone, has an apostrophe before it, names of columns too.
    """
    cells = table.rename(columns=_as_text)
    texts = [i for i, kind in enumerate(cells.dtypes) if kind.kind not in "biufcmM"]
    for i in texts:
        cells.isetitem(i, cells.iloc[:, i].map(_as_text).to_numpy())
    text: str = cells.to_csv(index=False, float_format=form)
    return text


def rows_text(rows: Iterable[Sequence[object]]) -> str:
    """`rows` of cells as CSV, of which none is a formula (`table_text`)."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([_as_text(c) for c in row] for row in rows)
    return text.getvalue()
