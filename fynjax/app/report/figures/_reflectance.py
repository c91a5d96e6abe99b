"""Pictures of calibrated captures, and of the panels they rest on."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from fynjax.app.io.captures import PanelView
from fynjax.app.io.raster import Cube
from fynjax.app.report.figures._style import VERMILION, Figure, note, style

_THIN = 640
"""Pixels of a picture's longer side; larger ones are thinned for it."""
_COLOURS = {
    "True colour": (660.0, 560.0, 475.0),
    "False colour (NIR, red, green)": (850.0, 660.0, 560.0),
}
"""Red, green and blue of a picture, and where they lie [nm]."""
_FAR = 45.0  # nm from there to a band, up to which it serves


def _band(cube: Cube, wavelength: float) -> NDArray[np.float64] | None:
    away = np.abs(cube.wavelength - wavelength)
    return cube.values[int(away.argmin())] if away.min() <= _FAR else None


@style()
def capture_figure(cube: Cube, title: str, *, pixels: bool) -> Figure:
    """Reflectance of a capture: composites and NDVI, as far as its bands reach.

    **Arguments:** `cube`, the reflectance [-]; `title` of the figure; `pixels`, whether the
    coordinates of `cube` are pixels instead of metres.
    """
    pictures: dict[str, NDArray[np.float64]] = {}
    ranges = []
    for name, waves in _COLOURS.items():
        bands = [band for wave in waves if (band := _band(cube, wave)) is not None]
        if len(bands) < 3:
            continue
        stack = np.stack(bands, axis=-1)
        high = np.nanpercentile(stack, 99, axis=(0, 1))
        pictures[name] = np.sqrt(np.clip(np.nan_to_num(stack / high, nan=1.0), 0.0, 1.0))
        ranges.append(f"{name.split(' (')[0].lower()} 0 to {', '.join(f'{v:.2f}' for v in high)}")
    red, nir = _band(cube, 660.0), _band(cube, 850.0)
    if red is not None and nir is not None:
        total = nir + red
        dark = ~(total > 0.0)
        pictures["NDVI"] = np.where(dark, np.nan, (nir - red) / np.where(dark, 1.0, total))
    if not pictures:  # a camera of few bands
        pictures = dict(zip(cube.names, cube.values, strict=True))
    rows, columns = cube.values.shape[1:]
    step = max(1, max(rows, columns) // _THIN)
    side = cube.pixel_m
    extent = (0.0, columns * side, 0.0, rows * side)
    figure = Figure(figsize=(3.9 * len(pictures) + 0.5, 3.9 * rows / columns + 0.9))
    grid = figure.subplots(1, len(pictures), squeeze=False)[0]
    for axes, (name, picture) in zip(grid, pictures.items(), strict=True):
        flat = picture.ndim == 2
        image = axes.imshow(
            picture[::step, ::step], origin="lower", extent=extent, interpolation="nearest",
            cmap="RdYlGn" if name == "NDVI" else "gray" if flat else None,
            vmin=-1.0 if name == "NDVI" else None, vmax=1.0 if name == "NDVI" else None,
        )  # fmt: skip
        axes.set(title=f"{title}\n{name}" if axes is grid[0] else name)
        if flat:
            figure.colorbar(image, ax=axes, label=f"{name} [-]", shrink=0.85)
        axes.set_xlabel("x [pixel]" if pixels else "x [m]")
    grid[0].set_ylabel("y [pixel]" if pixels else "y [m]")
    if ranges:
        note(
            figure,
            f"Reflectance shown: {'; '.join(ranges)} (99th percentiles), square root. "
            "Saturated pixels white.",
        )
    return figure


@style()
def panel_figure(panels: Sequence[PanelView], known: Sequence[NDArray[np.float64]]) -> Figure:
    """Every panel in every band, with the outline of the pixels that were read.

    **Arguments:** `panels`, the panels in their captures; `known`, for each panel its known
    reflectance by band [-].
    """
    columns = max(len(panel.areas) for panel in panels)
    figure = Figure(figsize=(2.3 * columns + 0.3, 2.15 * len(panels) + 0.25))
    grid = figure.subplots(len(panels), columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for row, panel, rho in zip(grid, panels, known, strict=True):
        for k, axes in enumerate(row[: len(panel.areas)]):
            _draw_panel(axes, panel, k, float(rho[k]))
    note(
        figure,
        "Counts of each band's own picture, with the pixels that were read (outlined), their "
        "spread and the panel's reflectance.",
    )
    return figure


def _draw_panel(axes: Axes, panel: PanelView, k: int, known: float) -> None:
    band = panel.capture.bands[k]
    step = max(1, max(band.counts.shape) // _THIN)
    rows, columns = band.counts.shape
    axes.imshow(band.counts[::step, ::step], cmap="gray", extent=(0, columns, rows, 0))
    axes.add_patch(Polygon(panel.areas[k], closed=True, fill=False, ec=VERMILION, lw=1.6))
    axes.set_title(
        f"{panel.capture.name} {band.name}\nreflectance {known:.3g}, "
        f"spread {100 * panel.spread[k] / panel.mean[k]:.1f} %",
        fontsize=8,
    )
