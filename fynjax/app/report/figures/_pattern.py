"""The picture of a probability map: what it was made from, its clusters, their greenness."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fynjax.app.io.raster import BandStack
from fynjax.app.report.figures._style import REAL, Figure, style, words
from fynjax.canopy import Greenness, VegetationPattern, band_roles

_MASKED = "#B7D3EA"
_LARGEST = 1200
"""Pixels of a picture's longer side; larger images are thinned for it."""


@style()
def pattern_figure(stack: BandStack, pattern: VegetationPattern, green: Greenness) -> Figure:
    """The image beside the map, and below them each cluster's spectrum and greenness.

    **Arguments:** `stack`, the bands of the image; `pattern`, the clusters; `green`, the index
    that orders them.
    """
    t = stack.transform
    rows, columns = stack.mask.shape
    step = max(1, -(-max(rows, columns) // _LARGEST))
    extent = (0.0, columns * t.a, 0.0, rows * -t.e)
    show: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
    count = len(pattern.levels)
    # Brown to green, without the pale middle.
    brown = np.linspace(0.1, 0.32, count - count // 2)
    colours = matplotlib.colormaps["BrBG"](np.append(brown, np.linspace(0.72, 0.95, count // 2)))
    figure = Figure(figsize=(9.0, 4.2 + 3.4 * min(1.6, max(0.4, extent[3] / extent[1]))))
    grid: Any = figure.subplots(2, 2, height_ratios=(max(1.0, 1.6 * extent[3] / extent[1]), 1))
    picture, title = _picture(stack, step)
    grid[0, 0].imshow(picture, **show)
    grid[0, 0].set_title(title)
    grey = np.ma.masked_array(pattern.grey, ~stack.mask)[::step, ::step]
    shown = grid[0, 1].imshow(grey, cmap="gray", vmin=0, vmax=255, **show)
    grid[0, 1].set_facecolor(_MASKED)
    masked = "" if stack.mask.all() else " (blue: no data)"
    grid[0, 1].set_title(f"Probability map{masked}")
    figure.colorbar(
        shown, ax=grid[0, 1], ticks=sorted({0, *pattern.levels, 255}), label="Grey, 255 is 1"
    )
    for axes in grid[0]:
        axes.set(xlabel="East [m]", ylabel="North [m]")
    _draw_spectra(grid[1, 0], stack, pattern, colours)
    _draw_greenness(grid[1, 1], stack, pattern, green, colours)
    labels = [
        f"{level}: {100 * share:.0f} % of the pixels"
        for level, share in zip(pattern.levels, pattern.share, strict=True)
    ]
    handles = [
        Patch(color=colour, label=label) for colour, label in zip(colours, labels, strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(count, 4))
    return figure


def _picture(stack: BandStack, step: int) -> tuple[NDArray[np.float64], str]:
    """The image in colours [y, x, 3], masked pixels blue, and what it shows."""
    role = band_roles(stack.names, stack.wavelengths)
    for wanted in (("nir", "red", "green"), ("red", "green", "blue")):
        if set(wanted) <= set(role):
            chosen, names = [role[name] for name in wanted], list(wanted)
            break
    else:
        last = len(stack.names) - 1
        chosen = [last, last // 2, 0]
        names = [stack.names[k] for k in chosen]
    data = stack.mask[::step, ::step]
    channels = []
    for k in chosen:
        band = np.asarray(stack.values[k, ::step, ::step], float)
        low, high = np.percentile(band[data], [1, 99]) if data.any() else (0.0, 1.0)
        channels.append(np.clip((band - low) / (high - low if high > low else 1.0), 0.0, 1.0))
    rgb = np.sqrt(np.stack(channels, axis=-1))  # shadows stay readable
    rgb[~data] = matplotlib.colors.to_rgb(_MASKED)
    if len(set(chosen)) == 1:
        return rgb, f"Image: {names[0]}"
    return rgb, f"Image: {', '.join(map(words, names))} as red, green, blue"


_COLOURS = ("blue", "green", "red", "red_edge", "nir")
"""Bands by wavelength."""


def _draw_spectra(
    axes: Axes, stack: BandStack, pattern: VegetationPattern, colours: NDArray[np.float64]
) -> None:
    waves = stack.wavelengths
    known = all(wave is not None for wave in waves)
    names = [name for name in _COLOURS if name in stack.names]
    if len(names) < len(waves):  # bands of other names come as in the file
        names = list(stack.names)
    at = np.array(waves, float) if known else np.array([names.index(n) + 1.0 for n in stack.names])
    order = np.argsort(at)
    marker = "o" if len(at) < 30 else ""
    for mean, spread, colour in zip(pattern.spectrum, pattern.spread, colours, strict=True):
        axes.fill_between(
            at[order], (mean - spread)[order], (mean + spread)[order], color=colour, alpha=0.2, lw=0
        )
        axes.plot(at[order], mean[order], color=colour, marker=marker, ms=4, lw=1.6)
    axes.set(title="Mean of each cluster, and one standard deviation", ylabel="Image's own unit")
    axes.set_xlabel("Wavelength [nm]" if known else "Band")
    if not known and len(at) < 12:
        axes.set_xticks(at, [words(name) for name in stack.names])
    axes.grid(axis="y")


def _draw_greenness(
    axes: Any,
    stack: BandStack,
    pattern: VegetationPattern,
    green: Greenness,
    colours: NDArray[np.float64],
) -> None:
    used = stack.mask
    step = max(1, int(used.sum()) // 500_000)
    value = green.function(np.asarray(stack.values[:, used][:, ::step], float).T)
    cluster = pattern.cluster[used][::step]
    defined = np.isfinite(value)
    low, high = np.percentile(value[defined], [0.2, 99.8])
    edges = np.linspace(low, high if high > low else low + 1e-6, 81)
    axes.hist(
        [value[defined & (cluster == k)] for k in range(len(colours))],
        edges,
        stacked=True,
        color=list(colours),
    )
    for mean in pattern.greenness:
        axes.axvline(mean, color=REAL, lw=1.0, ls=(0, (4, 2)))
    axes.set(
        title=f"{green.name} of the pixels; dashed: of each cluster's mean",
        xlabel=f"{green.name} [-]" if green.name != green.formula else green.name,
        yticks=[],
        ylabel="Pixels",
    )
