"""How plants are turned and lean: geometry by hand, areas, common random numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import instance_area, plant_model, random_orientation, unit_shapes
from tests.helpers import assert_gradients


def placed(position, azimuth, tilt, diameter=1.0, height=1.0, numpy=np):
    """Elements [element, 3] of one plant at the origin."""
    turn, lean = (numpy.asarray([angle]) for angle in (azimuth, tilt))
    across, along = unit_shapes(position, turn, lean, numpy)
    return (diameter * across + height * along)[0]


POINTS = np.array([[0.0, 0.5, 0.5], [0.0, 0.0, 1.0], [0.5, 0.0, 0.0]])
"""At the north rim, at the top, at the east rim."""


@pytest.mark.parametrize("numpy", [np, jnp])
def test_azimuth_turns_clockwise_from_north_and_tilt_leans_there(numpy) -> None:
    at = placed(numpy.asarray(POINTS), 90.0, 0.0, 2.0, 3.0, numpy)
    np.testing.assert_allclose(at, [[1, 0, 1.5], [0, 0, 3], [0, -1, 0]], atol=1e-12)
    at = placed(numpy.asarray(POINTS), 90.0, 30.0, 2.0, 3.0, numpy)
    np.testing.assert_allclose(at[1], [1.5, 0, 3 * np.sqrt(0.75)], atol=1e-12)
    # How far a tilt reaches sideways is what eq. (5) adds to the crown's radius.
    reach = float(jnp.sqrt(instance_area(2.0, 3.0, rotation_spread=30.0) / jnp.pi)) - 1.0
    assert float(at[1, 0]) == pytest.approx(reach)


def test_turning_and_leaning_keep_distances() -> None:
    position = np.asarray(plant_model("broad_leaved", 20, seed=0).position)
    distance = lambda p: np.linalg.norm(p[:, None] - p[None], axis=-1)  # noqa: E731
    np.testing.assert_allclose(
        distance(placed(position, 77.0, 25.0)), distance(position), atol=1e-12
    )


def test_places_are_differentiable() -> None:
    position = jnp.asarray(POINTS)
    assert_gradients(
        jax.jit(lambda x: placed(position, x[0], x[1], x[2], x[3], jnp).ravel()),
        jnp.array([77.0, 25.0, 0.43, 0.71]),
    )


def test_random_orientation() -> None:
    azimuth, tilt = random_orientation(4000, seed=1, rotation_spread=10.0)
    assert azimuth.min() >= 0.0
    assert azimuth.max() < 360.0
    counts, _ = np.histogram(azimuth, 8, (0, 360))
    assert np.abs(counts - 500).max() < 4 * np.sqrt(500)
    assert np.sqrt(np.mean(tilt**2)) == pytest.approx(10.0, rel=0.04)
    np.testing.assert_array_equal(azimuth[:7], random_orientation(7, seed=1)[0])
    np.testing.assert_array_equal(random_orientation(7, seed=1)[1], 0.0)
