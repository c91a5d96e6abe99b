"""From the rows of a species table to parameters, with the defaults of the growth forms."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy import FORM_DEFAULTS
from fynjax.leaf import LeafParameters
from fynjax.scene._parameters import LEAF_FIELDS, PARAMETERS, SpeciesParameters

USUAL_LEAF = {
    "structure": 1.8,
    "chlorophyll": 40.0,
    "carotenoids": 9.0,
    "anthocyanins": 1.5,
    "brown_pigments": 0.1,
    "water": 0.02,
    "dry_matter": 0.02,
}
"""Leaves of a species for which nothing is given: an evergreen, sclerophyllous leaf."""

_COLUMNS = {
    "cover_percent": "cover",
    "mean_diameter_cm": "diameter",
    "height_max_m": "height",
    "packing_percent": "packing",
    "fill_percent": "fill",
    "leaf_area_index": "leaf_area_index",
    "wood_area_index": "wood_area_index",
    "shoot_clumping": "shoot_clumping",
}
"""Columns of a species table and the parameters that they hold."""
_NEEDED = ("taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m")
SCENE_COLUMNS = {
    "branches": "branches",
    "rotation_spread_deg": "rotation_spread",
    "minimum_object_area_m2": "minimum_area",
}
"""Further columns, and the fields of `SceneSpecies` that they are."""


def species_parameters(
    forms: Sequence[str],
    values: Mapping[str, Sequence[float | None]],
    leaves: Sequence[Mapping[str, float] | None],
) -> tuple[SpeciesParameters, LeafParameters]:
    """Parameters of species and of their leaves from what a table states.

    **Arguments:**

    - `forms`: growth form of each species.
    - `values`: of each parameter in `SpeciesParameters`, in its unit; None takes its default,
      or that of the growth form, as does a parameter that is left out.
    - `leaves`: PROSPECT-D parameters of each species by name (`LEAF_FIELDS`); None takes
      `USUAL_LEAF`.
    """

    def column(name: str) -> Any:
        usual: list[Any]
        stated, default = values.get(name, [None] * len(forms)), PARAMETERS[name].default
        if default is None:
            usual = [getattr(FORM_DEFAULTS[form], name, None) for form in forms]
        else:
            usual = [default] * len(forms)
        filled = zip(stated, usual, strict=True)
        return jnp.asarray([float(u if value is None else value) for value, u in filled])

    optics = [USUAL_LEAF if leaf is None else leaf for leaf in leaves]
    return (
        SpeciesParameters(**{name: column(name) for name in _COLUMNS.values()}),
        LeafParameters.many(
            **{name: np.array([float(leaf[name]) for leaf in optics]) for name in LEAF_FIELDS}
        ),
    )


def table_rows(table: Any) -> list[dict[str, Any]]:
    """Rows of a species table, a pandas frame or records, that were checked; empty cells are left
    out.

    Raises `InputError` for a missing column or value, an unknown growth form, a taxon that is there
    twice, and a value out of its parameter's bounds.
    """
    records = table.to_dict("records") if hasattr(table, "to_dict") else list(table)
    rows: list[dict[str, Any]] = []
    for number, record in enumerate(records, start=1):
        row = {name: value for name, value in record.items() if not _empty(value)}
        if missing := [name for name in _NEEDED if name not in row]:
            raise InputError(f"expected a value of {missing[0]!r}", row=number, column=missing[0])
        if row["growth_form"] not in FORM_DEFAULTS:
            raise InputError(
                f"expected a growth form among {', '.join(FORM_DEFAULTS)}, but got "
                f"{row['growth_form']!r}",
                row=number,
                column="growth_form",
            )
        if any(row["taxon"] == other["taxon"] for other in rows):
            raise InputError(f"{row['taxon']!r} is there twice", row=number, column="taxon")
        for column, name in _COLUMNS.items():
            factor = column_factor(column)
            low, high = PARAMETERS[name].lower * factor, PARAMETERS[name].upper * factor
            if column in row and not low <= row[column] <= high:
                raise InputError(
                    f"expected {low:g} to {high:g}, but got {row[column]}",
                    row=number,
                    column=column,
                )
        rows.append(row)
    if not rows:
        raise InputError("expected a species table with rows, but it has none")
    return rows


def check_leaves(leaves: Mapping[str, Mapping[str, float]], taxa: Sequence[str]) -> None:
    """Raises `InputError` for leaves of a taxon that is not in the table, and for leaves that lack
    one of PROSPECT's parameters or have another."""
    for taxon, leaf in leaves.items():
        if taxon not in (*taxa, "*"):
            raise InputError(f"expected leaves of {', '.join(taxa)} or '*', but got {taxon!r}")
        if set(leaf) != set(LEAF_FIELDS):
            raise InputError(
                f"leaves of {taxon!r}: expected {', '.join(LEAF_FIELDS)}, but got {', '.join(leaf)}"
            )


def table_values(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[float | None]]:
    """The parameters that rows of a species table state, in their units; None where they do not."""
    return {
        name: [
            None if column not in row else float(row[column]) / column_factor(column)
            for row in rows
        ]
        for column, name in _COLUMNS.items()
    }


def column_factor(column: str) -> float:
    """What a column's numbers are of the parameter's in its unit: 100 for percent and cm."""
    return 100.0 if column.endswith(("_percent", "_cm")) else 1.0


def _empty(value: Any) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))
