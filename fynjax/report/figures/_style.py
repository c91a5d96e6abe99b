"""How every figure looks (readable labels, colour-blind safe), and how it is written.

Colours are those of Okabe and Ito (2008).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

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


def words(name: str) -> str:
    """The `name` of a statistic or parameter in words."""
    return name.replace("_", " ").replace("nir", "NIR")
