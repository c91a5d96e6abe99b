"""The regression against a posterior in closed form: linear model, normal prior, normal errors."""

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.inversion import INTERVALS, NetworkSettings, estimate_pixels, train_posterior

pytest.importorskip("optax")

SLOPE = np.array([[0.5, 0.1], [0.3, -0.4], [-0.1, 0.3], [0.2, 0.2]])
ERROR = 0.15**2 * (0.5 + 0.5 * np.eye(4))
QUICK = NetworkSettings(width=8, steps=2, batch=64)
BRIGHT = -0.7  # so bright that an error of 0.003 in reflectance is little


def simulated(count, seed):
    rng = np.random.default_rng(seed)
    quantities = rng.normal(size=(count, 2))
    return np.exp(BRIGHT + quantities @ SLOPE.T), quantities


@pytest.fixture(scope="module")
def trained():
    return train_posterior(*simulated(6000, 1), ERROR, training=NetworkSettings(4, 32, 1200, 512))


def closed_form(logs):
    precision = np.linalg.inv(ERROR + 1e-4 * np.eye(4))
    covariance = np.linalg.inv(np.eye(2) + SLOPE.T @ precision @ SLOPE)
    return (logs - BRIGHT) @ (covariance @ SLOPE.T @ precision).T, np.sqrt(np.diagonal(covariance))


def test_mean_and_spread_are_those_of_the_closed_form(trained):
    clean, truth = simulated(2000, 2)
    noise = np.random.default_rng(3).multivariate_normal(np.zeros(4), ERROR, 2000)
    logs = np.log(clean) + noise
    found = estimate_pixels(trained[0], jnp.asarray(np.exp(logs), jnp.float32))
    mean, sd = closed_form(logs)
    middle = np.all(np.abs(mean) < 1.5, axis=1)  # tails are of few simulations
    assert np.sqrt(np.mean((np.asarray(found.mean) - mean)[middle] ** 2)) < 0.15 * sd.mean()
    assert np.median(np.asarray(found.sd)[middle], axis=0) == pytest.approx(sd, rel=0.1)
    inside = (np.asarray(found.lower) <= truth) & (truth <= np.asarray(found.upper))
    assert inside.mean(axis=0) == pytest.approx(0.9, abs=0.03)


def test_held_out_coverage_is_reported_as_it_is(trained):
    held_out = trained[1]
    assert held_out.count == 900
    assert held_out.coverage == pytest.approx(np.array(INTERVALS)[:, None] * np.ones(2), abs=0.06)
    assert (held_out.explained > 0.5).all()


def test_spectra_that_nothing_simulated_makes_are_unlike(trained):
    posterior = trained[0]
    like = np.log(simulated(1000, 4)[0])
    like += np.random.default_rng(5).multivariate_normal(np.zeros(4), ERROR, 1000)
    share = np.mean(np.asarray(posterior.unlikeness(jnp.asarray(like, jnp.float32))) > 1.0)
    assert share == pytest.approx(0.01, abs=0.015)
    # Brighter in one channel alone by 1: six errors off, in a way that no quantity makes.
    odd = like + np.array([0.0, 0.0, 1.0, 0.0])
    assert np.mean(np.asarray(posterior.unlikeness(jnp.asarray(odd, jnp.float32))) > 1.0) > 0.9


def test_the_share_of_simulations_that_is_unlike_is_the_one_asked_for(trained):
    noise = np.random.default_rng(9).multivariate_normal(np.zeros(4), ERROR, 4000)
    logs = jnp.asarray(np.log(simulated(4000, 8)[0]) + noise, jnp.float32)
    for probability in (0.8, 0.9, 0.99):
        share = np.mean(np.asarray(trained[0].unlikeness(logs, probability)) < 1.0)
        assert share == pytest.approx(probability, abs=0.03)


CHANNELS = 16
SMALL = 0.05
WAVES = np.linalg.qr(np.random.default_rng(10).normal(size=(CHANNELS, CHANNELS)))[0].T


