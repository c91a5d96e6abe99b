"""Cubes read by blocks of rows, and maps written by blocks."""

import numpy as np
import pytest
import rasterio
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.io.raster import (
    Cube,
    MapWriter,
    open_blocks,
    read_cube,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)

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
    xr.Dataset({"reflectance": (dims, np.nan_to_num(values, nan=-9999.0))}).to_netcdf(path)
    bands = {"wavelengths": ("bands", CENTRE), "fwhm": ("bands", np.full(4, 20.0))}
    bands["good_wavelengths"] = ("bands", [1.0, 1.0, 0.0, 1.0])
    xr.Dataset(bands).to_netcdf(path, mode="a", group="sensor_band_parameters")
    found, _, good = whole(path)
    assert good.tolist() == [True, True, False, True]
    found = np.where(found == -9999.0, np.nan, found)
    assert found == pytest.approx(values, rel=1e-6, nan_ok=True)


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
