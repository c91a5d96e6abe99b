"""Explicit leaves: round, flat, placed at random after the density of a scene."""

from typing import NamedTuple

import numba
import numpy as np

from fynjax._core.errors import InputError
from fynjax.radiation._scene import VoxelScene
from tests.reference._world import Discs, World, build_world, plain

_MOST_CELLS = 20_000_000


class Leaves(NamedTuple):
    """Round, flat leaves [m]."""

    centre: np.ndarray
    """[leaf, 3]"""
    normal: np.ndarray
    """Unit vectors: [leaf, 3]"""
    radius: np.ndarray
    """[leaf]"""
    optical_class: np.ndarray
    """The class in the scene of each leaf: [leaf]"""


def discs(scene: VoxelScene, seed: int) -> Leaves:
    """Draw leaves, as discs, from the area density of a scene.

    In each voxel and for each class, their number is Poisson distributed about density times
    volume over the area of one leaf; centres are even over the voxel and normals follow the class's
    distribution, so leaves may stick out of their voxel.

    **Arguments:**

    - `scene`: with `classes.leaf_diameter` [m], positive.
    - `seed`: the same seed gives the same leaves.

    **Raises:** `InputError` if the classes have no leaf diameter, or one that is not positive.
    """
    classes = scene.classes
    world = build_world(scene, 0)
    if classes.leaf_diameter is None:
        raise InputError(
            "`classes.leaf_diameter` must be given to draw leaves, but is None: the scene is a "
            "medium of points"
        )
    sizes = np.asarray(classes.leaf_diameter, np.float64).ravel()
    if not (np.isfinite(sizes).all() and sizes.min() > 0):
        raise InputError(f"`classes.leaf_diameter` must be positive lengths in m, but is {sizes}")
    owners = classes.size_of_class or (0,) * len(classes.angle_of_class)
    rng = np.random.default_rng(seed)
    made: list[Leaves] = []
    for owner, size in enumerate(owners):
        radius = 0.5 * sizes[size]
        cell = np.asarray(world.cell)
        expected = world.medium.area[..., owner] * cell.prod() / (np.pi * radius**2)
        number = rng.poisson(expected)
        voxel = np.repeat(np.argwhere(number > 0)[:, ::-1], number[number > 0], axis=0)
        count = len(voxel)
        centre = (voxel + rng.random((count, 3))) * cell
        cumulative = world.medium.cumulative[classes.angle_of_class[owner]]
        steps = np.arange(len(cumulative)) / (len(cumulative) - 1)
        # Flat stretches hold no leaves; the lowest of equal values is never drawn.
        inclination = 0.5 * np.pi * np.interp(rng.random(count), cumulative, steps)
        turn = 2 * np.pi * rng.random(count)
        sine = np.sin(inclination)
        normal = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.cos(inclination)], axis=1)
        made.append(Leaves(centre, normal, np.full(count, radius), np.full(count, owner)))
    return Leaves(*(np.concatenate(parts) for parts in zip(*made)))


def with_leaves(scene: VoxelScene, leaves: Leaves, band: int) -> World:
    """The scene with `leaves` in the place of its medium."""
    world = build_world(scene, band)
    centre = plain(leaves.centre).reshape(-1, 3)
    normal = plain(leaves.normal).reshape(-1, 3)
    radius = plain(leaves.radius)
    owner = plain(leaves.optical_class, np.int64)
    if len(owner) and not 0 <= owner.min() <= owner.max() < len(world.medium.rho):
        raise InputError(
            f"`leaves.optical_class` must name classes of the scene, 0 to "
            f"{len(world.medium.rho) - 1}, but runs from {owner.min()} to {owner.max()}"
        )
    half = radius[:, None] * np.sqrt(np.clip(1 - normal**2, 0.0, 1.0))
    low, high = np.zeros(3), np.array(world.high)
    if world.periodic:
        if len(radius) and 2 * radius.max() > high[:2].min():
            raise InputError(
                f"a periodic scene must be at least one leaf wide, but is {high[:2].min():g} m "
                f"wide, with leaves of {2 * radius.max():g} m"
            )
        for axis in range(2):
            # Copies of those that cross a side, where they come in again on the other.
            copies = []
            for sign, crosses in (
                (1.0, centre[:, axis] < half[:, axis]),
                (-1.0, centre[:, axis] > high[axis] - half[:, axis]),
            ):
                moved = centre[crosses].copy()
                moved[:, axis] += sign * high[axis]
                copies.append((moved, *(a[crosses] for a in (normal, half, radius, owner))))
            centre, normal, half, radius, owner = (
                np.concatenate([whole, *parts])
                for whole, *parts in zip((centre, normal, half, radius, owner), *copies)
            )
    elif len(radius):
        low[:2] = np.minimum(low[:2], (centre - half).min(axis=0)[:2])
        high[:2] = np.maximum(high[:2], (centre + half).max(axis=0)[:2])
    if len(radius):
        high[2] = max(high[2], (centre[:, 2] + half[:, 2]).max())
    edge = max(2 * radius.max() if len(radius) else high[2], 1e-6)
    edge = max(edge, ((high - low).prod() / _MOST_CELLS) ** (1 / 3))
    count = np.maximum(1, ((high - low) / edge).astype(int))
    cell = (high - low) / count
    first = np.clip(((centre - half - low) / cell).astype(int), 0, count - 1)
    last = np.clip(((centre + half - low) / cell).astype(int), 0, count - 1)
    number = _count(first, last, count)
    starts = np.concatenate([[0], np.cumsum(number)])
    member = _list(first, last, count, starts[:-1].copy(), int(starts[-1]))
    nx, ny, nz = (int(n) for n in count)
    as_point = lambda v: (float(v[0]), float(v[1]), float(v[2]))  # noqa: E731
    return world._replace(
        low=as_point(low),
        cell=as_point(cell),
        cells=(nx, ny, nz),
        high=as_point(high),
        discs=Discs(True, centre, normal, radius, owner, starts, member),
    )


@numba.njit
def _count(first: np.ndarray, last: np.ndarray, count: np.ndarray) -> np.ndarray:
    """How many discs reach each cell."""
    out = np.zeros(count[0] * count[1] * count[2], np.int64)
    for leaf in range(first.shape[0]):
        for k in range(first[leaf, 2], last[leaf, 2] + 1):
            for j in range(first[leaf, 1], last[leaf, 1] + 1):
                for i in range(first[leaf, 0], last[leaf, 0] + 1):
                    out[(k * count[1] + j) * count[0] + i] += 1
    return out


@numba.njit
def _list(
    first: np.ndarray, last: np.ndarray, count: np.ndarray, place: np.ndarray, total: int
) -> np.ndarray:
    """Which discs reach each cell, one cell's after another's."""
    out = np.empty(total, np.int64)
    for leaf in range(first.shape[0]):
        for k in range(first[leaf, 2], last[leaf, 2] + 1):
            for j in range(first[leaf, 1], last[leaf, 1] + 1):
                for i in range(first[leaf, 0], last[leaf, 0] + 1):
                    cell = (k * count[1] + j) * count[0] + i
                    out[place[cell]] = leaf
                    place[cell] += 1
    return out
