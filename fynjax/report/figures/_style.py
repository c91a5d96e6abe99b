"""How every figure looks (readable labels, colour-blind safe), and how it is written.

Colours are those of Okabe and Ito (2008).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.category import StrCategoryFormatter
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from fynjax.io.text import atomic_path

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
def style() -> Iterator[None]:
    """The look of every figure, for the block."""
    with matplotlib.rc_context(_STYLE):
        yield


def save_figure(figure: Figure, path: str | Path, *, dpi: int = FIGURE_DPI) -> None:
    """Write a figure as PNG, PDF or SVG, by the suffix of its file.

    **Arguments:** `figure`; `path` of the file, which is replaced at once when complete; `dpi`,
    pixels an inch of a PNG.
    """
    with atomic_path(path) as partial:
        figure.savefig(partial, dpi=dpi, facecolor="white")


def named_rows(figure: Figure) -> list[tuple[str, tuple[float, float, float, float]]]:
    """Rows of a figure that have names for ticks, such as a bar for each species.

    **Arguments:** `figure`, once written: its layout is made then.

    **Returns:** each name with left, top, width and height of its row, names included, in shares of
    the figure's width and height from its upper left corner.
    """
    # Measured as drawn at the figure's own resolution, whatever that of the file was.
    renderer = FigureCanvasAgg(figure).get_renderer()
    wide, high = figure.bbox.width, figure.bbox.height
    rows = []
    for axes in figure.axes:
        if not isinstance(axes.yaxis.get_major_formatter(), FuncFormatter | StrCategoryFormatter):
            continue  # a scale of numbers
        named = [label for label in axes.get_yticklabels() if label.get_text().strip()]
        if not named:
            continue
        # Middles of the rows, whatever the scale along them.
        to_pixels = axes.get_yaxis_transform().transform
        middle = np.array([to_pixels((0.0, label.get_position()[1]))[1] for label in named])
        extents = [label.get_window_extent(renderer) for label in named]
        apart = np.diff(np.sort(middle))
        apart = apart[apart > 0]
        row = apart.min() if apart.size else 1.6 * max(e.height for e in extents)
        left, right = min(e.x0 for e in extents), axes.bbox.x1
        rows += [
            (
                label.get_text(),
                (left / wide, 1.0 - (at + 0.5 * row) / high, (right - left) / wide, row / high),
            )
            for label, at in zip(named, middle, strict=True)
            if axes.bbox.y0 <= at <= axes.bbox.y1
        ]
    return rows


def words(name: str) -> str:
    """The `name` of a statistic or parameter in words."""
    return name.replace("_", " ").replace("nir", "NIR")
