"""Solvers of optimistix and jaxopt on the density that a fit climbs."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.least_squares import BroydenLM
from fynjax.inversion._data import Data
from fynjax.inversion._fit_result import Ended, FitStatus

_REACH = 4.0
"""Bounds in prior standard deviations: beyond, the transform to a bounded parameter is flat."""

Density = Any
"""A `LogPosterior`, or what has its data, statistics, Jacobian and call."""

SolverKind = Literal[
    "broyden", "renewing", "least squares", "minimiser", "jaxopt least squares", "jaxopt minimiser"
]
"""How a solver is run: a `BroydenLM`, one that takes the Jacobian at each step, the kinds of
optimistix and those of jaxopt."""

Solved = tuple[Float[Array, " free"], Any, Array]
"""Whitened coordinates, a `FitStatus`, and the number of steps."""


def solver_kind(solver: Any) -> SolverKind:
    """What a solver is to a fit; the one place that decides it.

    **Raises:** `InputError` for what is no solver of optimistix or jaxopt that runs in JAX.
    """
    if isinstance(solver, BroydenLM):
        return "renewing" if solver.renew else "broyden"
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return "least squares"
    if isinstance(solver, optx.AbstractMinimiser):
        return "minimiser"
    import jaxopt  # late: a fit by another solver needs none of it

    if isinstance(solver, jaxopt.GaussNewton | jaxopt.LevenbergMarquardt):
        return "jaxopt least squares"
    if isinstance(
        solver,
        jaxopt.ArmijoSGD | jaxopt.BFGS | jaxopt.GradientDescent | jaxopt.LBFGS | jaxopt.LBFGSB
        | jaxopt.NonlinearCG | jaxopt.OptaxSolver | jaxopt.ProjectedGradient,
    ):  # fmt: skip
        return "jaxopt minimiser"
    if isinstance(solver, type):
        what = f"the class {solver.__name__} itself: make an object of it"
    else:
        what = f"of {type(solver).__module__}.{type(solver).__qualname__}"
    raise InputError(
        "`solver` must be a solver of optimistix or jaxopt that runs in JAX, for least squares or "
        f"minimisation, but is {what}. One of optax goes into optimistix.OptaxMinimiser"
    )


def run_solver(solver: Any, density: Density, u: Float[Array, " free"], max_steps: int) -> Solved:
    """Where a solver ends that starts at `u`, and why.

    **Raises:** `InputError` as `solver_kind`.
    """
    kind = solver_kind(solver)
    if kind == "minimiser":
        return _optimistix(optx.minimise, lambda u, _: -density(u), solver, u, max_steps, {})
    if kind == "least squares":
        return _optimistix(
            optx.least_squares, _with_jacobian(density), solver, u, max_steps, {"jac": "bwd"}
        )
    if kind in ("broyden", "renewing"):
        options = {"jacobian": lambda u, _: whitened(density.data, u, *density.jacobian(u))}
        plain = lambda u, _: residual(density, u)  # noqa: E731
        return _optimistix(optx.least_squares, plain, solver, u, max_steps, options)
    return _jaxopt(solver, kind, density, u, max_steps)


def residual(density: Density, u: Float[Array, " free"]) -> Float[Array, " residual"]:
    """Misfits of the statistics in units of their errors, then distances from the prior."""
    data = density.data
    return jnp.concatenate([data.whiten(density.statistics(u) - data.value), u])


def whitened(data: Data, u: Array, value: Array, slopes: Array) -> tuple[Array, Array]:
    """Residuals of statistics `value` at `u` in units of their errors, then distances from the
    prior, and the Jacobian of both."""
    rows = jnp.concatenate([data.whiten(slopes), jnp.eye(u.size)])
    return jnp.concatenate([data.whiten(value - data.value), u]), rows


def _with_jacobian(density: Density) -> Callable[[Array, Any], Array]:
    """The residuals with their Jacobian attached, by the model's own way to it: whatever a solver
    differentiates is then a product with it."""

    def linear(u: Array, _: Any) -> Array:
        # Value and slope are those of this very point; only the line through it has a derivative.
        here = jax.lax.stop_gradient(u)
        rest, rows = whitened(density.data, here, *density.jacobian(here))
        return rest + rows @ (u - here)

    return linear


def _optimistix(
    run: Callable[..., Any],
    function: Callable[[Array, Any], Array],
    solver: Any,
    u: Array,
    max_steps: int,
    options: dict[str, Any],
) -> Solved:
    # No error is thrown: under vmap some fits may fail, and each says so in its status.
    found = run(function, solver, u, options=options, max_steps=max_steps, throw=False)
    good = found.result == optx.RESULTS.successful
    limit = found.result == optx.RESULTS.nonlinear_max_steps_reached
    status = FitStatus.where(limit, FitStatus.max_steps, FitStatus.no_gain)
    status = FitStatus.where(good, FitStatus.successful, status)
    return found.value, status, jnp.asarray(found.stats["num_steps"])


def _jaxopt(solver: Any, kind: SolverKind, density: Density, u: Array, max_steps: int) -> Solved:
    import jaxopt

    # A fit has its own derivative: none is taken through the solver, whose loops can end early.
    options: dict[str, Any] = {"implicit_diff": False, "unroll": False, "jit": True}
    options["maxiter"] = max_steps
    if kind == "jaxopt least squares":
        options["residual_fun"] = lambda u: _with_jacobian(density)(u, None)
    else:
        options |= {"fun": lambda u: -density(u), "value_and_grad": False, "has_aux": False}
    arguments: tuple[Any, ...] = ()
    projected = isinstance(solver, jaxopt.ProjectedGradient)
    if isinstance(solver, jaxopt.LBFGSB) or (
        projected and solver.projection is jaxopt.projection.projection_box
    ):
        reach = jnp.full_like(u, _REACH)
        arguments = ((-reach, reach),)
    elif projected:
        arguments = (None,)  # what other projections take beside u
    ready = dataclasses.replace(solver, **options)
    u, state = ready.run(u, *arguments)
    settled = state.error <= ready.tol
    status = FitStatus.where(settled, FitStatus.successful, FitStatus.max_steps)
    return u, status, jnp.asarray(state.iter_num)


def gain(
    data: Data,
    u: Float[Array, " free"],
    statistics: Float[Array, " statistic"],
    jacobian: Float[Array, "statistic free"],
) -> Float[Array, ""]:
    """By how much a Gauss-Newton step would lower the objective, were the model linear.

    Half the squared distance to the minimum in posterior standard deviations: what is left to gain,
    whatever the units and however flat the valley.
    """
    misfit, slopes = data.whiten(statistics - data.value), data.whiten(jacobian)
    # By an orthogonal basis: the condition of the Hessian is the square of that of the slopes.
    basis, _ = jnp.linalg.qr(jnp.concatenate([slopes, jnp.eye(u.size)]))
    return 0.5 * jnp.sum((basis.T @ jnp.concatenate([misfit, u])) ** 2)


@eqx.filter_jit
def confirmed(end: Ended, data: Data, tolerance: Float[Array, ""]) -> Ended:
    """End of a fit, converged only where the `gain` left is at most `tolerance`, whatever rule of
    the solver's own ended it."""
    fixed = jax.lax.stop_gradient((data, end.u, end.predicted, end.jacobian))
    settled = gain(*fixed) <= tolerance
    ended = (end.status == FitStatus.successful) | (end.status == FitStatus.no_gain)
    found = FitStatus.where(settled, FitStatus.successful, FitStatus.no_gain)
    return dataclasses.replace(end, status=FitStatus.where(ended, found, end.status))
