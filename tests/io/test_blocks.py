"""Cubes read by blocks of rows, and maps written by blocks."""

import dataclasses
import os
import re
import shutil

import netCDF4
import numpy as np
import pyproj
import pytest
import rasterio
import xarray as xr
from affine import Affine
from rasterio.crs import CRS

from fynjax._core.errors import InputError
from fynjax.app.compare import read_spectra_sample
from fynjax.app.io.raster import (
    Cube,
    MapWriter,
    content_hash,
    open_blocks,
    open_cube,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)
from fynjax.app.io.raster import _blocks as blocks_module
from fynjax.app.io.raster import _lazy as lazy_module
from fynjax.app.io.raster import _lookup as lookup_module
from fynjax.app.io.raster import _netcdf as netcdf_module
from tests.helpers import read_cube
from tests.io.emit_files import FILL, GEOTRANSFORM, NOWHERE, lookup, write_emit

CENTRE = np.array([480.0, 560.0, 660.0, 860.0])


@pytest.fixture
def cube():
    values = np.random.default_rng(0).uniform(0.05, 0.5, (4, 9, 6))
    values[:, 2] = np.nan  # a stripe without data
    return Cube(
        values=values,
        names=("a", "b", "c", "d"),
        wavelength=CENTRE,
        fwhm=np.full(4, 20.0),
        good=np.array([True, True, False, True]),
        pixel_m=5.0,
        origin_m=(300000.0, 6200000.0),
        crs="EPSG:32734",
    )


def whole(path, rows=4):
    with open_blocks(path) as blocks:
        assert blocks.wavelength == pytest.approx(CENTRE)
        assert blocks.fwhm == pytest.approx(20.0)
        high = blocks.shape[0]
        parts = [blocks.read(start, min(rows, high - start)) for start in range(0, high, rows)]
        return np.concatenate(parts), blocks.transform, blocks.good


@pytest.mark.parametrize("kind", ["hdr", "tif", "nc", "zarr"])
def test_blocks_of_every_format_join_to_the_image(tmp_path, cube, kind):
    path = tmp_path / f"cube.{kind}"
    if kind == "hdr":
        write_cube_envi(path, cube, {})
    elif kind == "tif":
        write_cube_geotiff(path, cube, {})
    else:
        write_cubes_netcdf(tmp_path / "cube.nc", {"reflectance": cube}, {})
        if kind == "zarr":
            pytest.importorskip("zarr")
            with xr.open_dataset(tmp_path / "cube.nc") as data:
                data.drop_encoding().to_zarr(path, zarr_format=2, consolidated=False)
    values, transform, good = whole(path)
    assert values.dtype == np.float32
    assert np.moveaxis(values, 2, 0) == pytest.approx(cube.values[:, ::-1], rel=1e-6, nan_ok=True)
    assert transform @ (0, 9) == pytest.approx((300000.0, 6200000.0))
    assert good.tolist() == ([True] * 4 if kind == "tif" else cube.good.tolist())


def test_blocks_are_what_the_reader_reads(tmp_path, cube):
    write_cube_envi(tmp_path / "cube.hdr", cube, {})
    values, _, _ = whole(tmp_path / "cube.hdr", rows=2)
    read = read_cube(tmp_path / "cube.hdr").values[:, ::-1]
    assert np.moveaxis(values, 2, 0) == pytest.approx(read, rel=1e-6, nan_ok=True)


def test_emit_keeps_its_bands_in_a_group(tmp_path, cube):
    path = tmp_path / "emit.nc"
    values = np.moveaxis(cube.values, 0, 2).astype(np.float32)
    dims = ("downtrack", "crosstrack", "bands")
    fill = {"_FillValue": np.float32(-9999.0)}
    xr.Dataset({"reflectance": (dims, values, {}, fill)}).to_netcdf(path)
    bands = {"wavelengths": ("bands", CENTRE), "fwhm": ("bands", np.full(4, 20.0))}
    bands["good_wavelengths"] = ("bands", [1.0, 1.0, 0.0, 1.0])
    xr.Dataset(bands).to_netcdf(path, mode="a", group="sensor_band_parameters")
    found, _, good = whole(path)
    assert good.tolist() == [True, True, False, True]
    assert found == pytest.approx(values, rel=1e-6, nan_ok=True)


@pytest.mark.parametrize("unit", ["um", "Micrometers", ""])
@pytest.mark.parametrize("kind", ["hdr", "nc"])
def test_wavelengths_in_micrometres_are_known(tmp_path, cube, kind, unit):
    path = tmp_path / f"cube.{kind}"
    if kind == "hdr":
        write_cube_envi(path, cube, {})
        text = path.read_text("utf-8")
        for name in ("wavelength", "fwhm"):
            row = re.search(rf"^{name} = {{(.*?)}}", text, re.M | re.S)
            small = ", ".join(f"{float(v) / 1000.0:g}" for v in row[1].split(","))
            text = text.replace(row[0], f"{name} = {{{small}}}")
        stated = f"wavelength units = {unit}\n" if unit else ""
        path.write_text(re.sub(r"wavelength units = .*\n", stated, text), "utf-8")
    else:
        bands = {
            "reflectance": (("y", "x", "band"), np.moveaxis(cube.values, 0, 2)),
            "wavelength": ("band", CENTRE / 1000.0, {"units": unit} if unit else {}),
            "fwhm": ("band", np.full(4, 0.02)),
        }
        xr.Dataset(bands).to_netcdf(path)
    whole(path)


