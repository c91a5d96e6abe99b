"""Errors a user can act on: what was expected, what came, where, and the likely slip."""

import difflib
import functools
import inspect
import operator
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

LARGEST = 1e15
"""No measurement is larger than this, in any unit that files may state."""

_LONGEST_WORD, _LONGEST_LIST, _LONGEST = 80, 160, 3000


def printable(text: str) -> str:
    """Text on one line, without characters that control a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else repr(c)[1:-1] for c in text)


def _plain(text: str, most: int) -> str:
    """Text without characters that control a terminal, and with what is very long cut.

    Files come from anybody: what of them an error shows is a cell, not a page.
    """
    text = printable(text)
    text = re.sub(rf"\S{{{_LONGEST_WORD + 1},}}", lambda m: m[0][: _LONGEST_WORD - 3] + "...", text)
    text = re.sub(  # a cell that is quoted, but not what stands between two apostrophes
        rf"(?<=[\s(])(['\"])((?!\1).){{{_LONGEST_WORD + 1},}}\1(?=[\s.,;:)?]|$)",
        lambda m: m[0][: _LONGEST_WORD - 3] + "..." + m[1],
        text,
    )
    return text if len(text) <= most else text[: most - 3] + "..."


def listed(names: Iterable[str]) -> str:
    """Names with commas between, cut short where they are many."""
    return _plain(", ".join(_plain(name, 40) for name in names), _LONGEST_LIST)


class InputError(ValueError):
    """A user's input cannot be used. The message is one line and says what to change.

    **Arguments:**

    - `message`: what was expected, what came, and the likely slip.
    - `file`, `row`, `column`: where, when the input is a file. `row` counts from 1 as an
      editor does (a table's header is row 1); `column` is a name or a number. Of a TOML file the
      message calls them line and key.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        row: int | None = None,
        column: str | int | None = None,
    ) -> None:
        message = _plain(message, _LONGEST)
        column = _plain(column, _LONGEST_WORD) if isinstance(column, str) else column
        where = [] if file is None else [printable(str(file))]
        keyed = file is not None and Path(file).suffix.lower() == ".toml"
        if row is not None:
            where.append(f"{'line' if keyed else 'row'} {row}")
        if isinstance(column, str):
            where.append(f"{'key' if keyed else 'column'} {column!r}")
        elif column is not None:
            where.append(f"column {column}")
        super().__init__(f"{', '.join(where)}: {message}" if where else message)
        self.message, self.file, self.row, self.column = message, file, row, column


@contextmanager
def in_file(file: str | Path) -> Iterator[None]:
    """Have the `InputError`s of a block name `file`, unless they name one."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(
            error.message, file=Path(file), row=error.row, column=error.column
        ) from error


def names_file(reader: Callable[P, R]) -> Callable[P, R]:
    """Have the `InputError`s of a function name the file that is its argument `path`, unless they
    name one."""
    signature = inspect.signature(reader)

    @functools.wraps(reader)
    def named(*args: P.args, **kwargs: P.kwargs) -> R:
        with in_file(signature.bind(*args, **kwargs).arguments["path"]):
            return reader(*args, **kwargs)

    return named


@contextmanager
def refusing(
    *errors: type[Exception], words: str, file: str | Path | None = None, column: str | None = None
) -> Iterator[None]:
    """Make an `InputError` of any of these errors of a block; one that is an `InputError` stays.

    **Arguments:** `words`, its message, in which `{error}` stands for what the error says, and
    `{error.strerror}` for what the system says; `file` and `column`, as of `InputError`.
    """
    try:
        yield
    except InputError:
        raise
    except errors as error:
        # No `format`: a user's text among the words may have braces.
        words = words.replace("{error.strerror}", str(getattr(error, "strerror", error)))
        words = words.replace("{error}", str(error))
        raise InputError(words, file=file, column=column) from error


def whole_number(name: str, value: Any, least: int = 0, most: int | None = None) -> int:
    """The argument `name`, whose `value` must be a whole number from `least` to `most`.

    **Raises:** `InputError` for any other, also 2.0.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if number < least or (most is not None and number > most):
        span = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise InputError(f"expected `{name}` as a whole number {span}, but got {value!r:.60}")
    return number


def is_odd_number(text: str) -> bool:
    """Whether Python takes a text for a number and a reader does not: 1_0, digits of others."""
    if text.isascii() and "_" not in text:
        return False
    try:
        return bool(isfinite(float(text)))
    except ValueError:
        return False


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """' Did you mean ...?' for the nearest of `known` to `name`, or nothing if none is near."""
    known = list(known)
    lower = {k.lower(): k for k in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.5)
    return f" Did you mean {lower[near[0]]!r}?" if near else ""


class MissingExtraError(ImportError):
    """An optional package is absent; the message names the `pip install` line."""

    def __init__(self, package: str, extra: str) -> None:
        self.extra = extra
        super().__init__(
            f"This needs the optional package {package!r}. Install it with: "
            f'pip install "fynjax[{extra}]"'
        )

    @classmethod
    def of_app(cls, error: Exception) -> "MissingExtraError | None":
        """The error of a package that files, commands and pages need beyond the library, where
        `error` says that it cannot be found; None for another error."""
        name = error.name if isinstance(error, ModuleNotFoundError) else None
        package = (name or "fynjax").split(".")[0]
        return None if package == "fynjax" else cls(package, "all")

    @classmethod
    def unless_found(cls, found: Callable[[str], Any], name: str) -> Any:
        """What `found` imports by its `name`, when it is first used.

        **Raises:** `MissingExtraError` where a package that the app needs is not installed.
        """
        try:
            return found(name)
        except ModuleNotFoundError as error:
            if missing := cls.of_app(error):
                raise missing from error
            raise
