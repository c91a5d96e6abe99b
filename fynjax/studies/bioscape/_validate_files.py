"""Results of `fynjax bioscape validate`: tables, NetCDF, figures, a page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from fynjax.app.compare import (
    DISTANCE,
    FEATURES,
    FLIGHT,
    MEASURES,
    MODEL,
    OTHERS,
    PREDICTORS,
    REGRESSION,
    PlotSpectraPair,
    agreement_table,
    band_agreement,
    feature_table,
    mean_agreement,
    misfit_table,
    plot_diversity_table,
)
from fynjax.app.io.raster import write_run
from fynjax.app.jobs import JobResult, Rows, Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table, format_number
from fynjax.diversity import FEWEST_PLOTS, VARIETY
from fynjax.studies.bioscape._assumed import COVERS_MEAN
from fynjax.studies.bioscape._scenes import PlotSpectrum, Resolution

_UNITS = {
    "spectral_angle": "degree", "rmse": "-", "nrmse": "-", "correlation": "-",
    "relative_mean_difference": "-", "ground_seen_percent": "%", "live_percent": "%",
    "dead_percent": "%", "bare_percent": "%", "sun_zenith_deg": "degree",
    "sun_azimuth_deg": "degree", "intercept_bare_percent": "%", "intercept_bare_se_percent": "%",
}  # fmt: skip
_HEADERS = {
    "spectral_angle": "SAM", "rmse": "RMSE", "nrmse": "NRMSE", "correlation": "r",
    "relative_mean_difference": "mean, (sim − real) / real", "live_percent": "live",
    "dead_percent": "dead", "bare_percent": "bare", "ground_seen_percent": "ground seen, simulated",
    "sun_zenith_deg": "sun zenith", "sun_azimuth_deg": "sun azimuth",
    "intercept_bare_percent": "bare, line intercepts",
    "intercept_bare_se_percent": "its standard error",
    "q05": "5 %", "q95": "95 %", "p_value": "p", "p_of_all": "p of the largest",
    "level_share": "level", "contrast_share": "contrast", "shape_share": "shape",
}  # fmt: skip
_METRICS = {name: what for name, (what, _) in FEATURES.items()} | {
    "cv": "coefficient of variation", "angle": "mean angle to the mean spectrum",
    "rao": "Rao's Q", "variance": "variance, sum over bands",
    REGRESSION: "regression, skill", DISTANCE: "distance of spectra",
}  # fmt: skip
_UNLIKELY = 0.05
_ASSUMED = (
    "Measured: cover of live and dead vegetation, soil and rock; cover of the species; leaf mass "
    "per area and water content of a species, or the mean of its genus, family or growth form; "
    "from published tables also crown diameters, the height of the vegetation and the dead cover "
    "of species. "
    "Learned from the spectra of many plots, where a prior says so: leaf area, dead tissue "
    "and clumping of live shoots by growth form, factors on leaf chemistry, brightness of soil "
    "and dead tissue. A plot that the prior was learned from has the values learned from all "
    "others (column prior). "
    "Assumed, and the same for all plots: growth form, else crown size, leaf angles, the spectra "
    "of soil, litter and bark, level ground, and a view from straight above. The folder of each "
    "plot says of every number where it is from (sources.csv). Some choices were made with spectra "
    "of 18 of BioSCape's plots in sight, and are no test on these: that live shoots have dead "
    "tissue, and the shares of it (0.25 to 0.45) that were assumed before the shipped prior was "
    "learned; and, after a look at T068, T072 and T094, that dead plants that stand have the "
    "spectrum of bark. No other number was fitted to a measured spectrum.",
    "A measured spectrum is the mean of the flights over the plot; the sun is that of the flight "
    "in the middle, by its height. Where no table names a flight the sun is assumed at 30 degrees "
    "zenith in the north.",
)


class ValidatePlotsResult(JobResult):
    """Result of `validate_plots`: agreement of the model with the measured spectra."""

    command: Literal["bioscape validate"] = "bioscape validate"
    plots: list[str]
    measured: list[str]
    """Plots with a measured spectrum."""
    bands: int
    size_m: float
    voxel_m: float
    largest_residual: float
    """Largest residual of the light's equations over the plots [-]."""
    agreement: Rows | None = None
    """Agreement of each predictor, means over the plots: the rows of agreement_mean.csv."""
    by_plot: Rows | None = None
    """Agreement of the model with each plot over all bands: rows of agreement.csv."""
    features: Rows | None = None
    """Degree to which the model distinguishes plots: the rows of features.csv."""
    diversity: Rows | None = None
    """Correlations and skills of spectra with the diversity of the species: the rows of
    diversity.csv; of at least five plots."""