@pytest.mark.parametrize("kind", ["hdr", "nc"])
def test_a_negative_wavelength_states_that_a_band_has_none(tmp_path, cube, kind):
    path, stated = tmp_path / f"cube.{kind}", [-1.0, 560.0, -9999.0, 860.0]
    if kind == "hdr":
        write_cube_envi(path, cube, {})
        text = path.read_text("utf-8")
        row = "wavelength = {" + ", ".join(map(str, stated)) + "}"
        path.write_text(re.sub(r"^wavelength = {.*?}", row, text, flags=re.M | re.S), "utf-8")
    else:
        values = (("y", "x", "band"), np.moveaxis(cube.values, 0, 2))
        bands = {"reflectance": values, "wavelength": ("band", stated, {"units": "nm"})}
        xr.Dataset(bands).to_netcdf(path)
    with open_blocks(path) as blocks:
        np.testing.assert_array_equal(blocks.wavelength, [np.nan, 560.0, np.nan, 860.0])


def test_wavelengths_in_another_unit_than_stated_are_refused(tmp_path, cube):
    bands = {
        "reflectance": (("y", "x", "band"), np.moveaxis(cube.values, 0, 2)),
        "wavelength": ("band", CENTRE / 1000.0, {"units": "nm"}),
    }
    xr.Dataset(bands).to_netcdf(tmp_path / "cube.nc")
    with pytest.raises(InputError, match="are they µm"), open_blocks(tmp_path / "cube.nc"):
        pass


def test_ten_thousandths_are_told_from_shares_and_from_radiance(tmp_path, cube):
    for factor, scale in ((1.0, 1.0), (1e4, 1e4)):
        scaled = Cube(**{**vars(cube), "values": cube.values * factor})
        write_cube_geotiff(tmp_path / "cube.tif", scaled, {})
        with open_blocks(tmp_path / "cube.tif") as blocks:
            assert blocks.scale() == scale
    write_cube_geotiff(tmp_path / "p.tif", Cube(**{**vars(cube), "values": cube.values * 100}), {})
    with open_blocks(tmp_path / "p.tif") as blocks, pytest.raises(InputError, match="in percent"):
        blocks.scale()


def test_a_damaged_block_is_named(tmp_path):
    path = tmp_path / "cube.tif"
    values = np.random.default_rng(1).uniform(0.05, 0.5, (4, 64, 64)).astype(np.float32)
    profile = {"driver": "GTiff", "count": 4, "height": 64, "width": 64, "dtype": "float32"}
    profile["transform"] = rasterio.Affine(5.0, 0.0, 0.0, 0.0, -5.0, 0.0)
    with rasterio.open(path, "w", **profile, compress="deflate", blockysize=8) as file:
        file.write(values)
    content = bytearray(path.read_bytes())
    half = len(content) // 2
    content[half : half + 500] = bytes(500)
    path.write_bytes(content)
    errors = {}
    with open_blocks(path) as blocks:
        for start in range(0, 64, 8):
            try:
                assert np.isfinite(blocks.read(start, 8)).all()
            except InputError as error:
                errors[start] = str(error)
    assert 1 <= len(errors) <= 2
    for start, text in errors.items():
        assert str(path) in text
        assert f"rows {start + 1} to {start + 8} cannot be read" in text


def test_maps_that_do_not_fit_on_the_disk_end_in_a_line_and_stay_kept(tmp_path, cube):
    resource = pytest.importorskip("resource", reason="Windows has no limits of a file's size")
    write_cube_envi(tmp_path / "cube.hdr", cube, {})
    names, made = [(f"m{i}", "1") for i in range(200)], tmp_path / "maps.tif"
    with open_blocks(tmp_path / "cube.hdr") as blocks:
        writer = MapWriter(tmp_path / "work", "s", names, blocks, 1)
        writer.write(0, 0, np.ones((200, 9, 6)))
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
        try:
            with pytest.raises(InputError, match=r"cannot write the maps .* Is the disk full"):
                writer.finish(made, {})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert not made.exists()
        MapWriter(tmp_path / "work", "s", names, blocks, 1).finish(made, {})
    with rasterio.open(made) as file:
        assert (file.read() == 1.0).all()


