"""The diffuse light of many bands out of a few solves, against a solve of every band."""

import dataclasses
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import SphericalLeafAngle, leaf_angle
from fynjax.leaf import LeafParameters, prospect
from fynjax.radiation import (
    Accuracy,
    Illumination,
    OpticalClasses,
    RahmanPintyVerstraete,
    VoxelScene,
    fluxes,
    parallel_rays,
    reflectance_factor,
    solve_light,
)
from fynjax.radiation._multiple import cells_of
from fynjax.radiation._reduced import check_reducible, solve_reduced
from fynjax.radiation._sun import trace_sun

SPECIES = 13
WAVELENGTHS = np.linspace(400.0, 2500.0, 425)
TIGHT = Accuracy(
    lattice=1, sublayers=1, coarsening=(2, 2), levels=1, tolerance=1e-11, iterations=300
)


@lru_cache
def shrubs(every: int = 1) -> VoxelScene:
    """Thirteen species and their wood on 12 x 12 x 6 voxels, over a map of two soils."""
    rng = np.random.default_rng(5)

    def leaf() -> LeafParameters:
        return LeafParameters(
            structure=rng.uniform(1.2, 2.4),
            chlorophyll=rng.uniform(10, 75),
            carotenoids=rng.uniform(3, 15),
            anthocyanins=rng.uniform(0, 8),
            brown_pigments=rng.uniform(0, 0.6),
            water=rng.uniform(0.004, 0.03),
            dry_matter=rng.uniform(0.003, 0.025),
        )

    waves = WAVELENGTHS[::every]
    optics = [prospect(leaf(), waves) for _ in range(SPECIES)]
    wood = 0.1 + 0.35 * (waves - 400) / 2100
    owner = rng.integers(SPECIES, size=(12, 12)).repeat(1)
    density = rng.gamma(0.5, 3.0, (SPECIES + 1, 6, 144)) * (
        np.arange(SPECIES + 1)[:, None, None] == owner
    )
    density[-1] = rng.gamma(0.5, 0.6, (6, 144))
    soils = np.stack(
        [
            0.08 + 0.3 * (1 - np.exp((400 - waves) / 700)),
            0.2 + 0.2 * (waves > 700) - 0.1 * np.exp(-(((waves - 1930) / 70) ** 2)),
        ]
    )
    share = rng.random((12, 12))
    sky = 0.08 + 0.3 * (waves / 400) ** -2.5
    return VoxelScene(
        jnp.asarray(density.reshape(-1, 6, 12, 12)),
        OpticalClasses(
            jnp.stack([o.reflectance for o in optics] + [jnp.asarray(wood)]),
            jnp.stack([o.transmittance for o in optics] + [jnp.zeros(len(waves))]),
            (SphericalLeafAngle(), leaf_angle("planophile")),
            (0, 1) * ((SPECIES + 1) // 2),
        ),
        jnp.asarray(soils[0][:, None, None] * share + soils[1][:, None, None] * (1 - share)),
        Illumination(jnp.array(40.0), jnp.array(120.0), jnp.asarray(1 - sky), jnp.asarray(sky)),
        0.2,
        0.2,
    )


def reduced(scene, accuracy, solves, materials=2):
    sun = trace_sun(scene, accuracy.lattice, accuracy.sublayers, 0)
    field = solve_reduced(
        scene,
        cells_of(scene, sun, accuracy.coarsening),
        accuracy.coarsening,
        accuracy.ordinates,
        accuracy.tolerance,
        accuracy.iterations,
        solves,
        materials,
    )
    return field, sun


EVERY = dataclasses.replace(
    TIGHT, azimuths=4, tolerance=1e-8, iterations=300, solves=None, refine=False
)
FEW = {solves: dataclasses.replace(EVERY, solves=solves) for solves in (10, 25)}
light_of = jax.jit(solve_light, static_argnums=1)
image = jax.jit(reflectance_factor)
fluxes_of = jax.jit(fluxes)


@pytest.fixture(scope="module")
def want():
    return light_of(shrubs(), EVERY)


@pytest.fixture(scope="module")
def got():
    return light_of(shrubs(), FEW[25])


@pytest.fixture(scope="module")
def few():
    return light_of(shrubs(), FEW[10])


@pytest.mark.study
def test_mean_reflectance_of_425_bands(want, got):
    centres = (jnp.arange(12) + 0.5) * 0.2
    rays = parallel_rays(centres, centres, 0.2, 20.0, 200.0)
    true, found = (np.asarray(image(light, rays)) for light in (want, got))
    mean = true.mean(axis=(1, 2))
    assert np.abs(found.mean(axis=(1, 2)) / mean - 1).max() < 2e-4
    assert (np.sqrt(((found - true) ** 2).mean(axis=(1, 2))) / mean).max() < 5e-4


@pytest.mark.study
def test_fluxes_of_425_bands(want, got):
    true, found = fluxes_of(want), fluxes_of(got)
    for name in ("albedo", "transmitted", "ground_absorbed"):
        np.testing.assert_allclose(getattr(found, name), getattr(true, name), rtol=1e-3)
    field = jax.jit(lambda field: field.bands(0, 425))(got.diffuse)
    np.testing.assert_allclose(field.top, want.diffuse.top, rtol=5e-4)
    np.testing.assert_allclose(
        field.ground.mean(axis=(1, 2)), want.diffuse.ground.mean(axis=(1, 2)), rtol=1e-3
    )
    assert len(set(np.asarray(got.diffuse.chosen).tolist())) == 25


@pytest.mark.study
def test_residual_tracks_the_error(want, few):
    """Within the amplification of multiple scattering, and in the order of the bands' errors."""
    field = few.diffuse
    parts = jax.jit(lambda field: field.bands(0, 425))(field)
    true, found = want.diffuse.intensity, parts.intensity
    error = np.linalg.norm((found - true).reshape(425, -1), axis=1)
    error /= np.linalg.norm(true.reshape(425, -1), axis=1)
    residual = np.asarray(field.residual)
    solved = np.isin(np.arange(425), field.chosen)
    assert residual[solved].max() < 1e-7
    assert residual[~solved].max() > 1e-3
    np.testing.assert_allclose(parts.residual, residual, rtol=1e-6, atol=1e-12)
    assert (error[~solved] < 2 * residual[~solved]).all()
    rank = [np.argsort(np.argsort(v[~solved])) for v in (error, residual)]
    assert np.corrcoef(*rank)[0, 1] > 0.6
    top = np.abs(np.asarray(parts.top) / want.diffuse.top - 1)
    assert (top < residual + 1e-7).all()


@pytest.mark.study
def test_more_solves_less_error(got, few):
    assert float(got.residual.max()) < 0.2 * float(few.residual.max())


def repeated(scene: VoxelScene, bands: list[int]) -> VoxelScene:
    at = np.asarray(bands)
    light = scene.illumination
    return eqx.tree_at(
        lambda s: (
            s.classes.reflectance,
            s.classes.transmittance,
            s.ground,
            s.illumination.sun,
            s.illumination.sky,
        ),
        scene,
        (
            scene.classes.reflectance[:, at],
            scene.classes.transmittance[:, at],
            scene.ground[at],
            light.sun[at],
            light.sky[at],
        ),
    )


REPEATED = [30, 70, 300, 70, 30, 300, 70, 150]


def with_sky(scene):
    pattern = np.random.default_rng(0).uniform(0.5, 2.0, (2, 10, 12))
    share = np.linspace(0, 1, 425)[REPEATED][:, None, None]
    pattern = pattern[0] * share + pattern[1] * (1 - share)
    return eqx.tree_at(
        lambda s: s.illumination.sky_pattern,
        scene,
        jnp.asarray(pattern),
        is_leaf=lambda x: x is None,
    )


def with_anisotropic_ground(scene):
    ones = jnp.ones(len(REPEATED))
    return dataclasses.replace(
        scene, ground_shape=RahmanPintyVerstraete(0.8 * ones, -0.1 * ones, 0.3 * ones)
    )


def with_terrain(scene):
    slope = 0.25 * (1 + np.sin(np.arange(12) * np.pi / 6))[:, None] * np.ones(12)
    return dataclasses.replace(scene, terrain=jnp.asarray(slope))


# What the slopes of hilly ground throw at each other goes with powers of its reflectance: four
# bands' maps are then no mixture of three.
VARIANTS = {
    "even sky, Lambertian and level ground": (lambda scene: scene, 1e-7),
    "a sky for each band, Lambertian and level ground": (with_sky, 1e-7),
    "a sky for each band, anisotropic ground": (
        lambda s: with_anisotropic_ground(with_sky(s)),
        1e-7,
    ),
    "a sky for each band, hilly ground": (lambda s: with_terrain(with_sky(s)), 1e-5),
}


@pytest.mark.parametrize(
    "what",
    [
        pytest.param(what, marks=() if "Lambertian" in what else pytest.mark.study)
        for what in VARIANTS
    ],
)
def test_exact_where_all_that_differ_are_solved(what):
    change, tolerance = VARIANTS[what]
    scene = change(repeated(shrubs(), REPEATED))

    few = dataclasses.replace(TIGHT, solves=6)
    every = dataclasses.replace(TIGHT, solves=None, refine=False)
    true, found = light_of(scene, every).diffuse, light_of(scene, few).diffuse
    assert set(np.asarray(REPEATED)[np.asarray(found.chosen)]) == set(REPEATED)
    np.testing.assert_allclose(found.bands(2, 3).intensity, true.intensity[2:5], rtol=tolerance)
    every_band = found.bands(0, len(true.top))
    np.testing.assert_allclose(every_band.ground, true.ground, rtol=tolerance)
    np.testing.assert_allclose(every_band.top, true.top, rtol=tolerance)
    assert float(found.residual.max()) < 10 * tolerance


@pytest.mark.study
def test_residual_shows_ground_that_is_no_mixture():
    scene = repeated(shrubs(), REPEATED)
    one = jax.jit(lambda scene: reduced(scene, TIGHT, 4, 1)[0].residual)(scene)
    assert float(one.max()) > 1e-5  # with three it is below 1e-6: the test above


def outcome(scene, solves=5):
    """All that the reduced field gives, as one number."""
    field, _ = reduced(scene, TIGHT, solves)
    count = scene.ground.shape[0]
    rng = np.random.default_rng(3)
    weights = rng.normal(size=(count, 1, 12, 3, 6, 6))

    def of_band(at):
        index, weight = at
        part = field.bands(index, 1)
        return jnp.sum(weight * part.intensity) + jnp.sum(part.ground) - 2 * part.top[0]

    whole = field.bands(0, count)
    return (
        jnp.sum(jax.lax.map(jax.checkpoint(of_band), (jnp.arange(count), jnp.asarray(weights))))
        + jnp.sum(whole.ground * rng.normal(size=whole.ground.shape))
        + whole.top @ rng.normal(size=count)
    )


value = jax.jit(outcome)
slope = jax.jit(jax.grad(outcome))
push = jax.jit(lambda at, along: jax.jvp(outcome, (at,), (along,))[1])


@pytest.fixture(scope="module")
def gradient():
    return slope(shrubs(40))


def directions():
    scene = shrubs(40)
    rng = np.random.default_rng(2)

    def noise(shape):
        return jnp.asarray(rng.normal(size=shape))

    optics = scene.classes.reflectance.shape
    count = optics[1]
    return {
        "density": (lambda s: s.area_density, noise(scene.area_density.shape) * scene.area_density),
        "reflectance": (lambda s: s.classes.reflectance, noise(optics)),
        "transmittance": (lambda s: s.classes.transmittance, noise(optics)),
        "soil map": (lambda s: s.ground, noise(scene.ground.shape)),
        "sun zenith": (lambda s: s.illumination.sun_zenith, jnp.array(1.0)),
        "sun": (lambda s: s.illumination.sun, noise(count)),
        "sky": (lambda s: s.illumination.sky, noise(count)),
    }


@pytest.mark.study
@pytest.mark.parametrize("what", directions())
def test_derivative_along(what, gradient):
    scene = shrubs(40)
    select, step = directions()[what]
    along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, scene), step)
    h = 1e-5
    forth = jax.tree.map(lambda a, d: a + h * d, scene, along)
    back = jax.tree.map(lambda a, d: a - h * d, scene, along)
    difference = float(value(forth) - value(back)) / (2 * h)
    backward = float(jnp.sum(select(gradient) * step))
    assert backward == pytest.approx(difference, rel=2e-6)


