"""From the rows of a species table to parameters, with the defaults of the growth forms."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.parameters import Parameter, parameters_of
from fynjax.canopy import FORMS
from fynjax.leaf import LeafParameters, structure_from_dry_matter
from fynjax.scene._parameters import (
    FIXED_PARAMETERS,
    LEAF_FIELDS,
    PARAMETERS,
    SpeciesParameters,
)

USUAL_LEAF = {
    "structure": float(structure_from_dry_matter(0.0159)),
    "chlorophyll": 54.3,
    "carotenoids": 10.9,
    "anthocyanins": 1.5,
    "brown_pigments": 0.03,
    "water": 0.0185,
    "dry_matter": 0.0159,
}
"""Leaves of a species for which nothing is given: an evergreen, sclerophyllous leaf (200 g m-2,
52 % water, 60 ug cm-2 of chlorophyll) times the factors of the shipped prior, with the structure
that follows from dry matter. What is brown of its shoots is their dead tissue."""

COLUMNS = {
    "mean_diameter_cm": "diameter",
    "cover_percent": "cover",
    "height_max_m": "height",
    "packing_percent": "packing",
    "fill_percent": "fill",
    "branches": "branches",
    "rotation_spread_deg": "rotation_spread",
    "leaf_area_index": "leaf_area_index",
    "minimum_object_area_m2": "minimum_area",
    "wood_area_index": "wood_area_index",
    "shoot_clumping": "shoot_clumping",
    "dead_fraction": "dead_fraction",
}
"""Columns of a species table that are numbers, and the parameters or fields of `SceneSpecies` that
they hold."""
_RECORDS = {column: (PARAMETERS | FIXED_PARAMETERS)[name] for column, name in COLUMNS.items()}
_TEXTS = ("taxon", "growth_form")
_NEEDED = (*_TEXTS, "mean_diameter_cm", "cover_percent", "height_max_m")


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
      `USUAL_LEAF`, and a structure that is left out follows from dry matter.
    """

    def column(name: str) -> Any:
        usual: list[Any]
        stated, default = values.get(name, [None] * len(forms)), PARAMETERS[name].default
        if default is None:
            usual = [getattr(FORMS[form], name, None) for form in forms]
        else:
            usual = [default] * len(forms)
        filled = zip(stated, usual, strict=True)
        return jnp.asarray([float(u if value is None else value) for value, u in filled])

    optics = [USUAL_LEAF if leaf is None else _with_structure(leaf) for leaf in leaves]
    return (
        SpeciesParameters(**{name: column(name) for name in parameters_of(SpeciesParameters)}),
        LeafParameters.many(
            **{name: np.array([float(leaf[name]) for leaf in optics]) for name in LEAF_FIELDS}
        ),
    )


def _with_structure(leaf: Mapping[str, float]) -> Mapping[str, float]:
    return {"structure": float(structure_from_dry_matter(leaf["dry_matter"]))} | dict(leaf)


def table_rows(table: Any) -> list[dict[str, Any]]:
    """Rows of a species table, a pandas frame or records, that were checked; empty cells are left
    out.

    Raises `InputError` for what is no table, an unknown column, a missing value, text where a
    number should be or the other way round, an unknown growth form, a taxon that is there twice,
    and a value out of its parameter's bounds.
    """
    import pandas as pd  # late: the command line need not wait for it

    try:
        frame = pd.DataFrame(table).astype(object)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"expected a species table, a pandas frame or records, but got {table!r:.60}"
        ) from error
    known = (*_TEXTS, *COLUMNS)
    for name in frame.columns:
        if name not in known:
            raise InputError(
                f"unknown column.{did_you_mean(str(name), known)} Known: {', '.join(known)}",
                column=str(name),
            )
    rows: list[dict[str, Any]] = []
    for number, record in enumerate(frame.where(frame.notna(), None).to_dict("records"), start=1):
        row = {str(name): value for name, value in record.items() if value is not None}
        _check_row(row, number, [other["taxon"] for other in rows])
        rows.append(row)
    if not rows:
        raise InputError("expected a species table with rows, but it has none")
    return rows


def _check_row(row: Mapping[str, Any], number: int, earlier: Sequence[str]) -> None:
    of_taxon = f" of {row['taxon']!r}" if "taxon" in row else ""
    for name in _NEEDED:
        if name not in row:
            raise InputError(
                f"expected the {name}{of_taxon}, but it is empty", row=number, column=name
            )
    for name in _TEXTS:
        if not isinstance(row[name], str) or not row[name].strip():
            raise InputError(
                f"expected the {name} as text, but got {row[name]!r}", row=number, column=name
            )
    if row["growth_form"] not in FORMS:
        raise InputError(
            f"expected a growth form{of_taxon} among {', '.join(FORMS)}, but got "
            f"{row['growth_form']!r}.{did_you_mean(row['growth_form'], FORMS)}",
            row=number,
            column="growth_form",
        )
    if row["taxon"] in earlier:
        raise InputError(f"{row['taxon']!r} is there twice", row=number, column="taxon")
    for name, record in _RECORDS.items():
        if name in row:
            _check_number(row[name], record, of_taxon, shown=True, row=number, column=name)
    if row.get("branches", 1) % 1:
        raise InputError(
            f"expected a whole number of branches{of_taxon}, but got {row['branches']}",
            row=number,
            column="branches",
        )


def _check_number(
    value: Any, record: Parameter, of_taxon: str, *, shown: bool = False, **where: Any
) -> None:
    what = f"{record.name[0].lower()}{record.name[1:]}{of_taxon}"
    try:
        amount = None if isinstance(value, str | bool | np.bool_) else float(value)
    except (TypeError, ValueError):
        amount = None
    if amount is None:
        raise InputError(f"expected {what} as a number, but got {value!r}", **where)
    stated = (record.shown_unit, record.shown_factor) if shown else None
    record.check(amount, what, stated, **where)


def check_leaves(leaves: Mapping[str, Mapping[str, float]], taxa: Sequence[str]) -> None:
    """Raises `InputError` for leaves of a taxon that is not in the table, for leaves that lack one
    of PROSPECT's parameters other than structure or have another, and for values that are no
    numbers or out of bounds."""
    for taxon, leaf in leaves.items():
        if taxon not in (*taxa, "*"):
            raise InputError(f"expected leaves of {', '.join(taxa)} or '*', but got {taxon!r}")
        if set(leaf) | {"structure"} != set(LEAF_FIELDS):
            raise InputError(
                f"leaves of {taxon!r}: expected {', '.join(LEAF_FIELDS)}, but got {', '.join(leaf)}"
            )
        for name, value in leaf.items():
            _check_number(value, PARAMETERS[name], f" of {taxon!r}", column=name)


def table_values(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[float | None]]:
    """The parameters that rows of a species table state, in their units; None where they do not."""
    return {
        name: [
            None if column not in row else float(row[column]) / _RECORDS[column].shown_factor
            for row in rows
        ]
        for column, name in COLUMNS.items()
        if name in PARAMETERS
    }


def fixed_values(row: Mapping[str, Any]) -> dict[str, Any]:
    """What a row of a species table states of the fields of `SceneSpecies`, in their units."""
    return {
        name: float(row[column])
        for column, name in COLUMNS.items()
        if name in FIXED_PARAMETERS and column in row
    }
