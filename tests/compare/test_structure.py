"""Two clouds in, their structure compared: synthetic plots of known truth, and real clouds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

from fynjax._core.errors import InputError
from fynjax.app.compare.structure._cloud import CloudSettings, height_cloud
from fynjax.app.compare.structure._compare import (
    ComparisonSettings,
    cloud_structure,
    compare_clouds,
)
from fynjax.app.compare.structure._notes import comparison_notes
from fynjax.app.report.figures._structure import structure_figure, structure_maps
from fynjax.app.terrain import PointCloud
from fynjax.metrics.structure import STRUCTURE_METRICS, StructureSettings

laspy = pytest.importorskip("laspy")

CORNER = (412300.0, 6191200.0)
GRAINS = (1.0, 2.0)
"""At the paper's density the first is too fine, so that the second is taken, as there."""
FEW = ComparisonSettings(grains=GRAINS, repetitions=5, resamples=50)


def plot(seed, density, *, taller=1.0, plants=1, side=10.0):
    """x, y, height above ground and elevation of returns over shrubs; which are from the ground."""
    rng, places = np.random.default_rng(seed), np.random.default_rng(plants)
    number = int(density * side**2)
    x, y = rng.uniform(0.0, side, (2, number))
    top = np.zeros(number)
    for _ in range(int(4 * side**2)):
        (cx, cy), r = places.uniform(0.0, side, 2), places.uniform(0.15, 0.5)
        tall = taller * places.gamma(4.0, 0.16)
        away = ((x - cx) ** 2 + (y - cy) ** 2) / r**2
        top = np.maximum(top, tall * np.sqrt(np.maximum(1.0 - away, 0.0)))
    ground = (top == 0.0) | (rng.random(number) < 0.08)
    height = np.where(ground, 0.0, top * rng.uniform(0.4, 1.0, number))
    elevation = 120.0 + 0.05 * x + 0.02 * np.sin(y) + height + rng.normal(0.0, 0.02, number)
    return x, y, height, elevation, ground


def write_las(path, x, y, z, ground=None, epsg=None):
    """A LAS file; `ground` adds the classes 2 and 5."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [x.min(), y.min(), z.min()]
    if epsg is not None:
        wkt = rasterio.crs.CRS.from_epsg(epsg).to_wkt()
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
        header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x, las.y, las.z = x, y, z
    if ground is not None:
        las.classification = np.where(ground, 2, 5).astype(np.uint8)
    las.write(path)
    return path


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A real plot at the paper's density without classes, and a denser one with, 20 % taller."""
    folder = tmp_path_factory.mktemp("clouds")
    x, y, _, z, _ = plot(0, 13.17)
    real = write_las(folder / "real.las", x + CORNER[0], y + CORNER[1], z, epsg=32734)
    x, y, _, z, ground = plot(1, 150.0, taller=1.2)
    z[:6] -= 3.0  # late echoes, some of them labelled as ground
    return real, write_las(folder / "simulated.las", x, y, z, ground)


@pytest.fixture(scope="module")
def found(pair):
    return compare_clouds(*pair, settings=ComparisonSettings(grains=GRAINS), seed=3)


def test_compares_at_one_density_on_cells_of_2_m(found) -> None:
    assert found.grain == 2.0
    assert found.real.cells["rugosity"].shape == (5, 5)
    assert found.thinned == "simulated"
    assert found.matched_returns == found.real.returns < found.simulated.returns
    assert found.real.density == pytest.approx(13.17, rel=0.02)
    assert found.simulated.density == pytest.approx(150.0, rel=0.02)
    assert (found.real.ground, found.simulated.ground) == ("smrf", "labels")
    assert found.simulated.below_ground == 6
    assert found.real.below_ground == 0
    said = " ".join(found.notes)
    assert "no coordinates in common" in said
    assert "6 returns" in said
    assert "two ways" in said


def test_plants_three_times_as_tall_may_be_in_feet(found) -> None:
    assert "feet" not in " ".join(found.notes)
    tall = replace(found.real, nearly_highest=3.28 * found.simulated.nearly_highest)
    said = " ".join(comparison_notes(replace(found, real=tall)))
    assert "plants of the real cloud are 3.3 times as tall" in said


