"""Drone images as `fynjax validate` reads them: bands, thinning, no data, saturation."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.compare import _images
from fynjax.app.compare._drone import compare_drone_images
from fynjax.app.compare._images import DroneImage, read_drone_image, thinning
from fynjax.app.io.raster import write_geotiff
from fynjax.metrics import BANDS
from fynjax.sensors import BandSet
from tests.helpers import write_raster

BLUE = BandSet(("blue",), (475.0,), (20.0,))
PLACE = Affine(0.05, 0, 100.0, 0, -0.05, 200.0)


def values(rows: int = 30, columns: int = 20) -> np.ndarray:
    """Four bands, all pixels different, [band, row, column] from the north."""
    place = np.arange(rows * columns, dtype=float).reshape(rows, columns) / (rows * columns)
    return np.stack([0.03 + 0.02 * place, 0.04 + 0.01 * place, 0.1 + 0.05 * place, 0.3 + place / 9])


def read(path: Path, **options) -> DroneImage:  # type: ignore[no-untyped-def]
    return read_drone_image(path, **options)


def test_bands_are_found_by_name_wavelength_option_and_order(tmp_path: Path) -> None:
    image = values()
    blue = np.full((1, 30, 20), 0.02)
    mixed = np.concatenate([blue, image[[3, 0, 2, 1]]])[:, ::-1]
    write_geotiff(
        tmp_path / "names.tif", mixed, ["Blue", "NIR", "Green", "Red edge", "Red"], pixel_m=0.05
    )
    write_geotiff(
        tmp_path / "waves.tif", mixed, list("abcde"), pixel_m=0.05,
        wavelengths=[475, 840, 560, 717, 668],
    )  # fmt: skip
    write_raster(tmp_path / "plain.tif", mixed[:, ::-1], transform=PLACE)
    write_raster(tmp_path / "order.tif", image, transform=PLACE)
    for name, how, options in (
        ("names", "names", {}),
        ("waves", "wavelengths", {}),
        ("plain", "option", {"bands": ["x", "nir", "green", "rededge", "red"]}),
        ("order", "order", {}),
    ):
        said = pytest.warns(UserWarning, match="they are taken to be green, red, red_edge, nir")
        with said if how == "order" else nullcontext():
            got = read(tmp_path / f"{name}.tif", camera=BLUE, **options)
        assert got.chosen_by == how
        np.testing.assert_allclose(got.values[:4], image[:, ::-1], rtol=1e-6)
        others = ("blue",) if name in ("names", "waves") else ()
        assert got.bands == (*BANDS, *others)
        assert (got.values[4:] == np.float32(0.02)).all()
        assert got.mask.all()
        assert got.pixel_m == pytest.approx(0.05)
    write_raster(tmp_path / "one_band.tif", image[:1], transform=PLACE)
    for path, options, word in (
        ("one_band.tif", {}, "several files.*gdal_merge"),
        ("plain.tif", {}, "known as green.*--real-bands"),
        ("plain.tif", {"bands": ["red"] * 5}, "green is there 0 times"),
        ("plain.tif", {"bands": ["red", "nir"]}, "names of 5 bands"),
        ("nothing.tif", {}, "no such file"),
    ):
        with pytest.raises(InputError, match=word):
            read(tmp_path / path, **options)


def test_every_band_of_the_camera_that_the_file_has_is_read(tmp_path: Path) -> None:
    """By the camera's name of it or within its width, and no other."""
    image = np.concatenate([values(), np.stack([np.full((30, 20), 0.01 * k) for k in range(1, 5)])])
    names = [*BANDS, "Blue-475", "coastal", "band 7", "thermal"]
    waves = [560, 668, 717, 840, 475, 444, 531, 11000]
    write_geotiff(tmp_path / "a.tif", image, names, pixel_m=0.05, wavelengths=waves)
    camera = BandSet(
        ("green_2", "blue", "coastal", "red", "green", "nir", "red_edge", "yellow"),
        (531.0, 475.0, 450.0, 668.0, 560.0, 842.0, 717.0, 600.0), (14.0,) * 8,
    )  # fmt: skip
    got = read(tmp_path / "a.tif", camera=camera)
    assert got.bands == (*BANDS, "green_2", "blue", "coastal")
    assert got.taken[4:] == ("band 7", "Blue-475", "coastal")
    assert read(tmp_path / "a.tif").bands == BANDS
    np.testing.assert_allclose(got.values[4:, 0, 0], [0.03, 0.01, 0.02])


