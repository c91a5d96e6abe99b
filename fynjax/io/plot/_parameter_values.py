"""Values of parameters that replace those of a plot's other files, such as a calibration's."""

from pathlib import Path

import jax.numpy as jnp
from jaxtyping import Array

from fynjax._core.errors import InputError
from fynjax.io.plot._rows import ParameterRow
from fynjax.io.text import did_you_mean, read_rows
from fynjax.scene import PlotParameters, named_values, parameter_units, with_values

_FACTORS = {"%": ("-", 0.01), "cm": ("m", 0.01)}
"""Units as field crews write them: the one they stand for, and its part."""
_IN_FIELD_UNITS = {"cover": "%", "diameter": "cm"}
_RANGES = {
    "cover": (0.0, 1.0), "diameter": (0.01, 10.0), "height": (0.01, 20.0),
    "packing": (0.0, 0.99), "fill": (0.01, 1.0), "leaf_area_index": (0.0, 20.0),
    "wood_area_index": (0.0, 20.0), "shoot_clumping": (0.0, 0.8), "structure": (1.0, 5.0),
    "chlorophyll": (0.0, 150.0), "carotenoids": (0.0, 50.0), "anthocyanins": (0.0, 50.0),
    "brown_pigments": (0.0, 5.0), "water": (0.0, 0.2), "dry_matter": (0.0, 0.1),
    "brightness": (0.05, 2.0), "moisture": (0.0, 1.0), "litter_fraction": (0.0, 1.0),
    "char_fraction": (0.0, 1.0), "rock_fraction": (0.0, 1.0), "wood_brightness": (0.0, 3.0),
    "sun_zenith": (0.0, 88.99), "sun_azimuth": (-360.0, 360.0), "aerosol": (0.0, 2.0),
}  # fmt: skip
"""What the plot's own tables allow, in the parameters' units."""


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
        if row.unit is None and kind in _IN_FIELD_UNITS:
            raise InputError(
                f"expected the unit of {kind}, {_units(units[kind])}: calibrations write "
                f"{_IN_FIELD_UNITS[kind]}",
                file=path,
                row=number,
                column="unit",
            )
        stated = units[kind] if row.unit is None else row.unit
        # Water is in cm by itself.
        own, factor = (
            (stated, 1.0) if stated == units[kind] else _FACTORS.get(stated, (stated, 1.0))
        )
        if own != units[kind]:
            raise InputError(
                f"expected {kind} in {_units(units[kind])}, but got {row.unit!r}",
                file=path,
                row=number,
                column="unit",
            )
        low, high = _RANGES[kind]
        if not low <= factor * row.estimate <= high:
            raise InputError(
                f"expected {kind} from {low / factor:g} to {high / factor:g} {stated}, but got "
                f"{row.estimate:g}",
                file=path,
                row=number,
                column="estimate",
            )
        values[row.name] = jnp.asarray(factor * row.estimate)
    changed = with_values(parameters, taxa, values)
    ground = changed.ground
    covered = float(ground.litter_fraction + ground.char_fraction + ground.rock_fraction)
    if covered > 1.0 + 1e-9:
        raise InputError(
            f"expected litter, char and rock to cover at most the whole ground, but they sum to "
            f"{covered:g}",
            file=path,
            column="estimate",
        )
    return changed


def _units(own: str) -> str:
    return " or ".join([own, *(unit for unit, (of, _) in _FACTORS.items() if of == own)])
