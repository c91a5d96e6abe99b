"""What PROSPECT departs from a leaf's spectra and prior by, in units of their errors, and where the
square of that is least, for many leaves at once."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from fynjax._core.least_squares import NO_TAGS, BroydenLM, BroydenState
from fynjax.leaf._measurement import AbstractMeasurement
from fynjax.leaf._prospect import pile

# Steps of a parameter are at most 2 in its logit. A leaf has converged where a further step would
# move it by less than 1/200 of the posterior's standard deviation, or where only rounding is left.
_SOLVER = BroydenLM(atol=1e-5, rtol=1e-9, renew=True, longest=2.0)
# Sizes of batch that are compiled; steps between two looks at who has converged; how many looks.
_SIZES = (16, 128)
_STEPS, _ROUNDS = 2, 40
# Numbers of the Jacobians that are in memory at once: of some 1000 leaves on the usual bins.
_BLOCK = 4_000_000


class Optics(eqx.Module):
    """PROSPECT's constants on the fit's bins, and where each parameter enters."""

    absorption: Float[Array, "constituent bin"]
    first: Float[Array, " bin"]
    diffuse: Float[Array, " bin"]
    index: Float[Array, " bin"]
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]
    measurement: AbstractMeasurement


class LeafProblem(NamedTuple):
    """One leaf: data, weights, prior. Bands without data have precision 0."""

    data: Float[Any, "2 bin"]
    precision: Float[Any, "2 bin"]
    inflation: Float[Any, ""]
    prior_mean: Float[Any, " parameter"]
    prior_precision: Float[Any, "parameter parameter"]


class Whitening(NamedTuple):
    """What makes numbers of mean 0 and variance 1 of a leaf's misfit and of its prior, see
    `residual`."""

    misfit: Float[Any, "factor factor"]
    prior: Float[Any, "parameter parameter"]


class Solution(NamedTuple):
    """The most probable leaves, in unconstrained coordinates."""

    z: Float[np.ndarray, "leaf parameter"]
    hessian: Float[np.ndarray, "leaf parameter parameter"]
    """Hessian of minus the log posterior density, after Gauss and Newton: the inverse of the
    covariance."""
    misfit: Float[np.ndarray, " leaf"]
    """Squared misfit in units of the error model's covariance, without inflation [-]."""
    converged: Bool[np.ndarray, " leaf"]


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
    # Absorption of one of N elementary layers.
    k = (contents @ optics.absorption) / structure
    return jnp.stack(pile(k, structure, optics.first, optics.diffuse, optics.index))


def observed(x: Array, optics: Optics) -> Array:
    """What the instrument reads [2, bin] at physical parameters."""
    r, t = spectra(x, optics)
    return jnp.stack(optics.measurement.observe(r, t, *_split(x, optics)[2]))


def factor_system(factors: Array, precision: Array) -> Float[Array, "factor factor"]:
    """Cholesky factor of I + F D^-1 F^T.

    By products of pairs of factors, which leaves share: one matrix product for a whole batch.
    """
    number = factors.shape[0]
    flat = factors.reshape(number, -1)
    pairs = (flat[:, None] * flat[None]).reshape(number * number, -1)
    gram = (pairs @ precision.reshape(-1)).reshape(number, number)
    return jnp.linalg.cholesky(jnp.eye(number, dtype=flat.dtype) + gram)


def inverse_triangular(lower: Array) -> Array:
    """Inverse of a lower triangular matrix.

    Not LAPACK: its threads spend ten times the CPU time on small systems.
    """
    unit = jnp.eye(len(lower), dtype=lower.dtype)

    def row(i: Array, y: Array) -> Array:
        return y.at[i].set((unit[i] - lower[i] @ y) / lower[i, i])

    return jax.lax.fori_loop(0, len(lower), row, jnp.zeros_like(lower))


def whitening(problem: LeafProblem, factors: Array) -> Whitening:
    """Whitening of a leaf, by which `residual` multiplies.

    A square root of the inverse of F^T F + D is D^-1/2 (I - F^T N F D^-1) with
    N = (L + L L^T)^-1 and L L^T = I + F D^-1 F^T (Andrews 1968, AIAA Journal 6, 1165, for the
    inverse by Woodbury's identity); that of the prior's precision is its Cholesky factor.
    """
    lower = factor_system(factors, problem.precision)
    unit = jnp.eye(len(lower), dtype=lower.dtype)
    root = inverse_triangular(unit + lower).T @ inverse_triangular(lower)
    return Whitening(root, jnp.linalg.cholesky(problem.prior_precision).T)


Given = tuple[LeafProblem, Whitening, Array, Optics]
"""A leaf's problem and whitening, and the factors [factor, 2, bin] and optics of all."""


