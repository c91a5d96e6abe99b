"""`fynjax simulate`: a small plot, a camera of one's own, and what the run leaves."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
import xarray as xr
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.cli import main
from fynjax.app.io.raster import colour_bands
from fynjax.app.jobs._simulate import simulate
from fynjax.app.report.figures._products import quick_looks, spectrum_figure
from tests.helpers import assert_valid_summary, read_cube, write_raster

PLOT = """
[plot]
name = "small"
size_m = 2.0
voxel_m = 0.2
structure_m = "even"
probability_map = "map.tif"
[sensor]
path = "camera.toml"
altitude_m = 100
[atmosphere]
model = "clear-sky"
"""
SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form
Erica irregularis,40,30,0.6,rounded_shrub
"""
CAMERA = """
name = "camera"
source = "a data sheet"
[geometry]
kind = "pushbroom"
altitude_m = 50
focal_length_mm = 10
pixel_pitch_um = 50
columns = 100
[bands]
name = ["green", "red", "nir", "cirrus", "beyond"]
centre_nm = [560, 660, 860, 1900, 2600]
fwhm_nm = [30, 30, 40, 20, 20]
ground_sample_distance_m = [0.5, 0.5, 0.5, 1.0, 1.0]
[noise]
kind = "camera"
saturation_radiance = 400
full_well_electrons = 20000
read_noise_electrons = 5
bits = 14
"""


def write_plot(folder: Path, plot: str = PLOT) -> Path:
    (folder / "plot.toml").write_text(plot)
    (folder / "species.csv").write_text(SPECIES)
    (folder / "camera.toml").write_text(CAMERA)
    place = Affine(0.25, 0, 600000, 0, -0.25, 6180002)  # in UTM
    chance = np.linspace(120, 250, 64).astype(np.uint8).reshape(1, 8, 8)
    write_raster(folder / "map.tif", chance, transform=place, crs="EPSG:32734")
    return folder / "plot.toml"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate")
    plot = write_plot(folder)
    (folder / "out").mkdir()
    return simulate(plot, folder / "out", seed=4), folder / "out"


def test_every_file_is_written_and_listed(run):
    summary, folder = run
    assert set(summary.files) | {"reflectance.dat", "radiance.dat"} == {
        p.name for p in folder.iterdir()
    }
    assert_valid_summary(summary)
    assert summary.pixels == (4, 4)
    assert summary.pixel_m == 0.5
    assert summary.noise
    assert "4 bands of camera, 4 x 4 pixels of 0.5 m" in summary.headline[0]
    warnings = "\n".join(summary.warnings)
    assert "1 of 5 bands of camera reach beyond the spectra" in warnings
    assert "beyond (2600 nm)" in warnings
    assert "pixels of 0.5 to 1 m" in warnings


def test_products_agree_with_each_other_and_with_the_air(run):
    _, folder = run
    for quantity in ("reflectance", "radiance"):
        tiff, envi = (read_cube(folder / f"{quantity}.{ending}") for ending in ("tif", "hdr"))
        with xr.open_dataset(folder / "product.nc") as product:
            values, good = product[quantity].load(), product[f"{quantity}_good"].load()
        np.testing.assert_allclose(tiff.values, envi.values)
        np.testing.assert_allclose(tiff.values, values)
        assert envi.names == ("green", "red", "nir", "cirrus", "beyond")
        assert envi.good.tolist() == good.values.tolist()
        # Beyond the spectra nothing is known; where the air is opaque, nothing of the ground.
        assert envi.good.tolist() == [True, True, True, quantity == "radiance", False]
        assert not np.isfinite(envi.values[~envi.good]).any()
        for cube in (tiff, envi):
            assert cube.origin_m == (600000.0, 6180000.0)
            assert rasterio.CRS.from_wkt(cube.crs).to_epsg() == 32734
    with rasterio.open(folder / "reflectance.tif") as file:
        assert file.nodata == -9999.0
        assert 0.02 < file.read(1).mean() < 0.5


def test_the_record_says_what_was_done(run):
    summary, folder = run
    record = json.loads((folder / "run.json").read_text("utf-8"))
    assert record["seed"] == 4
    assert record["sensor"]["altitude_m"] == 100.0
    assert record["sensor"]["bands_simulated"] == 4
    assert record["atmosphere"]["model"] == "clear-sky"
    assert record["versions"]["jax"] == record["jax_version"]
    assert set(json.loads(record["input_sha256"])) == {
        "plot.toml",
        "species.csv",
        "camera.toml",
        "map.tif",
    }
    assert record["timings_s"]["bands"] == summary.timings_s["bands"] > 0
    assert 0 < record["accuracy"]["largest_residual"] < 1e-3


