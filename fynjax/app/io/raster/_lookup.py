"""Where the pixels of a swath lie on a map, as the lookup table of its own file says."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Int
from rasterio import Affine
from rasterio.windows import Window

from fynjax._core.errors import LARGEST, InputError, listed, refusing
from fynjax.app.io.raster._crs import geotransform, parse_crs

_AT_ONCE = 2**20
"""Pixels of the map of a block, about."""
_MOST = 1000
"""A map has at most so many times the pixels of its swath: EMIT's have two to four times."""
_NAMES = ("glt_x", "glt_y")


@dataclass(frozen=True)
class LookupTable:
    """Which pixel of a swath lies at each pixel of a map."""

    shape: tuple[int, int]
    """Rows and columns of the map."""
    transform: Affine
    """Affine map from column and row of the map to x and y."""
    crs: str
    """Coordinate reference system of the map as WKT."""
    swath: tuple[int, int]
    """Rows and columns of the swath."""
    columns: xr.DataArray
    """Column of the swath at each pixel of the map, from 1; 0 or NaN where there is none."""
    rows: xr.DataArray
    """Row of the swath at each pixel of the map, from 1; 0 or NaN where there is none."""

    def blocks(
        self,
    ) -> Iterator[tuple[int, Int[np.ndarray, "row column"], Int[np.ndarray, "row column"]]]:
        """The table by blocks of rows of the map: the block's first row, and the row and column in
        the swath of each of its pixels, from 0, -1 where there is none.

        **Raises:** `InputError` for pixels that the swath does not have, and where the table cannot
        be read.
        """
        high, wide = self.shape
        step = max(_AT_ONCE // wide, 1)
        for start in range(0, high, step):
            row, column = (
                self._read(name, part[start : start + step], start, count)
                for name, part, count in zip(
                    _NAMES[::-1], (self.rows, self.columns), self.swath, strict=True
                )
            )
            there = (row >= 0) & (column >= 0)
            yield start, np.where(there, row, -1), np.where(there, column, -1)

    def _read(
        self, name: str, part: xr.DataArray, start: int, count: int
    ) -> Int[np.ndarray, "row column"]:
        words = f"{name} of its lookup table cannot be read ({{error}}). Is the file damaged?"
        with refusing(OSError, RuntimeError, ValueError, words=words):
            number = np.nan_to_num(np.asarray(part.values, float))
        wrong = (number < 0) | (number > count) | (number != np.floor(number))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise InputError(
                f"expected {name} from 1 to {count}, as the swath has them, or 0 for none, but it "
                f"is {number[row, column]:g} in row {start + row + 1}, column {column + 1} of the "
                "map. Is the file damaged?"
            )
        return number.astype(int) - 1

    def place(self, swath: Any, onto: Any) -> None:
        """Copy the bands of a raster on the swath to one on the map, each pixel from that which the
        table names: nothing is interpolated. NaN where it names none.

        **Arguments:** `swath`: open rasterio dataset, to be read; `onto`: another of `shape` and
        the same bands, to be written.

        **Raises:** `InputError` as `blocks`.
        """
        for start, row, column in self.blocks():
            there = row >= 0
            # Only those rows of the swath are read that lie in this block.
            first, end = (row[there].min(), row[there].max() + 1) if there.any() else (0, 1)
            rows = Window(0, first, self.swath[1], end - first)
            for band in range(1, swath.count + 1):
                values = np.full(row.shape, np.nan, np.float32)
                values[there] = swath.read(band, window=rows)[row[there] - first, column[there]]
                onto.write(values, band, window=Window(0, start, *row.shape[::-1]))


def lookup_table(location: xr.Dataset, swath: tuple[int, int]) -> LookupTable:
    """The lookup table of a swath, checked.

    **Arguments:** `location`: has `glt_x` and `glt_y` and the attributes `geotransform` (as GDAL
    has it) and `spatial_ref` (WKT); `swath`: its rows and columns.

    **Raises:** `InputError` for a table that lacks a part, is no table, lies nowhere or names
    pixels that the swath does not have, or none at all.
    """
    lacking = [name for name in _NAMES if name not in location]
    lacking += [name for name in ("geotransform", "spatial_ref") if name not in location.attrs]
    if lacking:
        raise InputError(
            "expected glt_x, glt_y, geotransform and spatial_ref of its lookup table, but it has "
            f"no {listed(lacking)}. Without glt_x and glt_y the maps would have rows and columns "
            "only"
        )
    columns, rows = (location[name] for name in _NAMES)
    if columns.ndim != 2 or columns.shape != rows.shape or not 0 < columns.size <= _MOST * (
        swath[0] * swath[1]
    ) or {columns.dtype.kind, rows.dtype.kind} - set("fiu"):  # fmt: skip
        raise InputError(
            "expected glt_x and glt_y of its lookup table as numbers, alike in two dimensions and "
            f"about as many as the swath's {swath[0]} x {swath[1]}, but they are "
            f"{columns.shape} of {columns.dtype} and {rows.shape} of {rows.dtype}"
        )
    system = parse_crs(str(location.attrs["spatial_ref"]))
    transform = geotransform(location.attrs["geotransform"], "geotransform of its lookup table")
    x, y = zip(transform @ (0, 0), transform @ columns.shape[::-1], strict=True)
    most = (360.0, 90.0) if system.is_geographic else (LARGEST, LARGEST)
    if max(map(abs, x)) > most[0] or max(map(abs, y)) > most[1]:
        raise InputError(
            f"its lookup table lies nowhere: by its geotransform from {x[0]:g} to {x[1]:g} and "
            f"from {y[0]:g} to {y[1]:g}. Is the file damaged?"
        )
    shape = (columns.shape[0], columns.shape[1])
    table = LookupTable(shape, transform, system.to_wkt(), swath, columns, rows)
    if not sum(int((row >= 0).sum()) for _, row, _ in table.blocks()):
        raise InputError("its lookup table names no pixel of the swath")
    return table
