"""A scene from obliquely above as light shows it: meshes of its plants in sun and sky.

Every point of a leaf or stem, and of the ground, is as bright as the sunlight and skylight that
reach it, between the plants above it, and as its reflectance or transmittance lets it be in red,
green and blue. Light that is scattered more than once is left out.
"""

import warnings

import numpy as np
from jaxtyping import Float, Int

from fynjax._core.errors import InputError
from fynjax.app.io.instruments import scene_meshes
from fynjax.app.report.figures._scene import standing_points
from fynjax.app.report.figures._scene_oblique import View, oblique_figure, relief, view_of
from fynjax.app.report.figures._style import Figure
from fynjax.canopy import Organ, plant_model_from_mesh
from fynjax.scene import Instances, Scene, hard_instances, hard_scene, organ_classes
from fynjax.sensors import BandSet

_COLOURS = BandSet(("red", "green", "blue"), (650.0, 550.0, 460.0), (40.0, 40.0, 40.0))
_CELL = 0.01
"""Width of the columns in which what stands above takes light away [m]."""
_SKY = [(0.0, 0.0), *((50.0, azimuth) for azimuth in (20.0, 110.0, 200.0, 290.0))]
"""Zenith angle and azimuth from which light of the sky comes [degrees]."""
_FACE = 0.4
"""Sunlight on the faces below the edges of ground that is not level, over that on level ground."""
_TRIANGLES, _POINTS = 60_000, 4_000_000
"""Most triangles of a plant, and points of all plants."""


def lit_view(
    scene: Scene, *, size: tuple[int, int] = (840, 840), points: int = _POINTS
) -> Float[np.ndarray, "row column 3"]:
    """The plants of a scene as meshes in sun and sky, from the south-south-west.

    **Arguments:**

    - `scene`, with its parameters.
    - `size`: most columns and rows of the picture, which ends where the plants do [pixels].
    - `points`: that all plants are drawn with.

    **Returns:** red, green and blue, 0 to 1, for `matplotlib.pyplot.imshow(..., origin="lower")`:
    the square root of reflectance over the 98th percentile of the picture; white beside the plot.
    Not differentiable.

    **Raises:** `InputError` where no plants stand.
    """
    plants = hard_instances(scene, scene.parameters)
    view = view_of(plants, scene.terrain, size)
    image = _lit(plants, hard_scene(scene, scene.parameters), view, points)
    drawn = np.any(view.shown(np.isfinite(image)), axis=2)
    rows, columns = (np.flatnonzero(np.any(drawn, axis=k)) for k in (1, 0))
    cut = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return view.shown(_stretched(image))[cut]


def lit_figure(plants: Instances, scene: Scene, title: str = "") -> Figure:
    """The plants as meshes in sun and sky, with the plot's edges measured.

    **Arguments:** `plants`; `scene`, with these plants alone and its parameters; `title` of the
    figure.

    **Raises:** `InputError` where no plants stand.
    """
    image = _stretched(_lit(plants, scene, view_of(plants, scene.terrain), _POINTS))
    return oblique_figure(image, plants, title, scene.terrain)


def _stretched(image: np.ndarray) -> np.ndarray:
    """Reflectance as a picture, white where there is none."""
    part = image / np.nanpercentile(image, 98.0)
    return np.sqrt(np.clip(np.nan_to_num(part, nan=1.0), 0.0, 1.0))


def _lit(
    plants: Instances, hard: Scene, view: View, points: int
) -> Float[np.ndarray, "row column 3"]:
    """Reflectance of plants and ground in a view, NaN beside the plot. Hills cast no shadow."""
    parameters, extent = hard.parameters, plants.extent
    place, normal, area, kind = _points(plants, hard, points)
    optics, diffuse = hard.optics(parameters, _COLOURS)
    reflected, passed = (
        np.asarray(values)[kind] for values in (optics.reflectance, optics.transmittance)
    )
    sky = np.asarray(diffuse)
    image = np.full((*view.size[::-1], 3), np.nan)
    if hard.terrain is None:
        inside, x, y = view.ground(extent)
        ground, slope = np.stack([x, y, np.zeros_like(x)], axis=-1), np.ones(len(x))
    else:
        ground, slope, width = relief(extent, view, np.asarray(hard.terrain))
    # What of the light each point of plants and of the ground gets, between the plants above it.
    zenith, azimuth = (float(getattr(parameters.light, f"sun_{k}")) for k in ("zenith", "azimuth"))
    sun = _direction(zenith, azimuth)
    from_sun, columns = _reaching(extent, place, normal, area, sun)
    ground_sun = columns[_columns(extent, ground, sun)]
    from_sky, ground_sky = np.zeros(len(place)), np.zeros(len(ground))
    for way in (_direction(*angles) for angles in _SKY):
        share, columns = _reaching(extent, place, normal, area, way)
        from_sky += share / len(_SKY)
        ground_sky += columns[_columns(extent, ground, way)] / len(_SKY)
    # The sun passes through a leaf whose other side the eye sees.
    eye = view.eye - place
    facing = normal @ sun
    same = (facing * np.einsum("ij,ij->i", normal, eye) > 0.0)[:, None]
    direct = (np.abs(facing) / sun[2] * from_sun)[:, None] * np.where(same, reflected, passed)
    colour = (1 - sky) * direct + sky * from_sky[:, None] * 0.5 * (reflected + passed)
    soil = np.asarray(hard.ground_map(parameters, _COLOURS)).reshape(3, -1).mean(axis=1)
    bright = np.nan_to_num(slope, nan=_FACE)
    light = (1 - sky) * (bright * ground_sun)[:, None] + sky * ground_sky[:, None]
    shown = area * np.abs(np.einsum("ij,ij->i", normal, eye)) / np.linalg.norm(eye, axis=1)
    if hard.terrain is None:
        image[inside] = soil * light
    else:
        place, shown = np.concatenate([place, ground]), np.concatenate([shown, width])
        colour = np.concatenate([colour, soil * light])
    view.paint(image, place, colour, shown)
    return image