@pytest.mark.study
@pytest.mark.slow
def test_forward_mode_agrees_with_reverse(gradient):
    scene = shrubs(40)
    for select, step in directions().values():
        along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, scene), step)
        assert float(push(scene, along)) == pytest.approx(
            float(jnp.sum(select(gradient) * step)), rel=1e-7
        )


def optics_of(scene):
    return scene.classes.reflectance, scene.classes.transmittance


EDGES = {
    "an empty scene": (lambda s: s.area_density, lambda a: 0 * a),
    "black leaves": (optics_of, lambda a: 0 * a),
    "a band of black leaves": (optics_of, lambda a: a.at[:, 3].set(0.0)),
    "leaves that lose nothing": (optics_of, lambda a: 0 * a + 0.5),
    "black ground": (lambda s: s.ground, lambda a: 0 * a),
    "a species that does not grow": (lambda s: s.area_density, lambda a: a.at[0].set(0.0)),
    "no sky": (lambda s: s.illumination.sky, lambda a: 0 * a),
    "no sun": (lambda s: s.illumination.sun, lambda a: 0 * a),
    "no light": (lambda s: (s.illumination.sun, s.illumination.sky), lambda a: 0 * a),
}


@pytest.mark.study
@pytest.mark.parametrize("what", EDGES)
def test_finite_at_the_edge(what):
    scene = shrubs(40)
    select, edge = EDGES[what]
    at = eqx.tree_at(select, scene, jax.tree.map(edge, select(scene)))
    assert np.isfinite(value(at))
    for leaf in jax.tree.leaves(slope(at)):
        assert np.all(np.isfinite(leaf))


