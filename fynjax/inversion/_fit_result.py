"""What was measured, and what a fit made of it: the estimate and how far to trust it."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import stdtrit

from fynjax._core.errors import InputError
from fynjax.inversion._space import ParameterSpace

SEEN = 0.75
"""Share of a parameter's prior variance that data must remove to have seen it [-]."""


class Data(eqx.Module):
    """What was measured."""

    names: tuple[str, ...] = eqx.field(static=True)
    value: Float[Array, " statistic"]
    sd: Float[Array, " statistic"]
    """Standard deviation, model error included, of each statistic."""
    whitener: Float[Array, "statistic statistic"] | None = None
    """Makes errors that hang together independent, of unit size; without it they are."""

    def with_scatter(self, deviations: Float[Array, "draw statistic"]) -> "Data":
        """The data with an error of the model added that moves all statistics together.

        **Arguments:** `deviations`, how far the statistics lie from the model's in draws of what
        it leaves to chance. Their second moments, shrunk half-way to the diagonal because
        draws are few, add to the variances.
        """
        moments = deviations.T @ deviations / deviations.shape[0]
        spread = jnp.diag(jnp.diagonal(moments))
        known = jnp.diag(self.sd**2)
        if self.whitener is not None:
            known = jnp.linalg.inv(self.whitener.T @ self.whitener)
        covariance = known + 0.5 * (moments + spread)
        whitener = jnp.linalg.inv(jnp.linalg.cholesky(covariance))
        return Data(self.names, self.value, jnp.sqrt(jnp.diagonal(covariance)), whitener)

    def whiten(self, misfit: Float[Array, " statistic *free"]) -> Float[Array, " statistic *free"]:
        """Misfits in units of the errors, independent of each other."""
        if self.whitener is not None:
            return self.whitener @ misfit
        return misfit / (self.sd[:, None] if misfit.ndim == 2 else self.sd)

    def __check_init__(self) -> None:
        bad = ~(np.isfinite(np.asarray(self.value)) & (np.asarray(self.sd) > 0))
        if bad.any():
            name = self.names[int(np.argmax(bad))]
            raise InputError(f"the target {name} must be finite and have a positive sd")


class FitResult(eqx.Module):
    """What a fit found, and how far to trust it."""

    space: ParameterSpace
    data: Data
    whitened: Float[Array, " free"]
    """The estimate in whitened coordinates."""
    estimate: Float[Array, " free"]
    """The estimate in the parameters' own units."""
    sd: Float[Array, " free"]
    """Its standard deviation (Laplace approximation), own units."""
    constrained: Float[Array, " free"]
    """1 - posterior over prior variance [-]: 0, the data say nothing; 1, they say all."""
    covariance: Float[Array, "free free"]
    """Posterior covariance in whitened coordinates, where the prior's is one."""
    predicted: Float[Array, " statistic"]
    """Statistics at the estimate."""
    jacobian: Float[Array, "statistic free"]
    """Derivative of the statistics by the whitened coordinates there."""
    information: Float[Array, " mode"]
    """Eigenvalues of the data's Fisher information in prior units, largest first: a direction
    with less than one is known from the prior rather than from the data."""
    modes: Float[Array, "mode free"]
    """Their eigenvectors in whitened coordinates."""
    loss: Float[np.ndarray, " evaluation"]
    """The objective after each evaluation, at the best point so far for least squares."""
    gradient_norm: Float[np.ndarray, " evaluation"]
    converged: bool = eqx.field(static=True)
    status: str = eqx.field(static=True)
    """Why the fit stopped, in words."""

    @property
    def names(self) -> tuple[str, ...]:
        return self.space.names

    def seen(self, least: float = SEEN) -> tuple[str, ...]:
        """Parameters whose variance the data cut by the share `least` or more; by default those
        whose standard deviation they at least halve."""
        return tuple(n for n, c in zip(self.names, np.asarray(self.constrained)) if c >= least)

    def marginal(
        self,
        deviations: Float[Array, "draw statistic"],
        jacobians: Float[Array, "draw statistic free"],
    ) -> "FitResult":
        """The same estimate, with the uncertainty that chance in the model leaves.

        What a model draws at random is not what the data were drawn from, so only what another
        draw would repeat is information (`repeated_information`). Errors of the data grow by the
        scatter of the statistics (`Data.with_scatter`).

        **Arguments:** `deviations`, how far the statistics at the estimate lie from the model's in
        other draws; `jacobians`, their derivatives there, as in `jacobian`.
        """
        data = self.data.with_scatter(deviations)
        draws = jax.vmap(data.whiten)(jnp.concatenate([self.jacobian[None], jacobians]))
        information = repeated_information(draws)
        return dataclasses.replace(self, **posterior(self.space, self.whitened, information))

    def unseen_directions(self, count: int = 3) -> list[dict[str, float]]:
        """The combinations of parameters that the data say least about, main members only."""
        return main_members(self.names, np.asarray(self.modes)[::-1][:count])


