"""Solvers of optimistix and jaxopt behind one interface: a step, and what it says of itself.

A problem is a `LogPosterior` over whitened coordinates u. What a solver evaluates has its
derivatives attached: an evaluation takes each once, and the Jacobian comes back for the
uncertainty.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.least_squares import NO_TAGS, BroydenLM
from fynjax.inversion._fit_result import Data, FitStatus
from fynjax.inversion._log_posterior import LogPosterior

Figures = tuple[Array, Array]
"""The objective and the norm of its gradient."""

_DAMPING = 0.1
"""Step size of the trust region at first: a full first step often overshoots."""
_REACH = 4.0
"""Bounds in prior standard deviations: beyond, the transform to a bounded parameter is flat."""
_OPTIONS = {"jac": "bwd"}  # the Jacobian as an array, which another fit can pass again


def _of_jaxopt(solver: Any) -> bool:
    return type(solver).__module__.split(".")[0] == "jaxopt"


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
def confirmed(
    status: Any,
    data: Data,
    u: Float[Array, " free"],
    statistics: Float[Array, " statistic"],
    jacobian: Float[Array, "statistic free"],
    tolerance: Float[Array, ""],
) -> Any:
    """The status of a fit that ended at `u`, converged only where the `gain` left is at most
    `tolerance`, whatever rule of the solver's own ended it."""
    fixed = jax.lax.stop_gradient((data, u, statistics, jacobian))
    settled = gain(*fixed) <= tolerance
    ended = (status == FitStatus.successful) | (status == FitStatus.no_gain)
    found = FitStatus.where(settled, FitStatus.successful, FitStatus.no_gain)
    return FitStatus.where(ended, found, status)


class AbstractStepper(eqx.Module):
    """A solver that goes by steps, compiled or not."""

    @abc.abstractmethod
    def start(self, density: LogPosterior, u: Float[Array, " free"]) -> Any:
        """Its state before the first step from `u`."""

    @abc.abstractmethod
    def step(
        self, density: LogPosterior, u: Float[Array, " free"], state: Any
    ) -> tuple[Float[Array, " free"], Any, Figures, FitStatus]:
        """A step: coordinates, state, figures there, and `FitStatus.max_steps` to go on."""

    def statistics(self, state: Any) -> tuple[Array, Array] | None:
        """Statistics and Jacobian at the coordinates it has reached, if it knows them."""
        return None


def stepper(solver: Any, tolerance: float) -> AbstractStepper:
    """The stepper of a solver object, which goes on while more than `tolerance` is to gain; of
    Levenberg-Marquardt, damped from the start, where there is none."""
    if solver is None:
        limit: Any = jnp.asarray(tolerance)  # an array: another tolerance compiles nothing
        return OptimistixStepper(optx.LevenbergMarquardt(limit, limit), limit, _DAMPING)
    if isinstance(solver, BroydenLM):
        return BroydenStepper(solver, jnp.asarray(tolerance))
    if isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        return OptimistixStepper(solver, jnp.asarray(tolerance), None)
    if _of_jaxopt(solver) and hasattr(solver, "init_state"):
        return JaxoptStepper(solver)
    raise InputError(
        "`solver` must be a solver of optimistix or jaxopt that runs in JAX, for least squares or "
        f"minimisation, but is of {type(solver).__module__}.{type(solver).__name__}"
    )


def _status(figures: Figures, done: Array, result: Any) -> FitStatus:
    status = FitStatus.where(done, FitStatus.successful, FitStatus.max_steps)
    status = FitStatus.where(result == optx.RESULTS.successful, status, FitStatus.promote(result))
    finite = jnp.isfinite(figures[0]) & jnp.isfinite(figures[1])
    return FitStatus.where(finite, status, FitStatus.not_finite)


def _residual(jacobian: Callable[[Array], tuple[Array, Array]]) -> Callable[..., Any]:
    """Misfit of the data, then distance from the prior; from the statistics' Jacobian."""

    def residual(u: Array, density: LogPosterior) -> tuple[Array, tuple[Array, ...]]:
        data = density.data
        here = jax.lax.stop_gradient(u)
        value, slopes = jacobian(here)
        # The value with its slope attached: the solver's own differentiation is then a product
        # with the Jacobian, which it also hands back for the uncertainty.
        linear = value + slopes @ (u - here)
        rest = jnp.concatenate([data.whiten(linear - data.value), u])
        still = jax.lax.stop_gradient(rest)
        slope = data.whiten(slopes).T @ still[: value.size] + here
        return rest, (value, slopes, 0.5 * still @ still, jnp.linalg.norm(slope))

    return residual


def _objective(u: Array, density: LogPosterior) -> tuple[Array, Figures]:
    """Minus the log density with its slope attached."""
    here = jax.lax.stop_gradient(u)
    loss, slope = jax.value_and_grad(lambda u: -density(u))(here)
    return loss + slope @ (u - here), (loss, jnp.linalg.norm(slope))


