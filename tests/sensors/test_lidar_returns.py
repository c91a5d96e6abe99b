"""Beams, noise and the detector, against closed forms and statistics."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from fynjax._core.errors import InputError
from fynjax.sensors import (
    LidarNoise,
    Waveforms,
    detect_returns,
    lidar_waveforms,
    received_electrons,
    shipped_lidar,
    shipped_lidars,
)
from fynjax.sensors.lidar._returns import GROUND, VEGETATION
from tests.sensors.lidar_scenes import flash, scanner, slab


def echoes(lidar, beams, distances, strengths):
    """Waveforms of points at `distances`, the same for every beam."""
    edges = beams.start[:, None] + np.arange(beams.samples + 1) * lidar.sample
    parts = [
        s * np.diff(ndtr((edges - d) / lidar.pulse_sd), axis=1)
        for d, s in zip(distances, strengths)
    ]
    return np.sum(parts, axis=0)


def pixels(lidar, count):
    """Beams in the middle of the flash, where the irradiance is 1."""
    beams = lidar.beams((5.0, 5.0), top=2.0)
    near = np.argsort(-beams.irradiance)[:1]
    return beams.select(np.repeat(near, count))


def quiet(lidar, signal=1e6):
    return dataclasses.replace(lidar, noise=LidarNoise(signal, 0.0, 1.0))


def detect(lidar, beams, canopy, ground, key=None):
    truth = Waveforms(jnp.asarray(canopy), jnp.asarray(ground))
    electrons = received_electrons(lidar, beams, truth.total, key=key)
    return detect_returns(lidar, beams, np.asarray(electrons), truth)


def test_table_3_of_the_paper():
    """Footprint 7.11 m, frames of 5 m, 4 of them over 10 m, pixels of 4 cm, 67 samples of 15 cm."""
    lidar = shipped_lidar("flash_lidar_paper")
    assert 2 * 50 * np.tan(lidar.geometry.half_divergence_rad) == pytest.approx(7.11, abs=0.01)
    beams = lidar.beams((10.0, 10.0), top=3.0)
    assert len(beams) == 4 * 128 * 128
    assert len(np.unique(beams.time)) == 4
    place = np.unique(beams.origin, axis=0)
    np.testing.assert_allclose(place[:, :2], [[2.5, 2.5], [2.5, 7.5], [7.5, 2.5], [7.5, 7.5]])
    x = np.unique(beams.on_ground[:, 0].round(9))
    np.testing.assert_allclose(np.diff(x)[:100], 0.0390625, rtol=1e-6)
    corner = beams.irradiance.min()
    assert corner == pytest.approx(np.exp(-2 * (np.arctan(0.0496 * 2**0.5) / 0.071) ** 2), rel=0.01)
    bare = dataclasses.replace(lidar, gate=(40.0, 50.0))
    assert bare.beams((10.0, 10.0), top=3.0).samples == 67
    assert 2.3548 * lidar.pulse_sd == pytest.approx(0.5 * 0.2998 * 2.0, rel=1e-3)


@pytest.mark.parametrize("name", ["flash_lidar_paper", "scanning_lidar"])
def test_pulses_cover_the_plot_at_the_height_of_its_ground(name):
    lidar = shipped_lidar(name)
    level, high = (lidar.beams((20.0, 20.0), top=13.0, ground=g) for g in (0.0, 10.0))
    assert len(high) == len(level)
    np.testing.assert_allclose(high.at_height(10.0), level.on_ground, atol=1e-9)


def test_less_comes_back_to_the_same_system_from_higher_up():
    low = shipped_lidar("flash_lidar_paper")
    assert low.at(100.0).noise.signal_electrons == pytest.approx(low.noise.signal_electrons / 4)


def test_scanner_has_its_density_angle_and_side():
    lidar = scanner(line_offsets=(-80.0, 80.0), pulse_density=50.0, heading=90.0)
    beams = lidar.beams((20.0, 10.0), top=1.0)
    assert len(beams) == pytest.approx(50.0 * 200.0, rel=0.02)
    # Flying east, the line 80 m to the right is in the south and looks left, to the north.
    south = beams.origin[:, 1] < 0
    assert south.mean() == pytest.approx(0.5, abs=0.02)
    assert np.all(beams.scan_angle[south] < 0)
    assert np.all(beams.direction[south, 1] > 0)
    slant = np.rad2deg(np.arccos(-beams.direction[:, 2]))
    np.testing.assert_allclose(np.abs(beams.scan_angle), slant, atol=1e-9)
    spread = beams.pencils.std(axis=0)
    np.testing.assert_allclose(spread, 0.5e-3 / 4.0, rtol=1e-9)
    again = lidar.beams((20.0, 10.0), top=1.0, seed=1)
    assert len(again) != len(beams) or not np.array_equal(again.origin, beams.origin)
    with pytest.raises(InputError, match="no pulse"):
        scanner(line_offsets=(400.0,)).beams((20.0, 10.0), top=1.0)


def test_every_shipped_lidar_rises_with_its_gate():
    for name in shipped_lidars():
        lidar = shipped_lidar(name)
        high = lidar.at(2.0 * lidar.geometry.altitude)
        assert high.geometry.altitude == 2.0 * lidar.geometry.altitude
        if lidar.gate is not None:
            assert np.ptp(high.gate) == pytest.approx(np.ptp(lidar.gate))


def test_echoes_are_found_where_they_are():
    lidar = quiet(flash())
    beams = pixels(lidar, 3)
    canopy = echoes(lidar, beams, [48.43, 49.2], [0.2, 0.05])
    found = detect(lidar, beams, canopy, echoes(lidar, beams, [50.02], [0.3]))
    assert len(found) == 9
    np.testing.assert_array_equal(found.number, [1, 2, 3] * 3)
    np.testing.assert_array_equal(found.of, 3)
    np.testing.assert_array_equal(found.classification, [VEGETATION, VEGETATION, GROUND] * 3)
    np.testing.assert_allclose(found.distance[:3], [48.43, 49.2, 50.02], atol=0.01)
    # The sample blurs the pulse: a little lower, a little wider.
    np.testing.assert_allclose(found.reflectance[:3], [0.2, 0.05, 0.3], rtol=0.06)
    blurred = np.sqrt(lidar.pulse_sd**2 + lidar.sample**2 / 12) * 2.3548 / 0.1499
    np.testing.assert_allclose(found.width[:3], blurred, rtol=0.05)
    height = beams.origin[0, 2] + found.distance[:3] * beams.direction[0, 2]
    np.testing.assert_allclose(found.position[:3, 2], height)


def test_close_surfaces_are_one_return_and_the_strongest_stay():
    lidar = quiet(flash())
    beams = pixels(lidar, 1)
    none = np.zeros((1, beams.samples))
    one = detect(lidar, beams, echoes(lidar, beams, [49.0, 49.15], [0.2, 0.2]), none)
    assert len(one) == 1
    assert one.width[0] > 1.05 * 2.0
    two = dataclasses.replace(lidar, max_returns=2)
    many = echoes(lidar, beams, [46.0, 47.0, 48.0, 49.0], [0.1, 0.3, 0.05, 0.2])
    found = detect(two, beams, many, none)
    np.testing.assert_allclose(found.distance, [47.0, 49.0], atol=0.01)
    np.testing.assert_array_equal(found.number, [1, 2])


def test_noise_has_its_moments_and_rarely_looks_like_a_return():
    lidar = dataclasses.replace(flash(), noise=LidarNoise(2000.0, 20.0, 10.0))
    beams = pixels(lidar, 4000)
    empty = np.zeros((4000, beams.samples))
    level = echoes(lidar, beams, [49.0], [0.3])
    mean = np.asarray(received_electrons(lidar, beams, jnp.asarray(level)))
    assert mean.sum(axis=1) == pytest.approx(600.0 * (50.0 / 49.0) ** 2, rel=0.01)
    drawn = np.asarray(received_electrons(lidar, beams, jnp.asarray(level), key=jax.random.key(3)))
    np.testing.assert_allclose(drawn.mean(0), mean[0], atol=1.5)
    np.testing.assert_allclose(drawn.var(0), mean[0] + 20.0 + 100.0, rtol=0.12)
    false = detect(lidar, beams, empty, empty, key=jax.random.key(4))
    assert len(false) < 4000 * beams.samples * 3e-6 + 5
    real = detect(lidar, beams, level, empty, key=jax.random.key(5))
    assert len(real) == pytest.approx(4000, abs=20)
    error = real.distance - 49.0
    assert abs(error.mean()) < 0.004
    assert error.std() < 0.03


def test_ripples_of_noise_on_a_long_echo_are_no_returns():
    lidar = dataclasses.replace(flash(), noise=LidarNoise(20000.0, 20.0, 10.0))
    beams = pixels(lidar, 500)
    long = echoes(lidar, beams, np.arange(45.0, 48.0, 0.05), np.full(60, 0.01))
    found = detect(lidar, beams, long, np.zeros_like(long), key=jax.random.key(6))
    assert len(np.unique(found.beam)) == 500
    assert len(found) < 1.1 * 500


def test_returns_of_a_slab_follow_the_gap_law():
    """Narrow pencils and a short pulse: each pulse returns where its light first hits."""
    lidar = scanner(line_offsets=(0.0,), pulse_density=40000.0, pencils=1)
    lidar = dataclasses.replace(quiet(lidar), sample=0.01, pulse_length=0.15)
    scene = slab(2.0, layers=10)
    beams = lidar.beams((0.8, 0.8), top=scene.height)
    waveforms = lidar_waveforms(scene, lidar, beams, key=jax.random.key(7))
    electrons = received_electrons(lidar, beams, waveforms.total)
    found = detect_returns(lidar, beams, np.asarray(electrons), waveforms)
    assert len(found) == len(beams)
    ground = found.classification == GROUND
    share, wanted = ground.mean(), np.exp(-1.0)
    assert abs(share - wanted) < 4 * np.sqrt(wanted * (1 - wanted) / len(beams))
    depth = np.sort(1.0 - found.position[~ground, 2])
    law = -np.expm1(-depth) / -np.expm1(-1.0)
    rank = (np.arange(len(depth)) + 0.5) / len(depth)
    assert np.abs(law - rank).max() < 1.63 / np.sqrt(len(depth))  # Kolmogorov-Smirnov, 1 %


def test_electrons_that_are_not_numbers_are_refused():
    lidar = flash()
    beams = pixels(lidar, 1)
    waveform = jnp.full((1, beams.samples), np.nan)
    with pytest.raises(InputError, match="finite"):
        detect_returns(lidar, beams, waveform, Waveforms(waveform, waveform))
