"""`fynjax bioscape learn`: tables and spectra of many plots in, what the plots share out.

Each plot has a forward model in the parameters of `PER_PLOT`, linearised about its current
estimate; the linear mixed model of all plots gives the next (`fit_population`). Derivatives may be
of coarser voxels than values: the estimate ends where the values of the fine ones are explained.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.app.io.raster import file_hash
from fynjax.app.jobs import Run
from fynjax.inversion import LinearPlots, ParameterSpace, fit_population, spectrum_view
from fynjax.scene import PlotParameters, Scene
from fynjax.sensors import BandSet
from fynjax.studies.bioscape._calibrate import chosen_bands
from fynjax.studies.bioscape._learn_files import (
    ASSUMED,
    LEFT_OUT,
    LearnResult,
    Lesson,
    write_lesson,
)
from fynjax.studies.bioscape._plot_files import planted_files
from fynjax.studies.bioscape._plots import BioscapePlot, read_bioscape
from fynjax.studies.bioscape._population import (
    PER_PLOT,
    PopulationForward,
    effect_matrix,
    hyperprior,
    log_reflectance,
    population_space,
    uncovered,
)
from fynjax.studies.bioscape._scenes import ACCURACY, Resolution, build_scenes, slots_of
from fynjax.studies.bioscape._spectra import (
    PlotSpectra,
    Spectrometer,
    read_plot_spectra,
    read_spectrometer,
)

PASSES = 3
"""Linearisations of each plot."""
_FARTHEST = 2.0
"""A linearisation moves a parameter by so many assumed standard deviations at most."""
_FEWEST = 4


@double_precision
def learn(
    folders: Sequence[str | Path],
    output: str | Path,
    *,
    plots: Sequence[str] | None = None,
    traits: str | Path | None = None,
    resolution: Resolution | None = None,
    slope_voxel_m: Annotated[float, Field(ge=0.02, le=1.0)] = 0.25,
    title: str = "Plots of low shrubland",
    licence: str = "",
    sources: Sequence[str] = (),
    seed: Seed = 0,
    checkpoint: str | Path,
    workers: Workers | None = None,
) -> LearnResult:
    """Learn what plots share, and how they vary, from the tables and spectra of all at once.

    Growth forms' leaf area, dead tissue and clumping, leaf chemistry, brightness of soil and dead
    tissue, and the model's remaining error. An interrupted run goes on when the same command is
    given again.

    **Arguments:**

    - `folders`: folders with *CoverData.csv, *VegData.csv, *TraitLibrary.csv, *VegCenters.csv and
      *waves.csv, with the same bands. Names of plots differ.
    - `output`: folder of the results, made if missing.
    - `plots`: only this plot, by its name; all if left out.
    - `traits`: trait library, if it is not in the folder.
    - `resolution`: size and voxels of the simulated plots.
    - `slope_voxel_m`: edge of a voxel for derivatives [m]; that of the plots if smaller.
    - `title`: what the plots are, for the prior file.
    - `licence`: licence of the numbers, for the prior file.
    - `sources`: where the data are from, for the prior file; the input files with their hashes are
      added.
    - `seed`: seed of the positions of the plants.
    - `checkpoint`: folder that keeps the linearisations, from which an interrupted run goes on.
    - `workers`: where the plots are simulated; in this process by default.

    **Returns:** `LearnResult`. Writes `prior.toml`, tables, figures and a page into `output`.

    **Raises:** `InputError` for tables that are missing or cannot be read, fewer than four plots
    with a spectrum, plots of one name, other bands, a checkpoint of another run, plots
    that failed, and workers as `Workers` has it.
    """
    run = Run(output, seed=seed)
    resolution = Resolution() if resolution is None else resolution
    wide = Resolution(resolution.size_m, max(slope_voxel_m, resolution.voxel_m))
    read, bands, measured, remarks = _read(folders, plots, traits)
    begin_work({"prior.toml": f"learned from {len(read)} plots", "report.html": ""})
    files, said = planted_files(run, read, None)
    remarks += said
    with run.stage("Plant the plots"):
        # Each plot rounds its numbers of plants with a seed of its own.
        seeds = [seed + i for i in range(len(files))]
        fine = build_scenes(files, resolution, seeds)
        coarse = fine if wide == resolution else build_scenes(files, wide, seeds)
    inputs = sorted(p for folder in folders for p in Path(folder).glob("*.csv"))
    inputs += [] if traits is None else [Path(traits)]
    space, prior = population_space(), hyperprior(np.asarray(bands.centre))
    settings = (resolution, wide, [p.name for p in read], space, prior, len(bands), PASSES)
    journal = run.journal(checkpoint, settings, files=inputs)
    forms = slots_of(files)
    models = [
        PopulationForward(spectrum_view(bands, *scenes[0], ACCURACY), forms)
        for scenes in (fine, coarse)
    ]
    names = [f"plot {p.name}" for p in read]
    statistics = _statistics(read, measured)
    u = np.zeros((len(read), len(PER_PLOT)))
    before = np.empty(0)
    with at_work(workers) as pool:

        def each(stage: str, at: np.ndarray, differentiated: bool = False) -> np.ndarray:
            """Statistics or their derivatives of each plot at its own parameters."""
            scenes = coarse if differentiated else fine
            with run.stage(stage, total=len(read)):
                found = pool.all(
                    differentiate if differentiated else plot_statistics,
                    list(zip(scenes, at)), models[differentiated], space,
                    names=names, journal=journal,
                )  # fmt: skip
            for plot, (result,) in zip(read, found):
                if not np.isfinite(result).all():
                    raise InputError(f"the spectrum of plot {plot.name!r} is not finite")
            return np.stack([result for (result,) in found])

        for turn in range(PASSES):
            of = f"({turn + 1} of {PASSES})"
            predicted = each(f"Simulate {of}", u)
            before = before if turn else predicted
            slopes = each(f"Differentiate {of}", u, differentiated=True)
            linear = linear_plots(statistics, predicted, slopes, u)
            population = fit_population(linear, prior)
            # Each plot's own parameters, whitened; the last of `linear` is that of all plots.
            wanted = linear.design @ population.mean + population.effects @ linear.effects.T
            wanted = wanted[:, :-1]
            u = u + np.clip(wanted - u, -_FARTHEST, _FARTHEST)
        with run.stage("Leave each plot out"):
            left_out = [
                fit_population(linear.without(i), prior, population) for i in range(len(read))
            ]
        apart = each("Simulate plots left out", np.stack([p.mean[:-1] for p in left_out]))
    lesson = Lesson(
        title=title,
        licence=licence,
        sources=[*sources, *(f"{p.name}, SHA-256 {file_hash(p)[:16]}" for p in inputs)],
        plots=tuple(p.name for p in read),
        forms=forms,
        bands=bands,
        measured=np.stack(measured),
        space=space,
        prior=prior,
        population=population,
        left_out=left_out,
        ground=np.array([uncovered(p) for p in read]),
        predicted={ASSUMED: before, LEFT_OUT: apart},
        parameters=u,
        resolution=resolution,
    )
    with run.stage("Write"):
        return write_lesson(run, lesson, inputs, warnings=remarks)


def _statistics(
    plots: Sequence[BioscapePlot], measured: Sequence[Float[np.ndarray, " band"]]
) -> Float[np.ndarray, "plot statistic"]:
    """Of each plot the logarithms of its spectrum, and its ground that no crown covers."""
    spectra = np.asarray(log_reflectance(jnp.asarray(np.stack(measured))))
    return np.column_stack([spectra, [uncovered(plot) for plot in plots]])


def linear_plots(
    measured: Float[np.ndarray, "plot statistic"],
    predicted: Float[np.ndarray, "plot statistic"],
    slopes: Float[np.ndarray, "plot statistic parameter"],
    at: Float[np.ndarray, "plot parameter"],
) -> LinearPlots:
    """Plots linearised at their parameters `at`, whitened; what crews count as covered though
    ground shows through is one more parameter, the same in all plots, of the last statistic."""
    count, statistics, own = slopes.shape
    slope = np.zeros((count, statistics, own + 1))
    slope[..., :own] = slopes
    slope[:, -1, -1] = -1.0
    design = np.broadcast_to(np.eye(own + 1), (count, own + 1, own + 1))
    effects = np.vstack([effect_matrix(), np.zeros(effect_matrix().shape[1])])
    residual = measured - predicted + np.einsum("psk,pk->ps", slopes, at)
    return LinearPlots(residual, slope, design, effects)


def _read(
    folders: Sequence[str | Path], plots: Sequence[str] | None, traits: str | Path | None
) -> tuple[list[BioscapePlot], BandSet, list[np.ndarray], list[str]]:
    """Plots with a measured spectrum, its bands and values, remarks."""
    read: list[BioscapePlot] = []
    spectra: list[PlotSpectra] = []
    spectrometers: list[Spectrometer] = []
    remarks: list[str] = []
    for folder in map(Path, folders):
        everything = read_bioscape(folder, plots, traits=traits)
        flown = read_plot_spectra(folder)
        known = [p for p in everything if p.name in flown and flown[p.name].times]
        if missing := [p.name for p in everything if p not in known]:
            remarks.append(f"left out, without a measured spectrum: {', '.join(missing)}")
        if twice := {p.name for p in read} & {p.name for p in known}:
            raise InputError(
                f"expected plots of different names, but {min(twice)!r} is in two folders",
                file=folder,
            )
        if not known:
            continue
        spectrometers.append(read_spectrometer(folder))
        if not np.array_equal(spectrometers[0].centre, spectrometers[-1].centre):
            raise InputError("expected the bands of the first folder, but got others", file=folder)
        read += known
        spectra += [flown[p.name] for p in known]
    if len(read) < _FEWEST:
        raise InputError(
            f"expected {_FEWEST} plots with a measured spectrum or more to learn what plots share, "
            f"but got {len(read)}",
            file=Path(folders[0]),
        )
    bands, flights = chosen_bands(spectrometers[0], spectra, Path(folders[0]))
    return read, bands, [f.mean(axis=0) for f in flights], remarks


PlantedPlot = tuple[Scene, PlotParameters]
"""Scene and parameters of a plot."""
PlotAt = tuple[PlantedPlot, np.ndarray]
"""A plot, and its own parameters, whitened."""


def plot_statistics(plot: PlotAt, model: PopulationForward, space: ParameterSpace) -> tuple[Array]:
    """The statistics of a plot."""
    return (_value(model, space, plot[0], jnp.asarray(plot[1])),)


def differentiate(plot: PlotAt, model: PopulationForward, space: ParameterSpace) -> tuple[Array]:
    """Derivatives of the statistics of a plot by its parameters."""
    return (_slope(model, space, plot[0], jnp.asarray(plot[1])),)


@eqx.filter_jit
def _value(model: PopulationForward, space: ParameterSpace, plot: PlantedPlot, u: Array) -> Array:
    return model(space.physical(u), *plot)


@eqx.filter_jit
def _slope(model: PopulationForward, space: ParameterSpace, plot: PlantedPlot, u: Array) -> Array:
    return model.linearised(space, u, *plot)[1]
