"""The ground as a raster of heights."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator

from fynjax._core.errors import InputError
from fynjax.app.terrain._units import Bounds, check_bounds, check_inside, check_positive


@dataclass(frozen=True)
class Terrain:
    """Heights of the ground on square cells. Row 0 is the southern one."""

    heights: Float64[np.ndarray, "y x"]
    """Height of the ground at the centre of each cell [m]; finite."""
    cell: float
    """Side of a square cell [m]."""
    origin: tuple[float, float] = (0.0, 0.0)
    """South-west corner (x, y) of the raster [m]."""
    crs: str | None = None
    """Coordinate reference system as WKT; `None` is a frame of the plot's own."""
    filled: float = 0.0
    """Share of the cells of its file that had no height and were interpolated [-]."""
    gap: Float64[np.ndarray, "y x"] | None = None
    """Distance of the centre of each cell from the nearest ground that was measured, 0 in a cell
    with some: where it is not 0 the height is interpolated [m]. None where that is not known."""

    def __post_init__(self) -> None:
        values = np.asarray(self.heights, np.float64)
        if values.ndim != 2 or min(values.shape) < 2:
            raise InputError(
                f"`heights` must be [y, x] with at least two rows and columns, but has shape "
                f"{values.shape}"
            )
        check_positive("cell", self.cell)
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            raise InputError(
                f"`heights` must be finite, but {int((~np.isfinite(values)).sum())} of "
                f"{values.size} are not; the first is in row {row} from the south, column {column}"
            )
        object.__setattr__(self, "heights", values)
        object.__setattr__(self, "origin", (float(self.origin[0]), float(self.origin[1])))

    @property
    def bounds(self) -> Bounds:
        """Outer edges of the raster, cells included."""
        rows, columns = self.heights.shape
        x, y = self.origin
        return x, y, x + columns * self.cell, y + rows * self.cell

    @property
    def relief(self) -> float:
        """Height of the highest cell above the lowest [m]."""
        return float(np.ptp(self.heights))

    @property
    def centres(self) -> tuple[Float64[np.ndarray, " x"], Float64[np.ndarray, " y"]]:
        """Coordinates of the columns and of the rows [m]."""
        west, south, _, _ = self.bounds
        rows, columns = self.heights.shape
        x, y = (np.arange(count, dtype=np.float64) + 0.5 for count in (columns, rows))
        return west + x * self.cell, south + y * self.cell

    def gradient(self) -> tuple[Float64[np.ndarray, "y x"], Float64[np.ndarray, "y x"]]:
        """Slope eastward and northward [-], by central differences."""
        north, east = np.gradient(self.heights, self.cell)
        return np.asarray(east, np.float64), np.asarray(north, np.float64)

    def height_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Height of the ground at points [m], bilinear between the centres of cells.

        In the outer half cell the slope of the last two cells goes on. Raises `InputError` for a
        point outside the raster.
        """
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        west, south, east, north = self.bounds
        slack = 1e-6 * self.cell
        outside = (px < west - slack) | (px > east + slack)
        outside |= (py < south - slack) | (py > north + slack)
        if outside.any():
            raise InputError(
                f"the terrain covers ({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}), but "
                f"{int(outside.sum())} of {outside.size} points lie outside, the first at "
                f"({px[outside][0]:.2f}, {py[outside][0]:.2f})"
            )
        x, y = self.centres
        # Without a fill value it goes on beyond the outermost centres.
        surface = RegularGridInterpolator((y, x), self.heights, bounds_error=False, fill_value=None)
        return np.asarray(surface((py, px)), np.float64)

    def resample(self, cell: float, bounds: Bounds | None = None) -> "Terrain":
        """The same ground on cells of another size, over `bounds`.

        Bilinear, as the mean of points no farther apart than the cells that are there: coarser
        cells average, and the mean height stays.

        **Arguments:** `cell` [m], which must divide the sides of `bounds`; `bounds` are those of
        the terrain unless given.

        **Raises:** `InputError` if `bounds` are not covered or not divided by `cell`.
        """
        place = check_inside(
            self.bounds if bounds is None else bounds, self.bounds, 1e-6 * self.cell, "the terrain"
        )
        rows, columns = whole_cells(place, cell)
        parts = max(1, int(np.ceil(cell / self.cell - 1e-9)))
        x, y = (
            start + (np.arange(count * parts) + 0.5) * (cell / parts)
            for start, count in zip(place, (columns, rows))
        )
        dense = self.height_at(x[None, :], y[:, None])
        heights = dense.reshape(rows, parts, columns, parts).mean(axis=(1, 3))
        gap = self.gap
        if gap is not None:  # of the cell that holds the centre of the new one
            at = (
                np.clip(((v.reshape(-1, parts).mean(axis=1) - low) / self.cell).astype(int), 0, n)
                for v, low, n in zip((y, x), self.origin[::-1], np.subtract(gap.shape, 1))
            )
            gap = gap[np.ix_(*at)]
        return replace(self, heights=heights, cell=float(cell), origin=place[:2], gap=gap)


def whole_cells(bounds: Bounds, cell: float) -> tuple[int, int]:
    """Number of square cells in a rectangle.

    **Arguments:**

    - `bounds`: west, south, east and north edge [m].
    - `cell`: side of a cell [m].

    **Returns:** rows and columns.

    **Raises:** `InputError` if the cells do not divide the rectangle.
    """
    west, south, east, north = check_bounds(bounds)
    counts = []
    for axis, side in (("y", north - south), ("x", east - west)):
        count = round(side / cell) if np.isfinite(cell) and cell > 0.0 else 0
        if count < 1 or abs(count * cell - side) > 1e-6 * side:
            raise InputError(
                f"`cell` must be positive and divide the plot's sides, but {cell} m "
                f"does not divide {side:g} m along {axis}"
            )
        counts.append(count)
    return counts[0], counts[1]
