"""Figures show what they are given: read back from the paper (`tests.report.shown`), of tables and
images of which no two parts are alike, so that none can stand for another."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgba

from fynjax.app.compare.structure import StructureComparison
from fynjax.app.report.figures import (
    corner_plot,
    interval_plot,
    layer_map,
    maps_figure,
    parameter_plot,
    pixel_histograms,
    pixels_figure,
    predictive_plot,
    species_map,
    structure_figure,
    structure_maps,
    terrain_figure,
)
from fynjax.app.report.figures._plots_inferred import estimates_plot
from fynjax.app.report.figures._style import BLUE, words
from fynjax.app.report.figures._validation import band_box_plot, index_pair_histograms
from fynjax.app.report.figures._validation_spectra import mean_spectra_plot, misfit_plot
from fynjax.app.terrain import Terrain
from fynjax.metrics.structure import STRUCTURE_METRICS
from tests.helpers import stand_in
from tests.report.shown import colour, corners, laid_out, lines, panel, seen_corners, segments


def ramp(rows: int, columns: int, start: float, east: float, north: float) -> np.ndarray:
    """Values that grow to the east and to the north, row 0 in the south."""
    return start + east * np.arange(columns) + north * np.arange(rows)[:, None]


def test_maps_show_means_beside_their_standard_deviations_north_up():
    """Row 0 of a map is in the north."""
    mean, sd, unlike = (
        ramp(6, 9, 0.1, 0.02, 0.1),
        ramp(6, 9, 3.0, 0.5, 0.01),
        ramp(6, 9, 0, 0.1, 0.3),
    )
    other = ramp(6, 9, 20.0, -1.0, 2.0)
    figure = laid_out(maps_figure(
        {"cover": (mean[::-1], sd[::-1], "live cover", "1"),
         "mass": (other[::-1], sd[::-1] + 9.0, "leaf mass", "g m-2")}, unlike[::-1],
        "unlikeness (1: 99 %)",
    ))  # fmt: skip
    np.testing.assert_allclose(seen_corners(figure, panel(figure, "live cover")), corners(mean))
    mass = panel(figure, "leaf mass [g m-2]")
    np.testing.assert_allclose(seen_corners(figure, mass), corners(other))
    np.testing.assert_allclose(
        seen_corners(figure, panel(figure, "unlikeness (1: 99 %)")), corners(unlike)
    )
    shown = [axes for axes in figure.axes if axes.get_title(loc="left") == "its sd"]
    for beside, values in ((panel(figure, "live cover"), sd), (mass, sd + 9.0)):
        # Right of its mean, in the same row.
        right = min(shown, key=lambda one: abs(one.get_position().x0 - beside.get_position().x1)
                    + 9 * abs(one.get_position().y0 - beside.get_position().y0))  # fmt: skip
        np.testing.assert_allclose(seen_corners(figure, right), corners(values))


def test_pixels_have_the_intervals_of_map_and_chain_where_the_legend_says():
    pixels = {
        "p1": {"cover": ((0.1, 0.2, 0.4), (0.15, 0.3, 0.5)), "water": ((1, 2, 4), (3, 5, 8))},
        "p2": {"cover": ((0.5, 0.6, 0.65), (0.6, 0.7, 0.9)), "water": ((6, 7, 9), (5, 6, 7))},
    }
    figure = laid_out(pixels_figure(pixels, {"cover": ("cover", "1"), "water": ("water", "cm")}))
    for title, name in (("cover", "cover"), ("water [cm]", "water")):
        axes = panel(figure, title)
        for which, label in enumerate(("map", "emcee")):
            drawn = lines(axes, colour(figure, label))
            for place, pixel in enumerate(pixels.values()):
                low, mean, high = pixel[name][which]
                (bar,) = [one for one in drawn if one.shape[1] == 2 and round(one[1, 0]) == place]
                (dot,) = [one for one in drawn if one.shape[1] == 1 and round(one[1, 0]) == place]
                assert (*bar[0], dot[0, 0]) == (low, high, mean)
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["p1", "p2"]
    assert figure.axes[0].yaxis_inverted()  # the first above


def test_histograms_are_of_the_image_that_the_legend_names():
    rng = np.random.default_rng(0)
    middle = {"real": 0.30, "before": 0.45, "after": 0.36}
    layers = {who: {"nir": rng.normal(mean, 0.02, 4000)} for who, mean in middle.items()}
    for names in (("real", "before", "after"), ("before", "after"), ("real", "after")):
        figure = laid_out(pixel_histograms({who: layers[who] for who in names}))
        (axes,) = [one for one in figure.axes if one.patches]
        for who in names:
            shown = colour(figure, who)
            (stairs,) = [p for p in axes.patches if to_rgba(p.get_edgecolor())[:3] == shown
                         or to_rgba(p.get_facecolor())[:3] == shown]  # fmt: skip
            share, edges, _ = stairs.get_data()
            centre = 0.5 * (edges[1:] + edges[:-1])
            assert share @ centre / share.sum() == pytest.approx(middle[who], abs=3e-3)
            mean = [line[0, 0] for line in lines(axes, shown)]
            assert mean == [pytest.approx(middle[who], abs=2e-3)]


def test_histograms_of_indices_are_of_real_and_simulated():
    edges = np.linspace(0.0, 1.0, 11)[None]
    density = np.zeros((2, 1, 10))
    density[0, 0, 2], density[1, 0, 7] = 10.0, 10.0
    table = pd.DataFrame({"index": ["NDVI"], "histogram_intersection": 0.1, "ks": 0.9,
                          "central_intersection": 0.1, "real_mean": 0.25,
                          "simulated_mean": 0.75})  # fmt: skip
    figure = laid_out(index_pair_histograms(table, edges, density))
    (axes,) = [one for one in figure.axes if one.patches]
    for who, place in (("real", 0.25), ("simulated", 0.75)):
        shown = colour(figure, who)
        (stairs,) = [p for p in axes.patches if to_rgba(p.get_edgecolor())[:3] == shown
                     or to_rgba(p.get_facecolor())[:3] == shown]  # fmt: skip
        share, ends, _ = stairs.get_data()
        assert share @ (0.5 * (ends[1:] + ends[:-1])) / share.sum() == pytest.approx(place)


def test_ground_canopy_and_gaps_lie_where_they_are():
    heights, canopy = ramp(5, 8, 100.0, 1.0, 3.0), ramp(5, 8, 0.2, 0.1, 0.4)
    gap = np.maximum(ramp(5, 8, -0.2, 0.1, 0.2), 0.0)
    terrain = Terrain(heights, 1.0, gap=gap)
    figure = laid_out(terrain_figure(terrain, canopy))
    ground = panel(figure, "Ground, shaded")
    np.testing.assert_allclose(seen_corners(figure, ground), corners(heights))
    above = panel(figure, "Canopy")
    np.testing.assert_allclose(seen_corners(figure, above), corners(canopy))
    _, *known = seen_corners(figure, panel(figure, "Interpolated ground"))
    np.testing.assert_allclose(known, corners(gap)[1:])
    # Light from the north-west: a slope down to it is bright, one away from it dark.
    towards, away = (Terrain(ramp(9, 9, 0.0, east, north), 1.0)
                     for east, north in ((0.5, -0.5), (-0.5, 0.5)))  # fmt: skip
    bright, dark = (
        seen_corners(laid_out(one), one.axes[0], image=0)[0]
        for one in map(terrain_figure, (towards, away))
    )
    assert bright > dark + 0.3


def test_maps_of_layers_and_species_have_the_south_below():
    layer = ramp(6, 8, 0.1, 0.01, 0.05)
    figure = laid_out(layer_map({"Real": layer, "After": 2.0 * layer}, "NIR", pixel_m=0.5))
    for title, values in (("Real", layer), ("After", 2.0 * layer)):
        np.testing.assert_allclose(seen_corners(figure, panel(figure, title)), corners(values))
    place = np.zeros((4, 4), int)
    place[0, 0], place[-1, -1] = 1, -1
    forms = ["rounded_shrub", "restioid"]
    figure = laid_out(species_map(place, np.ones((4, 4)), ["Erica", "Restio"], forms, pixel_m=1.0))
    south_west, south_east, _, north_east = seen_corners(figure, figure.axes[0])
    np.testing.assert_allclose(south_west, colour(figure, "Restio (6%)"), atol=1e-6)
    np.testing.assert_allclose(south_east, colour(figure, "Erica (88%)"), atol=1e-6)
    np.testing.assert_allclose(north_east, 1.0)


def comparison() -> StructureComparison:
    """Of two clouds of which no number is the same."""
    rng = np.random.default_rng(3)
    edges, steps = np.linspace(0.0, 2.0, 5), np.linspace(0.0, 2.0, 9)

    def side(k: int) -> object:
        metrics = pd.DataFrame(
            {"value": 1.0 + k, "bootstrap_low": 0.8 + k, "bootstrap_high": 1.3 + k,
             "thinning_low": 0.9 + k, "thinning_high": 1.1 + k}, index=list(STRUCTURE_METRICS)
        )  # fmt: skip
        cells = {m: ramp(3, 4, 1.0 + i + 20 * k, 0.3, 1.1) for i, m in enumerate(STRUCTURE_METRICS)}
        return SimpleNamespace(
            metrics=metrics, cells=cells, histogram=rng.random(8), profile=rng.random(4) + k,
            percentiles=np.array([0.5, 0.8, 1.5]) + 0.3 * k,
        )  # fmt: skip

    heights = pd.DataFrame(
        {"height_intersection": [0.5, 0.4, 0.6], "height_percentile_rmse": [0.3, 0.2, 0.4]},
        index=["value", "thinning_low", "thinning_high"],
    ).T
    real, simulated = side(0), side(1)
    return stand_in(
        StructureComparison, real=real, simulated=simulated, heights=heights, edges=edges,
        sides={"real": real, "simulated": simulated}, histogram_edges=steps, grain=1.0,
        bounds=(0.0, 0.0, 4.0, 3.0), percents=np.array([50.0, 75.0, 95.0]),
        difference_percent=dict.fromkeys(STRUCTURE_METRICS, 100.0), thinned="neither",
        options={"confidence": 0.95},
        settings=SimpleNamespace(
            layer=0.5, lowest=0.0, diversity_of="returns", diversity_lowest=0.0, extinction=0.5,
            gap_height=0.2, rugosity_of="heights", canopy_cell=0.5, source="this test",
        ),
    )  # fmt: skip


@pytest.mark.untyped
def test_maps_of_structure_are_real_above_simulated():
    given = comparison()
    figure = laid_out(structure_maps(given))
    grid = [axes for axes in figure.axes if axes.images]
    for k, name in enumerate(("real", "simulated")):
        row = grid[k * len(STRUCTURE_METRICS) : (k + 1) * len(STRUCTURE_METRICS)]
        assert row[0].get_ylabel().startswith(name)
        for axes, metric in zip(row, STRUCTURE_METRICS, strict=True):
            expected = corners(given.sides[name].cells[metric])
            np.testing.assert_allclose(seen_corners(figure, axes), expected)
    assert grid[0].get_position().y0 > grid[-1].get_position().y0


def test_predictions_have_the_interval_that_the_legend_states():
    """5, 50 and 95 % of the draws, in standard errors of the measured."""
    draws = np.random.default_rng(1).gamma(2.0, 1.0, (4001, 2)) * [0.01, 3.0] + [0.1, 20.0]
    observed, sd = np.array([0.11, 24.0]), np.array([0.02, 2.0])
    figure = laid_out(predictive_plot(draws, observed, sd, ["red.mean", "nir.mean"]))
    (axes,) = figure.axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    shown = segments(axes, to_rgba(BLUE)[:3])
    (dots,) = lines(axes, to_rgba(BLUE)[:3], "o")
    for k, name in enumerate(map(words, ("red.mean", "nir.mean"))):
        (row,) = [y for label, y in zip(names, axes.get_yticks(), strict=True) if label == name]
        off = np.sort((draws[:, k] - observed[k]) / sd[k])
        (ends,) = [one[:, 0] for one in shown if one[0, 1] == row]
        np.testing.assert_allclose(ends, off[[200, 3800]], atol=1e-6)
        assert dots[0][dots[1] == row] == pytest.approx(off[2000])
    assert "predicted, 90 % of the draws" in [t.get_text() for t in figure.legends[0].get_texts()]


def test_contours_of_pairs_hold_half_and_nine_of_ten_draws():
    pytest.importorskip("corner")
    draws = np.random.default_rng(2).multivariate_normal(
        [1.0, 5.0], [[1.0, 0.8], [0.8, 4.0]], 60000
    )
    prior = np.linspace([-3.0, -4.0], [5.0, 14.0], 20), np.ones((20, 2))
    figure = laid_out(corner_plot({"emcee": draws}, ["first", "second"], prior=prior))
    (axes,) = [one for one in figure.axes if one.get_xlabel() == "first" and one.get_ylabel()]
    assert axes.get_ylabel() == "second"
    inside = sorted(
        np.mean(path.contains_points(draws))
        for one in axes.collections
        for path in one.get_paths()
        if len(path.vertices) > 20
    )
    np.testing.assert_allclose(inside, [0.5, 0.9], atol=0.04)  # smoothed, in coarse cells


TABLE = pd.DataFrame({
    "name": ["species.Erica.cover", "species.Restio.cover"], "kind": "cover", "unit": "%",
    "prior": [20.0, 30.0], "prior_q05": [11.0, 22.0], "prior_q95": [33.0, 44.0],
    "estimate": [25.0, 28.0], "q05": [21.0, 26.0], "q95": [27.0, 31.0], "truth": [23.5, 29.5],
})  # fmt: skip


def test_parameters_show_prior_estimate_and_truth_by_their_colours():
    figure = laid_out(parameter_plot(TABLE))
    (axes,) = figure.axes
    names = {label.get_text(): y for label, y in zip(axes.get_yticklabels(), axes.get_yticks())}
    kinds = {"prior, 90 %": ("prior", "prior_q05", "prior_q95"),
             "estimate, 90 %": ("estimate", "q05", "q95")}  # fmt: skip
    for label, columns in kinds.items():
        shown = colour(figure, label)
        (dots,) = lines(axes, shown)
        bars = segments(axes, shown)
        for row in TABLE.to_dict("records"):
            y = names[row["name"].split(".")[1]]
            (x,) = dots[0][np.round(dots[1]) == y]
            ((left, right),) = bars[np.round(bars[:, 0, 1]) == y][..., 0]
            assert [x, left, right] == [row[column] for column in columns]
    (truth,) = lines(axes, colour(figure, "truth"))
    assert sorted(truth[0]) == [23.5, 29.5]


def test_intervals_stand_in_the_prior_s_and_each_method_has_its_own():
    figure = laid_out(interval_plot(TABLE, {"fit": ("q05", "q95"), "chain": ("prior", "truth")}))
    (axes,) = figure.axes
    for method, columns in (("fit", ("q05", "q95")), ("chain", ("prior", "truth"))):
        bars = segments(axes, colour(figure, method))
        for y, row in enumerate(TABLE.to_dict("records")):
            (found,) = bars[np.round(bars[:, 0, 1]) == y][..., 0]
            wide = row["prior_q95"] - row["prior_q05"]
            expected = [(row[column] - row["prior_q05"]) / wide for column in columns]
            np.testing.assert_allclose(found, expected)


SPECTRA = pd.DataFrame({
    "wavelength_nm": np.arange(450.0, 1000.0, 10.0), "used": True,
    "real_mean": np.linspace(0.05, 0.4, 55), "simulated_mean": np.linspace(0.08, 0.5, 55) ** 1.1,
    "real_std": 0.01, "simulated_std": 0.03,
})  # fmt: skip


def test_spectra_and_their_difference_are_real_and_simulated():
    figure = laid_out(mean_spectra_plot(SPECTRA))
    top, below = figure.axes
    for side in ("real", "simulated"):
        (line,) = lines(top, colour(figure, side, top))
        np.testing.assert_allclose(line[1], SPECTRA[f"{side}_mean"])
    expected = SPECTRA["simulated_mean"] - SPECTRA["real_mean"]
    (line,) = [one.get_ydata() for one in below.lines if len(one.get_ydata()) == 55]
    np.testing.assert_allclose(line, expected)
    assert below.get_ylabel() == "Simulated − real"


def test_the_misfit_has_real_along_and_simulated_up():
    misfit = pd.DataFrame([{"region": "vnir", "gain": 1.2, "offset": 0.01, "level_percent": 50.0,
                            "contrast_percent": 30.0, "shape_percent": 20.0}])  # fmt: skip
    figure = laid_out(misfit_plot(SPECTRA, misfit))
    axes = figure.axes[0]
    assert axes.get_xlabel().startswith("Real")
    assert axes.get_ylabel().startswith("Simulated")
    dots = np.asarray(axes.collections[0].get_offsets())
    np.testing.assert_allclose(dots, SPECTRA[["real_mean", "simulated_mean"]])
    line = np.array(axes.lines[1].get_data())
    np.testing.assert_allclose(line[1], 0.01 + 1.2 * line[0])


def test_boxes_of_bands_and_the_sign_of_their_difference():
    quantiles = {5: 0.01, 25: 0.02, 50: 0.03, 75: 0.05, 95: 0.08}
    row = {f"real_p{p}": v for p, v in quantiles.items()}
    row |= {f"simulated_p{p}": 3.0 * v for p, v in quantiles.items()}
    row |= {"band": "red", "real_mean": 0.035, "simulated_mean": 0.105, "difference_percent": 20.0}
    figure = laid_out(band_box_plot(pd.DataFrame([row, row | {"difference_percent": -10.0}])))
    left, right = figure.axes
    for side, factor in (("real", 1.0), ("simulated", 3.0)):
        shown = colour(figure, side, left)
        box = next(p for p in left.patches if to_rgba(p.get_facecolor())[:3] == shown)
        heights = box.get_path().vertices[:, 1]
        assert (heights.min(), heights.max()) == pytest.approx((0.02 * factor, 0.05 * factor))
        levels = {round(v, 6) for one in lines(left, shown) for v in one[1]}
        assert {round(factor * v, 6) for v in quantiles.values()} <= levels
    assert [bar.get_height() for bar in right.patches] == [20.0, -10.0]
    assert right.get_ylabel() == "(simulated − real) / real [%]"


@pytest.mark.untyped
def test_percentiles_and_profiles_of_clouds_are_by_their_axes_and_sides():
    given = comparison()
    figure = laid_out(structure_figure(given))
    axes = panel(figure, "Percentiles")
    assert axes.get_xlabel().startswith("Real")
    assert axes.get_ylabel().startswith("Simulated")
    (dots,) = [np.array(one.get_data()) for one in axes.lines if one.get_marker() == "s"]
    np.testing.assert_allclose(dots, [given.real.percentiles, given.simulated.percentiles])
    axes, histogram = panel(figure, "Leaf area density, all"), panel(figure, "Heights")
    for side in ("real", "simulated"):
        shown = colour(figure, side)
        (line,) = lines(axes, shown)
        expected = [getattr(given, side).profile, [0.25, 0.75, 1.25, 1.75]]
        np.testing.assert_allclose(line, expected)
        (stairs,) = [p for p in histogram.patches if to_rgba(p.get_edgecolor())[:3] == shown
                     or to_rgba(p.get_facecolor())[:3] == shown]  # fmt: skip
        share, *_ = stairs.get_data()
        np.testing.assert_allclose(share, getattr(given, side).histogram / 0.25)
        value = given.sides[side].metrics["value"].iloc[0]
        assert value in {v for one in lines(figure.axes[0], shown) for v in one[1]}


def test_estimates_stand_over_the_field_with_their_intervals():
    table = pd.DataFrame({
        "predictor": "fit, wide", "quantity": "cover", "measured_share": [0.9, 0.1],
        "field": [0.2, 0.5], "estimate": [0.3, 0.8], "q025": [0.25, 0.6], "q975": [0.45, 0.95],
    })  # fmt: skip
    figure = laid_out(estimates_plot(
        table, {"cover": "Cover [-]"}, priors=["fit, wide"], regression="plsr", measured_share=0.5
    ))  # fmt: skip
    axes = panel(figure, "Cover [-]")
    dots = [np.array(one.get_data(), float) for one in axes.lines if one.get_marker() == "o"]
    np.testing.assert_allclose(np.concatenate(dots, axis=1), [[0.2, 0.5], [0.3, 0.8]])
    bars = np.concatenate([np.array(one.get_segments()) for one in axes.collections])
    np.testing.assert_allclose(bars[:, :, 1], [[0.25, 0.45], [0.6, 0.95]])
    assert figure.get_supxlabel() == "field"
    assert figure.get_supylabel() == "estimate, 95 %"
