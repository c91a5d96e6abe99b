"""Maps of quantities beside their standard deviations."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from fynjax.app.report.figures._style import Figure, panel_grid, style

_MASKED = "#D9D9D4"
_ACROSS = 4
"""Panels of quantities in a row."""
_Interval = tuple[float | None, float | None, float | None]
"""Low end, mean, high end."""


@style()
def maps_figure(
    maps: Mapping[
        str, tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"], str, str]
    ],
    unlikeness: Float[np.ndarray, "row column"],
    words_of_it: str,
) -> Figure:
    """Each map, and below it its standard deviation; at the end how unlike training pixels are.

    **Arguments:**

    - `maps`: mean, standard deviation, words and unit, by name; row 0 at the top.
    - `unlikeness`: 1 at the limit.
    - `words_of_it`: words for it.
    """
    across = 3
    rows = -(-(len(maps) + 1) // across)
    high, wide = unlikeness.shape
    side = float(np.clip(high / wide, 0.25, 2.5))
    figure = Figure(figsize=(10.2, rows * (1.65 * side + 0.75)))
    grid: Any = figure.subplots(rows, 2 * across, squeeze=False)
    cells = [(r, 2 * c) for r in range(rows) for c in range(across)]
    for (r, c), (mean, sd, words, unit) in zip(cells, maps.values()):
        label = "" if unit == "1" else f" [{unit}]"
        _show(figure, grid[r, c], mean, "viridis", f"{words}{label}", unit == "1")
        _show(figure, grid[r, c + 1], sd, "magma", "its sd", False)
    r, c = cells[len(maps)]
    _show(
        figure, grid[r, c], np.clip(unlikeness, 0.0, 3.0), "cividis", words_of_it, False
    )  # fmt: skip
    for r, c in [*((a, b + 1) for a, b in cells[len(maps) :]), *cells[len(maps) + 1 :]]:
        grid[r, c].set_axis_off()
    for r, c in cells[len(maps) + 1 :]:
        grid[r, c + 1].set_axis_off()
    return figure


@style()
def pixels_figure(
    pixels: Mapping[str, Mapping[str, tuple[_Interval, _Interval]]],
    quantities: Mapping[str, tuple[str, str]],
) -> Figure:
    """Intervals of pixels, by the regression of a map and by their full posteriors.

    **Arguments:**

    - `pixels`: of each the low end, mean and high end of each quantity, by both.
    - `quantities`: words and unit by name.
    """
    size = 2.55, 1.1 + 0.42 * len(pixels)
    figure, panels = panel_grid(len(quantities), _ACROSS, size, (0.0, 0.4))
    for axes, (name, (words, unit)) in zip(panels, quantities.items(), strict=True):
        for place, found in enumerate(pixels.values()):
            for (low, mean, high), below, colour, label in zip(
                found[name], (-0.15, 0.15), ("#8A8A85", "#1B6B4A"), ("map", "emcee")
            ):
                y = place + below
                shown = label if place == 0 else None
                axes.plot(
                    [low, high], [y, y], color=colour, lw=2, label=shown, solid_capstyle="butt"
                )
                axes.plot(mean, y, "o", color=colour, ms=4)
        axes.set_title(words if unit == "1" else f"{words} [{unit}]", fontsize=8)
        first = axes in panels[::_ACROSS]
        axes.set_yticks(range(len(pixels)), list(pixels) if first else [""] * len(pixels))
        axes.set_ylim(len(pixels) - 0.5, -0.5)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def _show(
    figure: Figure, axes: Axes, values: np.ndarray, colours: str, title: str, share: bool
) -> None:
    known = values[np.isfinite(values)]
    low, high = (0.0, 1.0) if share else (
        np.quantile(known, [0.02, 0.98]) if known.size else (0.0, 1.0)
    )  # fmt: skip
    image = axes.imshow(
        np.ma.masked_invalid(values), cmap=matplotlib.colormaps[colours], vmin=low,
        vmax=max(high, low + 1e-6), interpolation="nearest",
    )  # fmt: skip
    axes.set_facecolor(_MASKED)
    axes.set_title(title, fontsize=8)
    axes.set(xticks=[], yticks=[])
    figure.colorbar(image, ax=axes, orientation="horizontal", pad=0.03, shrink=0.9)
