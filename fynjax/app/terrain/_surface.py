"""From ground points to a surface without gaps, and from the surface to heights and a mesh."""

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax.app.terrain._cloud import PointCloud
from fynjax.app.terrain._raster import Terrain, whole_cells
from fynjax.app.terrain._units import Bounds, check_bounds, check_inside, check_positive

if TYPE_CHECKING:
    import trimesh

_MOST_CELLS = 100_000_000
_NEIGHBOURS = 12
# Cells by which a plot may stick out of a cloud, whose outermost points stand inside their cells.
_SLACK_CELLS = 2.0
# Share of cells outside the hull of what was measured from which a user should know.
_MANY_OUTSIDE = 0.01
_FEW_FAR = 0.001
"""Share of a plot's cells that may be farther from ground than allowed, with a warning."""


def terrain_from_points(
    cloud: PointCloud,
    ground: NDArray[np.bool_],
    *,
    cell: float = 0.25,
    bounds: Bounds | None = None,
    largest_gap: float = 10.0,
) -> Terrain:
    """The surface through the ground points of a cloud, on square cells.

    Points are averaged in each cell (position and height, so that a slope stays exact), and the
    heights of all cells' centres are interpolated between the averages by Laplace's variant of
    natural neighbours (Belikov et al. 1997) in their Delaunay triangulation. Cells outside its
    hull, at the edges, continue the plane through the nearest averages; more than 1 % of them
    farther out than two cells are warned of.

    **Arguments:**

    - `cloud`: points in metres.
    - `ground`: true for each point that is ground, from `find_ground`.
    - `cell`: side of a cell [m].
    - `bounds`: the plot, which `cell` must divide, and which may reach two cells beyond the cloud;
      unless given, the whole cells inside the cloud.
    - `largest_gap`: how far a cell may be from a ground point [m].

    **Returns:** a `Terrain`. Not differentiable. An example stands at `canopy_height`.

    **Raises:** `InputError` for a cloud without ground, one that does not cover the plot, or a
    gap larger than allowed; `MissingExtraError` without the extra `terrain`.
    """
    ground = np.asarray(ground, bool)
    if ground.shape != (len(cloud),):
        raise InputError(
            f"`ground` must have one value for each of the {len(cloud)} points, but has shape "
            f"{ground.shape}"
        )
    if ground.sum() < 3:
        raise InputError(f"expected ground, but {int(ground.sum())} points of the cloud are ground")
    check_positive("largest_gap", largest_gap)
    plot = _whole_cells_inside(cloud.bounds, cell) if bounds is None else check_bounds(bounds)
    rows, columns = whole_cells(plot, cell)
    if rows * columns > _MOST_CELLS:
        raise InputError(
            f"{columns} x {rows} cells of {cell} m are more than {_MOST_CELLS}: take larger cells"
        )
    check_covered(cloud.bounds, plot, cell)
    # Ground around the plot holds its edges.
    points = _cell_means(cloud.select(ground).crop(plot, largest_gap), plot, cell)
    x = (np.arange(columns) + 0.5) * cell
    y = (np.arange(rows) + 0.5) * cell
    centres = np.stack([a.ravel() for a in np.meshgrid(x, y)], axis=1)
    heights, gap = fill(points, centres, plot[:2], cell, largest_gap, len(centres))
    heights, gap = heights.reshape(rows, columns), gap.reshape(rows, columns)
    j, i = np.floor(points[:, 1::-1] / cell).astype(int).T
    inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    gap[j[inside], i[inside]] = 0.0
    return Terrain(heights, float(cell), (plot[0], plot[1]), cloud.crs, gap=gap)


def _whole_cells_inside(bounds: Bounds, cell: float) -> Bounds:
    """The largest rectangle of whole cells, on multiples of the cell, inside `bounds`."""
    check_positive("cell", cell)
    west, south = (float(np.ceil(v / cell - 1e-6) * cell) for v in bounds[:2])
    east, north = (float(np.floor(v / cell + 1e-6) * cell) for v in bounds[2:])
    if east - west < 1.5 * cell or north - south < 1.5 * cell:
        raise InputError(
            f"expected a cloud of more than two cells of {cell:g} m, but it is "
            f"{bounds[2] - bounds[0]:.2f} by {bounds[3] - bounds[1]:.2f} m. Take smaller cells."
        )
    return west, south, east, north


