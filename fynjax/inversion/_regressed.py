"""The posterior by a regression on simulations of the prior: no search, no slopes, no surrogate, so
that it can say where these are wrong."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtri

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.precision import double_precision
from fynjax.inversion._calibrate import Calibration
from fynjax.inversion._expected import FARTHEST, plants_wanted, predicted
from fynjax.inversion._fit_result import FitResult
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import AbstractView, PlotForward
from fynjax.scene import PlotParameters, room_needed, stand_realisation

_PENALTIES = np.logspace(-1.0, 5.0, 13)
_PLANTINGS = 3000
"""Numbers of the plantings, none of which a search has."""
AT_ONCE = 25
"""Simulations that are kept together."""
_ROWS = 4
"""Simulations for each statistic, at least: with fewer the regression knows less than the prior."""
KNOWN = 0.25
"""Share of the prior variance from which on a parameter counts as known, by either posterior."""
OFF, NARROWER, WIDER = 1.0, 0.6, 1.5
"""Beyond which two posteriors of a parameter differ: of their means, in standard deviations of the
regression; of their standard deviations, as a share of the regression's."""


class TooFewSimulationsError(InputError):
    """Of the simulations of a regression too few are of use."""


class Comparison(NamedTuple):
    """Another posterior held against a regression, parameter by parameter."""

    known: Bool[np.ndarray, " free"]
    """Either knows more than `KNOWN` of it: others agree by being their priors."""
    off: Bool[np.ndarray, " free"]
    """Known, and the means lie more than `OFF` apart, or the other is more than `WIDER`."""
    narrower: Bool[np.ndarray, " free"]
    """Known, and the other is less than `NARROWER`: too sure, or it knows what bends."""
    distance: Float[np.ndarray, " free"]
    """Between the means [standard deviations of the regression]."""
    scatter: float
    """Root mean square, over all parameters, of the distance of the means over what a right
    posterior that knows more would lie off."""
    usual: float
    """What `scatter` stays below if both are right, in all but a few of a hundred plots; in nine of
    ten where the statistics are one or two."""


class RegressedPosterior(NamedTuple):
    """Normal posteriors of single parameters, in the normal coordinate of the prior of each, which
    is a unit normal there (`ParameterSpace.together`)."""

    mean: Float[np.ndarray, " free"]
    sd: Float[np.ndarray, " free"]
    leverage: float
    """Variance that the regression itself has at the measurement, as a share of `sd` squared."""
    farther: float
    """Share of the simulations and the measurement whose statistics lie at least as far from their
    mean as the measured ones (Mahalanobis distance) [-]: near 0 the prior does not make them."""
    simulations: int

    @property
    def impossible(self) -> bool:
        """Whether at most one in a hundred simulations, or none, lies so far out."""
        return self.farther < max(0.01, 1.5 / (self.simulations + 1))

    @double_precision
    def quantiles(self, space: ParameterSpace, *shares: float) -> Float[np.ndarray, "share free"]:
        """Of each parameter of `space`, in its own unit."""
        return np.stack(
            [np.asarray(space.alone(jnp.asarray(self.mean + ndtri(p) * self.sd))) for p in shares]
        )

    def compare(
        self,
        mean: Float[np.ndarray, " free"],
        sd: Float[np.ndarray, " free"],
        size: float = np.inf,
    ) -> Comparison:
        """Hold another posterior of the same parameters, in the same coordinates, against it, known
        by draws of the effective `size`.

        The regression knows what is linear in the statistics over the whole prior. A posterior that
        is right may know more: then the variances of both differ by that of their means.
        """
        known = np.minimum(sd, self.sd) ** 2 < 1.0 - KNOWN
        apart = np.abs(mean - self.mean)
        expected = np.maximum(self.sd**2 - sd**2, 0.0) + self.leverage * self.sd**2 + sd**2 / size
        off = (apart > OFF * self.sd) | (sd > WIDER * self.sd)
        return Comparison(
            known, known & off, known & ~off & (sd < NARROWER * self.sd), apart / self.sd,
            float(np.sqrt(np.mean(apart**2 / expected))), 0.9 + 1.2 / np.sqrt(len(sd)),
        )  # fmt: skip


