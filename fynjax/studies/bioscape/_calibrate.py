"""`fynjax bioscape calibrate`: field tables and spectra in, covers, stand and leaf traits out."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.app.io.plot import DEFAULT_PRIOR, LearnedPrior, Plot, read_plot, read_prior
from fynjax.app.jobs import Run
from fynjax.inversion import spectrum_view
from fynjax.scene import PlotParameters, Scene
from fynjax.sensors import BandSet
from fynjax.studies.bioscape._inversion import (
    FREE,
    MOST_BANDS,
    QUANTITIES,
    ROOM,
    SOFTNESS,
    PlotCase,
    PlotEstimate,
    PlotSpectrumForward,
    ReferencePlot,
    bias_corrected_data,
    flight_covariance,
    infer_plot,
    plot_data,
    prior_space,
)
from fynjax.studies.bioscape._inversion_compare import (
    BIAS_CORRECTED,
    MEAN,
    OTHERS_PRIOR,
    REGRESSION,
    TABLE,
    TABLES_PRIOR,
    Field,
    estimate_table,
    field_values,
    others,
    simple_table,
)
from fynjax.studies.bioscape._inversion_files import CalibratePlotsResult, Findings, write_findings
from fynjax.studies.bioscape._plot_files import planted_files, write_plot_files
from fynjax.studies.bioscape._plots import BioscapePlot, read_bioscape
from fynjax.studies.bioscape._plsr import read_leaf_mass_model
from fynjax.studies.bioscape._scenes import (
    ACCURACY,
    COARSE,
    Resolution,
    build_scenes,
    slots_of,
    slotted_parameters,
)
from fynjax.studies.bioscape._spectra import (
    PlotSpectra,
    Spectrometer,
    read_plot_spectra,
    read_spectrometer,
)
from fynjax.studies.bioscape._traits import SOURCES, Sourced
from fynjax.studies.bioscape._validate import used_bands

_FEWEST_FOR_PRIOR, _FEWEST_FOR_CORRECTION = 4, 6
"""Plots from which on the others are a prior, and a bias correction."""


@dataclass(frozen=True)
class Prior:
    """One way of knowing the plots before their spectra."""

    name: str
    plots: list[BioscapePlot]
    """The plots, with the traits that their scenes are built with."""
    parameters: list[PlotParameters]
    elsewhere: Sequence[dict[str, tuple[float, float]] | None]
    """Mean and standard deviation of quantities over the other plots, for each plot; None where the
    plot's own tables are the prior."""


