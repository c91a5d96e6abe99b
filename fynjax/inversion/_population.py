"""Population of plots: means, variation between plots and the model's remaining error.

A linear mixed model about linearised forward models (Lindstrom and Bates 1990, Biometrics 46:673):
what a plot deviates by is a random effect, and what no parameter explains is an error with a
covariance over the statistics. Variances are those of the marginal posterior, in which means and
random effects are integrated out (Laplace's approximation, exact where models are linear), by
expectation maximisation (Dempster, Laird and Rubin 1977, JRSS B 39:1).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision


@dataclass(frozen=True)
class LinearPlots:
    """Forward models of plots, linearised: y = f + J (theta - u) + e, theta = A mu + Z b."""

    residual: Float[np.ndarray, "plot statistic"]
    """y - f + J u, what the parameters have to explain."""
    slope: Float[np.ndarray, "plot statistic parameter"]
    """J, derivatives of the statistics by the plot's parameters theta."""
    design: Float[np.ndarray, "plot parameter mean"]
    """A, the plot's parameters by the population's means mu."""
    effects: Float[np.ndarray, "parameter effect"]
    """Z, the plot's parameters by its random effects b."""

    def without(self, plot: int) -> "LinearPlots":
        """All plots but one."""
        residual, slope, design = (
            np.delete(a, plot, axis=0) for a in (self.residual, self.slope, self.design)
        )
        return LinearPlots(residual, slope, design, self.effects)


@dataclass(frozen=True)
class Hyperprior:
    """What is known of a population beforehand."""

    mean: Float[np.ndarray, " mean"]
    covariance: Float[np.ndarray, "mean mean"]
    """Covariance of the means mu, whose distribution is normal."""
    sd: Float[np.ndarray, " effect"]
    """Expected standard deviations of the random effects."""
    sd_weight: float
    """Number of plots that knowledge of `sd` is worth: its inverse-gamma density falls as that many
    effects of just that variance."""
    error: Float[np.ndarray, "statistic statistic"]
    """Expected covariance of the error."""
    error_weight: float
    """Number of plots that knowledge of `error` is worth, an inverse-Wishart density."""
    known: int = 0
    """The last so many statistics have the variances of `error`, uncorrelated with the others."""

    def __post_init__(self) -> None:
        free = len(self.error) - self.known
        if np.any(self.error[:free, free:]) or np.any(self.error[free:, :free]):
            raise InputError(
                f"expected an error whose last {self.known} statistics, of known variance, are "
                "uncorrelated with the others, but some covariances are not 0"
            )


@dataclass(frozen=True)
class Population:
    """Estimate of a population."""

    mean: Float[np.ndarray, " mean"]
    covariance: Float[np.ndarray, "mean mean"]
    """Posterior covariance of the means, at the estimated variances."""
    sd: Float[np.ndarray, " effect"]
    """Standard deviation of the random effects between plots."""
    error: Float[np.ndarray, "statistic statistic"]
    """Covariance of the error."""
    effects: Float[np.ndarray, "plot effect"]
    """Posterior means of the plots' random effects."""
    log_posterior: Float[np.ndarray, " iteration"]
    """Logarithm of the posterior density of the variances before each iteration, up to a constant;
    it never falls."""


@double_precision
def fit_population(
    plots: LinearPlots,
    prior: Hyperprior,
    start: Population | None = None,
    *,
    most: int = 400,
    tolerance: float = 1e-3,
) -> Population:
    """Means, variances and error covariance of a population of linearised plots.

    **Arguments:**

    - `plots`: linearised forward models and data.
    - `prior`: of means, variances and error.
    - `start`: where to start; the prior by default.
    - `most`: iterations at most.
    - `tolerance`: ends where the log posterior gains less in an iteration.

    **Returns:** `Population`. Estimated variances are the mode of their marginal posterior, means
    and effects are posterior means at these. Not differentiable.
    """
    count, size = plots.residual.shape
    free = size - prior.known
    sd, error = prior.sd, prior.error.copy()
    if start is not None:
        sd, error[:free, :free] = start.sd, start.error[:free, :free]
    history: list[float] = []
    while True:
        e = _expect(plots, prior, sd, error)
        history.append(e.log_posterior)
        gained = len(history) < 2 or history[-1] - history[-2] > tolerance
        if not gained or len(history) > most:
            return Population(e.mean, e.covariance, sd, error, e.effects, np.array(history))
        weights = (prior.sd_weight, prior.error_weight)
        # The mode: expected squares of all plots and of as many more as the prior is worth.
        sd = np.sqrt((weights[0] * prior.sd**2 + e.squares) / (weights[0] + count))
        total = (weights[1] * prior.error + e.errors) / (weights[1] + count)
        error = prior.error.copy()
        error[:free, :free] = total[:free, :free]


@dataclass(frozen=True)
class _Expectation:
    mean: np.ndarray
    covariance: np.ndarray
    effects: np.ndarray
    squares: np.ndarray
    errors: np.ndarray
    log_posterior: float