def check_covered(cloud: Bounds, plot: Bounds, cell: float) -> None:
    """Check that a plot lies within a cloud: ground beyond its points would be a guess.

    **Arguments:**

    - `cloud`: west, south, east and north edge of the cloud [m].
    - `plot`: those of the plot [m].
    - `cell`: side of a cell of the ground [m]; the plot may reach two cells beyond the cloud.

    **Raises:** `InputError` for a plot that reaches farther.
    """
    check_inside(plot, cloud, _SLACK_CELLS * cell * (1.0 + 1e-6), "the cloud")


def _cell_means(cloud: PointCloud, plot: Bounds, cell: float) -> NDArray[np.float64]:
    """Mean x, y (from the plot's corner) and z of the points in each cell that has some."""
    x, y = cloud.x - plot[0], cloud.y - plot[1]
    i = np.floor(x / cell).astype(np.int64)
    j = np.floor(y / cell).astype(np.int64)
    i, j = i - i.min(), j - j.min()
    _, which, count = np.unique(j * (i.max() + 1) + i, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(which, v) / count for v in (x, y, cloud.z)], axis=1)


def fill(
    points: NDArray[np.float64],
    centres: NDArray[np.float64],
    corner: tuple[float, float],
    cell: float,
    largest_gap: float,
    cells: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Heights at the centres of cells [n, 2] from points [m, 3], counted from `corner` [m], and
    how far each centre is from the nearest point [m].

    As `interpolate`; refuses centres farther than `largest_gap` from any point, and warns where
    many of all the plot's `cells` lie outside the hull of the points.
    """
    distance = _gaps(points, centres, corner, largest_gap, cells)
    outside = int((_beyond_hull(points[:, :2], centres) > _SLACK_CELLS * cell).sum())
    if outside > _MANY_OUTSIDE * cells:
        warnings.warn(
            f"{100 * outside / cells:.0f} % of the plot's cells lie outside of all measured ground "
            "points; their heights continue the slope of the nearest ground, and may be wrong. "
            "Choose a smaller plot.",
            stacklevel=3,
        )
    return interpolate(points, centres), distance


def _beyond_hull(points: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far places lie outside the convex hull of points at least [m]; negative inside."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(points).equations
    except (QhullError, ValueError):  # fewer than three points, or all in a row
        return np.full(len(places), np.inf)
    beyond = np.full(len(places), -np.inf)
    for east, north, offset in sides:  # one at a time, as there may be millions of places
        np.maximum(beyond, places[:, 0] * east + places[:, 1] * north + offset, out=beyond)
    return beyond


def _gaps(
    points: NDArray[np.float64],
    centres: NDArray[np.float64],
    corner: tuple[float, float],
    largest: float,
    cells: int,
) -> NDArray[np.float64]:
    """Distance of each centre from the nearest point [m], with a check that it is near enough."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points[:, :2]).query(centres)
    worst = int(np.argmax(distance))
    if distance[worst] <= largest:
        return distance
    x, y = centres[worst] + corner
    far = int((distance > largest).sum())
    if far <= _FEW_FAR * cells:
        warnings.warn(
            f"{far} of {cells} cells are farther than {largest:g} m from any ground, up to "
            f"{distance[worst]:.1f} m at ({x:.1f}, {y:.1f}); their heights may be wrong",
            stacklevel=4,
        )
        return distance
    raise InputError(
        f"expected ground within {largest:g} m of every cell, but the nearest point is "
        f"{distance[worst]:.1f} m of ({x:.1f}, {y:.1f}); {far} of {cells} cells are so far from "
        "it. Does the file cover the plot? Choose a smaller plot, or allow a larger `largest_gap`."
    )


def interpolate(points: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights at places [n, 2] from points [m, 3], by Laplace interpolation [m].

    Places outside the hull of the points get the plane through the nearest twelve of them, level
    in the directions in which these do not spread.
    """
    startinpy = require("startinpy", "terrain")
    from scipy.spatial import cKDTree

    triangulation = startinpy.DT()
    triangulation.snap_tolerance = 1e-6
    triangulation.insert(points, "BBox")
    if triangulation.number_of_triangles() > 0:
        heights = np.asarray(triangulation.interpolate({"method": "Laplace"}, places), np.float64)
    else:
        heights = np.full(len(places), np.nan)
    outside = ~np.isfinite(heights)
    if outside.any():  # the plane through the nearest points, by its slope from their middle
        here = places[outside]
        nearest = min(_NEIGHBOURS, len(points))
        _, index = cKDTree(points[:, :2]).query(here, k=nearest)
        near = points[index.reshape(len(here), nearest)]
        middle = near.mean(axis=1)
        spread = near - middle[:, None, :]
        slope = np.einsum("nck,nk->nc", np.linalg.pinv(spread[..., :2], rcond=0.2), spread[..., 2])
        heights[outside] = middle[:, 2] + ((here - middle[:, :2]) * slope).sum(axis=1)
    return heights


def heights_above_ground(cloud: PointCloud, terrain: Terrain) -> Float64[np.ndarray, " point"]:
    """Height of each point above the ground below it [m].

    **Arguments:**

    - `cloud`: points in metres.
    - `terrain`: of the same reference system; linear between the centres of its cells.

    **Raises:** `InputError` for points outside the terrain: crop the cloud to its bounds first.

    Not differentiable. An example stands at `canopy_height`.
    """
    return cloud.z - terrain.height_at(cloud.x, cloud.y)


def canopy_height(
    cloud: PointCloud, terrain: Terrain, cell: float | None = None
) -> Float64[np.ndarray, "y x"]:
    """The highest point above ground in each cell over the terrain [m]; NaN without a point.

    **Arguments:**

    - `cloud`: points in metres; those outside the terrain are left out.
    - `terrain`: of the same reference system.
    - `cell`: side of a cell [m]; the terrain's unless given.

    Ground counts as 0, and what the cloud has below it too. Not differentiable.

    **Raises:** `InputError` for a cell that does not divide the terrain.

    >>> import numpy as np
    >>> from fynjax.app.terrain import PointCloud, canopy_height, terrain_from_points
    >>> centres = np.arange(0.25, 4.0, 0.5)
    >>> x, y = (places.ravel() for places in np.meshgrid(centres, centres))
    >>> plant = np.hypot(x - 2.0, y - 2.0) < 0.5  # a plant 0.8 m high on a slope of 10 %
    >>> cloud = PointCloud(x, y, 100.0 + 0.1 * x + 0.8 * plant)
    >>> terrain = terrain_from_points(cloud, ~plant, cell=0.5, bounds=(0.0, 0.0, 4.0, 4.0))
    >>> round(float(np.nanmax(canopy_height(cloud, terrain))), 3)
    0.8
    """
    size = terrain.cell if cell is None else float(cell)
    rows, columns = whole_cells(terrain.bounds, size)
    inside = cloud.crop(terrain.bounds)
    west, south, _, _ = terrain.bounds
    i = np.minimum(((inside.x - west) / size).astype(np.intp), columns - 1)
    j = np.minimum(((inside.y - south) / size).astype(np.intp), rows - 1)
    highest = np.full(rows * columns, -np.inf)
    np.maximum.at(highest, j * columns + i, np.maximum(heights_above_ground(inside, terrain), 0.0))
    return np.where(np.isfinite(highest), highest, np.nan).reshape(rows, columns)


def terrain_mesh(terrain: Terrain) -> "trimesh.Trimesh":
    """The ground as triangles, two for each cell, facing up.

    **Arguments:**

    - `terrain`: the heights of the ground.

    **Returns:** a mesh in the plot's frame: x east and y north from the raster's south-west corner,
    z above its lowest cell's centre [m]. Vertices are the corners of cells, each the mean of the
    cells that meet there (at the edges their slope goes on, which may lead below 0): the mesh has
    the extent of the raster.
    """
    import trimesh

    rows, columns = terrain.heights.shape
    west, south, _, _ = terrain.bounds
    x = np.arange(columns + 1) * terrain.cell
    y = np.arange(rows + 1) * terrain.cell
    z = terrain.height_at(west + x[None, :], south + y[:, None]) - terrain.heights.min()
    gx, gy = np.meshgrid(x, y)
    vertices = np.stack([gx.ravel(), gy.ravel(), z.ravel()], axis=1)
    corner: Any = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1].ravel()
    above = corner + columns + 1
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, above + 1], axis=1),
            np.stack([corner, above + 1, above], axis=1),
        ]
    )
    return trimesh.Trimesh(vertices, faces, process=False)