def test_finds_what_differs(found) -> None:
    """Plants of the same places, 20 % taller: heights 20 % higher, cover the same."""
    # Their ground is found in two ways, which is worth 2 %; sampling the rest.
    assert found.difference_percent["gap_fraction"] == pytest.approx(0.0, abs=8.0)
    assert found.difference_percent["rugosity"] == pytest.approx(20.0, abs=9.0)
    high = [i for i, p in enumerate(found.percents) if p >= 75.0]
    ratio = found.simulated.percentiles[high] / found.real.percentiles[high]
    np.testing.assert_allclose(ratio, 1.2, atol=0.1)
    gap = found.simulated.percentiles - found.real.percentiles
    heights = found.heights["value"]
    assert heights["height_percentile_rmse"] == pytest.approx(np.sqrt(np.mean(gap**2)), rel=0.1)
    assert 0.85 < heights["height_intersection"] < 0.97


def test_intervals_hold_their_values(found) -> None:
    for side in found.sides.values():
        own = side.metrics
        assert (
            (own["bootstrap_low"] < own["value"]) & (own["value"] < own["bootstrap_high"])
        ).all()
    assert found.real.metrics[["thinning_low", "thinning_high"]].isna().all(axis=None)
    assert found.real.metrics["value"].equals(found.real.metrics["full"].rename("value"))
    own = found.simulated.metrics
    assert ((own["thinning_low"] < own["value"]) & (own["value"] < own["thinning_high"])).all()
    # A share of returns does not depend on their density, as the canopy's highest returns do.
    gap = own.loc["gap_fraction"]
    assert gap["thinning_low"] < gap["full"] < gap["thinning_high"]
    rmse = found.heights.loc["height_percentile_rmse"]
    assert rmse["thinning_low"] < rmse["value"] < rmse["thinning_high"]


