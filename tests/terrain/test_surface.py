"""Ground of a plot whose ground is known, and what is made of it."""

import sys

import numpy as np
import pytest

from fynjax._core.errors import InputError, MissingExtraError
from fynjax.app.terrain import (
    PointCloud,
    Terrain,
    canopy_height,
    find_ground,
    heights_above_ground,
    terrain_from_points,
    terrain_mesh,
)
from tests.terrain.synthetic import CORNER, SIDE, ground_height, needs_cloth, shrubland

PLOT = (CORNER[0], CORNER[1], CORNER[0] + SIDE, CORNER[1] + SIDE)


def plane(x, y):
    return 20.0 + 0.3 * x - 0.2 * y


def cloud_of(surface, n=4000, side=20.0, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, side, n), rng.uniform(0.0, side, n)
    return PointCloud(x, y, surface(x, y))


def raster_of(surface, shape=(8, 12), cell=0.5, origin=(3.0, -2.0)):
    x = origin[0] + (np.arange(shape[1]) + 0.5) * cell
    y = origin[1] + (np.arange(shape[0]) + 0.5) * cell
    return Terrain(surface(x[None, :], y[:, None]), cell, origin)


@pytest.fixture(scope="module")
def plot():
    cloud, truth = shrubland()
    return cloud, truth, find_ground(cloud)


def test_filter_on_known_shrubland(plot):
    _, truth, found = plot
    assert 0.4 < truth.mean() < 0.7  # about half of the plot is under shrubs
    assert (truth & ~found).sum() < 0.02 * truth.sum()
    assert (found & ~truth).sum() < 0.04 * (~truth).sum()


def test_terrain_of_known_shrubland_within_centimetres(plot):
    cloud, _, found = plot
    terrain = terrain_from_points(cloud, found, cell=0.25, bounds=PLOT)
    assert terrain.heights.shape == (120, 120)
    x, y = terrain.centres
    error = terrain.heights - ground_height(x[None, :], y[:, None])
    assert abs(np.median(error)) < 0.01
    assert np.sqrt((error**2).mean()) < 0.03  # noise of the points is 0.02
    assert np.quantile(np.abs(error), 0.99) < 0.1


def test_a_hillside_is_filtered_like_a_plain(plot):
    cloud, _, found = plot
    tilt = 0.7 * (cloud.x - CORNER[0])
    steep = find_ground(PointCloud(cloud.x, cloud.y, cloud.z + tilt))
    assert (steep != found).mean() < 0.002


def test_low_points_are_no_ground(plot):
    """Photogrammetry puts single points metres below the ground."""
    cloud, truth, _ = plot
    z = cloud.z.copy()
    low = np.random.default_rng(5).choice(len(z), 60, replace=False)
    z[low] -= 4.0
    found = find_ground(PointCloud(cloud.x, cloud.y, z))
    assert not found[low].any()
    terrain = terrain_from_points(cloud, found & truth, cell=0.25, bounds=PLOT, largest_gap=3.0)
    x, y = terrain.centres
    error = terrain.heights - ground_height(x[None, :], y[:, None])
    assert np.sqrt((error**2).mean()) < 0.04


@needs_cloth
def test_cloth_finds_ground_between_separate_trees(capfd):
    """A stiff cloth needs plants narrower and taller than shrubs: domes of 2 m every 10 m."""
    cloud = cloud_of(plane, n=20_000, side=30.0)
    away = np.hypot(cloud.x % 10.0 - 5.0, cloud.y % 10.0 - 5.0)
    tree = away < 2.0
    z = cloud.z + np.where(tree, 3.0 + np.sqrt(np.maximum(4.0 - away**2, 0.0)), 0.0)
    found = find_ground(PointCloud(cloud.x, cloud.y, z), "cloth", cell=0.5)
    assert not (found & tree).any()
    assert (~found & ~tree).sum() < 0.05 * (~tree).sum()
    assert capfd.readouterr().out == ""  # its own library prints


