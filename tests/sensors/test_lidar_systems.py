"""Scanners of known makers: density, pattern, footprint and noise, by counting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.sensors import (
    Waveforms,
    detect_returns,
    received_electrons,
    shipped_lidar,
    shipped_lidars,
)
from tests.sensors.lidar_scenes import mirror
from tests.sensors.test_lidar_returns import echoes

SYSTEMS = [n for n in shipped_lidars() if n not in ("flash_lidar_paper", "scanning_lidar")]


def swath(geometry):
    return 2.0 * geometry.altitude * np.tan(np.deg2rad(geometry.half_scan_angle))


def test_three_systems_ship():
    assert SYSTEMS == ["minivux_1uav", "vq_1560i", "zenmuse_l2"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_pulses_over_the_whole_swath_are_those_of_the_data_sheet(name):
    """Pulses a second in the swath, over what it covers in a second; at its middle more of them."""
    lidar = shipped_lidar(name)
    at = lidar.geometry
    lidar = lidar if name != "vq_1560i" else lidar.at(200.0)
    single = mirror(**{**vars(at), "line_offsets": (0.0,), "altitude": lidar.geometry.altitude})
    at = single.geometry
    wide = swath(at)
    beams = single.beams((wide + 10.0, 20.0), top=1.0)
    mean = len(beams) / (wide * 20.0)
    assert mean == pytest.approx(at.rate * at.used_share / (at.speed * wide), rel=0.01)
    # Even in angle: the swath's middle has the mean times tangent over angle.
    x, _ = beams.on_ground.T
    near = np.abs(x - 0.5 * (wide + 10.0)) < 0.05 * wide
    half = np.deg2rad(at.half_scan_angle)
    more = np.sum(near) / (0.1 * wide * 20.0) / mean
    assert more == pytest.approx(np.tan(half) / half, rel=0.03)
    assert np.abs(beams.scan_angle).max() <= at.half_scan_angle
    assert np.abs(beams.scan_angle).max() == pytest.approx(at.half_scan_angle, abs=0.3)


def test_lines_are_as_far_apart_as_the_flight_goes_in_one():
    lidar = mirror(line_offsets=(0.0,), scan_rate=50.0, speed=5.0)
    beams = lidar.beams((20.0, 20.0), top=1.0)
    along = beams.on_ground[:, 1]
    sweep = np.split(along, np.flatnonzero(np.diff(beams.time) > 2.0 / lidar.geometry.rate) + 1)
    np.testing.assert_allclose(np.diff([line.mean() for line in sweep[1:-1]]), 0.1, atol=2e-3)
    # Within a line, so many degrees from pulse to pulse.
    angle = np.split(beams.scan_angle, np.flatnonzero(np.diff(beams.time) > 2e-5) + 1)[3]
    np.testing.assert_allclose(np.diff(angle), 360.0 * 50.0 / 100000.0, rtol=1e-3)


def test_two_channels_cross_and_look_ahead_and_back():
    lidar = shipped_lidar("vq_1560i")
    beams = lidar.beams((30.0, 30.0), top=1.0)
    ahead = -beams.direction[:, 1] / beams.direction[:, 2]
    across = -beams.direction[:, 0] / beams.direction[:, 2]
    turn = np.rad2deg(np.arctan(-ahead / across))
    np.testing.assert_allclose(np.unique(turn.round(6)), [-14.0, 14.0])
    assert np.mean(turn > 0) == pytest.approx(0.5, abs=0.02)
    # What the maker says of the edges of the swath: 8 degrees.
    edge = np.tan(np.deg2rad(29.0)) * np.tan(np.deg2rad(14.0))
    assert np.rad2deg(np.arctan(edge)) == pytest.approx(8.0, abs=0.2)


def test_flight_lines_are_told_apart_by_side_and_time():
    lidar = mirror(line_offsets=(-30.0, 0.0, 30.0), heading=90.0)
    beams = lidar.beams((10.0, 10.0), top=1.0)
    np.testing.assert_array_equal(np.unique(beams.line), [0, 1, 2])
    # Flying east, what is to the right is in the south.
    for line, north in enumerate((30.0, 0.0, -30.0)):
        part = beams.select(beams.line == line)
        np.testing.assert_allclose(part.origin[:, 1], 5.0 + north, atol=1e-9)
        assert np.ptp(part.time) < 30.0
    first = [beams.time[beams.line == i].min() for i in range(3)]
    np.testing.assert_allclose(np.diff(first), 60.0, atol=1.0)


@pytest.mark.parametrize(("heading", "wide"), [(0.0, 0), (90.0, 1), (180.0, 0)])
def test_footprint_is_divergence_times_range(heading, wide):
    """160 mm x 50 mm at 100 m, the longer side across the flight."""
    beams = mirror(heading=heading).beams((10.0, 10.0), top=1.0)
    size = 4.0 * beams.pencils.std(axis=0) * 100.0
    np.testing.assert_allclose(size[[wide, 1 - wide]], [0.160, 0.050], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "precision"), [("zenmuse_l2", 0.02), ("minivux_1uav", 0.01), ("vq_1560i", 0.02)]
)
def test_ranges_scatter_as_the_maker_says(name, precision):
    """Over a plate of reflectance 0.5 at the usual height, wherever in a sample it is."""
    lidar = shipped_lidar(name)
    beams = lidar.beams((6.0, 6.0), top=1.0, seed=2)
    beams = beams.select(np.repeat([len(beams) // 2], 8000))
    within = np.random.default_rng(1).uniform(0.0, 1.0, (8000, 1))
    far = beams.start[:, None] + (0.5 * beams.samples + within) * lidar.sample
    plate = echoes(lidar, beams, [far], [0.5])
    truth = Waveforms(jnp.zeros_like(plate), jnp.asarray(plate))
    counting, clock = jax.random.split(jax.random.key(3))
    electrons = np.asarray(received_electrons(lidar, beams, truth.total, key=counting))
    found, counted = (
        detect_returns(lidar, beams, electrons, truth, key=key) for key in (clock, None)
    )
    spread, of_counting = (np.std(f.distance - far[f.beam, 0]) for f in (found, counted))
    assert spread == pytest.approx(precision, rel=0.15)
    assert spread == pytest.approx(np.hypot(lidar.noise.range_sd_m, of_counting), rel=0.02)
    run = found.position - beams.origin[found.beam]
    np.testing.assert_allclose(np.linalg.norm(run, axis=1), found.distance)


@pytest.mark.parametrize(
    ("name", "reflectance", "reach"),
    [("zenmuse_l2", 0.5, 450.0), ("minivux_1uav", 0.6, 290.0), ("vq_1560i", 0.2, 1500.0)],
)
def test_a_plate_is_just_found_at_the_stated_range(name, reflectance, reach):
    for share, seen in ((0.8, True), (1.25, False)):
        lidar = shipped_lidar(name).at(share * reach)
        beams = lidar.beams((40.0, 40.0), top=1.0)
        middle = beams.select(np.argsort(np.abs(beams.scan_angle))[:1])
        far = middle.start[0] + 0.5 * middle.samples * lidar.sample
        plate = echoes(lidar, middle, [far], [reflectance])
        truth = Waveforms(jnp.zeros_like(plate), jnp.asarray(plate))
        electrons = received_electrons(lidar, middle, truth.total)
        assert (len(detect_returns(lidar, middle, np.asarray(electrons), truth)) == 1) is seen
