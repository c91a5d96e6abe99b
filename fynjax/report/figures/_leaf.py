"""Fitted leaves: measured and modelled reflectance and transmittance."""

import numpy as np

from fynjax.leaf import LeafFit
from fynjax.report.figures._style import Figure, panel_grid, style

_SHOWN = 12


def leaf_fit_figure(fit: LeafFit) -> Figure:
    """Draw R from below and 1 - T from above with its 90 % band, a panel for each leaf.

    **Arguments:** `fit` of the leaves.

    At most twelve leaves are shown, evenly drawn from all.
    """
    status, names = fit.status, fit.labels
    count = len(status)
    shown = np.unique(np.linspace(0, count - 1, min(count, _SHOWN)).round().astype(int))
    with style():
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
