"""Raw pictures of a RedEdge: what is read, the panel, and what is refused."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from fynjax._core.errors import InputError
from fynjax.app.io.captures._capture import (
    aligned_radiance,
    find_captures,
    read_capture,
    same_capture,
)
from fynjax.app.io.captures._metadata import read_band
from fynjax.app.io.captures._panel import find_panel, panel_reflectance, read_panel
from tests.io.rededge_files import BANDS, IRRADIANCE, camera, lit, panel_scene, write_rededge


def test_radiance_and_metadata_come_back(tmp_path: Path) -> None:
    radiance = lit(panel_scene()[0])
    paths = write_rededge(tmp_path, "IMG_0007", radiance)
    capture = read_capture("IMG_0007", paths)
    assert [(b.name, b.wavelength, b.fwhm) for b in capture.bands] == list(BANDS)
    first = capture.bands[0]
    assert first.capture == "id of IMG_0007"
    assert first.time == "2026:11:22 10:00:00"
    assert first.focal_length == pytest.approx(5.5 * 266.667)
    assert first.irradiance == pytest.approx(IRRADIANCE[0])
    assert first.irradiance_tilt == pytest.approx(5.0, abs=0.01)  # 3 and 4 degrees at right angles
    # A step of 16 counts is 0.09 W m-2 sr-1 um-1, more in the corners.
    np.testing.assert_allclose(capture.radiance(), radiance, atol=0.06)


def test_an_irradiance_that_is_level_is_preferred(tmp_path: Path) -> None:
    """It is in uW cm-2 nm-1 unless its scale is named."""
    more = "<Camera:HorizontalIrradiance>{}</Camera:HorizontalIrradiance>"
    radiance = lit(panel_scene()[0])
    band = read_band(write_rededge(tmp_path, "A", radiance, more=more.format(140.0))[0])
    assert (band.irradiance, band.irradiance_tilt) == (pytest.approx(1400.0), None)
    scale = "<Camera:IrradianceScaleToSIUnits>0.1</Camera:IrradianceScaleToSIUnits>"
    more = more.format(14.0) + scale
    band = read_band(write_rededge(tmp_path, "B", radiance, more=more)[0])
    assert band.irradiance == pytest.approx(1400.0)
    band = read_band(write_rededge(tmp_path, "C", radiance, light=None)[0])
    assert band.irradiance is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"change": lambda t: ""}, "'RadiometricCalibration', but there are none at all"),
        ({"change": lambda t: t.replace("DarkRowValue", "Dark")}, "'DarkRowValue', but it has"),
        ({"change": lambda t: t.replace("1.2e-07", "x")}, "expected 3 numbers .* but got 0.00015"),
        ({"change": lambda t: t[:-9]}, r"\(XMP\) cannot be read"),
        ({"change": lambda t: "<!DOCTYPE a>" + t}, "must not define entities"),
        ({"exif": False}, "EXIF metadata with 'ExposureTime'"),
        ({"change": lambda t: t.replace("0.00015", "-0.00015")}, "number above 0 as 'Radiometric"),
        ({"change": lambda t: t.replace("0.00015", "0")}, "number above 0 as 'Radiometric"),
        ({"change": lambda t: t.replace('"475"', '"0.475"')}, r"Micrometres\? In nm this is 475"),
    ],
)
def test_metadata_that_miss_something(tmp_path: Path, options: dict, message: str) -> None:
    paths = write_rededge(tmp_path, "IMG_0001", lit(panel_scene()[0]), **options)
    with pytest.raises(InputError, match=message) as caught:
        read_band(paths[0])
    assert caught.value.file == paths[0]


REDEDGE_P = {
    "Name": "0,0,0,1,0,2,0,3,0,4,0,5,1,0,1,1,1,2,1,3,1,4,2,0,2,1,2,2,2,3,3,0,3,1,3,2,4,0,4,1,5,0",
    "": "0.467640,0.501446,-0.288309,-0.448964,0.306178,-0.083137,1.384667,0.284610,-0.472609,"
    "0.215251,-0.015028,-0.951077,-0.142211,0.523393,-0.179298,-0.884722,-0.275812,-0.063004,"
    "0.511571,0.124509,-0.058204",
}
"""Vignetting of a RedEdge-P (github.com/micasense/imageprocessing, issue 191)."""


def _with_two_dimensions(text: str) -> str:
    for key, value in REDEDGE_P.items():
        text = text.replace(
            "<Camera:IrradiancePitch>",
            f"<Camera:VignettingPolynomial2D{key}>{value}</Camera:VignettingPolynomial2D{key}>"
            "<Camera:IrradiancePitch>",
        )
    for key in ("VignettingCenter", "VignettingPolynomial>"):
        text = text.replace(key, f"Other{key}")
    return text


def test_the_vignetting_of_a_rededge_p_has_two_dimensions(tmp_path: Path) -> None:
    """Of shares of the picture's width and height: its real numbers are 1 in the middle alone."""
    radiance = lit(panel_scene()[0])
    rows, columns = radiance.shape[1:]
    row, column = np.indices((rows, columns))
    powers = np.array(REDEDGE_P["Name"].split(","), int).reshape(-1, 2)
    falloff = sum(
        float(k) * (column / columns) ** a * (row / rows) ** b
        for k, (a, b) in zip(REDEDGE_P[""].split(","), powers, strict=True)
    )
    assert falloff[rows // 2, columns // 2] == pytest.approx(1.0, abs=1e-3)
    assert falloff[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(0.47, abs=0.015)
    # The files' counts are those of a camera with a vignetting of the distance.
    flat = eqx.tree_at(lambda lens: lens.vignetting, camera(), jnp.zeros(6))
    radial = np.asarray(camera().response((rows, columns)) / flat.response((rows, columns)))
    paths = write_rededge(
        tmp_path, "IMG_0001", radiance * falloff / radial, change=_with_two_dimensions
    )
    np.testing.assert_allclose(
        read_capture("IMG_0001", paths).radiance(), radiance, atol=0.06 / 0.45
    )
    paths = write_rededge(
        tmp_path, "IMG_0002", radiance,
        change=lambda text: _with_two_dimensions(text).replace("4,0,4,1,5,0", "4,0,4,1,5,-1"),
    )  # fmt: skip
    with pytest.raises(InputError, match="powers of column and row as 'VignettingPolynomial2DN"):
        read_band(paths[0])


def test_files_that_are_no_raw_picture(tmp_path: Path) -> None:
    from PIL import Image

    from fynjax.app.io.raster import write_geotiff

    product = tmp_path / "A_1.tif"
    write_geotiff(product, np.ones((2, 4, 4)), ["a", "b"], pixel_m=1.0)
    with pytest.raises(InputError, match=r"2 of float32\. Is it a product"):
        read_band(product)
    preview = tmp_path / "B_1.tif"
    Image.fromarray(np.ones((4, 4), np.uint8)).save(preview)
    with pytest.raises(InputError, match="12 or 16 bits, but this has 8"):
        read_band(preview)
    broken = tmp_path / "C_1.tif"
    broken.write_bytes(preview.read_bytes()[:20])
    with pytest.raises(InputError, match="cannot be read as a raw picture"):
        read_band(broken)


def test_captures_by_their_files(tmp_path: Path) -> None:
    radiance = lit(panel_scene()[0])
    first = write_rededge(tmp_path, "IMG_0001", radiance)
    second = write_rededge(tmp_path, "IMG_0002", radiance)
    (tmp_path / "notes.txt").write_text("x")
    found = find_captures([tmp_path])
    assert found == {"IMG_0001": first, "IMG_0002": second}
    assert same_capture("IMG_0002", found) == ("IMG_0002", second)
    assert same_capture(first[2], {}) == ("IMG_0001", first)
    assert find_captures([second[1]]) == {"IMG_0002": [second[1]]}
    with pytest.raises(InputError, match=r"'IMG_0003'\. Did you mean 'IMG_000\d'"):
        same_capture("IMG_0003", found)
    with pytest.raises(InputError, match="no such file"):
        find_captures([tmp_path / "IMG_0001_9.tif"])
    with pytest.raises(InputError, match=r"called NAME_1\.tif"):
        find_captures([tmp_path / "notes.txt"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="this folder has none"):
        find_captures([tmp_path / "empty"])
    with pytest.raises(InputError, match=r"one capture, but this is of id of IMG_0002 \(2026"):
        read_capture("IMG_0001", [first[0], second[1]])
    with pytest.raises(InputError, match="different bands, but got Blue, Blue"):
        read_capture("IMG_0001", [first[0], first[0]])
    again = tmp_path / "again"
    again.mkdir()
    write_rededge(again, "IMG_0001", radiance)
    with pytest.raises(InputError, match=r"band \d is there more than once"):
        find_captures([tmp_path, again])


@pytest.mark.parametrize("turn", [0.0, 27.0])
def test_a_panel_is_found(turn: float) -> None:
    """Upright and turned, under noise and a slope of light; never on even ground alone."""
    scene, corners = panel_scene()
    scene = ndimage.rotate(scene, turn, reshape=False, order=1, mode="nearest")
    slope = 1.0 + 0.1 * np.linspace(-1, 1, scene.shape[1])
    noise = 1.0 + 0.02 * np.random.default_rng(0).standard_normal(scene.shape)
    found = find_panel(100.0 * scene * slope * noise)
    assert found is not None
    angle = np.radians(turn)
    middle = (np.array(scene.shape[::-1]) - 1) / 2
    offset = corners[0].mean(axis=0) - 0.5 - middle
    there = (
        middle
        + 0.5
        + [
            np.cos(angle) * offset[0] + np.sin(angle) * offset[1],
            -np.sin(angle) * offset[0] + np.cos(angle) * offset[1],
        ]
    )
    np.testing.assert_allclose(found.mean(axis=0), there, atol=1.0)
    sides = np.hypot(*(found - np.roll(found, 1, axis=0)).T)
    # Three quarters of the panel without its edge, which smoothing takes for two pixels or three.
    assert np.all((sides > 0.6 * 30.0) & (sides < 0.76 * 30.0))
    texture = np.random.default_rng(1).uniform(0.5, 1.5, (120, 160))
    assert find_panel(texture) is None


def test_reading_a_panel(tmp_path: Path) -> None:
    scene, corners = panel_scene((0.5, 0.2))
    capture = read_capture("P", write_rededge(tmp_path, "P", lit(scene)))
    seen = read_panel(capture)
    assert seen.found == "found in the picture"
    np.testing.assert_allclose(seen.mean, 0.5 * IRRADIANCE / np.pi, rtol=1e-3)
    given = read_panel(capture, corners[1])
    assert (given.found, given.count) == ("given", (900,) * 3)
    np.testing.assert_allclose(given.mean, 0.2 * IRRADIANCE / np.pi, rtol=1e-3)
    with pytest.raises(InputError, match=r"even panel, but in band Blue its pixels spread by \d+"):
        read_panel(capture, corners[0] + 10.0)
    with pytest.raises(InputError, match="must lie in the image"):
        read_panel(capture, corners[0] + 500.0)
    bright = read_capture("Q", write_rededge(tmp_path, "Q", lit(scene, 3.0)))
    with pytest.raises(InputError, match="saturated in band Blue: 100 % of its"):
        read_panel(bright)
    none = read_capture("R", write_rededge(tmp_path, "R", lit(panel_scene(())[0])))
    with pytest.raises(InputError, match=r"no even bright square in band Blue\. .*--panel-area"):
        read_panel(none)


def test_a_panel_that_the_camera_read_itself(tmp_path: Path) -> None:
    scene, corners = panel_scene()
    area = ",".join(f"{v:.0f}" for v in corners[0].ravel())
    more = f"<Camera:Albedo>0.49</Camera:Albedo><Camera:ReflectArea>{area}</Camera:ReflectArea>"
    capture = read_capture("P", write_rededge(tmp_path, "P", lit(scene), more=more))
    np.testing.assert_array_equal(panel_reflectance(None, capture), 0.49)
    seen = read_panel(capture)
    assert (seen.found, seen.count) == ("stated by the camera", (900,) * 3)


def test_reflectance_of_a_panel(tmp_path: Path) -> None:
    capture = read_capture("P", write_rededge(tmp_path, "P", lit(panel_scene()[0])))
    np.testing.assert_array_equal(panel_reflectance("0.5", capture), 0.5)
    np.testing.assert_array_equal(panel_reflectance("0.5,0.4, 0.3", capture), [0.5, 0.4, 0.3])
    table = tmp_path / "panel.csv"
    table.write_text("band,reflectance\nnir,0.6\nblue,0.51\nred,0.52\ngreen,0.5\n")
    np.testing.assert_array_equal(panel_reflectance(str(table), capture), [0.51, 0.52, 0.6])
    spectrum = tmp_path / "spectrum.csv"
    rows = "\n".join(f"{w},{0.2 + w / 4000}" for w in range(400, 951, 5))
    spectrum.write_text(f"wavelength_nm,reflectance\n{rows}\n")
    np.testing.assert_allclose(
        panel_reflectance(str(spectrum), capture),
        [0.2 + w / 4000 for _, w, _ in BANDS],  # the average of a straight line
        atol=1e-4,
    )
    for given, message in (
        (None, "the pictures do not state it .*--panel-reflectance 0.5,0.5,0.5 in the order Blue"),
        ("50", "In percent"),
        ("0.5,0.4", "or 3 in the order Blue, Red, NIR, but got 2"),
        ("0.5,O.4,0.3", "no such file"),
    ):
        with pytest.raises(InputError, match=message):
            panel_reflectance(given, capture)
    table.write_text("band,reflectance\nblue,0.5\n")
    with pytest.raises(InputError, match="reflectance in band 'Red', but there is only blue"):
        panel_reflectance(str(table), capture)
    table.write_text("reflectance\n0.5\n")
    with pytest.raises(InputError, match="either `band` or `wavelength_nm`"):
        panel_reflectance(str(table), capture)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("band,reflectance\nblue,0.5\nred,0.5\nnir,0.5\nBlue,0.1\n", "each band, but 'blue' has 2"),
        (
            "band,wavelength_nm,reflectance\nblue,,0.5\nred,,0.5\nnir,,0.5\n,475,0.2\n",
            "every one a `wavelength_nm`, but 3 of 4 name a band",
        ),
    ],
)
def test_no_row_of_a_panels_reflectance_is_passed_over(text, message, tmp_path: Path) -> None:
    capture = read_capture("P", write_rededge(tmp_path, "P", lit(panel_scene()[0])))
    table = tmp_path / "panel.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=message):
        panel_reflectance(str(table), capture)


def test_saturated_pixels_are_marked(tmp_path: Path) -> None:
    """With their neighbours where bands were aligned, and wherever the lens is darkest."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    rng = np.random.default_rng(2)
    ground = ndimage.gaussian_filter(rng.uniform(0.0, 1.0, (140, 180)), 2.0)
    ground = 0.1 + 0.2 * (ground - ground.min()) / np.ptp(ground)
    bright = np.zeros(ground.shape, bool)
    bright[20:26, 30:36] = bright[120:126, 160:166] = True
    scene = np.where(bright, 3.0, ground)
    bands = np.stack([scene, ndimage.shift(scene, (3, -4), order=0, mode="nearest"), scene])
    capture = read_capture("S", write_rededge(tmp_path, "S", bands * IRRADIANCE[:, None, None] / 5))
    plain = aligned_radiance(capture, align=False)
    np.testing.assert_array_equal(plain.full[0][::-1], bright)
    aligned = aligned_radiance(capture)
    assert aligned.alignment is not None
    np.testing.assert_allclose(aligned.alignment[1].shift, (4.0, 3.0), atol=0.3)
    # Rows count from below now: the second band moves by 3 up in its file.
    first, second = aligned.full[0], aligned.full[1]
    assert first.sum() == 2 * 8 * 8
    assert (second & first).sum() >= 2 * 6 * 6
    assert second.sum() <= 2 * 10 * 10


def test_the_real_panel(shared_data: Path) -> None:
    """Its maker's picture: a panel of 0.67 beside white paper with print. The light sensor, which
    was tilted, puts it at 0.49 to 0.68."""
    found = find_captures([shared_data / "eco" / "uas_micasense"])
    capture = read_capture("IMG_0000", found["IMG_0000"][2:4])
    assert capture.names == ("Red", "NIR")
    assert capture.bands[0].irradiance_tilt == pytest.approx(10.8, abs=0.1)
    seen = read_panel(capture)
    # The area that the maker's tutorial reads in the NIR is 660..840, 490..670.
    low, high = seen.areas[1].min(axis=0), seen.areas[1].max(axis=0)
    assert np.all(low > (642, 472))
    assert np.all(high < (860, 691))
    assert min(seen.count) > 20_000
    assert np.all(seen.spread < 0.03 * seen.mean)
    light = np.array([band.irradiance for band in capture.bands])
    assert np.all(np.abs(np.pi * seen.mean / light - 0.65) < 0.15)
