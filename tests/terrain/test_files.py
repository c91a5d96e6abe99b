"""Terrain on disk: where a GIS expects it, and back; rasters that are wrong are refused."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
import trimesh
from rasterio import Affine
from rasterio.crs import CRS

from fynjax._core.errors import InputError
from fynjax.terrain import Terrain, read_terrain, write_mesh, write_terrain
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
    with pytest.raises(InputError, match=r"the band says 'ft'\. State the height unit"):
        read_terrain(path)
    back = read_terrain(path, height_unit="foot")
    np.testing.assert_allclose(back.heights, terrain_of().heights, atol=1e-5)
    steep = raster(tmp_path / "b.tif", HEIGHTS * np.float32(100.0))
    with pytest.raises(InputError, match=r"rises 30\.0 m in each metre"):
        read_terrain(steep)
    np.testing.assert_allclose(read_terrain(steep, height_unit="centimetre").heights, back.heights)


def test_scale_and_offset_of_a_band_are_applied(tmp_path):
    path = raster(tmp_path / "a.tif", np.round(HEIGHTS * 100.0).astype(np.int16))
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (0.01,), (5.0,)
    back = read_terrain(path)
    np.testing.assert_allclose(back.heights, terrain_of().heights + 5.0, atol=0.006)


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
        ({"heights": np.full_like(HEIGHTS, np.nan)}, "all its cells are without data"),
    ],
)
def test_rasters_that_are_wrong(tmp_path, changes, said):
    arguments = {"heights": HEIGHTS, **changes}
    path = raster(tmp_path / "a.tif", **arguments)
    with pytest.raises(InputError, match=said) as caught:
        read_terrain(path)
    assert str(path) in str(caught.value)


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
