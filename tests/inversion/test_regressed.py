"""The regression on simulations of the prior against the posterior of a linear model."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
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
    compared = found.compare(mean, sd)
    assert compared.known.tolist() == [True, True, False]
    assert not compared.off.any()
    assert not compared.narrower.any()


def test_its_error_counts_what_few_simulations_leave():
    """Standard deviations are those of simulations left out, not of those fitted."""
    sd = closed_form(MEASURED)[1]
    few = [regressed(MEASURED, 30, seed).sd for seed in range(30)]
    assert np.mean(few, axis=0) == pytest.approx(sd * np.sqrt(1.0 + 4.0 / 25.0), rel=0.12)
    assert (np.mean(few, axis=0)[:2] > sd[:2]).all()


def test_posteriors_that_are_off_or_too_sure_or_too_wide_are_named():
    mean, sd = closed_form(MEASURED)
    found = regressed(MEASURED)
    for one in range(2):
        place = np.arange(3) == one
        assert found.compare(mean + 1.3 * sd * place, sd).off.tolist() == place.tolist()
        sure = found.compare(mean, np.where(place, 0.5 * sd, sd))
        assert sure.narrower.tolist() == place.tolist()
        assert not sure.off.any()
        assert found.compare(mean, np.where(place, 1.7 * sd, sd)).off.tolist() == place.tolist()
    # Of the third both know nothing: what is said of it counts only if it is said to be known.
    nothing = np.array([False, False, True])
    assert not found.compare(mean + 1.3 * nothing, sd).off.any()
    assert found.compare(mean + 1.3 * nothing, np.where(nothing, 0.4, sd)).off[2]


WIDE, MANY = 24, 76
STRENGTH = np.concatenate([np.full(4, 1.2), np.full(8, 0.4), np.full(64, 0.06)])


def many(seed, wrong=1.0):
    """How a posterior of many parameters compares that takes errors for `wrong` times what they
    are, and how far out the measurement is, with as many statistics as an image has directions."""
    random = np.random.default_rng(seed)
    slopes = random.normal(size=(WIDE, MANY)) * STRENGTH
    measured = slopes @ random.normal(size=MANY) + random.normal(size=WIDE)
    draws = random.normal(size=(300, MANY))
    found = regress(draws @ slopes.T + random.normal(size=(300, WIDE)) - measured, draws)
    covariance = np.linalg.inv(np.eye(MANY) + slopes.T @ slopes / wrong**2)
    mean = covariance @ slopes.T @ measured / wrong**2
    return found.compare(mean, np.sqrt(np.diagonal(covariance))), found.farther


def test_right_posteriors_agree_and_one_of_too_small_errors_does_not():
    right = [many(seed) for seed in range(40)]
    assert np.mean([one.off.any() or one.narrower.any() for one, _ in right]) < 0.15
    assert np.mean([one.scatter > one.usual for one, _ in right]) < 0.05
    wrong = [many(seed, 0.4)[0] for seed in range(40)]
    assert np.mean([one.scatter > one.usual or one.off.any() for one in wrong]) > 0.8
    shares = np.array([farther for _, farther in right])
    assert np.mean(shares) == pytest.approx(0.5, abs=0.13)
    assert np.mean(shares < 0.05) < 0.15


def test_data_that_the_prior_does_not_make_are_said():
    random = np.random.default_rng(5)
    shares = []
    for _ in range(200):
        own = SLOPES @ random.normal(size=3) + random.normal(size=4)
        shares.append(regressed(own, 200).farther)
    assert np.mean(shares) == pytest.approx(0.5, abs=0.06)  # as often near as far
    assert np.quantile(shares, [0.1, 0.9]) == pytest.approx([0.1, 0.9], abs=0.07)
    assert regressed(np.array([0.0, 0.0, 0.0, 6.0])).farther < 0.001


@pytest.mark.parametrize("columns", [[0], [0, 0], [0, 4], [0, 1, 2, 3, 4]])
def test_a_single_a_repeated_and_a_constant_statistic_are_no_obstacle(columns):
    random = np.random.default_rng(3)
    values = random.normal(size=(200, 1))
    statistics = np.hstack([values + random.normal(size=(200, 4)), np.full((200, 1), 0.1)])
    found = regress(statistics[:, columns], values)
    assert found.mean.shape == found.sd.shape == (1,)
    assert 0.0 < found.sd[0] < 1.0
    assert 0.0 < found.farther <= 1.0
    with pytest.raises(InputError, match="are the same"):
        regress(statistics[:, [4]], values)
