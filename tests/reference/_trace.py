"""Following a ray through the cells, to the next leaf, the ground, or out.

The ground's height is bilinear between the column centres. Along a ray it is then a quadratic in
each square between four centres, whose first root is where the ray meets the ground.
"""

import math

import numpy as np

from tests.reference._random import Vector, compiled
from tests.reference._world import Discs, Ground, World

LEAF, GROUND, SKY, SIDE = 0, 1, 2, 3
_OPAQUE = 40.0  # optical depth beyond which transmittance is taken as zero
_CLEAR = 1e-9  # distance within which a disc is the one that the ray starts from [m]
Meeting = tuple[int, float, float, float, int, int, int, float]
"""What was met; where (x, y, z); the voxel (k, j, i) or the disc (d, 0, 0); the depth crossed."""


@compiled
def projected(table: np.ndarray, cosine: float) -> float:
    """G from its table by zenith angle."""
    place = math.acos(min(abs(cosine), 1.0)) * (2.0 / math.pi) * (table.shape[0] - 1)
    low = min(int(place), table.shape[0] - 2)
    return table[low] + (place - low) * (table[low + 1] - table[low])


@compiled
def _corner(ground: Ground, periodic: bool, row: int, column: int) -> float:
    ny, nx = ground.terrain.shape
    if periodic:
        return ground.terrain[row % ny, column % nx]
    return ground.terrain[min(max(row, 0), ny - 1), min(max(column, 0), nx - 1)]


@compiled
def _patch(
    ground: Ground, periodic: bool, row: int, column: int
) -> tuple[float, float, float, float]:
    """Height h = a + b u + c v + e u v in the square north-east of a column's centre."""
    a = _corner(ground, periodic, row, column)
    east = _corner(ground, periodic, row, column + 1)
    north = _corner(ground, periodic, row + 1, column)
    across = _corner(ground, periodic, row + 1, column + 1)
    return a, east - a, north - a, across - east - north + a


@compiled
def surface(ground: Ground, periodic: bool, x: float, y: float) -> tuple[float, Vector]:
    """Height of the ground and its upward normal."""
    if not ground.uneven:
        return 0.0, (0.0, 0.0, 1.0)
    u, v = x / ground.spacing - 0.5, y / ground.spacing - 0.5
    column, row = math.floor(u), math.floor(v)
    a, b, c, e = _patch(ground, periodic, row, column)
    u, v = u - column, v - row
    east, north = (b + e * v) / ground.spacing, (c + e * u) / ground.spacing
    length = math.sqrt(1.0 + east * east + north * north)
    return a + b * u + c * v + e * u * v, (-east / length, -north / length, 1.0 / length)


@compiled
def _first_root(square: float, linear: float, constant: float, end: float) -> float:
    """The first zero in [0, end] of a quadratic that starts positive; -1 if none."""
    if constant <= 0.0:
        return 0.0
    inside = linear * linear - 4.0 * square * constant
    if inside < 0.0:
        return -1.0
    half = -0.5 * (linear + math.copysign(math.sqrt(inside), linear))
    first = half / square if square != 0.0 else -1.0
    second = constant / half if half != 0.0 else -1.0
    if first < 0.0 or (0.0 <= second < first):
        first = second
    return first if 0.0 <= first <= end else -1.0


