"""Terrain in files: GeoTIFF in and out, OBJ out."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from fynjax._core.errors import InputError
from fynjax.io._atomic import write_text
from fynjax.io._raster_checks import check_north_up, check_square
from fynjax.io._rasters import write_geotiff
from fynjax.io._tables import existing_file
from fynjax.terrain._raster import Terrain
from fynjax.terrain._surface import interpolate, terrain_mesh
from fynjax.terrain._units import (
    UNITS,
    Bounds,
    check_bounds,
    check_metric,
    parse_crs,
    unit_factor,
)

_TALLEST = 9000.0
_DEEPEST = -500.0
_STEEPEST = 2.0
_METRES = ("", "m", "metre", "meter", "metres", "meters")


def write_terrain(path: str | Path, terrain: Terrain) -> None:
    """Write the heights as a GeoTIFF of one band, whole or not at all; northern row first."""
    write_geotiff(
        path,
        terrain.heights[None],
        ["ground_height"],
        pixel_m=terrain.cell,
        origin_m=terrain.origin,
        crs=terrain.crs,
        tags={"quantity": "height of the ground", "unit": "m"},
    )


def write_mesh(path: str | Path, terrain: Terrain) -> None:
    """Write `terrain_mesh` as OBJ, whole or not at all.

    Map coordinates lose their decimals in programs of single precision, so the plot's frame is
    written; the first lines say where it is.
    """
    from trimesh.exchange.obj import export_obj

    x, y = terrain.origin
    header = (
        "ground, metres, x east, y north, z up\n"
        f"add ({x:.3f}, {y:.3f}, {terrain.heights.min():.3f}) for map coordinates"
    )
    text = export_obj(terrain_mesh(terrain), include_normals=False, digits=4, header=header)
    write_text(path, text if text.endswith("\n") else text + "\n")


def read_terrain(
    path: str | Path,
    bounds: Bounds | None = None,
    *,
    crs: str | None = None,
    height_unit: str | None = None,
    fill_gaps: bool = False,
) -> Terrain:
    """Read a digital terrain model.

    **Arguments:**

    - `path`: a raster of one band that GDAL reads; GeoTIFF is usual.
    - `bounds`: the plot, in the raster's coordinates; the cells that touch it are read. The whole
      raster unless given.
    - `crs`: reference system of a raster that states none, such as "EPSG:32734".
    - `height_unit`: one of `UNITS`, where heights are not in metres.
    - `fill_gaps`: interpolate cells without a height (Laplace, as `terrain_from_points`).

    **Raises:** `InputError` for a file that is missing or cut short, has no reference system, is
    in degrees or feet, is rotated, does not cover the plot, or has cells without a height there.
    """
    path = existing_file(path, "a terrain raster")
    with _opened(path) as file:
        cell, system = _frame(file, path, crs, height_unit is not None)
        unit = height_unit or _stated_unit(file, path)
        window, corner = _window(file, path, cell, bounds)
        values = file.read(1, window=window).astype(np.float64)
        values = values * file.scales[0] + file.offsets[0]
        valid = file.read_masks(1, window=window) > 0
    valid &= np.isfinite(values)
    values, valid = values[::-1] * unit_factor(unit), valid[::-1]
    values[~valid] = np.nan
    _check_heights(values, cell, path)
    if not valid.all():
        values = _filled(values, valid, cell, corner, fill_gaps, path)
    wkt = system.to_wkt()
    return Terrain(values, cell, corner, None if "fynjax plot frame" in wkt else wkt)


def raster_bounds(path: str | Path) -> Bounds:
    """West, south, east and north edge of a raster, in its coordinates."""
    with _opened(existing_file(path, "a terrain raster")) as file:
        west, south, east, north = (float(edge) for edge in file.bounds)
    return west, south, east, north


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A raster; what GDAL cannot read is an `InputError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                yield file
    except RasterioError as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise InputError(
            f"cannot be read as a raster ({reason}). Is it cut short, or not a GeoTIFF? Copy it "
            "again.",
            file=path,
        ) from error


def _frame(file: Any, path: Path, stated: str | None, height_stated: bool) -> tuple[float, CRS]:
    """Side of a cell [m] and reference system."""
    if file.count != 1:
        raise InputError(
            f"expected a raster of one band, the height of the ground, but it has {file.count}. "
            "Choose one: gdal_translate -b 1",
            file=path,
        )
    t = file.transform
    system = parse_crs(stated, path) if stated is not None else file.crs
    if system is None or t.is_identity:
        raise InputError(
            "expected a raster with a coordinate reference system and a place, but it has "
            f"{'no system' if system is None else 'no place'}. Give it one: "
            f"gdal_edit.py -a_srs EPSG:... {path.name}",
            file=path,
        )
    check_metric(system, path, height_stated=height_stated)
    check_north_up(t, path, "a raster")
    check_square(t, path, "cells")
    return float(t.a), system


def _stated_unit(file: Any, path: Path) -> str:
    """The unit of heights that the band states; metres if none."""
    unit = (file.units[0] or "").strip()
    if unit.lower() not in _METRES:
        raise InputError(
            f"expected heights in metres, but the band says {unit!r}. State the height unit "
            f"({', '.join(UNITS)}).",
            file=path,
        )
    return "metre"


def _window(
    file: Any, path: Path, cell: float, bounds: Bounds | None
) -> tuple[Window, tuple[float, float]]:
    """The part of the raster that touches the plot, and its south-west corner."""
    west, north = float(file.transform.c), float(file.transform.f)
    rows, columns = file.height, file.width
    if bounds is None:
        return Window(0, 0, columns, rows), (west, north - rows * cell)
    w, s, e, n = check_bounds(bounds)
    low = (w - west) / cell, (north - n) / cell
    high = (e - west) / cell, (north - s) / cell
    tiny = 1e-6
    if min(low) < -tiny or high[0] > columns + tiny or high[1] > rows + tiny:
        raise InputError(
            f"the raster covers ({west:.2f}, {north - rows * cell:.2f}) to "
            f"({west + columns * cell:.2f}, {north:.2f}), but the plot is ({w:.2f}, {s:.2f}) to "
            f"({e:.2f}, {n:.2f}). Are both in the same coordinate reference system?",
            file=path,
        )
    left, top = int(low[0] + tiny), int(low[1] + tiny)
    right = min(columns, int(np.ceil(high[0] - tiny)))
    bottom = min(rows, int(np.ceil(high[1] - tiny)))
    corner = (west + left * cell, north - bottom * cell)
    return Window(left, top, right - left, bottom - top), corner


def _check_heights(heights: NDArray[np.float64], cell: float, path: Path) -> None:
    """Refuse what no ground can be: missing values not declared, or another unit."""
    if not np.isfinite(heights).any():
        raise InputError(
            "expected heights over the plot, but all its cells are without data", file=path
        )
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    if low < _DEEPEST or high > _TALLEST:
        value = low if low < _DEEPEST else high
        raise InputError(
            f"expected heights in metres, but got {value:g}. A no-data value that the file does "
            f"not declare (gdal_edit.py -a_nodata {value:g} {path.name}), or centimetres or feet "
            "(state the height unit)?",
            file=path,
        )
    steps = np.abs(np.concatenate([np.diff(heights).ravel(), np.diff(heights, axis=0).ravel()]))
    steps = steps[np.isfinite(steps)]
    if steps.size and (slope := float(np.median(steps)) / cell) > _STEEPEST:
        raise InputError(
            f"expected ground in metres, but it rises {slope:.1f} m in each metre. Are heights in "
            "centimetres? State the height unit.",
            file=path,
        )


def _filled(
    values: NDArray[np.float64],
    valid: NDArray[np.bool_],
    cell: float,
    corner: tuple[float, float],
    fill_gaps: bool,
    path: Path,
) -> NDArray[np.float64]:
    """`values` with its gaps interpolated, or an `InputError` that says where they are."""
    missing = np.argwhere(~valid)
    if not fill_gaps:
        y, x = (missing[0] + 0.5) * cell + np.array(corner[::-1])
        raise InputError(
            f"expected a height in every cell of the plot, but {len(missing)} of {valid.size} "
            f"cells have none (no data or NaN), the first at ({x:.2f}, {y:.2f}). Fill the gaps "
            "(--fill-gaps), or choose another plot.",
            file=path,
        )
    known = np.argwhere(valid)
    points = np.column_stack([known[:, ::-1] * cell, values[valid]])
    filled = values.copy()
    filled[~valid] = interpolate(points, np.asarray(missing[:, ::-1] * cell, np.float64))
    return filled
