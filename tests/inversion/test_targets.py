"""Errors of the targets, and the jobs that read them."""

import numpy as np
import pytest
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.assembly import build_plot, imaged_plot, read_targets
from fynjax.assembly._targets import image_target
from fynjax.inversion import weigh_targets
from fynjax.io.plot import example_folder, read_plot
from tests.helpers import write_raster


def test_spreads_and_repeated_ratios_weigh_less():
    names = ("green.mean", "green.std", "NDVI.mean", "SR.mean", "GNDVI.mean")
    data = weigh_targets(names, np.array([0.05, 0.02, 0.7, 6.0, -0.6]), 0.01)
    share = [0.01, 0.1, 0.01 * 2**0.5, 0.01 * 2**0.5, 0.01]
    np.testing.assert_allclose(data.sd, np.array(share) * [0.05, 0.02, 0.7, 6.0, 0.6])


def test_a_stated_error_is_kept():
    data = weigh_targets(("NDVI.mean", "SR.mean"), np.ones(2), 0.01, sd=np.array([0.3, np.nan]))
    np.testing.assert_allclose(data.sd, [0.3, 0.01 * 2**0.5])
    with pytest.raises(InputError, match="relative_sd"):
        weigh_targets(("NDVI.mean",), np.ones(1), 0.0)


def test_the_example_table_is_a_target_of_the_example_plot():
    """What the README has a new user type."""
    plot = read_plot(example_folder() / "plot.toml")
    data = image_target(plot, example_folder() / "statistics.csv").data
    assert data.names[:2] == ("green.mean", "red.mean")
    assert float(data.sd[0]) == pytest.approx(0.0003)


def test_bands_of_an_image_are_stated(tmp_path):
    plot = read_plot(example_folder() / "plot.toml")
    plot = plot.replace(sensor=plot.sensor.replace(pixel_m=0.1))
    level = np.linspace(0.9, 1.1, 900).reshape(30, 30)
    image = np.stack([share * level for share in (0.03, 0.04, 0.1, 0.3)])
    write_raster(tmp_path / "named.tif", image[::-1], transform=Affine(0.1, 0, 0, 0, -0.1, 0))
    bands = ["nir", "red_edge", "red", "green"]
    (measured,) = read_targets(plot, [tmp_path / "named.tif"], bands=bands)
    mean = dict(zip(measured.data.names, np.asarray(measured.data.value), strict=True))
    assert mean["nir.mean"] == pytest.approx(0.3, rel=1e-5)
    assert mean["green.mean"] == pytest.approx(0.03, rel=1e-5)
    with pytest.raises(InputError, match="but this is a table"):
        read_targets(plot, [example_folder() / "statistics.csv"], bands=bands)
    with pytest.raises(InputError, match="no target is one"):
        read_targets(plot, [], bands=bands)


def test_an_image_is_simulated_in_its_own_pixels(tmp_path):
    """Spreads and percentiles of 10 cm are not those of the camera's 2.5 cm."""
    (tmp_path / "plot.toml").write_text('[plot]\nsize_m = 3.0\nstructure_m = "even"\n')
    (tmp_path / "species.csv").write_text(
        "taxon,mean_diameter_cm,cover_percent,height_max_m\nErica irregularis,40,30,0.6\n"
    )
    plot = read_plot(tmp_path / "plot.toml")
    image = np.random.default_rng(0).uniform(0.1, 0.2, (4, 30, 30))
    names = ["green", "red", "red_edge", "nir"]
    write_raster(tmp_path / "own.tif", image, transform=Affine(0.1, 0, 0, 0, -0.1, 0))
    scene, parameters = build_plot(plot)
    (one,) = read_targets(plot, [tmp_path / "own.tif"], bands=names)
    assert one.pixel == pytest.approx(0.1)
    camera = one.view_of(scene, parameters).camera
    assert (camera.pixel, camera.shape) == (pytest.approx(0.1), (30, 30))
    assert imaged_plot(plot, [one]).sensor.pixel_m == pytest.approx(0.1)
    assert imaged_plot(plot, []) is plot
    stated = plot.replace(sensor=plot.sensor.replace(pixel_m=0.03))
    with pytest.warns(UserWarning, match=r"pixels of 0\.1 m, which count, and not the 0\.03 m"):
        (again,) = read_targets(stated, [tmp_path / "own.tif"], bands=names)
    assert again.view_of(scene, parameters).camera.pixel == pytest.approx(0.1)
