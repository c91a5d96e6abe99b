"""Waveforms against closed forms, scenes of discs, and draws; their gradients."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import leaf_angle
from fynjax.radiation._phase import area_scattering
from fynjax.sensors import expected_returns, lidar_waveforms
from fynjax.sensors.lidar._path import backscatter
from tests.helpers import assert_gradients
from tests.sensors.lidar_scenes import VOXEL, flash, patchy, scanner, slab

EXTENT = (0.4, 0.4)
ANGLES = ("spherical", "planophile", "erectophile", "uniform")


def cosines(beams):
    return -beams.direction[:, 2]


def projection(angle, cosine):
    return np.asarray(leaf_angle(angle).projection(jnp.asarray(cosine)))


@pytest.mark.parametrize("angle", ANGLES)
def test_backscatter_is_the_area_scattering_straight_back(angle):
    zenith = np.deg2rad([0.0, 12.0, 35.0, 60.0])
    towards = np.stack([np.sin(zenith), 0 * zenith, np.cos(zenith)], axis=-1)
    for one in towards:
        vector = jnp.asarray(one[None])
        reflected, transmitted = area_scattering(leaf_angle(angle), -vector, vector)
        own = backscatter(leaf_angle(angle), jnp.asarray(one[2]))
        assert own == pytest.approx(float(reflected[0, 0]), rel=2e-3)
        assert float(transmitted[0, 0]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lidar", [flash(), scanner(line_offsets=(150.0,), pulse_density=200.0)])
@pytest.mark.parametrize("angle", ["spherical", "planophile"])
def test_returns_of_a_slab_follow_the_gap_law(lidar, angle):
    scene = slab(3.0, angle=angle)
    beams = lidar.beams(EXTENT, top=scene.height)
    edges = np.linspace(0.0, 1.2, 9)  # not the layers' own
    canopy, ground = expected_returns(scene, beams, edges)
    mu = cosines(beams)
    above = np.clip(1.0 - edges, 0.0, None)
    gap = np.exp(-3.0 * projection(angle, mu) / mu * above[:, None]).sum(axis=1)
    np.testing.assert_allclose(canopy, np.diff(gap), rtol=1e-4, atol=1e-6)
    assert float(ground) == pytest.approx(gap[0], rel=1e-4)
    assert float(canopy.sum() + ground) == pytest.approx(len(beams))


def test_beams_follow_a_structure_finer_than_the_voxels():
    scene = slab(3.0)
    even = dataclasses.replace(scene, structure=fine_voxels(scene.area_density[0]))
    columns = np.random.default_rng(8).random((1, 8, 8)) ** 4
    columns /= columns.reshape(4, 2, 4, 2).mean(axis=(1, 3)).repeat(2, 0).repeat(2, 1)
    uneven = dataclasses.replace(even, structure=even.structure * columns)
    lidar = scanner(line_offsets=(0.0,), pulse_density=4000.0)
    beams = lidar.beams(EXTENT, top=scene.height)
    edges = np.linspace(0.0, 1.2, 9)
    plain, alike, structured = (
        expected_returns(one, beams, edges) for one in (scene, even, uneven)
    )
    np.testing.assert_allclose(alike[0], plain[0], rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(alike[1], plain[1], rtol=1e-5)
    # Each pencil averages over its width: between voxels filled evenly and lines without one.
    lines = np.exp(-0.5 * 3.0 * columns / cosines(beams).mean()).mean()
    assert 1.5 * float(plain[1]) < float(structured[1]) < len(beams) * lines
    np.testing.assert_allclose(structured[0].sum() + structured[1], len(beams))


def fine_voxels(density):
    """Half as large."""
    for axis in range(3):
        density = jnp.repeat(density, 2, axis)
    return density


@pytest.mark.parametrize("lidar", [flash(), scanner(line_offsets=(150.0,), pulse_density=200.0)])
def test_energy_of_a_slab_counts_the_gap_once(lidar):
    """Leaves: the integral of rho Gamma exp(-G u s) over the path; ground: rho cos exp(-tau)."""
    scene = slab(2.0, angle="planophile")
    beams = lidar.beams(EXTENT, top=scene.height)
    waveforms = lidar_waveforms(scene, lidar, beams, multiple=False)
    mu = cosines(beams)
    g = projection("planophile", mu)
    back = np.asarray(backscatter(leaf_angle("planophile"), jnp.asarray(mu)))
    gap = np.exp(-2.0 * g / mu)
    np.testing.assert_allclose(waveforms.canopy.sum(1), 0.45 * back / g * (1 - gap), rtol=3e-4)
    np.testing.assert_allclose(waveforms.ground.sum(1), 0.3 * mu * gap, rtol=3e-4)


def test_the_shape_of_a_slab_is_its_decay_under_the_pulse():
    """Every sample against a fine quadrature of decay, pulse and sample."""
    scene, lidar = slab(2.0), flash(pencils=1)
    beams = lidar.beams(EXTENT, top=scene.height).select(np.array([40]))
    found = np.asarray(lidar_waveforms(scene, lidar, beams, multiple=False).canopy[0])
    mu = cosines(beams)[0]
    depth = (np.arange(20000) + 0.5) * (1.0 / mu / 20000)
    sent = 0.45 / 3.0 * 2.0 * np.exp(-0.5 * 2.0 * depth) * (1.0 / mu / 20000)
    distance = (50.0 - 1.0) / mu + depth
    fine = beams.start[0] + (np.arange(beams.samples * 30) + 0.5) * lidar.sample / 30
    pulse = np.exp(-0.5 * ((fine[:, None] - distance[::20]) / lidar.pulse_sd) ** 2)
    pulse = pulse / (lidar.pulse_sd * np.sqrt(2 * np.pi)) * lidar.sample / 30
    wanted = (pulse @ sent.reshape(-1, 20).sum(1)).reshape(-1, 30).sum(1)
    np.testing.assert_allclose(found, wanted, atol=2e-3 * wanted.max())


@pytest.mark.parametrize("tilt", [0.0, 20.0, 35.0])
def test_bare_slope_is_the_closed_form(tilt):
    """Energy rho cos(incidence); width from pulse, sample, and footprint times slope."""
    lidar = scanner(
        line_offsets=(0.0,), pulse_density=4.0, divergence_mrad=2.0, altitude=500.0, pencils=9
    )
    columns = 40
    x = (np.arange(columns) + 0.5) * VOXEL
    slope = np.tan(np.deg2rad(tilt))
    terrain = jnp.asarray(np.broadcast_to(slope * x, (columns, columns)))
    scene = slab(0.0, layers=30, columns=columns, boundary="open", terrain=terrain)
    beams = lidar.beams((4.0, 4.0), top=scene.height)
    middle = np.all(np.abs(beams.on_ground - 2.0) < 1.0, axis=1)
    beams = beams.select(middle)
    assert len(beams) > 5
    found = np.asarray(lidar_waveforms(scene, lidar, beams).ground)
    normal = np.array([-np.sin(np.deg2rad(tilt)), 0.0, np.cos(np.deg2rad(tilt))])
    np.testing.assert_allclose(found.sum(1), 0.3 * -(beams.direction @ normal), rtol=2e-4)
    samples = (np.arange(beams.samples) + 0.5) * lidar.sample
    mean = found @ samples / found.sum(1)
    plane = -(beams.origin @ normal) / (beams.direction @ normal)
    np.testing.assert_allclose(beams.start + mean, plane, atol=5e-3)
    spread = (found * (samples - mean[:, None]) ** 2).sum(1) / found.sum(1)
    along_slope = 2e-3 / 4 * (500.0 - 2 * slope) * slope
    wanted = lidar.pulse_sd**2 + lidar.sample**2 / 12 + along_slope**2
    np.testing.assert_allclose(spread, wanted, rtol=0.02)


def test_terrain_hides_what_lies_behind_it():
    """Seen from the side, a wall's lee is not hit: what is hit is above the line of sight."""
    height = np.zeros((20, 20))
    height[:, 9:11] = 0.8
    lidar = scanner(line_offsets=(181.0,), pulse_density=2000.0, pencils=1)
    scene = slab(0.0, layers=10, columns=20, boundary="open", terrain=jnp.asarray(height))
    beams = lidar.beams((2.0, 2.0), top=scene.height)
    found = np.asarray(lidar_waveforms(scene, lidar, beams).ground)
    samples = beams.start[:, None] + (np.arange(beams.samples) + 0.5) * lidar.sample
    distance = (found * samples).sum(1) / found.sum(1)
    x = beams.origin[:, 0] + distance * beams.direction[:, 0]
    # The sensor is in the east: the shadow of the wall is 0.8 m times the tangent to its west.
    reach = 0.8 * 181.0 / 500.0  # from the wall's upper edge, at 0.95 m
    assert np.sum((x > 0.97 - reach) & (x < 0.84)) == 0
    assert np.sum((x > 0.3) & (x < 0.6)) > 100


