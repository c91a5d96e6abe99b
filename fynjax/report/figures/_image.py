"""Figures of images and of their pixels, from plain arrays.

Every function returns a matplotlib figure that belongs to no window; `save_figure` writes it.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from fynjax.report.figures._scene import rgb, species_colours
from fynjax.report.figures._style import AFTER, BEFORE, REAL, Figure, note, panel_grid, style, words
from fynjax.scene import Observation

_COMPOSITES: dict[str, tuple[tuple[str, str, str], str]] = {
    "false_colour": (("nir", "red", "green"), "False colour: red, green, blue = NIR, red, green"),
    "true_like": (
        ("red", "green", "darker"),
        "True-like colour: blue, which the camera lacks, is 0.7 times the darker of red and green",
    ),
}
_TRUE_COLOUR = ("red", "green", "blue"), "True colour: red, green and blue are those of the sensor"

_LARGEST, _TOGETHER = 6.2, 9.2
"""Width of a picture that stands alone, and of all that stand side by side [inches]; a page is 9.4
wide."""
_NAMED = 20
"""Most species that a legend names."""
_LETTERS = 18.5
"""Letters of a caption to an inch."""


def _row(count: int) -> tuple[Figure, list[Axes], float]:
    """A figure of `count` pictures side by side, their axes, and its width [inches]."""
    side = min(_LARGEST, _TOGETHER / count)
    return *panel_grid(count, count, (side, side), (0.0, 0.55)), side * count


def _channels(
    image: ArrayLike, band_names: Sequence[str], channels: Sequence[str]
) -> NDArray[np.float64]:
    band = dict(zip(band_names, np.asarray(image, dtype=float), strict=True))
    if "darker" in channels:
        band["darker"] = 0.7 * np.minimum(band["red"], band["green"])
    return np.stack([band[name] for name in channels])


def _limits(stacks: Sequence[NDArray[np.float64]], shared: bool) -> list[tuple[float, float]]:
    """Lowest and highest reflectance shown in each channel, over all images."""
    pooled = np.concatenate([stack.reshape(3, -1) for stack in stacks], axis=1)
    if shared:  # one stretch for all channels keeps the hue
        high = float(np.nanpercentile(pooled, 99, axis=1).max())
        return [(0.0, max(high, 1e-6))] * 3
    low, top = np.nanpercentile(pooled, [1, 99], axis=1)
    return [(float(a), float(max(b, a + 1e-6))) for a, b in zip(low, top, strict=True)]


def _shown(
    stack: NDArray[np.float64], limits: Sequence[tuple[float, float]]
) -> NDArray[np.float64]:
    """Three channels between their limits as a picture [y, x, channel]; white where unknown."""
    low, high = np.array(limits).T[..., None, None]
    part = np.moveaxis((stack - low) / (high - low), 0, -1)
    # Square root, as prints and screens do: shadows stay readable.
    return np.sqrt(np.clip(np.nan_to_num(part, nan=1.0), 0.0, 1.0))


def _scale_bar(axes: Axes, width: float) -> None:
    step = 10.0 ** np.floor(np.log10(width / 5))
    length = float(max(s * step for s in (1, 2, 5) if s * step <= width / 4))
    x, y = 0.04 * width, 0.045 * width
    box = {"boxstyle": "square,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85}
    axes.text(x, y, f"{length:g} m", fontsize=8, va="bottom", bbox=box, zorder=3)
    axes.plot([x, x + length], [y * 0.62] * 2, color="white", lw=4, solid_capstyle="butt")
    axes.plot([x, x + length], [y * 0.62] * 2, color="black", lw=2, solid_capstyle="butt")


def _map(axes: Axes, values: NDArray[np.float64], pixel_m: float, title: str, **how: Any) -> Any:
    """Draw an image of the plot, north up, with a bar of its scale; what `imshow` returns."""
    height, width = (count * pixel_m for count in values.shape[:2])
    drawn = axes.imshow(
        values, origin="lower", extent=(0, width, 0, height), interpolation="nearest", **how
    )
    axes.set(title=title, xticks=[], yticks=[])
    _scale_bar(axes, width)
    return drawn


@style()
def composites(
    images: Mapping[str, ArrayLike],
    band_names: Sequence[str],
    *,
    pixel_m: float,
    kind: Literal["false_colour", "true_like"] = "false_colour",
) -> Figure:
    """Images side by side, all with one stretch, which is written below.

    **Arguments:**

    - `images`: [band, y, x] with y to the north, reflectance, by title, such as
      `{"Before": ..., "After": ...}`.
    - `band_names`: names of the bands; green, red and (for false colour) nir are needed.
    - `pixel_m`: side of a pixel [m].
    - `kind`: 'false_colour' (nir, red, green) or 'true_like', whose blue is that of the band blue,
      where there is one.
    """
    channels, what = _COMPOSITES[kind]
    if kind == "true_like" and "blue" in band_names:
        channels, what = _TRUE_COLOUR
    stacks = {title: _channels(image, band_names, channels) for title, image in images.items()}
    shared = kind == "true_like"
    limits = _limits(list(stacks.values()), shared)
    figure, grid, wide = _row(len(stacks))
    for axes, (title, stack) in zip(grid, stacks.items(), strict=True):
        _map(axes, _shown(stack, limits), pixel_m, title)
        for spine in axes.spines.values():
            spine.set_visible(False)
    ranges = (
        f"0 to {limits[0][1]:.3f} in all three (99th percentile)"
        if shared
        else "; ".join(
            f"{words(name)} {low:.3f} to {high:.3f}"
            for name, (low, high) in zip(channels, limits, strict=True)
        )
        + " (1st to 99th percentile)"
    )
    shown = f"Reflectance shown: {ranges}, square root. North up."
    lines = [textwrap.fill(line, int(_LETTERS * wide)) for line in (f"{what}.", shown)]
    note(figure, "\n".join(lines))
    return figure


def photo(
    image: Observation, kind: Literal["false_colour", "true_like"] = "true_like"
) -> Float[np.ndarray, "y x 3"]:
    """An image in colours to look at, for `matplotlib.pyplot.imshow(..., origin="lower")`.

    **Arguments:** `image`, of a camera with bands red and green, for false colour nir; `kind` as of
    `composites`.

    **Returns:** red, green and blue, 0 to 1, stretched as `composites` does.

    **Raises:** `InputError` for an image without the bands.
    """
    channels, _ = _COMPOSITES[kind]
    if kind == "true_like" and "blue" in image.bands:
        channels, _ = _TRUE_COLOUR
    for name in channels:
        image[name if name != "darker" else "red"]  # an `InputError` where there is none
    stack = _channels(image.reflectance, image.bands, channels)
    return _shown(stack, _limits([stack], kind == "true_like"))


@style()
def layer_map(layers: Mapping[str, ArrayLike], what: str, *, pixel_m: float) -> Figure:
    """One band or index of images side by side, in grey, all with one scale.

    **Arguments:**

    - `layers`: [y, x] with y to the north, by title; what is not finite is left white.
    - `what`: what is shown, with its unit.
    - `pixel_m`: side of a pixel [m].
    """
    values = {title: np.asarray(layer, float) for title, layer in layers.items()}
    known = np.concatenate([layer[np.isfinite(layer)] for layer in values.values()])
    low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
    figure, grid, _ = _row(len(values))
    for axes, (title, layer) in zip(grid, values.items(), strict=True):
        known = np.where(np.isfinite(layer), layer, np.nan)
        scale = {"cmap": "gray", "vmin": low, "vmax": max(high, low + 1e-6)}
        drawn = _map(axes, known, pixel_m, title, **scale)
    bar = figure.colorbar(
        drawn, ax=grid, location="bottom", shrink=0.9 / len(values), extend="both"
    )
    bar.set_label(f"{what}, 1st to 99th percentile. North up.", fontsize=7.5)
    return figure


@style()
def species_map(
    place: ArrayLike, share: ArrayLike, taxa: Sequence[str], forms: Sequence[str], *, pixel_m: float
) -> Figure:
    """The species that leads in each pixel, in its colour, the paler the smaller its share.

    **Arguments:**

    - `place`: [y, x] with y to the north, place of the leading species in `taxa`; -1 for none.
    - `share`: [y, x], share of the pixel that it has [-].
    - `taxa`, `forms`: names of the species and their growth forms.
    - `pixel_m`: side of a pixel [m].
    """
    place, share = np.asarray(place), np.asarray(share, float)
    colours = species_colours(forms)
    tint = np.array([rgb(colour) for colour in colours] + [np.ones(3)])
    image = 1.0 - share[..., None] * (1.0 - tint[place])
    by_pixels = np.bincount(place[place >= 0], minlength=len(taxa))
    shown = [i for i in np.argsort(-by_pixels) if by_pixels[i]][:_NAMED]
    figure = Figure(figsize=(_LARGEST + 2.6, _LARGEST + 0.4))
    title = "Leading species of each pixel, paler the less of it"
    _map(figure.subplots(), np.clip(image, 0.0, 1.0), pixel_m, title)
    handles = [
        Patch(facecolor=colours[i], label=f"{taxa[i]} ({by_pixels[i] / place.size:.0%})")
        for i in shown
    ]
    figure.legend(handles=handles, loc="outside right upper", title="leads in pixels")
    return figure


@style()
def residual_maps(residual: ArrayLike, band_names: Sequence[str], *, pixel_m: float) -> Figure:
    """How far an image is off, band by band, each with the scale of its own largest error.

    **Arguments:**

    - `residual`: [band, y, x] with y to the north, difference of reflectances; NaN is left white.
    - `band_names`: names of the bands.
    - `pixel_m`: side of a pixel [m].
    """
    residual = np.asarray(residual, float)
    figure, grid = panel_grid(len(residual), len(residual), (2.6, 3.2))
    for axes, values, name in zip(grid, residual, band_names, strict=True):
        most = max(float(np.nanpercentile(np.abs(values), 99)), 1e-9)
        scale = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
        drawn = _map(axes, values, pixel_m, words(name), **scale)
        figure.colorbar(drawn, ax=axes, location="bottom", shrink=0.9)
    return figure


@style()
def index_histograms(
    before: Mapping[str, ArrayLike],
    after: Mapping[str, ArrayLike] | None = None,
    target: Mapping[str, tuple[float, float]] | None = None,
) -> Figure:
    """Histogram of each index over the pixels, with the target's mean and spread marked.

    **Arguments:**

    - `before`, `after`: pixel values of each index, any shape; NaN is left out. `before` alone is
      an image that was not calibrated, and is called so nowhere.
    - `target`: mean and standard deviation over the pixels of the real image, by index; a NaN
      standard deviation draws the mean alone.
    """
    target = target or {}
    figure, panels = panel_grid(len(before), 4, (2.15, 1.75), (0.0, 0.45))
    for axes, name in zip(panels, before, strict=True):
        drawn = [(before[name], BEFORE, True)]
        if after is not None:
            drawn.append((after[name], AFTER, False))
        values = [np.asarray(v, dtype=float).ravel() for v, _, _ in drawn]
        values = [v[np.isfinite(v)] for v in values]
        pooled = np.concatenate(values)
        low, high = np.percentile(pooled, [0.5, 99.5]) if pooled.size else (0.0, 1.0)
        mean, sd = target.get(name, (np.nan, np.nan))
        if np.isfinite(mean):
            reach = 1.3 * sd if np.isfinite(sd) else 0.0
            low, high = min(low, mean - reach), max(high, mean + reach)
        edges = np.linspace(low, high if high > low else low + 1e-6, 81)
        for v, (_, colour, filled) in zip(values, drawn, strict=True):
            share = np.histogram(v, edges)[0] / max(v.size, 1) / np.diff(edges)
            axes.stairs(
                share, edges, color=colour, fill=filled, alpha=0.55 if filled else 1, lw=1.3
            )
        if np.isfinite(mean):
            if np.isfinite(sd):
                axes.axvspan(mean - sd, mean + sd, color=REAL, alpha=0.1, lw=0)
            axes.axvline(mean, color=REAL, lw=1.2, ls=(0, (4, 2)))
        axes.set(title=name, yticks=[], xlim=(edges[0], edges[-1]))
        axes.locator_params(axis="x", nbins=4)
        axes.spines["left"].set_visible(False)
    name = "simulated" if after is None else "before"
    handles: list[Artist] = [Patch(color=BEFORE, alpha=0.55, label=name)]
    if after is not None:
        handles.append(Line2D([], [], color=AFTER, label="after"))
    if target:
        handles.append(
            Line2D([], [], color=REAL, ls=(0, (4, 2)), label="real image: mean (grey: ±1 sd)")
        )
    if len(handles) > 1:
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
    figure.supxlabel("Index value [-]; height is the density of pixels", fontsize=8.5)
    return figure