def test_metrics_are_those_of_the_truth(pair, tmp_path) -> None:
    """With the true heights, no ground has to be found."""
    x, y, height, _, _ = plot(0, 13.17)
    path = write_las(tmp_path / "true.las", x, y, height)
    given = CloudSettings(ground="none")
    settings = ComparisonSettings(grain=2.0, real=given)
    truth = cloud_structure(path, settings)
    found = cloud_structure(pair[0], ComparisonSettings(grain=2.0))
    assert truth.side.ground_share is None
    for name, bound in (("gap_fraction", 0.1), ("rugosity", 0.05), ("height_cv", 0.1)):
        true = truth.side.metrics.loc[name, "value"]
        assert found.side.metrics.loc[name, "value"] == pytest.approx(true, rel=bound)
    inside = (x > 0) & (y > 0)
    assert truth.side.returns == inside.sum()
    low = [(height[(x // 2 == i) & (y // 2 == j)] < 0.1).mean() for j in range(5) for i in range(5)]
    gap = truth.side.metrics.loc["gap_fraction", "value"]
    assert gap == pytest.approx(np.mean(low), rel=0.01)


def test_seed_decides_and_sides_swap(pair, found) -> None:
    one, two, other = (compare_clouds(*pair, settings=FEW, seed=s) for s in (1, 1, 2))
    assert one.table().equals(two.table())
    assert not one.table().equals(other.table())
    swapped = compare_clouds(*pair[::-1], settings=FEW)
    assert swapped.thinned == "real"
    assert swapped.grain == found.grain
    np.testing.assert_allclose(swapped.simulated.metrics["value"], found.real.metrics["value"])
    assert swapped.simulated.metrics["thinning_low"].isna().all()


def test_a_cloud_against_itself(pair) -> None:
    same = compare_clouds(pair[0], pair[0], settings=FEW)
    assert same.thinned == "neither"
    assert same.heights.loc["height_percentile_rmse", "value"] == 0.0
    assert same.heights.loc["height_intersection", "value"] == pytest.approx(1.0)
    assert (same.difference_percent == 0.0).all()
    assert same.notes == ()


def test_outputs_carry_numbers_settings_and_the_papers_values(found, tmp_path) -> None:
    table = found.table().set_index("metric")
    assert list(table.index[:6]) == list(STRUCTURE_METRICS)
    assert table.loc["gap_fraction", "paper_real"] == 0.0625
    assert table.loc["rugosity", "paper_difference_percent"] == 35.8
    assert table.loc["height_intersection", "simulated"] == found.heights["value"].iloc[1]
    settings = found.settings_table().set_index("setting")["value"]
    for name in (
        "layer",
        "extinction",
        "gap_height",
        "repetitions",
        "seed",
        "grain",
        "real_ground",
    ):
        assert name in settings.index
    path = tmp_path / "structure.nc"
    data = found.dataset()
    data.to_netcdf(path)
    assert data.attrs["layer"] == 0.25
    assert data["rugosity"].attrs["units"] == "m"
    assert data.sizes["x"] == data.sizes["y"] == 5
    np.testing.assert_allclose(data["height_share"].sum("bin"), 1.0)


def test_figures_show_what_was_found(found) -> None:
    figure = structure_figure(found)
    assert len(figure.axes) == len(STRUCTURE_METRICS) + 3
    titles = " ".join(axes.get_title("left") for axes in figure.axes)
    rmse, overlap = found.heights["value"]
    assert f"intersection {overlap:.3f}" in titles
    assert f"RMSE {rmse:.3f} m" in titles
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert f"{found.difference_percent.iloc[0]:+.1f} %" in labels
    maps = structure_maps(found)
    np.testing.assert_array_equal(
        maps.axes[0].images[0].get_array(), found.real.cells["foliage_height_diversity"]
    )


def test_bare_ground_has_no_plants_and_no_nan(pair, tmp_path) -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0.0, 10.0, (2, 3000))
    bare = write_las(tmp_path / "bare.las", x, y, 50.0 + rng.normal(0.0, 0.005, 3000))
    found = compare_clouds(pair[0], bare, settings=FEW)
    assert found.simulated.metrics.loc["gap_fraction", "value"] == 1.0
    row = found.table().set_index("metric").loc["foliage_height_diversity"]
    assert np.isnan(row["simulated"])
    assert np.isnan(row["difference_percent"])
    structure_figure(found)
    structure_maps(found)


def test_empty_cells_and_cells_of_one_return(pair, tmp_path) -> None:
    """Half of the plot without returns but one in each cell: those cells do not count."""
    x, y, height, _, _ = plot(0, 60.0)
    keep = (x < 4.0) | (np.arange(len(x)) % 400 == 0)
    path = write_las(tmp_path / "half.las", x[keep], y[keep], height[keep])
    given = CloudSettings(ground="none")
    bounds = (0.0, 0.0, 10.0, 10.0)
    with pytest.raises(InputError, match=r"half\.las: no grain has 5 returns in 90 %"):
        cloud_structure(path, ComparisonSettings(real=given, bounds=bounds))
    found = cloud_structure(path, ComparisonSettings(real=given, bounds=bounds, grain=2.0))
    counted = found.structure.counted(5)
    assert counted[:, :2].all()
    assert not counted[:, 2:].any()
    expected = found.structure.metrics["gap_fraction"][:, :2].mean()
    assert found.side.metrics.loc["gap_fraction", "value"] == pytest.approx(expected)


def test_clouds_that_cannot_be_compared(pair, tmp_path) -> None:
    real, _ = pair
    x, y, _, z, _ = plot(5, 40.0)
    elsewhere = write_las(tmp_path / "zone.las", x + CORNER[0], y + CORNER[1], z, epsg=32735)
    with pytest.raises(InputError, match=r"zone\.las: .*EPSG:32734 and this one in EPSG:32735"):
        compare_clouds(real, elsewhere)
    away = write_las(tmp_path / "away.las", x, y, z, epsg=32734)
    with pytest.raises(InputError, match=r"away\.las: expected both clouds over the same plot"):
        compare_clouds(real, away)
    few = replace(FEW, simulated_shift=CORNER)
    assert compare_clouds(real, away, settings=few).grain == 2.0
    with pytest.raises(InputError, match=r"real\.las: expected heights above the ground"):
        cloud_structure(real, ComparisonSettings(real=CloudSettings(ground="none")))
    with pytest.raises(InputError, match=r"real\.las: expected points with classes"):
        cloud_structure(real, ComparisonSettings(real=CloudSettings(ground="labels")))
    with pytest.raises(InputError, match=r"real\.las: .*wider than the grains"):
        cloud_structure(real, ComparisonSettings(grains=(20.0,)))
    with pytest.raises(InputError, match="nothing"):
        compare_clouds(real, tmp_path / "nothing.las")
    for wrong in (
        {"repetitions": 0},
        {"confidence": 1.0},
        {"percents": (101.0,)},
        {"histogram_bin": 0.0},
    ):
        with pytest.raises(InputError, match=next(iter(wrong))):
            ComparisonSettings(**wrong)
    with pytest.raises(InputError, match="`ground`"):
        CloudSettings(ground="some")


@pytest.mark.parametrize("density", [13.17, 150.0])
def test_heights_above_a_ground_that_was_found(density) -> None:
    """Mean height within 1.5 cm of the truth, where the filter's own tolerance errs by 5 to 10."""
    x, y, height, z, _ = plot(7, density, plants=3)
    cloud = PointCloud(x, y, z)
    bounds = (0.0, 0.0, 10.0, 10.0)
    got = height_cloud(cloud, Path("cloud.laz"), CloudSettings(), bounds)
    assert got.height.mean() == pytest.approx(height.mean(), abs=0.015)
    coarse = height_cloud(cloud, Path("cloud.laz"), CloudSettings(tolerance=0.3), bounds)
    assert coarse.height.mean() < got.height.mean() - 0.01


def test_real_clouds_with_and_without_their_classes(shared_data) -> None:
    """Forest and pasture, ground labelled by its makers: the filter gives nearly the same."""
    path = shared_data / "eco" / "lidar" / "MixedEucaNat_crop60.laz"
    settings = ComparisonSettings(grain=5.0, structure=StructureSettings(layer=1.0, lowest=1.0,
                                  diversity_lowest=1.0, gap_height=1.0))  # fmt: skip
    labels = cloud_structure(path, settings)
    smrf = cloud_structure(path, replace(settings, real=CloudSettings(ground="smrf")))
    assert labels.side.ground == "labels"
    assert labels.structure.grid.shape == (10, 10)  # 49.99 m of points are a plot of 50 m
    for name in ("gap_fraction", "foliage_height_diversity", "rugosity"):
        by_labels = labels.side.metrics.loc[name, "value"]
        assert smrf.side.metrics.loc[name, "value"] == pytest.approx(by_labels, rel=0.1), name


def test_shrub_height_rasters_as_clouds(shared_data, tmp_path) -> None:
    """Photogrammetric heights of willow at 1 cm (Cunliffe et al. 2020): a surface, cell by cell."""
    path = shared_data / "eco" / "sfm_shrub" / "20160725_AC_ORC_P01_HAG.tif"
    with rasterio.open(path) as file:
        values = file.read(1).astype(float)
        values[file.read_masks(1) == 0] = np.nan
        cell = file.transform.a
    row, column = np.nonzero(np.isfinite(values))
    x, y = (column + 0.5) * cell, (values.shape[0] - row - 0.5) * cell
    z = values[row, column]
    cloud = write_las(tmp_path / "p01.las", x, y, z)
    lengths = {"layer": 0.05, "lowest": 0.05, "diversity_lowest": 0.05, "canopy_cell": 0.05}
    settings = ComparisonSettings(
        grain=0.25,
        structure=StructureSettings(gap_height=0.02, **lengths),
        real=CloudSettings(ground="none"),
    )
    found = cloud_structure(cloud, settings)
    expected = np.percentile(np.maximum(np.round(z, 3), 0.0), [25.0, 50.0, 75.0])
    middle = [settings.percents.index(p) for p in (25.0, 50.0, 75.0)]
    np.testing.assert_allclose(found.side.percentiles[middle], expected, atol=0.02)
    assert found.side.metrics["value"].notna().all()
