"""Poisson-disk sampling by the printed steps of Bridson (2007, SIGGRAPH sketches), one by one."""

import math

import numba
import numpy as np
from jaxtyping import Float


def bridson(
    side: float, radius: float, attempts: int, seed: int, periodic: bool
) -> Float[np.ndarray, "point 2"]:
    """Points on a square, no two of them nearer than `radius`."""
    return _steps(np.random.default_rng(seed), side, radius, attempts, periodic)


@numba.njit
def _steps(
    rng: np.random.Generator, side: float, radius: float, attempts: int, periodic: bool
) -> np.ndarray:
    """An active point is chosen at random, up to `attempts` candidates are
    drawn from its annulus of one to two radii until one fits, and it retires where none does."""
    cells = max(1, math.ceil(side / (radius / math.sqrt(2.0))))
    edge = side / cells
    grid = np.full((cells, cells), -1)
    points = np.empty((int(1.2 * (side / radius + 1.0) ** 2) + 8, 2))
    points[0] = rng.random() * side, rng.random() * side
    grid[int(points[0, 1] / edge), int(points[0, 0] / edge)] = 0
    count, active = 1, [0]
    while len(active) > 0:
        chosen = int(rng.random() * len(active))
        centre, found = points[active[chosen]], False
        for _ in range(attempts):
            far = radius * math.sqrt(1.0 + 3.0 * rng.random())
            turn = 2.0 * math.pi * rng.random()
            x, y = centre[0] + far * math.cos(turn), centre[1] + far * math.sin(turn)
            if periodic:
                x, y = x % side, y % side
            elif min(x, y) < 0.0 or max(x, y) >= side:
                continue
            column, row = min(int(x / edge), cells - 1), min(int(y / edge), cells - 1)
            found = True
            for j in range(row - 2, row + 3):
                for i in range(column - 2, column + 3):
                    if periodic:
                        other = grid[j % cells, i % cells]
                    elif min(i, j) < 0 or max(i, j) >= cells:
                        continue
                    else:
                        other = grid[j, i]
                    if other >= 0:
                        dx, dy = abs(x - points[other, 0]), abs(y - points[other, 1])
                        if periodic:
                            dx, dy = min(dx, side - dx), min(dy, side - dy)
                        found = found and dx * dx + dy * dy >= radius * radius
            if found:
                points[count], grid[row, column] = (x, y), count
                active.append(count)
                count += 1
                break
        if not found:
            active[chosen] = active[-1]
            active.pop()
    return points[:count].copy()
