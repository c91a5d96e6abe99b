"""Levenberg-Marquardt for many leaves at once, under a correlated error model.

Why not a general solver: PROSPECT depends on its chemistry only through the absorption of a layer,
so two tangents give the whole Jacobian (a third of the cost of forward mode over seven
parameters), and the covariance F^T F + D of the errors is inverted through its few factors
(Woodbury), which also leaves a band out by giving it no weight. Neither fits a residual-vector
interface without forming the dense whitened Jacobian of each leaf.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from fynjax.leaf._measurement import AbstractMeasurement
from fynjax.leaf._prospect import _stack
from fynjax.leaf._transmissivity import layer_absorptance


class Optics(eqx.Module):
    """PROSPECT's constants on the fit's bins, and where each parameter enters."""

    absorption: Float[Array, "constituent bin"]
    first: Float[Array, " bin"]
    diffuse: Float[Array, " bin"]
    index: Float[Array, " bin"]
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]
    measurement: AbstractMeasurement


class Problem(NamedTuple):
    """One leaf: data, weights, prior. Bands without data have precision 0."""

    data: Float[Array, "2 bin"]
    precision: Float[Array, "2 bin"]
    factors: Float[Array, "factor 2 bin"]
    prior_mean: Float[Array, " parameter"]
    prior_precision: Float[Array, "parameter parameter"]
    line: Float[Array, " 2"]
    start: Float[Array, " parameter"]


class Solution(NamedTuple):
    """Where the iteration ended, in the unconstrained coordinates."""

    z: Float[Array, " parameter"]
    cost: Float[Array, ""]
    hessian: Float[Array, "parameter parameter"]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


def to_physical(z: Array, optics: Optics) -> Array:
    """Parameters within their bounds from unconstrained coordinates."""
    return optics.lower + (optics.upper - optics.lower) * jax.nn.sigmoid(z)


def to_unconstrained(x: Array, optics: Optics) -> Array:
    """Inverse of `to_physical`, kept a little off the bounds."""
    unit = jnp.clip((x - optics.lower) / (optics.upper - optics.lower), 1e-6, 1 - 1e-6)
    return jnp.log(unit) - jnp.log1p(-unit)


def spectra(x: Array, optics: Optics) -> Array:
    """R and T [2, bin] at physical parameters, structure first."""
    k = (x[1:] @ optics.absorption) / x[0]
    return jnp.stack(_stack(layer_absorptance(k), x[0], optics.first, optics.diffuse, optics.index))


def spectra_and_slopes(x: Array, optics: Optics) -> tuple[Array, Array]:
    """R and T [2, bin], and their derivatives by the physical parameters [parameter, 2, bin]."""

    def of(k: Array, n: Array) -> Array:
        return jnp.stack(
            _stack(layer_absorptance(k), n, optics.first, optics.diffuse, optics.index)
        )

    k = (x[1:] @ optics.absorption) / x[0]
    n = jnp.broadcast_to(x[0], k.shape)
    value, by_k = jax.jvp(of, (k, n), (jnp.ones_like(k), jnp.zeros_like(n)))
    _, by_n = jax.jvp(of, (k, n), (jnp.zeros_like(k), jnp.ones_like(n)))
    contents = by_k[None] * (optics.absorption / x[0])[:, None, :]
    return value, jnp.concatenate([(by_n - by_k * k / x[0])[None], contents])


def observed_and_slopes(x: Array, optics: Optics) -> tuple[Array, Array]:
    """What the instrument reads [2, bin] and its derivatives [parameter, 2, bin]."""
    value, jacobian = spectra_and_slopes(x, optics)
    r, t = value
    one, none = jnp.ones_like(r), jnp.zeros_like(r)
    read = optics.measurement.observe
    seen, by_r = jax.jvp(read, (r, t), (one, none))
    _, by_t = jax.jvp(read, (r, t), (none, one))
    slopes = jnp.stack(by_r) * jacobian[:, :1] + jnp.stack(by_t) * jacobian[:, 1:]
    return jnp.stack(seen), slopes


def factor_system(problem: Problem) -> Float[Array, "factor factor"]:
    """Cholesky factor of I + F D^-1 F^T."""
    flat = problem.factors.reshape(problem.factors.shape[0], -1)
    weighted = flat * problem.precision.reshape(-1)
    return jnp.linalg.cholesky(jnp.eye(flat.shape[0], dtype=flat.dtype) + weighted @ flat.T)


def _weigh(problem: Problem, system: Array, residual: Array, jacobian: Array) -> tuple:
    """r' S^-1 r, J' S^-1 r and J' S^-1 J for the covariance S = F^T F + D."""
    flat = problem.factors.reshape(problem.factors.shape[0], -1)
    stacked = jnp.concatenate([residual.reshape(1, -1), jacobian.reshape(jacobian.shape[0], -1)])
    weighted = stacked * problem.precision.reshape(-1)
    inner = jax.scipy.linalg.solve_triangular(system, flat @ weighted.T, lower=True)
    gram = weighted @ stacked.T - inner.T @ inner
    return gram[0, 0], gram[1:, 0], gram[1:, 1:]


