"""Pictures of a scene: from above, obliquely, and its height profile. All axes in metres."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fynjax.report.figures._style import style
from fynjax.scene import Instances, crown_centres, projected_cover

_PALETTE = (
    "#1B7837", "#E69F00", "#CC79A7", "#0072B2", "#A6D96A", "#D55E00", "#56B4E9",
    "#F0E442", "#7B3294", "#01665E", "#F4A6A0", "#8C510A", "#B2ABD2", "#80CDC1",
)  # fmt: skip
_DEAD = "#8A8378"
_GROUND = "#E6DAC2"
_LIGHT = np.array([-0.50, 0.50, 0.71])  # from the north-west, as maps have it
_PIXELS = 1300


def species_colours(forms: Sequence[str]) -> list[str]:
    """A colour for each species: deadwood is grey, the others as different as possible.

    **Arguments:** `forms`, growth form of each species.
    """
    living = iter(range(len(forms)))
    return [
        _DEAD if form == "deadwood" else _PALETTE[next(living) % len(_PALETTE)] for form in forms
    ]


def rgb(colour: str) -> Float[np.ndarray, "3"]:
    """Red, green and blue of a `colour` '#RRGGBB', 0 to 1."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def plan_view(
    instances: Instances, forms: Sequence[str], *, periodic: bool, title: str = ""
) -> Figure:
    """The crowns from straight above, the tallest on top, each species in its colour.

    **Arguments:** `instances`, the plants; `forms`, growth form of each species; `periodic`,
    whether the plot repeats itself beyond its edges; `title` of the figure.

    The legend gives the plants of each species and the share of the ground over which it is the
    tallest.
    """
    lx, ly = instances.extent
    cell = _cell(instances.extent, _PIXELS)
    cover = projected_cover(instances, cell=cell, periodic=periodic)
    colours = species_colours(forms)
    with style():
        figure = Figure(figsize=(9.8, 6.6 * min(max(ly / lx, 0.4), 1.6) + 0.3))
        axes = figure.subplots()
        axes.imshow(
            _domes(cover.top, instances, colours, cell, periodic),
            origin="lower",
            extent=(0, lx, 0, ly),
            interpolation="antialiased",
        )
        axes.set(xlabel="East [m]", ylabel="North [m]", title=title, aspect="equal")
        _north(axes)
        _legend(figure, instances, colours, cover.visible, cover.total)
    return figure


def _cell(extent: tuple[float, float], pixels: int) -> float:
    """Side of a square cell that divides both sides, about `pixels` of them along the longer."""
    lx, ly = extent
    for count in range(pixels, 2 * pixels):
        cell = max(lx, ly) / count
        if abs(min(lx, ly) / cell - round(min(lx, ly) / cell)) < 1e-7 * count:
            return cell
    return 0.01


def _domes(
    top: np.ndarray, instances: Instances, colours: Sequence[str], cell: float, periodic: bool
) -> np.ndarray:
    """Crowns as domes in the sun, over bare ground: [y, x, 3]."""
    ny, nx = top.shape
    image = np.broadcast_to(rgb(_GROUND), (ny, nx, 3)).copy()
    row, column = np.nonzero(top >= 0)
    plant = top[row, column]
    x, y = crown_centres(instances)
    radius = instances.diameter[plant] / 2.0
    offset = []
    for place, centre, count in ((column, x, nx), (row, y, ny)):
        away = (place + 0.5) * cell - centre[plant]
        if periodic:
            away -= count * cell * np.round(away / (count * cell))
        offset.append(away / radius)
    east, north = offset
    distance = np.minimum(east**2 + north**2, 1.0)
    normal = np.stack([0.9 * east, 0.9 * north, np.ones_like(east)], axis=-1)
    facing = normal @ _LIGHT / np.linalg.norm(normal, axis=-1)
    light = (0.50 + 0.66 * np.clip(facing, 0.0, 1.0)) * (1.0 - 0.30 * distance**6)
    # Plants of one species that touch stay apart for the eye.
    shade = 0.92 + 0.16 * np.random.default_rng(0).random(len(instances))
    colour = np.array([rgb(c) for c in colours])[instances.species[plant]]
    image[row, column] = np.clip(colour * (light * shade[plant])[:, None], 0.0, 1.0)
    return image


def _north(axes: Axes) -> None:
    axes.annotate(
        "N", (0.965, 0.97), (0.965, 0.885), xycoords="axes fraction", ha="center", va="center",
        fontsize=9, fontweight="bold",
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85},
        arrowprops={"arrowstyle": "-|>", "lw": 1.4, "color": "black"},
    )  # fmt: skip


def _legend(
    figure: Figure,
    instances: Instances,
    colours: Sequence[str],
    visible: np.ndarray | None = None,
    total: float | None = None,
) -> None:
    handles = []
    for index, (taxon, count) in enumerate(zip(instances.taxa, instances.counts)):
        text = f"{taxon}\n{count} plants" if count != 1 else f"{taxon}\n1 plant"
        if visible is not None:
            text += f", {100 * visible[index]:.1f} % of the ground"
        handles.append(Patch(facecolor=colours[index], edgecolor="none", label=text))
    if total is not None:
        bare = f"bare ground\n{100 * (1 - total):.1f} %"
        handles.append(Patch(facecolor=_GROUND, edgecolor="#B8AD95", lw=0.5, label=bare))
    figure.legend(
        handles=handles, loc="outside right center", fontsize=7.5, labelspacing=0.75,
        handlelength=1.2, handleheight=1.6,
    )  # fmt: skip


def profile_view(
    profile: Float[np.ndarray, "organ species layer"],
    edges: Float[np.ndarray, " edge"],
    instances: Instances,
    forms: Sequence[str],
) -> Figure:
    """Area density of leaves and of wood against height, the species side by side.

    **Arguments:** `profile` and `edges` [m], those of `height_profile`; `instances`, the plants;
    `forms`, growth form of each species.
    """
    colours = species_colours(forms)
    with style():
        figure = Figure(figsize=(9.4, 4.8))
        panels = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
        for axes, part, name in zip(panels, profile, ("Leaf", "Wood"), strict=True):
            start = np.zeros(part.shape[1])
            for species, values in enumerate(part):
                # Steps: within a layer the density is its mean.
                axes.stairs(
                    start + values, edges, baseline=start, orientation="horizontal", fill=True,
                    color=colours[species], lw=0,
                )  # fmt: skip
                start = start + values
            axes.stairs(start, edges, orientation="horizontal", color="#333333", lw=0.8)
            index = float((part * np.diff(edges)).sum())
            axes.set_title(f"{name}: {index:.2f} m² per m² of ground")
            axes.set_xlabel(f"{name} area density [m² m⁻³]")
            axes.set_xlim(0, None)
            axes.grid(axis="x")
        panels[0].set_ylabel("Height above ground [m]")
        panels[0].set_ylim(0, edges[-1])
        _legend(figure, instances, colours)
    return figure
