"""Structure of vegetation from heights of returns above the ground, in cells of a plot: exact."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray

from fynjax._core.errors import InputError
from fynjax.metrics.structure._profile import leaf_area_gap, profile_metrics
from fynjax.metrics.structure._settings import STRUCTURE_METRICS, StructureSettings

_MOST_VOXELS = 100_000_000
# A height this share of a layer below an edge is on the edge: decimals have no exact form.
_ON_EDGE = 1e-6


@dataclass(frozen=True)
class CellGrid:
    """Square cells of a plot. Row 0 is the southern one."""

    origin: tuple[float, float]
    """South-west corner (x, y) [m]."""
    grain: float
    """Side of a cell [m]."""
    rows: int
    columns: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north edge [m]."""
        x, y = self.origin
        return x, y, x + self.columns * self.grain, y + self.rows * self.grain


def cell_grid(
    bounds: tuple[float, float, float, float], grain: float, *, slack: float = 0.0
) -> CellGrid:
    """The whole cells of a given side in a rectangle, from its south-west corner.

    What is left over at the eastern and northern edge belongs to no cell: 3 m cells leave a strip
    of 1 m of a plot of 10 m.

    **Arguments:**

    - `bounds`: west, south, east and north edge of the plot [m].
    - `grain`: side of a cell [m], positive.
    - `slack`: the cells may be that much wider than the rectangle [m], in the middle of which they
      then lie: for a rectangle of points, which never reach the very edge of their plot.

    **Raises:** `InputError` where not one cell fits.

    >>> from fynjax.metrics.structure import cell_grid
    >>> cell_grid((0.0, 0.0, 10.0, 10.0), 3.0).shape
    (3, 3)
    """
    west, south, east, north = bounds
    if not (np.isfinite(grain) and grain > 0.0):
        raise InputError(f"`grain` must be positive, but is {grain:g}")
    sides = (east - west, north - south)
    columns, rows = (int(np.floor((side + slack) / grain + 1e-9)) for side in sides)
    if min(rows, columns) < 1:
        raise InputError(
            f"expected a plot of at least one cell of {grain:g} m, but it is {sides[0]:.2f} by "
            f"{sides[1]:.2f} m. Take a smaller grain."
        )
    x = west - 0.5 * max(columns * grain - sides[0], 0.0)
    y = south - 0.5 * max(rows * grain - sides[1], 0.0)
    return CellGrid((x, y), float(grain), rows, columns)


@dataclass(frozen=True)
class BinnedReturns:
    """Returns sorted into cells, layers and canopy cells; `take` thins them."""

    grid: CellGrid
    settings: StructureSettings
    layers: int
    """Number of layers, up to the highest return."""
    canopy_cells: int
    """Cells of the canopy's surface along the side of a cell."""
    height: Float[np.ndarray, " return"]
    """Height of each return above the ground [m]."""
    cell: Int[np.ndarray, " return"]
    """Number of each return's cell, row by row."""
    layer: Int[np.ndarray, " return"]
    """Number of each return's layer, from 1 for the lowest; 0 is below all layers."""
    canopy: Int[np.ndarray, " return"]
    """Number of each return's cell of the canopy's surface."""

    def __len__(self) -> int:
        return len(self.height)

    def take(self, index: NDArray[Any]) -> "BinnedReturns":
        """Some of the returns, by number or by a mask, in the same cells and layers."""
        return replace(
            self,
            **{name: getattr(self, name)[index] for name in ("height", "cell", "layer", "canopy")},
        )


