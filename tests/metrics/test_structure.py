"""Exact structure metrics against other tools' conventions, closed forms and hand counts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from fynjax._core.errors import InputError
from fynjax.app.compare.structure import structure_2006
from fynjax.metrics.structure import (
    STRUCTURE_METRICS,
    STRUCTURE_PRESETS,
    StructureSettings,
    bin_returns,
    cell_grid,
    cell_structure,
    foliage_height_diversity,
)
from tests.metrics.structure_clouds import fynbos_cells, fynbos_returns


def one_cell(heights, settings, **options):
    """Structure of a single cell of 1 m with these heights, all metrics as numbers."""
    place = np.full(len(heights), 0.5)
    returns = bin_returns(place, place, heights, cell_grid((0, 0, 1, 1), 1.0), settings, **options)
    found = cell_structure(returns)
    return {name: float(v[0, 0]) for name, v in found.metrics.items()}, found


# PyForestScan 0.5.0 (iosefa/PyForestScan, MIT), `assign_voxels`, `calculate_fhd`, `calculate_pad`,
# `calculate_pai` and `calculate_canopy_cover` with voxels of 5 x 5 x 1 m and its own defaults else,
# run once on `forest`; rows from south to north.
PEER_FHD = [
    [1.43682894, 1.54398272, 2.20775206, 2.19756928],
    [1.43240916, 1.31437314, 2.3080397, 2.36805386],
]
PEER_PAI = [
    [0.87806952, 1.08518927, 1.13943428, 1.19523912],
    [0.77770457, 0.65392647, 1.44036158, 1.51787072],
]
PEER_COVER = [
    [0.20227596, 0.29289322, 0.36754447, 0.34105347],
    [0.2466292, 0.14365116, 0.41510235, 0.45102836],
]


def forest():
    """600 returns on 20 m x 10 m, without any random number."""
    i = np.arange(600)
    x, y = 20.0 * ((i * 0.618034) % 1.0), 10.0 * ((i * 0.414214) % 1.0)
    tall = 12.0 * ((i * 0.732051) % 1.0) ** 1.5 * (0.4 + 0.6 * (x > 10.0))
    return x, y, np.where(i % 9 == 0, 0.0, tall)


def test_against_pyforestscan() -> None:
    settings = STRUCTURE_PRESETS["PyForestScan"]
    found = cell_structure(bin_returns(*forest(), cell_grid((0, 0, 20, 10), 5.0), settings))
    np.testing.assert_allclose(found.metrics["foliage_height_diversity"], PEER_FHD, atol=2e-8)
    np.testing.assert_allclose(1.0 - found.metrics["gap_fraction"], PEER_COVER, atol=2e-8)
    index = np.nansum(found.leaf_area_density, axis=2) * settings.layer
    np.testing.assert_allclose(index, PEER_PAI, atol=2e-8)


def r_lad(z, dz, k, z0):
    """lidR's `LAD` (Bouvier et al. 2015), return by return: densities by the middle of layers."""
    found = {}
    bottom = z0
    while bottom < max(z):
        inside = sum(bottom <= one < bottom + dz for one in z)
        below = sum(one < bottom for one in z)
        found[round(bottom + dz / 2, 6)] = (
            -np.log(below / (below + inside)) / (k * dz) if below else np.nan
        )
        bottom += dz
    return found


def r_entropy(z, by):
    """lidR's `entropy`: between 0 and 1, missing below two layers of height."""
    if max(z) < 2 * by:
        return np.nan
    number = int(np.ceil(max(z) / by))
    shares = [sum(i * by <= one < (i + 1) * by for one in z) / len(z) for i in range(number)]
    return -sum(p * np.log(p) for p in shares if p > 0) / np.log(number)


@pytest.mark.parametrize(
    "z",
    [
        [0.1, 0.4, 1.2, 1.9, 2.3, 2.4, 3.7, 3.8, 5.2, 5.25, 7.7],  # nothing from 4 to 5 and 6 to 7
        [2.1, 2.5, 3.3, 3.4, 4.9],  # nothing below the lowest layer
        [0.2, 1.4],  # too low for an entropy
    ],
)
def test_against_lidr(z) -> None:
    settings = STRUCTURE_PRESETS["lidR"]
    got, found = one_cell(z, settings)
    np.testing.assert_allclose(got["foliage_height_diversity"], r_entropy(z, 1.0), atol=1e-13)
    expected = r_lad(z, 1.0, 0.5, 2.0)
    middle = 0.5 * (found.edges[1:] + found.edges[:-1])
    density = dict(zip(middle.round(6), found.leaf_area_density[0, 0]))
    for height, value in expected.items():
        np.testing.assert_allclose(density[height], value, atol=1e-13)
    defined = [v for v in expected.values() if np.isfinite(v)]
    if len(defined) > 1:
        assert got["leaf_area_density_mean"] == pytest.approx(np.mean(defined), rel=1e-12)
        assert got["leaf_area_density_std"] == pytest.approx(np.std(defined, ddof=1), rel=1e-12)
    else:
        assert np.isnan(got["leaf_area_density_std"])


