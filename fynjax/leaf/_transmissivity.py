"""Absorption of the elementary leaf layer at a fixed cost, with exact derivatives.

The transmissivity of an isotropically lit absorbing layer is
theta(k) = (1 - k) exp(-k) + k^2 E1(k) (Allen et al. 1969; Jacquemoud & Baret 1990, eq. 15). The
exponential integral E1 costs more than all the rest of PROSPECT, so what is evaluated here are
tables, interpolated by cubics that carry the exact values and slopes at the nodes:

- the absorptance 1 - theta, not theta, because its relative accuracy near k = 0 is what the nearly
  transparent near infrared needs; as the factor of k / (1 + k), which has a limit at k = 0;
- its slope d(1 - theta)/dk = 2 exp(-k) - 2 k E1(k), times 1 + k;
- for the second derivative -2 E1(k), the smooth E1(k) + exp(-k) log(k).

They run over u = (k / (1 + k))^(1/4), in which even k log k is u^4 log u, mild enough at k = 0 for
absolute errors below 1e-13 with 8192 cells. Absorptance and slope thus end with a division by
1 + k, and XLA on processors stores quotients, where it would compute products again in every loop
that reads them: PROSPECT takes two thirds of the time.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import exp1

_CELLS = 8192
_SMALLEST_LOG_ARGUMENT = 1e-30
_EULER_GAMMA = 0.5772156649015329


def _cubics(values: np.ndarray, slopes: np.ndarray, first: tuple, last: tuple) -> np.ndarray:
    """Coefficients [4, cell] in the coordinate 0..1 within the cell from the values and slopes at
    the inner nodes, and (value, slope) at the first and last node."""
    value, slope = (
        np.concatenate([[first[i]], array, [last[i]]]) for i, array in enumerate((values, slopes))
    )
    left, right = value[:-1], value[1:]
    left_slope, right_slope = slope[:-1] / _CELLS, slope[1:] / _CELLS
    jump = right - left
    return np.stack(
        [
            left,
            left_slope,
            3 * jump - 2 * left_slope - right_slope,
            left_slope + right_slope - 2 * jump,
        ]
    )


@cache
def _tables() -> dict[str, np.ndarray]:
    """Cubics over u of (1 - theta) (1 + k) / k, (1 + k) d(1 - theta)/dk, and E1 + exp(-k) log k."""
    u = np.linspace(0.0, 1.0, _CELLS + 1)[1:-1]
    k = u**4 / (1.0 - u**4)
    by_u = 4.0 * u**3 / (1.0 - u**4) ** 2
    integral, decay = exp1(k), np.exp(-k)
    absorbed = -np.expm1(-k) + k * decay - k**2 * integral
    slope = 2.0 * decay - 2.0 * k * integral
    share, share_by_u = absorbed / u**4, slope * by_u / u**4 - 4.0 * absorbed / u**5
    smooth, smooth_by_u = integral + decay * np.log(k), -decay * np.log(k) * by_u
    grown, grown_by_u = slope * (1.0 + k), (slope - 2.0 * integral * (1.0 + k)) * by_u
    return {
        "absorptance": _cubics(share, share_by_u, (2.0, 0.0), (1.0, -4.0)),
        "slope": _cubics(grown, grown_by_u, (2.0, 0.0), (0.0, 0.0)),
        "integral": _cubics(smooth, smooth_by_u, (-_EULER_GAMMA, 0.0), (0.0, 0.0)),
    }


def _interpolate(name: str, k: Array) -> Array:
    """Value of a table at k."""
    position = jnp.sqrt(jnp.sqrt(k / (1.0 + k))) * _CELLS
    cell = jnp.clip(position.astype(jnp.int32), 0, _CELLS - 1)
    offset = position - cell.astype(k.dtype)
    coefficients = jnp.asarray(_tables()[name], k.dtype)
    c0, c1, c2, c3 = (row.at[cell].get(mode="promise_in_bounds") for row in coefficients)
    return c0 + offset * (c1 + offset * (c2 + offset * c3))


def _within(k: Array | float) -> Array:
    """A negative k counts as 0, infinity as a large number."""
    return jnp.clip(k, 0.0, 1e6)


@jax.custom_jvp
def exponential_integral(k: float | Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Exponential integral E1(k) [-] at a fixed cost, absolute error below 1e-12.

    Used in second derivatives of `layer_absorptance` only.

    **Arguments:** `k` >= 0 [-], of any shape; a negative value counts as 0.

    **Returns:** E1(k), of the shape and dtype of `k`. E1 is infinite at 0: below 1e-30
    the value at 1e-30 (68.5) is returned, so that curvatures at zero absorption are finite.
    Differentiable, dE1/dk = -exp(-k) / k.
    """
    guarded = jnp.clip(k, _SMALLEST_LOG_ARGUMENT, 1e6)
    return _interpolate("integral", guarded) - jnp.exp(-guarded) * jnp.log(guarded)


@exponential_integral.defjvp
def _exponential_integral_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (k,), (dk,) = primals, tangents
    guarded = jnp.maximum(k, _SMALLEST_LOG_ARGUMENT)
    slope = jnp.where(k < _SMALLEST_LOG_ARGUMENT, 0.0, -jnp.exp(-guarded) / guarded)
    return exponential_integral(k), slope * dk


@jax.custom_jvp
def _slope_numerator(k: Array | float) -> Array:
    """(1 + k) d(1 - theta)/dk."""
    return _interpolate("slope", _within(k))


@_slope_numerator.defjvp
def _slope_numerator_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (k,), (dk,) = primals, tangents
    numerator, denominator = absorptance_slope(k)
    slope = numerator / denominator - 2.0 * (1.0 + _within(k)) * exponential_integral(k)
    return numerator, slope * dk


def absorptance_slope(k: Array | float) -> tuple[Array, Array]:
    """d(1 - theta)/dk as numerator and denominator; 2 and 1 at k = 0."""
    return _slope_numerator(k), 1.0 + jnp.where(k < 0.0, 0.0, k)


@jax.custom_jvp
def layer_absorptance(k: float | Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """1 - theta(k): what an elementary layer of absorption coefficient k absorbs [-].

    **Arguments:**

    - `k`: absorption coefficient of the layer, k >= 0 [-]; a negative value counts as 0.

    **Returns:** 1 - (1 - k) exp(-k) - k^2 E1(k), in [0, 1] to rounding, of the shape and dtype of
    `k`; absolute error below 1e-13 in float64, relative error at small k that of the arithmetic.

    Differentiable to any order. The slope at 0 is 2; the second derivative -2 E1(k) is infinite
    there and is cut off at its value for k = 1e-30 (-137).
    """
    k = _within(k)
    return _interpolate("absorptance", k) * k / (1.0 + k)


@layer_absorptance.defjvp
def _layer_absorptance_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (k,), (dk,) = primals, tangents
    numerator, denominator = absorptance_slope(k)
    return layer_absorptance(k), numerator * dk / denominator
