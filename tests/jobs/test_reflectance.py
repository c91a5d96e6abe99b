"""`fynjax reflectance`: known reflectance through counts and back, its files, and its errors."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.app.cli import app
from fynjax.app.compare import read_drone_image
from fynjax.app.io.captures import read_capture, usable_captures
from fynjax.app.jobs import pattern
from tests.helpers import assert_valid_summary, read_cube
from tests.io.dji_files import SCALE, write_dji
from tests.io.rededge_files import BANDS, IRRADIANCE, lit, panel_scene, write_rededge


def run(*arguments: object) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(
        app, ["reflectance", *map(str, arguments), "--json"], catch_exceptions=False
    )
    assert result.exit_code == 0
    return json.loads(result.stdout)


def ground(seed: int = 0) -> np.ndarray:
    """Reflectance [row, column] of ground without panels."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.03, 0.6, (12, 16)).repeat(10, axis=0).repeat(10, axis=1)


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """A panel, a capture in its light, and one in 0.6 of it, which the light sensor knows."""
    folder = tmp_path / "flight"
    folder.mkdir()
    write_rededge(folder, "IMG_0000", lit(panel_scene()[0]))
    write_rededge(folder, "IMG_0001", lit(ground()))
    write_rededge(folder, "IMG_0002", lit(ground(), 0.6), light=0.6 * IRRADIANCE)
    return folder


PANEL = ("--panel", "IMG_0000", "--panel-reflectance", "0.5", "--no-align")
NEAR = {"atol": 3e-4, "rtol": 2e-3}
"""A step of the counts is 3e-4 of reflectance in the NIR; the panel averages it out."""


def product(out: Path, name: str = "IMG_0001") -> np.ndarray:
    """Reflectance [band, row, column] as another program reads it."""
    with rasterio.open(out / f"{name}_reflectance.tif") as file:
        return file.read()


