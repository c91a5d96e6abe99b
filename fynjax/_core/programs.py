"""Programs that JAX compiles of functions of large records."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax

from fynjax._core.errors import InputError

_F = TypeVar("_F", bound=Callable[..., Any])


def as_one(function: _F, *, inline: bool = True) -> _F:
    """The function compiled as one program where it is called alone, and not each of its operations
    as its own: a sixth of the time. Where another program calls it, its arguments are kept from the
    compiler's constant folding (`unfolded`).

    **Arguments:** `function`; `inline`, False where its derivative is to be a program as well.
    """

    @functools.wraps(function)
    def one(*args: Any, **kwargs: Any) -> Any:
        args, kwargs = unfolded((args, kwargs))
        return function(*args, **kwargs)

    return eqx.filter_jit(one, inline=inline)  # type: ignore[call-overload]


def concrete(*values: Any) -> bool:
    """Whether all values are known, that is outside a transformation."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))


def check_known(**numbers: Any) -> None:
    """Raise `InputError` where a number by name, or a record of numbers, is traced."""
    for name, value in numbers.items():
        if not concrete(value):
            raise InputError(
                f"`{name}` must be known, but is traced by a transformation such as jit, grad or "
                "vmap: it sets the shape of what is computed. Take it from outside as a plain "
                "number, with a call for each of its values"
            )


def unfolded(tree: Any) -> Any:
    """A record whose arrays the compiler does not compute with while it compiles.

    Arrays that a compiled function closes over, such as those of a scene, are constants to the
    compiler, and it computes while it compiles whatever depends on constants alone ("constant
    folding"): an image of 10 m then takes 171 CPU s to compile in place of 6. It folds nothing that
    lies behind a barrier (`jax.lax.optimization_barrier`), and the values are computed when the
    program runs.

    **Arguments:** `tree`: any record; what is no array in it stays as it is. Values, shapes and
    derivatives are unchanged.
    """
    # Leaf by leaf: one barrier of all would make a derivative by one leaf one by each.
    return jax.tree.map(
        lambda leaf: jax.lax.optimization_barrier(leaf) if eqx.is_array(leaf) else leaf, tree
    )
