"""Species of a plot as a table states them, what of them is fixed in a scene, and their parameters.

A row is made by the table's columns, in the units of field crews (`SpeciesRow.model_validate`). Its
fields are in the package's own units; `replace` changes them. The same rows and checks serve
files, pandas frames and records.
"""

import functools
import itertools
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, SupportsIndex

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import (
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationInfo,
    field_validator,
    model_validator,
)

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.files import NamedFile
from fynjax._core.parameters import parameters_of
from fynjax._core.records import Slip, Strict, quantity
from fynjax._core.seeds import generator
from fynjax._core.validation import check_header, checked_row, checked_rows, is_note
from fynjax.canopy import (
    FORMS,
    FORMS_SHOWN,
    AbstractLeafAngle,
    MeshPlant,
    Organ,
    PlantModel,
    Shrubland,
    TabulatedLeafAngle,
    TiltedLeafAngle,
    leaf_angle,
    most_projected,
    table1_2006,
)
from fynjax.leaf import FLAT, ROUND, LeafParameters, structure_from_dry_matter
from fynjax.scene._cover_words import cover_range, name_classes
from fynjax.scene._parameters import FIXED_PARAMETERS, LEAF_FIELDS, PARAMETERS, SpeciesParameters
from fynjax.scene._spectra import Spectrum

if TYPE_CHECKING:
    FormName = str
else:  # the names as a choice: in errors, and as an enumeration of the schema
    FormName = Literal[tuple(FORMS)]

_RECORDS = PARAMETERS | FIXED_PARAMETERS
CoverDefinition = Literal["projected", "article"]
"""Meaning of the cover of a species, see `PlantingRules`."""
_OF_THE_ARTICLE = ("packing", "fill", "branches", "minimum_area")
"""What eq. (10) counts plants by besides cover and diameter."""
_MOST_COVER = 300.0
"""Sum of the covers of a plot, whose layers overlap, above which they are taken for counts [%]."""


def _diameter_slip(value: float) -> str | None:
    if 0 < value < 1:
        return f"Metres? In cm this is {value * 100:g}."
    return "Millimetres?" if value > 1000 else None


def _per_area_slip(value: float) -> str | None:
    if value >= 5:
        return f"g m-2? In g cm-2 (or cm of water) this is {value / 1e4:g}."
    return f"mg cm-2 or mm? Here it would be {value / 1000:g}." if value > 0 else None


def _defaulted(name: str, column: str | None = None) -> Any:
    """A field that has the default of its parameter where nothing is stated."""
    record = _RECORDS[name]
    assert record.default is not None
    default = record.shown_factor * record.default
    return quantity(record, default=default, note=f"{default:g} if left out", column=column)


def _of_the_form(name: str) -> Any:
    """A field that is None where nothing is stated: its growth form has a value."""
    return quantity(
        PARAMETERS[name], default=None, note="that of the growth form if left out", column=name
    )


def _of_the_leaf(name: str) -> Any:
    """A field that is None where nothing is stated: the usual leaf has a value."""
    note = "that of the usual leaf of the growth form if left out"
    return quantity(PARAMETERS[name], default=None, note=note)


@functools.cache
def _shipped_growth_forms() -> dict[str, str]:
    table = table1_2006()
    return dict(zip(table["taxon"], table["growth_form"], strict=True))


