"""The job of `fynjax diversity`: how well sensors see the diversity of communities."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError, listed, whole_number
from fynjax._core.extras import require
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.app.io.instruments import load_instrument
from fynjax.app.io.plot import Plot, as_plot, example_folder
from fynjax.app.io.text import existing_file, read_rows
from fynjax.app.jobs import JobResult, Rows, Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.diversity import read_phylogeny
from fynjax.scene import SpeciesRow, check_species, cover_definition_of, visible_sensor
from fynjax.sensors import Sensor
from fynjax.studies import fynbos_2006
from fynjax.studies.communities._draw import Gradients, alive, check_pool
from fynjax.studies.communities._observe import Design, green, observe_community
from fynjax.studies.communities._scores import composition, correlations, recognition

TREE_2006 = Path(fynbos_2006.__file__).parent / "data" / "phylogeny.nwk"
"""Dated tree of the article's taxa."""
PIXELS = (0.05, 0.1, 0.25, 0.5, 1.0, 1.25, 2.5, 5.0)
"""Edges of a pixel [m] of a run that names none."""
_ROUNDING = 1e-6
_FEWEST = 10
"""Communities at least: of fewer, some metric goes with some diversity by chance."""
_MOST_NOISE = 0.3


class DiversityResult(JobResult):
    """Result of `diversity`: how well spectra know diversity, and where that is lost."""

    command: Literal["diversity"] = "diversity"
    lost: Rows
    """Rows of lost.csv."""
    recognition: Rows
    """Rows of recognition.csv."""
    composition: Rows
    """Rows of composition.csv."""


@double_precision
def diversity(
    output: str | Path,
    plot: Plot | str | Path | None = None,
    *,
    communities: Annotated[int, Field(ge=10)] = 100,
    size: Annotated[float, Field(ge=0.5, le=100.0)] = 10.0,
    gradients: Gradients | None = None,
    sensors: Names | Sequence[str | Path | Sensor] = ("mavic_3m", "aviris_ng"),
    pixels: Sequence[float] = PIXELS,
    noise: Sequence[float] = (0.01,),
    bands: Annotated[int, Field(ge=1)] = 30,
    samples: Annotated[int, Field(ge=1)] = 20,
    threshold: float = 0.25,
    greenness: float | None = None,
    tree: str | Path | None = None,
    seed: Seed = 0,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
) -> DiversityResult:
    """Find what sensors can know of the diversity of communities, and at which pixel it is lost.

    Communities of the species of a plot are drawn along gradients, planted and seen by each sensor
    at its finest pixel; coarser pixels are means of these, blurred by the optics of a sensor of
    such pixels. The light is that of the plot file; leaves of a species are all alike.

    **Arguments:**

    - `output`: folder of the results, made if missing.
    - `plot`: plot file whose species and leaves communities are drawn from; or a species table
      (CSV), with usual leaves on the shipped plot; that plot if left out.
    - `communities`: how many are drawn.
    - `size`: side of a simulated plot [m].
    - `gradients`: of richness, evenness, cover and years since fire.
    - `sensors`: imaging sensors, by name or file; from Python as objects too.
    - `pixels`: edges of a pixel [m] that divide the side, multiples of the smallest, at least two.
    - `noise`: standard deviations of the noise of a pixel, relative to its reflectance, 0 to 0.3.
    - `bands`: bands of a sensor that are used, at most, evenly chosen.
    - `samples`: pixels of each species that a community gives to the classification, at most.
    - `threshold`: squared correlation with a spectral metric, between 0 and 1, below which a
      diversity is lost.
    - `greenness`: NDVI, from -1 to below 1, that a pixel must have to count in the metrics, so that
      bare ground and its contrast with plants do not; all count if left out.
    - `tree`: Newick file of the descent of the species, or fynbos, the dated tree of the article's
      taxa: communities then go from near to distant relatives too, and their phylogenetic
      diversity is asked for, Rao's quadratic entropy with the paths in the tree.
    - `seed`: seed of everything random.
    - `checkpoint`: folder that keeps what communities gave, from which an interrupted run goes on.
    - `workers`: where communities are simulated; in this process by default.

    **Returns:** `DiversityResult`. Writes `communities.csv`, `agreement.csv`, `lost.csv`,
    `recognition.csv`, `composition.csv`, figures and a page into `output`.

    **Raises:** `InputError` for settings that do not fit each other, as `read_plot` and
    `build_plot`, and a checkpoint of another run; `MissingExtraError` without scikit-learn.

    Source of the question, and of squared correlations against the pixel: Wang et al. (2018),
    Ecological Applications 28, 541.

    Example: `studies.communities.diversity("results", communities=20, size=5.0)`.
    """
    require("sklearn", "analysis", "scikit-learn")
    gradients = Gradients() if gradients is None else gradients
    read = _pool(example_folder() / "plot.toml" if plot is None else plot)
    check_pool(read, gradients)
    pool = read.replace(size_m=(size, size))
    whole_number("communities", communities, _FEWEST)
    whole_number("samples", samples, 1)
    whole_number("bands", bands, 1)
    if not 0.0 < threshold < 1.0:
        raise InputError(f"expected a `threshold` above 0 and below 1, but got {threshold:g}")
    if not noise or not all(0.0 <= one <= _MOST_NOISE for one in noise):
        raise InputError(f"expected at least one `noise`, each from 0 to {_MOST_NOISE:g}")
    _check_different("noise", noise)
    chosen = _sensors(sensors, bands, greenness)
    fine = _checked_pixels(pixels, size, pool.voxel_m)
    design = Design(chosen, fine, tuple(noise), samples, seed, greenness, _related(tree, read))
    run = Run(output, seed=seed, plot=read)
    inputs = read.inputs if tree is None else (*read.inputs, _file_of(tree))
    begin_work(dict.fromkeys(_TABLES, f"{communities} communities") | {"report.html": ""})
    journal = run.journal(checkpoint, pool, gradients, design, files=inputs)
    with at_work(workers) as pool_of_workers, stage("Communities", communities):
        done = pool_of_workers.all(
            observe_community, range(communities), pool, gradients, design, journal=journal
        )
    truth, cover, metrics, species, *kept = (np.stack(parts) for parts in zip(*done, strict=True))
    spectra, drawn = kept[: len(chosen)], kept[len(chosen) :]
    with run.stage("Score"):
        metrics, composed = composition(cover, metrics, drawn, design)
        table, lost = correlations(truth, metrics, design, threshold)
        known = recognition(species, spectra, pool.taxa, design)
    headline = _headline(lost, known, threshold)
    with run.stage("Write"):
        tables = pd.DataFrame(truth, columns=design.diversities), table, lost, known, composed
        for (name, what), rows in zip(_TABLES.items(), tables, strict=True):
            run.table(name, rows, what)
        sections = _sections(table, lost, known, composed, threshold)
        record = run.record(inputs)
        title = f"Diversity as sensors see it: {communities} communities of {read.name}"
        run.page(Page("diversity", title, " ".join(headline), sections, record=record))
    return run.result(
        DiversityResult, headline=headline, lost=lost, recognition=known, composition=composed
    )


