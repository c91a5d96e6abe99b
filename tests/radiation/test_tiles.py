"""A scene rendered in tiles, and by several devices, against the solve of the whole."""

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import (
    Accuracy,
    cut_cells,
    nadir_rays,
    parallel_rays,
    render,
    render_tiles,
    solve_light,
    tile_picture,
)
from tests.radiation.scenes import patchy

ACCURACY = Accuracy(levels=1, azimuths=4, refine=False, margin=6)
SCENE = {"shape": (4, 24, 24), "sky": (0.2, 0.1)}


X = (jnp.arange(24) + 0.5) * 0.1
RAYS = nadir_rays(X, X, 0.1, (1.0, 1.3, 3.0))


@pytest.fixture(scope="module")
def repeated():
    """Light of a scene that repeats itself."""
    return jax.jit(lambda s: solve_light(s, ACCURACY))(patchy(**SCENE))


def test_tiles_make_the_same_picture():
    """Of ten pixels, which do not divide the 24; from so low that rays cross several voxels, over
    an open hill. The derivative of their brightness in the depth of the shade is that of
    differences."""
    scene = patchy("open", **SCENE)
    hill = 0.02 * jnp.hypot(*jnp.mgrid[-12:12, -12:12])
    scene = eqx.tree_at(lambda s: s.terrain, scene, hill, is_leaf=lambda v: v is None)
    light = jax.jit(lambda s: solve_light(s, ACCURACY))(scene)
    tiling = tile_picture(light, RAYS, 10)
    assert tiling.shape == (3, 3)
    assert tiling.pixels(0, 2) == (slice(0, 10), slice(14, 24))

    def tiles(by):
        deeper = eqx.tree_at(lambda at: at.sun.depth, light, light.sun.depth * (1.0 + by))
        made = render_tiles(deeper, RAYS, tiling)
        return jnp.sum(made.total**2), made

    tiles = jax.jit(jax.value_and_grad(tiles, has_aux=True))
    (_, made), slope = tiles(0.0)
    whole = jax.jit(lambda at: render(at, RAYS))(light)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12), made, whole)
    difference = (tiles(1e-6)[0][0] - tiles(-1e-6)[0][0]) / 2e-6
    assert float(slope) == pytest.approx(float(difference), rel=1e-4)


def test_a_scene_that_repeats_itself_has_no_edge(repeated):
    """Pixels beyond the scene are those of its other side."""
    shown = jax.jit(lambda at, rays, tiling: render_tiles(at, rays, tiling).total, static_argnums=2)
    here, there = (
        shown(repeated, rays, tile_picture(repeated, rays))
        for rays in (parallel_rays(X + by, X, 0.1, 30.0, 40.0) for by in (0.0, -2.4))
    )
    np.testing.assert_allclose(there, here, rtol=1e-9)


def test_what_has_no_tiles(repeated):
    reduced = eqx.tree_at(lambda at: at.diffuse, repeated, None)
    with pytest.raises(InputError, match="render fewer bands at once"):
        tile_picture(reduced, RAYS)
    with pytest.raises(InputError, match="outside the transformation"):
        jax.eval_shape(lambda at: render_tiles(at, RAYS), repeated)


def test_windows_under_a_low_sun_stay_wider_than_their_rims(monkeypatch):
    """However little is to be held: a tile of one cell would need almost the rim of the whole."""
    scene = patchy(**SCENE, sun=(85.0, 40.0))
    tiling = cut_cells(scene, ACCURACY, held=1)
    assert tiling.shape == (2, 2)
    assert tiling.voxels(scene) > scene.area_density[0].size
    monkeypatch.setattr("fynjax.radiation._check._memory", lambda: 4 * tiling.voxels(scene))
    with pytest.raises(InputError, match="GiB"):
        cut_cells(scene, ACCURACY, held=1)


DEVICES = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from fynjax.radiation import render_tiles, solve_light, tile_picture
from tests.radiation.scenes import patchy
from tests.radiation.test_tiles import ACCURACY, RAYS, SCENE
assert len(jax.devices()) == 4
mesh = jax.make_mesh((4,), ("tile",))
light = jax.jit(lambda s: solve_light(s, ACCURACY))(patchy(**SCENE))
tiling = tile_picture(light, RAYS, 12)
one, four = (
    np.asarray(jax.jit(lambda at, m=m: render_tiles(at, RAYS, tiling, mesh=m).total)(light))
    for m in (None, mesh)
)
np.testing.assert_allclose(four, one, rtol=1e-10)
print("same")
"""


@pytest.mark.slow
def test_four_devices_make_the_same_picture():
    environment = {
        **os.environ,
        "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=4",
    }
    done = subprocess.run(
        [sys.executable, "-c", DEVICES],
        cwd=Path(__file__).parents[2],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.strip() == "same", done.stderr[-2000:]
