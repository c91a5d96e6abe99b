"""Fitted leaves: measured and modelled reflectance and transmittance."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from fynjax.leaf import LeafFit

_SHOWN = 12


def leaf_fit_figure(fit: LeafFit, names: Sequence[str]) -> Figure:
    """Draw R from below and 1 - T from above with its 90 % band, a panel for each leaf.

    **Arguments:** `fit` of the leaves; `names` of the leaves, for the titles.

    At most twelve leaves are shown, evenly drawn from all.
    """
    status = fit.status
    count = len(status)
    shown = np.unique(np.linspace(0, count - 1, min(count, _SHOWN)).round().astype(int))
    columns = min(3, shown.size)
    rows = -(-shown.size // columns)
    figure = Figure(figsize=(4.2 * columns, 2.9 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    wide = 1.6448536269514722 * fit.transmittance_deviation
    inside = (fit.wavelength >= 445.0) & (fit.wavelength <= 2405.0)
    grid = fit.wavelength[inside]
    for panel, i in zip(panels, shown):
        low, high = (
            np.clip(1.0 - fit.transmittance[i] + sign * wide[i], 0.0, 1.0)[inside]
            for sign in (-1, 1)
        )
        panel.fill_between(grid, low, high, color="tab:blue", alpha=0.25, lw=0,
                           label="90 % interval of 1 - T")  # fmt: skip
        panel.plot(grid, 1.0 - fit.transmittance[i][inside], color="tab:blue",
                   label="1 - T of one leaf" if fit.estimated else "1 - T of leaf")  # fmt: skip
        panel.plot(grid, fit.fitted[i, 0][inside], color="tab:green", label="R of model")
        panel.plot(grid, fit.measured[i, 0][inside], "k.", ms=2.5, label="R measured")
        if np.isfinite(fit.measured[i, 1]).any():
            if fit.estimated:
                panel.plot(grid, 1.0 - fit.fitted[i, 1][inside], "--", color="tab:purple",
                           label="1 - T of model, with gaps")  # fmt: skip
            panel.plot(grid, 1.0 - fit.measured[i, 1][inside], ".", color="0.45", ms=2.5,
                       label="1 - T measured")  # fmt: skip
        short = names[i] if len(names[i]) <= 32 else "..." + names[i][-29:]
        doubt = "" if status[i] == "converged" else f"\n{status[i].split(':')[0]}"
        panel.set_title(short + doubt, fontsize=8)
    for panel in panels[shown.size :]:
        panel.set_axis_off()
    panels[0].set(xlim=(400, 2450), ylim=(0, 1))
    figure.supxlabel("wavelength [nm]", fontsize=9)
    figure.supylabel("share of the light [-]", fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    wide_enough = 5 if columns > 1 else 2  # entries of the legend in a row
    figure.legend(
        handles, labels, loc="outside upper center", ncols=wide_enough, fontsize=8, frameon=False
    )
    return figure
