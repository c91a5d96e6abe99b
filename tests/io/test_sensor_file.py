"""Sensor files: shipped ones, one's own, and what is refused."""

import csv
import tomllib
import typing
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jsonschema
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.instruments import load_instrument, load_sensor
from fynjax.app.io.instruments._sensor_tables import RadianceUnit
from fynjax.app.jobs._schemas import json_schema
from fynjax.sensors import (
    ASSUMED,
    CameraNoise,
    FrameCamera,
    Gains,
    OrthographicCamera,
    PushbroomCamera,
    sensor_folder,
    shipped_sensor,
    shipped_sensors,
)
from fynjax.sensors._noise import RADIANCE_UNITS

OWN = """\
name = "own"
source = "data sheet"

[geometry]
kind = "frame"
altitude_m = 60
focal_length_mm = 8
pixel_pitch_um = 4
columns = 12
rows = 8

[bands]
response = "box"
name = ["green", "red", "nir"]
centre_nm = [550, 660, 850]
fwhm_nm = [40, 40, 60]

[psf]
kind = "gaussian"
width_pixels = [1.2, 0.8]

[noise]
kind = "camera"
saturation_radiance = [400, 350, 300]
full_well_electrons = 10500
read_noise_electrons = 3
bits = 12
"""


GEOMETRY = OWN[OWN.index("[geometry]") : OWN.index("[bands]")]
CALIBRATION = """
[calibration]
usual = "panels"
light_sensor = {gain_sd = 0.2, gain_shared = 0.1}
panels = {gain_sd = [0.1, 0.2, 0.3], gain_shared = 0.5}
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes OWN with replacements, and tables beside it."""

    def writer(*changes: tuple[str, str], **tables: str) -> Path:
        text = OWN
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        for name, table in tables.items():
            (tmp_path / f"{name}.csv").write_text(table)
        (tmp_path / "own.toml").write_text(text, encoding="utf-8")
        return tmp_path / "own.toml"

    return writer


def with_table(name: str) -> tuple[str, str]:
    start = OWN.index("response"), OWN.index("[psf]")
    return OWN[slice(*start)], f'table = "{name}.csv"\n\n'


@pytest.mark.filterwarnings("ignore:aviris_ng_paper")
@pytest.mark.parametrize("name", shipped_sensors())
def test_shipped_files_are_valid_and_read_alike(name: str) -> None:
    """Through the validating reader and without it comes the same sensor."""
    assert bool(eqx.tree_equal(load_sensor(name), shipped_sensor(name)))
    raw = tomllib.loads((sensor_folder() / f"{name}.toml").read_text("utf-8"))
    jsonschema.Draft202012Validator(json_schema("sensor")).validate(raw)
    assert raw["name"] == name
    assert load_sensor(sensor_folder() / f"{name}.toml").source == raw["source"]


def test_rows_of_the_shipped_tables_are_valid() -> None:
    kinds = {"bands": "sensor_band_row", "noise": "sensor_noise_row", "curves": "sensor_curve_row"}
    tables = sorted(sensor_folder().glob("*.csv"))
    for path in tables:
        kind = path.stem.rpartition("_")[2]
        if kind not in kinds:
            continue
        check = jsonschema.Draft202012Validator(json_schema(kinds[kind]))
        for row in list(csv.DictReader(path.read_text("utf-8").splitlines()))[::25]:
            check.validate({k: v if k == "band" else float(v) for k, v in row.items()})


def test_the_paper_s_pixel_is_that_of_images() -> None:
    with pytest.warns(UserWarning, match=r"3 m disagrees .* 1\.015 m .* 2956 m.* stated pixel"):
        sensor = load_sensor("aviris_ng_paper")
    assert float(sensor.ground_sample_distance()) == pytest.approx(1.01504, abs=1e-5)
    assert float(sensor.pixel()) == pytest.approx(3.0, rel=1e-6)
    assert float(sensor.pixel(2000.0)) == pytest.approx(6.0, rel=1e-6)