def write_report(
    run: Run,
    pair: PlotSpectraPair,
    about: pd.DataFrame,
    resolution: Resolution,
    inputs: Sequence[str | Path | None],
    *,
    cover: Float[np.ndarray, "plot species"],
    spectra: Sequence[PlotSpectrum],
    warnings: list[str],
) -> ValidatePlotsResult:
    """Write tables, spectra, figures and the page."""
    record = run.record(inputs)
    _write_spectra(run, pair, record)
    run.table("plots.csv", about, "what was assumed of each plot and what was measured", None)
    measured = pair.those_measured()
    unmeasured = [name for name in pair.plots if name not in measured.plots]
    count = len(measured.plots)
    headline = [
        f"{len(pair.plots)} plots simulated, {count} with a measured spectrum. {COVERS_MEAN}"
    ]
    keys: dict[str, str] = {}
    rows: dict[str, pd.DataFrame] = {}
    if count:
        variety = {
            name: np.array([s.variety[i] for s in spectra], float) for i, name in enumerate(VARIETY)
        }
        sentence, keys, sections, rows = _compare(run, pair, measured, cover, variety)
        headline.append(sentence)
    else:
        text = "The folder has no measured spectrum of these plots: nothing to compare."
        what = "simulated spectrum of each plot"
        picture = Picture("spectra.png", figures.spectra_plot(pair), what)
        sections = [Section("Simulated spectra", [text, picture])]
    square = (
        f"A plot is a square of {resolution.size_m:g} m that repeats itself, in voxels of "
        f"{100 * resolution.voxel_m:g} cm."
    )
    sections += [
        Section("The plots", [Table(about, units=_UNITS, headers=_HEADERS, digits=3)]),
        Section("What was assumed", [*_ASSUMED, square]),
    ]
    lead = (
        f"{len(pair.plots)} plots simulated from cover, species and leaf traits alone, {count} of "
        "them compared with measured spectra."
    )
    title = "Spectra of plots from their field tables"
    run.page(Page("bioscape validate", title, lead, sections, keys, record))
    if unmeasured:
        text = f"{len(unmeasured)} plots have no measured spectrum and were only simulated"
        warnings = [f"{text}: {', '.join(unmeasured)}", *warnings]
    return run.result(
        ValidatePlotsResult,
        headline=headline,
        warnings=warnings,
        plots=pair.plots,
        measured=measured.plots,
        bands=pair.wavelength.size,
        size_m=resolution.size_m,
        voxel_m=resolution.voxel_m,
        largest_residual=max(float(s.residual) for s in spectra),
        **rows,
    )


def _compare(
    run: Run,
    pair: PlotSpectraPair,
    measured: PlotSpectraPair,
    cover: Float[np.ndarray, "plot species"],
    variety: Mapping[str, Float[np.ndarray, " plot"]],
) -> tuple[str, dict[str, str], list[Section], dict[str, pd.DataFrame]]:
    """Write the tables of the plots that were `measured`, of all in `pair`.

    Returns the agreement in a sentence and as key figures, sections, and rows for the result.
    """
    agreement, features = agreement_table(measured), feature_table(measured)
    mean, misfit = mean_agreement(agreement), misfit_table(measured)
    for name, table, what in (
        ("agreement.csv", agreement, "agreement by plot, predictor and region"),
        ("agreement_mean.csv", mean, "agreement, means over the plots"),
        ("misfit.csv", misfit, "offset, gain and shape of each plot's misfit"),
        ("bands.csv", band_agreement(measured), "residual, errors and correlation by band"),
        ("features.csv", features, "how well the model distinguishes plots"),
    ):
        run.table(name, table, what, None)
    of_model = agreement[agreement["predictor"] == MODEL].drop(columns="predictor")
    sections = _comparison(measured, mean, of_model, misfit, features)
    full = of_model[of_model["region"] == "full"]
    rows = {"agreement": mean, "by_plot": full[["plot", *MEASURES]], "features": features}
    if len(measured.plots) >= FEWEST_PLOTS:
        there = np.array([name in measured.plots for name in pair.plots])
        seen = {name: values[there] for name, values in variety.items()}
        diversity = plot_diversity_table(measured, cover[there], seen, seed=run.seed)
        run.table("diversity.csv", diversity, "how spectra follow diversity of species", None)
        sections.append(_diversity(diversity))
        rows["diversity"] = diversity
    return *_agreement(mean), sections, rows


def _diversity(table: pd.DataFrame) -> Section:
    """The section on how spectra follow the diversity of species."""
    table = table.drop(columns="metric").assign(metric=table["metric"].replace(_METRICS))
    best = table[table["p_value"] <= _UNLIKELY]
    return Section(
        "Do spectra follow the diversity of the species?",
        [
            "Correlations across plots of features of the mean spectrum, and of how much spectra "
            "within a plot differ: measured ones of each two flights, simulated ones of pixels of "
            "a voxel's edge. Of the regression the value is its skill on plots left out, of the "
            "distance Mantel's correlation with the Bray-Curtis dissimilarity of the covers. "
            "Intervals are those of 5 to 95 % over bootstrapped plots; p is the probability that "
            "plots exchanged have a value as large, and the last column that the largest of all "
            "metrics then is.",
            Table(best, f"Values with a p of at most {_UNLIKELY:g}", headers=_HEADERS, digits=3),
            Table(table, "All of them", headers=_HEADERS, digits=3, folded=True),
        ],
    )