@pytest.mark.study
@pytest.mark.slow
def test_memory_does_not_grow_with_the_bands():
    """But for the maps of ground, in and out; one field of a band is 1296 numbers here."""
    plans = []
    for every in (8, 2):
        scene = shrubs(every)

        def total(scene):
            field, _ = reduced(scene, TIGHT, 4)

            def of_band(index):
                return jnp.sum(field.bands(index, 1).intensity ** 2)

            return jnp.sum(jax.lax.map(jax.checkpoint(of_band), jnp.arange(scene.ground.shape[0])))

        compiled = jax.jit(jax.value_and_grad(total)).lower(scene).compile()
        plans.append((scene.ground.shape[0], compiled.memory_analysis().temp_size_in_bytes / 8))
    (few, small), (many, large) = plans
    assert (large - small) / (many - few) < 1296


def test_ground_shape_must_not_differ_between_bands():
    scene = with_anisotropic_ground(repeated(shrubs(), REPEATED))
    check_reducible(scene)
    check_reducible(shrubs())
    bad = eqx.tree_at(lambda s: s.ground_shape.k, scene, jnp.linspace(0.7, 0.9, len(REPEATED)))
    with pytest.raises(InputError, match=r"`k` .*0\.7 .*0\.9"):
        check_reducible(bad)


