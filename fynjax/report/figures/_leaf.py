"""Fitted leaves: measured and modelled reflectance and transmittance."""

import numpy as np
from matplotlib.figure import Figure

from fynjax.leaf import LeafFit

_SHOWN = 12


def leaf_fit_figure(fit: LeafFit) -> Figure:
    """Draw R from below and 1 - T from above with its 90 % band, a panel for each leaf.

    **Arguments:** `fit` of the leaves.

    At most twelve leaves are shown, evenly drawn from all.
    """
    status, names = fit.status, fit.labels
    count = len(status)
    shown = np.unique(np.linspace(0, count - 1, min(count, _SHOWN)).round().astype(int))
    columns = min(3, shown.size)
    rows = -(-shown.size // columns)
    figure = Figure(figsize=(4.2 * columns, 2.9 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, i in zip(panels, shown.tolist()):
        fit.plot(i, axes=panel)
        short = names[i] if len(names[i]) <= 32 else "..." + names[i][-29:]
        doubt = "" if status[i] == "converged" else f"\n{status[i].split(':')[0]}"
        panel.set_title(short + doubt, fontsize=8)
    for panel in panels[shown.size :]:
        panel.set_axis_off()
    figure.supxlabel("wavelength [nm]", fontsize=9)
    figure.supylabel("share of the light [-]", fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    wide_enough = 5 if columns > 1 else 2  # entries of the legend in a row
    figure.legend(
        handles, labels, loc="outside upper center", ncols=wide_enough, fontsize=8, frameon=False
    )
    return figure
