"""The fit to every pixel of known plants, with an image that is linear in the parameters."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.checkpoint import Journal, signature
from fynjax.inversion import (
    CalibrationSettings,
    ImageView,
    ParameterSpace,
    Pixels,
    PixelSearch,
    PixelState,
    Problem,
    _known_plants,
    calibration,
    pixel_data,
)
from fynjax.inversion._known_plants import PixelErrors, PixelModel
from fynjax.scene import AimedSensor, ModelError
from fynjax.sensors import Gains, shipped_sensor
from tests.helpers import stand_in
from tests.scene.plots import TAXA, drone, small_parameters, small_plot

NAMES = tuple(f"species.{taxon}.cover" for taxon in TAXA[:2])
SPACE = ParameterSpace(
    NAMES, jnp.full(2, -50.0), jnp.full(2, 50.0), jnp.array([0.3, 0.2]), jnp.array([0.1, 0.2]),
    distribution="normal",
)  # fmt: skip
RANDOM = np.random.default_rng(2)
BASE = RANDOM.uniform(0.3, 0.5, (2, 2, 3))
SLOPES = RANDOM.normal(size=(2, 2, 2, 3))
"""Of two parameters, in two bands."""
PIXEL_SD, GAINS = 0.3, Gains(0.2)


def linear(values):
    """An image without light."""
    return BASE + np.tensordot(np.asarray(values) - np.array([0.3, 0.2]), SLOPES, axes=1)


class Linear(PixelModel):
    """A model that counts how often slopes are asked for."""

    count = 0

    def image(self, values):
        return linear(values)

    def slopes(self, values):
        Linear.count += 1
        return linear(values), SLOPES


def searched(max_steps=30, error=None):
    Linear.count, mavic = 0, shipped_sensor("mavic_3m")
    two = dataclasses.replace(mavic, bands=mavic.bands.select([1, 3]), psf=None, noise=None)
    view = ImageView((), stand_in(AimedSensor, sensor=two, shape=(2, 3)), GAINS)
    measured = linear([0.35, 0.1]) * np.array([1.2, 0.9])[:, None, None]
    measured[:, 1, 2] = np.nan
    pixels = Pixels(measured, 1, PIXEL_SD)
    data = pixel_data(pixels, two.bands.names, lambda *_: view)
    settings = CalibrationSettings(max_steps=max_steps, tolerance=1e-4)
    scene = dataclasses.replace(small_plot(), known_plants=True)  # as if
    problem = Problem(scene, data, SPACE, error=error, settings=settings)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_known_plants, "PixelModel", Linear)
        search = PixelSearch(problem)
    states = [search.begin(jnp.zeros(2))]
    while not states[-1].ended:
        states.append(search.step(states[-1]))
    return search, states, np.asarray(data.value), pixels.compared


@pytest.fixture(scope="module")
def found():
    search, states, target, compared = searched()
    return calibration(search, states[-1:]), target, compared


@pytest.mark.parametrize("max_steps", [30, 1])
def test_slopes_are_computed_once_a_round_and_are_those_of_the_estimate(max_steps):
    """Whether the search converged, or came to the end of its rounds."""
    search, states, target, _ = searched(max_steps)
    last = states[-1]
    result = calibration(search, [last])
    assert Linear.count == int(last.turn) + 1
    assert bool(result.fit.converged) == (max_steps == 30)
    values, slopes = search.linear(last.u)
    np.testing.assert_allclose(result.fit.predicted, values, rtol=1e-12)
    np.testing.assert_allclose(result.fit.jacobian, slopes[:, :2], rtol=1e-9, atol=1e-12)
    rest = (values - target) / (PIXEL_SD * np.asarray(last.sd))
    u = np.asarray(last.u)
    assert result.misfit == pytest.approx(rest @ rest + u @ u)
    assert len(result.fit.loss) == len(states) - 1  # all but the end, which is that before it
    assert int(result.fit.steps) == len(result.fit.loss) - int(result.fit.rounds[-1])


def test_errors_that_bands_and_neighbours_share_are_whitened():
    """The information that slopes have is that of the covariance of all values."""
    root = RANDOM.normal(size=(2, 2))
    errors = PixelErrors(jnp.asarray(root @ root.T), jnp.asarray(3.0), True)
    slopes = RANDOM.normal(size=(2 * 5, 3))
    white = errors.whiten(slopes)
    whole = np.kron(root @ root.T, np.eye(5)) * 3.0  # band by band
    np.testing.assert_allclose(white.T @ white, slopes.T @ np.linalg.solve(whole, slopes))
    np.testing.assert_allclose(errors.whiten(white, back=True), slopes)
    np.testing.assert_allclose(errors.sd, np.hypot(*root.T))


def test_what_errors_are_shares_of():
    """Half of a value and half of its band's mean; of stated errors the value itself."""
    values = np.array([0.1, 0.3, 0.2, 0.6])
    shapes = PixelErrors(jnp.eye(2), jnp.asarray(1.0), True)
    np.testing.assert_allclose(shapes.scale(values), [0.15, 0.25, 0.3, 0.5])
    own = dataclasses.replace(shapes, shapes=False)
    np.testing.assert_allclose(own.scale(values), values)


