"""The one writer of rasters: GeoTIFF and ENVI files that any GIS opens where they lie.

In memory an image is [band, y, x] with y increasing to the north, as everywhere in fynjax; on
disk row 0 is the northern edge, as every GIS expects.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import ArrayLike
from rasterio import Affine
from rasterio.crs import CRS

from fynjax.app.io.text import atomic_path

LOCAL_FRAME = 'LOCAL_CS["fynjax plot frame, origin south-west",UNIT["metre",1]]'
"""Coordinate system of a plot without a place on Earth: x east, y north, in metres."""
UNKNOWN_FRAME = 'LOCAL_CS["unknown reference system",UNIT["metre",1]]'
"""Coordinate system of coordinates whose file does not say what they are."""


_PROFILE = {"driver": "GTiff", "compress": "deflate", "photometric": "minisblack", "alpha": "no"}


def grid_profile(
    bands: int, shape: tuple[int, ...], transform: Affine, crs: str | None, nodata: float | None
) -> dict[str, Any]:
    """What rasterio is to know of a raster of `bands` before it is written; without a `crs` it is
    in the plot's own frame."""
    system = CRS.from_user_input(crs) if crs else CRS.from_wkt(LOCAL_FRAME)
    size = {"count": bands, "height": shape[0], "width": shape[1]}
    return {**size, "dtype": "float32", "transform": transform, "crs": system, "nodata": nodata}


def write_geotiff(
    path: str | Path,
    image: ArrayLike,
    band_names: Sequence[str],
    *,
    pixel_m: float | None = None,
    wavelengths: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
    origin_m: tuple[float, float] = (0.0, 0.0),
    transform: Affine | None = None,
    crs: str | None = None,
    nodata: float | None = float("nan"),
    unit: str | None = None,
    offset: float = 0.0,
    tags: Mapping[str, object] | None = None,
) -> None:
    """Write an image as a compressed GeoTIFF, whole or not at all.

    **Arguments:**

    - `path`: the file to write.
    - `image`: [band, y, x], y increasing to the north. `uint8` stays so, all else is float32.
    - `band_names`: one for each band; they become the band descriptions.
    - `pixel_m`: side of a pixel [m]; `origin_m`: (x, y) of the south-west corner [m]. Or
      `transform`: from column and row, counted from the north-west corner, to x and y [m].
    - `wavelengths`: band centres; `widths`: full widths at half maximum, with them [nm].
    - `crs`: anything rasterio reads, such as "EPSG:32734"; `None` is the plot's local frame where
      the south-west corner is (0, 0), and unknown elsewhere.
    - `nodata`: value of pixels without data. Non-finite pixels are written as it.
    - `unit`: of the values; `offset`: what readers add to them.
    - `tags`: file attributes such as those of `provenance`.

    **Raises:** `ValueError` if shapes and names do not fit together.
    """
    values, count = np.asarray(image), len(band_names)
    if values.ndim != 3 or values.shape[0] != count:
        raise ValueError(
            f"`image` must be [band, y, x] with {count} bands, but has shape {values.shape}"
        )
    if wavelengths is not None and len(wavelengths) != count:
        raise ValueError(f"`wavelengths` must have {count} values, but has {len(wavelengths)}")
    if (transform is None) == (pixel_m is None):
        raise ValueError("either `pixel_m` or `transform` must be given")
    if values.dtype != np.uint8:
        missing = np.nan if nodata is None else nodata
        values = np.where(np.isfinite(values), values, missing).astype(np.float32)
    bands, rows, columns = values.shape
    if pixel_m is not None:
        transform = north_up(pixel_m, origin_m, rows)
    assert transform is not None
    if crs is None and max(map(abs, transform @ (0.0, float(rows)))) >= 1e-6:
        crs = UNKNOWN_FRAME
    profile = _PROFILE | grid_profile(bands, (rows, columns), transform, crs, nodata)
    profile |= {"dtype": values.dtype, "tiled": min(rows, columns) >= 256}
    profile["predictor"] = 1 if values.dtype == np.uint8 else 3
    with atomic_path(path) as partial, rasterio.open(partial, "w", **profile) as file:
        file.write(np.ascontiguousarray(values[:, ::-1, :]))
        if unit is not None:
            file.units = (unit,) * bands
        if offset:
            file.offsets = (offset,) * bands
        file.descriptions = tuple(band_names)
        for number, centre in enumerate(() if wavelengths is None else wavelengths, start=1):
            # Also as GDAL's drivers do.
            file.update_tags(number, wavelength=f"{centre:g}", wavelength_units="Nanometers")
            imagery = {"CENTRAL_WAVELENGTH_UM": f"{centre / 1e3:.7g}"}
            if widths is not None:
                file.update_tags(number, fwhm=f"{widths[number - 1]:g}")
                imagery["FWHM_UM"] = f"{widths[number - 1] / 1e3:.7g}"
            file.update_tags(number, ns="IMAGERY", **imagery)
        file.update_tags(
            **{k: v if isinstance(v, str) else json.dumps(v) for k, v in (tags or {}).items()}
        )


def north_up(pixel_m: float, origin_m: tuple[float, float], rows: int) -> Affine:
    """From column and row, counted from the north-west corner, to x and y [m]."""
    x, y = origin_m
    return Affine(pixel_m, 0.0, x, 0.0, -pixel_m, y + rows * pixel_m)