@compiled
def ground_distance(ground: Ground, periodic: bool, p: Vector, d: Vector) -> float:
    """How far the ray from `p` goes before it meets the ground; infinite if never."""
    if not ground.uneven:
        if d[2] >= 0.0:
            return math.inf
        t = -p[2] / d[2]
        x, y = p[0] + d[0] * t, p[1] + d[1] * t
        inside = 0.0 <= x < ground.size[0] and 0.0 <= y < ground.size[1]
        return t if periodic or inside else math.inf
    start = 0.0
    if d[2] < 0.0:
        start = max(0.0, (ground.highest - p[2]) / d[2])
        end = max(start, (ground.lowest - p[2]) / d[2])
    else:
        end = (ground.highest - p[2]) / d[2]
    cut = d[2] > 0.0
    if not periodic:
        for axis in range(2):
            if d[axis] != 0.0:
                near, far = -p[axis] / d[axis], (ground.size[axis] - p[axis]) / d[axis]
                start = max(start, min(near, far))
                if max(near, far) < end:
                    end, cut = max(near, far), True
    if end < start:
        return math.inf
    x, y, z = p[0] + d[0] * start, p[1] + d[1] * start, p[2] + d[2] * start
    u, v = x / ground.spacing - 0.5, y / ground.spacing - 0.5
    du, dv = d[0] / ground.spacing, d[1] / ground.spacing
    column, row = math.floor(u), math.floor(v)
    t, length = 0.0, end - start
    while True:
        to_u, to_v = math.inf, math.inf
        if du != 0.0:
            to_u = (column + (1.0 if du > 0.0 else 0.0) - u) / du
        if dv != 0.0:
            to_v = (row + (1.0 if dv > 0.0 else 0.0) - v) / dv
        leave = min(to_u, to_v, length)
        a, b, c, e = _patch(ground, periodic, row, column)
        at_u, at_v = u + du * t - column, v + dv * t - row
        root = _first_root(
            -e * du * dv,
            d[2] - b * du - c * dv - e * (at_u * dv + at_v * du),
            z + d[2] * t - a - b * at_u - c * at_v - e * at_u * at_v,
            leave - t,
        )
        if root >= 0.0:
            return start + t + root
        if leave >= length:
            # Going down, the lowest ground has been passed, but for rounding.
            return math.inf if cut else end
        t = max(t, leave)
        if to_u <= to_v:
            column += 1 if du > 0.0 else -1
        else:
            row += 1 if dv > 0.0 else -1


@compiled
def _enter(world: World, p: Vector, d: Vector) -> tuple[bool, Vector]:
    """Where a ray from outside the cells enters them, and whether it does."""
    start, end = 0.0, math.inf
    for axis in range(2 if world.periodic else 0, 3):
        if d[axis] != 0.0:
            near = (world.low[axis] - p[axis]) / d[axis]
            far = (world.high[axis] - p[axis]) / d[axis]
            start, end = max(start, min(near, far)), min(end, max(near, far))
        elif not world.low[axis] <= p[axis] <= world.high[axis]:
            return False, p
    if end < start:
        return False, p
    x, y, z = p[0] + d[0] * start, p[1] + d[1] * start, p[2] + d[2] * start
    if world.periodic:
        x -= math.floor(x / world.high[0]) * world.high[0]
        y -= math.floor(y / world.high[1]) * world.high[1]
    return True, (x, y, z)


@compiled
def _nearest(
    discs: Discs, cell: int, p: Vector, d: Vector, best: float, nearest: int
) -> tuple[float, int]:
    """The nearest disc listed in a cell, if nearer than `best`."""
    for m in range(discs.first[cell], discs.first[cell + 1]):
        leaf = discs.member[m]
        n0, n1, n2 = discs.normal[leaf]
        x, y, z = discs.centre[leaf]
        x, y, z = x - p[0], y - p[1], z - p[2]
        facing = n0 * d[0] + n1 * d[1] + n2 * d[2]
        if facing == 0.0:
            continue
        t = (n0 * x + n1 * y + n2 * z) / facing
        if _CLEAR < t < best:
            x, y, z = d[0] * t - x, d[1] * t - y, d[2] * t - z
            if x * x + y * y + z * z < discs.radius[leaf] ** 2:
                best, nearest = t, leaf
    return best, nearest


