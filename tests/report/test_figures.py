"""Figures show what they are given: right way up, sorted, labelled, and never failing on gaps."""

import itertools

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.legend import Legend
from matplotlib.text import Text

from fynjax.app.report.figures import (
    all_leaves_figure,
    composites,
    constraint_plot,
    convergence_plot,
    error_bars,
    layer_map,
    leaf_fit_figure,
    measured_figure,
    parameter_plot,
    pixel_histograms,
    plant_figure,
    recognition_plot,
    residual_maps,
    save_figure,
    side_view,
)
from fynjax.app.report.figures._style import AFTER, BEFORE, Figure, name_rows, style
from fynjax.canopy import Organ, PlantModel
from fynjax.canopy.mesh import MeshPlant
from fynjax.leaf import LeafOverBackground, fit_leaf, prospect
from fynjax.sensors.lidar import LidarReturns

BANDS = ("green", "red", "red_edge", "nir")


@pytest.fixture
def image():
    values = np.random.default_rng(0).uniform(0.02, 0.1, (4, 12, 12))
    values[3, 0, 0] = 0.9  # south-west: bright in the NIR
    return values


@pytest.fixture
def table():
    rng = np.random.default_rng(1)
    kinds = [("cover", "%"), ("diameter", "cm"), ("chlorophyll", "ug cm-2"), ("height", "m")]
    rows = [
        {"name": f"species.Genus epithet{k}.{kind}", "kind": kind, "unit": unit}
        for kind, unit in kinds
        for k in range(16)
    ]
    frame = pd.DataFrame(rows)
    frame["prior"] = rng.uniform(1, 10, len(frame))
    frame["prior_sd"] = 0.25 * frame["prior"]
    frame["estimate"] = frame["prior"] * rng.uniform(0.8, 1.2, len(frame))
    frame["constrained"] = rng.uniform(0, 1, len(frame))
    frame["sd"] = frame["prior_sd"] * np.sqrt(1 - frame["constrained"])
    for name, middle, sd in (("prior_", "prior", "prior_sd"), ("", "estimate", "sd")):
        frame[f"{name}q05"], frame[f"{name}q95"] = (
            frame[middle] + sign * 1.645 * frame[sd] for sign in (-1, 1)
        )
    return frame


