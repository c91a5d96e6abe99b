"""The jobs behind the commands, whole: a small plot rendered, and calibrated to its own image."""

import dataclasses
import json

import jax.numpy as jnp
import jsonschema
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.app.compare import read_drone_image
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.app.jobs import CalibrateResult, calibrate, render_plot
from fynjax.app.jobs._calibration_page import doubt_first, status_words
from fynjax.app.jobs._fit_report import _short_of_sites
from fynjax.app.jobs._render import check_finite
from fynjax.app.jobs._schemas import json_schema
from fynjax.inversion import Calibration, FitResult, FitStatus, PlotSearch
from fynjax.metrics import image_statistics
from tests.heard import hearing
from tests.helpers import stand_in
from tests.scene.plots import small_parameters, small_plot
from tests.small import search_quickly, write_plot

MORE = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.*.cover", "ground.brightness"]
max_iterations = 6
gain_sd = 0.0
"""


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """(summary of a rendered plot, folder of plot and image)."""
    folder = tmp_path_factory.mktemp("jobs")
    write_plot(folder, MORE)
    (folder / "render").mkdir()
    return render_plot(folder / "plot.toml", folder / "render", seed=0), folder


def misfit(summary, when):
    rows = [s for s in summary.statistics if s.fitted]
    return sum(((getattr(s, when) - s.target) / s.target_sd) ** 2 for s in rows)


@pytest.mark.study
def test_an_image_of_the_plot_itself_moves_no_parameter_beyond_its_error(rendered, tmp_path):
    """Its plants are one draw, which the expectation over plantings need not meet."""
    _, folder = rendered
    same = calibrate(folder / "plot.toml", folder / "render" / "image.tif", tmp_path, seed=0)
    assert same.converged
    assert same.status == "ok"
    assert misfit(same, "after") < misfit(same, "before")
    for one in same.parameters:
        assert abs(one.estimate - one.prior) < 2.0 * one.sd, one.name
    known = {one.kind: one for one in same.parameters}
    # As well as a model is believed that is off by some 12 % of what real images show.
    assert known["brightness"].sd < 0.25 * known["brightness"].prior_sd


def test_no_product_holds_nan():
    plot = read_plot(example_folder() / "plot.toml")
    check_finite(jnp.ones((4, 2, 2)), plot)
    with pytest.raises(InputError, match=r"1 values.*not finite"):
        check_finite(jnp.ones((4, 2, 2)).at[1, 0, 1].set(jnp.nan), plot)


def test_plants_without_a_site_are_a_warning():
    model, parameters = small_plot(), small_parameters()
    assert _short_of_sites(model, parameters) == []
    species = dataclasses.replace(parameters.species, diameter=parameters.species.diameter * 0.5)
    crowded = dataclasses.replace(parameters, species=species)
    (first, *_) = _short_of_sites(model, crowded)
    assert first.startswith("Erica irregularis: the estimate asks for")


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    """(folder, calibration of a twin to an image, a spectrum and a cloud), whose results are in
    `output`. The run was interrupted, and went on from its checkpoint without a new start."""
    folder = tmp_path_factory.mktemp("twin")
    free = MORE.replace('"ground.brightness"', '"species.*.height"')
    write_plot(folder, free.replace("gain_sd = 0.0", "gain_sd = 0.1"), voxel=0.2)
    table, spectrum, cloud = (folder / f"{name}.csv" for name in ("table", "spectrum", "cloud"))
    table.write_text("statistic,value,sd\nnir.mean,0.26,\nred.mean,0.08,\ngreen.mean,0.06,1000\n")
    spectrum.write_text("wavelength_nm,mean\n550,0.06\n680,0.08\n860,0.26\n1650,0.22\n")
    cloud.write_text(
        "metric,value,sd,grain_m,returns_m2\ngap_fraction,0.45,0.02,2,100\n"
        "rugosity,0.25,0.01,2,100\n"
    )
    kept, first, second = (folder / name for name in ("kept", "first", "output"))
    for made in (first, second):
        made.mkdir()
    arguments = (folder / "plot.toml", [table, cloud, spectrum])
    again = {"seed": 3, "twin": True, "checkpoint": kept}
    with pytest.MonkeyPatch.context() as patch:
        search_quickly(patch)
        with pytest.raises(KeyboardInterrupt), hearing(3):
            calibrate(*arguments, first, **again)
        assert not list(first.iterdir())
        names = sorted(p.name for p in kept.iterdir())
        assert names == ["calibration.mark", "calibration.start_1.npz"]

        def never(*_):
            raise AssertionError("this was computed before")

        patch.setattr(PlotSearch, "begin", never)
        found = calibrate(*arguments, second, **again)
        spectrum.write_text(spectrum.read_text().replace("0.26", "0.27"))
        with pytest.raises(InputError, match="another run"):
            calibrate(*arguments, second, **again)
    return folder, found


@pytest.mark.slow
def test_three_sensors_together_after_an_interruption(twin):
    """Statistics of an image, a spectrum and a cloud: the page tells of each, and the run went on
    where it was."""
    folder, calibration = twin
    output = folder / "output"
    assert [t.kind for t in calibration.targets] == ["image", "spectrum", "structure"]
    names = [s.statistic for s in calibration.statistics if s.fitted]
    assert names == [
        *("nir.mean", "red.mean", "green.mean"),
        *(f"spectrum.{nm}nm" for nm in (550, 680, 860, 1650)),
        *("lidar.gap_fraction", "lidar.rugosity"),
    ]
    # The start is within the errors already; so is the end.
    assert misfit(calibration, "with_error") < len(names)
    # No index is a target, so the headline has none.
    assert calibration.headline[1].startswith("The stand: green leaf area ")
    assert calibration.headline[2].startswith(
        "small, expected over plantings: largest error of a band mean"
    )
    assert "nan" not in " ".join(calibration.headline)
    bands = pd.read_csv(output / "bands.csv")
    assert len(bands) == 8  # four of the camera, four of the spectrum
    # Of the covariance of all gains each sensor has its own block: data make none less certain.
    assert (bands["gain_sd"] <= bands["gain_prior_sd"] + 1e-9).all()
    # Both see near infrared at 860 nm: one error of the model, and gains of their own.
    at_860 = bands[bands["wavelength_nm"] == 860.0]
    np.testing.assert_allclose(at_860["model_error"], at_860["model_error"].iloc[0])
    assert at_860["gain"].nunique() == 2
    files = {"image_after.tif", "spectrum.png", "structure.png", "parameters.csv", "run.nc"}
    assert files <= set(calibration.files)
    assert all((output / name).stat().st_size for name in calibration.files)
    page = (output / "report.html").read_text("utf-8")
    assert "<h2>The spectrum</h2>" in page
    assert "<h2>The point cloud</h2>" in page
    assert "nan %" not in page
    assert ('<p class="lead">A twin, whose truth' in page) == (calibration.status == "ok")
    assert "each with its 90 % interval" in page
    assert "noise of AVIRIS-NG" in page
    assert any("RMSE of the spectrum" in line for line in calibration.headline)
    jsonschema.validate(json.loads(calibration.model_dump_json()), json_schema("summary"))


def ended(*doubts, **fit):
    """A calibration of such a fit, with these doubts."""
    own = stand_in(FitResult, status=FitStatus.max_steps, **fit)
    return stand_in(Calibration, doubts=lambda _: list(doubts), fit=own)


def test_a_page_says_first_that_the_search_did_not_converge():
    stopped = ended(converged=False, explanation="Stopped at the limit of steps.")
    lead = doubt_first(stopped, "Plot: largest error 14 %.")
    assert lead.startswith("Not converged: Stopped at the limit of steps. Allow more steps")
    assert lead.endswith("Plot: largest error 14 %.")
    assert lead[0].lower() + lead[1:] == f"{status_words(stopped)} Plot: largest error 14 %."
    good = ended(converged=True, explanation="")
    assert (status_words(good), doubt_first(good, "Plot.")) == ("ok", "Plot.")


def test_a_page_says_before_all_else_that_the_table_was_nearer():
    worse = ended("Worse than the table: 3 of 4.", converged=True, explanation="")
    assert doubt_first(worse, "Plot.") == "Worse than the table: 3 of 4. Plot."


@pytest.mark.slow
def test_a_twin_shows_its_truth(twin):
    """In tables, headline and page; and nearly all of it lies in its intervals."""
    folder, found = twin
    output = folder / "output"
    tables = [pd.read_csv(output / f"{n}.csv") for n in ("parameters", "stand")]
    counts = []
    for table in tables:
        off = np.abs(table["truth"] / table["prior"] - 1.0)
        assert off.max() > 0.02  # not the middle of the prior
        counts.append(int(table["truth"].between(table["q05"], table["q95"]).sum()))
        assert counts[-1] >= len(table) - 1
    first = found.headline[0]
    assert first.startswith("A twin, whose truth was drawn from the prior")
    for count, table, what in zip(counts, tables, ("parameters", "numbers of the stand")):
        assert f"{count} of {len(table)} {what}" in first
    assert " of 4 gains of the camera" in first
    page = (output / "report.html").read_text("utf-8")
    assert first in page
    image = jnp.asarray(read_drone_image(output / "image_after.tif").values)
    table = pd.read_csv(output / "statistics.csv")
    table = table[table["image_after"].notna()]
    own = np.asarray(image_statistics(image, tuple(table["statistic"]), pixel=0.1))
    np.testing.assert_allclose(table["image_after"], own, rtol=1e-3)
    means = table[table["statistic"].str.endswith(".mean")]
    apart = 100.0 * (means["image_after"] / means["after"] - 1.0).abs().max()
    assert f"differ from those of the image after by up to {apart:.0f} %" in page
    assert "of a plot whose truth is known" in found.targets[0].description.lower()


def test_neither_a_target_nor_a_twin_is_said(tmp_path):
    with pytest.raises(InputError, match="expected what was measured"):
        calibrate(write_plot(tmp_path, MORE), [], tmp_path / "output")


def test_a_twin_of_a_plot_without_targets_has_an_image(tmp_path, monkeypatch):
    given = []

    def calibrate_to(plot, data, *_, **__):
        given.extend(data.parts)
        return CalibrateResult.model_construct()

    monkeypatch.setattr("fynjax.app.jobs._calibrate.calibrate_to", calibrate_to)
    calibrate(write_plot(tmp_path, MORE), [], tmp_path / "output", twin=True)
    (one,) = given
    assert one.source.kind == "image"
    assert {"red.mean", "NDVI.std"} <= set(one.names)
