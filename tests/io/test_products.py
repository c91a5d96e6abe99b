"""Image products: what is written is what other readers find, and what is read back."""

import dataclasses
from xml.etree import ElementTree

import numpy as np
import pyproj
import pytest
import rasterio
import spectral
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.io.raster import Cube, write_geotiff, write_qgis_style
from fynjax.app.io.raster._cubes import (
    NODATA,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)
from tests.helpers import read_cube

RECORD = {"source": "fynjax 0", "seed": 3, "note": '{"a": [1, 2]}'}
NAMES = ("blue", "green", "red", "cirrus", "nir")
CENTRES, WIDTHS = (
    np.array([450.5, 560.25, 650.0, 1375.0, 860.0]),
    np.array([20.0, 32, 16, 30, 5.57]),
)


def cube(quantity="reflectance"):
    """Five bands of 3 x 4 pixels of 3 m; band 4 is bad, one pixel of the others has no data."""
    values = np.random.default_rng(0).uniform(0.05, 0.5, (5, 3, 4))
    values[3] = np.nan
    values[:, 0, 1] = np.nan
    good = np.array([True, True, True, False, True])
    return Cube(values, NAMES, CENTRES, WIDTHS, good, 3.0, (0.5, -1.0), quantity)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("products")
    for quantity in ("reflectance", "radiance"):
        write_cube_geotiff(path / f"{quantity}.tif", cube(quantity), RECORD)
        write_cube_envi(path / f"{quantity}.hdr", cube(quantity), RECORD)
    both = {q: cube(q) for q in ("reflectance", "radiance")}
    write_cubes_netcdf(path / "product.nc", both, RECORD)
    return path


def north_first(values):
    return np.where(np.isfinite(values), values, NODATA)[:, ::-1].astype(np.float32)


@pytest.mark.parametrize("file", ["reflectance.tif", "radiance.dat"])
def test_gdal_finds_values_place_and_no_data(folder, file):
    with rasterio.open(folder / file) as found:
        np.testing.assert_array_equal(found.read(), north_first(cube().values))
        assert found.transform.to_gdal() == (0.5, 3.0, 0.0, 8.0, 0.0, -3.0)
        assert found.nodatavals == (NODATA,) * 5
        assert found.descriptions[0].startswith("blue")
        assert found.xy(2, 0) == (2.0, 0.5)  # the pixel in the south-west
        wavelengths = [float(found.tags(n)["wavelength"]) for n in range(1, 6)]
    np.testing.assert_allclose(wavelengths, CENTRES)


def test_geotiff_says_widths_in_both_manners(folder):
    with rasterio.open(folder / "reflectance.tif") as found:
        assert [float(found.tags(n)["fwhm"]) for n in range(1, 6)] == WIDTHS.tolist()
        assert float(found.tags(5, ns="IMAGERY")["FWHM_UM"]) == pytest.approx(0.00557)
        assert float(found.tags(2, ns="IMAGERY")["CENTRAL_WAVELENGTH_UM"]) == 0.56025
        assert found.tags()["seed"] == "3"
        assert found.tags()["units"] == "1"


def test_spy_finds_values_wavelengths_and_bad_bands(folder):
    image = spectral.open_image(str(folder / "radiance.hdr"))
    np.testing.assert_array_equal(
        np.asarray(image.load()), north_first(cube().values).transpose(1, 2, 0)
    )
    assert image.bands.centers == CENTRES.tolist()
    assert image.bands.bandwidths == WIDTHS.tolist()
    assert image.bands.band_unit == "Nanometers"
    header = image.metadata
    assert header["interleave"] == "bil"
    assert header["band names"] == list(NAMES)
    assert [int(b) for b in header["bbl"]] == [1, 1, 1, 0, 1]
    assert float(header["data ignore value"]) == NODATA
    assert header["map info"][:7] == ["Arbitrary", "1", "1", "0.5", "8", "3", "3"]
    assert header["data units"] == "W m-2 sr-1 um-1"
    assert header["fynjax seed"] == "3"
    assert not list(folder.glob(".*"))  # nothing is left of the writing


