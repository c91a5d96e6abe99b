"""Plot files from the field tables of BioSCape: what `fynjax bioscape` writes."""

import csv
import io
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from fynjax._core.errors import InputError
from fynjax._core.progress import Progress
from fynjax.io.text import write_text
from fynjax.jobs import JobResult, Run
from fynjax.leaf import structure_from_dry_matter
from fynjax.scene import LEAF_FIELDS, PARAMETERS
from fynjax.sensors import sun_position
from fynjax.studies.bioscape._assumed import (
    CLOSED_COVER,
    DOME,
    MOST_WATER,
    PLOT_SIDE_M,
    pigments,
    plant_size,
)
from fynjax.studies.bioscape._plots import BioscapePlot, BioscapeSpecies, Visit, read_bioscape
from fynjax.studies.bioscape._traits import SOURCES

OTHER = "Other species"
"""Taxon of the live cover that no listed species makes up."""

DEAD = "Standing dead plants"
"""Taxon of the dead cover that stands: bare stems, as large as the dominant species, with the
measured spectrum of bark. PROSPECT is no model of dead culms and stems."""

_TRAIT_UNITS = {
    "leaf_mass_per_area": "g m-2 projected", "water_content": "% of fresh mass",
    "nitrogen": "mg g-1", "carbon": "mg g-1",
}  # fmt: skip
_ASSUMED = "growth form default"
_FROM_MASS = "from leaf mass per area"
_MOST = {"water": MOST_WATER, "dry_matter": PARAMETERS["dry_matter"].upper}


def _per_area(species: BioscapeSpecies) -> dict[str, float]:
    """Water [cm] and dry matter [g cm-2] of a species' leaf per half of its surface."""
    dry = species.traits["leaf_mass_per_area"].value / species.shape.area_ratio / 1e4
    wet = species.traits["water_content"].value / 100.0
    return {"water": dry * wet / (1.0 - wet), "dry_matter": dry}


def leaf_parameters(species: BioscapeSpecies) -> dict[str, float]:
    """PROSPECT-D parameters of a species' leaf, in PROSPECT's units, per half of its surface.

    Dry matter is the leaf mass per projected area over the shape's `area_ratio`; water is that
    times w / (1 - w), with w the share of water in the fresh mass (1 g of water is 1 cm3). Values
    above what PROSPECT can mean, of culms and succulents, are cut to that: `beyond_prospect` names
    them. Structure follows from dry matter, pigments are those of the growth form.
    """
    mass = {name: min(value, _MOST[name]) for name, value in _per_area(species).items()}
    structure = float(structure_from_dry_matter(mass["dry_matter"]))
    return {"structure": structure} | pigments(species.shape.growth_form) | mass


def beyond_prospect(species: BioscapeSpecies) -> dict[str, float]:
    """Values above what PROSPECT can mean, which `leaf_parameters` cuts, by parameter."""
    return {n: v for n, v in _per_area(species).items() if v > _MOST[n]}


def mean_leaf(plot: BioscapePlot) -> dict[str, float]:
    """Leaf of the species that are not listed: the mean of those listed, weighted with cover."""
    leaves = [(s.cover / plot.listed_cover, leaf_parameters(s)) for s in plot.species]
    return {name: sum(share * leaf[name] for share, leaf in leaves) for name in LEAF_FIELDS}


def write_plot_files(plot: BioscapePlot, folder: str | Path) -> None:
    """Write a plot as `plot.toml`, `species.csv`, `leaves.csv` and `sources.csv` into a folder.

    `fynjax render` takes `plot.toml`. `sources.csv` has every number with its source: measured, the
    mean of related species, or assumed.

    **Arguments:** `plot`, as read by `read_bioscape`; `folder`, whose files of these names are
    replaced.
    """
    folder = Path(folder)
    write_text(folder / "plot.toml", _plot_toml(plot))
    write_text(folder / "species.csv", _species_csv(plot))
    write_text(folder / "leaves.csv", _leaves_csv(plot))
    header = ("taxon", "quantity", "value", "unit", "source", "note")
    write_text(folder / "sources.csv", _table([header, *_sources(plot)]))


def _table(rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [f"{c:.6g}" if isinstance(c, float) else c for c in row] for row in rows
    )
    return text.getvalue()


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


