"""Values of plants that a plot's tables leave open: from where they are, and of what population."""

import glob
import math
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

from fynjax.app.io.plot._plot import Plot
from fynjax.app.io.plot._prior import BY_FORM, DEFAULT_PRIOR, LearnedPrior, read_prior
from fynjax.canopy import FORMS
from fynjax.scene import LEAF_FIELDS, ModelError, SpeciesRow, table_spreads

_OPEN = {
    "leaf_area_index": "leaf area",
    "dead_fraction": "dead tissue",
    "shoot_clumping": "clumping",
    "wood_area_index": "wood area",
}
"""What a species table may leave open, and its words."""
ASSUMED = "assumed by growth form"
AT_LARGE = "medians of shrublands at large, published where known"
AS_FYNBOS = "assumed as in fynbos"


def plant_sources(plot: Plot, prior: LearnedPrior | None = None) -> str:
    """A line on where the values of a plot's plants are from: which are the user's, and which are
    learned or assumed.

    **Arguments:**

    - `plot`: as `read_plot` gives it; of one of `with_prior` the line that it was given there.
    - `prior`: learned population that fills in what the tables leave open; left out, the values are
      those of `Plot.shrubland`.
    """
    if plot.plant_sources is not None:
        return plot.plant_sources
    shipped = read_prior(DEFAULT_PRIOR)
    assert shipped is not None
    fynbos = f"learned from {shipped.file.plots} fynbos plots"
    usual = fynbos if plot.shrubland == "fynbos" else AT_LARGE
    filled = usual
    if prior is not None:
        filled = fynbos if prior == shipped else f"learned by {prior.path.name}"
    forms = (prior or shipped).forms
    table, found = plot.species_table.name, dict[str, list[str]]()

    def add(what: str, sources: Counter[str]) -> None:
        for source, count in sources.items():
            some = f" ({count} of {sources.total()} species)" if len(sources) > 1 else ""
            found.setdefault(source, []).append(what + some)

    def source_of(row: SpeciesRow, kind: str) -> str:
        if getattr(row, kind) is not None:
            return table
        if row.plant is not None and kind.endswith("area_index"):
            return row.plant.name
        if kind not in BY_FORM or row.growth_form not in forms:
            return ASSUMED
        return AS_FYNBOS if kind == "shoot_clumping" and filled == AT_LARGE else filled

    sizes = table if plot.crowns is None else plot.crowns.name
    add("species", Counter([table]))
    add("covers, diameters, heights", Counter([sizes]))
    leafy = [row for row in plot.species if FORMS[row.growth_form].leafy]
    for kind, what in _OPEN.items():
        rows = plot.species if kind == "wood_area_index" else leafy
        add(what, Counter(source_of(row, kind) for row in rows))
    stated = {leaf.taxon for leaf in plot.leaves if not leaf.material}
    leaves = "" if plot.leaf_table is None else plot.leaf_table.name

    def leaf_source(row: SpeciesRow) -> str:
        if row.taxon in plot.leaf_files and plot.leaf_spectra is not None:
            return plot.leaf_spectra.name
        if stated & {row.taxon, "*"}:
            return leaves
        return usual if FORMS[row.growth_form].generic is not None else ASSUMED

    add("leaf traits", Counter(map(leaf_source, leafy)))
    bark = "the shipped spectrum" if filled == AT_LARGE else filled
    bark = bark if plot.ground.wood_brightness is None else plot.file.name
    add("bark", Counter([bark if plot.dead_tissue is None else plot.dead_tissue.name]))
    lines = [f"{', '.join(what)}: {source}." for source, what in found.items()]
    if plot.plants is None and prior is None and usual in found:
        if plot.place_deg is None:
            lines.append(
                "No place is stated, so the plot is taken for fynbos: of another shrubland write "
                'plants = "generic" under [plot].'
            )
        elif usual == AT_LARGE:
            lines.append('The plot lies outside the Cape: of fynbos write plants = "fynbos".')
    if plot.parameters is not None:
        lines.append(f"Where {plot.parameters.name} has a value, it counts.")
    return " ".join(line[0].upper() + line[1:] for line in lines)


def plot_spreads(plot: Plot) -> dict[str, float]:
    """Uncertainty of a plot's tables in themselves, by the names of parameters, as relative
    standard deviations (`table_spreads`).

    **Arguments:** `plot`, as `read_plot` gives it.
    """
    return table_spreads(plot.species, plot.shrubland, plot.leaves, plot.leaf_files)


