"""Light of a flash LiDAR that is scattered more than once, against photons followed in time."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

from fynjax.sensors import lidar_waveforms
from tests.sensors.lidar_scenes import flash, patchy, scanner, slab

EXTENT = (0.4, 0.4)


def photons(lai, rho, tau, soil, count=60_000, seed=3):
    """Apparent reflectance, straight up, of all light but that scattered once, and the range below
    the top at which it seems to be.

    A slab 1 m high of evenly spread leaves whose normals point anywhere, lit from above.
    Independent of the package: followed one collision after another, each sends its share up.
    """
    draw = np.random.default_rng(seed)

    def cosine_lobe(normal):
        about = draw.normal(size=normal.shape)
        about /= np.linalg.norm(about, axis=1, keepdims=True)
        out = normal + about
        return out / np.linalg.norm(out, axis=1, keepdims=True)

    def leaf(towards):
        """Normals, anywhere, of the leaves that rays meet: in proportion to |normal . ray|."""
        cosine = np.sqrt(draw.random(count))[:, None]
        side = np.cross(towards, draw.normal(size=towards.shape))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        return cosine * towards + np.sqrt(1 - cosine**2) * side

    towards = np.tile([0.0, 0.0, -1.0], (count, 1))
    height, path, weight = np.ones(count), np.zeros(count), np.ones(count)
    energy, below = [], []
    for order in range(60):
        run = draw.exponential(2.0 / lai, count)
        to_ground = np.where(towards[:, 2] < 0, height / np.maximum(-towards[:, 2], 1e-12), np.inf)
        out = np.where(towards[:, 2] > 0, (1 - height) / np.maximum(towards[:, 2], 1e-12), np.inf)
        run = np.minimum(run, to_ground)
        ground, lost = run >= to_ground, run >= out
        weight = np.where(lost, 0.0, weight)
        height, path = height + run * towards[:, 2], path + run
        height = np.where(ground, 0.0, height)
        normal = leaf(towards)
        facing = -np.sign(np.sum(normal * towards, axis=1))[:, None] * normal
        up = facing[:, 2]
        sent = np.where(ground, soil, np.where(up > 0, rho * up, -tau * up))
        if order > 0:
            energy.append(weight * sent * np.exp(-0.5 * lai * (1 - height)))
            below.append(0.5 * (path + 1 - height))
        reflected = draw.random(count) < rho / (rho + tau)
        facing = np.where(
            ground[:, None], [0.0, 0.0, 1.0], np.where(reflected[:, None], facing, -facing)
        )
        weight = weight * np.where(ground, soil, rho + tau)
        towards = cosine_lobe(facing)
    return np.concatenate(energy) / count, np.concatenate(below)


@pytest.mark.parametrize(
    ("lai", "rho", "tau", "soil"), [(2.0, 0.45, 0.4, 0.3), (0.5, 0.4, 0.4, 0.6)]
)
def test_energy_and_delay_of_a_slab_are_those_of_photons(lai, rho, tau, soil):
    scene = slab(lai, rho=rho, tau=tau, ground=soil)
    lidar = dataclasses.replace(flash(), gate=(47.0, 62.0))
    beams = lidar.beams(EXTENT, top=scene.height)
    beams = beams.select(np.array([np.argmin(np.hypot(*(beams.on_ground - 0.2).T))]))
    late = lidar_waveforms(scene, lidar, beams).total[0]
    late = np.asarray(late - lidar_waveforms(scene, lidar, beams, multiple=False).total[0])
    energy, below = photons(lai, rho, tau, soil)
    assert late.sum() == pytest.approx(energy.sum(), rel=0.02)
    # The leaves begin 1 m above the ground, below two empty layers; the pulse and the samples blur.
    edges = 47.0 + np.arange(len(late) + 1) * lidar.sample - 49.0
    middle = 0.5 * (edges[1:] + edges[:-1])
    below = below + np.random.default_rng(1).normal(0.0, lidar.pulse_sd, below.shape)
    wanted = np.histogram(below, edges, weights=energy)[0] / energy.sum()
    found = late / late.sum()
    assert found @ middle == pytest.approx(wanted @ middle, rel=0.04)
    np.testing.assert_allclose(np.cumsum(found), np.cumsum(wanted), atol=0.05)


def test_leaves_that_are_hit_send_late_light_as_all_do_on_the_mean():
    scene, lidar = patchy(), flash()
    beams = lidar.beams((0.3, 0.3), top=scene.height)

    def late(key):
        whole = lidar_waveforms(scene, lidar, beams, key=key).total
        return np.asarray(
            whole - lidar_waveforms(scene, lidar, beams, key=key, multiple=False).total
        )

    mean = late(None).mean(axis=0)
    runs = np.stack([late(jax.random.key(k)).mean(axis=0) for k in range(8)])
    error = runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.all(np.abs(runs.mean(axis=0) - mean) < 5.0 * error + 1e-3 * mean.max())
    assert mean.sum() > 0.03


def test_scanners_are_left_without_it():
    scene, lidar = slab(), scanner()
    beams = lidar.beams((1.0, 1.0), top=scene.height)
    both = [lidar_waveforms(scene, lidar, beams, multiple=m).total for m in (True, False)]
    np.testing.assert_array_equal(*both)


def test_gradients_are_those_of_differences_and_finite_without_leaves():
    scene, lidar = patchy(), flash()
    beams = lidar.beams((0.3, 0.3), top=scene.height).select(np.arange(0, 49, 12))
    weight = np.random.default_rng(4).normal(size=(len(beams), beams.samples))
    optics = lambda s: (s.classes.reflectance, s.classes.transmittance, s.ground)  # noqa: E731

    def measure(density, *values):
        there = eqx.tree_at(optics, eqx.tree_at(lambda s: s.area_density, scene, density), values)
        return (weight * lidar_waveforms(there, lidar, beams).total).sum()

    slopes = jax.jit(jax.value_and_grad(measure, argnums=(0, 1, 2, 3)))
    at = scene.area_density, *optics(scene)
    gradient = slopes(*at)[1]
    for k in range(len(at)):
        turn = np.random.default_rng(k).uniform(0.5, 1.0, at[k].shape) * at[k]
        up, down = (
            slopes(*(v + s * 1e-4 * turn if i == k else v for i, v in enumerate(at)))[0]
            for s in (1.0, -1.0)
        )
        # The diffuse light is solved to 1e-4.
        assert float((gradient[k] * turn).sum()) == pytest.approx(float(up - down) / 2e-4, rel=2e-3)
    bare = slopes(0.0 * at[0], *at[1:])
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(bare))
