"""Compiled kernel that projects crowns on a raster. Apart, because importing numba takes time."""

from typing import no_type_check

import numba
import numpy as np


@numba.njit(cache=True)
@no_type_check  # a check of types while tests run would wrap it, and numba compile the wrapper
def project(
    x: np.ndarray,
    y: np.ndarray,
    radius: np.ndarray,
    height: np.ndarray,
    species: np.ndarray,
    n_species: int,
    nx: int,
    ny: int,
    cell: float,
    periodic: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Discs on a raster of cells whose centres count: (top, crowns, union).

    `top` [ny, nx] is the tallest plant over each cell, -1 for none. `crowns` counts the cells of
    all discs, those beyond an open border too; `union` the cells that a species covers at all.
    Plants of one species must lie together.
    """
    top = np.full((ny, nx), -1, np.int32)
    stamp = np.full((ny, nx), -1, np.int32)
    crowns = np.zeros(n_species, np.int64)
    union = np.zeros(n_species, np.int64)
    for plant in range(len(x)):
        one = species[plant]
        square = radius[plant] * radius[plant]
        first = int(np.ceil((y[plant] - radius[plant]) / cell - 0.5))
        last = int(np.floor((y[plant] + radius[plant]) / cell - 0.5))
        # The rows whose centres the disc covers, and in each the columns from west to east.
        for row in range(first, last + 1):
            dy = (row + 0.5) * cell - y[plant]
            half = np.sqrt(max(square - dy * dy, 0.0))
            west = int(np.ceil((x[plant] - half) / cell - 0.5))
            east = int(np.floor((x[plant] + half) / cell - 0.5))
            crowns[one] += max(east - west + 1, 0)
            j = row
            if periodic:
                j = row % ny
            elif row < 0 or row >= ny:
                continue
            for column in range(west, east + 1):
                i = column
                if periodic:
                    i = column % nx
                elif column < 0 or column >= nx:
                    continue
                # Plants of a species follow each other: what it covers already bears its stamp.
                if stamp[j, i] != one:
                    stamp[j, i] = one
                    union[one] += 1
                other = top[j, i]
                if other < 0 or height[plant] > height[other]:
                    top[j, i] = plant
    return top, crowns, union
