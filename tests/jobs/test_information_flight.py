"""What frames and pulses know: sums, bounds by what is shared, and a run."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs import plot_information
from fynjax.app.jobs._information_flight import (
    FlightSetting,
    cloud_covariance,
    flight_settings,
    frame_covariance,
    frame_directions,
)
from fynjax.inversion import BandFactors, fisher_information
from fynjax.sensors import Gains, shipped_sensor
from tests.small import write_plot

CAMERA = shipped_sensor("mavic_3m")
CERTAIN = Gains(0.0, 0.0, "exact", 0.0)


def camera(sd, drift):
    return dataclasses.replace(CAMERA, calibrations=(Gains(sd, 0.5, "stated", drift),))


def bound_of(values, slopes, sensor):
    """Bound on one parameter of prior deviation 1 from frames with these slopes."""
    factors = BandFactors.of_bands([(sensor.bands, sensor.gains())], None)
    _, covariance = frame_covariance(values, 0.01, sensor, factors)
    known = fisher_information(("a",), slopes.reshape(-1, 1), covariance, np.ones(1))
    return known.conditional[0]


def frames(count):
    """Two plantings that are alike, so that places add no error, seen in `count` frames."""
    one = np.tile(np.linspace(0.1, 0.3, 8), (2, count, 1))
    return one, np.tile(np.linspace(0.02, 0.05, 8), (count, 1))


def test_information_of_independent_frames_adds():
    exact = camera(0.0, 0.0)
    single = bound_of(*frames(1), exact)
    for count in (2, 9):
        assert bound_of(*frames(count), exact) == pytest.approx(single / np.sqrt(count), rel=1e-6)


def test_identical_frames_know_no_more_than_their_gains_allow():
    """Of one gain g common to all bands and frames, slopes as the values cannot be told from it."""
    shared = dataclasses.replace(CAMERA, calibrations=(Gains(0.05, 1.0, "stated", 0.0),))
    values, _ = frames(1)
    alike = values[0] / 0.5  # a parameter that makes all brighter by twice its value
    bounds = [
        bound_of(np.tile(values, (1, n, 1)), np.tile(alike, (n, 1)), shared) for n in (1, 10, 60)
    ]
    assert bounds[0] > bounds[1] > bounds[2] > 0.5 * 0.05 * 0.999
    assert bounds[2] == pytest.approx(0.5 * 0.05, rel=1e-2)
    drifting = camera(0.0, 0.02)
    # The drift is each frame's own: it averages out.
    many = bound_of(np.tile(values, (1, 25, 1)), np.tile(alike, (25, 1)), drifting)
    one = bound_of(values, alike, drifting)
    assert many == pytest.approx(one / 5.0, rel=1e-6)


def test_quantiles_of_returns_scatter_as_drawn_ones():
    """Heights even from 0 to 2 m: against draws."""
    share = np.array([25.0, 50.0, 75.0, 90.0, 95.0, 99.0])
    beside = np.minimum(2.0, 100.0 - share - 0.1)
    heights = 0.02 * np.concatenate([share, share - beside, share + beside])
    got = cloud_covariance(np.tile(heights, (2, 1)), 4.0, 100.0)
    model = cloud_covariance(np.tile(heights, (2, 1)), 4.0, np.inf)
    # Half of the model's variance is common to all heights.
    np.testing.assert_allclose(model[0, 2], 0.5 * 0.05**2 * heights[0] * heights[2], rtol=1e-6)
    drawn = np.random.default_rng(3).uniform(0.0, 2.0, (20_000, 400))
    want = np.cov(np.percentile(drawn, share, axis=1))
    np.testing.assert_allclose(got - model, want, rtol=0.12, atol=2e-5)


def test_frames_stand_where_the_overlap_puts_them():
    """Of an image 53 degrees wide, 80 % of overlap: every fifth of its width a frame."""
    views = frame_directions(CAMERA, 25, 80.0)
    assert views[0, 0] == 0.0
    assert len(np.unique(views.round(6), axis=0)) == 25
    lens = CAMERA.camera
    half = 5e-4 * np.array(lens.array) * lens.pixel_pitch_um / float(lens.focal_length_mm)
    steps = np.tan(np.deg2rad(views[1:5, 0]))
    np.testing.assert_allclose(np.unique(steps.round(9))[0], 0.4 * half.min(), rtol=1e-6)
    assert set(views[1:3, 1].round()) == {0.0, 180.0}
    assert np.tan(np.deg2rad(views[:, 0])).max() <= np.hypot(*half)
    with pytest.raises(InputError, match="at most 25 frames"):
        frame_directions(CAMERA, 26, 80.0)
    with pytest.raises(InputError, match="has none"):
        frame_directions(shipped_sensor("aviris_ng"), 1, 80.0)
    with pytest.raises(InputError, match="overlap"):
        frame_directions(CAMERA, 1, 100.0)


def test_settings_are_combined():
    assert flight_settings((1, 5), (0, 8), (20.0,)) == [
        FlightSetting(1, 0, 0.0), FlightSetting(5, 0, 0.0), FlightSetting(1, 8, 0.0),
        FlightSetting(5, 8, 0.0), FlightSetting(0, 0, 20.0),
    ]  # fmt: skip
    with pytest.raises(InputError, match="positive"):
        flight_settings((0,), (0,), ())


def test_what_does_not_go_together_is_refused(tmp_path):
    plot = write_plot(tmp_path, voxel=0.2)
    for options in ({"oblique": (4,)}, {"overlap": 70.0, "pulses": (20,)}):
        with pytest.raises(InputError, match="expected frames beside oblique or overlap"):
            plot_information(plot, tmp_path / "out", **options)
    aside = read_plot(plot).replace(boundary="open")
    with pytest.raises(InputError, match=r"periodic.* for frames"):
        plot_information(aside, tmp_path / "out", frames=(1,))


def test_gains_of_frames_are_those_of_the_plot_file(tmp_path, monkeypatch):
    class Seen(Exception):
        pass

    def look(problem, sensor, settings, **_):
        assert sensor.gains().sd == 0.013
        raise Seen

    monkeypatch.setattr("fynjax.app.jobs._information_flight.flight_information", look)
    plot = write_plot(tmp_path, "\n[calibration]\ngain_sd = 0.013\n", voxel=0.2)
    with pytest.raises(Seen):
        plot_information(plot, tmp_path / "out", free=("species.*.height",), frames=(1,))


@pytest.mark.slow
def test_more_frames_and_more_pulses_never_know_less(tmp_path):
    plot = write_plot(tmp_path, voxel=0.2)
    made = plot_information(
        plot, tmp_path / "out", free=("species.*.height", "species.*.leaf_area_index"),
        frames=(1, 5), oblique=(0, 4), pulses=(20, 200), realisations=2, seed=3,
    )  # fmt: skip
    table = pd.read_csv(tmp_path / "out" / "flight.csv")
    flight = ["frames", "oblique", "pulses"]
    assert len(table.groupby(flight)) == 6
    left = {key: part.set_index("parameter")["bayesian"] for key, part in table.groupby(flight)}
    prior = table.groupby("parameter")["prior_sd"].first()
    for less, more in (
        ((1, 0, 0), (5, 0, 0)), ((1, 0, 0), (1, 4, 0)), ((5, 0, 0), (5, 4, 0)),
        ((1, 4, 0), (5, 4, 0)), ((0, 0, 20), (0, 0, 200)),
    ):  # fmt: skip
        assert (left[more] <= left[less] * (1 + 1e-9)).all()
    for one in left.values():
        assert (one <= prior[one.index] * (1 + 1e-9)).all()
    # A cloud tells heights; frames from aside tell leaf area.
    assert left[0, 0, 200]["species.Erica irregularis.height"] < 0.9 * 100.0
    name = "stand.green_leaf_area"
    assert left[5, 4, 0][name] < 0.9 * left[1, 0, 0][name]
    assert made.headline[0].startswith("1 frame: ")
