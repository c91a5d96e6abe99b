"""What rays meet first, against rays counted one by one, Beer's law and the image's own gap."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.math import mean_transmittance, transmittance_beyond
from fynjax.errors import InputError
from fynjax.radiation import (
    Accuracy,
    first_met,
    nadir_rays,
    parallel_rays,
    reflectance_factor,
    render,
    solve_light,
)
from tests import reference
from tests.radiation.scenes import patchy, slab, solver
from tests.radiation.test_monte_carlo import clumps

FINE = Accuracy(lattice=1, sublayers=4)
CENTRES = (np.arange(8) + 0.5) * 0.15
see = jax.jit(first_met, static_argnames=("accuracy", "together"))


@pytest.mark.parametrize("zenith", [0.0, 35.0])
def test_shares_are_those_of_rays_counted_one_by_one(zenith):
    scene = clumps("planophile", "spherical")
    rays = parallel_rays(CENTRES, CENTRES, 0.15, zenith, 120.0)
    middles = (np.arange(40) + 0.5) * 0.03  # 5 x 5 rays to a pixel
    many = parallel_rays(middles, middles, 0.03, zenith, 120.0)
    sight = see(clumps("planophile", "spherical", parts=5), many, FINE, together=5)
    got = np.concatenate([sight.canopy, sight.sunlit_ground[None], sight.shaded_ground[None]])
    np.testing.assert_allclose(got.sum(axis=0), 1.0, atol=1e-6)
    counted = reference.first_met(scene, rays, samples=4000, seed=3)
    assert counted.mean(axis=(1, 2)).min() > 0.05  # each of them is put to the test
    mean = counted.mean(axis=(1, 2))
    np.testing.assert_allclose(got.mean(axis=(1, 2)), mean, atol=0.006)
    # A pixel's count has a standard error of 0.008 at most.
    assert np.sqrt(np.mean((got - counted) ** 2)) < 0.03


def test_a_slab_of_two_kinds_is_met_by_beers_law_in_their_shares():
    whole = slab(1.0, [(0.1, 0.1, 0.2)], 30.0)
    first = whole.area_density
    scene = dataclasses.replace(
        whole,
        area_density=jnp.concatenate([first, 0.5 * first]),
        classes=dataclasses.replace(
            whole.classes,
            reflectance=whole.classes.reflectance.repeat(2, 0),
            transmittance=whole.classes.transmittance.repeat(2, 0),
            angle_of_class=(0, 0),
        ),
    )
    at = np.array([0.5, 1.5])
    sight = see(scene, nadir_rays(at, at, 0.5, (1.0, 1.0, 50.0)), FINE)
    hit = 1.0 - np.exp(-0.5 * 1.5)
    np.testing.assert_allclose(sight.canopy.mean(axis=(1, 2)), [hit * 2 / 3, hit / 3], rtol=1e-3)
    shaded = np.exp(-0.75) * (1.0 - np.exp(-0.75 / np.cos(np.deg2rad(30.0))))
    np.testing.assert_allclose(sight.shaded_ground, shaded, rtol=2e-3)


def test_the_ground_in_sight_is_the_gap_of_the_image_and_blocks_are_means():
    scene = clumps("planophile", "spherical")
    rays = nadir_rays(CENTRES, CENTRES, 0.15, (0.6, 0.6, 30.0))
    sight = see(scene, rays)
    gap = jax.jit(render)(solver(Accuracy())(scene), rays).gap
    np.testing.assert_allclose(sight.sunlit_ground + sight.shaded_ground, gap, atol=1e-6)
    blocks = see(scene, rays, together=2)
    means = np.asarray(sight.canopy).reshape(2, 4, 2, 4, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(blocks.canopy, means, atol=1e-6)
    with pytest.raises(InputError, match="must divide"):
        first_met(scene, rays, together=3)


def test_over_terrain_shares_sum_to_one():
    level = clumps("planophile", "spherical")
    hill = 0.4 * np.exp(-((np.arange(4) - 1.5) ** 2)) * np.ones((4, 1))
    scene = dataclasses.replace(level, terrain=jnp.asarray(hill))
    sight = see(scene, parallel_rays(CENTRES, CENTRES, 0.15, 20.0, 40.0))
    total = sight.canopy.sum(axis=0) + sight.sunlit_ground + sight.shaded_ground
    np.testing.assert_allclose(total, 1.0, atol=1e-6)
    assert (np.asarray(sight.shaded_ground) >= -1e-6).all()


def test_the_slope_is_that_of_differences():
    scene = clumps("planophile", "spherical")
    rays = nadir_rays(CENTRES, CENTRES, 0.15, (0.6, 0.6, 30.0))
    weight = np.random.default_rng(2).normal(size=(4, 8, 8))

    @jax.jit
    def shown(times):
        density = scene.area_density * jnp.stack([times, 1.0 + 0.0 * times])[:, None, None, None]
        sight = first_met(dataclasses.replace(scene, area_density=density), rays)
        ground = jnp.stack([sight.sunlit_ground, sight.shaded_ground])
        return jnp.sum(weight * jnp.concatenate([sight.canopy, ground]))

    step = 1e-4
    difference = (shown(1.0 + step) - shown(1.0 - step)) / (2 * step)
    assert jax.grad(shown)(1.0) == pytest.approx(float(difference), rel=1e-5)


def test_rays_that_step_out_of_a_shadow_are_right_and_stay_finite_in_single_precision():
    """Beside a dense crown in a low sun the joint depth of sun and sight falls along a ray. The
    closed form agrees with three points of each piece, and holds where it falls by thousands."""
    scene = patchy(sun=(85.0, 80.0), boundary="open")
    accuracy = Accuracy(lattice=1, margin=50)
    image = jax.jit(lambda scene, rays: reflectance_factor(solve_light(scene, accuracy), rays))
    rays = parallel_rays(CENTRES, CENTRES, 0.05, 30.0, 120.0)

    def seen(density, diameter, dtype):
        dense = scene.area_density.at[:, :, :, :4].set(density).at[:, :, :, 4:].set(0.5)
        classes = scene.classes
        if diameter is not None:
            classes = dataclasses.replace(
                classes, leaf_diameter=jnp.array([diameter]), size_of_class=(0, 0, 0)
            )
        beside = dataclasses.replace(scene, area_density=dense, classes=classes)
        cast = lambda x: x.astype(dtype) if x.dtype == jnp.float64 else x  # noqa: E731
        return np.asarray(image(*jax.tree.map(cast, (beside, rays))))

    np.testing.assert_allclose(seen(4.0, None, jnp.float64), seen(4.0, 0.0, jnp.float64), rtol=2e-3)
    for diameter in (None, 0.02):
        deep, single = (seen(3000.0, diameter, d) for d in (jnp.float64, jnp.float32))
        assert single.dtype == np.float32
        np.testing.assert_allclose(single, deep, rtol=1e-3, atol=1e-6)


def test_light_beyond_a_depth_has_right_slopes_of_any_order():
    before, depths = jnp.asarray(3.0), jnp.array([-2.5, -1e-3, 0.0, 0.02, 4.0])
    orders = [lambda x: transmittance_beyond(before, x)]
    plain = [lambda x: jnp.exp(-before) * mean_transmittance(x)]
    for _ in range(2):
        orders.append(jax.grad(orders[-1]))
        plain.append(jax.grad(plain[-1]))
    for stable, direct in zip(orders, plain):
        np.testing.assert_allclose(jax.vmap(stable)(depths), jax.vmap(direct)(depths), rtol=1e-6)
