"""The posterior by a regression on simulations of the prior: no search, no slopes, no surrogate, so
that it can say where these are wrong."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import ndtri

from fynjax._core.checkpoint import Keep, keep_nothing
from fynjax._core.extras import require
from fynjax._core.progress import NullProgress, Progress
from fynjax.inversion._calibrate import Calibration
from fynjax.inversion._fit import predicted_statistics
from fynjax.inversion._log_posterior import LogPosterior
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import AbstractView, PlotForward
from fynjax.scene import PlotParameters, stand_realisation

_PENALTIES = np.logspace(-1.0, 5.0, 13)
_PLANTINGS = 3000
"""Numbers of the plantings, none of which a search has."""
_APART, _NARROWER, _WIDER = 1.0, 0.6, 1.5
"""Beyond which two posteriors differ: of their means, in standard deviations of the regression; of
their standard deviations, as a share of the regression's."""


class RegressedPosterior(NamedTuple):
    """Normal posteriors of single parameters, in the normal coordinate of the prior of each, which
    is a unit normal there (`ParameterSpace.together`)."""

    mean: Float[np.ndarray, " free"]
    sd: Float[np.ndarray, " free"]
    farther: float
    """Share of the simulations and the measurement whose statistics lie at least as far from their
    mean as the measured ones (Mahalanobis distance) [-]: near 0 the prior does not make them."""
    simulations: int

    def quantiles(self, space: ParameterSpace, *shares: float) -> Float[np.ndarray, "share free"]:
        """Of each parameter of `space`, in its own unit."""
        return np.stack(
            [np.asarray(space.alone(jnp.asarray(self.mean + ndtri(p) * self.sd))) for p in shares]
        )

    def differs(
        self, mean: Float[np.ndarray, " free"], sd: Float[np.ndarray, " free"]
    ) -> np.ndarray:
        """Where another posterior does not agree: its mean lies more than a standard deviation off,
        or it is less than 0.6 or more than 1.5 times as wide.

        The regression knows what is linear in the statistics over the whole prior; so a posterior
        that is right may be narrower, and lies off by what it knows more.
        """
        off = np.abs(mean - self.mean) > _APART * self.sd
        return off | (sd < _NARROWER * self.sd) | (sd > _WIDER * self.sd)


def simulation_posterior(
    calibration: Calibration,
    parameters: PlotParameters,
    views: Sequence[AbstractView],
    *,
    simulations: int = 300,
    seed: int = 0,
    keep: Keep = keep_nothing,
    progress: Progress | None = None,
) -> RegressedPosterior:
    """The posterior of each parameter by a regression on simulations of the prior.

    Parameters are drawn from the prior, planted by chance and rendered in the cheap form, corrected
    by what that lacks at the estimate; errors of data, model and gains are drawn. On the statistics
    along the directions of the calibration's likelihood the parameters are regressed (regression
    adjustment: Beaumont et al. 2002, doi:10.1093/genetics/162.4.2025), and read off at the measured
    ones. Of the calibration it uses the stands, the directions and that correction, nothing of its
    slopes, covariances or estimate.

    **Arguments:**

    - `calibration`: of a plot whose plants stand by chance.
    - `parameters`: of the plot; those that are not free count.
    - `views`: in the cheap form (`search_form`).
    - `simulations`: how many.
    - `seed`: of parameters, plantings and errors.
    - `keep`: how the renders are done, such as by a `Journal`.
    - `progress`: where to report the renders; nowhere by default.

    **Raises:** `MissingExtraError` without scikit-learn.
    """
    fit, measured = calibration.fit, calibration.measured
    progress = NullProgress() if progress is None else progress
    forward = PlotForward(parameters, fit.names, tuple(views))
    random = np.random.default_rng([seed, 97])
    draws = random.normal(size=(simulations, len(fit.names)))
    count, none = len(calibration.stands), jnp.zeros(measured.value.shape)

    def step() -> tuple[Array, ...]:
        found = []
        for i, u in enumerate(draws):
            stand = stand_realisation(calibration.stands[i % count], _PLANTINGS + i)
            density = LogPosterior(forward, fit.space, measured, none, (stand,))
            found.append(predicted_statistics(density, jnp.asarray(u)))
            progress.advance()
        return (jnp.stack(found),)

    with progress.stage("Simulate the prior", len(draws)):
        rendered = np.asarray(keep(step)[0])
    root = np.linalg.cholesky(np.asarray(measured.covariance))
    simulated = rendered + calibration.lack + random.normal(size=rendered.shape) @ root.T
    finite = np.isfinite(simulated).all(axis=1)
    apart = simulated[finite] - np.asarray(measured.value)
    along = np.asarray(jax.vmap(fit.data.whiten)(jnp.asarray(apart)))[:, : calibration.degrees]
    own = np.asarray(jax.vmap(fit.space.together)(jnp.asarray(draws[finite])))
    return regress(along, own)


def regress(
    misfit: Float[np.ndarray, "simulation direction"], values: Float[np.ndarray, "simulation free"]
) -> RegressedPosterior:
    """Linear regression of parameters on misfits, read off where the misfit is zero.

    Ridge regression, whose penalty and error are those of simulations left out one at a time.

    **Arguments:**

    - `misfit`: statistics of simulations less the measured ones.
    - `values`: parameters of each, in coordinates where the prior is a unit normal.
    """
    linear = require("sklearn.linear_model", "posterior", "scikit-learn")
    scale = misfit.std(axis=0)
    features = misfit[:, scale > 0] / scale[scale > 0]
    model = linear.RidgeCV(_PENALTIES, alpha_per_target=True, store_cv_results=True)
    model.fit(features, values)
    error = model.cv_results_.mean(axis=0).min(axis=1)
    # The measurement counts among the rows that set mean and covariance: it is then as likely to
    # be any of them, however few they are.
    rows = np.vstack([features, np.zeros((1, features.shape[1]))])
    basis, size, _ = np.linalg.svd(rows - rows.mean(axis=0), full_matrices=False)
    distance = np.sum(basis[:, size > 1e-9 * size[0]] ** 2, axis=1)
    farther = float(np.mean(distance >= distance[-1]))
    mean = np.asarray(model.predict(np.zeros((1, features.shape[1])))).reshape(-1)
    return RegressedPosterior(mean, np.sqrt(error), farther, len(values))