def text_of(figure):
    figure.canvas.draw()
    return [t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")) if t.get_text()]


def test_composite_is_north_up_and_shares_its_stretch(image):
    figure = composites({"Before": image, "After": 0.5 * image}, BANDS, pixel_m=0.5)
    left, right = (axes.images[0] for axes in figure.axes)
    assert left.origin == "lower"
    assert list(left.get_extent()) == [0, 6, 0, 6]
    assert left.get_array()[0, 0, 0] == 1.0  # NIR shown as red, brightest in the south-west
    assert right.get_array()[..., 1].mean() < left.get_array()[..., 1].mean()
    said = " ".join(text_of(figure))
    assert "NIR, red, green" in said
    assert "percentile" in said
    assert "1 m" in said
    true_like = composites({"Image": image}, BANDS, pixel_m=0.5, kind="true_like")
    assert "blue, which the camera lacks" in " ".join(text_of(true_like))


def test_a_sensor_with_blue_is_shown_in_its_own_blue(image):
    """Of 425 bands none is lacking."""
    names = ("blue", *BANDS)
    image = np.concatenate([0.5 * image[:1], image])
    figure = composites({"Image": image}, names, pixel_m=0.5, kind="true_like")
    said = " ".join(text_of(figure))
    assert "lacks" not in said
    assert "True colour: red, green and blue are those of the sensor" in said
    shown = figure.axes[0].images[0].get_array()
    top = np.percentile(image[[2, 1, 0]], 99, axis=(1, 2)).max()
    np.testing.assert_allclose(shown[..., 2], np.sqrt(np.clip(image[0] / top, 0, 1)), rtol=1e-6)


def test_an_image_alone_is_as_large_as_two_and_its_caption_lies_inside(image):
    alone, two = (
        composites({str(n): image for n in range(count)}, BANDS, pixel_m=0.5, kind="true_like")
        for count in (1, 2)
    )
    for figure in (alone, two):
        assert 6.0 < figure.get_figwidth() < 9.4
        renderer = FigureCanvasAgg(figure).get_renderer()
        figure.draw(renderer)
        box = figure._supxlabel.get_window_extent(renderer)
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.width


def test_the_stretch_is_that_of_one_image(image):
    """One that is half as bright looks so, and one that is brighter does not darken the others."""
    images = {"Before": 0.5 * image, "Real": image, "After": 3.0 * image}
    for kind, name in (("true_like", "green"), ("false_colour", "red")):
        figure = composites(images, BANDS, pixel_m=0.5, kind=kind, stretch="Real")
        before, real, _ = (axes.images[0].get_array() for axes in figure.axes)
        (alone,) = composites({"Real": image}, BANDS, pixel_m=0.5, kind=kind).axes
        np.testing.assert_array_equal(real, alone.images[0].get_array())
        assert before.mean() < 0.8 * real.mean(), name
        if kind == "true_like":  # from zero on, by the square root
            inside = (real > 0.0) & (real < 1.0)
            np.testing.assert_allclose(before[inside], 0.5**0.5 * real[inside], rtol=1e-6)
        assert "of “Real”" in " ".join(text_of(figure))
    layers = {title: each[3] for title, each in images.items()}
    figure = layer_map(layers, "NIR", pixel_m=0.5, stretch="Real")
    limits = {axes.images[0].get_clim() for axes in figure.axes[:3]}
    assert limits == {tuple(np.percentile(image[3], [1, 99]))}


def test_images_of_other_pixels_and_sizes_have_one_scale_of_length(image):
    """The smaller in the middle."""
    images = {"Real": image, "Before": image[:, ::2, ::3]}
    pixels = {"Real": 0.5, "Before": 0.6}
    for figure in (
        composites(images, BANDS, pixel_m=pixels),
        layer_map({title: each[0] for title, each in images.items()}, "x", pixel_m=pixels),
    ):
        real, before = figure.axes[:2]
        assert real.get_xlim() == before.get_xlim() == (0.0, 6.0)
        assert real.get_ylim() == before.get_ylim() == (0.0, 6.0)
        assert real.images[0].get_extent() == [0, 6, 0, 6]
        np.testing.assert_allclose(before.images[0].get_extent(), [1.8, 4.2, 1.2, 4.8])


def test_residuals_before_and_after_share_the_scale_of_their_band(image):
    figure = residual_maps({"Before": -image, "After": 0.1 * image}, BANDS, pixel_m=0.5)
    maps = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title(loc="left") for axes in maps[:2]] == ["Before, green", "Before, red"]
    for k in range(4):
        before, after = (maps[row * 4 + k].images[0] for row in (0, 1))
        most = np.percentile(np.abs([image[k], 0.1 * image[k]]), 99)
        assert before.get_clim() == after.get_clim() == pytest.approx((-most, most))
        np.testing.assert_array_equal(after.get_array(), 0.1 * image[k])


def test_an_image_that_was_not_calibrated_is_not_called_before():
    values = {"NDVI": np.linspace(0.2, 0.8, 50)}
    assert "before" not in text_of(pixel_histograms({"simulated": values}))
    real = text_of(pixel_histograms({"simulated": values}, target={"NDVI": (0.5, 0.1)}))
    assert "simulated" in real
    assert "before" not in real
    two = pixel_histograms({"before": values, "after": values})
    assert {"before", "after"} <= set(text_of(two))


def test_histograms_of_the_real_image_lie_over_those_of_the_simulations():
    values = np.linspace(0.2, 0.4, 500)
    every = {who: {"nir": values + k} for k, who in enumerate(("real", "before", "after"))}
    figure = pixel_histograms(every, {"nir": (0.25, 0.01)}, what="Reflectance [-]")
    (axes,) = figure.axes
    found = [patch.get_data() for patch in axes.patches if hasattr(patch, "get_data")]
    for k, (height, edges, _) in enumerate(found):
        middle = 0.5 * (edges[1:] + edges[:-1])
        assert middle @ height / height.sum() == pytest.approx(0.3 + k, abs=0.02)
    # The means of the simulations, and what is stated of the real one.
    assert [line.get_xdata()[0] for line in axes.lines] == pytest.approx([1.3, 2.3, 0.25])
    assert axes.get_title(loc="left") == "NIR"
    assert {"real", "before", "after", "Reflectance [-]; height is the density of pixels"} <= set(
        text_of(figure)
    )


