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
        """Squared distance of places `dx` and `dy` apart, to the nearest repetition of a periodic
        extent. `least` is the minimum of two: NumPy's, or Python's for single numbers."""
        if periodic and outer:
            dx, dy = abs(dx), abs(dy)
            dx, dy = least(dx, lx - dx), least(dy, ly - dy)
        return dx * dx + dy * dy

    def add(x: float, y: float) -> None:
        nonlocal count
        points[count] = x, y
        grid[place(x, y)] = count
        active.append((x, y))
        count += 1

    add(rng.random() * lx, rng.random() * ly)
    numbers, at = np.empty(0), 0
    while active:
        if at + 2 * attempts >= len(numbers):  # enough for the next centre, in large pieces
            numbers = np.concatenate([numbers[at:], rng.random(2**14 + 2 * attempts)])
            uniform, at = numbers.tolist(), 0
            reach = 2.0 * radius * np.sqrt(numbers)
            east, north = np.cos(2.0 * np.pi * numbers), np.sin(2.0 * np.pi * numbers)
        pick, at = int(uniform[at] * len(active)), at + 1
        centre_x, centre_y = active[pick]
        active[pick] = active[-1]
        active.pop()
        # Candidates lie within two radii, and what is near them within three.
        to_border = min(centre_x, lx - centre_x, centre_y, ly - centre_y)
        outer = to_border <= 6.0 * radius
        # Uniform by area in the disc of 2 r; within r of the centre, a quarter of it, none fits.
        tried = []
        for _ in range(attempts):
            if uniform[at] < 0.25:
                at += 1
            else:  # the share of the disc's area, and the direction after it
                tried.append(at)
                at += 2
        chosen = np.array(tried, int)
        x = centre_x + reach[chosen] * east[chosen + 1]
        y = centre_y + reach[chosen] * north[chosen + 1]
        if periodic and outer:
            x -= lx * np.floor(x / lx)
            y -= ly * np.floor(y / ly)
            x[x >= lx] = 0.0  # rounding of a tiny negative number
            y[y >= ly] = 0.0
        j, i = place(centre_x, centre_y)
        near = grid[rows[j : j + 2 * far_y + 1, None], columns[i : i + 2 * far_x + 1]]
        others = points[near[near >= 0]]
        apart = squared(others[:, 0] - x[:, None], others[:, 1] - y[:, None], np.minimum)
        free = (apart >= radius * radius).all(axis=1)
        if outer and not periodic:
            free &= (x >= 0.0) & (y >= 0.0) & (x < lx) & (y < ly)
        new: list[tuple[float, float]] = []  # candidates of one centre keep apart, too
        for one_x, one_y in zip(x[free].tolist(), y[free].tolist()):
            if all(squared(one_x - x0, one_y - y0, min) >= radius * radius for x0, y0 in new):
                new.append((one_x, one_y))
                add(one_x, one_y)
    return points[:count].copy()
