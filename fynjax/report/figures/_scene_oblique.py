"""A scene from obliquely above, drawn point by point with numpy: nearer points hide others."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.ndimage import map_coordinates

from fynjax.report.figures._scene import (
    GROUND,
    SUN,
    DrawnPlants,
    _legend,
    element_points,
    paint_points,
    rgb,
    species_colours,
)
from fynjax.report.figures._style import style
from fynjax.scene import Instances, projected_cover

_WIDTH, _HEIGHT, _FINER = 1120, 840, 2
_SOIL = "#B08F68"


class View:
    """A camera in the south-south-west that looks down on the plot's middle."""

    finer = _FINER
    """Of its pixels along an edge of one that is shown."""

    def __init__(
        self,
        extent: tuple[float, float],
        top: float,
        pixels: tuple[int, int] = (_WIDTH, _HEIGHT),
    ) -> None:
        self.size = pixels[0] * _FINER, pixels[1] * _FINER
        """Columns and rows [pixels]."""
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
        size = np.array(self.size)
        self.scale = float(np.min(0.88 * size / (high - low)))
        self.middle = size / 2 - self.scale * (low + high) / 2

    def project(self, points: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Column and row from the bottom of points [pixels], and their distances [m]."""
        away = points - self.eye
        depth = away @ self.ahead
        flat = np.stack([away @ self.right, away @ self.up], axis=-1) / depth[:, None]
        return self.scale * flat + self.middle, depth

    def ground(self) -> tuple[np.ndarray, np.ndarray]:
        """x and y of the ground behind each pixel [m]."""
        column, row = np.meshgrid(*(np.arange(n) + 0.5 for n in self.size))
        right = (column - self.middle[0]) / self.scale
        up = (row - self.middle[1]) / self.scale
        rays = self.ahead + right[..., None] * self.right + up[..., None] * self.up
        far = -self.eye[2] / np.minimum(rays[..., 2], -1e-9)
        return self.eye[0] + far * rays[..., 0], self.eye[1] + far * rays[..., 1]


Painter = Callable[[View], Float[np.ndarray, "row column 4"]]
Ground = Float[np.ndarray, "y x"] | None


def oblique_view(
    plants: DrawnPlants,
    *,
    periodic: bool,
    ground: Ground = None,
    title: str = "",
    paint: Painter | None = None,
) -> Figure:
    """The plants from the south-south-west, as clouds of their area elements.

    **Arguments:**

    - `plants`: the plants.
    - `periodic`: whether the plot repeats itself beyond its edges.
    - `ground`: its height in the middles of even cells over the plot [m]; `None` if level.
    - `title` of the figure.
    - `paint`: draws the plants, and ground that is not level, instead of the area elements: red,
      green, blue and opacity of each pixel of a view, rows from the bottom.
    """
    instances, colours = plants.instances, species_colours(plants.forms)
    top = float((instances.z + instances.height).max(initial=0.3))
    view = View(instances.extent, top if ground is None else max(top, float(ground.max())))
    parts = []
    if ground is None:
        image = _ground_image(instances, view, periodic)
    else:
        image = np.ones((*view.size[::-1], 3))
    if paint is not None:
        painted = paint(view)
        image += painted[..., 3:] * (painted[..., :3] - image)
    else:
        if ground is not None:
            parts.append(_relief(instances, view, ground, periodic))
        if len(instances):
            metre = view.scale / float(np.linalg.norm(view.eye - view.target))
            parts.append(element_points(plants, metre, -view.ahead))
    if parts:
        _draw(image, view, *(np.concatenate(part) for part in zip(*parts, strict=True)))
    shape = (_HEIGHT, _FINER, _WIDTH, _FINER, 3)
    image = image.reshape(shape).mean(axis=(1, 3))
    return oblique_figure(image, view, instances, colours, title, ground)


def height_at(
    ground: Ground, extent: tuple[float, float], x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Height of the ground [m]: linear between the middles of its cells, level beyond them."""
    if ground is None:
        return np.zeros(np.broadcast(x, y).shape)
    ny, nx = ground.shape
    at = np.stack(np.broadcast_arrays(y / extent[1] * ny - 0.5, x / extent[0] * nx - 0.5))
    return np.asarray(map_coordinates(ground, at, order=1, mode="nearest"), float)


def oblique_figure(
    image: np.ndarray,
    view: View,
    instances: Instances,
    colours: Sequence[str],
    title: str,
    ground: Ground = None,
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
            z = height_at(ground, (lx, ly), np.array([x]), np.array([y]))[0]
            flat, _ = view.project(np.array([[x, y, z]]))
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
    image = np.ones((*x.shape, 3))
    image[inside] = _sand(instances, x[inside], y[inside], periodic)
    return image


def _sand(instances: Instances, x: np.ndarray, y: np.ndarray, periodic: bool) -> np.ndarray:
    """Colour of the ground at places on the plot, darker beneath the crowns."""
    lx, ly = instances.extent
    count = 512
    cell = lx / count
    rows = max(1, round(ly / cell))
    shade = projected_cover(instances, (lx, rows * cell), cell=cell, periodic=periodic).top >= 0
    light = 1.0 - 0.42 * shade
    i = np.minimum((x / cell).astype(int), count - 1)
    j = np.minimum((y / cell).astype(int), rows - 1)
    return np.asarray(rgb(GROUND) * light[j, i, None])


def _relief(
    instances: Instances, view: View, ground: np.ndarray, periodic: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of ground that is not level and of the faces below its edges, as `_points` has them.

    Slopes are as bright as they face the sun.
    """
    lx, ly = instances.extent
    step = 1.5 * float(np.linalg.norm(view.eye - view.target)) / view.scale  # [m], 1.5 pixels
    east, north = (
        (np.arange(int(np.ceil(side / step))) + 0.5) * side / np.ceil(side / step)
        for side in (lx, ly)
    )
    x, y = (part.ravel() for part in np.meshgrid(east, north))
    z = height_at(ground, (lx, ly), x, y)
    to_north, to_east = np.gradient(z.reshape(len(north), len(east)), north, east)
    facing = SUN[2] - SUN[0] * to_east - SUN[1] * to_north
    facing /= np.sqrt(1.0 + to_east**2 + to_north**2) * np.linalg.norm(SUN)
    light = 0.25 + 0.75 * np.clip(facing / SUN[2], 0.0, 1.3)
    places = [np.stack([x, y, z], axis=-1)]
    tints = [_sand(instances, x, y, periodic) * light.reshape(-1, 1)]
    depth = np.arange(int(np.ceil(z.max() / step))) / max(np.ceil(z.max() / step), 1.0)
    for a, b in ((east, np.zeros_like(east)), (np.zeros_like(north), north)):
        edge = np.outer(depth, height_at(ground, (lx, ly), a, b))
        face = np.stack([np.broadcast_to(a, edge.shape), np.broadcast_to(b, edge.shape), edge], -1)
        places.append(face.reshape(-1, 3))
        tints.append(np.broadcast_to(rgb(_SOIL), places[-1].shape))
    place = np.concatenate(places).astype(np.float32)
    tint = np.concatenate(tints).astype(np.float32)
    return place, tint, np.full(len(place), (2.0 * step) ** 2, np.float32)


def _draw(
    image: np.ndarray, view: View, place: np.ndarray, tint: np.ndarray, area: np.ndarray
) -> None:
    """Paint points of an `area` [m2] into `image`, the farthest first."""
    flat, depth = view.project(place)
    paint_points(image, flat, depth, area * (view.scale / depth) ** 2, tint)
