"""Absorption of the elementary leaf layer at a fixed cost, with exact derivatives.

The transmissivity of an isotropically lit absorbing layer is
theta(k) = (1 - k) exp(-k) + k^2 E1(k) (Allen et al. 1969; Jacquemoud & Baret 1990, eq. 15). The
exponential integral E1 costs more than all the rest of PROSPECT, so what is evaluated here is a
table of the absorptance 1 - theta over v = sqrt(k / (1 + k)), interpolated by cubics that carry
the exact values and slopes at the nodes. In v the logarithm at k = 0 is v^4 log v, mild enough for
an absolute error below 1e-13 with 2048 cells. The absorptance is stored instead of theta because
its relative accuracy near k = 0 is what the nearly transparent near infrared needs.

The derivatives do not come from the table's cubics: d(1 - theta)/dk = 2 exp(-k) - 2 k E1(k), and
d2(1 - theta)/dk2 = -2 E1(k), where E1(k) + exp(-k) log(k) is smooth and is tabulated separately.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import exp1

_CELLS = 4096
_SMALLEST_LOG_ARGUMENT = 1e-30
_EULER_GAMMA = 0.5772156649015329


def _cubics(values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Coefficients [4, cell] in the coordinate 0..1 within the cell from node values and slopes."""
    left, right = values[:-1], values[1:]
    left_slope, right_slope = slopes[:-1] / _CELLS, slopes[1:] / _CELLS
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
def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Cubics of 1 - theta and of E1 + exp(-k) log k over v = sqrt(k / (1 + k))."""
    v = np.linspace(0.0, 1.0, _CELLS + 1)
    inner = v[1:-1]
    k = inner**2 / (1.0 - inner**2)
    k_slope = 2.0 * inner / (1.0 - inner**2) ** 2
    integral, decay = exp1(k), np.exp(-k)
    absorbed = -np.expm1(-k) + k * decay - k**2 * integral
    absorbed_slope = (2.0 * decay - 2.0 * k * integral) * k_slope
    smooth = integral + decay * np.log(k)
    smooth_slope = -decay * np.log(k) * k_slope

    def ends(array: np.ndarray, first: float, last: float) -> np.ndarray:
        return np.concatenate([[first], array, [last]])

    return (
        _cubics(ends(absorbed, 0.0, 1.0), ends(absorbed_slope, 0.0, 0.0)),
        _cubics(ends(smooth, -_EULER_GAMMA, 0.0), ends(smooth_slope, 0.0, 0.0)),
    )


def _interpolate(table: np.ndarray, k: Array) -> Array:
    """Value of a table at k; a negative k counts as 0, infinity as the last node."""
    coefficients = jnp.asarray(table, k.dtype)
    k = jnp.clip(k, 0.0, 1e6)
    position = jnp.sqrt(k / (1.0 + k)) * _CELLS
    cell = jnp.clip(position.astype(jnp.int32), 0, _CELLS - 1)
    offset = position - cell.astype(k.dtype)
    c0, c1, c2, c3 = (row.at[cell].get(mode="promise_in_bounds") for row in coefficients)
    return c0 + offset * (c1 + offset * (c2 + offset * c3))


@jax.custom_jvp
def exponential_integral(k: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Exponential integral E1(k) [-] at a fixed cost, absolute error below 1e-8.

    Used in second derivatives of `layer_absorptance` only.

    **Arguments:** `k` >= 0 [-], of any shape; a negative value counts as 0.

    **Returns:** E1(k), of the shape and dtype of `k`. E1 is infinite at 0: below 1e-30
    the value at 1e-30 (68.5) is returned, so that curvatures at zero absorption are finite.
    Differentiable, dE1/dk = -exp(-k) / k.
    """
    guarded = jnp.maximum(k, _SMALLEST_LOG_ARGUMENT)
    return _interpolate(_tables()[1], guarded) - jnp.exp(-guarded) * jnp.log(guarded)


@exponential_integral.defjvp
def _exponential_integral_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (k,), (dk,) = primals, tangents
    guarded = jnp.maximum(k, _SMALLEST_LOG_ARGUMENT)
    slope = jnp.where(k < _SMALLEST_LOG_ARGUMENT, 0.0, -jnp.exp(-guarded) / guarded)
    return exponential_integral(k), slope * dk


@jax.custom_jvp
def _absorptance_slope(k: Array) -> Array:
    """d(1 - theta)/dk = 2 exp(-k) - 2 k E1(k); 2 at k = 0."""
    positive = jnp.clip(k, 0.0, 1e6)
    return 2.0 * jnp.exp(-positive) - 2.0 * positive * exponential_integral(positive)


@_absorptance_slope.defjvp
def _absorptance_slope_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (k,), (dk,) = primals, tangents
    return _absorptance_slope(k), -2.0 * exponential_integral(k) * dk


@jax.custom_jvp
def layer_absorptance(k: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """1 - theta(k): what an elementary layer of absorption coefficient k absorbs [-].

    **Arguments:**

    - `k`: absorption coefficient of the layer, k >= 0 [-]; a negative value counts as 0.

    **Returns:** 1 - (1 - k) exp(-k) - k^2 E1(k), in [0, 1], of the shape and dtype of `k`; absolute
    error below 1e-12 in float64, relative error at small k that of the arithmetic.

    Differentiable to any order. The slope at 0 is 2; the second derivative -2 E1(k) is infinite
    there and is cut off at its value for k = 1e-30 (-137).
    """
    return _interpolate(_tables()[0], k)


@layer_absorptance.defjvp
def _layer_absorptance_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (k,), (dk,) = primals, tangents
    return layer_absorptance(k), _absorptance_slope(k) * dk
