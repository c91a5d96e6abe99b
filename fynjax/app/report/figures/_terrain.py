"""The terrain as a picture: what is wrong with a surface shows at once under a low sun."""

from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from fynjax.app.report.figures._style import Figure
from fynjax.app.terrain import Terrain


def hillshade(
    terrain: Terrain, *, sun_zenith: float = 45.0, sun_azimuth: float = 315.0
) -> Float64[np.ndarray, "y x"]:
    """Cosine between the ground's normal and the sun, 0 where it is turned away [-].

    `sun_azimuth` is clockwise from north; both angles in degrees.
    """
    zenith, azimuth = np.radians(sun_zenith), np.radians(sun_azimuth)
    east, north = terrain.gradient()
    towards = np.array(
        [np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)]
    )
    cosine = (towards[2] - east * towards[0] - north * towards[1]) / np.sqrt(1 + east**2 + north**2)
    return np.maximum(cosine, 0.0)


def terrain_figure(terrain: Terrain, canopy: NDArray[np.float64] | None = None) -> Figure:
    """Heights over a shaded relief, where they are interpolated, and the height of the canopy.

    **Arguments:** `terrain`, the heights of the ground; `canopy`, the highest point above the
    ground in each cell [m], if known.
    """
    gap = terrain.gap if terrain.gap is not None and terrain.gap.any() else None
    panels = 1 + (canopy is not None) + (gap is not None)
    rows, columns = -(-panels // 2), min(panels, 2)
    west, south, east, north = terrain.bounds
    extent = (0.0, east - west, 0.0, north - south)
    size = (5.4 if columns == 1 else 10.4, 4.6 * rows)
    figure = Figure(figsize=size, layout="constrained")
    axes: Any = list(figure.subplots(rows, columns, squeeze=False).flat)
    for left in axes[panels:]:
        left.remove()
    show: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
    axes[0].imshow(hillshade(terrain), cmap="gray", vmin=0.0, vmax=1.0, **show)
    heights = axes[0].imshow(terrain.heights, cmap="viridis", alpha=0.45, **show)
    whole = ScalarFormatter(useOffset=False)  # 350.2 m, and not 0.2 with "+3.5e2" above the bar
    figure.colorbar(
        heights, ax=axes[0], label="Height of the ground [m]", shrink=0.85, format=whole
    )
    axes[0].set_title("Ground, shaded from the north-west", loc="left", fontsize=9.5)
    if canopy is not None:
        top = float(np.nanpercentile(canopy, 99.5)) if np.isfinite(canopy).any() else 1.0
        above = axes[1].imshow(canopy, cmap="YlGn", vmin=0.0, vmax=max(top, 0.1), **show)
        axes[1].set_facecolor("#D0D0D0")
        figure.colorbar(above, ax=axes[1], label="Highest point above ground [m]", shrink=0.85)
        axes[1].set_title("Canopy; grey where there is no point", loc="left", fontsize=9.5)
    if gap is not None:
        panel = axes[panels - 1]
        shown = np.where(gap > 0.0, gap, np.nan)
        distance = panel.imshow(shown, cmap="magma_r", vmin=0.0, vmax=float(gap.max()), **show)
        label = "From the nearest measured ground [m]"
        figure.colorbar(distance, ax=panel, label=label, shrink=0.85)
        panel.set_title("Interpolated ground; white where measured", loc="left", fontsize=9.5)
    for panel in axes[:panels]:
        panel.set_xlabel("East [m]")
        panel.set_ylabel("North [m]")
    return figure
