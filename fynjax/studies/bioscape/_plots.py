"""Plots from the field tables of BioSCape: cover of species and ground, traits, flights."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fynjax._core.errors import InputError
from fynjax.app.io.text import did_you_mean, existing_file, read_rows
from fynjax.studies.bioscape._assumed import (
    DOME,
    OPEN_GROUND_LITTER,
    STANDING_DEAD,
    PlantShape,
    PlantSize,
    plant_shape,
    plant_size,
    random_packing,
)
from fynjax.studies.bioscape._published import (
    FieldTables,
    Remark,
    SpeciesNote,
    ViewFromAbove,
    Visit,
    is_published,
    read_published,
)
from fynjax.studies.bioscape._tables import (
    COVER,
    SPECIES,
    TRAITS,
    VISITS,
    CoverRow,
    SpeciesCoverRow,
    TraitRow,
    VisitRow,
    find_table,
    flight_time,
    needed_table,
)
from fynjax.studies.bioscape._traits import Sourced, TraitLibrary, split_name

FORM_DEFAULT = "growth form default"
"""Source of a number that the tables do not state."""

MEAN_STATURE = 0.8
"""Mean height of planted plants over the greatest [-]: heights lie evenly between 0.6 and 1."""

_TOLERANCE = 1.0
"""Covers of a plot may miss their sum by this [%]: crews round."""


@dataclass(frozen=True)
class BioscapeSpecies:
    """One species of a plot."""

    taxon: str
    family: str
    """Family of the species, '' if unknown."""
    cover: float
    """Live cover as noted, a share of the plot [-]."""
    shape: PlantShape
    """Growth form and shape of the leaves, by genus or family."""
    size: PlantSize
    """Crown diameter and height, by growth form."""
    traits: dict[str, Sourced]
    """`leaf_mass_per_area` [g per m2 of projected area] and `water_content` [% of fresh mass],
    always; `nitrogen` and `carbon` [mg g-1] where the library has them."""
    library_name: str | None
    """Name of the species in the trait library, `None` if it is not there."""
    note: SpeciesNote
    """Note of the field tables on the species."""
    size_source: tuple[str, str] = (FORM_DEFAULT, FORM_DEFAULT)
    """Sources of the crown diameter and of the height."""

    @property
    def crown_cover(self) -> float:
        """Cover of its crowns, live and dead [-]."""
        return self.cover + (self.note.dead_cover or 0.0)

    def dead_fraction(self, usual: float) -> float:
        """Share of its shoots that is dead tissue [-]; `usual`, that of its growth form [-], where
        the tables state no dead cover.

        Dead cover is dead altogether; what the crew notes as live cover has the dead tissue in
        its shoots that the growth form has.
        """
        if self.note.dead_cover is None:
            return usual
        return 1.0 - (1.0 - usual) * self.cover / self.crown_cover


@dataclass(frozen=True)
class BioscapePlot:
    """One plot as its tables describe it. Covers are shares of the plot [-]."""

    name: str
    live: float
    """Live vegetation, seen from above [-]."""
    dead: float
    """Dead vegetation [-]: litter and standing dead, which the tables do not separate."""
    soil: float
    """Bare soil [-]."""
    rock: float
    """Bare rock [-]."""
    species: tuple[BioscapeSpecies, ...]
    """Species as listed; the crews list those of 5 % and more."""
    visit: Visit | None
    """`None` where no table of spectra or of places names the plot."""
    height: float | None = None
    """Mean height of the vegetation [m], where the tables state it."""
    age: float | None = None
    """Years since fire, where the tables state them."""
    view: ViewFromAbove | None = None
    """Line intercepts, where there are any."""
    remarks: tuple[Remark, ...] = ()
    """Oddities of the plot's rows, and how it was read."""
    published: bool = False
    """Whether it is from the published tables, which have counts and line intercepts."""

    @property
    def listed_cover(self) -> float:
        """Sum of the species' covers [-]; more than `live` where layers overlap."""
        return sum(s.cover for s in self.species)

    @property
    def other_cover(self) -> float:
        """Live cover of species too rare to be listed [-]."""
        return max(0.0, self.live - self.listed_cover)

    @property
    def dead_in_crowns(self) -> float:
        """Dead cover of the listed species [-], as far as the plot's dead cover and what live
        cover leaves free allow: what it covers from above."""
        noted = sum(s.note.dead_cover or 0.0 for s in self.species)
        return max(0.0, min(noted, self.dead, 1.0 - self.live))

    @property
    def standing_dead(self) -> float:
        """Cover of dead plants that stand between the live ones [-], by `STANDING_DEAD`. Dead
        cover that exceeds what the live leaves free is under them. 0 where the tables state the
        dead cover of species, which then is in their crowns."""
        if any(s.note.dead_cover is not None for s in self.species):
            return 0.0
        return STANDING_DEAD * max(0.0, min(self.dead, 1.0 - self.live))

    @property
    def packing(self) -> float:
        """Share of a crown over other crowns [-] with which all crowns cover what is live or
        stands dead."""
        crowns = sum(s.crown_cover for s in self.species) + self.other_cover + self.standing_dead
        return random_packing(crowns, self.live + self.dead_in_crowns + self.standing_dead)

    @property
    def height_factor(self) -> float:
        """Measured height of the vegetation over that of its crowns by growth form [-]."""
        if self.height is None:
            return 1.0
        crowns = [(s.crown_cover, plant_size(s.family, s.shape.growth_form)) for s in self.species]
        if self.other_cover > 0:
            crowns.append((self.other_cover, plant_size("", DOME)))
        mean = sum(c * s.height_m for c, s in crowns) / sum(c for c, _ in crowns)
        return self.height / (MEAN_STATURE * mean)

    @property
    def litter_fraction(self) -> float:
        """Share of the ground under litter [-]: dead cover that does not stand, over it and bare
        cover."""
        litter = self.dead - self.standing_dead - self.dead_in_crowns
        ground = litter + self.soil + self.rock
        return litter / ground if ground > 0 else OPEN_GROUND_LITTER

    @property
    def dominant(self) -> BioscapeSpecies:
        """The species with the largest cover."""
        return max(self.species, key=lambda s: s.cover)

    def trait_shares(self) -> dict[str, float]:
        """Share of the listed cover for each source of leaf mass per area [-]."""
        shares: dict[str, float] = {}
        for s in self.species:
            source = s.traits["leaf_mass_per_area"].source
            shares[source] = shares.get(source, 0.0) + s.cover / self.listed_cover
        return shares

    def weighted_mean(self, trait: str) -> float | None:
        """Mean of a trait over the species that have it, weighted with cover."""
        pairs = [(s.cover, s.traits[trait].value) for s in self.species if trait in s.traits]
        total = sum(cover for cover, _ in pairs)
        return sum(cover * value for cover, value in pairs) / total if pairs else None


