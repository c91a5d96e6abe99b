"""The part of a raster that lies over a plot: heights, probabilities, shares of what lies on the
ground."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.windows import Window
from scipy.interpolate import make_interp_spline

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.raster._reader import RasterFile, open_raster
from fynjax.app.io.text import did_you_mean
from fynjax.scene import COVERS

_TINY = 1e-4
"""Part of a cell by which edges may miss each other and still be the same [-]."""

_MOST_CLASSES = 20
"""Number below which whole numbers alone are likely to be those of classes."""

Edges = tuple[float, float]


@dataclass(frozen=True)
class OverPlot:
    """Bands of a raster where it lies over a plot."""

    file: Path
    values: NDArray[np.float64]
    """Values [band, row, column] of all cells that the plot touches, rows from the north."""
    edges: tuple[Edges, Edges]
    """First and last edge of the plot in rows and in columns of `values`."""
    names: tuple[str, ...]
    """Description of each band; empty where it has none."""
    units: tuple[str, ...]
    """Unit of each band, as the file states it; empty where it states none."""

    def check_single(self, expected: str, remedy: str) -> None:
        """Refuse a raster of several bands; `expected` is what one band is to be."""
        if len(self.names) != 1:
            listed = ", ".join(name or f"band {k}" for k, name in enumerate(self.names, 1))
            words = f"expected {expected}, but it has {len(self.names)} ({listed}). {remedy}"
            raise InputError(words, file=self.file)

    def in_own_cells(self) -> NDArray[np.float64]:
        """[band, y, x], y to the north: the cells as they are where the plot's edges meet those of
        cells; else cells that divide the plot and are no larger, each with the mean of what it
        covers."""
        rows, columns = (int(np.ceil(last - first - _TINY)) for first, last in self.edges)
        return self.in_cells((rows, columns))

    def in_cells(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """[band, y, x], y to the north: means over the cells of a grid of `shape` over the plot."""
        values = self.values
        for axis, (edges, number) in enumerate(zip(self.edges, shape, strict=True), start=1):
            values = _means(values, edges, axis, number)
        return np.ascontiguousarray(values[:, ::-1])

    def at_centres(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """[band, y, x], y to the north: a smooth quantity at the middles of the cells of a grid of
        `shape` over the plot. Linear between the middles of the raster's cells where these are
        the larger ones (their means would make steps); means where they are the smaller ones."""
        values = self.values
        for axis, (edges, number) in enumerate(zip(self.edges, shape, strict=True), start=1):
            finer = number > edges[1] - edges[0] + _TINY
            values = (_between if finer else _means)(values, edges, axis, number)
        return np.ascontiguousarray(values[:, ::-1])


@names_file
def read_over_plot(
    path: Path,
    what: str,
    size_m: tuple[float, float],
    *,
    origin_m: tuple[float, float] | None,
    option: str,
) -> OverPlot:
    """Read the part of a raster that lies over a plot.

    **Arguments:**

    - `path`: any raster that GDAL reads.
    - `what`: names the file in errors, such as "a probability map".
    - `size_m`: (x, y) extent of the plot [m].
    - `origin_m`, `option`: where the plot lies in the raster, as `read_probability_map` has them.

    **Returns:** an `OverPlot`: the cells that cover the plot, in the file's unit.

    **Raises:** `InputError` for a raster that cannot be read or placed, does not cover the plot,
    has cells without data over it, or numbers that stand for colours.
    """
    if not (np.isfinite(size_m).all() and min(size_m) > 0.0):
        raise InputError(f"`size_m` must be positive [m], but is {size_m}")
    with open_raster(path, what) as file:
        file.check_place()
        _check_palette(file)
        corner = _corner(file, size_m, origin_m, option)
        columns, rows = _edges(file, size_m, corner, option)
        first = (int(rows[0] + _TINY), int(columns[0] + _TINY))
        last = (int(np.ceil(rows[1] - _TINY)), int(np.ceil(columns[1] - _TINY)))
        window = Window(first[1], first[0], last[1] - first[1], last[0] - first[0])
        part = file.read(file.bands, window=window)
    values, valid = part.values[:, ::-1], part.mask[::-1]
    if not valid.all():
        row, column = np.argwhere(~valid)[0]
        x, y = part.transform @ (column + 0.5, row + 0.5)
        raise InputError(
            f"expected a value in every cell of the plot, but {int((~valid).sum())} of "
            f"{valid.size} have none (no data or NaN), the first at "
            f"({x:.2f}, {y:.2f}). Fill them first, with 0 where that is meant: "
            f"gdal_fillnodata.py {path.name} filled.tif"
        )
    (r0, r1), (c0, c1) = rows, columns
    edges = (r0 - first[0], r1 - first[0]), (c0 - first[1], c1 - first[1])
    names, units = (tuple(of[n - 1] for n in file.bands) for of in (file.names, file.units))
    return OverPlot(path, values, edges, names, units)


def _check_palette(file: RasterFile) -> None:
    """Refuse numbers of colours, but for those of grey that are as bright as they say."""
    for band in file.bands:
        if file.dataset.colorinterp[band - 1] == ColorInterp.palette:
            colours = file.dataset.colormap(band).items()
            if any(colour[:3] != (number,) * 3 for number, colour in colours):
                raise InputError(
                    f"expected {file.what}, but band {band} has a palette: its numbers are those "
                    "of classes or colours. Give each class its value first, or if grey is meant: "
                    f"gdal_translate -expand gray {file.path.name} grey.tif"
                )


def _corner(
    file: RasterFile, size: tuple[float, float], origin: tuple[float, float] | None, option: str
) -> tuple[float, float]:
    """The plot's south-west corner in the raster's coordinates."""
    if origin is not None:
        if len(origin) != 2 or not np.isfinite(origin).all():
            raise InputError(f"`{option}` must be two numbers (x, y) [m], but is {origin}")
        return float(origin[0]), float(origin[1])
    if not file.on_earth:
        return 0.0, 0.0
    west, south, east, north = file.dataset.bounds
    wide, deep = east - west, north - south
    t = file.dataset.transform
    if abs(wide - size[0]) > _slack(t.a, size[0]) or abs(deep - size[1]) > _slack(-t.e, size[1]):
        raise InputError(
            f"expected a raster as large as the plot, {size[0]:g} m x {size[1]:g} m, but it covers "
            f"{wide:g} m x {deep:g} m. Say where in it the plot lies: `{option}` is the plot's "
            f"south-west corner (x, y) in its coordinates, within ({west:.2f}, {south:.2f}) "
            f"to ({east:.2f}, {north:.2f})."
        )
    return west, south


def _slack(cell: float, size: float) -> float:
    """By how much [m] a raster may miss a plot's edge, as one cut to whole cells around it does."""
    return min(0.5 * cell, 0.02 * size)


