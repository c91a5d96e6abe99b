"""Posteriors of draws of a prior, against those that are known in closed form."""

import numpy as np
import pytest
import scipy.stats

from fynjax._core.errors import InputError
from fynjax.inversion import draws_like, sample_prior, spectrum_likelihood
from fynjax.inversion._amortised import OFFSET_SD, OWN_SD

NUMBERS, NOISE, CHANCE = 20, 0.4, 0.8
SLOPES = np.random.default_rng(1).normal(size=(2, NUMBERS)) * np.where(
    np.arange(NUMBERS) < 3, 0.8, 0.2
)
MEASURED = np.array([1.2, -0.8])


def linear(z, chance):
    """Two measurements that are linear in the numbers and in what no number stands for."""
    own = chance.normal(size=(len(z), 2))
    rest = (MEASURED - z @ SLOPES.T - CHANCE * own) / NOISE
    return -0.5 * np.sum(rest**2, axis=1), z[:, :3]


def test_the_posterior_of_a_linear_model_is_that_of_its_formula():
    """Chance counts as an error of the measurements, though every draw of it is known exactly."""
    start = np.random.default_rng(0).normal(size=(40, NUMBERS))
    chain = sample_prior(linear, start, steps=4000, seed=3)
    draws = chain.quantities[200:].reshape(-1, 3)
    error = (NOISE**2 + CHANCE**2) * np.eye(2)
    gain = SLOPES.T @ np.linalg.inv(SLOPES @ SLOPES.T + error)
    covariance = np.eye(NUMBERS) - gain @ SLOPES
    np.testing.assert_allclose(draws.mean(axis=0), (gain @ MEASURED)[:3], atol=0.05)
    np.testing.assert_allclose(np.cov(draws.T), covariance[:3, :3], atol=0.06)
    assert np.abs((gain @ MEASURED)[:3]).max() > 0.2
    assert covariance[:3, :3].diagonal().min() < 0.85
    assert 0.1 < chain.acceptance < 0.9


def test_the_same_seed_gives_the_same_chain_and_keeps_the_likelihood_of_its_draws():
    start = np.random.default_rng(0).normal(size=(6, NUMBERS))

    def exact(z, chance):
        return -0.5 * np.sum((MEASURED - z @ SLOPES.T) ** 2, axis=1), z @ SLOPES.T

    one, other = (sample_prior(exact, start, steps=20, seed=5) for _ in range(2))
    np.testing.assert_array_equal(one.quantities, other.quantities)
    expected = -0.5 * np.sum((MEASURED - one.quantities) ** 2, axis=2)
    np.testing.assert_allclose(one.log_likelihood, expected, atol=1e-9)
    assert not np.array_equal(sample_prior(exact, start, steps=20, seed=6).quantities, one[0])


def test_draws_of_no_likelihood_are_refused():
    start = np.random.default_rng(0).normal(size=(8, 3))
    start[0] = 1.0

    def positive(z, chance):
        return np.where(z[:, 0] > 0.0, 0.0, np.nan), z

    chain = sample_prior(positive, start, steps=60, seed=0)
    assert (start[:, 0] < 0.0).any()
    assert (chain.quantities[..., 0] > 0.0).all()
    with pytest.raises(InputError, match="finite at none"):
        sample_prior(lambda z, _: (np.full(len(z), np.nan), z), start, steps=5, seed=0)


def test_starts_are_drawn_by_their_likelihood():
    candidates = np.arange(3000.0)[:, None]
    likelihood = np.where(candidates[:, 0] < 1500, 0.0, np.log(3.0))
    chosen = draws_like(candidates, likelihood, 200, 4)[:, 0]
    assert len(set(chosen)) == 200
    assert np.mean(chosen >= 1500) == pytest.approx(0.75, abs=0.08)
    assert 7.0 in draws_like(candidates[:10], np.where(np.arange(10) == 7, 0.0, -1e3), 1, 0)


def test_the_likelihood_of_a_spectrum_is_the_density_of_its_errors():
    random = np.random.default_rng(2)
    reflectance = random.uniform(0.05, 0.4, (3, 4))
    error = 0.01 * np.eye(4) + 0.005
    observed = np.array([0.1, 0.2, 0.15, 0.3])
    for spectrum, found in zip(
        reflectance, spectrum_likelihood(observed, reflectance, error), strict=True
    ):
        offset = OFFSET_SD / spectrum
        total = error + OWN_SD**2 * np.eye(4) + np.outer(offset, offset)
        expected = scipy.stats.multivariate_normal.logpdf(np.log(observed), np.log(spectrum), total)
        assert found == pytest.approx(expected)
    dark = spectrum_likelihood(np.array([0.0, 0.2, 0.1, 0.1]), np.zeros((1, 4)), error)
    assert np.isfinite(dark).all()
