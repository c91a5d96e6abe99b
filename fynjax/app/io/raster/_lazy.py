"""Cubes as xarray arrays on dask, for whoever goes on in that world."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax.app.io.raster._blocks import grid_coordinates, open_blocks


def open_cube(path: str | Path, *, rows: int | None = None) -> xr.DataArray:
    """A cube of reflectance of any size as an xarray array of which a block is read when it is
    asked for, here or on the workers of a dask cluster that see the file.

    **Arguments:**

    - `path`: ENVI, GeoTIFF, NetCDF or zarr, as `fynjax map` takes them.
    - `rows`: of a block; by default as many as take some 128 MiB.

    **Returns:** reflectance [-], NaN without data, over (y, x, wavelength), or over (row, column,
    wavelength) where the grid is turned or has no place; coordinates `wavelength` and `fwhm` [nm],
    `good` (bands that are to be used), `x` and `y` of the middles of pixels, and `crs`. Rows begin
    in the north. rioxarray knows its place: `.rio.clip`, `.rio.reproject_match` and
    `.rio.to_raster` of a band, or of all as `.transpose("wavelength", ...)`.

    **Raises:** `InputError` for what is no such image, also where a block turns out to be damaged
    when it is computed; `MissingExtraError` without dask or rioxarray.

    >>> open_cube("flight.hdr").sel(wavelength=860, method="nearest").plot()  # doctest: +SKIP
    """
    array: Any = require("dask.array", "map", "dask")
    delayed: Any = require("dask", "map").delayed
    require("rioxarray", "map")
    if rows is not None and rows < 1:
        raise InputError(f"expected blocks of 1 row or more, but got {rows}")
    path = Path(path)
    with open_blocks(path) as cube:
        step, scale = rows or cube.rows_at_once, cube.scale()
        high, wide = cube.shape
        bands = len(cube.wavelength)
        there, crs = cube.transform, cube.crs
        coords: dict[str, Any] = {
            "wavelength": ("wavelength", cube.wavelength, {"units": "nm"}),
            "fwhm": ("wavelength", cube.fwhm, {"units": "nm"}),
            "good": ("wavelength", cube.good),
        }
    read = delayed(_read, pure=True)
    blocks = [
        array.from_delayed(
            read(path, start, min(step, high - start), scale),
            (min(step, high - start), wide, bands),
            dtype=np.float32,
        )
        for start in range(0, high, step)
    ]
    dims, placed = grid_coordinates(there, crs, (high, wide), step)
    if there.is_identity:
        dims, placed = ("row", "column"), {}
    attributes = {"units": "1", "long_name": "reflectance", "source": path.name}
    cube_array = xr.DataArray(
        array.concatenate(blocks), coords | placed, (*dims, "wavelength"), "reflectance", attributes
    )
    return cube_array.rio.write_crs(crs, grid_mapping_name="crs") if crs else cube_array


_ONE = threading.Lock()
"""HDF5 and netCDF4 fall over where two threads read at once."""


def _read(path: Path, start: int, rows: int, scale: float) -> np.ndarray:
    with _ONE, open_blocks(path) as cube:
        return cube.read(start, rows) / np.float32(scale)