def _line_terms(problem: Problem, x: Array, slope: Array) -> tuple[Array, Array]:
    """Whitened residual and slope of the prior on N: mean line[0], precision line[1]."""
    root = jnp.sqrt(problem.line[1])
    return root * (x[0] - problem.line[0]), jnp.zeros_like(x).at[0].set(root * slope[0])


def _evaluate(problem: Problem, optics: Optics, system: Array, z: Array) -> tuple:
    x = to_physical(z, optics)
    unit = jax.nn.sigmoid(z)
    slope = (optics.upper - optics.lower) * unit * (1.0 - unit)
    value, jacobian = observed_and_slopes(x, optics)
    residual = jnp.where(problem.precision > 0, value - problem.data, 0.0)
    square, gradient, hessian = _weigh(problem, system, residual, jacobian * slope[:, None, None])
    offset = z - problem.prior_mean
    pulled = problem.prior_precision @ offset
    line, line_slope = _line_terms(problem, x, slope)
    return (
        0.5 * (square + offset @ pulled + line**2),
        gradient + pulled + line_slope * line,
        hessian + problem.prior_precision + jnp.outer(line_slope, line_slope),
    )


def solve(
    problem: Problem, optics: Optics, max_steps: int = 60, tolerance: float = 1e-2
) -> Solution:
    """Minimise half the squared misfit plus prior; stop when a full step gains below `tolerance`^2.

    The gain predicted by the quadratic model is in units of the log-posterior, so the tolerance is
    a fraction of the standard deviation of the answer.
    """
    system = factor_system(problem)
    cost, gradient, hessian = _evaluate(problem, optics, system, problem.start)

    def step(state: tuple) -> tuple:
        z, cost, gradient, hessian, damping, count, _ = state
        damped = hessian + damping * jnp.diag(jnp.diag(hessian))
        change = -jax.scipy.linalg.solve(damped, gradient, assume_a="pos")
        change = change / jnp.maximum(1.0, jnp.max(jnp.abs(change)) / 3.0)
        trial = z + change
        new_cost, new_gradient, new_hessian = _evaluate(problem, optics, system, trial)
        better = new_cost < cost
        promised = -(gradient @ change + 0.5 * change @ hessian @ change)
        done = (promised < tolerance**2) & (damping < 1.0)
        # A step that rounding alone keeps from gaining ends the iteration too.
        stuck = ~better & (promised < 1e-9 * jnp.abs(cost))
        keep = lambda new, old: jnp.where(better, new, old)  # noqa: E731
        return (
            keep(trial, z),
            keep(new_cost, cost),
            keep(new_gradient, gradient),
            keep(new_hessian, hessian),
            jnp.clip(jnp.where(better, damping * 0.2, damping * 6.0), 1e-8, 1e8),
            count + 1,
            done | stuck,
        )

    def go_on(state: tuple) -> Array:
        return ~state[-1] & (state[-2] < max_steps)

    first = (
        problem.start, cost, gradient, hessian, jnp.asarray(1e-2, cost.dtype), 0, jnp.asarray(False)
    )  # fmt: skip
    z, cost, _, hessian, _, count, done = jax.lax.while_loop(go_on, step, first)
    return Solution(z, cost, hessian, jnp.asarray(count), done)