@dataclass(frozen=True)
class CellStructure:
    """Structure in each cell. Row 0 is the southern one; NaN where a metric is undefined."""

    grid: CellGrid
    settings: StructureSettings
    returns: Int[np.ndarray, "y x"]
    """Returns in each cell."""
    metrics: dict[str, Float[np.ndarray, "y x"]]
    """Values of each metric in each cell, by its name in `STRUCTURE_METRICS`."""
    edges: Float[np.ndarray, " edge"]
    """Heights of the layers' edges [m], one more than layers."""
    leaf_area_density: Float[np.ndarray, "y x layer"]
    """Leaf area density of each layer of each cell [m2 m-3]; NaN below `settings.lowest`, above the
    top, and where nothing passed."""

    def counted(self, least_returns: int) -> NDArray[np.bool_]:
        """Which cells have at least so many returns."""
        return self.returns >= least_returns

    def means(self, least_returns: int = 1) -> dict[str, float]:
        """Mean of each metric over the cells that count; NaN where all are undefined."""
        keep = self.counted(least_returns)
        defined = {name: v[keep & np.isfinite(v)] for name, v in self.metrics.items()}
        return {name: float(v.mean()) if v.size else np.nan for name, v in defined.items()}

    def profile(self, least_returns: int = 1) -> NDArray[np.float64]:
        """Leaf area density of each layer, mean over cells that count [m2 m-3].

        Cells in which a layer is undefined do not count for it; NaN for a layer without any.
        """
        density = self.leaf_area_density[self.counted(least_returns)]
        number = np.isfinite(density).sum(axis=0)
        total = np.nansum(density, axis=0)
        return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def bin_returns(
    x: ArrayLike, y: ArrayLike, height: ArrayLike, grid: CellGrid, settings: StructureSettings
) -> BinnedReturns:
    """Sort returns into the cells of a plot and the layers of its canopy.

    **Arguments:**

    - `x`, `y`: places [m]; returns outside of all cells are left out.
    - `height`: above ground [m]; below 0 counts as 0.
    - `grid`: the cells (`cell_grid`).
    - `settings`: layers and thresholds.

    **Returns:** a `BinnedReturns`, for `cell_structure`. Not differentiable.

    **Raises:** `InputError` for arrays of different length, NaN, no return inside, or more cells
    times layers than memory is for.
    """
    east, north, up = (np.asarray(v, np.float64).ravel() for v in (x, y, height))
    if not len(east) == len(north) == len(up):
        raise InputError(
            f"expected as many x, y and heights, but got {len(east)}, {len(north)} and {len(up)}"
        )
    for name, values in (("x", east), ("y", north), ("height", up)):
        if not np.isfinite(values).all():
            first = int(np.argmin(np.isfinite(values))) + 1
            raise InputError(f"`{name}` must be finite, but return {first} is not")
    column = np.floor((east - grid.origin[0]) / grid.grain).astype(np.int64)
    row = np.floor((north - grid.origin[1]) / grid.grain).astype(np.int64)
    # A return on the outer edge belongs to the last cell, as in a histogram.
    column[east == grid.bounds[2]] = grid.columns - 1
    row[north == grid.bounds[3]] = grid.rows - 1
    inside = (column >= 0) & (column < grid.columns) & (row >= 0) & (row < grid.rows)
    if not inside.any():
        raise InputError(
            "expected returns in the cells of the plot, but there are none. Are both in the same "
            "coordinate reference system?"
        )
    east, north, column, row = east[inside], north[inside], column[inside], row[inside]
    up = np.maximum(up[inside], 0.0)
    cell = row * grid.columns + column
    layer = np.floor((up - settings.base) / settings.layer + _ON_EDGE).astype(np.int64) + 1
    layer[(layer < 0) | (up < settings.ground_height)] = 0
    layers = max(int(layer.max()), 1, settings.first_layer(settings.lowest) + 1)
    if layers * grid.rows * grid.columns > _MOST_VOXELS:
        raise InputError(
            f"{grid.rows * grid.columns} cells of {layers} layers are more than {_MOST_VOXELS}. "
            "Take thicker layers, larger cells or a smaller plot. Are heights above the ground?"
        )
    side = max(1, round(grid.grain / settings.canopy_cell))
    i = ((east - grid.origin[0]) / grid.grain - column) * side
    j = ((north - grid.origin[1]) / grid.grain - row) * side
    # Rounding may put a return at the edge of its cell beside it.
    part = [np.clip(v.astype(np.int64), 0, side - 1) for v in (j, i)]
    canopy = (cell * side + part[0]) * side + part[1]
    return BinnedReturns(grid, settings, layers, side, up, cell, layer, canopy)


