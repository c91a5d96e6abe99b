"""Pictures of plots on level ground that are too large to be in memory in one piece."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from fynjax._core.progress import track
from fynjax.canopy import Organ
from fynjax.radiation import (
    LightInWindows,
    RayLattice,
    Tiling,
    VoxelScene,
    check_light,
    light_tiling,
    voxel_values,
)
from fynjax.scene._instances import standing_plants
from fynjax.scene._observe import AimedSensor
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._planting import no_plants
from fynjax.scene._scene import Scene, Window
from fynjax.sensors import BandSet

_MOST_RAYS = 1500**2
"""Rays up to which a picture is rendered in one piece."""
_MOST_VOXELS, _MOST_FINEST = 5_000_000, 100_000_000
"""Voxels, and finest voxels, up to which a scene is in memory in one piece."""
_TILE = 500
"""Edge of a tile [rays], at most."""
_HELD = 2**29
"""Numbers of voxels in memory at once, about."""


def is_large(aimed: AimedSensor, scene: Scene) -> bool:
    """Whether a picture has so many rays, or a scene so many voxels, that it is to be rendered in
    tiles, and can be.

    Rays of a tilted camera cannot be cut, nor terrain, whose shade reaches far, nor the light of
    more bands than are solved for.

    **Arguments:** `aimed`, the sensor; `scene`, what it is aimed at.
    """
    most = aimed.accuracy.solves
    few = most is None or len(aimed.sensor.bands) <= most
    rays, voxels = aimed.rays, math.prod(scene.class_grid.shape)
    finest = math.prod(scene.grid.shape) * scene.finer**3
    many = math.prod(rays.shape) > _MOST_RAYS or voxels > _MOST_VOXELS or finest > _MOST_FINEST
    return few and scene.terrain is None and isinstance(rays, RayLattice) and many


def check_image(
    aimed: AimedSensor, scene: Scene, parameters: PlotParameters, *, tiled: bool = False
) -> None:
    """Raise `InputError` where the light of a picture would not fit in memory, before it is solved.

    **Arguments:**

    - `aimed`, `scene`, `parameters`: the sensor and what it is aimed at, whose plants do not count.
    - `tiled`: whether it is to be a `TiledPicture`.
    """
    bare = eqx.tree_at(lambda s: s.planting, scene, no_plants(scene.dtype))
    if tiled:
        whole = _without_voxels(bare, parameters, aimed.sensor.bands)
        light_tiling(whole, aimed.accuracy, _voxels_held(whole))
    else:
        shapes = jax.eval_shape(lambda: bare.voxels(parameters, aimed.sensor.bands))
        check_light(shapes, aimed.accuracy)


class TiledPicture:
    """A large picture, rendered tile by tile with light that is solved once for the whole scene.

    It is that of `AimedSensor.observe`, without air and noise. The voxels of the scene, and its
    plants' area elements, are made window by window: memory is that of the diffuse light on its
    coarse cells. Who watches, keeps or stops it does so between the `tiles`.

    **Arguments:**

    - `aimed`, `scene`, `parameters`: the sensor, without air, and what it is aimed at: such that
      `is_large` could be true.
    - `tile`: edge of a tile [rays], at most.

    **Raises:** `InputError` where the light does not fit in memory.

    Not differentiable.
    """

    tiles: list[tuple[int, int]]
    """Row and column of each tile."""

    def __init__(
        self, aimed: AimedSensor, scene: Scene, parameters: PlotParameters, *, tile: int = _TILE
    ) -> None:
        scene, bands, rays = scene.expected(False), aimed.sensor.bands, aimed.rays
        assert isinstance(rays, RayLattice)
        bare = eqx.tree_at(lambda s: s.planting, scene, no_plants(scene.dtype))
        whole = _without_voxels(bare, parameters, bands)
        held = _voxels_held(whole)
        plants = _Plants(scene, parameters, whole.horizontal)

        def windows(
            voxels: Callable[..., VoxelScene], bands: BandSet, tiling: Tiling
        ) -> Callable[[int, int], VoxelScene]:
            room = plants.room(tiling)
            return lambda row, column: voxels(
                bare, parameters, bands, plants.window(tiling, room, row, column)
            )

        by_organ = partial(windows, _voxels_by_organ, bands.select([0]))
        light = LightInWindows(whole, aimed.accuracy, held, partial(windows, _voxels, bands))
        self._tiling, self._draw = light.picture(rays, tile, aimed.steepest)
        organs = len(Organ) * len(scene.species)
        held = _HELD // (len(bands) + 4 * organs)
        self._sight = partial(light.sight, rays, tile, aimed.steepest, held, by_organ)
        self._aimed, self._whole = aimed, whole
        self._factor = np.empty((len(bands), *rays.shape), scene.dtype)
        self.tiles = [*np.ndindex(*self._tiling.shape)]

    def render(self, tile: tuple[int, int]) -> Float[Array, "band row column"]:
        """Reflectance factor along the rays of a tile [-]."""
        return self._draw(*tile)

    def image(
        self, rendered: Iterable[Float[ArrayLike, "band row column"]] | None = None
    ) -> Float[Array, "band y x"]:
        """Reflectance factor of the pixels [-], from what was rendered of all `tiles`, in order;
        rendered here if left out."""
        if rendered is None:
            rendered = map(self.render, track(self.tiles, "Tiles"))
        for tile, part in zip(self.tiles, rendered, strict=True):
            self._factor[:, *self._tiling.pixels(*tile)] = part
        return self._aimed.averages(jnp.asarray(self._factor), self._whole)[0]

    def sight(self) -> Float[Array, "layer y x"]:
        """Shares of the pixels that are each organ of each species, species by species, ground in
        the sun and in shade [-]: the layers of `pixel_truth`."""
        tiling, met = self._sight()
        layers = None
        for tile in track([*np.ndindex(*tiling.shape)], "Tiles"):
            seen = met(*tile)
            part = np.concatenate([seen.canopy, seen.sunlit_ground[None], seen.shaded_ground[None]])
            if layers is None:
                layers = np.empty((len(part), *self._factor.shape[1:]), np.float32)
            layers[:, *tiling.pixels(*tile)] = part
        assert layers is not None
        average = lambda layer: self._aimed.averages(jnp.asarray(layer)[None], self._whole)[0]  # noqa: E731
        return jnp.concatenate([average(layer) for layer in layers])


class _Plants:
    """The plants of a scene that stand, as windows of it want them."""

    def __init__(self, scene: Scene, parameters: PlotParameters, edge: float) -> None:
        crown = np.asarray(_visible_crowns(scene, parameters))
        standing = np.flatnonzero(standing_plants(scene, parameters))
        planting = jax.tree.map(np.asarray, scene.planting).plants(standing)
        diameter, height = (
            np.asarray(getattr(parameters.species, name))[planting.species]
            for name in ("diameter", "height")
        )
        x, y, z = np.abs(planting.shapes.position).max(axis=0, initial=0.0)
        lean = np.abs(np.sin(np.deg2rad(planting.tilt)))
        # How far from its foot a plant reaches, at most [m].
        self._reach = (
            diameter * planting.size * np.hypot(x, y)
            + height * planting.stature * z * lean
            + scene.tuft
            + edge
        )
        self._planting, self._crown, self._edge = planting, crown[standing], edge
        self._sides, self._periodic = np.array(scene.grid.extent[:2]), scene.boundary == "periodic"

    def room(self, tiling: Tiling) -> tuple[int, int]:
        """Most plants, and most elements, of a window."""
        # One size for all windows, so that they share a program.
        found = [self._within(tiling, *place)[0] for place in np.ndindex(tiling.shape)]
        elements = [int(self._planting.count[index].sum(dtype=np.int64)) for index in found]
        return max(map(len, found)), max(elements)

    def window(self, tiling: Tiling, room: tuple[int, int], row: int, column: int) -> Window:
        """The window of a tile, with room for as many plants and elements as any has."""
        index, foot = self._within(tiling, row, column)
        few = dataclasses.replace(self._planting.plants(index), foot=foot).with_elements()
        # One plant more at the end, without area, to which the elements left over belong.
        plants, elements = room[0] + (room[1] > 0), room[1]
        longer = lambda field, to, fill=0: np.pad(  # noqa: E731
            field, [(0, to - len(field))] + [(0, 0)] * (field.ndim - 1), constant_values=fill
        )
        few = dataclasses.replace(
            few.of_plants(lambda field: longer(field, plants)),
            plant=longer(few.plant, elements, plants - 1),
            part=longer(few.part, elements),
        )
        first, columns = tiling.window(row, column)
        crown = jnp.asarray(longer(self._crown[index], plants))
        return Window(jax.tree.map(jnp.asarray, few), crown, jnp.asarray(first), columns)

    def _within(
        self, tiling: Tiling, row: int, column: int
    ) -> tuple[Int[np.ndarray, " plant"], Float[np.ndarray, "plant 2"]]:
        """Plants that reach into the window of a tile, and their feet from its corner; each as
        often as the scene repeats it there."""
        first, columns = (np.array(pair[::-1]) * self._edge for pair in tiling.window(row, column))
        repeats = [range(1)] * 2
        if self._periodic:
            wide = self._reach.max(initial=0.0)
            low, high = ((first - wide) / self._sides - 1, (first + columns + wide) / self._sides)
            # Whole sides to shift by, for every copy of the plot that reaches into the window.
            repeats = [range(math.ceil(a), math.floor(b) + 1) for a, b in zip(low, high)]
        index, feet = [], []
        for by in itertools.product(*repeats):
            foot, reach = self._planting.foot, self._reach[:, None]
            foot = foot + (by * self._sides - first).astype(foot.dtype)
            # Feet count from the window's corner: within its sides, or near enough to reach in.
            inside = np.flatnonzero(((foot > -reach) & (foot < columns + reach)).all(axis=1))
            index.append(inside)
            feet.append(foot[inside])
        return np.concatenate(index), np.concatenate(feet)


_visible_crowns = eqx.filter_jit(Scene.visible_crowns)
_voxels, _voxels_by_organ = map(eqx.filter_jit, (Scene.voxels, Scene.voxels_by_organ))


def _voxels_held(whole: VoxelScene) -> int:
    """Voxels in memory at once, about."""
    # Placing the elements takes about as much again for each class.
    return _HELD // (voxel_values(whole) + 3 * whole.area_density.shape[0])


@eqx.filter_jit
def _without_voxels(bare: Scene, parameters: PlotParameters, bands: BandSet) -> VoxelScene:
    """The scene as light meets it, with shapes in place of the voxels' area."""
    voxels = bare.voxels(parameters, bands)
    of_voxels = lambda v: (v.area_density, v.structure)  # noqa: E731
    shapes = jax.eval_shape(lambda: of_voxels(voxels))
    return eqx.tree_at(of_voxels, voxels, shapes, is_leaf=lambda v: v is None)
