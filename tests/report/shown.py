"""What a figure shows, read back from where it is drawn: the place on the paper, not the order of
an array, and the colour that the legend names, not the one that the code means."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import MouseEvent
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure


def laid_out(figure: Figure) -> Figure:
    """The figure, drawn once, so that its axes have their places."""
    FigureCanvasAgg(figure).draw()
    return figure


def panel(figure: Figure, title: str) -> Axes:
    """The only axes whose title begins so, on whichever side it stands."""
    found = [
        axes
        for axes in figure.axes
        if any(axes.get_title(loc=side).startswith(title) for side in ("left", "center", "right"))
    ]
    assert len(found) == 1, f"{title!r}: {len(found)} panels"
    return found[0]


def at(figure: Figure, axes: Axes, right: float, up: float, image: int = -1) -> Any:
    """The value of an image where it is seen, in shares of its axes from the lower left corner."""
    x, y = axes.transAxes.transform((right, up))
    return axes.images[image].get_cursor_data(
        MouseEvent("motion_notify_event", figure.canvas, x, y)
    )


def ends(low: float = 0.02) -> tuple[tuple[float, float], ...]:
    """South-west, south-east, north-west and north-east, just inside the axes."""
    return (low, low), (1 - low, low), (low, 1 - low), (1 - low, 1 - low)


def seen_corners(figure: Figure, axes: Axes, image: int = -1) -> list[Any]:
    """The values in the corners of an image, as `ends` has them."""
    return [at(figure, axes, *place, image) for place in ends()]


def corners(values: np.ndarray) -> list[float]:
    """The same of an array with row 0 in the south."""
    return [values[0, 0], values[0, -1], values[-1, 0], values[-1, -1]]


def colour(figure: Figure, label: str, axes: Axes | None = None) -> tuple[float, ...]:
    """The colour that a legend names, without its opacity."""
    legends = [*figure.legends, *([axes.get_legend()] if axes and axes.get_legend() else [])]
    for legend in legends:
        for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True):
            if text.get_text() == label:
                get = getattr(handle, "get_facecolor", None) or handle.get_color
                shown = get()
                shown = shown[0] if np.ndim(shown) == 2 else shown
                return to_rgba(shown)[:3]
    raise AssertionError(f"no legend names {label!r}")


def lines(axes: Axes, of: tuple[float, ...], marker: str | None = None) -> list[np.ndarray]:
    """Points [x, y] of every line of a colour, those with a marker alone if that is named."""
    return [
        np.array(line.get_data(), float)
        for line in axes.lines
        if to_rgba(line.get_color())[:3] == of and marker in (None, line.get_marker())
    ]


def segments(axes: Axes, of: tuple[float, ...]) -> np.ndarray:
    """Ends [segment, end, xy] of every stroke of a colour in collections, such as intervals."""
    found = [
        np.array(one.get_segments())
        for one in axes.collections
        if hasattr(one, "get_segments") and to_rgba(one.get_color()[0])[:3] == of
    ]
    return np.concatenate(found)