_TABLES = {
    "communities.csv": "what stands in each",
    "agreement.csv": "squared correlation of metrics with diversity",
    "lost.csv": "pixel at which each diversity is lost to each metric",
    "recognition.csv": "how well species are recognised; q05, q95 over 20 trainings, not over "
    "communities",
    "composition.csv": "how composition follows that of the plants",
}


def _check_different(what: str, values: Sequence[object]) -> None:
    if len(set(values)) < len(values):
        raise InputError(f"expected each {what} once, but got {listed(map(str, values))}")


def _sensors(
    sensors: Sequence[str | Path | Sensor], bands: int, greenness: float | None
) -> tuple[Sensor, ...]:
    """The sensors with at most so many bands, among them those that the greenness needs."""
    given = [sensors] if isinstance(sensors, str | Path | Sensor) else sensors
    chosen = tuple(_few_bands(sensor, bands) for sensor in given)
    if not chosen:
        raise InputError("expected at least one of `sensors`")
    _check_different("sensor", [sensor.name for sensor in chosen])
    if greenness is not None and not -1.0 <= greenness < 1.0:
        raise InputError(f"expected a `greenness` from -1 to below 1, but got {greenness:g}")
    for sensor in chosen:
        green(np.zeros((0, len(sensor.bands))), sensor, greenness)  # whether it has the bands
    return chosen


def _pool(plot: Plot | str | Path) -> Plot:
    """A plot, that of a plot file, or the shipped one with the species of a table."""
    if isinstance(plot, Plot) or Path(plot).suffix.lower() != ".csv":
        return as_plot(plot)
    path = existing_file(plot, "a species table").resolve()
    rows = read_rows(path, SpeciesRow, "a species table")
    check_species(rows, path, None)
    species = tuple(row for _, row in rows)
    read = as_plot(example_folder() / "plot.toml")
    return read.replace(
        name=path.stem, species_table=path, species=species, leaf_table=None, leaves=(),
        cover_definition=cover_definition_of(species, None),
        inputs=(read.file, path, *(row.plant for row in species if row.plant is not None)),
    )  # fmt: skip


def _file_of(tree: str | Path) -> Path:
    return TREE_2006 if str(tree) == "fynbos" else Path(tree)


def _related(tree: str | Path | None, pool: Plot) -> tuple[tuple[float, ...], ...]:
    """Path between each two species in a tree, 0 to those without leaves; empty without a tree."""
    if tree is None:
        return ()
    living, apart = alive(pool), np.zeros((len(pool.species),) * 2)
    phylogeny = read_phylogeny(_file_of(tree), [pool.taxa[i] for i in living])
    apart[np.ix_(living, living)] = phylogeny.distance
    return tuple(map(tuple, apart.tolist()))