def read_bioscape(
    folder: str | Path, plots: Sequence[str] | None = None, *, traits: str | Path | None = None
) -> list[BioscapePlot]:
    """Read the plots of a folder of BioSCape's field tables, in either of two forms.

    The tables as published, `bioscape_veg_*_vYYYYMMDD`: `plot_summary` and `plot_species`, and if
    they are there `quadrat_summary`, `quadrat_species`, `line_intercepts` (CSV) and `spatial`
    (GeoPackage). They hold crown diameters, counts, dead cover of species and the height of the
    vegetation, which are then taken from them: heights are those of the growth forms times one
    factor, so that their mean over the crowns is the vegetation's; dead cover of a species is dead
    tissue of its crowns. What is odd in them is in `BioscapePlot.remarks`.

    Or the older extract of 24 plots (doi:10.5281/zenodo.14198989), without these.

    **Arguments:**

    - `folder`: of the published tables, with a `*TraitLibrary.csv`; or has a file `*CoverData.csv`
      (cover of live and dead vegetation, soil and rock by plot, %), `*VegData.csv` (live cover by
      species and plot, %), `*TraitLibrary.csv` (mean nitrogen, carbon [mg/g], leaf mass per area
      [g/m2] and water content [%] by species) and perhaps `*VegCenters.csv` (place and flight times
      by plot). Other columns are skipped, and columns may stand in any order.
    - `plots`: names of the plots to read; all if left out.
    - `traits`: trait library, if it is not in the folder.

    **Returns:** plots in the order of the cover table; of the published tables those with all
    covers and a live species. A trait of a species without a measured
    value is the mean of its genus, else family, else growth form in the library.

    **Raises:** `InputError` for a missing file, column or plot, a value that is no number or
    out of range, rows that are there twice, a plot without species, and one whose name cannot be
    that of a folder. Warns where covers do not sum to 100 %, and where a name is read as another.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("expected a folder with BioSCape's tables, but there is none", file=folder)
    if published := is_published(folder):
        tables = read_published(folder)
    else:
        cover_path, species_path = needed_table(folder, COVER), needed_table(folder, SPECIES)
        covers = {row.Plot: (at, row) for at, row in read_rows(cover_path, CoverRow, COVER[1])}
        rows = read_rows(species_path, SpeciesCoverRow, SPECIES[1])
        listed = _species_by_plot(rows, species_path)
        tables = FieldTables(cover_path, species_path, covers, listed, set(covers))
    trait_path = (
        needed_table(folder, TRAITS) if traits is None else existing_file(traits, TRAITS[1])
    )
    library = TraitLibrary(read_rows(trait_path, TraitRow, TRAITS[1]), trait_path)
    visit_path = find_table(folder, VISITS)
    visits = tables.place | ({} if visit_path is None else _visits(visit_path))

    column = "plot" if published else "Plot"
    if plots is None:
        plots = _every_plot(tables, column, published)
    read = []
    for name in dict.fromkeys(plots):
        if name not in tables.cover:
            raise InputError(
                f"expected a row with covers for plot {name!r}, but there is none."
                f"{did_you_mean(name, tables.cover)}",
                file=tables.summary,
                column=column,
            )
        if name not in tables.listed:
            raise InputError(
                f"expected live species of plot {name!r} in {tables.species.name}, but there is "
                "none. Without species there is nothing to plant.",
                file=tables.summary,
                row=tables.cover[name][0],
                column=column,
            )
        plot = _plot(name, tables, library, visits.get(name))
        read.append(replace(plot, published=published))
    if not read:
        raise InputError("expected a plot with covers and species, but there is none", file=folder)
    for plot in read:
        if not plot.name.replace("-", "").replace("_", "").isalnum():
            raise InputError(
                f"expected a plot named by letters, digits, - and _, but got {plot.name!r}: a "
                "folder is named after it",
                file=folder,
                column=column,
            )
    return read


def _every_plot(tables: FieldTables, column: str, published: bool) -> list[str]:
    """The plots that have covers and species; those of the published tables may lack either."""
    if strange := [name for name in tables.listed if name not in tables.named]:
        raise InputError(
            f"expected a row for plot {strange[0]!r}, which {tables.species.name} has, but there "
            f"is none.{did_you_mean(strange[0], tables.cover)}",
            file=tables.summary,
            column=column,
        )
    if not published:
        return list(tables.cover)
    plots = [name for name in tables.cover if name in tables.listed]
    if lacking := sorted(tables.named - set(plots)):  # not surveyed to their end
        warnings.warn(
            f"{tables.summary}: plots without covers or live species are left out: "
            f"{', '.join(lacking)}",
            stacklevel=3,
        )
    return plots


def _plot(
    name: str, tables: FieldTables, library: TraitLibrary, visit: Visit | None
) -> BioscapePlot:
    where, row = tables.cover[name]
    bare = row.PercentBareSoil + row.PercentBareRock
    total = bare + row.PercentDeadVegetation + row.PercentLiveVegetation
    if abs(total - 100) > _TOLERANCE:
        reading = (
            "what is too much is read as dead vegetation under live vegetation"
            if total > 100
            else "what is missing is read as ground like the rest"
        )
        warnings.warn(
            f"{tables.summary}, row {where}: the covers of plot {name!r} sum to {total:g} %, not "
            f"100 %; {reading}.",
            stacklevel=3,
        )
        tables.remark(tables.summary, where, name, f"covers sum to {total:g} %; {reading}")
    species = []
    for taxon, noted in tables.listed[name].items():
        genus = split_name(taxon)[0]
        family = noted.family or library.family(genus)
        traits, library_name = library.lookup(taxon, family)
        shape = plant_shape(split_name(library_name or taxon)[0], family)
        species.append(
            BioscapeSpecies(
                taxon=taxon,
                family=family,
                cover=noted.cover,
                shape=shape,
                size=plant_size(family, shape.growth_form),
                traits=traits,
                library_name=library_name,
                note=noted,
            )
        )
    plot = BioscapePlot(
        name=name,
        live=row.PercentLiveVegetation / 100,
        dead=row.PercentDeadVegetation / 100,
        soil=row.PercentBareSoil / 100,
        rock=row.PercentBareRock / 100,
        species=tuple(species),
        visit=visit,
        height=tables.height.get(name),
        age=tables.age.get(name),
        view=tables.view.get(name),
        remarks=tuple(remark for remark in tables.remarks if remark.plot == name),
    )
    return replace(plot, species=tuple(_sized(s, plot) for s in species))


def _sized(species: BioscapeSpecies, plot: BioscapePlot) -> BioscapeSpecies:
    """With the sizes that the tables state in place of the growth form's."""
    size, noted = species.size, species.note.diameter
    height = FORM_DEFAULT if plot.height is None else "vegetation height, by growth form"
    sized = replace(
        size,
        crown_diameter_m=size.crown_diameter_m if noted is None else noted,
        height_m=size.height_m * plot.height_factor,
    )
    source = FORM_DEFAULT if noted is None else "measured", height
    return replace(species, size=sized, size_source=source)