@pytest.mark.parametrize("names", [
    ["MS_G", "MS_R", "MS_RE", "MS_NIR"], ["GRE", "RED", "REG", "NIR"],
    ["B560", "B650", "B730", "B860"], ["560 nm", "650 nm", "717.5 nm", "842 nm"],
])  # fmt: skip
def test_bands_are_known_by_names_of_other_programs(names, tmp_path: Path) -> None:
    write_geotiff(tmp_path / "a.tif", values()[::-1], names[::-1], pixel_m=0.05)
    got = read(tmp_path / "a.tif")
    np.testing.assert_allclose(got.values, values(), rtol=1e-6)


@pytest.mark.parametrize("crs", [None, "EPSG:32734"])
def test_pixels_in_degrees_are_refused_whatever_the_system(crs, tmp_path: Path) -> None:
    place = Affine(4.5e-7, 0, 19.4, 0, -4.5e-7, -34.4)
    write_raster(tmp_path / "a.tif", values(), transform=place, crs=crs)
    with pytest.raises(InputError, match="are they in degrees"):
        read(tmp_path / "a.tif", bands=BANDS)


def test_near_infrared_darker_than_red_is_doubted(tmp_path: Path) -> None:
    backward = values()[::-1]
    write_raster(tmp_path / "order.tif", backward, transform=PLACE)
    with pytest.raises(InputError, match=r"brightest in near infrared.*--bands nir,red_edge,red,"):
        read(tmp_path / "order.tif")
    got = read(tmp_path / "order.tif", bands=["nir", "red_edge", "red", "green"])
    np.testing.assert_allclose(got.values, values()[:, ::-1], rtol=1e-6)
    for image in (backward, values()[[0, 1, 3, 2]], values()[[3, 1, 2, 0]]):
        write_geotiff(tmp_path / "names.tif", image, list(BANDS), pixel_m=0.05)
        with pytest.warns(UserWarning, match="Are the bands named right"):
            read(tmp_path / "names.tif")


def test_of_two_bands_the_one_nearer_to_the_drone_camera_is_taken(tmp_path, monkeypatch) -> None:
    path, image = tmp_path / "two.tif", values()
    write_geotiff(
        path, image[[0, 1, 2, 2, 3]], list("abcde"), pixel_m=0.05,
        wavelengths=[560, 650, 717, 741, 860],
    )  # fmt: skip
    assert read(path).taken[2] == "741 nm"
    moved = BandSet(BANDS, (560.0, 650.0, 720.0, 860.0), (32.0,) * 4)
    monkeypatch.setattr(_images, "mavic_3m", lambda: moved)
    assert read(path).taken[2] == "717 nm"


def test_a_hole_in_one_band_is_no_data_and_a_shadow_is(tmp_path: Path) -> None:
    image = values()
    image[3, :4] = 0.0  # the mosaic has no near infrared there
    image[3, 4, 2] = 0.0  # its ragged edge
    image[:, 7, 5] = 0.004, 0.0, 0.006, 0.01  # a shadow, red clipped at 0
    image[2, -2:, -9:] = 0.0  # the red edge ends two pixels before the image
    image[1, 7, 8:10] = 0.0  # two leaves without red, by themselves
    path = tmp_path / "a.tif"
    write_geotiff(path, image, list(BANDS), pixel_m=0.05)
    with pytest.warns(UserWarning, match="are 0 in one band and bright in another"):
        got = read(path)
    holes = 4 * image.shape[2] + 1 + 18
    assert (got.without_data, got.not_positive) == (holes, 3)
    assert not got.mask[:4].any()
    assert not got.mask[4, 2]
    assert got.mask[4:].sum() == got.mask[4:].size - 19


