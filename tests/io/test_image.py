"""Images as programs write them: a file for each band, other units of length, other scales."""

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.compare import read_drone_image
from fynjax.app.io.raster import open_image, open_raster, read_band_stack
from fynjax.canopy import band_word
from fynjax.metrics import BANDS
from tests.helpers import write_raster

LEVELS = {"green": 0.064, "red": 0.042, "red_edge": 0.158, "nir": 0.301}
FOOT, US_FOOT = 0.3048, 1200.0 / 3937.0


def picture(band: str, rows: int = 40, columns: int = 30) -> np.ndarray:
    """One band, all pixels different, [row, column]."""
    return LEVELS[band] * np.linspace(0.8, 1.2, rows * columns).reshape(rows, columns)


def write_bands(folder, names: dict[str, str], **changes):  # type: ignore[no-untyped-def]
    """A file for each band, by the name it is to have."""
    place = Affine(0.05, 0, 412300.0, 0, -0.05, 6191200.0)
    for band, name in names.items():
        values = picture(band)[None].astype(np.float32)
        options = {"transform": place, "crs": "EPSG:32734"} | changes.get(band, {})
        write_raster(folder / name, values, **options)
    return folder / next(iter(names.values()))


@pytest.mark.parametrize(
    "names",
    [
        {b: f"survey_transparent_reflectance_{b.replace('_', ' ')}.tif" for b in BANDS},
        {b: f"survey_index_{b}.TIF" for b in BANDS},
        dict(zip(BANDS, ("result_Green.tif", "result_Red.tif", "result_RedEdge.tif",
                         "result_NIR.tif"), strict=True)),
        dict(zip(BANDS, ("a-G.tif", "a-R.tif", "a-RE.tif", "a-NIR.tif"), strict=True)),
    ],
)  # fmt: skip
def test_single_band_maps_are_one_image(names, tmp_path):
    write_bands(tmp_path, names)
    stranger = {"transform": Affine(2, 0, 0, 0, -2, 9)}
    write_bands(tmp_path, {"red": "another_red.tif"}, red=stranger)
    write_bands(tmp_path, {"nir": "0_nir.tif"}, nir=stranger)
    for name in names.values():
        image = read_drone_image(tmp_path / name)
        assert (image.chosen_by, image.pixel_m) == ("names", pytest.approx(0.05))
        for band, values in zip(BANDS, image.values, strict=True):
            np.testing.assert_allclose(values, picture(band)[::-1], rtol=1e-6)
    stack = read_band_stack([tmp_path / next(iter(names.values()))])
    for name, values in zip(stack.names, stack.values, strict=True):
        np.testing.assert_allclose(values, picture(name)[::-1], rtol=1e-6)


def test_single_band_maps_of_other_types_of_numbers(tmp_path):
    write_bands(tmp_path, {b: f"map_{b}.tif" for b in BANDS})
    scaled = np.round(picture("nir")[None] * 1e4).astype(np.uint16)
    place = Affine(0.05, 0, 412300.0, 0, -0.05, 6191200.0)
    write_raster(
        tmp_path / "map_nir.tif", scaled, transform=place, crs="EPSG:32734", scale=1e-4, nodata=0
    )
    image = read_drone_image(tmp_path / "map_red.tif")
    for band, values in zip(BANDS, image.values, strict=True):
        np.testing.assert_allclose(values, picture(band)[::-1], atol=6e-5)


def test_single_band_maps_keep_scale_and_missing_data(tmp_path):
    scale = {"scale": 1e-4, "nodata": -10000.0}
    names = {band: f"m_{band}.tif" for band in BANDS}
    path = write_bands(tmp_path, names, nir=scale)
    with rasterio.open(tmp_path / names["nir"], "r+") as file:
        values = file.read(1)
        values[:] = 3000.0
        values[3, 4] = -10000.0
        file.write(values, 1)
    image = read_drone_image(path)
    assert not image.mask[::-1][3, 4]
    assert image.mask.sum() == image.mask.size - 1
    np.testing.assert_allclose(image.pixels[3], 0.30, rtol=1e-6)


def test_single_band_maps_that_do_not_lie_together_are_refused(tmp_path):
    names = {band: f"m_{band}.tif" for band in BANDS}
    path = write_bands(tmp_path, names, red={"crs": "EPSG:32735"})
    with pytest.raises(InputError, match=r"m_red\.tif: expected the pixels .* of m_green\.tif"):
        read_drone_image(path)
    (tmp_path / "m_red.tif").unlink()
    with pytest.raises(InputError, match="no single band is known as red"):
        read_drone_image(path)


def test_a_file_of_several_bands_or_of_no_band_stands_alone(tmp_path):
    write_bands(tmp_path, {band: f"m_{band}.tif" for band in BANDS})
    for name, bands in (("m_blue.tif", 2), ("cover_of_shrubs.tif", 1)):
        values = np.stack([picture("nir")] * bands)
        write_raster(tmp_path / name, values, transform=Affine(1, 0, 9, 0, -1, 9))
        with open_image(tmp_path / name, "an image") as file:
            assert file.dataset.count == bands


