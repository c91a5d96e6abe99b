"""Figures of many plots whose spectra were simulated and measured."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from fynjax.app.compare import (
    FEATURES,
    PlotSpectraPair,
    band_table,
    chance_correlation,
    feature_values,
    misfit_table,
)
from fynjax.app.report.figures._style import (
    BLUE,
    GREY,
    ORANGE,
    REAL,
    SKY,
    VERMILION,
    Figure,
    panel_grid,
    style,
)

_GAP_NM = 30.0
"""Bands further apart than this are not joined by a line."""


def draw_line(
    axes: Axes, x: np.ndarray, y: np.ndarray, gap: float = _GAP_NM, **how: object
) -> None:
    """A curve that is broken where bands were left out."""
    cut = np.flatnonzero(np.diff(x) > gap) + 1
    axes.plot(np.insert(x, cut, np.nan), np.insert(y.astype(float), cut, np.nan), **how)  # type: ignore[arg-type]


def draw_band(
    axes: Axes,
    x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    gap: float = _GAP_NM,
    **how: object,
) -> None:
    """Shade what lies between two curves, with a gap where `draw_line` leaves one."""
    for part in np.split(np.arange(x.size), np.flatnonzero(np.diff(x) > gap) + 1):
        axes.fill_between(x[part], low[part], high[part], **how)  # type: ignore[arg-type]
        how.pop("label", None)


@style()
def spectra_plot(pair: PlotSpectraPair) -> Figure:
    """Every plot: simulated spectrum, measured mean and the range of its flights.

    **Arguments:** `pair`, the simulated and the measured spectra of the plots.
    """
    figure, panels = panel_grid(
        len(pair.plots), 4, (2.5, 1.75), (0.6, 0.7), sharex=True, sharey=True
    )
    for axes, name, simulated, flights in zip(
        panels, pair.plots, pair.simulated, pair.flights, strict=True
    ):
        if len(flights):
            low, high = flights.min(axis=0), flights.max(axis=0)
            draw_band(axes, pair.wavelength, low, high, color=GREY, alpha=0.3, linewidth=0)
            draw_line(axes, pair.wavelength, flights.mean(axis=0), color=REAL, lw=1.1)
        draw_line(axes, pair.wavelength, simulated, color=VERMILION, lw=1.1)
        label = f"{len(flights)} flights" if len(flights) else "not measured"
        axes.set_title(f"{name} ({label})", fontsize=8)
        axes.grid(True)
    panels[0].set_ylim(bottom=0.0)
    handles = [
        Line2D([], [], color=REAL, label="measured, mean and range of flights"),
        Line2D([], [], color=VERMILION, label="simulated"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2)
    figure.supxlabel("wavelength [nm]", fontsize=9)
    figure.supylabel("reflectance [-]", fontsize=9)
    return figure


@style()
def residual_plot(pair: PlotSpectraPair) -> Figure:
    """Residuals by band: mean, error, and correlation across plots.

    **Arguments:** `pair`, the simulated and the measured spectra of the plots.
    """
    table = band_table(pair)
    x = table["wavelength_nm"].to_numpy()
    column = {name: table[name].to_numpy() for name in table}
    several = len(pair.plots) > 2
    figure = Figure(figsize=(7.6, 7.2 if several else 5.0))
    axes = figure.subplots(3 if several else 2, 1, sharex=True)
    mean, sd = column["residual"], column["residual_sd"]
    draw_band(axes[0], x, mean - sd, mean + sd, color=VERMILION, alpha=0.2, linewidth=0,
          label="± 1 sd of the plots")  # fmt: skip
    draw_line(axes[0], x, mean, color=VERMILION, lw=1.4, label="mean of the plots")
    axes[0].axhline(0.0, color=GREY, lw=0.8)
    axes[0].set_title("Residual: simulated less measured")
    axes[0].set_ylabel("reflectance [-]")
    curves = (
        ("rmse_model", VERMILION, "model, from the tables alone"),
        ("rmse_others", BLUE, "mean of the other plots"),
        ("flight_sd", GREY, "sd of the flights over a plot"),
    )
    for name, color, label in curves:
        if np.isfinite(column[name]).any():
            draw_line(axes[1], x, column[name], color=color, lw=1.4, label=label)
    axes[1].set_ylim(0.0, 1.4 * axes[1].get_ylim()[1])  # room for the legend
    axes[1].set_title("Error by band (root mean square over the plots)")
    axes[1].set_ylabel("reflectance [-]")
    if several:
        chance = chance_correlation(len(pair.plots))
        axes[2].axhspan(-chance, chance, color=GREY, alpha=0.18, lw=0, label="chance (95 %)")
        draw_line(axes[2], x, column["correlation"], color=VERMILION, lw=1.4)
        axes[2].axhline(0.0, color=GREY, lw=0.8)
        axes[2].set_ylim(-1.0, 1.0)
        axes[2].set_title("Does it distinguish plots? Correlation across plots")
        axes[2].set_ylabel("r [-]")
    for panel in axes:
        panel.grid(True)
        if panel.get_legend_handles_labels()[0]:
            panel.legend(loc="best")
    axes[-1].set_xlabel("wavelength [nm]")
    return figure


@style()
def misfit_of_plots(pair: PlotSpectraPair) -> Figure:
    """Parts of the squared error of each plot, and the size of the error.

    **Arguments:** `pair`, the simulated and the measured spectra of the plots.
    """
    table = misfit_table(pair).sort_values("rmse", ascending=True)
    y = np.arange(len(table))
    figure = Figure(figsize=(7.6, 0.2 * len(table) + 1.5))
    axes = figure.subplots(1, 1)
    left = np.zeros(len(table))
    parts = (
        ("level_share", SKY, "level: an offset repairs it"),
        ("contrast_share", ORANGE, "contrast: a gain repairs it"),
        ("shape_share", VERMILION, "shape: neither does"),
    )
    for name, color, label in parts:
        length = table["rmse"].to_numpy() * table[name].to_numpy()
        axes.barh(y, length, left=left, color=color, label=label)
        left += length
    axes.set_yticks(y, list(table["plot"]))
    axes.set_xlabel("RMSE [-], divided by the shares of the squared error")
    axes.grid(True, axis="x")
    figure.legend(loc="outside upper right", ncols=3)
    return figure


@style()
def feature_plot(pair: PlotSpectraPair) -> Figure:
    """Simulated over measured features of the spectra, a point for each plot.

    **Arguments:** `pair`, the simulated and the measured spectra of the plots.
    """
    real, simulated = (feature_values(pair.wavelength, s) for s in (pair.measured, pair.simulated))
    figure, panels = panel_grid(len(FEATURES), 4, (2.3, 2.35))
    for axes, (name, (what, _)) in zip(panels, FEATURES.items(), strict=True):
        x, y = real[name], simulated[name]
        ends = np.array([min(x.min(), y.min()), max(x.max(), y.max())])
        ends += 0.05 * (ends[1] - ends[0] + 1e-3) * np.array([-1.0, 1.0])
        axes.plot(ends, ends, color=GREY, lw=0.8)
        axes.plot(x, y, "o", ms=3.5, color=VERMILION, mec="white", mew=0.4)
        axes.set(xlim=ends, ylim=ends, aspect="equal")
        axes.set_title(what, fontsize=8)
        axes.grid(True)
    figure.supxlabel("measured", fontsize=9)
    figure.supylabel("simulated", fontsize=9)
    return figure