def test_maps_go_on_where_they_were_interrupted(tmp_path, cube):
    write_cube_envi(tmp_path / "cube.hdr", cube, {})
    names = [("one", "1"), ("two", "g m-2")]
    with open_blocks(tmp_path / "cube.hdr") as blocks:
        first = MapWriter(tmp_path / "work", "s", names, blocks, 2)
        first.write(1, 5, np.full((2, 4, 6), 2.0), damaged=True)
        again = MapWriter(tmp_path / "work", "s", names, blocks, 2)
        assert again.done.tolist() == [False, True]
        assert again.damaged == {1}
        again.write(0, 0, np.full((2, 5, 6), 1.0))
        again.finish(tmp_path / "maps.tif", {"history": "made"})
        with pytest.raises(InputError, match="of another run"):
            MapWriter(tmp_path / "work", "t", names, blocks, 2)
        again.forget()
    assert not (tmp_path / "work").exists()
    with rasterio.open(tmp_path / "maps.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.descriptions == ("one", "two")
        assert file.units == ("1", "g m-2")
        assert file.crs.to_epsg() == 32734
        assert file.transform @ (0, 9) == pytest.approx((300000.0, 6200000.0))
        assert file.tags()["history"] == "made"
        values = file.read()
    assert (values[:, :5] == 1.0).all()
    assert (values[:, 5:] == 2.0).all()


@pytest.mark.parametrize("kind", ["hdr", "tif", "nc"])
def test_a_cube_as_an_array_of_dask_reads_what_is_asked_for(tmp_path, cube, kind, monkeypatch):
    pytest.importorskip("dask", reason="the extra `map` is not installed")
    path = tmp_path / f"cube.{kind}"
    write = {"hdr": write_cube_envi, "tif": write_cube_geotiff}.get(kind)
    if write is None:
        write_cubes_netcdf(path, {"reflectance": cube}, {})
    else:
        write(path, cube, {})
    began, real = [], lazy_module._read
    monkeypatch.setattr(lazy_module, "_read", lambda *a: (began.append(a[1:3]), real(*a))[1])
    array = open_cube(path, rows=4)
    assert not began
    assert array.dims == ("y", "x", "wavelength")
    part = array.isel(y=slice(0, 3)).sel(wavelength=[560.0, 860.0]).compute()
    assert began == [(0, 4)]
    values, transform, good = whole(path)
    np.testing.assert_array_equal(part, values[:3, :, [1, 3]])
    np.testing.assert_array_equal(array.compute(), values)
    assert array["good"].values.tolist() == good.tolist()
    assert (float(array["x"][2]), float(array["y"][7])) == pytest.approx(transform @ (2.5, 7.5))
    assert array["x"].attrs["standard_name"] == "projection_x_coordinate"
    assert array.rio.crs.to_epsg() == 32734
    with pytest.raises(InputError, match="1 row or more"):
        open_cube(path, rows=0)


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")  # of rioxarray
def test_a_cube_goes_on_in_rioxarray(tmp_path, cube):
    pytest.importorskip("rioxarray", reason="the extra `map` is not installed")
    path = tmp_path / "cube.tif"
    write_cube_geotiff(path, cube, {})
    array = open_cube(path, rows=4).transpose("wavelength", ...)
    with rasterio.open(path) as file:
        west, _, _, north = file.bounds
        side = file.res[0]
        assert array.rio.transform().almost_equals(file.transform)
        disk = file.read(masked=True).filled(np.nan)
    part = array.rio.clip_box(west + side, north - 4 * side, west + 3 * side, north - side)
    np.testing.assert_array_equal(part, disk[:, 1:4, 1:3])
    part.rio.to_raster(tmp_path / "part.tif")
    onto = array.rio.reproject_match(part.isel(x=[0, 1], y=[1, 2]))
    np.testing.assert_array_equal(onto, disk[:, 2:4, 1:3])
    with open_blocks(tmp_path / "part.tif") as again:
        assert again.transform @ (0, 0) == pytest.approx((west + side, north - side))
        np.testing.assert_array_equal(again.read(0, 3), np.moveaxis(disk[:, 1:4, 1:3], 0, 2))


def test_maps_of_a_turned_flight_line_have_two_coordinates_a_pixel(tmp_path, cube, monkeypatch):
    pytest.importorskip("zarr")
    monkeypatch.setattr(blocks_module, "_INNER", 4)  # rows in three parts
    turned = Affine.translation(300000.0, 6200000.0) @ Affine.rotation(20.0) @ Affine.scale(5, -5)
    write_cube_geotiff(tmp_path / "cube.tif", cube, {})
    with rasterio.open(tmp_path / "cube.tif", "r+") as file:
        file.transform = turned
    with open_blocks(tmp_path / "cube.tif") as blocks:
        assert blocks.transform.almost_equals(turned)
        lazy = open_cube(tmp_path / "cube.tif", rows=4)
        assert lazy.dims == ("row", "column", "wavelength")
        place = turned @ (5.5, 3.5)
        pixel = lazy[3, 5]
        assert (float(pixel["x"]), float(pixel["y"])) == pytest.approx(place)
        writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 1)
        values = np.arange(54.0).reshape(1, 9, 6)
        writer.write(0, 0, values)
        writer.finish_zarr(tmp_path / "maps.zarr", {}, {"one": "one"})
    with xr.open_zarr(tmp_path / "maps.zarr", consolidated=False) as maps:
        np.testing.assert_array_equal(maps["one"], values[0])
        assert maps["one"].dims == ("row", "column")
        assert set(maps.coords) == {"x", "y"}
        for row, column in ((0, 0), (3, 5), (8, 2)):
            place = turned @ (column + 0.5, row + 0.5)
            pixel = maps["one"][row, column]
            assert (float(pixel["x"]), float(pixel["y"])) == pytest.approx(place)
            assert pixel["x"].attrs["standard_name"] == "projection_x_coordinate"
        # What reads it by its reference system alone finds the same place.
        reflectance = xr.concat([maps["one"]] * 2, "wavelength").transpose("wavelength", ...)
        kept = reflectance.drop_vars(["x", "y"]).drop_encoding().to_dataset(name="reflectance")
        kept["reflectance"].attrs = {"grid_mapping": "crs"}
        kept.assign(crs=maps["crs"]).to_netcdf(tmp_path / "again.nc")
    with open_blocks(tmp_path / "again.nc") as blocks:
        assert blocks.transform.almost_equals(turned)
        assert "32734" in blocks.crs
    for numbers, right in (
        (list(turned.to_gdal()), True),
        (", ".join(map(str, turned.to_gdal())), True),
        ("1 2 3", False),
        ("a b c d e f", False),
        ("0 0 0 0 0 0", False),
        ("nan 1 0 0 0 1", False),
    ):
        maps["crs"].attrs["GeoTransform"] = numbers
        kept.assign(crs=maps["crs"]).to_netcdf(tmp_path / "again.nc")
        if right:
            with open_blocks(tmp_path / "again.nc") as blocks:
                assert blocks.transform.almost_equals(turned)
            continue
        with (
            pytest.raises(InputError, match="as GeoTransform six numbers"),
            open_blocks(tmp_path / "again.nc"),
        ):
            pass


