"""A population of linear plots with known truth comes back; estimates against closed forms."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.inversion import Hyperprior, LinearPlots, fit_population
from fynjax.inversion._population import log_marginal

MEANS, EFFECTS, STATISTICS, PLOTS = 4, 2, 12, 60
MU, SD = np.array([0.8, -0.5, 0.3, 0.0]), np.array([0.6, 0.25])
EFFECT = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
"""Two parameters share an effect, as dead tissue of all growth forms does."""


def error_covariance() -> np.ndarray:
    at = np.linspace(0.0, 3.0, STATISTICS)
    return 0.05**2 * (np.exp(-np.abs(at[:, None] - at)) + 0.1 * np.eye(STATISTICS))


def simulate(seed: int) -> tuple[LinearPlots, np.ndarray]:
    """Plots of the truth above, linearised at no parameter's true value, with their effects."""
    random = np.random.default_rng(seed)
    slope = random.normal(size=(PLOTS, STATISTICS, 3))
    design = np.zeros((PLOTS, 3, MEANS))
    design[:, range(3), range(3)] = 1.0
    design[:, 0, 3] = random.normal(size=PLOTS)  # a covariate
    effects = random.normal(size=(PLOTS, EFFECTS)) * SD
    theta = design @ MU + effects @ EFFECT.T
    error = random.multivariate_normal(np.zeros(STATISTICS), error_covariance(), PLOTS)
    measured = np.einsum("pmi,pi->pm", slope, theta) + error
    return LinearPlots(measured, slope, design, EFFECT), effects


PRIOR = Hyperprior(
    np.zeros(MEANS), np.eye(MEANS), np.full(EFFECTS, 0.4), 2.0,
    0.1**2 * np.eye(STATISTICS), 3.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def estimate():
    plots, effects = simulate(3)
    return plots, effects, fit_population(plots, PRIOR, tolerance=1e-7, most=2000)


def test_the_truth_lies_within_what_the_estimate_leaves(estimate) -> None:
    _, effects, found = estimate
    off = found.mean - MU
    assert off @ np.linalg.solve(found.covariance, off) < 13.3  # 99 % of chi2 with 4
    np.testing.assert_allclose(found.sd, SD, rtol=3.0 / np.sqrt(2 * PLOTS))
    # What all effects share cannot be told from the means.
    apart = found.effects - found.effects.mean(axis=0) - (effects - effects.mean(axis=0))
    np.testing.assert_allclose(apart, 0.0, atol=0.12)
    truth = error_covariance()
    sd = np.sqrt(np.diagonal(found.error))
    np.testing.assert_allclose(sd, np.sqrt(np.diagonal(truth)), rtol=0.35)
    correlation = found.error / np.outer(sd, sd)
    expected = truth / np.sqrt(np.outer(np.diagonal(truth), np.diagonal(truth)))
    np.testing.assert_allclose(correlation, expected, atol=0.4)


def test_no_step_loses_and_the_end_is_where_the_marginal_density_is_flat(estimate) -> None:
    plots, _, found = estimate
    assert np.all(np.diff(found.log_posterior) > -1e-8)
    assert found.log_posterior[-1] - found.log_posterior[0] > 10.0

    def density(log_sd, log_scale):
        scale = jnp.exp(log_scale)
        return log_marginal(plots, PRIOR, jnp.exp(log_sd), found.error * scale)

    slopes = jax.grad(density, argnums=(0, 1))(jnp.log(found.sd), jnp.zeros(()))
    for slope in slopes:
        np.testing.assert_allclose(slope, 0.0, atol=0.05)
    away = jax.grad(density)(jnp.log(2.0 * found.sd), jnp.zeros(()))
    assert np.all(away < -1.0)


def test_the_marginal_density_is_that_of_all_data_at_once() -> None:
    plots, _ = simulate(5)
    few = LinearPlots(plots.residual[:3], plots.slope[:3], plots.design[:3], plots.effects)
    error = error_covariance()
    x, w = few.slope @ few.design, few.slope @ few.effects

    def exact(sd):
        blocks = np.zeros((3, STATISTICS, 3, STATISTICS))
        for p in range(3):
            blocks[p, :, p, :] = w[p] @ np.diag(sd**2) @ w[p].T + error
        joined = x.reshape(-1, MEANS)
        covariance = blocks.reshape(len(joined), -1) + joined @ PRIOR.covariance @ joined.T
        y = few.residual.ravel() - joined @ PRIOR.mean
        likelihood = -0.5 * (np.linalg.slogdet(covariance)[1] + y @ np.linalg.solve(covariance, y))
        return likelihood - 0.5 * PRIOR.sd_weight * np.sum(2 * np.log(sd) + (PRIOR.sd / sd) ** 2)

    ends = np.array([0.3, 0.5]), np.array([0.7, 0.2])
    difference = [float(log_marginal(few, PRIOR, sd, error)) for sd in ends]
    assert difference[1] - difference[0] == pytest.approx(exact(ends[1]) - exact(ends[0]), abs=1e-6)


def test_a_statistic_of_known_error_keeps_it_and_informs() -> None:
    plots, _ = simulate(7)
    known = np.zeros((PLOTS, 1, 3))
    known[:, 0, 2] = 1.0
    more = replace(
        plots,
        residual=np.column_stack([plots.residual, np.full(PLOTS, 0.3)]),
        slope=np.concatenate([plots.slope, known], axis=1),
    )
    error = np.zeros((STATISTICS + 1, STATISTICS + 1))
    error[:-1, :-1], error[-1, -1] = PRIOR.error, 1e-4
    prior = replace(PRIOR, error=error, known=1)
    alone, both = fit_population(plots, PRIOR), fit_population(more, prior)
    assert both.error[-1, -1] == 1e-4
    assert np.all(both.error[-1, :-1] == 0.0)
    # Nor can a start bring another.
    spoilt = both.error.copy()
    spoilt[-1, -1] = 1.0
    assert fit_population(more, prior, replace(both, error=spoilt)).error[-1, -1] == 1e-4
    # Every plot says 0.3 within 0.01: the third parameter hardly differs between plots.
    assert both.sd[1] < 0.4 * alone.sd[1]
    assert both.mean[2] == pytest.approx(0.3, abs=0.02)


def test_a_known_variance_is_of_a_statistic_by_itself() -> None:
    error = np.eye(STATISTICS)
    error[0, -1] = error[-1, 0] = 0.1
    with pytest.raises(ValueError, match="last 1 statistics"):
        replace(PRIOR, error=error, known=1)


def test_a_plot_left_out_does_not_count() -> None:
    plots, _ = simulate(9)
    spoilt = replace(plots, residual=plots.residual.copy())
    spoilt.residual[4] += 100.0
    whole, rest = (fit_population(p.without(4), PRIOR) for p in (plots, spoilt))
    np.testing.assert_array_equal(whole.mean, rest.mean)
    assert len(whole.effects) == PLOTS - 1
