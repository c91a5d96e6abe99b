"""Figure of a population learned from many plots."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax.report.figures._style import BLUE, GREY, VERMILION, Figure, style


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
