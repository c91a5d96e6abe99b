"""Absorption by voxel, grids of odd size, and many bands out of few solves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation import Accuracy, nadir_rays, reflectance_factor
from fynjax.radiation._fluxes import absorption
from tests import reference
from tests.radiation.scenes import fluxes_of, patchy, reflectance_of, solver
from tests.radiation.test_monte_carlo import clumps
from tests.radiation.test_monte_carlo_reference import with_fields

absorption_of = jax.jit(absorption)

TIGHT = {"tolerance": 1e-8, "iterations": 200}
HOW = {
    "refined": Accuracy(margin=6, **TIGHT),
    "coarse": Accuracy(refine=False, **TIGHT),
    "every voxel": Accuracy(coarsening=(1, 1), **TIGHT),
    "reduced": Accuracy(solves=2, **TIGHT),
}


FINER = Accuracy(levels=4, azimuths=8, margin=6)
image_of = jax.jit(reflectance_factor, static_argnames="chunk")


def many_bands(count=40):
    """The patchy scene with smooth spectra of all its surfaces."""
    scene = patchy()
    at = np.linspace(0, 1, count)
    rng = np.random.default_rng(6)
    start, turn = rng.uniform(0.02, 0.25, (3, 1)), rng.uniform(0.2, 0.8, (3, 1))
    rise = 1 / (1 + np.exp((turn - at) / 0.05))
    reflectance = start + (0.48 - start) * rise
    transmittance = 0.8 * reflectance * np.array([[1.0], [1.0], [0.0]])
    share = rng.random((6, 8))
    ground = (0.08 + 0.2 * at)[:, None, None] * share + (0.3 - 0.1 * at**2)[:, None, None] * (
        1 - share
    )
    sky = jnp.asarray(0.1 + 0.3 * (1 - at) ** 2)
    return with_fields(
        scene,
        classes__reflectance=jnp.asarray(reflectance),
        classes__transmittance=jnp.asarray(transmittance),
        ground=jnp.asarray(ground),
        illumination__sun=1 - sky,
        illumination__sky=sky,
    )


@pytest.mark.parametrize(
    ("how", "boundary"),
    [
        ("refined", "periodic"),
        *(
            pytest.param(how, "periodic", marks=pytest.mark.study)
            for how in HOW
            if how != "refined"
        ),
        pytest.param("refined", "open", marks=pytest.mark.study),
    ],
)
def test_voxels_sum_to_the_classes(how, boundary):
    scene = with_fields(many_bands(3), boundary=boundary)
    light = solver(HOW[how])(scene)
    per_voxel = np.asarray(absorption_of(light))
    assert per_voxel.shape[0] == 3
    total = per_voxel.mean(axis=(2, 3)).sum(axis=1) * scene.vertical
    np.testing.assert_allclose(total, fluxes_of(light).absorbed.sum(axis=1), rtol=1e-9)
    assert np.all(per_voxel >= 0)


def test_nothing_is_absorbed_where_nothing_is():
    scene = patchy()
    density = jnp.zeros_like(scene.area_density).at[0, 1].set(scene.area_density[0, 1])
    per_voxel = np.asarray(
        absorption_of(solver(Accuracy())(with_fields(scene, area_density=density)))
    )
    empty = np.asarray(density.sum(axis=0)) == 0
    assert 0 < empty.sum() < empty.size
    assert np.all(per_voxel[:, empty] == 0)
    assert np.all(per_voxel[:, ~empty] > 0)


def test_leaves_that_lose_nothing_absorb_nothing():
    """Two classes of three do not; what a voxel absorbs is then the third's."""
    scene = patchy()
    lossless = with_fields(
        scene,
        classes__reflectance=scene.classes.reflectance.at[:2].set(0.6),
        classes__transmittance=scene.classes.transmittance.at[:2].set(0.4),
    )
    light = solver(Accuracy())(lossless)
    np.testing.assert_allclose(fluxes_of(light).absorbed[:, :2], 0.0, atol=1e-12)
    per_voxel = np.asarray(absorption_of(light))
    third = np.asarray(scene.area_density[2]) > 0
    np.testing.assert_allclose(per_voxel[:, ~third], 0.0, atol=1e-12)
    assert np.all(per_voxel[:, third] > 0)


