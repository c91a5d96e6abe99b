"""A polynomial in place of a costly function of a few numbers."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.seeds import generator


class Emulated(eqx.Module):
    """A polynomial of second degree that stands in for a costly function; `emulate` makes one."""

    centre: Float[np.ndarray, " free"]
    """Middle of the range in which it stands in for the function."""
    scale: Float[np.ndarray, " free"]
    """Half the width of that range."""
    coefficients: Float[np.ndarray, "term output"]
    """Coefficients of the constant, the coordinates and their products; the range is -1 to 1."""
    error: Float[np.ndarray, " output"]
    """Root mean square error at points that were left out of its fit."""

    def __call__(self, values: Float[Array, " free"]) -> Float[Array, " output"]:
        """The function's value; differentiable; jit and vmap work."""
        unit = (jnp.asarray(values) - self.centre) / self.scale
        return _terms(unit) @ jnp.asarray(self.coefficients)


def _terms(unit: Float[Array, "*point free"]) -> Float[Array, "*point term"]:
    first, second = np.triu_indices(unit.shape[-1])
    one = jnp.ones((*unit.shape[:-1], 1))
    return jnp.concatenate([one, unit, unit[..., first] * unit[..., second]], axis=-1)


@double_precision
def emulate(
    function: Callable[[Float[Array, " free"]], Float[Array, " output"]],
    lower: Any,
    upper: Any,
    *,
    points: int | None = None,
    seed: int = 0,
) -> Emulated:
    """A polynomial of second degree in place of a costly function of a few numbers.

    **Arguments:**

    - `function`: of an array [free], such as of a cover and a leaf area; gives an array [output].
    - `lower`, `upper`: ends of the range in which it is needed [free].
    - `points`: where the function is evaluated, in a Sobol sequence; three times the terms of the
      polynomial by default. A fifth of them are left out, to say its error.
    - `seed`: of the sequence.

    **Returns:** `Emulated`, differentiable. Outside the range it is a guess.

    **Raises:** `InputError` for bounds that are no ranges, too few points, and values that are not
    finite.

    >>> import jax.numpy as jnp
    >>> import fynjax as fx
    >>> quick = fx.emulate(lambda x: jnp.array([x[0] * x[1]]), [0.0, 0.0], [1.0, 2.0])
    >>> quick(jnp.array([0.5, 1.0])).round(3).tolist()
    [0.5]
    """
    from scipy.stats import qmc  # late: it takes half of the package's import time

    low, high = np.atleast_1d(np.asarray(lower, float)), np.atleast_1d(np.asarray(upper, float))
    if low.shape != high.shape or low.ndim != 1 or not (high > low).all():
        raise InputError(f"expected `lower` below `upper`, but got {lower} and {upper}")
    terms = _terms(jnp.zeros(low.size)).size
    count = 3 * terms if points is None else points
    if count < 1.25 * terms + 2:
        raise InputError(f"expected at least {int(np.ceil(1.25 * terms)) + 2} points, got {count}")
    # Whole powers of two keep a Sobol sequence even; the first of them are taken.
    sequence = qmc.Sobol(low.size, rng=generator(seed))
    unit = 2.0 * sequence.random(1 << (count - 1).bit_length())[:count] - 1.0
    centre, scale = 0.5 * (low + high), 0.5 * (high - low)
    found = np.stack(
        [np.ravel(function(jnp.asarray(centre + scale * u))) for u in track(unit, "Emulate")]
    )
    if not np.isfinite(found).all():
        at = centre + scale * unit[int(np.argmin(np.isfinite(found).all(axis=1)))]
        raise InputError(f"the function is not finite at {at.tolist()}")
    rows = np.asarray(_terms(jnp.asarray(unit)))
    # Each fifth point is left out, for the error; the polynomial that is used has them all.
    kept = np.arange(count) % 5 != 0
    partial = np.linalg.lstsq(rows[kept], found[kept])[0]
    error = np.sqrt(np.mean((rows[~kept] @ partial - found[~kept]) ** 2, axis=0))
    whole = np.linalg.lstsq(rows, found)[0]
    return Emulated(centre, scale, whole, error)
