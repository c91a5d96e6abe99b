"""Paths of light among explicit leaves: their places, their shadows, and their hot spot."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import leaf_angle
from fynjax.radiation import VoxelScene, parallel_rays
from tests import reference
from tests.radiation.scenes import patchy, slab, spherical_gamma, views_of_reference
from tests.radiation.test_monte_carlo_reference import SIGMA, assert_close, with_fields


def leafy(lai, optics, zenith, diameter=0.1, width=4.0, empty=0.0):
    """A slab of 2 m with leaves of a size, over `empty` metres without."""
    below, count = round(empty / 0.5), round(width / 0.5)
    scene = slab(lai, [optics], zenith)
    density = jnp.full((1, 4 + below, count, count), lai / 2.0).at[:, :below].set(0.0)
    classes = with_fields(scene, classes__leaf_diameter=jnp.array([diameter])).classes
    return VoxelScene(density, classes, scene.ground, scene.illumination, 0.5, 0.5)


def test_leaves_are_those_of_the_density():
    scene = with_fields(patchy(size=1.0), classes__leaf_diameter=jnp.array([0.05]))
    leaves = reference.discs(scene, 0)
    density = np.asarray(scene.area_density)
    k, j, i = np.floor(leaves.centre).astype(int).T[::-1]
    area = np.zeros_like(density)
    np.add.at(area, (leaves.optical_class, k, j, i), np.pi * leaves.radius**2)
    each = np.pi * 0.025**2
    assert np.all(area[density == 0] == 0)
    excess = (area - density)[density > 0] / np.sqrt(density[density > 0] * each)
    np.testing.assert_allclose([excess.mean(), excess.std()], [0, 1], atol=0.35)
    np.testing.assert_allclose(np.linalg.norm(leaves.normal, axis=1), 1.0, rtol=1e-12)
    flat = np.abs(leaves.normal[leaves.optical_class == 0, 2])
    want = float(leaf_angle("planophile").projection(jnp.array(1.0)))
    np.testing.assert_allclose(flat.mean(), want, atol=4 * flat.std() / len(flat) ** 0.5)


@pytest.mark.parametrize("corner", [0.0, 0.4])
def test_shadow_of_one_leaf(corner):
    """A level leaf hides its own area, also when it crosses the corner of a periodic scene."""
    scene = leafy(1.0, (0.0, 0.0, 0.5), 50.0, width=1.0)
    leaf = reference.Leaves(
        np.array([[corner, corner, 1.2]]), np.array([[0.0, 0, 1]]), np.array([0.3]), np.array([0])
    )
    found = reference.disc_fluxes(scene, leaf, photons=100_000, seed=1, band=0)
    assert_close(found.transmitted_direct, 1 - np.pi * 0.09)
    # In an open scene the leaf sticks out, and still nothing is lost.
    found = reference.disc_fluxes(
        with_fields(scene, boundary="open"), leaf, photons=100_000, seed=1, band=0
    )
    parts = (found.albedo, found.absorbed, found.ground_absorbed, found.sides)
    noise = np.sqrt(sum(np.sum(part.error**2) for part in parts))
    total = sum(np.sum(part.mean) for part in parts)
    np.testing.assert_allclose(total, 1.0, atol=SIGMA * noise)


def test_hot_spot_in_closed_form():
    """Looking along the sun's rays, every lit leaf is seen and no other: the gap counts once."""
    rho, tau, lai = 4e-3, 1e-3, 2.0
    scene = leafy(lai, (rho, tau, 0.0), 30.0, empty=0.5)
    layouts = [
        reference.disc_reflectance(
            scene, reference.discs(scene, s), 30.0, 270.0, photons=20_000, seed=s, band=0
        ).mean[0]
        for s in range(8)
    ]
    cosine = np.cos(np.deg2rad(30.0))
    k = 0.5 / cosine
    want = spherical_gamma(np.pi, rho, tau) / cosine**2 * -np.expm1(-k * lai) / k
    error = np.std(layouts, ddof=1) / 8**0.5
    assert error < 0.01 * want
    np.testing.assert_allclose(np.mean(layouts), want, atol=SIGMA * error, rtol=3e-3)


def test_paths_among_leaves_agree_both_ways():
    scene = leafy(2.0, (0.45, 0.4, 0.2), 30.0, width=1.0)
    leaves = reference.discs(scene, 5)
    forward = reference.disc_reflectance(
        scene, leaves, [20.0], [250.0], photons=50_000, seed=0, band=0
    )
    x = (jnp.arange(10) + 0.5) * 0.1
    pixels = reference.disc_image(
        scene, leaves, parallel_rays(x, x, 0.1, 20.0, 250.0), samples=500, seed=1, band=0
    )
    noise = np.sqrt((pixels.error**2).sum()) / pixels.mean.size
    assert_close(forward, pixels.mean.mean(), atol=SIGMA * noise)


@pytest.mark.study
@pytest.mark.parametrize("index", [0, 1], ids=["near infrared", "red"])
def test_disc_slab_of_another_code(shared_data, index):
    """The Eradiate kernel among 240,000 discs; here the mean of smaller boxes, drawn anew."""
    with open(shared_data / "rt" / "disc_canopies.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][index]
    optics = case["optics"]
    scene = leafy(3.0, tuple(optics[n] for n in ("rho", "tau", "soil")), case["sza"], width=5.0)
    views = views_of_reference([(v, 0) for v in case["vz"]])
    runs = np.array(
        [
            reference.disc_reflectance(
                scene, reference.discs(scene, s), *views, photons=20_000, seed=s, band=0
            ).mean
            for s in range(6)
        ]
    )
    error = np.hypot(runs.std(axis=0, ddof=1) / 6**0.5, case["brf_se"])
    off = runs.mean(axis=0) / np.array(case["brf"]) - 1
    print("off %", np.round(100 * off, 2), "noise %", np.round(100 * error / case["brf"], 2))
    assert np.abs(off).max() < 0.03
    assert np.all(np.abs(off) < SIGMA * error / case["brf"] + 5e-3)
