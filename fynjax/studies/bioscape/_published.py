"""The vegetation tables as BioSCape publishes them, with diameters, counts, heights, dead cover of
species and line intercepts (BioSCape-io/BioSCape-terrestrial, `ornl_daac/README.md`).
"""

import re
import sqlite3
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from fynjax._core.errors import InputError
from fynjax.app.io.text import check_geopackage, in_unit, read_rows
from fynjax.studies.bioscape._tables import (
    CoverRow,
    OptionalText,
    TableRow,
    find_table,
    needed_table,
    not_available,
    percent,
)

SUMMARY = "bioscape_veg_plot_summary_v*.csv", "a table of cover by plot"
SPECIES = "bioscape_veg_plot_species_v*.csv", "a table of species by plot"
QUADRATS = "bioscape_veg_quadrat_summary_v*.csv", "a table of cover by quadrant"
QUADRAT_SPECIES = "bioscape_veg_quadrat_species_v*.csv", "a table of species by quadrant"
INTERCEPTS = "bioscape_veg_line_intercepts_v*.csv", "a table of line intercepts"
PLACES = "bioscape_veg_spatial_v*.gpkg", "a GeoPackage of plot centres"

_MISSING = -9999.0
_OLDEST = 150.0
"""A larger number of years since fire is a date's serial number, or a year."""
_SMALLEST, _LARGEST = 1.0, 1000.0
"""Crown diameters of plants [cm]: the bounds of a plot's parameter."""


def _missing(value: Any) -> Any:
    value = not_available(value)
    try:
        return None if value is not None and float(value) == _MISSING else value
    except (TypeError, ValueError):
        return value


def _amount(description: str, unit: str, most: float | None = None) -> Any:
    return in_unit(unit, of=description, default=None, ge=0, le=most)


Amount = Annotated[float | None, BeforeValidator(_missing)]
"""A number, or -9999 where it is missing."""


class PublishedRow(TableRow):
    """A row of a published table. Its columns must be there, but cells may be empty."""

    plot: str = Field(description="Name of the plot.", min_length=1)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        cls.must_have = tuple(name for name in cls.model_fields if name != "genus_species_combo")


class SummaryRow(PublishedRow):
    """Cover and height of a plot."""

    unique = "plot"
    percent_bare_soil: Amount = percent("Bare soil", None)
    percent_bare_rock: Amount = percent("Bare rock", None)
    percent_dead_vegetation: Amount = percent("Dead vegetation", None)
    percent_live_vegetation: Amount = percent("Live vegetation", None)
    veg_height_mean_cm: Amount = _amount("Height of the vegetation", "cm", 2000)


class TaxonRow(PublishedRow):
    """A row about a taxon; `genus_species_combo` stands in where there is no genus."""

    accepted_genus: OptionalText = Field(default=None, description="Genus.")
    accepted_species: OptionalText = Field(default=None, description="Epithet.")
    genus_species_combo: OptionalText = Field(default=None, description="Both.")

    @property
    def taxon(self) -> str | None:
        """Name of the plant, of the genus alone where that is all; None without any."""
        name = self.genus_species_combo
        if self.accepted_genus is not None:
            name = f"{self.accepted_genus} {self.accepted_species or ''}"
        return None if name is None else " ".join(name.replace("_", " ").split())


class PlotSpeciesRow(TaxonRow):
    """A species of a plot."""

    percent_cover_alive: Amount = percent("Live cover", None)
    percent_cover_dead: Amount = percent("Dead cover", None)
    abundance_alive_count: Amount = _amount("Live plants counted", "-")
    mean_canopy_diameter_cm: Amount = _amount("Mean crown diameter", "cm", _LARGEST)
    clonal: OptionalText = Field(default=None, description="Whether it spreads by clones.")


class QuadratRow(PublishedRow):
    """Cover and age of a quadrant."""

    quadrant: str = Field(description="NE, NW, SE or SW.", min_length=1)
    total_cover_check: Amount = _amount("Sum of the covers", "%")
    post_fire_age_years: OptionalText = Field(default=None, description="Years since fire, text.")


class QuadratSpeciesRow(TaxonRow):
    """A species of a quadrant, as far as it is compared."""

    quadrant: str = Field(description="NE, NW, SE or SW.", min_length=1)


