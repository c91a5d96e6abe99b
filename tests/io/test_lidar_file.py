"""LiDAR files, and returns as LAS opened by laspy."""

import tomllib

import jsonschema
import laspy
import numpy as np
import pytest

from fynjax._core import extras
from fynjax._core.errors import InputError, MissingExtraError
from fynjax.app.io.instruments import load_instrument, load_lidar, write_cloud
from fynjax.app.jobs._schemas import json_schema
from fynjax.sensors import Lidar, LidarReturns, Sensor, lidar_folder, shipped_lidar, shipped_lidars

FLASH = (lidar_folder() / "flash_lidar_paper.toml").read_text("utf-8")
SCAN = (lidar_folder() / "scanning_lidar.toml").read_text("utf-8")
MIRROR = (lidar_folder() / "minivux_1uav.toml").read_text("utf-8")


def test_an_array_has_its_columns_first(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(FLASH.replace("columns = 128", "columns = 64"))
    assert load_lidar(own).geometry.array == (64, 128)


@pytest.mark.parametrize("name", shipped_lidars())
def test_shipped_files_are_valid_and_the_same_by_both_roads(name, tmp_path):
    text = (lidar_folder() / f"{name}.toml").read_text("utf-8")
    jsonschema.Draft202012Validator(json_schema("lidar")).validate(tomllib.loads(text))
    own = tmp_path / "own.toml"
    own.write_text(text)
    for loaded in (load_lidar(name), load_lidar(own)):
        assert loaded == shipped_lidar(name)


@pytest.mark.parametrize(
    ("text", "old", "new", "says"),
    [
        (FLASH, "wavelength_nm = 1064.0", "wavelength_nm = 1.064", "Micrometres"),
        (FLASH, "pulse_fwhm_ns = 2.0", "pulse_fwhm_ns = 2000.0", "Picoseconds"),
        (FLASH, "half_divergence_rad = 0.071", "half_divergence_rad = 71.0", "Milliradians"),
        (FLASH, "sample_m = 0.15", "sample_m = 15.0", "Centimetres"),
        (FLASH, "sample_m = 0.15", "sample_cm = 15.0", "unknown name 'sample_cm'"),
        (FLASH, "columns = 128", 'columns = "128 px"', "whole number"),
        (FLASH, "rows = 128\n", "", "expected 'rows'.* missing"),
        (
            FLASH,
            "rows = 128",
            "rows = 128\npulse_density_m2 = 4.0",
            "unknown name 'pulse_density_m2'",
        ),
        (FLASH, "[40.0, 50.0]", "[50.0, 40.0]", "nearest, farthest"),
        (SCAN, "half_scan_angle_deg = 20.0", "half_scan_angle_deg = 75.0", "above 0 to 60"),
        (SCAN, "divergence_mrad = 0.5", "divergence_mrad = 0.0005", "Radians"),
        (SCAN, "sample_m = 0.15", "sample_m = 0.15\ngate_margin_m = 1.0", "needs range_gate_m"),
        (SCAN, 'kind = "scan"', 'kind = "scanner"', "'scan'"),
        (MIRROR, "divergence_mrad = [1.6, 0.5]", "divergence_mrad = [0.0016, 0.0005]", "Radians"),
        (MIRROR, "divergence_mrad = [1.6, 0.5]", "divergence_mrad = 1.6", "divergence_mrad"),
        (MIRROR, "used_share = 0.25", "used_share = 25.0", "at most 1|0 to 1"),
        (MIRROR, "used_share = 0.25", "pulse_density_m2 = 4.0", "pulse_density_m2"),
        (MIRROR, "range_sd_m = 0.005", "range_sd_m = -0.005", "range_sd_m"),
    ],
)
def test_slips_are_named_with_their_place(tmp_path, text, old, new, says):
    assert old in text
    path = tmp_path / "lidar.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=says) as error:
        load_lidar(path)
    assert error.value.file == path
    assert error.value.row is not None


def test_unknown_names_and_missing_files(tmp_path):
    with pytest.raises(InputError, match="Did you mean 'scanning_lidar'"):
        load_lidar("scaning_lidar")
    with pytest.raises(InputError, match="Did you mean 'zenmuse_l2'"):
        load_lidar("zenmuse_l1")
    with pytest.raises(InputError, match="LiDAR file"):
        load_lidar(tmp_path / "none.toml")


def some_returns():
    beam = np.array([0, 0, 3])
    return LidarReturns(
        beam=beam,
        position=np.array([[1.25, 2.5, 0.75], [1.25, 2.5, 0.0], [3.0, 0.5, -0.01]]),
        distance=np.array([49.25, 50.0, 50.01]),
        reflectance=np.array([0.25, 0.1, 5.0]),
        width=np.array([2.1, 2.2, 2.3]),
        number=np.array([1, 2, 1]),
        of=np.array([2, 2, 1]),
        classification=np.array([3, 2, 2]),
        time=np.array([1.5, 1.5, 7.25]),
        scan_angle=np.array([-12.0, -12.0, 3.0]),
        line=np.array([0, 0, 1]),
    )


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_cloud_opens_in_laspy(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    origin = (600000.0, 6180000.0, 120.0)
    write_cloud(path, some_returns(), origin_m=origin, crs="EPSG:32734")
    cloud = laspy.read(path)
    assert str(cloud.header.version) == "1.4"
    assert cloud.point_format.id == 6
    np.testing.assert_allclose(cloud.xyz, some_returns().position + origin, atol=3e-4)
    np.testing.assert_array_equal(cloud.return_number, [1, 2, 1])
    np.testing.assert_array_equal(cloud.number_of_returns, [2, 2, 1])
    np.testing.assert_array_equal(cloud.classification, [3, 2, 2])
    np.testing.assert_array_equal(cloud.intensity, [5000, 2000, 65535])
    np.testing.assert_allclose(
        np.asarray(cloud.scan_angle) * 0.006, [-12.0, -12.0, 3.0], atol=0.003
    )
    np.testing.assert_allclose(cloud.gps_time, [1.5, 1.5, 7.25])
    np.testing.assert_array_equal(cloud.point_source_id, [1, 1, 2])
    np.testing.assert_allclose(cloud.reflectance, [0.25, 0.1, 5.0])
    np.testing.assert_array_equal(cloud.pulse, [0, 0, 3])
    assert cloud.header.global_encoding.wkt
    assert "34S" in cloud.header.vlrs.get("WktCoordinateSystemVlr")[0].string
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_clouds_that_cannot_be_written(tmp_path, monkeypatch):
    empty = LidarReturns(**{k: v[:0] for k, v in vars(some_returns()).items()})
    with pytest.raises(InputError, match="no pulse has a return"):
        write_cloud(tmp_path / "cloud.laz", empty)
    with pytest.raises(InputError, match=r"\.las or \.laz"):
        write_cloud(tmp_path / "cloud.ply", some_returns())
    with pytest.raises(InputError, match="EPSG"):
        write_cloud(tmp_path / "cloud.laz", some_returns(), crs="{nowhere}")

    def absent(name):
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(extras.importlib, "import_module", absent)
    with pytest.raises(MissingExtraError, match="terrain"):
        write_cloud(tmp_path / "cloud.laz", some_returns())
    assert not list(tmp_path.iterdir())


def test_one_loader_tells_a_lidar_from_a_camera(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text((lidar_folder() / "flash_lidar_paper.toml").read_text("utf-8"), "utf-8")
    for name in ("flash_lidar_paper", own):
        assert isinstance(load_instrument(name), Lidar)
    assert isinstance(load_instrument("mavic_3m"), Sensor)
    with pytest.raises(InputError, match="Did you mean 'aviris_ng'"):
        load_instrument("aviris")
    with pytest.raises(InputError, match=r"none\.toml"):
        load_instrument(tmp_path / "none.toml")
