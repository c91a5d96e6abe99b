"""How much ground the crowns of a scene cover, measured on a raster."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fynjax._core.errors import InputError
from fynjax.scene._instances import Instances

_MOST_CELLS = 4e8


@dataclass(frozen=True)
class ProjectedCover:
    """Cover of a scene, in four senses. Shares of the plot's area."""

    crowns: Float[np.ndarray, " species"]
    """Every crown's disc counted in full, whatever lies over or under it [-]: what covers of a
    table add up. May exceed 1."""
    species: Float[np.ndarray, " species"]
    """Ground under at least one crown of the species [-]: overlap within it counts once."""
    visible: Float[np.ndarray, " species"]
    """Ground over which a crown of the species is the tallest [-]: what is visible from above. Sums
    to `total`."""
    total: float
    """Ground under at least one crown of any species [-]."""
    top: Int[np.ndarray, "y x"]
    """The tallest plant over each cell, an index into the instances; -1 over bare ground."""
    cell: float
    """Side of a cell [m]."""


def projected_cover(
    instances: Instances,
    extent: tuple[float, float] | None = None,
    cell: float = 0.01,
    periodic: bool = True,
) -> ProjectedCover:
    """Project the crowns of a scene straight down on a raster and measure their cover.

    A crown is a full disc of its diameter around the middle of its axis (the foot, unless it
    leans). A cell counts as covered if its centre is.

    **Arguments:**

    - `instances`: the plants.
    - `extent`: (lx, ly) [m] of the raster from the south-west corner; the plot's if left out.
    - `cell`: side of a cell [m], which must divide the extent; 1 cm on 10 m is 1e6 cells.
    - `periodic`: a crown that reaches over a border comes in at the other side. Otherwise what
      is beyond counts for `crowns` alone.

    The error of a disc's area is that of counting cell centres: about 3 % for a crown ten cells
    wide, and of random sign, so that it averages out over plants.

    Raises `InputError` where cells do not divide the extent or are more than 4e8.
    """
    lx, ly = instances.extent if extent is None else extent
    if not (np.isfinite(cell) and cell > 0.0):
        raise InputError(f"`cell` must be positive [m], but is {cell}")
    nx, ny = round(lx / cell), round(ly / cell)
    if min(nx, ny) < 1 or max(abs(nx * cell - lx), abs(ny * cell - ly)) > 1e-6 * max(lx, ly):
        raise InputError(
            f"`cell` must divide the sides of the plot, but {cell:g} m does not divide {lx:g} m x "
            f"{ly:g} m"
        )
    if nx * ny > _MOST_CELLS:
        raise InputError(
            f"a raster may have {_MOST_CELLS:.0e} cells, but {cell:g} m on {lx:g} m x {ly:g} m "
            f"asks for {nx * ny:.1e}; take a coarser `cell`"
        )
    top, crowns, union = _project(instances, (ny, nx), float(cell), periodic)
    covered = top >= 0
    visible = np.bincount(instances.species[top[covered]], minlength=len(instances.taxa))
    cells = nx * ny
    return ProjectedCover(
        crowns / cells, union / cells, visible / cells, float(covered.mean()), top, float(cell)
    )


def _project(
    instances: Instances, shape: tuple[int, int], cell: float, periodic: bool
) -> tuple[Int[np.ndarray, "y x"], Int[np.ndarray, " species"], Int[np.ndarray, " species"]]:
    """Discs on a raster of cells whose centres count: (top, crowns, union).

    `top` is the tallest plant over each cell, the first of equals, -1 for none. `crowns` counts the
    cells of all discs, those beyond an open border too; `union` the cells that a species covers at
    all.
    """
    ny, nx = shape
    n_species = len(instances.taxa)
    x, y = crown_centres(instances)
    radius, height = instances.diameter / 2.0, instances.height
    top = np.full(shape, -1, np.int32)
    level = np.full(shape, -np.inf)
    crowns, union = np.zeros(n_species, np.int64), np.zeros(n_species, np.int64)
    south, north = _centres(y, radius, cell)
    for one in range(n_species):
        covered = np.zeros(shape, bool)
        for plant in np.flatnonzero(instances.species == one):
            rows = np.arange(south[plant], north[plant])
            dy = (rows + 0.5) * cell - y[plant]
            # Half a chord in each row of cells: the disc as a run of columns in each row.
            half = np.sqrt(np.maximum(radius[plant] ** 2 - dy * dy, 0.0))
            west, east = _centres(x[plant], half, cell)
            crowns[one] += np.maximum(east - west, 0).sum()
            if not rows.size:
                continue
            columns = np.arange(west.min(), east.max())
            inside = (columns >= west[:, None]) & (columns < east[:, None])
            if periodic:
                rows, columns = rows % ny, columns % nx
            else:
                on = (rows >= 0) & (rows < ny), (columns >= 0) & (columns < nx)
                inside, rows, columns = inside[np.ix_(*on)], rows[on[0]], columns[on[1]]
            place = rows[:, None], columns
            row, column = (part[inside] for part in np.broadcast_arrays(*place))
            covered[row, column] = True
            taller = height[plant] > level[row, column]
            top[row[taller], column[taller]] = plant
            level[row[taller], column[taller]] = height[plant]
        union[one] = covered.sum()
    return top, crowns, union


def _centres(
    middle: Float[np.ndarray, " n"] | float, half: Float[np.ndarray, " n"], cell: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """First and one after the last cell whose centre is within `half` [m] of `middle` [m]."""
    first = np.ceil((middle - half) / cell - 0.5).astype(int)
    return first, np.floor((middle + half) / cell - 0.5).astype(int) + 1


def crown_centres(
    instances: Instances,
) -> tuple[Float[np.ndarray, " plant"], Float[np.ndarray, " plant"]]:
    """x and y of the middles of the axes of `instances` [m]: where their crowns are centred."""
    lean = 0.5 * instances.height * np.sin(np.deg2rad(instances.tilt))
    turn = np.deg2rad(instances.azimuth)
    return instances.x + lean * np.sin(turn), instances.y + lean * np.cos(turn)
