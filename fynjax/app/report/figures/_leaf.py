"""Fitted leaves: measured and modelled reflectance and transmittance."""

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from fynjax.app.report.figures._style import GREY, VERMILION, Figure, panel_grid, style
from fynjax.leaf import LeafFit

if TYPE_CHECKING:
    import xarray as xr

APART = 12
"""Most leaves that have a panel of their own."""
_NAMED = 10
"""Most leaves that a legend names."""


@style()
def leaf_fit_figure(fit: LeafFit) -> Figure:
    """Draw R from below and 1 - T from above with its 90 % band, a panel for each leaf.

    **Arguments:** `fit` of the leaves.

    At most twelve leaves are shown, evenly drawn from all.
    """
    status, names = fit.status, fit.labels
    count = len(status)
    shown = np.unique(np.linspace(0, count - 1, min(count, APART)).round().astype(int))
    figure, panels = panel_grid(shown.size, 3, (4.2, 2.9), (0.0, 0.5), sharex=True, sharey=True)
    for panel, i in zip(panels, shown.tolist(), strict=True):
        fit.plot(i, axes=panel)
        short = names[i] if len(names[i]) <= 32 else "..." + names[i][-29:]
        doubt = "" if status[i] == "converged" else f"\n{status[i].split(':')[0]}"
        panel.set_title(short + doubt, fontsize=8)
    figure.supxlabel("wavelength [nm]", fontsize=9)
    figure.supylabel("share of the light [-]", fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    in_a_row = 5 if shown.size > 1 else 2
    figure.legend(handles, labels, loc="outside upper center", ncols=in_a_row)
    return figure


@style()
def measured_figure(spectra: "xr.Dataset") -> Figure:
    """Every measured spectrum: reflectance from below, 1 - T from above.

    **Arguments:** `spectra`, as `fynjax.app.io.spectra.read_spectra` gives them.
    """
    names, grid = spectra["spectrum"].values.tolist(), spectra["wavelength"].values
    figure = Figure(figsize=(9.2, 4.6))
    axes = figure.subplots()
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.95, len(names)))
    ends = [0.0]
    for quantity, dashes in (("reflectance", "-"), ("transmittance", (0, (4, 2)))):
        if quantity not in spectra:
            continue
        values = spectra[quantity].values
        shown = values if quantity == "reflectance" else 1.0 - values
        # In the bands of water and at the ends an instrument may have anything.
        ends += np.nanpercentile(shown, [2.0, 98.0]).tolist()
        lines = [np.column_stack([grid, row])[np.isfinite(row)] for row in shown]
        axes.add_collection(LineCollection(lines, colors=colours, lw=0.9, linestyles=[dashes]))
    low, high = min(ends), max(ends)
    room = 0.05 * max(high - low, 0.1)
    axes.set(xlim=(grid[0], grid[-1]), ylim=(low - room, high + room))
    what = "R" if "transmittance" not in spectra else "R; dashed: 1 - T"
    axes.set(xlabel="Wavelength [nm]", ylabel=f"{what} [-]")
    handles = [
        Line2D([], [], color=colour, label=name) for name, colour in zip(names[:_NAMED], colours)
    ]
    if len(names) > _NAMED:
        more = f"... to {names[-1]}, in this order"
        handles.append(Line2D([], [], color=colours[-1], label=more))
    figure.legend(handles=handles, loc="outside upper left", ncols=4, fontsize=7.5)
    return figure


@style()
def all_leaves_figure(fit: LeafFit) -> Figure:
    """Measured reflectance of every leaf, and what the fit leaves of it, those in doubt in colour.

    Leaves of which transmittance alone was measured have 1 - T.

    **Arguments:** `fit` of the leaves.
    """
    grid, (r, t) = fit.wavelength, np.moveaxis(fit.measured, 1, 0)
    model_r, model_t = np.moveaxis(fit.fitted, 1, 0)
    alone = np.isnan(r).all(axis=1, keepdims=True)
    seen = np.where(alone, 1.0 - t, r)
    left = np.where(alone, model_t - t, r - model_r)
    doubtful = np.array([status != "converged" for status in fit.status])
    figure = Figure(figsize=(9.2, 5.4))
    axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for panel, values in zip(axes, (seen, left), strict=True):
        for colour, chosen in ((GREY, ~doubtful), (VERMILION, doubtful)):
            lines = [np.column_stack([grid, one]) for one in values[chosen]]
            panel.add_collection(LineCollection(lines, colors=colour, linewidths=0.7))
        panel.autoscale_view()
    axes[0].set(ylabel="R measured, or 1 - T [-]", xlim=(400, 2450))
    axes[1].axhline(0.0, color="#333333", lw=0.6)
    axes[1].set(ylabel="Less fitted [-]", xlabel="Wavelength [nm]")
    named = [name for name, doubt in zip(fit.labels, doubtful, strict=True) if doubt]
    more = f" and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
    kinds = [(GREY, f"{int((~doubtful).sum())} fitted without doubt")]
    if named:
        kinds.append((VERMILION, f"in doubt: {', '.join(named[:_NAMED])}{more}"))
    handles = [Line2D([], [], color=c, label=label) for c, label in kinds]
    figure.legend(handles=handles, loc="outside upper left", fontsize=7.5)
    return figure
