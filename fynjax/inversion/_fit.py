"""Fit parameters to statistics with a prior, and say how far the data pinned them down.

The objective is half the squared whitened misfit of the statistics plus half the squared
distance from the prior, also whitened: the negative log posterior, but for a constant.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.inversion._space import ParameterSpace

Predict = Callable[[Float[Array, " free"]], Float[Array, " statistic"]]
"""Statistics from parameters in their own units; differentiable and traceable."""


class Data(eqx.Module):
    """What was measured."""

    names: tuple[str, ...] = eqx.field(static=True)
    value: Float[Array, " statistic"]
    sd: Float[Array, " statistic"]
    """Standard deviation, model error included, of each statistic."""

    def __check_init__(self) -> None:
        bad = ~(np.isfinite(np.asarray(self.value)) & (np.asarray(self.sd) > 0))
        if bad.any():
            name = self.names[int(np.argmax(bad))]
            raise InputError(f"the target {name} must be finite and have a positive sd")


class FitResult(eqx.Module):
    """What a fit found, and how far to trust it."""

    space: ParameterSpace
    data: Data
    whitened: Float[Array, " free"]
    """The estimate in whitened coordinates."""
    estimate: Float[Array, " free"]
    """The estimate in the parameters' own units."""
    sd: Float[Array, " free"]
    """Its standard deviation (Laplace approximation), own units."""
    constrained: Float[Array, " free"]
    """1 - posterior over prior variance [-]: 0, the data say nothing; 1, they say all."""
    covariance: Float[Array, "free free"]
    """Posterior covariance in whitened coordinates, where the prior's is one."""
    predicted: Float[Array, " statistic"]
    """Statistics at the estimate."""
    information: Float[Array, " mode"]
    """Eigenvalues of the data's Fisher information in prior units, largest first: a direction
    with less than one is known from the prior rather than from the data."""
    modes: Float[Array, "mode free"]
    """Their eigenvectors in whitened coordinates."""
    loss: Float[np.ndarray, " evaluation"]
    """The objective at each evaluation, falling or not."""
    gradient_norm: Float[np.ndarray, " evaluation"]
    converged: bool = eqx.field(static=True)
    status: str = eqx.field(static=True)
    """Why the fit stopped, in words."""

    @property
    def names(self) -> tuple[str, ...]:
        return self.space.names

    def seen(self, least: float = 0.5) -> tuple[str, ...]:
        """Parameters whose variance the data cut by the share `least` or more."""
        return tuple(n for n, c in zip(self.names, np.asarray(self.constrained)) if c >= least)

    def unseen_directions(self, count: int = 3) -> list[dict[str, float]]:
        """The combinations of parameters that the data say least about, main members only."""
        found = []
        for mode in np.asarray(self.modes)[::-1][:count]:
            largest = np.argsort(-np.abs(mode))[:4]
            found.append({self.names[i]: float(mode[i]) for i in largest})
        return found


def fit(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    *,
    method: str = "lbfgsb",
    max_steps: int = 60,
    tolerance: float = 1e-3,
    start: Float[Array, " free"] | None = None,
    offset: Float[Array, " statistic"] | None = None,
    report: Callable[[float, float], None] | None = None,
    pull: "Pullback | None" = None,
    uncertainty: bool = True,
) -> FitResult:
    """Find the most probable parameters.

    **Arguments:**

    - `predict`: the forward model.
    - `data`, `space`: statistics with their errors; free parameters with their priors.
    - `method`: "lbfgsb", quasi-Newton by jaxopt, one gradient a step: for a forward model that
      takes seconds; or "least_squares", Levenberg-Marquardt by optimistix, which needs the
      Jacobian at each step and fewer steps: for a cheap one.
    - `max_steps`, `tolerance`: most steps, and the gradient norm (in whitened coordinates) or,
      for least squares, the relative step, at which it has converged.
    - `start`: whitened coordinates to start from; the prior's centre by default.
    - `offset`: added to the predicted statistics: what a cheap forward model lacks.
    - `report`: called with the objective and the norm of its gradient at each evaluation.
    - `pull`: the compiled forward and reverse model of an earlier call, to be used again.
    - `uncertainty`: whether to compute the Jacobian at the estimate; without it the standard
      deviations and modes are NaN.

    A stop without convergence, and a loss that is not finite, are stated in the result, not
    raised.
    """
    pull = Pullback(predict, space) if pull is None else pull
    shift = jnp.zeros_like(data.value) if offset is None else offset
    u = jnp.zeros(len(space.names)) if start is None else jnp.asarray(start, float)
    history: list[tuple[float, float]] = []

    def note(loss: float, norm: float) -> None:
        history.append((loss, norm))
        if report is not None:
            report(loss, norm)

    if method == "lbfgsb":
        u, status, converged = _quasi_newton(pull, data, shift, u, max_steps, tolerance, note)
    elif method == "least_squares":
        u, status, converged = _least_squares(
            predict, data, space, shift, u, max_steps, tolerance, note
        )
    else:
        raise InputError(f"`method` must be 'lbfgsb' or 'least_squares', but is {method!r}")
    predicted = pull.forward(u) + shift
    size = len(space.names)
    if uncertainty:
        jacobian = pull.jacobian(u) / data.sd[:, None]
        information, vectors = jnp.linalg.eigh(jacobian.T @ jacobian)
        information, vectors = information[::-1], vectors[:, ::-1]
        covariance = (vectors / (1.0 + jnp.maximum(information, 0.0))) @ vectors.T
    else:
        information, vectors = jnp.full(size, jnp.nan), jnp.full((size, size), jnp.nan)
        covariance = jnp.full((size, size), jnp.nan)
    variance = jnp.diagonal(covariance)
    losses, norms = np.asarray(history, float).reshape(-1, 2).T
    if not np.all(np.isfinite(np.asarray(predicted))):
        status, converged = "A predicted statistic is not finite; the estimate is of no use.", False
    return FitResult(
        space=space,
        data=data,
        whitened=u,
        estimate=space.physical(u),
        sd=jnp.sqrt(variance) * space.slope(u),
        constrained=1.0 - variance,
        covariance=covariance,
        predicted=predicted,
        information=information,
        modes=vectors.T,
        loss=losses,
        gradient_norm=norms,
        converged=converged,
        status=status,
    )


