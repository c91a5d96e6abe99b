"""Values of parameters that replace those of a plot's other files, such as a calibration's."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fynjax._core.errors import InputError
from fynjax.io._table_rows import ParameterRow
from fynjax.io._tables import read_rows
from fynjax.io._validate import did_you_mean
from fynjax.scene import PlotParameters, named_values, parameter_units, with_values

_FACTORS = {"%": ("-", 0.01), "cm": ("m", 0.01)}
"""Units as field crews write them: the one they stand for, and its part."""


def with_parameter_table(
    parameters: PlotParameters, taxa: tuple[str, ...], path: Path
) -> PlotParameters:
    """`parameters` with the estimates of a table, such as the parameters.csv of a calibration.

    **Raises:** `InputError` for a name that the plot has not or that is there twice, another unit
    than the parameter's, and a negative value.
    """
    known, units = named_values(parameters, taxa), parameter_units()
    values: dict[str, Array] = {}
    for number, row in read_rows(path, ParameterRow, "a table of parameters"):
        if row.name not in known:
            raise InputError(
                f"the plot has no parameter {row.name!r}.{did_you_mean(row.name, list(known))} Is "
                "the table of another plot?",
                file=path,
                row=number,
                column="name",
            )
        if row.name in values:
            raise InputError(f"{row.name!r} is there twice", file=path, row=number, column="name")
        kind = row.name.rsplit(".", 1)[-1]
        stated = units[kind] if row.unit is None else row.unit
        # Water is in cm by itself.
        own, factor = (
            (stated, 1.0) if stated == units[kind] else _FACTORS.get(stated, (stated, 1.0))
        )
        if own != units[kind]:
            shown = [units[kind], *(u for u, (o, _) in _FACTORS.items() if o == units[kind])]
            raise InputError(
                f"expected {kind} in {' or '.join(shown)}, but got {row.unit!r}",
                file=path,
                row=number,
                column="unit",
            )
        if not (np.isfinite(row.estimate) and row.estimate >= 0.0):
            raise InputError(
                f"expected a value of at least 0, but got {row.estimate:g}",
                file=path,
                row=number,
                column="estimate",
            )
        values[row.name] = jnp.asarray(factor * row.estimate)
    return with_values(parameters, taxa, values)
