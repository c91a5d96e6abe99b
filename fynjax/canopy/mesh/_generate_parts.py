"""Surfaces that generated plants are made of: closed tubes and flat blades."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Outline = tuple[tuple[float, float], ...]

OUTLINES: dict[str, Outline] = {
    "linear": ((0.0, 0.5), (1.0, 0.2)),
    "lanceolate": ((0.0, 0.0), (0.25, 0.45), (0.55, 0.45), (1.0, 0.0)),
    "elliptic": ((0.0, 0.0), (0.30, 0.5), (0.70, 0.5), (1.0, 0.0)),
    "obovate": ((0.0, 0.0), (0.45, 0.38), (0.80, 0.5), (1.0, 0.0)),
    "wedge": ((0.0, 0.0), (0.80, 0.5), (1.0, 0.35)),
    "petal": ((0.0, 0.5), (1.0, 0.5)),
}
"""Half-width (in widths) at parts of the length, from base to tip; between them straight."""


def outline_area(outline: Outline) -> float:
    """Area of a flat blade of length and width one [-]."""
    return sum((low[1] + high[1]) * (high[0] - low[0]) for low, high in pairwise(outline))


def outline_triangles(outline: Outline) -> int:
    """Triangles of a blade."""
    return sum((low[1] > 0.0) + (high[1] > 0.0) for low, high in pairwise(outline))


_CURL = 0.06
"""Height of a blade's arch over its chord, in lengths."""
_WIDTH_STEPS = 12
_SHORTEST = 1e-12


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors [..., 3] at length one; those of length zero stay."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > _SHORTEST, length, 1.0)


def tangents(paths: np.ndarray) -> np.ndarray:
    """Unit tangents at the points of `paths` [path, point, 3]."""
    step = np.diff(paths, axis=1)
    inner = unit(step[:, 1:]) + unit(step[:, :-1])
    return unit(np.concatenate([step[:, :1], inner, step[:, -1:]], axis=1))


@dataclass(frozen=True)
class Surface:
    """Triangles: `vertices` [vertex, 3] in metres, `faces` [face, 3] counter-clockwise."""

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def area(self) -> float:
        """Area of all triangles [m2]."""
        corners = self.vertices[self.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return float(0.5 * np.linalg.norm(cross, axis=1).sum())


EMPTY = Surface(np.zeros((0, 3)), np.zeros((0, 3), int))


def join(parts: list[Surface]) -> Surface:
    """One surface of several."""
    if not parts:
        return EMPTY
    first = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, first)]),
    )


def _frames(paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two sides of paths [path, point, 3], right-handed with them, without needless twist."""
    along = tangents(paths)
    level = np.abs(along[:, 0, 2]) < 0.9
    reference = np.where(level[:, None], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    side = np.empty_like(along)
    side[:, 0] = unit(np.cross(reference, along[:, 0]))
    for point in range(1, paths.shape[1]):
        ahead = along[:, point]
        before = side[:, point - 1]
        # The side of the point before, less its part along the path: it does not turn about it.
        side[:, point] = unit(before - (before * ahead).sum(-1, keepdims=True) * ahead)
    return side, np.cross(along, side)


def tubes_of_area(
    groups: list[tuple[np.ndarray, np.ndarray]], sides: list[int], one_sided_area: float
) -> tuple[Surface, float]:
    """Closed tubes (of groups of paths [path, point, 3] and relative radii [path, point], each with
    its number of edges) thickened to a one-sided area [m2].

    The one-sided area of a closed surface is half of it; outward faces are counter-clockwise.
    Returns the factor of the radii too.
    """
    rings = [_rings(paths, radii, edges) for (paths, radii), edges in zip(groups, sides)]
    middle = np.concatenate([part[0] for part in rings])
    offset = np.concatenate([part[1] for part in rings])
    faces = join([Surface(part[0], part[2]) for part in rings]).faces
    # The area is nearly in proportion to the radii.
    factor = 1e-4
    for _ in range(_WIDTH_STEPS):
        ratio = one_sided_area / (0.5 * Surface(middle + factor * offset, faces).area)
        factor *= ratio
        if abs(ratio - 1.0) < 1e-13:
            break
    return Surface(middle + factor * offset, faces), factor


def _rings(
    paths: np.ndarray, radii: np.ndarray, sides: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of tubes as points on the paths plus offsets, [vertex, 3] each, and faces."""
    count, points, _ = paths.shape
    side, second = _frames(paths)
    turn = 2.0 * np.pi * np.arange(sides) / sides
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    out = side[:, :, None, :] * cos + second[:, :, None, :] * sin
    offset = (radii[:, :, None, None] * out).reshape(-1, 3)
    middle = np.repeat(paths.reshape(-1, 3), sides, axis=0)

    ring = np.arange(points - 1)[:, None] * sides
    here, beside = np.arange(sides)[None, :], ((np.arange(sides) + 1) % sides)[None, :]
    a, b, c, d = ring + here, ring + beside, ring + sides + beside, ring + sides + here
    # Two triangles for each edge between rings, and a fan that closes either end.
    wall = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    corner = np.arange(1, sides - 1)
    start = np.stack([np.zeros_like(corner), corner + 1, corner], -1)
    end = np.stack([np.zeros_like(corner), corner, corner + 1], -1) + (points - 1) * sides
    faces = np.concatenate([wall, start, end])
    first = np.arange(count)[:, None, None] * (points * sides)
    return middle, offset, (faces[None] + first).reshape(-1, 3)


def blades(
    base: np.ndarray,
    axis: np.ndarray,
    normal: np.ndarray,
    length: np.ndarray,
    width: np.ndarray,
    outline: Outline,
) -> Surface:
    """Flat blades, slightly arched lengthwise about their mean plane.

    `base`, `axis` (from base to tip), `normal`: [blade, 3], the last two orthogonal unit
    vectors; `length`, `width`: [blade] [m].
    """
    count = len(base)
    if count == 0:
        return EMPTY
    across = np.cross(normal, axis)
    rows: list[np.ndarray] = []
    strips: list[list[int]] = []
    arched = len(outline) > 2
    for part, half in outline:
        rise = 4.0 * _CURL * part * (1.0 - part) if arched else 0.0
        middle = base + length[:, None] * (part * axis + rise * normal)
        if half == 0.0:
            strips.append([len(rows)])
            rows.append(middle)
        else:
            strips.append([len(rows), len(rows) + 1])
            offset = (half * width)[:, None] * across
            rows.extend([middle - offset, middle + offset])
    faces = []
    for low, high in pairwise(strips):
        if len(low) == 1:
            faces.append([low[0], high[0], high[1]])
        elif len(high) == 1:
            faces.append([low[0], high[0], low[1]])
        else:
            faces += [[low[0], high[0], high[1]], [low[0], high[1], low[1]]]
    vertices = np.stack(rows, axis=1)
    first = np.arange(count)[:, None, None] * len(rows)
    return Surface(vertices.reshape(-1, 3), (np.array(faces)[None] + first).reshape(-1, 3))