def _plot_toml(plot: BioscapePlot) -> str:
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
    lines = [
        f"# BioSCape vegetation plot {plot.name}, Greater Cape Floristic Region (field tables:",
        "# doi:10.5281/zenodo.14198989). sources.csv says where each number of a species is from.",
        "# Cover seen from above, in % of the plot:",
        f"#   live {plot.live * 100:g}, dead {plot.dead * 100:g}, bare soil {plot.soil * 100:g}, "
        f"bare rock {plot.rock * 100:g}",
        "",
        "[plot]",
        f'name = "{_escaped(plot.name)}"',
        f"size_m = {PLOT_SIDE_M}  # a square instead of the circle of this diameter",
        "voxel_m = 0.1  # assumed",
        'species_table = "species.csv"',
        'leaf_table = "leaves.csv"',
        *place,
        "",
        "[sun]",
        *sun,
        "",
        "[ground]",
        'soil = "dry"  # assumed; rock is taken to be as bright',
        f"litter_fraction = {plot.litter_fraction:.4f}  # dead over dead and bare cover, without "
        "the dead that is read as standing",
        f"# rock_fraction = {plot.rock:.4f}",
        "",
    ]
    return "\n".join(lines)


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _species_csv(plot: BioscapePlot) -> str:
    listed, packing = plot.listed_cover * 100, plot.packing * 100
    notes = [
        f"Live cover of {plot.name} as the field crew noted it; the listed species sum to "
        f"{listed:g} %.",
        f"Live cover seen from above is {plot.live * 100:g} %, standing dead read as "
        f"{plot.standing_dead * 100:g} %. Crowns are",
        f"set at random: with {packing:.1f} % of each over others (packing_percent) they cover so "
        "much",
        f"together, or {CLOSED_COVER:.0%} at most.",
        *(
            [f"{OTHER!r} is the rest of the live cover, with the mean leaf of those listed."]
            if plot.other_cover > 0
            else []
        ),
        "Crown diameter and height were not measured: they are those of the growth form, and the",
        "growth form is that of the genus or family. See sources.csv.",
    ]
    header = (
        "taxon", "mean_diameter_cm", "cover_percent", "height_max_m", "growth_form",
        "packing_percent",
    )  # fmt: skip
    rows = [
        (s.taxon, s.size.crown_diameter_m, s.cover, s.size.height_m, s.shape.growth_form)
        for s in plot.species
    ]
    if plot.other_cover > 0:
        size = plant_size("", DOME)
        rows.append((OTHER, size.crown_diameter_m, plot.other_cover, size.height_m, DOME))
    if plot.standing_dead > 0:
        like = plot.dominant
        sizes = like.size.crown_diameter_m, plot.standing_dead, like.size.height_m
        rows.append((DEAD, *sizes, "deadwood"))
    cells = [(t, d * 100, c * 100, h, form, round(packing, 3)) for t, d, c, h, form in rows]
    return "".join(f"# {note}\n" for note in notes) + _table([header, *cells])


def _leaves_csv(plot: BioscapePlot) -> str:
    notes = (
        "Dry matter and water from leaf mass per area and water content, per half of the leaf's",
        "surface: the library's area is projected, and a rolled leaf or culm has pi/2 as much.",
        "Structure follows from dry matter, pigments are assumed. sources.csv says what was",
        "measured of which species.",
    )
    leaves = [(s.taxon, leaf_parameters(s)) for s in plot.species]
    if plot.other_cover > 0:
        leaves.append((OTHER, mean_leaf(plot)))
    rows = [(taxon, *(leaf[name] for name in LEAF_FIELDS)) for taxon, leaf in leaves]
    return "".join(f"# {note}\n" for note in notes) + _table([("taxon", *LEAF_FIELDS), *rows])


def _sources(plot: BioscapePlot) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for s in plot.species:
        leaf, lma = leaf_parameters(s), s.traits["leaf_mass_per_area"]
        renamed = s.library_name not in (None, s.taxon)
        rows += [
            (s.taxon, "cover", s.cover * 100, "%", "measured", ""),
            (s.taxon, "growth_form", s.shape.growth_form, "-", f"assumed by {s.shape.source}", ""),
            (s.taxon, "crown_diameter", s.size.crown_diameter_m, "m", _ASSUMED, s.size.source),
            (s.taxon, "height", s.size.height_m, "m", _ASSUMED, s.size.source),
            (s.taxon, "leaf_area_ratio", s.shape.area_ratio, "-", f"assumed by {s.shape.source}",
             "half of the surface over the projected area"),
        ]  # fmt: skip
        for trait, sourced in s.traits.items():
            note = f"as {s.library_name}" if renamed else ""
            rows.append((s.taxon, trait, sourced.value, _TRAIT_UNITS[trait], sourced.source, note))
        for name, value in leaf.items():
            source = _FROM_MASS if name == "structure" else _ASSUMED
            if name in ("water", "dry_matter"):
                water = s.traits["water_content"].source
                source = lma.source if name == "dry_matter" else max(
                    lma.source, water, key=SOURCES.index
                )  # fmt: skip
            above = beyond_prospect(s).get(name)
            note = "" if above is None else f"cut from {above:.4g}, more than PROSPECT can mean"
            rows.append((s.taxon, name, value, PARAMETERS[name].unit, source, note))
    if plot.other_cover > 0:
        cover = plot.other_cover * 100
        rows.append((OTHER, "cover", cover, "%", "live cover less the listed species", ""))
        for name, value in mean_leaf(plot).items():
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


