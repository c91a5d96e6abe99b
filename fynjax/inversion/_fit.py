"""Fit parameters to statistics with a prior, and say how far the data pinned them down.

The objective is half the squared whitened misfit of the statistics plus half the squared
distance from the prior, also whitened: the negative log posterior, but for a constant.
"""

from collections.abc import Callable
from copy import copy
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from fynjax._core.checkpoint import Keep, keep_nothing
from fynjax._core.errors import InputError
from fynjax.inversion._fit_result import Data, FitResult, posterior
from fynjax.inversion._space import ParameterSpace

Predict = Callable[..., Float[Array, " statistic"]]
"""Statistics from parameters in their own units [free], and whatever else the caller passes on as
`context`; differentiable and traceable."""


def fit(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    *,
    method: str = "least_squares",
    max_steps: int = 30,
    tolerance: float = 1e-3,
    start: Float[Array, " free"] | None = None,
    offset: Float[Array, " statistic"] | None = None,
    report: Callable[[float, float], None] | None = None,
    forward: "Forward | None" = None,
    context: tuple[Any, ...] = (),
    keep: Keep = keep_nothing,
) -> FitResult:
    """Find the most probable parameters.

    **Arguments:**

    - `predict`: the forward model.
    - `data`, `space`: statistics with their errors; free parameters with their priors.
    - `method`: "least_squares", Levenberg-Marquardt by optimistix, which takes the Jacobian at
      each of a few steps; or "lbfgsb", quasi-Newton by jaxopt, which takes one gradient at each
      of many: for more statistics than a Jacobian should have rows.
    - `max_steps`, `tolerance`: most steps, and the relative change of the coordinates and of the
      misfit or, for "lbfgsb", the largest slope in whitened coordinates, at which it ends.
    - `start`: whitened coordinates to start from; the prior's centre by default.
    - `offset`: added to the predicted statistics: what a cheap forward model lacks.
    - `report`: called with the objective and the norm of its gradient at each evaluation.
    - `forward`: the compiled forward model of an earlier call, to be used again.
    - `context`: further arguments of `predict`.
    - `keep`: how a step is done, such as by a `Journal`, which keeps what it returned.

    A stop without convergence, a loss or slope that is not finite, and parameters that nothing
    depends on are stated in the result's `status`, not raised.
    """
    if max_steps < 1:
        raise InputError(f"`max_steps` must be at least 1, but is {max_steps}")
    forward = Forward(predict, space) if forward is None else forward
    shift = jnp.zeros_like(data.value) if offset is None else offset
    u = jnp.zeros(len(space.names)) if start is None else jnp.asarray(start, float)
    history: list[tuple[float, float]] = []

    def note(loss: Array, norm: Array) -> None:
        history.append((float(loss), float(norm)))
        if report is not None:
            report(*history[-1])

    if method == "least_squares":
        solver = _LeastSquares(forward, data, shift, tolerance, context, keep)
        u, predicted, jacobian, status, converged = solver.run(u, max_steps, note)
    elif method == "lbfgsb":
        misfit = lambda u: keep(lambda: forward.misfit(u, data, shift, context))  # noqa: E731
        u, status, converged = _quasi_newton(misfit, u, max_steps, tolerance, note)
        predicted, jacobian = keep(lambda: forward.jacobian(u, context))
    else:
        raise InputError(f"`method` must be 'lbfgsb' or 'least_squares', but is {method!r}")
    predicted = predicted + shift
    scaled = data.whiten(jacobian)
    losses, norms = np.asarray(history, float).reshape(-1, 2).T
    if reason := _broken(predicted, jacobian, data, space):
        status, converged = f"{reason}; the estimate is of no use.", False
        scaled = jnp.zeros_like(scaled)
    elif still := [n for n, s in zip(space.names, np.abs(jacobian).max(axis=0)) if s == 0.0]:
        shown = ", ".join(still[:3]) + (f" and {len(still) - 3} more" if len(still) > 3 else "")
        status += f" No statistic depends on {shown}: flat, left at the prior."
    return FitResult(
        space=space,
        data=data,
        whitened=u,
        estimate=space.physical(u),
        predicted=predicted,
        jacobian=jacobian,
        loss=losses,
        gradient_norm=norms,
        converged=converged,
        status=status,
        **posterior(space, u, scaled.T @ scaled),
    )


