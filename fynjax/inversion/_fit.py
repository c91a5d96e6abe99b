"""Fit parameters to statistics with a prior, and say how far the data determine them.

The objective is half the squared whitened misfit of the statistics plus half the squared
distance from the prior, also whitened: the negative log posterior, but for a constant.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from fynjax._core.errors import InputError
from fynjax._core.least_squares import NO_TAGS, BroydenLM, BroydenState, figures_of
from fynjax._core.precision import compiled_in_single, double_precision
from fynjax._core.programs import concrete
from fynjax.inversion._data import Data
from fynjax.inversion._fit_result import Ended, FitResult, FitStatus, fit_result
from fynjax.inversion._log_posterior import LogPosterior, Predict
from fynjax.inversion._solvers import confirmed, gain, residual, run_solver, solver_kind, whitened
from fynjax.inversion._space import ParameterSpace


@double_precision
def fit_function(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    *,
    solver: Any = None,
    max_steps: int = 30,
    tolerance: float = 1e-3,
    start: Float[Array, " free"] | None = None,
    offset: Float[Array, " statistic"] | None = None,
    context: tuple[Any, ...] = (),
) -> FitResult:
    """Find the most probable parameters.

    **Arguments:**

    - `predict`: the forward model, of values in their own units [free] and `context`; traceable.
    - `data`, `space`: statistics with their errors; free parameters with their priors.
    - `solver`: of optimistix for least squares or minimisation, such as `BroydenLM()`,
      `optx.Dogleg(1e-3, 1e-3)` or `optx.BFGS(1e-3, 1e-3)`; or of jaxopt, such as
      `jaxopt.LBFGSB(fun=jnp.sum)`, whose function is replaced. Those that minimise take one
      gradient at each of many steps: for more statistics than a Jacobian should have rows. Those of
      jaxopt that take bounds stay within four prior standard deviations of the prior; where the
      data want more, they do not converge. By default a `BroydenLM` that renews its Jacobian.
    - `max_steps`: most steps; as many more where a solver that ends by a rule of its own starts
      again, because more than the `tolerance` is left to gain.
    - `tolerance`: the fit has converged only where a Gauss-Newton step would lower the objective by
      no more than this, whatever tolerances the solver has of its own: 1e-3 is 0.045 posterior
      standard deviations.
    - `start`: whitened coordinates to start from; the prior's centre by default.
    - `offset`: added to the predicted statistics: what a coarse model lacks.
    - `context`: further arguments of `predict`. A `Scene` among them shows whole plants, so that a
      cover moves its image by steps: fit with `scene.expected()`, whose image moves as its slope
      says, and give what whole plants differ by as `offset`.

    **Returns:** `FitResult`. A stop without convergence, a loss or slope that is not finite, and
    parameters that nothing depends on are stated in its `status`, not raised. Where a solver ends
    by a rule of its own before the fit has converged (see `tolerance`), the status is
    `FitStatus.no_gain`. A minimum may be a local one.

    The fit can be compiled by `jax.jit` and mapped by `jax.vmap`, over data, priors, start or
    context; inside `jax.jit` with a least-squares solver of optimistix, whose linear algebra keeps
    the precision of the process, only within `jax.enable_x64(True)`. To watch or stop it between
    steps, run the solver on `whitened_residual`. The estimate is differentiable once in data,
    priors, offset and context, by the implicit function theorem with the Hessian of the objective;
    only nearly where the model itself can be differentiated once, as light in a canopy
    (`fynjax.radiation.solve_light`). Computed in 64 bits; in a process of 32 take `jax.grad` of a
    fit inside `with jax.enable_x64(True):`.

    **Raises:** `InputError` for what is no solver, a model that gives another number of statistics
    than there are data, and a fit inside `jax.jit` that needs 64 bits (above).
    """
    if max_steps < 1:
        raise InputError(f"`max_steps` must be at least 1, but is {max_steps}")
    # In 64 bits also for data in 32.
    shift = jnp.zeros(data.value.shape) if offset is None else jnp.asarray(offset, float)
    u = jnp.zeros(len(space.names)) if start is None else jnp.asarray(start, float)
    density = LogPosterior(predict, space, data, shift, context)
    if solver is None:
        solver = BroydenLM(renew=True)
    kind = solver_kind(solver)
    if kind in ("broyden", "renewing"):  # by the same measure of what is to gain
        solver = dataclasses.replace(solver, atol=jnp.minimum(solver.atol, tolerance), rtol=0.0)
    solved, rest = eqx.partition(solver, eqx.is_array)
    traced = not concrete(density, u)
    run = _run if traced else _run_compiled
    limit = jnp.asarray(tolerance)
    if kind == "least squares" and compiled_in_single():
        raise InputError(
            f"a fit by {type(solver).__name__} inside `jax.jit` needs 64 bits: compile and call it "
            "inside `with jax.enable_x64(True):`, or take the default solver"
        )
    end = confirmed(run(density, solved, rest, u, max_steps, limit), data, limit)
    u, predicted, jacobian = _solution(density, end.u, end.predicted, end.jacobian)
    end = dataclasses.replace(end, u=u, predicted=predicted, jacobian=jacobian)
    return fit_result(space, data, end)


def whitened_residual(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    *,
    offset: Float[Array, " statistic"] | None = None,
    context: tuple[Any, ...] = (),
) -> Callable[[Float[Array, " free"], Any], Float[Array, " residual"]]:
    """What a fit makes small, for a solver of one's own.

    **Arguments:** `predict`, `data`, `space`, `offset` and `context` as of `fit`.

    **Returns:** a function of whitened coordinates u and of further arguments, which it ignores, as
    solvers of optimistix call it. It gives the misfit of the statistics in units of their errors,
    independent of each other, and then u, the distance from the prior in units of the prior. Half
    its squared norm is the objective of `fit`. Traceable and differentiable in u.

    **Example:** a parameter with the prior 0.5 ± 10 and one measurement of it, 2.0 ± 0.1.

    >>> import jax.numpy as jnp
    >>> import optimistix as optx
    >>> from fynjax.inversion import Data, ParameterSpace, whitened_residual
    >>> data = Data(("y",), jnp.array([2.0]), jnp.array([0.1]))
    >>> low, high, prior, sd = (jnp.full(1, v) for v in (-100.0, 100.0, 0.5, 10.0))
    >>> space = ParameterSpace(("x",), low, high, prior, sd)
    >>> residual = whitened_residual(lambda x: x, data, space)
    >>> found = optx.least_squares(residual, optx.Dogleg(1e-6, 1e-6), jnp.zeros(1))
    >>> space.physical(found.value).round(2).tolist()
    [2.0]
    """
    shift = jnp.zeros(data.value.shape) if offset is None else jnp.asarray(offset, float)
    space, data = jax.tree.map(jnp.asarray, (space, data))
    density = LogPosterior(predict, space, data, shift, context)

    def of_density(u: Float[Array, " free"], args: Any = None) -> Float[Array, " residual"]:
        return residual(density, u)

    return of_density


@eqx.filter_jit
def predicted_statistics(
    density: LogPosterior, u: Float[Array, " free"]
) -> Float[Array, " statistic"]:
    """What the model of `density` predicts at whitened coordinates `u`, compiled."""
    return density.statistics(u)


@eqx.filter_jit
def statistics_and_jacobian(
    density: LogPosterior, u: Float[Array, " free"]
) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
    """Statistics of `density` at whitened coordinates `u` and their slopes by `u`, compiled."""
    return density.jacobian(u)


def _run(
    density: LogPosterior, solver: Any, rest: Any, u: Array, max_steps: int, tolerance: Array
) -> Ended:
    """The end of a solver, with the objective and its gradient's norm at the start and there.

    A solver that ends by a rule of its own, while more than the tolerance is to gain, starts again
    from there as long as that lowers the objective.
    """
    density, u = _constant((density, u))
    solver = eqx.combine(solver, rest)
    if solver_kind(solver) == "renewing":
        return _renewed(density, solver, u, max_steps)
    start = _Run(u, *density.jacobian(u), FitStatus.successful, jnp.asarray(0), jnp.asarray(True))

    def going(run: _Run) -> Array:
        left = gain(density.data, run.u, run.predicted, run.jacobian) > tolerance
        # A solver that goes wrong from the start says why, once.
        open_end = (run.status == FitStatus.successful) & (run.steps < max_steps) & run.fell
        return open_end & (left | (run.steps == 0))

    def again(run: _Run) -> _Run:
        u, status, steps = run_solver(solver, density, run.u, max_steps)
        value, slopes = density.jacobian(u)
        before = _figures(density, run.u, (run.predicted, run.jacobian))[0]
        fell = _figures(density, u, (value, slopes))[0] < before
        return _Run(u, value, slopes, status, run.steps + steps, fell)

    end = jax.lax.while_loop(going, again, start)
    trace = jnp.stack(
        [_figures(density, run.u, (run.predicted, run.jacobian)) for run in (start, end)]
    )
    return Ended(end.u, end.predicted, end.jacobian, end.status, end.steps, trace)


class _Run(eqx.Module):
    """Where a solver ended."""

    u: Float[Array, " free"]
    predicted: Float[Array, " statistic"]
    jacobian: Float[Array, "statistic free"]
    status: Any
    steps: Int[Array, ""]
    fell: Bool[Array, ""]
    """Whether the objective fell."""


def _renewed(density: LogPosterior, solver: BroydenLM, u: Array, max_steps: int) -> Ended:
    """As `_run`, by a solver that takes the Jacobian at each step and ends by the rule of a fit.

    The start is evaluated as the steps are, in the loop: so the Jacobian, most of the program, is
    compiled once.
    """
    free, observed = u.size, density.data.value.size
    value, slopes = jnp.zeros(observed, u.dtype), jnp.zeros((observed, free), u.dtype)
    residual, rows = whitened(density.data, u, value, slopes)
    zero = jnp.zeros((), u.dtype)
    before = BroydenState(residual, rows, zero, zero, jnp.asarray(-1))  # not evaluated yet

    def ended(u: Array, state: BroydenState) -> tuple[Array, Any]:
        return solver.terminate(None, u, None, None, state, NO_TAGS)

    def going(run: tuple) -> Array:
        u, state, *_ = run
        return (state.steps < 0) | (~ended(u, state)[0] & (state.steps < max_steps))

    def step(run: tuple) -> tuple:
        u, state, value, slopes, start = run
        first = state.steps < 0
        # The place of the next step, known beforehand: value and Jacobian are asked for once.
        at = u + jnp.where(first, 0.0, solver.move(state))
        there = density.jacobian(at)
        options = {"jacobian": lambda *_: whitened(density.data, at, *there)}
        begun = solver.init(None, at, None, options, None, None, NO_TAGS)
        u, state, _ = solver.step(None, u, None, options, state, NO_TAGS)
        u, state = jax.tree.map(partial(jnp.where, first), (at, begun), (u, state))
        # Where a step was refused, `u` has stayed behind.
        value, slopes = jax.tree.map(partial(jnp.where, jnp.all(u == at)), there, (value, slopes))
        return u, state, value, slopes, jnp.where(first, figures_of(begun), start)

    u, state, value, slopes, start = jax.lax.while_loop(
        going, step, (u, before, value, slopes, jnp.zeros(2, u.dtype))
    )
    done, result = ended(u, state)
    status = FitStatus.where(done, FitStatus.no_gain, FitStatus.max_steps)
    good = done & (result == optx.RESULTS.successful)
    status = FitStatus.where(good, FitStatus.successful, status)
    return Ended(u, value, slopes, status, state.steps, jnp.stack([start, figures_of(state)]))


def _figures(density: LogPosterior, u: Array, end: tuple[Array, Array]) -> Float[Array, " 2"]:
    """The objective and the norm of its gradient."""
    value, slopes = end
    rest = density.data.whiten(value - density.data.value)
    gradient = density.data.whiten(slopes).T @ rest + u
    return jnp.stack([0.5 * (rest @ rest + u @ u), jnp.linalg.norm(gradient)])


_run_compiled = eqx.filter_jit(_run)


def _constant(tree: Any) -> Any:
    """What no derivative is taken through: that of a fit is implicit, see `_solution`."""
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    return eqx.combine(jax.lax.stop_gradient(arrays), rest)


@eqx.filter_custom_jvp
def _solution(
    density: LogPosterior, u: Array, predicted: Array, jacobian: Array
) -> tuple[Array, Array, Array]:
    """The estimate and what the model says there, with the derivative of a minimum.

    Where the gradient g(u, problem) of the objective is zero, du = -H^-1 dg, H its Hessian.
    """
    return u, predicted, jacobian


@_solution.def_jvp
def _solution_jvp(primals: Any, tangents: Any) -> Any:
    density, u, predicted, jacobian = primals
    change, *_ = tangents

    def gradient(density: LogPosterior, u: Array) -> Array:
        return jax.grad(lambda u: -density(u))(u)

    # How the gradient moves with the problem where the estimate stays.
    _, moved = eqx.filter_jvp(lambda density: gradient(density, u), (density,), (change,))
    # The whole Hessian, not that of Gauss and Newton: residuals at the minimum need not be small.
    hessian = lx.MatrixLinearOperator(jax.hessian(lambda u: -density(u))(u), lx.symmetric_tag)
    solver = lx.AutoLinearSolver(well_posed=True)
    du = -lx.linear_solve(hessian, moved, solver, throw=False).value
    # Statistics and slopes move with the problem and with the estimate.
    _, (value, slopes) = eqx.filter_jvp(
        lambda density, u: density.jacobian(u), (density, u), (change, du)
    )
    return (u, predicted, jacobian), (du, value, slopes)
