"""The regression on simulations of the prior against the posterior of a linear model."""

import numpy as np
import pytest

from fynjax.inversion import regress

pytest.importorskip("sklearn", reason="the extra `posterior` is not installed")

SLOPES = np.array([[2.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.3, -0.4, 0.0], [0.0, 0.2, 0.0]])
"""Of four statistics with unit errors by three parameters with unit normal priors, the last of
which changes nothing."""


def closed_form(measured):
    covariance = np.linalg.inv(np.eye(3) + SLOPES.T @ SLOPES)
    return covariance @ SLOPES.T @ measured, np.sqrt(np.diagonal(covariance))


def regressed(measured, count=3000, seed=0):
    random = np.random.default_rng(seed)
    draws = random.normal(size=(count, 3))
    return regress(draws @ SLOPES.T + random.normal(size=(count, 4)) - measured, draws)


MEASURED = np.array([2.5, -1.0, 0.5, 0.3])


def test_the_regression_is_the_posterior_of_a_linear_model():
    mean, sd = closed_form(MEASURED)
    found = regressed(MEASURED)
    assert found.mean == pytest.approx(mean, abs=0.06)
    assert found.sd == pytest.approx(sd, rel=0.04)
    assert not found.differs(mean, sd).any()


def test_its_error_counts_what_few_simulations_leave():
    """Standard deviations are those of simulations left out, not of those fitted."""
    sd = closed_form(MEASURED)[1]
    few = [regressed(MEASURED, 30, seed).sd for seed in range(30)]
    assert np.mean(few, axis=0) == pytest.approx(sd * np.sqrt(1.0 + 4.0 / 25.0), rel=0.12)
    assert (np.mean(few, axis=0)[:2] > sd[:2]).all()


def test_posteriors_that_are_off_or_too_narrow_or_too_wide_differ():
    mean, sd = closed_form(MEASURED)
    found = regressed(MEASURED)
    for one in range(3):
        place = np.arange(3) == one
        assert found.differs(mean + 1.3 * sd * place, sd)[one]
        assert found.differs(mean, np.where(place, 0.5 * sd, sd))[one]
        assert found.differs(mean, np.where(place, 1.7 * sd, sd))[one]
        assert found.differs(mean, np.where(place, 0.5 * sd, sd)).sum() == 1


def test_data_that_the_prior_does_not_make_are_said():
    random = np.random.default_rng(5)
    shares = []
    for _ in range(200):
        own = SLOPES @ random.normal(size=3) + random.normal(size=4)
        shares.append(regressed(own, 200).farther)
    assert np.mean(shares) == pytest.approx(0.5, abs=0.06)  # as often near as far
    assert np.quantile(shares, [0.1, 0.9]) == pytest.approx([0.1, 0.9], abs=0.07)
    assert regressed(np.array([0.0, 0.0, 0.0, 6.0])).farther < 0.001
