"""`fynjax terrain`: from a file to the files of a terrain."""

import json
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.crs import CRS

from fynjax._core.errors import InputError
from fynjax.app.cli import app
from fynjax.app.jobs import terrain
from fynjax.app.report.figures._terrain import hillshade
from fynjax.app.terrain import Terrain, read_cloud, read_terrain, terrain_from_points, write_terrain
from tests.helpers import assert_valid_summary, write_raster
from tests.terrain.synthetic import CORNER, ground_height, needs_cloth, shrubland
from tests.terrain.test_cloud import write_las


@pytest.fixture(scope="module")
def cloud_file(tmp_path_factory):
    cloud, _ = shrubland(density=20.0)
    path = tmp_path_factory.mktemp("cloud") / "plot.csv"
    points = np.stack([cloud.x, cloud.y, cloud.z], axis=1)
    np.savetxt(path, points, "%.4f", delimiter=",", header="x,y,z", comments="")
    return path


def invoke(*arguments):
    app(args=["terrain", *map(str, arguments)], standalone_mode=False)


def test_command_writes_the_terrain_of_a_cloud(cloud_file, tmp_path, capfd):
    output = tmp_path / "out"
    invoke(cloud_file, "--size", 20, "--cell", 0.5, "--json", "--output", output)
    summary = json.loads(capfd.readouterr().out)
    assert sorted(p.name for p in output.iterdir()) == [
        "canopy_height.qml",
        "canopy_height.tif",
        "ground_distance.qml",
        "ground_distance.tif",
        "report.html",
        "summary.json",
        "terrain.obj",
        "terrain.png",
        "terrain.qml",
        "terrain.tif",
    ]
    assert set(summary["files"]) == {p.name for p in output.iterdir()} - {"summary.json"}
    assert_valid_summary(summary)
    bounds = summary["terrain"]["bounds_m"]
    np.testing.assert_allclose(bounds, np.add([5, 5, 25, 25], [*CORNER, *CORNER]), atol=0.06)
    ground = read_terrain(output / "terrain.tif", crs="EPSG:32734")
    x, y = ground.centres
    error = ground.heights - ground_height(x[None, :], y[:, None])
    assert np.sqrt((error**2).mean()) < 0.05
    assert summary["terrain"]["relief_m"] == pytest.approx(np.ptp(ground.heights), abs=1e-4)
    with rasterio.open(output / "canopy_height.tif") as file:
        canopy = file.read(1)
    assert canopy.shape == ground.heights.shape
    assert 0.0 <= np.nanmin(canopy) <= np.nanmax(canopy) < 2.2
    assert (output / "terrain.png").read_bytes()[:4] == b"\x89PNG"


@pytest.fixture(scope="module")
def labelled_file(tmp_path_factory):
    """Points of which the file says what is ground, 2 m below where a filter would look for it."""
    cloud, ground = shrubland(density=20.0)
    z = np.where(ground, cloud.z - 2.0, cloud.z)
    return written(tmp_path_factory.mktemp("labelled"), cloud.x, cloud.y, z, ground)


def written(folder, x, y, z, ground):
    columns = np.stack([x, y, z, np.where(ground, 2, 5)], axis=1)
    path, names = folder / "plot.csv", "x,y,z,classification"
    np.savetxt(path, columns, "%.4f", delimiter=",", header=names, comments="")
    return path


def test_the_files_own_ground_is_taken_and_said(labelled_file, tmp_path):
    result = terrain(labelled_file, tmp_path, unit="metre", size=20.0, cell=0.5)
    assert result.terrain.ground_by == "labels"
    assert result.terrain.labels_apart_m < 0.1
    assert "the file's own labels" in " ".join(result.headline)
    ground = read_terrain(tmp_path / "terrain.tif", crs="EPSG:32734")
    x, y = ground.centres
    error = ground.heights - ground_height(x[None, :], y[:, None]) + 2.0
    assert np.sqrt((error**2).mean()) < 0.05
    filtered = terrain(labelled_file, tmp_path, unit="metre", size=20.0, cell=0.5, tolerance=0.2)
    assert filtered.terrain.ground_by == "smrf"


