"""Figures of a comparison of spectra, after figures 11 and 12 of the fynbos scene paper."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.patches import Patch

from fynjax.app.report.figures._style import GREY, REAL, VERMILION, Figure, style
from fynjax.app.report.figures._validation import SAMPLES, difference_bars
from fynjax.metrics import SPECTRAL_REGIONS

_NAMES = {"full": "All", "vnir": "VNIR", "swir1": "SWIR1", "swir2": "SWIR2"}


@style()
def mean_spectra_plot(spectra: pd.DataFrame, windows: Sequence[tuple[float, float]] = ()) -> Figure:
    """Mean spectra with one standard deviation, and their difference (figure 11).

    **Arguments:** `spectra` with the columns `wavelength_nm`, `used`, `real_mean`, `real_std`,
    `simulated_mean`, `simulated_std`; `windows` that are left out [nm], shaded.
    """
    wave = spectra["wavelength_nm"].to_numpy(float)
    used = spectra["used"].to_numpy(bool)
    # A line must not cross what is left out.
    gap = np.where(used, 1.0, np.nan)
    holes = np.flatnonzero(np.diff(wave) > 4.0 * np.median(np.diff(wave))) + 1

    def shown(column: str) -> np.ndarray:
        return np.insert(spectra[column].to_numpy(float) * gap, holes, np.nan)

    at = np.insert(wave, holes, wave[holes] if holes.size else [])
    figure = Figure(figsize=(8.6, 4.8))
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))
    for side, colour in SAMPLES:
        mean, spread = shown(f"{side}_mean"), shown(f"{side}_std")
        if np.isfinite(spread).any():
            top.fill_between(at, mean - spread, mean + spread, color=colour, alpha=0.18, lw=0)
        top.plot(at, mean, color=colour, lw=1.5, label=side)
    below.plot(at, shown("simulated_mean") - shown("real_mean"), color=VERMILION, lw=1.3)
    below.axhline(0.0, color="#444444", lw=0.7)
    for axes in (top, below):
        for low, high in windows:
            axes.axvspan(low, high, color="#EEEEEE", lw=0, zorder=0)
        for edge in (1000.0,):
            axes.axvline(edge, color="#BBBBBB", lw=0.7, ls=(0, (2, 2)), zorder=0)
        axes.grid(axis="y")
    top.set(ylabel="Reflectance [-]", ylim=(min(0.0, top.get_ylim()[0]), None))
    top.set_title("Mean spectra; bands: one standard deviation; grey: left out")
    top.legend(loc="upper right")
    below.set(ylabel="Simulated − real", xlabel="Wavelength [nm]")
    edges = wave[used] if used.any() else wave
    below.set_xlim(edges[0], edges[-1])
    return figure


@style()
def misfit_plot(spectra: pd.DataFrame, misfit: pd.DataFrame) -> Figure:
    """Simulated against real in each region, with the lines of no error, of a gain and an offset.

    **Arguments:** `spectra` as `mean_spectra_plot`; `misfit` with the columns `region`, `gain`,
    `offset`, `level_percent`, `contrast_percent`, `shape_percent`.
    """
    count = len(misfit)
    figure = Figure(figsize=(2.45 * max(count, 2), 3.5))
    grid = figure.subplots(1, max(count, 1), squeeze=False)[0]
    for axes, row in zip(grid, misfit.to_dict("records"), strict=False):
        low, high = SPECTRAL_REGIONS[row["region"]]
        part = spectra[
            spectra["used"] & spectra["wavelength_nm"].between(low, high, inclusive="both")
        ]
        x, y = part["real_mean"].to_numpy(float), part["simulated_mean"].to_numpy(float)
        both = np.concatenate([x, y])
        reach = 0.06 * max(float(np.ptp(both)), 1e-6)
        ends = np.array([both.min() - reach, both.max() + reach])
        axes.plot(ends, ends, color=GREY, lw=1.0, ls=(0, (4, 2)), label="no error")
        dots = axes.scatter(x, y, c=part["wavelength_nm"], s=9, cmap="viridis", vmin=400, vmax=2450)
        line = "no line,\nthe real spectrum is constant"
        if np.isfinite(row["gain"]):
            across = np.array([x.min(), x.max()])
            axes.plot(across, row["offset"] + row["gain"] * across, color=REAL, lw=1.3)
            line = (
                f"{row['gain']:.2f} real {'+' if row['offset'] >= 0 else '−'} "
                f"{abs(row['offset']):.3f}\nlevel {row['level_percent']:.0f} %, contrast "
                f"{row['contrast_percent']:.0f} %, shape {row['shape_percent']:.0f} %"
            )
        axes.set(xlim=ends, ylim=ends, xlabel="Real [-]", aspect="equal")
        axes.set_title(f"{_NAMES[row['region']]}: {line}", fontsize=8)
        axes.locator_params(nbins=4)
    grid[0].set_ylabel("Simulated [-]")
    if count:
        figure.colorbar(dots, ax=list(grid), label="Wavelength [nm]", location="bottom", aspect=50)
    return figure


@style()
def spectrometer_index_bars(indices: pd.DataFrame) -> Figure:
    """Indices of both mean spectra, and their differences (figure 12).

    **Arguments:** `indices` with the columns `index`, `real`, `simulated`, `real_std`,
    `simulated_std`, `difference_percent`.
    """
    largest = indices[["real", "simulated"]].abs().max(axis=1)
    table = pd.concat([indices[~(largest > 1.3)], indices[largest > 1.3]])
    split = int((~(largest > 1.3)).sum())
    figure = Figure(figsize=(8.6, 5.4))
    grid = figure.subplot_mosaic(
        [["small", "large"], ["change", "change"]],
        width_ratios=(max(split, 1), max(len(table) - split, 2)),
    )
    for key, part in (("small", table[:split]), ("large", table[split:])):
        axes = grid[key]
        place = np.arange(len(part), dtype=float)
        for shift, (side, colour) in zip((-0.2, 0.2), SAMPLES, strict=True):
            axes.bar(
                place + shift,
                part[side],
                width=0.38,
                color=colour,
                yerr=part[f"{side}_std"].fillna(0.0),
                error_kw={"lw": 0.8, "ecolor": GREY},
            )
        axes.set_xticks(place, part["index"], rotation=45, ha="right")
        axes.axhline(0.0, color="#444444", lw=0.7)
        axes.grid(axis="y")
    grid["small"].set(ylabel="Index [-]", title="Indices of the mean spectra")
    grid["large"].set_title("other scale", fontsize=8)
    grid["large"].set_visible(split < len(table))
    handles = [Patch(color=c, label=s) for s, c in SAMPLES]
    grid["small"].legend(handles=handles, ncols=2, loc="best")
    difference_bars(grid["change"], list(table["index"]), table["difference_percent"])
    grid["change"].tick_params(axis="x", rotation=45)
    grid["change"].set_title("Difference")
    return figure
