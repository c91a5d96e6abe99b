"""`vmap` over scenes equals a loop, and equal shapes compile once."""

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.radiation import Accuracy, fluxes, nadir_rays, reflectance_factor, solve_light
from tests.radiation.scenes import patchy

RAYS = nadir_rays(jnp.linspace(0.05, 0.75, 4), jnp.linspace(0.05, 0.55, 3), 0.1, (0.4, 0.3, 5.0))
SCENES = [patchy(seed=seed, sun=(20.0 + 15 * seed, 80.0 * seed)) for seed in range(3)]


def both(scene):
    light = solve_light(scene, Accuracy(levels=2, refine=False, tolerance=1e-6))
    return reflectance_factor(light, RAYS), fluxes(light)


def test_many_scenes_at_once():
    compiled = jax.jit(both)
    loop = [compiled(scene) for scene in SCENES]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *SCENES)
    together = jax.jit(jax.vmap(both))(stacked)
    for index, one in enumerate(loop):
        for got, want in zip(jax.tree.leaves(together), jax.tree.leaves(one), strict=True):
            # Both stop at the same residual, on sums taken in another order.
            np.testing.assert_allclose(got[index], want, rtol=1e-10, atol=1e-13)


def test_scenes_of_equal_shape_share_one_compilation():
    traces = []

    @jax.jit
    def counted(scene):
        traces.append(scene.boundary)
        return solve_light(scene, Accuracy(levels=1, refine=False, margin=4)).diffuse.top

    for boundary in ("periodic", "periodic", "periodic"):
        counted(patchy(boundary, seed=len(traces), sun=(10.0 + len(traces), 5.0)))
    counted(patchy(seed=7))
    assert traces == ["periodic"]
    counted(patchy("open"))
    assert traces == ["periodic", "open"]