def test_species_stand_in_one_order_in_panels_with_units(table):
    """In both figures and all panels; the one of which a parameter moved farthest first."""
    moved = table.index[table["name"] == "species.Genus epithet7.height"]
    table.loc[moved, "estimate"] = table.loc[moved, "prior_q95"]
    figure = parameter_plot(table)
    assert len(figure.axes) == 4
    by_title = {axes.get_title(loc="left"): axes for axes in figure.axes}
    assert "Chlorophyll [µg cm⁻²]" in by_title
    axes = by_title["Cover [%]"]
    every = [*figure.axes, *constraint_plot(table).axes]
    labels = {tuple(label.get_text() for label in one.get_yticklabels()) for one in every}
    (order,) = labels
    wide = table["prior_q95"] - table["prior_q05"]
    far = ((table["estimate"] - table["prior"]).abs() / wide).groupby(
        table["name"].str.split(".").str[1]
    )
    assert list(order) == list(far.max().sort_values(ascending=False).index)
    assert order[0] == "Genus epithet7"
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # largest on top


def test_constraint_bars_are_percent(table):
    table.loc[0, "constrained"] = 0.004
    figure = constraint_plot(table[table["kind"] == "cover"])
    bars = [
        p.get_width() for p in figure.axes[0].patches if p.get_facecolor()[:3] < (0.9, 0.9, 0.9)
    ]
    expected = 100 * table[table["kind"] == "cover"]["constrained"]
    np.testing.assert_allclose(sorted(bars), sorted(expected))
    assert "<1" in text_of(figure)


def test_no_labels_overlap_with_64_parameters(table):
    figure = parameter_plot(table)
    figure.canvas.draw()
    for axes in figure.axes:
        boxes = [label.get_window_extent() for label in axes.get_yticklabels()]
        assert not any(a.overlaps(b) for a, b in itertools.pairwise(boxes))
        assert all(box.x0 >= 0 for box in boxes)


def test_errors_are_absolute_cut_and_may_be_missing():
    means = {
        "before": {"nir": -30.0, "NDVI": 250.0},
        "after": {"nir": 1.0, "NDVI": float("nan")},
        "DIRSIG (paper)": {"nir": 22.19},
    }
    spreads = {"before": {"NDVI": 50.0}, "with gains": {"NDVI": -20.0}}
    figure = error_bars({"Means": means, "Spreads": spreads})
    axes, below = figure.axes
    widths = [bar.get_width() for container in axes.containers for bar in container]
    np.testing.assert_allclose(widths, [30, 100, 1, np.nan, 22.19, np.nan])
    assert axes.get_xlim()[1] == pytest.approx(110)
    assert "→ 250" in text_of(figure)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["NIR", "NDVI"]
    # Spreads in a panel of their own, with a scale and with colours for the same simulations.
    assert [one.get_title(loc="left") for one in figure.axes] == ["Means", "Spreads"]
    assert below.get_xlim()[1] == pytest.approx(55)
    colour = [
        {bars.get_label(): bars[0].get_facecolor() for bars in one.containers}
        for one in figure.axes
    ]
    assert colour[0]["before"] == colour[1]["before"] == to_rgba(BEFORE)
    assert colour[0]["after"] == to_rgba(AFTER)
    assert len({*colour[0].values(), *colour[1].values()}) == 4
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*means, "with gains"]


def test_gaps_and_edges_do_not_break_a_figure(tmp_path, image):
    image[:, 3, 3] = np.nan
    flat = np.full((4, 5, 5), 0.1)
    save_figure(composites({"a": image}, BANDS, pixel_m=0.025), tmp_path / "a.png")
    save_figure(composites({"a": flat}, BANDS, pixel_m=0.025), tmp_path / "b.png")
    nothing = np.array([np.nan, np.inf])
    figure = pixel_histograms(
        {"before": {"NDVI": nothing, "SR": np.ones(5)}},
        target={"NDVI": (0.7, np.nan), "SR": (7.6, 3.0)},
    )
    save_figure(figure, tmp_path / "c.png")
    save_figure(convergence_plot([3.0]), tmp_path / "d.png")
    save_figure(convergence_plot([3.0, np.nan, -1.0], [1.0, 0.0, 0.0]), tmp_path / "e.png")
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{c}.png" for c in "abcde"]


def test_a_curve_of_the_objective_breaks_where_a_round_begins():
    """Along the steps done; a round begins where the one before ended."""
    figure = convergence_plot([9.0, 4.0, 3.0, 7.0, 5.0], rounds=[1, 1, 1, 2, 2])
    (axes,) = figure.axes
    first, second, mark = (line.get_xdata() for line in sorted_lines(axes))
    assert first.tolist() == [0, 1, 2]
    assert second.tolist() == [2, 3]
    assert set(mark) == {2}
    assert any(text.get_text() == "round 2" for text in axes.texts)