def _expect(
    plots: LinearPlots, prior: Hyperprior, sd: np.ndarray, error: np.ndarray
) -> _Expectation:
    """Posterior of means and effects at the variances, and sums of squares over plots."""
    x, w = plots.slope @ plots.design, plots.slope @ plots.effects
    variance = np.diag(sd**2)
    # Covariance S of a plot's data about the population: random effects and error.
    marginal = w @ variance @ w.swapaxes(1, 2) + error
    # S^-1 of means, residuals and effects in one solution, plot by plot.
    both = np.linalg.solve(marginal, np.concatenate([x, plots.residual[..., None], w], axis=2))
    k = x.shape[2]
    sx, sr, sw = both[..., :k], both[..., k], both[..., k + 1 :]
    known = np.linalg.inv(prior.covariance)
    # Generalised least squares of the means, with their prior.
    covariance = np.linalg.inv(known + np.einsum("pmi,pmj->ij", x, sx))
    covariance = 0.5 * (covariance + covariance.T)
    mean = covariance @ (known @ prior.mean + np.einsum("pmi,pm->i", x, sr))
    rest = sr - sx @ mean  # S^-1 (r - X mu)
    # Best linear prediction: D W' S^-1 (r - X mu).
    effects = np.einsum("pmr,pm->pr", w, rest) * sd**2
    gain = variance @ w.swapaxes(1, 2)
    # Posterior covariance of the effects, and what the unknown means add to it.
    spread = variance - gain @ sw @ variance + _square(gain @ sx, covariance)
    squares = (effects**2).sum(axis=0) + np.einsum("prr->r", spread)
    # The error left in each plot, E S^-1 (r - X mu), and its posterior covariance.
    left = rest @ error
    inverse = np.linalg.inv(marginal)
    errors = left.T @ left + np.sum(
        error - error @ inverse @ error + _square(error @ sx, covariance), axis=0
    )
    return _Expectation(
        mean, covariance, effects, squares, errors,
        float(log_marginal(plots, prior, sd, error)),
    )  # fmt: skip


def _square(a: np.ndarray, middle: np.ndarray) -> np.ndarray:
    return a @ middle @ a.swapaxes(-1, -2)


@jax.jit
def _log_marginal(
    residual: Array, x: Array, w: Array, hyper: tuple[Array, ...], sd: Array, error: Array
) -> Array:
    centre, spread, expected, expected_error, sd_weight, error_weight = hyper
    marginal = w @ (sd[:, None] ** 2 * w.swapaxes(1, 2)) + error
    apart = residual - x @ centre
    solved = jnp.linalg.solve(marginal, jnp.concatenate([x, apart[..., None]], axis=2))
    # Means integrated out: by Woodbury's identity for the quadratic form, and by the lemma of
    # matrix determinants for |S + X C X'| = |S| |C| |C^-1 + X' S^-1 X|.
    precision = jnp.linalg.inv(spread) + jnp.einsum("pmi,pmj->ij", x, solved[..., :-1])
    score = jnp.einsum("pmi,pm->i", x, solved[..., -1])
    misfit = jnp.sum(apart * solved[..., -1]) - score @ jnp.linalg.solve(precision, score)

    def log_det(a: Array) -> Array:
        return jnp.linalg.slogdet(a)[1].sum()

    likelihood = misfit + log_det(marginal) + log_det(spread) + log_det(precision)
    # Inverse-gamma and inverse-Wishart densities that favour the expected variances.
    of_sd = jnp.sum(2.0 * jnp.log(sd) + (expected / sd) ** 2)
    free = expected_error.shape[0]
    inner = error[:free, :free]
    of_error = log_det(inner) + jnp.trace(jnp.linalg.solve(inner, expected_error))
    return -0.5 * (likelihood + sd_weight * of_sd + error_weight * of_error)


@double_precision
def log_marginal(
    plots: LinearPlots,
    prior: Hyperprior,
    sd: Float[Array | np.ndarray, " effect"],
    error: Float[Array | np.ndarray, "statistic statistic"],
) -> Array:
    """Log posterior density of the variances with means and effects integrated out.

    **Arguments:**

    - `plots`, `prior`: as for `fit_population`.
    - `sd`: standard deviations of the random effects.
    - `error`: covariance of the error.

    **Returns:** up to a constant. Differentiable in `sd` and `error`.
    """
    free = plots.residual.shape[1] - prior.known
    hyper = (
        prior.mean, prior.covariance, prior.sd, prior.error[:free, :free],
        jnp.asarray(prior.sd_weight, float), jnp.asarray(prior.error_weight, float),
    )  # fmt: skip
    x, w = plots.slope @ plots.design, plots.slope @ plots.effects
    return _log_marginal(plots.residual, x, w, hyper, jnp.asarray(sd), jnp.asarray(error))