def test_pictures_take_the_bands_that_lie_near(run):
    _, folder = run
    cube = read_cube(folder / "reflectance.hdr")
    assert colour_bands(cube.wavelength, cube.good) == {"green": 0, "red": 1, "nir": 2}
    large = replace(cube, values=np.tile(cube.values, (1, 4, 4)))
    assert set(quick_looks(large, "x")) == {"true_like.png", "false_colour.png"}
    (axes,) = spectrum_figure({"reflectance": large}).axes
    assert axes.get_ylabel() == "reflectance [-]"


def test_few_pixels_are_shown_by_their_spectra_and_not_as_colours(run):
    """16 pixels stretched to red, green and blue show nothing but their noise."""
    summary, folder = run
    cube = read_cube(folder / "reflectance.hdr")
    assert quick_looks(cube, "x") == {}
    assert not {"true_like.png", "false_colour.png"} & set(summary.files)
    (axes,) = spectrum_figure({"reflectance": cube}).axes
    drawn = np.array([line.get_ydata() for line in axes.lines])
    wanted = cube.values[:3].reshape(3, -1).T
    np.testing.assert_allclose(drawn[:16, :3], wanted)
    np.testing.assert_allclose(drawn[16, :3], wanted.mean(axis=0), rtol=1e-6)
    assert "4 x 4 pixels, and each of them" in axes.get_title(loc="left")


WRONG = [
    (["--sensor", "aviris"], "Did you mean 'aviris_ng'"),
    (["--atmosphere", "none"], "noise is that of radiance"),
    (["--atmosphere", "none", "--no-noise", "--product", "radiance"], "there is no radiance"),
    (["--sensor", "mavic_3m", "--noise"], "has none. Leave noise out"),
    (["--altitude", "0.5"], "above the plants"),
    (["--atmosphere", "nowhere.csv"], "no such file"),
    (["--sensor", "flash_lidar_paper", "--pixel", "1"], "no pixel with the LiDAR"),
    (["panels = [{x_m=1, y_m=1, reflectance=5}]"], "sensor.panels.0.reflectance': expected"),
    (["panels = [{x_m=1, y_m=1, side_m=0.4, reflectance=0.5}]"], "three pixels wide"),
    (["panels = [{x_m=9, y_m=9, reflectance=0.5}]"], "must lie in the image"),
    (
        ['panels = [{x_m=1, y_m=1, side_m=1, reflectance=0.5}]\n[atmosphere]\nmodel="none"'],
        "panels",
    ),
]


@pytest.mark.parametrize(("options", "words"), WRONG)
def test_a_slip_is_one_line_and_leaves_nothing(tmp_path, capsys, options, words):
    tables = PLOT + "\n"
    if options[:2] == ["--atmosphere", "none"] and "--no-noise" not in options:
        tables = tables.replace("altitude_m = 100", "altitude_m = 100\nnoise = true")
    if options[0].startswith("panels"):
        key, *air = options.pop().split("\n", 1)
        tables = tables.replace("[atmosphere]", key + "\n[atmosphere]")
        tables = tables.replace("clear-sky", "none") if air else tables
    plot = write_plot(tmp_path, tables)
    with pytest.raises(SystemExit) as caught:
        main(["simulate", str(plot), "--output", str(tmp_path / "out"), *options])
    assert caught.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("fynjax: error: ")
    assert words in line
    assert not (tmp_path / "out").exists()


def test_unknown_products_are_refused(tmp_path):
    with pytest.raises(InputError, match="reflectance, radiance"):
        simulate(write_plot(tmp_path), tmp_path, products=["brightness"])


@pytest.mark.slow
def test_many_bands_are_reduced(tmp_path):
    """30 bands: more than are solved."""
    bands = "\n".join(f"{v},{20}" for v in np.linspace(450, 1000, 30))
    (tmp_path / "bands.csv").write_text("centre_nm,fwhm_nm\n" + bands + "\n")
    text = CAMERA[: CAMERA.index("[bands]")] + '[bands]\ntable = "bands.csv"\n'
    plot = write_plot(tmp_path)
    (tmp_path / "camera.toml").write_text(text)
    (tmp_path / "out").mkdir()
    simulate(plot, tmp_path / "out", products=["reflectance"])
    record = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))
    assert record["accuracy"]["bands_reduced_to_few_solves"]
    assert record["accuracy"]["largest_residual"] < 0.01
