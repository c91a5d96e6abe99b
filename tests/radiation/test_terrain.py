"""Ground that is not flat, against Lambert's cosine, shadows by geometry, and photons."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation import Accuracy, fluxes, parallel_rays, reflectance_factor, solve_light
from tests import reference
from tests.radiation.scenes import fluxes_of, patchy, reflectance_of, solver, towards
from tests.radiation.test_monte_carlo_reference import bare, with_fields

ACCURACY = Accuracy(lattice=2, sublayers=2, coarsening=(1, 1), levels=4, azimuths=8, margin=12)
REFINED = Accuracy(lattice=2, sublayers=2, coarsening=(2, 2), levels=4, azimuths=8, margin=12)
VIEWS = np.array([0.0, 40.0]), np.array([0.0, 250.0])
SIZE = 12  # scenes of equal shape share a compilation
pixels = jax.jit(reflectance_factor)


def centres(count, size=1.0):
    return (jnp.arange(count) + 0.5) * size


def level_area(**fields):
    """Bare ground of 6 m, in voxels of half a metre and three layers of a metre."""
    return bare(SIZE, horizontal=0.5, **fields)


def seen(scene, accuracy=ACCURACY):
    return np.asarray(reflectance_of(solver(accuracy)(scene), *map(jnp.asarray, VIEWS)))


def nadir(scene, accuracy=ACCURACY):
    """One pixel a voxel column, straight down."""
    _, ny, nx = scene.shape
    x, y = centres(nx, scene.horizontal), centres(ny, scene.horizontal)
    rays = parallel_rays(x, y, scene.horizontal, 0.0, 0.0)
    return np.asarray(pixels(solver(accuracy)(scene), rays))


def waves(scene, amplitude):
    """Ground that waves once along x and once along y, from zero to `amplitude`."""
    _, ny, nx = scene.shape
    y, x = np.meshgrid((np.arange(ny) + 0.5) / ny, (np.arange(nx) + 0.5) / nx, indexing="ij")
    wave = 0.5 * (1 + np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y))
    return with_fields(scene, terrain=jnp.asarray(amplitude * wave))


def above_ground(scene):
    """The scene with density only where a voxel is wholly above the ground."""
    nz = scene.shape[0]
    low = (np.arange(nz) * scene.vertical)[:, None, None]
    free = low >= np.asarray(scene.terrain)[None]
    return with_fields(scene, area_density=scene.area_density * jnp.asarray(free))


@pytest.mark.parametrize(
    "height", [1.3, *(pytest.param(h, marks=pytest.mark.study) for h in (0.0, 1.0, 2.0))]
)
def test_level_bare_ground_higher_up_is_bare_ground(height):
    scene = level_area(sky=0.4, terrain=jnp.full((SIZE, SIZE), height, float))
    np.testing.assert_allclose(nadir(scene), 0.3, rtol=1e-9)
    np.testing.assert_allclose(seen(scene), 0.3, rtol=1e-9)
    flux = fluxes_of(solver(ACCURACY)(scene))
    np.testing.assert_allclose(flux.albedo, 0.3, rtol=1e-9)
    np.testing.assert_allclose(flux.ground_absorbed, 0.7, rtol=1e-9)
    np.testing.assert_allclose(flux.transmitted, 1.0, rtol=1e-9)


@pytest.mark.study
def test_terrain_of_zeros_is_level_ground():
    scene = patchy()
    level = with_fields(scene, terrain=jnp.zeros((6, 8)))
    np.testing.assert_allclose(seen(level), seen(scene), rtol=1e-12)
    one, two = (fluxes_of(solver(ACCURACY)(s)) for s in (level, scene))
    for got, want in zip(jax.tree.leaves(one), jax.tree.leaves(two)):
        np.testing.assert_allclose(got, want, rtol=1e-12)


@pytest.mark.parametrize(
    ("azimuth", "rise"),
    [
        (270.0, 0.3),
        (90.0, 1.1),
        *(
            pytest.param(*case, marks=pytest.mark.study)
            for case in ((90.0, 0.3), (270.0, -0.2), (0.0, 0.5), (270.0, 1.5))
        ),
    ],
)
def test_tilted_plane(azimuth, rise):
    check_tilted_plane(azimuth, rise, 0.1)


def check_tilted_plane(azimuth, rise, vertical):
    """A plane that rises eastward: r cos(incidence) / cos(sun zenith), dark when turned away."""
    size, zenith, soil = 16, 50.0, 1e-3
    heights = (jnp.arange(size) - size / 2) * rise * 0.1 + 1.4
    scene = bare(
        size,
        "open",
        (zenith, azimuth),
        soil=soil,
        terrain=jnp.broadcast_to(heights, (size, size)),
        area_density=jnp.zeros((1, round(3 / vertical), size, size)),
        horizontal=0.1,
        vertical=vertical,
    )
    facing = towards(zenith, azimuth) @ np.array([-rise, 0.0, 1.0]) / np.hypot(rise, 1.0)
    want = soil * max(facing, 0.0) / np.cos(np.deg2rad(zenith))
    got = nadir(scene)[0, 5:-5, 5:-5]
    np.testing.assert_allclose(got, want, rtol=2e-3, atol=1e-9)


@pytest.mark.study
def test_tilted_plane_in_tall_voxels():
    """The height of the layers does not soften what the heights of the ground tell."""
    check_tilted_plane(90.0, 0.3, 1.0)


@pytest.mark.study
def test_a_wall_throws_its_shadow_away_from_the_sun():
    """Sun in the west at 30 degrees of height: 1.5 m of wall shade tan(60) times as much east.
    The edge of the shadow is as soft as a voxel is wide."""
    heights = jnp.full((SIZE, SIZE), 0.5, float).at[:, 2].set(2.0)
    scene = level_area(sun=(60.0, 270.0), soil=1e-3, terrain=heights)
    row = nadir(scene)[0, 6] / 1e-3
    print(np.round(row, 2))
    last = 2.5 + 1.5 * np.tan(np.deg2rad(60.0)) / 0.5  # 5.2 columns from the crest on
    assert np.all(row[4:6] < 0.02)
    np.testing.assert_allclose(row[[0, 10, 11]], 1.0, atol=0.02)
    assert (1 - row[4:]).sum() + 4 == pytest.approx(last, abs=0.75)
    # Turned round, so does the shadow.
    scene = level_area(sun=(60.0, 0.0), soil=1e-3, terrain=heights.T[::-1])
    np.testing.assert_allclose(nadir(scene)[0, ::-1, 6] / 1e-3, row, atol=1e-6)


@pytest.mark.parametrize("amplitude", [0.5, pytest.param(1.5, marks=pytest.mark.study)])
def test_white_furnace(amplitude):
    """Ground that keeps nothing, lit evenly from everywhere, is as bright as the sky."""
    scene = waves(level_area(sky=1.0, soil=1.0), amplitude)
    view, image = seen(scene), nadir(scene)
    print("views", view.ravel(), "image", image.min(), image.max())
    print("albedo", fluxes_of(solver(ACCURACY)(scene)).albedo)
    np.testing.assert_allclose(view, 1.0, atol=1e-6)
    np.testing.assert_allclose(image, 1.0, atol=1e-6)


@pytest.mark.study
@pytest.mark.parametrize("sky", [0.0, 0.3])
def test_bare_hills_against_photons(sky):
    scene = waves(level_area(sun=(45.0, 110.0), sky=sky), 1.2)
    want = reference.reflectance(scene, *VIEWS, photons=40_000, seed=1, band=0)
    got = seen(scene)[:, 0]
    print("off %", 100 * (got / want.mean - 1), "noise %", 100 * want.error / want.mean)
    np.testing.assert_allclose(got, want.mean, rtol=0.02)
    x = centres(SIZE, 0.5)
    rays = parallel_rays(x, x, 0.5, 0.0, 0.0)
    want = reference.image(scene, rays, samples=200, seed=2, band=0).mean
    got = nadir(scene)[0]
    print("rms", np.sqrt(np.mean((got / want - 1) ** 2)))
    assert np.sqrt(np.mean((got / want - 1) ** 2)) < 0.08
    assert np.corrcoef(got.ravel(), want.ravel())[0, 1] > 0.97


@pytest.mark.study
@pytest.mark.parametrize("band", [0, 1])
def test_shrubs_on_hills_against_photons(band):
    """A patchy canopy on hills of half its height."""
    scene = waves(patchy(shape=(8, 12, 12), size=0.1, sun=(35.0, 50.0)), 0.25)
    scene = above_ground(scene)
    want = reference.reflectance(scene, *VIEWS, photons=60_000, seed=1, band=band)
    got = seen(scene, REFINED)[:, band]
    print("off %", 100 * (got / want.mean - 1), "noise %", 100 * want.error / want.mean)
    np.testing.assert_allclose(got, want.mean, rtol=0.03)
    flux = fluxes_of(solver(REFINED)(scene))
    want = reference.fluxes(scene, photons=60_000, seed=2, band=band)
    found = {
        name: (getattr(flux, name)[band], getattr(want, name).mean)
        for name in ("albedo", "absorbed", "transmitted", "ground_absorbed")
    }
    print(found)
    for name, (one, two) in found.items():
        np.testing.assert_allclose(one, two, rtol=0.04, atol=0.003, err_msg=name)


def outcome(scene):
    """An image from aslant and the fluxes as one number."""
    light = solve_light(scene, ACCURACY_OF_DERIVATIVES)
    rng = np.random.default_rng(1)
    x, y = centres(8, 0.1), centres(6, 0.1)
    image = reflectance_factor(light, parallel_rays(x, y, 0.1, 35.0, 100.0))
    total = jnp.sum(rng.normal(size=image.shape) * image)
    flux = fluxes(light)
    return total + flux.albedo @ jnp.array([1.0, -2.0]) + flux.transmitted @ jnp.array([0.3, 0.7])


ACCURACY_OF_DERIVATIVES = Accuracy(
    lattice=1, sublayers=2, coarsening=(1, 1), levels=2, azimuths=4, tolerance=1e-12, margin=6
)
value, slope = jax.jit(outcome), jax.jit(jax.grad(outcome))


@pytest.mark.study
@pytest.mark.parametrize("boundary", ["periodic", pytest.param("open", marks=pytest.mark.slow)])
def test_derivative_with_respect_to_the_terrain(boundary):
    """Of gentle hills, and of the density and the sun above them."""
    scene = waves(patchy(boundary), 0.13)
    scene = with_fields(scene, terrain=scene.terrain + 0.013)
    gradient = slope(scene)
    for leaf in jax.tree.leaves(gradient):
        assert np.all(np.isfinite(leaf))
    rng = np.random.default_rng(2)
    h = 1e-6
    for select, step in (
        (lambda s: s.terrain, 0.1 * jnp.asarray(rng.normal(size=(6, 8)))),
        (lambda s: s.area_density, scene.area_density),
        (lambda s: s.illumination.sun_zenith, jnp.array(10.0)),
    ):
        along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, scene), step)
        forth, back = (jax.tree.map(lambda a, d, s=s: a + s * h * d, scene, along) for s in (1, -1))
        difference = float(value(forth) - value(back)) / (2 * h)
        got = float(jnp.sum(select(gradient) * step))
        assert got == pytest.approx(difference, rel=1e-5)
    if boundary == "open":
        _, pushed = jax.jit(lambda at, step: jax.jvp(outcome, (at,), (step,)))(scene, along)
        assert float(pushed) == pytest.approx(got, rel=1e-8)


@pytest.mark.study
@pytest.mark.parametrize("height", [0.0, 0.1])
def test_finite_on_level_ground(height):
    """Also at a plane between layers, and with the sun overhead."""
    scene = with_fields(
        patchy(), terrain=jnp.full((6, 8), height, float), illumination__sun_zenith=jnp.array(0.0)
    )
    for leaf in jax.tree.leaves(slope(scene)):
        assert np.all(np.isfinite(leaf))