def sorted_lines(axes):
    """Curves, then marks."""
    return sorted(axes.lines, key=lambda line: line.get_linestyle() == ":")


def test_histogram_is_a_density_with_the_target_inside():
    rng = np.random.default_rng(0)
    values = rng.normal(0.5, 0.1, 20000)
    figure = pixel_histograms(
        {"before": {"NDVI": values}, "after": {"NDVI": values + 0.1}}, {"NDVI": (0.95, 0.05)}
    )
    axes = figure.axes[0]
    low, high = axes.get_xlim()
    assert low < 0.3
    assert high > 1.0
    heights, edges, _ = axes.patches[0].get_data()
    assert heights @ np.diff(edges) == pytest.approx(1, abs=0.01)


def assert_titles_and_legends_lie_inside(figure):
    FigureCanvasAgg(figure).draw()
    legends = [legend for part in (figure, *figure.axes) for legend in part.findobj(Legend)]
    titles = [axes.title for axes in figure.axes] + [axes._left_title for axes in figure.axes]
    texts = [*figure.texts, *titles, *(t for legend in legends for t in legend.get_texts())]
    texts = [text for text in texts if text.get_text()]
    assert texts
    for text in texts:
        box = text.get_window_extent()
        assert box.x0 >= -1, text.get_text()
        assert box.x1 <= figure.bbox.x1 + 1, text.get_text()


def returns(position):
    """Returns at these places, some of them of the ground."""
    number = np.arange(len(position))
    kind = np.random.default_rng(2).integers(2, 4, len(position))
    even = np.ones(len(position))
    return LidarReturns(number, position, *[even] * 3, number, number, kind, even, even, 0 * number)


@pytest.mark.parametrize(("extent", "count"), [((4.0, 4.0), 5000), ((30.0, 10.0), 40)])
def test_a_cloud_fills_its_figure_and_its_title_is_whole(extent, count):
    rng = np.random.default_rng(2)
    position = rng.uniform(0.0, 1.0, (count, 3)) * (*extent, 1.5)
    figure = side_view(
        returns(position), position[:, 2], extent, title="Grootbos, burnt 2006, flash_lidar_paper"
    )
    assert_titles_and_legends_lie_inside(figure)
    side, above = (axes.get_position() for axes in figure.axes[:2])
    assert min(side.width, above.width) > 0.65


def test_one_false_return_high_above_does_not_leave_a_cloud_s_figure_empty():
    rng = np.random.default_rng(2)
    position = rng.uniform(0.0, 1.0, (5000, 3)) * (10.0, 10.0, 1.5)
    heights = []
    for false in (1.0, 9.0):
        position[0] = 0.5, 0.5, false  # far from the strip that is shown from the side
        heights.append(side_view(returns(position), position[:, 2], (10.0, 10.0)).get_figheight())
    assert heights[1] == pytest.approx(heights[0])


@pytest.mark.parametrize("leaves", [1, 5])
@pytest.mark.parametrize("estimated", [(), ("gap_fraction",)])
def test_the_legend_of_leaves_is_whole(leaves, estimated):
    gap = None if estimated else 0.0
    measurement = LeafOverBackground(gap_fraction=gap)
    r, t = prospect(chlorophyll=np.linspace(20.0, 60.0, leaves))
    fit = fit_leaf(range(400, 2501), r, t, measurement=measurement)
    assert fit.estimated == estimated
    figure = leaf_fit_figure(fit)
    assert_titles_and_legends_lie_inside(figure)
    assert ("1 - T of model, with gaps" in shown_labels(figure)) == bool(estimated)


def test_all_leaves_are_drawn_with_those_in_doubt_named():
    """Two of 14 leaves are no leaves; of one transmittance alone was measured."""
    r, t = (np.array(x) for x in prospect(chlorophyll=np.linspace(20.0, 60.0, 14)))
    r[3], r[8] = 0.5, np.linspace(0.0, 0.9, r.shape[1])
    r[5] = np.nan
    fit = fit_leaf(range(400, 2501), r, t)
    doubtful = [i for i, status in enumerate(fit.status) if status != "converged"]
    assert {3, 8} <= set(doubtful)
    figure = all_leaves_figure(fit)
    seen = figure.axes[0]
    drawn = [len(lines.get_segments()) for lines in seen.collections]
    assert drawn == [14 - len(doubtful), len(doubtful)]
    where = seen.collections[0].get_segments()[4]  # the sixth leaf, after one in doubt
    at = np.argmin(abs(fit.wavelength - 800.0))
    assert where[at, 1] == pytest.approx(1.0 - t[5, 400], abs=1e-3)
    named = ", ".join(fit.labels[i] for i in doubtful)
    assert shown_labels(figure) == [
        f"{14 - len(doubtful)} fitted without doubt",
        f"in doubt: {named}",
    ]
    assert_titles_and_legends_lie_inside(figure)


