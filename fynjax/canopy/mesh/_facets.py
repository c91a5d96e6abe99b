"""Facets of meshes: their areas and normals, which of them close, and even draws of them."""

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.seeds import generator
from fynjax.canopy._elements import split_elements

# Normals are sorted into this many rings and sectors of the hemisphere, all of equal area.
_NORMAL_RINGS, _NORMAL_SECTORS = 8, 16
_POSITION_BITS = 10


def facets(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals [face, 3] and areas [face] of triangles [face, 3, 3]."""
    # Half the cross product of two sides is the area, along the normal.
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double = np.linalg.norm(cross, axis=1)
    return cross / np.where(double > 0.0, double, 1.0)[:, None], 0.5 * double


_WIDEST_ENDS = 0.5
"""Area of the caps that the open ends of a tube would have over its surface, at most: that of a
tube as long as it is wide. The rim of a sheet would have one as large as the sheet or larger."""
_WIDEST_END = 0.1
"""The same of a surface with one open end, as a stem that tapers to a point: a box without its lid
is none."""


def closed_faces(triangles: np.ndarray, *, least_ends: int | None = None) -> np.ndarray:
    """Which of the triangles [face, 3, 3] belong to a closed surface [face].

    Triangles that share edges are one surface; it is closed if none of its edges is open, as the
    rim of a sheet is. Corners at the same place are one corner. With `least_ends` a surface whose
    open edges make so many rings or more counts too, if the rings are narrow for its area: a tube
    whose ends nobody closed.
    """
    from scipy.sparse import coo_array  # late: the parametric forms do without
    from scipy.sparse.csgraph import connected_components

    points = triangles.reshape(-1, 3)
    step = 1e-9 * max(float(np.ptp(points, axis=0).max()), 1e-30)
    grid = np.round((points - points.min(axis=0)) / step).astype(np.int64)
    _, corner = np.unique(grid, axis=0, return_inverse=True)
    faces = corner.reshape(-1, 3)
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, edge, count = np.unique(
        sides[:, 0] * len(points) + sides[:, 1], return_inverse=True, return_counts=True
    )
    # Triangles and edges are the nodes of a graph; each triangle is tied to its three edges.
    owner = np.tile(np.arange(len(faces)), 3)
    ties = coo_array(
        (np.ones(len(owner), bool), (owner, len(faces) + edge)),
        shape=(len(faces) + len(count),) * 2,
    )
    number, surface = connected_components(ties, directed=False)
    is_open = np.zeros(number, bool)
    is_open[surface[len(faces) :][count % 2 == 1]] = True
    if least_ends is not None:
        at = np.flatnonzero(count[edge] == 1)  # sides, whose edge is open
        ends = np.zeros((len(points), 3))
        ends[corner] = points
        whole = np.bincount(surface[: len(faces)], facets(triangles)[1], number)
        tubes = _tubes(sides[at], surface[owner[at]], ends, whole, least_ends)
        odd = np.unique(surface[len(faces) :][(count % 2 == 1) & (count > 1)])
        is_open[np.setdiff1d(tubes, odd)] = False
    return ~is_open[surface[: len(faces)]]


def _tubes(
    sides: np.ndarray, surface: np.ndarray, points: np.ndarray, area: np.ndarray, least: int
) -> np.ndarray:
    """Surfaces whose open edges `sides` [edge, 2] are narrow rings, `least` of them at least.

    **Arguments:** `surface` of each edge; `points`, places of corners; `area` of each surface.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    size = len(points)
    ties = coo_array((np.ones(len(sides), bool), (sides[:, 0], sides[:, 1])), shape=(size, size))
    number, ring = connected_components(ties, directed=False)
    of_side = ring[sides[:, 0]]
    length = np.bincount(
        of_side, np.linalg.norm(np.diff(points[sides], axis=1)[:, 0], axis=1), number
    )
    # In a ring each corner has two edges.
    degree = np.bincount(sides.ravel(), minlength=size)
    clean = np.bincount(ring, (degree != 2) & (degree > 0), number) == 0
    rings, first = np.unique(of_side, return_index=True)
    owner = surface[first]
    caps = np.bincount(owner, length[rings] ** 2 / (4.0 * np.pi), len(area))
    count = np.bincount(owner, minlength=len(area))
    widest = np.where(count > 1, _WIDEST_ENDS, _WIDEST_END)
    broken = np.bincount(owner, ~clean[rings], len(area)) > 0
    return np.flatnonzero((count >= least) & ~broken & (caps < widest * area))


def draw_groups(
    group: np.ndarray,
    area: np.ndarray,
    normal: np.ndarray,
    place: np.ndarray,
    count: int,
    seed: int,
) -> list[np.ndarray]:
    """Indices of `count` facets, drawn evenly within each of the groups that have area.

    Groups, such as materials, get facets by their area, at least one. Raises `InputError` for a
    `count` below the number of groups.
    """
    share = np.bincount(group, weights=area)
    present = {int(index): float(share[index]) for index in np.flatnonzero(share > 0.0)}
    if count < len(present):
        raise InputError(
            f"`n_elements` must be at least {len(present)}, one for each material or organ, but is "
            f"{count}"
        )
    drawn = []
    for index, number in split_elements(count, present).items():
        own = np.flatnonzero(group == index)
        drawn.append(own[draw_evenly(area[own], normal[own], place[own], number, [seed, index])])
    return drawn


def draw_evenly(
    area: np.ndarray, normal: np.ndarray, place: np.ndarray, count: int, seed: list[int]
) -> np.ndarray:
    """Indices of `count` facets, in equal steps through their areas from a random start.

    The facets are ranked by their normals first (opposite ones are alike), then along a curve
    through space, so that every direction and every place gets its share: far more even than an
    independent draw.
    """
    order = np.lexsort((_along_curve(place), _normal_cell(normal)))
    mass = np.cumsum(area[order])
    start = generator(*np.ravel(seed)).random()
    # One random start for all: steps of equal area from there.
    steps = (np.arange(count) + start) / count * mass[-1]
    return order[np.minimum(np.searchsorted(mass, steps), len(mass) - 1)]


def _normal_cell(normal: np.ndarray) -> np.ndarray:
    """Cell of equal area on the hemisphere of unoriented normals, neighbours one after another."""
    up = np.where(normal[:, 2:] < 0.0, -normal, normal)
    # Rings of equal height have equal area on a sphere.
    ring = np.minimum((up[:, 2] * _NORMAL_RINGS).astype(int), _NORMAL_RINGS - 1)
    turn = np.arctan2(up[:, 1], up[:, 0]) / (2.0 * np.pi) % 1.0
    sector = np.minimum((turn * _NORMAL_SECTORS).astype(int), _NORMAL_SECTORS - 1)
    # Every second ring runs back, so that the last cell of one is beside the first of the next.
    sector = np.where(ring % 2 == 1, _NORMAL_SECTORS - 1 - sector, sector)
    return ring * _NORMAL_SECTORS + sector


def _along_curve(place: np.ndarray) -> np.ndarray:
    """Rank of points [n, 3] along a Z-order curve (Morton 1966)."""
    low = place.min(axis=0)
    side = max(float(np.ptp(place, axis=0).max()), 1e-30)
    cell = ((place - low) / side * (2**_POSITION_BITS - 1)).astype(np.int64)
    rank = np.zeros(len(place), np.int64)
    # Bits of x, y and z in turn.
    for bit in range(_POSITION_BITS):
        for axis in range(3):
            rank |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return rank