@pytest.mark.study
@pytest.mark.parametrize("boundary", ["periodic", pytest.param("open", marks=pytest.mark.slow)])
def test_classes_and_voxels_against_photons(boundary):
    scene = with_fields(clumps("planophile", "spherical", 2), boundary=boundary)
    light = solver(FINER)(scene)
    flux = fluxes_of(light)
    for band in range(2):
        want = reference.fluxes(scene, photons=60_000, seed=band, band=band)
        for name in ("absorbed", "albedo", "transmitted", "ground_absorbed"):
            value, found = np.asarray(getattr(flux, name)[band]), getattr(want, name)
            print(boundary, band, name, 100 * (value / found.mean - 1))
            assert np.all(np.abs(value - found.mean) < 0.015 * found.mean + 3 * found.error), name


@pytest.mark.study
@pytest.mark.parametrize("shape", [(5, 7, 9), (3, 6, 9), (1, 1, 1)])
def test_odd_sizes(shape):
    """The default accuracy takes any size: against one empty layer more, and finer cells."""
    scene = patchy(shape=shape)
    light = solver(Accuracy())(scene)
    whole = solver(Accuracy(coarsening=(1, 1)))(scene)
    above = jnp.pad(scene.area_density, ((0, 0), (0, 1), (0, 0), (0, 0)))
    taller = solver(Accuracy())(with_fields(scene, area_density=above))
    rays = nadir_rays(jnp.array([0.0, 0.2]), jnp.array([0.1, 0.3]), 0.05, (0.2, 0.2, 3.0))
    image, want = (np.asarray(image_of(each, rays)) for each in (light, taller))
    np.testing.assert_allclose(image, want, rtol=0.02)
    flux = fluxes_of(light)
    for name in ("albedo", "transmitted", "absorbed"):
        got = getattr(flux, name)
        np.testing.assert_allclose(got, getattr(fluxes_of(taller), name), rtol=0.02, err_msg=name)
        np.testing.assert_allclose(got, getattr(fluxes_of(whole), name), rtol=0.05, err_msg=name)
    per_voxel = np.asarray(absorption_of(light)).mean(axis=(2, 3)).sum(axis=1) * 0.1
    np.testing.assert_allclose(per_voxel, flux.absorbed.sum(axis=1), rtol=1e-9)


@pytest.mark.study
def test_odd_sizes_are_as_even_ones():
    """The scene twice side by side is the same scene."""
    scene = patchy(shape=(5, 7, 9))
    twice = with_fields(
        scene,
        area_density=jnp.tile(scene.area_density, (1, 1, 2, 2)),
        ground=jnp.tile(scene.ground, (1, 2, 2)),
    )
    views = jnp.array([0.0, 40.0]), jnp.array([0.0, 200.0])
    one, two = (reflectance_of(solver(Accuracy())(s), *views) for s in (scene, twice))
    np.testing.assert_allclose(one, two, rtol=0.01)


@pytest.mark.study
@pytest.mark.parametrize("solves", [12, 24])
def test_many_bands_are_those_solved_one_by_one(solves):
    """Images of 40 bands, three at a time or all at once."""
    scene = many_bands()
    few = solver(Accuracy(solves=solves, tolerance=1e-6))(scene)
    every = solver(Accuracy(solves=None, refine=False, tolerance=1e-6))(scene)
    x = jnp.array([0.1, 0.33, 0.7])
    rays = nadir_rays(x, x, 0.05, (0.4, 0.3, 3.0))
    want = np.asarray(image_of(every, rays))
    got = np.asarray(image_of(few, rays))
    print(solves, "largest error", np.abs(got / want - 1).max(), "residual", few.residual.max())
    np.testing.assert_allclose(got, want, rtol=1e-3)
    again = image_of(few, rays, chunk=3)
    np.testing.assert_allclose(again, got, rtol=1e-9)
    one, two = fluxes_of(few), fluxes_of(every)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two)):
        np.testing.assert_allclose(a, b, rtol=1e-3)
    np.testing.assert_allclose(absorption_of(few), absorption_of(every), rtol=2e-3, atol=1e-6)