def test_own_file(write: Callable) -> None:
    sensor = load_sensor(write())
    assert sensor.bands.names == ("green", "red", "nir")
    assert sensor.bands.response == "box"
    assert isinstance(sensor.camera, FrameCamera)
    assert sensor.camera.shape == (8, 12)
    assert float(sensor.ground_sample_distance()) == pytest.approx(0.03)
    assert sensor.psf is not None
    np.testing.assert_allclose(sensor.psf.width, [1.2, 0.8])
    assert isinstance(sensor.noise, CameraNoise)
    electrons = 10500 * 0.5
    expected = 400 / 10500 * np.sqrt(electrons + 9 + (10500 / 4095) ** 2 / 12)
    assert float(sensor.noise.standard_deviation(np.array([200.0, 1, 1]))[0]) == pytest.approx(
        expected
    )
    half = load_sensor(write(("fwhm_nm = [40, 40, 60]", "half_width_nm = [20, 20, 30]")))
    assert half.bands == sensor.bands


def test_geometries_and_tables(write: Callable) -> None:
    bands = "name,centre_nm,half_width_nm,ground_sample_distance_m\na,500,5,10\nb,600,6,20\n"
    noise = "wavelength_nm,a,b,c\n400,0.1,1,0\n700,0.1,1,0\n"
    geometry = OWN[OWN.index('kind = "frame"') : OWN.index("[bands]")]
    own_noise = OWN[OWN.index('kind = "camera"') :]
    table_noise = 'kind = "radiometric"\ntable = "noise.csv"\n'
    unit = 'radiance_unit = "W m-2 sr-1 um-1"\nintegrations = 4\n'
    satellite = load_sensor(
        write(
            with_table("bands"),
            (geometry, 'kind = "orthographic"\npixel_m = 10\nview_zenith_deg = 5\n\n'),
            (own_noise, table_noise + unit),
            bands=bands,
            noise=noise,
        )
    )
    assert isinstance(satellite.camera, OrthographicCamera)
    assert float(satellite.camera.view_zenith) == 5.0
    assert satellite.bands.fwhm == (10.0, 12.0)
    assert satellite.band_pixel == (10.0, 20.0)
    assert satellite.noise is not None
    np.testing.assert_allclose(
        satellite.noise.standard_deviation(np.array([8.0, 3.0])), [0.15, 0.1]
    )
    flown = load_sensor(write(('"frame"', '"pushbroom"'), ("rows = 8\n", "tilt_deg = 3\n")))
    assert isinstance(flown.camera, PushbroomCamera)
    assert flown.camera.line.shape == (1, 12)


def test_units_named_twice_agree() -> None:
    assert set(typing.get_args(RadianceUnit)) == set(RADIANCE_UNITS)


@pytest.mark.parametrize(
    ("change", "row", "message"),
    [
        (("[550, 660, 850]", "[0.55, 0.66, 0.85]"), 15, r"centre_nm'.* 0\.55\. Micro.* is 550"),
        (("[550, 660, 850]", "[850, 660, 550]"), 15, "descending from 850 to 550"),
        (("[550, 660, 850]", "[550, 850, 660]"), 15, "660 nm follows 850 nm.*any_order"),
        (("[550, 660, 850]", "[550, 550, 850]"), 15, "duplicate of band 1"),
        (("[550, 660, 850]", "[550, 660]"), 12, "one name for each of 2 bands"),
        (("[40, 40, 60]", "[0.04, 0.04, 0.06]"), 16, "Micrometres"),
        (("fwhm_nm = [40, 40, 60]", ""), 12, "fwhm_nm or half_width_nm.* none"),
        (('"red", "nir"]', '"red", "red"]'), None, "'red' is there twice"),
        (("centre_nm", "centre_um"), None, "unknown name 'centre_um'.*Did you mean 'centre_nm'"),
        (('response = "box"', 'response = "triangle"'), 13, "gaussian"),
        (('response = "box"', 'response = "tabulated"'), 12, "go together"),
        (('"frame"', '"fisheye"'), 5, "'frame', 'pushbroom', 'orthographic'"),
        (('"frame"', '"frames"'), 5, "got 'frames'. Did you mean 'frame'"),
        (('kind = "frame"', ""), 4, "expected 'kind'.* missing"),
        ((GEOMETRY, ""), None, "expected 'geometry'.* missing"),
        ((GEOMETRY, "geometry = 3\n"), 4, "expected a table of lines of sight.* got 3"),
        (("[noise]", "[[noise]]"), None, "expected a table of noise"),
        (("rows = 8", ""), 4, "expected 'rows'.* missing"),
        (('"frame"', '"pushbroom"'), 10, "unknown name 'rows'.*Known: kind, altitude_m"),
        (("columns = 12", "columns = 0"), 9, "geometry.columns': expected a whole number from 1"),
        (("focal_length_mm = 8", "focal_length_mm = 0.008"), 7, "Metres.* is 8"),
        (("pixel_pitch_um = 4", "pixel_pitch_um = 0.004"), 8, "Millimetres.* is 4"),
        (("rows = 8", "rows = 8\ntilt_deg = -90"), 11, "gimbal"),
        (("bits = 12", ""), 22, "expected 'bits'.* missing"),
        (("bits = 12", "bits = 12\nintegrations = 2"), 28, "unknown name 'integrations'"),
        (("[400, 350, 300]", "[400, 350]"), None, "one for each of 3 bands, but has 2"),
        (("[1.2, 0.8]", "-1"), 20, "width of the blur"),
        (('source = "data sheet"', ""), None, "expected 'source'"),
        (("bits = 12", "bits = = 12"), 27, "TOML"),
    ],
)
def test_errors_name_file_row_and_key(
    write: Callable, change: tuple[str, str], row: int | None, message: str
) -> None:
    path = write(change)
    with pytest.raises(InputError, match=message) as caught:
        load_sensor(path)
    assert str(path) in str(caught.value)
    assert row is None or caught.value.row == row