def residual(z: Array, given: Given) -> Float[Array, " number"]:
    """What z departs from the data by, then from the prior, each in units of its error: minus half
    its square is the logarithm of the posterior density, up to a constant. Bands without data have
    0. Differentiable: two slopes of each band serve all parameters, see `pile`."""
    problem, roots, factors, optics = given
    flat, weight = factors.reshape(len(factors), -1), problem.precision.reshape(-1)
    misfit = (observed(to_physical(z, optics), optics) - problem.data).reshape(-1)
    shared = (roots.misfit @ (flat @ (weight * misfit))) @ flat
    white = jnp.sqrt(weight / problem.inflation) * (misfit - shared)
    return jnp.concatenate([white, roots.prior @ (z - problem.prior_mean)])


def _function(z: Array, given: Given) -> tuple[Array, None]:
    """As a solver of optimistix calls it."""
    return residual(z, given), None


@eqx.filter_jit
def _begin(leaves: tuple, factors: Any, optics: Optics) -> tuple[BroydenState, Whitening]:
    """State of the solver at the z of each leaf, and its whitening; `leaves` is z and problems."""

    def begin(z: Array, problem: LeafProblem) -> tuple[BroydenState, Whitening]:
        roots = whitening(problem, factors)
        given = problem, roots, factors, optics
        return _SOLVER.init(_function, z, given, None, None, None, NO_TAGS), roots

    return jax.vmap(begin)(*leaves)


@eqx.filter_jit
def _advance(leaves: tuple, factors: Any, optics: Optics) -> tuple[Array, BroydenState, Array]:
    """A few steps of each leaf: z, state, and whether it has converged.

    `leaves` is z, states, problems, and whitenings.
    """

    def several(
        z: Array, state: BroydenState, problem: LeafProblem, roots: Whitening
    ) -> tuple[Array, BroydenState, Array]:
        given = problem, roots, factors, optics

        def step(_: Any, now: tuple) -> tuple:
            return _SOLVER.step(_function, now[0], given, None, now[1], NO_TAGS)[:2]

        z, state = jax.lax.fori_loop(0, _STEPS, step, (z, state))
        done, reason = _SOLVER.terminate(_function, z, given, None, state, NO_TAGS)
        return z, state, done & (reason == optx.RESULTS.successful)

    return jax.vmap(several)(*leaves)


def solve(start: np.ndarray, problems: LeafProblem, factors: Any, optics: Optics) -> Solution:
    """The most probable z of each leaf, from `start` [leaf, parameter].

    Leaves that have converged leave the batch, which shrinks through few fixed sizes: a few slow
    leaves then cost no more than themselves, and few programs are compiled.
    """
    size = max(_SIZES[0], _BLOCK // (problems.data[0].size * start.shape[1]))
    blocks = (slice(at, at + size) for at in range(0, len(start), size))
    parts = [
        _solve_block(start[rows], LeafProblem(*(a[rows] for a in problems)), factors, optics)
        for rows in blocks
    ]
    return Solution(*(np.concatenate(values) for values in zip(*parts)))


def _solve_block(
    start: np.ndarray, problems: LeafProblem, factors: Any, optics: Optics
) -> Solution:
    # All leaves begin; those that have not converged are packed anew before each round.
    begun = [
        cut(_begin(leaves, factors, optics), rows.size)
        for rows, leaves in batches((start, problems), np.arange(len(start)))
    ]
    state, roots = jax.tree.map(lambda *parts: np.concatenate(parts), *begun)
    z, converged = np.array(start), np.zeros(len(start), bool)
    for _ in range(_ROUNDS):
        for rows, leaves in batches((z, state, problems, roots), np.flatnonzero(~converged)):
            moved = cut(_advance(leaves, factors, optics), rows.size)
            for whole, part in zip(jax.tree.leaves((z, state, converged)), jax.tree.leaves(moved)):
                whole[rows] = part
    # Residuals are whitened: J^T J is the precision of data and prior together.
    hessian = state.jacobian.swapaxes(1, 2) @ state.jacobian
    misfit = (state.residual[:, : -z.shape[1]] ** 2).sum(1) * problems.inflation
    return Solution(z, hessian, misfit, converged)


def cut(tree: Any, count: int) -> Any:
    """The first rows of every array of a tree, as NumPy arrays."""
    return jax.tree.map(lambda a: np.array(a)[:count], tree)


def batches(tree: Any, rows: np.ndarray) -> Iterator[tuple[np.ndarray, Any]]:
    """Rows in batches, and every array of the tree at them: the first row is repeated up to the
    next of the fixed batch sizes."""
    for at in range(0, rows.size, _SIZES[-1]):
        part = rows[at : at + _SIZES[-1]]
        size = next(s for s in _SIZES if s >= part.size)
        index = np.concatenate([part, np.repeat(part[:1], size - part.size)])
        yield part, jax.tree.map(lambda a, at=index: jnp.asarray(np.asarray(a)[at]), tree)
