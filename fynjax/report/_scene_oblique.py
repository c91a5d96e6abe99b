"""A scene from obliquely above, drawn point by point with numpy: nearer points hide others."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from fynjax.canopy import Organ, plant_model, unit_shapes
from fynjax.report._figure_style import style
from fynjax.report._scene_figures import _GROUND, _legend, rgb, species_colours
from fynjax.scene import Instances, projected_cover

_WIDTH, _HEIGHT, _FINER = 1120, 840, 2
_MOST_POINTS = 4_000_000
BARK = "#5B4636"
SUN = np.array([-0.45, 0.35, 0.82])


class View:
    """A camera in the south-south-west that looks down on the plot's middle."""

    def __init__(self, extent: tuple[float, float], top: float) -> None:
        lx, ly = extent
        side = max(lx, ly)
        azimuth, elevation = np.deg2rad(205.0), np.deg2rad(42.0)
        level = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        self.target = np.array([lx / 2, ly / 2, 0.25 * top])
        self.eye = self.target + 2.3 * side * (
            np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
        )
        self.ahead = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(self.ahead, [0.0, 0.0, 1.0])
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.right, self.ahead)
        corners = np.array([[x, y, z] for x in (0, lx) for y in (0, ly) for z in (0, top)])
        self.scale, self.middle = 1.0, np.zeros(2)
        raw, _ = self.project(corners)
        low, high = raw.min(axis=0), raw.max(axis=0)
        size = np.array([_WIDTH, _HEIGHT]) * _FINER
        self.scale = float(np.min(0.88 * size / (high - low)))
        self.middle = size / 2 - self.scale * (low + high) / 2

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows [pixels]."""
        return _WIDTH * _FINER, _HEIGHT * _FINER

    def project(self, points: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Column and row from the bottom of points [pixels], and their distances [m]."""
        away = points - self.eye
        depth = away @ self.ahead
        flat = np.stack([away @ self.right, away @ self.up], axis=-1) / depth[:, None]
        return self.scale * flat + self.middle, depth

    def ground(self) -> tuple[np.ndarray, np.ndarray]:
        """x and y of the ground behind each pixel [m]."""
        column, row = np.meshgrid(
            np.arange(_WIDTH * _FINER) + 0.5, np.arange(_HEIGHT * _FINER) + 0.5
        )
        right = (column - self.middle[0]) / self.scale
        up = (row - self.middle[1]) / self.scale
        rays = self.ahead + right[..., None] * self.right + up[..., None] * self.up
        far = -self.eye[2] / np.minimum(rays[..., 2], -1e-9)
        return self.eye[0] + far * rays[..., 0], self.eye[1] + far * rays[..., 1]


Painter = Callable[[View], Float[np.ndarray, "row column 4"]]


def oblique_view(
    instances: Instances,
    forms: Sequence[str],
    *,
    periodic: bool,
    title: str = "",
    paint: Painter | None = None,
) -> Figure:
    """The plants from the south-south-west, as clouds of their area elements.

    `paint` may draw them instead: red, green, blue and opacity of each pixel, rows from the
    bottom, as a view sees them.
    """
    colours = species_colours(forms)
    top = float(instances.height.max(initial=0.3))
    view = View(instances.extent, top)
    image = _ground_image(instances, view, periodic)
    if paint is not None:
        plants = paint(view)
        image += plants[..., 3:] * (plants[..., :3] - image)
    elif len(instances):
        _draw(image, view, *_points(instances, forms, view, colours))
    shape = (_HEIGHT, _FINER, _WIDTH, _FINER, 3)
    return oblique_figure(image.reshape(shape).mean(axis=(1, 3)), view, instances, colours, title)


