"""Files of reflectance as EMIT's are: a swath, and the lookup table that places it on a map."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rasterio.crs import CRS

GEOTRANSFORM = (18.4, 5.5e-4, 0.0, -33.9, 0.0, -5e-4)
FILL = -9999


def lookup(
    rows: int, columns: int, shape: tuple[int, int] = (14, 13)
) -> tuple[np.ndarray, np.ndarray]:
    """Column and row, from 1, of a swath that is turned and sheared on its map, with two holes."""
    y, x = np.mgrid[: shape[0], : shape[1]] - np.array(shape).reshape(2, 1, 1) / 2
    row = np.rint(0.8 * y + 0.5 * x + rows / 2).astype(np.int32)
    column = np.rint(0.3 * y - 0.7 * x + columns / 2).astype(np.int32)
    out = (row < 1) | (row > rows) | (column < 1) | (column > columns)
    out[6, 5] = out[7, 7] = True
    return np.where(out, 0, column), np.where(out, 0, row)


def write_emit(
    path: Path,
    values: np.ndarray,
    centre: Any,
    fwhm: Any,
    *,
    location: dict[str, Any] | None = None,
    attributes: dict[str, Any] | None = None,
    counted: bool = False,
) -> None:
    """Write `values` [row, column, band], NaN without data.

    `location` and `attributes` take the place of those of a sound file; `None` among them leaves
    one out. `counted`: rows and columns have their numbers as coordinates, as files that were
    written anew may.
    """
    rows, columns, bands = values.shape
    given = {"geotransform": np.array(GEOTRANSFORM), "spatial_ref": CRS.from_epsg(4326).to_wkt()}
    given |= attributes or {}
    swath, ortho = ("downtrack", "crosstrack"), ("ortho_y", "ortho_x")
    data = xr.Dataset(
        {"reflectance": ((*swath, "bands"), values.astype(np.float32))},
        coords=dict(zip(swath, map(np.arange, values.shape))) if counted else {},
        attrs={k: v for k, v in given.items() if v is not None},
    )
    data.to_netcdf(path, encoding={"reflectance": {"_FillValue": float(FILL)}})
    spectral = {"wavelengths": ("bands", np.asarray(centre)), "fwhm": ("bands", np.asarray(fwhm))}
    spectral["good_wavelengths"] = ("bands", np.ones(bands))
    xr.Dataset(spectral).to_netcdf(path, mode="a", group="sensor_band_parameters")
    glt_x, glt_y = lookup(rows, columns)
    parts: dict[str, Any] = {
        "lon": (swath, np.full((rows, columns), 18.4)),
        "lat": (swath, np.full((rows, columns), -33.9)),
        "glt_x": (ortho, glt_x),
        "glt_y": (ortho, glt_y),
    } | (location or {})
    there = xr.Dataset({k: v for k, v in parts.items() if v is not None})
    packed = {"zlib": True, "_FillValue": FILL, "dtype": "int32"}
    encoding = {k: packed for k in there if str(k).startswith("glt") and there[k].dtype == np.int32}
    if there:
        there.to_netcdf(path, mode="a", group="location", encoding=encoding)


NOWHERE = dict.fromkeys(("lon", "lat", "glt_x", "glt_y"))
"""`location` of a file without any."""
