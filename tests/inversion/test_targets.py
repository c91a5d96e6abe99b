"""Errors of the targets, and the jobs that read them."""

import numpy as np
import pytest
from rasterio import Affine
from scipy.ndimage import gaussian_filter, map_coordinates, uniform_filter

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.assembly import _targets, read_targets, twin_image
from fynjax.app.assembly._targets import image_target
from fynjax.app.io.plot import example_folder, read_plot, sensor_place
from fynjax.app.io.raster import write_geotiff
from fynjax.inversion import SPREAD_SD, weigh_targets
from fynjax.metrics import BANDS
from fynjax.sensors import shipped_sensor
from tests.helpers import write_raster


def test_spreads_and_repeated_ratios_weigh_less():
    names = ("green.mean", "green.std", "NDVI.mean", "SR.mean", "GNDVI.mean")
    data = weigh_targets(names, np.array([0.05, 0.02, 0.7, 6.0, -0.6]), 0.01)
    share = [0.01, np.hypot(0.01, SPREAD_SD), 0.01 * 2**0.5, 0.01 * 2**0.5, 0.01]
    np.testing.assert_allclose(data.sd, np.array(share) * [0.05, 0.02, 0.7, 6.0, 0.6])


def test_what_spreads_are_off_by_moves_quantiles_about_their_mean():
    """Half of its variance moves all spreads of a band together, and none of another one."""
    names = ("red.mean", "red.q05", "red.q95", "red.std", "nir.std")
    value = np.array([0.05, 0.02, 0.1, 0.02, 0.1])
    covariance = np.asarray(weigh_targets(names, value, 1e-6).covariance)
    apart = SPREAD_SD * np.array([0.0, -0.03, 0.05, 0.02, 0.1])
    want = np.outer(apart, apart) * (0.5 + 0.5 * np.eye(5))
    want[4, :4] = want[:4, 4] = 0.0
    np.testing.assert_allclose(covariance, want, atol=1e-7)


def test_every_function_of_a_ratio_repeats_it():
    """Two of near infrared over red edge count once, as do three shares of three bands."""
    names = ("NDRE.mean", "ReCI.mean", "NormR.mean", "NormG.mean", "GRNDVI.mean", "SAVI.mean")
    data = weigh_targets(names, np.ones(6), 0.01)
    np.testing.assert_allclose(data.sd, 0.01 * np.sqrt([2, 2, 3, 3, 3, 1]))


def test_a_stated_error_is_kept():
    data = weigh_targets(("NDVI.mean", "SR.mean"), np.ones(2), 0.01, sd=np.array([0.3, np.nan]))
    np.testing.assert_allclose(data.sd, [0.3, 0.01 * 2**0.5])
    with pytest.raises(InputError, match="relative_sd"):
        weigh_targets(("NDVI.mean",), np.ones(1), 0.0)


def test_the_example_table_is_a_target_of_the_example_plot():
    """What the README has a new user type."""
    plot = read_plot(example_folder() / "plot.toml")
    data = image_target(plot, example_folder() / "statistics.csv")
    assert data.names[:2] == ("green.mean", "red.mean")
    assert float(data.sd[0]) == pytest.approx(0.0003)


def test_bands_of_an_image_are_stated(tmp_path):
    plot = read_plot(example_folder() / "plot.toml")
    level = np.linspace(0.9, 1.1, 900).reshape(30, 30)
    image = np.stack([share * level for share in (0.03, 0.04, 0.1, 0.3)])
    write_raster(tmp_path / "named.tif", image[::-1], transform=Affine(0.1, 0, 0, 0, -0.1, 0))
    bands = ["nir", "red_edge", "red", "green"]
    measured = read_targets(plot, [tmp_path / "named.tif"], bands=bands)
    mean = dict(zip(measured.names, np.asarray(measured.value), strict=True))
    assert mean["nir.mean"] == pytest.approx(0.3, rel=1e-5)
    assert mean["green.mean"] == pytest.approx(0.03, rel=1e-5)
    with pytest.raises(InputError, match="but this is a table"):
        read_targets(plot, [example_folder() / "statistics.csv"], bands=bands)
    with pytest.raises(InputError, match="no target is one"):
        read_targets(plot, [], bands=bands)


def test_an_image_of_other_pixels_than_the_sensors_is_simulated_in_its_own(tmp_path):
    plot = read_plot(example_folder() / "plot.toml")
    own = sensor_place(plot)[1]
    image = (
        np.linspace(0.9, 1.1, 1600).reshape(40, 40)
        * np.array([0.05, 0.04, 0.1, 0.3])[:, None, None]
    )
    for pixel in (own, 2.0 * own, 0.5 * own):
        path = tmp_path / f"{pixel}.tif"
        write_geotiff(path, image, list(BANDS), pixel_m=pixel, crs="EPSG:32734")
        target = image_target(plot, path)
        assert target.source.view_of.placement.pixel == pytest.approx(pixel)
        assert ("are simulated" in target.source.description) == (pixel != own)


def test_every_band_that_camera_and_image_have_is_a_target(tmp_path):
    """Of a twin without an image it is every band of the camera."""
    plot = read_plot(example_folder() / "plot.toml")
    five = plot.replace(sensor=plot.sensor.replace(name="rededge_3"))
    names = ("blue", *BANDS)
    image = np.sort(np.random.default_rng(1).uniform(0.1, 0.2, (5, 20, 20)), axis=0)
    for name, bands in (("five", names), ("four", BANDS)):
        path = tmp_path / f"{name}.tif"
        write_geotiff(path, image[-len(bands) :], list(bands), pixel_m=0.06, crs="EPSG:32734")
        for camera in (plot, five):
            target = image_target(camera, path)
            has = name == "five" and camera is five
            assert ("blue.q25" in target.source.view_of.names) == has
            assert ("blue" in target.source.description) == has
            if has:
                mean = dict(zip(target.names, target.value))["blue.mean"]
                assert float(mean) == pytest.approx(image[0].mean(), rel=1e-6)
    for camera in (plot, five):
        assert ("blue.std" in twin_image(camera).names) == (camera is five)
    data = fx.Data.from_image(tmp_path / "five.tif", "rededge_3", statistics=("*.mean",))
    assert "blue.mean" in data.names


