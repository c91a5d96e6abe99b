"""Pictures of a scene: from above, obliquely, and its height profile. All axes in metres."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fynjax.canopy import Organ, plant_model, unit_shapes
from fynjax.report.figures._style import style
from fynjax.scene import Instances, projected_cover

_PALETTE = (
    "#1B7837", "#E69F00", "#CC79A7", "#0072B2", "#A6D96A", "#D55E00", "#56B4E9",
    "#F0E442", "#7B3294", "#01665E", "#F4A6A0", "#8C510A", "#B2ABD2", "#80CDC1",
)  # fmt: skip
_DEAD = "#8A8378"
_GROUND = "#E6DAC2"
BARK = "#5B4636"
SUN = np.array([-0.45, 0.35, 0.82])
_PIXELS = 1300
_MOST_POINTS = 4_000_000
_INDIVIDUALS = 8
"""Shapes among the plants of a species, as a scene has them."""


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
    """The plants from straight above as clouds of their area elements, each species in its colour.

    **Arguments:** `instances`, the plants; `forms`, growth form of each species; `periodic`,
    whether the plot repeats itself beyond its edges; `title` of the figure.

    The legend gives the plants of each species and the share of the ground over which its crown,
    taken for a disc, is the tallest.
    """
    lx, ly = instances.extent
    cell = _cell(instances.extent, _PIXELS)
    cover = projected_cover(instances, cell=cell, periodic=periodic)
    colours = species_colours(forms)
    with style():
        figure = Figure(figsize=(9.8, 6.6 * min(max(ly / lx, 0.4), 1.6) + 0.3))
        axes = figure.subplots()
        axes.imshow(
            _from_above(instances, forms, colours, cell, periodic),
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


def _from_above(
    instances: Instances, forms: Sequence[str], colours: Sequence[str], cell: float, periodic: bool
) -> np.ndarray:
    """Area elements of the plants over bare ground, the highest on top: [y, x, 3]."""
    lx, ly = instances.extent
    nx, ny = round(lx / cell), round(ly / cell)
    image = np.broadcast_to(rgb(_GROUND), (ny, nx, 3)).copy()
    if len(instances):
        place, tint, width = element_points(instances, forms, colours, 1.0 / cell)
        flat = place[:, :2] / cell
        paint_points(image, flat % [nx, ny] if periodic else flat, -place[:, 2], width / cell, tint)
    return np.clip(image, 0.0, 1.0)


def element_points(
    instances: Instances, forms: Sequence[str], colours: Sequence[str], metre: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of all plants [m], their colours, and how wide each is drawn [m].

    `metre` is the pixels of a metre in the picture. Plants are individuals of their forms.
    """
    rng = np.random.default_rng(0)
    # As many points as hide what is behind them at two pixels each, if that is not too many.
    wanted = np.clip(instances.diameter * instances.height * (metre / 2.0) ** 2, 10, 9000)
    fewer = min(1.0, _MOST_POINTS / wanted.sum())
    places, tints, widths = [], [], []
    for species, form in enumerate(forms):
        plants = np.flatnonzero(instances.species == species)
        if len(plants) == 0:
            continue
        number = max(8, int(fewer * wanted[plants].mean()))
        for individual in range(min(len(plants), _INDIVIDUALS)):
            mine = plants[individual::_INDIVIDUALS]
            shape = plant_model(form, number, seed=_INDIVIDUALS * species + individual)
            position = np.asarray(shape.position, np.float32)
            per_diameter, per_height = unit_shapes(
                position, instances.azimuth[mine], instances.tilt[mine]
            )
            diameter, height = instances.diameter[mine], instances.height[mine]
            place = diameter[:, None, None] * per_diameter + height[:, None, None] * per_height
            foot = np.stack([instances.x[mine], instances.y[mine], instances.z[mine]], axis=-1)
            place = place + foot[:, None]
            organ = np.asarray(shape.organ)
            base = np.where((organ == Organ.WOOD)[:, None], rgb(BARK), rgb(colours[species]))
            if form == "deadwood":
                base = np.broadcast_to(rgb(colours[species]), base.shape)
            facing = np.abs(np.asarray(shape.normal) @ SUN)
            # Light fades into the crown: darker low down and near the axis.
            inner = np.clip(2.0 * np.hypot(position[:, 0], position[:, 1]), 0.0, 1.0)
            light = (0.34 + 0.5 * position[:, 2] + 0.16 * inner) * (0.72 + 0.4 * facing)
            shade = 0.90 + 0.2 * rng.random((len(mine), 1, 1))
            places.append(place.reshape(-1, 3).astype(np.float32))
            tints.append((shade * (light[:, None] * base)).reshape(-1, 3).astype(np.float32))
            gap = np.sqrt(diameter * height / number)
            widths.append(np.repeat(0.8 * gap, number).astype(np.float32))
    return np.concatenate(places), np.concatenate(tints), np.concatenate(widths)


def paint_points(
    image: np.ndarray, flat: np.ndarray, depth: np.ndarray, width: np.ndarray, tint: np.ndarray
) -> None:
    """Paint points of colours `tint` at columns and rows `flat` into `image`, the farthest first,
    each a square `width` pixels wide."""
    side = np.clip(np.round(width), 1, 5).astype(np.int32)
    order = np.argsort(-depth, kind="stable")
    flat, side, tint = flat[order], side[order], tint[order]
    rows, columns = image.shape[:2]
    corner = np.floor(flat - 0.5 * (side[:, None] - 1)).astype(np.int64)
    owner, pixel = [], []
    # All squares of a size at once would mix the order: number the points, sort once more.
    for size in np.unique(side):
        mine = np.flatnonzero(side == size)
        step = np.arange(size)
        down, across = (part.ravel() for part in np.meshgrid(step, step, indexing="ij"))
        row, column = corner[mine, 1][:, None] + down, corner[mine, 0][:, None] + across
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        owner.append(np.broadcast_to(mine[:, None], row.shape)[inside])
        pixel.append((row * columns + column)[inside])
    who, where = np.concatenate(owner), np.concatenate(pixel)
    nearest = np.full(rows * columns, -1, np.int64)
    np.maximum.at(nearest, where, who)
    drawn = nearest >= 0
    image.reshape(-1, 3)[drawn] = tint[nearest[drawn]]


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
