"""A plot whose truth is known, and what sensors measure of it."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.app.assembly import RealImage, plant_twin, prepare, twin_image
from fynjax.app.assembly._twin import _PLANTING, PIXEL_NOISE, measure_truth
from fynjax.app.io.plot import drone_sensor, read_plot
from fynjax.inversion import Data, ImageView, spectrum_names, spectrum_view, structure_view
from fynjax.scene import with_values
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


@pytest.fixture(scope="module")
def ready(tmp_path_factory):
    plot = read_plot(write_plot(tmp_path_factory.mktemp("twin"), MORE))
    return prepare(plot, None, seed=0)


@pytest.fixture(scope="module")
def twin(ready):
    return plant_twin(ready, [twin_image(ready.plot)], seed=4)


def test_a_twin_is_an_image_of_its_truth_with_gains_and_noise(ready, twin):
    """Means are those of the full image times the gains and what the model is off by; noise of a
    pixel adds to the spread."""
    (one,) = twin.measured
    view = one.view_of(ready.scene, ready.parameters)
    truth = with_values(
        ready.parameters, ready.scene.taxa, ready.space.named(jnp.asarray(twin.whitened))
    )
    scene = ready.scene.realisation(_PLANTING)
    image, _ = eqx.filter_jit(ImageView.observe)(view, scene, truth)
    found = dict(zip(one.data.names, np.asarray(one.data.value), strict=True))
    mean, std = (np.asarray(f(image, axis=(1, 2)), float) for f in (jnp.mean, jnp.std))
    off = twin.gain * twin.model_error[0]
    for i, band in enumerate(("green", "red", "red_edge", "nir")):
        assert found[f"{band}.mean"] == pytest.approx(off[i] * mean[i], rel=2e-3)
    square = np.asarray((image[3] ** 2).mean(), float)
    noisy = off[3] * np.sqrt(std[3] ** 2 + PIXEL_NOISE**2 * square)
    assert found["nir.std"] == pytest.approx(noisy, rel=5e-3)
    assert 0.05 < np.abs(np.log(twin.gain)).max() < 0.7
    assert 0.02 < np.abs(np.log(twin.model_error[0])).max() < 0.5


def test_all_sensors_of_a_twin_share_what_the_model_is_off_by(ready):
    """Red of the drone and of a spectrometer at its wavelength: one factor."""
    (image,) = [twin_image(ready.plot)]
    red = drone_sensor(ready.plot).bands.select([1])
    spectrum = dataclasses.replace(
        image,
        kind="spectrum",
        data=Data(spectrum_names(red), jnp.zeros(1), jnp.ones(1)),
        view_of=lambda scene, parameters: spectrum_view(red, scene, parameters),
    )
    by_drone, by_spectrum = plant_twin(ready, [image, spectrum], seed=1).model_error
    assert by_spectrum[0] == pytest.approx(by_drone[1], rel=1e-6)
    assert abs(np.log(by_spectrum[0])) > 0.002


def test_a_twin_is_planted_by_another_chance(ready):
    """Than the scene, and than any planting of a search."""
    feet = [np.asarray(ready.scene.realisation(i).planting.foot) for i in (*range(8), _PLANTING)]
    assert all(one.shape != feet[-1].shape or (one != feet[-1]).any() for one in feet[:-1])


def test_a_seed_is_a_truth(ready, twin):
    again = plant_twin(ready, [twin_image(ready.plot)], seed=4)
    np.testing.assert_array_equal(again.whitened, twin.whitened)
    np.testing.assert_array_equal(again.measured[0].data.value, twin.measured[0].data.value)
    shown = RealImage(np.ones((4, 2, 2)), (), 0.1, (0.2, 0.2), 1, np.ones((4, 4)))
    real = dataclasses.replace(twin_image(ready.plot), image=shown)
    other = plant_twin(ready, [real], seed=5)
    assert other.measured[0].image is None  # which is no image of the twin
    assert np.abs(other.whitened - twin.whitened).max() > 0.1
    assert np.abs(other.gain / twin.gain - 1.0).max() > 0.01


def test_a_truth_moves_what_is_measured(ready, twin):
    view = twin.measured[0].view_of(ready.scene, ready.parameters)
    bright = np.zeros(len(ready.space.names))
    bright[ready.space.names.index("ground.brightness")] = 1.0
    values = [
        measure_truth(ready, view, u, 0, np.random.default_rng(0))[0]
        for u in (np.zeros_like(bright), bright)
    ]
    assert values[1][view.names.index("red.mean")] > 1.01 * values[0][view.names.index("red.mean")]


def test_a_spectrum_of_a_twin_has_the_errors_of_the_real_one(ready, twin, monkeypatch):
    truth = np.array([1.0, 2.0])
    monkeypatch.setattr("fynjax.app.assembly._twin.measure_truth", lambda *_: (truth, None))
    sd = jnp.array([0.1, 0.3])
    one = dataclasses.replace(
        twin.measured[0],
        data=Data(("a", "b"), jnp.zeros(2), sd),
        view_of=lambda *_: structure_view(),
    )
    drawn = np.stack(
        [plant_twin(ready, [one], seed=seed).measured[0].data.value for seed in range(400)]
    )
    np.testing.assert_allclose(drawn.mean(axis=0), truth, atol=0.05)
    np.testing.assert_allclose(drawn.std(axis=0), sd, rtol=0.15)
    assert plant_twin(ready, [one], seed=0).gain is None