@double_precision
def simulation_posterior(
    calibration: Calibration,
    parameters: PlotParameters,
    views: Sequence[AbstractView],
    *,
    simulations: int = 300,
    seed: int = 0,
    rendered: Float[np.ndarray, "simulation statistic"] | None = None,
) -> RegressedPosterior:
    """The posterior of each parameter by a regression on simulations of the prior.

    Parameters are drawn from the prior (up to 2.2 standard deviations, as a search does), planted
    by chance and rendered in the cheap form, corrected by what that lacks at the estimate; errors
    of the data, the model's light and the camera's gains are drawn. On the statistics along the
    directions of the calibration's likelihood the parameters are regressed, and read off at the
    measured ones (Bayes linear; the regression of Beaumont et al. 2002,
    doi:10.1093/genetics/162.4.2025, without their weights). Of the calibration it uses the stands,
    the directions, that correction and the slopes of the gains; none of the slopes by parameters,
    and neither its estimate nor its covariances otherwise.

    **Arguments:**

    - `calibration`: of a plot.
    - `parameters`: of the plot; those that are not free count.
    - `views`: in the cheap form (`search_form`).
    - `simulations`: how many. More of them begin with those of fewer.
    - `seed`: of parameters, plantings and errors.
    - `rendered`: what `simulated_parts` of the same arguments gives, one after the other; done here
      if left out.

    **Raises:** `TooFewSimulationsError` where too few have the plants they ask for and all
    statistics; `MissingExtraError` without scikit-learn.
    """
    fit, measured = calibration.fit, calibration.measured
    if rendered is None:
        parts = simulated_parts(calibration, parameters, views, simulations=simulations, seed=seed)
        rendered = np.concatenate([part() for part in parts])
    draws = _draws(fit, simulations, seed)[:simulations]
    cheap = rendered[:simulations]
    root = np.linalg.cholesky(np.asarray(measured.covariance))
    errors = np.random.default_rng([seed, 98]).normal(size=cheap.shape) @ root.T
    simulated = cheap + calibration.lack + errors
    whole = np.isfinite(simulated).all(axis=1)
    if not calibration.scene.known_plants:
        wanted = plants_wanted(calibration.stands[0], parameters, fit.space, jnp.asarray(draws))
        whole &= [not room_needed(calibration.stands[0], parameters, n).any() for n in wanted]
    apart = simulated[whole] - np.asarray(measured.value)
    if len(apart) < _ROWS * calibration.degrees:
        raise TooFewSimulationsError(
            f"{len(apart)} of {simulations} simulations have their plants and all statistics, and "
            f"{calibration.degrees} statistics need {_ROWS * calibration.degrees}. Simulate more"
        )
    along = np.asarray(jax.vmap(fit.data.whiten)(jnp.asarray(apart)))[:, : calibration.degrees]
    return regress(along, np.asarray(jax.vmap(fit.space.together)(jnp.asarray(draws[whole]))))


@double_precision
def simulated_parts(
    calibration: Calibration,
    parameters: PlotParameters,
    views: Sequence[AbstractView],
    *,
    simulations: int,
    seed: int = 0,
) -> list[Callable[[], Float[np.ndarray, "simulation statistic"]]]:
    """The coarse renders of draws of the prior, in parts of `AT_ONCE`, for who watches or keeps
    them: functions that do a part each. The parts of fewer simulations are the first of more.

    **Arguments:** `calibration`, `parameters`, `views`, `simulations`, `seed`: as of
    `simulation_posterior`.
    """
    fit, count = calibration.fit, len(calibration.stands)
    forward = PlotForward(parameters, fit.names, tuple(views))
    draws = _draws(fit, simulations, seed)

    def part(first: int) -> Float[np.ndarray, "simulation statistic"]:
        found = []
        for i in range(first, first + AT_ONCE):
            stand = stand_realisation(calibration.stands[i % count], _PLANTINGS + i)
            found.append(predicted(forward, fit.space, stand, jnp.asarray(draws[i])))
        return np.asarray(jnp.stack(found))

    return [partial(part, first) for first in range(0, len(draws), AT_ONCE)]


def _draws(fit: FitResult, simulations: int, seed: int) -> Float[np.ndarray, "simulation free"]:
    total = -(-simulations // AT_ONCE) * AT_ONCE  # parts are alike, whatever is asked for
    draws = np.random.default_rng([seed, 97]).normal(size=(total, len(fit.names)))
    return draws.clip(-FARTHEST, FARTHEST)


@double_precision
def regress(
    misfit: Float[np.ndarray, "simulation direction"], values: Float[np.ndarray, "simulation free"]
) -> RegressedPosterior:
    """Linear regression of parameters on misfits, read off where the misfit is zero.

    Ridge regression, whose penalty and error are those of simulations left out one at a time.

    **Arguments:**

    - `misfit`: statistics of simulations less the measured ones.
    - `values`: parameters of each, in coordinates where the prior is a unit normal.

    **Raises:** `InputError` for misfits of which none varies; `MissingExtraError` without
    scikit-learn.
    """
    linear = require("sklearn.linear_model", "posterior", "scikit-learn")
    scale = misfit.std(axis=0)
    varies = scale > 1e-9 * np.abs(misfit).max(axis=0, initial=0.0)
    if not varies.any():
        raise InputError("the statistics of all simulations are the same")
    features = misfit[:, varies] / scale[varies]
    model = linear.RidgeCV(_PENALTIES, alpha_per_target=True, store_cv_results=True)
    model.fit(features, values)
    error = model.cv_results_.mean(axis=0).min(axis=1)
    # The measurement counts among the rows that set mean and covariance: it is then as likely to
    # be any of them, however few they are.
    rows = np.vstack([features, np.zeros((1, features.shape[1]))])
    basis, size, _ = np.linalg.svd(rows - rows.mean(axis=0), full_matrices=False)
    distance = np.sum(basis[:, size > 1e-9 * size[0]] ** 2, axis=1) + 1.0 / len(rows)
    mean = np.asarray(model.predict(np.zeros((1, features.shape[1])))).reshape(-1)
    return RegressedPosterior(
        mean,
        np.sqrt(error),
        float(distance[-1] / max(1.0 - distance[-1], 1e-9)),
        float(np.mean(distance >= distance[-1])),
        len(values),
    )
