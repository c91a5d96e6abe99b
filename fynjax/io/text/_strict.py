"""What the pydantic models of a user's files share.

The JSON Schemas in `data_schemas/` are made from them; `unit` and `slip` feed the sentences of
`InputError`.
"""

from collections.abc import Callable
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from fynjax._core.parameters import Parameter

Slip = Callable[[float], str | None]


def number(
    description: str,
    unit: str,
    *,
    default: Any = ...,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """A finite number with a range and a unit, both told to the user when missed."""
    return Field(
        default,
        description=f"{description} [{unit}].",
        gt=gt,
        ge=ge,
        lt=lt,
        le=le,
        allow_inf_nan=False,
        json_schema_extra={"unit": unit},
    )


def quantity(parameter: Parameter, *, default: Any = ..., note: str = "") -> Any:
    """A number that holds `parameter`, in its shown unit and within its bounds."""
    factor, unit = parameter.shown_factor, parameter.shown_unit
    return Field(
        default,
        description=f"{parameter.name}{'; ' if note else ''}{note} [{unit}]. "
        f"{parameter.description}",
        ge=factor * parameter.lower,
        le=factor * parameter.upper,
        allow_inf_nan=False,
        json_schema_extra={"unit": unit},
    )


def optional_quantity(parameter: Parameter) -> Any:
    """The same where nothing needs to be stated: None stands for the parameter's default."""
    assert parameter.default is not None
    default = parameter.shown_factor * parameter.default
    return quantity(parameter, default=None, note=f"{default:g} if left out")


class Strict(BaseModel):
    """A record that takes no unknown names and cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    slips: ClassVar[dict[str, Slip]] = {}
    """For a field, what a value outside its range was probably meant to be."""
