"""Plot files from the field tables of BioSCape: what `fynjax bioscape plots` writes."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from fynjax._core.dry_run import begin_work
from fynjax._core.precision import double_precision
from fynjax.app.io.plot import (
    DEFAULT_PRIOR,
    LearnedPrior,
    Plot,
    leaf_factors,
    read_plot,
    read_prior,
)
from fynjax.app.io.text import rows_text, write_text
from fynjax.app.jobs import JobResult, Run
from fynjax.canopy import instance_area, soft_count, target_area
from fynjax.leaf import structure_from_dry_matter
from fynjax.scene import LEAF_FIELDS, PARAMETERS
from fynjax.sensors import sun_position
from fynjax.studies.bioscape._assumed import (
    ASSUMED_POPULATION,
    CLOSED_COVER,
    DOME,
    MOST_WATER,
    PLOT_SIDE_M,
    pigments,
    plant_size,
)
from fynjax.studies.bioscape._plots import (
    FORM_DEFAULT,
    BioscapePlot,
    BioscapeSpecies,
    Visit,
    read_bioscape,
)
from fynjax.studies.bioscape._traits import SOURCES

OTHER = "Other species"
"""Taxon of the live cover that no listed species makes up."""

DEAD = "Standing dead plants"
"""Taxon of the dead cover that stands: bare stems, as large as the dominant species, with the
measured spectrum of bark. PROSPECT is no model of dead culms and stems."""

CIRCLE_M2 = math.pi / 4.0 * PLOT_SIDE_M**2
"""Area in which the crew counted: the circle [m2]."""

_TRAIT_UNITS = {
    "leaf_mass_per_area": "g m-2 projected", "water_content": "% of fresh mass",
    "nitrogen": "mg g-1", "carbon": "mg g-1",
}  # fmt: skip
_FROM_MASS = "from leaf mass per area"
_MOST = {"water": MOST_WATER, "dry_matter": PARAMETERS["dry_matter"].upper}


def _per_area(species: BioscapeSpecies) -> dict[str, float]:
    """Water [cm] and dry matter [g cm-2] of a species' leaf per half of its surface."""
    dry = species.traits["leaf_mass_per_area"].value / species.shape.area_ratio / 1e4
    wet = species.traits["water_content"].value / 100.0
    return {"water": dry * wet / (1.0 - wet), "dry_matter": dry}


def leaf_parameters(
    species: BioscapeSpecies, population: Mapping[str, float] = ASSUMED_POPULATION
) -> dict[str, float]:
    """PROSPECT-D parameters of a species' leaf, in PROSPECT's units, per half of its surface.

    Dry matter is the leaf mass per projected area over the shape's `area_ratio`; water is that
    times w / (1 - w), with w the share of water in the fresh mass (1 g of water is 1 cm3). Values
    above what PROSPECT can mean, of culms and succulents, are cut to that: `beyond_prospect` names
    them. Structure follows from dry matter, pigments are those of the growth form. All are then
    times the factors of the `population` (`LearnedPrior.values`).
    """
    mass = {name: min(value, _MOST[name]) for name, value in _per_area(species).items()}
    structure = float(structure_from_dry_matter(mass["dry_matter"]))
    leaf = {"structure": structure} | pigments(species.shape.growth_form) | mass
    scaled = leaf | {n: leaf[n] * factor for n, factor in leaf_factors(population).items()}
    return {n: min(max(v, PARAMETERS[n].lower), PARAMETERS[n].upper) for n, v in scaled.items()}


def beyond_prospect(species: BioscapeSpecies) -> dict[str, float]:
    """Values above what PROSPECT can mean, which `leaf_parameters` cuts, by parameter."""
    return {n: v for n, v in _per_area(species).items() if v > _MOST[n]}


def mean_leaf(plot: BioscapePlot, population: Mapping[str, float]) -> dict[str, float]:
    """Leaf of the species that are not listed: the mean of those listed, weighted with cover."""
    leaves = [(s.cover / plot.listed_cover, leaf_parameters(s, population)) for s in plot.species]
    return {name: sum(share * leaf[name] for share, leaf in leaves) for name in LEAF_FIELDS}


