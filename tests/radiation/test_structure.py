"""Sun and sight on a structure finer than the voxels of the classes."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.errors import InputError
from fynjax.radiation import (
    Accuracy,
    directional_reflectance,
    fluxes,
    parallel_rays,
    reflectance_factor,
    render,
    solve_light,
    voxel_scene,
)
from fynjax.radiation._resample import axis_weights, nearest_cells, resample, sample_near
from fynjax.radiation._sun import trace_sun
from tests.radiation.scenes import slab, with_shape

FAST = Accuracy(levels=1, azimuths=4, tolerance=1e-9, refine=False)


def scene_of(density, *, zenith=0.0, times=2, seed=3, **changes):
    """Two classes in voxels of 0.2 m, their leaves in random halves of them, and the structure."""
    density = np.asarray(density, float)
    total = density.sum(axis=0)
    fine = np.repeat(np.repeat(np.repeat(total, times, 0), times, 1), times, 2)
    weights = np.random.default_rng(seed).random(fine.shape) ** 3
    blocks = [n for size in total.shape for n in (size, times)]
    mean = weights.reshape(blocks).mean(axis=(1, 3, 5))
    weights /= np.repeat(np.repeat(np.repeat(mean, times, 0), times, 1), times, 2)
    even = voxel_scene(
        area_density=jnp.asarray(density),
        reflectance=jnp.array([[0.05, 0.45], [0.2, 0.3]]),
        transmittance=jnp.array([[0.03, 0.45], [0.0, 0.0]]),
        leaf_angles=["spherical", "erectophile"],
        voxel=(0.2, 0.2, 0.2),
        ground=jnp.array([0.2, 0.3]),
        sun_zenith=zenith,
        sun_azimuth=90.0,
        **changes,
    )
    return even, dataclasses.replace(even, structure=jnp.asarray(fine * weights))


def shrubs(size=6, layers=4, seed=1):
    rng = np.random.default_rng(seed)
    filled = rng.random((1, layers, size, size)) > 0.4
    return rng.random((2, layers, size, size)) * 6.0 * filled


def fine_rays(scene, zenith=0.0, per_voxel=2):
    x = (jnp.arange(scene.shape[2] * per_voxel) + 0.5) * (scene.horizontal / per_voxel)
    return parallel_rays(x, x, scene.horizontal / per_voxel, zenith, 90.0)


def gap_and_sun(scene, rays, accuracy=FAST):
    """Gaps along the rays, and the sun's mean share on the ground."""

    @jax.jit
    def look(scene):
        light = solve_light(scene, accuracy)
        return render(light, rays).gap, light.sun.on_ground.mean()

    return look(scene)


def test_the_gap_is_that_of_the_fine_columns():
    density = shrubs()
    density[1] = 0.0  # spherical leaves: G is 1/2 everywhere
    even, structured = scene_of(density)
    gap, on_ground = gap_and_sun(structured, fine_rays(structured))
    columns = 0.5 * np.asarray(structured.structure).sum(axis=0) * 0.1
    np.testing.assert_allclose(gap, np.exp(-columns), rtol=1e-6)
    np.testing.assert_allclose(on_ground, np.exp(-columns).mean(), rtol=1e-6)
    filled, _ = gap_and_sun(even, fine_rays(even))
    assert float(filled.mean()) < 0.97 * float(gap.mean())


def test_a_ball_stops_the_light_of_the_formula():
    """Mean gap 2 [1 - (1 + t) exp(-t)] / t^2 at a depth t of 4, five voxels a radius."""
    x = (np.arange(96) + 0.5) / 8 - 6
    inside = (x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) < 25
    made = slab(1.0, [(0.0, 0.0, 1.0)], 0.0, layers=12, columns=12)
    made = dataclasses.replace(made, horizontal=0.2, vertical=0.2)
    expected = (1 - 2 * (1 - 5 * np.exp(-4.0)) / 16) * np.pi / 2.4**2
    errors = []
    for finer in (0, 4):
        sun = jax.jit(lambda s: trace_sun(s, 2, 1, 0))(with_shape(made, inside, finer, 4.0))
        errors.append((1 - float(sun.on_ground.mean())) / expected - 1)
    assert errors[0] > 0.02
    assert abs(errors[1]) < 0.005


