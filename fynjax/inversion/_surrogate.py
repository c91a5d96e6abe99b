"""Statistics near an estimate without a render, for chains that ask for a hundred thousand."""

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.seeds import generator
from fynjax.inversion._calibrate import Calibration, Plantings
from fynjax.inversion._expected import predicted
from fynjax.inversion._fit_result import FitResult
from fynjax.inversion._views import PlotForward

_CURVED = 6
"""Directions along which a surrogate bends: those that the data know most."""
_RENDERS, _LEFT_OUT = 60, 12
"""Coarse renders that it is fitted to, and those of them that tell its error."""
_SPREAD = 1.5
"""Standard deviations of the posterior over which these lie."""


class Surrogate(eqx.Module):
    """Statistics expected over plantings: linear in all parameters, with a quadratic polynomial
    along the directions that the data know most.

    A forward model as `sample_posterior` takes it. Differentiable.
    """

    fit: FitResult
    """The fit about whose estimate the surrogate holds."""
    directions: Float[Array, "direction free"]
    curvature: Float[Array, "term statistic"]
    level: Float[Array, " statistic"]
    """Mean of the quadratic part over the posterior: the fit's statistics, which are expectations,
    hold it already."""

    def __call__(self, values: Float[Array, " free"]) -> Float[Array, " statistic"]:
        fit = self.fit
        # Around the estimate, in whitened coordinates, where the posterior is nearly normal.
        away = fit.space.whitened(values) - fit.whitened
        bent = _terms(self.directions @ away) @ self.curvature
        return fit.predicted - self.level + fit.jacobian @ away + bent


class FittedSurrogate(NamedTuple):
    """A surrogate, and how far to trust it."""

    surrogate: Surrogate
    error: Float[np.ndarray, " statistic"]
    """Root mean square error of renders that were left out, in units of the errors of the data."""


@double_precision
def fit_surrogate(
    calibration: Calibration,
    *,
    seed: int = 0,
    rendered: Float[np.ndarray, "draw statistic"] | None = None,
) -> FittedSurrogate:
    """A surrogate of the statistics about the estimate of a calibration.

    Coarse renders at draws of one and a half times the Laplace posterior show how statistics bend.
    Each is compared with the same plants at the estimate, so that plantings scatter them little.

    **Arguments:**

    - `calibration`: with one or more stands.
    - `seed`: of the draws.
    - `rendered`: what `surrogate_renders` of the same arguments gives; done here if left out.
    """
    fit = calibration.fit
    if rendered is None:
        renders = surrogate_renders(calibration, seed=seed)
        rendered = np.stack(list(renders))
    plantings = _plantings(calibration)
    centre, draws, count = np.asarray(fit.whitened), _draws(fit, seed), len(plantings.stands)
    at_centre, slopes = plantings.statistics, np.asarray(fit.jacobian)
    away = draws - centre
    # What the slopes leave of the change from the same planting at the estimate.
    bent = np.stack(
        [
            value - at_centre[i % count] - slopes @ move
            for i, (value, move) in enumerate(zip(rendered, away, strict=True))
        ]
    )
    # Slopes were taken along the directions that count: beyond, all change would seem a bend.
    bent = bent @ plantings.projector.T
    directions = jnp.asarray(np.asarray(fit.modes)[:_CURVED])
    terms = np.asarray(_terms(jnp.asarray(away) @ directions.T))
    # Fitted to all draws but the first, which then show the error.
    fitted = slice(_LEFT_OUT, None)
    curvature = np.linalg.lstsq(terms[fitted], bent[fitted])[0]
    rest = (bent - terms @ curvature)[:_LEFT_OUT]
    along = np.asarray(directions) @ plantings.spread
    # The mean of a product of two coordinates over the posterior is their covariance.
    over = along @ along.T
    level = over[np.triu_indices(len(directions))] @ curvature[len(directions) :]
    error = np.sqrt(np.mean(rest**2, axis=0)) / np.asarray(fit.data.sd)
    surrogate = Surrogate(fit, directions, jnp.asarray(curvature), jnp.asarray(level))
    return FittedSurrogate(surrogate, error)


@double_precision
def surrogate_renders(
    calibration: Calibration, *, seed: int = 0
) -> Iterator[Float[np.ndarray, " statistic"]]:
    """The coarse renders that a surrogate is fitted to, one by one, for who watches or keeps them.

    **Arguments:** `calibration`, `seed`: as of `fit_surrogate`.
    """
    fit, plantings = calibration.fit, _plantings(calibration)
    forward = PlotForward(calibration.before, fit.names, plantings.views)
    factors = calibration.coordinates[len(fit.names) :]  # as estimated, where slopes were taken
    for i, u in enumerate(track(_draws(fit, seed), "Fit a surrogate", _RENDERS)):
        stand = plantings.stands[i % len(plantings.stands)].expected()
        place = jnp.asarray(np.concatenate([u, factors]))
        yield np.asarray(predicted(forward, calibration.space, stand, place))


def _plantings(calibration: Calibration) -> Plantings:
    if calibration.plantings is None:
        raise InputError(
            "expected a calibration of plants that stand by chance: of known plants every pixel "
            "counts, and the posterior is the estimate with its covariance"
        )
    return calibration.plantings


def _draws(fit: FitResult, seed: int) -> Float[np.ndarray, "draw free"]:
    random = generator(seed, 71)
    centre, covariance = np.asarray(fit.whitened), np.asarray(fit.covariance)
    return random.multivariate_normal(centre, _SPREAD**2 * covariance, _RENDERS, method="eigh")


def _terms(z: Float[Array, "*draw direction"]) -> Float[Array, "*draw term"]:
    """The coordinates, and all products of two."""
    first, second = np.triu_indices(z.shape[-1])
    return jnp.concatenate([z, z[..., first] * z[..., second]], axis=-1)