def emit(tmp_path, cube, **changes):
    path = tmp_path / "emit.nc"
    write_emit(path, np.moveaxis(cube.values, 0, 2), CENTRE, np.full(4, 20.0), **changes)
    return path


@pytest.mark.parametrize("counted", [False, True])
def test_maps_of_a_swath_lie_where_its_lookup_table_says(tmp_path, cube, monkeypatch, counted):
    monkeypatch.setattr(lookup_module, "_AT_ONCE", 26)  # two rows of the map; the first are empty
    path = emit(tmp_path, cube, counted=counted)
    glt_x, glt_y = lookup(9, 6)
    assert len(set(glt_y[glt_y > 0])) == 9  # as the table of a swath is: all of it is on the map
    assert 40 < (glt_x > 0).sum() < glt_x.size - 40
    # Maps tell their pixel: the number of its row and column, from 1.
    row, column = np.mgrid[1:10, 1:7].astype(float)
    swath = np.stack([row, column])
    swath[:, 4, 2] = np.nan  # masked
    names = [("row", "1"), ("column", "g m-2")]
    with open_blocks(path) as blocks:
        np.testing.assert_array_equal(
            blocks.read(0, 9), np.moveaxis(cube.values, 0, 2).astype(np.float32)
        )
        assert (blocks.crs, blocks.transform.is_identity) == (None, True)
        MapWriter(tmp_path / "work", "s", names, blocks, 2).write(1, 5, swath[:, 5:])
    with open_blocks(path) as blocks:
        again = MapWriter(tmp_path / "work", "s", names, blocks, 2)
        assert again.done.tolist() == [False, True]
        again.write(0, 0, swath[:, :5])
        np.testing.assert_array_equal(again.read(), swath)
        again.finish(tmp_path / "maps.tif", {"history": "made"})
        pytest.importorskip("zarr")
        again.finish_zarr(tmp_path / "maps.zarr", {}, {"row": "row", "column": "column"})
        again.forget()
    assert not (tmp_path / "work").exists()
    expected = np.full((2, *glt_x.shape), np.nan)
    for r, c in np.argwhere(glt_x > 0):
        expected[:, r, c] = swath[:, glt_y[r, c] - 1, glt_x[r, c] - 1]
    with rasterio.open(tmp_path / "maps.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.crs.to_epsg() == 4326
        assert file.transform.to_gdal() == pytest.approx(GEOTRANSFORM)
        assert file.descriptions == ("row", "column")
        assert file.units == ("1", "g m-2")
        assert file.tags()["history"] == "made"
        assert np.isnan(file.nodata)
        np.testing.assert_array_equal(file.read(), expected)
        middle = file.xy(3, 2)
    with xr.open_zarr(tmp_path / "maps.zarr", consolidated=False) as same:
        np.testing.assert_array_equal(np.stack([same["row"], same["column"]]), expected)
        for axis, name, unit in (
            ("x", "longitude", "degrees_east"), ("y", "latitude", "degrees_north")
        ):  # fmt: skip
            assert same[axis].attrs["standard_name"] == name
            assert same[axis].attrs["units"] == unit
        assert (same["x"][2], same["y"][3]) == pytest.approx(middle)
        assert same["x"].values == pytest.approx(18.4 + 5.5e-4 * (np.arange(13) + 0.5))
        assert same["y"].values == pytest.approx(-33.9 - 5e-4 * (np.arange(14) + 0.5))
        assert rasterio.crs.CRS.from_wkt(same["crs"].attrs["crs_wkt"]).to_epsg() == 4326


def test_a_lookup_table_may_be_turned(tmp_path, cube):
    pytest.importorskip("zarr")
    numbers = [18.4, 5e-4, 1e-4, -33.9, 2e-4, -5e-4]
    with open_blocks(emit(tmp_path, cube, attributes={"geotransform": numbers})) as blocks:
        writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 1)
        writer.write(0, 0, np.ones((1, 9, 6)))
        writer.finish(tmp_path / "maps.tif", {})
        writer.finish_zarr(tmp_path / "maps.zarr", {}, {"one": "one"})
    turned = Affine.from_gdal(*numbers)
    with rasterio.open(tmp_path / "maps.tif") as file:
        assert file.transform.almost_equals(turned)
    with xr.open_zarr(tmp_path / "maps.zarr", consolidated=False) as maps:
        pixel = maps["one"][3, 5]
        assert (float(pixel["x"]), float(pixel["y"])) == pytest.approx(turned @ (5.5, 3.5))


