"""Sun on bare ground that is not level: Lambert's cosine, and shadows where walls throw them."""

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation._terrain import sun_on_ground
from tests.radiation.scenes import patchy, towards
from tests.radiation.test_monte_carlo_reference import with_fields


def sunlit(heights, width, zenith, azimuth):
    scene = with_fields(
        patchy("open"),
        terrain=jnp.asarray(heights),
        area_density=jnp.zeros((3, 4, *np.shape(heights))),
        horizontal=width,
    )
    return np.asarray(sun_on_ground(scene, jnp.asarray(towards(zenith, azimuth)), 20))


@pytest.mark.parametrize("width", [0.2, 0.05])
@pytest.mark.parametrize("share", [-0.5, 0.0, 0.5, 0.75, 0.85, 0.95, 1.05])
def test_a_plane_does_not_shade_itself(width, share):
    """Slopes turned from a low sun by that share of the tangent of its height."""
    zenith, azimuth = 75.0, 40.0
    sunward = towards(zenith, azimuth)
    gradient = share * sunward[2] * sunward[:2] / (sunward[:2] @ sunward[:2])  # of the height
    y, x = np.meshgrid((np.arange(24) + 0.5) * width, (np.arange(24) + 0.5) * width, indexing="ij")
    got = sunlit(20.0 + gradient[0] * x + gradient[1] * y, width, zenith, azimuth)
    inner = got[2:-2, 2:-2]
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    want = max(normal @ sunward, 0.0) / np.linalg.norm(normal) / sunward[2]
    np.testing.assert_allclose(inner, want, atol=1e-9)


@pytest.mark.parametrize("width", [0.25, 0.1])
def test_a_wall_throws_a_shadow_of_its_height(width):
    """3 m of ground behind a wall 1 m high, sun at 45 degrees in the west."""
    heights = np.zeros((8, round(5 / width)))
    heights[:, : round(1 / width)] = 1.0
    lit = sunlit(heights, width, 45.0, 270.0)[4]
    beyond = (np.arange(lit.size) + 0.5) * width - 1.0
    np.testing.assert_allclose(lit[(beyond > width) & (beyond < 1 - width)], 0.0, atol=1e-9)
    np.testing.assert_allclose(lit[beyond > 1 + width], 1.0, atol=1e-9)