def test_reflectance_by_a_panel(flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    summary = run(flight, *PANEL, "--height", "60", "--output", out)
    for band in product(out):
        np.testing.assert_allclose(band, ground(), **NEAR)
    np.testing.assert_allclose(product(out, "IMG_0002")[1], 0.6 * ground(), **NEAR)
    assert len(summary["warnings"]) == 1
    assert (
        "IMG_0002: the light sensor says that the light changed by a factor of 0.60 to 0.60"
        in (summary["warnings"][0])
    )
    assert {p.name for p in out.iterdir()} == {*summary["files"], "summary.json"}
    assert_valid_summary(summary)
    assert all((out / name).stat().st_size > 20_000 for name in ("IMG_0001.png", "panels.png"))
    assert not (out / "IMG_0000_reflectance.tif").exists()
    # The place, the bands and the record.
    with rasterio.open(out / "IMG_0001_reflectance.tif") as file:
        assert file.descriptions == tuple(name for name, _, _ in BANDS)
        assert [float(file.tags(k)["wavelength"]) for k in (1, 2, 3)] == [475.0, 668.0, 840.0]
        assert file.transform.a == pytest.approx(60.0 / (5.5 * 266.667))
        assert file.transform.f == pytest.approx(120 * file.transform.a)
        assert file.tags()["units"] == "1"
        assert json.loads(file.tags()["input_sha256"]).keys() == {
            f"IMG_0001_{k}.tif" for k in (1, 2, 3)
        }
    cube = read_cube(out / "IMG_0001_reflectance_sd.tif")
    sd = np.hypot(0.02, 0.10) * ground()[::-1]  # of the panel, and of light and camera
    np.testing.assert_allclose(cube.values[0], sd, atol=1e-4, rtol=3e-3)
    record = json.loads((out / "provenance.json").read_text("utf-8"))
    assert len(json.loads(record["input_sha256"])) == 9
    panel = record["panels"][0]["bands"][2]
    assert panel["reflectance_by_light_sensor"] == pytest.approx(0.5, rel=1e-3)
    rows = list(csv.DictReader((out / "calibration.csv").read_text().splitlines()[1:]))
    assert [(r["capture"], r["band"]) for r in rows[:3]] == [("IMG_0001", b) for b, _, _ in BANDS]
    assert float(rows[0]["gain"]) == pytest.approx(np.pi / 1300.0, rel=1e-3)


@pytest.mark.parametrize("light", ["sensor", "both"])
def test_reflectance_by_the_light_sensor(flight: Path, tmp_path: Path, light: str) -> None:
    """The same, in full light and in less of it."""
    out = tmp_path / "out"
    summary = run(flight, *PANEL, "--light", light, "--output", out)
    for name in ("IMG_0001", "IMG_0002"):
        np.testing.assert_allclose(product(out, name)[2], ground(), **NEAR)
    assert summary["warnings"] == []
    assert summary["captures"]["IMG_0001"]["pixel_m"] is None
    # Without a panel the sensor is what there is.
    alone = run(flight / "IMG_0001_1.tif", "--no-align", "--output", tmp_path / "alone")
    assert alone["light"] == "sensor"
    np.testing.assert_allclose(product(tmp_path / "alone")[0], ground(), **NEAR)


@pytest.mark.parametrize("light", ["panel", "both"])
@pytest.mark.parametrize("marked", [True, False])
def test_a_panel_before_and_after_the_flight_is_one(light, marked, tmp_path: Path) -> None:
    """Its mean signal is taken, and the light's change between is said."""
    scene, corners = panel_scene()
    area = ",".join(f"{v:.0f}" for v in corners[0].ravel())
    code = f"<Camera:Albedo>0.5</Camera:Albedo><Camera:ReflectArea>{area}</Camera:ReflectArea>"
    more = {"more": code if marked else ""}
    write_rededge(tmp_path, "IMG_0000", lit(scene), **more)
    write_rededge(tmp_path, "IMG_0001", lit(ground()))
    write_rededge(tmp_path, "IMG_0009", lit(scene, 0.8), light=0.8 * IRRADIANCE, **more)
    named = [] if marked else [*PANEL[:2], "--panel", "IMG_0009", *PANEL[2:4]]
    out = tmp_path / "out"
    summary = run(tmp_path, *named, "--no-align", "--light", light, "--output", out)
    assert list(summary["captures"]) == ["IMG_0001"]
    assert [panel["capture"] for panel in summary["panels"]] == ["IMG_0000", "IMG_0009"]
    mean = 0.9 if light == "panel" else 1.0
    np.testing.assert_allclose(product(out)[2], ground() / mean, atol=4e-4, rtol=2e-3)
    bands = summary["captures"]["IMG_0001"]["bands"]
    change = 1.0 / 0.9 if light == "panel" else 1.0  # since the mean, or since the first
    np.testing.assert_allclose([b["light_since_panel"] for b in bands], change, rtol=1e-3)
    sd = read_cube(out / "IMG_0001_reflectance_sd.tif").values[0]
    np.testing.assert_allclose(sd, np.hypot(0.02, 0.10) * product(out)[0][::-1], rtol=3e-3)
    (said,) = [text for text in summary["headline"] if "pictures of one panel" in text]
    assert ("the light changed by up to 22.2 %" in said) == (light == "panel")
    assert ("what the light sensor says by up to 0." in said) == (light == "both")
    warned = [text for text in summary["warnings"] if text == said]
    assert len(warned) == (light == "panel")


def test_two_panels_take_the_haze_off(tmp_path: Path) -> None:
    haze = np.array([9.0, 4.0, 2.0])[:, None, None]
    scene, corners = panel_scene((0.55, 0.06))
    folder = tmp_path / "flight"
    folder.mkdir()
    write_rededge(folder, "IMG_0000", lit(scene) + haze)
    write_rededge(folder, "IMG_0001", lit(ground()) + haze)
    panels = []
    for area, rho in zip(corners, ("0.55", "0.06"), strict=True):
        text = " ".join(f"{x:g},{y:g}" for x, y in area)
        panels += ["--panel", "IMG_0000", "--panel-reflectance", rho, "--panel-area", text]
    run(folder, *panels, "--no-align", "--output", tmp_path / "out")
    for band in product(tmp_path / "out"):
        np.testing.assert_allclose(band, ground(), atol=6e-4, rtol=3e-3)
    run(folder, *panels[:6], "--no-align", "--output", tmp_path / "one")
    # One panel takes the haze for light from the ground: dark ground comes out too bright.
    veil = np.pi * haze[0, 0, 0] / IRRADIANCE[0]
    wrong = 0.55 * (ground() + veil) / (0.55 + veil)
    np.testing.assert_allclose(product(tmp_path / "one")[0], wrong, atol=6e-4, rtol=3e-3)


def test_a_panel_and_a_capture_of_the_flight_may_have_one_name(tmp_path: Path) -> None:
    """The camera numbers its pictures anew in each folder."""
    before, flight = tmp_path / "0000SET", tmp_path / "0001SET"
    before.mkdir()
    flight.mkdir()
    (panel, *_) = write_rededge(before, "IMG_0000", lit(panel_scene()[0]))
    write_rededge(flight, "IMG_0000", lit(ground()))
    write_rededge(flight, "IMG_0001", lit(ground(1)))
    out = tmp_path / "out"
    summary = run(flight, "--panel", panel, *PANEL[2:], "--output", out)
    assert list(summary["captures"]) == ["IMG_0000", "IMG_0001"]
    np.testing.assert_allclose(product(out, "IMG_0000")[0], ground(), **NEAR)
    # A path to the same files in other words is the same capture.
    other = flight / ".." / "0001SET" / panel.name
    panel.replace(other)
    for band in (2, 3):
        (before / f"IMG_0000_{band}.tif").replace(flight / f"IMG_0000_{band}.tif")
    summary = run(flight, "--panel", other, *PANEL[2:], "--output", tmp_path / "other")
    assert list(summary["captures"]) == ["IMG_0001"]


def test_what_is_refused(flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments, message in (
        ((*PANEL, "--light", "sun"), "panel, sensor, both"),
        ((*PANEL, "--panel-area", "1,2 3"), "corners"),
        ((*PANEL, "--panel", "IMG_0001", "--panel-area", "1,2 3,4 5,1"), "--panel-area"),
        ((*PANEL, "--height", "50", "--pixel", "0.1"), "both"),
        ((*PANEL, "--pixel", "0"), "`--pixel`"),
        ((*PANEL, "--panel-sd", "5"), "`--panel-sd`"),
        (("--panel", "IMG_0009"), r"'IMG_0009'\. Did you mean 'IMG_000"),
        (("--light", "panel"), "--panel IMG_0000"),
        (("--panel", "IMG_0000"), "pictures do not state it"),
        (("--panel", "IMG_0001", "--panel-reflectance", "0.5"), "--panel-area"),
        (("--panel", "IMG_0000", "--panel", "IMG_0000", "--panel-reflectance", "0.5"),
         "differ in reflectance.*band 1"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            run(flight, *arguments, "--output", out)
    dark = write_rededge(tmp_path, "D", lit(ground()), light=None)
    with pytest.raises(InputError, match="light sensor"):
        run(*dark, "--output", out)
    only = [flight / f"IMG_0000_{k}.tif" for k in (1, 2, 3)]
    with pytest.raises(InputError, match="panels: IMG_0000"):
        run(*only, *PANEL, "--output", out)
    assert not out.exists()


def test_a_capture_that_lacks_a_band_is_skipped_before_the_work(
    flight: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(flight, tmp_path / "copy")
    write_rededge(folder, "IMG_0007", lit(ground()))
    write_rededge(folder, "IMG_0008", lit(ground()))
    (folder / "IMG_0008_2.tif").unlink()
    (folder / "IMG_0009_1.tif").write_bytes(b"no picture")
    summary = run(folder, *PANEL, "--output", tmp_path / "out")
    assert "IMG_0007" in summary["captures"]
    assert not {"IMG_0008", "IMG_0009"} & set(summary["captures"])
    said = " ".join(summary["warnings"])
    assert "IMG_0008 is skipped" in said
    assert "Red is missing" in said
    assert "IMG_0009 is skipped" in said


def test_the_bands_of_most_captures_are_the_usual_ones(tmp_path: Path) -> None:
    captures = {}
    for number, bands in enumerate((2, 2, 3)):
        name = f"IMG_000{number}"
        captures[name] = write_rededge(tmp_path, name, lit(ground()))[:bands]
    usable, skipped, _ = usable_captures(captures)
    assert list(usable) == list(captures)
    assert not skipped


def test_a_flight_of_a_dji_without_one_of_its_bands_gets_a_warning(mavic: Path) -> None:
    files = sorted(mavic.glob(f"{MAVIC_GROUND}_MS_*"))
    assert usable_captures({MAVIC_GROUND: files})[0]
    with pytest.warns(UserWarning, match=r"has 3 of its camera's 4 bands: Green, "):
        usable_captures({MAVIC_GROUND: files[:3]})


@pytest.mark.parametrize(
    ("stated", "instead"),
    [
        ('CentralWavelength="840"', 'CentralWavelength="11000"'),
        ('BandName="NIR" Camera:CentralWavelength="840"', 'BandName="LWIR"'),
        ('BandName="NIR" Camera:CentralWavelength="840"', 'BandName="Panchro"'),
    ],
)
def test_thermal_and_panchromatic_bands_are_left_out(stated, instead, tmp_path: Path) -> None:
    paths = write_rededge(tmp_path, "IMG_0000", lit(ground()))
    (tmp_path / "t").mkdir()
    thermal = write_rededge(
        tmp_path / "t", "IMG_0000", lit(ground())[:, ::4, ::4],
        change=lambda text: text.replace(stated, instead),
    )[2]  # fmt: skip
    added = thermal.rename(tmp_path / "IMG_0000_6.tif")
    capture = read_capture("IMG_0000", [*paths, added])
    assert capture.names == ("Blue", "Red", "NIR")
    with pytest.raises(InputError, match="all are thermal or panchromatic"):
        read_capture("IMG_0000", [added])


@pytest.mark.parametrize("folder", ["12_rededge-p-altum-pt", "11_dji-m3m-raw-capture"])
def test_where_an_image_is_asked_for_raw_captures_are_refused(
    folder, shared_data, tmp_path
) -> None:
    path = next(iter(sorted((shared_data / "field" / folder).iterdir())))
    with pytest.raises(InputError, match=r"raw capture, whose .*: fynjax reflectance"):
        pattern([path], tmp_path / "out", pixel=0.05)
    with pytest.raises(InputError, match=r"raw capture, whose .*: fynjax reflectance"):
        pattern([path], tmp_path / "out")
    with pytest.raises(InputError, match=r"raw capture, whose .*: fynjax reflectance"):
        read_drone_image(path)


MAVIC_PANEL = "DJI_20261122100000_0000"
MAVIC_GROUND = "DJI_20261122100001_0001"


@pytest.fixture
def mavic(tmp_path: Path) -> Path:
    """A panel of a half, and ground in 0.6 of its light, which the light sensor knows."""
    folder = tmp_path / "mavic"
    folder.mkdir()
    write_dji(folder, MAVIC_PANEL, [panel_scene()[0]] * 4)
    write_dji(folder, MAVIC_GROUND, [ground(k) for k in range(4)], light=0.6)
    return folder


def test_a_mavic_by_a_panel_and_its_light_sensor(mavic: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    panel = ("--panel", MAVIC_PANEL, "--panel-reflectance", "0.5", "--no-align")
    summary = run(mavic, *panel, "--light", "both", "--height", "54", "--output", out)
    for k, band in enumerate(product(out, MAVIC_GROUND)):
        np.testing.assert_allclose(band, ground(k), atol=3e-4, rtol=2e-3)
    assert summary["warnings"] == []
    assert summary["captures"][MAVIC_GROUND]["pixel_m"] == pytest.approx(54.0 / 135.0)
    assert summary["panels"][0]["bands"][0]["reflectance_by_light_sensor"] is None
    cube = read_cube(out / f"{MAVIC_GROUND}_reflectance_sd.tif")
    # By the file of the sensor a panel leaves 10 %; that of its own reflectance is on top.
    sd = np.hypot(0.10, 0.02) * ground()[::-1]
    np.testing.assert_allclose(cube.values[0], sd, atol=2e-4, rtol=5e-3)
    assert cube.names == ("Green", "Red", "RedEdge", "NIR")


def test_a_mavic_by_its_light_sensor_alone_is_right_up_to_a_factor(
    mavic: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    for path in mavic.glob(f"{MAVIC_PANEL}*"):
        path.unlink()
    summary = run(mavic, "--no-align", "--output", out)
    assert [warning[:45] for warning in summary["warnings"]] == [
        "reflectance by this camera's light sensor alo"
    ]
    for k, band in enumerate(product(out, MAVIC_GROUND)):
        np.testing.assert_allclose(band * SCALE / np.pi, ground(k), atol=3e-4, rtol=2e-3)
    made = out / f"{MAVIC_GROUND}_reflectance.tif"
    with rasterio.open(made) as file:
        assert "right up to one factor" in file.tags()["reflectance_scale"]
    with pytest.warns(UserWarning, match="right up to one factor that all bands share"):
        read_drone_image(made)
    sd = read_cube(out / f"{MAVIC_GROUND}_reflectance_sd.tif").values[2]
    np.testing.assert_allclose(sd, 0.35 * product(out, MAVIC_GROUND)[2][::-1], rtol=1e-4)
    head = (out / "calibration.csv").read_text().splitlines()[0]
    assert "radiance [the camera maker's own]" in head


FIX = {
    "GpsLatitude": "-33.95", "GpsLongtitude": "+18.05", "FlightYawDegree": "+30.0",
    "RelativeAltitude": "+40.5", "RtkStdLat": "0.3", "RtkStdLon": "0.4",
}  # fmt: skip


def test_a_capture_lies_where_it_was_taken(tmp_path: Path) -> None:
    """By GPS, the height above the take-off and the heading, each pixel as it was."""
    scene = [np.roll(ground(k), 5, axis=(0, 1)) for k in range(4)]
    write_dji(tmp_path, MAVIC_GROUND, scene, more=FIX)
    summary = run(tmp_path, "--no-align", "--output", tmp_path / "out")
    record = summary["captures"][MAVIC_GROUND]
    assert record["pixel_m"] == pytest.approx(40.5 / 135.0)
    # RTK knows 0.5 m; a gimbal off by 1 degree moves the picture by 0.71 m.
    assert record["place_sd_m"] == pytest.approx(np.hypot(0.5, 0.707), rel=1e-3)
    made = tmp_path / "out" / f"{MAVIC_GROUND}_reflectance.tif"
    with rasterio.open(made) as file:
        assert file.crs.to_epsg() == 32734
        assert "by GPS, height and heading: the middle to some 0.9 m" in file.tags()["coordinates"]
        middle = Transformer.from_crs(4326, 32734, always_xy=True).transform(18.05, -33.95)
        (at,) = file.sample([middle])
        values = file.read(1, masked=True)
    expected = [rho[59, 79] * np.pi / SCALE for rho in scene]  # in the middle of a patch
    np.testing.assert_allclose(at, expected, rtol=5e-3)
    assert values.count() == pytest.approx(120 * 160, rel=0.01)
    flat = run(tmp_path, "--no-align", "--pixel", "0.1", "--output", tmp_path / "pixel")
    assert flat["captures"][MAVIC_GROUND]["pixel_m"] == 0.1


@pytest.mark.parametrize("size", [(), ("--height", "40")])
def test_an_oblique_picture_is_not_laid_on_the_map(size, tmp_path: Path) -> None:
    """Nor has it a pixel of one size; the capture beside it that looks down is laid there."""
    down, aside = MAVIC_GROUND, "DJI_20261122100002_0002"
    rho = [ground(k) for k in range(4)]
    write_dji(tmp_path, down, rho, more=FIX | {"GimbalPitchDegree": "-89.9"})
    write_dji(tmp_path, aside, rho, more=FIX | {"GimbalPitchDegree": "-30.0"})
    out = tmp_path / "out"
    summary = run(tmp_path, "--no-align", *size, "--output", out)
    assert summary["captures"][down]["place_sd_m"] is not None
    record = summary["captures"][aside]
    assert (record["pixel_m"], record["place_sd_m"]) == (None, None)
    (said,) = [text for text in summary["warnings"] if "straight down" in text]
    assert said.startswith(f"{aside}: the camera looked up to 60 degrees away")
    assert "fynjax frames FLIGHT --plot PLOT --images " in said
    with rasterio.open(out / f"{aside}_reflectance.tif") as file:
        assert file.crs is None or not file.crs.is_projected
        assert file.shape == (120, 160)
        assert "picture" in file.tags()
    own = run(tmp_path, "--no-align", "--own-pixels", "--output", tmp_path / "own")
    assert not any("straight down" in text for text in own["warnings"])


@pytest.mark.parametrize(("roll", "aside"), [(8.0, False), (30.0, True)])
def test_the_tilt_that_a_fixed_camera_states_counts(roll, aside, tmp_path: Path) -> None:
    pose = f"<Camera:Pitch>1.0</Camera:Pitch><Camera:Roll>{roll}</Camera:Roll>"
    write_rededge(tmp_path, "IMG_0001", lit(ground()), more=pose)
    summary = run(tmp_path, "--no-align", "--height", "60", "--output", tmp_path / "out")
    assert (summary["captures"]["IMG_0001"]["pixel_m"] is None) == aside
    assert any("looked up to 30 degrees" in text for text in summary["warnings"]) == aside


def test_the_raw_capture_of_the_field_has_its_ndvi(shared_data: Path, tmp_path: Path) -> None:
    """Soil 0.26, plants 0.78; its metadata have no vignetting."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    summary = run(shared_data / "field" / "11_dji-m3m-raw-capture", "--output", tmp_path / "out")
    (name,) = summary["captures"]
    assert "no numbers for vignetting" in summary["warnings"][1]
    _, red, _, nir = product(tmp_path / "out", name)
    ndvi = (nir - red) / (nir + red)
    plants = ndvi > 0.5
    assert np.median(ndvi[plants]) == pytest.approx(0.78, abs=0.005)
    assert np.median(ndvi[~plants]) == pytest.approx(0.26, abs=0.005)


def test_captures_without_light_or_likeness_are_skipped(mavic: Path, tmp_path: Path) -> None:
    """One whose light sensor says nothing before the work, one whose bands do not fit after."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    write_dji(
        mavic, "DJI_20261122100002_0002", [ground()] * 4,
        change=lambda text: text.replace('Irradiance="13096.1"', 'Irradiance="0"'),
    )  # fmt: skip
    rng = np.random.default_rng(1)
    write_dji(mavic, "DJI_20261122100003_0003", rng.uniform(0.1, 0.5, (4, 120, 160)))
    write_dji(mavic, "DJI_20261122100004_0004", [ground() * (1 + k) for k in range(4)])
    summary = run(*(p for p in mavic.glob("*_MS_*") if p.name[17] in "234"), "--output",
                  tmp_path / "out")  # fmt: skip
    assert list(summary["captures"]) == ["DJI_20261122100004_0004"]
    said = " ".join(summary["warnings"])
    assert "DJI_20261122100002_0002 is skipped: " in said
    assert "irradiance of a downwelling light sensor" in said
    assert "DJI_20261122100003_0003 is skipped: " in said


@pytest.mark.slow
def test_a_real_flight(shared_data: Path, tmp_path: Path) -> None:
    """Rows of bushes and trees on dry soil, with the reflectance of the panel that its maker gives
    in the tutorial for these pictures (micasense/imageprocessing): 0.69, 0.68 and 0.61."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    folder = shared_data / "eco" / "uas_micasense"
    files = [folder / f"IMG_000{capture}_{band}.tif" for capture in (0, 1) for band in (2, 3, 4)]
    out = tmp_path / "out"
    summary = run(
        *files, "--panel", "IMG_0000", "--panel-reflectance", "0.69,0.68,0.61", "--height", "72.7",
        "--output", out,
    )  # fmt: skip
    for band, line in zip(
        summary["panels"][0]["bands"], summary["captures"]["IMG_0001"]["bands"], strict=True
    ):
        assert line["gain"] * band["radiance"] == pytest.approx(band["reflectance"], rel=1e-9)
    assert summary["captures"]["IMG_0001"]["alignment_residual_px"] < 1.0
    cube = read_cube(out / "IMG_0001_reflectance.tif")
    green, red, nir = cube.values
    ndvi = (nir - red) / (nir + red)
    known = np.isfinite(cube.values).all(axis=0)
    assert known.sum() > 0.96 * 1280 * 960
    assert cube.crs is not None
    assert "UTM zone 11N" in cube.crs
    leaves = known & (ndvi > 0.6) & (nir > 0.3)
    soil = known & (ndvi < 0.25)
    assert leaves.sum() > 0.2 * known.sum()
    assert soil.sum() > 0.15 * known.sum()
    # Sunlit leaves absorb red, reflect half of the NIR, and are green; dry soil rises with the
    # wavelength (Jensen 2007, fig. 10-6 and 11-1).
    assert 0.02 < np.median(red[leaves]) < 0.08
    assert 0.05 < np.median(green[leaves]) < 0.15
    assert 0.35 < np.median(nir[leaves]) < 0.65
    assert np.median(green[soil]) < np.median(red[soil]) < np.median(nir[soil])
    assert 0.12 < np.median(red[soil]) < 0.4
    assert np.nanpercentile(cube.values, 0.1) > 0.0