def with_prior(plot: Plot, name_or_path: str | Path) -> Plot:
    """A plot with what a learned population says of what its files leave open.

    Leaf area index, dead tissue and clumping of species that state none, with the population's
    spread elsewhere (`LearnedPrior.sd`) as their priors unless the plot file states one; the
    brightness of dead tissue where it is as shipped. Leaves, soil and plants of meshes stay as they
    are stated.

    **Arguments:** `plot`: a plot; `name_or_path`: as for `read_prior`.

    **Returns:** `Plot`; `plot` itself with "none".

    **Raises:** `InputError` as `read_prior`. Warns of growth forms that the population lacks, of
    which the plot gets what they assume themselves.
    """
    prior = read_prior(name_or_path)
    if prior is None:
        return plot
    filled = [one for one in plot.species if any(map(one.leaves_open, BY_FORM))]
    for sentence in prior.unlearned(one.growth_form for one in filled):
        warnings.warn(sentence, stacklevel=2)
    sources = plant_sources(plot, prior)
    values = prior.values(plot.name)
    species, spread = [], dict(plot.calibration.priors)
    for one in plot.species:
        found: dict[str, Any] = {
            kind: values[f"{kind}.{one.growth_form}"]
            for kind in BY_FORM
            if f"{kind}.{one.growth_form}" in values and one.leaves_open(kind)
        }
        species.append(one.replace(**found))
        for kind, value in found.items():
            # Patterns of the plot file come first.
            spread.setdefault(
                f"species.{one.taxon}.{kind}",
                prior.sd(f"{kind}.{one.growth_form}", elsewhere=True) / value,
            )
    ground = plot.ground
    if ground.wood_brightness is None and plot.dead_tissue is None:
        ground = ground.replace(wood_brightness=values["wood_brightness"])
        bark = prior.sd("wood_brightness", elsewhere=True) / values["wood_brightness"]
        spread.setdefault("ground.wood_brightness", bark)
    return plot.replace(
        species=tuple(species),
        ground=ground,
        calibration=plot.calibration.replace(priors=spread),
        inputs=(*plot.inputs, prior.path),
        prior=prior,
        plant_sources=sources,
    )


_ELSEWHERE = math.sqrt(2.0)
"""Factor on the model's error for plants of which no plot was learned from: how far regions differ
is not known, and taken to be as far as plots do, as in `LearnedPrior.sd`."""


def plot_error(plot: Plot) -> ModelError | None:
    """What the model of a plot is off by: the error of the population that filled its tables
    (`with_prior`), or else of the shipped one, times `calibration.model_error`.

    **Arguments:** `plot`: a plot.

    **Returns:** `ModelError`, or None with a `calibration.model_error` of 0.
    """
    prior = plot.prior or read_prior(DEFAULT_PRIOR)
    assert prior is not None  # a name, and not "none"
    scale = plot.calibration.model_error
    if scale is None:
        scale = _ELSEWHERE if plot.shrubland == "generic" else 1.0
    return prior.model_error.wider(scale) if scale > 0.0 else None


def free_parameters(plot: Plot) -> tuple[str, ...]:
    """Patterns of the parameters that a calibration of a plot frees: those that its file states, or
    else what is guessed and what changes from year to year.

    Of every species cover, diameter and dead share; leaf area and clumping that the species table
    leaves open; leaf traits of species of which no leaf was measured. Brown pigments and the
    brightness of wood are not among them: what darkens and browns live shoots is their dead tissue.
    Of the ground brightness, moisture and covers.

    **Arguments:** `plot`: a plot.
    """
    if plot.calibration.free is not None:
        return tuple(plot.calibration.free)
    found = []
    for one in plot.species:
        kinds = ["cover", "diameter", "dead_fraction"]
        kinds += [kind for kind in ("leaf_area_index", "shoot_clumping") if one.leaves_open(kind)]
        if one.taxon not in plot.leaf_files:
            kinds += [f"leaf.{name}" for name in LEAF_FIELDS if name != "brown_pigments"]
        found += [f"species.{glob.escape(one.taxon)}.{kind}" for kind in kinds]
    return (*found, "ground.brightness", "ground.moisture", "ground.*_fraction")
