"""Terrain on disk: where a GIS expects it, and back; rasters that are wrong are refused."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
import trimesh
from rasterio import Affine
from rasterio.crs import CRS

from fynjax._core.errors import InputError
from fynjax.app.terrain import Terrain, read_terrain, write_mesh, write_terrain
from tests.helpers import write_raster

UTM = CRS.from_epsg(32734)


def plane(x, y):
    return 20.0 + 0.3 * (x - 412300.0) - 0.2 * (y - 6191200.0)


def terrain_of(shape=(6, 9), cell=0.5, origin=(412300.0, 6191200.0)):
    x = origin[0] + (np.arange(shape[1]) + 0.5) * cell
    y = origin[1] + (np.arange(shape[0]) + 0.5) * cell
    heights = plane(x[None, :], y[:, None])
    return Terrain(heights, cell, origin, UTM.to_wkt())


PLACE = Affine(0.5, 0.0, 412300.0, 0.0, -0.5, 6191203.0)


def raster(path, heights, *, crs=UTM, transform=PLACE, **options):
    """A raster of one band, or of several, northern row first."""
    bands = heights.reshape(-1, *heights.shape[-2:])
    return write_raster(path, bands, crs=crs, transform=transform, **options)


HEIGHTS = terrain_of().heights[::-1].astype(np.float32)


def test_geotiff_round_trip_and_a_gis_sees_it_in_place(tmp_path):
    terrain = terrain_of()
    write_terrain(tmp_path / "a.tif", terrain)
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.crs == UTM
        assert tuple(file.bounds) == terrain.bounds
        assert file.transform.e < 0  # north up
        places = [(412300.3, 6191200.2), (412304.3, 6191202.9), (412301.7, 6191201.1)]
        for (x, y), (value,) in zip(places, file.sample(places), strict=True):
            row, column = int((y - 6191200.0) / 0.5), int((x - 412300.0) / 0.5)
            centre = 412300.25 + 0.5 * column, 6191200.25 + 0.5 * row
            assert value == pytest.approx(plane(*centre), abs=1e-5)
        assert file.tags()["unit"] == "m"
    back = read_terrain(tmp_path / "a.tif")
    np.testing.assert_allclose(back.heights, terrain.heights, atol=1e-5)
    assert back.bounds == terrain.bounds
    assert CRS.from_wkt(back.crs) == UTM
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_a_plot_without_a_place_comes_back_so(tmp_path):
    write_terrain(tmp_path / "a.tif", replace(terrain_of(), origin=(0.0, 0.0), crs=None))
    assert read_terrain(tmp_path / "a.tif").crs is None


def test_a_part_of_a_raster_is_read(tmp_path):
    path = raster(tmp_path / "a.tif", HEIGHTS)
    part = read_terrain(path, (412301.0, 6191200.6, 412302.4, 6191202.0))
    assert part.bounds == (412301.0, 6191200.5, 412302.5, 6191202.0)
    np.testing.assert_allclose(part.heights, terrain_of().heights[1:4, 2:5], atol=1e-5)


def test_heights_in_other_units(tmp_path):
    path = raster(tmp_path / "a.tif", HEIGHTS / np.float32(0.3048), unit="ft")
    with pytest.raises(InputError, match=r"band .*'ft'"):
        read_terrain(path)
    back = read_terrain(path, height_unit="foot")
    np.testing.assert_allclose(back.heights, terrain_of().heights, atol=1e-5)
    steep = raster(tmp_path / "b.tif", HEIGHTS * np.float32(100.0))
    with pytest.raises(InputError, match=r"30\.0 m in each metre"):
        read_terrain(steep)
    np.testing.assert_allclose(read_terrain(steep, height_unit="centimetre").heights, back.heights)


def test_scale_and_offset_of_a_band_are_applied(tmp_path):
    path = raster(tmp_path / "a.tif", np.round(HEIGHTS * 100.0).astype(np.int16))
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (0.01,), (5.0,)
    back = read_terrain(path)
    np.testing.assert_allclose(back.heights, terrain_of().heights + 5.0, atol=0.006)


def test_a_scale_of_zero_is_refused(tmp_path):
    path = raster(tmp_path / "a.tif", HEIGHTS)
    with rasterio.open(path, "r+") as file:
        file.scales = (0.0,)
    with pytest.raises(InputError, match="a scale of its values that is not 0"):
        read_terrain(path)


def test_gaps_are_refused_or_filled(tmp_path):
    holes = HEIGHTS.copy()
    holes[1, 2], holes[3:5, 4:6], holes[0, 0] = np.nan, -9999.0, np.nan
    path = raster(tmp_path / "a.tif", holes, nodata=-9999.0)
    with pytest.raises(
        InputError, match=r"6 of 54 cells have none .* first at \(412302.25, 6191200.75\)"
    ):
        read_terrain(path)
    filled = read_terrain(path, fill_gaps=True)
    np.testing.assert_allclose(filled.heights, terrain_of().heights, atol=1e-4)
    beside = read_terrain(path, (412303.0, 6191200.0, 412304.5, 6191203.0))
    assert beside.heights.shape == (6, 3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"crs": None}, "it has no system"),
        ({"crs": CRS.from_epsg(4326)}, "degrees"),
        ({"crs": CRS.from_epsg(2227)}, "us_survey_foot"),
        ({"transform": Affine(0.5, 0.1, 0.0, 0.1, -0.5, 3.0)}, "rotated"),
        ({"transform": Affine(0.5, 0.0, 0.0, 0.0, -0.4, 3.0)}, "square cells"),
        ({"heights": np.stack([HEIGHTS] * 3)}, "it has 3"),
        ({"heights": np.where(HEIGHTS > 20.0, HEIGHTS, np.float32(-9999.0))}, "got -9999"),
        ({"heights": HEIGHTS[:1, :1]}, "at least two rows and columns .* got 1 by 1"),
        ({"heights": np.full_like(HEIGHTS, np.nan)}, "all its cells are without data"),
    ],
)
def test_rasters_that_are_wrong(tmp_path, changes, said):
    arguments = {"heights": HEIGHTS, **changes}
    path = raster(tmp_path / "a.tif", **arguments)
    with pytest.raises(InputError, match=said) as caught:
        read_terrain(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -32.0, -99.0, 255.0])
@pytest.mark.parametrize("smeared", [False, True])
def test_a_value_for_missing_data_that_is_not_declared(tmp_path, value, smeared):
    """An 8 m plane with a corner and a hole without data; also as a warp smears their edges."""
    heights = plane(*np.meshgrid(412300.0 + np.arange(40.0), 6191230.0 - np.arange(30.0)))
    heights += np.random.default_rng(0).normal(0.0, 0.05, heights.shape)
    missing = np.add(*np.meshgrid(np.arange(40), np.arange(30))) < 12
    missing[14:19, 20:27] = True
    heights[missing] = value
    if smeared:
        heights[:, 1:] = np.where(
            missing[:, 1:] & ~missing[:, :-1], 0.4 * heights[:, :-1], heights[:, 1:]
        )
    place = Affine(1.0, 0.0, 412300.0, 0.0, -1.0, 6191230.0)
    path = raster(tmp_path / "a.tif", heights, transform=place)
    with pytest.raises(
        InputError, match=rf"got {value:g} in 1\d\d? cells.*-a_nodata {value:g} a.tif"
    ):
        read_terrain(path)
    other = raster(tmp_path / "b.tif", heights, transform=place, nodata=-9999.0)
    with pytest.warns(UserWarning, match=rf"b\.tif has {value:g} in"):
        read_terrain(other)
    if not smeared:
        right = raster(tmp_path / "c.tif", heights, transform=place, nodata=value)
        beside = (412310.0, 6191200.0, 412340.0, 6191218.0)
        assert np.ptp(read_terrain(right, beside, fill_gaps=True).heights) < 13.0


def test_lakes_cliffs_and_whole_metres_are_ground(tmp_path):
    x, y = np.meshgrid(np.arange(60.0), np.arange(50.0))
    lake = np.maximum(0.2 * np.hypot(x - 30.0, y - 25.0), 2.0)
    cliff = 10.0 + 0.1 * x + np.where(y > 25.0, 8.0, 0.0)
    place = Affine(1.0, 0.0, 412300.0, 0.0, -1.0, 6191230.0)
    for heights in (lake, cliff, np.round(lake), np.round(cliff)):
        back = read_terrain(raster(tmp_path / "a.tif", heights, transform=place))
        np.testing.assert_array_equal(back.heights[::-1], heights)


def test_heights_far_from_the_sea(tmp_path):
    """Fractions of a millimetre survive single precision, and any GIS that adds the offset."""
    high = replace(terrain_of(), heights=terrain_of().heights + 7000.0)
    write_terrain(tmp_path / "a.tif", high)
    assert np.abs(read_terrain(tmp_path / "a.tif").heights - high.heights).max() < 1e-6
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.units == ("m",)
        value = float(file.read(1)[-1, 0]) * file.scales[0] + file.offsets[0]
        assert value == pytest.approx(high.heights[0, 0], abs=1e-6)
    odd = raster(tmp_path / "b.tif", HEIGHTS * np.float32(0.1) + np.float32(20_000.0))
    with pytest.raises(InputError, match=r"b\.tif: .*got 2000\d.* State `height_unit`"):
        read_terrain(odd)
    with pytest.warns(UserWarning, match="no height above the sea"):
        read_terrain(odd, height_unit="metre")
    np.testing.assert_allclose(read_terrain(odd, height_unit="centimetre").heights, 200.0, atol=0.1)


def test_a_band_is_chosen(tmp_path):
    path = raster(tmp_path / "a.tif", np.stack([HEIGHTS + 50.0, HEIGHTS, HEIGHTS * np.nan]))
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (1.0, 0.5, 1.0), (0.0, 3.0, 0.0)
        file.set_band_description(2, "ground")
    back = read_terrain(path, band=2)
    np.testing.assert_allclose(back.heights, 0.5 * terrain_of().heights + 3.0, atol=1e-5)
    for band in (None, 0, 4):
        with pytest.raises(InputError, match=r"a\.tif: .*`band`.*it has 3 \(1, 2 ground, 3\)"):
            read_terrain(path, band=band)


def test_the_user_may_state_the_system(tmp_path):
    path = raster(tmp_path / "a.tif", HEIGHTS, crs=None)
    assert CRS.from_wkt(read_terrain(path, crs="EPSG:32734").crs) == UTM


def test_a_raster_that_does_not_cover_the_plot(tmp_path):
    path = raster(tmp_path / "a.tif", HEIGHTS)
    with pytest.raises(InputError, match=r"covers \(412300.00, 6191200.00\).*plot is \(412299.00"):
        read_terrain(path, (412299.0, 6191200.0, 412302.0, 6191202.0))


def test_files_that_are_no_rasters(tmp_path):
    path = raster(tmp_path / "a.tif", np.tile(HEIGHTS, (40, 40)))
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="cut short"):
        read_terrain(path)
    path.write_text("hello")
    with pytest.raises(InputError, match="cut short, or not a GeoTIFF"):
        read_terrain(path)
    with pytest.raises(InputError, match="no such file"):
        read_terrain(tmp_path / "b.tif")


def test_obj_is_in_the_plots_frame_and_says_where(tmp_path):
    terrain = terrain_of()
    write_mesh(tmp_path / "a.obj", terrain)
    text = (tmp_path / "a.obj").read_text()
    assert text.startswith("# ")
    low = terrain.heights.min()
    assert f"(412300.000, 6191200.000, {low:.3f})" in text
    mesh = trimesh.load(tmp_path / "a.obj", process=False)
    assert len(mesh.faces) == 2 * 6 * 9
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z + low, plane(x + 412300.0, y + 6191200.0), atol=1e-4)
    np.testing.assert_allclose(mesh.extents[:2], [4.5, 3.0])
    assert [p.name for p in tmp_path.iterdir()] == ["a.obj"]
