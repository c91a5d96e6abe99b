"""Bridson's Poisson-disk sampling."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float


def fill(
    rng: np.random.Generator, lx: float, ly: float, radius: float, attempts: int, periodic: bool
) -> Float[np.ndarray, "point 2"]:
    """Points on [0, lx) x [0, ly), all at least `radius` apart, until none fits.

    Each point is the centre once, of `attempts` candidates; all that fit become points.
    The background grid holds one point a cell at most: its cells have a diagonal of at most
    `radius`. On a periodic extent they shrink a little so that whole cells fit.
    """
    cell = radius / math.sqrt(2.0)
    if periodic:
        nx, ny = math.ceil(lx / cell), math.ceil(ly / cell)
        cell_x, cell_y = lx / nx, ly / ny
    else:
        nx, ny = int(lx / cell) + 1, int(ly / cell) + 1
        cell_x = cell_y = cell
    # What can be too close to a candidate stands within three radii of its centre.
    far_x, far_y = math.ceil(3.0 * radius / cell_x), math.ceil(3.0 * radius / cell_y)
    # Cells beyond a border are those at the other; an open one has them too far away to matter.
    columns, rows = np.arange(-far_x, nx + far_x) % nx, np.arange(-far_y, ny + far_y) % ny

    grid = np.full((ny, nx), -1)
    # No packing of discs of this radius is denser than the hexagonal one (plus its border).
    room = int(1.16 * (lx + radius) * (ly + radius) / radius**2) + 8
    points = np.empty((min(room, nx * ny + 8), 2))
    count = 0
    active: list[tuple[float, float]] = []

    def place(x: float, y: float) -> tuple[int, int]:
        return min(int(y / cell_y), ny - 1), min(int(x / cell_x), nx - 1)

    def squared(dx: Any, dy: Any, least: Callable[[Any, Any], Any]) -> Any:
        """Squared distance of places so far apart, to the nearest repetition."""
        if periodic:
            dx, dy = least(dx, lx - dx), least(dy, ly - dy)
        return dx * dx + dy * dy

    def add(x: float, y: float) -> None:
        nonlocal count
        points[count] = x, y
        grid[place(x, y)] = count
        active.append((x, y))
        count += 1

    draw = rng.random
    add(draw() * lx, draw() * ly)
    while active:
        pick = int(draw() * len(active))
        centre_x, centre_y = active[pick]
        active[pick] = active[-1]
        active.pop()
        # Uniform by area in the disc of 2 r; within r of the centre, a quarter of it, none fits.
        shares = (draw() for _ in range(attempts))
        draws = np.array([(share, draw()) for share in shares if share >= 0.25]).reshape(-1, 2)
        distance, angle = 2.0 * radius * np.sqrt(draws[:, 0]), 2.0 * np.pi * draws[:, 1]
        x = centre_x + distance * np.cos(angle)
        y = centre_y + distance * np.sin(angle)
        if periodic:
            x -= lx * np.floor(x / lx)
            y -= ly * np.floor(y / ly)
            x[x >= lx] = 0.0  # rounding of a tiny negative number
            y[y >= ly] = 0.0
        j, i = place(centre_x, centre_y)
        near = grid[rows[j : j + 2 * far_y + 1, None], columns[i : i + 2 * far_x + 1]]
        others = points[near[near >= 0]]
        apart = np.abs(others[:, 0] - x[:, None]), np.abs(others[:, 1] - y[:, None])
        free = (squared(*apart, np.minimum) >= radius * radius).all(axis=1)
        if not periodic:
            free &= (x >= 0.0) & (y >= 0.0) & (x < lx) & (y < ly)
        new: list[tuple[float, float]] = []  # candidates of one centre keep apart, too
        for one_x, one_y in zip(x[free].tolist(), y[free].tolist()):
            pairs = ((abs(one_x - x0), abs(one_y - y0)) for x0, y0 in new)
            if all(squared(*pair, min) >= radius * radius for pair in pairs):
                new.append((one_x, one_y))
                add(one_x, one_y)
    return points[:count].copy()
