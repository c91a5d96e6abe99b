"""Targets of a calibration given as numbers: statistics of an image, structure of a cloud."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax.io.plot._rows import StatisticRow, StructureRow
from fynjax.io.text import did_you_mean, read_rows

BANDS = ("green", "red", "red_edge", "nir")
"""Bands of the shipped camera, as statistics name them."""


@dataclass(frozen=True)
class TargetStatistics:
    """Statistics of a real image, in the order of the file."""

    file: Path
    names: tuple[str, ...]
    """'<band or index>.<mean|std|qNN|stdNNcm>'."""
    value: NDArray[np.float64]
    """One for each name [-]."""
    sd: NDArray[np.float64]
    """Standard deviation of each value [-]; NaN where the file states none."""


def read_statistics(path: str | Path, known: Collection[str] | None = None) -> TargetStatistics:
    """Read a table of statistics with the columns statistic, value, sd.

    **Arguments:**

    - `path`: a CSV file.
    - `known`: names of bands and indices that can be computed; `None` takes any.

    **Returns:** a `TargetStatistics`, in the order of the file.

    **Raises:** `InputError` for an unknown name, a statistic given twice, a standard deviation
    that is not above 0, or a band's reflectance above 1.5 (percent, not a fraction).
    """
    path = Path(path)
    rows = read_rows(path, StatisticRow, "a table of statistics")
    for number, row in rows:
        subject, kind = row.statistic.rsplit(".", 1)
        if known is not None and subject not in known:
            raise InputError(
                f"unknown band or index {subject!r}.{did_you_mean(subject, known)}",
                file=path,
                row=number,
                column="statistic",
            )
        if subject in BANDS and not 0 <= row.value <= 1.5:
            hint = f" Percent? This is {row.value / 100:g}." if row.value > 1.5 else ""
            raise InputError(
                f"expected a reflectance as a fraction from 0 to 1.5, but got {row.value:g}.{hint}",
                file=path,
                row=number,
                column="value",
            )
        if kind == "std" and row.value < 0:
            raise InputError(
                f"expected a standard deviation of at least 0, but got {row.value:g}",
                file=path,
                row=number,
                column="value",
            )
    return TargetStatistics(
        file=path,
        names=tuple(row.statistic for _, row in rows),
        value=np.array([row.value for _, row in rows]),
        sd=np.array([np.nan if row.sd is None else row.sd for _, row in rows]),
    )


@dataclass(frozen=True)
class TargetStructure:
    """Structure metrics of a real cloud, in the order of the file."""

    file: Path
    metrics: tuple[str, ...]
    """As in `fynjax.metrics.structure.STRUCTURE_METRICS`."""
    value: NDArray[np.float64]
    """Mean over cells, in the metric's unit."""
    sd: NDArray[np.float64]
    """Standard deviation of each value; NaN where the file states none."""
    grain_m: float
    """Side of a cell [m]."""
    returns_m2: float
    """Returns for each square metre [m-2]."""


def read_structure(path: str | Path) -> TargetStructure:
    """Read a table of structure metrics of a point cloud.

    **Arguments:**

    - `path`: a CSV file with the columns metric and value, and, if need be, sd, grain_m [m] and
      returns_m2 [m-2].

    **Returns:** a `TargetStructure`, in the order of the file.

    **Raises:** `InputError` for an unknown metric, one given twice, or rows that differ in grain or
    returns.
    """
    path = Path(path)
    rows = read_rows(path, StructureRow, "a table of structure metrics")
    first = rows[0][1]
    for number, row in rows:
        for column in ("grain_m", "returns_m2"):
            value, known = getattr(row, column), getattr(first, column)
            if value != known:
                raise InputError(
                    f"expected the same in all rows, {known:g}, but got {value:g}",
                    file=path,
                    row=number,
                    column=column,
                )
    return TargetStructure(
        file=path,
        metrics=tuple(row.metric for _, row in rows),
        value=np.array([row.value for _, row in rows]),
        sd=np.array([np.nan if row.sd is None else row.sd for _, row in rows]),
        grain_m=first.grain_m,
        returns_m2=first.returns_m2,
    )
