"""What flights can know of a plot."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from fynjax.app.report.figures._posterior import short_name
from fynjax.app.report.figures._style import Figure, style

_ENDS = (".cover", ".height", ".leaf_area_index")


@style()
def flight_plot(table: pd.DataFrame, words: Mapping[tuple[float, ...], str]) -> Figure:
    """Error that is left of each parameter and number of the stand, a mark for each flight.

    **Arguments:** `table` with the columns parameter, prior_sd, bayesian, frames, oblique and
    pulses; `words`, name of each flight by the last three.
    """
    shown = table[table["parameter"].str.startswith("stand.")
                  | table["parameter"].str.endswith(_ENDS)]  # fmt: skip
    names = list(dict.fromkeys(shown["parameter"]))
    figure = Figure(figsize=(7.4, 1.4 + 0.24 * len(names)))
    axes: Any = figure.add_subplot()
    marks = "osD^vP*X"
    for k, (flight, label) in enumerate(words.items()):
        one = shown[(shown[["frames", "oblique", "pulses"]] == list(flight)).all(axis=1)]
        left = (one["bayesian"] / one["prior_sd"]).to_numpy()
        axes.plot(left, range(len(names)), marks[k % len(marks)], ms=6, alpha=0.85, label=label)
    axes.set_yticks(range(len(names)), [short_name(name) for name in names])
    axes.invert_yaxis()
    axes.set(xlim=(0.0, 1.03), xlabel="Error that is left of the prior's [-]")
    axes.grid(axis="y", lw=0.4)
    figure.legend(loc="outside upper left", ncols=4)
    return figure