def _broken(predicted: Array, jacobian: Array, data: Data, space: ParameterSpace) -> str:
    """Which statistic or slope is not finite, in words; nothing if all are."""
    value, slope = (np.isfinite(np.asarray(a)) for a in (predicted, jacobian))
    if not value.all():
        return f"A predicted statistic is not finite ({data.names[int(np.argmin(value))]})"
    if not slope.all():
        row, column = np.argwhere(~slope)[0]
        return f"The slope of {data.names[row]} by {space.names[column]} is not finite"
    return ""


def jacobian_by_rows(
    function: Callable[[Array], Array], u: Float[Array, " free"]
) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
    """Value and Jacobian by reverse mode, a statistic at a time."""
    value, backward = jax.vjp(function, u)
    every = jnp.eye(value.size, dtype=value.dtype)
    return value, jax.lax.map(lambda row: backward(row)[0], every, batch_size=1)


class Forward:
    """A forward model in whitened coordinates, each way of running it compiled once.

    Derivatives are by reverse mode: a plot has more free parameters than statistics. A forward
    model that knows a cheaper way has a method `jacobian(values_at, u, *context)`.

    `values`: statistics at whitened coordinates. `jacobian`: these and their derivatives,
    [statistic] and [statistic, free]. `misfit`: objective and gradient, from coordinates, data and
    offset. `step`: one step of Levenberg-Marquardt; all that a least-squares fit compiles.
    """

    def __init__(self, predict: Predict, space: ParameterSpace) -> None:
        def values(space: ParameterSpace, u: Array, context: tuple[Any, ...] = ()) -> Array:
            return predict(space.physical(u), *context).astype(u.dtype)

        def with_jacobian(
            space: ParameterSpace, u: Array, context: tuple[Any, ...] = ()
        ) -> tuple[Array, Array]:
            own = getattr(predict, "jacobian", None)
            if own is not None:
                return own(space.physical, u, *context)
            return jacobian_by_rows(lambda u: values(space, u, context), u)

        def misfit(
            space: ParameterSpace, u: Array, data: Data, offset: Array, context: Any = ()
        ) -> tuple[Array, Array]:
            def objective(u: Array) -> Array:
                rest = data.whiten(values(space, u, context) + offset - data.value)
                return 0.5 * (rest @ rest + u @ u)

            return jax.value_and_grad(objective)(u)

        def step(
            space: ParameterSpace,
            u: Array,
            state: Any,
            data: Data,
            offset: Array,
            tolerance: Array,
            context: Any,
        ) -> Any:
            residual = _residual(lambda u, context: with_jacobian(space, u, context))
            solver = _solver(tolerance)
            args, tags = (data, offset, context), frozenset[object]()
            u, state, _ = solver.step(residual, u, args, _OPTIONS, state, tags)
            done, result = solver.terminate(residual, u, args, _OPTIONS, state, tags)
            return u, state, state.aux, done & (result == optx.RESULTS.successful)

        self._compiled = [eqx.filter_jit(f) for f in (values, with_jacobian, misfit, step)]
        self._bind(space)

    def _bind(self, space: ParameterSpace) -> None:
        self.values, self.jacobian, self.misfit, self.step = (
            partial(function, space) for function in self._compiled
        )

    def with_space(self, space: ParameterSpace) -> "Forward":
        """The same model with other priors and bounds of the same parameters, compiled no more."""
        other = copy(self)
        other._bind(space)
        return other


_TRUST = 0.1
_OPTIONS = {"jac": "bwd"}  # the Jacobian as an array, which another fit can pass again


def _solver(tolerance: Array) -> Any:
    return optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)  # type: ignore[arg-type]


def _residual(with_jacobian: Callable[..., tuple[Array, Array]]) -> Callable[..., Any]:
    """The residual for optimistix: misfit of the data, then distance from the prior."""

    def residual(u: Array, args: tuple[Data, Array, Any]) -> tuple[Array, tuple[Array, ...]]:
        data, offset, context = args
        here = jax.lax.stop_gradient(u)
        value, jacobian = with_jacobian(here, context)
        # The value with its slope attached: the solver's own differentiation is then a product
        # with the Jacobian, which it also hands back for the uncertainty.
        linear = value + jacobian @ (u - here)
        rest = jnp.concatenate([data.whiten(linear + offset - data.value), u])
        still = jax.lax.stop_gradient(rest)
        slope = data.whiten(jacobian).T @ still[: value.size] + here
        return rest, (value, jacobian, 0.5 * still @ still, jnp.linalg.norm(slope))

    return residual