def changed(value, name="glt_x"):
    """A lookup table with one wrong number, in row 5 and column 6 of the map."""
    table = dict(zip(("glt_x", "glt_y"), lookup(9, 6), strict=True))[name].copy()
    table[4, 5] = value
    return {"location": {name: (("ortho_y", "ortho_x"), table)}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (changed(7), "expected glt_x from 1 to 6, .* is 7 in row 5, column 6 of the map"),
        (changed(-1), "is -1 in row 5"),
        (changed(10, "glt_y"), "expected glt_y from 1 to 9, .* is 10 in row 5"),
        ({"location": {"glt_x": (("ortho_y", "ortho_x"), np.full((14, 13), 1.5))}}, "it is 1.5"),
        ({"location": {"glt_x": None}}, "it has no glt_x"),
        ({"location": {"glt_y": None}}, "it has no glt_y"),
        ({"location": {"glt_y": (("a", "b"), lookup(9, 6)[1][1:])}}, r"\(14, 13\) .* \(13, 13\)"),
        (
            {"location": {n: ("a", np.ones(9, np.int32)) for n in ("glt_x", "glt_y")}},
            "alike in two dimensions",
        ),
        (
            {"location": {n: (("a", "b"), np.ones((300, 300))) for n in ("glt_x", "glt_y")}},
            "about as many as the swath's 9 x 6",
        ),
        ({"location": {"glt_x": (("ortho_y", "ortho_x"), np.full((14, 13), "a"))}}, "as numbers"),
        (
            {"location": {"glt_x": (("ortho_y", "ortho_x"), np.zeros((14, 13), np.int32))}},
            "names no pixel",
        ),
        ({"attributes": {"geotransform": None}}, "it has no geotransform"),
        ({"attributes": {"spatial_ref": None}}, "it has no spatial_ref"),
        ({"attributes": {"spatial_ref": "GEOGCS[nonsense"}}, "coordinate reference system"),
        ({"attributes": {"geotransform": np.array(GEOTRANSFORM[:5])}}, "table six numbers"),
        ({"attributes": {"geotransform": "here"}}, "six numbers .* got here"),
        ({"attributes": {"geotransform": [18.4, 0.0, 0.0, -33.9, 0.0, -5e-4]}}, "place a grid"),
        ({"attributes": {"geotransform": [18.4, 5e-4, 0.0, -339.0, 0.0, -5e-4]}}, "lies nowhere"),
        ({"attributes": {"geotransform": [np.nan, 5e-4, 0.0, -33.9, 0.0, -5e-4]}}, "six"),
    ],
)
def test_a_lookup_table_that_places_nothing_is_refused(
    tmp_path, cube, monkeypatch, changes, message
):
    monkeypatch.setattr(lookup_module, "_AT_ONCE", 26)
    path = emit(tmp_path, cube, **changes)
    with open_blocks(path) as blocks:
        assert blocks.scale() == 1.0  # who asks for no maps may read it
        with pytest.raises(InputError, match=message) as error:
            MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 1)
    assert error.value.file == path
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize("both", [True, False])
def test_a_lookup_table_marks_what_it_has_not_by_0_or_the_fill_value(tmp_path, cube, both):
    """A pixel with a row but no column is on no pixel of the swath."""
    table = lookup(9, 6)
    marked = [np.where(t == 0, FILL, t).astype(np.int32) for t in table]
    dims = ("ortho_y", "ortho_x")
    location = {"glt_y": (dims, np.where(table[1] == 0, 3, table[1]).astype(np.int32))}
    if both:
        location = {n: (dims, m) for n, m in zip(("glt_x", "glt_y"), marked, strict=True)}
    with open_blocks(emit(tmp_path, cube, location=location)) as blocks:
        writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 1)
        writer.write(0, 0, np.ones((1, 9, 6)))
        writer.finish(tmp_path / "maps.tif", {})
    with rasterio.open(tmp_path / "maps.tif") as file:
        np.testing.assert_array_equal(file.read(1) == 1.0, table[0] > 0)


def test_a_lookup_table_that_cannot_be_read_is_named(tmp_path, cube):
    h5py = pytest.importorskip("h5py")
    path = emit(tmp_path, cube)
    with h5py.File(path) as file:
        chunk = file["location/glt_y"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    path.write_bytes(content)
    with open_blocks(path) as blocks, pytest.raises(InputError, match=r"glt_y of its .* damaged"):
        MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 1)


