"""The growth forms, one file each.

A form is a module of this folder with a `GrowthForm` named `FORM`; the module's name is that of the
form in files and arguments. Nothing else needs to know of it.
"""

from collections.abc import Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType

from fynjax.canopy._form import GrowthForm

FORMS: Mapping[str, GrowthForm] = MappingProxyType(
    {name: import_module(f"{__name__}.{name}").FORM for _, name, _ in iter_modules(__path__)}
)
"""Each growth form by its name, in the order of the alphabet."""

__all__ = ["FORMS"]
