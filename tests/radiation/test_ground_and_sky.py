"""Anisotropic ground and uneven sky, against their formulas and against photons."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation import (
    Accuracy,
    Illumination,
    RahmanPintyVerstraete,
    directional_reflectance,
    fluxes,
    nadir_rays,
    reflectance_factor,
    solve_light,
)
from fynjax.radiation._ordinates import Ordinates, sky_radiance
from tests import reference
from tests.radiation.scenes import closure, fluxes_of, patchy, reflectance_of, solver
from tests.radiation.test_monte_carlo import clumps
from tests.radiation.test_monte_carlo_reference import bare, rahman, with_fields

ACCURACY = Accuracy(
    lattice=2, sublayers=2, coarsening=(1, 1), levels=4, azimuths=12, tolerance=1e-6, margin=6
)
SHAPE = RahmanPintyVerstraete([0.75, 0.85], [-0.12, 0.08], [0.3, 1.0])
VIEWS = np.array([0.0, 40.0, 25.0, 60.0]), np.array([0.0, 65.0, 150.0, 245.0])


def shaped(scene, shape=SHAPE):
    return with_fields(scene, ground_shape=shape)


def seen(scene, accuracy=ACCURACY):
    return np.asarray(reflectance_of(solver(accuracy)(scene), *map(jnp.asarray, VIEWS)))


@pytest.mark.study
def test_lambert_is_a_case():
    scene = patchy()
    lambert = shaped(scene, RahmanPintyVerstraete([1.0, 1.0], [0.0, 0.0], [1.0, 1.0]))
    np.testing.assert_allclose(seen(lambert), seen(scene), rtol=1e-5)
    one, two = (fluxes_of(solver(ACCURACY)(s)) for s in (lambert, scene))
    for got, want in zip(jax.tree.leaves(one), jax.tree.leaves(two)):
        np.testing.assert_allclose(got, want, rtol=1e-5)


@pytest.mark.parametrize(
    "parameters",
    [
        (0.75, -0.12, 0.3),
        pytest.param((1.2, 0.1, 1.0), marks=pytest.mark.study),
        pytest.param((0.6, -0.3, 0.05), marks=pytest.mark.study),
    ],
)
def test_bare_ground_is_the_formula(parameters):
    """Distant views and each pixel of a wide camera (interpolated between few directions)."""
    k, theta, rho_c = parameters
    scene = shaped(bare(sun=(40.0, 65.0)), RahmanPintyVerstraete([k], [theta], [rho_c]))
    zenith, azimuth = VIEWS
    want = 0.3 * rahman(40.0, zenith, azimuth - 65.0, k, theta, rho_c)
    np.testing.assert_allclose(seen(scene)[:, 0], want, rtol=1e-9)
    x = jnp.linspace(-4.0, 4.0, 6)
    rays = nadir_rays(x, x, 0.1, (0.0, 0.0, 10.0))
    got = np.asarray(jax.jit(reflectance_factor)(solver(ACCURACY)(scene), rays))[0]
    east, north = np.meshgrid(x, x)
    zenith = np.rad2deg(np.arctan(np.hypot(east, north) / 10.0))
    azimuth = np.rad2deg(np.arctan2(-east, -north))
    want = 0.3 * rahman(40.0, zenith, azimuth - 65.0, k, theta, rho_c)
    np.testing.assert_allclose(got, want, rtol=0.01)


@pytest.mark.study
@pytest.mark.parametrize("boundary", ["periodic", pytest.param("open", marks=pytest.mark.study)])
@pytest.mark.parametrize("band", [0, 1])
def test_under_a_canopy_against_photons(boundary, band):
    scene = shaped(with_fields(clumps("planophile", "spherical", 2), boundary=boundary))
    want = reference.reflectance(scene, *VIEWS, photons=60_000, seed=1, band=band)
    got = seen(scene)[:, band]
    print("off %", 100 * (got / want.mean - 1), "noise %", 100 * want.error / want.mean)
    np.testing.assert_allclose(got, want.mean, rtol=0.025)
    # The shape is no trifle in this comparison.
    plain = seen(with_fields(scene, ground_shape=None))[:, band]
    assert np.abs(plain / want.mean - 1).max() > 0.05


@pytest.mark.parametrize("sky", [pytest.param(0.0, marks=pytest.mark.study), 0.6])
def test_energy_closes(sky):
    scene = shaped(with_fields(patchy(sky=(sky, sky)), ground=0.4 * jnp.ones(2)))
    accuracy = Accuracy(coarsening=(2, 2), levels=4, azimuths=8, tolerance=1e-9, refine=False)
    np.testing.assert_allclose(closure(solver(accuracy)(scene)), 1.0, atol=1e-6)
    refined = Accuracy(coarsening=(2, 2), levels=4, azimuths=8, tolerance=1e-9)
    np.testing.assert_allclose(closure(solver(refined)(scene)), 1.0, atol=2e-3)


def patterned(scene, pattern):
    return with_fields(scene, illumination__sky_pattern=jnp.asarray(pattern))


@pytest.mark.study
def test_an_even_pattern_is_an_even_sky():
    scene = patchy(sky=(0.7, 0.4))
    even = patterned(scene, np.full((4, 6), 7.0))
    np.testing.assert_allclose(seen(even), seen(scene), rtol=1e-5)


def random_pattern(*shape):
    return np.random.default_rng(3).uniform(0.2, 3.0, shape)


@pytest.mark.parametrize(
    "shape",
    [(2, 5, 8), *(pytest.param(s, marks=pytest.mark.study) for s in ((5, 8), (2, 1), (2, 2, 12)))],
)
def test_the_irradiance_is_that_of_the_sky(shape):
    """Whatever the pattern: the flux on the ordinates, and on level ground without a canopy."""
    sky = jnp.array([0.7, 1.3])
    sun = jnp.array(40.0), jnp.array(0.0), jnp.zeros(2)
    light = Illumination(*sun, sky, jnp.asarray(random_pattern(*shape)))
    ordinates = Ordinates.create(3, 6)
    radiance = sky_radiance(light, ordinates)
    np.testing.assert_allclose(radiance @ ordinates.fluxes.ravel(), sky, rtol=1e-12)
    scene = patterned(patchy(sky=(1.0, 1.0)), random_pattern(*shape))
    scene = with_fields(scene, area_density=0 * scene.area_density)
    flux = fluxes_of(solver(ACCURACY)(scene))
    np.testing.assert_allclose(flux.transmitted, 1.0, rtol=1e-9)


def test_radiance_is_read_at_its_place():
    """A pattern linear in zenith angle, and one that waves slowly with azimuth."""
    ordinates = Ordinates.create(5, 8)
    from_there = -ordinates.vectors[: 5 * 8]
    zenith = np.rad2deg(np.arccos(from_there[:, 2]))
    azimuth = np.arctan2(from_there[:, 0], from_there[:, 1])
    steps = np.linspace(0, 90, 4)[:, None], np.deg2rad(np.arange(0, 360, 2.0))[None]
    one = np.ones(1)
    for pattern, want in (
        (2 - steps[0] / 90 + 0 * steps[1], 2 - zenith / 90),
        (2 + np.sin(steps[1]) + 0 * steps[0], 2 + np.sin(azimuth)),
        (2 + np.cos(steps[1]) + 0 * steps[0], 2 + np.cos(azimuth)),
    ):
        light = Illumination(*map(jnp.asarray, (40.0, 0.0, 0 * one, one, pattern)))
        got = np.asarray(sky_radiance(light, ordinates))[0]
        np.testing.assert_allclose(got / got.mean(), want / want.mean(), rtol=1e-3)


VIEW_OF_HEDGE = np.array([0.0, 45.0, 45.0]), np.array([0.0, 0.0, 180.0])


def hedges(side, parts):
    """A hedge 30 cm wide that runs east and west over ground bright to its north, without sun,
    under a sky ten times as bright on one `side` as on the other; 30 cm are `parts` voxels."""
    azimuth = np.arange(12) * 30.0
    glow = 1.1 + np.cos(np.deg2rad(azimuth - 30.0 * side))
    density = jnp.zeros((2, 3, 4, 4)).at[0, :, 2].set(4.0)
    soil = jnp.full((2, 4, 4), 0.05).at[:, 3:].set(0.6)
    return with_fields(
        patterned(clumps("spherical", "spherical"), glow * np.ones((4, 1))),
        area_density=density.repeat(parts, 1).repeat(parts, 2).repeat(parts, 3),
        ground=soil.repeat(parts, 1).repeat(parts, 2),
        illumination__sun=jnp.zeros(2),
        illumination__sky=jnp.ones(2),
        horizontal=0.3 / parts,
        vertical=0.3 / parts,
    )


@pytest.mark.study
@pytest.mark.parametrize("side", [0, 6], ids=["north", "south"])
def test_a_sky_bright_on_one_side_against_photons(side):
    """A sweep spreads a beam by about a voxel, which brings light behind a hedge of two voxels:
    up to 8 % there, half of it with every halving of the voxels."""
    scene = hedges(side, 2)
    views = list(map(jnp.asarray, VIEW_OF_HEDGE))
    want = [
        reference.reflectance(scene, *VIEW_OF_HEDGE, photons=60_000, seed=1, band=b)
        for b in range(2)
    ]
    mean, noise = np.array([w.mean for w in want]).T, np.array([w.error for w in want]).T
    off, fluxes_off = [], []
    absorbed = reference.fluxes(scene, photons=60_000, seed=2, band=1)
    for parts in (2, 8):
        light = solver(UNREFINED)(hedges(side, parts))
        off.append(np.asarray(reflectance_of(light, *views)) / mean - 1)
        flux = fluxes_of(light)
        fluxes_off.append(
            [
                float(getattr(flux, name)[1]) / float(getattr(absorbed, name).mean) - 1
                for name in ("albedo", "transmitted", "ground_absorbed")
            ]
        )
        print(parts, "off %", 100 * off[-1].T, "fluxes", fluxes_off[-1])
    assert np.abs(off[0]).max() < 0.09
    assert np.all(np.abs(off[1]) < 0.015 + 2 * noise / mean)
    assert np.abs(fluxes_off).max() < 0.015


UNREFINED = Accuracy(
    lattice=2, sublayers=2, coarsening=(1, 1), levels=4, azimuths=12, tolerance=1e-6
)


DERIVATIVES = Accuracy(
    lattice=1, sublayers=2, coarsening=(1, 1), levels=2, azimuths=4, tolerance=1e-12, iterations=300
)


def outcome(scene):
    """Two views, an image and the fluxes as one number."""
    light = solve_light(scene, DERIVATIVES)
    flux = fluxes(light)
    x = jnp.array([0.15, 0.42, 0.6])
    image = reflectance_factor(light, nadir_rays(x, x, 0.05, (0.4, 0.3, 2.0)))
    view = directional_reflectance(light, jnp.array([40.0, 20.0]), jnp.array([100.0, 300.0]))
    weights = np.random.default_rng(1).normal(size=image.shape)
    return (
        jnp.sum(weights * image)
        + jnp.sum(view * jnp.array([[1.0, -0.3], [0.4, 2.0]]))
        + flux.albedo @ jnp.array([1.0, -2.0])
        + flux.ground_absorbed @ jnp.array([0.3, 0.7])
    )


value, slope = jax.jit(outcome), jax.jit(jax.grad(outcome))


@pytest.fixture(scope="module")
def scene():
    return patterned(shaped(patchy(sky=(0.5, 0.3))), random_pattern(2, 4, 6))


@pytest.fixture(scope="module")
def gradient(scene):
    return slope(scene)


VARIABLES = {
    "k": lambda s: s.ground_shape.k,
    "theta": lambda s: s.ground_shape.theta,
    "rho_c": lambda s: s.ground_shape.rho_c,
    "sky pattern": lambda s: s.illumination.sky_pattern,
    "sky": lambda s: s.illumination.sky,
    "sun zenith": lambda s: s.illumination.sun_zenith,
    "ground": lambda s: s.ground,
}


@pytest.mark.study
@pytest.mark.parametrize("what", VARIABLES)
def test_derivative(what, scene, gradient):
    select = VARIABLES[what]
    step = jnp.asarray(np.random.default_rng(5).normal(size=select(scene).shape)) * 0.3
    along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, scene), step)
    h = 1e-5
    forth, back = (jax.tree.map(lambda a, d, s=s: a + s * h * d, scene, along) for s in (1, -1))
    difference = float(value(forth) - value(back)) / (2 * h)
    assert float(jnp.sum(select(gradient) * step)) == pytest.approx(difference, rel=1e-6)


@pytest.mark.study
def test_finite_at_the_edge(scene):
    """Lambert's case, a view and a sun overhead, and a dark sky."""
    lambert = shaped(scene, RahmanPintyVerstraete([1.0, 1.0], [0.0, 0.0], [1.0, 1.0]))
    for at in (
        with_fields(lambert, illumination__sun_zenith=jnp.array(0.0)),
        with_fields(scene, illumination__sky_pattern=jnp.zeros((2, 4, 6))),
    ):
        assert np.isfinite(value(at))
        for leaf in jax.tree.leaves(slope(at)):
            assert np.all(np.isfinite(leaf))
