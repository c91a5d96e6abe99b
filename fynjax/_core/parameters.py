"""What is known of a physical parameter, in one record that the field holding it carries.

Files, schemas, tables, bounds and priors of fits, and the reference page read it from there.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import equinox as eqx

from fynjax._core.errors import InputError
from fynjax._core.math import real_array

# Rounding of float32: a bound that was stored in single precision is still within itself.
_ROUNDING = 1e-6

Distribution = Literal["lognormal", "logit-normal", "normal"]
"""Distribution of a prior. A logit-normal one is of log((x - lower) / (upper - x))."""

PERCENT, CENTIMETRES = ("%", 100.0), ("cm", 100.0)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A physical parameter: how it is written, where it may lie, what is known of it beforehand.

    **Raises:** `ValueError` for a default or a usual range outside the bounds, and for no source.
    """

    symbol: str
    """Symbol of the parameter in equations."""
    name: str
    """Name in words, as titles and the first words of a description."""
    unit: str
    """Unit of every value inside the package, such as 'm', '-' or 'ug cm-2'."""
    lower: float
    """Least value that anything accepts, and lower end of the interval that a fit searches."""
    upper: float
    """Largest value, and upper end of that interval."""
    usual: tuple[float, float]
    """Range that is common; values outside it are possible."""
    description: str
    """Meaning of the parameter, with the reason of its bounds."""
    source: str
    """Source of default, bounds and prior of the parameter; says what is assumed."""
    default: float | None = None
    """Value where nothing is stated; None where there is none, or it is that of the growth form."""
    relative_sd: float | None = None
    """Standard deviation of the prior over the value that a plot's tables state."""
    sd: float | None = None
    """Standard deviation of the prior where it does not grow with the value [unit], instead of
    `relative_sd`; without either the parameter cannot be free."""
    distribution: Distribution = "lognormal"
    """Distribution of the prior: lognormal for sizes and amounts, logit-normal for shares."""
    shared: float = 0.0
    """Share of the prior's variance that the species of a plot have in common [-]."""
    population: tuple[float, float] | None = None
    """Centre of the prior where no value is stated, and its standard deviation over that."""
    shown: tuple[str, float] | None = None
    """Unit of files and tables, and the factor from `unit` to it; None: `unit` itself."""
    hint: str = ""
    """Likely slip where a value lies outside the bounds."""

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise ValueError(f"{self.name}: no source; say so where it is assumed")
        inside = [*self.usual, *(v for v in (self.default,) if v is not None)]
        if not all(self.lower <= value <= self.upper for value in inside):
            raise ValueError(f"{self.name}: default or usual range outside the bounds")

    @property
    def shown_unit(self) -> str:
        """Unit of files and tables."""
        return self.unit if self.shown is None else self.shown[0]

    @property
    def shown_factor(self) -> float:
        """Factor from `unit` to `shown_unit`."""
        return 1.0 if self.shown is None else self.shown[1]

    def prior_sd(self, value: float) -> float | None:
        """Standard deviation of the prior about `value` [unit]; None where the parameter cannot be
        free."""
        if self.sd is not None or self.relative_sd is None:
            return self.sd
        return self.relative_sd * abs(value)

    def contains(self, value: float) -> bool:
        """Whether `value` lies within the bounds, these included."""
        slack = _ROUNDING * max(abs(self.lower), abs(self.upper))
        return self.lower - slack <= value <= self.upper + slack

    def check(
        self, value: float, what: str, stated: tuple[str, float] | None = None, **where: Any
    ) -> None:
        """Raise `InputError` unless `value` lies within the bounds.

        **Arguments:** `what`, the value in words; `stated`, unit of `value` and the factor from
        `unit` to it, where it differs; `where`, file, row and column as `InputError` takes them.
        """
        unit, factor = (self.unit, 1.0) if stated is None else stated
        if not self.contains(value / factor):
            shown = "" if unit == "-" else f" {unit}"
            raise InputError(
                f"expected {what} from {factor * self.lower:g} to {factor * self.upper:g}{shown}, "
                f"but got {value:g}{f'; {self.hint}' if self.hint else ''}",
                **where,
            )


def parameter_field(*, required: bool = False, optional: bool = False, **record: Any) -> Any:
    """A field of an `eqx.Module` that holds a real array, with what `Parameter` takes of it.

    The parameter's default is that of the field too, unless it is `required`, or `optional`: then
    the field may be None, and is by default.
    """
    parameter = Parameter(**record)
    if optional:
        return eqx.field(
            converter=lambda value: None if value is None else real_array(value, parameter.name),
            metadata={"parameter": parameter},
            default=None,
        )
    without = required or parameter.default is None
    default: dict[str, Any] = {} if without else {"default": parameter.default}
    return eqx.field(
        converter=lambda value: real_array(value, parameter.name),
        metadata={"parameter": parameter},
        **default,
    )


def parameters_of(module: Any) -> dict[str, Parameter]:
    """The parameters that a class's fields hold, by name of the field."""
    return {
        field.name: field.metadata["parameter"]
        for field in dataclasses.fields(module)
        if "parameter" in field.metadata
    }
