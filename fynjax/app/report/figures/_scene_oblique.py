"""A scene from obliquely above, drawn point by point with numpy: nearer points hide others."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, map_coordinates

from fynjax.app.report.figures._scene import (
    GROUND,
    SUN,
    DrawnPlants,
    _legend,
    element_points,
    paint_points,
    rgb,
    species_colours,
)
from fynjax.app.report.figures._style import Figure, style
from fynjax.scene import Instances, projected_cover

_WIDTH, _HEIGHT, _FINER = 1120, 840, 2
_SOIL = "#B08F68"
_SHADE = 0.42
"""Part by which the ground below crowns is drawn darker."""


class View:
    """A camera in the south-south-west that looks down on the plot's middle."""

    def __init__(
        self, extent: tuple[float, float], top: float, pixels: tuple[int, int] = (_WIDTH, _HEIGHT)
    ) -> None:
        self.size = pixels[0] * _FINER, pixels[1] * _FINER
        """Columns and rows of the picture before it is thinned to what is shown [pixels]."""
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

    def ground(self, extent: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which pixels show the plot's level ground, and x and y of it there [m]."""
        column, row = np.meshgrid(*(np.arange(n) + 0.5 for n in self.size))
        right = (column - self.middle[0]) / self.scale
        up = (row - self.middle[1]) / self.scale
        rays = self.ahead + right[..., None] * self.right + up[..., None] * self.up
        far = -self.eye[2] / np.minimum(rays[..., 2], -1e-9)
        x, y = self.eye[0] + far * rays[..., 0], self.eye[1] + far * rays[..., 1]
        inside = (x >= 0) & (x < extent[0]) & (y >= 0) & (y < extent[1])
        return inside, x[inside], y[inside]

    def paint(
        self, image: np.ndarray, place: np.ndarray, tint: np.ndarray, area: np.ndarray
    ) -> None:
        """Paint points of an `area` [m2] and colours `tint` into `image`, the farthest first."""
        flat, depth = self.project(place)
        paint_points(image, flat, depth, area * (self.scale / depth) ** 2, tint)

    def shown(self, image: np.ndarray) -> np.ndarray:
        """An image of this view in the pixels that are shown, each the mean of its own."""
        columns, rows = (n // _FINER for n in self.size)
        return np.asarray(image.reshape(rows, _FINER, columns, _FINER, 3).mean(axis=(1, 3)))


Ground = Float[np.ndarray, "y x"] | None


def view_of(
    instances: Instances, ground: Ground, size: tuple[int, int] = (_WIDTH, _HEIGHT)
) -> View:
    """The view of a plot with its plants and ground, of `size` columns and rows."""
    top = float((instances.z + instances.height).max(initial=0.3))
    top = top if ground is None else max(top, float(ground.max()))
    return View(instances.extent, top, size)


def oblique_view(
    plants: DrawnPlants, *, periodic: bool, ground: Ground = None, title: str = ""
) -> Figure:
    """The plants from the south-south-west, as clouds of their area elements.

    **Arguments:**

    - `plants`: the plants.
    - `periodic`: whether the plot repeats itself beyond its edges.
    - `ground`: its height in the middles of even cells over the plot [m]; `None` if level.
    - `title` of the figure.
    """
    instances = plants.instances
    view = view_of(instances, ground)
    image = np.ones((*view.size[::-1], 3))
    metre = view.scale / float(np.linalg.norm(view.eye - view.target))
    points = [element_points(plants, metre, -view.ahead)]
    if ground is None:
        inside, x, y = view.ground(instances.extent)
        image[inside] = _sand(instances, x, y, periodic)
    else:
        place, light, area = relief(instances.extent, view, ground)
        tint = _sand(instances, place[:, 0], place[:, 1], periodic) * light[:, None]
        points.append((place, np.where(np.isnan(tint), rgb(_SOIL), tint), area))
    view.paint(image, *(np.concatenate(part) for part in zip(*points, strict=True)))
    return oblique_figure(image, instances, title, ground, plants.forms)


def height_at(
    ground: Ground, extent: tuple[float, float], x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Height of the ground [m]: linear between the middles of its cells, level beyond them."""
    if ground is None:
        return np.zeros(np.broadcast(x, y).shape)
    ny, nx = ground.shape
    at = np.stack(np.broadcast_arrays(y / extent[1] * ny - 0.5, x / extent[0] * nx - 0.5))
    return np.asarray(map_coordinates(ground, at, order=1, mode="nearest"), float)


@style()
def oblique_figure(
    image: np.ndarray,
    instances: Instances,
    title: str,
    ground: Ground,
    forms: Sequence[str] | None = None,
) -> Figure:
    """An image of the view of a plot with the plot's edges measured.

    **Arguments:** `image` [row from the bottom, column, 3]; `instances`, the plants; `title` of the
    figure; `ground` as of `oblique_view`; `forms`, growth form of each species, for a legend of
    their colours.
    """
    lx, ly = instances.extent
    view = view_of(instances, ground)
    image = view.shown(image)
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
        axes.text(*at(part * lx, -out), f"{part * lx:g}", fontsize=7.5, ha="center", va="center")
        axes.text(*at(-out, part * ly), f"{part * ly:g}", fontsize=7.5, ha="center", va="center")
    axes.text(*at(lx / 2, -3 * out), "East [m]", fontsize=8.5, ha="center", va="center")
    axes.text(*at(-3.7 * out, 0.45 * ly), "North [m]", fontsize=8.5, ha="center", va="center")
    axes.annotate(
        "N", at(-3.2 * out, 0.63 * ly), at(-3.2 * out, 0.86 * ly), ha="center", va="center",
        fontsize=9, fontweight="bold",
        arrowprops={"arrowstyle": "<|-", "lw": 1.3, "color": "black"},
    )  # fmt: skip
    if forms is not None:
        below = tuple((1.0 - _SHADE) * rgb(GROUND))
        soils = {"ground": GROUND, "ground below a crown": below}
        _legend(figure, instances, species_colours(forms), ground=soils)
    return figure


def _sand(instances: Instances, x: np.ndarray, y: np.ndarray, periodic: bool) -> np.ndarray:
    """Colour of the ground at places on the plot, darker beneath the crowns."""
    lx, ly = instances.extent
    count = 512
    cell = lx / count
    rows = max(1, round(ly / cell))
    shade = projected_cover(instances, (lx, rows * cell), cell=cell, periodic=periodic).top >= 0
    # Grains and clods, the same for every plot.
    grain = np.random.default_rng(0).normal(size=shade.shape)
    clods = gaussian_filter(grain, 4.0, mode="wrap") * 14.0
    light = (1.0 - _SHADE * shade) * (1.0 + 0.05 * np.clip(grain + clods, -2.5, 2.5))
    i = np.minimum((x / cell).astype(int), count - 1)
    j = np.minimum((y / cell).astype(int), rows - 1)
    return np.asarray(rgb(GROUND) * light[j, i, None])


def relief(
    extent: tuple[float, float], view: View, ground: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of ground that is not level, and of the faces below its edges.

    **Returns:** their places [m], how bright the sun makes them, 1 where it is level and NaN on the
    faces, and the area that each is drawn with [m2].
    """
    lx, ly = extent
    step = 1.5 * float(np.linalg.norm(view.eye - view.target)) / view.scale  # [m], 1.5 pixels
    east, north = (
        (np.arange(int(np.ceil(side / step))) + 0.5) * side / np.ceil(side / step)
        for side in (lx, ly)
    )
    x, y = (part.ravel() for part in np.meshgrid(east, north))
    z = height_at(ground, extent, x, y)
    to_north, to_east = np.gradient(z.reshape(len(north), len(east)), north, east)
    facing = SUN[2] - SUN[0] * to_east - SUN[1] * to_north
    facing /= np.sqrt(1.0 + to_east**2 + to_north**2) * np.linalg.norm(SUN)
    light = (0.25 + 0.75 * np.clip(facing / SUN[2], 0.0, 1.3)).ravel()
    places = [np.stack([x, y, z], axis=-1)]
    depth = np.arange(int(np.ceil(z.max() / step))) / max(np.ceil(z.max() / step), 1.0)
    for a, b in ((east, np.zeros_like(east)), (np.zeros_like(north), north)):
        edge = np.outer(depth, height_at(ground, extent, a, b))
        face = np.stack([np.broadcast_to(a, edge.shape), np.broadcast_to(b, edge.shape), edge], -1)
        places.append(face.reshape(-1, 3))
    place = np.concatenate(places).astype(np.float32)
    light = np.append(light, np.full(len(place) - len(light), np.nan)).astype(np.float32)
    return place, light, np.full(len(place), (2.0 * step) ** 2, np.float32)
