"""A plot whose ground is known: a slope with waves, and shrubs of known outline on it."""

import sys

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fynjax.app.terrain import PointCloud

needs_cloth = pytest.mark.skipif(
    sys.version_info >= (3, 13), reason="cloth-simulation-filter has no wheel for this Python"
)
"""Elsewhere it is among the tests' dependencies: its absence is a failure."""

CORNER = (412300.0, 6191200.0)
"""South-west corner, as in UTM zone 34 south [m]."""
SIDE = 30.0
SLOPE = (0.24, -0.1)


def ground_height(x, y):
    """Height of the ground [m] in closed form."""
    east, north = np.asarray(x) - CORNER[0], np.asarray(y) - CORNER[1]
    waves = 0.3 * np.sin(2.0 * np.pi * east / 17.0) * np.cos(2.0 * np.pi * north / 13.0)
    return 350.0 + SLOPE[0] * east + SLOPE[1] * north + waves


def shrubland(density=50.0, noise=0.02, seed=0):
    """A cloud of shrubland, labelled, and the truth: which points are ground.

    Shrubs are domes of 0.3 to 1.3 m radius on half of the area, through which 3 % of the points
    reach the ground.
    """
    rng = np.random.default_rng(seed)
    n = int(density * SIDE**2)
    x, y = (rng.uniform(0.0, SIDE, n) for _ in range(2))
    top = np.zeros(n)
    tree = cKDTree(np.stack([x, y], axis=1))
    for _ in range(int(0.4 * SIDE**2)):
        middle, radius = rng.uniform(0.0, SIDE, 2), rng.uniform(0.3, 1.3)
        height = radius * rng.uniform(0.6, 1.4)
        near = np.array(tree.query_ball_point(middle, radius), int)
        away = ((x[near] - middle[0]) ** 2 + (y[near] - middle[1]) ** 2) / radius**2
        top[near] = np.maximum(top[near], height * np.sqrt(np.maximum(1.0 - away, 0.0)))
    ground = (top == 0.0) | (rng.random(n) < 0.03)
    x, y = x + CORNER[0], y + CORNER[1]
    height = np.where(ground, 0.0, top * rng.uniform(0.6, 1.0, n))
    z = ground_height(x, y) + height + rng.normal(0.0, noise, n)
    labels = np.where(ground, 2, 3).astype(np.uint8)
    return PointCloud(x, y, z, labels), ground
