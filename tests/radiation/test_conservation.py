"""Laws that hold whatever the canopy: energy, the white furnace, reciprocity, an empty scene."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation import Accuracy, nadir_rays, parallel_rays, reflectance_factor, render
from tests.radiation.scenes import closure, fluxes_of, patchy, reflectance_of, solver

CELLS = Accuracy(coarsening=(1, 1), levels=2, tolerance=1e-7, margin=6)
MANY = Accuracy(lattice=4, sublayers=6, coarsening=(1, 1), levels=6, azimuths=12, tolerance=1e-7)
BLOCKS = Accuracy(coarsening=(2, 2), levels=2, tolerance=1e-7, margin=6)
X, Y = jnp.linspace(0.02, 0.78, 9), jnp.linspace(0.03, 0.57, 7)


CAMERA = nadir_rays(X, Y, 0.05, (0.4, 0.3, 3.0))
see = jax.jit(render)
photograph = jax.jit(reflectance_factor)


def camera_factor(light):
    return photograph(light, CAMERA)


def white(scene, sun):
    """`scene` with leaves and soil that lose nothing."""
    rho = scene.classes.reflectance
    ones = jnp.ones(2)
    return eqx.tree_at(
        lambda s: (s.classes.transmittance, s.ground, s.illumination.sun, s.illumination.sky),
        scene,
        (1.0 - rho, jnp.ones_like(scene.ground), ones * sun, ones * (1 - sun)),
    )


@pytest.mark.parametrize("accuracy", [CELLS, BLOCKS], ids=["cells", "blocks"])
@pytest.mark.parametrize("seed", [0, 1])
def test_energy_closes(accuracy, seed):
    """Albedo + leaves + soil = 1: three classes, two distributions, sun and sky, soil map."""
    np.testing.assert_allclose(closure(solver(accuracy)(patchy(seed=seed))), 1.0, atol=1e-5)


def test_energy_closes_with_finer_beams_and_a_low_sun():
    accuracy = Accuracy(lattice=3, sublayers=4, coarsening=(1, 2), levels=3, tolerance=1e-7)
    np.testing.assert_allclose(closure(solver(accuracy)(patchy(sun=(72.0, 200.0)))), 1.0, atol=1e-5)


def test_black_classes_absorb_and_lossless_ones_do_not():
    scene = patchy()
    rho = jnp.array([[0.6, 0.2], [0.0, 0.0], [0.3, 0.1]])
    tau = jnp.array([[0.4, 0.8], [0.0, 0.0], [0.0, 0.0]])
    scene = eqx.tree_at(
        lambda s: (s.classes.reflectance, s.classes.transmittance), scene, (rho, tau)
    )
    absorbed = np.asarray(fluxes_of(solver(CELLS)(scene)).absorbed)
    np.testing.assert_allclose(absorbed[:, 0], 0.0, atol=1e-12)
    assert np.all(absorbed[:, 1:] > 0.01)


@pytest.mark.parametrize("accuracy", [CELLS, BLOCKS], ids=["cells", "blocks"])
def test_white_furnace(accuracy):
    """Nothing absorbs, so everything comes back, whatever the sun and the sky bring."""
    light = solver(accuracy)(white(patchy(), 0.7))
    flux = fluxes_of(light)
    np.testing.assert_allclose(flux.albedo, 1.0, atol=1e-4)
    np.testing.assert_allclose(flux.absorbed, 0.0, atol=1e-12)


def test_uniform_light_stays_uniform():
    """Under an even sky over white soil a white canopy cannot be told from its surroundings."""
    light = solver(MANY)(white(patchy(), 0.0))
    np.testing.assert_allclose(light.diffuse.intensity, 1 / np.pi, rtol=1e-4)
    aslant = reflectance_of(light, np.array([50.0]), np.array([123.0]))
    np.testing.assert_allclose(aslant, 1.0, rtol=1e-4)


def test_uniform_light_stays_uniform_in_few_directions():
    """24 ordinates conserve what is scattered from each of them, and what arrives in each only
    as well as they integrate the scattering function: within 0.1 %."""
    light = solver(CELLS)(white(patchy(), 0.0))
    np.testing.assert_allclose(light.diffuse.intensity, 1 / np.pi, rtol=1e-3)
    downwards = parallel_rays(X, Y, 0.05, 0.0, 0.0)
    np.testing.assert_allclose(photograph(light, downwards), 1.0, rtol=1e-3)


def test_uniform_light_stays_uniform_across_a_wide_field_of_view():
    """Leaves that lie flat show a frame camera less of themselves towards its edge; what they
    send there must shrink as what they hide does."""
    wide = nadir_rays(X, Y, 0.05, (0.4, 0.3, 0.6))
    image = photograph(solver(MANY)(white(patchy(), 0.0)), wide)
    np.testing.assert_allclose(image, 1.0, rtol=5e-3)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_an_empty_grid_shows_bare_soil(boundary):
    scene = patchy(boundary)
    scene = eqx.tree_at(lambda s: s.area_density, scene, jnp.zeros_like(scene.area_density))
    scene = eqx.tree_at(
        lambda s: s.ground, scene, jnp.array([[[0.25]], [[0.1]]]) * jnp.ones((2, 6, 8))
    )
    light = solver(CELLS)(scene)
    got = camera_factor(light)
    inside = got[:, 1:-1, 1:-1]  # the outer pixels reach over the edge of the scene
    np.testing.assert_allclose(
        inside, np.broadcast_to([[[0.25]], [[0.1]]], inside.shape), rtol=1e-12
    )
    flux = fluxes_of(light)
    np.testing.assert_allclose(flux.transmitted, 1.0, rtol=1e-12)
    np.testing.assert_array_equal(flux.absorbed, 0.0)
    if boundary == "periodic":
        np.testing.assert_allclose(flux.albedo, [0.25, 0.1], rtol=1e-12)


def test_an_empty_grid_shows_each_soil_in_its_place():
    scene = patchy()
    scene = eqx.tree_at(lambda s: s.area_density, scene, jnp.zeros_like(scene.area_density))
    centres = (jnp.arange(8) + 0.5) * 0.1, (jnp.arange(6) + 0.5) * 0.1
    got = photograph(solver(CELLS)(scene), nadir_rays(*centres, 0.1, (0.4, 0.3, 3.0)))
    np.testing.assert_allclose(got, scene.ground, rtol=1e-12)


def test_open_and_periodic_agree_when_nothing_reaches_the_sides():
    """A thicket in the middle of wide empty ground, under a high sun and a black sky."""
    scenes = []
    for boundary in ("periodic", "open"):
        scene = patchy(boundary, shape=(2, 30, 30), sun=(5.0, 50.0), sky=(0.0, 0.0))
        inside = np.zeros((30, 30))
        inside[13:17, 13:17] = 1.0
        scene = eqx.tree_at(
            lambda s: (s.area_density, s.classes.reflectance, s.classes.transmittance),
            scene,
            (
                scene.area_density * inside,
                0.01 * scene.classes.reflectance,
                0.01 * scene.classes.transmittance,
            ),
        )
        scenes.append(scene)
    centres = (jnp.arange(30) + 0.5) * 0.1
    rays = nadir_rays(centres, centres, 0.1, (1.5, 1.5, 8.0))
    accuracy = Accuracy(coarsening=(1, 1), margin=1, levels=1)
    one, other = (see(solver(accuracy)(scene), rays) for scene in scenes)
    np.testing.assert_allclose(one.sunlit_leaves, other.sunlit_leaves, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(one.gap, other.gap, rtol=1e-12)
    np.testing.assert_allclose(one.ground, other.ground, rtol=3e-3)


def test_reciprocity_of_the_scene_mean():
    """BRF(sun, view) = BRF(view, sun), Helmholtz, for a canopy without symmetry.

    The sun is traced on beams and the view on rays, so this compares two roads.
    """
    pairs = [((20.0, 10.0), (50.0, 130.0)), ((40.0, 300.0), (5.0, 80.0))]
    for one, other in pairs:
        got = []
        for sun, view in ((one, other), (other, one)):
            light = solver(MANY)(patchy(sun=sun, sky=(0.0, 0.0)))
            got.append(
                np.asarray(reflectance_of(light, np.array([view[0]]), np.array([view[1]])))[0]
            )
        np.testing.assert_allclose(got[0], got[1], rtol=3e-3)


def test_single_precision_agrees_with_double():
    single = jax.tree.map(lambda a: a.astype(jnp.float32), (patchy(), CAMERA))
    image = photograph(solver(CELLS)(single[0]), single[1])
    assert image.dtype == jnp.float32
    np.testing.assert_allclose(image, camera_factor(solver(CELLS)(patchy())), rtol=2e-4)


@pytest.mark.parametrize("unit", [1e-18, 1e19])
def test_light_in_any_unit(unit):
    """In single precision too, where the squares of such numbers do not exist."""
    scene = jax.tree.map(lambda a: a.astype(np.float32), patchy())
    light = scene.illumination
    other = eqx.tree_at(
        lambda s: (s.illumination.sun, s.illumination.sky),
        scene,
        (light.sun * np.float32(unit), light.sky * np.float32(unit)),
    )
    one, two = solver(BLOCKS)(scene), solver(BLOCKS)(other)
    np.testing.assert_allclose(fluxes_of(two).albedo, fluxes_of(one).albedo, rtol=1e-5)
    np.testing.assert_allclose(two.residual, one.residual, rtol=1e-2)


def test_a_band_without_light_reflects_nothing():
    scene = patchy()
    dark = eqx.tree_at(
        lambda s: (s.illumination.sun, s.illumination.sky),
        scene,
        (scene.illumination.sun.at[1].set(0.0), scene.illumination.sky.at[1].set(0.0)),
    )
    light = solver(CELLS)(dark)
    for share in jax.tree.leaves(fluxes_of(light)):
        assert np.all(np.asarray(share)[0] > 0)
        np.testing.assert_array_equal(share[1], 0.0)
    np.testing.assert_array_equal(camera_factor(light)[1], 0.0)


def test_the_solve_reports_what_it_left_over():
    cut_short = Accuracy(coarsening=(1, 1), tolerance=1e-7, margin=6, iterations=2)
    assert np.all(np.asarray(solver(CELLS)(patchy()).diffuse.residual) < 1.01e-7)
    assert np.all(np.asarray(solver(cut_short)(patchy()).diffuse.residual) > 1e-6)
