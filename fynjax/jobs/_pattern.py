"""From an image to a probability map of where plants stand: what `fynjax pattern` does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.canopy import (
    Greenness,
    VegetationPattern,
    band_roles,
    choose_greenness,
    vegetation_pattern,
)
from fynjax.io._band_stack import BandStack, read_band_stack
from fynjax.io._probability import write_probability_map
from fynjax.report._figure_style import REAL, save_figure, style, words

_MASKED = "#B7D3EA"
_LARGEST = 1200
"""Pixels of a picture's longer side; larger images are thinned for it."""


def run_pattern(
    paths: Sequence[str | Path],
    output: str | Path,
    *,
    clusters: int = 3,
    bands: Sequence[str] | None = None,
    greenness: str = "auto",
    greenness_weight: float = 1.0,
    levels: Sequence[int] | None = None,
    pixel: float | None = None,
    align: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write `map.tif` and `pattern.png` of an image into the folder `output`.

    **Arguments:** `paths`, `bands`, `pixel` and `align` as `read_band_stack` has them; `greenness`
    is the index of `choose_greenness`; `clusters`, `greenness_weight`, `levels` and `seed` as
    `vegetation_pattern` has them.

    **Returns:** the summary: headline, files, the map's frame, the clusters.

    **Raises:** what these functions raise.
    """
    progress = NullProgress() if progress is None else progress
    output = Path(output)
    with progress.stage("Read the image"):
        stack = read_band_stack(paths, bands=bands, pixel_m=pixel, align=align, progress=progress)
    try:
        green = choose_greenness(stack.names, stack.wavelengths, index=greenness)
        with progress.stage("Cluster the pixels"):
            pattern = vegetation_pattern(
                stack.values,
                green,
                mask=stack.mask,
                clusters=clusters,
                levels=levels,
                greenness_weight=greenness_weight,
                seed=seed,
            )
    except InputError as error:
        raise InputError(str(error), file=paths[0]) from error
    masked = int((~stack.mask).sum())
    with progress.stage("Write"):
        write_probability_map(
            output / "map.tif",
            pattern.grey,
            stack.transform,
            crs=stack.crs,
            nodata=pattern.nodata if masked else None,
            tags={
                "quantity": "chance of a plant to stand here, 255 is 1",
                "clusters": clusters,
                "greenness": green.formula,
                "greenness_weight": greenness_weight,
                "levels": list(pattern.levels),
                "seed": seed,
            },
        )
        save_figure(pattern_figure(stack, pattern, green), output / "pattern.png")
    return _summary(stack, pattern, green, greenness_weight, masked)


def _summary(
    stack: BandStack, pattern: VegetationPattern, green: Greenness, weight: float, masked: int
) -> dict[str, Any]:
    rows, columns = stack.mask.shape
    t = stack.transform
    told = "; ".join(
        f"{100 * share:.0f} % at {level} ({green.name} {value:.3g})"
        for share, level, value in zip(
            pattern.share, pattern.levels, pattern.greenness, strict=True
        )
    )
    headline = [
        f"{columns * t.a:g} m x {rows * -t.e:g} m in pixels of {t.a:g} m, "
        f"{len(stack.names)} bands: {stack.known_as}.",
        f"Clusters by {green.name} = {green.formula}: {told}.",
    ]
    if masked:
        headline.append(
            f"{masked} of {stack.mask.size} pixels have no data; a plot must not reach them."
        )
    alignment = None
    if stack.alignment is not None:
        worst = max(band.residual for band in stack.alignment)
        headline.append(
            f"Bands aligned on the first; tiles still miss it by {worst:.1f} pixels at most, in "
            "the median of a band."
        )
        alignment = [
            {"shift_px": band.shift, "residual_px": band.residual, "match": band.match}
            for band in stack.alignment
        ]
    west, north = t.c, t.f
    return {
        "headline": headline,
        "files": {
            "map.tif": "probability map, 0 to 255, for `probability_map` of a plot file",
            "pattern.png": "the image, the map and the clusters' spectra",
        },
        "map": {
            "bounds_m": [west, north + rows * t.e, west + columns * t.a, north],
            "pixel_m": [t.a, -t.e],
            "crs": stack.crs,
            "masked_pixels": masked,
            "nodata": pattern.nodata if masked else None,
        },
        "bands": [
            {"name": name, "wavelength_nm": wave}
            for name, wave in zip(stack.names, stack.wavelengths, strict=True)
        ],
        "greenness": {"name": green.name, "formula": green.formula, "weight": weight},
        "clusters": [
            {
                "level": level,
                "share": pattern.share[k],
                "greenness": pattern.greenness[k],
                "mean_spectrum": pattern.spectrum[k],
                "standard_deviation": pattern.spread[k],
            }
            for k, level in enumerate(pattern.levels)
        ],
        "inertia": pattern.inertia,
        "alignment": alignment,
    }


# -- the picture ----------------------------------------------------------------------------


def pattern_figure(stack: BandStack, pattern: VegetationPattern, green: Greenness) -> Figure:
    """The image beside the map, and below them each cluster's spectrum and greenness."""
    t = stack.transform
    rows, columns = stack.mask.shape
    step = max(1, -(-max(rows, columns) // _LARGEST))
    extent = (0.0, columns * t.a, 0.0, rows * -t.e)
    show: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
    count = len(pattern.levels)
    # Brown to green, without the pale middle.
    brown = np.linspace(0.1, 0.32, count - count // 2)
    colours = matplotlib.colormaps["BrBG"](np.append(brown, np.linspace(0.72, 0.95, count // 2)))
    with style():
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
            matplotlib.patches.Patch(color=colour, label=label)
            for colour, label in zip(colours, labels, strict=True)
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


def _draw_spectra(
    axes: Any, stack: BandStack, pattern: VegetationPattern, colours: NDArray[np.float64]
) -> None:
    waves = stack.wavelengths
    known = all(wave is not None for wave in waves)
    at = np.array(waves, float) if known else np.arange(1.0, len(waves) + 1.0)
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
        axes.set_xticks(at, stack.names)
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
