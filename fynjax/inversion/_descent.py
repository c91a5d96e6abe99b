"""Levenberg-Marquardt with slopes that each step corrects."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from fynjax.inversion._fit_result import FitStatus


class Descended(NamedTuple):
    """Where a descent ended."""

    u: Float[np.ndarray, " free"]
    value: Float[np.ndarray, " statistic"]
    """Statistics there."""
    jacobian: Float[np.ndarray, "statistic free"]
    """Their slopes there, as corrected."""
    status: Any
    """A `FitStatus`."""


def descend(
    evaluate: Callable[[Float[np.ndarray, " free"]], Float[np.ndarray, " statistic"]],
    start: Descended,
    target: Float[np.ndarray, " statistic"],
    weights: Any,
    *,
    most: int,
    tolerance: float,
    note: Callable[[float, float], None],
) -> Descended:
    """Lower half the squared whitened misfit and distance from the prior.

    Each step corrects the slopes by what it changed (Broyden 1965), as new ones cost as much as
    tens of evaluations.

    **Arguments:**

    - `evaluate`: statistics at whitened coordinates.
    - `start`: where to start from, with the statistics and their slopes there.
    - `target`: of the statistics.
    - `weights`: makes of misfits independent ones of unit size: a matrix, or whatever else has a
      product with a vector and a matrix.
    - `most`: steps.
    - `tolerance`: the descent ends where another step would lower the objective by less.
    - `note`: called with the objective and the norm of its gradient before each step.

    Not differentiable.
    """
    u, value, jacobian, _ = start
    loss, damping = objective_of(weights, u, value - target), 0.0
    for _ in range(most):
        if not (np.isfinite(jacobian).all() and np.isfinite(loss)):
            return Descended(u, value, jacobian, FitStatus.not_finite)
        gradient, hessian = _quadratic(weights, u, value - target, jacobian)
        note(loss, float(np.linalg.norm(gradient)))
        if 0.5 * gradient @ np.linalg.solve(hessian, gradient) < tolerance:
            return Descended(u, value, jacobian, FitStatus.successful)
        move = -np.linalg.solve(hessian + damping * np.eye(u.size), gradient)
        expected = -gradient @ move - 0.5 * move @ hessian @ move
        reached = evaluate(u + move)
        fall = loss - objective_of(weights, u + move, reached - target)
        if np.isfinite(fall):
            change = reached - value - jacobian @ move
            jacobian = jacobian + np.outer(change, move) / (move @ move)
        if np.isfinite(fall) and fall > 0:
            u, value, loss = u + move, reached, loss - fall
            damping = 0.25 * damping if fall > 0.5 * expected else damping
        else:
            damping = max(4.0 * damping, 1.0)
    return Descended(u, value, jacobian, FitStatus.max_steps)


def _quadratic(
    weights: Any, u: np.ndarray, misfit: np.ndarray, jacobian: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Gauss-Newton Hessian of the objective."""
    scaled = weights @ jacobian
    return scaled.T @ (weights @ misfit) + u, scaled.T @ scaled + np.eye(u.size)


def objective_of(weights: Any, u: np.ndarray, misfit: np.ndarray) -> float:
    """Half the squared whitened misfit and distance from the prior."""
    return 0.5 * float(np.sum((weights @ misfit) ** 2) + np.sum(u**2))


def unsettled(
    weights: Any,
    u: np.ndarray,
    moved: np.ndarray,
    misfit: np.ndarray,
    jacobian: np.ndarray,
) -> float:
    """The distance that a search `moved` to `u`, or that a Gauss-Newton step from there would
    move, along the principal direction where it is largest [posterior standard deviations]."""
    gradient, hessian = _quadratic(weights, u, misfit, jacobian)
    if not np.isfinite(hessian).all():
        return np.inf
    values, vectors = np.linalg.eigh(hessian)
    steps = np.stack([moved, np.linalg.solve(hessian, gradient)])
    return float(np.max(np.abs(steps @ vectors) * np.sqrt(values)))