def test_xarray_finds_units_coordinates_and_no_data(folder):
    with xr.open_dataset(folder / "product.nc") as data:
        assert data.radiance.attrs["units"] == "W m-2 sr-1 um-1"
        assert data.reflectance.attrs["standard_name"] == "surface_bidirectional_reflectance"
        np.testing.assert_allclose(data.reflectance, cube().values, rtol=1e-6)
        np.testing.assert_allclose(data.x, [2.0, 5.0, 8.0, 11.0])
        np.testing.assert_allclose(data.y, [0.5, 3.5, 6.5])
        np.testing.assert_allclose(data.wavelength, CENTRES)
        np.testing.assert_allclose(data.fwhm, WIDTHS)
        assert data.wavelength.attrs["units"] == data.fwhm.attrs["units"] == "nm"
        assert data.reflectance_good.values.tolist() == [1, 1, 1, 0, 1]
        assert data.attrs["Conventions"].startswith("CF-")
        assert data.attrs["seed"] == 3


@pytest.mark.parametrize("file", ["radiance.tif", "radiance.hdr", "radiance.dat"])
def test_what_was_written_is_read_back(folder, file):
    found, truth = read_cube(folder / file), cube("radiance")
    np.testing.assert_allclose(found.values, truth.values, rtol=1e-6)
    for name in ("wavelength", "fwhm", "good", "pixel_m", "origin_m"):
        np.testing.assert_allclose(getattr(found, name), getattr(truth, name))
    assert found.names == NAMES
    assert found.quantity == "radiance"


def copy_of(folder, tmp_path, old="", new=""):
    text = (folder / "reflectance.hdr").read_text()
    assert old in text
    (tmp_path / "a.hdr").write_text(text.replace(old, new))
    (tmp_path / "a.dat").write_bytes((folder / "reflectance.dat").read_bytes())
    return tmp_path / "a.hdr"


SLIPS = [
    ("wavelength units = Nanometers", "wavelength units = Furlongs", "the unit is 'furlongs'"),
    ("450.5 , ", "4505e4 , ", r"one is 4.505e\+07"),
    ("450.5 , ", "0.4505 , 0.5 , ", "expected 5 values, one for each band, but got 6"),
    ("bbl = { 1 , ", "bbl = { yes , ", "expected lists of numbers"),
    ("lines   = 3", "lines = three", "samples, lines, bands and data type.*three"),
    ("samples = 4", "samples = 0", "cannot be read as an image .*samples"),
    ("lines   = 3", "lines = 30", "cut short: .* needs 2400 bytes"),
    ("ENVI\n", "GIF\n", "starts with the word ENVI"),
    ("bands   = 5\n", "", "samples, lines, bands and data type.*'bands'"),
]


@pytest.mark.parametrize(("old", "new", "words"), SLIPS)
def test_a_corrupt_envi_file_is_explained(folder, tmp_path, old, new, words):
    path = copy_of(folder, tmp_path, old, new)
    with pytest.raises(InputError, match=words) as caught:
        read_cube(path)
    assert caught.value.file.stem == "a"


def test_lost_halves_of_an_envi_file_are_named(folder, tmp_path):
    path = copy_of(folder, tmp_path)
    path.with_suffix(".dat").unlink()
    with pytest.raises(InputError, match=r"data file .* missing"):
        read_cube(path)
    with pytest.raises(InputError, match="no such file"):
        read_cube(tmp_path / "nothing.tif")


def test_wavelengths_in_micrometres_become_nanometres(folder, tmp_path):
    path = copy_of(folder, tmp_path, "Nanometers", "Micrometers")
    text = path.read_text()
    for line in text.splitlines():
        if line.startswith(("wavelength =", "fwhm =")):
            numbers = [float(v) / 1000 for v in line.split("{")[1].strip(" }").split(",")]
            text = text.replace(line, f"{line.split('=')[0]}= {{ {', '.join(map(str, numbers))} }}")
    path.write_text(text)
    found = read_cube(path)
    np.testing.assert_allclose(found.wavelength, CENTRES)
    np.testing.assert_allclose(found.fwhm, WIDTHS)