@pytest.mark.parametrize("location", [NOWHERE, {"glt_x": None, "glt_y": None}])
def test_a_swath_without_a_lookup_table_has_rows_and_columns(tmp_path, cube, location):
    with open_blocks(emit(tmp_path, cube, location=location)) as blocks:
        assert blocks.location is None
        writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 1)
        writer.write(0, 0, np.arange(54.0).reshape(1, 9, 6))
        pytest.importorskip("zarr")
        writer.finish_zarr(tmp_path / "maps.zarr", {}, {"one": "one"})
    with xr.open_zarr(tmp_path / "maps.zarr", consolidated=False) as maps:
        np.testing.assert_array_equal(maps["one"], np.arange(54.0).reshape(9, 6))
        assert maps["x"].attrs == {"units": "1", "long_name": "x of the middles of pixels"}


def begun(folder, cube):
    """Maps of which two of three blocks are there."""
    write_cube_geotiff(folder / "cube.tif", cube, {})
    with open_blocks(folder / "cube.tif") as blocks:
        writer = MapWriter(folder / "work", "s", [("one", "1")], blocks, 3)
        for block in (0, 2):
            writer.write(block, 3 * block, np.full((1, 3, 6), block + 1.0), damaged=block == 2)
        return blocks


def test_a_flipped_bit_of_unfinished_maps_is_found(tmp_path, cube):
    blocks = begun(tmp_path, cube)
    contents = {path: path.read_bytes() for path in sorted((tmp_path / "work").iterdir())}
    assert len(contents) == 3
    for path, whole in contents.items():
        mark = path.suffix == ".mark"
        for place in range(0, len(whole), 1 if mark else 7):
            flipped = bytearray(whole)
            flipped[place] ^= 1 << place % 8
            path.write_bytes(flipped)
            try:
                writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 3)
            except InputError:
                assert mark
            else:
                assert not mark
                assert writer.done.sum() == 1  # the other of the two
                assert writer.damaged == ({2} if writer.done[2] else set())
        path.write_bytes(whole)
    writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 3)
    assert (writer.done.tolist(), writer.damaged) == ([True, False, True], {2})
    np.testing.assert_array_equal(writer.read()[0, :, 0], [1.0] * 3 + [np.nan] * 3 + [3.0] * 3)
    writer.forget()
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize("kind", ["hdr", "tif", "nc"])
def test_widths_that_no_band_has_are_refused(tmp_path, cube, kind):
    path = tmp_path / f"cube.{kind}"
    write = {"hdr": write_cube_envi, "tif": write_cube_geotiff}.get(kind)
    wide = dataclasses.replace(cube, fwhm=np.array([20.0, 20.0, 1e7, 20.0]))
    write(path, wide, {}) if write else write_cubes_netcdf(path, {"reflectance": wide}, {})
    with pytest.raises(InputError, match=r"'fwhm': expected .* 0 to 1e\+06 nm, but one is 1e\+07"):
        whole(path)
    if kind == "nc":
        with pytest.raises(InputError, match="'fwhm': expected full widths"):
            read_spectra_sample([path])


def test_impossible_spectra_and_attributes_of_a_netcdf_file_are_named(tmp_path, cube):
    path = tmp_path / "cube.nc"
    values = np.where(np.isnan(cube.values), 0.3, cube.values)
    values[1, 0, 0] = 1e30
    write_cubes_netcdf(path, {"reflectance": dataclasses.replace(cube, values=values)}, {})
    with pytest.warns(UserWarning, match=r"cube.nc: 1 of 216 values are infinite or beyond 1e\+15"):
        sample = read_spectra_sample([path])
    assert (sample.left_out, sample.values.max() < 1.0) == (1, True)
    with netCDF4.Dataset(path, "a") as data:
        data["reflectance"].coordinates = 7.0
    with pytest.raises(InputError, match="cannot be read as NetCDF"):
        read_spectra_sample([path])


def test_a_scale_beyond_what_numbers_hold_leaves_no_data(tmp_path, cube):
    path = tmp_path / "cube.tif"
    write_cube_geotiff(path, cube, {})
    with rasterio.open(path, "r+") as file:
        file.scales = [1e300] * 4
    with open_blocks(path) as blocks, pytest.warns(UserWarning, match="infinite or beyond"):
        assert np.isnan(blocks.read(0, 2)).all()