def test_a_spectrum_s_noise_in_the_bands_of_water_does_not_flatten_the_others():
    """Of 30 spectra of R and T the first ones are named."""
    r, t = (np.asarray(x) for x in prospect(chlorophyll=np.linspace(20.0, 60.0, 30)))
    spectra = xr.Dataset(
        {"reflectance": (("spectrum", "wavelength"), r.copy()),
         "transmittance": (("spectrum", "wavelength"), t)},
        {"spectrum": [f"leaf {k}" for k in range(30)], "wavelength": np.arange(400.0, 2501.0)},
    )  # fmt: skip
    spectra["reflectance"][4, 1450:1460] = 300.0
    figure = measured_figure(spectra)
    (axes,) = figure.axes
    assert axes.get_ylim()[1] < 1.1
    assert [len(lines.get_segments()) for lines in axes.collections] == [30, 30]
    whole = axes.collections[1].get_segments()[7]
    np.testing.assert_allclose(whole[:, 1], 1.0 - t[7])
    assert len(shown_labels(figure)) == 11
    assert_titles_and_legends_lie_inside(figure)


def shown_labels(figure):
    """Texts of a figure's legends."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_numbers_below_a_slender_plant_do_not_overlap():
    rng = np.random.default_rng(0)
    position = rng.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0), (200, 3))
    whole = np.zeros(200, int)
    shape = (position, np.full(200, 1 / 200), rng.normal(size=(200, 3)), whole)
    plant = MeshPlant(
        PlantModel(*map(jnp.asarray, shape)), 0.15, 0.15, 1.78, jnp.full(len(Organ), 1e-4),
        jnp.asarray(whole), ("leaf",), ("leaf",), (0.0,),
    )  # fmt: skip
    figure = plant_figure(plant)
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        low, high = axes.get_xlim()
        shown = [t for t, at in zip(axes.get_xticklabels(), axes.get_xticks()) if low <= at <= high]
        boxes = [label.get_window_extent() for label in shown]
        assert len(boxes) > 1
        assert not any(a.overlaps(b) for a, b in itertools.pairwise(boxes))


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_names_with_dollars_are_text_wherever_they_stand(tmp_path, kind):
    """A title, the names of rows, and those along an axis that are made when it is drawn."""
    name = r"Erica $\frac{ and $x$ 5$"
    with style():
        figure = Figure(figsize=(4.0, 3.0))
        axes = figure.subplots()
        if kind == 0:
            name_rows(axes, [name, name])
        elif kind == 1:
            axes.bar([name, "Restio"], [1.0, 2.0])
        else:
            axes.loglog([0.02, 3000.0], [1e-6, 1e6])
        axes.set_title(name)
        figure.legend(*axes.get_legend_handles_labels(), title=name)
    save_figure(figure, tmp_path / "a.png")
    save_figure(figure, tmp_path / "a.svg")  # which has text by its letters' outlines
    assert axes.get_title(loc="left") == name
    shown = [text for text in figure.findobj(Text) if "$" in text.get_text()]
    assert len(shown) >= 2 + (kind == 1) + 2 * (kind == 0)
    assert not any(text.get_parse_math() for text in shown)
    if kind == 2:
        numbers = [float(t.get_text()) for t in axes.get_yticklabels() if t.get_text()]
        assert {1e-6, 1.0, 1e6} & set(numbers)
        ticks = [float(t.get_text()) for t in axes.get_xticklabels() if t.get_text()]
        assert {0.1, 1.0, 10.0, 100.0, 1000.0} <= set(ticks)


def test_a_notebook_shows_figures_by_themselves():
    """Also the first one, before pyplot has told it how."""
    line = {"sensor": "a", "noise": 0.0, "pixel_m": 1.0, "accuracy": 0.5, "q05": 0.4, "q95": 0.6}
    table = pd.DataFrame([line | {"by_chance": 0.1, "species": 2.0}])
    assert recognition_plot(table)._repr_png_().startswith(b"\x89PNG")
