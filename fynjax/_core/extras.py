"""Optional packages, imported where they are used."""

import importlib
import warnings
from types import ModuleType
from typing import Any

from fynjax._core.errors import MissingExtraError


def require(module: str, extra: str, package: str | None = None) -> ModuleType:
    """Import `module`, or say which extra of fynjax brings it.

    **Arguments:** `module`: name as imported; `extra`: the extra in `pip install "fynjax[extra]"`;
    `package`: name as installed, if it is another.

    **Raises:** `MissingExtraError` if the package is not installed. A package that is there and
    fails in an import of its own raises what it raises.
    """
    try:
        with warnings.catch_warnings():
            # Of the Python a wrapper was compiled for, or of a next version: no user can change it.
            warnings.simplefilter("ignore", DeprecationWarning)
            warnings.simplefilter("ignore", FutureWarning)
            return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name != module.split(".")[0]:
            raise
        raise MissingExtraError(package or module, extra) from error


def app_room(room: str, name: str) -> Any:
    """The function called `name` of a package of `fynjax.app`, for a method of the library that
    reads a user's file or writes a page. It is the only door: the library needs the packages of the
    app for nothing else.

    **Raises:** `MissingExtraError` for a package that the app needs and that is not installed.
    """
    found = lambda name: getattr(importlib.import_module(f"fynjax.app.{room}"), name)  # noqa: E731
    return MissingExtraError.unless_found(found, name)