@pytest.mark.parametrize("zenith", [25.0, 55.0])
def test_slanted_beams_lose_what_paths_through_the_structure_do(zenith):
    """Points followed one by one through the boxes of the structure."""
    density = shrubs()
    density[1] = 0.0
    _, structured = scene_of(density, zenith=zenith)
    fine = np.asarray(structured.structure)
    rng, steps = np.random.default_rng(5), 1600
    start = rng.random((4000, 2)) * 1.2
    height = (np.arange(steps) + 0.5) * (structured.height / steps)
    # The sun stands in the east.
    x = (start[:, :1] + height * np.tan(np.radians(zenith))) % 1.2
    cells = (height / 0.1).astype(int), (start[:, 1:] / 0.1).astype(int), (x / 0.1).astype(int)
    depth = 0.5 * fine[cells].sum(axis=1) * (structured.height / steps)
    expected = np.exp(-depth / np.cos(np.radians(zenith)))
    rays = fine_rays(structured, zenith, per_voxel=8)
    gap, got = gap_and_sun(structured, rays, dataclasses.replace(FAST, lattice=4))
    error = expected.std() / np.sqrt(len(expected))
    # Besides chance: beams are a quarter of a voxel wide.
    assert abs(float(got) - expected.mean()) < 3 * error + 0.01 * expected.mean()
    assert float(gap.mean()) == pytest.approx(float(got), rel=0.01)


def test_energy_is_closed():
    _, structured = scene_of(shrubs(), zenith=35.0, sky=jnp.array([0.3, 0.1]))
    accuracy = dataclasses.replace(FAST, refine=True)
    share = jax.jit(lambda scene: fluxes(solve_light(scene, accuracy)))(structured)
    total = share.albedo + share.absorbed.sum(axis=1) + share.ground_absorbed
    np.testing.assert_allclose(total, 1.0, atol=1e-5)


@pytest.mark.parametrize(
    "changes", [pytest.param({}, marks=pytest.mark.study), {"leaf_diameter": 0.05}]
)
def test_an_even_structure_changes_nothing(changes):
    density = np.repeat(shrubs()[:, :, :1, :1], 6, axis=2).repeat(6, axis=3)
    even, _ = scene_of(density, zenith=35.0, **changes)
    total = even.area_density.sum(axis=0)
    fine = jnp.repeat(jnp.repeat(jnp.repeat(total, 2, 0), 2, 1), 2, 2)
    views = jnp.array([0.0, 50.0]), 200.0
    look = jax.jit(lambda scene: directional_reflectance(solve_light(scene, FAST), *views))
    plain, structured = (look(scene) for scene in (even, dataclasses.replace(even, structure=fine)))
    # Finer layers integrate the light between them a little differently.
    np.testing.assert_allclose(structured, plain, rtol=4e-3)