@double_precision
def calibrate_plots(
    folder: str | Path,
    output: str | Path,
    *,
    plots: Sequence[str] | None = None,
    traits: str | Path | None = None,
    prior: str | Path = DEFAULT_PRIOR,
    resolution: Resolution = COARSE,
    realisations: int = 3,
    seed: Seed = 0,
    checkpoint: str | Path,
    workers: Workers | None = None,
) -> CalibratePlotsResult:
    """Infer covers, leaf area, dead tissue, gap and leaf traits of plots from measured spectra.

    Once with the plot's own tables as a weak prior, once with the other plots' means. Compares with
    the field's community-weighted means, and with a published regression (`*LMA*model*.json`) if
    the folder has it. An interrupted run goes on when the same command is given again.

    **Arguments:**

    - `folder`: folder with *CoverData.csv, *VegData.csv, *TraitLibrary.csv and, for the measured
      spectra, *VegCenters.csv and *waves.csv.
    - `output`: folder of the results, made if missing.
    - `plots`: only this plot, by its name; all if left out.
    - `traits`: trait library, if it is not in the folder.
    - `prior`: population that the plots are of: the name of a shipped one, a file that `fynjax
      bioscape learn` wrote, or none: what is assumed before one is learned. Plots that it was
      learned from have the values learned from all others; variances and the model's error are of
      all.
    - `resolution`: size and voxels of the simulated plots.
    - `realisations`: stand realisations of each plot, from which the variance over them is
      estimated; at least 3.
    - `seed`: seed of the positions of the plants.
    - `checkpoint`: folder that keeps the fit of each plot, from which an interrupted run goes on.
    - `workers`: where the plots are inferred; in this process by default.

    **Returns:** `CalibratePlotsResult`. Writes tables, figures and a page into `output`.

    **Raises:** `InputError` for tables that are missing or cannot be read, plots without spectra,
    a checkpoint of another run, plots whose fit failed, and workers as `Workers` has it.
    """
    run = Run(output, seed=seed)
    folder = Path(folder)
    if realisations < 3:
        raise InputError(f"expected three stand realisations or more, but got {realisations}")
    learned = read_prior(prior)
    everything = read_bioscape(folder, plots, traits=traits)
    spectrometer, measured = read_spectrometer(folder), read_plot_spectra(folder)
    read = [p for p in everything if p.name in measured and measured[p.name].times]
    if not read:
        raise InputError("none of the plots has a measured spectrum to learn from", file=folder)
    bands, flights = chosen_bands(spectrometer, [measured[p.name] for p in read], folder)
    begin_work({"estimates.csv": f"{len(read)} plots", "report.html": ""})
    files, remarks = planted_files(run, read, learned)
    field = field_values(read)
    slots = slots_of(files)
    with run.stage("Plant the plots"):
        stands, parameters = _stands(files, resolution, realisations, seed)
    priors = [Prior(TABLES_PRIOR, read, parameters, [None] * len(read))]
    if len(read) >= _FEWEST_FOR_PRIOR:
        priors.append(_elsewhere(read, slots, field, learned))
    if len(read) >= _FEWEST_FOR_CORRECTION:
        priors.append(replace(priors[-1], name=BIAS_CORRECTED))
    view = spectrum_view(bands, stands[0][0], parameters[0], ACCURACY)
    repeatability = flight_covariance(flights)
    error = None if learned is None else learned.model_error.covariance(np.asarray(bands.centre))
    data = [plot_data(view.names, f, repeatability, error) for f in flights]
    predict = PlotSpectrumForward(view, tuple(form == "deadwood" for form in slots))
    inputs = [*sorted([*folder.glob("*.csv"), *folder.glob("*.json")]), traits]
    inputs += [] if learned is None else [learned.path]
    settings = (resolution, realisations, [p.name for p in read], FREE, len(bands))
    journal = run.journal(checkpoint, settings, files=inputs)
    cases = {
        prior.name: [
            PlotCase(spectrum, prior_space(plot, known, learned), parameters, tuple(scenes))
            for spectrum, plot, known, parameters, scenes in zip(
                data, prior.plots, prior.elsewhere, prior.parameters, stands, strict=True
            )
        ]
        for prior in priors
    }
    with run.stage("Infer", total=len(priors) * len(read)), at_work(workers) as pool:
        estimates: dict[str, list[PlotEstimate]] = {}
        for name, of_prior in cases.items():
            if name == BIAS_CORRECTED:
                of_prior = _corrected(of_prior, estimates[TABLES_PRIOR], flights)
            each = [f"plot {plot.name}, {name}" for plot in read]
            found = pool.all(infer_plot, of_prior, predict, names=each, journal=journal)
            estimates[name] = [
                PlotEstimate.of(case.space, arrays) for case, arrays in zip(of_prior, found)
            ]
            for fit, plot in zip(estimates[name], read):
                if not (np.isfinite(fit.after).all() and np.isfinite(fit.covariance).all()):
                    raise InputError(
                        f"the fit of plot {plot.name!r} is not finite; is its spectrum a "
                        "reflectance?",
                        file=folder,
                    )
    with run.stage("Write"):
        spectra = np.stack([np.asarray(one.value) for one in data])
        tables = _tables(read, priors, estimates, field)
        names = tuple(plot.name for plot in read)
        if regression := read_leaf_mass_model(folder):
            means = np.stack([measured[name].reflectance.mean(axis=0) for name in names])
            try:
                mass = {"leaf_mass_per_area": regression.predict(spectrometer.centre, means)}
            except ValueError as error:
                raise InputError(str(error), file=folder) from error
            tables.append(simple_table(names, REGRESSION, mass, field))
        table = pd.concat(tables, ignore_index=True)
        centres = np.asarray(bands.centre)
        findings = Findings(names, centres, spectra, estimates, table)
        if lost := [plot.name for plot in everything if plot not in read]:
            remarks.append(
                f"{len(lost)} plots have no measured spectrum and are left out: {', '.join(lost)}"
            )
        return write_findings(run, findings, resolution, realisations, inputs, warnings=remarks)


