"""Levenberg-Marquardt for many leaves at once, under a correlated error model.

Why not a general solver: PROSPECT depends on its chemistry only through the absorption of a layer,
so two slopes of each band give the whole Jacobian, and the covariance F^T F + D of the errors is
inverted through its few factors (Woodbury), which also leaves a band out by giving it no weight.
Neither fits a residual-vector interface without forming the dense whitened Jacobian of each leaf.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax.leaf._measurement import AbstractMeasurement
from fynjax.leaf._prospect import pile, pile_and_slopes

# Sizes of batch that are compiled; steps between two looks at who has converged; how many looks.
_SIZES = (16, 128)
_STEPS, _ROUNDS = 4, 20
# Longest step of a parameter in its logit; the gain of the log posterior (a fraction of the
# posterior's standard deviation, squared) below which a full step ends the iteration.
_LONGEST_STEP, _TOLERANCE = 2.0, 1e-2


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

    data: Float[Any, "2 bin"]
    precision: Float[Any, "2 bin"]
    inflation: Float[Any, ""]
    prior_mean: Float[Any, " parameter"]
    prior_precision: Float[Any, "parameter parameter"]


class State(NamedTuple):
    """Where the iteration of a leaf stands, in the unconstrained coordinates."""

    z: Float[Any, " parameter"]
    cost: Float[Any, ""]
    gradient: Float[Any, " parameter"]
    hessian: Float[Any, "parameter parameter"]
    damping: Float[Any, ""]
    converged: Bool[Any, ""]


def to_physical(z: Array, optics: Optics) -> Array:
    """Parameters within their bounds from unconstrained coordinates."""
    return optics.lower + (optics.upper - optics.lower) * jax.nn.sigmoid(z)


def to_unconstrained(x: Array, optics: Optics) -> Array:
    """Inverse of `to_physical`, kept a little off the bounds."""
    unit = jnp.clip((x - optics.lower) / (optics.upper - optics.lower), 1e-6, 1 - 1e-6)
    return jnp.log(unit) - jnp.log1p(-unit)


def _split(x: Array, optics: Optics) -> tuple[Array, Array, Array]:
    """Structure, contents and the measurement's parameters, which follow in this order."""
    last = 1 + optics.absorption.shape[0]
    return x[0], x[1:last], x[last:]


def spectra(x: Array, optics: Optics) -> Array:
    """R and T [2, bin] at physical parameters."""
    structure, contents, _ = _split(x, optics)
    k = (contents @ optics.absorption) / structure
    return jnp.stack(pile(k, structure, optics.first, optics.diffuse, optics.index))


def observed(x: Array, optics: Optics) -> Array:
    """What the instrument reads [2, bin] at physical parameters."""
    r, t = spectra(x, optics)
    return jnp.stack(optics.measurement.observe(r, t, *_split(x, optics)[2]))


def spectra_and_slopes(x: Array, optics: Optics) -> tuple[Array, Array]:
    """R and T [2, bin], and their derivatives by the physical parameters [parameter, 2, bin].

    By the measurement's parameters they are zero.
    """
    structure, contents, rest = _split(x, optics)
    k = (contents @ optics.absorption) / structure
    surface = (optics.first, optics.diffuse, optics.index)
    value, by_k, by_n = (jnp.stack(pair) for pair in pile_and_slopes(k, structure, *surface))
    by_contents = by_k[None] * (optics.absorption / structure)[:, None, :]
    none = jnp.zeros((rest.size, *value.shape), value.dtype)
    by_structure = (by_n - by_k * k / structure)[None]
    return value, jnp.concatenate([by_structure, by_contents, none])


def observed_and_slopes(x: Array, optics: Optics) -> tuple[Array, Array]:
    """What the instrument reads [2, bin] and its derivatives [parameter, 2, bin]."""
    value, jacobian = spectra_and_slopes(x, optics)
    r, t = value
    ones, zeros = jnp.ones_like(r), jnp.zeros_like(r)
    rest = _split(x, optics)[2]
    read = optics.measurement.observe
    recorded, by_r = jax.jvp(lambda r, t: read(r, t, *rest), (r, t), (ones, zeros))
    _, by_t = jax.jvp(lambda r, t: read(r, t, *rest), (r, t), (zeros, ones))
    slopes = jnp.stack(by_r) * jacobian[:, :1] + jnp.stack(by_t) * jacobian[:, 1:]
    if rest.size:
        own = jax.jacfwd(lambda rest: jnp.stack(read(r, t, *rest)))(rest)
        slopes = slopes.at[-rest.size :].set(jnp.moveaxis(own, -1, 0))
    return jnp.stack(recorded), slopes


def factor_system(factors: Array, precision: Array) -> Float[Array, "factor factor"]:
    """Cholesky factor of I + F D^-1 F^T.

    By products of pairs of factors, which leaves share: one matrix product for a whole batch.
    """
    number = factors.shape[0]
    flat = factors.reshape(number, -1)
    pairs = (flat[:, None] * flat[None]).reshape(number * number, -1)
    gram = (pairs @ precision.reshape(-1)).reshape(number, number)
    return jnp.linalg.cholesky(jnp.eye(number, dtype=flat.dtype) + gram)


def _weigh(problem: Problem, factors: Array, system: Array, rows: Array) -> Array:
    """Gram matrix of rows [row, 2 bin] under the inverse of S = inflation (F^T F + D)."""
    weighted = rows * problem.precision.reshape(-1)
    projected = factors.reshape(factors.shape[0], -1) @ weighted.T
    inner = jax.scipy.linalg.solve_triangular(system, projected, lower=True)
    return (weighted @ rows.T - inner.T @ inner) / problem.inflation


