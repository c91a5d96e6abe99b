"""Cubes whose reflectance stands in a group, and pixels that are no squares."""

from pathlib import Path

import netCDF4
import numpy as np
import pytest
from pyproj import CRS
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.io.raster import open_blocks

SHAPE, COUNT = (5, 6), 4
NM = np.array([450.0, 560.0, 660.0, 860.0])
VALUES = np.linspace(0.02, 0.5, COUNT * SHAPE[0] * SHAPE[1]).reshape(COUNT, *SHAPE)


def axes(group, east=4.0, north=4.0, names=("easting", "northing")) -> None:
    for name, count, start, step in (
        (names[0], SHAPE[1], 262000.0, east), (names[1], SHAPE[0], 6221000.0, -north)
    ):  # fmt: skip
        group.createDimension(name, count)
        values = start + step * (np.arange(count) + 0.5)
        group.createVariable(name, "f8", (name,))[:] = values


def mapping(group, name: str = "transverse_mercator", **more: object) -> None:
    made = group.createVariable(name, "i4")
    made.setncatts({"crs_wkt": CRS.from_epsg(32734).to_wkt(), **more})


def cube(group, name: str = "reflectance", **about: object) -> None:
    """Bands first, as AVIRIS-3 has them."""
    group.createDimension("wavelength", COUNT)
    group.createVariable("wavelength", "f4", ("wavelength",))[:] = NM
    group.createVariable("fwhm", "f4", ("wavelength",))[:] = 8.0
    made = group.createVariable(name, "f4", ("wavelength", "northing", "easting"))
    made.setncatts(about)
    made[:] = VALUES


def read(path: Path) -> tuple[Affine, np.ndarray]:
    with open_blocks(path) as blocks:
        assert blocks.crs is not None
        np.testing.assert_allclose(blocks.wavelength, NM)
        np.testing.assert_allclose(blocks.read(0, SHAPE[0]), VALUES.transpose(1, 2, 0), rtol=1e-6)
        return blocks.transform, blocks.fwhm


@pytest.mark.parametrize("place", ["reflectance", "level2/surface", ""])
@pytest.mark.parametrize("stated", [True, False])
def test_reflectance_is_found_in_the_tree(tmp_path: Path, place: str, stated: bool) -> None:
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        axes(file)
        mapping(file)
        group = file.createGroup(place) if place else file
        cube(group, **({"grid_mapping": "transverse_mercator"} if stated or not place else {}))
    transform, width = read(tmp_path / "a.nc")
    assert transform == Affine(4, 0, 262000, 0, -4, 6221000)
    np.testing.assert_allclose(width, 8.0)


def test_several_or_no_reflectance_is_said_with_what_there_is(tmp_path: Path) -> None:
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        axes(file)
        for name in ("flight1", "flight2"):
            cube(file.createGroup(name))
    with pytest.raises(InputError, match=r"several groups have one: /flight1/reflectance"):
        read(tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "b.nc", "w") as file:
        axes(file)
        cube(file.createGroup("one"), "radiance")
    with pytest.raises(InputError, match=r"of three dimensions one/radiance.*rename it"):
        read(tmp_path / "b.nc")


def test_neon_is_scaled_and_placed_by_its_map_information(tmp_path: Path) -> None:
    with netCDF4.Dataset(tmp_path / "a.h5", "w") as file:
        site = file.createGroup("SITE/Reflectance")
        for name, count in (("y", SHAPE[0]), ("x", SHAPE[1]), ("b", COUNT)):
            file.createDimension(name, count)
        made = site.createVariable("Reflectance_Data", "i2", ("y", "x", "b"))
        made.setncatts({"Scale_Factor": 10000.0, "Data_Ignore_Value": -9999.0})
        stored = np.round(1e4 * VALUES.transpose(1, 2, 0)).astype("i2")
        stored[0, 0] = -9999
        made.set_auto_maskandscale(False)
        made[:] = stored
        spectral = file.createGroup("SITE/Reflectance/Metadata/Spectral_Data")
        spectral.createVariable("Wavelength", "f4", ("b",))[:] = NM
        spectral.createVariable("FWHM", "f4", ("b",))[:] = 5.0
        system = file.createGroup("SITE/Reflectance/Metadata/Coordinate_System")
        info = "UTM, 1.000, 1.000, 262000.0, 6221000.0, 1.0, 1.0, 34, South, WGS-84, units=Meters"
        for name, text in (("Map_Info", info), ("EPSG Code", "32734")):
            system.createVariable(name, str)[...] = text
    with open_blocks(tmp_path / "a.h5") as blocks:
        assert blocks.transform == Affine(1, 0, 262000, 0, -1, 6221000)
        np.testing.assert_allclose(blocks.fwhm, 5.0)
        found = blocks.read(0, SHAPE[0])
    assert np.isnan(found[0, 0]).all()
    np.testing.assert_allclose(found[1:], VALUES.transpose(1, 2, 0)[1:], atol=6e-5)


@pytest.mark.parametrize(("east", "north"), [(4.0, 3.0), (0.5, 2.0)])
def test_pixels_need_not_be_squares(tmp_path: Path, east: float, north: float) -> None:
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        axes(file, east, north)
        mapping(file)
        cube(file, grid_mapping="transverse_mercator")
    assert read(tmp_path / "a.nc")[0] == Affine(east, 0, 262000, 0, -north, 6221000)


def test_a_turned_grid_keeps_its_transform_and_an_uneven_one_is_refused(tmp_path: Path) -> None:
    turned = Affine(3.0, 1.0, 262000.0, 1.5, -2.0, 6221000.0)
    numbers = " ".join(map(str, turned.to_gdal()))
    for with_axes in (True, False):
        with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
            if with_axes:
                axes(file)
            else:
                file.createDimension("northing", SHAPE[0])
                file.createDimension("easting", SHAPE[1])
            mapping(file, GeoTransform=numbers)
            cube(file, grid_mapping="transverse_mercator")
        assert read(tmp_path / "a.nc")[0] == turned
    with netCDF4.Dataset(tmp_path / "b.nc", "w") as file:
        axes(file)
        mapping(file)
        cube(file, grid_mapping="transverse_mercator")
        file["easting"][3:] += 2.0
    with pytest.raises(InputError, match=r"'easting' has steps from 4 to 6"):
        read(tmp_path / "b.nc")


@pytest.mark.parametrize(
    ("file", "transform"),
    [("24_netcdf-cube-pixels-not-square/cube.nc", Affine(4, 0, 262000, 0, -3, 6221000)),
     ("25_aviris3-reflectance-in-group/AV3_like_RFL_ORT.nc", Affine(4, 0, 262000, 0, -4, 6221000))],
)  # fmt: skip
def test_cubes_of_the_field(shared_data: Path, file: str, transform: Affine) -> None:
    with open_blocks(shared_data / "field" / file) as blocks:
        assert blocks.transform == transform
        np.testing.assert_allclose(blocks.wavelength, np.linspace(400, 2400, 21))
