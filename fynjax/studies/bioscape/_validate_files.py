"""What `fynjax validate-plots` writes: tables, NetCDF, figures, a page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from fynjax.compare import (
    FLIGHT,
    MEASURES,
    MODEL,
    OTHERS,
    PREDICTORS,
    PlotSpectraPair,
    agreement_table,
    band_table,
    feature_table,
    mean_agreement,
    misfit_table,
)
from fynjax.io.raster import write_run
from fynjax.io.text import write_text
from fynjax.report.figures import (
    feature_plot,
    misfit_of_plots,
    residual_plot,
    save_figure,
    spectra_plot,
)
from fynjax.report.pages import Page, format_number
from fynjax.studies.bioscape._scenes import Resolution

_UNITS = {
    "spectral_angle": "degree", "rmse": "-", "nrmse": "-", "correlation": "-",
    "relative_mean_difference": "-", "ground_seen_percent": "%", "live_percent": "%",
    "dead_percent": "%", "bare_percent": "%", "sun_zenith_deg": "degree",
    "sun_azimuth_deg": "degree",
}  # fmt: skip
_HEADERS = {
    "spectral_angle": "SAM", "rmse": "RMSE", "nrmse": "NRMSE", "correlation": "r",
    "relative_mean_difference": "mean, (sim − real) / real", "live_percent": "live",
    "dead_percent": "dead", "bare_percent": "bare", "ground_seen_percent": "ground seen, simulated",
    "sun_zenith_deg": "sun zenith", "sun_azimuth_deg": "sun azimuth",
    "level_share": "level", "contrast_share": "contrast", "shape_share": "shape",
}  # fmt: skip
_ASSUMED = (
    "Measured: cover of live and dead vegetation, soil and rock; cover of the species; leaf mass "
    "per area and water content of a species, or the mean of its genus, family or growth form. "
    "Assumed, and the same for all plots: growth form, crown size, leaf area, leaf angles, "
    "pigments, the spectra of soil, litter and bark, level ground, and a view from straight above. "
    "The folder of each plot says of every number where it is from (sources.csv). No number was "
    "fitted to a measured spectrum. One choice was made after a look at three of them (Cape "
    "Peninsula plots T068, T072, T094): dead plants that stand have the spectrum of bark, where "
    "PROSPECT with brown pigments was tried before.",
    "A measured spectrum is the mean of the flights over the plot; the sun is that of the flight "
    "in the middle, by its height. Where no table names a flight the sun is assumed at 30 degrees "
    "zenith in the north.",
)


def write_report(
    output: Path,
    pair: PlotSpectraPair,
    about: pd.DataFrame,
    resolution: Resolution,
    record: Mapping[str, str | int],
) -> dict[str, Any]:
    """Write all of it into `output`; the summary for `run_job`."""
    _write_spectra(output, pair, record)
    files = {
        "report.html": "the report",
        "spectra.nc": "simulated and measured spectra",
        "spectra.csv": "the same, one row a plot and band",
        "plots.csv": "what was assumed and found of each plot",
    }
    measured = pair.those_measured()
    told = dict.fromkeys(pair.plots)
    for name in measured.plots:
        told.pop(name)
    count = len(measured.plots)
    page = Page(
        "Spectra of plots from their field tables",
        f"{len(pair.plots)} plots simulated from cover, species and leaf traits alone, "
        f"{count} of them compared with measured spectra.",
    )
    headline = [f"{len(pair.plots)} plots simulated, {count} with a measured spectrum."]
    numbers: dict[str, Any] = {}
    if count:
        line, numbers = _compare(output, page, measured, files)
        headline.append(line)
    else:
        save_figure(spectra_plot(pair), output / "spectra.png")
        page.section("Simulated spectra")
        page.paragraph("The folder has no measured spectrum of these plots: nothing to compare.")
        page.figure(output / "spectra.png", "Simulated spectrum of each plot.")
    about.to_csv(output / "plots.csv", index=False)
    page.section("The plots")
    page.table(about, units=_UNITS, headers=_HEADERS, digits=3)
    page.section("What was assumed")
    for text in _ASSUMED:
        page.paragraph(text)
    page.paragraph(
        f"A plot is a square of {resolution.size_m:g} m that repeats itself, in voxels of "
        f"{100 * resolution.voxel_m:g} cm."
    )
    page.footer(record)
    page.write(output / "report.html")
    warned = (
        [f"{len(told)} plots have no measured spectrum and were only simulated: {', '.join(told)}"]
        if told
        else []
    )
    return {
        "headline": headline,
        "files": files,
        "warnings": warned,
        "validate_plots": {
            "plots": list(pair.plots),
            "measured": list(measured.plots),
            "bands": int(pair.wavelength.size),
            "size_m": resolution.size_m,
            "voxel_m": resolution.voxel_m,
            **numbers,
        },
    }


def _compare(
    output: Path,
    page: Page,
    pair: PlotSpectraPair,
    files: dict[str, str],
) -> tuple[str, dict[str, Any]]:
    """Tables, figures and the part of the page on measured plots; a line that tells it, and
    numbers for the summary."""
    agreement, misfits = agreement_table(pair), misfit_table(pair)
    mean, bands, features = mean_agreement(agreement), band_table(pair), feature_table(pair)
    tables = {
        "agreement.csv": (agreement, "agreement by plot, predictor and region"),
        "agreement_mean.csv": (mean, "the same, means over the plots"),
        "misfit.csv": (misfits, "offset, gain and shape of each plot's misfit"),
        "bands.csv": (bands, "residual, errors and correlation by band"),
        "features.csv": (features, "how well the model tells plots apart"),
    }
    for name, (table, what) in tables.items():
        write_text(output / name, table.to_csv(index=False))
        files[name] = what
    full = {row["predictor"]: row for row in mean.to_dict("records") if row["region"] == "full"}
    model = full[MODEL]
    figures = {"RMSE of the model": format_number(model["rmse"], 3)}
    line = f"RMSE {model['rmse']:.4f}, SAM {model['spectral_angle']:.1f}°"
    if OTHERS in full:
        others = full[OTHERS]
        figures["RMSE of the mean of the other plots"] = format_number(others["rmse"], 3)
        figures["skill against that mean"] = format_number(model["skill"], 2)
        line += (
            f"; the mean of the other plots: {others['rmse']:.4f}, {others['spectral_angle']:.1f}°"
        )
    figures["SAM of the model"] = f"{model['spectral_angle']:.1f}°"
    if FLIGHT in full:
        figures["RMSE of one flight to the others"] = format_number(full[FLIGHT]["rmse"], 3)
    page.key_figures(figures)
    drawn = {
        "spectra": (spectra_plot, "Simulated and measured spectrum of each plot."),
        "residual": (
            residual_plot,
            "Where the model is off. Above zero the simulation is too bright. In the middle its "
            "error beside that of a predictor that knows fynbos but not the plot, and beside what "
            "one flight differs from the next. Below: a model that ranks the plots rightly has a "
            "correlation above the grey band, even where its level is wrong.",
        ),
        "misfit": (
            misfit_of_plots,
            "What the error of each plot is made of. Level and contrast are what one offset and "
            "one gain for the whole spectrum would repair; shape is what neither does.",
        ),
        "features": (
            feature_plot,
            "Simulated over measured, a point a plot; on the line is right.",
        ),
    }
    for name, (draw, caption) in drawn.items():
        if name == "features" and len(pair.plots) < 2:
            continue
        save_figure(draw(pair), output / f"{name}.png")
        files[f"{name}.png"] = caption.split(".")[0]
    page.section("Agreement, mean of the plots")
    page.paragraph(
        "Water windows (1340 to 1460 and 1790 to 2100 nm) and the sensor's edges are left out. "
        + " ".join(f"“{name}” is {what}." for name, what in PREDICTORS.items())
        + " Skill is 1 less the squared error over that of the mean of the other plots: 1 is "
        "perfect, below 0 is worse than that mean."
    )
    page.table(mean, units=_UNITS, headers=_HEADERS, digits=3)
    page.section("Where the model is off")
    page.figure(output / "residual.png", drawn["residual"][1])
    page.figure(output / "misfit.png", drawn["misfit"][1])
    page.section("Does the model tell plots apart?")
    if len(pair.plots) > 1:
        page.figure(output / "features.png", drawn["features"][1])
    page.table(features, digits=3, caption="Correlations are across plots.")
    page.section("Plot by plot")
    page.figure(output / "spectra.png", drawn["spectra"][1])
    page.table(misfits, digits=3, headers=_HEADERS, caption="Gain, offset and shares of the error")
    own = agreement[agreement["predictor"] == MODEL].drop(columns="predictor")
    page.table(own, units=_UNITS, headers=_HEADERS, digits=3, folded=True,
               caption="Agreement of the model, by plot and region")  # fmt: skip
    numbers = {
        "agreement": mean.to_dict("records"),
        "by_plot": own[own["region"] == "full"][["plot", *MEASURES]].to_dict("records"),
        "features": features.to_dict("records"),
    }
    return line + ".", numbers


def _write_spectra(output: Path, pair: PlotSpectraPair, record: Mapping[str, str | int]) -> None:
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
    write_run(output / "spectra.nc", dataset, record)
    count, bands = pair.simulated.shape
    table = pd.DataFrame(
        {"plot": np.repeat(pair.plots, bands), "wavelength_nm": np.tile(pair.wavelength, count)}
        | {name: values.ravel() for name, (values, _) in fields.items()}
    )
    write_text(output / "spectra.csv", table.to_csv(index=False, float_format="%.6g"))