INDEX_COLUMNS = {
    "plot": "name, and name of the folder",
    "latitude_deg": "WGS84",
    "longitude_deg": "WGS84",
    "first_flight": "UTC",
    "flights": "",
    "species": "listed",
    "live_percent": "",
    "dead_percent": "",
    "soil_percent": "",
    "rock_percent": "",
    "listed_percent": "sum of the species' covers",
    "other_percent": "live cover of species that are not listed",
    "packing_percent": "",
    **{f"{source.replace(' ', '_')}_percent": "of the listed cover" for source in SOURCES},
    "leaf_mass_per_area_g_m2": "mean of the listed species",
    "water_content_percent": "mean of the listed species",
    "nitrogen_mg_g": "mean of the listed species that have one",
    "remark": "the crew's",
}
"""Columns of `plots.csv`; covers in % of the plot, means weighted with cover."""


def _index_row(plot: BioscapePlot) -> list[Any]:
    visit, shares = plot.visit, plot.trait_shares()
    where = ("", "", "", 0) if visit is None else (
        f"{visit.latitude:.6f}", f"{visit.longitude:.6f}", visit.times[0], len(visit.times)
    )  # fmt: skip
    covers = (plot.live, plot.dead, plot.soil, plot.rock, plot.listed_cover, plot.other_cover)
    means = (plot.weighted_mean(t) for t in ("leaf_mass_per_area", "water_content", "nitrogen"))
    return [
        plot.name,
        *where,
        len(plot.species),
        *(c * 100 for c in (*covers, plot.packing)),
        *(shares.get(source, 0.0) * 100 for source in SOURCES),
        *("" if mean is None else mean for mean in means),
        "" if visit is None else visit.remark,
    ]


class BioscapeResult(JobResult):
    """Result of `bioscape`: the plots that were written."""

    command: Literal["bioscape"] = "bioscape"
    plots: list[str]
    cover_share_by_trait_source: dict[str, float]
    """Share of the listed cover, over all plots, by the source of leaf mass per area [-]."""


def run_bioscape(
    folder: str | Path,
    output: str | Path,
    *,
    plots: Sequence[str] | None = None,
    traits: str | Path | None = None,
    progress: Progress | None = None,
) -> BioscapeResult:
    """Write a folder of plot files for each plot of BioSCape's tables, and `plots.csv`.

    **Arguments:**

    - `folder`, `plots`, `traits`: as for `read_bioscape`.
    - `output`: folder of the results, made if missing.
    - `progress`: where to report the stages; nowhere by default.

    **Returns:** `BioscapeResult`, with the plots that were written.

    **Raises:** as `read_bioscape`, and `InputError` for a plot whose name cannot be that of a
    folder.
    """
    run = Run(output, progress=progress)
    with run.stage("Read the tables"):
        read = read_bioscape(folder, plots, traits=traits)
    for plot in read:
        if not plot.name.replace("-", "").replace("_", "").isalnum():
            raise InputError(
                f"expected a plot named by letters, digits, - and _, but got {plot.name!r}: a "
                "folder is named after it",
                file=folder,
                column="Plot",
            )
    with run.stage("Write the plots"):
        index = _table([tuple(INDEX_COLUMNS), *map(_index_row, read)])
        write_text(run.path("plots.csv", "all plots, one a row"), index)
        for plot in read:
            write_plot_files(plot, run.folder / plot.name)
            run.path(f"{plot.name}/plot.toml", f"{len(plot.species)} species")
    total = sum(plot.listed_cover for plot in read)
    shares = {
        source: sum(p.trait_shares().get(source, 0.0) * p.listed_cover for p in read) / total
        for source in SOURCES
    }
    named = ", ".join(f"{100 * v:.1f} % {k}" for k, v in shares.items() if v > 0)
    cut = []
    for name, most in _MOST.items():
        thick = {s.taxon for p in read for s in p.species if name in beyond_prospect(s)}
        if thick:
            cut.append(
                f"{name} of {len(thick)} species is more than PROSPECT can mean, and cut to "
                f"{most:g} {PARAMETERS[name].unit} (sources.csv has what their traits give): "
                f"{', '.join(sorted(thick))}"
            )
    return run.result(
        BioscapeResult,
        headline=[
            f"{len(read)} plots with {len({s.taxon for p in read for s in p.species})} species.",
            f"Leaf mass per area by cover: {named}.",
        ],
        warnings=cut,
        plots=[plot.name for plot in read],
        cover_share_by_trait_source=shares,
    )
