"""Values of parameters that replace those of a plot's other files, such as a calibration's."""

from pathlib import Path

import jax.numpy as jnp
from jaxtyping import Array

from fynjax._core.errors import InputError, names_file
from fynjax._core.parameters import CENTIMETRES, PERCENT, Parameter
from fynjax.app.io.plot._rows import ParameterRow
from fynjax.app.io.text import did_you_mean, read_rows
from fynjax.scene import PARAMETERS, PlotParameters, named_values, parameter_kind, with_values

_FIELD_UNITS = {"-": PERCENT, "m": CENTIMETRES}
"""Units as field crews write them, and the factor to them, by the unit that they stand for."""


def _accepted(record: Parameter) -> dict[str, float]:
    """Units that a parameter may be stated in, and the factor to each."""
    field = dict([_FIELD_UNITS[record.unit]]) if record.unit in _FIELD_UNITS else {}
    return {record.unit: 1.0, **field, record.shown_unit: record.shown_factor}


@names_file
def with_parameter_table(
    parameters: PlotParameters, taxa: tuple[str, ...], path: Path
) -> PlotParameters:
    """A plot's parameters with the values that a table offers, such as `parameters.csv`: its
    estimates, or where it has a column `offered` those.

    **Arguments:**

    - `parameters`: of the plot, in their units.
    - `taxa`: the plot's taxa, in the order of `parameters`.
    - `path`: a CSV file with the columns of `ParameterRow`; name and estimate are enough, and the
      unit of covers and lengths.

    **Returns:** `parameters` with the values of the table.

    **Raises:** `InputError` for a name that the plot has not or that is there twice, another unit
    than the parameter's, and a value outside its bounds.
    """
    known = named_values(parameters, taxa)
    values: dict[str, Array] = {}
    for number, row in read_rows(path, ParameterRow, "a table of parameters"):
        if row.name not in known:
            raise InputError(
                f"the plot has no parameter {row.name!r}.{did_you_mean(row.name, list(known))} Is "
                "the table of another plot?",
                row=number,
                column="name",
            )
        kind = parameter_kind(row.name)
        record = PARAMETERS[kind]
        accepted = _accepted(record)
        if row.unit is None and record.shown is not None:
            raise InputError(
                f"expected the unit of {kind}, {' or '.join(accepted)}: calibrations write "
                f"{record.shown_unit}",
                row=number,
                column="unit",
            )
        unit = record.unit if row.unit is None else row.unit
        if unit not in accepted:
            words = f"expected {kind} in {' or '.join(accepted)}, but got {unit!r}"
            raise InputError(words, row=number, column="unit")
        factor = accepted[unit]
        used, column = row.estimate, "estimate"
        if row.offered is not None:
            used, column = row.offered, "offered"
        record.check(used, kind, (unit, factor), row=number, column=column)
        values[row.name] = jnp.asarray(used / factor)
    changed = with_values(parameters, taxa, values)
    ground = changed.ground
    covered = float(ground.litter_fraction + ground.char_fraction + ground.rock_fraction)
    if covered > 1.0 + 1e-9:
        raise InputError(
            f"expected litter, char and rock to cover at most the whole ground, but they sum to "
            f"{covered:g}",
            column="estimate",
        )
    return changed
