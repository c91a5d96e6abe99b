"""How every figure looks (readable labels, colour-blind safe), and how it is written.

Colours are those of Okabe and Ito (2008).
"""

import io
import itertools
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.figure
import matplotlib.image
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.category import StrCategoryFormatter
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from fynjax.app.io.text import atomic_path

ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
GREY = "#7F7F7F"
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
"""Colours of lines that are of one kind, in their order."""
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


GROUND = "ground"
"""Mark (`gid`) of axes that show the ground from above, all of a page with one scale of length."""


class _PlainPowers(LogFormatterSciNotation):
    """Numbers along a logarithmic axis without mathematical text: 0.01, 1, 1e+06."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


class Figure(matplotlib.figure.Figure):
    """A figure that a notebook shows by itself, also where nothing was drawn by pyplot before.

    Text is text: names come from files of anybody, and matplotlib would take what stands between
    two dollar signs for a formula, which ends in an error where it is none.
    """

    def draw(self, renderer: Any) -> None:
        """Draw all parts, with `renderer`."""
        for axes in self.axes:
            for axis in (axes.xaxis, axes.yaxis):
                for level in ("major", "minor"):
                    kind = getattr(axis, f"get_{level}_formatter")()
                    if type(kind) is LogFormatterSciNotation:
                        plain = _PlainPowers(
                            labelOnlyBase=kind.labelOnlyBase, minor_thresholds=kind.minor_thresholds
                        )
                        getattr(axis, f"set_{level}_formatter")(plain)
        for text in self.findobj(Text):
            text.set_parse_math(False)
        with matplotlib.rc_context({"text.parse_math": False}):  # of ticks that are made now
            super().draw(renderer)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


@contextmanager
def style() -> Iterator[None]:
    """The look of every figure, for the block."""
    with matplotlib.rc_context(_STYLE):
        yield


def save_figure(
    figure: matplotlib.figure.Figure, path: str | Path, *, dpi: int = FIGURE_DPI
) -> None:
    """Write a figure as PNG, PDF or SVG, by the suffix of its file.

    **Arguments:** `figure`; `path` of the file, which is replaced at once when complete; `dpi`,
    pixels an inch of a PNG.
    """
    for text in figure.findobj(lambda one: isinstance(one, Text) and "[" in one.get_text()):
        text.set_text(typeset(text.get_text()))  # type: ignore[attr-defined]
    with atomic_path(path) as partial:
        figure.savefig(partial, dpi=dpi, facecolor="white")


def named_rows(
    figure: matplotlib.figure.Figure,
) -> list[tuple[str, tuple[float, float, float, float]]]:
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


def ground_panels(figure: matplotlib.figure.Figure) -> list[tuple[float, float, float, float]]:
    """Where a `figure`, once written, shows the ground (`GROUND`): left, top, width and height of
    each such panel, in shares of the figure's width and height from its upper left corner."""
    boxes = [axes.get_position() for axes in figure.axes if axes.get_gid() == GROUND]
    return [(box.x0, 1.0 - box.y1, box.width, box.height) for box in boxes]


def stacked_panels(figure: matplotlib.figure.Figure, width: float) -> list[NDArray[np.uint8]]:
    """A written `figure` for a narrow page: its panels one below the other, each with its own
    labels, then legends; one panel as wide as `width` [inches]. Each as [y, x, RGB] at
    `FIGURE_DPI`; none where its parts find no room, or reach into each other."""
    axes = [each for each in figure.axes if each.get_visible() and each.has_data()]
    panels = [each for each in axes if not hasattr(each, "_colorbar")]
    wide, tall = figure.get_size_inches().tolist()
    dots = figure.dpi
    several = len(panels) + len(figure.legends) > 1
    for each in panels if len(panels) > 1 else ():
        each.tick_params(labelleft=each.axison, labelbottom=each.axison)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            figure.set_size_inches(wide if several else width, tall)
            figure.set_dpi(FIGURE_DPI)  # words are as wide as they are drawn
            if not several:
                buffer = io.BytesIO()
                edges: Any = {"bbox_inches": "tight", "pil_kwargs": {"compress_level": 1}}
                figure.savefig(buffer, format="png", dpi=FIGURE_DPI, facecolor="white", **edges)
                buffer.seek(0)
                picture = matplotlib.image.imread(buffer)[..., :3]
                return [np.round(255.0 * picture).astype(np.uint8)]
            canvas = FigureCanvasAgg(figure)
            figure.set_facecolor("white")
            canvas.draw()
            whole: NDArray[np.uint8] = np.array(canvas.buffer_rgba())[..., :3]
            renderer = canvas.get_renderer()
            parts = _parts(figure, panels, [each for each in axes if each not in panels], renderer)
    except (UserWarning, ValueError):
        return []
    finally:
        figure.set_size_inches(wide, tall)
        figure.set_dpi(dots)
    places = [_pixels(box, len(whole)) for box in parts]
    cut = [np.array(whole[place]) for place in places[: len(panels)]]
    for place in places[: len(panels)]:
        whole[place] = 255  # of what is beside panels none shows a piece of one
    beside = [whole[place] for place in places[len(panels) :]]
    cut += [part if len(part) <= part.shape[1] else np.rot90(part, -1) for part in beside]
    return cut if all(part.size for part in cut) else []