def test_first_hits_of_discs_follow_the_expectation():
    """Independent: discs thrown at random in a box, and rays intersected with each of them."""
    draw = np.random.default_rng(5)
    radius, side, count = 0.02, 0.8, 3000
    centre = draw.random((count, 3)) * [side, side, 0.6]
    normal = draw.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rays = draw.random((3000, 2)) * side
    away = rays[:, None] - centre[:, :2]
    away -= side * np.round(away / side)
    rise = -np.einsum("rnk,nk->rn", away, normal[:, :2]) / normal[:, 2]
    hit = (away**2).sum(-1) + rise**2 < radius**2
    top = np.where(hit, centre[:, 2] + rise, -1.0).max(axis=1)
    lai = count * np.pi * radius**2 / side**2
    scene = slab(lai, layers=6, columns=8)
    lidar = scanner(line_offsets=(0.0,), altitude=5000.0, pulse_density=100.0)
    beams = lidar.beams((side, side), top=scene.height)
    edges = np.array([-0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7])
    canopy, ground = expected_returns(scene, beams, np.clip(edges, 0.0, None))
    share = np.r_[float(ground), canopy] / len(beams)
    seen = np.r_[np.sum(top < -0.5), np.histogram(top[top > -0.5], edges)[0]] / len(rays)
    # Rays share discs: more than binomial noise, by about the rays that meet the same disc.
    sd = np.sqrt(share * (1 - share) / len(rays) * (1 + len(rays) * 0.5 * radius**2 / side**2 * 6))
    assert np.all(np.abs(seen - share) < 4 * sd + 0.005)


