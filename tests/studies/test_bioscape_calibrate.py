"""`fynjax bioscape calibrate`: estimates of a plot, by hand; and a plot that comes back."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.plot import read_plot
from fynjax.inversion import (
    Data,
    LogPosterior,
    SpectrumView,
    predicted_statistics,
    spectrum_view,
    statistics_and_jacobian,
    weigh_spectrum,
)
from fynjax.scene import stand_area
from fynjax.sensors import BandSet
from fynjax.studies.bioscape import read_bioscape, write_plot_files
from fynjax.studies.bioscape._assumed import MOST_WATER
from fynjax.studies.bioscape._calibrate import calibrate_plots
from fynjax.studies.bioscape._inversion import (
    FREE,
    QUANTITIES,
    ROOM,
    SOFTNESS,
    PlotCase,
    PlotEstimate,
    PlotSpectrumForward,
    ReferencePlot,
    bias_corrected_data,
    flight_covariance,
    infer_plot,
    prior_space,
    quantity,
)
from fynjax.studies.bioscape._inversion_compare import (
    TABLES_PRIOR,
    agreement,
    estimate_table,
    field_values,
    others,
    shift_table,
)
from fynjax.studies.bioscape._plot_files import beyond_prospect
from fynjax.studies.bioscape._scenes import ACCURACY, Resolution, build_scenes, slots_of
from tests.helpers import stand_in
from tests.scene.plots import small_parameters
from tests.studies.test_bioscape_validate import write_tables


@pytest.fixture(scope="module")
def plots(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("tables")
    write_tables(folder)
    return read_bioscape(folder)


def test_at_one_a_plot_is_what_its_tables_say(plots):
    for plot in plots:
        reference = ReferencePlot(plot)
        assert quantity(reference, "live_cover", 1.0) == pytest.approx(100 * plot.live)
        mass, water = (plot.weighted_mean(t) for t in ("leaf_mass_per_area", "water_content"))
        assert quantity(reference, "leaf_mass_per_area", 1.0) == pytest.approx(mass)
        planted = quantity(reference, "water_content", 1.0)
        cut = any(beyond_prospect(s) for s in plot.species)  # the succulent of B2
        assert planted < water if cut else planted == pytest.approx(water)
        assert reference.factor(reference.live(0.8)) == pytest.approx(0.8)
        # Twice the water of a leaf that holds half of its mass: two thirds.
        species = replace(
            plot.species[0],
            traits=plot.species[0].traits
            | {"water_content": replace(plot.species[0].traits["water_content"], value=50.0)},
        )
        alone = ReferencePlot(replace(plot, species=(species,)))
        assert quantity(alone, "water_content", 2.0) == pytest.approx(200.0 / 3.0)


def test_water_is_that_of_leaves_as_planted(plots):
    """A succulent leaf of 900 g m-2, nine tenths water, holds more than PROSPECT can mean."""
    species = plots[0].species[0]
    thick = {"leaf_mass_per_area": 900.0, "water_content": 90.0}
    traits = {name: replace(species.traits[name], value=value) for name, value in thick.items()}
    plot = replace(plots[0], species=(replace(species, traits=species.traits | traits),))
    dry = 0.09 / species.shape.area_ratio
    assert 9 * dry > MOST_WATER
    held = 100 * MOST_WATER / (MOST_WATER + dry)
    assert quantity(ReferencePlot(plot), "water_content", 1.0) == pytest.approx(held)


def test_dead_tissue_is_at_most_all_of_a_shoot(plots):
    """At twice the dead tissue, a species with 0.8 of it has 1."""
    parameters = small_parameters()
    species = replace(parameters.species, dead_fraction=jnp.array([0.8, 0.3, 0.0]))
    factors = dict.fromkeys(FREE, 1.0) | {"dead_fraction": 2.0}
    forward = PlotSpectrumForward(stand_in(SpectrumView), (False, False, True))
    moved = forward._plot(jnp.array(list(factors.values())), replace(parameters, species=species))
    np.testing.assert_allclose(moved.species.dead_fraction, [1.0, 0.6, 0.0])


def test_factors_on_leaves_multiply_what_the_tables_say():
    """Water follows dry matter and its own factor; other parameters stay."""
    parameters = small_parameters()
    factors = dict.fromkeys(FREE, 1.0) | {"leaf_mass_per_area": 2.0, "water_per_dry_matter": 1.5}
    forward = PlotSpectrumForward(stand_in(SpectrumView), (False, False, True))
    moved = forward._plot(jnp.array(list(factors.values())), parameters).leaf
    for name, factor in (("dry_matter", 2.0), ("water", 3.0), ("chlorophyll", 1.0)):
        before, after = getattr(parameters.leaf, name), getattr(moved, name)
        np.testing.assert_allclose(after, factor * before, rtol=1e-6)


def test_other_plots_as_prior_are_as_wide_as_they_differ(plots):
    known = {"leaf_mass_per_area": (250.0, 50.0), "water_content": (55.0, 3.0)}
    known["live_cover"] = (70.0, 8.0)
    plot = plots[0]
    for name, (mean, sd) in known.items():
        if name != "live_cover":
            same = tuple(
                replace(s, traits=s.traits | {name: replace(s.traits[name], value=mean)})
                for s in plot.species
            )
            plot = replace(plot, species=same)
        space = prior_space(plot, {name: (mean, sd)})
        i = space.names.index(QUANTITIES[name][0])
        reference = ReferencePlot(plot)
        at = [
            quantity(reference, name, float(space.physical(jnp.full(len(space.names), u))[i]))
            for u in (-0.1, 0.0, 0.1)
        ]
        assert at[1] == pytest.approx(mean, rel=1e-6)
        assert (at[2] - at[0]) / 0.2 == pytest.approx(sd, rel=0.1), name


def test_flights_differ_by_their_pooled_covariance():
    random = np.random.default_rng(0)
    first, second = random.normal(size=(2, 5, 3))
    pooled = (np.cov(first, rowvar=False) + np.cov(second, rowvar=False)) / 2
    np.testing.assert_allclose(flight_covariance([first, second, first[:1]]), pooled)
    assert flight_covariance([first[:1]]) is None


def test_the_bias_correction_is_the_mean_error_of_other_plots_and_its_spread():
    random = np.random.default_rng(2)
    residuals = 0.05 + 0.01 * random.normal(size=(400, 2)) @ np.array([[1.0, 1.0], [0.0, 1.0]])
    data, mean = bias_corrected_data(("a", "b"), np.array([[0.1, 0.2], [0.3, 0.4]]), residuals)
    np.testing.assert_allclose(data.value, [0.2, 0.3])
    np.testing.assert_allclose(mean, residuals.mean(axis=0))
    covariance = np.linalg.inv(np.asarray(data.whitener.T @ data.whitener))
    # Half of the correlation is kept.
    np.testing.assert_allclose(covariance, 1e-4 * np.array([[1.0, 0.5], [0.5, 2.0]]), rtol=0.2)


def test_the_mean_and_spread_of_other_plots_leave_one_out():
    mean, sd = others(np.array([1.0, 3.0, 5.0, 9.0]))
    np.testing.assert_allclose(mean, [17 / 3, 5.0, 13 / 3, 3.0])
    assert sd[3] == pytest.approx(2.0)


def test_the_field_counts_what_was_measured(plots):
    plot = plots[0]
    field = field_values([plot])
    kept = [
        (s.cover, s.traits["leaf_mass_per_area"].value)
        for s in plot.species
        if s.traits["leaf_mass_per_area"].source == "measured"
    ]
    total = sum(c for c, _ in kept)
    expected = sum(c * v for c, v in kept) / total if kept else np.nan
    assert field.value["leaf_mass_per_area"][0] == pytest.approx(expected, nan_ok=True)
    assert field.share["leaf_mass_per_area"][0] == pytest.approx(total / plot.listed_cover)


def test_intervals_and_scores_by_hand(plots):
    space = prior_space(plots[0])
    covariance = np.eye(len(space.names)) * 0.04
    blank = np.zeros(2)
    slope = np.zeros((3, len(space.names)))
    slope[0, :2], slope[2, 0] = (0.3, 0.4), 50.0
    one = PlotEstimate(
        space, np.zeros(len(space.names)), covariance, blank, blank, (1.0, 1.0), True,
        np.array([2.0, 0.5, 40.0]), slope,
    )  # fmt: skip
    table = estimate_table(
        plots[:1], "x", [ReferencePlot(plots[0])], [one], field_values(plots[:1])
    )
    row = table[table["quantity"] == "leaf_mass_per_area"].iloc[0]
    mean = plots[0].weighted_mean("leaf_mass_per_area")
    assert row["estimate"] == pytest.approx(mean, rel=0.01)
    assert row["sd"] == pytest.approx(0.3 * 0.2 * mean, rel=0.05)
    assert row["constrained"] == pytest.approx(0.96)
    assert row["verdict"] == ""
    of = table.set_index("quantity")
    # Live, dead and bare cover are those of the tables, and all of a plot.
    covers = of.loc[["live_cover", "dead_cover", "bare_cover"], "prior"]
    noted = [100 * v for v in (plots[0].live, plots[0].dead, plots[0].soil + plots[0].rock)]
    np.testing.assert_allclose(covers, noted)
    assert covers.sum() == pytest.approx(100.0)
    # Of the scene: linear in the parameters, and within what is possible.
    assert of.loc["leaf_area_index", "sd"] == pytest.approx(0.2 * np.hypot(0.3, 0.4), rel=0.05)
    assert of.loc["leaf_area_index", "constrained"] == pytest.approx(0.96)
    assert of.loc["dead_fraction", "verdict"] == "not constrained"  # nothing moves it
    scored = pd.DataFrame(
        {"plot": list("abc"), "predictor": "x", "quantity": "live_cover", "field": [1.0, 2.0, 3.0],
         "measured_share": [1.0, 1.0, 0.5], "estimate": [2.0, 3.0, 4.0],
         "q025": [1.5, 1.0, 2.0], "q975": [2.5, 4.0, 5.0], "q05": [1.6, 2.1, 2.0],
         "q95": [2.4, 4.0, 5.0], "constrained": 0.5}
    )  # fmt: skip
    every, known = agreement(scored).to_dict("records")
    assert every["bias"] == every["rmse"] == every["correlation"] == pytest.approx(1.0)
    assert every["inside_95"] == pytest.approx(2 / 3)
    assert every["inside_90"] == pytest.approx(1 / 3)
    assert known["count"] == 2


def test_a_shift_that_plots_share_differs_from_one_they_do_not():
    parameters = pd.DataFrame(
        {"plot": list("abcd") * 2, "predictor": "x", "parameter": ["cover"] * 4 + ["litter"] * 4,
         "shift": [1.0, 1.1, 0.9, 1.0, -1.0, 1.0, -1.0, 1.0], "constrained": 0.1}
    )  # fmt: skip
    table = shift_table(parameters).set_index("parameter")
    assert table.loc["cover", "mean_over_error"] > 20
    assert abs(table.loc["litter", "mean_over_error"]) < 1e-9


def test_priors_change_and_nothing_compiles_again(plots):
    def predict(values, scale):
        predict.traced += 1
        return values[:2] * scale

    predict.traced = 0
    first = prior_space(plots[0])
    second = eqx.tree_at(lambda space: space.location, first, first.location - 0.1)
    u = jnp.full(len(FREE), 0.3)
    data = Data(("a", "b"), jnp.zeros(2), jnp.ones(2))
    density = LogPosterior(predict, first, data, jnp.zeros(2), (2.0,))
    predicted_statistics(density, u)
    traced = predict.traced
    np.testing.assert_allclose(
        predicted_statistics(replace(density, space=second), u), 2.0 * second.physical(u)[:2]
    )
    assert predict.traced == traced


def test_without_spectra_there_is_nothing_to_learn(tmp_path: Path):
    write_tables(tmp_path / "tables", measured=False)
    with pytest.raises(InputError, match="measured spectrum"):
        calibrate_plots(tmp_path / "tables", tmp_path, checkpoint=tmp_path / "c")


@pytest.mark.study
def test_a_plot_comes_back_from_its_own_spectrum(tmp_path: Path, plots):
    """A twin: another planting with other cover, traits and soil. The truth lies within what the
    posterior leaves, and the slopes are those of differences."""
    plot = plots[0]
    write_plot_files(plot, tmp_path)
    file = read_plot(tmp_path / "plot.toml")
    centre = (560.0, 670.0, 720.0, 860.0, 1240.0, 1650.0, 2200.0)
    bands = BandSet(tuple(f"{c:.0f}" for c in centre), centre, (6.0,) * len(centre))
    slots = slots_of([file])
    seeds = [0, 1, 2, 3, 9]
    scenes = build_scenes(
        [file] * len(seeds), Resolution(6.0, 0.5), seeds, room=ROOM, softness=SOFTNESS
    )
    # The spectrum is that of whole plants; the search is on plants that fade, as the command's.
    models, parameters = [m.expected() for m, _ in scenes], scenes[0][1]
    view = spectrum_view(bands, *scenes[0], ACCURACY)
    predict = PlotSpectrumForward(view, tuple(s == "deadwood" for s in slots))
    space = prior_space(plot)
    at = dict.fromkeys(FREE, 0.0) | {
        "leaf_mass_per_area": 1.0, "water_per_dry_matter": -1.0, "chlorophyll": -1.5,
    }  # fmt: skip
    truth = jnp.asarray(list(at.values()))
    zero = jnp.zeros(len(centre))
    blank = Data(view.names, zero, zero + 1, jnp.eye(len(centre)))  # as `weigh_spectrum` has it
    density = LogPosterior(predict, space, blank, zero, (scenes[-1][0], parameters))
    spectrum = np.asarray(predicted_statistics(density, truth))
    data = weigh_spectrum(view.names, spectrum, 0.01, gain=0.0, offset=1e-4)
    case = PlotCase(data, space, parameters, tuple(models[:-1]))
    estimate = PlotEstimate.of(space, infer_plot(case, predict))
    assert estimate.converged
    assert estimate.misfit[1] < 0.5 * estimate.misfit[0]
    off = (estimate.whitened - np.asarray(truth)) / np.sqrt(np.diagonal(estimate.covariance))
    print(dict(zip(FREE, off.round(2))), estimate.misfit)
    assert np.abs(off).max() < 3.0
    known = dict(zip(FREE, estimate.constrained))
    assert known["chlorophyll"] > 0.55
    assert abs(estimate.whitened[list(FREE).index("chlorophyll")] + 1.5) < 0.7

    # The stand is that of `build` at the estimate, and its slopes those of differences.
    def stand_at(u):
        values = space.physical(jnp.asarray(u))
        return np.asarray(predict.stand(values, models[0], parameters))

    areas = stand_area(models[0], predict._plot(space.physical(estimate.whitened), parameters))
    expected = [areas.leaf.sum(), areas.dead.sum() / (areas.leaf + areas.dead).sum()]
    np.testing.assert_allclose(estimate.stand, [*expected, 100.0 * areas.gap], rtol=1e-4)
    along = np.cos(np.arange(len(FREE)))
    ends = [stand_at(estimate.whitened + step * along) for step in (0.02, -0.02)]
    # A plant that begins to fade in between the two ends bends the gap by some per cent.
    np.testing.assert_allclose(estimate.stand_slope @ along, (ends[0] - ends[1]) / 0.04, rtol=0.05)

    u = truth * 0.5
    density = replace(density, data=data, context=(models[0], parameters))
    value, slope = statistics_and_jacobian(density, u)
    np.testing.assert_allclose(value, predicted_statistics(density, u), rtol=1e-5)
    weights = np.cos(np.arange(len(centre)))
    for name in ("cover", "water_per_dry_matter", "soil_brightness", "leaf_area_index"):
        step = 0.02 * jnp.eye(len(FREE))[list(FREE).index(name)]
        ends = [weights @ np.asarray(predicted_statistics(density, u + s * step)) for s in (1, -1)]
        expected = (ends[0] - ends[1]) / 0.04
        ours = weights @ np.asarray(slope)[:, list(FREE).index(name)]
        assert ours == pytest.approx(expected, rel=0.02, abs=2e-5), name


class Straight(PlotSpectrumForward):
    """A spectrum without light, nearly linear."""

    def __call__(self, values, scene, parameters):
        bands, free = len(self.view.names), values.size
        slopes = jnp.cos(jnp.arange(bands)[:, None] * (1.0 + jnp.arange(free)))
        return 0.2 + 0.05 * slopes @ jnp.tanh(values - 1.0)

    def jacobian(self, values_at, u, scene, parameters):
        at = lambda u: self(values_at(u), scene, parameters)  # noqa: E731
        return at(u), jax.jacfwd(at)(u)

    def stand(self, values, scene, parameters):
        return values[:3]


@pytest.mark.parametrize(
    "forward", [Straight, pytest.param(PlotSpectrumForward, marks=pytest.mark.study)]
)
def test_one_plot_alone_goes_on_from_its_checkpoint(tmp_path: Path, monkeypatch, forward):
    """Without other plots there is one prior; a second run takes the fits of the first."""
    monkeypatch.setattr("fynjax.studies.bioscape._calibrate.PlotSpectrumForward", forward)
    write_tables(tmp_path / "tables")
    kept = tmp_path / "kept"
    options = {"resolution": Resolution(2.0, 0.25), "checkpoint": kept}
    results = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        results.append(calibrate_plots(tmp_path / "tables", tmp_path / name, **options))
        assert all((tmp_path / name / file).stat().st_size for file in results[-1].files)
        times = {p.name: p.stat().st_mtime_ns for p in kept.iterdir()}
        if name == "first":
            before = times
    assert before == times
    assert results[0].plots == ["A1"]
    assert "B2" in results[0].warnings[-1]
    first, second = (pd.read_csv(tmp_path / n / "estimates.csv") for n in ("first", "second"))
    pd.testing.assert_frame_equal(first, second)
    assert results[0].converged
    spectra = pd.read_csv(tmp_path / "first" / "spectra.csv")
    before, after = (
        np.sqrt(np.mean((spectra[name] - spectra["measured"]) ** 2))
        for name in ("tables_alone", "the_plot's_tables_as_prior")
    )
    assert after < 0.7 * before
    said = results[0].headline
    assert (
        f"root mean square {before:.4f} before, by the tables alone, {after:.4f} after" in said[0]
    )
    field = first[np.isfinite(first["field"]) & (first["predictor"] == TABLES_PRIOR)]
    assert len(field) == len(said) - 1
    for line, (_, row) in zip(said[1:], field.iterrows(), strict=True):
        errors = [abs(row[name] - row["field"]) for name in ("prior", "estimate")]
        assert f"RMSE {round(errors[0], 6):.3g} before, {errors[1]:.3g} " in line
    with pytest.raises(InputError, match="another run"):
        calibrate_plots(tmp_path / "tables", tmp_path / "first", **(options | {"seed": 1}))
