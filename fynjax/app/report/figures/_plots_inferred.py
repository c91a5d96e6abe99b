"""Figures of what is estimated of plots from their spectra, and of their population."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.lines import Line2D

from fynjax.app.report.figures._plots import draw_band, draw_line
from fynjax.app.report.figures._style import BLUE, GREY, ORANGE, SERIES, VERMILION, Figure, style

_COLOURS = SERIES[:3]
"""Colours of the priors, in the order in which a table names them."""


@style()
def estimates_plot(
    table: pd.DataFrame,
    titles: dict[str, str],
    *,
    priors: Sequence[str],
    regression: str,
    measured_share: float,
) -> Figure:
    """Estimates with their 95 % intervals against the field, by prior and quantity.

    **Arguments:** `table`, a row for each plot, predictor and quantity; `titles` of the quantities,
    with their units; the predictors that are fits with `priors`, and the one that is a
    `regression`; `measured_share` of a plot's cover from which its mean trait counts as known [-].
    """
    colours = dict(zip(priors, _COLOURS))
    priors = [prior for prior in priors if (table["predictor"] == prior).any()]
    figure = Figure(figsize=(3.0 * len(titles), 0.5 + 2.9 * len(priors)))
    grid = figure.subplots(len(priors), len(titles), squeeze=False)
    for row, prior in zip(grid, priors):
        for axes, (name, title) in zip(row, titles.items()):
            part = table[table["quantity"] == name]
            of_prior = part[part["predictor"] == prior]
            plsr = part[part["predictor"] == regression]
            if len(plsr):
                axes.plot(plsr["field"], plsr["estimate"], "x", color=ORANGE, ms=5)
            for enough, fill in ((True, colours[prior]), (False, "white")):
                some = of_prior[(of_prior["measured_share"] >= measured_share) == enough]
                axes.errorbar(
                    some["field"],
                    some["estimate"],
                    [some["estimate"] - some["q025"], some["q975"] - some["estimate"]],
                    fmt="o", ms=4, lw=0.8, color=colours[prior], mfc=fill,
                )  # fmt: skip
            known = of_prior["field"][np.isfinite(of_prior["field"])]
            if len(known):
                low, high = known.min(), known.max()
                axes.axline((low, low), slope=1.0, color=GREY, lw=0.8)
                room = max(0.08 * (high - low), 0.02 * high)
                axes.set_xlim(low - room, high + room)
            axes.set_title(title, fontsize=9)
            axes.grid(True)
        row[0].set_ylabel(prior.split(", ")[1], fontsize=8)
    handles = [
        Line2D([], [], color=GREY, marker="o", ls="", label="trait measured on most cover"),
        Line2D([], [], color=GREY, marker="o", mfc="white", ls="", label="on less"),
        Line2D([], [], color=ORANGE, marker="x", ls="", label=regression),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3)
    figure.supxlabel("field", fontsize=9)
    figure.supylabel("estimate, 95 %", fontsize=9)
    return figure


@style()
def shifts_plot(parameters: pd.DataFrame) -> Figure:
    """Shift of each parameter from its prior, a point for each plot.

    **Arguments:** `parameters`, a row for each plot and parameter.
    """
    colours = dict(zip(parameters["predictor"].unique(), _COLOURS))
    priors, free = list(colours), list(parameters["parameter"].unique())
    figure = Figure(figsize=(7.4, 0.8 + 0.33 * len(free)))
    axes = figure.subplots()
    axes.axvspan(-1.0, 1.0, color=GREY, alpha=0.2, lw=0)
    for k, prior in enumerate(priors):
        rows = parameters[parameters["predictor"] == prior]
        for row, name in enumerate(free):
            shift = rows[rows["parameter"] == name]["shift"].to_numpy()
            y = np.full(shift.size, row + 0.25 * (k - 0.5 * (len(priors) - 1)))
            axes.plot(shift, y, "o", ms=3.5, alpha=0.6, color=colours[prior], mew=0)
            axes.plot([shift.mean()], y[:1], "|", ms=12, mew=2, color=colours[prior])
    axes.axvline(0.0, color=GREY, lw=0.8)
    axes.set_yticks(range(len(free)), [name.replace("_", " ") for name in free])
    axes.invert_yaxis()
    axes.set_xlabel("shift from the prior [prior standard deviations]")
    handles = [Line2D([], [], color=colours[p], marker="o", ls="", label=p) for p in priors]
    figure.legend(handles=handles, loc="outside upper right", fontsize=7.5)
    axes.grid(True, axis="x")
    return figure


@style()
def residuals_plot(
    wavelength: Float[np.ndarray, " band"], residuals: dict[str, Float[np.ndarray, "plot band"]]
) -> Figure:
    """Residuals of model and measurement, mean and spread over the plots.

    **Arguments:** `wavelength` [nm]; `residuals` of reflectance [-], by the name of the prior.
    """
    gap = 2.5 * float(np.median(np.diff(wavelength)))
    figure = Figure(figsize=(7.4, 3.2))
    axes = figure.subplots()
    colours = dict(zip(residuals, (GREY, *_COLOURS)))
    for name, rest in residuals.items():
        mean, sd = rest.mean(axis=0), rest.std(axis=0)
        draw_band(axes, wavelength, mean - sd, mean + sd, gap, color=colours[name], alpha=0.2, lw=0)
        draw_line(axes, wavelength, mean, gap, color=colours[name], lw=1.3, label=name)
    axes.axhline(0.0, color="black", lw=0.6)
    axes.set_xlabel("wavelength [nm]")
    axes.set_ylabel("model less measured [-]")
    axes.grid(True)
    figure.legend(loc="outside upper right", ncols=2)
    return figure


@style()
def population_plot(
    names: Sequence[str],
    mean: Float[np.ndarray, " parameter"],
    sd: Float[np.ndarray, " parameter"],
    plots: Float[np.ndarray, "plot parameter"],
    error: pd.DataFrame,
) -> Figure:
    """Means of a population and its plots, and the model's remaining error.

    **Arguments:** `names` of the parameters; `mean`, its standard error `sd` and values of the
    `plots`, in standard deviations of what was assumed; `error`, a row for each wavelength.
    """
    rows = np.arange(len(names))[::-1]
    figure = Figure(figsize=(7.4, 2.6 + 0.3 * len(names)))
    heights = (0.3 * len(names), 2.0)
    above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": heights})
    above.axvspan(-1.0, 1.0, color=GREY, alpha=0.2, lw=0)
    above.axvline(0.0, color=GREY, lw=0.8)
    for values in plots:
        above.plot(values, rows, "o", ms=3, alpha=0.5, color=BLUE, mew=0)
    above.errorbar(mean, rows, xerr=sd, fmt="|", ms=11, mew=2, lw=1.5, color=VERMILION)
    above.set_yticks(rows, names)
    above.set_xlabel("from what was assumed [assumed standard deviations]")
    below.plot(error["wavelength_nm"], error["sd"], ".", color=VERMILION, label="estimated")
    below.plot(error["wavelength_nm"], error["assumed_sd"], color=GREY, lw=0.8, label="assumed")
    below.set_ylim(bottom=0.0)
    below.set_xlabel("wavelength [nm]")
    below.set_ylabel("sd of log reflectance [-]")
    below.legend()
    return figure