@compiled
def trace_path(world: World, p: Vector, d: Vector, budget: float, g: np.ndarray) -> Meeting:
    """Follow a ray until the turbid medium has used up the optical depth `budget`, or a disc
    is met, or the ground, or the ray leaves.

    Fills `g` with the projection of each distribution along the ray.
    """
    inside, p = _enter(world, p, d)
    out = SKY if d[2] > 0.0 else SIDE
    if not inside:
        return out, p[0], p[1], p[2], 0, 0, 0, 0.0
    ground, medium, discs = world.ground, world.medium, world.discs
    if ground.uneven and p[2] < ground.highest:
        # Through a side of the block of ground that an open scene stands on.
        within = 0.0 <= p[0] <= ground.size[0] and 0.0 <= p[1] <= ground.size[1]
        if within and p[2] < surface(ground, world.periodic, p[0], p[1])[0] - 1e-9:
            return SIDE, p[0], p[1], p[2], 0, 0, 0, math.inf
    end = ground_distance(ground, world.periodic, p, d)
    for angle in range(g.shape[0]):
        g[angle] = projected(medium.projection[angle], d[2])
    nx, ny, nz = world.cells
    i = min(max(int((p[0] - world.low[0]) / world.cell[0]), 0), nx - 1)
    j = min(max(int((p[1] - world.low[1]) / world.cell[1]), 0), ny - 1)
    k = min(max(int((p[2] - world.low[2]) / world.cell[2]), 0), nz - 1)
    right, up, rise = 1 if d[0] > 0.0 else 0, 1 if d[1] > 0.0 else 0, 1 if d[2] > 0.0 else 0
    tx, ty, step_x, step_y = math.inf, math.inf, math.inf, math.inf
    if d[0] != 0.0:
        tx = (world.low[0] + (i + right) * world.cell[0] - p[0]) / d[0]
        step_x = world.cell[0] / abs(d[0])
    if d[1] != 0.0:
        ty = (world.low[1] + (j + up) * world.cell[1] - p[1]) / d[1]
        step_y = world.cell[1] / abs(d[1])
    tz = (world.low[2] + (k + rise) * world.cell[2] - p[2]) / d[2]
    step_z = world.cell[2] / abs(d[2])
    t, depth, best, nearest = 0.0, 0.0, math.inf, -1
    while True:
        leave = max(t, min(tx, ty, tz, end))
        if discs.active:
            best, nearest = _nearest(discs, (k * ny + j) * nx + i, p, d, best, nearest)
            if best <= leave:
                at = p[0] + d[0] * best, p[1] + d[1] * best, p[2] + d[2] * best
                return LEAF, at[0], at[1], at[2], nearest, 0, 0, 0.0
        else:
            extinction = 0.0
            for angle in range(g.shape[0]):
                extinction += g[angle] * medium.by_angle[k, j, i, angle]
            crossed = extinction * (leave - t)
            if depth + crossed >= budget:
                t += (budget - depth) / extinction
                return LEAF, p[0] + d[0] * t, p[1] + d[1] * t, p[2] + d[2] * t, k, j, i, budget
            depth += crossed
        t = leave
        if t >= end:
            return GROUND, p[0] + d[0] * t, p[1] + d[1] * t, p[2] + d[2] * t, k, j, i, depth
        if tz <= tx and tz <= ty:
            k += 2 * rise - 1
            tz += step_z
            if k < 0 and end < math.inf:  # the flat ground, missed by rounding
                out = GROUND
            if k < 0 or k >= nz:
                break
        elif tx <= ty:
            i += 2 * right - 1
            tx += step_x
            if i < 0 or i >= nx:
                if not world.periodic:
                    out = SIDE
                    break
                i -= (2 * right - 1) * nx
                p = (p[0] - (2 * right - 1) * world.high[0], p[1], p[2])
        else:
            j += 2 * up - 1
            ty += step_y
            if j < 0 or j >= ny:
                if not world.periodic:
                    out = SIDE
                    break
                j -= (2 * up - 1) * ny
                p = (p[0], p[1] - (2 * up - 1) * world.high[1], p[2])
    return out, p[0] + d[0] * t, p[1] + d[1] * t, p[2] + d[2] * t, k, j, i, depth


@compiled
def transmittance(world: World, p: Vector, d: Vector, g: np.ndarray) -> float:
    """Share of light that gets from `p` out along the upward direction `d`."""
    met = trace_path(world, p, d, _OPAQUE, g)
    free = met[0] == SKY or met[0] == SIDE
    return math.exp(-met[7]) if free else 0.0