class _LeastSquares:
    """Levenberg-Marquardt by optimistix, a compiled step at a time: it can be watched and stopped
    between steps, and another fit of the same forward model compiles nothing."""

    def __init__(
        self,
        forward: Forward,
        data: Data,
        offset: Array,
        tolerance: float,
        context: Any,
        keep: Keep = keep_nothing,
    ) -> None:
        self._forward, self._data, self._offset, self._context = forward, data, offset, context
        self._tolerance, self._keep = jnp.asarray(tolerance), keep

    def start(self, u: Array) -> Any:
        # A stand-in with the right shapes: to trace the forward model for them takes seconds.
        shape = (self._data.value.size, u.size)
        residual = _residual(lambda u, _: (jnp.zeros(shape[0], u.dtype), jnp.zeros(shape, u.dtype)))
        args = (self._data, self._offset, ())
        rest, found = jax.eval_shape(lambda u: residual(u, args), u)
        state = _solver(self._tolerance).init(residual, u, args, _OPTIONS, rest, found, frozenset())
        # Damped from the start: a full first step often overshoots, and costs an evaluation.
        return eqx.tree_at(lambda s: s.search_state.step_size, state, jnp.asarray(_TRUST))

    def step(self, u: Array, state: Any) -> Any:
        now, still = eqx.partition((u, state), eqx.is_array)
        structure = jax.tree.structure(now)

        def do() -> tuple[Array, ...]:
            u, state = eqx.combine(now, still)
            u, state, _, done = self._forward.step(
                u, state, self._data, self._offset, self._tolerance, self._context
            )
            return done, *jax.tree.leaves(eqx.filter((u, state), eqx.is_array))

        done, *arrays = self._keep(do)
        u, state = eqx.combine(jax.tree.unflatten(structure, arrays), still)
        return u, state, state.aux, done

    def run(
        self, u: Array, max_steps: int, note: Callable[[Array, Array], None]
    ) -> tuple[Array, Array, Array, str, bool]:
        """Estimate, statistics and Jacobian there, status in words, whether it converged."""
        state = self.start(u)
        for count in range(1, max_steps + 1):
            u, state, (value, jacobian, loss, slope), done = self.step(u, state)
            note(loss, slope)
            if not np.isfinite(float(loss) + float(slope)):
                return u, value, jacobian, f"The loss is not finite at step {count}.", False
            if bool(done):
                return u, value, jacobian, f"Converged after {_steps(count)}.", True
        return u, value, jacobian, f"Stopped at the limit of {_steps(max_steps)}.", False


def _steps(count: int) -> str:
    return f"{count} step" + ("s" if count != 1 else "")


def evaluate(
    forward: Forward,
    data: Data,
    u: Array,
    context: tuple[Any, ...] = (),
    keep: Keep = keep_nothing,
) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
    """Statistics and Jacobian at `u`, by the first step of a fit, so that nothing else compiles."""
    solver = _LeastSquares(forward, data, jnp.zeros_like(data.value), 1.0, context, keep)
    _, _, (value, jacobian, *_), _ = solver.step(u, solver.start(u))
    return value, jacobian


def _quasi_newton(
    misfit: Callable[[Array], tuple[Array, ...]],
    start: Array,
    max_steps: int,
    tolerance: float,
    note: Callable[[Array, Array], None],
) -> tuple[Array, str, bool]:
    import jaxopt  # late: it warns on import that it is no longer maintained

    def objective(u: Array) -> tuple[float, Array]:
        loss, gradient = misfit(jnp.asarray(u))
        note(loss, jnp.linalg.norm(gradient))
        return float(loss), gradient

    # Four prior widths either way: beyond, the bounded transform is flat.
    reach = jnp.full_like(start, 4.0)
    solver = jaxopt.ScipyBoundedMinimize(
        fun=objective,
        method="l-bfgs-b",
        value_and_grad=True,
        jit=False,
        maxiter=max_steps,
        tol=tolerance,
        options={"maxcor": 20, "maxfun": 2 * max_steps, "gtol": tolerance, "ftol": 1e-9},
    )
    parameters, state = solver.run(start, (-reach, reach))
    loss, gradient = misfit(jnp.asarray(parameters))
    norm = float(jnp.linalg.norm(gradient))
    if not np.isfinite(float(loss)):
        return start, "The objective is not finite; the estimate is the start.", False
    if bool(state.success) and norm <= 10 * tolerance * np.sqrt(start.size):
        return jnp.asarray(parameters), f"Converged: gradient norm {norm:.2g}.", True
    status = f"Stopped after {int(state.iter_num)} steps, gradient norm {norm:.2g}."
    return jnp.asarray(parameters), status, False