def test_rows_of_rays_follow_the_structure_as_all_of_them_do(monkeypatch):
    _, structured = scene_of(shrubs(16, 2), zenith=20.0)
    light, rays = jax.jit(lambda s: solve_light(s, FAST))(structured), fine_rays(structured)
    whole = jax.jit(lambda at: render(at, rays).total)(light)
    monkeypatch.setattr("fynjax.radiation._image.MOST_RAYS", math.prod(rays.shape) // 3)
    rows = jax.jit(lambda at: render(at, rays).total)(light)
    np.testing.assert_allclose(rows, whole, rtol=1e-9)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
@pytest.mark.parametrize("width", [0.3, 1.0, 1.7, 2.5])
def test_cells_read_one_by_one_give_what_the_product_gives(boundary, width):
    rng = np.random.default_rng(2)
    field = jnp.asarray(rng.random((13, 17)))
    rows, columns = jnp.asarray(rng.uniform(-2.0, 15.0, 9)), jnp.asarray(rng.uniform(-2.0, 19.0, 7))
    axes = (rows, width, 13, 1.0, boundary), (columns, width, 17, 1.0, boundary)

    def single(by):
        return sample_near(field, *(nearest_cells(a[0] + by, *a[1:]) for a in axes))

    @jax.jit
    def read(by):
        product = resample(field, *(axis_weights(*axis) for axis in axes))
        return product, single(by), jax.value_and_grad(lambda by: (single(by) ** 2).sum())(by)

    product, one_by_one, (_, slope) = read(0.0)
    np.testing.assert_allclose(one_by_one, product, atol=1e-12)
    difference = (read(1e-6)[2][0] - read(-1e-6)[2][0]) / 2e-6
    assert float(slope) == pytest.approx(float(difference), rel=1e-4, abs=1e-8)


def test_derivatives_are_those_of_differences():
    even, structured = scene_of(shrubs(4, 2), zenith=35.0)
    rng = np.random.default_rng(7)

    @jax.jit
    @jax.value_and_grad
    def loss(by, start, towards):
        area, structure = (a + b * d for a, b, d in zip(start, by, towards))
        moved = dataclasses.replace(structured, area_density=area, structure=structure)
        light = solve_light(moved, dataclasses.replace(FAST, lattice=1))
        return (render(light, fine_rays(moved, 20.0)).total ** 2).mean()

    start = structured.area_density, structured.structure
    towards = tuple(a * jnp.asarray(rng.standard_normal(a.shape)) for a in start)
    _, slope = loss(jnp.zeros(2), start, towards)
    step = 1e-5
    for i, unit in enumerate(np.eye(2)):
        ends = [loss(k * step * unit, start, towards)[0] for k in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * step)
        assert float(slope[i]) == pytest.approx(float(difference), rel=1e-4)
    # Where nothing stands, the first leaf has its derivative too.
    bare = tuple(map(jnp.zeros_like, start))
    grown = even.area_density, structured.structure
    dark, slope = loss(jnp.zeros(2), bare, grown)
    difference = (loss(jnp.full(2, step), bare, grown)[0] - dark) / step
    assert float(slope.sum()) == pytest.approx(float(difference), rel=1e-2)


def test_a_structure_that_is_not_that_of_the_classes_is_refused():
    _, structured = scene_of(shrubs())
    denser = dataclasses.replace(structured, area_density=2.0 * structured.area_density)
    with pytest.raises(InputError, match="changed alone"):
        solve_light(denser, FAST)


@pytest.mark.untyped
def test_a_structure_that_does_not_divide_the_voxels_is_refused():
    even, _ = scene_of(shrubs())
    for shape in ((4, 6, 9), (4, 12, 6), (5, 6, 6), (4, 6)):
        with pytest.raises(InputError, match="whole number of finer voxels"):
            solve_light(dataclasses.replace(even, structure=jnp.zeros(shape)), FAST)


def test_many_bands_are_seen_along_all_rays_of_a_block():
    """The light of a band is taken along a block's middle, the plants are met by each ray."""
    _, structured = scene_of(shrubs(), times=4)
    accuracy = dataclasses.replace(FAST, solves=1)  # fewer than bands: reduced

    def pixels(image):  # one a voxel
        return image.reshape(2, 6, -1, 6, image.shape[2] // 6).mean(axis=(2, 4))

    @jax.jit
    def images(scene):
        light = solve_light(scene, accuracy)
        dense, sparse = (fine_rays(scene, per_voxel=n) for n in (4, 2))
        every, less = (reflectance_factor(light, rays) for rays in (dense, sparse))
        return tuple(map(pixels, (every, reflectance_factor(light, dense, together=2), less)))

    every, blocks, sparse = images(structured)
    off = lambda image: float(np.abs(image / every - 1).max())  # noqa: E731
    assert off(blocks) < 5e-3 < 0.1 < off(sparse)
    np.testing.assert_allclose(blocks.mean(axis=(1, 2)), every.mean(axis=(1, 2)), rtol=5e-4)
    uneven = lambda s: reflectance_factor(solve_light(s), fine_rays(s), together=5)  # noqa: E731
    with pytest.raises(InputError, match=r"`together` must divide .* does not divide 12 x 12"):
        jax.eval_shape(uneven, structured)
