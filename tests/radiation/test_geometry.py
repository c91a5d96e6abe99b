"""Where light goes: ray boxes by hand, shadows on the right side, cameras, ordinates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import SphericalLeafAngle
from fynjax.radiation import (
    Accuracy,
    Illumination,
    OpticalClasses,
    VoxelScene,
    nadir_rays,
    parallel_rays,
    render,
)
from fynjax.radiation._ordinates import Ordinates, coarse_grid, sweep
from tests.radiation.scenes import fluxes_of, patchy, solver, towards

see = jax.jit(render)
BEAMS = Accuracy(lattice=8, sublayers=16, coarsening=(1, 1), levels=1, azimuths=4, margin=8)


def path_depth(scene, start, direction):
    """Optical depth from a point up to the top, box by box (spherical leaves, G = 1/2)."""
    density = 0.5 * np.asarray(scene.area_density).sum(axis=0)
    nz, ny, nx = density.shape
    size = np.array([scene.horizontal, scene.horizontal, scene.vertical])
    length = (scene.height - start[2]) / direction[2]
    cuts = [0.0, length]
    for p, d, s in zip(start, direction, size, strict=True):
        if abs(d) > 1e-12:
            ends = sorted((p / s, (p + d * length) / s))
            planes = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)
            cuts.extend((planes * s - p) / d)
    cuts = np.unique(np.clip(cuts, 0, length))
    middle = start + direction * (0.5 * (cuts[1:] + cuts[:-1]))[:, None]
    x, y, z = np.floor(middle / size).astype(int).T
    inside = np.ones(len(x), bool)
    if scene.boundary == "open":
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
    return float(np.diff(cuts) @ (density[z.clip(0, nz - 1), y % ny, x % nx] * inside))


def single(density, boundary, sun, soil=0.2):
    """One spherical class in one band over even soil, voxels of 10 cm, no sky."""
    return VoxelScene(
        jnp.asarray(density)[None],
        OpticalClasses(jnp.array([[0.3]]), jnp.array([[0.2]]), (SphericalLeafAngle(),), (0,)),
        jnp.array([soil]),
        Illumination(*(jnp.array(a) for a in (float(sun[0]), float(sun[1]), [1.0], [0.0]))),
        0.1,
        0.1,
        boundary,
    )


def random_density():
    rng = np.random.default_rng(8)
    return rng.gamma(0.5, 6.0, (4, 6, 8)) * (rng.random((4, 6, 8)) > 0.4)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_gaps_along_slant_rays_box_by_box(boundary):
    """Narrow rays at 40 degrees; pieces of 1/16 of a voxel leave 2 % of a ray's depth at worst."""
    scene = single(random_density(), boundary, (25.0, 60.0))
    x, y = jnp.linspace(0.031, 0.777, 7), jnp.linspace(0.017, 0.563, 5)
    gap = see(solver(BEAMS)(scene), parallel_rays(x, y, 1e-4, 40.0, 200.0)).gap
    direction = towards(40.0, 200.0)
    want = [[path_depth(scene, np.array([a, b, 0.0]), direction) for a in x] for b in y]
    np.testing.assert_allclose(-np.log(gap), want, atol=0.05)
    np.testing.assert_allclose(np.mean(-np.log(gap)), np.mean(want), rtol=0.01)


@pytest.mark.parametrize("sun", [(25.0, 60.0), (60.0, 290.0)])
def test_direct_light_at_the_ground_box_by_box(sun):
    """The mean over the ground of beams traced from a fine lattice of points."""
    scene = single(random_density(), "periodic", sun)
    direction = towards(*sun)
    points = [(x, y, 0.0) for x in (np.arange(48) + 0.5) / 60 for y in (np.arange(36) + 0.5) / 60]
    want = np.mean([np.exp(-path_depth(scene, np.array(p), direction)) for p in points])
    got = fluxes_of(solver(BEAMS)(scene)).transmitted_direct
    np.testing.assert_allclose(got, want, rtol=5e-3)


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0, 270.0])
def test_a_shadow_falls_away_from_the_sun(azimuth):
    """One dense voxel 0.2 to 0.3 m up under a sun at 45 degrees: its shadow lies, shifted by
    0.2 to 0.3 m, on the side that faces away."""
    density = np.zeros((4, 12, 12))
    density[2, 6, 5] = 1e3  # x 0.5 to 0.6 m, y 0.6 to 0.7 m
    light = solver(BEAMS)(single(density, "open", (45.0, azimuth)))
    x = jnp.asarray((np.arange(120) + 0.5) / 100)
    ground = np.asarray(see(light, parallel_rays(x, x, 0.005, 0.0, 0.0)).ground)[0]
    shadow = ground < 0.02 * ground.max()
    shadow[60:70, 50:60] = False  # the voxel itself hides the ground below
    rows, columns = np.nonzero(shadow)
    away = -towards(45.0, azimuth) / np.cos(np.pi / 4)
    middle = np.array([0.55, 0.65]) + 0.25 * away[:2]
    half = 0.05 + 0.05 * np.abs(away[:2])
    assert len(rows) > 100
    np.testing.assert_allclose(
        [(columns.min() + columns.max() + 1) / 200, (rows.min() + rows.max() + 1) / 200],
        middle,
        atol=0.02,
    )
    np.testing.assert_allclose(
        [(np.ptp(columns) + 1) / 200, (np.ptp(rows) + 1) / 200], half, atol=0.02
    )


