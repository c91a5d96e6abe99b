"""What the pydantic models of a user's files share.

The JSON Schemas in `data_schemas/` are made from them; `unit` and `slip` feed the sentences of
`InputError`.
"""

import functools
import typing
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from fynjax._core.errors import LARGEST, is_odd_number
from fynjax._core.parameters import Parameter

Slip = Callable[[float], str | None]


def in_unit(
    unit: str, *, of: str = "", default: Any = ..., several: bool = False, **limits: Any
) -> Any:
    """A field of a record with a unit, which errors and schemas state: a finite number, or several.
    What it is says its docstring, which ends with the unit, as "[nm].".

    **Arguments:**

    - `unit`: such as "nm"; "-" of a number without one.
    - `of`: stands for the docstring; the unit is added to it.
    - `default`: value where none is given; the number is required if this is left out.
    - `several`: the field's type may hold several numbers, and states their range.
    - `limits`: `gt` and `lt`, or with their end `ge` and `le`, in `unit`; or others of pydantic,
      such as `min_length`.

    **Returns:** a pydantic field.
    """
    extra: Any = {"unit": unit}
    if of:
        limits["description"] = f"{of} [{unit}]."
    if not several:
        limits["allow_inf_nan"] = False
    return Field(default, json_schema_extra=extra, **limits)


def quantity(
    parameter: Parameter,
    *,
    default: Any = ...,
    optional: bool = False,
    note: str = "",
    column: str | None = None,
) -> Any:
    """A field of a record that holds a physical parameter, in its shown unit and within its bounds.

    **Arguments:**

    - `parameter`: the parameter's record, with unit and bounds.
    - `default`: value where none is given, in the shown unit; required if this is left out.
    - `optional`: it may be left out: None then stands for the default of `parameter`.
    - `note`: what the description adds to unit and name.
    - `column`: name in files, where it is not that of the field.

    **Returns:** a pydantic field.
    """
    factor, unit = parameter.shown_factor, parameter.shown_unit
    if optional:
        assert parameter.default is not None
        default, note = None, f"{factor * parameter.default:g} if left out"
    return Field(
        default,
        alias=column,
        validate_default=True,
        description=f"{parameter.name}{'; ' if note else ''}{note} [{unit}]. "
        f"{parameter.description}",
        ge=factor * parameter.lower,
        le=factor * parameter.upper,
        allow_inf_nan=False,
        json_schema_extra={"unit": unit},
    )


def _descriptions_on_one_line(schema: dict[str, Any]) -> None:
    for part in schema.get("properties", {}).values():
        if "description" in part:
            part["description"] = " ".join(part["description"].split())


def _kinds(annotation: Any) -> set[Any]:
    """The kinds of values that a field takes, alone or in lists; without words of its own."""
    if typing.get_origin(annotation) is typing.Literal:
        return set()
    inner = typing.get_args(annotation)
    return set().union(*map(_kinds, inner)) if inner else {annotation}


@functools.cache
def _keys_of_numbers(record: type[BaseModel]) -> list[tuple[str, bool]]:
    """Keys of a record that take numbers, and whether they take texts, too."""
    found = []
    for name, field in record.model_fields.items():
        kinds = _kinds(field.annotation)
        if kinds & {int, float} and not kinds & {bool, Any}:
            found += [(key, str in kinds) for key in dict.fromkeys((name, field.alias or name))]
    return found


class Refused:
    """A value in the place of a number that is none, though Python takes it for one: true or false,
    and texts such as 1_0; `given`, as the user wrote it."""

    def __init__(self, given: Any) -> None:
        self.given = given


def _plain(value: Any, *, texts: bool) -> Any:
    """A value, alone or in a list, in which what is no number is `Refused`; where `texts` may
    stand, those are no numbers anyway."""
    if isinstance(value, list | tuple):
        return [_plain(one, texts=texts) for one in value]
    odd = not texts and isinstance(value, str) and is_odd_number(value)
    return Refused(value) if isinstance(value, bool) or odd else value


class Strict(BaseModel):
    """A record that takes no unknown names and cannot be changed; docstrings of its fields are
    their descriptions in schemas and errors."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        json_schema_extra=_descriptions_on_one_line,
    )

    slips: ClassVar[dict[str, Slip]] = {}
    """Meanings, by column, that a value outside its range was probably meant to be."""
    unique: ClassVar[str | None] = None
    """Field whose value, where there is one, no two rows of a table share."""
    if_twice: ClassVar[str] = ""
    """Advice about two rows that share the key."""
    must_have: ClassVar[tuple[str, ...]] = ()
    """Columns that a table must have although their cells may be empty."""

    @classmethod
    def of_table(cls, cells: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """The rows of a table, where what a cell means depends on its column; as they are by
        default.

        **Arguments:** `cells`: of each row by column, without empty ones.
        """
        return cells

    def replace(self, **changes: Any) -> Self:
        """The same record with other values, as `dataclasses.replace`. Ranges are not checked.

        **Raises:** `TypeError` for a name that the record has not.
        """
        if unknown := sorted(set(changes) - set(type(self).model_fields)):
            raise TypeError(f"{type(self).__name__} has no {', '.join(unknown)}")
        return self.model_copy(update=changes)

    @model_validator(mode="before")
    @classmethod
    def _plain_numbers(cls, given: Any) -> Any:
        """`true` is no 1, and 1_0 no 10, where a number stands."""
        if not isinstance(given, Mapping):
            return given
        checked = dict(given)
        for key, texts in _keys_of_numbers(cls):
            if key in checked:
                checked[key] = _plain(checked[key], texts=texts)
        return checked

    @model_validator(mode="after")
    def _measurable(self) -> Self:
        for name in type(self).model_fields:
            value = getattr(self, name)
            for each in value if isinstance(value, list | tuple) else (value,):
                if isinstance(each, int | float) and abs(each) > LARGEST:
                    raise ValueError(
                        f"expected {name} within {LARGEST:g}: no measurement is larger"
                    )
        return self
