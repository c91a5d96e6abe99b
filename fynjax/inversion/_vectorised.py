"""One function at many points, as many at once as the memory holds; and its Jacobian."""

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.memory import free_memory

_MOST = 1024
_SHARE = 0.3
"""Share of the free memory that the values between may take."""


@eqx.filter_jit
def _block(function: Callable[[Array], Array], points: Array) -> Array:
    if len(points) == 1:  # without the cost that vmap adds to loops
        return function(points[0])[None]
    return jax.vmap(function)(points)


def evaluate_many(
    function: Callable[[Array], Array],
    points: Float[np.ndarray, "point free"],
    *,
    batch: int | None = None,
) -> Float[np.ndarray, " point *value"]:
    """`function` at each of `points`, `batch` of them at once; by default what the memory holds.

    A function that is a pytree (an equinox module, `jax.tree_util.Partial`) hands its arrays on as
    arguments and compiles once for all of its structure.
    """
    return np.concatenate([*evaluate_batches(function, points, batch=batch)])


def evaluate_batches(
    function: Callable[[Array], Array],
    points: Float[np.ndarray, "point free"],
    *,
    batch: int | None = None,
) -> Iterator[Float[np.ndarray, " point *value"]]:
    """What `evaluate_many` gives, batch after batch."""
    points = np.asarray(points)
    batch = memory_batch(function, points[0]) if batch is None else batch
    if batch < 1:
        raise InputError(f"`batch` must be at least 1, but is {batch}")
    batch = min(batch, len(points))
    for first in range(0, len(points), batch):
        chunk = points[first : first + batch]
        # The last one is filled up, so that nothing compiles again.
        full = np.concatenate([chunk, np.repeat(chunk[-1:], batch - len(chunk), axis=0)])
        yield np.asarray(_block(function, jnp.asarray(full)))[: len(chunk)]


def memory_batch(function: Callable[[Array], Array], point: Float[np.ndarray, " free"]) -> int:
    """How many evaluations of `function` fit into the memory together, from 1 to 1024."""
    block: Any = _block  # an object of equinox, whose type says no more than a function's
    compiled = block.lower(function, jnp.asarray(point)[None]).compile().compiled
    analysis = compiled.memory_analysis()
    if analysis is None:
        return 1
    each = analysis.temp_size_in_bytes + analysis.output_size_in_bytes
    return int(np.clip(_SHARE * _free_memory() / max(each, 1), 1, _MOST))


def _free_memory() -> float:
    """Free memory of the device [bytes]."""
    known = jax.local_devices()[0].memory_stats()
    if known and "bytes_limit" in known:
        return known["bytes_limit"] - known.get("bytes_in_use", 0)
    return float(free_memory())


def value_and_jacobian(
    function: Callable[[Array], Any], at: Float[Array, " free"], *, mode: str = "auto"
) -> tuple[Float[Array, "*value"], Float[Array, "*value free"]]:
    """The value and the Jacobian of a `function` at `at`, row by row or column by column: little
    memory.

    `mode` is "forward", a run for each parameter; "reverse", two or three runs for each value; or
    "auto", the one of fewer runs. Values of more or fewer axes than one need "forward".
    """
    if mode not in ("auto", "forward", "reverse"):
        raise InputError(f"`mode` must be 'auto', 'forward' or 'reverse', but is {mode!r}")
    size = jax.eval_shape(function, at).size
    if mode == "forward" or (mode == "auto" and at.size <= 2 * size):
        value, push = jax.linearize(function, at)
        columns = jax.lax.map(push, jnp.eye(at.size, dtype=at.dtype))
        return value, jnp.moveaxis(columns, 0, -1)
    value, pull = jax.vjp(function, at)
    rows = jax.lax.map(lambda row: pull(row)[0], jnp.eye(size, dtype=value.dtype))
    return value, rows