def _agreement(mean: pd.DataFrame) -> tuple[str, dict[str, str]]:
    """The agreement over all bands in a sentence, and as key figures."""
    full = {row["predictor"]: row for row in mean.to_dict("records") if row["region"] == "full"}
    model = full[MODEL]
    numbers = {"RMSE of the model": format_number(model["rmse"], 3)}
    sentence = f"RMSE {model['rmse']:.4f}, SAM {model['spectral_angle']:.1f}°"
    if OTHERS in full:
        others = full[OTHERS]
        numbers["RMSE of the mean of the other plots"] = format_number(others["rmse"], 3)
        numbers["skill against that mean"] = format_number(model["skill"], 2)
        sentence += (
            f"; the mean of the other plots: {others['rmse']:.4f}, {others['spectral_angle']:.1f}°"
        )
    numbers["SAM of the model"] = f"{model['spectral_angle']:.1f}°"
    if FLIGHT in full:
        numbers["RMSE of one flight to the others"] = format_number(full[FLIGHT]["rmse"], 3)
    return f"{sentence}.", numbers


def _comparison(
    pair: PlotSpectraPair,
    mean: pd.DataFrame,
    of_model: pd.DataFrame,
    misfit: pd.DataFrame,
    features: pd.DataFrame,
) -> list[Section]:
    """The sections on measured plots, from the tables of their agreement."""
    columns: dict[str, Any] = {"units": _UNITS, "headers": _HEADERS, "digits": 3}
    agreement: list[Part] = [
        "Water windows (1340 to 1460 and 1790 to 2100 nm) and the sensor's edges are left out. "
        + " ".join(f"“{name}” is {what}." for name, what in PREDICTORS.items())
        + " Skill is 1 less the squared error over that of the mean of the other plots: 1 is "
        "perfect, below 0 is worse than that mean.",
        Table(mean, **columns),
    ]
    errors = [
        Picture(
            "residual.png",
            figures.residual_plot(pair),
            "error of the model by band",
            "Error of the model by band. Above zero the simulation is too bright. In the middle "
            "its error beside that of a predictor that knows fynbos but not the plot, and beside "
            "what one flight differs from the next. Below: a model that ranks the plots rightly "
            "has a correlation above the grey band, even where its level is wrong.",
        ),
        Picture(
            "misfit.png",
            figures.misfit_of_plots(pair),
            "level, contrast and shape of each plot's error",
            "What the error of each plot is made of. Level and contrast are what one offset and "
            "one gain for the whole spectrum would repair; shape is what neither does.",
        ),
    ]
    distinguished: list[Part] = []
    if len(pair.plots) > 1:
        distinguished.append(
            Picture(
                "features.png",
                figures.feature_plot(pair),
                "spectral features, simulated over measured",
                "Simulated over measured, a point a plot; on the line is right.",
            )
        )
    distinguished.append(Table(features, "Correlations are across plots.", digits=3))
    each: list[Part] = [
        Picture(
            "spectra.png",
            figures.spectra_plot(pair),
            "simulated and measured spectrum of each plot",
        ),
        Table(misfit, "Gain, offset and shares of the error", headers=_HEADERS, digits=3),
        Table(of_model, "Agreement of the model, by plot and region", folded=True, **columns),
    ]
    return [
        Section("Agreement, mean of the plots", agreement),
        Section("Where the model is off", errors),
        Section("Does the model distinguish plots?", distinguished),
        Section("Plot by plot", each),
    ]


def _write_spectra(run: Run, pair: PlotSpectraPair, record: Mapping[str, str | int]) -> None:
    sd = np.stack(
        [f.std(axis=0, ddof=1) if len(f) > 1 else np.full(pair.wavelength.size, np.nan)
         for f in pair.flights]
    )  # fmt: skip
    fields = {
        "simulated": (pair.simulated, "reflectance simulated from the plot's tables"),
        "measured": (pair.measured, "measured reflectance, mean of the flights"),
        "measured_sd": (sd, "standard deviation of the flights"),
    }
    dataset = xr.Dataset(
        {
            name: (("plot", "band"), values, {"units": "1", "long_name": what})
            for name, (values, what) in fields.items()
        },
        coords={
            "plot": ("plot", list(pair.plots), {"long_name": "name of the plot"}),
            "wavelength": (
                "band",
                pair.wavelength,
                {
                    "units": "nm",
                    "standard_name": "sensor_band_central_radiation_wavelength",
                    "long_name": "band centre",
                },
            ),
        },
    )
    write_run(run.path("spectra.nc", "simulated and measured spectra"), dataset, record)
    count, bands = pair.simulated.shape
    table = pd.DataFrame(
        {"plot": np.repeat(pair.plots, bands), "wavelength_nm": np.tile(pair.wavelength, count)}
        | {name: values.ravel() for name, (values, _) in fields.items()}
    )
    run.table("spectra.csv", table, "simulated and measured spectra, one row a plot and band")