def oblique_figure(
    image: np.ndarray, view: View, instances: Instances, colours: Sequence[str], title: str
) -> Figure:
    """An image [row from the bottom, column, 3] with the plot's edges measured, and the legend."""
    lx, ly = instances.extent
    with style():
        figure = Figure(figsize=(9.8, 6.0))
        axes = figure.subplots()
        axes.imshow(np.clip(image, 0, 1), origin="lower", interpolation="antialiased")
        axes.set(title=title, xticks=[], yticks=[], xlim=(0, _WIDTH), ylim=(0, _HEIGHT))
        for spine in axes.spines.values():
            spine.set_visible(False)

        def at(x: float, y: float) -> tuple[float, float]:
            flat, _ = view.project(np.array([[x, y, 0.0]]))
            return float(flat[0, 0]) / _FINER, float(flat[0, 1]) / _FINER

        out = 0.035 * max(lx, ly)
        for part in np.linspace(0.0, 1.0, 6):
            axes.text(
                *at(part * lx, -out), f"{part * lx:g}", fontsize=7.5, ha="center", va="center"
            )
            axes.text(
                *at(-out, part * ly), f"{part * ly:g}", fontsize=7.5, ha="center", va="center"
            )
        axes.text(*at(lx / 2, -3 * out), "East [m]", fontsize=8.5, ha="center", va="center")
        axes.text(*at(-3.7 * out, 0.45 * ly), "North [m]", fontsize=8.5, ha="center", va="center")
        axes.annotate(
            "N", at(-3.2 * out, 0.63 * ly), at(-3.2 * out, 0.86 * ly), ha="center", va="center",
            fontsize=9, fontweight="bold",
            arrowprops={"arrowstyle": "<|-", "lw": 1.3, "color": "black"},
        )  # fmt: skip
        _legend(figure, instances, colours)
    return figure


def _ground_image(instances: Instances, view: View, periodic: bool) -> np.ndarray:
    """Sand, darker beneath the crowns, white around."""
    lx, ly = instances.extent
    x, y = view.ground()
    inside = (x >= 0) & (x < lx) & (y >= 0) & (y < ly)
    count = 512
    cell = lx / count
    rows = max(1, round(ly / cell))
    shade = projected_cover(instances, (lx, rows * cell), cell=cell, periodic=periodic).top >= 0
    light = 1.0 - 0.42 * shade
    image = np.ones((*x.shape, 3))
    i = np.minimum((x[inside] / cell).astype(int), count - 1)
    j = np.minimum((y[inside] / cell).astype(int), rows - 1)
    image[inside] = rgb(_GROUND) * light[j, i, None]
    return image


def _points(
    instances: Instances, forms: Sequence[str], view: View, colours: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of all plants, their colours, and how wide each is drawn [m]."""
    rng = np.random.default_rng(0)
    metre = view.scale / np.linalg.norm(view.eye - view.target)
    # As many points as hide what is behind them at two pixels each, if that is not too many.
    wanted = np.clip(instances.diameter * instances.height * (metre / 2.0) ** 2, 10, 4000)
    fewer = min(1.0, _MOST_POINTS / wanted.sum())
    places, tints, widths = [], [], []
    for one, form in enumerate(forms):
        mine = instances.species == one
        if not mine.any():
            continue
        number = max(8, int(fewer * wanted[mine].mean()))
        shape = plant_model(form, number, seed=one)
        position = np.asarray(shape.position, np.float32)
        per_diameter, per_height = unit_shapes(
            position, instances.azimuth[mine], instances.tilt[mine]
        )
        diameter, height = instances.diameter[mine], instances.height[mine]
        place = diameter[:, None, None] * per_diameter + height[:, None, None] * per_height
        place[..., 0] += instances.x[mine, None]
        place[..., 1] += instances.y[mine, None]
        organ = np.asarray(shape.organ)
        base = np.where((organ == Organ.WOOD)[:, None], rgb(BARK), rgb(colours[one]))
        if form == "deadwood":
            base = np.broadcast_to(rgb(colours[one]), base.shape)
        facing = np.abs(np.asarray(shape.normal) @ SUN)
        # Light fades into the crown: darker low down and near the axis.
        inner = np.clip(2.0 * np.hypot(position[:, 0], position[:, 1]), 0.0, 1.0)
        light = (0.34 + 0.5 * position[:, 2] + 0.16 * inner) * (0.72 + 0.4 * facing)
        own = 0.90 + 0.2 * rng.random((mine.sum(), 1))
        places.append(place.reshape(-1, 3).astype(np.float32))
        tints.append(
            (own[..., None] * (light[:, None] * base)[None]).reshape(-1, 3).astype(np.float32)
        )
        gap = np.sqrt(diameter * height / number)
        widths.append(np.repeat(0.8 * gap, number).astype(np.float32))
    return np.concatenate(places), np.concatenate(tints), np.concatenate(widths)


def _draw(
    image: np.ndarray, view: View, place: np.ndarray, tint: np.ndarray, width: np.ndarray
) -> None:
    """Paint points into `image`, the farthest first."""
    flat, depth = view.project(place)
    side = np.clip(np.round(width * view.scale / depth), 1, 5).astype(np.int32)
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
    seen = nearest >= 0
    image.reshape(-1, 3)[seen] = tint[nearest[seen]]
