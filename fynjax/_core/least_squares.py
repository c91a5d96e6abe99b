"""Levenberg-Marquardt as a solver of optimistix, for models whose Jacobian costs tens of
evaluations."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from fynjax._core.errors import InputError

NO_TAGS: frozenset[object] = frozenset()
"""A solver of optimistix may use tags of the structure of a problem; there are none."""


class BroydenState(eqx.Module):
    """Where a descent stands: all that another process needs to go on from here."""

    residual: Float[Array, " residual"]
    """Residual at the current point [-]."""
    jacobian: Float[Array, "residual free"]
    """Derivative of the residual at the current point, as corrected so far."""
    damping: Float[Array, ""]
    """Added to the diagonal of the Gauss-Newton Hessian [-]."""
    gain: Float[Array, ""]
    """Share by which a further undamped step would lower half the squared residual [-]."""
    steps: Int[Array, ""]
    """Steps taken, refused ones included."""


class BroydenLM(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt whose Jacobian each step corrects by what it changed, or takes anew.

    The Jacobian is taken once at the start. After each step to a point d away, it is corrected by
    the least change that explains the residuals there (Broyden 1965, Mathematics of Computation 19,
    577). A step starts undamped, as the residuals of a fit hold the distance from its prior in
    units of the prior, which bounds the Hessian from below.

    The descent has converged where a further Gauss-Newton step would lower half the squared
    residual by at most `atol + rtol` times that: with a prior, half a squared distance in posterior
    standard deviations. Where a residual or slope is not finite the result is
    `optx.RESULTS.nonlinear_divergence`, as where a residual without a prior depends on some
    coordinate not at all.

    Works in `optx.least_squares` and, step by step, by `init`, `step` and `terminate`.
    `options["jacobian"]` may be a function (y, args) -> (residual, jacobian), where these are known
    with less work than by differentiating `fn`. Points and residuals are arrays of one axis,
    without further outputs (`has_aux`). The state is a pytree of arrays; jit and vmap work.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import optimistix as optx
    >>> import fynjax as fx
    >>> bent = lambda y, _: jnp.array([y[0] ** 2 - 2.0, y[0] - 1.0])
    >>> found = optx.least_squares(bent, fx.BroydenLM(atol=1e-6), jnp.ones(1))
    >>> found.value.round(2).tolist()
    [1.37]
    """

    atol: Any = 0.05
    """Least fall of half the squared residual that is worth another step [-]."""
    rtol: float = 0.0
    """Least fall as a share of half the squared residual that is worth another step [-]."""
    norm: Callable = eqx.field(static=True, default=optx.max_norm)
    """Norm that optimistix asks every solver for; this one does not use it."""
    renew: bool = eqx.field(static=True, default=False)
    """Whether every step takes the Jacobian anew instead of correcting it."""
    longest: float = eqx.field(static=True, default=float("inf"))
    """A step changes no coordinate by more."""

    def init(
        self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any
    ) -> BroydenState:
        """The state at `y`."""
        if aux_struct is not None:
            raise InputError("expected a function of residuals alone, without `has_aux`")
        residual, jacobian = _jacobian(fn, y, args, options)
        return _state(residual, jacobian, jnp.zeros((), residual.dtype), jnp.zeros((), int))

    def step(
        self, fn: Any, y: Any, args: Any, options: Any, state: BroydenState, tags: Any
    ) -> tuple[Any, BroydenState, Any]:
        """One step; where it would not lower the objective, none, and more damping."""
        residual, jacobian = state.residual, state.jacobian
        gradient, hessian = jacobian.T @ residual, jacobian.T @ jacobian
        move = self.move(state)
        if self.renew:
            reached, renewed = _jacobian(fn, y + move, args, options)
        else:
            reached, _ = fn(y + move, args)
        expected = -gradient @ move - 0.5 * move @ hessian @ move
        fall = 0.5 * (residual @ residual - reached @ reached)
        finite = jnp.isfinite(fall)
        accepted = finite & (fall > 0)
        if self.renew:
            jacobian = jnp.where(accepted, renewed, jacobian)
        else:  # a refused step corrects the Jacobian too
            change = jnp.where(finite, reached - residual - jacobian @ move, 0.0)
            jacobian = jacobian + jnp.outer(change, move) / jnp.maximum(
                move @ move, jnp.finfo(move.dtype).tiny
            )
        eased = jnp.where(fall > 0.5 * expected, 0.25 * state.damping, state.damping)
        damping = jnp.where(accepted, eased, jnp.maximum(4.0 * state.damping, 1.0))
        residual = jnp.where(accepted, reached, residual)
        y = jnp.where(accepted, y + move, y)
        return y, _state(residual, jacobian, damping, state.steps + 1), None

    def move(self, state: BroydenState) -> Float[Array, " free"]:
        """Change of the coordinates by the next step, should it lower the objective."""
        gradient, hessian = state.jacobian.T @ state.residual, state.jacobian.T @ state.jacobian
        damped = hessian + state.damping * jnp.eye(gradient.size, dtype=hessian.dtype)
        move = -jnp.linalg.solve(damped, gradient)
        return move / jnp.maximum(1.0, jnp.max(jnp.abs(move)) / self.longest)

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: BroydenState, tags: Any
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Whether too little is left to gain, or a number is not finite."""
        finite = jnp.isfinite(state.gain)
        enough = self.atol + self.rtol * 0.5 * (state.residual @ state.residual)
        good, bad = optx.RESULTS.successful, optx.RESULTS.nonlinear_divergence
        return (state.gain <= enough) | ~finite, optx.RESULTS.where(finite, good, bad)

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: BroydenState, tags: Any,
        result: optx.RESULTS,
    ) -> tuple[Any, Any, dict[str, Any]]:  # fmt: skip
        """The end, and how many steps it took."""
        return y, aux, {"steps": state.steps}


def _jacobian(fn: Any, y: Any, args: Any, options: Any) -> tuple[Array, Array]:
    known = (options or {}).get("jacobian")
    if known is not None:
        residual, jacobian = known(y, args)
        return jnp.asarray(residual), jnp.asarray(jacobian)
    residual, push = jax.linearize(lambda y: fn(y, args)[0], y)
    return residual, jax.vmap(push, out_axes=-1)(jnp.eye(y.size, dtype=y.dtype))


def _state(residual: Array, jacobian: Array, damping: Array, steps: Array) -> BroydenState:
    gradient, hessian = jacobian.T @ residual, jacobian.T @ jacobian
    gain = 0.5 * gradient @ jnp.linalg.solve(hessian, gradient)
    return BroydenState(residual, jacobian, damping, gain, steps)


def figures_of(state: BroydenState) -> Float[Array, " 2"]:
    """Half the squared residual at a state, and the norm of its gradient."""
    residual = state.residual
    return jnp.stack([0.5 * residual @ residual, jnp.linalg.norm(state.jacobian.T @ residual)])