class InterceptRow(TaxonRow):
    """A point on a line across a plot, as it is seen from above."""

    line_transect: str = Field(description="NS or WE.", min_length=1)
    metres_along_line: str = Field(description="0L to 10R.", min_length=1)
    other_cover_type: OptionalText = Field(default=None, description="Bare, dead plant or other.")


_COVERS = {
    "percent_bare_soil": "PercentBareSoil",
    "percent_bare_rock": "PercentBareRock",
    "percent_dead_vegetation": "PercentDeadVegetation",
    "percent_live_vegetation": "PercentLiveVegetation",
}
_BARE = ("bare soil", "bare rock", "bare soil and rock")
_DEAD = "dead plant"


@dataclass(frozen=True)
class Remark:
    """Something odd in a table, and how it was read."""

    file: str
    row: int | None
    """Line of the file; None where it is about all of it."""
    plot: str
    what: str
    """Sentence on what is odd and how it was read."""


@dataclass(frozen=True)
class SpeciesNote:
    """Notes of the tables on a species of a plot; None where they have none."""

    where: str
    """File and row that name the species."""
    cover: float
    """Live cover [-]."""
    family: str | None = None
    dead_cover: float | None = None
    """Dead cover [-]."""
    diameter: float | None = None
    """Mean crown diameter [m]."""
    counted: float | None = None
    """Live plants in the plot."""
    clonal: bool = False


@dataclass(frozen=True)
class ViewFromAbove:
    """Points of a plot's line intercepts, by what shows there from above."""

    live: dict[str, int]
    """Points on live plants of each taxon."""
    dead: int
    bare: int
    other: int

    @property
    def points(self) -> int:
        """All points."""
        return sum(self.live.values()) + self.dead + self.bare + self.other

    def share(self, points: int) -> tuple[float, float]:
        """Share of the points [-] and its standard error, of points that are independent."""
        share = points / self.points
        return share, (share * (1.0 - share) / self.points) ** 0.5


@dataclass(frozen=True)
class Visit:
    """Where a plot is and when the spectrometer flew over it."""

    longitude: float
    """Longitude of the plot, WGS84 [degree]."""
    latitude: float
    """Latitude of the plot, WGS84 [degree]."""
    times: tuple[str, ...]
    """Start of each flight line, ISO 8601, in order."""
    remark: str
    """Remark of the crew, or ''."""


@dataclass
class FieldTables:
    """Field tables, plot by plot; those of the older extract end after `listed`."""

    summary: Path
    species: Path
    cover: dict[str, tuple[int, CoverRow]] = field(default_factory=dict)
    """Row and covers of each plot."""
    listed: dict[str, dict[str, SpeciesNote]] = field(default_factory=dict)
    """Species of each plot, by plot and taxon."""
    named: set[str] = field(default_factory=set)
    """Plots with a row, with covers or without."""
    height: dict[str, float] = field(default_factory=dict)
    """Mean height of the vegetation of each plot [m]."""
    age: dict[str, float] = field(default_factory=dict)
    """Years since fire, mean of the quadrants that state a number."""
    view: dict[str, ViewFromAbove] = field(default_factory=dict)
    """Line intercepts of each plot."""
    place: dict[str, Visit] = field(default_factory=dict)
    """Centres of the plots, without flights."""
    remarks: list[Remark] = field(default_factory=list)
    """Oddities of the tables, and how it was read."""

    def remark(self, path: Path, row: int | None, plot: str, what: str) -> None:
        """Note that something is odd."""
        self.remarks.append(Remark(path.name, row, plot, what))


def is_published(folder: Path) -> bool:
    """Whether a folder has the published tables."""
    return find_table(folder, SUMMARY) is not None or find_table(folder, SPECIES) is not None


