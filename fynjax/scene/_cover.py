"""How much ground the crowns of a scene cover, measured on a raster."""

from dataclasses import dataclass
from typing import Any

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
    from fynjax.scene._cover_kernel import project

    order = np.argsort(instances.species, kind="stable")
    x, y = crown_centres(instances)
    kernel: Any = project  # numba's own type takes no arrays
    top, crowns, union = kernel(
        *(values[order] for values in (x, y, instances.diameter / 2.0, instances.height)),
        instances.species[order],
        len(instances.taxa),
        nx,
        ny,
        float(cell),
        periodic,
    )
    covered = top >= 0
    top[covered] = order[top[covered]]
    visible = np.bincount(instances.species[top[covered]], minlength=len(instances.taxa))
    cells = nx * ny
    return ProjectedCover(
        crowns / cells, union / cells, visible / cells, float(covered.mean()), top, float(cell)
    )


def crown_centres(
    instances: Instances,
) -> tuple[Float[np.ndarray, " plant"], Float[np.ndarray, " plant"]]:
    """x and y of the middles of the axes of `instances` [m]: where their crowns are centred."""
    lean = 0.5 * instances.height * np.sin(np.deg2rad(instances.tilt))
    turn = np.deg2rad(instances.azimuth)
    return instances.x + lean * np.sin(turn), instances.y + lean * np.cos(turn)
