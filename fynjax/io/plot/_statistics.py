"""Targets of a calibration given as numbers: statistics of an image, structure of a cloud."""

from collections.abc import Collection
from pathlib import Path

from fynjax._core.errors import InputError, names_file
from fynjax.io.plot._rows import StatisticRow, StructureRow
from fynjax.io.text import did_you_mean, read_rows
from fynjax.metrics import VEGETATION_INDICES


@names_file
def read_statistics(path: str | Path, known: Collection[str] | None = None) -> list[StatisticRow]:
    """Read a table of statistics with the columns statistic, value, sd.

    **Arguments:**

    - `path`: a CSV file.
    - `known`: names of bands and indices that can be computed; `None` takes any.

    **Returns:** the rows, in the order of the file.

    **Raises:** `InputError` for an unknown name, a statistic given twice, a standard deviation
    that is not above 0, or a band's reflectance above 1.5 (percent, not a fraction).
    """
    rows = read_rows(path, StatisticRow, "a table of statistics")
    for number, row in rows:
        if known is not None and row.subject not in known:
            raise InputError(
                f"unknown band or index {row.subject!r}.{did_you_mean(row.subject, known)}",
                row=number,
                column="statistic",
            )
        if row.subject not in VEGETATION_INDICES and not 0 <= row.value <= 1.5:
            hint = f" Percent? This is {row.value / 100:g}." if row.value > 1.5 else ""
            raise InputError(
                f"expected a reflectance as a fraction from 0 to 1.5, but got {row.value:g}.{hint}",
                row=number,
                column="value",
            )
    return [row for _, row in rows]


@names_file
def read_structure(path: str | Path) -> list[StructureRow]:
    """Read a table of structure metrics of a point cloud.

    **Arguments:** `path`, a CSV file with the columns metric and value, and, if need be, sd,
    grain_m [m] and returns_m2 [m-2].

    **Returns:** the rows, in the order of the file; at least one, all of one grain and of as many
    returns.

    **Raises:** `InputError` for an unknown metric, one given twice, or rows that differ in grain or
    returns.
    """
    rows = read_rows(path, StructureRow, "a table of structure metrics")
    first = rows[0][1]
    for number, row in rows:
        for column in ("grain_m", "returns_m2"):
            value, known = getattr(row, column), getattr(first, column)
            if value != known:
                raise InputError(
                    f"expected the same in all rows, {known:g}, but got {value:g}",
                    row=number,
                    column=column,
                )
    return [row for _, row in rows]