def unlike(quantities, logs):
    """How unlike `logs` are, trained on stands of which each quantity is along one of `WAVES`."""
    sizes = quantities @ WAVES[: quantities.shape[1]]
    error = SMALL**2 * np.eye(CHANNELS)
    posterior, _ = train_posterior(np.exp(BRIGHT + sizes), quantities, error, training=QUICK)
    return np.asarray(posterior.unlikeness(jnp.asarray(BRIGHT + logs, jnp.float32)))


def test_limits_of_few_stands_with_long_tails_are_those_of_others_of_their_kind():
    """A limit from the farthest of 15 stands scatters: the share beyond it was 1 to 15 %."""

    def stands(count, together, random):
        sizes = random.standard_t(4, size=(count, 2)).repeat(together, axis=0)
        return sizes + 0.2 * random.normal(size=sizes.shape)

    random = np.random.default_rng(13)
    others = 0.3 * stands(4000, 1, random) @ WAVES[:2]
    others = jnp.asarray(BRIGHT + others + SMALL * random.normal(size=others.shape), jnp.float32)
    shares = []
    for seed in range(6):
        quantities = stands(100, 12, np.random.default_rng(seed))
        posterior, _ = train_posterior(
            np.exp(BRIGHT + 0.3 * quantities @ WAVES[:2]), quantities,
            SMALL**2 * np.eye(CHANNELS), together=12, training=QUICK, seed=seed,
        )  # fmt: skip
        shares.append(np.mean(np.asarray(posterior.unlikeness(others)) > 1.0))
    assert np.mean(shares) == pytest.approx(0.01, abs=0.006)
    assert np.max(shares) < 0.03


def test_what_lies_between_simulations_is_unlike_them():
    """Stands have one of two quantities, never both: an ellipsoid around all holds both."""
    rng = np.random.default_rng(11)
    one = rng.random(4000) < 0.5
    quantities = rng.normal(size=(4000, 2)) * np.stack([one, ~one], axis=1)
    logs = np.array([[1.5, 0.0], [0.0, -1.5], [0.0, 0.0], [1.5, 1.5], [-1.2, 1.2]]) @ WAVES[:2]
    found = unlike(quantities, logs)
    assert (found[:3] < 1.0).all()
    assert (found[3:] > 2.0).all()
    ellipsoid = np.sum((logs @ WAVES[:2].T) ** 2, axis=1) / quantities.var(axis=0)[0]
    assert (ellipsoid < np.quantile(np.sum(quantities**2, axis=1) / 0.5, 0.99)).all()


def test_a_residual_is_not_hidden_by_the_tail_of_what_varies():
    """A tenth of the stands varies ten times as much: so far may not be what no stand does."""
    rng = np.random.default_rng(12)
    quantities = rng.normal(size=(4000, 1)) * np.where(rng.random((4000, 1)) < 0.1, 3.0, 0.3)
    residual = SMALL * 6.5 * WAVES[7]  # 42 where 15 channels have 15, and 99.5 % below 33
    found = unlike(quantities, np.stack([0.3 * WAVES[0], 3.0 * WAVES[0], residual]))
    assert (found[:2] < 1.0).all()
    assert found[2] > 1.0


def test_estimates_never_leave_what_was_simulated():
    clean, quantities = simulated(1500, 6)
    share = 1.0 / (1.0 + np.exp(-quantities))
    posterior, _ = train_posterior(clean, share, ERROR, training=NetworkSettings(16, 16, 100, 256))
    extreme = jnp.asarray(np.exp(np.random.default_rng(7).normal(-1.0, 2.0, (500, 4))), jnp.float32)
    found = estimate_pixels(posterior, extreme)
    for values in (found.mean, found.lower, found.upper):
        assert np.isfinite(np.asarray(values)).all()
        assert (np.asarray(values) > 0.0).all()
        assert (np.asarray(values) < 1.0).all()


def test_missing_values_stay_missing(trained):
    pixels = jnp.asarray([[0.5, 0.5, np.nan, 0.5], [0.5, 0.5, 0.5, 0.5]], jnp.float32)
    found = estimate_pixels(trained[0], pixels)
    assert np.isnan(np.asarray(found.unlikeness)).tolist() == [True, False]
    assert np.isnan(np.asarray(found.mean)[0]).all()
    assert np.isfinite(np.asarray(found.mean)[1]).all()