def test_draws_have_the_expected_waveform_as_mean():
    scene = patchy()
    lidar = scanner(line_offsets=(100.0,), pulse_density=3000.0, pencils=4)
    beams = lidar.beams((0.3, 0.3), top=scene.height)
    mean = np.asarray(lidar_waveforms(scene, lidar, beams).total).mean(0)
    runs = np.stack(
        [
            np.asarray(lidar_waveforms(scene, lidar, beams, key=jax.random.key(k)).total).mean(0)
            for k in range(24)
        ]
    )
    error = runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.all(np.abs(runs.mean(0) - mean) < 4.5 * error + 1e-4 * mean.max() + 5e-3 * mean)
    assert runs.std(axis=0).max() > 1e-3 * mean.max()


def test_draws_repeat_with_their_key():
    scene, lidar = slab(), flash()
    beams = lidar.beams(EXTENT, top=scene.height)
    one, same, other = (
        lidar_waveforms(scene, lidar, beams, key=jax.random.key(k), multiple=False).canopy
        for k in (1, 1, 2)
    )
    assert jnp.array_equal(one, same)
    assert not jnp.array_equal(one, other)


@pytest.mark.slow
def test_gradients_of_waveforms_and_expected_returns():
    """In the density of some voxels, in optics, and in the heights of the ground."""
    lidar = scanner(
        line_offsets=(8.0,), pulse_density=60.0, pencils=2, divergence_mrad=1.0, altitude=60.0
    )
    relief = np.random.default_rng(2).uniform(0.02, 0.12, (3, 3))
    scene = patchy(terrain=jnp.asarray(relief))
    beams = lidar.beams((0.3, 0.3), top=scene.height)
    edges = np.linspace(0.0, 0.4, 5)

    @jax.jit
    def measure(values):
        density, rho, ground, terrain = values
        there = eqx.tree_at(
            lambda s: (s.area_density, s.classes.reflectance, s.ground, s.terrain),
            scene,
            (scene.area_density.at[:, 1:3, 1, 1].set(density), rho, ground, terrain),
        )
        waveform = lidar_waveforms(there, lidar, beams).total
        return waveform, expected_returns(there, beams, edges)

    at = (scene.area_density[:, 1:3, 1, 1], scene.classes.reflectance, scene.ground, scene.terrain)
    assert_gradients(measure, at, step=1e-5, rtol=2e-5)


