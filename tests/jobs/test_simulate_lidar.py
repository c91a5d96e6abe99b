"""A LiDAR flown over a small plot: its files, opened by other readers."""

import laspy
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.app.jobs import simulate
from fynjax.app.jobs._simulate_lidar import _seams
from tests.helpers import write_raster
from tests.sensors.lidar_scenes import flash
from tests.small import write_plot


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lidar")
    write_plot(folder)
    (folder / "out").mkdir()
    flown = simulate(folder / "plot.toml", folder / "out", sensor="flash_lidar_paper", seed=4)
    return flown, folder


def test_files_are_there_and_agree(run):
    summary, folder = run
    out = folder / "out"
    assert sorted(p.name for p in out.iterdir()) == sorted(summary.files)
    cloud = laspy.read(out / "cloud.laz")
    assert len(cloud) == summary.returns
    assert int(np.sum(np.asarray(cloud.classification) == 2)) == summary.ground_returns
    x, _, z = cloud.xyz.T
    assert x.min() > -0.1
    assert x.max() < 2.1
    ground = np.asarray(cloud.classification) == 2
    assert abs(np.median(z[ground])) < 0.03
    assert 0.3 < np.percentile(z[~ground], 99) < 0.75
    with xr.open_dataset(out / "waveforms.nc") as data:
        assert data.attrs["Conventions"].startswith("CF")
        assert data.attrs["seed"] == 4
        assert data.waveform.dims == ("pulse", "sample")
        peak = data.waveform.isel(pulse=np.asarray(cloud.pulse)[:50]).max("sample")
        assert np.all(np.isfinite(data.waveform))
        assert np.all(peak > 0)
        # The highest sample of the first echo is where the point is.
        first = int(np.asarray(cloud.pulse)[0])
        pulse = data.isel(pulse=first)
        distance = float(pulse.first_range + pulse.sample[int(np.argmax(pulse.waveform.values))])
        height = pulse.origin_z + distance * pulse.direction_z
        points_of_pulse = z[np.asarray(cloud.pulse) == first]
        assert np.abs(points_of_pulse - float(height)).min() < 0.15


def test_the_cloud_has_the_species_of_its_returns(run):
    summary, folder = run
    cloud = laspy.read(folder / "out" / "cloud.laz")
    names = pd.read_csv(folder / "out" / "cloud_species.csv")
    assert names["taxon"].tolist() == ["ground or none", "Erica irregularis", "Restio eleocharis"]
    place = np.asarray(cloud.species).astype(int)
    np.testing.assert_array_equal(np.bincount(place, minlength=3), names["returns"])
    assert names["returns"].min() > 0.02 * summary.returns
    with xr.open_dataset(folder / "out" / "truth.nc") as truth:
        np.testing.assert_allclose(truth.species_share.sum("species") + truth.ground_share, 1.0,
                                   atol=1e-5)  # fmt: skip
        np.testing.assert_array_equal(place, truth.leading_species + 1)
        np.testing.assert_allclose(cloud.species_share, truth.leading_share, atol=1e-6)
        assert truth.species.values.tolist() == names["taxon"].tolist()[1:]
    # Light scattered more than once is left out, which hardly moves what a return is of.
    ground = np.asarray(cloud.classification) == 2
    assert np.mean(ground == (place == 0)) > 0.95


def test_the_summary_says_what_was_measured(run):
    summary, _ = run
    assert summary.returns_per_m2 == pytest.approx(summary.returns / 4.0)
    assert summary.pulses_per_m2 == pytest.approx(655.36, rel=0.04)  # whole pixels
    assert summary.share_of_pulses_with_returns > 0.9
    assert summary.percentile_rmse_m["first hits"] < 0.1
    assert "small, flash_lidar_paper" in summary.headline[0]


def test_a_scanner_of_a_known_maker_has_its_flight_lines_in_the_cloud(tmp_path):
    write_plot(tmp_path)
    flown = simulate(tmp_path / "plot.toml", tmp_path / "out", sensor="minivux_1uav", seed=4)
    cloud = laspy.read(tmp_path / "out" / "cloud.laz")
    line = np.asarray(cloud.point_source_id)
    np.testing.assert_array_equal(np.unique(line), [1, 2])
    angle, time = 0.006 * np.asarray(cloud.scan_angle), np.asarray(cloud.gps_time)
    # The plot lies 30 m to the right of the first line, 60 m below it, and left of the second.
    for number, side in ((1, 1.0), (2, -1.0)):
        seen = side * np.rad2deg(np.arctan(30.0 / 60.0))
        assert np.median(angle[line == number]) == pytest.approx(seen, abs=1.0)
    assert time[line == 2].min() - time[line == 1].max() > 30.0
    # Even in angle: density falls with the squared cosine.
    nadir = 1e5 * 0.25 / (5.0 * 60.0 * np.deg2rad(90.0))
    assert flown.pulses_per_m2 == pytest.approx(2.0 * nadir * 0.8, rel=0.08)


def test_a_sensor_inside_the_canopy_is_refused(run):
    _, folder = run
    with pytest.raises(InputError, match="above the canopy"):
        simulate(folder / "plot.toml", folder / "none", sensor=flash(altitude=0.5), seed=4)
    assert not (folder / "none").exists()


def test_a_slope_comes_out_on_its_map(tmp_path):
    """A plane of 20 %, rising to the east, on a map in UTM."""
    east = (np.arange(8) + 0.5) * 0.25
    height = np.broadcast_to(120.0 + 0.2 * east, (1, 8, 8)).astype(np.float32)
    place = Affine(0.25, 0, 600000, 0, -0.25, 6180002)
    write_raster(tmp_path / "terrain.tif", height, transform=place, crs="EPSG:32734")
    write_plot(tmp_path, 'boundary = "open"\nterrain = "terrain.tif"\n')
    simulate(
        tmp_path / "plot.toml", tmp_path / "out", sensor="flash_lidar_paper", seed=4, noise=False
    )
    cloud = laspy.read(tmp_path / "out" / "cloud.laz")
    ground = np.asarray(cloud.classification) == 2
    slope, level = np.polyfit(np.asarray(cloud.x)[ground] - 600000, np.asarray(cloud.z)[ground], 1)
    assert slope == pytest.approx(0.2, abs=0.01)
    assert level == pytest.approx(120.0, abs=0.03)
    assert 6180000 - 0.1 < cloud.y.min() < cloud.y.max() < 6180002.1
    assert "34S" in cloud.header.vlrs.get("WktCoordinateSystemVlr")[0].string


@pytest.mark.parametrize("side", [5.0, 10.0])
def test_slits_between_the_frames_of_a_flash_are_told(side):
    """Against the lines of sight: the widest gap of where they pass 1 m above the ground."""
    lidar = flash()
    plot = read_plot(example_folder() / "plot.toml").replace(size_m=(side, side))
    beams = lidar.beams(plot.size_m, top=2.0)
    steps = (1.0 - beams.origin[:, 2]) / beams.direction[:, 2]
    x = np.unique((beams.origin[:, 0] + steps * beams.direction[:, 0]).round(6))
    widest, usual = np.diff(x).max(), np.median(np.diff(x))
    told = _seams(plot, lidar)
    if side == 5.0:
        assert told == []
        assert widest == pytest.approx(usual, rel=1e-3)
    else:
        assert f"a strip of {widest - usual:.2f} m of what is 1 m high" in told[0]