class Pullback:
    """A forward model compiled once for values, gradients and rows of the Jacobian.

    The cotangent is (statistics - target) * weight + extra: with the errors as weight it gives
    the gradient of the misfit, with no weight and a unit vector a row of the Jacobian. So one
    compiled program, whose memory is that of one reverse pass, serves for both.
    """

    def __init__(self, predict: Predict, space: ParameterSpace) -> None:
        def run(u: Array, target: Array, weight: Array, extra: Array) -> tuple[Array, Array]:
            value, backward = jax.vjp(lambda v: predict(space.physical(v)), u)
            (gradient,) = backward(((value - target) * weight + extra).astype(value.dtype))
            return value.astype(u.dtype), gradient

        self._run = jax.jit(run)
        self._forward = jax.jit(lambda u: predict(space.physical(u)).astype(u.dtype))

    def forward(self, u: Float[Array, " free"]) -> Float[Array, " statistic"]:
        return self._forward(u)

    def misfit(self, u: Array, data: Data, offset: Array) -> tuple[float, Array]:
        """The objective and its gradient."""
        weight = data.sd**-2
        value, gradient = self._run(u, data.value - offset, weight, jnp.zeros_like(data.value))
        rest = (value + offset - data.value) / data.sd
        return float(0.5 * (rest @ rest + u @ u)), gradient + u

    def jacobian(self, u: Float[Array, " free"]) -> Float[Array, "statistic free"]:
        """Rows by reverse mode, one after another."""
        size = self.forward(u).shape[0]
        none = jnp.zeros(size)
        rows = [self._run(u, none, none, none.at[i].set(1.0))[1] for i in range(size)]
        return jnp.stack(rows)


def _quasi_newton(
    pull: Pullback,
    data: Data,
    offset: Array,
    start: Array,
    max_steps: int,
    tolerance: float,
    note: Callable[[float, float], None],
) -> tuple[Array, str, bool]:
    import jaxopt  # late: it warns on import that it is no longer maintained

    def objective(u: Array) -> tuple[float, Array]:
        loss, gradient = pull.misfit(jnp.asarray(u), data, offset)
        note(loss, float(jnp.linalg.norm(gradient)))
        return loss, gradient

    # Four prior widths either way: beyond, the bounded transform is flat.
    reach = jnp.full_like(start, 4.0)
    solver = jaxopt.ScipyBoundedMinimize(
        fun=objective,
        method="l-bfgs-b",
        value_and_grad=True,
        jit=False,
        maxiter=max_steps,
        tol=tolerance,
        options={"maxcor": 20, "maxfun": 2 * max_steps, "gtol": tolerance, "ftol": 1e-5},
    )
    parameters, state = solver.run(start, (-reach, reach))
    loss, gradient = pull.misfit(jnp.asarray(parameters), data, offset)
    norm = float(jnp.linalg.norm(gradient))
    if not np.isfinite(loss):
        return start, "The objective is not finite; the estimate is the start.", False
    if bool(state.success):
        return jnp.asarray(parameters), f"Converged: gradient norm {norm:.2g}.", True
    status = f"Stopped after {int(state.iter_num)} steps, gradient norm {norm:.2g}."
    return jnp.asarray(parameters), status, False


def _least_squares(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    offset: Array,
    start: Array,
    max_steps: int,
    tolerance: float,
    note: Callable[[float, float], None],
) -> tuple[Array, str, bool]:
    def residual(u: Array, _: None) -> Array:
        rest = (predict(space.physical(u)) + offset - data.value) / data.sd
        return jnp.concatenate([rest, u])

    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    solution = optx.least_squares(residual, solver, start, max_steps=max_steps, throw=False)
    rest = residual(solution.value, None)
    gradient = jax.grad(lambda u: 0.5 * jnp.sum(residual(u, None) ** 2))(solution.value)
    note(float(0.5 * rest @ rest), float(jnp.linalg.norm(gradient)))
    converged = bool(solution.result == optx.RESULTS.successful)
    steps = int(solution.stats["num_steps"])
    status = f"Converged in {steps} steps." if converged else str(optx.RESULTS[solution.result])
    return solution.value, status, converged
