"""Bridson's Poisson-disk sampling, for all active points at once."""

import math
from itertools import product

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from fynjax._core.errors import InputError

_FINER, _PLACES = 8, 16
"""Parts of a cell's edge: of the squares that are known to be covered, and of the places of a
point in its cell for which the squares are tabulated."""
_DRAWS = 32
"""Candidates of an active point in one round, those without the annulus among them."""
_SLACK = 1.0 + 1e-9
"""Least squared distance over that asked for: what rounding takes is less."""
_REACH = tuple(product(range(-2, 3), repeat=2))
"""Cells, as (row, column), in which a point may be too near; with corners."""


def fill_disks(
    rng: np.random.Generator,
    lx: float,
    ly: float,
    radius: float,
    attempts: int,
    periodic: bool,
    start: Float[np.ndarray, "given 2"] | None = None,
) -> Float[np.ndarray, "point 2"]:
    """Points on [0, lx) x [0, ly), all at least `radius` apart, until none fits.

    Active points draw candidates from their annuli until `attempts` in a row have failed, as in
    Bridson's steps; but in each round all of them draw some, not one of them all. Candidates that
    exclude each other come in the order of their active points. What is computed are sums, products
    and comparisons alone, whose digits are the same on every machine.

    The grid holds one point a cell at most: its cells have a diagonal of at most `radius`. On a
    periodic extent they shrink a little so that whole cells fit. Points are `start`, which are at
    least `radius` apart and all active at first, and those drawn after them.
    """
    grid = _Grid(lx, ly, radius, periodic)
    if start is None or not len(start):
        start = rng.random((1, 2)) * (lx, ly)
    x, y = np.array(start, float).T.copy()
    grid.take(x, y)
    found, failed = [(x, y)], np.zeros(len(x), np.int32)
    while active := len(x):
        # Uniform by area in the square about the disc of 2 r: some lie in the annulus.
        east, north = rng.random((2, _DRAWS, active), dtype=np.float32)
        for shift in (east, north):
            shift -= 0.5
            shift *= 4.0
        far = east * east + north * north
        drawn = (far >= 1.0) & (far < 4.0)
        tried = np.cumsum(drawn, axis=0, dtype=np.int8)
        drawn &= tried <= attempts - failed
        which = np.flatnonzero(drawn)
        draw = which // active
        of = which - draw * active
        new, accepted = grid.add(
            x[of] + east.ravel()[which] * radius,
            y[of] + north.ravel()[which] * radius,
            of * _DRAWS + draw,
        )
        # Failures in a row: where any was accepted, those after the last.
        of, draw = np.divmod(np.sort(accepted), _DRAWS)
        failed += np.minimum(tried[-1], attempts - failed)
        last = np.full(active, -1)
        last[of] = draw  # the latest is written last
        some = np.flatnonzero(last >= 0)
        after = np.arange(_DRAWS)[:, None] > last[some]
        failed[some] = np.count_nonzero(drawn[:, some] & after, axis=0)
        on = failed < attempts
        found.append(new)
        x, y = (np.concatenate([old[on], more]) for old, more in zip((x, y), new, strict=True))
        failed = np.concatenate([failed[on], np.zeros(len(accepted), np.int32)])
    return np.stack([np.concatenate(parts) for parts in zip(*found, strict=True)], axis=1)


_Values = Float[np.ndarray, " n"]
_New = Float[np.ndarray, " new"]
_Points = Complex[np.ndarray, " n"]
_Index = Int[np.ndarray, " n"]


