"""Figures of a fit, from plain tables: its parameters, its search, the errors it leaves.

Every function returns a matplotlib figure that belongs to no window; `save_figure` writes it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from fynjax.app.report.figures._style import (
    AFTER,
    BEFORE,
    BLUE,
    GREEN,
    GREY,
    OTHER,
    PURPLE,
    REAL,
    SKY,
    VERMILION,
    Figure,
    name_rows,
    panel_grid,
    style,
    typeset,
    words,
)
from fynjax.inversion import WELL_CONSTRAINED
from fynjax.metrics import WATER_WINDOWS


def _unit(unit: str) -> str:
    """' [µg cm⁻²]' for 'ug cm-2', nothing for a pure number."""
    if unit in ("-", "1", ""):
        return ""
    return f" [{typeset(unit)}]"


_ROW = 0.185
"""Height of a row [inch]."""


def _panels(sizes: Sequence[int], extra: float) -> tuple[Figure, list[Axes]]:
    """A figure with one axes for each number of rows, heights by these, in two columns of about
    equal height."""
    rows = [size + 3 for size in sizes]  # title and axis take the height of three
    columns: list[list[int]] = [[] for _ in sizes[:2]]
    for panel in sorted(range(len(sizes)), key=lambda k: -sizes[k]):
        min(columns, key=lambda column: sum(rows[p] for p in column)).append(panel)
    tall = max(sum(rows[p] for p in column) for column in columns)
    wide = 8.0 if len(columns) > 1 else 6.0
    figure = Figure(figsize=(wide, tall * _ROW + extra))
    outer = figure.add_gridspec(1, len(columns))
    axes: dict[int, Axes] = {}
    for k, column in enumerate(map(sorted, columns)):
        used = [rows[p] for p in column]
        spare = tall - sum(used)
        ratios = [*used, spare] if spare > 0 else used
        inner = outer[k].subgridspec(len(ratios), 1, height_ratios=ratios)
        axes |= {panel: figure.add_subplot(inner[row]) for row, panel in enumerate(column)}
    return figure, [axes[panel] for panel in range(len(sizes))]


def _groups(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """The rows of each kind, species in one order: by how far, over the prior's interval, that
    parameter of each moved which moved farthest."""
    wide = table["prior_q95"] - table["prior_q05"]
    moved = (table["estimate"] - table["prior"]).abs() / wide.where(wide > 0.0)
    of = [_label(str(name), str(kind)) for name, kind in zip(table["name"], table["kind"])]
    order = (-moved.fillna(0.0)).groupby(of).transform("min").argsort(kind="stable")
    return [(str(kind), part) for kind, part in table.iloc[order].groupby("kind", sort=False)]


def _label(name: str, kind: str) -> str:
    """A parameter's name without what the panel's title says already."""
    short = name.removeprefix("species.").removesuffix(f".{kind}").removeprefix(f"{kind}.")
    short = short.removesuffix(".leaf")
    return words(short)


@style()
def parameter_plot(table: pd.DataFrame) -> Figure:
    """Prior against estimate, with 90 % intervals, one panel for each kind.

    **Arguments:** `table` with the columns name, kind, unit, prior, prior_q05, prior_q95, estimate,
    q05, q95, and truth where that is known; a row for each parameter. In all panels species come in
    one order, the one that moved farthest first.
    """
    known = "truth" in table
    groups = _groups(table)
    figure, panels = _panels([len(part) for _, part in groups], 0.35)
    for axes, (kind, part) in zip(panels, groups, strict=True):
        y = name_rows(axes, [_label(str(name), kind) for name in part["name"]])
        axes.hlines(y - 0.16, part["prior_q05"], part["prior_q95"], color=GREY, lw=1.0)
        axes.plot(part["prior"], y - 0.16, "o", ms=4, mfc="white", color=GREY)
        axes.hlines(y + 0.16, part["q05"], part["q95"], color=BLUE, lw=1.4)
        axes.plot(part["estimate"], y + 0.16, "o", ms=4, color=BLUE)
        if known:
            axes.plot(part["truth"], y, "x", ms=5, mew=1.4, color=VERMILION)
        units = part["unit"].astype(str).unique()
        axes.set_title(words(kind).capitalize() + (_unit(units[0]) if len(units) == 1 else ""))
        axes.locator_params(axis="x", nbins=6)
    handles = [
        Line2D([], [], marker="o", mfc="white", color=GREY, label="prior, 90 %"),
        Line2D([], [], marker="o", color=BLUE, label="estimate, 90 %"),
    ]
    if known:
        handles.append(Line2D([], [], marker="x", ls="", color=VERMILION, label="truth"))
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    return figure


@style()
def interval_plot(table: pd.DataFrame, methods: Mapping[str, tuple[str, str]]) -> Figure:
    """90 % intervals of the same parameters by several methods, side by side.

    Along the prior's own interval, so that parameters of all units share an axis.

    **Arguments:** `table` with the columns name, prior_q05, prior_q95, a row for each parameter;
    `methods`, the columns of the lower and the upper end by the name of the method.
    """
    colours = (BLUE, GREEN, VERMILION, PURPLE)
    low = table["prior_q05"].to_numpy(float)
    wide = table["prior_q95"].to_numpy(float) - low
    figure = Figure(figsize=(6.0, 1.0 + (2.0 + len(table)) * 1.6 * _ROW))
    axes = figure.add_subplot()
    names = [str(name).removeprefix("species.").replace(".", " ") for name in table["name"]]
    y = name_rows(axes, [words(name) for name in names])
    for edge in (0.0, 1.0):
        axes.axvline(edge, color=GREY, lw=0.8, ls=":")
    for i, (method, ends) in enumerate(methods.items()):
        at = y + 0.22 * (i - 0.5 * (len(methods) - 1))
        left, right = ((table[end].to_numpy(float) - low) / wide for end in ends)
        axes.hlines(at, left, right, color=colours[i], lw=1.8, label=method)
    figure.supxlabel("Place in the prior's 90 % interval, which is 0 to 1", fontsize=8.5)
    figure.legend(loc="outside upper left", ncols=len(methods))
    return figure


@style()
def constraint_plot(table: pd.DataFrame) -> Figure:
    """How far the data narrowed each parameter: 1 - (sd / prior sd)^2, in percent.

    **Arguments:** `table` with the columns of `parameter_plot`, in whose order rows come, and
    constrained (0 to 1).
    """
    groups = _groups(table)
    figure, panels = _panels([len(part) for _, part in groups], 0.45)
    for axes, (kind, part) in zip(panels, groups, strict=True):
        share = 100 * part["constrained"].to_numpy(dtype=float)
        y = name_rows(axes, [_label(str(name), kind) for name in part["name"]])
        axes.barh(y, np.full(share.shape, 100.0), height=0.62, color="#EFEFEF")
        axes.barh(
            y,
            share,
            height=0.62,
            color=np.where(share >= 100 * WELL_CONSTRAINED, BLUE, SKY).tolist(),
        )
        for position, value in zip(y, share, strict=True):
            inside = value > 85
            axes.text(
                value - 1.5 if inside else value + 1.5, position,
                "<1" if 0 <= value < 1 else f"{value:.0f}",
                fontsize=6.5, va="center", ha="right" if inside else "left",
                color="white" if inside else "#333333",
            )  # fmt: skip
        axes.set_xlim(0, 100)
        axes.set_title(words(kind).capitalize())
        axes.grid(visible=False)
        axes.axvline(100 * WELL_CONSTRAINED, color="#999999", lw=0.7, ls=":")
    figure.supxlabel(
        "Variance removed by the data [%]; 0: only the prior speaks, 100: only the data",
        fontsize=8.5,
    )
    return figure


@style()
def convergence_plot(
    loss: ArrayLike, gradient_norm: ArrayLike | None = None, *, rounds: ArrayLike | None = None
) -> Figure:
    """Loss, and the norm of its gradient if given, against the steps done.

    **Arguments:**

    - `loss`, `gradient_norm`: at the beginning of each round and after each of its steps.
    - `rounds`: number of the round of each, from 1; by default all are of one. A line ends with its
      round.
    """
    losses = np.asarray(loss, dtype=float)
    turn = np.ones(losses.size, int) if rounds is None else np.asarray(rounds)
    steps = np.arange(losses.size) - (turn - 1)
    series: list[tuple[NDArray[np.float64], str, str]] = [(losses, "Loss [-]", BLUE)]
    if gradient_norm is not None:
        series.append((np.asarray(gradient_norm, dtype=float), "Gradient norm", GREEN))
    figure, grid = panel_grid(len(series), 1, (5.2, 1.9), (0.0, 1.1), sharex=True)
    for axes, (values, label, colour) in zip(grid, series, strict=True):
        for number in np.unique(turn):
            here = turn == number
            axes.plot(steps[here], values[here], "-o", ms=3, lw=1.2, color=colour)
            if number > 1:
                axes.axvline(steps[here][0], color=GREY, lw=0.8, ls=":")
        finite = values[np.isfinite(values)]
        if finite.size and finite.min() > 0 and finite.max() / finite.min() > 5:
            axes.set_yscale("log")
        axes.set_ylabel(label)
        axes.grid(visible=True)
        if values.size:
            axes.annotate(
                f"{values[-1]:.3g}", (steps[-1], values[-1]), xytext=(4, 4),
                textcoords="offset points", fontsize=8, color=colour,
            )  # fmt: skip
    for number in np.unique(turn)[1:]:
        grid[0].annotate(
            f"round {number}", (steps[turn == number][0], 1.0), xytext=(3, -9),
            xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=7,
        )  # fmt: skip
    grid[-1].set_xlabel("Steps")
    grid[-1].xaxis.get_major_locator().set_params(integer=True)
    return figure


_FULL_SCALE = 100.0
"""Longer bars are cut and show their value, so that the short ones stay readable [%]."""


_BARS = {
    **dict.fromkeys(("before", "uncalibrated"), BEFORE),
    **dict.fromkeys(("after", "calibrated"), AFTER),
    "with gains": SKY,
    "DIRSIG (paper)": OTHER,
}
"""Colours of bars by what they are of."""


@style()
def error_bars(panels: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Figure:
    """Absolute relative error of each statistic, one bar for each simulation.

    **Arguments:** `panels`, relative errors [%], sign ignored, by the panel's title, simulation and
    statistic, such as `{"Means": {"before": {"NIR": 12.0}, "after": {...}}, "Spreads": {...}}`; a
    statistic that a simulation lacks has no bar, and bars of unlike sizes belong in panels of their
    own.
    """
    who = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    names = {
        title: list(dict.fromkeys(name for values in panel.values() for name in values))
        for title, panel in panels.items()
    }
    spare = iter((VERMILION, PURPLE, GREEN))
    colours = {name: _BARS.get(name) or next(spare, GREY) for name in who}
    height = 0.8 / len(who)
    rows = [max(len(of), 1) for of in names.values()]
    row = 0.105 * len(who) + 0.09
    figure = Figure(figsize=(6.4, row * sum(rows) + 0.45 + 0.55 * len(panels)))
    grid = figure.subplots(len(panels), 1, squeeze=False, height_ratios=rows)[:, 0]
    for axes, (title, panel) in zip(grid, panels.items(), strict=True):
        highest = 0.0
        for name, values in panel.items():
            y = np.arange(len(names[title])) + (who.index(name) - (len(who) - 1) / 2) * height
            share = np.array([abs(values.get(each, np.nan)) for each in names[title]])
            highest = max(highest, float(np.nanmax(share, initial=0.0)))
            bars = np.minimum(share, _FULL_SCALE)
            axes.barh(y, bars, height * 0.9, color=colours[name], label=name)
            for position, value in zip(y, share, strict=True):
                if np.isfinite(value):
                    text = f"{value:.2g}" if value < 9.95 else f"{value:.0f}"
                    axes.annotate(
                        text if value <= _FULL_SCALE else f"→ {text}",
                        (min(value, _FULL_SCALE), position), xytext=(3, 0),
                        textcoords="offset points", fontsize=6.5, va="center", zorder=4,
                        bbox={"boxstyle": "square,pad=0.05", "fc": "white", "ec": "none"},
                    )  # fmt: skip
        name_rows(axes, [words(each) for each in names[title]])
        axes.set_xlim(0, min(highest, _FULL_SCALE) * 1.1 or 1)
        axes.set_title(title)
    handles = [Patch(color=colours[name], label=name) for name in who]
    columns = len(who) if len(who) < 5 else 3
    figure.legend(handles=handles, loc="outside upper left", ncols=columns)
    grid[-1].set_xlabel("|simulated - real| / |real| [%]")
    return figure


@style()
def spectrum_plot(wavelength: ArrayLike, reflectance: ArrayLike, bands: pd.DataFrame) -> Figure:
    """A measured spectrum, and the plot's before and after calibration, in the bands compared.

    **Arguments:** `wavelength` [nm] and `reflectance` [-] of all of the measured spectrum; `bands`
    with the columns wavelength_nm, real, target_sd, before, after. Below, simulated less measured.
    """
    grid, measured = np.asarray(wavelength, float), np.array(reflectance, float)
    # No line across the water windows, where the spectrum is noise or none.
    for low, high in WATER_WINDOWS:
        measured[(grid >= low) & (grid <= high)] = np.nan
    at = bands["wavelength_nm"].to_numpy(float)
    figure = Figure(figsize=(6.8, 4.8))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    upper.plot(grid, measured, color=REAL, lw=1.0, label="measured")
    upper.errorbar(
        at, bands["real"], yerr=bands["target_sd"], fmt="none", ecolor=REAL, elinewidth=0.8
    )
    spread = bands["target_sd"].to_numpy(float)
    lower.fill_between(at, -spread, spread, color="#E3E3E3", lw=0, label="±1 sd")
    lower.axhline(0.0, color=REAL, lw=0.8)
    for column, colour, marker in (("before", BEFORE, "s"), ("after", AFTER, "o")):
        values = bands[column].to_numpy(float)
        upper.plot(at, values, marker, ms=3.5, color=colour, label=column)
        lower.plot(at, values - bands["real"], marker, ms=3.0, color=colour)
    upper.set_ylabel("Reflectance [-]")
    upper.set_ylim(bottom=0.0)
    lower.set_ylabel("Simulated -\nmeasured [-]")
    lower.set_xlabel("Wavelength [nm]")
    for axes in (upper, lower):
        axes.grid(visible=True)
        axes.set_xlim(min(grid.min(), at.min()), min(grid.max(), 2500.0))
    handles, labels = upper.get_legend_handles_labels()
    more, names = lower.get_legend_handles_labels()
    figure.legend([*handles, *more], [*labels, *names], loc="outside upper left", ncols=4)
    return figure


@style()
def metric_plot(table: pd.DataFrame) -> Figure:
    """Metrics of a point cloud and of the plot, before and after, one panel for each.

    **Arguments:** `table` with the columns metric, unit, real, target_sd, before, after.
    """
    count = len(table)
    figure = Figure(figsize=(max(1.5 * count, 3.0), 2.9))
    panels = figure.subplots(1, count, squeeze=False)[0]
    numbers = table[["real", "target_sd", "before", "after"]].to_numpy(float)
    texts = zip(table["metric"].astype(str), table["unit"].astype(str), strict=True)
    for axes, (real, sd, before, after), (metric, unit) in zip(panels, numbers, texts, strict=True):
        axes.errorbar([0], [real], yerr=[sd], fmt="o", ms=5, color=REAL, lw=1.2)
        axes.axhspan(real - sd, real + sd, color="#EFEFEF", lw=0)
        axes.plot([1], [before], "s", ms=6, color=BEFORE)
        axes.plot([2], [after], "o", ms=6, color=AFTER)
        axes.set_xticks([0, 1, 2], ["real", "before", "after"], rotation=60)
        axes.set_xlim(-0.6, 2.6)
        title = words(metric).capitalize().replace(" density ", "\ndensity ")
        title = title.replace("height diversity", "height\ndiversity")
        axes.set_title(title + _unit(unit), fontsize=8)
        axes.locator_params(axis="y", nbins=5)
        axes.grid(axis="y")
    return figure