class SpeciesRow(Strict):
    """One row of the species table: what a field crew notes of one taxon in one plot."""

    slips: ClassVar[dict[str, Slip]] = {
        "mean_diameter_cm": _diameter_slip,
        "height_max_m": lambda v: f"Centimetres? In m this is {v / 100:g}." if v > 20 else None,
        "fill_percent": lambda v: "A crown must hold some plant." if v == 0 else None,
    }
    unique = "taxon"
    if_twice = "Add the covers up, or give the two layers different names."

    taxon: str = Field(description="Scientific name, or 'Deadwood'.", min_length=1)
    diameter: float = quantity(PARAMETERS["diameter"], column="mean_diameter_cm")
    """Mean crown diameter [m]."""
    cover: float = quantity(
        PARAMETERS["cover"],
        note="or a class of Braun-Blanquet, '<1', '>75', '5-10' or 'trace', whose middle counts "
        "and whose range is the prior",
        column="cover_percent",
    )
    """Share of the ground under the crowns [-]."""
    height: float = quantity(PARAMETERS["height"], column="height_max_m")
    """Greatest height in the plot [m]."""
    growth_form: FormName = Field(
        default=None,
        validate_default=True,
        description="Shape of the plant. May be left out for a taxon of the shipped table.",
    )
    packing: float = _defaulted("packing", "packing_percent")
    """Share of a crown over its neighbours, PE of equation (8) [-]."""
    fill: float = _defaulted("fill", "fill_percent")
    """Share of the crown circle filled, FF of equation (9) [-]."""
    branches: int = _defaulted("branches")
    """Copies of the plant model that make one plant [-]."""
    rotation_spread: float = _defaulted("rotation_spread", "rotation_spread_deg")
    """Standard deviation of the plants' lean, sigma_rot of equation (5) [degree]."""
    leaf_area_index: float | None = _of_the_form("leaf_area_index")
    minimum_area: float = _defaulted("minimum_area", "minimum_object_area_m2")
    """Least ground area that a plant counts for [m2]."""
    wood_area_index: float | None = _of_the_form("wood_area_index")
    plant: Annotated[Path, NamedFile("a plant")] | None = Field(
        default=None,
        description="Mesh of one plant (OBJ, PLY, STL, GLB; metres), or the elements.csv that "
        "`fynjax plant` writes; a path from the table's folder. Its areas over its crown are "
        "the area indices where the table leaves these out, and count once where crowns overlap, "
        "as these do. Left out: the growth form's shape.",
    )
    shoot_clumping: float | None = _of_the_form("shoot_clumping")
    dead_fraction: float | None = _of_the_form("dead_fraction")
    leaf_angle: float | None = quantity(
        PARAMETERS["leaf_angle"],
        default=None,
        note="left out of all species, leaves are inclined as those of their form or mesh",
        column="leaf_angle_deg",
    )
    """Mean inclination of the leaves [degree]."""
    groups: float = _defaulted("groups", "clumping_m")
    """Radius of the groups in which the plants stand, 0 for none [m]."""

    _cover_range: tuple[float, float] | None = PrivateAttr(default=None)

    @property
    def cover_range(self) -> tuple[float, float] | None:
        """Least and largest cover [-] of a class, a limit or a range; None of a plain number."""
        return self._cover_range

    def leaves_open(self, kind: str) -> bool:
        """Whether neither the row nor the mesh that it names gives a value of `kind`, such as
        "leaf_area_index"."""
        from_mesh = self.plant is not None and kind.endswith("area_index")
        return getattr(self, kind) is None and not from_mesh

    @classmethod
    def of_table(cls, cells: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """The rows of a table with classes of cover named as such (`name_classes`)."""
        column = "cover_percent"
        at = [row for row in cells if column in row]
        named = name_classes([row[column] for row in at])
        for row, cell in zip(at, named, strict=True):
            row[column] = cell
        return cells

    @model_validator(mode="wrap")
    @classmethod
    def _cover_as_written(cls, given: Any, handler: Any) -> "SpeciesRow":
        """A class, limit or range of cover counts as its middle, and is kept."""
        word = given.get("cover_percent") if isinstance(given, Mapping) else None
        between = cover_range(word) if isinstance(word, str) else None
        if between is None:
            return handler(given)
        row = handler({**given, "cover_percent": 0.5 * sum(between)})
        row._cover_range = (between[0] / 100.0, between[1] / 100.0)
        return row

    @field_validator("diameter", "cover", "packing", "fill")
    @classmethod
    def _in_own_unit(cls, value: float, info: ValidationInfo) -> float:
        return value / PARAMETERS[str(info.field_name)].shown_factor

    @field_validator("growth_form", mode="before")
    @classmethod
    def _of_the_shipped_table(cls, value: Any, info: ValidationInfo) -> Any:
        taxon = info.data.get("taxon")
        if value is not None and value not in FORMS:
            raise ValueError(
                f"expected one of {', '.join(map(repr, FORMS))}, but got {value!r}."
                f"{did_you_mean(str(value), FORMS)} {FORMS_SHOWN}"
            )
        if value is not None or taxon is None:
            return value
        shipped = _shipped_growth_forms()
        if taxon not in shipped:
            raise ValueError(
                f"expected a growth form for {taxon!r}, which is not in the shipped table."
                f"{did_you_mean(taxon, shipped)} Add a column growth_form with one of "
                f"{', '.join(FORMS)}. {FORMS_SHOWN}"
            )
        return shipped[taxon]


_STATED = tuple(name for name in LEAF_FIELDS if name not in ("anthocyanins", "brown_pigments"))
"""Traits that no row states beside a spectrum."""
_OTHER_ORGANS = ("wood", "flower")
SHIPPED_MATERIALS = ("bark", "litter", "char")
"""Shipped spectra that a material may have."""


def _has(kind: str, *names: str) -> dict[str, Any]:
    """JSON schema of a row that states one of `names`."""
    one = [{"required": [name], "properties": {name: {"type": kind}}} for name in names]
    return {"anyOf": one}


_REFUSED: Any = {
    "anyOf": [
        _has("string", "spectrum", "reflectance") | {"allOf": [_has("number", *_STATED)]},
        {"allOf": [_has("string", "spectrum"), _has("string", "reflectance")]},
        _has("number", "outer_fraction") | {"not": _has("string", "material")},
        _has("string", "reflectance") | {"not": _has("string", "material")},
        _has("string", "transmittance") | {"not": _has("string", "reflectance")},
    ]
}
"""JSON schema of rows of a leaf table that state too much, or that of leaves which only another
material has."""


class LeafRow(Strict):
    """One row of the leaf table: what the leaves of a taxon, or another material of its plants,
    are: PROSPECT parameters, a spectrum to fit, or of a material a spectrum as it is."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "anyOf": [_has("string", "spectrum", "reflectance"), _has("number", *LEAF_FIELDS)],
            "not": _REFUSED,
        },
    )
    slips: ClassVar[dict[str, Slip]] = {"water": _per_area_slip, "dry_matter": _per_area_slip}

    taxon: str = Field(
        description="Name as in the species table; '*' is every taxon without a row of its own. Of "
        "a taxon with several rows of its leaves each plant has one of these.",
        min_length=1,
    )
    material: str = Field(
        default="",
        description="Material of the plant that the row describes, as its mesh names it, such as "
        "young, old, fruit, petal or bark; 'flower' and 'wood' are the flowers and the wood that "
        "nothing else describes, also of generated plants. Left out, or 'leaf': the leaves of the "
        "taxon.",
    )
    outer_fraction: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="Of a material, such as young, of plants without a mesh: the share of their "
        "leaf area, outermost in the crown, that is of it [-].",
    )
    chlorophyll: float | None = _of_the_leaf("chlorophyll")
    carotenoids: float | None = _of_the_leaf("carotenoids")
    anthocyanins: float = _defaulted("anthocyanins")
    brown_pigments: float = _defaulted("brown_pigments")
    water: float | None = _of_the_leaf("water")
    dry_matter: float | None = _of_the_leaf("dry_matter")
    structure: float | None = quantity(
        PARAMETERS["structure"], default=None, note="computed from dry matter if left out"
    )
    spectrum: Annotated[Path, NamedFile("a leaf spectrum")] | None = Field(
        default=None, description="Measured reflectance to fit; a path from the table's folder."
    )
    reflectance: (
        Annotated[Path | str, NamedFile("a reflectance spectrum", words=SHIPPED_MATERIALS)] | None
    ) = Field(
        default=None,
        description="Of a material, its reflectance as it is: a file as of spectrum (ASD, CSV "
        "...), or the shipped bark, litter or char.",
    )
    transmittance: Annotated[Path, NamedFile("a transmittance spectrum")] | None = Field(
        default=None,
        description="Transmittance beside the reflectance, a file likewise; left out: opaque.",
    )

    @field_validator("material")
    @classmethod
    def _leaf_is_the_leaf(cls, value: str) -> str:
        return "" if value == "leaf" else value

    @model_validator(mode="before")
    @classmethod
    def _one_source(cls, given: dict[str, Any]) -> dict[str, Any]:
        has = [name for name, value in given.items() if value is not None]
        sources = [name for name in ("spectrum", "reflectance") if name in has]
        if not sources and not set(has) & set(LEAF_FIELDS):
            raise ValueError(
                f"expected one of {', '.join(LEAF_FIELDS)}, a spectrum or, of a material, its "
                "reflectance, but all are empty"
            )
        both = [*(name for name in _STATED if name in has), *sources]
        if sources and len(both) > 1:
            raise ValueError(
                f"expected PROSPECT parameters or a spectrum, but got both ({both[0]!r} and "
                f"{both[-1]!r}). Leave one empty."
            )
        if "reflectance" in has and given.get("material") in (None, "", "leaf"):
            raise ValueError(
                "expected a material beside a reflectance that is taken as it is: of the leaves of "
                "a taxon state PROSPECT parameters, or a 'spectrum' to fit them to"
            )
        if "outer_fraction" in has and given.get("material") in (None, "", "leaf", *_OTHER_ORGANS):
            raise ValueError(
                "expected a material of leaves, such as young, beside an outer_fraction: the share "
                "of the leaf area that is of it"
            )
        if "transmittance" in has and "reflectance" not in has:
            raise ValueError("expected a reflectance beside a transmittance, but it is empty")
        return given

    @field_validator("structure")
    @classmethod
    def _of_leaves_as_heavy(cls, value: float | None, info: ValidationInfo) -> float | None:
        dry = info.data.get("dry_matter")
        return float(structure_from_dry_matter(dry)) if value is None and dry is not None else value

    def filled(self, usual: "LeafRow") -> "LeafRow":
        """The row with the traits of a `usual` leaf where it states none."""
        left_out = [name for name in LEAF_FIELDS if getattr(self, name) is None]
        return self.replace(**{name: getattr(usual, name) for name in left_out})


USUAL_LEAF = LeafRow(
    taxon="*",
    chlorophyll=53.6,
    carotenoids=10.7,
    anthocyanins=1.5,
    brown_pigments=0.03,
    water=0.0200,
    dry_matter=0.0168,
)
"""Leaves of a species for which nothing is given: an evergreen, sclerophyllous leaf (200 g m-2,
52 % water, 60 ug cm-2 of chlorophyll) times the factors of the shipped prior, with the structure
that follows from dry matter. What is brown of its shoots is their dead tissue."""
SHRUB_LEAF = USUAL_LEAF.replace(
    chlorophyll=38.6,
    carotenoids=9.5,
    water=0.0109,
    dry_matter=0.0090,
    structure=float(structure_from_dry_matter(0.0090)),
)
"""Leaf of shrubs at large: medians over 22 species of shrubs, of pigments over 15, in ANGERS (Féret
et al. 2008, Remote Sensing of Environment 112:3030), LOPEX (Hosgood et al. 1994, EUR 16095) and
"Fresh Leaf Spectra to Estimate Leaf Traits for California Ecosystems" (EcoSIS)."""
SHRUB_LEAF_SD = {"dry_matter": 0.6, "water": 0.6, "chlorophyll": 0.45, "carotenoids": 0.4}
"""Standard deviation of the logarithm of these between the species [-]; of pigments without leaves
below 15 ug cm-2, which are yellow."""


PETAL = {
    "structure": 2.0, "chlorophyll": 0.0, "carotenoids": 0.5, "anthocyanins": 1.0, "water": 0.008,
    "dry_matter": 0.003,
}  # fmt: skip
"""Petals as leaves without chlorophyll: an assumption, for want of measured fynbos petals."""


_WIDTH_OF_90 = 3.29
"""Standard deviations of a normal that its middle 90 % are wide."""


def table_spreads(
    rows: Sequence[SpeciesRow],
    plants: Shrubland,
    leaves: Sequence[LeafRow] = (),
    measured: Collection[str] = (),
) -> dict[str, float]:
    """Relative standard deviations [-] that a species table gives parameters, by their names.

    A cover that is a class or a range has the one whose middle 90 % are that range. What the table
    leaves open of generic plants has that of shrublands at large.

    **Arguments:**

    - `rows`: of the table.
    - `plants`: whose values those have that it leaves out.
    - `leaves`: rows of its leaf table, which may leave traits open too.
    - `measured`: taxa whose leaves are measured besides.
    """
    spreads = {}
    for row in rows:
        low, high = row.cover_range or (0.0, 0.0)
        if row.cover > 0.0 and low <= row.cover <= high:  # else another cover took its place
            spreads[f"species.{row.taxon}.cover"] = (high - low) / _WIDTH_OF_90 / row.cover
        if plants == "fynbos":
            continue
        record = FORMS[row.growth_form]
        known = record.generic or record.prior
        for kind in () if known is None else ("leaf_area_index", "dead_fraction", "shoot_clumping"):
            if row.leaves_open(kind):
                median, sd = getattr(known, kind)
                spreads[f"species.{row.taxon}.{kind}"] = float(sd / median)
        if row.taxon in measured:
            continue
        of_leaves = [leaf for leaf in leaves if not leaf.material]
        own = [leaf for leaf in of_leaves if leaf.taxon == row.taxon]
        own = own or [leaf for leaf in of_leaves if leaf.taxon == "*"]
        for kind, sd in SHRUB_LEAF_SD.items():
            if all(leaf.spectrum is None and getattr(leaf, kind) is None for leaf in own):
                spreads[f"species.{row.taxon}.leaf.{kind}"] = sd
    return spreads


def own_spread(name: str, spreads: Mapping[str, float], stated: Iterable[str]) -> float | None:
    """Relative standard deviation that a species table gives a parameter (`table_spreads`), or None
    where something else is stated: of its name or, but for a cover, by a pattern.

    **Arguments:**

    - `name`: of the parameter.
    - `spreads`: of `table_spreads`.
    - `stated`: names and patterns of which a standard deviation is stated.

    **Returns:** a relative standard deviation [-], or None.
    """
    patterns = [p for p in stated if not name.endswith(".cover") or "*" not in p]
    return None if any(fnmatchcase(name, p) for p in patterns) else spreads.get(name)


@functools.cache
def usual_leaf(form: str, plants: Shrubland = "fynbos") -> LeafRow:
    """Leaf of a growth form of which a table states none: the usual one of fynbos or of shrubs at
    large, and of a form that neither of them has, such as a succulent, its own.

    **Arguments:** `form`, a key of `fynjax.canopy.FORMS`; `plants`, which of the two.
    """
    record = FORMS[form]
    if record.generic is not None or not record.leafy:
        return USUAL_LEAF if plants == "fynbos" else SHRUB_LEAF
    # Crews measure per area that is seen, PROSPECT counts per half of the surface.
    dry = record.leaf_mass_per_area / 1e4 / (ROUND if record.round_leaves else FLAT)
    water = dry * record.water_content / (1.0 - record.water_content)
    return USUAL_LEAF.replace(
        chlorophyll=record.chlorophyll,
        carotenoids=record.carotenoids,
        anthocyanins=record.anthocyanins,
        water=min(water, PARAMETERS["water"].upper),
        dry_matter=dry,
        structure=float(structure_from_dry_matter(dry)),
    )


def cover_definition_of(
    rows: Sequence[SpeciesRow], stated: CoverDefinition | None = None
) -> CoverDefinition:
    """Meaning of the covers of a species table: as `stated`, else the article's where a row has
    packing, fill, branches or a least area, by which only eq. (10) counts, else projected.

    **Arguments:** `rows`, of the table; `stated`, what is said of them.
    """
    terms = any(getattr(row, n) != _RECORDS[n].default for row in rows for n in _OF_THE_ARTICLE)
    return stated or ("article" if terms else "projected")


def check_projected(
    taxon: str, cover: float, terms: Mapping[str, float], most: float | None = None, **where: Any
) -> None:
    """Raise `InputError` for what a species whose cover is projected cannot have: terms of the
    article's eq. (10), and more cover than crowns at random reach.

    **Arguments:**

    - `taxon`: its name.
    - `cover`: its cover [-].
    - `terms`: its packing, fill, branches and minimum area, in the package's units.
    - `most`: largest cover [-]; left out, `most_projected`.
    - `where`: file and row, for errors.
    """
    for name, value in terms.items():
        if value != _RECORDS[name].default:
            column = SpeciesRow.model_fields[name].alias or name
            raise InputError(
                f"{taxon} has {column}, which the article counts plants by in eq. (10), but covers "
                "here are projected: overlap is counted as it is planted. Leave the column out, or "
                'set cover_definition = "article".',
                column=column,
                **where,
            )
    most = float(most_projected()) if most is None else most
    if cover > most + 1e-6:
        raise InputError(
            f"{taxon} is to cover {100 * cover:.3g} % of the ground, but crowns that stand by "
            f"chance overlap, and cover {100 * most:.3g} % at most here: state no more.",
            column="cover_percent",
            **where,
        )


def check_species(
    rows: Sequence[tuple[int, SpeciesRow]],
    file: Path | None = None,
    cover_definition: CoverDefinition | None = None,
) -> None:
    """Raise `InputError` for covers that cannot be those of one plot.

    **Arguments:**

    - `rows`: of a species table, each with its number.
    - `file`: of the table, for errors.
    - `cover_definition`: meaning of its covers (`cover_definition_of`); of projected ones as
      `check_projected`.

    Warns where covers look like fractions.
    """
    if cover_definition_of([row for _, row in rows], cover_definition) == "projected":
        for number, row in rows:
            terms = {name: getattr(row, name) for name in _OF_THE_ARTICLE}
            check_projected(row.taxon, row.cover, terms, file=file, row=number)
    covers = [100.0 * row.cover for _, row in rows]
    total, largest = sum(covers), max(covers)
    if total > _MOST_COVER:
        raise InputError(
            f"expected covers that sum to at most {_MOST_COVER:g} % (layers may overlap), "
            f"but they sum to {total:g} %. Are these counts?",
            file=file,
            column="cover_percent",
        )
    if 0 < largest <= 1 and total <= 1.5:
        warnings.warn(
            f"{file or 'species table'}: the largest cover is {largest:g} %. Are these fractions? "
            f"Percent is expected: {largest:g} would be {largest * 100:g}.",
            stacklevel=3,
        )


def check_taxa(
    rows: Sequence[tuple[int | None, Any]], taxa: Sequence[str], file: Path | None = None
) -> None:
    """Raise `InputError` for a row of a taxon that is not in the species table.

    **Arguments:**

    - `rows`: of leaves or crowns, each with its number.
    - `taxa`: that it may be of.
    - `file`: of the rows, for errors.
    """
    for number, row in rows:
        if row.taxon not in taxa:
            raise InputError(
                f"unknown taxon {row.taxon!r}: it is not in the species table."
                f"{did_you_mean(row.taxon, taxa)} Else delete this row, or add the taxon there.",
                file=file,
                row=number,
                column="taxon",
            )


def species_rows(
    table: Any, cover_definition: CoverDefinition | None = None
) -> tuple[SpeciesRow, ...]:
    """The species of a table in Python.

    **Arguments:**

    - `table`: a pandas frame or records with the columns of a species table; empty cells are left
      out, and rows are counted from 1. Or rows that were read.
    - `cover_definition`: meaning of its covers, as of `check_species`.

    **Raises:** `InputError` with row and column for what is no table and for a row or a table that
    a file would not be taken with either. Warns as `check_species`.
    """
    import pandas as pd  # late: the command line need not wait for it

    if isinstance(table, list | tuple) and table and isinstance(table[0], SpeciesRow):
        check_species(list(enumerate(table, start=1)), None, cover_definition)
        return tuple(table)
    try:
        frame = pd.DataFrame(table).astype(object)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"expected a species table, a pandas frame or records, but got {table!r:.60}. "
            "`fx.read_scene` reads files"
        ) from error
    if frame.empty:
        raise InputError("expected a species table with rows, but it has none")
    check_header([str(name) for name in frame.columns], SpeciesRow)
    records = frame.where(frame.notna(), None).to_dict("records")
    given = (
        {
            str(name): str(value) if isinstance(value, bool | np.bool_) else value  # no number
            for name, value in record.items()
            if value is not None and not is_note(str(name))
        }
        for record in records
    )
    rows = checked_rows(enumerate(given, start=1), SpeciesRow)
    check_species(rows, None, cover_definition)
    return tuple(row for _, row in rows)


LeafStated = Mapping[str, Any]
"""PROSPECT parameters of a leaf by name, or reflectance and transmittance of a material: each a
`Spectrum`, the reflectance also the name of a shipped one."""


def leaf_rows(
    leaves: Mapping[str | tuple[str, str], LeafStated | Sequence[LeafStated]], taxa: Sequence[str]
) -> list[LeafRow]:
    """Leaves stated by taxon, one or several of each, and materials by taxon and name, with "*" for
    any other taxon, as rows of a leaf table.

    **Raises:** `InputError` for what a leaf table could not have, for those of a taxon that is not
    among `taxa`, and for several of one material.
    """
    rows = []
    for key, stated in leaves.items():
        taxon, material = (key, "") if isinstance(key, str) else key
        if not stated:
            raise InputError(f"expected a leaf of {taxon!r}, or several, but got none")
        for leaf in [stated] if isinstance(stated, Mapping) else stated:
            # A spectrum in memory stands for a file, and is put in its place.
            given = {name: v for name, v in leaf.items() if isinstance(v, Spectrum)}
            names = {name: Path(name) for name in given}
            try:
                if "spectrum" in leaf:
                    raise InputError(
                        "expected PROSPECT parameters, but got a spectrum: fit it first"
                    )
                if any(isinstance(leaf.get(n), str | Path) and leaf[n] not in SHIPPED_MATERIALS
                       for n in ("reflectance", "transmittance")):  # fmt: skip
                    raise InputError(
                        f"expected a `Spectrum` or one of {', '.join(SHIPPED_MATERIALS)}, but got "
                        "a file: `fx.read_scene` reads files"
                    )
                row = {"taxon": taxon, "material": material, **leaf, **names}
                rows.append(checked_row(LeafRow, row).replace(**given))
            except InputError as error:
                of = f"leaves of {taxon!r}" if not material else f"{material!r} of {taxon!r}"
                raise InputError(f"{of}: {error}") from error
    check_taxa([(None, row) for row in rows], (*taxa, "*"))
    check_materials([(None, row) for row in rows])
    return rows


def check_materials(rows: Sequence[tuple[int | None, LeafRow]], file: Path | None = None) -> None:
    """Raise `InputError` for a material of a taxon that is described twice.

    **Arguments:** `rows`, of a leaf table, each with its number; `file` of the table, for errors.
    """
    seen: set[tuple[str, str]] = set()
    for number, row in rows:
        key = row.taxon, row.material
        if row.material and key in seen:
            raise InputError(
                f"{row.material!r} of {row.taxon!r} is there twice: only of leaves may a taxon "
                "have several, of which each plant has one",
                file=file,
                row=number,
                column="material",
            )
        seen.add(key)


def leaves_of(
    species: Sequence[SpeciesRow], leaves: Sequence[LeafRow], plants: Shrubland = "fynbos"
) -> list[tuple[LeafRow, ...]]:
    """The leaves of each species: its own rows, else those of "*", else the usual leaf, which also
    has the traits that a row leaves out. Other materials are not among them.

    **Arguments:**

    - `species`: of a plot; those without leaves have the usual one.
    - `leaves`: rows of its leaf table, in any number.
    - `plants`: whose usual leaf.
    """
    by_taxon: dict[str, tuple[LeafRow, ...]] = {}
    for row in leaves:
        if not row.material:
            by_taxon[row.taxon] = (*by_taxon.get(row.taxon, ()), row)
    found = []
    for one in species:
        usual = usual_leaf(one.growth_form, plants)
        stated = by_taxon.get(one.taxon, by_taxon.get("*", (usual,)))
        leafy = FORMS[one.growth_form].leafy
        # A spectrum is still to be fitted: it gives all traits.
        own = [row if row.spectrum is not None else row.filled(usual) for row in stated]
        found.append(tuple(own) if leafy else (usual,))
    return found


_WITHIN_SPECIES = {
    "structure": 0.23,
    "chlorophyll": 0.34,
    "carotenoids": 0.17,
    "anthocyanins": 0.23,
    "water": 0.21,
    "dry_matter": 0.17,
}
"""Standard deviation of the logarithm of leaf traits within a species, and below their correlation:
what `fit_leaf_groups` learns of 107 leaves of 12 shrubs and oaks of California ("Fresh Leaf Spectra
to Estimate Leaf Traits for California Ecosystems", EcoSIS) of several ages, from reflectance alone.
Measured water and dry matter of these have medians over species of 0.24."""
_WITHIN_CORRELATION = np.array(
    [
        [1.00, -0.10, 0.22, 0.65, 0.34, 0.59],
        [-0.10, 1.00, 0.65, 0.16, 0.31, 0.19],
        [0.22, 0.65, 1.00, 0.33, 0.49, 0.44],
        [0.65, 0.16, 0.33, 1.00, 0.30, 0.56],
        [0.34, 0.31, 0.49, 0.30, 1.00, 0.52],
        [0.59, 0.19, 0.44, 0.56, 0.52, 1.00],
    ]
)


def drawn_leaves(
    leaves: Sequence[Sequence[LeafRow]], variants: int, seed: SupportsIndex
) -> list[tuple[LeafRow, ...]]:
    """The leaves of each species, where one is stated so many drawn about it.

    **Arguments:**

    - `leaves`: of each species, none of which states a spectrum.
    - `variants`: leaves of a species of which one is stated; 1 draws none.
    - `seed`: of the drawing.

    Traits are log-normal with the spread within species of Californian shrubs. Their mean is the
    leaf that is stated, and their number does not change how far they spread.
    """
    if variants == 1:
        return [tuple(own) for own in leaves]
    spread = np.array(list(_WITHIN_SPECIES.values()))
    root = np.linalg.cholesky(_WITHIN_CORRELATION * np.outer(spread, spread))
    drawn = []
    for i, own in enumerate(leaves):
        if len(own) > 1:
            drawn.append(tuple(own))
            continue
        normal = generator(seed, 113, i).normal(size=(variants, len(spread)))
        # Few draws about their own mean: unbiased as a variance is, whatever their number.
        normal = (normal - normal.mean(axis=0)) * np.sqrt(variants / (variants - 1.0))
        ratio = np.exp(normal @ root.T)
        # The mean of a log-normal is not its median: back to the stated leaf.
        ratio /= ratio.mean(axis=0)
        stated = np.array([getattr(own[0], name) for name in _WITHIN_SPECIES])
        drawn.append(
            tuple(
                own[0].replace(**dict(zip(_WITHIN_SPECIES, traits, strict=True)))
                for traits in (ratio * stated).tolist()
            )
        )
    return drawn


class Material(eqx.Module):
    """A material of the plants of a species, beside its leaf and the shipped bark and petals."""

    name: str = eqx.field(static=True)
    """Its name in the leaf table."""
    organ: int = eqx.field(static=True)
    """`Organ` of its facets."""
    share: float = eqx.field(static=True)
    """Part of the organ's area that is of it [-]."""
    number: int = eqx.field(static=True)
    """Place of its traits in `PlotParameters.materials`; of a stated spectrum its number among the
    different ones. Materials of one number have the same optics."""
    reflectance: Spectrum | None = None
    """Reflectance as it was stated; None: PROSPECT of its traits."""
    transmittance: Spectrum | None = None
    """Transmittance beside a stated reflectance; None: opaque."""


class Species(eqx.Module):
    """What is fixed about a species of a scene; the rest are its parameters."""

    taxon: str = eqx.field(static=True)
    """Name."""
    form: str = eqx.field(static=True)
    """Growth form, a key of `fynjax.canopy.FORMS`."""
    branches: float = eqx.field(static=True, default=1.0)
    """Copies of the plant model that make one plant [-]."""
    rotation_spread: float = eqx.field(static=True, default=0.0)
    """Standard deviation of the plants' lean [degrees]."""
    minimum_area: float = eqx.field(static=True, default=0.0)
    """Least ground area that a plant counts for [m2]."""
    leaf_angle: AbstractLeafAngle | None = None
    """Inclination of the leaves; None: as the form has it."""
    leaf_ratios: Float[Array, "leaf trait"] | None = None
    """Traits of its leaves (`LEAF_FIELDS`), of which each plant has one, over their mean [-]; None:
    all plants have the same leaf."""
    groups: float = eqx.field(static=True, default=0.0)
    """Radius of the groups in which its plants stand, 0 for none [m] (`fynjax.canopy.grouped`)."""
    materials: tuple[Material, ...] = ()
    """What else its plants are made of, as `PlantModel.material` counts it; those named "wood" and
    "flower" are all wood and flowers that are of no other."""

    @classmethod
    def of(
        cls, row: SpeciesRow, leaves: Sequence[LeafRow] = (), materials: tuple[Material, ...] = ()
    ) -> "Species":
        """The species of a `row` of a species table, with its `leaves`, none of which states a
        spectrum, where there are several, and its other `materials`."""
        ratios = None
        if len(leaves) > 1:
            traits = np.array([[getattr(leaf, name) for name in LEAF_FIELDS] for leaf in leaves])
            mean = traits.mean(axis=0)  # of traits that are 0 in all leaves the ratio is 1
            ratios = np.where(mean > 0.0, traits, 1.0) / np.where(mean > 0.0, mean, 1.0)
        return cls(
            row.taxon,
            row.growth_form,
            float(row.branches),
            row.rotation_spread,
            row.minimum_area,
            leaf_ratios=None if ratios is None else jnp.asarray(ratios),
            groups=row.groups,
            materials=materials,
        )

    @property
    def leaves(self) -> int:
        """Number of different leaves among its plants; 0 where all of these are of materials."""
        if self.share_without_material(Organ.LEAF) == 0.0:
            return 0
        return 1 if self.leaf_ratios is None else len(self.leaf_ratios)

    def share_without_material(self, organ: int) -> float:
        """Part of the area of an `organ` that is of no material: 0 where none is left [-]."""
        left = 1.0 - sum(one.share for one in self.materials if one.organ == organ)
        return left if left > 1e-6 else 0.0


def species_parameters(
    rows: Sequence[SpeciesRow],
    leaves: Sequence[Sequence[LeafRow]] = (),
    plants: Shrubland = "fynbos",
    shapes: Sequence[MeshPlant | None] = (),
) -> SpeciesParameters:
    """Parameters of species, with those of the growth form where a row states none.

    **Arguments:**

    - `rows`: one a species.
    - `leaves`: of each species; where one has several, there is a spread of leaves.
    - `plants`: whose values growth forms have.
    - `shapes`: meshes of the species that have one, whose leaves are inclined as they are.
    """

    def column(name: str) -> Any:
        stated = [getattr(row, name) for row in rows]
        return jnp.asarray(
            [
                FORMS[row.growth_form].value(name, plants) if s is None else s
                for s, row in zip(stated, rows, strict=True)
            ]
        )

    optional = ("leaf_spread", "leaf_angle")
    names = [name for name in parameters_of(SpeciesParameters) if name not in optional]
    several, as_stated = any(len(own) > 1 for own in leaves), _RECORDS["leaf_spread"].default
    assert as_stated is not None
    return SpeciesParameters(
        **{name: column(name) for name in names},
        leaf_spread=jnp.full(len(rows), as_stated) if several else None,
        leaf_angle=_leaf_angles(rows, shapes),
    )


def _leaf_angles(
    rows: Sequence[SpeciesRow], shapes: Sequence[MeshPlant | None]
) -> Float[Array, " species"] | None:
    """Mean inclination of the leaves of each species [degrees]; None where no row states one."""
    if all(row.leaf_angle is None for row in rows):
        return None
    means = []
    for row, shape in itertools.zip_longest(rows, shapes):
        own = None if shape is None else inclination(shape.plant)
        usual = leaf_angle(FORMS[row.growth_form].leaf_angle) if own is None else own
        if row.leaf_angle is None:
            means.append(float(usual.mean_angle))
            continue
        means.append(row.leaf_angle)
        if own is not None:
            _check_reached(row, own)
    return jnp.asarray(np.clip(means, _RECORDS["leaf_angle"].lower, _RECORDS["leaf_angle"].upper))


_NOT_REACHED = 0.5
"""Mean angles of a mesh's leaves that differ by more than this are others [degrees]."""


def _check_reached(row: SpeciesRow, own: AbstractLeafAngle) -> None:
    """Refuse a mean angle that the leaves of a mesh cannot have, as they lie in few directions."""
    record = _RECORDS["leaf_angle"]
    asked = jnp.asarray([row.leaf_angle, record.lower, record.upper])
    tilted = TiltedLeafAngle.to_means([own] * 3, asked)
    has, low, high = (float(angle.mean_angle) for angle in tilted)
    if abs(has - asked[0]) > _NOT_REACHED:
        raise InputError(
            f"expected a mean angle of the leaves of {row.taxon} that its mesh can have, from "
            f"{low:.0f} to {high:.0f} degrees, but got {row.leaf_angle:g}",
            column="leaf_angle_deg",
        )


def inclination(plant: PlantModel) -> AbstractLeafAngle | None:
    """How the leaves of a plant model are inclined; None if it has none."""
    leaf = np.asarray(plant.organ) == Organ.LEAF
    if not leaf.any():
        return None
    return TabulatedLeafAngle.from_normals(plant.normal[leaf], plant.area_fraction[leaf])


def leaf_parameters(leaves: Sequence[Sequence[LeafRow]]) -> LeafParameters:
    """PROSPECT parameters of the mean leaf of each species, vectors over these.

    **Arguments:** `leaves`, of each species, none of which states a spectrum.
    """
    return LeafParameters.many(
        **{
            name: np.array([np.mean([getattr(leaf, name) for leaf in own]) for own in leaves])
            for name in LEAF_FIELDS
        }
    )