def _corrected(
    cases: Sequence[PlotCase],
    fits: Sequence[PlotEstimate],
    flights: Sequence[Float[np.ndarray, "flight band"]],
) -> list[PlotCase]:
    """Plots with spectra corrected by the mean residual of the other plots' fits."""
    rest = np.stack([np.asarray(c.data.value) - fit.before for c, fit in zip(cases, fits)])
    corrected = []
    for i, (case, spectra) in enumerate(zip(cases, flights)):
        data, bias = bias_corrected_data(case.data.names, spectra, np.delete(rest, i, axis=0))
        corrected.append(case._replace(data=data, bias=bias))
    return corrected


def chosen_bands(
    spectrometer: Spectrometer, spectra: Sequence[PlotSpectra], folder: Path
) -> tuple[BandSet, list[Float[np.ndarray, "flight band"]]]:
    """Some `MOST_BANDS` bands that every spectrum has, and the spectra there."""
    keep = used_bands(spectrometer)
    there = np.all([np.isfinite(s.reflectance[:, keep]).all(axis=0) for s in spectra], axis=0)
    keep = keep[there]
    if keep.size < 10:
        raise InputError(
            f"only {keep.size} bands outside the water windows have a value in every spectrum",
            file=folder,
        )
    every = -(-keep.size // MOST_BANDS)
    keep = keep[every // 2 :: every]
    centre, fwhm = spectrometer.centre[keep], spectrometer.fwhm[keep]
    bands = BandSet(tuple(f"{c:.1f}nm" for c in centre), tuple(centre), tuple(fwhm))
    return bands, [s.reflectance[:, keep] for s in spectra]


def _stands(
    files: Sequence[Plot], resolution: Resolution, realisations: int, seed: int
) -> tuple[list[list[Scene]], list[PlotParameters]]:
    """Realisations of the stand of every plot, and the plot's parameters."""
    each = [(file, seed + k) for file in files for k in range(realisations)]
    planted = build_scenes(
        [f for f, _ in each], resolution, [s for _, s in each], room=ROOM, softness=SOFTNESS
    )
    # In expectation the stands are smooth functions of the covers.
    scenes = [scene.expected() for scene, _ in planted]
    stands = [scenes[i : i + realisations] for i in range(0, len(scenes), realisations)]
    return stands, [parameters for _, parameters in planted[::realisations]]


def _elsewhere(
    read: Sequence[BioscapePlot], slots: tuple[str, ...], field: Field, learned: LearnedPrior | None
) -> Prior:
    """The prior that other plots are: every species has the mean traits of the other plots."""
    known = {name: others(field.value[name]) for name in QUANTITIES}
    plots, parameters, elsewhere = [], [], []
    for i, plot in enumerate(read):
        mean = {
            name: Sourced(float(known[name][0][i]), SOURCES[-1])
            for name in ("leaf_mass_per_area", "water_content")
        }
        species = tuple(replace(s, traits={**s.traits, **mean}) for s in plot.species)
        plots.append(replace(plot, species=species))
        with tempfile.TemporaryDirectory() as work:
            write_plot_files(plots[-1], work, learned)
            file = read_plot(Path(work) / "plot.toml")
            parameters.append(slotted_parameters(file, slots))
        elsewhere.append(
            {name: (float(mean[i]), float(sd[i])) for name, (mean, sd) in known.items()}
        )
    return Prior(OTHERS_PRIOR, plots, parameters, elsewhere)


def _tables(
    read: Sequence[BioscapePlot],
    priors: Sequence[Prior],
    estimates: dict[str, list[PlotEstimate]],
    field: Field,
) -> list[pd.DataFrame]:
    """Every quantity of every plot by each prior, by the tables and by the other plots' mean."""
    tables = [
        estimate_table(
            read, prior.name, [ReferencePlot(p) for p in prior.plots], estimates[prior.name], field
        )
        for prior in priors
    ]
    names = tuple(p.name for p in read)
    of_tables = {
        name: np.array([p.weighted_mean(name) for p in read], float)
        for name in ("leaf_mass_per_area", "water_content")
    }
    tables.append(simple_table(names, TABLE, of_tables, field))
    if len(read) > 1:
        mean = {name: others(value)[0] for name, value in field.value.items()}
        tables.append(simple_table(names, MEAN, mean, field))
    return tables
