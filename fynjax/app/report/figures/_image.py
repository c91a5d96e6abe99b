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
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from fynjax.app.report.figures._scene import rgb, species_colours
from fynjax.app.report.figures._style import (
    AFTER,
    BEFORE,
    GREY,
    GROUND,
    REAL,
    Figure,
    panel_grid,
    small_print,
    style,
    words,
)
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
    """Lowest and highest reflectance shown in each channel, over all of some images."""
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


class _Ground:
    """One scale of length for images side by side, of whatever pixels and sizes: each is drawn in
    the middle of a ground as large as the largest."""

    def __init__(
        self, images: Mapping[str, NDArray[np.float64]], pixel_m: float | Mapping[str, float]
    ):
        self._size = {}
        for title, image in images.items():
            pixel = pixel_m[title] if isinstance(pixel_m, Mapping) else pixel_m
            self._size[title] = np.array(image.shape[-2:][::-1]) * pixel
        self._whole = np.max(list(self._size.values()), axis=0)

    def draw(
        self, axes: Axes, values: NDArray[np.float64], title: str, label: str = "", **how: Any
    ) -> Any:
        """Draw the image `title`, whose `values` are [y, x] or [y, x, channel], north up, with a
        bar of its scale and a `label`, by default the title; what `imshow` returns."""
        (x, y), (wide, high) = (self._whole - self._size[title]) / 2.0, self._size[title]
        extent = (float(x), float(x + wide), float(y), float(y + high))
        drawn = axes.imshow(values, origin="lower", extent=extent, interpolation="nearest", **how)
        axes.set(title=label or title, xticks=[], yticks=[], gid=GROUND)
        axes.set(xlim=(0.0, self._whole[0]), ylim=(0.0, self._whole[1]))
        for spine in axes.spines.values():
            spine.set(visible=True, color="#BBBBBB", linewidth=0.5)
        _scale_bar(axes, float(self._whole[0]))
        return drawn


def _stretched(images: Mapping[str, Any], stretch: str | None) -> tuple[list[Any], str]:
    """Of which of the images the stretch of all is, and words for that."""
    if stretch is None:
        return list(images.values()), ""
    return [images[stretch]], f" of “{stretch}”"


@style()
def composites(
    images: Mapping[str, ArrayLike],
    band_names: Sequence[str],
    *,
    pixel_m: float | Mapping[str, float],
    kind: Literal["false_colour", "true_like"] = "false_colour",
    stretch: str | None = None,
) -> Figure:
    """Images side by side, all with one stretch, which is written below, and one scale of length.

    **Arguments:**

    - `images`: [band, y, x] with y to the north, reflectance, by title, such as
      `{"Before": ..., "After": ...}`.
    - `band_names`: names of the bands; green, red and (for false colour) nir are needed.
    - `pixel_m`: side of a pixel, or that of each image by title [m].
    - `kind`: 'false_colour' (nir, red, green) or 'true_like', whose blue is that of the band blue,
      where there is one.
    - `stretch`: title of the image that the stretch is taken from, so that others look as dark or
      as bright beside it as they are; by default it is of all images together.
    """
    channels, what = _COMPOSITES[kind]
    if kind == "true_like" and "blue" in band_names:
        channels, what = _TRUE_COLOUR
    stacks = {title: _channels(image, band_names, channels) for title, image in images.items()}
    shared = kind == "true_like"
    stretched, of = _stretched(stacks, stretch)
    limits = _limits(stretched, shared)
    figure, grid, wide = _row(len(stacks))
    ground = _Ground(stacks, pixel_m)
    for axes, (title, stack) in zip(grid, stacks.items(), strict=True):
        ground.draw(axes, _shown(stack, limits), title)
    ranges = (
        f"0 to {limits[0][1]:.3f} in all three (99th percentile{of})"
        if shared
        else "; ".join(
            f"{words(name)} {low:.3f} to {high:.3f}"
            for name, (low, high) in zip(channels, limits, strict=True)
        )
        + f" (1st to 99th percentile{of})"
    )
    shown = f"Reflectance shown: {ranges}, square root. North up."
    lines = [textwrap.fill(line, int(_LETTERS * wide)) for line in (f"{what}.", shown)]
    small_print(figure, "\n".join(lines))
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
def layer_map(
    layers: Mapping[str, ArrayLike],
    what: str,
    *,
    pixel_m: float | Mapping[str, float],
    stretch: str | None = None,
) -> Figure:
    """One band or index of images side by side, in grey, all with one scale.

    **Arguments:**

    - `layers`: [y, x] with y to the north, by title; what is not finite is left white.
    - `what`: what is shown, with its unit.
    - `pixel_m`, `stretch`: as of `composites`.
    """
    values = {title: np.asarray(layer, float) for title, layer in layers.items()}
    stretched, of = _stretched(values, stretch)
    known = np.concatenate([layer[np.isfinite(layer)] for layer in stretched])
    low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
    figure, grid, _ = _row(len(values))
    ground = _Ground(values, pixel_m)
    for axes, (title, layer) in zip(grid, values.items(), strict=True):
        known = np.where(np.isfinite(layer), layer, np.nan)
        top = max(high, low + 1e-6)
        drawn = ground.draw(axes, known, title, cmap="gray", vmin=low, vmax=top)
    bar = figure.colorbar(
        drawn, ax=grid, location="bottom", shrink=0.9 / len(values), extend="both"
    )
    bar.set_label(f"{what}, 1st to 99th percentile{of}. North up.", fontsize=7.5)
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
    ground = _Ground({title: share}, pixel_m)
    ground.draw(figure.subplots(), np.clip(image, 0.0, 1.0), title)
    handles = [
        Patch(facecolor=colours[i], label=f"{taxa[i]} ({by_pixels[i] / place.size:.0%})")
        for i in shown
    ]
    figure.legend(handles=handles, loc="outside right upper", title="leads in pixels")
    return figure