def test_ground_and_labels_that_contradict_each_other_are_said(tmp_path):
    cloud, _ = shrubland(density=20.0)
    crowns = cloud.z - ground_height(cloud.x, cloud.y) > 0.8
    path = written(tmp_path, cloud.x, cloud.y, cloud.z, crowns)
    with pytest.warns(UserWarning, match="the file's own ground points lie"):
        result = terrain(path, tmp_path, unit="metre", size=20.0, cell=0.5, method="smrf")
    assert result.terrain.ground_by == "smrf"
    rough = pytest.warns(UserWarning, match="the ground scatters by")
    with rough, pytest.warns(UserWarning, match="points lie more than 0.3 m below the ground"):
        terrain(path, tmp_path, unit="metre", size=20.0, cell=0.5)


@needs_cloth
def test_command_with_bounds_units_and_the_cloth(tmp_path, capfd):
    """Trees, as a stiff cloth wants them; in centimetres; stdout holds the summary alone."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 30, 9000), rng.uniform(0, 30, 9000)
    away = np.hypot(x % 10 - 5, y % 10 - 5)
    z = 0.1 * x + np.where(away < 1.5, 4.0, 0.0)
    np.savetxt(tmp_path / "a.xyz", 100.0 * np.stack([x, y, z], axis=1))
    edges = ["--bounds", "5,5,25,25"]
    options = ["--method", "cloth", "--unit", "centimetre", "--json"]
    invoke(tmp_path / "a.xyz", *edges, *options, "--output", tmp_path / "out")
    summary = json.loads(capfd.readouterr().out)
    assert summary["terrain"]["relief_m"] == pytest.approx(1.975, abs=0.02)
    assert summary["terrain"]["canopy_height_99_m"] == pytest.approx(4.0, abs=0.05)


def test_raster_is_cut_out_and_resampled(tmp_path):
    x, y = CORNER[0] + np.arange(60) * 0.5 + 0.25, CORNER[1] + np.arange(60) * 0.5 + 0.25
    whole = Terrain(
        ground_height(x[None, :], y[:, None]), 0.5, CORNER, CRS.from_epsg(32734).to_wkt()
    )
    write_terrain(tmp_path / "dtm.tif", whole)
    summary = terrain(tmp_path / "dtm.tif", tmp_path, size=10.0, cell=0.25)
    assert set(summary.files) == {
        "terrain.tif",
        "terrain.qml",
        "terrain.obj",
        "report.html",
        "terrain.png",
    }
    part = read_terrain(tmp_path / "terrain.tif")
    np.testing.assert_allclose(part.bounds, np.add([10, 10, 20, 20], [*CORNER, *CORNER]))
    x, y = part.centres
    assert np.abs(part.heights - ground_height(x[None, :], y[:, None])).max() < 0.02


def plain_raster(path, heights, cell=1.0):
    transform = Affine(cell, 0.0, CORNER[0], 0.0, -cell, CORNER[1] + cell * heights.shape[0])
    return write_raster(path, heights[None], crs=CRS.from_epsg(32734), transform=transform)


def sloping(rows, columns):
    return 200.0 + 0.1 * np.arange(columns) + 0.05 * np.arange(rows)[:, None]


@pytest.mark.parametrize(("columns", "size"), [(101, 66), (100, 66), (101, 65), (100, 65)])
def test_a_plot_of_a_raster_is_as_large_as_asked(tmp_path, columns, size):
    path = plain_raster(tmp_path / "a.tif", sloping(80, columns))
    summary = terrain(path, tmp_path / "out", size=float(size))
    west, south, east, north = summary.terrain.bounds_m
    assert (east - west, north - south) == (size, size)
    middle = np.array([0.5 * (west + east), 0.5 * (south + north)]) - CORNER
    assert np.abs(middle - [0.5 * columns, 40.0]).max() <= 0.5
    finer = terrain(path, tmp_path / "out", size=12.5, cell=0.5).terrain.bounds_m
    assert finer[2] - finer[0] == 12.5
    with pytest.raises(InputError, match=r"a\.tif: `cell`.*12\.5"):
        terrain(path, tmp_path / "out", size=12.5)


def test_filled_cells_are_counted_and_not_far(tmp_path):
    heights = sloping(20, 60)
    heights[:, 30:41] = np.nan
    path = plain_raster(tmp_path / "a.tif", heights)
    summary = terrain(path, tmp_path / "out", fill_gaps=True)
    assert summary.terrain.cells_filled == pytest.approx(11 / 60)
    assert "18.3 % of the cells had no height" in summary.headline[1]
    assert summary.terrain.interpolated_to_m == 6.0
    with rasterio.open(tmp_path / "out" / "ground_distance.tif") as file:
        far = np.array([*range(1, 7), *range(5, 0, -1)])
        np.testing.assert_array_equal(file.read(1)[:, 30:41], np.tile(far, (20, 1)))
        assert not file.read(1)[:, :30].any()
    with pytest.raises(InputError, match=r"a\.tif: .*within 5 m"):
        terrain(path, tmp_path / "out", fill_gaps=True, largest_gap=5.0)
    heights[:, 11:] = np.nan
    path = plain_raster(tmp_path / "b.tif", heights)
    with pytest.raises(InputError, match="within 10 m"):
        terrain(path, tmp_path / "out", fill_gaps=True)
    with pytest.warns(UserWarning, match="78 %"):
        terrain(path, tmp_path / "out", fill_gaps=True, largest_gap=60.0)


def test_ground_under_a_closed_stand_is_mapped_as_interpolated(tmp_path):
    """No point of the file's own ground lies within 3 m of the middle of a plot of 20 m."""
    x, y = np.meshgrid(np.arange(0.125, 20.0, 0.25), np.arange(0.125, 20.0, 0.25))
    far = np.hypot(x - 10.0, y - 10.0)
    high, ground = np.where(far < 3.0, 2.0, 0.0), far >= 3.0
    heights = (100.0 + 0.02 * x + high).ravel()
    off = 0.03  # of points from the middle of their cells
    path = written(tmp_path, x.ravel() + off, y.ravel(), heights, ground.ravel())
    result = terrain(path, tmp_path / "out", bounds=(0.0, 0.0, 20.0, 20.0), cell=0.25)
    assert result.terrain.cells_with_ground == pytest.approx(ground.mean())
    assert result.terrain.interpolated_to_m == pytest.approx(3.0, abs=0.2)
    with rasterio.open(tmp_path / "out" / "ground_distance.tif") as file:
        found = file.read(1)[::-1]
    assert not found[ground].any()
    np.testing.assert_allclose(found[~ground], 3.0 - far[~ground], atol=0.25)
    coarser = read_cloud(path)
    whole = terrain_from_points(coarser, ground.ravel(), bounds=(0.0, 0.0, 20.0, 20.0))
    half = whole.resample(0.5, (2.0, 4.0, 18.0, 16.0)).gap
    np.testing.assert_array_equal(half, whole.gap[17:65:2, 9:73:2])