BANDS = "centre_nm,fwhm_nm\n"
CURVES = "band,wavelength_nm,response\n"


@pytest.mark.parametrize(
    ("table", "row", "message"),
    [
        (BANDS + "500,6\n0.505,6\n", 3, "Micrometres.* is 505"),
        (BANDS + "510,6\n505,6\n", 3, "descending"),
        (BANDS + "500,6\n500,6\n", 3, "duplicate"),
        (BANDS + "500,\n", 2, "one of them"),
        ("centre_um,fwhm_nm\n0.5,6\n", 1, "'centre_nm'.*'centre_um'"),
        ("centre_nm,fwhm_nm,half_width_nm\n500,6,\n510,,3\n", 3, "all rows or in none"),
        ("name,centre_nm,fwhm_nm\na,500,6\na,510,6\n", None, "'a' is there twice"),
    ],
)
def test_errors_in_a_table_of_bands(
    write: Callable, table: str, row: int | None, message: str
) -> None:
    path = write(with_table("bands"), bands=table)
    with pytest.raises(InputError, match=message) as caught:
        load_sensor(path)
    assert "bands.csv" in str(caught.value)
    assert row is None or caught.value.row == row


def test_curves_in_a_column_a_band_and_noise_below_zero(write: Callable) -> None:
    old, _ = with_table("x")
    new = 'response = "tabulated"\ncurves = "curves.csv"\n\n'
    wide = "Wavelength (nm),green,red\n540,0,\n550,1,0\n560,-0.01,1\n570,,0\n"
    rows = "green,540,0\ngreen,550,1\ngreen,560,0\nred,550,0\nred,560,1\nred,570,0\n"
    one, other = (
        load_sensor(write((old, new), *no_noise(), curves=table)) for table in (wide, CURVES + rows)
    )
    assert one.bands.names == other.bands.names == ("green", "red")
    np.testing.assert_array_equal(one.bands.centre, [550.0, 560.0])
    np.testing.assert_array_equal(one.bands.fwhm, other.bands.fwhm)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"own"', "“own”", "line 1.*Curly quotation marks"),
        ("altitude_m = 60", "altitude_m = 60,5", r"line 6.*A decimal comma\? Write 60\.5"),
    ],
)
def test_slips_of_whoever_writes_toml(write: Callable, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_sensor(write((old, new)))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (CURVES + "a,500,0\na,510,1\na,505,0\n", "row 4.*505 nm follows 510 nm.*Sort"),
        (CURVES + "a,500,0\na,500,1\n", "row 3.*A duplicate"),
        (CURVES + "a,500,0\nb,500,1\na,510,0\n", "row 4.*start again"),
        (CURVES + "a,500,0\na,510,-1\n", "response.*at least 0"),
        (CURVES + "a,0.5,0\na,0.51,1\n", "Micrometres"),
        (CURVES + "a,500,0\na,510,0\n", "own.toml.*positive"),
        (CURVES + "a,600,1\na,610,1\nb,500,1\nb,510,1\n", "own.toml.*descending"),
        (CURVES + "".join(f"a,{w},1\n" for w in (500, 505, 510, 515, 700)), "row 6.*stray"),
        ("wavelength,a,a\n500,0,0\n510,1,1\n", "row 1.*one name for each band"),
        ("wavelength,a,b\n500,0,0\n510,x,1\n", "row 3.*number, but got 'x'"),
        ("wavelength,a,b\n0.5,0,0\n0.51,1,1\n", "Micrometres"),
    ],
)
def test_errors_in_a_table_of_curves(write: Callable, table: str, message: str) -> None:
    old, _ = with_table("x")
    new = 'response = "tabulated"\ncurves = "curves.csv"\n\n'
    path = write((old, new), *no_noise(), curves=table)
    with pytest.raises(InputError, match=message):
        load_sensor(path)


