"""The oblique picture of a scene on ground that is not level, against what it should show."""

import numpy as np
import pytest

from fynjax.report.figures._scene import element_points
from fynjax.report.figures._scene_oblique import View, _relief, height_at
from fynjax.scene import Instances

EXTENT = (4.0, 2.0)
EAST, NORTH = 0.3, 0.1


def plane(x, y):
    return EAST * x + NORTH * y


def on_a_slope() -> tuple[Instances, np.ndarray]:
    """Two plants on a plane, and its height in cells of 10 cm."""
    x, y = np.array([1.0, 3.0]), np.array([0.5, 1.5])
    none = np.zeros(2)
    plants = Instances(
        ("a",), EXTENT, np.zeros(2, int), x, y, plane(x, y), none, none,
        np.array([0.3, 0.5]), np.array([0.8, 0.6]),
    )  # fmt: skip
    column, row = (np.arange(40) + 0.5) * 0.1, (np.arange(20) + 0.5) * 0.1
    return plants, plane(column, row[:, None])


def test_plants_are_drawn_where_they_stand():
    plants, _ = on_a_slope()
    place, _, _ = element_points(plants, ["rounded_shrub"], ["#1B7837"], 300.0)
    for one, points in enumerate(np.split(place, 2)):
        low, high = points[:, 2].min(), points[:, 2].max()
        height = plants.height[one]
        assert low == pytest.approx(plants.z[one], abs=0.15 * height)
        assert high == pytest.approx(plants.z[one] + height, abs=0.1 * height)


def test_the_ground_is_drawn_as_the_plane_that_it_is():
    plants, ground = on_a_slope()
    place, tint, width = _relief(plants, View(EXTENT, 2.0), ground, periodic=False)
    assert len(place) == len(tint) == len(width)
    x, y, z = place.astype(float).T
    inner = (x > 0.06) & (x < 3.94) & (y > 0.06) & (y < 1.94)
    np.testing.assert_allclose(z[inner], plane(x[inner], y[inner]), atol=1e-5)
    assert np.all(z <= plane(x, y) + 0.06)  # the faces hang below the edges
    beside = np.array([-1.0, 9.0])
    np.testing.assert_allclose(
        height_at(ground, EXTENT, beside, np.full(2, 1.0)), plane(np.array([0.05, 3.95]), 1.0)
    )
    assert np.all(height_at(None, EXTENT, x, y) == 0.0)
