"""Figures from plain arrays, ready for a paper: units, readable labels, colour-blind safe.

Every function returns a matplotlib figure that belongs to no window; `save_figure` writes it.
Colours are those of Okabe and Ito (2008).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from fynjax.inversion import SEEN
from fynjax.io._atomic import atomic_path

ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
GREY = "#7F7F7F"
BEFORE, AFTER, REAL, OTHER = ORANGE, BLUE, "#222222", GREY
"""Before calibration, after it, the real data, another simulation: the same in every figure."""

FIGURE_DPI = 160
"""Resolution of a saved figure [dots per inch]."""

_STYLE: Any = {  # matplotlib's own type lists every key it knows
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "savefig.dpi": FIGURE_DPI,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
}


@contextmanager
def _style() -> Iterator[None]:
    with matplotlib.rc_context(_STYLE):
        yield


def save_figure(figure: Figure, path: str | Path, *, dpi: int = FIGURE_DPI) -> None:
    """Write a figure (PNG, PDF or SVG by its suffix), whole or not at all."""
    with atomic_path(path) as partial:
        figure.savefig(partial, dpi=dpi, facecolor="white")


def _words(name: str) -> str:
    return name.replace("_", " ").replace("nir", "NIR")


def _unit(unit: str) -> str:
    """' [µg cm⁻²]' for 'ug cm-2', nothing for a pure number."""
    if unit in ("-", "1", ""):
        return ""
    raised = "⁰¹²³⁴⁵⁶⁷⁸⁹"
    text = re.sub(r"(?<=[a-z])(-?)(\d)", lambda m: ("⁻" if m[1] else "") + raised[int(m[2])], unit)
    return f" [{re.sub(r'^u(?=g)', 'µ', text)}]"


# -- images ---------------------------------------------------------------------------------

_COMPOSITES: dict[str, tuple[tuple[str, str, str], str]] = {
    "false_colour": (("nir", "red", "green"), "False colour: red, green, blue = NIR, red, green"),
    "true_like": (
        ("red", "green", "darker"),
        "True-like colour: blue, which the camera lacks, is 0.7 times the darker of red and green",
    ),
}


def _channels(
    image: ArrayLike, band_names: Sequence[str], channels: Sequence[str]
) -> NDArray[np.float64]:
    band = dict(zip(band_names, np.asarray(image, dtype=float), strict=True))
    if "darker" in channels:
        band["darker"] = 0.7 * np.minimum(band["red"], band["green"])
    return np.stack([band[name] for name in channels])


def _limits(stacks: Sequence[NDArray[np.float64]], shared: bool) -> list[tuple[float, float]]:
    """Lowest and highest reflectance shown in each channel, over all images."""
    pooled = np.concatenate([stack.reshape(3, -1) for stack in stacks], axis=1)
    if shared:  # one stretch for all channels keeps the hue
        high = float(np.nanpercentile(pooled, 99, axis=1).max())
        return [(0.0, max(high, 1e-6))] * 3
    low, top = np.nanpercentile(pooled, [1, 99], axis=1)
    return [(float(a), float(max(b, a + 1e-6))) for a, b in zip(low, top, strict=True)]


def _nice_length(width: float) -> float:
    """A round length near a fifth of `width`."""
    step = 10.0 ** np.floor(np.log10(width / 5))
    return float(max(s * step for s in (1, 2, 5) if s * step <= width / 4))


def _scale_bar(axes: Axes, width: float) -> None:
    length = _nice_length(width)
    x, y = 0.04 * width, 0.045 * width
    box = {"boxstyle": "square,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85}
    axes.text(x, y, f"{length:g} m", fontsize=8, va="bottom", bbox=box, zorder=3)
    axes.plot([x, x + length], [y * 0.62] * 2, color="white", lw=4, solid_capstyle="butt")
    axes.plot([x, x + length], [y * 0.62] * 2, color="black", lw=2, solid_capstyle="butt")


def composites(
    images: Mapping[str, ArrayLike],
    band_names: Sequence[str],
    *,
    pixel_m: float,
    kind: Literal["false_colour", "true_like"] = "false_colour",
) -> Figure:
    """Images side by side, all with one stretch, which is written below.

    **Arguments:**

    - `images`: [band, y, x] with y to the north, reflectance, by title, such as
      `{"Before": ..., "After": ...}`.
    - `band_names`: names of the bands; green, red and (for false colour) nir are needed.
    - `pixel_m`: side of a pixel [m].
    """
    channels, what = _COMPOSITES[kind]
    stacks = {title: _channels(image, band_names, channels) for title, image in images.items()}
    shared = kind == "true_like"
    limits = _limits(list(stacks.values()), shared)
    with _style():
        count = len(stacks)
        figure = Figure(figsize=(3.6 * count, 4.15))
        grid = figure.subplots(1, count, squeeze=False)[0]
        for axes, (title, stack) in zip(grid, stacks.items(), strict=True):
            rgb = np.stack(
                [(s - low) / (high - low) for s, (low, high) in zip(stack, limits, strict=True)],
                axis=-1,
            )
            # Square root, as prints and screens do: shadows stay readable.
            rgb = np.sqrt(np.clip(np.nan_to_num(rgb, nan=1.0), 0, 1))
            width, height = stack.shape[2] * pixel_m, stack.shape[1] * pixel_m
            axes.imshow(rgb, origin="lower", extent=(0, width, 0, height), interpolation="nearest")
            axes.set(title=title, xticks=[], yticks=[])
            for spine in axes.spines.values():
                spine.set_visible(False)
            _scale_bar(axes, width)
        ranges = (
            f"0 to {limits[0][1]:.3f} in all three (99th percentile)"
            if shared
            else "; ".join(
                f"{_words(name)} {low:.3f} to {high:.3f}"
                for name, (low, high) in zip(channels, limits, strict=True)
            )
            + " (1st to 99th percentile)"
        )
        figure.supxlabel(
            f"{what}.\nReflectance shown: {ranges}, square root. North up.",
            fontsize=7.5,
            color="#333333",
        )
    return figure


# -- distributions --------------------------------------------------------------------------


def index_histograms(
    before: Mapping[str, ArrayLike],
    after: Mapping[str, ArrayLike] | None = None,
    target: Mapping[str, tuple[float, float]] | None = None,
    *,
    columns: int = 4,
    bins: int = 80,
) -> Figure:
    """Histogram of each index over the pixels, with the target's mean and spread marked.

    **Arguments:**

    - `before`, `after`: pixel values of each index, any shape; NaN is left out.
    - `target`: mean and standard deviation over the pixels of the real image, by index; a NaN
      standard deviation draws the mean alone.
    """
    target = target or {}
    names = list(before)
    columns = min(columns, len(names))
    rows = -(-len(names) // columns)
    with _style():
        figure = Figure(figsize=(2.15 * columns, 1.75 * rows + 0.45))
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes in grid.flat[len(names) :]:
            axes.set_visible(False)
        for axes, name in zip(grid.flat, names, strict=False):
            drawn = [(before[name], BEFORE, True)]
            if after is not None:
                drawn.append((after[name], AFTER, False))
            values = [np.asarray(v, dtype=float).ravel() for v, _, _ in drawn]
            values = [v[np.isfinite(v)] for v in values]
            pooled = np.concatenate(values)
            low, high = np.percentile(pooled, [0.5, 99.5]) if pooled.size else (0.0, 1.0)
            mean, sd = target.get(name, (np.nan, np.nan))
            if np.isfinite(mean):
                reach = 1.3 * sd if np.isfinite(sd) else 0.0
                low, high = min(low, mean - reach), max(high, mean + reach)
            edges = np.linspace(low, high if high > low else low + 1e-6, bins + 1)
            for v, (_, colour, filled) in zip(values, drawn, strict=True):
                share = np.histogram(v, edges)[0] / max(v.size, 1) / np.diff(edges)
                axes.stairs(
                    share, edges, color=colour, fill=filled, alpha=0.55 if filled else 1, lw=1.3
                )
            if np.isfinite(mean):
                if np.isfinite(sd):
                    axes.axvspan(mean - sd, mean + sd, color=REAL, alpha=0.1, lw=0)
                axes.axvline(mean, color=REAL, lw=1.2, ls=(0, (4, 2)))
            axes.set(title=name, yticks=[], xlim=(edges[0], edges[-1]))
            axes.locator_params(axis="x", nbins=4)
            axes.spines["left"].set_visible(False)
        handles: list[Artist] = [matplotlib.patches.Patch(color=BEFORE, alpha=0.55, label="before")]
        if after is not None:
            handles.append(matplotlib.lines.Line2D([], [], color=AFTER, label="after"))
        if target:
            handles.append(
                matplotlib.lines.Line2D(
                    [], [], color=REAL, ls=(0, (4, 2)), label="real image: mean (grey: ±1 sd)"
                )
            )
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
        figure.supxlabel("Index value [-]; height is the density of pixels", fontsize=8.5)
    return figure


# -- parameters -----------------------------------------------------------------------------


def _pack(sizes: Sequence[int], columns: int) -> list[list[int]]:
    """Panels into columns of about equal height, in order of size (largest first)."""
    filled: list[list[int]] = [[] for _ in range(min(columns, len(sizes)))]
    heights = [0] * len(filled)
    for panel in sorted(range(len(sizes)), key=lambda k: -sizes[k]):
        shortest = heights.index(min(heights))
        filled[shortest].append(panel)
        heights[shortest] += sizes[panel] + 3  # title and axis take the height of three rows
    return [sorted(column) for column in filled]


_ROW = 0.185
"""Height of a row [inch]."""


def _panels(
    groups: Sequence[tuple[str, int]], columns: int, extra: float
) -> tuple[Figure, list[Axes]]:
    """A figure with one axes for each group, heights by the number of rows in it."""
    sizes = [count for _, count in groups]
    layout = _pack(sizes, columns)
    height = max(sum(sizes[p] + 3 for p in column) for column in layout) * _ROW + extra
    figure = Figure(figsize=(4.0 * len(layout) if len(layout) > 1 else 6.0, height))
    axes: list[Axes | None] = [None] * len(groups)
    tall = max(sum(sizes[p] + 3 for p in column) for column in layout)
    outer = figure.add_gridspec(1, len(layout))
    for k, column in enumerate(layout):
        used = [sizes[p] + 3 for p in column]
        spare = tall - sum(used)
        ratios = [*used, spare] if spare > 0 else used
        inner = outer[k].subgridspec(len(ratios), 1, height_ratios=ratios)
        for row, panel in enumerate(column):
            axes[panel] = figure.add_subplot(inner[row])
    return figure, [a for a in axes if a is not None]


def _groups(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    return [(str(kind), part) for kind, part in table.groupby("kind", sort=False)]


def _label(name: str, kind: str) -> str:
    """A parameter's name without what the panel's title says already."""
    short = name.removeprefix("species.").removesuffix(f".{kind}").removeprefix(f"{kind}.")
    short = short.removesuffix(".leaf")
    return _words(short)


def _rows(axes: Axes, labels: Sequence[str]) -> NDArray[np.float64]:
    y = np.arange(len(labels), dtype=float)
    axes.set_yticks(y, labels, fontsize=7.5)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    return y


def parameter_plot(table: pd.DataFrame, *, columns: int = 2) -> Figure:
    """Prior against estimate, with one standard deviation, one panel for each kind.

    **Arguments:** `table` with the columns name, kind, unit, prior, prior_sd, estimate, sd; one row
    for each parameter. Within a kind, rows are sorted by the prior, largest first.
    """
    groups = [
        (kind, part.sort_values("prior", ascending=False, kind="stable"))
        for kind, part in _groups(table)
    ]
    with _style():
        figure, panels = _panels([(k, len(p)) for k, p in groups], columns, 0.35)
        for axes, (kind, part) in zip(panels, groups, strict=True):
            y = _rows(axes, [_label(str(name), kind) for name in part["name"]])
            axes.errorbar(
                part["prior"], y - 0.16, xerr=part["prior_sd"], fmt="o", ms=4, mfc="white",
                color=GREY, lw=1.0,
            )  # fmt: skip
            axes.errorbar(
                part["estimate"], y + 0.16, xerr=part["sd"], fmt="o", ms=4, color=BLUE, lw=1.4
            )
            units = part["unit"].astype(str).unique()
            axes.set_title(_words(kind).capitalize() + (_unit(units[0]) if len(units) == 1 else ""))
            axes.locator_params(axis="x", nbins=6)
        handles = [
            matplotlib.lines.Line2D(
                [], [], marker="o", mfc="white", color=GREY, label="prior ±1 sd"
            ),
            matplotlib.lines.Line2D([], [], marker="o", color=BLUE, label="estimate ±1 sd"),
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=2)
    return figure


def constraint_plot(table: pd.DataFrame, *, columns: int = 2) -> Figure:
    """How far the data narrowed each parameter: 1 - (sd / prior sd)^2, in percent.

    **Arguments:** `table` with the columns name, kind, constrained (0 to 1). Within a kind, rows
    are sorted, best constrained first.
    """
    groups = [
        (kind, part.sort_values("constrained", ascending=False, kind="stable"))
        for kind, part in _groups(table)
    ]
    with _style():
        figure, panels = _panels([(k, len(p)) for k, p in groups], columns, 0.45)
        for axes, (kind, part) in zip(panels, groups, strict=True):
            share = 100 * part["constrained"].to_numpy(dtype=float)
            y = _rows(axes, [_label(str(name), kind) for name in part["name"]])
            axes.barh(y, np.full(share.shape, 100.0), height=0.62, color="#EFEFEF")
            axes.barh(
                y, share, height=0.62, color=np.where(share >= 100 * SEEN, BLUE, SKY).tolist()
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
            axes.set_title(_words(kind).capitalize())
            axes.grid(visible=False)
            axes.axvline(100 * SEEN, color="#999999", lw=0.7, ls=":")
        figure.supxlabel(
            "Variance removed by the data [%]; 0: only the prior speaks, 100: only the data",
            fontsize=8.5,
        )
    return figure


# -- the fit --------------------------------------------------------------------------------


def convergence_plot(
    loss: ArrayLike, gradient_norm: ArrayLike | None = None, *, loss_label: str = "Loss [-]"
) -> Figure:
    """Loss, and the norm of its gradient if given, against the iteration (from 0)."""
    losses = np.asarray(loss, dtype=float)
    with _style():
        rows = 1 if gradient_norm is None else 2
        figure = Figure(figsize=(5.2, 1.1 + 1.9 * rows))
        grid = figure.subplots(rows, 1, squeeze=False, sharex=True)[:, 0]
        series: list[tuple[NDArray[np.float64], str, str]] = [(losses, loss_label, BLUE)]
        if gradient_norm is not None:
            series.append((np.asarray(gradient_norm, dtype=float), "Gradient norm", GREEN))
        for axes, (values, label, colour) in zip(grid, series, strict=True):
            axes.plot(values, "-o", ms=3, lw=1.2, color=colour)
            finite = values[np.isfinite(values)]
            if finite.size and finite.min() > 0 and finite.max() / finite.min() > 5:
                axes.set_yscale("log")
            axes.set_ylabel(label)
            axes.grid(visible=True)
            if values.size:
                axes.annotate(
                    f"{values[-1]:.3g}", (values.size - 1, values[-1]), xytext=(4, 4),
                    textcoords="offset points", fontsize=8, color=colour,
                )  # fmt: skip
        grid[-1].set_xlabel("Iteration")
        grid[-1].xaxis.get_major_locator().set_params(integer=True)
    return figure


_FULL_SCALE = 100.0
"""Longer bars are cut and show their value, so that the short ones stay readable [%]."""


def error_bars(
    errors: Mapping[str, Mapping[str, float]], *, goal_percent: Mapping[str, float] | None = None
) -> Figure:
    """Absolute relative error of each statistic, one bar for each simulation.

    **Arguments:**

    - `errors`: relative errors [%], sign ignored, by simulation and statistic, such as
      `{"before": {"NIR": 12.0}, "after": {...}, "DIRSIG (paper)": {...}}`; a statistic that a
      simulation lacks has no bar.
    - `goal_percent`: the error aimed at, by statistic, drawn as a tick.
    """
    names = list(dict.fromkeys(name for values in errors.values() for name in values))
    colours = [BEFORE, AFTER, OTHER, PURPLE]
    count = len(errors)
    height = 0.8 / count
    with _style():
        figure = Figure(figsize=(6.4, (0.105 * count + 0.09) * len(names) + 1.0))
        axes = figure.subplots()
        highest = 0.0
        for k, (simulation, values) in enumerate(errors.items()):
            y = np.arange(len(names)) + (k - (count - 1) / 2) * height
            share = np.array([abs(values.get(name, np.nan)) for name in names])
            highest = max(highest, float(np.nanmax(share, initial=0.0)))
            bars = np.minimum(share, _FULL_SCALE)
            axes.barh(y, bars, height * 0.9, color=colours[k % 4], label=simulation)
            for position, value in zip(y, share, strict=True):
                if np.isfinite(value):
                    text = f"{value:.2g}" if value < 9.95 else f"{value:.0f}"
                    axes.annotate(
                        text if value <= _FULL_SCALE else f"→ {text}",
                        (min(value, _FULL_SCALE), position), xytext=(3, 0),
                        textcoords="offset points", fontsize=6.5, va="center", zorder=4,
                        bbox={"boxstyle": "square,pad=0.05", "fc": "white", "ec": "none"},
                    )  # fmt: skip
        for name, goal in (goal_percent or {}).items():
            if name in names:
                row = names.index(name)
                axes.plot([goal, goal], [row - 0.45, row + 0.45], color=VERMILION, lw=1.2)
        handles, labels = axes.get_legend_handles_labels()
        if goal_percent:
            handles.append(matplotlib.lines.Line2D([], [], color=VERMILION, lw=1.2))
            labels.append("goal")
        figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
        axes.set_yticks(np.arange(len(names)), names)
        axes.set_ylim(len(names) - 0.45, -0.55)
        axes.tick_params(axis="y", length=0)
        axes.set_xlim(0, min(highest, _FULL_SCALE) * 1.1 or 1)
        axes.set_xlabel("|simulated - real| / |real| [%]")
        axes.grid(axis="x")
    return figure