def test_against_leafr() -> None:
    """Voxels, the plot's mean profile, and its diversity, column by column from the sky down."""
    x, y, z = forest()
    settings = STRUCTURE_PRESETS["leafR"]
    found = cell_structure(bin_returns(x, y, z, cell_grid((0, 0, 20, 10), 5.0), settings))
    tallest = int(max(z))
    columns = []
    for j in range(2):
        for i in range(4):
            inside = (x >= 5 * i) & (x < 5 * i + 5) & (y >= 5 * j) & (y < 5 * j + 5)
            number = np.bincount(z[inside].astype(int), minlength=tallest + 1)
            entering, column = inside.sum(), []
            for layer in range(tallest, 0, -1):
                leaving = entering - number[layer]
                column.append(np.log(entering / leaving) if leaving else np.nan)
                entering = leaving
            columns.append(column[::-1])
    profile = np.nanmean(columns, axis=0)
    np.testing.assert_allclose(found.profile(), profile, atol=1e-13)
    percent = 100.0 * profile / profile.sum()
    kept = percent[percent >= 1.0 / len(percent)] / 100.0
    assert len(kept) < len(percent) or percent.min() > 0.05
    got = foliage_height_diversity(found.profile(), least_share=settings.diversity_least_share)
    assert got == pytest.approx(-np.sum(kept * np.log(kept)), rel=1e-12)


def test_a_layer_of_too_small_a_share_is_left_out_without_scaling_the_rest() -> None:
    amount = [50.0, 49.9, 0.05, 0.05]
    p = np.array(amount[:2]) / 100.0
    got = foliage_height_diversity(amount, least_share=0.01)
    assert got == pytest.approx(-np.sum(p * np.log(p)), rel=1e-12)
    assert got < foliage_height_diversity(amount)


def test_gedi_counts_the_ground_by_its_reflectance() -> None:
    """P_gap(z) = 1 - Rv(z) / (Rv(0) + 1.5 Rg), and the area index is -ln P_gap / k."""
    heights = [0.0] * 40 + [3.0] * 25 + [7.0] * 20 + [12.0] * 15
    got, found = one_cell(heights, STRUCTURE_PRESETS["GEDI L2B"])
    total = 60 + 1.5 * 40
    assert got["gap_fraction"] == pytest.approx(60 / total, rel=1e-12)
    above = np.array([15, 35, 60])[::-1] / total  # higher than 10, 5 and 0 m
    index = -np.log(1.0 - above) / 0.5
    layers = -np.diff(np.append(index, 0.0))
    np.testing.assert_allclose(found.leaf_area_density[0, 0] * 5.0, layers, rtol=1e-12)
    expected = stats.entropy(layers)
    assert got["foliage_height_diversity"] == pytest.approx(expected, rel=1e-12)


def test_a_uniform_slab_has_its_density_and_gap() -> None:
    """Beer and Lambert: area 1.6 m2 m-3 between 0.5 and 1.75 m, seen with G = 0.5."""
    density, low, high, number = 1.6, 0.5, 1.75, 400_000
    depth = -np.log1p(-(np.arange(number) + 0.5) / number) / (0.5 * density)
    heights = np.where(depth < high - low, high - depth, 0.0)
    settings = StructureSettings(layer=0.25, lowest=0.5, diversity_lowest=0.5)
    got, found = one_cell(heights, settings)
    np.testing.assert_allclose(found.leaf_area_density[0, 0], density, rtol=1e-4)
    assert got["leaf_area_density_mean"] == pytest.approx(density, rel=1e-5)
    assert got["leaf_area_density_std"] < 1e-4
    gap = np.exp(-0.5 * density * (high - low))
    assert got["gap_fraction"] == pytest.approx(gap, rel=1e-5)
    same = one_cell(heights, replace(settings, gap_of="leaf_area", gap_height=0.5))[0]
    assert same["gap_fraction"] == pytest.approx(gap, rel=1e-5)
    # Each layer takes exp(-k a dz) of what enters it.
    share = np.exp(-0.5 * density * 0.25 * np.arange(5))
    assert got["foliage_height_diversity"] == pytest.approx(stats.entropy(share), rel=1e-5)
    weighted = one_cell(heights, replace(settings, extinction=1.0))[0]
    assert weighted["leaf_area_density_mean"] == pytest.approx(0.5 * density, rel=1e-5)


