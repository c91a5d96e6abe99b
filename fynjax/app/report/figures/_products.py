"""Pictures of an image product: quick looks and spectra."""

import math
from collections.abc import Mapping

import matplotlib
import numpy as np

from fynjax.app.io.raster import QUANTITIES, Cube, colour_bands
from fynjax.app.report.figures._image import composites
from fynjax.app.report.figures._style import BLUE, GREY, SKY, Figure, style, typeset

_FEW = 25  # bands of which each is drawn
_FEW_PIXELS = 64
"""Pixels that are no picture: the spectrum of each is drawn instead."""


def quick_looks(cube: Cube, title: str) -> dict[str, Figure]:
    """Pictures of a reflectance image, by file name.

    **Arguments:** `cube`, the reflectance [-]; `title` of the pictures. Pictures of bands that the
    sensor does not have are left out, as are those of so few pixels that they show nothing:
    `spectrum_figure` has a line for each of them.
    """
    bands = colour_bands(cube.wavelength, cube.good)
    if math.prod(cube.values.shape[1:]) <= _FEW_PIXELS:
        return {}
    if not {"green", "red"} <= set(bands):
        return {}
    image = cube.values[list(bands.values())]
    kinds = ("true_like", "false_colour") if "nir" in bands else ("true_like",)
    return {
        f"{kind}.png": composites({title: image}, list(bands), pixel_m=cube.pixel_m, kind=kind)  # type: ignore[arg-type]
        for kind in kinds
    }


@style()
def spectrum_figure(cubes: Mapping[str, Cube]) -> Figure:
    """Mean and range over the pixels of each cube against wavelength; gaps where bands are bad. Of
    few pixels each has a line.

    **Arguments:** `cubes`, by the name of the quantity.
    """
    figure = Figure(figsize=(8.6, 1.0 + 2.6 * len(cubes)))
    grid = figure.subplots(len(cubes), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (name, cube) in zip(grid, cubes.items(), strict=True):
        _draw(axes, cube)
        unit = QUANTITIES[cube.quantity][0]
        axes.set_ylabel(f"{name} [{'-' if unit == '1' else typeset(unit)}]")
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        axes.grid(True)
    rows, columns = next(iter(cubes.values())).values.shape[1:]
    spread = ", and the range of 5 to 95 % of them"
    if rows * columns <= _FEW_PIXELS:
        spread = ", and each of them (light)" if rows * columns > 1 else ""
    grid[0].set_title(f"Mean of {columns} x {rows} pixels{spread}")
    grid[-1].set_xlabel("wavelength [nm]")
    return figure


def _draw(axes: matplotlib.axes.Axes, cube: Cube) -> None:
    order = np.argsort(cube.wavelength)
    x = cube.wavelength[order]
    values = np.where(cube.good[:, None, None], cube.values, np.nan)[order]
    flat = values.reshape(len(x), -1)
    known = np.isfinite(flat).any(axis=1)
    mean, low, high = (np.full(len(x), np.nan) for _ in range(3))
    mean[known] = np.nanmean(flat[known], axis=1)
    low[known], high[known] = np.nanpercentile(flat[known], [5, 95], axis=1)
    if len(x) > _FEW:
        if flat.shape[1] <= _FEW_PIXELS:
            axes.plot(x, flat, color=SKY, lw=0.5, alpha=0.8)
        else:
            axes.fill_between(x, low, high, color=BLUE, alpha=0.25, lw=0)
        axes.plot(x, mean, color=BLUE, lw=1.3)
        return
    if flat.shape[1] <= _FEW_PIXELS:
        axes.plot(x, flat, "o", ms=2.0, color=SKY, alpha=0.8)
        axes.plot(x, mean, "o", ms=4.5, color=BLUE)
        return
    spread = np.stack([mean - low, high - mean])
    axes.errorbar(
        x, mean, yerr=spread, fmt="o", ms=4.5, color=BLUE, ecolor=GREY, elinewidth=1.2, capsize=2
    )