def cost(z: Array, problem: Problem, factors: Array, system: Array, optics: Optics) -> Array:
    """Minus the logarithm of the posterior density of z, up to a constant."""
    recorded = observed(to_physical(z, optics), optics)
    residual = jnp.where(problem.precision > 0, recorded - problem.data, 0.0).reshape(1, -1)
    offset = z - problem.prior_mean
    pull = offset @ problem.prior_precision @ offset
    return 0.5 * (_weigh(problem, factors, system, residual)[0, 0] + pull)


def _evaluate(
    z: Array, problem: Problem, factors: Array, system: Array, optics: Optics
) -> tuple[Array, Array, Array]:
    """Cost, gradient, and Gauss-Newton Hessian."""
    unit = jax.nn.sigmoid(z)
    slope = (optics.upper - optics.lower) * unit * (1.0 - unit)
    value, jacobian = observed_and_slopes(to_physical(z, optics), optics)
    residual = jnp.where(problem.precision > 0, value - problem.data, 0.0)
    rows = jnp.concatenate([residual[None], jacobian * slope[:, None, None]])
    gram = _weigh(problem, factors, system, rows.reshape(rows.shape[0], -1))
    offset = z - problem.prior_mean
    pulled = problem.prior_precision @ offset
    return (
        0.5 * (gram[0, 0] + offset @ pulled),
        gram[1:, 0] + pulled,
        gram[1:, 1:] + problem.prior_precision,
    )


@eqx.filter_jit
def begin(leaves: tuple, factors: Any, optics: Optics) -> tuple[State, Array]:
    """State of each leaf at its z, and its factor system; `leaves` is z and the problems."""
    z, problems = leaves

    def begin_leaf(z: Array, problem: Problem) -> tuple[State, Array]:
        system = factor_system(factors, problem.precision)
        values = _evaluate(z, problem, factors, system, optics)
        return State(z, *values, jnp.asarray(1e-2), jnp.asarray(False)), system

    return jax.vmap(begin_leaf)(z, problems)


@eqx.filter_jit
def advance(leaves: tuple, factors: Any, optics: Optics) -> State:
    """A few Levenberg-Marquardt steps of each leaf; converged leaves do not move.

    `leaves` is the states, the problems, and the factor systems.
    """
    states, problems, systems = leaves

    def step(problem: Problem, system: Array, s: State) -> State:
        damped = s.hessian + s.damping * jnp.diag(jnp.diag(s.hessian))
        change = -jax.scipy.linalg.solve(damped, s.gradient, assume_a="pos")
        change = change / jnp.maximum(1.0, jnp.max(jnp.abs(change)) / _LONGEST_STEP)
        cost, gradient, hessian = _evaluate(s.z + change, problem, factors, system, optics)
        better = (cost < s.cost) & ~s.converged
        promised = -(s.gradient @ change + 0.5 * change @ s.hessian @ change)
        done = s.converged | ((promised < _TOLERANCE**2) & (s.damping < 1.0))
        # A step that rounding alone keeps from gaining ends the iteration too.
        done = done | (~better & (promised < 1e-9 * jnp.abs(s.cost)))
        old = (s.z, s.cost, s.gradient, s.hessian)
        new = (s.z + change, cost, gradient, hessian)
        kept = [jnp.where(better, n, o) for n, o in zip(new, old)]
        damping = jnp.clip(jnp.where(better, s.damping * 0.2, s.damping * 6.0), 1e-8, 1e8)
        return State(kept[0], kept[1], kept[2], kept[3], damping, done)

    def several(state: State, problem: Problem, system: Array) -> State:
        return jax.lax.fori_loop(0, _STEPS, lambda _, s: step(problem, system, s), state)

    return jax.vmap(several)(states, problems, systems)


def solve(start: np.ndarray, problems: Problem, factors: Any, optics: Optics) -> State:
    """Minimise the cost of every leaf from `start` [leaf, parameter].

    Leaves that have converged leave the batch, which shrinks through few fixed sizes: a few slow
    leaves then cost no more than themselves, and few programs are compiled.
    """
    begun = [
        [np.array(part)[: rows.size] for part in jax.tree.leaves(begin(leaves, factors, optics))]
        for rows, leaves in batches((start, problems), np.arange(len(start)))
    ]
    *parts, kept = (np.concatenate(parts) for parts in zip(*begun))
    state = State(*parts)
    for _ in range(_ROUNDS):
        left = np.flatnonzero(~state.converged)
        if left.size == 0:
            break
        for rows, leaves in batches((state, problems, kept), left):
            moved = advance(leaves, factors, optics)
            for whole, part in zip(state, moved):
                whole[rows] = np.asarray(part)[: rows.size]
    return state


def batches(tree: Any, rows: np.ndarray) -> Iterator[tuple[np.ndarray, Any]]:
    """Rows in batches of the largest size, and every array of the tree at them, see `padded`."""
    for at in range(0, rows.size, _SIZES[-1]):
        part = rows[at : at + _SIZES[-1]]
        yield part, padded(tree, part)


def padded(tree: Any, rows: np.ndarray) -> Any:
    """Rows of every array, repeated up to the next of the fixed batch sizes."""
    size = next(s for s in _SIZES if s >= rows.size)
    index = np.concatenate([rows, np.repeat(rows[:1], size - rows.size)])
    return jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[index]), tree)