def _species_by_plot(
    rows: list[tuple[int, SpeciesCoverRow]], path: Path
) -> dict[str, dict[str, SpeciesNote]]:
    """Species of each plot. Rows that differ only in the family are the same row, joined twice."""
    if len(rows) > 1 and max(row.PercentCoverAlive for _, row in rows) <= 1:
        raise InputError(
            "expected covers in percent, but none is over 1. Are these fractions?",
            file=path,
            column="PercentCoverAlive",
        )
    plots: dict[str, dict[str, SpeciesCoverRow]] = {}
    row_of: dict[tuple[str, str], int] = {}
    for where, row in rows:
        taxon = " ".join(row.GenusSpecies.replace("_", " ").split())
        before = plots.setdefault(row.Plot, {}).get(taxon)
        if before is None:
            plots[row.Plot][taxon], row_of[row.Plot, taxon] = row, where
            continue
        first = row_of[row.Plot, taxon]
        if before.Family == row.Family or before.PercentCoverAlive != row.PercentCoverAlive:
            raise InputError(
                f"{taxon!r} of plot {row.Plot!r} is there twice, first in row {first}. Add the "
                "covers up, or leave one out.",
                file=path,
                row=where,
                column="GenusSpecies",
            )
        warnings.warn(
            f"{path}: rows {first} and {where} give {taxon!r} of plot {row.Plot!r} the same cover "
            f"and two families, {before.Family} and {row.Family}; it is counted once.",
            stacklevel=4,
        )
    return {
        plot: {
            taxon: SpeciesNote(
                f"{path.name}, row {row_of[plot, taxon]}", row.PercentCoverAlive / 100, row.Family
            )
            for taxon, row in taxa.items()
        }
        for plot, taxa in plots.items()
    }


def _visits(path: Path) -> dict[str, Visit]:
    grouped: dict[str, list[VisitRow]] = {}
    for where, row in read_rows(path, VisitRow, VISITS[1]):
        flight_time(row.start_time, path, where)
        grouped.setdefault(row.BScpPID, []).append(row)
    return {
        name: Visit(
            longitude=sum(r.X for r in rows) / len(rows),
            latitude=sum(r.Y for r in rows) / len(rows),
            times=tuple(sorted({r.start_time for r in rows})),
            remark="; ".join(sorted({r.QltyFlg for r in rows if r.QltyFlg})),
        )
        for name, rows in grouped.items()
    }