@style()
def residual_maps(
    residuals: Mapping[str, ArrayLike], band_names: Sequence[str], *, pixel_m: float
) -> Figure:
    """How far images are off, a row for each, band by band; in a band all with one scale.

    **Arguments:**

    - `residuals`: [band, y, x] with y to the north, differences of reflectances, by title; NaN is
      left white.
    - `band_names`: names of the bands.
    - `pixel_m`: side of a pixel [m].
    """
    values = {title: np.asarray(each, float) for title, each in residuals.items()}
    count = len(band_names)
    rows, side = len(values), min(2.6, _TOGETHER / count)
    figure = Figure(figsize=(side * count, (side + 0.2) * rows + 0.7))
    grid = figure.subplots(rows, count, squeeze=False)
    ground = _Ground(values, pixel_m)
    for k, name in enumerate(band_names):
        bands = {title: each[k] for title, each in values.items()}
        pooled = np.concatenate([np.abs(each[np.isfinite(each)]) for each in bands.values()])
        most = max(float(np.percentile(pooled, 99)) if pooled.size else 0.0, 1e-9)
        scale = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
        for axes, (title, layer) in zip(grid[:, k], bands.items(), strict=True):
            drawn = ground.draw(axes, layer, title, f"{title}, {words(name)}", **scale)
        bar = figure.colorbar(
            drawn, ax=list(grid[:, k]), location="bottom", shrink=0.9, extend="both"
        )
        bar.locator = MaxNLocator(4)
        bar.update_ticks()
    small_print(figure, "Reflectance, simulated less measured [-]. North up.")
    return figure


_SHOWN_BY = {"real": (REAL, False), "before": (BEFORE, True), "after": (AFTER, False)}
"""Colour of the histogram of an image, and whether it is filled."""


@style()
def pixel_histograms(
    layers: Mapping[str, Mapping[str, ArrayLike]],
    target: Mapping[str, tuple[float, float]] | None = None,
    *,
    what: str = "Index value [-]",
) -> Figure:
    """Histograms of bands or indices over the pixels of images, with means and spreads marked.

    **Arguments:**

    - `layers`: pixel values of each layer by the name of an image and of the layer, any shape; NaN
      is left out. The images are "real", "before" and "after", those of them that there are; one
      that was not calibrated has any other name.
    - `target`: mean and standard deviation over the pixels of the real image, by layer; a NaN
      standard deviation draws the mean alone.
    - `what`: what the layers are, with their unit.
    """
    target = target or {}
    names = list(dict.fromkeys(name for image in layers.values() for name in image))
    figure, panels = panel_grid(len(names), 4, (2.15, 1.75), (0.0, 0.45))
    for axes, name in zip(panels, names, strict=True):
        drawn = {
            title: np.asarray(image[name], dtype=float).ravel()
            for title, image in layers.items()
            if name in image
        }
        drawn = {title: v[np.isfinite(v)] for title, v in drawn.items()}
        ends = [np.percentile(v, [0.5, 99.5]) for v in drawn.values() if v.size]
        low = min((float(end[0]) for end in ends), default=0.0)
        high = max((float(end[1]) for end in ends), default=1.0)
        mean, sd = target.get(name, (np.nan, np.nan))
        if np.isfinite(mean):
            reach = 1.3 * sd if np.isfinite(sd) else 0.0
            low, high = min(low, mean - reach), max(high, mean + reach)
        edges = np.linspace(low, high if high > low else low + 1e-6, 81)
        for title, v in drawn.items():
            colour, filled = _SHOWN_BY.get(title, (BEFORE, True))
            share = np.histogram(v, edges)[0] / max(v.size, 1) / np.diff(edges)
            axes.stairs(
                share, edges, color=colour, fill=filled, alpha=0.55 if filled else 1, lw=1.3
            )
            if v.size and not (title == "real" and np.isfinite(mean)):
                axes.axvline(v.mean(), color=colour, lw=1.0, ls=(0, (1, 1)))
        if np.isfinite(mean):
            if np.isfinite(sd):
                axes.axvspan(mean - sd, mean + sd, color=REAL, alpha=0.1, lw=0)
            axes.axvline(mean, color=REAL, lw=1.2, ls=(0, (4, 2)))
        axes.set(title=words(name), yticks=[], xlim=(edges[0], edges[-1]))
        axes.locator_params(axis="x", nbins=4)
        axes.spines["left"].set_visible(False)
    handles: list[Artist] = []
    for title in layers:
        colour, filled = _SHOWN_BY.get(title, (BEFORE, True))
        if filled:
            handles.append(Patch(color=colour, alpha=0.55, label=title))
        else:
            handles.append(Line2D([], [], color=colour, label=title))
    if len(layers) > 1:
        handles.append(
            Line2D([], [], color=GREY, lw=1.0, ls=(0, (1, 1)), label="mean of a simulation")
        )
    if target:
        label = "real mean (grey: ±1 sd)" if "real" in layers else "real image: mean (grey: ±1 sd)"
        handles.append(Line2D([], [], color=REAL, ls=(0, (4, 2)), label=label))
    if len(handles) > 1:
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
    figure.supxlabel(f"{what}; height is the density of pixels", fontsize=8.5)
    return figure