def test_pix4d_maps_of_a_real_naming(shared_data):
    folder = shared_data / "field" / "09_metashape-32768-and-pix4d-single-band"
    image = read_drone_image(folder / "proj_transparent_reflectance_red_edge.tif")
    for band, values in zip(BANDS, image.values, strict=True):
        with open_raster(folder / f"proj_transparent_reflectance_{band}.tif", "a map") as file:
            alone = file.read().values[0]
        assert np.nanmean(values) == pytest.approx(np.nanmean(alone), rel=1e-6)


@pytest.mark.parametrize(
    ("crs", "unit", "corner"),
    [("EPSG:2227", US_FOOT, (6e6, 2e6)), ("EPSG:2222", FOOT, (7e5, 1e6)),
     ("EPSG:32734", 1.0, (4e5, 6.2e6)), ('LOCAL_CS["site",UNIT["foot",0.3048]]', FOOT, (9.0, 9.0))],
)  # fmt: skip
def test_a_pixel_on_the_ground_is_in_metres_whatever_the_system(crs, unit, corner, tmp_path):
    side = 0.05 / unit
    for name, place in (
        ("up", Affine(side, 0, corner[0], 0, -side, corner[1])),
        ("turned", Affine.translation(*corner) @ Affine.rotation(20.0) @ Affine.scale(side, -side)),
    ):
        values = np.stack([picture(band) for band in BANDS])
        path = write_raster(tmp_path / f"{name}.tif", values, transform=place, crs=crs)
        image = read_drone_image(path, bands=BANDS)
        assert image.pixel_m == pytest.approx(0.05, rel=1e-9)


def test_an_image_in_degrees_is_refused_with_its_zone(shared_data, tmp_path):
    folder = shared_data / "field" / "10_ortho-in-degrees-and-feet"
    assert read_drone_image(folder / "ortho_2227_ft.tif").pixel_m == pytest.approx(0.05, rel=1e-5)
    with pytest.raises(InputError, match=r"in degrees.*EPSG:32734 .*ortho_4326\.tif"):
        read_drone_image(folder / "ortho_4326.tif")
    values = np.stack([picture(band) for band in BANDS])
    for corner, zone in (((9.9, 53.5), 32632), ((-122.4, 37.7), 32610), ((179.9, -40.0), 32760)):
        place = Affine(5e-7, 0, corner[0], 0, -5e-7, corner[1])
        path = write_raster(tmp_path / f"{zone}.tif", values, transform=place, crs="EPSG:4326")
        with pytest.raises(InputError, match=f"EPSG:{zone}"):
            read_drone_image(path, bands=BANDS)


def test_lengths_of_a_map_for_the_web_are_those_of_the_ground(tmp_path):
    values = np.stack([picture(band) for band in BANDS])
    place = Affine(0.05 / np.cos(np.radians(53.0)), 0, 1.1e6, 0, -0.05 / np.cos(np.radians(53.0)),
                   6974871.0)  # fmt: skip
    path = write_raster(tmp_path / "web.tif", values, transform=place, crs="EPSG:3857")
    # A sphere stands for the ellipsoid there, which is 0.3 % longer from south to north.
    assert read_drone_image(path, bands=BANDS).pixel_m == pytest.approx(0.05, rel=4e-3)
    with pytest.raises(InputError, match=r"1\.6\d times as long .*EPSG:32632"):
        read_band_stack([path], bands=BANDS)


def test_reflectance_in_another_scale_is_refused(shared_data, tmp_path):
    folder = shared_data / "field" / "08_odm-ortho-M3M-alpha-nan"
    with pytest.raises(InputError, match=r"brightest band is 1\.5\d*e-05: no ground is so dark"):
        read_drone_image(folder / "odm_tiny_values.tif")
    with pytest.raises(InputError, match="brightest in near infrared, then in the red edge"):
        read_drone_image(folder / "odm_unnamed.tif")
    values = np.stack([picture(band) for band in BANDS])
    place = Affine(0.05, 0, 100.0, 0, -0.05, 200.0)
    for factor, words in ((1e-5, "divided twice"), (1e-2, "divided twice"), (100.0, "percent"),
                          (1e4, "-scale 0.0001"), (32768.0, "3.05176e-05")):  # fmt: skip
        path = write_raster(tmp_path / "x.tif", factor * values, transform=place)
        with pytest.raises(InputError, match=words):
            read_drone_image(path, bands=BANDS)


def test_names_of_bands_in_the_spelling_of_programs():
    for name, word in (
        ("Band 3 (Red)", "red"), ("b4: Red Edge", "red_edge"),
        ("Red edge (717 nm)", "red_edge"), ("NIR-842", "nir"), ("band_nir", "nir"),
        ("Rededge", "red_edge"), ("nir_reflectance", "nir"), ("Green 560.5nm", "green"),
        ("B4", "b4"), ("Band 1", "1"), ("R", "red"), ("Near-Infrared", "nir"), ("LWIR", "lwir"),
    ):  # fmt: skip
        assert band_word(name) == word