def test_a_real_emit_cube_is_read_as_spy_reads_it(shared_data):
    path = shared_data / "eco" / "satellite" / "emit20250324t221005_jpl_unmix_ex.hdr"
    found, spy = read_cube(path), spectral.open_image(str(path))
    assert found.values.shape == (285, 10, 10)
    np.testing.assert_allclose(found.wavelength, spy.bands.centers, rtol=1e-6)
    np.testing.assert_allclose(found.fwhm, spy.bands.bandwidths, rtol=1e-6)
    truth = np.asarray(spy.load()).transpose(2, 0, 1)[:, ::-1]
    np.testing.assert_allclose(found.values, np.where(truth == -9999, np.nan, truth), rtol=1e-6)
    assert found.good.sum() == sum(int(float(b)) for b in spy.metadata["bbl"])


UTM, ALBERS = "EPSG:32734", "ESRI:102022"  # Africa, equal areas
WEB, SWISS = "EPSG:3857", "EPSG:2056"  # CF has no name, and not all words, for these


@pytest.mark.parametrize("system", [UTM, ALBERS, WEB, SWISS])
def test_a_place_on_earth_is_found_by_every_reader(tmp_path, system):
    placed = dataclasses.replace(
        cube(), origin_m=(600000.5, 6180001.0), crs=rasterio.CRS.from_user_input(system).to_wkt()
    )
    write_cube_geotiff(tmp_path / "a.tif", placed, RECORD)
    write_cube_envi(tmp_path / "b.hdr", placed, RECORD)
    write_cubes_netcdf(tmp_path / "c.nc", {"reflectance": placed}, RECORD)
    for name in ("a.tif", "b.dat"):
        with rasterio.open(tmp_path / name) as found:
            # ESRI's words for a system lose its number, not what it is.
            assert found.crs.to_dict() == rasterio.CRS.from_user_input(system).to_dict()
            assert found.transform.to_gdal() == (600000.5, 3.0, 0.0, 6180010.0, 0.0, -3.0)
    with xr.open_dataset(tmp_path / "c.nc", decode_coords="all") as data:
        np.testing.assert_allclose(data.x[:2], [600002.0, 600005.0])
        assert pyproj.CRS.from_cf(data.crs.attrs) == pyproj.CRS.from_user_input(system)
    for name in ("a.tif", "b.hdr"):
        found = read_cube(tmp_path / name)
        assert pyproj.CRS.from_wkt(found.crs).equals(
            pyproj.CRS.from_user_input(system), ignore_axis_order=True
        )
        assert found.origin_m == (600000.5, 6180001.0)


def test_qgis_shows_infrared_red_green_stretched_and_single_bands_as_a_ramp(folder, tmp_path):
    style = ElementTree.parse(write_qgis_style(folder / "reflectance.tif")).getroot()
    renderer = style.find("pipe/rasterrenderer")
    assert style.tag == "qgis"
    assert [renderer.get(f"{c}Band") for c in ("red", "green", "blue")] == ["5", "3", "2"]
    infrared = cube().values[4]
    ends = np.quantile(infrared[np.isfinite(infrared)], [0.02, 0.98])
    stretch = renderer.find("redContrastEnhancement")
    shown = [float(stretch.find(end).text) for end in ("minValue", "maxValue")]
    np.testing.assert_allclose(shown, ends, rtol=1e-5)

    write_geotiff(tmp_path / "height.tif", np.arange(12.0).reshape(1, 3, 4), ["z"], pixel_m=1.0)
    style = ElementTree.parse(write_qgis_style(tmp_path / "height.tif")).getroot()
    assert style.find("pipe/rasterrenderer").get("type") == "singlebandpseudocolor"
    values = [float(item.get("value")) for item in style.iter("item")]
    assert values == sorted(values)
    np.testing.assert_allclose([values[0], values[-1]], [0.22, 10.78])