def test_labels(plot):
    cloud, truth, _ = plot
    np.testing.assert_array_equal(find_ground(cloud, "labels"), truth)
    with pytest.raises(InputError, match="the cloud has none"):
        find_ground(PointCloud(cloud.x, cloud.y, cloud.z), "labels")
    plants = cloud.select(~truth)
    with pytest.raises(InputError, match=r"class 2 .*has 3"):
        find_ground(plants, "labels")


def test_no_ground_is_said(plot):
    cloud, truth, _ = plot
    with pytest.raises(InputError, match=r"0 points .*ground"):
        terrain_from_points(cloud, np.zeros(len(cloud), bool))
    inside = np.hypot(cloud.x - CORNER[0] - 15.0, cloud.y - CORNER[1] - 15.0) < 8.0
    with pytest.raises(InputError, match=r"7\.\d m of \(41231\d"):
        terrain_from_points(cloud, truth & ~inside, largest_gap=5.0)
    west, south = CORNER
    with pytest.raises(
        InputError, match=r"covers .* \(412330\.00, .* but the plot is .*412360\.00"
    ):
        terrain_from_points(cloud, truth, bounds=(west, south, west + 60.0, south + 30.0))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "pmf"}, "'smrf', 'cloth' or 'labels', but is 'pmf'"),
        ({"tolerance": 0.0}, "`tolerance` must be positive"),
        ({"slope": np.nan}, "`slope` must be positive"),
        ({"window": -1.0}, "`window` must be positive"),
        ({"cell": -1.0}, "`cell` must be positive"),
        ({"cell": 20.0}, "wider than three cells"),
        ({"window": 15.0}, r"half of the cloud's diagonal, 14\.1\d m, but is 15 m"),
    ],
)
def test_settings_of_the_filter(options, said):
    with pytest.raises(InputError, match=said):
        find_ground(cloud_of(plane), **options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"cell": 0.0}, "`cell` must be positive"),
        ({"cell": 15.0}, "more than two cells"),
        ({"bounds": (0.0, 0.0, 10.1, 10.0)}, "does not divide 10.1 m along x"),
        ({"bounds": (0.0, 0.0, 10.0, np.nan)}, "`bounds` must be"),
        ({"bounds": (90.0, 90.0, 95.0, 95.0)}, r"the cloud covers \(0\.0.*is \(90\.00, 90\.00\)"),
        ({"bounds": (-0.75, 0.0, 10.0, 10.0)}, r"plot is \(-0\.75, 0\.00\)"),
        ({"bounds": (12.0, 0.0, 20.75, 10.0)}, "the cloud covers"),
        ({"bounds": (0.0, -0.75, 10.0, 10.0)}, "the cloud covers"),
        ({"bounds": (0.0, 12.0, 10.0, 20.75)}, "the cloud covers"),
        ({"largest_gap": 0.0}, "`largest_gap` must be positive"),
        ({"cell": 0.001}, "take larger cells"),
    ],
)
def test_settings_of_the_surface(options, said):
    cloud = cloud_of(plane)
    with pytest.raises(InputError, match=said):
        terrain_from_points(cloud, np.ones(len(cloud), bool), **options)


