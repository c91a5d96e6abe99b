"""Guarded functions: right values and right slopes where the plain formula divides by zero."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError


def real_array(value: Any, name: str = "") -> Array:
    """As a real array: floating arrays keep their precision, all else takes the default.

    A Python number stays weakly typed, so that it does not lift float32 arrays to float64.

    **Raises:** `InputError`, naming the field `name` if it is given, for what is no number.
    """
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"expected {f'{name} as ' if name else ''}a number or an array of numbers, but got "
            f"{value!r:.60}: is it text, or missing?"
        ) from error
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array * 1.0


def square_root(square: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Square root with the slope 0 at 0, where that of the plain one is infinite; NaN of NaN."""
    some = ~(square == 0.0)  # true for NaN, which must show
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)


def symmetric_power(
    matrix: Float[np.ndarray, "n n"], power: float = 0.5
) -> Float[np.ndarray, "n n"]:
    """A power, such as the root, of a symmetric matrix without negative eigenvalues: symmetric
    itself, so that no coordinate comes before another, as in a Cholesky factor. It need not have
    full rank if the power is positive; eigenvalues that rounding made negative count as 0."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0) ** power) @ vectors.T)


def mean_transmittance(depth: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Transmittance averaged along a path of optical depth `depth`, (1 - exp(-x)) / x [-].

    Negative depths are allowed as far as exp(-x) is finite. Differentiable everywhere to any order;
    value 1 and slope -1/2 at 0.
    """
    small = jnp.abs(depth) < 0.05
    safe = jnp.where(small, 1.0, depth)  # the branch not taken must be finite too
    series = 1.0 + depth * (-1 / 2 + depth * (1 / 6 + depth * (-1 / 24 + depth / 120)))
    return jnp.where(small, series, -jnp.expm1(-safe) / safe)


def transmittance_beyond(
    before: Float[Array, "*shape"], depth: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """Transmittance averaged along a path of optical depth `depth` that begins at the depth
    `before`, exp(-b) (1 - exp(-x)) / x [-].

    A path that leaves a shadow has a negative depth, down to -`before`: nothing overflows, however
    deep that is. Differentiable everywhere to any order.
    """
    rises = depth < 0.0  # by `where`, whose slopes are right at 0: of empty voxels
    deepest = before + jnp.where(rises, depth, 0.0)
    return jnp.exp(-deepest) * mean_transmittance(jnp.where(rises, -depth, depth))


def mean_emission(depth: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Share of a path's uniform emission that stays in it, (x - 1 + exp(-x)) / x² [-].

    This is the mean intensity, along a path of optical depth `depth`, of light emitted at unit
    rate over the whole path. Differentiable on [0, inf); value 1/2 and slope -1/6 at 0.
    """
    small = jnp.abs(depth) < 0.2
    safe = jnp.where(small, 1.0, depth)
    series = 1 / 2 + depth * (
        -1 / 6 + depth * (1 / 24 + depth * (-1 / 120 + depth * (1 / 720 - depth / 5040)))
    )
    return jnp.where(small, series, (1.0 + jnp.expm1(-safe) / safe) / safe)