def test_scaled_integers_no_data_border_and_saturation(tmp_path: Path) -> None:
    raw = np.round(values() * 10000).astype(np.uint16)
    raw[:, 0, :] = 0  # a border that the file does not declare
    raw[1, 5, 3] = 7777  # declared
    raw[3, 9, 9] = 65535  # the type's largest
    raw[3, 9, 10] = 9000
    raw[0, 12, 12] = 1
    path = write_raster(tmp_path / "a.tif", raw, transform=PLACE, scale=1e-4, nodata=7777)
    got = read(path, bands=BANDS)
    assert (got.without_data, got.saturated, got.not_positive) == (21, 1, 0)
    assert got.mask.sum() == 600 - 22
    assert not got.mask[-1].any()  # y to the north
    np.testing.assert_allclose(got.pixels.max(axis=1)[3], 0.9)
    assert np.isnan(got.values[:, 30 - 1 - 9, 9]).all()
    limited = read(path, bands=BANDS, saturation=0.9)
    assert (limited.saturated, limited.mask.sum()) == (2, 600 - 23)
    assert "2 saturated left out" in limited.description()
    with pytest.raises(InputError, match="none is left"):
        read(path, bands=BANDS, saturation=0.01)
    with pytest.raises(InputError, match=r"gdal_edit\.py -scale 0\.0001"):
        read(write_raster(tmp_path / "b.tif", raw[:, 1:], transform=PLACE), bands=BANDS)


def test_a_large_image_is_thinned_evenly_across_blocks(tmp_path: Path) -> None:
    image = values(1300, 70)
    path = write_raster(tmp_path / "a.tif", image, transform=PLACE)
    whole = read(path, bands=BANDS, most_pixels=10**6)
    np.testing.assert_array_equal(whole.values, image[:, ::-1])
    for most in (91_000, 40_000, 5000, 100):
        got = read(path, bands=BANDS, most_pixels=most)
        step = thinning(1300, 70, most)
        np.testing.assert_array_equal(got.values, image[:, ::step, ::step][:, ::-1])
        assert got.mask.size <= most
        assert step == 1 or -(-1300 // (step - 1)) * -(-70 // (step - 1)) > most
        assert (f"every {step}th row" in got.description()) == (step > 1)


def test_clipped_values_are_told_and_a_missing_system_is_no_matter(tmp_path: Path) -> None:
    image = np.minimum(values(), 0.35)
    path = write_raster(tmp_path / "a.tif", image, transform=Affine(2, 0, 0, 0, -2, 0))
    with pytest.warns(UserWarning, match=r"nir 5\d % at 0.35.*clipped"):
        got = read(path, bands=BANDS)
    assert got.crs is None


def test_numbers_that_are_no_fractions_name_their_scale(tmp_path: Path) -> None:
    for name, scale, kind, words in (
        ("eight", 255, np.uint8, "in 8 bits.*-scale 0.00392157 eight.tif"),
        ("ten", 10000, np.uint16, "-scale 0.0001 ten.tif"),
        ("micasense", 32768, np.uint16, "32768.*-scale 3.05176e-05 micasense.tif"),
        ("percent", 100, np.uint16, "percent.*-scale 0.01 percent.tif"),
    ):
        raw = np.round(values() * scale).astype(kind)
        path = write_raster(tmp_path / f"{name}.tif", raw, transform=PLACE)
        with pytest.raises(InputError, match=words):
            read(path, bands=BANDS)


def test_too_few_pixels_for_distributions_are_told(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "one.tif", values()[:, :1, :1], transform=PLACE)
    with pytest.warns(UserWarning, match=r"one\.tif: 1 pixels are compared, which is too few"):
        one = read(path, bands=BANDS)
    large = read(write_raster(tmp_path / "large.tif", values(), transform=PLACE), bands=BANDS)
    said = " ".join(compare_drone_images(large, one).notes)
    assert "Only 1 pixels of the simulated image" in said


def test_a_pixel_of_an_image_is_as_large_as_its_area(tmp_path: Path) -> None:
    """Cells that are no squares, and those that are rotated."""
    for name, place in (
        ("oblong", Affine(0.05, 0, 100.0, 0, -0.20, 200.0)),
        ("rotated", Affine.rotation(30.0) @ Affine(0.1, 0, 100.0, 0, -0.1, 200.0)),
    ):
        image = read(write_raster(tmp_path / f"{name}.tif", values(), transform=place), bands=BANDS)
        assert image.pixel_m == pytest.approx(0.1)