@pytest.mark.parametrize("missing", ["pysmrf", "startinpy", "CSF"])
def test_without_the_extra_the_command_is_named(monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    cloud = cloud_of(plane)
    needed = {
        "pysmrf": lambda: find_ground(cloud),
        "CSF": lambda: find_ground(cloud, "cloth"),
        "startinpy": lambda: terrain_from_points(cloud, np.ones(len(cloud), bool)),
    }
    with pytest.raises(MissingExtraError, match=r'pip install "fynjax\[terrain\]"'):
        needed[missing]()


def test_a_plane_is_kept_through_gaps_and_at_the_edges():
    """Laplace interpolation is exact on planes, and so are means and what continues them."""
    cloud = cloud_of(plane)
    seen = (np.hypot(cloud.x - 9.0, cloud.y - 11.0) > 4.0) & (cloud.x > 1.0) & (cloud.y < 18.5)
    with pytest.warns(UserWarning, match="3 % of the plot's cells"):
        terrain = terrain_from_points(cloud, seen, cell=0.5, bounds=(0.0, 0.0, 20.0, 20.0))
    x, y = terrain.centres
    np.testing.assert_allclose(terrain.heights, plane(x[None, :], y[:, None]), atol=1e-3)


def test_ground_around_the_plot_holds_its_edges():
    """A bowl, with a point in each square metre: beyond the outer ones a plane would be wrong."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(20.0), np.arange(20.0)))
    cloud = PointCloud(x, y, 0.1 * ((x - 10.0) ** 2 + (y - 10.0) ** 2))
    terrain = terrain_from_points(
        cloud, np.ones(400, bool), cell=0.25, bounds=(5.5, 5.5, 14.5, 14.5)
    )
    cx, cy = terrain.centres
    error = terrain.heights - 0.1 * ((cx[None, :] - 10.0) ** 2 + (cy[:, None] - 10.0) ** 2)
    # A surface through the points lies above the bowl, by 0.1 * 2 * 0.5^2 at most.
    assert error.min() > -1e-6
    assert error.max() <= 0.05 + 1e-6


def test_three_points_in_a_row_give_no_wild_slope():
    cloud = PointCloud(np.array([1.0, 2.0, 3.0]), np.full(3, 1.0), np.array([5.0, 5.1, 5.2]))
    with pytest.warns(UserWarning, match="100 % of the plot's cells"):
        terrain = terrain_from_points(
            cloud, np.ones(3, bool), cell=0.5, bounds=(0.0, 0.0, 4.0, 2.0), largest_gap=3.0
        )
    x, _ = terrain.centres
    np.testing.assert_allclose(terrain.heights, np.broadcast_to(4.9 + 0.1 * x, (4, 8)), atol=1e-9)


def test_points_nearly_in_a_row_give_no_wild_slope_across():
    y = np.array([1.0, 1.0001, 1.0])
    cloud = PointCloud(np.array([1.0, 2.0, 3.0]), y, np.array([5.0, 5.3, 5.0]))
    terrain = terrain_from_points(
        cloud, np.ones(3, bool), cell=0.5, bounds=(0.0, 0.0, 4.0, 2.0), largest_gap=3.0
    )
    assert np.abs(terrain.heights - 5.1).max() < 0.3


def test_heights_between_centres_follow_a_plane_to_the_edge():
    terrain = raster_of(plane)
    west, south, east, north = terrain.bounds
    assert terrain.bounds == (3.0, -2.0, 9.0, 2.0)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(west, east, 50), rng.uniform(south, north, 50)
    x[:2], y[:2] = (west, east), (south, north)
    np.testing.assert_allclose(terrain.height_at(x, y), plane(x, y), rtol=1e-12)
    with pytest.raises(InputError, match=r"1 of 2 points .*\(9\.10, 0\.00\)"):
        terrain.height_at([4.0, 9.1], [0.0, 0.0])


def test_gradient_is_the_planes():
    east, north = raster_of(plane).gradient()
    np.testing.assert_allclose(east, 0.3)
    np.testing.assert_allclose(north, -0.2)


def test_resampling_keeps_planes_and_means():
    rng = np.random.default_rng(2)
    rough = Terrain(rng.normal(size=(12, 18)), 0.5)
    coarse = rough.resample(1.5)
    means = rough.heights.reshape(4, 3, 6, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse.heights, means, atol=1e-12)
    for cell in (0.1, 0.25, 0.4, 1.0):
        terrain = raster_of(plane).resample(cell, (4.0, -1.0, 8.0, 1.0))
        x, y = terrain.centres
        assert terrain.heights.shape == (round(2 / cell), round(4 / cell))
        np.testing.assert_allclose(terrain.heights, plane(x[None, :], y[:, None]), rtol=1e-12)
    with pytest.raises(InputError, match="does not divide"):
        rough.resample(0.7)
    with pytest.raises(InputError, match=r"the terrain covers \(0\.00.*plot is \(-1\.00"):
        rough.resample(0.5, (-1.0, 0.0, 3.0, 3.0))


@pytest.mark.parametrize(
    ("heights", "cell", "said"),
    [
        (np.zeros(4), 1.0, "shape"),
        (np.zeros((1, 4)), 1.0, "two rows"),
        (np.zeros((3, 4)), 0.0, "`cell`"),
        (np.where(np.eye(3) > 0, np.nan, 1.0), 1.0, "3 of 9 are not; the first is in row 0"),
    ],
)
def test_terrain_that_is_none(heights, cell, said):
    with pytest.raises(InputError, match=said):
        Terrain(heights, cell)


def test_heights_above_ground_and_canopy(plot):
    cloud, _, found = plot
    terrain = terrain_from_points(cloud, found, cell=0.25, bounds=PLOT)
    inside = cloud.crop(terrain.bounds)
    above = heights_above_ground(inside, terrain)
    expected = inside.z - ground_height(inside.x, inside.y)
    assert np.quantile(np.abs(above - expected), 0.98) < 0.1
    canopy = canopy_height(cloud, terrain, cell=0.5)
    # A cell at a time, from the truth.
    for row, column in [(3, 5), (20, 40), (59, 0)]:
        here = np.floor((inside.x - terrain.origin[0]) / 0.5) == column
        here &= np.floor((inside.y - terrain.origin[1]) / 0.5) == row
        assert canopy[row, column] == pytest.approx(expected[here].max(), abs=0.1)
    empty = canopy_height(cloud.select(cloud.x > CORNER[0] + 10.0), terrain, cell=0.5)
    assert np.isnan(empty[:, :20]).all()
    assert np.isfinite(empty[:, 20:]).all()


def test_mesh_has_the_rasters_heights():
    terrain = raster_of(lambda x, y: plane(x, y) + 0.2 * np.sin(x) * np.cos(y), (40, 60), 0.1)
    mesh = terrain_mesh(terrain)
    np.testing.assert_allclose(mesh.bounds[:, :2], [[0.0, 0.0], [6.0, 4.0]], atol=1e-12)
    assert (mesh.face_normals[:, 2] > 0.0).all()
    corners = mesh.vertices.reshape(41, 61, 3)
    middles = 0.25 * (corners[1:, 1:] + corners[:-1, 1:] + corners[1:, :-1] + corners[:-1, :-1])
    x, _ = terrain.centres
    np.testing.assert_allclose(middles[..., 0], np.broadcast_to(x - 3.0, (40, 60)), atol=1e-12)
    # Means of means smooth by h^2 / 4 times the curvature: here at most 0.1^2 / 4 * 0.2 * 2.
    wrong = middles[..., 2] - (terrain.heights - terrain.heights.min())
    assert np.abs(wrong[1:-1, 1:-1]).max() < 1.1e-3
    assert np.abs(wrong).max() < 3e-3


def test_mesh_of_a_plane_is_the_plane():
    terrain = raster_of(plane)
    mesh = terrain_mesh(terrain)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z + terrain.heights.min(), plane(x + 3.0, y - 2.0), atol=1e-12)
    assert mesh.area == pytest.approx(24.0 * np.sqrt(1 + 0.3**2 + 0.2**2))


def test_bounds_follow_multiples_of_the_cell():
    cloud = cloud_of(plane)
    shifted = PointCloud(cloud.x + 0.13, cloud.y - 7.06, cloud.z)
    terrain = terrain_from_points(shifted, np.ones(len(cloud), bool), cell=0.5)
    assert terrain.bounds == (0.5, -7.0, 20.0, 12.5)


def test_a_few_cells_far_from_ground_do_not_refuse_a_cloud():
    side = np.arange(0.0, 80.01, 0.25)
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    hole = np.hypot(x - 30.0, y - 30.0) < 5.2
    cloud = PointCloud(x, y, 0.1 * x)
    with pytest.warns(UserWarning, match=r"4 of 6400 cells are farther than 4\.4 m .*may be wrong"):
        terrain = terrain_from_points(cloud, ~hole, cell=1.0, largest_gap=4.4)
    assert terrain.heights[30, 30] == pytest.approx(3.05, abs=0.05)
    with pytest.raises(InputError, match=r"\d+ of 6400 cells are so far from it"):
        terrain_from_points(cloud, ~hole, cell=1.0, largest_gap=3.5)
