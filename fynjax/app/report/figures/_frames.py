"""From where the frames of a flight see a plot."""

from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Int
from matplotlib.ticker import MaxNLocator

from fynjax.app.report.figures._style import BLUE, GREY, Figure, style


@style()
def frames_figure(table: pd.DataFrame, count: Int[np.ndarray, "y x"], pixel: float) -> Figure:
    """Directions from the plot to the cameras, and how many frames see each pixel.

    **Arguments:** `table`, a row a frame with `view_zenith_deg`, `view_azimuth_deg`, `seen` and,
    where some are not used, `used`; `count`, frames of each pixel; `pixel`, its side [m].
    """
    figure = Figure(figsize=(9.6, 4.4))
    polar: Any = figure.add_subplot(1, 2, 1, projection="polar")
    polar.set_theta_zero_location("N")
    polar.set_theta_direction(-1)
    inside = table[table["seen"] > 0]
    chosen = inside["used"] == "yes" if "used" in inside else np.ones(len(inside), bool)
    polar.scatter(
        np.radians(inside["view_azimuth_deg"]), inside["view_zenith_deg"],
        s=12 + 48 * inside["seen"], color=np.where(chosen, BLUE, "none"), alpha=0.7,
        edgecolors=np.where(chosen, "none", GREY),
    )  # fmt: skip
    polar.set_rlim(0.0, max(10.0, 1.1 * float(inside["view_zenith_deg"].max())))
    polar.set_xticks(np.radians([0, 90, 180, 270]), list("NESW"))
    polar.tick_params(colors=GREY)
    hollow = "" if np.all(chosen) else "; hollow: not used"
    title = f"Cameras as seen from the plot: zenith angle [degrees]\nlarger: more of it{hollow}"
    polar.set_title(title)
    axes: Any = figure.add_subplot(1, 2, 2)
    rows, columns = count.shape
    shown = axes.imshow(
        count, origin="lower", extent=(0, columns * pixel, 0, rows * pixel), cmap="viridis",
        vmin=0, interpolation="nearest",
    )  # fmt: skip
    whole = MaxNLocator(integer=True)
    figure.colorbar(shown, ax=axes, label="Frames that see the pixel", shrink=0.85, ticks=whole)
    axes.set(xlabel="East [m]", ylabel="North [m]")
    axes.set_title("How often the plot was seen")
    return figure