class OptimistixStepper(AbstractStepper):
    """A solver of optimistix, for least squares or for minimisation."""

    solver: Any
    tolerance: Float[Array, ""]
    """Of the `gain` left at the end."""
    damping: float | None = eqx.field(static=True)

    @property
    def _by_residuals(self) -> bool:
        return isinstance(self.solver, optx.AbstractLeastSquaresSolver)

    def start(self, density: LogPosterior, u: Float[Array, " free"]) -> Any:
        # A stand-in with the right shapes: to trace the forward model for them takes seconds.
        if self._by_residuals:
            shape = (density.data.value.size, u.size)
            zeros = (jnp.zeros(shape[0], u.dtype), jnp.zeros(shape, u.dtype))
            function: Any = _residual(lambda _: zeros)
        else:
            function = lambda u, _: (0.5 * u @ u, (0.5 * u @ u, jnp.linalg.norm(u)))  # noqa: E731
        out, aux = jax.eval_shape(lambda u: function(u, density), u)
        state = self.solver.init(function, u, density, _OPTIONS, out, aux, NO_TAGS)
        if self.damping is not None:
            size = jnp.asarray(self.damping)
            state = eqx.tree_at(lambda s: s.search_state.step_size, state, size)
        return state

    def step(
        self, density: LogPosterior, u: Float[Array, " free"], state: Any
    ) -> tuple[Float[Array, " free"], Any, Figures, FitStatus]:
        function: Any = _residual(density.jacobian) if self._by_residuals else _objective
        u, state, _ = self.solver.step(function, u, density, _OPTIONS, state, NO_TAGS)
        done, result = self.solver.terminate(function, u, density, _OPTIONS, state, NO_TAGS)
        *reached, loss, norm = state.aux
        if self._by_residuals:
            done &= gain(density.data, u, *reached) <= self.tolerance
        return u, state, (loss, norm), _status((loss, norm), done, result)

    def statistics(self, state: Any) -> tuple[Array, Array] | None:
        return state.aux[:2] if self._by_residuals else None


class BroydenStepper(AbstractStepper):
    """`BroydenLM`, whose state holds the figures, and which asks for a Jacobian rarely."""

    solver: BroydenLM
    tolerance: Float[Array, ""]
    """Of the `gain` left at the end."""

    def _call(self, density: LogPosterior) -> tuple[BroydenLM, Any, dict[str, Any]]:
        def residual(u: Array, _: Any) -> tuple[Array, None]:
            misfit = density.data.whiten(density.statistics(u) - density.data.value)
            return jnp.concatenate([misfit, u]), None

        def jacobian(u: Array, _: Any) -> tuple[Array, Array]:
            value, slopes = density.jacobian(u)
            misfit = density.data.whiten(value - density.data.value)
            rows = jnp.concatenate([density.data.whiten(slopes), jnp.eye(u.size)])
            return jnp.concatenate([misfit, u]), rows

        solver = dataclasses.replace(
            self.solver, atol=jnp.minimum(self.solver.atol, self.tolerance)
        )
        return solver, residual, {"jacobian": jacobian}

    def start(self, density: LogPosterior, u: Float[Array, " free"]) -> Any:
        solver, residual, options = self._call(density)
        return solver.init(residual, u, None, options, None, None, NO_TAGS)

    def step(
        self, density: LogPosterior, u: Float[Array, " free"], state: Any
    ) -> tuple[Float[Array, " free"], Any, Figures, FitStatus]:
        solver, residual, options = self._call(density)
        u, state, _ = solver.step(residual, u, None, options, state, NO_TAGS)
        done, _ = solver.terminate(residual, u, None, options, state, NO_TAGS)
        # A corrected Jacobian may lack what is left to gain: only a new one can tell.
        fresh = lambda: solver.init(residual, u, None, options, None, None, NO_TAGS)  # noqa: E731
        state = jax.lax.cond(done, fresh, lambda: state)
        done, result = solver.terminate(residual, u, None, options, state, NO_TAGS)
        figures = (
            0.5 * state.residual @ state.residual,
            jnp.linalg.norm(state.jacobian.T @ state.residual),
        )
        return u, state, figures, _status(figures, done, result)


class JaxoptStepper(AbstractStepper):
    """A solver of jaxopt that runs in JAX."""

    solver: Any = eqx.field(static=True)

    def _set(self, density: LogPosterior, u: Array) -> tuple[Any, tuple[Any, ...]]:
        """The solver of this problem, and its bounds where it takes any."""
        # A fit has its own derivative, and its own loop.
        options: dict[str, Any] = {"has_aux": True, "implicit_diff": False}
        if hasattr(self.solver, "residual_fun"):

            def residual(u: Array) -> tuple[Array, Figures]:
                rest, (*_, loss, norm) = _residual(density.jacobian)(u, density)
                return rest, (loss, norm)

            options["residual_fun"] = residual
        else:
            options |= {"fun": lambda u: _objective(u, density), "value_and_grad": False}
        reach = jnp.full_like(u, _REACH)
        projection = getattr(self.solver, "projection", None)
        bounded = type(self.solver).__name__ == "LBFGSB" or (
            getattr(projection, "__name__", "") == "projection_box"
        )
        bounds = ((-reach, reach),) if bounded else (None,) * (projection is not None)
        return dataclasses.replace(self.solver, **options), bounds

    def start(self, density: LogPosterior, u: Float[Array, " free"]) -> Any:
        solver, bounds = self._set(density, u)
        state = eqx.filter_jit(solver.init_state)(u, *bounds)
        return jax.tree.map(jnp.asarray, state)  # some count steps by a Python number at first

    def step(
        self, density: LogPosterior, u: Float[Array, " free"], state: Any
    ) -> tuple[Float[Array, " free"], Any, Figures, FitStatus]:
        solver, bounds = self._set(density, u)
        u, state = solver.update(u, state, *bounds)
        done = state.error <= solver.tol
        return u, state, state.aux, _status(state.aux, done, optx.RESULTS.successful)
