"""`fynjax bioscape validate`: field tables in, simulated against measured spectra out."""

from collections.abc import Sequence, Set
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.checkpoint import Journal, signature
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.compare import PlotSpectraPair
from fynjax.diversity import VARIETY
from fynjax.inversion import nadir_imager
from fynjax.io.plot import DEFAULT_PRIOR, LearnedPrior, Plot, read_prior
from fynjax.io.raster import file_hash
from fynjax.jobs import Run
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
    seed: int = 0,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
) -> ValidatePlotsResult:
    """Simulate the spectra of a folder's plots from its tables and compare them with the measured.

    **Arguments:**

    - `folder`, `plots`, `traits`: as for `read_bioscape`; for the measured spectra the folder has
      `*VegCenters.csv` and `*waves.csv`.
    - `output`: folder of the results, made if missing.
    - `prior`: learned population (`read_prior`), or "none": what is assumed before one is
      learned. Plots that it was learned from have the values learned from all others.
    - `resolution`: size and voxels of the simulated plots, see `Resolution`.
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
    files, remarks = planted_files(run, folder, read, learned)
    with run.stage("Plant the plots"):
        scenes = build_scenes(files, resolution, [seed + i for i in range(len(files))])
    inputs = [*sorted(folder.glob("*.csv")), traits, None if learned is None else learned.path]
    journal = None
    if checkpoint is not None:
        settings = (resolution, seed, [p.name for p in read], bands.names)
        hashes = [file_hash(Path(path)) for path in inputs if path is not None]
        journal = Journal(checkpoint, signature(settings, hashes))
    imager = nadir_imager(bands, *scenes[0], ACCURACY)
    with run.stage("Simulate", total=len(read)), at_work(workers) as pool:
        names = [f"plot {p.name}" for p in read]
        found = pool.all(simulate_plot, scenes, imager, names=names, journal=journal)
    spectra = [PlotSpectrum(*arrays) for arrays in found]
    _check_finite(spectra, read)
    pair = PlotSpectraPair(
        tuple(p.name for p in read),
        spectrometer.centre[keep],
        np.stack([np.asarray(s.reflectance, float) for s in spectra]),
        tuple(_flights(measured.get(p.name), keep) for p in read),
    )
    if plots is None:
        remarks += _left_out(set(measured) - set(pair.plots))
    with run.stage("Write"):
        about = plot_table(read, files, spectra, measured)
        about["prior"] = [prior_words(learned, plot) for plot in read]
        return write_report(
            run,
            pair,
            about,
            resolution,
            inputs,
            cover=species_covers(read),
            variety=_variety(spectra),
            largest_residual=max(float(s.residual) for s in spectra),
            warnings=remarks,
        )


def _left_out(plots: Set[str]) -> list[str]:
    """A remark on plots that have spectra only."""
    if not plots:
        return []
    return [
        f"{len(plots)} plots have spectra but no row in the table of cover, and are left out: "
        f"{', '.join(sorted(plots))}"
    ]


def _variety(spectra: Sequence[PlotSpectrum]) -> dict[str, Float[np.ndarray, " plot"]]:
    """Degree to which spectra within each plot differ, by measure."""
    return {
        name: np.array([s.variety[i] for s in spectra], float) for i, name in enumerate(VARIETY)
    }


def used_bands(spectrometer: Spectrometer) -> np.ndarray:
    """Bands that are compared: outside the water windows and the sensor's edges, inside the
    model's wavelengths with all of their response."""
    centre, reach = spectrometer.centre, 2.2 * spectrometer.fwhm
    inside = (centre - reach >= _MODEL_NM[0]) & (centre + reach <= _MODEL_NM[1])
    return np.flatnonzero(spectral_mask(centre) & inside)


def prior_words(prior: LearnedPrior | None, plot: BioscapePlot) -> str:
    """Words for the data that a plot's population was learned from."""
    if prior is None:
        return "assumed"
    return "learned from the other plots" if prior.knows(plot.name) else "learned from other data"


def _flights(spectra: PlotSpectra | None, keep: np.ndarray) -> np.ndarray:
    return np.zeros((0, keep.size)) if spectra is None else spectra.reflectance[:, keep]


def species_covers(read: Sequence[BioscapePlot]) -> np.ndarray:
    """Live cover of each species on each plot as noted [plot, species], a share of the plot."""
    taxa = sorted({species.taxon for plot in read for species in plot.species})
    cover = np.zeros((len(read), len(taxa)))
    for row, plot in zip(cover, read, strict=True):
        for species in plot.species:
            row[taxa.index(species.taxon)] += species.cover
    return cover


def _check_finite(spectra: Sequence[PlotSpectrum], read: Sequence[BioscapePlot]) -> None:
    for plot, spectrum in zip(read, spectra):
        if not np.isfinite(spectrum.reflectance).all():
            raise InputError(f"the simulated spectrum of plot {plot.name!r} is not finite")


def _from_above(plot: BioscapePlot) -> dict[str, float]:
    """Share of points of the line intercepts that show bare ground, with its standard error."""
    if plot.view is None:
        return {}
    share, error = plot.view.share(plot.view.bare)
    return {"intercept_bare_percent": 100 * share, "intercept_bare_se_percent": 100 * error}


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
        rows.append(
            {
                "plot": plot.name,
                "species": len(plot.species),
                "live_percent": 100 * plot.live,
                "dead_percent": 100 * plot.dead,
                "bare_percent": 100 * (plot.soil + plot.rock),
                "ground_seen_percent": 100 * float(spectrum.ground_seen),
                **_from_above(plot),
                "sun_zenith_deg": file.sun.zenith,
                "sun_azimuth_deg": file.sun.azimuth,
                "sun_from": "flight" if flights(plot.visit) else "assumed",
                "flights": 0 if flown is None else len(flown.times),
                "flights_left_out": 0 if flown is None else flown.left_out,
                "remark": "" if plot.visit is None else plot.visit.remark,
            }
        )
    return pd.DataFrame(rows)