def _edges(
    file: RasterFile, size: tuple[float, float], corner: tuple[float, float], option: str
) -> tuple[tuple[float, float], tuple[float, float]]:
    """First and last edge of the plot in columns from the west, and in rows from the north."""
    t = file.dataset.transform
    west, south, east, north = file.dataset.bounds
    height, width = file.shape
    columns = (corner[0] - west) / t.a, (corner[0] + size[0] - west) / t.a
    rows = (north - corner[1] - size[1]) / -t.e, (north - corner[1]) / -t.e
    beyond = (max(-columns[0], columns[1] - width) * t.a, max(-rows[0], rows[1] - height) * -t.e)
    if any(b > _slack(c, s) for b, c, s in zip(beyond, (t.a, -t.e), size, strict=True)):
        raise InputError(
            f"expected a raster that covers the plot, ({corner[0]:.2f}, {corner[1]:.2f}) to "
            f"({corner[0] + size[0]:.2f}, {corner[1] + size[1]:.2f}), but it covers "
            f"({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}). The plot's south-west "
            f"corner in its coordinates is set by `{option}`."
        )
    columns = max(columns[0], 0.0), min(columns[1], float(width))
    rows = max(rows[0], 0.0), min(rows[1], float(height))
    return columns, rows


def _means(
    values: NDArray[np.float64], edges: tuple[float, float], axis: int, number: int
) -> NDArray[np.float64]:
    """Means of `number` cells that divide `edges`, in cells of `values`, evenly."""
    cells = values.shape[axis]
    if edges[0] < _TINY and cells - edges[1] < _TINY and number == cells:
        return values
    total = np.insert(np.cumsum(values, axis), 0, 0.0, axis)
    until = make_interp_spline(np.arange(cells + 1.0), total, k=1, axis=axis)
    at = np.linspace(*edges, number + 1)
    return np.diff(until(at), axis=axis) / ((edges[1] - edges[0]) / number)


def _between(
    values: NDArray[np.float64], edges: tuple[float, float], axis: int, number: int
) -> NDArray[np.float64]:
    """Values at the middles of `number` cells that divide `edges`, linear between those of the
    middles of cells, and straight on beyond the outermost."""
    cells = values.shape[axis]
    if cells == 1:
        return np.repeat(values, number, axis)
    linear = make_interp_spline(np.arange(cells) + 0.5, values, k=1, axis=axis)
    at = np.linspace(*edges, number + 1)
    return np.asarray(linear(0.5 * (at[1:] + at[:-1])), float)


