"""Fit parameters to statistics with a prior, and say how far the data pinned them down.

The objective is half the squared whitened misfit of the statistics plus half the squared
distance from the prior, also whitened: the negative log posterior, but for a constant.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.checkpoint import Keep, keep_nothing
from fynjax._core.errors import InputError
from fynjax._core.precision import require_double_precision
from fynjax.inversion._fit_result import Data, FitResult, FitStatus, fit_result
from fynjax.inversion._log_posterior import LogPosterior, Predict
from fynjax.inversion._solvers import (
    AbstractStepper,
    Figures,
    confirmed,
    is_scipy,
    lbfgsb,
    least_squares,
    run_scipy,
    stepper,
)
from fynjax.inversion._space import ParameterSpace

_NAMED = ("least_squares", "lbfgsb")


def fit(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    *,
    solver: Any = "least_squares",
    max_steps: int = 30,
    tolerance: float = 1e-3,
    start: Float[Array, " free"] | None = None,
    offset: Float[Array, " statistic"] | None = None,
    report: Callable[[float, float], None] | None = None,
    context: tuple[Any, ...] = (),
    keep: Keep = keep_nothing,
    known: tuple[Array, Array] | None = None,
) -> FitResult:
    """Find the most probable parameters.

    **Arguments:**

    - `predict`: the forward model, of values in their own units [free] and `context`; traceable.
    - `data`, `space`: statistics with their errors; free parameters with their priors.
    - `solver`: "least_squares", Levenberg-Marquardt by optimistix, which takes the Jacobian at
      each of a few steps; "lbfgsb", quasi-Newton by SciPy through jaxopt, which takes one gradient
      at each of many: for more statistics than a Jacobian should have rows. Or a solver of
      optimistix for least squares or minimisation, such as `optx.BFGS(1e-3, 1e-3)`; or one of
      jaxopt, such as `jaxopt.LBFGSB(fun=jnp.sum)`, whose function is replaced. Those of jaxopt that
      take bounds stay within four prior standard deviations of the prior; where the data want more,
      they do not converge.
    - `max_steps`: most steps.
    - `tolerance`: of a solver given by name, the relative change of the coordinates and of the
      misfit or, for "lbfgsb", the largest slope in whitened coordinates, at which it ends. A solver
      object has its own. Whatever the solver, the fit has converged only where a Gauss-Newton step
      would lower the objective by no more than this: 1e-3 is 0.045 posterior standard deviations.
    - `start`: whitened coordinates to start from; the prior's centre by default.
    - `offset`: added to the predicted statistics: what a cheap forward model lacks.
    - `report`: called with the objective and the norm of its gradient at each evaluation.
    - `context`: further arguments of `predict`. A `Scene` among them shows whole plants, so that a
      cover moves its image by steps: fit with `scene.faded()`, whose image moves as its slope says,
      and give what whole plants differ by as `offset`.
    - `keep`: how a step is done, such as by a `Journal`, which keeps what it returned.
    - `known`: statistics, offset included, and Jacobian [statistic, free] at `start`, if they are
      computed already: "least_squares" with `report` or `keep` then does not compute them again.

    **Returns:** `FitResult`. A stop without convergence, a loss or slope that is not finite, and
    parameters that nothing depends on are stated in its `status`, not raised. Where a solver ends
    by a rule of its own before the fit has converged (see `tolerance`), the status is
    `FitStatus.no_gain`; one of optimistix for least squares goes on. A minimum may be a local one.

    Without `report` and `keep` the fit can be compiled by `jax.jit` and mapped by `jax.vmap`, over
    data, priors, start or context; not with "lbfgsb" and the solvers of SciPy. The estimate is
    differentiable once in data, priors, offset and context, by the implicit function theorem with
    the Hessian of the objective; only nearly where the model itself can be differentiated once, as
    light in a canopy (`fynjax.radiation.solve_light`).

    **Raises:** `InputError` for an unknown solver, a fit that cannot be traced, and where JAX is
    limited to 32 bits.

    **Example:** a line through three points, whose offset and slope have wide priors.

    >>> import jax.numpy as jnp
    >>> from fynjax.inversion import Data, ParameterSpace, fit
    >>> at = jnp.array([0.0, 1.0, 2.0])
    >>> data = Data(("a", "b", "c"), jnp.array([1.0, 2.0, 3.0]), jnp.full(3, 0.1))
    >>> low, high, prior, sd = (jnp.full(2, v) for v in (-100.0, 100.0, 0.5, 10.0))
    >>> space = ParameterSpace(("offset", "slope"), low, high, prior, sd)
    >>> line = fit(lambda x: x[0] + x[1] * at, data, space)
    >>> line.estimate.round(2).tolist(), bool(line.converged)
    ([1.0, 1.0], True)
    """
    require_double_precision("`fit`")
    if max_steps < 1:
        raise InputError(f"`max_steps` must be at least 1, but is {max_steps}")
    # In 64 bits also for data in 32: else `evaluate` and `fit` compile a step each.
    shift = jnp.zeros(data.value.shape) if offset is None else jnp.asarray(offset, float)
    u = jnp.zeros(len(space.names)) if start is None else jnp.asarray(start, float)
    density = LogPosterior(predict, space, data, shift, context)
    if not (isinstance(solver, str) and solver == "least_squares"):
        known = None  # others may evaluate more than the start in their first step
    if isinstance(solver, str):
        if solver not in _NAMED:
            raise InputError(f"`solver` must be one of {_NAMED} or an object, but is {solver!r}")
        solver = lbfgsb(tolerance) if solver == "lbfgsb" else least_squares(tolerance)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((density, u)))
    watched = report is not None or keep is not keep_nothing
    if traced and (watched or is_scipy(solver)):
        raise InputError(
            "a fit inside `jax.jit`, `jax.vmap` or `jax.grad` must leave out `report` and `keep`, "
            "and its solver must not be one of SciPy ('lbfgsb' is)"
        )
    history: list[Figures] = []

    def note(figures: Figures) -> None:
        history.append(figures)
        if report is not None:
            report(float(figures[0]), float(figures[1]))

    if is_scipy(solver):
        u, status = run_scipy(
            solver, lambda u: keep(lambda: objective_and_gradient(density, u)), u, max_steps, note
        )
        predicted, jacobian = keep(lambda: statistics_and_jacobian(density, u))
    elif watched:
        u, predicted, jacobian, status = _run_watched(
            density, stepper(solver, tolerance), u, max_steps, note, keep, known
        )
    else:
        run, method = _run if traced else _run_compiled, stepper(solver, tolerance)
        u, predicted, jacobian, status, steps, trace = run(density, method, u, max_steps)
        status = confirmed(status, data, u, predicted, jacobian, jnp.asarray(tolerance))
        u, predicted, jacobian = _solution(density, u, predicted, jacobian)
        if not isinstance(steps, jax.core.Tracer):
            trace = jnp.asarray(trace[: int(steps)])
        return fit_result(space, data, u, predicted, jacobian, status, steps, trace)
    status = confirmed(status, data, u, predicted, jacobian, jnp.asarray(tolerance))
    trace = jnp.asarray(np.asarray(history, float).reshape(-1, 2))
    return fit_result(space, data, u, predicted, jacobian, status, len(trace), trace)


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


@eqx.filter_jit
def objective_and_gradient(
    density: LogPosterior, u: Float[Array, " free"]
) -> tuple[Float[Array, ""], Float[Array, " free"]]:
    """Minus the log posterior `density` at whitened coordinates `u` and its gradient, compiled."""
    return jax.value_and_grad(lambda u: -density(u))(u)


def evaluate(
    density: LogPosterior, u: Float[Array, " free"], keep: Keep = keep_nothing
) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
    """Statistics and Jacobian at `u`, by the first step of a fit, so that nothing else compiles.

    **Arguments:** `density`, whitened coordinates `u`, and `keep` as `fit` has it.
    """
    method = least_squares(1.0)
    _, state, *_ = _step(density, method, u, method.start(density, u), keep)
    value, jacobian, *_ = state.aux
    return value, jacobian


# -- The loop over steps --------------------------------------------------------------------


class _Evaluated(eqx.Module):
    """A density whose statistics and Jacobian may be known where the next step takes them."""

    density: LogPosterior
    known: Bool[Array, ""]
    statistics: Float[Array, " statistic"]
    slopes: Float[Array, "statistic free"]

    @property
    def data(self) -> Data:
        return self.density.data

    def jacobian(self, u: Array) -> tuple[Array, Array]:
        return jax.lax.cond(
            self.known,
            lambda: (self.statistics, self.slopes),
            lambda: self.density.jacobian(u),
        )

    def __call__(self, u: Array) -> Array:
        return self.density(u)


@eqx.filter_jit
def step(density: Any, method: AbstractStepper, u: Array, state: Any) -> Any:
    """One step of a solver: all that a least-squares fit that is watched compiles."""
    return method.step(density, u, state)


def _step(
    density: LogPosterior,
    method: AbstractStepper,
    u: Array,
    state: Any,
    keep: Keep,
    known: tuple[Array, Array] | None = None,
) -> Any:
    """A step whose arrays `keep` may take from an earlier run."""
    arrays, rest = eqx.partition((u, state), eqx.is_array)
    structure = jax.tree.structure(arrays)
    if known is None:
        size = density.data.value.size
        values, slopes = jnp.zeros(size, u.dtype), jnp.zeros((size, u.size), u.dtype)
    else:
        values, slopes = known
    problem = _Evaluated(density, jnp.asarray(known is not None), values, slopes)

    def do() -> tuple[Array, ...]:
        u, state, figures, status = step(problem, method, *eqx.combine(arrays, rest))
        return *figures, status._value, *jax.tree.leaves(eqx.filter((u, state), eqx.is_array))

    loss, norm, code, *leaves = keep(do)
    u, state = eqx.combine(jax.tree.unflatten(structure, leaves), rest)
    return u, state, (loss, norm), eqx.tree_at(lambda s: s._value, FitStatus.max_steps, code)


def _run_watched(
    density: LogPosterior,
    method: AbstractStepper,
    u: Array,
    max_steps: int,
    note: Callable[[Figures], None],
    keep: Keep,
    known: tuple[Array, Array] | None,
) -> tuple[Array, Array, Array, FitStatus]:
    """Step by step, so that it can be watched, stopped between steps and taken up again."""
    state = method.start(density, u)
    for _ in range(max_steps):
        u, state, figures, status = _step(density, method, u, state, keep, known)
        known = None  # was at the start
        note(figures)
        if bool(status != FitStatus.max_steps):
            break
    reached: tuple[Array, ...] | None = method.statistics(state)
    if reached is None:
        reached = keep(lambda: statistics_and_jacobian(density, u))
    predicted, jacobian = reached
    return u, predicted, jacobian, status


def _run(
    density: LogPosterior, method: AbstractStepper, u: Array, max_steps: int
) -> tuple[Array, Array, Array, FitStatus, Array, Array]:
    """The same steps in one loop of JAX; the figures of steps not taken are NaN."""
    density, u = _constant((density, u))
    start = (u, method.start(density, u))
    arrays, rest = eqx.partition(start, eqx.is_array)
    trace = jnp.full((max_steps, 2), jnp.nan, u.dtype)

    def going(carry: Any) -> Array:
        count, status, *_ = carry
        return (count < max_steps) & (status == FitStatus.max_steps)

    def do(carry: Any) -> Any:
        count, _, arrays, trace = carry
        u, state, figures, status = method.step(density, *eqx.combine(arrays, rest))
        arrays = eqx.filter((u, state), eqx.is_array)
        return count + 1, status, arrays, trace.at[count].set(jnp.stack(figures))

    begin = (jnp.asarray(0), _as_array(FitStatus.max_steps), arrays, trace)
    steps, status, arrays, trace = jax.lax.while_loop(going, do, begin)
    u, state = eqx.combine(arrays, rest)
    known = method.statistics(state)
    predicted, jacobian = density.jacobian(u) if known is None else known
    return u, predicted, jacobian, status, steps, trace


_run_compiled = eqx.filter_jit(_run)


def _as_array(status: Any) -> Any:
    return jax.tree.map(jnp.asarray, status)


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

    _, moved = eqx.filter_jvp(lambda density: gradient(density, u), (density,), (change,))
    hessian = lx.MatrixLinearOperator(jax.hessian(lambda u: -density(u))(u), lx.symmetric_tag)
    solver = lx.AutoLinearSolver(well_posed=True)
    du = -lx.linear_solve(hessian, moved, solver, throw=False).value
    _, (value, slopes) = eqx.filter_jvp(
        lambda density, u: density.jacobian(u), (density, u), (change, du)
    )
    return (u, predicted, jacobian), (du, value, slopes)