@double_precision
def write_plot_files(
    plot: BioscapePlot, folder: str | Path, prior: LearnedPrior | None = None
) -> None:
    """Write a plot as `plot.toml`, `species.csv`, `leaves.csv` and `sources.csv` into a folder.

    `fynjax render` takes `plot.toml`. `sources.csv` has every number with its source: measured, the
    mean of related species, or assumed.

    **Arguments:**

    - `plot`: as read by `read_bioscape`.
    - `folder`: its files of these names are replaced.
    - `prior`: learned population, of which dead tissue, leaf areas, brightness and factors on the
      leaves are taken: those learned from other plots, if it was learned from this one too. None:
      what is assumed before any population is learned.
    """
    folder = Path(folder)
    population = ASSUMED_POPULATION if prior is None else prior.values(plot.name)
    write_text(folder / "plot.toml", _plot_toml(plot, population, prior is not None))
    write_text(folder / "species.csv", _species_csv(plot, population))
    write_text(folder / "leaves.csv", _leaves_csv(plot, population))
    header = ("taxon", "quantity", "value", "unit", "source", "note")
    write_text(folder / "sources.csv", _table([header, *_sources(plot, population, prior)]))


def _table(rows: Iterable[Sequence[object]]) -> str:
    return rows_text([f"{c:.6g}" if isinstance(c, float) else c for c in row] for row in rows)


def flights(visit: Visit | None) -> list[tuple[str, float, float]]:
    """Time of each flight with the sun's zenith angle and azimuth [degree], highest sun first."""
    if visit is None:
        return []
    times = []
    for text in visit.times:
        time = datetime.fromisoformat(text)
        sun = sun_position(visit.latitude, visit.longitude, time.replace(tzinfo=time.tzinfo or UTC))
        times.append((text, sun.zenith, sun.azimuth))
    return sorted(times, key=lambda flight: flight[1])


