"""The published numbers of the AVIRIS-NG spectrum, as a target beside the drone's image."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from fynjax.app.compare import table5_2006
from fynjax.app.jobs._calibration_page import _camera_sentence
from fynjax.app.jobs._calibration_tables import camera_table
from fynjax.inversion import (
    BandFactors,
    Calibration,
    CalibrationSettings,
    ImageView,
    PlotSpace,
    free_space,
    join_data,
    spectrum_view,
    weigh_targets,
)
from fynjax.metrics import spectral_mask
from fynjax.scene import Placement, aim, with_values
from fynjax.sensors import BandSet, Gains, shipped_sensor
from fynjax.studies.fynbos_2006._aviris import NAMES, aviris_target, regions_view
from tests.helpers import stand_in
from tests.problems import calibrate_plot
from tests.scene.plots import TAXA, small_parameters, small_plot

FREE = ("species.*.leaf_area_index", "ground.brightness")


@pytest.fixture(scope="module")
def plot():
    return small_plot(extent=(1.0, 1.0), dtype="float32"), small_parameters()


def test_the_numbers_are_those_of_the_article():
    """Its real spectrum at 2100 to 2450 nm is 0.063; what its error there, 0.0548, is of the range,
    161 %, gives a range of 0.034."""
    data = aviris_target(Path("plot.toml"))
    found = dict(zip(data.names, np.asarray(data.value), strict=True))
    assert found["spectrum.swir2_mean"] == 0.063
    assert found["spectrum.swir2_range"] == pytest.approx(0.0548 / 1.6122)
    assert found["spectrum.vnir_range"] == pytest.approx(0.2524, abs=1e-4)
    assert set(table5_2006()) == {n[9:-6] for n in NAMES if n.endswith("_range")}


def test_the_ranges_of_few_bands_are_those_of_the_spectrum(plot):
    """Within their stated error, 5 %, of a spectrum in steps of 30 nm outside the water windows."""
    scene, parameters = plot
    found = dict(zip(NAMES, np.asarray(regions_view(*plot).predict(*plot)), strict=True))
    grid = np.arange(420.0, 2440.0, 30.0)
    bands = BandSet(tuple(f"{w:.0f}nm" for w in grid), tuple(grid), (10.0,) * grid.size)
    whole = np.asarray(spectrum_view(bands, scene, parameters).predict(scene, parameters))
    for region in table5_2006():
        inside = whole[spectral_mask(grid, region)]
        assert found[f"spectrum.{region}_range"] == pytest.approx(np.ptp(inside), rel=0.05), region
    inside = whole[spectral_mask(grid, "swir2")]
    assert found["spectrum.swir2_mean"] == pytest.approx(inside.mean(), rel=0.05)


def test_slopes_are_those_of_the_numbers(plot):
    scene, parameters = plot
    view = regions_view(scene, parameters)
    scene = scene.expected()

    def plot_at(u):
        values = {f"species.{TAXA[0]}.leaf_area_index": u[0], "ground.brightness": u[1]}
        return with_values(parameters, TAXA, values)

    u = jnp.array([2.5, 0.8])
    jacobian = jax.jit(lambda u: view.jacobian(scene, plot_at, u))
    _, slopes = jacobian(u)
    for i, step in enumerate(np.diag([0.1, 0.02])):
        difference = (jacobian(u + step)[0] - jacobian(u - step)[0]) / (2.0 * step[i])
        np.testing.assert_allclose(slopes[:, i], difference, rtol=0.03, atol=1e-3)


@pytest.mark.study
def test_the_numbers_tie_the_gains_of_the_camera(plot):
    """Gains that were planted come out, within their errors, which are those of a spectrum and no
    longer of the camera, 0.3."""
    scene, truth = plot
    names, gains = tuple(f"{b}.mean" for b in ("green", "red", "red_edge", "nir")), Gains(0.3, 0.0)
    camera = aim(scene, truth, shipped_sensor("mavic_3m"), Placement(50.0, 0.1))
    drone, aviris = ImageView(names, camera, gains), regions_view(scene, truth)
    planted = np.array([0.8, 0.75, 0.6, 0.95])
    seen = planted * np.asarray(eqx.filter_jit(drone.predict)(scene, truth), float)
    numbers = np.asarray(eqx.filter_jit(aviris.predict)(scene, truth), float)
    regions = dataclasses.replace(aviris_target(Path("plot.toml")), value=jnp.asarray(numbers))
    start = with_values(truth, TAXA, {"ground.brightness": jnp.asarray(0.7)})
    found = calibrate_plot(
        scene, start, join_data([weigh_targets(names, seen, 0.01), regions]),
        free_space(scene, start, FREE, lambda _: 0.3), (drone, aviris),
        CalibrationSettings(stand_realisations=0, max_steps=6),
    )  # fmt: skip
    assert (np.abs(np.log(found.gain / planted)) < 2.0 * found.gain_sd).all()
    assert (found.gain_sd < 0.1).all()


def test_gains_say_what_an_exact_simulation_is_off_by(plot):
    """A camera that has 0.8 of the light makes what is true look 25 % too bright."""
    camera = aim(*plot, shipped_sensor("mavic_3m"), Placement(50.0, 0.1))
    views = (ImageView(("green.mean",), camera, Gains(0.3, 0.0)),)
    found = stand_in(
        Calibration,
        views=views,
        space=stand_in(PlotSpace, factors=BandFactors.of(views, None)),
        gains=(np.array([0.8, 1.25, 0.5, 1.1]),),
        gains_covariance=(np.diag(np.full(4, 0.08**2)),),
        model_error=(np.full(4, 1.1),),
        model_error_sd=(np.full(4, 0.1),),
    )
    statistics = pd.DataFrame({"statistic": ["nir.mean"], "after_error_percent": [12.0]})
    table = camera_table(found, statistics, views[0])
    np.testing.assert_allclose(table["exact_error_percent"], [25.0, -20.0, 100.0, -100.0 / 11.0])
    np.testing.assert_allclose(table["sd"], [0.064, 0.1, 0.04, 0.088])
    np.testing.assert_allclose(table["prior_sd"], 0.3)
    np.testing.assert_allclose(table["model_error_sd"], 0.11)
    np.testing.assert_array_equal(table["after_error_percent"], [np.nan, np.nan, np.nan, 12.0])
    text = _camera_sentence(table)
    assert "green +25 %, red −20 %" in text.replace("-", "−")
    assert text.count("within the error of the gain") == 1