def test_a_cube_is_known_by_all_of_its_content(tmp_path, cube, monkeypatch):
    pytest.importorskip("zarr")

    def signed(path):
        with open_blocks(path) as blocks:
            return [content_hash(one) for one in blocks.files]

    write_cube_envi(tmp_path / "cube.hdr", cube, {})
    before = signed(tmp_path / "cube.hdr")
    assert before == signed(tmp_path / "cube.dat")
    header = (tmp_path / "cube.hdr").read_text("utf-8")
    (tmp_path / "cube.hdr").write_text(header.replace("480 ", "481 "), "utf-8")
    assert signed(tmp_path / "cube.hdr") != before
    write_cubes_netcdf(tmp_path / "cube.nc", {"reflectance": cube}, {})
    with xr.open_dataset(tmp_path / "cube.nc") as data:
        data.drop_encoding().to_zarr(tmp_path / "cube.zarr", zarr_format=2, consolidated=False)
    chunk = tmp_path / "cube.zarr" / "reflectance" / "0.0.0"
    for large in (1 << 30, 1 << 10):  # also where a file is read in part
        monkeypatch.setattr(netcdf_module, "_SIGNED_WHOLE", large)
        before = signed(tmp_path / "cube.zarr")
        assert before == signed(tmp_path / "cube.zarr")
        whole = chunk.read_bytes()
        chunk.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        assert signed(tmp_path / "cube.zarr") != before
        chunk.write_bytes(whole)


def test_a_large_file_is_known_by_its_size_and_by_samples(tmp_path, monkeypatch):
    monkeypatch.setattr(netcdf_module, "_SIGNED_WHOLE", 1 << 18)
    path = tmp_path / "large"
    whole = bytearray(1 << 20)

    def signed(content):
        path.write_bytes(content)
        os.utime(path, (1, 1))
        return content_hash(path)

    before = signed(whole)
    assert signed(whole) == before
    assert signed(whole + b"\0") != before
    for place in (0, len(whole) // 15, len(whole) - 1):
        changed = whole.copy()
        changed[place] = 1
        assert signed(changed) != before
    path.write_bytes(whole)  # now, not then
    assert content_hash(path) != before


def test_maps_whose_folder_was_removed_meanwhile_end_in_one_line(tmp_path, cube):
    write_cube_geotiff(tmp_path / "cube.tif", cube, {})
    with open_blocks(tmp_path / "cube.tif") as blocks:
        writer = MapWriter(tmp_path / "work", "s", [("one", "1")], blocks, 3)
        shutil.rmtree(tmp_path / "work")
        with pytest.raises(InputError, match=r"removed meanwhile: the same command begins anew"):
            writer.write(0, 0, np.ones((1, 3, 6)))


WAVES = np.linspace(450.0, 2400.0, 7)
SPECTRA = np.random.default_rng(3).uniform(0.05, 0.5, (5, 4, 7)).astype(np.float32)
EAST, NORTH = 262002.0 + 4.0 * np.arange(4), 6220998.0 - 4.0 * np.arange(5)
PLACE = Affine(4.0, 0.0, 262000.0, 0.0, -4.0, 6221000.0)
UTM = pyproj.CRS.from_epsg(32734)
CF = {key: value for key, value in UTM.to_cf().items() if key != "crs_wkt"}


def netcdf_cube(path, values=SPECTRA, **changes):
    """A NetCDF cube over y, x and bands; `changes` of its names, coordinates and attributes."""
    of = {"dims": ("y", "x", "wavelength"), "x": EAST, "y": NORTH, "unit": {}, "wave": "wavelength"}
    of |= {"crs": {"crs_wkt": UTM.to_wkt()}, "order": (0, 1, 2), "attrs": {}, **changes}
    dims, crs = of["dims"], of["crs"]
    stored = tuple(dims[k] for k in of["order"])
    data = xr.Dataset({"reflectance": (stored, values.transpose(of["order"]), of["attrs"])})
    data[dims[0]], data[dims[1]] = (dims[0], of["y"], of["unit"]), (dims[1], of["x"], of["unit"])
    data[of["wave"]] = dims[2], WAVES, {"units": "nm"}
    if crs is not None:
        data["crs"] = (), np.int32(0), crs
        data["reflectance"].attrs["grid_mapping"] = "crs"
    data.to_netcdf(path)
    return path


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"dims": ("y", "x", "nb")},
        {"dims": ("y", "x", "spectral"), "wave": "central_wavelength"},
        {"dims": ("y", "x", "nb"), "order": (2, 0, 1)},
        {"order": (1, 0, 2)},
        {"dims": ("lat", "lon", "n"), "order": (1, 2, 0)},
        {"x": EAST[::-1], "values": SPECTRA[:, ::-1]},
        {"y": NORTH[::-1], "values": SPECTRA[::-1]},
        {"crs": CF},
        {"crs": {"spatial_ref": UTM.to_wkt(), "GeoTransform": "262000 4 0 6221000 0 -4"}},
        {"crs": {"epsg_code": "EPSG:32734"}},
        {"x": EAST / 1000.0, "y": NORTH / 1000.0, "unit": {"units": "km"}},
    ],
)
def test_axes_and_place_of_a_netcdf_cube_go_by_what_it_says(tmp_path, changes):
    with open_blocks(netcdf_cube(tmp_path / "a.nc", **changes)) as blocks:
        np.testing.assert_array_equal(blocks.read(0, 5), SPECTRA)
        assert blocks.wavelength == pytest.approx(WAVES)
        assert blocks.transform.almost_equals(PLACE, 1e-6)
        assert CRS.from_wkt(blocks.crs).to_epsg() == 32734


