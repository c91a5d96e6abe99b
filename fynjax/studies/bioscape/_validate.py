"""`fynjax bioscape validate`: field tables in, simulated against measured spectra out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.app.compare import PlotSpectraPair
from fynjax.app.io.plot import DEFAULT_PRIOR, Plot, read_prior
from fynjax.app.jobs import Run
from fynjax.inversion import nadir_imager
from fynjax.metrics import spectral_mask
from fynjax.sensors import BandSet
from fynjax.studies.bioscape._plot_files import flights, planted_files
from fynjax.studies.bioscape._plots import BioscapePlot, read_bioscape
from fynjax.studies.bioscape._scenes import (
    ACCURACY,
    PlotSpectrum,
    Resolution,
    build_scenes,
    simulate_plot,
)
from fynjax.studies.bioscape._spectra import (
    PlotSpectra,
    Spectrometer,
    read_plot_spectra,
    read_spectrometer,
)
from fynjax.studies.bioscape._validate_files import ValidatePlotsResult, write_report

_MODEL_NM = (400.0, 2500.0)
"""Wavelengths that leaf and ground spectra cover [nm]."""


@double_precision
def validate_plots(
    folder: str | Path,
    output: str | Path,
    *,
    plots: Sequence[str] | None = None,
    traits: str | Path | None = None,
    prior: str | Path = DEFAULT_PRIOR,
    resolution: Resolution | None = None,
    seed: Seed = 0,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
) -> ValidatePlotsResult:
    """Simulate plots from field tables alone, and compare with their measured spectra.

    An interrupted run goes on when the same command is given again.

    **Arguments:**

    - `folder`: folder with *CoverData.csv, *VegData.csv, *TraitLibrary.csv and, for the measured
      spectra, *VegCenters.csv and *waves.csv.
    - `output`: folder of the results, made if missing.
    - `plots`: only this plot, by its name; all if left out.
    - `traits`: trait library, if it is not in the folder.
    - `prior`: population that the plots are of: the name of a shipped one, a file that `fynjax
      bioscape learn` wrote, or none: what is assumed before one is learned. Plots that it was
      learned from have the values learned from all others.
    - `resolution`: size and voxels of the simulated plots.
    - `seed`: seed of the positions of the plants.
    - `checkpoint`: folder that keeps each plot's spectrum, from which an interrupted run goes on;
      none by default.
    - `workers`: where the plots are simulated; in this process by default.

    **Returns:** `ValidatePlotsResult`. Writes tables, figures and a page into `output`.

    **Raises:** `InputError` for tables that are missing or cannot be read, a checkpoint of another
    run, plots that failed, and workers as `Workers` has it.
    """
    run = Run(output, seed=seed)
    resolution = Resolution() if resolution is None else resolution
    folder = Path(folder)
    learned = read_prior(prior)
    read = read_bioscape(folder, plots, traits=traits)
    spectrometer, measured = read_spectrometer(folder), read_plot_spectra(folder)
    keep = used_bands(spectrometer)
    numbered = tuple(f"band_{i + 1}" for i in keep)
    bands = BandSet(numbered, tuple(spectrometer.centre[keep]), tuple(spectrometer.fwhm[keep]))
    begin_work({"plots.csv": f"{len(read)} plots", "report.html": ""})
    files, remarks = planted_files(run, read, learned)
    with run.stage("Plant the plots"):
        scenes = build_scenes(files, resolution, [seed + i for i in range(len(files))])
    inputs = [*sorted(folder.glob("*.csv")), traits, None if learned is None else learned.path]
    settings = (resolution, [p.name for p in read], bands.names)
    journal = run.journal(checkpoint, settings, files=inputs)
    imager = nadir_imager(bands, *scenes[0], ACCURACY)
    with run.stage("Simulate", total=len(read)), at_work(workers) as pool:
        names = [f"plot {p.name}" for p in read]
        found = pool.all(simulate_plot, scenes, imager, names=names, journal=journal)
    spectra = [PlotSpectrum(*arrays) for arrays in found]
    for plot, spectrum in zip(read, spectra):
        if not np.isfinite(spectrum.reflectance).all():
            raise InputError(f"the simulated spectrum of plot {plot.name!r} is not finite")
    pair = PlotSpectraPair(
        tuple(p.name for p in read),
        spectrometer.centre[keep],
        np.stack([np.asarray(s.reflectance, float) for s in spectra]),
        tuple(
            measured[p.name].reflectance[:, keep]
            if p.name in measured
            else np.zeros((0, keep.size))
            for p in read
        ),
    )
    if plots is None and (lost := set(measured) - set(pair.plots)):
        remarks.append(
            f"{len(lost)} plots have spectra but no row in the table of cover, and are left out: "
            f"{', '.join(sorted(lost))}"
        )
    with run.stage("Write"):
        about = plot_table(read, files, spectra, measured)
        about["prior"] = "assumed"
        if learned is not None:
            about["prior"] = [
                f"learned from {'the other plots' if learned.knows(plot.name) else 'other data'}"
                for plot in read
            ]
        return write_report(
            run,
            pair,
            about,
            resolution,
            inputs,
            cover=species_covers(read),
            spectra=spectra,
            warnings=remarks,
        )


def used_bands(spectrometer: Spectrometer) -> np.ndarray:
    """Bands that are compared: outside the water windows and the sensor's edges, inside the
    model's wavelengths with all of their response."""
    centre, reach = spectrometer.centre, 2.2 * spectrometer.fwhm
    inside = (centre - reach >= _MODEL_NM[0]) & (centre + reach <= _MODEL_NM[1])
    return np.flatnonzero(spectral_mask(centre) & inside)


def species_covers(read: Sequence[BioscapePlot]) -> np.ndarray:
    """Live cover of each species on each plot as noted [plot, species], a share of the plot."""
    taxa = sorted({species.taxon for plot in read for species in plot.species})
    cover = np.zeros((len(read), len(taxa)))
    for row, plot in zip(cover, read, strict=True):
        for species in plot.species:
            row[taxa.index(species.taxon)] += species.cover
    return cover


def plot_table(
    read: Sequence[BioscapePlot],
    files: Sequence[Plot],
    spectra: Sequence[PlotSpectrum],
    measured: dict[str, PlotSpectra],
) -> pd.DataFrame:
    """Assumptions and measurements, a row for each plot."""
    rows = []
    for plot, file, spectrum in zip(read, files, spectra):
        flown = measured.get(plot.name)
        from_above = {}
        if plot.view is not None:  # points of the line intercepts that show bare ground
            share, error = plot.view.share(plot.view.bare)
            from_above["intercept_bare_percent"] = 100 * share
            from_above["intercept_bare_se_percent"] = 100 * error
        rows.append(
            {
                "plot": plot.name,
                "species": len(plot.species),
                "live_percent": 100 * plot.live,
                "dead_percent": 100 * plot.dead,
                "bare_percent": 100 * (plot.soil + plot.rock),
                "ground_seen_percent": 100 * float(spectrum.ground_seen),
                **from_above,
                "sun_zenith_deg": file.sun.zenith,
                "sun_azimuth_deg": file.sun.azimuth,
                "sun_from": "flight" if flights(plot.visit) else "assumed",
                "flights": 0 if flown is None else len(flown.times),
                "flights_left_out": 0 if flown is None else flown.left_out,
                "remark": "" if plot.visit is None else plot.visit.remark,
            }
        )
    return pd.DataFrame(rows)
