"""Pictures of a simulated point cloud: from the side, and its heights against what was planted."""

import numpy as np
from jaxtyping import Float

from fynjax.app.compare import LEVELS, Heights
from fynjax.app.report.figures._style import BLUE, GREEN, ORANGE, Figure, style
from fynjax.sensors import LidarReturns
from fynjax.sensors.lidar import GROUND

_STRIP = 1.0
_GROUND_COLOUR = "#8C6D46"
_WIDE = 6.0
"""Width of the panels [inches]."""


@style()
def side_view(
    returns: LidarReturns,
    height: Float[np.ndarray, " point"],
    extent: tuple[float, float],
    *,
    title: str = "",
) -> Figure:
    """The cloud from the south, and from above, coloured by `height` above the ground [m].

    **Arguments:** `returns` of the pulses; `height` of each above the ground [m]; `extent` of the
    plot to the east and to the north [m]; `title` of the figure.

    From the south only a strip through the plot's middle is shown, so that plants stay apart.
    """
    lx, ly = extent
    x, y, z = returns.position.T
    ground = returns.classification == GROUND
    deep = min(_STRIP, ly)
    strip = np.abs(y - 0.5 * ly) <= 0.5 * deep
    top = max(float(np.percentile(height, 99.9)), 0.1)
    # Of the strip alone: a false return elsewhere must not leave the figure empty.
    tall = np.ptp(z[strip]) if strip.any() else 0.0
    heights = np.clip(_WIDE * np.array([tall, ly]) / lx, 0.8, 1.5 * _WIDE)
    spacing = 72.0 * _WIDE / lx * np.sqrt(lx * ly / max(len(x), 1))  # of the points, in points
    size = float(np.clip(0.7 * spacing, 1.0, 3.5) ** 2)
    colours = {"cmap": "viridis", "vmin": 0, "vmax": top, "s": size, "lw": 0, "rasterized": True}
    figure = Figure(figsize=(_WIDE + 1.6, heights.sum() + 1.7))
    side, above = figure.subplots(2, 1, height_ratios=heights.tolist())
    low = strip & ground
    side.scatter(x[low], z[low], s=size, c=_GROUND_COLOUR, lw=0, label="ground", rasterized=True)
    high = strip & ~ground
    shown = side.scatter(x[high], z[high], c=height[high], **colours)
    side.set(
        xlim=(0, lx), xlabel="East [m]", ylabel="Height [m]", aspect="equal",
        title=f"Strip of {deep:g} m through the middle, from the south",
    )  # fmt: skip
    side.legend(loc="upper right", markerscale=np.sqrt(20.0 / size))
    order = np.argsort(height)
    above.scatter(x[order], y[order], c=height[order], **colours)
    above.set(
        xlim=(0, lx), ylim=(0, ly), xlabel="East [m]", ylabel="North [m]", aspect="equal",
        title="From above, the highest on top",
    )  # fmt: skip
    figure.suptitle(title)
    figure.colorbar(shown, ax=[side, above], label="Height above ground [m]", shrink=0.7)
    return figure


@style()
def height_profiles(compared: Heights) -> Figure:
    """Shares of planted area, of first hits and of returns against height, and percentiles.

    **Arguments:** `compared`, the heights of the plants and of the point cloud.
    """
    edges = compared.edges
    colours = dict(zip(compared.shares, (GREEN, ORANGE, BLUE)))
    figure = Figure(figsize=(9.4, 4.6))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    for number, (name, share) in enumerate(compared.shares.items()):
        left.stairs(
            share / np.diff(edges), edges, orientation="horizontal", color=colours[name],
            fill=number == 0, alpha=0.35 if number == 0 else 1.0, lw=1.6, label=name,
        )  # fmt: skip
    for name, values in compared.percentiles.items():
        right.plot(LEVELS, values, color=colours[name], lw=1.6, marker="o", ms=3, label=name)
    left.set(xlabel="Share per height [m⁻¹]", ylabel="Height above ground [m]")
    left.set_title("Plants against height")
    left.set_xlim(0, None)
    left.set_ylim(0, edges[-1])
    left.legend(loc="upper right")
    right.set(xlabel="Percentile", title="Percentiles of height")
    for axes in (left, right):
        axes.grid()
    return figure
