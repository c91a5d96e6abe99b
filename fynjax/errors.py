"""Errors of fynjax that a user meets and can act on."""

from fynjax._core.errors import InputError, MissingExtraError

__all__ = ["InputError", "MissingExtraError"]