def _pixels(box: Bbox, high: int) -> tuple[slice, slice]:
    """Rows and columns of a box in a picture of a height [pixels]."""
    x0, x1, y0, y1 = (
        round(x) for x in (box.x0 - 3, box.x1 + 3, high - box.y1 - 3, high - box.y0 + 3)
    )
    return slice(max(y0, 0), y1), slice(max(x0, 0), x1)


def _parts(
    figure: matplotlib.figure.Figure, panels: list[Axes], scales: list[Axes], renderer: Any
) -> list[Bbox]:
    """Where each panel lies with its own scale of colours, then scales of several, words and
    legends of all."""
    boxes: dict[Axes, Any] = {each: each.get_tightbbox(renderer) for each in panels}
    if any(
        a.padded(-3).overlaps(b.padded(-3)) for a, b in itertools.combinations(boxes.values(), 2)
    ):
        raise ValueError("panels reach into each other")
    shared = []
    for scale in scales:
        box: Any = scale.get_tightbbox(renderer)
        own = scale._colorbar.mappable.axes  # type: ignore[attr-defined]
        both = Bbox.union([boxes.get(own, box), box])
        if own in boxes and not any(both.overlaps(boxes[each]) for each in panels if each != own):
            boxes[own] = both
        else:
            shared.append(box)
    words = [text for text in figure.texts if text.get_text()]
    shared += [text.get_window_extent(renderer).padded(3) for text in words]
    return [*boxes.values(), *shared, *(
        legend.get_window_extent(renderer).padded(9) for legend in figure.legends
    )]  # fmt: skip


def panel_grid(
    count: int,
    columns: int,
    panel: tuple[float, float],
    beside: tuple[float, float] = (0.0, 0.0),
    **shared: Any,
) -> tuple[Figure, list[Any]]:
    """A figure of equal panels, row by row.

    **Arguments:** `count`: of the panels; `columns`: most panels in a row; `panel`: width and
    height of each, with its labels [inches]; `beside`: width and height of what stands beside all
    panels [inches]; `shared`: `sharex` and `sharey`, as of `Figure.subplots`.

    **Returns:** the figure and its `count` axes.
    """
    columns = max(min(columns, count), 1)
    rows = max(-(-count // columns), 1)
    size = panel[0] * columns + beside[0], panel[1] * rows + beside[1]
    figure = Figure(figsize=size)
    axes = list(figure.subplots(rows, columns, squeeze=False, **shared).flat)
    for unused in axes[count:]:
        unused.set_axis_off()
    return figure, axes[:count]


def name_rows(axes: Axes, labels: Sequence[str], *, room: int = 0) -> NDArray[np.float64]:
    """Name the rows of a figure from the top.

    **Arguments:** `axes`; `labels`, one a row; `room`, rows to leave space for where there are
    fewer.

    **Returns:** the height of each row on the axis.
    """
    y = np.arange(len(labels), dtype=float)
    axes.set_yticks(y, labels, fontsize=7.5)
    axes.set_ylim(max(len(labels), room) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    return y


def small_print(figure: Figure, text: str) -> None:
    """Small print below a `figure`."""
    figure.supxlabel(text, fontsize=7.5, color="#333333")


def words(name: str) -> str:
    """The `name` of a statistic or parameter in words."""
    return name.replace("_", " ").replace("nir", "NIR")


def typeset(text: str) -> str:
    """A text with the exponents and the micro of its units: 2 m2 m-2 becomes 2 m² m⁻².

    **Arguments:** `text`. One unit alone is typeset only after a number or in brackets, as taxa,
    plots and files may have such names.
    """
    return _OF_UNITS.sub(_raised, text)


def _raised(found: re.Match[str]) -> str:
    units, before = found[0], found.string[: found.start()]
    alone = not re.search(r"[ /\n]", units)
    stated = before.endswith(("[", "(")) or re.search(
        r"(\d|\b(per|in|plants|returns|pulses)) $", before
    )
    if (alone or not re.search(r"\d", units)) and not (stated or units == found.string):
        return units
    units = re.sub(r"(?<![a-z])u(?=[gmW])", "µ", units)
    return re.sub(r"-?[1-3]", lambda power: power[0].translate(_RAISED), units)


_UNIT = r"(?:[cdkmnuµ]?m(?:[23]|-[1-3])?|(?:[kmuµ]?[gW]|k?J|sr|s|h|ha|mol|K)(?:-[1-3])?)"
_OF_UNITS = re.compile(rf"(?<![\w./-]){_UNIT}(?:[ /\n]{_UNIT})*(?![\w/'(-]|\.\w)")
_RAISED = str.maketrans("-123", "⁻¹²³")
