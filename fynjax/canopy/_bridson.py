"""Compiled kernel of Bridson's Poisson-disk sampling. Apart, because importing numba takes time."""

from typing import Any, no_type_check

import numba
import numpy as np


@numba.njit(cache=True, fastmath=False)
@no_type_check  # a check of types while tests run would wrap it, and numba compile the wrapper
def fill(
    rng: Any, lx: float, ly: float, radius: float, attempts: int, periodic: bool
) -> np.ndarray:
    """Points [n, 2] on [0, lx) x [0, ly), all at least `radius` apart, until none fits.

    Each point is the centre once, of `attempts` candidates; all that fit become points.
    The background grid holds one point a cell at most: its cells have a diagonal of at most
    `radius`. On a periodic extent they shrink a little so that whole cells fit.
    """
    cell = radius / np.sqrt(2.0)
    if periodic:
        nx = int(np.ceil(lx / cell))
        ny = int(np.ceil(ly / cell))
        cell_x = lx / nx
        cell_y = ly / ny
    else:
        nx = int(lx / cell) + 1
        ny = int(ly / cell) + 1
        cell_x = cell
        cell_y = cell
    reach_x = int(np.ceil(radius / cell_x))
    reach_y = int(np.ceil(radius / cell_y))

    grid = np.full((ny, nx), -1, np.int64)
    # No packing of discs of this radius is denser than the hexagonal one (plus its border).
    room = int(1.16 * (lx + radius) * (ly + radius) / radius**2) + 8
    points = np.empty((min(room, nx * ny + 8), 2), np.float64)
    active = np.empty(points.shape[0], np.int64)

    points[0, 0] = rng.random() * lx
    points[0, 1] = rng.random() * ly
    grid[min(int(points[0, 1] / cell_y), ny - 1), min(int(points[0, 0] / cell_x), nx - 1)] = 0
    active[0] = 0
    n_points = 1
    n_active = 1
    square = radius * radius

    while n_active > 0:
        pick = int(rng.random() * n_active)
        centre = active[pick]
        n_active -= 1
        active[pick] = active[n_active]
        px = points[centre, 0]
        py = points[centre, 1]
        for _ in range(attempts):
            # Uniform by area in the disc of 2 r; within r of the centre none fits.
            distance = 2.0 * radius * np.sqrt(rng.random())
            if distance < radius:
                continue
            angle = 2.0 * np.pi * rng.random()
            x = px + distance * np.cos(angle)
            y = py + distance * np.sin(angle)
            if periodic:
                x -= lx * np.floor(x / lx)
                y -= ly * np.floor(y / ly)
                if x >= lx:  # rounding of a tiny negative number
                    x = 0.0
                if y >= ly:
                    y = 0.0
            elif x < 0.0 or y < 0.0 or x >= lx or y >= ly:
                continue
            ix = min(int(x / cell_x), nx - 1)
            iy = min(int(y / cell_y), ny - 1)
            free = True
            for dy in range(-reach_y, reach_y + 1):
                jy = iy + dy
                if periodic:
                    jy %= ny
                elif jy < 0 or jy >= ny:
                    continue
                for dx in range(-reach_x, reach_x + 1):
                    jx = ix + dx
                    if periodic:
                        jx %= nx
                    elif jx < 0 or jx >= nx:
                        continue
                    other = grid[jy, jx]
                    if other < 0:
                        continue
                    ex = abs(points[other, 0] - x)
                    ey = abs(points[other, 1] - y)
                    if periodic:
                        ex = min(ex, lx - ex)
                        ey = min(ey, ly - ey)
                    if ex * ex + ey * ey < square:
                        free = False
                        break
                if not free:
                    break
            if free:
                points[n_points, 0] = x
                points[n_points, 1] = y
                grid[iy, ix] = n_points
                active[n_active] = n_points
                n_points += 1
                n_active += 1
    return points[:n_points].copy()
