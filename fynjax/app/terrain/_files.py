"""Terrain in files: GeoTIFF in and out, OBJ out."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from fynjax._core.errors import InputError
from fynjax.app.io.raster import METRES, UNITS, RasterFile, open_raster, parse_crs, write_geotiff
from fynjax.app.io.text import write_text
from fynjax.app.terrain._raster import Terrain
from fynjax.app.terrain._surface import fill, terrain_mesh
from fynjax.app.terrain._units import (
    Bounds,
    check_height_range,
    check_inside,
    check_positive,
    unit_factor,
)

_STEEPEST = 2.0
_WHAT = "a terrain raster"
# Heights this large [m] move in steps of half a millimetre in single precision.
_LARGE = 4096.0
# How far above the usual step between neighbours the jump around missing data is.
_JUMP = 10.0


def write_terrain(path: str | Path, terrain: Terrain) -> None:
    """Write the heights as a GeoTIFF of one band, complete or not at all; northern row first.

    **Arguments:**

    - `path`: of the file.
    - `terrain`: the heights of the ground.

    In single precision, in metres. Where heights are beyond 4096 m, the band's offset (which GDAL,
    GIS and `read_terrain` add) is the lowest of them, so that steps stay below half a millimetre.
    """
    low = float(terrain.heights.min())
    offset = low if np.abs(terrain.heights).max() > _LARGE else 0.0
    write_geotiff(
        path,
        terrain.heights[None] - offset,
        ["ground_height"],
        pixel_m=terrain.cell,
        origin_m=terrain.origin,
        crs=terrain.crs,
        unit="m",
        offset=offset,
        tags={"quantity": "height of the ground", "unit": "m"},
    )


def write_mesh(path: str | Path, terrain: Terrain) -> None:
    """Write `terrain_mesh` as OBJ, complete or not at all.

    **Arguments:**

    - `path`: of the file.
    - `terrain`: the heights of the ground.

    Map coordinates lose their decimals in programs of single precision, so the plot's frame is
    written; the first lines hold its place.
    """
    from trimesh.exchange.obj import export_obj

    x, y = terrain.origin
    header = (
        "ground, metres, x east, y north, z up\n"
        f"add ({x:.3f}, {y:.3f}, {terrain.heights.min():.3f}) for map coordinates\n"
        "0 is the height of the lowest cell's centre; corners of cells may lie below"
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
    largest_gap: float = 10.0,
    band: int | None = None,
) -> Terrain:
    """Read a digital terrain model.

    **Arguments:**

    - `path`: a raster that GDAL reads; GeoTIFF is usual.
    - `bounds`: the plot, in the raster's coordinates; the cells that touch it are read. The whole
      raster unless given.
    - `crs`: reference system of a raster that states none, such as "EPSG:32734".
    - `height_unit`: one of `UNITS`, where heights are not in metres.
    - `fill_gaps`: interpolate cells without a height (Laplace, as `terrain_from_points`).
    - `largest_gap`: how far a cell that is filled may be from one with a height [m].
    - `band`: number of the band with the heights, from 1, in a raster of several.

    **Raises:** `InputError` for a file that is missing or cut short, has no reference system, is
    in degrees or feet, is rotated, does not cover the plot, has cells without a height there, or
    a value that stands for missing data and is not declared (a whole number, the lowest or the
    highest, with a jump all around; a warning where the file declares another).
    """
    path = Path(path)
    check_positive("largest_gap", largest_gap)
    with open_raster(path, _WHAT) as file:
        band = _band(file, band)
        stated = None if crs is None else parse_crs(crs, path)
        system = file.check_place(crs=stated, height_stated=height_unit is not None)
        unit = height_unit or _stated_unit(file, band)
        cell = file.cell_m
        assert cell is not None  # it has a place, in metres
        part = file.read([band], window=_window(file, cell, bounds))
        scale, offset = file.dataset.scales[band - 1], file.dataset.offsets[band - 1]
        declared = file.dataset.nodatavals[band - 1] is not None
    values, valid, corner = part.values[0], part.mask, part.origin
    raw = np.round((values - offset) / scale, 6)
    values = values * unit_factor(unit or "metre")
    if min(valid.shape) < 2:
        raise InputError(
            f"expected at least two rows and columns of cells over the plot, but got "
            f"{valid.shape[1]} by {valid.shape[0]}. Choose a larger plot.",
            file=path,
        )
    if not valid.any():
        raise InputError(
            "expected heights over the plot, but all its cells are without data", file=path
        )
    _check_missing(raw, values, cell, path, declared)
    _check_heights(values, cell, path, unit_known=unit is not None)
    gap = np.zeros(valid.shape)
    if not valid.all():
        values, gap[~valid] = _filled(values, valid, cell, corner, fill_gaps, largest_gap, path)
    wkt = system.to_wkt()
    unplaced = any(name in wkt for name in ("fynjax plot frame", "unknown reference system"))
    crs = None if unplaced else wkt
    return Terrain(values, cell, corner, crs, filled=float((~valid).mean()), gap=gap)


def middle_of_raster(path: str | Path, size: float) -> Bounds:
    """A square in the middle of a raster, with its corner on that of a cell.

    **Arguments:**

    - `path`: a raster that GDAL reads.
    - `size`: side of the square [m].

    **Returns:** west, south, east and north edge, in the raster's coordinates [m].
    """
    with open_raster(path, _WHAT) as file:
        west, south, east, north = file.dataset.bounds
        cell = abs(file.dataset.transform.a)
    x = west + cell * round((east - west - size) / 2.0 / cell)
    y = south + cell * round((north - south - size) / 2.0 / cell)
    return x, y, x + size, y + size


def _band(file: RasterFile, band: int | None) -> int:
    """Number of the band to read."""
    if band is None and file.dataset.count == 1:
        return 1
    if band is None or band not in file.dataset.indexes:
        named = (
            f"{number} {name}" if name else str(number)
            for number, name in zip(file.dataset.indexes, file.names, strict=True)
        )
        asked = "none was chosen" if band is None else f"{band} was chosen"
        raise InputError(
            f"expected the number of the band with the heights (`band`): it has "
            f"{file.dataset.count} ({', '.join(named)}), and {asked}",
            file=file.path,
        )
    return band


def _stated_unit(file: RasterFile, band: int) -> str | None:
    """The unit of heights that the band states."""
    unit = file.units[band - 1]
    if not unit:
        return None
    if unit.lower() not in METRES:
        raise InputError(
            f"expected heights in metres, but the band says {unit!r}. State the height unit "
            f"({', '.join(UNITS)}).",
            file=file.path,
        )
    return "metre"


def _window(file: RasterFile, cell: float, bounds: Bounds | None) -> Window | None:
    """The part of the raster that touches the plot; `None` is all of it."""
    if bounds is None:
        return None
    (rows, columns), edges = file.shape, file.dataset.bounds
    tiny = 1e-6
    west, south, east, north = check_inside(
        bounds, tuple(edges), tiny * cell, "the raster", file.path
    )
    low = (west - edges.left) / cell, (edges.top - north) / cell
    high = (east - edges.left) / cell, (edges.top - south) / cell
    left, top = int(low[0] + tiny), int(low[1] + tiny)
    right = min(columns, int(np.ceil(high[0] - tiny)))
    bottom = min(rows, int(np.ceil(high[1] - tiny)))
    return Window(left, top, right - left, bottom - top)


def _check_missing(
    raw: NDArray[np.float64], heights: NDArray[np.float64], cell: float, path: Path, declared: bool
) -> None:
    """Refuse a value for missing data that the file does not declare.

    It is a whole number and the lowest or the highest there is, with a jump around its cells that
    is far above the steps elsewhere and steeper than ground. `raw` are the numbers in the file,
    `heights` what they mean [m], NaN where they are declared missing.
    """
    used = raw[np.isfinite(heights)]
    steps = [np.abs(np.diff(heights, axis=axis)) for axis in (0, 1)]
    for value in (float(used.min()), float(used.max())):
        if value != round(value):
            continue
        same = raw == value
        # How many of the two neighbours have the value: one at its edge, none elsewhere.
        count = [same[1:].astype(int) + same[:-1], same[:, 1:].astype(int) + same[:, :-1]]
        edge, rest = (
            np.concatenate(
                [s[(c == n) & np.isfinite(s)] for s, c in zip(steps, count, strict=True)]
            )
            for n in (1, 0)
        )
        if not (edge.size and rest.size):
            continue
        usual, jump = float(np.percentile(rest, 95.0)), float(np.median(edge))
        if jump <= max(_JUMP * usual, _STEEPEST * cell):
            continue
        said = (
            f"{value:g} in {int(same.sum())} cells, {jump:.1f} m off their neighbours, where "
            f"others differ by {usual:.2g} m"
        )
        if declared or usual == 0.0:  # it may be a wall after all
            warnings.warn(
                f"{path.name} has {said}. Does it stand for missing data? Then declare it: "
                f"gdal_edit.py -a_nodata {value:g} {path.name}",
                stacklevel=4,
            )
            return
        raise InputError(
            f"expected heights, but got {said}. Does it stand for missing data? Then declare it: "
            f"gdal_edit.py -a_nodata {value:g} {path.name}. If it is a height, declare another "
            "value.",
            file=path,
        )


def _check_heights(
    heights: NDArray[np.float64], cell: float, path: Path, *, unit_known: bool
) -> None:
    """Refuse what no ground can be: heights of no place, or in another unit."""
    known = heights[np.isfinite(heights)]
    remedy = f"Then declare it: gdal_edit.py -a_nodata VALUE {path.name}"
    check_height_range(known, path, remedy, unit_known=unit_known)
    if unit_known:
        return
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
    largest_gap: float,
    path: Path,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`values` with its gaps interpolated, and how far each of these is from a height [m]; or an
    `InputError` that says where they are."""
    missing = np.argwhere(~valid)
    if not fill_gaps:
        y, x = (missing[0] + 0.5) * cell + np.array(corner[::-1])
        raise InputError(
            f"expected a height in every cell of the plot, but {len(missing)} of {valid.size} "
            f"cells have none (no data or NaN), the first at ({x:.2f}, {y:.2f}). Fill the gaps "
            "(`fill_gaps`), or choose another plot.",
            file=path,
        )
    known = np.argwhere(valid)
    points = np.column_stack([known[:, ::-1] * cell, values[valid]])
    filled = values.copy()
    places = np.asarray(missing[:, ::-1] * cell, np.float64)
    first = (corner[0] + 0.5 * cell, corner[1] + 0.5 * cell)
    filled[~valid], distance = fill(points, places, first, cell, largest_gap, valid.size)
    return filled, distance
