"""Figures of posteriors, sensitivities and bounds, from plain arrays and tables."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from fynjax._core.extras import require
from fynjax.app.report.figures._style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    REAL,
    SKY,
    VERMILION,
    Figure,
    name_rows,
    panel_grid,
    style,
    words,
)
from fynjax.inversion import Posterior

_MOST_SHOWN = 15
"""Parameters of a panel of sensitivities, at most."""
_SERIES = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, GREY)


def short_name(name: str) -> str:
    """`Erica irregularis cover` for `species.Erica irregularis.cover`.

    **Arguments:** `name` of a parameter.
    """
    return words(name.removeprefix("species.").replace(".leaf.", " ").replace(".", " "))


def corner_plot(
    draws: Mapping[str, ArrayLike],
    names: Sequence[str],
    *,
    prior: tuple[ArrayLike, ArrayLike],
    truth: ArrayLike | None = None,
) -> Figure:
    """Each parameter's distribution on the diagonal and each pair's below it, one over the other.

    Contours hold 50 and 90 % of the draws; the prior is the grey curve on the diagonal.

    **Arguments:**

    - `draws`: [draw, parameter], by the name of their method.
    - `names`: of the parameters, for their axes.
    - `prior`: values [point, parameter] and its density there.
    - `truth`: values to mark [parameter].

    **Raises:** `MissingExtraError` without the package corner (extra `posterior`).
    """
    package = require("corner", "posterior")
    count = len(names)
    values = {name: np.asarray(one, float) for name, one in draws.items()}
    low, high = np.quantile(np.concatenate(list(values.values())), [0.002, 0.998], axis=0)
    room = np.maximum(0.05 * (high - low), 1e-9 + 1e-6 * np.abs(high))
    low, high = low - room, high + room
    if truth is not None:
        low, high = np.minimum(low, truth - room), np.maximum(high, truth + room)
    # On as many lines as words, so that they stay beside their panel.
    labels = [short_name(name).replace(" ", "\n") for name in names]
    beside = 0.65 + 0.17 * max(label.count("\n") + 1 for label in labels)
    side = 1.9 * count + beside + 0.1  # [inches]
    options: dict[str, Any] = {
        "labels": labels,
        "truths": truth,
        "truth_color": "k",
        "range": list(zip(low, high)),
        "levels": (0.5, 0.9),
        "smooth": 1.0,
        "plot_datapoints": False,
        "plot_density": False,
        "no_fill_contours": True,
    }
    # The package places its axes itself, whatever the layout that the user's settings ask for.
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        figure = Figure(figsize=(side, side))
    for one, colour in zip(values.values(), _SERIES, strict=False):
        shape = {"density": True, "color": colour}
        package.corner(one, fig=figure, color=colour, hist_kwargs=shape, **options)
    edge, end = beside / side, 1.0 - 0.1 / side
    figure.subplots_adjust(left=edge, bottom=edge, right=end, top=end)
    x, density = (np.asarray(part) for part in prior)
    for i in range(count):
        figure.axes[i * (count + 1)].plot(x[:, i], density[:, i], color=GREY)
    handles = [
        Line2D([], [], color=colour, label=name)
        for name, colour in zip([*values, "prior"], [*_SERIES[: len(values)], GREY], strict=True)
    ]
    figure.legend(handles=handles, fontsize=11)
    return figure


def corner(draws: Posterior | Mapping[str, Posterior], truth: ArrayLike | None = None) -> Figure:
    """Each parameter and each pair of posteriors of the same parameters, as `corner_plot` has them.

    **Arguments:** `draws` from `fx.sample`, or several by the name of their method; `truth`, values
    to mark [free].

    **Raises:** `MissingExtraError` without the package corner (extra `posterior`).
    """
    many = {"posterior": draws} if isinstance(draws, Posterior) else dict(draws)
    space = next(iter(many.values())).space
    values = {name: one.values.reshape(-1, len(space.names)) for name, one in many.items()}
    return corner_plot(values, space.names, prior=space.density(), truth=truth)


@style()
def predictive_plot(
    predicted: ArrayLike, observed: ArrayLike, sd: ArrayLike, names: Sequence[str]
) -> Figure:
    """Posterior prediction of each statistic against the measurement, in standard errors.

    **Arguments:** `predicted` [draw, statistic], without error; `observed` and `sd` [statistic];
    `names` of the statistics.
    """
    error = np.asarray(sd, float)
    off = (np.asarray(predicted, float) - np.asarray(observed, float)) / error
    figure = Figure(figsize=(6.0, 0.19 * len(names) + 1.1))
    axes = figure.subplots()
    y = name_rows(axes, [words(name) for name in names])
    axes.axvspan(-1.0, 1.0, color="#EFEFEF", lw=0)
    axes.axvline(0.0, color=REAL, lw=0.8)
    low, middle, high = np.quantile(off, [0.05, 0.5, 0.95], axis=0)
    axes.errorbar(middle, y, xerr=[middle - low, high - middle], fmt="o", ms=3.5, color=BLUE,
                  lw=1.2, label="predicted, 90 % of the draws")  # fmt: skip
    axes.set_xlabel("Predicted less measured, in standard errors of the measured (grey: one)")
    figure.legend(loc="outside upper left")
    return figure


@style()
def tornado_plot(table: pd.DataFrame) -> Figure:
    """Elasticities of each metric, largest first, a panel for each metric.

    Bars that are not distinguished from zero are grey and hollow.

    **Arguments:** `table` with the columns metric, parameter, elasticity [-], interval (half of
    it) [-] and distinguished; the 15 parameters of the largest are shown.
    """
    metrics = list(dict.fromkeys(table["metric"]))
    shown = min(_MOST_SHOWN, table["parameter"].nunique())
    figure, panels = panel_grid(len(metrics), 2, (4.6, 0.17 * shown + 0.55), (0.0, 0.5))
    for axes, metric in zip(panels, metrics, strict=True):
        part = table[(table["metric"] == metric) & table["elasticity"].notna()]
        order = part["elasticity"].abs().sort_values(ascending=False).index[:_MOST_SHOWN]
        part = part.loc[order]
        value = part["elasticity"].to_numpy(float)
        y = name_rows(axes, [short_name(str(n)) for n in part["parameter"]], room=shown)
        clear = part["distinguished"].to_numpy(bool)
        colour = np.where(clear, np.where(value > 0, BLUE, VERMILION), GREY)
        axes.barh(y, value, height=0.7, color=np.where(clear, colour, "none"), edgecolor=colour,
                  xerr=part["interval"].to_numpy(float),
                  error_kw={"lw": 0.8, "ecolor": REAL})  # fmt: skip
        axes.axvline(0.0, color=REAL, lw=0.7)
        axes.set_title(words(metric))
    figure.supxlabel("Change of the metric [%] for 1 % more of the parameter", fontsize=8.5)
    return figure


@style()
def indices_plot(table: pd.DataFrame) -> Figure:
    """First and total Sobol indices with their 95 % intervals, and the derivative-based bound.

    **Arguments:** `table` with the columns metric, parameter, first, first_error, total,
    total_error, bound (NaN where unknown); the 15 parameters of the largest are shown.
    """
    metrics = list(dict.fromkeys(table["metric"]))
    shown = min(_MOST_SHOWN, table["parameter"].nunique())
    figure, panels = panel_grid(len(metrics), 2, (4.6, 0.24 * shown + 0.6), (0.0, 0.7))
    for axes, metric in zip(panels, metrics, strict=True):
        part = table[table["metric"] == metric]
        key = part["total"].fillna(part["bound"])
        part = part.loc[key.sort_values(ascending=False).index[:_MOST_SHOWN]]
        y = name_rows(axes, [short_name(str(n)) for n in part["parameter"]], room=shown)
        for kind, colour, shift in (("first", SKY, -0.18), ("total", BLUE, 0.18)):
            if part[kind].notna().any():
                error = part[f"{kind}_error"].to_numpy(float)
                axes.barh(y + shift, part[kind].clip(lower=0.0), 0.34, color=colour,
                          xerr=error, error_kw={"lw": 0.8, "ecolor": REAL})  # fmt: skip
        axes.plot(np.minimum(part["bound"].to_numpy(float), 1.0), y, "|", ms=9, mew=1.6,
                  color=VERMILION)  # fmt: skip
        axes.set_xlim(0.0, 1.05)
        axes.set_title(words(metric))
    handles = [
        Patch(color=SKY, label="alone"),
        Patch(color=BLUE, label="with interactions"),
        Line2D([], [], marker="|", ls="", ms=9, mew=1.6, color=VERMILION,
                                label="bound by slopes (cut at 1)"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    figure.supxlabel("Share of the metric's variance [-]", fontsize=8.5)
    return figure


_HIGHEST = 90.0
"""Bound over cover up to which numbers are shown [-]."""


@style()
def bound_plot(table: pd.DataFrame, species: Sequence[str]) -> Figure:
    """Bound on the cover of each species over the cover, against the pixel size and bands.

    **Arguments:** `table` with the columns parameter, gsd_m, bands, bound, value; `species`, the
    parameters to show. Triangles mark where there is no bound.
    """
    figure, panels = panel_grid(len(species), 3, (2.7, 1.9), (0.4, 1.0), sharex=True, sharey=True)
    for axes, name in zip(panels, species, strict=True):
        part = table[table["parameter"] == name]
        for k, (count, line) in enumerate(part.groupby("bands")):
            line = line.sort_values("gsd_m")
            ratio = (line["bound"] / line["value"]).replace(np.inf, np.nan)
            number, colour = int(str(count)), _SERIES[k % len(_SERIES)]
            label = f"{number} band{'s' * (number != 1)}"
            axes.loglog(line["gsd_m"], np.clip(ratio, 0, _HIGHEST), "-o", ms=3, lw=1.2,
                        color=colour, label=label)  # fmt: skip
            none = line["gsd_m"][ratio.isna()]
            # Side by side, so that each number of bands is seen.
            axes.plot(none * 1.08**k, np.full(len(none), _HIGHEST / 2), "^", ms=4, mfc="none",
                      color=colour)  # fmt: skip
        axes.axhspan(1.0, 100.0, color="#F3E3DC", lw=0)
        axes.set_title(short_name(name.removesuffix(".cover")), fontsize=8)
        axes.grid(which="major")
    panels[0].set_ylim(0.02, 100.0)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=len(names))
    figure.supxlabel("Pixel on the ground [m]", fontsize=8.5)
    figure.supylabel("Bound over cover [-]; shaded: lost", fontsize=8.5)
    return figure
