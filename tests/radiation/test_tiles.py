"""A picture whose rows are followed one after another, against the picture in one piece."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation import Accuracy, nadir_rays, reflectance_factor, render, solve_light
from tests.radiation.scenes import patchy

ACCURACY = Accuracy(levels=1, azimuths=4, refine=False, margin=6)
SCENE = {"shape": (4, 24, 24), "sky": (0.2, 0.1)}


X = (jnp.arange(24) + 0.5) * 0.1
RAYS = nadir_rays(X, X, 0.1, (1.0, 1.3, 3.0))


def test_rows_make_the_same_picture(monkeypatch):
    """From so low that rays cross several voxels, over an open hill. The derivative of their
    brightness in the depth of the shade is that of differences."""
    scene = patchy("open", **SCENE)
    hill = 0.02 * jnp.hypot(*jnp.mgrid[-12:12, -12:12])
    scene = eqx.tree_at(lambda s: s.terrain, scene, hill, is_leaf=lambda v: v is None)
    light = jax.jit(lambda s: solve_light(s, ACCURACY))(scene)
    whole = jax.jit(lambda at: render(at, RAYS))(light)
    monkeypatch.setattr("fynjax.radiation._image.MOST_RAYS", 10 * 24 + 5)

    def rows(by):
        deeper = eqx.tree_at(lambda at: at.sun.depth, light, light.sun.depth * (1.0 + by))
        made = render(deeper, RAYS)
        return jnp.sum(made.total**2), made

    rows = jax.jit(jax.value_and_grad(rows, has_aux=True))
    (_, made), slope = rows(0.0)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12), made, whole)
    difference = (rows(1e-6)[0][0] - rows(-1e-6)[0][0]) / 2e-6
    assert float(slope) == pytest.approx(float(difference), rel=1e-4)


def test_rows_make_the_same_blocks(monkeypatch):
    light = jax.jit(lambda s: solve_light(s, ACCURACY))(patchy(**SCENE))
    show = lambda at: reflectance_factor(at, RAYS, together=4)  # noqa: E731
    whole = jax.jit(show)(light)
    monkeypatch.setattr("fynjax.radiation._image.MOST_RAYS", 10 * 24 + 5)
    np.testing.assert_allclose(jax.jit(lambda at: show(at))(light), whole, rtol=1e-9)