def test_cells_against_a_loop() -> None:
    """Every metric of every cell, from its own returns alone."""
    x, y, h = fynbos_returns()
    settings = replace(StructureSettings(), cv_lowest=0.2)
    found = cell_structure(fynbos_cells(settings))
    for j in range(5):
        for i in range(5):
            inside = (x >= 2 * i) & (x < 2 * i + 2) & (y >= 2 * j) & (y < 2 * j + 2)
            z = h[inside]
            assert found.returns[j, i] == len(z)
            cell = {name: found.metrics[name][j, i] for name in STRUCTURE_METRICS}
            assert cell["gap_fraction"] == pytest.approx((z < 0.1).mean(), rel=1e-12)
            high = z[z >= 0.2]
            assert cell["height_cv"] == pytest.approx(high.std(ddof=1) / high.mean(), rel=1e-12)
            counts = np.histogram(z[z >= 0.25], np.arange(0.25, 9.0, 0.25))[0]
            expected = stats.entropy(counts)
            assert cell["foliage_height_diversity"] == pytest.approx(expected, rel=1e-12)
            u, v = ((w[inside] % 2.0 // 0.5).astype(int) for w in (x, y))
            tops = [
                z[(u == a) & (v == b)].max()
                for a in range(4)
                for b in range(4)
                if ((u == a) & (v == b)).any()
            ]
            assert cell["rugosity"] == pytest.approx(np.std(tops, ddof=1), rel=1e-12)
            if (j, i) == (2, 3):
                layers = [v for v in r_lad(z, 0.25, 0.5, 0.25).values() if np.isfinite(v)]
                expected = np.mean(layers)
                assert cell["leaf_area_density_mean"] == pytest.approx(expected, rel=1e-12)


def test_variants_of_gap_and_rugosity() -> None:
    x, y, h = fynbos_returns()
    found = cell_structure(fynbos_cells(StructureSettings(gap_of="canopy", rugosity_of="columns")))
    inside = (x < 2) & (y < 2)
    u, v = ((w[inside] // 0.5).astype(int) for w in (x, y))
    groups = [h[inside][(u == a) & (v == b)] for a in range(4) for b in range(4)]
    low = np.mean([g.max() < 0.1 for g in groups if g.size])
    assert found.metrics["gap_fraction"][0, 0] == pytest.approx(low, abs=1e-12)
    spread = np.std([g.std(ddof=1) for g in groups if g.size > 1], ddof=1)
    assert found.metrics["rugosity"][0, 0] == pytest.approx(spread, rel=1e-12)


def test_layers_decide_the_diversity() -> None:
    """The table of a fynbos-like cloud in thin and thick layers: a factor of six."""
    values = [
        cell_structure(
            fynbos_cells(StructureSettings(layer=dz, lowest=0.0, diversity_lowest=0.0))
        ).means()["foliage_height_diversity"]
        for dz in (0.1, 0.25, 0.5, 1.0)
    ]
    assert all(a > b + 0.3 for a, b in pairwise(values))
    assert values[0] > 5.0 * values[-1]


def test_decimal_heights_are_on_their_edge() -> None:
    """0.3 / 0.1 is less than 3 in binary; the return is in the layer that begins at 0.3 m."""
    settings = StructureSettings(layer=0.1, lowest=0.0, diversity_lowest=0.0)
    heights = np.round(np.arange(0.0, 3.0, 0.1), 1)
    got, found = one_cell(heights, settings)
    assert len(found.edges) == len(heights) + 1
    assert got["foliage_height_diversity"] == pytest.approx(np.log(len(heights)), rel=1e-12)


def test_what_is_undefined_is_nan_and_the_rest_is_not() -> None:
    settings = StructureSettings()
    one, _ = one_cell([0.6], settings)
    assert one["foliage_height_diversity"] == 0.0
    assert one["gap_fraction"] == 0.0
    assert np.isnan([one["leaf_area_density_std"], one["rugosity"], one["height_cv"]]).all()
    assert np.isnan(one["leaf_area_density_mean"])  # nothing passed its layers
    bare, _ = one_cell([0.0] * 8, settings)
    assert bare["gap_fraction"] == 1.0
    assert np.isnan(bare["foliage_height_diversity"])
    assert np.isnan(bare["height_cv"])
    for top, expected in (("cell", np.nan), ("plot", 0.0)):  # beside a cell with plants
        two = cell_structure(
            bin_returns(
                np.array([0.5, 0.5, 0.5, 1.5]),
                np.full(4, 0.5),
                np.array([0.0, 0.4, 0.9, 0.0]),
                cell_grid((0, 0, 2, 1), 1.0),
                replace(settings, top=top),
            )
        )
        np.testing.assert_equal(two.metrics["leaf_area_density_mean"][0, 1], expected)
    x = np.array([0.5, 0.5, 0.6])
    empty = cell_structure(
        bin_returns(x, x, np.array([0.1, 0.5, 0.9]), cell_grid((0, 0, 4, 2), 2.0), settings)
    )
    assert empty.returns.tolist() == [[3, 0]]
    assert all(np.isnan(v[0, 1]) for v in empty.metrics.values())
    assert empty.means()["gap_fraction"] == 0.0


def test_cells_of_a_plot() -> None:
    grid = cell_grid((100.0, 50.0, 110.0, 60.0), 3.0)
    assert grid.shape == (3, 3)
    assert grid.bounds == (100.0, 50.0, 109.0, 59.0)  # a strip of 1 m belongs to no cell
    points = cell_grid((0.04, 0.02, 9.93, 9.99), 2.0, slack=0.28)
    assert points.shape == (5, 5)
    assert points.bounds == pytest.approx((-0.015, 0.005, 9.985, 10.005))
    with pytest.raises(InputError, match="smaller grain"):
        cell_grid((0, 0, 2, 2), 3.0)
    with pytest.raises(InputError, match="`grain`"):
        cell_grid((0, 0, 2, 2), -1.0)


def test_bad_settings_and_returns() -> None:
    for wrong, message in (
        ({"layer": 0.0}, "`layer` .--layer. must be positive"),
        ({"layer": float("nan")}, "`layer`"),
        ({"lowest": -0.1}, "`lowest` .--lowest. must be at least 0"),
        ({"top": "tree"}, "`top` .--top. must be one of"),
        ({"lowest": 0.3}, "whole layers apart"),
    ):
        with pytest.raises(InputError, match=message):
            StructureSettings(**wrong)
    grid, settings = cell_grid((0, 0, 1, 1), 1.0), StructureSettings()
    good = np.array([0.2, 0.7])
    with pytest.raises(InputError, match=r"`height` .*return 2"):
        bin_returns(good, good, [0.1, np.nan], grid, settings)
    with pytest.raises(InputError, match="as many"):
        bin_returns(good, good, [0.1], grid, settings)
    with pytest.raises(InputError, match="there are none"):
        bin_returns(good + 9.0, good, good, grid, settings)
    with pytest.raises(InputError, match="above the ground"):
        bin_returns(good, good, good * 1e9, grid, settings)


def test_settings_are_carried_and_names_agree() -> None:
    found = cell_structure(fynbos_cells(STRUCTURE_PRESETS["lidR"]))
    assert found.settings.source.startswith("lidR")
    assert found.settings.layer == 1.0
    assert tuple(found.metrics) == tuple(STRUCTURE_METRICS)
    assert set(STRUCTURE_METRICS) < set(structure_2006())


def test_the_papers_numbers(shared_data) -> None:
    import json

    text = (shared_data / "paper" / "reference_values.json").read_text("utf-8")
    printed = json.loads(text)["structure"]
    ours = structure_2006()
    assert ours["foliage_height_diversity"].real == printed["FHD"]["saeon"]
    assert ours["foliage_height_diversity"].simulated == printed["FHD"]["sim_median"]
    assert ours["gap_fraction"].real == printed["gap_fraction"]["saeon"]
    assert ours["gap_fraction"].simulated == printed["gap_fraction"]["sim_median"]
    differences = printed["sim_minus_real_percent"]
    for name, key in (
        ("leaf_area_density_mean", "LAD_mean"),
        ("leaf_area_density_std", "LAD_std"),
        ("rugosity", "rugosity"),
        ("height_cv", "CV_height"),
    ):
        assert ours[name].difference_percent == differences[key]
    assert ours["height_percentile_rmse"].simulated == printed["height_percentile_rmse_m"]
    assert ours["height_intersection"].simulated == printed["height_histogram_intersection"]
