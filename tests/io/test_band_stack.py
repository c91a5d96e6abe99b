"""Images of any number of bands: what is known of them, and captures laid on each other."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.enums import ColorInterp
from scipy import ndimage

from fynjax._core.errors import InputError
from fynjax.app.io.raster import read_band_stack, write_geotiff
from fynjax.app.io.raster._align import align_bands
from tests.io.test_probability import CORNER, UTM, frame, raster

VALUES = np.random.default_rng(5).uniform(0.1, 0.5, (4, 20, 30)).astype(np.float32)


def test_names_wavelengths_and_place_come_from_the_file(tmp_path: Path) -> None:
    names, waves = ("Green", "Red", "RE", "NIR"), (560.0, 650.0, 730.0, 860.0)
    path = tmp_path / "i.tif"
    write_geotiff(path, VALUES, names, pixel_m=0.5, wavelengths=waves, origin_m=CORNER, crs=UTM)
    stack = read_band_stack([path])
    np.testing.assert_array_equal(stack.values, VALUES)
    assert stack.names == names
    assert stack.wavelengths == waves
    assert stack.mask.all()
    assert stack.transform == frame(rows=20)
    assert stack.crs is not None
    assert stack.known_as == "Green 560 nm, Red 650 nm, RE 730 nm, NIR 860 nm"
    stated = read_band_stack([path], bands=["a", "650", "c", "nir"])
    assert stated.names == ("a", "650 nm", "c", "nir")
    assert stated.wavelengths == (None, 650.0, None, None)


def test_colours_of_a_picture_are_names(tmp_path: Path) -> None:
    values = (VALUES * 255).astype(np.uint8)
    values[3] = 255
    values[3, :2] = 0
    stack = read_band_stack([raster(tmp_path / "i.tif", values)])
    assert stack.names == ("red", "green", "blue")
    assert stack.values.dtype == np.float32
    assert not stack.mask[:2].any()
    assert stack.mask[2:].all()


def test_near_infrared_is_not_taken_for_a_mask(tmp_path: Path) -> None:
    path = raster(tmp_path / "i.tif", (VALUES * 255).astype(np.uint8))
    with rasterio.open(path) as file:  # so it is called where nobody says otherwise
        assert file.colorinterp[3] == ColorInterp.alpha
    stack = read_band_stack([path])
    assert stack.names == ("band 1", "band 2", "band 3", "band 4")
    np.testing.assert_array_equal(stack.values, (VALUES * 255).astype(np.uint8))


def test_a_pixel_counts_where_every_band_has_data(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[2, 3, 4] = np.nan
    values[1, 5, 6] = -9999.0
    values[:, 7, 8] = 0.0  # the undeclared border of a mosaic
    values[0, 7, 9] = 0.0  # not a border: the other bands have values
    stack = read_band_stack([raster(tmp_path / "i.tif", values, nodata=-9999.0)])
    assert sorted(zip(*np.nonzero(~stack.mask), strict=True)) == [(3, 4), (5, 6), (7, 8)]


def test_a_band_without_data_is_left_out(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[1] = -9999.0
    path = raster(tmp_path / "i.tif", values, nodata=-9999.0)
    with pytest.warns(UserWarning, match="1 of 4 bands .* band 2"):
        stack = read_band_stack([path])
    assert stack.names == ("band 1", "band 3", "band 4")
    assert stack.mask.all()


def test_a_picture_without_a_place_needs_the_size_of_a_pixel(tmp_path: Path) -> None:
    path = raster(tmp_path / "i.tif", VALUES, crs=None, transform=Affine.identity())
    with pytest.raises(InputError, match="--pixel METRES"):
        read_band_stack([path])
    with pytest.raises(InputError, match="positive"):
        read_band_stack([path], pixel_m=-1.0)
    stack = read_band_stack([path], pixel_m=0.1)
    assert stack.crs is None
    assert (stack.transform.c, stack.transform.f) == (0.0, pytest.approx(2.0))
    np.testing.assert_array_equal(stack.values, VALUES)
    placed = raster(tmp_path / "placed.tif", VALUES)
    with pytest.raises(InputError, match=r"pixels of 0\.5 m. Leave it out"):
        read_band_stack([placed], pixel_m=0.1)


def test_single_band_files_on_the_same_pixels_are_stacked(tmp_path: Path) -> None:
    paths = [raster(tmp_path / f"{k}.tif", band) for k, band in enumerate(VALUES)]
    stack = read_band_stack(paths)
    np.testing.assert_array_equal(stack.values, VALUES)
    assert stack.names == ("band 1", "band 2", "band 3", "band 4")
    assert stack.alignment is None


@pytest.mark.parametrize(
    ("second", "options", "word"),
    [
        (VALUES[0, :10], {}, "30 x 20 pixels"),
        (VALUES[:2], {}, "files of one band each"),
        (VALUES[0], {"crs": "EPSG:32733"}, "same place"),
        (VALUES[0], {"transform": frame(rows=21)}, "same place"),
    ],
)
def test_files_that_do_not_fit(
    second: np.ndarray, options: dict[str, Any], word: str, tmp_path: Path
) -> None:
    first = raster(tmp_path / "a.tif", VALUES[0])
    other = raster(tmp_path / "b.tif", second, **options)
    with pytest.raises(InputError, match=word):
        read_band_stack([first, other])


@pytest.mark.parametrize(
    ("values", "options", "bands", "word"),
    [
        (VALUES, {}, ["red"], "4 bands, but got 1"),
        (VALUES, {}, ["1", "2", "3", "4"], "Is it a band's number"),
        (VALUES * np.nan, {}, None, "without data"),
        (
            VALUES,
            {"crs": "EPSG:4326", "transform": Affine(1e-5, 0, 19, 0, -1e-5, -34)},
            None,
            "deg",
        ),
    ],
)
def test_bad_images(
    values: np.ndarray, options: dict[str, Any], bands: Any, word: str, tmp_path: Path
) -> None:
    path = raster(tmp_path / "i.tif", values, **options)
    with pytest.raises(InputError, match=word):
        read_band_stack([path], bands=bands)


# -- captures -------------------------------------------------------------------------------


def scene(seed: int, size: int = 340) -> np.ndarray:
    """Ground with texture at several scales."""
    rng = np.random.default_rng(seed)
    coarse, fine = (ndimage.gaussian_filter(rng.normal(size=(size, size)), s) for s in (9, 2.5))
    return 5.0 + coarse / coarse.std() + fine / fine.std()


def test_bands_are_laid_on_the_first() -> None:
    """Turned, stretched, shifted, and bright where the other is dark, as plants are in red."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    ground = scene(0)
    y, x = np.mgrid[:240, :300].astype(float)
    turn = np.array([[1.004, 0.006], [-0.006, 0.997]])
    move = np.array([31.3, 12.6])  # rows, columns
    at = np.einsum("ij,jyx->iyx", turn, np.stack([y, x])) + move[:, None, None]
    first = ndimage.map_coordinates(ground, np.stack([y + 22.0, x + 20.0]), order=3)
    other = 30.0 - 2.0 * ndimage.map_coordinates(ground, at, order=3)
    aligned, cut, told = align_bands(np.stack([first, other]))
    np.testing.assert_array_equal(aligned[0], first[cut])
    assert aligned.shape[1] > 215
    assert aligned.shape[2] > 270
    inside = (slice(5, -5), slice(5, -5))
    error = (30.0 - aligned[1][inside]) / 2.0 - aligned[0][inside]
    assert np.sqrt(np.mean(error**2)) < 0.05  # of a texture of 1.4
    assert told[1].residual < 0.2
    assert told[1].match > 0.95
    # Where the first band's middle lies in the other band, by the map above.
    middle = np.array([119.5, 149.5])
    there = np.linalg.solve(turn, middle + np.array([22.0, 20.0]) - move)
    np.testing.assert_allclose(told[1].shift, (middle - there)[::-1], atol=0.15)


def test_bands_of_two_places_are_refused() -> None:
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    with pytest.raises(InputError, match=r"band 2 does not fit .* one capture"):
        align_bands(np.stack([scene(1, 200), scene(2, 200)]))
    with pytest.raises(InputError, match="80 x 80"):
        align_bands(np.stack([scene(1, 60)] * 2))


def test_a_real_capture(shared_data: Path) -> None:
    """Camera metadata name the bands; red and near infrared fall on each other."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    folder = shared_data / "eco" / "uas_micasense"
    stack = read_band_stack([folder / f"IMG_0001_{k}.tif" for k in (3, 4)], pixel_m=0.08)
    assert stack.names == ("Red", "NIR")
    assert stack.wavelengths == (668.0, 840.0)
    # Black pixels of this camera read about 5200 of 65536, which is taken off.
    assert 0.0 <= np.percentile(stack.values, 1) < 2000.0
    assert stack.alignment is not None
    assert stack.alignment[1].residual < 1.0
    assert stack.alignment[1].match > 0.4
    with pytest.raises(InputError, match="one capture"):
        read_band_stack([folder / "IMG_0001_3.tif", folder / "IMG_0000_4.tif"], pixel_m=0.08)
