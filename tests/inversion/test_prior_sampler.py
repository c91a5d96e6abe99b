"""Posteriors of draws of a prior, against those that are known in closed form."""

import numpy as np
import pytest
import scipy.stats

from fynjax._core.errors import InputError
from fynjax._core.sampling import effective_size
from fynjax.inversion import draws_like, sample_prior, spectrum_likelihood
from fynjax.inversion._amortised import OFFSET_SD, OWN_SD

NUMBERS, NOISE, CHANCE = 20, 0.4, 0.8
SLOPES = np.random.default_rng(1).normal(size=(2, NUMBERS)) * np.where(
    np.arange(NUMBERS) < 3, 0.8, 0.2
)
MEASURED = np.array([1.2, -0.8])


def linear(z):
    """Two measurements that are linear in the first numbers, and in the last, which are chance."""
    rest = (MEASURED - z[:, :NUMBERS] @ SLOPES.T - CHANCE * z[:, NUMBERS:]) / NOISE
    return -0.5 * np.sum(rest**2, axis=1), z[:, :3]


def test_the_posterior_of_a_linear_model_is_that_of_its_formula():
    """Chance counts as an error of the measurements."""
    start = np.random.default_rng(0).normal(size=(40, NUMBERS + 2))
    chain = sample_prior(linear, start, chance=2, steps=5000, seed=3)
    draws = chain.quantities[200:].reshape(-1, 3)
    error = (NOISE**2 + CHANCE**2) * np.eye(2)
    gain = SLOPES.T @ np.linalg.inv(SLOPES @ SLOPES.T + error)
    covariance = np.eye(NUMBERS) - gain @ SLOPES
    np.testing.assert_allclose(draws.mean(axis=0), (gain @ MEASURED)[:3], atol=0.05)
    np.testing.assert_allclose(np.cov(draws.T), covariance[:3, :3], atol=0.06)
    assert np.abs((gain @ MEASURED)[:3]).max() > 0.2
    assert covariance[:3, :3].diagonal().min() < 0.85
    assert 0.1 < chain.acceptance < 0.9


def test_chance_is_kept_in_two_of_three_proposals_and_drawn_anew_in_the_third():
    """Where all is accepted; chance of one step says nothing of that of another."""
    start = np.zeros((30, 5))
    chain = sample_prior(lambda z: (np.zeros(len(z)), z), start, chance=2, steps=400, seed=0)
    same = np.diff(chain.quantities, axis=0) == 0.0
    # The rest moves with the prior's density, so that not all is accepted.
    moved = ~same[..., 0]
    assert np.mean(same[..., 4][moved]) == pytest.approx(2 / 3, abs=0.05)
    np.testing.assert_array_equal(same[..., 3], same[..., 4])
    new = np.diff(chain.quantities[..., 4], axis=0)[~same[..., 4]]
    assert new.std() == pytest.approx(np.sqrt(2.0), abs=0.1)
    later = chain.quantities[50:].reshape(-1, 5)
    np.testing.assert_allclose(later.mean(axis=0), 0.0, atol=0.15)
    np.testing.assert_allclose(later.std(axis=0), 1.0, atol=0.1)


def test_the_same_seed_gives_the_same_chain_and_keeps_the_likelihood_of_its_draws():
    start = np.random.default_rng(0).normal(size=(6, NUMBERS))

    def exact(z):
        return -0.5 * np.sum((MEASURED - z @ SLOPES.T) ** 2, axis=1), z @ SLOPES.T

    one, other = (sample_prior(exact, start, steps=20, seed=5) for _ in range(2))
    np.testing.assert_array_equal(one.quantities, other.quantities)
    expected = -0.5 * np.sum((MEASURED - one.quantities) ** 2, axis=2)
    np.testing.assert_allclose(one.log_likelihood, expected, atol=1e-9)
    assert not np.array_equal(sample_prior(exact, start, steps=20, seed=6).quantities, one[0])


def test_an_interruption_prints_nothing(capsys):
    def interrupted(z):
        if calls.pop():
            raise KeyboardInterrupt
        return np.zeros(len(z)), z

    calls = [True, False]
    with pytest.raises(KeyboardInterrupt):
        sample_prior(interrupted, np.zeros((4, 3)), steps=5, seed=0)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(("time", "truth"), [(1.0, 3200), (20.0, 160), (200.0, 43), (1e9, 32)])
def test_slow_chains_do_not_look_as_if_they_mixed(time, truth):
    """100 steps of 32 walkers whose neighbours' correlation is that of an autocorrelation time
    `time`; `truth` is how many independent draws have a mean as certain."""
    kept = (time - 1.0) / (time + 1.0)
    random = np.random.default_rng(0)
    found = []
    for _ in range(20):
        chain = [random.normal(size=(32, 4))]
        for _ in range(99):
            new = np.sqrt(1.0 - kept**2) * random.normal(size=(32, 4))
            chain.append(kept * chain[-1] + new)
        found.append(effective_size(np.array(chain)))
    assert 0.4 * truth < np.mean(found) < 1.3 * truth


def test_draws_of_no_likelihood_are_refused():
    start = np.random.default_rng(0).normal(size=(8, 3))
    start[0] = 1.0

    def positive(z):
        return np.where(z[:, 0] > 0.0, 0.0, np.nan), z

    chain = sample_prior(positive, start, steps=60, seed=0)
    assert (start[:, 0] < 0.0).any()
    assert (chain.quantities[..., 0] > 0.0).all()
    with pytest.raises(InputError, match="finite at none"):
        sample_prior(lambda z: (np.full(len(z), np.nan), z), start, steps=5, seed=0)


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
