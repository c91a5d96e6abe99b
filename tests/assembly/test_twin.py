"""A plot whose truth is known, and what sensors measure of it."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.app.assembly import RealImage, plant_twin, plot_problem, twin_image
from fynjax.app.assembly._twin import _PLANTING, PIXEL_NOISE, measure_truth
from fynjax.app.io.plot import drone_sensor, read_plot
from fynjax.inversion import (
    Data,
    ImageView,
    Problem,
    Source,
    SpectrumSight,
    join_data,
    spectrum_names,
    structure_view,
)
from fynjax.scene import with_values
from fynjax.sensors import Gains
from tests.small import write_plot

MORE = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.*.leaf_area_index", "ground.brightness"]
targets = ["*.mean", "nir.std"]
gain_sd = 0.2
gain_shared = 0.0
"""
ERROR = 0.01
"""Of a statistic of the twin's image, as a share of it."""


@pytest.fixture(scope="module")
def plot(tmp_path_factory):
    return read_plot(write_plot(tmp_path_factory.mktemp("twin"), MORE))


@pytest.fixture(scope="module")
def problem(plot):
    return plot_problem(plot, twin_image(plot), seed=0)


@pytest.fixture(scope="module")
def twin(problem):
    return plant_twin(problem, ERROR, seed=4)


def test_a_twin_is_an_image_of_its_truth_with_gains_and_noise(problem, twin):
    """Means are those of the full image times the gains and what the model is off by; noise of a
    pixel adds to the spread."""
    one, scene = twin.measured, problem.scene
    view = one.source.view(scene, scene.parameters)
    named = problem.free.named(jnp.asarray(twin.whitened))
    truth = with_values(scene.parameters, scene.taxa, named)
    scene = scene.realisation(_PLANTING)
    image, _ = eqx.filter_jit(ImageView.observe)(view, scene, truth)
    found = dict(zip(one.names, np.asarray(one.value), strict=True))
    mean, std = (np.asarray(f(image, axis=(1, 2)), float) for f in (jnp.mean, jnp.std))
    off = twin.gain * twin.model_error[0]
    for i, band in enumerate(("green", "red", "red_edge", "nir")):
        assert found[f"{band}.mean"] == pytest.approx(off[i] * mean[i], rel=2e-3)
    square = np.asarray((image[3] ** 2).mean(), float)
    noisy = off[3] * np.sqrt(std[3] ** 2 + PIXEL_NOISE**2 * square)
    assert found["nir.std"] == pytest.approx(noisy, rel=5e-3)
    assert 0.05 < np.abs(np.log(twin.gain)).max() < 0.7
    assert 0.02 < np.abs(np.log(twin.model_error[0])).max() < 0.5


def test_all_sensors_of_a_twin_share_what_the_model_is_off_by(plot, problem):
    """Red of the drone and of a spectrometer at its wavelength: one factor."""
    red = drone_sensor(plot).bands.select([1])
    sight = SpectrumSight(red, Gains(0.0))
    spectrum = Data(
        spectrum_names(red), jnp.zeros(1), jnp.ones(1), source=Source("spectrum", sight)
    )
    both = plot_problem(plot, join_data([problem.data, spectrum]), seed=0)
    by_drone, by_spectrum = plant_twin(both, ERROR, seed=1).model_error
    assert by_spectrum[0] == pytest.approx(by_drone[1], rel=1e-6)
    assert abs(np.log(by_spectrum[0])) > 0.002


def test_a_twin_is_planted_by_another_chance(problem):
    """Than the scene, and than any planting of a search."""
    feet = [np.asarray(problem.scene.realisation(i).planting.foot) for i in (*range(8), _PLANTING)]
    assert all(one.shape != feet[-1].shape or (one != feet[-1]).any() for one in feet[:-1])


def test_two_views_of_one_camera_have_its_gains_but_for_their_drift(problem, monkeypatch):
    """As the fit takes them; and the twin's gain is that of the first."""
    seen = []

    def measured(problem, view, u, number, random, error, gain):
        seen.append(gain)
        return np.zeros(len(view.names)), gain

    monkeypatch.setattr("fynjax.app.assembly._twin.measure_truth", measured)
    flights = join_data([problem.data.renamed("noon"), problem.data.renamed("dusk")])
    both = Problem(problem.scene, flights, problem.free, error=None)
    twins = [plant_twin(both, ERROR, seed=seed) for seed in range(60)]
    logs = np.log(np.array(seen)).reshape(60, 2, -1)
    gains = both.views[0].gains
    apart, own = logs[:, 0] - logs[:, 1], logs[:, 0].std(axis=0)
    # Of both views one drift each, common to all bands.
    assert apart.std() == pytest.approx(2**0.5 * gains.drift, rel=0.25)
    assert np.ptp(apart, axis=1).max() < 1e-6
    np.testing.assert_allclose(own, gains.of_bands(len(own)), rtol=0.3)
    np.testing.assert_allclose(twins[0].gain, np.exp(logs[0, 0]))


def test_a_seed_is_a_truth(problem, twin):
    again = plant_twin(problem, ERROR, seed=4)
    np.testing.assert_array_equal(again.whitened, twin.whitened)
    np.testing.assert_array_equal(again.measured.value, twin.measured.value)
    shown = RealImage(np.ones((4, 2, 2)), (), 0.1, (0.2, 0.2), 1, np.ones((4, 4)))
    source = dataclasses.replace(problem.data.source, image=shown)
    real = dataclasses.replace(problem.data, source=source)
    other = plant_twin(problem.with_data(real), ERROR, seed=5)
    assert other.measured.source.image is None  # which is no image of the twin
    assert np.abs(other.whitened - twin.whitened).max() > 0.1
    assert np.abs(other.gain / twin.gain - 1.0).max() > 0.01


def test_a_truth_moves_what_is_measured(problem):
    (view,) = problem.views
    bright = np.zeros(len(problem.free.names))
    bright[problem.free.names.index("ground.brightness")] = 1.0
    values = [
        measure_truth(problem, view, u, 0, np.random.default_rng(0))[0]
        for u in (np.zeros_like(bright), bright)
    ]
    assert values[1][view.names.index("red.mean")] > 1.01 * values[0][view.names.index("red.mean")]


def test_a_spectrum_of_a_twin_has_the_errors_of_the_real_one(problem, monkeypatch):
    truth = np.array([1.0, 2.0])
    monkeypatch.setattr("fynjax.app.assembly._twin.measure_truth", lambda *_: (truth, None))
    sd, view = jnp.array([0.1, 0.3]), structure_view(("gap_fraction", "rugosity"))
    one = Data(view.names, jnp.zeros(2), sd, source=Source("structure", lambda *_: view))
    asked = Problem(problem.scene, one, problem.free, error=None)
    drawn = np.stack([plant_twin(asked, ERROR, seed=seed).measured.value for seed in range(400)])
    np.testing.assert_allclose(drawn.mean(axis=0), truth, atol=0.05)
    np.testing.assert_allclose(drawn.std(axis=0), sd, rtol=0.15)
    assert plant_twin(asked, ERROR, seed=0).gain is None