def test_the_image_is_kept_to_be_shown_cut_to_the_plot_and_in_bounded_memory(tmp_path, monkeypatch):
    plot = read_plot(example_folder() / "plot.toml")
    plot = plot.replace(size_m=(2.0, 1.0))
    random = np.random.default_rng(2)
    image = np.sort(random.uniform(0.1, 0.2, (4, 31, 40)), axis=0)
    image[:, 12, 14:16] = np.nan
    write_geotiff(tmp_path / "a.tif", image, list(BANDS), pixel_m=0.1, crs="EPSG:32734")
    kept = image_target(plot, tmp_path / "a.tif").source.image
    assert (kept.bands, kept.block, kept.pixel) == (BANDS, 1, pytest.approx(0.1))
    assert kept.size == pytest.approx((4.0, 3.1))
    np.testing.assert_allclose(kept.values, image[:, 10:20, 10:30], rtol=1e-6)  # from its middle
    assert kept.pixels.shape == (4, 31 * 40 - 2)
    monkeypatch.setattr(_targets, "_MOST_SHOWN", 50)
    monkeypatch.setattr(_targets, "_MOST_SAMPLED", 100)
    small = image_target(plot, tmp_path / "a.tif").source.image
    assert (small.block, small.pixel) == (2, pytest.approx(0.2))
    assert small.values.shape == (4, 5, 10)
    assert np.isfinite(small.values).all()
    np.testing.assert_allclose(small.values[:, 0, 0], image[:, 10:12, 10:12].mean((1, 2)))
    np.testing.assert_allclose(small.values[:, 1, 2], image[:, 13, 14:16].mean(axis=1))
    assert small.pixels.shape[1] <= 100
    np.testing.assert_array_equal(small.pixels[:, 1], kept.pixels[:, 13])
    whole = image_target(plot.replace(size_m=(9.0, 9.0)), tmp_path / "a.tif").source.image
    assert whole.values.shape == (4, 6, 8)  # smaller than the plot; 5 x 5 pixels each
    table = image_target(plot, example_folder() / "statistics.csv")
    assert table.source.image is None


def test_a_resampled_image_is_simulated_by_what_its_pixels_average_over(tmp_path):
    plot = read_plot(example_folder() / "plot.toml")
    image = np.random.default_rng(0).uniform(0.1, 0.2, (4, 40, 40))
    write_geotiff(tmp_path / "a.tif", image, list(BANDS), pixel_m=0.06, crs="EPSG:32734")
    own = image_target(plot, tmp_path / "a.tif")
    plot = plot.replace(sensor=plot.sensor.replace(footprint_m=0.043))
    sharp = image_target(plot, tmp_path / "a.tif")
    pixels = [one.source.view_of.placement.pixel for one in (own, sharp)]
    assert pixels == [pytest.approx(0.06), 0.043]
    np.testing.assert_array_equal(own.value, sharp.value)
    assert "average over 0.043 m" in sharp.source.description


def test_an_image_that_is_more_blurred_than_its_camera_is_doubted(tmp_path, monkeypatch):
    """Once: what the plot file states counts."""
    plot, asked = read_plot(example_folder() / "plot.toml"), []

    def footprint(image, mask, *, blur):
        asked.append(blur)
        return 3.0

    monkeypatch.setattr(_targets, "pixel_footprint", footprint)
    image = np.sort(np.random.default_rng(0).uniform(0.1, 0.2, (4, 40, 40)), axis=0)
    write_geotiff(tmp_path / "a.tif", image, list(BANDS), pixel_m=0.06, crs="EPSG:32734")
    with pytest.warns(UserWarning, match=r"some 0\.18 m.*`footprint_m = 0\.18`"):
        image_target(plot, tmp_path / "a.tif")
    sensor = shipped_sensor("mavic_3m")
    own = 0.7 * float(sensor.pixel(sensor_place(plot)[0])) / 0.06
    assert asked == [pytest.approx(own)]
    image_target(plot.replace(sensor=plot.sensor.replace(footprint_m=0.06)), tmp_path / "a.tif")
    assert len(asked) == 1


def test_bilinear_interpolation_averages_over_root_three_of_the_pixel_before():
    """What the page on `calibrate` says of images that are rotated to wider pixels."""
    random = np.random.default_rng(2)
    ground = gaussian_filter(random.normal(size=(2000, 2000)), 15.0, mode="wrap")
    before = uniform_filter(ground, 20, mode="wrap")[::20, ::20]
    line = np.arange(100) * 2.4 + 3.0
    x, y = np.meshgrid(line, line)
    turned = np.cos(0.4) * x - np.sin(0.4) * y, np.sin(0.4) * x + np.cos(0.4) * y
    after = map_coordinates(before, turned, order=1, mode="grid-wrap").std()
    spread = [uniform_filter(ground, width, mode="wrap").std() for width in (20, 35, 48)]
    assert after == pytest.approx(spread[1], rel=0.02)
    assert spread[2] < 0.9 * after
    assert spread[0] > 1.1 * after