def _direction(zenith: float, azimuth: float) -> Float[np.ndarray, "3"]:
    up, turn = np.deg2rad(zenith), np.deg2rad(azimuth)
    return np.array([np.sin(up) * np.sin(turn), np.sin(up) * np.cos(turn), np.cos(up)])


def _points(
    plants: Instances, scene: Scene, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Places [m], normals, one-sided areas [m2] and optical classes of points on all plants."""
    counts, most_triangles = plants.counts, _TRIANGLES * len(plants)
    with warnings.catch_warnings():  # of taxa with the usual leaf of their form
        warnings.simplefilter("ignore", UserWarning)
        meshes, _ = scene_meshes(
            plants, scene, scene.parameters,
            max_triangles=most_triangles, seed=int(scene.seed),
        )  # fmt: skip
    share = float(scene.crown_share(scene.parameters))
    index = share * np.asarray(scene.organ_index(scene.parameters))
    crowns = np.bincount(plants.species, np.pi / 4 * plants.diameter**2, len(plants.taxa))
    total = np.maximum(index.sum(axis=1) * crowns, 1e-9)
    classes = organ_classes(scene.species)
    parts = []
    for species, mesh in enumerate(meshes):
        if mesh is None:
            continue
        mine = np.flatnonzero(plants.species == species)
        number = int(np.clip(most * total[species] / total.sum() / counts[species], 200, 400_000))
        model = plant_model_from_mesh(mesh, number, solid_materials="closed").plant
        organ, position = np.asarray(model.organ), np.asarray(model.position, np.float32)
        place, turned = standing_points(plants, mine, position, np.asarray(model.normal))
        disc = np.pi / 4 * plants.diameter[mine, None] ** 2
        area = disc * np.asarray(model.area_fraction) * index[species][organ]
        kinds = np.broadcast_to(np.array(classes[species])[organ], area.shape)
        if plants.leaf is not None and scene.species[species].leaves > 0:
            kinds = kinds + np.outer(plants.leaf[mine], organ == Organ.LEAF)
        kinds = kinds.ravel()
        parts.append(
            (place.astype(np.float32).reshape(-1, 3), turned.reshape(-1, 3), area.ravel(), kinds)
        )
    if not parts:
        raise InputError("expected plants to look at, but none stand on the plot")
    place, normal, area, kinds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return place, normal, area, kinds


def _reaching(
    extent: tuple[float, float],
    place: np.ndarray,
    normal: np.ndarray,
    area: np.ndarray,
    towards: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, "y x"]]:
    """Share of the light from `towards` that reaches each point, and the ground in cells: what is
    above it in a column along that light takes as much as its area covers. The plot repeats
    itself."""
    row, column = _columns(extent, place, towards)
    ny, nx = (round(side / _CELL) for side in extent[::-1])
    where = row * nx + column
    order = np.lexsort((-place[:, 2], where))
    covers = (area * np.abs(normal @ towards) / (towards[2] * _CELL**2))[order]
    depth = np.cumsum(covers, dtype=float) - covers
    first = np.flatnonzero(np.diff(where[order], prepend=-1))
    depth -= np.repeat(depth[first], np.diff(first, append=len(order)))
    share = np.empty(len(place))
    share[order] = np.exp(-depth)
    ground = np.bincount(where[order], covers, nx * ny).reshape(ny, nx)
    return share, np.exp(-ground)


def _columns(
    extent: tuple[float, float], place: np.ndarray, towards: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, " point"], Int[np.ndarray, " point"]]:
    """Row and column of the ground in which light from `towards` through each point would end."""
    flat = place[:, :2] - place[:, 2:] * towards[:2] / towards[2]
    count = [round(side / _CELL) for side in extent]
    column, row = (np.floor(flat / _CELL).astype(np.int64) % count).T
    return row, column