def test_rough_ground_is_warned_of(tmp_path):
    """A layer of plants whose lowest points are no surface."""
    rng = np.random.default_rng(3)
    points = rng.uniform([0.0, 0.0, 0.35], [12.0, 12.0, 1.5], (40_000, 3))
    np.savetxt(tmp_path / "a.xyz", points)
    with pytest.warns(UserWarning, match="no points on the ground"):
        terrain(tmp_path / "a.xyz", tmp_path, unit="metre")


def test_what_does_not_go_together(cloud_file, tmp_path):
    with pytest.raises(InputError, match="`bounds` or `size`"):
        terrain(cloud_file, tmp_path, size=3.0, bounds=(0.0, 0.0, 1.0, 1.0))
    with pytest.raises(InputError, match="`size`"):
        terrain(cloud_file, tmp_path, size=-3.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("a.tif", {"method": "smrf"}, "`method` is for point clouds"),
        ("a.tif", {"tolerance": 0.2}, "`tolerance` is for point clouds"),
        ("a.tif", {"slope": 0.2}, "`slope` is for point clouds"),
        ("a.tif", {"window": 3.0}, "`window` is for point clouds"),
        ("a.tif", {"unit": "foot"}, "`unit` is for point clouds"),
        ("a.tif", {"largest_gap": 3.0}, r"`largest_gap` is for .*\(`fill_gaps`\)"),
        ("a.las", {"fill_gaps": True}, "`fill_gaps` is for rasters"),
        ("a.las", {"band": 1}, "`band` is for rasters"),
        ("a.las", {"method": "cloth", "window": 2.0}, "`window` is for the method 'smrf'"),
        ("a.las", {"method": "labels", "slope": 0.2}, "`slope` is for the method 'smrf'"),
        ("a.las", {"method": "labels", "tolerance": 0.2}, "`tolerance` is for methods that"),
        ("a.tif", {"tolerance": -1.0}, "`tolerance`.* -1"),
        ("a.tif", {"largest_gap": -3.0}, "`largest_gap`.* -3"),
        ("a.las", {"cell": 0.0}, "`cell`.* 0"),
        ("a.las", {"bounds": (1.0, 0.0, 0.0, 1.0)}, "`bounds`"),
    ],
)
def test_settings_that_do_nothing_or_are_out_of_range(tmp_path, name, settings, message):
    """Before the file is looked for."""
    with pytest.raises(InputError, match=message):
        terrain(tmp_path / name, tmp_path, **settings)