def read_published(folder: Path) -> FieldTables:
    """Read the published tables of a folder; those of quadrants, intercepts and places if there.

    **Raises:** `InputError` for a missing table or column, two versions of one table, and a value
    that is no number or out of range. Anything else that is odd becomes a `Remark`.
    """
    tables = FieldTables(needed_table(folder, SUMMARY), needed_table(folder, SPECIES))
    _read_summary(tables)
    _read_species(tables)
    if (path := find_table(folder, QUADRATS)) is not None:
        _read_quadrats(tables, path)
    if (path := find_table(folder, QUADRAT_SPECIES)) is not None:
        _compare_quadrat_species(tables, path)
    if (path := find_table(folder, INTERCEPTS)) is not None:
        _read_intercepts(tables, path)
    if (path := find_table(folder, PLACES)) is not None:
        tables.place = _read_places(path)
    return tables


def _read_summary(tables: FieldTables) -> None:
    path = tables.summary
    remark = partial(tables.remark, path)
    for where, row in read_rows(path, SummaryRow, SUMMARY[1]):
        tables.named.add(row.plot)
        covers = {new: getattr(row, old) for old, new in _COVERS.items()}
        if None in covers.values():
            continue
        tables.cover[row.plot] = where, CoverRow(Plot=row.plot, **covers)
        if row.veg_height_mean_cm:
            tables.height[row.plot] = row.veg_height_mean_cm / 100.0
        else:
            remark(where, row.plot, "no height: heights are those of growth forms")


def _read_species(tables: FieldTables) -> None:
    path = tables.species
    remark = partial(tables.remark, path)
    rows: dict[tuple[str, str], list[tuple[int, PlotSpeciesRow]]] = {}
    for where, row in read_rows(path, PlotSpeciesRow, SPECIES[1]):
        taxon = row.taxon
        if taxon is None:
            raise InputError(
                "expected accepted_genus or genus_species_combo, but both are empty",
                file=path,
                row=where,
                column="accepted_genus",
            )
        if row.percent_cover_alive is None:
            remark(where, row.plot, f"no live cover of {taxon}: left out")
        elif row.percent_cover_alive + (row.percent_cover_dead or 0.0) == 0:
            remark(where, row.plot, f"no cover of {taxon}, live or dead: left out")
        else:
            rows.setdefault((row.plot, taxon), []).append((where, row))
    for (plot, taxon), several in rows.items():
        if len(several) > 1:
            numbers = " and ".join(str(where) for where, _ in several)
            remark(several[-1][0], plot, f"{taxon} in rows {numbers}: covers and counts added")
        note = _species_note(path, several)
        sizes = [row.mean_canopy_diameter_cm for _, row in several]
        if note.diameter is None:
            remark(several[0][0], plot, f"no diameter of {taxon}: that of its growth form")
        elif any(0 < (size or 0.0) < _SMALLEST for size in sizes):
            remark(several[0][0], plot, f"diameter of {taxon} below {_SMALLEST:g} cm: read as that")
        tables.listed.setdefault(plot, {})[taxon] = note
    # Shares of the live cover are those of no plot without any.
    tables.listed = {
        plot: notes
        for plot, notes in tables.listed.items()
        if any(note.cover > 0 for note in notes.values())
    }


def _species_note(path: Path, several: list[tuple[int, PlotSpeciesRow]]) -> SpeciesNote:
    """The rows of one species on one plot as one: covers and counts added, the diameter a mean
    by cover."""
    rows = [row for _, row in several]

    def total(name: str) -> float | None:
        values = [value for row in rows if (value := getattr(row, name)) is not None]
        return sum(values) if values else None

    sizes = [
        ((row.percent_cover_alive or 0.0) + (row.percent_cover_dead or 0.0), size)
        for row in rows
        if (size := row.mean_canopy_diameter_cm)
    ]
    weight = sum(cover for cover, _ in sizes)
    diameter = sum(cover * size for cover, size in sizes) / weight if weight else None
    dead = total("percent_cover_dead")
    return SpeciesNote(
        where=f"{path.name}, row {', '.join(str(where) for where, _ in several)}",
        cover=(total("percent_cover_alive") or 0.0) / 100.0,
        dead_cover=None if dead is None else dead / 100.0,
        diameter=None if diameter is None else max(diameter, _SMALLEST) / 100.0,
        counted=total("abundance_alive_count"),
        clonal=any((row.clonal or "").lower() in ("yes", "y", "true", "1") for row in rows),
    )