def test_spectra_of_few_species_are_reduced_in_float32():
    """Light of many bands that differ in two spectra alone: what one solve adds to others is small,
    and its digits are few. Systems of such solves were singular, and bands NaN."""
    scene = shrubs(14)
    density = jnp.zeros_like(scene.area_density).at[0].set(scene.area_density.sum(axis=0))
    even = dataclasses.replace(scene, area_density=density, ground=scene.ground.mean(axis=(1, 2)))
    single = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), even)
    accuracy = dataclasses.replace(TIGHT, tolerance=1e-3)
    light = light_of(single, accuracy)
    few = light.diffuse
    basis = few.basis.reshape(len(few.basis), -1)
    there = np.asarray((basis**2).sum(axis=1) > 0)
    gram = np.asarray(basis @ basis.T)[np.ix_(there, there)]
    assert len(few.coefficients) > len(few.chosen)
    np.testing.assert_allclose(gram, np.eye(there.sum()), atol=1e-4)
    assert np.isfinite(few.coefficients).all()
    centres = (jnp.arange(12) + 0.5) * 0.2
    rays = parallel_rays(centres, centres, 0.2, 20.0, 200.0)
    every = light_of(even, dataclasses.replace(TIGHT, solves=None, refine=False))
    np.testing.assert_allclose(image(light, rays), image(every, rays), rtol=5e-3)