def test_a_failed_command_writes_nothing_and_names_its_options(cloud_file, tmp_path):
    for options, message in {
        ("--size", 42): r"plot\.csv: .*412300\.0.*412294\.0",
        ("--window", 100): r"plot\.csv: `--window`",
        ("--largest-gap", -3): "`--largest-gap`",
        ("--cell", 0.3, "--size", 20): r"plot\.csv: `--cell`",
        ("--bounds", "0,0,5,5"): r"plot\.csv: the cloud covers",
        ("--cell", 40): r"plot\.csv: .*two cells",
    }.items():
        with pytest.raises(InputError, match=message):
            invoke(cloud_file, *options, "--output", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_ground_around_the_plot_is_used(tmp_path):
    """Hedges along its edges, on a hilltop that no plane through the middle would continue."""
    x, y = np.random.default_rng(4).uniform(0.0, 30.0, (2, 18_000))

    def height(x, y):
        return -0.01 * ((x - 15.0) ** 2 + (y - 15.0) ** 2)

    hedge = (np.maximum(np.abs(x - 15.0), np.abs(y - 15.0)) > 4.0) & (
        np.maximum(np.abs(x - 15.0), np.abs(y - 15.0)) < 6.0
    )
    z = height(x, y) + np.where(hedge, 1.5, 0.0)
    np.savetxt(tmp_path / "a.xyz", np.stack([x, y, z], axis=1), "%.4f")
    terrain(tmp_path / "a.xyz", tmp_path, size=10.0, unit="metre")
    ground = read_terrain(tmp_path / "terrain.tif")
    x, y = ground.centres
    error = ground.heights - height(x[None, :], y[:, None])
    assert np.abs(error).max() < 0.08


def test_shade_is_lamberts_cosine():
    """A slope that faces the sun is fully lit, and one that faces away by its angle less."""
    x = np.arange(6.0)
    tan = np.tan(np.radians(30.0))
    falls_west = Terrain(np.broadcast_to(tan * x, (4, 6)), 1.0)
    lit = hillshade(falls_west, sun_zenith=30.0, sun_azimuth=270.0)
    np.testing.assert_allclose(lit, 1.0)
    away = hillshade(falls_west, sun_zenith=30.0, sun_azimuth=90.0)
    np.testing.assert_allclose(away, np.cos(np.radians(60.0)))
    falls_south = Terrain(np.broadcast_to(tan * x[:4, None], (4, 6)), 1.0)
    np.testing.assert_allclose(hillshade(falls_south, sun_zenith=30.0, sun_azimuth=180.0), 1.0)


def test_a_cloud_that_does_not_say_where_it_lies_keeps_its_coordinates(tmp_path):
    cloud, _ = shrubland(density=20.0)
    points = np.stack([cloud.x, cloud.y, cloud.z], axis=1)
    las = write_las(tmp_path / "a.laz", points)[0]
    las.write(tmp_path / "a.laz")
    place = pytest.warns(UserWarning, match=r"a.laz: no coordinate reference system .* --crs")
    with place, pytest.warns(UserWarning, match=r"a.laz: the file states no unit.* --unit foot"):
        terrain(tmp_path / "a.laz", tmp_path / "out", size=10.0, cell=0.5)
    west, south, _, _ = cloud.bounds
    for name in ("terrain.tif", "canopy_height.tif"):
        with rasterio.open(tmp_path / "out" / name) as file:
            assert "unknown reference system" in file.crs.to_wkt()
            np.testing.assert_allclose(file.bounds[:2], (west + 10, south + 10), atol=0.6)
    ground = read_terrain(tmp_path / "out" / "terrain.tif")
    assert ground.crs is None
    terrain(tmp_path / "a.laz", tmp_path / "known", size=10.0, cell=0.5, crs="EPSG:32734")


def _cloud_of(folder: Path, ground: float, stray: bool = False) -> Path:
    """Trees without ground beneath on ground of a slope [m m-1], as text."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.0, 40.0, (2, 30_000))
    tree = np.hypot(x - 20.0, y - 20.0) < 9.0
    z = np.where(tree, rng.uniform(3.0, 12.0, x.size), rng.normal(0.0, 0.02, x.size)) + ground * x
    points = np.stack([x, y, z], axis=1)
    if stray:
        points = np.concatenate([points, [[9000.0, 20.0, 0.0]]])
    path = folder / "cloud.xyz"
    np.savetxt(path, points, fmt="%.3f")
    return path


def test_heights_above_the_ground_are_doubted(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        terrain(_cloud_of(tmp_path, 0.0), tmp_path / "out", cell=1.0, window=4.0)
    assert any("above its ground already" in str(one.message) for one in said)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        terrain(_cloud_of(tmp_path, 0.1), tmp_path / "out", cell=1.0, window=4.0)
    assert not any("above its ground already" in str(one.message) for one in said)


def test_a_point_far_from_all_others_is_left_out(tmp_path: Path) -> None:
    path = _cloud_of(tmp_path, 0.1, stray=True)
    with pytest.warns(UserWarning, match=r"1 of 30001 points lie far from all others.*9000\.0, 20"):
        cloud = read_cloud(path)
    assert len(cloud) == 30_000
    assert cloud.bounds[2] <= 40.0


def test_heights_cut_off_above_the_ground_are_doubted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform([[0.0], [0.0], [0.0]], [[20.0], [20.0], [2.5]], (3, 20_000))
    rough = rng.normal(0.0, 0.03, x.size)
    for ground, said in ((z, "sharply at 0.5 m"), (1.1 + rough - rough.min(), ""), (0 * z + 1, "")):
        kept = z > 0.5
        heights = np.where(z > 1.5, z, ground)[kept]
        np.savetxt(tmp_path / "plot.xyz", np.stack([x[kept], y[kept], heights], axis=1), "%.3f")
        with pytest.warns(UserWarning, match=said) if said else nullcontext():
            read_cloud(tmp_path / "plot.xyz")


def test_a_cloud_that_was_normalised_gets_a_warning(tmp_path):
    x, y, chance = np.random.default_rng(0).random((3, 20000))
    points = np.stack([20 * x, 20 * y, np.where(chance < 0.5, 3 * chance, 0.0)], axis=1)
    np.savetxt(tmp_path / "plot.xyz", points, "%.3f")
    with pytest.warns(UserWarning, match="begin at 0.*shape of the ground is lost"):
        terrain(tmp_path / "plot.xyz", tmp_path / "out", cell=0.5, unit="metre")