def test_gradients_are_finite_without_leaves():
    scene, lidar = slab(0.0), flash()
    beams = lidar.beams(EXTENT, top=scene.height)

    def energy(density, tau):
        there = eqx.tree_at(
            lambda s: (s.area_density, s.classes.transmittance), scene, (density, tau)
        )
        waveforms = lidar_waveforms(there, lidar, beams, multiple=False)
        return waveforms.total.sum()

    density, tau = jax.grad(energy, argnums=(0, 1))(scene.area_density, jnp.array([[0.4]]))
    assert np.all(np.isfinite(density))
    assert np.asarray(density)[0, :10].any()
    assert np.isfinite(tau).all()


def test_transformations_and_batches_agree():
    scene = patchy()
    lidar = scanner(line_offsets=(100.0,), pulse_density=200.0)
    beams = lidar.beams((0.3, 0.3), top=scene.height)
    plain = lidar_waveforms(scene, lidar, beams).total
    parts = lidar_waveforms(scene, lidar, beams, batch=5).total
    np.testing.assert_allclose(parts, plain, atol=1e-12)

    def measure(rho):
        there = eqx.tree_at(lambda s: s.classes.reflectance, scene, rho)
        return lidar_waveforms(there, lidar, beams).total

    both = jnp.stack([scene.classes.reflectance, 2.0 * scene.classes.reflectance])
    many = jax.jit(jax.vmap(measure))(both)
    np.testing.assert_allclose(many[0], plain, atol=1e-12)
    np.testing.assert_allclose(many[1], measure(both[1]), atol=1e-12)
    single = jax.tree.map(lambda a: a.astype(jnp.float32), scene)
    low = lidar_waveforms(single, lidar, beams).total
    assert low.dtype == jnp.float32
    np.testing.assert_allclose(low, plain, atol=2e-3 * float(plain.max()))


def test_the_gate_cuts_the_record():
    scene, lidar = slab(2.0), flash()

    def total(lidar, beams):
        return lidar_waveforms(scene, lidar, beams, multiple=False).total

    assert lidar.gate is not None
    whole = lidar.beams(EXTENT, top=scene.height)
    short = dataclasses.replace(lidar, gate=(40.0, 49.6))
    beams = short.beams(EXTENT, top=scene.height)
    assert beams.samples == 64
    cut = total(short, beams)
    np.testing.assert_allclose(cut, total(lidar, whole)[:, :64], atol=1e-12)
    late = dataclasses.replace(lidar, gate=(49.45, 50.95))
    beams = late.beams(EXTENT, top=scene.height)
    np.testing.assert_allclose(total(late, beams)[:, :9], total(lidar, whole)[:, 63:72], atol=1e-9)


def test_bad_input_is_refused():
    scene, lidar = slab(), flash()
    beams = lidar.beams(EXTENT, top=scene.height)
    with pytest.raises(InputError, match="above the canopy"):
        flash(altitude=1.1).beams(EXTENT, top=scene.height)
    with pytest.raises(InputError, match="above the grid"):
        lidar_waveforms(
            scene, lidar, dataclasses.replace(beams, origin=beams.origin * [1, 1, 0.02])
        )
    two = jnp.array([[0.4, 0.5]])
    optics = lambda s: (s.classes.reflectance, s.classes.transmittance, s.ground)  # noqa: E731
    with pytest.raises(InputError, match="one band"):
        lidar_waveforms(eqx.tree_at(optics, scene, (two, two, two[0])), lidar, beams)
    with pytest.raises(InputError, match=r"Lidar\.beams"):
        lidar_waveforms(scene, lidar, dataclasses.replace(beams, samples=0))
