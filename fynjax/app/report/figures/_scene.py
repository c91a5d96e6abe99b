"""Pictures of a scene: from above, obliquely, and its height profile. All axes in metres."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from fynjax.app.report.figures._style import Figure, style
from fynjax.canopy import FORMS, Organ, PlantModel, plant_model, unit_shapes
from fynjax.scene import Instances, individual_seeds, projected_cover

_PALETTE = (
    "#1B7837", "#E69F00", "#CC79A7", "#0072B2", "#A6D96A", "#D55E00", "#56B4E9",
    "#F0E442", "#7B3294", "#01665E", "#F4A6A0", "#8C510A", "#B2ABD2", "#80CDC1",
)  # fmt: skip
_DEAD = "#8A8378"
GROUND = "#E6DAC2"
BARK = "#5B4636"
SUN = np.array([-0.45, 0.35, 0.82])
_STRAW = "#B59A6A"
_FADED = 0.5
"""How far the colour of dead tissue is from the species' to that of straw."""
_PIXELS = 1300
_MOST_POINTS = 4_000_000
_MOST_OF_A_PLANT, _FEWEST_POINTS = 9000, 8
_FAINTEST = 0.25
"""Least share of a pixel that a point of wood fills, for stems thinner than a pixel to show."""
_LEAST_PIXELS = 1.5
"""Side of the smallest point of foliage [pixels]."""


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


@dataclass(frozen=True)
class DrawnPlants:
    """The plants of a scene and what there is to be drawn of them."""

    instances: Instances
    """The plants."""
    forms: Sequence[str]
    """Growth form of each species."""
    area_index: Float[np.ndarray, "species organ"]
    """One-sided area of leaves, wood and flowers of a plant, as seen from outside its shoots, over
    the disc of its crown [m2 m-2]."""
    dead: Float[np.ndarray, " species"]
    """Share of the area of the leaves that is dead tissue [-]."""
    models: Sequence[PlantModel | None]
    """Shape of the plants of each species, None for the individuals of its growth form."""
    seed: int
    """Seed of the scene, which the shapes of its plants are drawn with."""


