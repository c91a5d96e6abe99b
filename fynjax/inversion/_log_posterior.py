"""The density that a fit climbs and a sampler explores: data, forward model and prior together."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError, listed
from fynjax.inversion._data import Data
from fynjax.inversion._space import ParameterSpace

Predict = Callable[..., Float[Array, " statistic"]]
"""Statistics from parameters in their own units [free], and whatever else the caller passes on as
`context`; differentiable and traceable.

Derivatives are by reverse mode, a statistic at a time: a plot has more free parameters than
statistics. A forward model that knows a quicker way has a method `jacobian(values_at, u, *context)`
with the statistics and their derivatives by `u`, of which `values_at` makes the values. One that is
an equinox module hands its arrays on as arguments: another of the same shapes compiles nothing."""


def jacobian_by_rows(
    function: Callable[[Array], Array], u: Float[Array, " free"]
) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
    """Value and Jacobian by reverse mode, a statistic at a time."""
    value, backward = jax.vjp(function, u)
    every = jnp.eye(value.size, dtype=value.dtype)
    return value, jax.lax.map(lambda row: backward(row)[0], every, batch_size=1)


class LogPosterior(eqx.Module):
    """Logarithm of the posterior density over whitened coordinates, up to a constant: what samplers
    of any library for JAX explore.

    The prior of a `ParameterSpace` is a unit normal in its whitened coordinates u. Over a
    parameter's own values it is that density over |d value / d u|. A prior stated over values,
    `log_prior`, is carried to u by the same factor.

    Differentiable in u; jit and vmap work.

    >>> import jax
    >>> import jax.numpy as jnp
    >>> from fynjax.inversion import Data, LogPosterior, ParameterSpace
    >>> data = Data(("sum",), jnp.array([1.0]), jnp.array([0.1]))
    >>> space = ParameterSpace(
    ...     ("x", "y"), jnp.zeros(2), jnp.ones(2), jnp.array([0.4, 0.6]), jnp.full(2, 0.1)
    ... )
    >>> log_density = LogPosterior(lambda x: x.sum()[None], space, data)
    >>> start = jnp.zeros(2)  # the prior's medians, as space.physical(start) says
    >>> round(abs(float(log_density(start))), 6), jax.grad(log_density)(start).shape
    (0.0, (2,))
    """

    predict: Predict
    space: ParameterSpace
    data: Data
    offset: Float[ArrayLike, "*statistic"] = 0.0
    """Added to the predicted statistics."""
    context: tuple[Any, ...] = ()
    """Further arguments of `predict`."""
    log_prior: Callable[[Float[Array, " free"]], Array] | None = None
    """Log density of a prior over values in their own units, instead of the space's."""

    def statistics(self, u: Float[Array, " free"]) -> Float[Array, " statistic"]:
        """What the model predicts.

        **Raises:** `InputError` where it predicts another number of statistics than there are data.
        """
        found = jnp.asarray(self.predict(self.space.physical(u), *self.context))
        if jnp.shape(found) != self.data.value.shape:
            raise InputError(
                f"expected the model to give one number for each of the {len(self.data.names)} "
                f"statistics of the data ({listed(self.data.names)}), as an array of shape "
                f"{self.data.value.shape}, but it gives the shape {jnp.shape(found)}"
            )
        return found.astype(u.dtype) + self.offset

    def jacobian(
        self, u: Float[Array, " free"]
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        """What the model predicts, and its derivatives by the whitened coordinates."""
        analytic = getattr(self.predict, "jacobian", None)
        if analytic is None:
            return jacobian_by_rows(self.statistics, u)
        value, slopes = analytic(self.space.physical, u, *self.context)
        return value + self.offset, slopes

    def __call__(self, u: Float[Array, " free"]) -> Float[Array, ""]:
        rest = self.data.whiten(self.statistics(u) - self.data.value)
        if self.log_prior is None:
            prior = -0.5 * u @ u
        else:
            prior = self.log_prior(self.space.physical(u)) + jnp.sum(self.space.log_slope(u))
        return prior - 0.5 * rest @ rest