def cell_structure(returns: BinnedReturns) -> CellStructure:
    """Exact structure metrics in each cell.

    **Arguments:**

    - `returns`: sorted into cells and layers (`bin_returns`).

    **Returns:** a `CellStructure` with the metrics of `STRUCTURE_METRICS`, each as
    `returns.settings` define it. Undefined, and NaN, are: the diversity of a cell without a return
    in its layers; the density's mean without a layer and its deviation with less than two; the
    rugosity of less than two canopy cells with returns; the coefficient of variation of less than
    two returns, or of returns that all lie on the ground; all of them in a cell without a return.

    Not differentiable: `voxel_structure` is the differentiable form, of area density on voxels.

    >>> import numpy as np
    >>> from fynjax.metrics.structure import (
    ...     StructureSettings,
    ...     bin_returns,
    ...     cell_grid,
    ...     cell_structure,
    ... )
    >>> rng = np.random.default_rng(1)
    >>> x, y, height = rng.random(400) * 2.0, rng.random(400) * 2.0, rng.random(400)
    >>> cells = cell_grid((0.0, 0.0, 2.0, 2.0), 1.0)
    >>> returns = bin_returns(x, y, height, cells, StructureSettings())
    >>> structure = cell_structure(returns)
    >>> structure.metrics["gap_fraction"].shape, round(structure.means()["height_cv"], 2)
    ((2, 2), 0.55)
    """
    grid, settings = returns.grid, returns.settings
    cells, layers = grid.rows * grid.columns, returns.layers
    ground = returns.height < settings.ground_height
    weight = np.where(ground, settings.ground_weight, 1.0)
    # [cell, layer], what lies below all layers first.
    bins = np.bincount(
        returns.cell * (layers + 1) + returns.layer, weight, cells * (layers + 1)
    ).reshape(cells, layers + 1)
    under, counts = bins[:, 0], bins[:, 1:]
    occupied = np.bincount(returns.cell, minlength=cells)
    # Layers count up to the highest return; light passed those that returns lie below.
    reached = np.cumsum(counts[:, ::-1] > 0.0, axis=1)[:, ::-1] > 0
    if settings.top == "plot":
        reached = np.broadcast_to(reached.any(axis=0), reached.shape) & (occupied > 0)[:, None]
    passed = under[:, None] + np.cumsum(counts, axis=1) - counts > 0.0
    values, density, defined = profile_metrics(
        np, counts, under, reached.astype(float), passed.astype(float), settings
    )
    if settings.gap_of == "leaf_area":
        values["gap_fraction"] = leaf_area_gap(np, density, defined, settings, occupied)
    else:
        values["gap_fraction"] = _gap(returns, weight, cells)
    values["rugosity"] = _rugosity(returns, cells)
    values["height_cv"] = _height_cv(returns, cells)
    first = settings.first_layer(settings.lowest)
    shown = np.where(defined > 0.0, density, np.nan)
    shown[:, :first] = np.nan
    return CellStructure(
        grid=grid,
        settings=settings,
        returns=occupied.reshape(grid.shape),
        metrics={
            name: np.where(values[name][1], values[name][0], np.nan).reshape(grid.shape)
            for name in STRUCTURE_METRICS
        },
        edges=settings.base + settings.layer * np.arange(layers + 1),
        leaf_area_density=shown.reshape(*grid.shape, layers),
    )


def _gap(returns: BinnedReturns, weight: NDArray[np.float64], cells: int) -> tuple[Any, Any]:
    """Share of returns, or of canopy cells, below the threshold."""
    settings = returns.settings
    if settings.gap_of == "canopy":
        highest = _highest(returns, cells)
        occupied = np.isfinite(highest)
        number = occupied.sum(axis=1)
        return (occupied & (highest < settings.gap_height)).sum(axis=1) / np.maximum(
            number, 1
        ), number > 0
    total = np.bincount(returns.cell, weight, cells)
    low = np.bincount(returns.cell, weight * (returns.height < settings.gap_height), cells)
    return low / np.where(total > 0.0, total, 1.0), total > 0.0


def _highest(returns: BinnedReturns, cells: int) -> NDArray[np.float64]:
    """Highest return of each canopy cell [cell, canopy cell], -inf without one."""
    highest = np.full(cells * returns.canopy_cells**2, -np.inf)
    np.maximum.at(highest, returns.canopy, returns.height)
    return highest.reshape(cells, -1)


def _rugosity(returns: BinnedReturns, cells: int) -> tuple[Any, Any]:
    lost = returns.settings.degrees_lost
    if returns.settings.rugosity_of == "canopy":
        value = _highest(returns, cells)
        good = np.isfinite(value)
    else:
        number = cells * returns.canopy_cells**2
        _, value, good = _moments(returns.height, returns.canopy, number, lost)
        value, good = value.reshape(cells, -1), good.reshape(cells, -1)
    which = np.broadcast_to(np.arange(cells)[:, None], value.shape)[good]
    return _moments(value[good], which, cells, lost)[1:]


def _height_cv(returns: BinnedReturns, cells: int) -> tuple[Any, Any]:
    high = returns.height >= returns.settings.cv_lowest
    mean, deviation, defined = _moments(
        returns.height[high], returns.cell[high], cells, returns.settings.degrees_lost
    )
    return deviation / np.where(mean > 0.0, mean, 1.0), defined & (mean > 0.0)


def _moments(
    value: NDArray[np.float64], group: NDArray[np.int64], groups: int, degrees_lost: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Mean and standard deviation in each group, and where there are two values or more."""
    number = np.bincount(group, minlength=groups)
    mean = np.bincount(group, value, groups) / np.maximum(number, 1)
    squares = np.bincount(group, (value - mean[group]) ** 2, groups)
    several = number > 1
    return mean, np.sqrt(squares / np.maximum(number - degrees_lost, 1)) * several, several
