"""A scene rendered in tiles, and by several devices, against the solve of the whole."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import Accuracy, parallel_rays, render, render_tiles, solve_light
from tests.radiation.scenes import patchy

ACCURACY = Accuracy(levels=1, refine=False, margin=6)
SCENE = {"shape": (4, 24, 24), "sky": (0.2, 0.1)}


def rays():
    x = (jnp.arange(24) + 0.5) * 0.1
    return parallel_rays(x, x, 0.1, jnp.array(10.0), jnp.array(40.0))


def test_tiles_make_the_same_picture():
    """A rim of three times the height leaves 0.3 % RMS of the mean; a rim of nothing, far more."""
    scene = patchy("open", **SCENE)
    whole = np.asarray(jax.jit(lambda s: render(solve_light(s, ACCURACY), rays()).total)(scene))
    errors = {}
    for rim in (0, 12):
        tiled = jax.jit(
            lambda s, rim=rim: render_tiles(s, rays(), ACCURACY, tile=12, rim=rim).total
        )
        error = np.asarray(tiled(scene)) - whole
        errors[rim] = np.sqrt((error**2).mean(axis=(1, 2))) / whole.mean(axis=(1, 2))
    print(errors)
    assert np.all(errors[12] < 0.004)
    assert np.all(errors[0] > 5 * errors[12])


def test_tiles_that_do_not_fit():
    scene = patchy(**SCENE)
    with pytest.raises(InputError, match=r"`tile`.* 7 .*24 voxels along y"):
        render_tiles(scene, rays(), ACCURACY, tile=7)
    x = (jnp.arange(25) + 0.5) * 0.1
    with pytest.raises(InputError, match=r"25 along y .*2 tiles"):
        render_tiles(scene, parallel_rays(x, x, 0.1, 0.0, 0.0), ACCURACY, tile=12, rim=4)


DEVICES = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from fynjax.radiation import render_tiles
from tests.radiation.scenes import patchy
from tests.radiation.test_tiles import ACCURACY, SCENE, rays
assert len(jax.devices()) == 4
HOW = {"accuracy": ACCURACY, "tile": 12, "rim": 4}
mesh = jax.make_mesh((4,), ("tile",))
scene = patchy(**SCENE)
one, four = (
    np.asarray(jax.jit(lambda s, m=m: render_tiles(s, rays(), mesh=m, **HOW).total)(scene))
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