class _Grid:
    """Points in cells, in rows of cells with a margin of two all round.

    The margin of a periodic extent repeats its other side, that of an open one stays empty.
    """

    def __init__(self, lx: float, ly: float, radius: float, periodic: bool) -> None:
        cell = radius / math.sqrt(2.0)
        if periodic:
            nx, ny = math.ceil(lx / cell), math.ceil(ly / cell)
            edge = lx / nx, ly / ny
        else:
            nx, ny = int(lx / cell) + 1, int(ly / cell) + 1
            edge = cell, cell
        self._sides, self._count, self._edge, self._periodic = (lx, ly), (nx, ny), edge, periodic
        self._radius = radius
        self._least, self._wide = radius * radius * _SLACK, nx + 4
        size = self._wide * (ny + 4)
        # x + i y of the point of each cell, infinite where there is none.
        self._point = np.full(size, complex(np.inf, np.inf))
        self._rank = np.zeros(size, np.int32)
        # Squares of each cell that are wholly within the radius of a point, a bit for each.
        self._covered = np.zeros(size, np.uint64)
        self._stamps = _stamps(edge, radius)
        near = sorted((j * j + i * i, j * self._wide + i) for j, i in _REACH if abs(i * j) < 4)
        self._near = [by for _, by in near]
        # Column and row of cells in the grid, those beyond a periodic border in those they repeat.
        beyond = [np.arange(-2, n + 2) for n in (nx, ny)]
        if periodic:
            beyond = [n % count for n, count in zip(beyond, (nx, ny), strict=True)]
        self._column, self._row = beyond[0] + 2, (beyond[1] + 2) * self._wide

    def _parts(self, x: _Values, y: _Values, finer: int) -> tuple[_Index, _Index]:
        """Column and row, in cells of which so many fit into an edge of the grid's."""
        (wide, high), (nx, ny) = self._edge, self._count
        i, j = (x * (finer / wide)).astype(np.int64), (y * (finer / high)).astype(np.int64)
        return np.minimum(i, finer * nx - 1), np.minimum(j, finer * ny - 1)

    def take(self, x: _Values, y: _Values) -> None:
        """Take in points, after a look whether they are on the extent and far enough apart."""
        lx, ly = self._sides
        inside = bool(((x >= 0.0) & (y >= 0.0) & (x < lx) & (y < ly)).all())
        if inside:
            i, j = self._parts(x, y, 1)
            cell = (j + 2) * self._wide + i + 2
            self.cover(x, y)
            points, near = x + 1j * y, self._near[1:]
            inside = bool((self._point[cell] == points).all()) and not any(
                self._too_near(points, cell + by).any() for by in near
            )
        if not inside:
            raise InputError(
                f"`start` must be points on {lx} m x {ly} m, at least {self._radius} m apart"
            )

    def cover(self, x: _Values, y: _Values) -> None:
        """Take points in, no two of them in one cell."""
        i, j = self._parts(x, y, _PLACES)
        at = (j & _PLACES - 1) * _PLACES + (i & _PLACES - 1)
        i, j = i // _PLACES + 2, j // _PLACES + 2
        self._write(x + 1j * y, i, j)
        for (dj, di), stamp in zip(_REACH, self._stamps, strict=True):
            # No cell twice: each point has one of its own.
            self._covered[self._row[j + dj] + self._column[i + di]] |= stamp[at]

    def _write(self, points: _Points, i: _Index, j: _Index, rank: _Index | None = None) -> None:
        """Points in their cells, and in those of the margin that repeat them; columns and rows are
        those of cells, margin and all."""
        (lx, ly), (nx, ny) = self._sides, self._count
        cell = j * self._wide + i
        self._point[cell] = points
        if rank is not None:
            self._rank[cell] = rank
        if not self._periodic:
            return
        edge = np.flatnonzero((i < 4) | (j < 4) | (i >= nx) | (j >= ny))
        points, i, j, rank = points[edge], i[edge], j[edge], None if rank is None else rank[edge]
        for up, right in product((-1, 0, 1), repeat=2):
            row, column = j + up * ny, i + right * nx
            own = (row >= 0) & (row < ny + 4) & (column >= 0) & (column < nx + 4)
            cell = row[own] * self._wide + column[own]
            self._point[cell] = points[own] + complex(right * lx, up * ly)
            if rank is not None:
                self._rank[cell] = rank[own]

    def add(
        self, x: _Values, y: _Values, which: _Index
    ) -> tuple[tuple[_New, _New], Int[np.ndarray, " new"]]:
        """Take in as many candidates as fit, the first by `which` of those that exclude each other;
        their x and y, and their values of `which`."""
        lx, ly = self._sides
        beyond = np.flatnonzero((x < 0.0) | (y < 0.0) | (x >= lx) | (y >= ly))
        if self._periodic:
            for values, side in ((x, lx), (y, ly)):
                some = values[beyond]
                some = np.where(some < 0.0, some + side, some)
                values[beyond] = np.where(some >= side, some - side, some)
        else:
            x, y, which = (np.delete(values, beyond) for values in (x, y, which))
        i, j = self._parts(x, y, _FINER)
        cell = (j // _FINER + 2) * self._wide + (i // _FINER + 2)
        bit = ((j & _FINER - 1) * _FINER + (i & _FINER - 1)).astype(np.uint64)
        free = np.flatnonzero(self._covered[cell] >> bit & np.uint64(1) == 0)
        free = free[np.argsort(which[free])]
        points, which, cell = x[free] + 1j * y[free], which[free], cell[free]
        new, accepted = [points[:0]], [which[:0]]
        while True:
            free = self._free(points, cell)
            points, which, cell = points[free], which[free], cell[free]
            if not len(points):
                found = np.concatenate(new)
                return (found.real, found.imag), np.concatenate(accepted)
            # The first of each cell, unless an earlier one of another cell is too near.
            own, first = np.unique(cell, return_index=True)
            heads = points[first]
            j, i = np.divmod(own, self._wide)
            self._write(heads, i, j, first)
            wins = np.ones(len(first), bool)
            for by in self._near[1:]:
                near = np.flatnonzero(self._too_near(heads, own + by))
                wins[near] &= self._rank[own[near] + by] > first[near]
            lost = np.flatnonzero(~wins)
            self._write(np.full(len(lost), complex(np.inf, np.inf)), i[lost], j[lost])
            first = first[wins]
            self.cover(points[first].real, points[first].imag)
            new.append(points[first])
            accepted.append(which[first])
            points, which, cell = (np.delete(values, first) for values in (points, which, cell))

    def _free(self, points: _Points, cell: _Index) -> Int[np.ndarray, " free"]:
        """Index of the points to which none of the grid is too near."""
        free = np.arange(len(points))
        for by in self._near:
            far = ~self._too_near(points, cell + by)
            if not far.all():
                points, cell, free = points[far], cell[far], free[far]
        return free

    def _too_near(self, points: _Points, cell: _Index) -> Bool[np.ndarray, " n"]:
        """Whether each point is too near to that of a cell."""
        apart = self._point[cell] - points
        return apart.real * apart.real + apart.imag * apart.imag < self._least


def _stamps(edge: tuple[float, float], radius: float) -> np.ndarray:
    """Squares of the cells about a point that are wholly within its radius [reach, place of the
    point in its cell], a bit for each square."""
    place, square = np.arange(_PLACES), np.arange(_FINER)
    bits = np.uint64(1) << (square[:, None] * _FINER + square).astype(np.uint64)
    stamps = np.zeros((len(_REACH), _PLACES**2), np.uint64)
    for number, by in enumerate(_REACH):
        squared = []
        for step, length in zip(by, edge[::-1]):
            low = step + square / _FINER - (place[:, None] + 1) / _PLACES
            high = step + (square + 1) / _FINER - place[:, None] / _PLACES
            squared.append((np.maximum(np.abs(low), np.abs(high)) * length) ** 2)
        y, x = squared  # [place, square]
        within = y[:, None, :, None] + x[None, :, None, :] < radius**2 * (1.0 - 1e-9)
        stamps[number] = np.where(within, bits, np.uint64(0)).sum((2, 3), np.uint64).ravel()
    return stamps
