"""Late returns misclassified as ground: noise below it."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from fynjax.app.terrain import PointCloud

_NEIGHBOURS = 16
_OF_ONE_KIND = 3
"""So many neighbours at a point's own level make it part of a ditch and no noise."""
_BLOCK = 20_000
_ROUNDS = 50

_Mask = Bool[np.ndarray, " point"]
_Points = Float[np.ndarray, "point 3"]


def without_pits(cloud: PointCloud, ground: _Mask, depth: float) -> _Mask:
    """Ground without points more than `depth` [m] below the median of the ground around them.

    Levels are compared along the slope of the ground around. What is found is taken away and the
    rest compared again, until nothing is, so that two such points near each other do not hide one
    another. A point with three neighbours at its own level stays: the floor of a ditch.
    """
    which = np.flatnonzero(ground)
    if len(which) <= _NEIGHBOURS:
        return ground
    points = np.stack([cloud.x, cloud.y, cloud.z], axis=1)[which]
    points -= points.mean(axis=0)
    # Without the slope of the whole, the foot of a step is level with its neighbours below.
    points[:, 2] = _levelled(points[None])[0]
    left = np.arange(len(points))
    near = _nearest(points, left)
    # Noise is lonely among all points, before any went; the floor of a ditch is not.
    suspect = ~_has_company(points[near, 2] - points[:, 2, None], depth)
    index = np.flatnonzero(suspect)
    suspect[index] = ~_has_company(_levels(points, index, near[index]), depth)
    for _ in range(_ROUNDS):
        index = np.flatnonzero(suspect[left])
        if len(left) <= _NEIGHBOURS or not index.size:
            break
        levels = _levels(points[left], index, _nearest(points[left], index))
        pit = index[np.median(levels, axis=1) > depth]
        if not pit.size:
            break
        left = np.delete(left, pit)
    kept = np.zeros_like(ground)
    kept[which[left]] = True
    return kept


def _has_company(levels: Float[np.ndarray, "one near"], depth: float) -> _Mask:
    return np.asarray((np.abs(levels) <= depth).sum(axis=1) >= _OF_ONE_KIND)


def sunk(cloud: PointCloud, ground: _Mask, depth: float) -> _Mask:
    """Points more than `depth` [m] below the ground around them."""
    which = np.flatnonzero(ground)
    pits = np.zeros(len(cloud), bool)
    if len(which) <= _NEIGHBOURS:
        return pits
    points = np.stack([cloud.x, cloud.y, cloud.z], axis=1)
    points -= points.mean(axis=0)
    floor = points[which]
    tree = cKDTree(floor[:, :2])
    other = np.flatnonzero(~ground)
    # Most points are plants, above every ground point near them.
    _, near = tree.query(points[other, :2], k=4)
    other = other[points[other, 2] < floor[near, 2].max(axis=1) - depth]
    for start in range(0, len(other), _BLOCK):
        part = other[start : start + _BLOCK]
        _, near = tree.query(points[part, :2], k=_NEIGHBOURS)
        levels = _levelled(floor[near] - points[part][:, None])
        pits[part] = np.median(levels, axis=1) > depth
    return pits


def _nearest(points: _Points, index: Int[np.ndarray, " one"]) -> Int[np.ndarray, "one near"]:
    """Numbers of the points nearest in place to some of them, without themselves."""
    _, near = cKDTree(points[:, :2]).query(points[index, :2], k=_NEIGHBOURS + 1)
    self = near == index[:, None]
    self[~self.any(axis=1), -1] = True  # of points in one place any may be the first
    return near[~self].reshape(len(index), _NEIGHBOURS)


def _levels(
    points: _Points, index: Int[np.ndarray, " one"], near: Int[np.ndarray, "one near"]
) -> Float[np.ndarray, "one near"]:
    """How far above a point its neighbours are [m], without the slope of the ground."""
    if not index.size:
        return np.zeros((0, _NEIGHBOURS))
    return np.concatenate(
        [
            _levelled(points[near[i : i + _BLOCK]] - points[index[i : i + _BLOCK]][:, None])
            for i in range(0, len(index), _BLOCK)
        ]
    )


def _levelled(away: Float[np.ndarray, "one near 3"]) -> Float[np.ndarray, "one near"]:
    """Height differences [m] without a plane's slope: the plane of least absolute deviation."""
    z = away[..., 2]
    sides = np.concatenate([np.ones_like(away[..., :1]), away[..., :2]], axis=-1)
    scale = np.maximum(np.abs(away[..., :2]).max(axis=(1, 2)), 1e-9)
    sides[..., 1:] /= scale[:, None, None]
    weight = np.ones_like(z)
    # A little towards level, so that neighbours on a line have a plane too.
    ridge = np.diag([0.0, 1e-3, 1e-3]) * away.shape[1]
    for _ in range(15):
        weighted = sides * weight[..., None]
        normal = (
            np.einsum("nki,nkj->nij", weighted, sides) + ridge * weight.mean(axis=1)[:, None, None]
        )
        right = np.einsum("nki,nk->ni", weighted, z)
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        weight = 1.0 / np.maximum(np.abs(z - np.einsum("nki,ni->nk", sides, plane)), 0.02)
    return z - np.einsum("nki,ni->nk", sides[..., 1:], plane[:, 1:])