def _read_quadrats(tables: FieldTables, path: Path) -> None:
    remark = partial(tables.remark, path)
    ages: dict[str, list[float]] = {}
    for where, row in read_rows(path, QuadratRow, QUADRATS[1]):
        total = row.total_cover_check
        if total is not None and abs(total - 100.0) > 1.0:
            remark(where, row.plot, f"covers of {row.quadrant} sum to {total:g} %: kept as noted")
        text = row.post_fire_age_years
        if text is None or _missing(text) is None:
            continue
        age = float(text) if re.fullmatch(r"\d+(\.\d*)?", text) else None
        if age is None or age > _OLDEST:
            remark(where, row.plot, f"years since fire are {text!r}, no number of years: left out")
        else:
            ages.setdefault(row.plot, []).append(age)
    tables.age = {plot: sum(values) / len(values) for plot, values in ages.items()}


def _compare_quadrat_species(tables: FieldTables, path: Path) -> None:
    """The plot's table holds the sums over the quadrants: a row that is there twice may count
    twice in them."""
    remark = partial(tables.remark, path)
    first: dict[tuple[str, str, str], int] = {}
    for where, row in read_rows(path, QuadratSpeciesRow, QUADRAT_SPECIES[1]):
        taxon = row.taxon
        key = row.plot, row.quadrant, taxon or ""
        if taxon is not None and key in first:
            remark(
                where,
                row.plot,
                f"{taxon} of {row.quadrant} also in row {first[key]}: its sum over the plot is "
                "taken as published",
            )
        first.setdefault(key, where)


def _read_intercepts(tables: FieldTables, path: Path) -> None:
    remark = partial(tables.remark, path)
    points: dict[str, list[tuple[int, InterceptRow]]] = {}
    for where, row in read_rows(path, InterceptRow, INTERCEPTS[1]):
        points.setdefault(row.plot, []).append((where, row))
    for plot, rows in points.items():
        first: set[tuple[str, str]] = set()
        repeated = 0
        live: Counter[str] = Counter()
        kinds: Counter[str] = Counter()
        for where, row in rows:
            place = row.line_transect, row.metres_along_line
            repeated += place in first
            first.add(place)
            other, taxon = (row.other_cover_type or "").lower(), row.taxon
            if other == _DEAD:
                kinds["dead"] += 1
            elif other in _BARE:
                kinds["bare"] += 1
            elif taxon is not None:
                live[taxon] += 1
            elif other:
                kinds["other"] += 1
                if other != "other":
                    remark(where, plot, f"{row.other_cover_type!r} counts as other")
            else:
                remark(where, plot, "a point with neither plant nor cover: left out")
        if repeated:
            remark(None, plot, f"{repeated} of {len(rows)} points on places that are there twice")
        if live or kinds:
            tables.view[plot] = ViewFromAbove(
                dict(live), kinds["dead"], kinds["bare"], kinds["other"]
            )
    for plot in tables.cover:
        if plot not in tables.view:
            remark(None, plot, "no line intercepts")


_PLACE_COLUMNS = ("bioscape_plot_id", "townsend_long", "townsend_lat", "quality_flag")


def _read_places(path: Path) -> dict[str, Visit]:
    """Centres of the plots from the layer `plot_centers` of a GeoPackage, which is SQLite."""
    check_geopackage(path)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            columns = [row[1] for row in base.execute("PRAGMA table_info(plot_centers)")]
            if lacking := [name for name in _PLACE_COLUMNS if name not in columns]:
                raise InputError(
                    f"expected a layer plot_centers with {', '.join(_PLACE_COLUMNS)}, but "
                    f"{', '.join(lacking)} is missing",
                    file=path,
                )
            rows = base.execute(f"SELECT {', '.join(_PLACE_COLUMNS)} FROM plot_centers").fetchall()
    except sqlite3.DatabaseError as error:
        raise InputError(f"expected a GeoPackage (SQLite), but: {error}", file=path) from error
    return {
        str(plot): Visit(float(x), float(y), (), "" if not_available(flag) is None else str(flag))
        for plot, x, y, flag in rows
        if _on_earth((x, 180.0), (y, 90.0))
    }


def _on_earth(*values: tuple[Any, float]) -> bool:
    return all(isinstance(v, int | float) and abs(v) <= most for v, most in values)