@pytest.mark.parametrize("crs", [None, {"grid_mapping_name": "latitude_longitude"}])
def test_longitude_and_latitude_need_no_reference_system(tmp_path, crs):
    places = {"x": 18.4 + 4e-5 * np.arange(4), "y": -34.1 - 4e-5 * np.arange(5)}
    path = netcdf_cube(tmp_path / "a.nc", dims=("lat", "lon", "band"), crs=crs, **places)
    with open_blocks(path) as blocks:
        assert CRS.from_wkt(blocks.crs).is_geographic
        assert blocks.transform @ (0.5, 0.5) == pytest.approx((18.4, -34.1), abs=1e-9)


def test_places_that_cannot_be_known_are_told(tmp_path):
    far = netcdf_cube(tmp_path / "a.nc", x=EAST / 1000.0, y=NORTH / 1000.0)
    with pytest.raises(InputError, match="Are they in kilometres"), open_blocks(far):
        pass
    unknown = netcdf_cube(tmp_path / "b.nc", crs=None)
    with pytest.warns(UserWarning, match="no reference system"), open_blocks(unknown) as blocks:
        assert blocks.crs is None


def test_values_out_of_the_valid_range_are_no_data(tmp_path):
    values = SPECTRA.copy()
    values[0, 0, 2], values[1] = 3.0, -5.0
    limits = {"valid_range": np.array([-0.1, 1.5], np.float32)}
    with open_blocks(netcdf_cube(tmp_path / "a.nc", values, attrs=limits)) as blocks:
        missing = np.isnan(blocks.read(0, 5))
    assert np.argwhere(missing).tolist() == np.argwhere((values > 1.5) | (values < 0)).tolist()
    whole = np.rint(1e4 * values).astype(np.int16)
    limits = {"scale_factor": 1e-4, "valid_min": np.int16(-1000), "valid_max": np.int16(15000)}
    with open_blocks(netcdf_cube(tmp_path / "b.nc", whole, attrs=limits)) as blocks:
        np.testing.assert_array_equal(np.isnan(blocks.read(0, 5)), missing)


def geotiff(path, values, kind="float32", tags=(), of_file=(), names=()):
    size = {"height": 5, "width": 4, "count": values.shape[2], "dtype": kind, "crs": "EPSG:32734"}
    with rasterio.open(path, "w", driver="GTiff", transform=PLACE, **size) as file:
        file.write(np.moveaxis(values, 2, 0).astype(kind))
        file.descriptions = names or file.descriptions
        file.update_tags(**dict(of_file))
        for n, of in enumerate(tags, 1):
            file.update_tags(n, **of)
    return path


@pytest.mark.parametrize("mark", [-9999.0, -50.0, -1.0])
@pytest.mark.parametrize("kind", ["tif", "nc"])
def test_one_negative_number_in_all_bands_is_missing_data(tmp_path, kind, mark):
    values = SPECTRA.copy()
    values[:, 0] = mark
    path = tmp_path / f"a.{kind}"
    geotiff(path, values) if kind == "tif" else netcdf_cube(path, values)
    with open_blocks(path) as blocks:
        with pytest.warns(UserWarning, match=f"{mark:g} in all bands"):
            found = blocks.read(0, 5)
        with pytest.warns(UserWarning, match="which the file does not declare"):
            assert blocks.scale() == 1.0
    assert np.isnan(found[:, 0]).all()
    np.testing.assert_array_equal(found[:, 1:], values[:, 1:])


def test_numbers_that_are_no_reflectance_are_refused(tmp_path):
    values = SPECTRA.copy()
    values[:, 0, 3] = -9999.0
    with (
        open_blocks(geotiff(tmp_path / "a.tif", values)) as blocks,
        pytest.raises(InputError, match=r"got -9999.*does not declare"),
    ):
        blocks.scale()
    path = netcdf_cube(tmp_path / "a.nc", -SPECTRA)
    with open_blocks(path) as blocks, pytest.raises(InputError, match="a scale below 0"):
        blocks.scale()
    for path in (
        geotiff(tmp_path / "b.tif", 255.0 * (SPECTRA + 0.5), "uint8"),
        netcdf_cube(tmp_path / "b.nc", (255.0 * (SPECTRA + 0.5)).astype(np.uint8)),
    ):
        with open_blocks(path) as blocks, pytest.raises(InputError, match="in 8 bits"):
            blocks.scale()


@pytest.mark.parametrize(
    "texts",
    [
        {"names": [f"{w:g} nm" for w in WAVES]},
        {"names": [f"{w / 1000.0:.6f} Micrometers" for w in WAVES]},
        {"names": [f"Band {k} ({w:.1f} nm)" for k, w in enumerate(WAVES)]},
        {"names": [f"{w:g}" for w in WAVES]},
        {"of_file": {"wavelength": "{" + ", ".join(f"{w:g}" for w in WAVES) + "}"}},
        {"of_file": {f"Band_{k}": f"{w:.1f} Nanometers" for k, w in enumerate(WAVES, 1)}},
    ],
)
def test_wavelengths_in_names_and_tags_of_a_geotiff(tmp_path, texts):
    with open_blocks(geotiff(tmp_path / "a.tif", SPECTRA, **texts)) as blocks:
        assert blocks.wavelength == pytest.approx(WAVES, abs=0.01)