def _plot_toml(plot: BioscapePlot, population: Mapping[str, float], learned: bool) -> str:
    flown = flights(plot.visit)
    up = [flight for flight in flown if flight[1] < 80.0]
    if plot.visit is None:
        place = ["# Place and date: not in the tables."]
    else:
        place = [
            f"# latitude_deg = {plot.visit.latitude:.6f}",
            f"# longitude_deg = {plot.visit.longitude:.6f}",
            *(f"# flown {t}: sun at zenith {z:.1f}, azimuth {a:.1f}" for t, z, a in flown),
            *([f"# The crew's remark: {plot.visit.remark}"] if plot.visit.remark else []),
        ]
    if up:
        _, zenith, azimuth = up[len(up) // 2]
        sun = [
            "# Of the flight in the middle, by height of the sun.",
            f"zenith_deg = {zenith:.2f}",
            f"azimuth_deg = {azimuth:.2f}",
        ]
    else:
        sun = ["# Assumed.", "zenith_deg = 30.0", "azimuth_deg = 0.0"]
    source = "learned from many plots" if learned else "assumed"
    lines = [
        f"# BioSCape vegetation plot {plot.name}, Greater Cape Floristic Region (field tables:",
        "# doi:10.5281/zenodo.14198989). sources.csv says where each number of a species is from.",
        "# Cover seen from above, in % of the plot:",
        f"#   live {plot.live * 100:g}, dead {plot.dead * 100:g}, bare soil {plot.soil * 100:g}, "
        f"bare rock {plot.rock * 100:g}",
        *_field_notes(plot),
        "",
        "[plot]",
        f"name = {json.dumps(plot.name, ensure_ascii=False)}",
        f"size_m = {PLOT_SIDE_M}  # a square instead of the circle of this diameter",
        "voxel_m = 0.1  # assumed",
        'species_table = "species.csv"',
        'cover_definition = "article"  # with packing_percent: all crowns together cover what is '
        "live",
        'leaf_table = "leaves.csv"',
        *place,
        "",
        "[sun]",
        *sun,
        "",
        "[ground]",
        'soil = "dry"  # assumed; rock is taken to be as bright',
        f"brightness = {population['soil_brightness']:.4f}  # {source}",
        f"wood_brightness = {population['wood_brightness']:.4f}  # {source}",
        f"litter_fraction = {plot.litter_fraction:.4f}  # dead over dead and bare cover, without "
        "the dead that stands",
        f"# rock_fraction = {plot.rock:.4f}",
        "",
    ]
    return "\n".join(lines)


def _field_notes(plot: BioscapePlot) -> list[str]:
    notes = []
    if plot.height is not None:
        notes.append(f"# Vegetation is {plot.height:.3g} m high.")
    if plot.age is not None:
        notes.append(f"# Burnt {plot.age:.3g} years before.")
    if plot.view is not None:
        shares = ", ".join(
            f"{word} {100 * plot.view.share(count)[0]:.0f}"
            for word, count in (
                ("live", sum(plot.view.live.values())),
                ("dead", plot.view.dead),
                ("bare", plot.view.bare),
            )
        )
        notes.append(f"# Line intercepts, % of {plot.view.points} points from above: {shares}")
    return notes


def _species_csv(plot: BioscapePlot, population: Mapping[str, float]) -> str:
    listed, packing = plot.listed_cover * 100, plot.packing * 100
    notes = [
        f"Cover of {plot.name} as the field crew noted it, live and where it was noted dead; the "
        "listed",
        f"species sum to {listed:g} % live. Live cover seen from above is {plot.live * 100:g} %, "
        "standing dead",
        f"read as {(plot.standing_dead + plot.dead_in_crowns) * 100:g} %. Crowns are",
        f"set at random: with {packing:.1f} % of each over others (packing_percent) they cover so "
        "much",
        f"together, or {CLOSED_COVER:.0%} at most.",
        *(
            [f"{OTHER!r} is the rest of the live cover, with the mean leaf of those listed."]
            if plot.other_cover > 0
            else []
        ),
        "Growth forms are those of genera or families, as are crown diameters and heights where",
        "they were not measured. See sources.csv.",
    ]
    header = (
        "taxon", "mean_diameter_cm", "cover_percent", "height_max_m", "growth_form",
        "packing_percent", "dead_fraction", "leaf_area_index", "shoot_clumping",
    )  # fmt: skip
    rows: list[tuple[str, float, float, float, str, float | None]] = [
        (
            s.taxon,
            s.size.crown_diameter_m,
            s.crown_cover,
            s.size.height_m,
            s.shape.growth_form,
            _dead_fraction(s, population),
        )
        for s in plot.species
    ]
    if plot.other_cover > 0:
        size, dead = plant_size("", DOME), population[f"dead_fraction.{DOME}"]
        height = size.height_m * plot.height_factor
        rows.append((OTHER, size.crown_diameter_m, plot.other_cover, height, DOME, dead))
    if plot.standing_dead > 0:
        like = plot.dominant
        sizes = like.size.crown_diameter_m, plot.standing_dead, like.size.height_m
        rows.append((DEAD, *sizes, "deadwood", None))
    cells = [
        (
            *(t, d * 100, c * 100, h, form, round(packing, 3)),
            "" if dead is None else round(dead, 4),
            *(
                population.get(f"{kind}.{form}", "")
                for kind in ("leaf_area_index", "shoot_clumping")
            ),
        )
        for t, d, c, h, form, dead in rows
    ]
    return "".join(f"# {note}\n" for note in notes) + _table([header, *cells])


def _dead_fraction(species: BioscapeSpecies, population: Mapping[str, float]) -> float:
    """Dead tissue of a species, `BioscapeSpecies.dead_fraction` about that of its growth form."""
    return species.dead_fraction(population[f"dead_fraction.{species.shape.growth_form}"])


def _leaves_csv(plot: BioscapePlot, population: Mapping[str, float]) -> str:
    notes = (
        "Dry matter and water from leaf mass per area and water content, per half of the leaf's",
        "surface: the library's area is projected, and a rolled leaf or culm has pi/2 as much.",
        "Structure follows from dry matter, pigments are assumed. sources.csv says what was",
        "measured of which species.",
    )
    leaves = [(s.taxon, leaf_parameters(s, population)) for s in plot.species]
    if plot.other_cover > 0:
        leaves.append((OTHER, mean_leaf(plot, population)))
    rows = [(taxon, *(leaf[name] for name in LEAF_FIELDS)) for taxon, leaf in leaves]
    return "".join(f"# {note}\n" for note in notes) + _table([("taxon", *LEAF_FIELDS), *rows])


def _sources(
    plot: BioscapePlot, population: Mapping[str, float], prior: LearnedPrior | None
) -> list[tuple[object, ...]]:
    learned = "assumed" if prior is None else f"learned ({prior.path.name})"
    without = "without this plot" if prior is not None and prior.knows(plot.name) else ""
    own = () if prior is None else {p.name for p in prior.file.parameters}
    rows: list[tuple[object, ...]] = [
        ("*", name, value, "-", learned, without)
        if prior is None or name in own
        else ("*", name, value, "-", "assumed by growth form", f"not in {prior.path.name}")
        for name, value in population.items()
    ]
    for s in plot.species:
        leaf, lma = leaf_parameters(s, population), s.traits["leaf_mass_per_area"]
        renamed = s.library_name not in (None, s.taxon)
        rows += [
            (s.taxon, "cover", s.cover * 100, "%", "measured", s.note.where),
            *_dead_sources(s, population),
            (s.taxon, "growth_form", s.shape.growth_form, "-", f"assumed by {s.shape.source}", ""),
            *_size_sources(s, plot),
            (s.taxon, "leaf_area_ratio", s.shape.area_ratio, "-", f"assumed by {s.shape.source}",
             "half of the surface over the projected area"),
        ]  # fmt: skip
        for trait, sourced in s.traits.items():
            note = f"as {s.library_name}" if renamed else ""
            rows.append((s.taxon, trait, sourced.value, _TRAIT_UNITS[trait], sourced.source, note))
        for name, value in leaf.items():
            source = _FROM_MASS if name == "structure" else FORM_DEFAULT
            if name in ("water", "dry_matter"):
                water = s.traits["water_content"].source
                source = lma.source if name == "dry_matter" else max(
                    lma.source, water, key=SOURCES.index
                )  # fmt: skip
            above = beyond_prospect(s).get(name)
            note = "" if above is None else f"cut from {above:.4g}, more than PROSPECT can mean"
            if prior is not None and name in leaf_factors(population):
                note = f"{note}{'; ' if note else ''}times the learned factor"
            rows.append((s.taxon, name, value, PARAMETERS[name].unit, source, note))
    if plot.other_cover > 0:
        cover = plot.other_cover * 100
        rows.append((OTHER, "cover", cover, "%", "live cover less the listed species", ""))
        for name, value in mean_leaf(plot, population).items():
            rows.append(
                (OTHER, name, value, PARAMETERS[name].unit, "mean of the listed species", "")
            )
    if plot.standing_dead > 0:
        size, like = plot.dominant.size, f"as {plot.dominant.taxon}"
        rows += [
            (DEAD, "cover", plot.standing_dead * 100, "%", "assumed", "half of the dead cover"),
            (DEAD, "growth_form", "deadwood", "-", "assumed", ""),
            (DEAD, "crown_diameter", size.crown_diameter_m, "m", "assumed", like),
            (DEAD, "height", size.height_m, "m", "assumed", like),
        ]
    return rows


def _dead_sources(
    species: BioscapeSpecies, population: Mapping[str, float]
) -> list[tuple[object, ...]]:
    taxon, dead = species.taxon, species.note.dead_cover
    if dead is None:
        return []
    return [
        (taxon, "dead_cover", dead * 100, "%", "measured", species.note.where),
        (taxon, "dead_fraction", _dead_fraction(species, population), "-", "from dead cover",
         "all of the dead cover, and of the live cover that of the growth form"),
    ]  # fmt: skip


def _size_sources(species: BioscapeSpecies, plot: BioscapePlot) -> list[tuple[object, ...]]:
    taxon, size, (of_diameter, of_height) = species.taxon, species.size, species.size_source
    noted = species.note.where if of_diameter == "measured" else size.source
    note = size.source
    if plot.height is not None:
        note = f"{note}; times {plot.height_factor:.4g}"
    rows: list[tuple[object, ...]] = [
        (taxon, "crown_diameter", size.crown_diameter_m, "m", of_diameter, noted),
        (taxon, "height", size.height_m, "m", of_height, note),
    ]
    if species.note.counted is not None:
        rows.append((taxon, "count", species.note.counted, "-", "measured", species.note.where))
    return rows


def _counts(read: Sequence[BioscapePlot]) -> pd.DataFrame:
    """Live plants counted in plots, and those that eq. (10) makes of cover and diameter."""
    rows = []
    for plot in read:
        for s in plot.species:
            counted, diameter = s.note.counted, s.note.diameter
            if counted is None or diameter is None:
                continue
            each = float(instance_area(diameter, s.size.height_m))
            expected = float(soft_count(target_area(CIRCLE_M2, s.cover), each))
            ratio = counted / expected if expected > 0 else math.nan
            clonal = "yes" if s.note.clonal else "no"
            rows.append(
                (plot.name, s.taxon, clonal, 100 * s.cover, diameter, counted, expected, ratio)
            )
    columns = (
        "plot", "taxon", "clonal", "live_percent", "crown_diameter_m", "counted", "from_cover",
        "counted_over_from_cover",
    )  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def _median_ratio(counts: pd.DataFrame) -> float | None:
    """Plants counted over those from cover, median of species that are not clonal."""
    ratios = counts["counted_over_from_cover"][counts["clonal"] == "no"].dropna()
    return float(ratios.median()) if len(ratios) else None


def _intercepts(read: Sequence[BioscapePlot]) -> pd.DataFrame:
    """Line intercepts as seen from above, beside the covers that the crew judged."""
    rows = []
    for plot in read:
        if plot.view is None:
            continue
        covers = {s.taxon: s.cover for s in plot.species}
        for name, points, cover in (
            ("live", sum(plot.view.live.values()), plot.live),
            ("dead", plot.view.dead, plot.dead),
            ("bare", plot.view.bare, plot.soil + plot.rock),
            ("other", plot.view.other, math.nan),
            *(
                (taxon, n, covers.get(taxon, math.nan))
                for taxon, n in sorted(plot.view.live.items())
            ),
        ):
            share, error = plot.view.share(points)
            rows.append((plot.name, name, points, 100 * share, 100 * error, 100 * cover))
    columns = ("plot", "shown", "points", "percent", "standard_error_percent", "crew_percent")
    return pd.DataFrame(rows, columns=columns)


def _index_row(plot: BioscapePlot) -> dict[str, Any]:
    """A plot's row of `plots.csv`: covers in % of the plot, means weighted with cover; of what only
    the published tables have, None elsewhere."""
    visit, view, listed, shares = plot.visit, plot.view, plot.listed_cover, plot.trait_shares()
    seen = {} if view is None else {
        "live": sum(view.live.values()), "dead": view.dead, "bare": view.bare
    }  # fmt: skip
    sized = sum(s.cover for s in plot.species if s.note.diameter is not None)
    dead = any(s.note.dead_cover is not None for s in plot.species)
    return {
        "plot": plot.name,
        "latitude_deg": None if visit is None else f"{visit.latitude:.6f}",
        "longitude_deg": None if visit is None else f"{visit.longitude:.6f}",
        "first_flight": None if visit is None else next(iter(visit.times), None),
        "flights": 0 if visit is None else len(visit.times),
        "species": len(plot.species),
        "live_percent": 100 * plot.live,
        "dead_percent": 100 * plot.dead,
        "soil_percent": 100 * plot.soil,
        "rock_percent": 100 * plot.rock,
        "listed_percent": 100 * listed,
        "other_percent": 100 * plot.other_cover,
        "packing_percent": 100 * plot.packing,
        **{f"{s.replace(' ', '_')}_percent": 100 * shares.get(s, 0.0) for s in SOURCES},
        "leaf_mass_per_area_g_m2": plot.weighted_mean("leaf_mass_per_area"),
        "water_content_percent": plot.weighted_mean("water_content"),
        "nitrogen_mg_g": plot.weighted_mean("nitrogen"),
        "veg_height_m": plot.height,
        "post_fire_age_years": plot.age,
        "diameter_measured_percent": 100 * sized / listed if listed > 0 else None,
        "dead_in_crowns_percent": 100 * plot.dead_in_crowns if dead else None,
        "counted_over_from_cover": _median_ratio(_counts([plot])),
        "intercept_points": None if view is None else view.points,
        **{
            f"intercept_{kind}_percent": None if view is None else 100 * view.share(seen[kind])[0]
            for kind in ("live", "dead", "bare")
        },
        "remark": "" if visit is None else visit.remark,
    }


class BioscapeResult(JobResult):
    """Result of `bioscape`: the plots that were written."""

    command: Literal["bioscape plots"] = "bioscape plots"
    plots: list[str]
    counted_over_from_cover: float | None = None
    """Plants counted over those that cover and diameter ask for, eq. (10): median of the species
    that are not clonal [-]; none where the tables hold no counts."""
    oddities: int = 0
    """Number of oddities of the tables, the rows of remarks.csv."""
    cover_share_by_trait_source: dict[str, float]
    """Share of the listed cover, over all plots, by the source of leaf mass per area [-]."""


@double_precision
def run_bioscape(
    folder: str | Path,
    output: str | Path,
    *,
    plots: Sequence[str] | None = None,
    traits: str | Path | None = None,
    prior: str | Path = DEFAULT_PRIOR,
) -> BioscapeResult:
    """Make plot files from the field tables of BioSCape.

    Writes a folder for each plot, to be rendered, with a table of where each number came from. Of
    the published tables also `counts.csv` (plants counted, and those that eq. (10) makes of cover
    and diameter), `intercepts.csv` (what line intercepts show from above, beside the crew's covers)
    and `remarks.csv` (what is odd in the tables, with file and row, and how it was read).

    **Arguments:**

    - `folder`: folder with the tables as published, bioscape_veg_*_vYYYYMMDD.csv, or *CoverData.csv
      and *VegData.csv; with *TraitLibrary.csv and, for place and time, *VegCenters.csv.
    - `output`: folder of the results, made if missing.
    - `plots`: only this plot, by its name; all if left out.
    - `traits`: trait library, if it is not in the folder.
    - `prior`: population that the plots are of: the name of a shipped one, a file that `fynjax
      bioscape learn` wrote, or none: what is assumed before one is learned.

    **Returns:** `BioscapeResult`, with the plots that were written.

    **Raises:** as `read_bioscape`.
    """
    run = Run(output)
    learned = read_prior(prior)
    with run.stage("Read the tables"):
        read = read_bioscape(folder, plots, traits=traits)
    begin_work({"plots.csv": f"{len(read)} plots"} | {f"{p.name}/plot.toml": "" for p in read})
    with run.stage("Write the plots"):
        return write_plots(run, read, learned)


def planted_files(
    run: Run, read: Sequence[BioscapePlot], learned: LearnedPrior | None
) -> tuple[list[Plot], list[str]]:
    """Write plots into the folder `plots` of a run and read their files; what there is to say."""
    written = write_plots(Run(run.folder / "plots"), read, learned)
    files = [read_plot(run.folder / "plots" / plot.name / "plot.toml") for plot in read]
    return files, list(written.warnings)


def _cut_or_assumed(read: Sequence[BioscapePlot], learned: LearnedPrior | None) -> list[str]:
    """Warnings of values that PROSPECT cannot mean, and of forms that the prior lacks."""
    said = []
    for name, most in _MOST.items():
        thick = {s.taxon for p in read for s in p.species if name in beyond_prospect(s)}
        if thick:
            said.append(
                f"{name} of {len(thick)} species is more than PROSPECT can mean, and cut to "
                f"{most:g} {PARAMETERS[name].unit} (sources.csv has what their traits give): "
                f"{', '.join(sorted(thick))}"
            )
    if learned is not None:
        forms = [s.shape.growth_form for p in read for s in p.species]
        said += learned.unlearned([*forms, *(DOME for p in read if p.other_cover > 0)])
    return said


def write_plots(
    run: Run, read: Sequence[BioscapePlot], learned: LearnedPrior | None
) -> BioscapeResult:
    """Write what `run_bioscape` does of plots that are read."""
    index = pd.DataFrame([_index_row(plot) for plot in read])
    run.table("plots.csv", index, "all plots, one a row")
    counts = _counts(read)
    remarks = [r for plot in read for r in plot.remarks]
    if any(plot.published for plot in read):
        odd = pd.DataFrame(remarks, columns=["file", "row", "plot", "what"])
        odd = odd[["plot", "file", "row", "what"]].astype({"row": "Int64"})
        run.table("counts.csv", counts, "plants counted and from cover")
        run.table("intercepts.csv", _intercepts(read), "line intercepts, the view from above")
        run.table("remarks.csv", odd, "oddities of the tables, and how they were read")
    for plot in read:
        write_plot_files(plot, run.folder / plot.name, learned)
        run.path(f"{plot.name}/plot.toml", f"{len(plot.species)} species")
    total = sum(plot.listed_cover for plot in read)
    shares = {
        source: sum(p.trait_shares().get(source, 0.0) * p.listed_cover for p in read) / total
        for source in SOURCES
    }
    named = ", ".join(f"{100 * v:.1f} % {k}" for k, v in shares.items() if v > 0)
    warnings = _cut_or_assumed(read, learned)
    headline = [
        f"{len(read)} plots with {len({s.taxon for p in read for s in p.species})} species.",
        f"Leaf mass per area by cover: {named}.",
    ]
    ratio = _median_ratio(counts)
    if ratio is not None:
        headline.append(
            f"Plants counted over those from cover and diameter (eq. 10): median {ratio:.2g}."
        )
    if remarks:
        first = remarks[0]
        at = first.file if first.row is None else f"{first.file}, row {first.row}"
        warnings.append(
            f"{len(remarks)} oddities of the tables, with file and row in remarks.csv; the first: "
            f"{at}, plot {first.plot}: {first.what}"
        )
    return run.result(
        BioscapeResult,
        headline=headline,
        warnings=warnings,
        counted_over_from_cover=ratio,
        oddities=len(remarks),
        plots=[plot.name for plot in read],
        cover_share_by_trait_source=shares,
    )
