"""Real clouds with labelled ground, and real shrubs whose heights were published.

Not in the project: Topography (lidR, GPL-3), MixedEucaNat (lidRtutorial), laspy's test files, and
photogrammetric height rasters of willow plots (Cunliffe et al. 2020).
"""

import csv
import warnings

import numpy as np
import pytest
import rasterio

from fynjax._core.errors import InputError
from fynjax.app.jobs import terrain
from fynjax.app.terrain import (
    PointCloud,
    Terrain,
    canopy_height,
    find_ground,
    read_cloud,
    read_terrain,
    terrain_from_points,
)


def error_at_held_out_ground(cloud, cell, method):
    """Terrain from nine tenths of the points, minus the labelled ground in the last tenth [m]."""
    labelled = np.isin(cloud.classification, (2, 9))
    held = labelled & (np.random.default_rng(0).random(len(cloud)) < 0.1)
    used = cloud.select(~held)
    found = find_ground(used, method)
    terrain = terrain_from_points(used, found, cell=cell, largest_gap=60.0)
    rest = cloud.select(held).crop(terrain.bounds)
    error = terrain.height_at(rest.x, rest.y) - rest.z
    truth = labelled[~held]
    lost = (truth & ~found).sum() / truth.sum()
    kept = (found & ~truth).sum() / (~truth).sum()
    return error, lost, kept


@pytest.mark.parametrize(
    ("name", "cell", "most_lost", "most_kept", "most_rmse"),
    [
        # 22 points m-2, trees over pasture and a cutting with banks; measured 0.14, 0.001, 0.13.
        ("MixedEucaNat_crop60.laz", 0.25, 0.2, 0.01, 0.16),
        # 0.9 points m-2, forest between lakes, labels on a ninth of the points; 0.04, 0.15, 0.15.
        ("Topography.laz", 1.0, 0.1, 0.2, 0.2),
    ],
)
def test_ground_against_labelled_ground(shared_data, name, cell, most_lost, most_kept, most_rmse):
    cloud = read_cloud(shared_data / "eco" / "lidar" / name)
    floor, _, _ = error_at_held_out_ground(cloud, cell, "labels")
    error, lost, kept = error_at_held_out_ground(cloud, cell, "smrf")
    assert lost < most_lost
    assert kept < most_kept
    assert abs(np.median(error)) < 0.03
    rmse, least = (np.sqrt((e**2).mean()) for e in (error, floor))
    assert rmse < most_rmse
    assert rmse < 1.5 * least  # nearly as good as with the labels themselves


def test_systems_of_real_clouds(shared_data):
    folder = shared_data / "eco" / "lidar"
    codes = {
        "MixedEucaNat_crop60.laz": 31983,
        "Topography.laz": 2949,
        "fullwave.laz": 32723,
        "vegetation_1_3.las": None,
    }
    for name, code in codes.items():
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "vegetation_1_3.las lies at -81458 m")
            cloud = read_cloud(folder / name)
        found = None if cloud.crs is None else rasterio.crs.CRS.from_wkt(cloud.crs).to_epsg()
        assert found == code, name
    assert len(read_cloud(folder / "Topography.laz")) == 73403


def test_a_patch_without_ground_is_said(shared_data, tmp_path):
    path = shared_data / "eco" / "lidar" / "vegetation_1_3.las"
    with pytest.warns(UserWarning, match="-81458 m"):
        cloud = read_cloud(path)
    with pytest.raises(InputError, match=r"class 2 .*0 of 10683"):
        find_ground(cloud, "labels")
    with (
        pytest.warns(UserWarning, match="no coordinate reference system is known"),
        pytest.warns(UserWarning, match="no height above the sea"),
        pytest.warns(UserWarning, match="4 % of the plot's cells"),
        pytest.warns(UserWarning, match="may have no points on the ground"),
    ):
        summary = terrain(path, tmp_path, cell=0.5, unit="metre")
    # What the command wrote it reads, to fractions of a millimetre 81 km below the sea.
    with pytest.warns(UserWarning, match=r"terrain\.tif lies at -81459 m"):
        back = read_terrain(tmp_path / "terrain.tif")
    assert back.heights.min() == pytest.approx(summary.terrain.lowest_m, abs=1e-6)
    assert back.relief == pytest.approx(summary.terrain.relief_m, abs=1e-6)