@style()
def plan_view(plants: DrawnPlants, *, periodic: bool, title: str = "") -> Figure:
    """The plants from straight above as clouds of their area elements, each species in its colour.

    **Arguments:** `plants`; `periodic`, whether the plot repeats itself beyond its edges; `title`
    of the figure.

    Leaves and flowers fill as much of the picture as their area is seen to, so that ground shows
    through; thin stems are drawn somewhat wider. The legend gives the plants of each species and
    the share of the ground over which its crown, taken for a disc, is the tallest.
    """
    instances = plants.instances
    lx, ly = instances.extent
    cell = _cell(instances.extent, _PIXELS)
    cover = projected_cover(instances, cell=cell, periodic=periodic)
    colours = species_colours(plants.forms)
    figure = Figure(figsize=(9.8, 6.6 * min(max(ly / lx, 0.4), 1.6) + 0.3))
    axes = figure.subplots()
    axes.imshow(
        from_above(plants, cell, periodic=periodic),
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


def from_above(
    plants: DrawnPlants, cell: float, *, periodic: bool
) -> Float[np.ndarray, "row column 3"]:
    """Area elements of the plants over bare ground in pixels of `cell` [m], the highest on top."""
    lx, ly = plants.instances.extent
    nx, ny = round(lx / cell), round(ly / cell)
    image = np.broadcast_to(rgb(GROUND), (ny, nx, 3)).copy()
    if len(plants.instances):
        place, tint, area = element_points(plants, 1.0 / cell, np.array([0.0, 0.0, 1.0]))
        flat = place[:, :2] / cell
        flat = flat % [nx, ny] if periodic else flat
        paint_points(image, flat, -place[:, 2], area / cell**2, tint)
    return np.clip(image, 0.0, 1.0)


def element_points(
    plants: DrawnPlants, metre: float, towards: Float[np.ndarray, "3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of all plants [m], their colours, and the area that each shows [m2].

    **Arguments:** `plants`; `metre`, pixels of a metre in the picture; `towards`, unit vector to
    the eye.

    Organs without area have no points. A point of foliage is a leaf of the form's size, or as many
    smaller ones as a pixel or two hold; dead tissue is as many of them as its share. Those of wood
    are a pixel apart along a stem, and show a quarter of one at least.
    """
    instances, rng = plants.instances, np.random.default_rng(0)
    disc = np.pi / 4.0 * instances.diameter**2
    wanted = np.stack([_points(plants, i, metre) for i in range(len(plants.forms))])
    total = wanted.sum(axis=1)[instances.species].sum()
    wanted = wanted * min(1.0, _MOST_POINTS / max(total, 1.0))
    places, tints, areas = [], [], []
    for species, form in enumerate(plants.forms):
        standing = np.flatnonzero(instances.species == species)
        index, model = plants.area_index[species], plants.models[species]
        if len(standing) == 0 or not index.any():
            continue
        share = dict(zip(Organ, np.maximum(wanted[species], 1e-9), strict=True))
        number = max(_FEWEST_POINTS, round(wanted[species].sum()))
        seeds = individual_seeds(plants.seed, species) if model is None else [0]
        for individual, seed in enumerate(seeds[: len(standing)]):
            mine = standing[individual :: len(seeds)]
            shape = plant_model(form, number, seed=seed, share=share) if model is None else model
            position = np.asarray(shape.position, np.float32)
            organ = np.asarray(shape.organ)
            there = index[organ] > 0.0
            position, organ = position[there], organ[there]
            normal = np.asarray(shape.normal)[there]
            place, turned = standing_points(instances, mine, position, normal)
            share_of_organ = np.asarray(shape.area_fraction)[there] * index[organ]
            area = disc[mine, None] * share_of_organ * np.abs(turned @ towards)
            area = np.where(organ == Organ.WOOD, np.maximum(area, _FAINTEST / metre**2), area)
            # Light fades into the crown: darker low down and near the axis.
            inner = np.clip(2.0 * np.hypot(position[:, 0], position[:, 1]), 0.0, 1.0)
            light = (0.34 + 0.5 * position[:, 2] + 0.16 * inner) * (
                0.72 + 0.4 * np.abs(turned @ SUN)
            )
            tone = _tones(plants, species, organ, len(mine), rng)
            places.append(place.reshape(-1, 3).astype(np.float32))
            tints.append((light[..., None] * tone).reshape(-1, 3).astype(np.float32))
            areas.append(area.ravel().astype(np.float32))
    if not places:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    return np.concatenate(places), np.concatenate(tints), np.concatenate(areas)


def standing_points(
    plants: Instances, mine: np.ndarray, position: np.ndarray, normal: np.ndarray
) -> tuple[Float[np.ndarray, "plant point 3"], Float[np.ndarray, "plant point 3"]]:
    """Places [m] and normals of the points of a plant of unit size, on each plant of `mine`."""
    angles = plants.azimuth[mine], plants.tilt[mine]
    across, up = unit_shapes(position, *angles)
    wide, high = plants.diameter[mine, None, None], plants.height[mine, None, None]
    foot = np.stack([plants.x[mine], plants.y[mine], plants.z[mine]], axis=-1)
    return wide * across + high * up + foot[:, None], np.add(*unit_shapes(normal, *angles))


def _points(plants: DrawnPlants, species: int, metre: float) -> Float[np.ndarray, " organ"]:
    """Points of each organ that a plant of a species is drawn with, on average."""
    mine = plants.instances.species == species
    if not mine.any():
        return np.zeros(len(Organ))
    disc = float(np.mean(np.pi / 4.0 * plants.instances.diameter[mine] ** 2))
    form = FORMS[plants.forms[species]]
    # Culms and thick stems as beads of their own width, that touch.
    across = form.leaf.width if form.leaf.tubular else form.leaf_diameter
    leaf = max(np.pi / 4.0 * across**2, (_LEAST_PIXELS / metre) ** 2)
    many = disc * plants.area_index[species] / leaf
    shoots = 0 if form.shoots is None else form.shoots.number
    stems = shoots * float(plants.instances.height[mine].mean())
    many[Organ.WOOD] = stems * metre * (plants.area_index[species, Organ.WOOD] > 0.0)
    return np.minimum(many, _MOST_OF_A_PLANT)


def _tones(
    plants: DrawnPlants, species: int, organ: np.ndarray, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "plant element 3"]:
    """Colours of the elements of `count` plants of a species in full light."""
    own = rgb(species_colours(plants.forms)[species])
    if plants.forms[species] == "deadwood":  # from charred to bleached
        return own * rng.uniform(0.45, 1.35, (count, 1, 1)) * np.ones((len(organ), 1))
    of_organ = np.stack([own, rgb(BARK), 0.35 * own + 0.65])
    tone = np.broadcast_to(of_organ[organ], (count, len(organ), 3))
    dead = (organ == Organ.LEAF) & (rng.random((count, len(organ))) < plants.dead[species])
    tone = np.where(dead[..., None], (1.0 - _FADED) * own + _FADED * rgb(_STRAW), tone)
    return tone * (0.90 + 0.2 * rng.random((count, 1, 1)))


def _disc(side: int) -> Int[np.ndarray, "pixel 2"]:
    """Rows and columns of the pixels of a disc that is `side` of them wide."""
    step = np.arange(side) - 0.5 * (side - 1)
    down, across = np.nonzero(np.hypot(step[:, None], step) <= 0.5 * side - 0.1 * (side > 2))
    return np.stack([down, across], axis=-1)


_DISCS = [_disc(side) for side in range(41)]
_AREAS = np.array([len(disc) for disc in _DISCS], float)


def sides(area: Float[np.ndarray, " point"]) -> Int[np.ndarray, " point"]:
    """How many pixels wide points of an `area` [pixels] are drawn: on average they fill it."""
    area = np.minimum(area, _AREAS[-1])
    lower = np.clip(np.searchsorted(_AREAS, area, side="right") - 1, 0, len(_AREAS) - 2)
    part = (area - _AREAS[lower]) / (_AREAS[lower + 1] - _AREAS[lower])
    return lower + (np.random.default_rng(1).random(len(area)) < part)


def paint_points(
    image: np.ndarray, flat: np.ndarray, depth: np.ndarray, area: np.ndarray, tint: np.ndarray
) -> None:
    """Paint points of colours `tint` at columns and rows `flat` into `image`, the farthest first,
    each as a disc of `area` pixels."""
    side = sides(area)
    shown = np.flatnonzero(side > 0)
    order = shown[np.argsort(-depth[shown], kind="stable")]
    flat, side, tint = flat[order], side[order], tint[order]
    rows, columns = image.shape[:2]
    corner = np.floor(flat - 0.5 * (side[:, None] - 1)).astype(np.int64)
    owner, pixel = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    # All discs of a size at once would mix the order: number the points, sort once more.
    for size in np.unique(side):
        mine = np.flatnonzero(side == size)
        down, across = _DISCS[size].T
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
    ground: Mapping[str, Any] | None = None,
) -> None:
    handles = []
    for index, (taxon, count) in enumerate(zip(instances.taxa, instances.counts)):
        text = f"{taxon}\n{count} plants" if count != 1 else f"{taxon}\n1 plant"
        if visible is not None:
            text += f", {100 * visible[index]:.1f} % of the ground"
        handles.append(Patch(facecolor=colours[index], edgecolor="none", label=text))
    if total is not None:
        ground = {f"ground under no crown\n{100 * (1 - total):.1f} %": GROUND}
    for text, colour in (ground or {}).items():
        handles.append(Patch(facecolor=colour, edgecolor="#B8AD95", lw=0.5, label=text))
    figure.legend(
        handles=handles, loc="outside right center", fontsize=7.5, labelspacing=0.75,
        handlelength=1.2, handleheight=1.6,
    )  # fmt: skip


@style()
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
