"""TOML files of a user or shipped under a name, with errors that point at the key."""

import re
import tomllib
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.files import existing_file
from fynjax._core.validation import first_error, sentence
from fynjax.app.io.text._tables import read_text

_DEEPEST = 32
"""Parts of a dotted key; a file of ours has three."""
_DEEP = re.compile(
    r"""(?<![\w"'\\-])(?:(?:[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*\.[ \t]*)"""
    f"{{{_DEEPEST}}}"
)
"""A longer one: Python's reader takes memory with the square of the parts, 16 kB of text 246 MB."""

Model = TypeVar("Model", bound=BaseModel)


def line_of(text: str, loc: tuple[str | int, ...]) -> int | None:
    """Row of `[table]` or `key =` in TOML text; a search, as tomllib keeps no positions.

    **Arguments:**

    - `text`: of the file.
    - `loc`: table and key, such as ("sensor", "name"); numbers in it are skipped.

    **Returns:** the row, counted from 1; that of the table where the key is not there, `None` where
    neither is.
    """
    names = [part for part in loc if isinstance(part, str)]
    table, row = "", None
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[([^\[\]]+)\]", line):
            table = header[1].strip()
            if names and table == names[0]:
                row = number
        elif (key := re.match(r"\s*+[\"']?([^\"'=]++)[\"']?\s*=", line)) and (
            [*filter(None, [table]), key[1].strip()] == names[:2]
        ):
            return number
    return row


def read_toml(path: Path, model: type[Model], *, within: Path | None = None) -> tuple[Model, str]:
    """A TOML file as a record.

    **Arguments:**

    - `path`: a file that exists.
    - `model`: class of the record; its fields are tables and keys.
    - `within`: folder in which files must lie that a `NamedFile` of the record names; `None` allows
      any place.

    **Returns:** the record, and the text of the file.

    **Raises:** `InputError` with file, row, key, what was expected, what came and the likely slip.
    """
    text = read_text(path)
    if deep := _DEEP.search(text):
        raise InputError(
            f"expected TOML whose keys have at most {_DEEPEST} parts, but {deep[0][:20]!r}... has "
            "more",
            file=path,
            row=text.count("\n", 0, deep.start()) + 1,
        )
    try:
        raw = tomllib.loads(text)
    except (RecursionError, ValueError) as error:  # also of numbers too long to convert
        at = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        reason = str(error).split(" (at")[0]
        if "digits" in reason:  # of Python's, with advice to programmers
            reason = "a number has thousands of digits"
        hint = " Write paths with / or in single quotes." if "escape" in reason else ""
        line = text.splitlines()[int(at[1]) - 1] if at else ""
        if re.search("[“”„‘’]", line):
            hint = ' Curly quotation marks? Write straight ones: ".'
        elif comma := re.search(r"=\s*[-+]?(\d+),(\d+)\s*(#|$)", line):
            hint = f" A decimal comma? Write {comma[1]}.{comma[2]}."
        raise InputError(
            f"expected TOML, but: {reason}.{hint}",
            file=path,
            row=int(at[1]) if at else None,
            column=int(at[2]) if at else None,
        ) from error
    try:
        return model.model_validate(raw, context={"owner": path, "within": within}), text
    except ValidationError as error:
        first = first_error(error)
        table, first, loc = _place(first, model, raw)
        raise InputError(
            sentence(first, table, str(loc[-1]) if loc else ""),
            file=path,
            row=line_of(text, loc),
            column=".".join(str(part) for part in loc) or None,
        ) from error


def _place(
    error: ErrorDetails, model: type[BaseModel], raw: dict[str, Any]
) -> tuple[type[BaseModel], ErrorDetails, tuple[str | int, ...]]:
    """The record, the complaint and the key as a user knows them: [table] and key."""
    place = error["loc"]
    field = model.model_fields.get(str(place[0])) if place else None
    if field is not None and isinstance(by := field.discriminator, str):
        if error["type"].startswith("union_tag"):  # the kind is missing or not known
            return model, error, (*place, by)
        for record in _records(field):
            if place[1:] and place[1] in typing.get_args(record.model_fields[by].annotation):
                model = record
        place = (*place[:1], *place[2:])  # pydantic adds the kind to it
    elif field is not None and len(place) > 1:
        model = next(iter(_records(field)), model)
    # Other unions add the branch's own name to the place, lists the position.
    loc = place[:2]
    if len(place) > 3 and (field := model.model_fields.get(str(loc[1]))) and _records(field):
        return _records(field)[0], error, place[:4]  # of a list of tables
    if len(place) > 2:
        value: Any = raw
        for part in place[:3]:  # the value itself, or the list or table that it stands in
            inside = (isinstance(value, list) and isinstance(part, int) and part < len(value)) or (
                isinstance(value, dict) and part in value
            )
            value = value[part] if inside else value
        error = {**error, "type": "nested", "input": value}
    return model, error, loc


def _records(field: FieldInfo) -> list[type[BaseModel]]:
    """The records that may stand under a key, alone or in a list."""
    kinds = [field.annotation, *typing.get_args(field.annotation)]
    return [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]


def shipped_or_own(
    name_or_path: str | Path, what: str, shipped: Sequence[str], folder: Path
) -> Path:
    """The path of a shipped file by its name, or the path given.

    **Arguments:**

    - `name_or_path`: a name in `shipped`, or the path of a file.
    - `what`: names the thing in errors, such as "sensor".
    - `shipped`: names of the shipped files, without suffix.
    - `folder`: where the shipped files lie.

    **Returns:** the path of the file.

    **Raises:** `InputError` for a name that is not in `shipped`, and for a path without a file.
    """
    text = str(name_or_path)
    if Path(text).suffix or len(Path(text).parts) != 1:
        return existing_file(text, f"a {what} file")
    if text not in shipped:
        raise InputError(
            f"expected a shipped {what} or the path of a {what} file, but got {text!r}."
            f"{did_you_mean(text, shipped)} Shipped: {', '.join(shipped)}."
        )
    return folder / f"{text}.toml"
