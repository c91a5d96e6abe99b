"""Figures of structure as the paper's figure 13, from a comparison of two clouds."""

from typing import Any

import matplotlib.colors
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from fynjax.app.compare.structure import StructureComparison
from fynjax.app.report.figures._style import AFTER, REAL, Figure, small_print, style, typeset, words
from fynjax.metrics.structure import STRUCTURE_METRICS

_SIDES = (("real", REAL, "o"), ("simulated", AFTER, "s"))


@style()
def structure_figure(comparison: StructureComparison) -> Figure:
    """Metrics with their intervals, and heights, percentiles and profiles of both clouds.

    **Arguments:** `comparison` of the real and the simulated cloud.
    """
    figure = Figure(figsize=(11.4, 7.4))
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
    upper, lower = parts
    panels = upper.subplots(1, len(STRUCTURE_METRICS))
    for axes, metric in zip(panels, STRUCTURE_METRICS):
        _metric(axes, comparison, metric)
    histogram, percentiles, profile = lower.subplots(1, 3)
    _histogram(histogram, comparison)
    _percentiles(percentiles, comparison)
    _profile(profile, comparison)
    handles, labels = histogram.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    small_print(figure, _caption(comparison))
    return figure


@style()
def structure_maps(comparison: StructureComparison) -> Figure:
    """Every metric in each cell, the real cloud above and the simulated below, on the same scale.

    **Arguments:** `comparison` of the real and the simulated cloud.
    """
    west, south, east, north = comparison.bounds
    extent = (0.0, east - west, 0.0, north - south)
    count = len(STRUCTURE_METRICS)
    figure = Figure(figsize=(2.05 * count, 4.9))
    grid = figure.subplots(2, count, sharex=True, sharey=True)
    for column, metric in zip(grid.T, STRUCTURE_METRICS):
        maps = [side.cells[metric] for side in comparison.sides.values()]
        pooled = np.concatenate([m[np.isfinite(m)] for m in maps])
        low, high = (pooled.min(), pooled.max()) if pooled.size else (0.0, 1.0)
        scale = matplotlib.colors.Normalize(low, high if high > low else low + 1e-6)
        for axes, values in zip(column, maps):
            axes.set_facecolor("#D9D9D9")  # undefined
            image = axes.imshow(values, origin="lower", extent=extent, norm=scale, cmap="viridis")
            axes.tick_params(length=2)
        column[0].set_title(_title(metric), fontsize=8.5)
        bar = figure.colorbar(image, ax=list(column), location="bottom", aspect=12, pad=0.02)
        bar.ax.tick_params(labelsize=7)
        bar.ax.locator_params(nbins=3)
    for axes, (name, _, _) in zip(grid[:, 0], _SIDES):
        axes.set_ylabel(f"{name}\nNorth [m]")
    small_print(
        figure,
        f"East [m]. Cells of {comparison.grain:g} m; grey is undefined. Of the thinned cloud, "
        "the median of thinnings.",
    )
    return figure


def _title(metric: str) -> str:
    short = {
        "foliage_height_diversity": "Foliage height\ndiversity",
        "leaf_area_density_mean": "Leaf area density,\nmean",
        "leaf_area_density_std": "Leaf area density,\nsd over layers",
        "gap_fraction": "Gap\nfraction",
        "rugosity": "\nRugosity",
        "height_cv": "Variation (CV)\nof height",
    }
    unit = STRUCTURE_METRICS[metric]
    unit = "-" if unit == "1" else typeset(unit)
    return f"{short.get(metric, words(metric))} [{unit}]"


def _metric(axes: Axes, comparison: StructureComparison, metric: str) -> None:
    """Value, thinnings (thin) and bootstrap over cells (thick) of both clouds."""
    values = []
    for place, (side, colour, marker) in enumerate(_SIDES):
        row = comparison.sides[side].metrics.loc[metric]
        for kind, x, width, alpha in (
            ("bootstrap", place, 4.0, 0.35),
            ("thinning", place + 0.16, 1.3, 1.0),
        ):
            ends = [row[f"{kind}_low"], row[f"{kind}_high"]]
            axes.plot([x, x], ends, color=colour, lw=width, alpha=alpha)
        axes.plot(place, row["value"], marker, color=colour, ms=6)
        values.append(row["value"])
    difference = comparison.difference_percent[metric]
    axes.set_title(_title(metric), fontsize=8.5)
    below = "real near 0" if np.isfinite(values).all() else "undefined"
    below = f"{difference:+.1f} %" if np.isfinite(difference) else below
    axes.margins(y=0.08)
    axes.set(xticks=[], xlim=(-0.6, 1.6), xlabel=below)
    axes.set_ylim(0.0, None)
    axes.grid(axis="y")