_SLIGHT = 0.05
"""A smaller weight is no member of a direction of length one."""


def main_members(
    names: tuple[str, ...], modes: Float[np.ndarray, "mode free"], most: int = 4
) -> list[dict[str, float]]:
    """The parameters that a direction is mostly made of, with their weights."""
    largest = [np.argsort(-np.abs(mode))[:most] for mode in modes]
    return [
        {names[i]: float(mode[i]) for i in some if abs(mode[i]) >= _SLIGHT}
        for mode, some in zip(modes, largest)
    ]


def repeated_information(
    draws: Float[Array, "draw statistic free"],
) -> Float[Array, "free free"]:
    """Fisher information of what every draw of a random model repeats.

    The mean of the products of two *different* draws' derivatives, since in the product of one
    with itself the chance part of a slope counts as knowledge. That mean may have negative
    eigenvalues. They are set to zero with each parameter in units of its slopes' size, lest one
    whose slopes are all chance drown the others. Each is then scaled to its own mean, less what
    chance alone exceeds in one case of forty: so many standard errors of the mean over the pairs
    (Student's t). Two draws make one pair, which says nothing of its error: then nothing counts as
    known.

    **Arguments:** `draws`, derivatives of the whitened statistics in each draw.
    """
    total, count = draws.sum(axis=0), draws.shape[0]
    same = jnp.einsum("dsi,dsj->ij", draws, draws)
    shared = (total.T @ total - same) / (count * (count - 1))
    size = jnp.sqrt(jnp.diagonal(same) / count)
    unit = jnp.where(size > 0, 1.0 / jnp.where(size > 0, size, 1.0), 0.0)
    values, vectors = jnp.linalg.eigh(shared * unit * unit[:, None])
    kept = (vectors * jnp.maximum(values, 0.0)) @ vectors.T
    first, second = jnp.triu_indices(count, 1)
    pairs = jnp.sum(draws[first] * draws[second], axis=1)  # [pair, free]
    if count < 3:
        own = jnp.zeros_like(size)
    else:
        error = jnp.std(pairs, axis=0, ddof=1) / np.sqrt(len(pairs))
        own = jnp.maximum(jnp.diagonal(shared) - stdtrit(count - 1, 0.975) * error, 0.0)
    raised = jnp.diagonal(kept)
    scale = jnp.sqrt(own / jnp.where(raised > 0, raised, 1.0)) * (raised > 0)
    return kept * scale * scale[:, None]


def posterior(space: ParameterSpace, u: Array, information: Array) -> dict[str, Any]:
    """Laplace approximation, from the data's information in whitened coordinates."""
    values, vectors = jnp.linalg.eigh(information)
    values, vectors = jnp.maximum(values[::-1], 0.0), vectors[:, ::-1]
    covariance = (vectors / (1.0 + values)) @ vectors.T
    variance = jnp.diagonal(covariance)
    return {
        "sd": jnp.sqrt(variance) * space.slope(u),
        "constrained": 1.0 - variance,
        "covariance": covariance,
        "information": values,
        "modes": vectors.T,
    }
