"""Random numbers and the directions made of them.

The generator is SplitMix64 (Steele, Lea and Flood 2014): its whole state is one integer that the
caller owns, so a result depends on its seed alone, however many threads share the work.
"""

import math
from typing import Any

import numba
import numpy as np

Vector = tuple[float, float, float]

_UNCOUNTED: dict[str, Any] = {"_nrt": False}  # an option of numba's own, not in its stubs
compiled_with_arrays = numba.njit(nogil=True, error_model="numpy")
"""For functions that make arrays."""
compiled = numba.njit(nogil=True, error_model="numpy", **_UNCOUNTED)
"""For all others: the arrays they are given need no reference counts, which would take half of
the time."""

_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@compiled
def uniform(state: np.ndarray) -> float:
    """A number in [0, 1); `state` is one uint64."""
    state[0] += _STEP
    z = state[0]
    z = (z ^ (z >> _30)) * _FIRST
    z = (z ^ (z >> _27)) * _SECOND
    return float((z ^ (z >> _31)) >> _11) * 2.0**-53


@compiled
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def unit(x: float, y: float, z: float) -> Vector:
    """The direction of a vector, kept off the horizontal, along which a ray would never end."""
    length = math.sqrt(x * x + y * y + z * z)
    z = z / length
    if abs(z) < 1e-6:
        z = math.copysign(1e-6, z)
    return (x / length, y / length, z)


@compiled
def lambert(normal: Vector, state: np.ndarray) -> Vector:
    """A direction about `normal` by Lambert's law: the normal plus a point of the unit sphere."""
    z = 2.0 * uniform(state) - 1.0
    turn = 2.0 * math.pi * uniform(state)
    s = math.sqrt(1.0 - z * z)
    return unit(normal[0] + s * math.cos(turn), normal[1] + s * math.sin(turn), normal[2] + z)


@compiled
def leaf_normal(cumulative: np.ndarray, direction: Vector, state: np.ndarray) -> Vector:
    """The normal of a leaf that light along `direction` met, on the side it met.

    Inclinations follow their distribution; a leaf is met in proportion to what it shows.
    """
    cells = cumulative.shape[0] - 1
    while True:
        draw = uniform(state)
        low, high = 0, cells
        while high - low > 1:
            middle = (low + high) // 2
            if cumulative[middle] <= draw:
                low = middle
            else:
                high = middle
        inclination = (low + uniform(state)) * (0.5 * math.pi / cells)
        turn = 2.0 * math.pi * uniform(state)
        s = math.sin(inclination)
        n = (s * math.cos(turn), s * math.sin(turn), math.cos(inclination))
        facing = dot(n, direction)
        if uniform(state) < abs(facing):
            return (-n[0], -n[1], -n[2]) if facing > 0.0 else n
