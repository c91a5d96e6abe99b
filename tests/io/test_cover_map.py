"""Rasters of what lies on the ground."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import read_plot
from fynjax.app.io.raster._over_plot import read_cover_map
from fynjax.app.io.raster._writer import write_geotiff
from fynjax.sensors import mavic_3m


def written(folder, bands, names, pixel=0.5):
    path = folder / "ground.tif"
    write_geotiff(path, np.asarray(bands, float), names, pixel_m=pixel)
    return path


def shares_over(path, shape=(4, 4), size=(2.0, 2.0)):
    return read_cover_map(path, size, shape, origin_m=None, option="map_origin_m")


def test_bands_are_taken_by_name_and_the_rest_is_soil(tmp_path):
    rock, litter = np.random.default_rng(0).uniform(0, 0.5, (2, 4, 4))
    got = shares_over(written(tmp_path, [rock, litter], ["Rock", "litter"]))
    np.testing.assert_allclose(got[1], litter, atol=1e-7)
    np.testing.assert_allclose(got[2], 0.0)
    np.testing.assert_allclose(got[3], rock, atol=1e-7)
    np.testing.assert_allclose(got.sum(axis=0), 1.0, atol=1e-7)


def test_cells_are_averaged_over_voxels(tmp_path):
    litter = np.random.default_rng(1).uniform(0, 1, (8, 8))
    got = shares_over(written(tmp_path, [litter], ["litter"], pixel=0.25))
    np.testing.assert_allclose(got[1], litter.reshape(4, 2, 4, 2).mean(axis=(1, 3)), atol=1e-6)


@pytest.mark.parametrize(
    ("bands", "names", "words"),
    [
        ([np.full((4, 4), 0.3)], ["leaves"], "litter, char, rock"),
        ([np.full((4, 4), 0.3)] * 2, ["rock", "rock"], "once"),
        ([np.full((4, 4), 30.0)], ["litter"], "Percent"),
        ([np.full((4, 4), 0.7)] * 2, ["litter", "rock"], "sum to"),
        ([np.full((4, 4), -0.1)], ["litter"], "one is"),
        ([np.full((2, 2), 0.1)], ["litter"], "covers the plot"),
        ([np.where(np.eye(4), np.nan, 0.1)], ["litter"], "have none"),
    ],
)
def test_a_map_that_cannot_serve_is_refused(tmp_path, bands, names, words):
    path = written(tmp_path, bands, names)
    with pytest.raises(InputError, match=words) as caught:
        shares_over(path)
    assert str(path) in str(caught.value)


def test_a_plot_takes_its_ground_from_the_map(tmp_path):
    char = np.zeros((10, 10))
    char[:, :4] = 0.9  # the western two fifths have burnt
    written(tmp_path, [char], ["char"], pixel=0.2)
    (tmp_path / "species.csv").write_text(
        "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form\n"
        "Erica,20,10,0.5,upright_ericoid\n"
    )
    toml = tmp_path / "plot.toml"
    start = "[plot]\nsize_m = 2.0\n[ground]\n"
    toml.write_text(start + 'map = "ground.tif"\n')
    model, parameters = build_plot(read_plot(toml))
    assert float(parameters.ground.char_fraction) == pytest.approx(0.36, abs=1e-6)
    assert float(parameters.ground.litter_fraction) == 0.0
    nir = np.asarray(model.ground_map(parameters, mavic_3m()))[-1]
    burnt, bare = nir[:, :8], nir[:, 8:]
    assert burnt.max() < 0.6 * bare.min()
    assert np.ptp(burnt) < 1e-4
    toml.write_text(start + 'map = "ground.tif"\nlitter_fraction = 0.1\n')
    with pytest.raises(InputError, match="a map or litter_fraction"):
        read_plot(toml)
    toml.write_text(start + "char_fraction = 0.7\nrock_fraction = 0.5\n")
    with pytest.raises(InputError, match=r"sum to 1\.2"):
        read_plot(toml)