def shrub_plots(folder):
    """Plot, points of the highest and lowest height above ground in each 1 cm cell."""
    for path in sorted(folder.glob("*_HAG.tif")):
        with rasterio.open(path) as file:
            bands, transform = file.read([1, 2]), file.transform
        row, column = np.nonzero(bands[1] > -9000.0)
        x = transform.c + (column + 0.5) * transform.a
        y = transform.f + (row + 0.5) * transform.e
        yield path.stem.split("_")[3], x, y, bands[0][row, column], bands[1][row, column]


def slope_below(x, y):
    return 12.0 + 0.1 * (x - 582000.0) - 0.05 * (y - 7719500.0)


def test_heights_of_real_shrubs_on_a_slope(shared_data):
    """Published plot means of the highest point in each cell; our tiles have a margin more."""
    folder = shared_data / "eco" / "sfm_shrub"
    with (folder / "main_database.csv").open(encoding="utf-8-sig", newline="") as file:
        table = csv.DictReader(file)
        published = {r["PlotID"]: float(r["HAG_plotmean_of_cellmax_m"]) for r in table}
    ours, theirs = [], []
    for name, x, y, _, high in shrub_plots(folder):
        west, south = np.floor(x.min() * 100) / 100, np.floor(y.min() * 100) / 100
        columns, rows = (int(np.ceil(np.ptp(v) / 0.01)) + 2 for v in (x, y))
        cx = west + (np.arange(columns) + 0.5) * 0.01
        cy = south + (np.arange(rows) + 0.5) * 0.01
        terrain = Terrain(slope_below(cx[None, :], cy[:, None]), 0.01, (west, south))
        canopy = canopy_height(PointCloud(x, y, slope_below(x, y) + high), terrain)
        assert np.isfinite(canopy).sum() >= 0.9 * len(x)
        ours.append(np.nanmean(canopy))
        theirs.append(published[name])
    assert len(ours) >= 20
    difference = np.subtract(ours, theirs)
    assert np.abs(np.median(difference)) < 0.003
    assert np.abs(difference).max() < 0.015


def test_a_band_of_a_real_raster_is_chosen(shared_data):
    path = shared_data / "eco" / "sfm_shrub" / "20160725_AC_ORC_P01_HAG.tif"
    with pytest.raises(InputError, match=r"6 \(1 min, 2 max, .* 6 stdev\)"):
        read_terrain(path)
    with rasterio.open(path) as file:
        whole, inside = file.read(2), file.transform @ (20, 20)
        west, north = inside
        part = read_terrain(path, (west, north - 0.2, west + 0.2, north), band=2)
    np.testing.assert_allclose(part.heights[::-1], whole[20:40, 20:40])


def test_ground_below_real_shrubs(shared_data):
    """Where a twentieth of a plot is open, the slope below is found within centimetres."""
    seen = 0
    for _, x, y, low, high in shrub_plots(shared_data / "eco" / "sfm_shrub"):
        px, py, above = np.tile(x, 2), np.tile(y, 2), np.concatenate([low, high])
        if (above < 0.03).mean() < 0.05:
            continue
        seen += 1
        cloud = PointCloud(px, py, slope_below(px, py) + above)
        found = find_ground(cloud, cell=0.1, window=0.3, tolerance=0.03)
        with warnings.catch_warnings():
            # Shrubs stand at the edges, and the tiles are turned against the cells.
            warnings.filterwarnings("ignore", ".* of the plot's cells lie outside")
            terrain = terrain_from_points(cloud, found, cell=0.05)
        cx, cy = terrain.centres
        error = terrain.heights - slope_below(cx[None, :], cy[:, None])
        assert np.sqrt((error**2).mean()) < 0.05
    assert seen >= 2