def test_a_frame_camera_sees_each_pixel_from_its_own_side():
    """Each pixel of a camera equals a parallel view of its own direction, but for the diffuse
    light, which is taken towards the middle."""
    scene = patchy(sky=(0.0, 0.0))
    light = solver(BEAMS)(scene)
    x, y = jnp.linspace(0.05, 0.75, 5), jnp.linspace(0.05, 0.55, 4)
    frame = see(light, nadir_rays(x, y, 0.02, (0.3, 0.4, 2.0)))
    for row, column in ((0, 0), (3, 1), (2, 4)):
        slope = np.array([(0.3 - x[column]) / 2.0, (0.4 - y[row]) / 2.0])
        zenith = np.rad2deg(np.arctan(np.hypot(*slope)))
        azimuth = np.rad2deg(np.arctan2(*slope))
        one = see(light, parallel_rays(x[column][None], y[row][None], 0.02, zenith, azimuth))
        for part in ("sunlit_leaves", "ground"):
            got, want = getattr(frame, part)[:, row, column], getattr(one, part)[:, 0, 0]
            np.testing.assert_allclose(got, want, rtol=1e-3, atol=1e-7)
        np.testing.assert_allclose(frame.gap[row, column], one.gap[0, 0], rtol=1e-4)


@pytest.mark.parametrize("ordinate", [0, 5, 11, 12, 17, 23])
def test_light_of_one_cell_travels_along_its_ordinate(ordinate):
    """In empty space the light of one cell is centred on the line through the cell, sideways by
    the ordinate's slope times the height: linear shifts keep the centre. In its own layer it is
    seen a third of the layer further on, in the mean."""
    n, layers, start = 41, 4, 1
    scene = single(np.zeros((layers, n, n)), "periodic", (10.0, 0.0))
    ordinates = Ordinates.create(2, 6)
    coarse = coarse_grid(scene, scene.area_density, (1, 1), ordinates)
    source = jnp.zeros((24, layers, n, n)).at[ordinate, start, n // 2, n // 2].set(1.0)
    zero = jnp.zeros((n, n))
    mean, falling, top = sweep(coarse, source, jnp.zeros(12), zero, zero)
    vector = ordinates.vectors[ordinate]
    cell = (np.arange(n) - n // 2) * 0.1
    up = vector[2] > 0
    for layer in range(layers):
        light = np.asarray(mean)[ordinate, layer]
        if layer != start and (layer > start) != up:
            np.testing.assert_array_equal(light, 0.0)
            continue
        centre = np.array([(light.sum(0) @ cell), (light.sum(1) @ cell)]) / light.sum()
        distance = 0.1 * (layer - start) / vector[2]
        if layer == start:
            distance = 0.1 / 3 / abs(vector[2])
        np.testing.assert_allclose(centre, vector[:2] * distance, atol=0.03)
        if layer != start:
            # Light emitted at unit rate over the cell's chord, seen in a layer it fully crosses.
            np.testing.assert_allclose(light.sum(), 0.1 / abs(vector[2]), rtol=1e-12)
    assert not np.asarray(mean)[np.arange(24) != ordinate].any()
    leaving = np.asarray(top if up else falling.sum(axis=0))
    centre = np.array([(leaving.sum(0) @ cell), (leaving.sum(1) @ cell)]) / leaving.sum()
    height = 0.1 * ((layers - start if up else start) + (-0.5 if up else 0.5))
    np.testing.assert_allclose(centre, vector[:2] * height / abs(vector[2]), atol=1e-12)


def test_light_of_one_spot_of_ground_travels_along_each_ordinate():
    """It starts at the ground, half a layer below the middle of the first."""
    n, layers = 41, 4
    scene = single(np.zeros((layers, n, n)), "periodic", (10.0, 0.0))
    ordinates = Ordinates.create(2, 6)
    coarse = coarse_grid(scene, scene.area_density, (1, 1), ordinates)
    spot = jnp.zeros((n, n)).at[n // 2, n // 2].set(1.0)
    dark = jnp.zeros((24, layers, n, n))
    mean, _, _ = sweep(coarse, dark, jnp.zeros(12), jnp.ones((n, n)), spot)
    cell = (np.arange(n) - n // 2) * 0.1
    for ordinate in range(12, 24):
        vector = ordinates.vectors[ordinate]
        for layer in range(layers):
            light = np.asarray(mean)[ordinate, layer]
            assert light.sum() == pytest.approx(1 / np.pi)
            centre = np.array([(light.sum(0) @ cell), (light.sum(1) @ cell)]) / light.sum()
            height = 0.1 * (layer + 0.5)
            np.testing.assert_allclose(centre, vector[:2] / vector[2] * height, atol=1e-9)


def test_ordinates_integrate_the_sphere():
    ordinates = Ordinates.create(3, 6)
    vectors, weights = ordinates.vectors, ordinates.weights
    assert weights.sum() == pytest.approx(4 * np.pi)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0)
    np.testing.assert_allclose(weights @ vectors, 0.0, atol=1e-12)
    np.testing.assert_allclose(
        (vectors * weights[:, None]).T @ vectors, np.eye(3) * 4 * np.pi / 3, atol=1e-12
    )
    downward = vectors[:, 2] < 0
    assert weights[downward] @ -vectors[downward, 2] == pytest.approx(np.pi)
