"""Types and shapes of every function of the package, checked by beartype while tests run.

With `FYNJAX_TYPES=1` in the environment, as in `.ci/run` and `.ci/study`, `conftest.py` has
jaxtyping's import hook wrap functions and data classes with `checked`.
"""

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Self, get_args, get_origin

from beartype import BeartypeConf, FrozenDict, beartype
from numpy.typing import ArrayLike
from pydantic import ValidationInfo
from typer import CallbackParam, Context

# At runtime the nested sequences of numpy's ArrayLike are no tuples: these have no `__reversed__`.
nested = [hint for hint in get_args(ArrayLike) if "NestedSequence" in str(get_origin(hint))]
# Of no class that can be checked: a protocol, a mark for typer, a class of which typer has its own,
# and what depends on the class.
unchecked = (Self, ValidationInfo, CallbackParam, Context)
# An integer passes for a float, as for mypy.
check = beartype(
    conf=BeartypeConf(
        is_pep484_tower=True,
        hint_overrides=FrozenDict(
            dict.fromkeys(nested, Sequence) | dict.fromkeys(unchecked, object)
        ),
    )
)


def checked(stub: Callable[..., Any]) -> Callable[..., Any]:
    """Checks a stub that jaxtyping calls with a function's arguments, or also its result as `ret0`.

    Of the two stubs the first, called before the function, checks nothing. The second has the
    arguments too: a function that refuses wrong input has done so in its own words by then.
    """
    return check(stub) if "ret0" in inspect.signature(stub).parameters else stub
