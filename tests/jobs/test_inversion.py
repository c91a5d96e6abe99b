"""Results of the jobs on posteriors, sensitivities and bounds, and one of each on a tiny plot."""

import re
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from fynjax import jobs
from fynjax._core.errors import InputError
from fynjax.app.assembly import image_view, plot_problem
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs._information import _limit_sentences, limit_table, plot_information
from fynjax.app.jobs._posterior import _headline, posterior
from fynjax.app.jobs._sensitivity import _headline as sensitivity_headline
from fynjax.app.jobs._sensitivity import sensitivity
from fynjax.app.report.figures._posterior import (
    bound_plot,
    corner_plot,
    indices_plot,
    predictive_plot,
    tornado_plot,
)
from fynjax.inversion import PlotForward, Posterior, search_form
from fynjax.inversion._sensitivity import local_sensitivity
from tests.heard import hearing
from tests.helpers import stand_in
from tests.small import write_plot

MORE = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.*.cover", "ground.brightness"]
max_iterations = 2
"""
TARGET = "statistic,value,sd\nred.mean,0.06,0.002\nnir.mean,0.22,0.005\nNDVI.std,0.2,0.05\n"


@pytest.fixture(scope="module")
def plot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plot")
    write_plot(folder, MORE)
    (folder / "target.csv").write_text(TARGET)
    return folder / "plot.toml"


def bounds(values):
    """A table of bounds on one cover of 10 % for pixels of 0.1, 1 and 5 m."""
    rows = [
        {"parameter": "species.A.cover", "bands": 4, "noise": 0.01, "sun_zenith": 30.0,
         "gsd_m": gsd, "bound": bound, "value": 10.0}
        for gsd, bound in zip((0.1, 1.0, 5.0), values)
    ]  # fmt: skip
    return pd.DataFrame(rows)


@pytest.mark.parametrize(
    ("values", "detected", "lost"),
    [
        ((1.0, 5.0, 9.0), "at every pixel", np.nan),
        ((1.0, 5.0, 11.0), "at fine pixels", 5.0),
        ((1.0, 12.0, np.inf), "at fine pixels", 1.0),
        ((20.0, 30.0, np.inf), "at no pixel", 0.1),
        ((np.nan, 30.0, np.inf), "at no pixel", 0.1),
        ((20.0, 5.0, 6.0), "at fine pixels", 0.1),  # no sweep gives that; lost it is all the same
    ],
)
def test_a_cover_that_is_lost_at_a_pixel_is_said_to_be(values, detected, lost):
    limits = limit_table(bounds(values), ["species.A.cover"])
    assert limits["detected"].tolist() == [detected]
    assert limits["lost_from_gsd_m"].tolist() == pytest.approx([lost], nan_ok=True)
    (line,) = _limit_sentences(bounds(values), limits)
    numbers = [int(n) for n in re.findall(r"(\d+) (?:are detected|only|not)", line)]
    places = ["at every pixel", "at fine pixels", "at no pixel"]
    assert numbers == [place == detected for place in places]


def test_covers_are_counted_for_each_noise_and_sun():
    one = bounds((1.0, 5.0, 9.0))
    table = pd.concat([one, one.assign(noise=0.05, bound=[20.0, 30.0, np.inf])])
    first, second = _limit_sentences(table, limit_table(table, ["species.A.cover"]))
    assert first.startswith("4 bands, noise 1 %: of 1 covers 1 are detected")
    assert second.startswith("4 bands, noise 5 %: of 1 covers 0 are detected")
    (line,) = _limit_sentences(one, limit_table(one, ["species.A.cover"]))
    assert line.startswith("4 bands: of 1 covers")


def test_one_file_need_not_be_in_a_list(plot, tmp_path):
    for job in (jobs.pattern, jobs.reflectance, partial(jobs.calibrate, plot)):
        with pytest.raises(InputError) as error:
            job("missing_1.tif", tmp_path / "out")
        assert "missing_1" in str(error.value)


def test_figures_stand_what_data_bring():
    """A constant parameter, an infinite bound, an elasticity that is not there."""
    draws = np.random.default_rng(0).normal(size=(300, 3)) * np.array([1.0, 2.0, 0.0])
    names = ["species.A.cover [%]", "ground.brightness [-]", "species.A.leaf.water [cm]"]
    figure = corner_plot({"emcee": draws}, names, prior=(draws[:9], np.ones((9, 3))))
    assert len(figure.axes) == 9
    assert predictive_plot(draws, np.zeros(3), np.ones(3), ["a.mean", "b.mean", "c.std"]).axes
    table = pd.DataFrame(
        {"metric": ["red.mean"] * 2, "parameter": names[:2], "elasticity": [0.3, np.nan],
         "interval": [0.1, np.nan], "distinguished": [True, False],
         "first": [0.2, 0.1], "first_error": [0.1, 0.1], "total": [np.nan] * 2,
         "total_error": [np.nan] * 2, "bound": [0.4, 2.0]}
    )  # fmt: skip
    for figure in (tornado_plot(table), indices_plot(table)):
        figure.canvas.draw()
    figure = bound_plot(bounds((1.0, 12.0, np.inf)), ["species.A.cover"])
    figure.canvas.draw()
    shown, none = figure.axes[0].lines
    assert np.isnan(np.asarray(shown.get_ydata())[-1])
    assert (len(none.get_xdata()), none.get_marker()) == (1, "^")


def test_slopes_are_those_of_the_expectation_over_plantings(plot, tmp_path):
    """Against plots built from other seeds, one planting each, and their scatter."""
    read = read_plot(plot)
    result = sensitivity(read, tmp_path, metrics=["nir.mean"], plantings=8, seed=0)
    table = pd.DataFrame(result.slopes).set_index("parameter")
    problem = plot_problem(read, None, seed=0)
    scene, parameters = problem.scene, problem.scene.parameters
    view = image_view(read, scene, parameters, ["nir.mean"])
    names, at = problem.free.names, np.asarray(problem.free.prior)
    quick, cheap = search_form(scene, parameters, [view])
    predict = PlotForward(parameters, names, cheap)
    others, values = [], []
    for seed in range(100, 116):
        quick, _ = search_form(scene.realisation(seed), parameters, [view])
        local = local_sensitivity(predict, names, ["nir.mean"], at, context=(quick,))
        others.append(local.elasticity[0])
        values.append(local.value[0])
    mean, spread = np.mean(others, axis=0), np.std(others, axis=0, ddof=1)
    assert list(table.index) == list(names)
    np.testing.assert_allclose(table["elasticity_error"] * np.sqrt(8), spread, rtol=0.6)
    np.testing.assert_allclose(table["metric_sd"], np.std(values, ddof=1), rtol=0.6)
    error = np.hypot(table["elasticity_error"], spread / 4.0)
    assert (abs(table["elasticity"] - mean) < 4.0 * error).all()
    assert table["distinguished"]["ground.brightness"]
    assert "ground brightness (+" in result.headline[0]
    assert result.status == result.headline[1]  # 8 are too few for the covers
    assert "After 8 plantings" in result.status


def test_slopes_are_the_same_for_a_seed_also_after_an_interruption(plot, tmp_path):
    kept = tmp_path / "kept"

    def run(seed, checkpoint=None):
        options = {"plantings": 3, "seed": seed, "checkpoint": checkpoint}
        return sensitivity(plot, tmp_path, metrics=["nir.mean"], **options).slopes

    with pytest.raises(KeyboardInterrupt), hearing(2):
        run(0, kept)
    with pytest.raises(InputError, match="of another run"):
        run(1, kept)
    whole = run(0)
    assert run(0, kept) == whole
    assert run(1) != whole


def test_what_is_not_distinguished_from_zero_is_neither_named_nor_drawn_as_if():
    table = pd.DataFrame(
        {"metric": ["red.mean"] * 3 + ["nir.mean"], "parameter": ["species.A.cover",
         "species.B.cover", "ground.brightness", "species.A.cover"],
         "elasticity": [-0.5, 0.3, 0.2, 0.4], "elasticity_error": [0.4, 0.05, 0.01, 0.3],
         "interval": [0.8, 0.1, 0.02, 0.6], "distinguished": [False, True, True, False]}
    )  # fmt: skip
    red, nir = sensitivity_headline(table)
    assert red == (
        "red.mean changes most, for 1 % more, by B cover (+0.3 ± 0.05 %), "
        "ground brightness (+0.2 ± 0.01 %)."
    )
    assert nir == "No parameter's effect on nir.mean is distinguished from zero."
    for axes, told in zip(tornado_plot(table).axes, ([False, True, True], [False])):
        bars, whiskers = axes.patches, axes.collections[0].get_segments()
        assert [bar.get_facecolor()[3] == 1.0 for bar in bars] == told
        assert [len(set(bar.get_edgecolor()[:3])) > 1 for bar in bars] == told
        part = table[table["metric"] == ("red.mean" if len(told) == 3 else "nir.mean")]
        lengths = [np.ptp(line[:, 0]) for line in whiskers]
        np.testing.assert_allclose(lengths, 2.0 * part["interval"])


@pytest.mark.study
def test_a_plot_tells_what_moves_its_metrics(plot, tmp_path):
    result = sensitivity(plot, tmp_path, metrics=["nir.mean"], derivatives=4, seed=0)
    assert all((tmp_path / name).stat().st_size for name in result.files)
    slope = {row["parameter"]: row["slope"] for row in result.slopes}
    assert slope["ground.brightness"] > 0
    assert all(row["bound"] >= 0 for row in result.variance)
    with pytest.raises(InputError, match="a statistic must be"):
        sensitivity(plot, tmp_path, metrics=["nir.middle"], seed=0)


@pytest.mark.study
def test_the_posterior_of_a_plot_goes_on_from_its_checkpoint(plot, tmp_path):
    pytest.importorskip("arviz", reason="the extra `posterior` is not installed")
    keep = tmp_path / "checkpoint"
    target = plot.with_name("target.csv")
    options = {"checkpoint": keep, "target_size": 50.0, "seed": 0}
    for output in ("first", "second", "gauss"):
        (tmp_path / output).mkdir()
    posterior(plot, target, tmp_path / "first", method="emcee", max_steps=4, **options)
    result = posterior(plot, target, tmp_path / "second", method="emcee", max_steps=8, **options)
    assert not result.converged
    assert any(line.startswith("The stand: green leaf area ") for line in result.headline)
    table = pd.read_csv(tmp_path / "second" / "parameters.csv")
    assert (table["laplace_q05"] < table["laplace_q95"]).all()
    assert "50 autocorrelation times" in result.status
    gauss = posterior(plot, target, tmp_path / "gauss", method="laplace", **options)
    assert all((tmp_path / "gauss" / name).stat().st_size for name in gauss.files)
    assert "methods.png" in result.files
    assert all(0 < row.sd <= 1.3 * row.prior_sd for row in gauss.parameters)
    with pytest.raises(InputError, match="another run"):
        posterior(plot, target, tmp_path / "gauss", method="laplace", **(options | {"seed": 1}))


@pytest.mark.study
def test_a_posterior_from_three_sensors(plot, tmp_path):
    spectrum, cloud = tmp_path / "spectrum.csv", tmp_path / "cloud.csv"
    spectrum.write_text("wavelength_nm,mean\n550,0.06\n680,0.08\n860,0.26\n1650,0.22\n")
    cloud.write_text(
        "metric,value,sd,grain_m,returns_m2\ngap_fraction,0.45,0.02,1,100\n"
        "rugosity,0.25,0.01,1,100\n"
    )
    deviations = []
    for name, targets in (("one", []), ("all", [spectrum, cloud])):
        (tmp_path / name).mkdir()
        result = posterior(
            plot, [*targets, plot.with_name("target.csv")], tmp_path / name, method="laplace",
            checkpoint=tmp_path / f"{name}.kept", seed=0,
        )  # fmt: skip
        deviations.append({row.name: row.sd for row in result.parameters})
    # More sensors, no less known.
    assert deviations[1]["ground.brightness"] < 1.1 * deviations[0]["ground.brightness"]
    with xr.open_dataset(tmp_path / "all" / "posterior.nc", group="observed_data") as data:
        assert {"spectrum.860nm", "lidar.rugosity"} <= set(data["statistic"].values.tolist())


@pytest.mark.study
def test_a_plot_tells_what_sensors_could_know_of_it(plot, tmp_path):
    result = plot_information(plot, tmp_path, gsd=[0.2, 1.0], bands=[1, 2], realisations=2, seed=0)
    assert all((tmp_path / name).stat().st_size for name in result.files)
    assert len(result.limits) == 4
    states = {"at no pixel", "at fine pixels", "at every pixel"}
    assert {row["detected"] for row in result.limits} <= states


def test_a_headline_of_a_posterior_writes_no_unit_where_there_is_none():
    names = ("prior", "prior_sd", "estimate", "sd", "prior_q05", "prior_q95", "constrained")
    numbers = dict.fromkeys(names, 0.5) | {"median": 0.37, "q05": 0.2, "q95": 0.5}
    rows = [
        {"name": f"species.A.{kind}", "kind": kind, "unit": unit, **numbers}
        for kind, unit in (("dead_fraction", "-"), ("cover", "%"))
    ]
    sampled = stand_in(
        Posterior, constrained=np.array([0.6, 0.5]), misfit=np.array([0.1]), effective_size=400.0,
        method="laplace", names=("a", "b"), data=SimpleNamespace(names=("nir.mean",)),
        well_constrained=tuple,
    )  # fmt: skip
    small = SimpleNamespace(name="small")
    said = _headline(small, sampled, pd.DataFrame(rows))[-1]
    assert "A dead fraction 0.37 (0.2 to 0.5), 50 %" in said
    assert "A cover 0.37 (0.2 to 0.5) %, 50 %" in said