def test_noise_that_does_not_reach_the_bands_and_unknown_units(write: Callable) -> None:
    old = OWN[OWN.index('kind = "camera"') :]
    new = 'kind = "radiometric"\ntable = "noise.csv"\nradiance_unit = "uW cm-2 sr-1 nm-1"\n'
    noise = "wavelength_nm,a,b,c\n400,0.1,1,0\n700,0.1,1,0\n"
    short = "wavelength_nm,a,b,c\n540,0.1,1,0\n560,0.1,1,0\n"
    with pytest.raises(InputError, match=r"own\.toml.* 660 nm lies outside"):
        load_sensor(write((old, new), noise=short))
    wrong = new.replace("uW cm-2 sr-1 nm-1", "uW/cm2/sr/nm")
    with pytest.raises(InputError, match=r"radiance_unit.*expected one of .*uW cm-2 sr-1 nm-1"):
        load_sensor(write((old, wrong), noise=noise))
    missing = new.replace("noise.csv", "nosie.csv")
    with pytest.raises(InputError, match=r"noise\.table.*'nosie.csv'.*Did you mean 'noise.csv'"):
        load_sensor(write((old, missing), noise=noise))


def test_half_widths_given_as_full_widths_are_noticed(write: Callable) -> None:
    """AVIRIS-NG's own table with its widths halved, as a file of half widths would have them."""
    table = (sensor_folder() / "aviris_ng_bands.csv").read_text("utf-8")
    load_sensor(write(with_table("bands"), *no_noise(), bands=table))
    rows = [line.split(",") for line in table.splitlines()[1:]]
    halved = BANDS + "".join(f"{c},{float(w) / 2:.3f}\n" for c, w in rows)
    with pytest.warns(UserWarning, match="half widths"):
        load_sensor(write(with_table("bands"), *no_noise(), bands=halved))


def no_noise() -> list[tuple[str, str]]:
    return [(OWN[OWN.index("[noise]") :], "")]


def test_names_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Did you mean 'mavic_3m'"):
        load_sensor("mavic_3")
    with pytest.raises(InputError, match="no such file"):
        load_sensor(tmp_path / "none.toml")
    with pytest.raises(InputError, match="folder"):
        load_sensor(tmp_path)


def test_lists_without_end_in_a_file_of_any_instrument_end_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "sensor.toml"
    path.write_text("a = " + "[" * 5000)
    with pytest.raises(InputError, match="expected TOML"):
        load_instrument(path)


def test_errors_of_each_way_of_calibration(write: Callable) -> None:
    assert load_sensor(write()).gains() == ASSUMED
    sensor = load_sensor(write(("\n[psf]", CALIBRATION + "\n[psf]")))
    assert sensor.gains() == Gains((0.1, 0.2, 0.3), 0.5, "panels")
    assert sensor.gains("light_sensor") == Gains(0.2, 0.1, "light_sensor")
    assert sensor.select([2, 0]).gains().sd == (0.3, 0.1)
    with pytest.raises(InputError, match=r"states \(panels, light_sensor\), but got 'panel'"):
        sensor.gains("panel")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2]", "one for each of 3 bands, but got 2"),
        ('usual = "panels"', 'usual = "product"', "expected a table product"),
        ("gain_shared = 0.1", "gain_shared = 1.1", "gain_shared, each of 0 to 1, .*got 1.1"),
    ],
)
def test_wrong_errors_of_calibration_are_refused(write, old, new, message) -> None:
    with pytest.raises(InputError, match=message):
        load_sensor(write(("\n[psf]", CALIBRATION.replace(old, new) + "\n[psf]")))
