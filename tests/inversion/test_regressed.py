"""The regression on simulations of the prior against the posterior of a linear model."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError
from fynjax.inversion import (
    Data,
    ParameterSpace,
    TooFewSimulationsError,
    regress,
    simulated_parts,
    simulation_posterior,
)
from fynjax.inversion import _regressed as module

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


def test_chance_in_the_mean_of_draws_is_no_disagreement():
    """One statistic of many parameters, whose posterior is known by 100 draws."""
    flagged = {100.0: [], np.inf: []}
    for seed in range(40):
        random = np.random.default_rng(seed)
        slopes = random.normal(size=(1, MANY)) * 0.2
        measured = slopes @ random.normal(size=MANY) + random.normal(size=1)
        draws = random.normal(size=(300, MANY))
        found = regress(draws @ slopes.T + random.normal(size=(300, 1)) - measured, draws)
        covariance = np.linalg.inv(np.eye(MANY) + slopes.T @ slopes)
        mean = covariance @ slopes.T @ measured
        some = random.multivariate_normal(mean, covariance, 100)
        for size, flags in flagged.items():
            compared = found.compare(some.mean(axis=0), some.std(axis=0), size)
            flags.append(compared.scatter > compared.usual)
    assert np.mean(flagged[100.0]) < 0.25
    assert np.mean(flagged[np.inf]) > 0.5


def test_data_that_the_prior_does_not_make_are_said():
    random = np.random.default_rng(5)
    shares = []
    for _ in range(200):
        own = SLOPES @ random.normal(size=3) + random.normal(size=4)
        shares.append(regressed(own, 200).farther)
    assert np.mean(shares) == pytest.approx(0.5, abs=0.06)  # as often near as far
    assert np.quantile(shares, [0.1, 0.9]) == pytest.approx([0.1, 0.9], abs=0.07)
    assert regressed(np.array([0.0, 0.0, 0.0, 6.0])).farther < 0.001
    for count in (50, 300):  # none of few is as far: they cannot say one in a hundred
        assert regressed(np.array([0.0, 0.0, 0.0, 9.0]), count).impossible
        assert not regressed(MEASURED, count).impossible


@pytest.fixture
def linear_plot(monkeypatch):
    """A calibration whose renders are the linear model, and the count of these."""
    rendered = []

    def predicted(*arguments):
        u = arguments[-1]
        rendered.append(u)
        return jnp.asarray(SLOPES) @ u

    for name in ("PlotForward", "stand_realisation"):
        monkeypatch.setattr(module, name, lambda *_: None)
    monkeypatch.setattr(module, "predicted", predicted)
    space = ParameterSpace(
        tuple("abc"), [-9.0] * 3, [9.0] * 3, [0.0] * 3, [1.0] * 3, distribution="normal"
    )
    data = Data(tuple("stuv"), jnp.asarray(MEASURED), jnp.ones(4))
    fit = SimpleNamespace(names=space.names, space=space, data=data.along(np.eye(4)))
    calibration = SimpleNamespace(
        fit=fit, measured=data, stands=[None], lack=np.zeros(4), degrees=4,
        scene=SimpleNamespace(known_plants=True),
    )  # fmt: skip
    return calibration, rendered


def test_simulations_have_the_errors_of_the_data_once(linear_plot):
    found = simulation_posterior(linear_plot[0], None, (), simulations=3000)
    mean, sd = closed_form(MEASURED)
    assert found.mean == pytest.approx(mean, abs=0.07)
    assert found.sd == pytest.approx(sd, rel=0.05)
    with pytest.raises(TooFewSimulationsError, match=r"12 of 12 .* 4 statistics need 16"):
        simulation_posterior(linear_plot[0], None, (), simulations=12)


@pytest.mark.parametrize(("first", "then"), [(110, 300), (300, 110), (110, 120), (100, 200)])
def test_more_simulations_go_on_from_fewer(linear_plot, tmp_path, first, then):
    calibration, rendered = linear_plot
    whole = simulation_posterior(calibration, None, (), simulations=then)
    rendered.clear()
    for count in (first, then):
        keep = Journal(tmp_path, "mark")
        parts = simulated_parts(calibration, None, (), simulations=count)
        kept = np.concatenate([keep(part) for part in parts])
        found = simulation_posterior(calibration, None, (), simulations=count, rendered=kept)
    assert len(rendered) == 25 * -(-max(first, then) // 25)
    assert found.simulations == then
    assert found.mean == pytest.approx(whole.mean)
    assert found.sd == pytest.approx(whole.sd)


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