@names_file
def read_probability_map(
    path: str | Path,
    size_m: tuple[float, float],
    *,
    origin_m: tuple[float, float] | None = None,
    option: str = "origin_m",
) -> Float64[np.ndarray, "y x"]:
    """Read the part of a raster of 0 to 255 that lies over a plot, as `assign_sites` takes it.

    Where the plot lies in the raster: with its south-west corner at `origin_m`, if given. Else, in
    a raster of the plot's own frame (any local system, as fynjax writes it for a plot without a
    place on Earth), at (0, 0). Else, in a raster with a place on Earth, at the raster's own
    corner, if the raster is as large as the plot; a larger one cannot be placed without
    `origin_m`. A raster may miss the plot's edges by half a cell, but by no more than 2 % of the
    plot: it is then stretched over the plot.

    Where the plot's edges meet those of cells the cells are taken as they are. Else the plot is
    divided into cells no larger than the raster's, each with the area-weighted mean of what it
    covers: so the mean over the plot is kept, and with it the share of points accepted.

    **Arguments:**

    - `path`: any raster of one band that GDAL reads; whole numbers or fractions of 0 to 255.
    - `size_m`: (x, y) extent of the plot [m].
    - `origin_m`: (x, y) of the plot's south-west corner, in the raster's coordinates [m].
    - `option`: what the user calls `origin_m`, for errors.

    **Returns:** the map over the plot's extent, 0 to 255, row 0 at the southern edge.

    **Raises:** `InputError` for a raster that is missing or cut short, has no coordinate reference
    system, is in degrees or feet, is rotated, has several bands, does not cover the plot; that has
    cells without data or NaN over the plot, values outside 0-255 or within 0-1, nothing but 0, or
    a palette. Warns where the map has one value all over the plot, or none above 100.
    """
    path = Path(path)
    part = read_over_plot(path, "a probability map", size_m, origin_m=origin_m, option=option)
    part.check_single(
        "a map of one band of 0 to 255",
        f"Make a map of an image with `fynjax pattern {path.name}`, or choose a band: "
        "gdal_translate -b 1",
    )
    _check_values(part.values, path)
    values = np.clip(part.in_own_cells()[0], 0.0, 255.0)
    if np.ptp(values) < 1e-9:
        warnings.warn(
            f"{path}: the probability map is {values.flat[0]:g} all over the plot, so it sets no "
            "pattern",
            stacklevel=3,
        )
    return values


def _check_values(values: NDArray[np.float64], path: Path) -> None:
    """Refuse numbers that cannot be 0 to 255."""
    low, high = float(values.min()), float(values.max())
    if low < 0.0 or high > 255.0:
        raise InputError(
            f"expected values of 0 to 255, but they range from {low:g} to {high:g} over the plot. "
            "A no-data value that the file does not declare (gdal_edit.py -a_nodata), or another "
            f"scale (gdal_translate -ot Byte -scale {low:g} {high:g} 0 255)?"
        )
    if high == 0.0:
        raise InputError(
            "expected values above 0 where plants may stand, but the map is 0 all over the plot: "
            "no plant could be placed"
        )
    if high <= 1.0:
        raise InputError(
            f"expected values of 0 to 255, but the largest over the plot is {high:g}. Chances of 0 "
            f"to 1, or a mask? Multiply by 255: gdal_translate -ot Byte -scale 0 1 0 255 "
            f"{path.name} map.tif"
        )
    if high <= 100.0 and low < high:
        whole = high < _MOST_CLASSES and bool((values == np.round(values)).all())
        warnings.warn(
            f"{path}: the largest value over the plot is {high:g}, so plants would be kept there "
            f"with a chance of {high:g}/255. Is the map in {'classes' if whole else 'percent'}? "
            "Write 0 to 255 for chances of 0 to 1",
            stacklevel=4,
        )


@names_file
def read_cover_map(
    path: Path,
    size_m: tuple[float, float],
    shape: tuple[int, int],
    *,
    origin_m: tuple[float, float] | None,
    option: str,
) -> Float64[np.ndarray, "kind y x"]:
    """Shares of soil, litter, char and rock in each voxel column of a plot.

    From a GeoTIFF whose bands are named after the covers, any of them, with values of 0 to 1; the
    soil is the rest.

    **Arguments:**

    - `path`: the GeoTIFF.
    - `size_m`: (x, y) extent of the plot [m].
    - `shape`: rows and columns of voxels.
    - `origin_m`, `option`: where the plot lies in the raster, as `read_probability_map` has them.

    **Returns:** shares [kind, y, x] of 0 to 1, y to the north [-].

    **Raises:** `InputError` for a raster that cannot be read or placed, bands of other names, and
    shares below 0 or that sum to more than 1.
    """
    part = read_over_plot(path, "a map of the ground", size_m, origin_m=origin_m, option=option)
    covers = [name.lower() for name in part.names]
    for number, cover in enumerate(covers, 1):
        if cover not in COVERS or cover in covers[: number - 1]:
            raise InputError(
                f"expected bands named {', '.join(COVERS)} (any of them, once), but band {number} "
                f"is {part.names[number - 1] or 'unnamed'!r}.{did_you_mean(cover, COVERS)} The "
                "names are the bands' descriptions."
            )
    total = part.values.sum(axis=0)
    if part.values.min() < 0.0 or total.max() > 1.0 + 1e-3:
        wrong = part.values.min() if part.values.min() < 0.0 else total.max()
        raise InputError(
            "expected shares of 0 to 1 that sum to at most 1, but "
            f"{'one is' if wrong < 0 else 'they sum to'} {wrong:g}. Percent? Divide by 100."
        )
    shares = np.zeros((len(COVERS) + 1, *shape))
    for name, values in zip(covers, part.in_cells(shape), strict=True):
        shares[1 + COVERS.index(name)] = np.clip(values, 0.0, 1.0)  # but for rounding
    shares[0] = np.maximum(1.0 - shares[1:].sum(axis=0), 0.0)
    return shares