def _checked_pixels(pixels: Sequence[float], size: float, voxel: float) -> tuple[float, ...]:
    """Pixels in ascending order, of which the plot's side holds at least two."""
    ascending = tuple(sorted({float(pixel) for pixel in pixels}))
    if not ascending or not (ascending[0] > 0.0 and ascending[-1] <= size / 2.0 < math.inf):
        raise InputError(
            f"expected `pixels` above 0 and at most half the side of {size:g} m, but got "
            f"{listed(f'{pixel:g}' for pixel in ascending) or 'none'}"
        )
    wholes = [(size / voxel, f"expected a `size` of whole voxels of {voxel:g} m", size)]
    for pixel in ascending:
        wholes += [
            (pixel / ascending[0], "expected each pixel as a multiple of the smallest", pixel),
            (size / pixel, f"expected each pixel as a part of the side of {size:g} m", pixel),
        ]
    for whole, message, number in wholes:
        if abs(whole - round(whole)) > _ROUNDING * whole:
            raise InputError(f"{message}, but got {number:g} m")
    return ascending


def _few_bands(sensor: str | Path | Sensor, most: int) -> Sensor:
    """The bands of an imaging sensor that plants have spectra for, evenly chosen."""
    found = load_instrument(sensor) if isinstance(sensor, str | Path) else sensor
    if not isinstance(found, Sensor):
        raise InputError(f"expected an imaging sensor, but got {found.name!r}")
    seen = visible_sensor(found)
    places = np.unique(np.linspace(0, len(seen.bands) - 1, min(most, len(seen.bands))).round())
    return seen if len(places) == len(seen.bands) else seen.select(places.astype(int).tolist())


def _headline(lost: pd.DataFrame, known: pd.DataFrame, threshold: float) -> list[str]:
    """For each sensor, at its least noise: how well any metric knows Shannon, richness and
    evenness, where that is lost, and how well species are recognised."""
    lines = []
    least = lost[lost["noise"] == lost["noise"].min()]
    for sensor, part in least.groupby("sensor", sort=False):
        for what in ("shannon", "richness", "evenness"):
            rows = part[part["diversity"] == what].set_index("metric")
            best = rows.loc["any"]
            if not np.isfinite(best["best_r2"]):
                lines.append(f"{sensor}: {what} does not vary over the communities.")
                continue
            metric = rows.drop(index="any")["best_r2"].idxmax()
            line = (
                f"{sensor}: of {what} the {metric} of spectra explains {100 * best['best_r2']:.0f} "
                f"% at pixels of {best['best_pixel_m']:g} m (the best by chance up to "
                f"{100 * best['by_chance']:.0f} %)"
            )
            below = f"below {100 * threshold:.0f} %"
            if best["best_r2"] < threshold:
                line += f"; every metric is {below} at every pixel"
            elif np.isfinite(best["lost_from_m"]):
                line += f"; every metric is {below} from {best['lost_from_m']:g} m on"
                line += f" [{best['q05']:g}, {best['q95']:g}]"
            else:
                line += f"; some metric is not {below} at the widest pixel"
                if np.isfinite(best["unknown_beyond_m"]):
                    line += f" that is known, {best['unknown_beyond_m']:g} m"
            lines.append(f"{line}.")
        mine = known[(known["sensor"] == sensor) & (known["noise"] == known["noise"].min())]
        pixel, count, found, chance = mine[["pixel_m", "species", "accuracy", "by_chance"]].iloc[0]
        lines.append(
            f"{sensor}: of pixels of {pixel:g} m that are mostly of one species, {100 * found:.0f} "
            f"% are recognised ({count:.0f} species, {100 * chance:.0f} % by chance)."
            if count
            else f"{sensor}: no two species lead in enough pixels of {pixel:g} m."
        )
    return lines


def _sections(
    table: pd.DataFrame,
    lost: pd.DataFrame,
    known: pd.DataFrame,
    composed: pd.DataFrame,
    threshold: float,
) -> list[Section]:
    curves = Picture(
        "agreement.png",
        figures.agreement_plot(table, threshold),
        "squared correlation of spectral metrics with diversity against the pixel",
        "Squared correlation over communities, at the least noise; bands are 5 to 95 % over "
        "bootstrapped communities. Below the dashed line a diversity counts as lost.",
    )
    skill = Picture(
        "recognition.png",
        figures.recognition_plot(known),
        "share of pixels whose species is recognised against the pixel",
        "Pixels that are at least half of one species, recognised by a linear discriminant that "
        "other communities trained; bands are 5 to 95 % over 20 trainings on halves of the same "
        "communities, not over communities; dotted is chance. Numbers are species that lead in "
        "enough pixels. Leaves of a species are all alike here: real ones are not, and are "
        "recognised less often.",
    )
    where = Table(
        lost,
        "Where each diversity is lost (–: at no pixel that is known). Of pixels wider than "
        "'unknown beyond' the metric is not known.",
    )
    how_well = "How well species are recognised; q05 and q95 are over 20 trainings."
    follows = (
        "Correlation over pairs of communities (Mantel) of the Bray-Curtis dissimilarity of their "
        "spectral species, which are clusters of the pixels of all communities, with that of their "
        "plant species."
    )
    return [
        Section("Diversity", [curves, where]),
        Section("Species", [skill, Table(known, how_well)]),
        Section("Composition", [Table(composed, follows)]),
        Section("All numbers", [Table(table, "Squared correlations.", folded=True)]),
    ]