def test_what_gains_may_be_is_an_error_of_the_parameters(found):
    """Their covariance is that of data whose errors hang together by the gains, and a prior that
    few and uncertain pixels leave its weight."""
    result, _, compared = found
    gain = result.gain[:, None]
    image = np.asarray(result.blocks.with_error)[:, compared]
    sd = np.asarray(result.fit.data.sd)
    to_u = np.asarray(SPACE.slope(result.fit.whitened))
    jacobian = (SLOPES[:, :, compared] * gain).reshape(2, -1).T * to_u
    by_gain = np.kron(np.eye(2), np.ones((image.shape[1], 1))) * image.reshape(-1, 1)
    error = np.diag(sd**2) + by_gain @ GAINS.covariance(2) @ by_gain.T
    want = np.linalg.inv(np.eye(2) + jacobian.T @ np.linalg.solve(error, jacobian))
    assert result.fit.converged
    np.testing.assert_allclose(sd, PIXEL_SD * image.ravel(), rtol=0.02)
    np.testing.assert_allclose(result.fit.covariance, want, rtol=1e-3)
    assert 0.05 < want[0, 0] < 0.95  # neither the prior alone nor the data alone


def test_the_estimate_of_parameters_and_gains_is_where_the_posterior_is_densest(found):
    """No step of a parameter or a gain has a lower sum of squares and prior."""
    result, target, compared = found
    sd = np.asarray(result.fit.data.sd)
    known = np.linalg.inv(GAINS.covariance(2))

    def objective(u, log_gain):
        image = linear(SPACE.physical(jnp.asarray(u))) * np.exp(log_gain)[:, None, None]
        rest = (image[:, compared].ravel() - target) / sd
        return rest @ rest + u @ u + log_gain @ known @ log_gain

    u, log_gain = np.asarray(result.fit.whitened), np.log(result.gain)
    least = objective(u, log_gain)
    assert result.misfit == pytest.approx(least, rel=1e-6)
    for step in 0.02 * np.concatenate([np.eye(4), -np.eye(4)]):
        assert objective(u + step[:2], log_gain + step[2:]) > least


def test_images_are_of_the_plot_alone_with_gains_and_with_the_model_s_error():
    """Each made anew from the estimate; and the means that are held against the measured ones."""
    error = ModelError(np.array([500.0, 900.0]), np.array([0.1, 0.2]), np.eye(2))
    search, states, _, compared = searched(error=error)
    result = calibration(search, states[-1:])
    alone = linear(result.fit.estimate)
    np.testing.assert_allclose(result.image_after, alone, rtol=1e-9)
    (gain,), (off,) = result.gains, result.model_error
    assert np.abs(np.log(off)).min() > 1e-3
    np.testing.assert_allclose(
        result.blocks.with_error, alone * (gain * off)[:, None, None], rtol=1e-9
    )
    measured = linear([0.35, 0.1]) * np.array([1.2, 0.9])[:, None, None]
    mean = lambda image: np.array([band[compared].mean() for band in image])  # noqa: E731
    table = result.means()
    for column, image in (("after", alone), ("with_gain", alone * gain[:, None, None])):
        want = 100.0 * (mean(image) / mean(measured) - 1.0)
        np.testing.assert_allclose(table[f"{column}_error_percent"], want, rtol=1e-9)


def test_a_search_goes_on_from_any_state_that_was_kept(tmp_path):
    search, states, *_ = searched()
    kept = Journal(tmp_path, signature(search.signed))
    for before, after in itertools.pairwise(states):
        kept.put_state("start_1", before)
        again = search.step(kept.kept_state("start_1", PixelState))
        for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(after), strict=True):
            np.testing.assert_array_equal(one, other)


def test_values_that_change_nothing_have_slopes_of_zero():
    """Of leaves of a species that has none; the image is there all the same."""
    scene, mavic = small_plot(), shipped_sensor("mavic_3m")
    red = dataclasses.replace(mavic, bands=mavic.bands.select([1]), psf=None, noise=None)
    name = f"species.{TAXA[2]}.leaf.chlorophyll"
    model = PixelModel(scene, small_parameters(), (name,), drone(scene, sensor=red), 8)
    image, slopes = model.slopes(jnp.array([30.0]))
    assert image.min() > 0.0
    np.testing.assert_array_equal(slopes, np.zeros((1, *image.shape)))


def test_what_was_before_is_where_the_search_started():
    search, states, *_ = searched()
    start = search.begin(jnp.array([0.7, -0.4]))
    np.testing.assert_allclose(start.start[:2], [0.7, -0.4])
    np.testing.assert_allclose(start.before, search.image(start.u))
    assert not np.allclose(start.before, states[0].before)
    np.testing.assert_array_equal(search.step(start).start, start.start)