def _histogram(axes: Axes, comparison: StructureComparison) -> None:
    for side, colour, _ in _SIDES:
        share = getattr(comparison, side).histogram / np.diff(comparison.histogram_edges)
        options: Any = {"fill": True, "alpha": 0.3} if side == "real" else {"lw": 1.4}
        axes.stairs(
            share, comparison.histogram_edges, orientation="horizontal", color=colour, label=side,
            **options,
        )  # fmt: skip
    shown = comparison.heights.T["height_intersection"]
    axes.set(
        title=f"Heights: intersection {_with_range(shown)}",
        xlabel="Density of returns [m⁻¹], square root",
        ylabel="Height [m]",
        ylim=(0.0, None),
    )
    axes.set_xscale("function", functions=(lambda v: np.sqrt(np.maximum(v, 0.0)), np.square))
    axes.set_xlim(0.0, None)
    axes.locator_params(axis="x", nbins=5)
    axes.grid()


def _percentiles(axes: Axes, comparison: StructureComparison) -> None:
    real, simulated = comparison.real.percentiles, comparison.simulated.percentiles
    high = 1.05 * max(real.max(), simulated.max(), 1e-3)
    axes.plot([0.0, high], [0.0, high], color="#999999", lw=0.8)
    axes.plot(real, simulated, "s", color=AFTER, ms=4)
    for percent, x, y in zip(comparison.percents, real, simulated):
        if percent in (50.0, 75.0, 95.0):
            axes.annotate(f"{percent:g}", (x, y), xytext=(5, -8), textcoords="offset points",
                          fontsize=7.5)  # fmt: skip
    shown = comparison.heights.T["height_percentile_rmse"]
    axes.set(
        title=f"Percentiles: RMSE {_with_range(shown, ' m')}",
        xlabel="Real [m]",
        ylabel="Simulated [m]",
        xlim=(0.0, high),
        ylim=(0.0, high),
        aspect="equal",
    )
    axes.grid()


def _profile(axes: Axes, comparison: StructureComparison) -> None:
    middle = 0.5 * (comparison.edges[1:] + comparison.edges[:-1])
    for side, colour, marker in _SIDES:
        axes.plot(
            getattr(comparison, side).profile, middle, color=colour, marker=marker, ms=3.5, lw=1.2
        )
    axes.set(
        title="Leaf area density, all returns",
        xlabel="Mean over cells [m² m⁻³]",
        ylabel="Height [m]",
        xlim=(0.0, None),
        ylim=(0.0, None),
    )
    axes.grid()


def _with_range(row: pd.Series, unit: str = "") -> str:
    low, high = row["thinning_low"], row["thinning_high"]
    return f"{row['value']:.3f}{unit} ({low:.3f} to {high:.3f})"


def _caption(comparison: StructureComparison) -> str:
    s, o = comparison.settings, comparison.options
    percent = f"{100.0 * o['confidence']:g} %"
    matched = (
        "both have as many returns"
        if comparison.thinned == "neither"
        else f"the {comparison.thinned} cloud thinned {o['repetitions']} times to "
        f"{comparison.matched_returns} returns"
    )
    return (
        f"Cells of {comparison.grain:g} m; {matched}; thick bars: {percent} by bootstrap over "
        f"cells, thin bars: central {percent} of thinnings.\n"
        f"Layers of {s.layer:g} m from {s.lowest:g} m (diversity of {words(s.diversity_of)} from "
        f"{s.diversity_lowest:g} m), k {s.extinction:g}, gap below {s.gap_height:g} m, rugosity of "
        f"{s.rugosity_of}, cells of {s.canopy_cell:g} m. Conventions: {s.source}."
    )
