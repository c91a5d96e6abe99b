"""Which numbers have 64 bits and which have 32: the rule, in one place.

JAX makes float32 of everything unless its user sets `jax_enable_x64`. No import and no function of
fynjax sets it, and none leaves it changed.

- What computes forward (`prospect`, `Scene`, `observe`, and all of `fynjax.canopy`,
  `fynjax.radiation`, `fynjax.sensors`, `fynjax.metrics` and `fynjax.diversity`) takes the precision
  of its arrays, light that of the scene, which is float32 (`build_scene` takes another `dtype`).
- What would lose small differences of large numbers (fits, posteriors, populations, planting, a
  camera's radiometry) and the functions of `fynjax.app.jobs` and `fynjax.studies` compute in 64
  bits whatever the process has: they enter `jax.enable_x64(True)` and leave it
  (`double_precision`). In a process of 32 bits their float64 arrays come back as NumPy arrays. JAX
  would cut its own down to float32 wherever they meet others, with a warning; NumPy's keep their
  digits and become float32 only as an argument of JAX.
- A scene and the parameters of a plot are drawn in 64 bits, so that the same seed gives the same
  stand, and come back in the precision of the process (`drawn_in_double`).

A function that enters 64 bits may be called inside `jax.jit`, `jax.vmap` and `jax.jacfwd` of 32
bits; its traced results then are float64. Not inside `jax.grad`: what reverse mode leaves until
later would be computed in 32 bits. `with jax.enable_x64(True):` around the gradient serves.

JAX (0.10) keeps what it made of a NumPy array in one precision as long as a compiled function holds
it, and takes it for the same array in the other: it then has the digits of float32, or nothing
compiles. So constants of modules enter JAX by `jnp.asarray(constant, dtype)`, which makes an array
of its own; arrays of records that come from a process of 32 bits are copied; and a function that
its user hands over, such as the model of a fit, computes in 32 bits as it does outside.
"""

import contextlib
import copy
import dataclasses
import functools
import inspect
from collections.abc import Callable, Generator, Iterator
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")


_entered: ContextVar[bool] = ContextVar("_entered", default=False)


def compiled_in_single() -> bool:
    """Whether this runs in 64 bits inside a `jax.jit` of a process of 32: linear solves of lineax
    do not compile there."""
    return _entered.get() and isinstance(jnp.zeros(()), jax.core.Tracer)


def double_precision(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function compute in 64 bits; where the process has 32, its arrays of 64 bits come back
    as NumPy arrays. A generator computes each of its items so; between them the caller has the
    precision of the process."""
    in_64_bits = _in_64_bits(function, np.asarray)
    if not inspect.isgeneratorfunction(function):
        return in_64_bits

    @functools.wraps(function)
    def item_by_item(*args: P.args, **kwargs: P.kwargs) -> Iterator[Any]:
        made = cast(Generator[Any, None, None], in_64_bits(*args, **kwargs))
        with contextlib.closing(made) as items:
            while (item := _following(items)) is not _END:
                yield item

    return cast(Callable[P, R], item_by_item)


def drawn_in_double(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function that draws a scene compute in 64 bits; its arrays come back in the precision
    of the process.

    **Raises:** `InputError` where a `dtype` of float64 is asked for in a process of 32 bits.
    """
    in_64_bits = _in_64_bits(function, lambda array: jnp.asarray(np.asarray(array)))

    @functools.wraps(function)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        if kwargs.get("dtype") == "float64" and not jax.config.read("jax_enable_x64"):
            raise InputError(
                'a scene in float64 needs JAX in 64 bits: call jax.config.update("jax_enable_x64", '
                "True) first, or leave out `dtype`"
            )
        return in_64_bits(*args, **kwargs)

    return drawn


def _in_64_bits(function: Callable[P, R], change: Callable[[jax.Array], Any]) -> Callable[P, R]:
    """A function that computes in 64 bits; where the process has 32, `change` is made to each of
    its arrays of 64 bits."""

    @functools.wraps(function)
    def in_64_bits(*args: P.args, **kwargs: P.kwargs) -> R:
        if jax.config.read("jax_enable_x64"):
            return function(*args, **kwargs)
        token = _entered.set(True)
        try:
            with jax.enable_x64(True):
                found = function(*map(_afresh, args), **{k: _afresh(v) for k, v in kwargs.items()})
        finally:
            _entered.reset(token)
        return found if inspect.isgenerator(found) else _each(change, found)

    return in_64_bits


_END = object()


@double_precision
def _following(items: Iterator[Any]) -> Any:
    """The next item, or `_END`."""
    return next(items, _END)


def in_double(values: ArrayLike) -> Any:
    """`values` in float64: as a JAX array where JAX has 64 bits, else as a NumPy array."""
    array = np.asarray(values, float)
    return jnp.asarray(array) if jax.config.read("jax_enable_x64") else array


def _each(change: Callable[[jax.Array], Any], tree: Any) -> Any:
    """`tree` with its concrete JAX arrays of 64 bits changed, also in dataclasses."""

    def leaf(value: Any) -> Any:
        if isinstance(value, jax.Array):
            known = not isinstance(value, jax.core.Tracer) and value.dtype in _WIDE
            return change(value) if known else value
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            changed = copy.copy(value)
            for field in dataclasses.fields(value):
                object.__setattr__(changed, field.name, _each(change, getattr(value, field.name)))
            return changed
        return value

    return jax.tree.map(leaf, tree)


_WIDE = (np.float64, np.int64, np.uint64)


def _afresh(argument: Any) -> Any:
    """What comes from a process of 32 bits, for one of 64: see the module's last words."""
    own = hasattr(argument, "__wrapped__") or not isinstance(argument, type | eqx.Module)
    if callable(argument) and own:
        return _InOwnPrecision(argument)
    if not isinstance(argument, eqx.Module | tuple | list):
        return argument
    return jax.tree.map(lambda a: a.copy() if isinstance(a, np.ndarray) else a, argument)


@dataclasses.dataclass(frozen=True)
class _InOwnPrecision:
    """A function of the user's, which computes in 32 bits here as it does there."""

    function: Callable[..., Any]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        with jax.enable_x64(False):
            args, kwargs = jax.tree.map(_narrowed, (args, kwargs))
            return self.function(*args, **kwargs)


def _narrowed(value: Any) -> Any:
    if isinstance(value, jax.Array) and value.dtype in _WIDE:
        return value.astype(jax.dtypes.canonicalize_dtype(value.dtype))
    return value
