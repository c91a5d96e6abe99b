"""Pictures of plots too large to be rendered in one piece."""

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

from fynjax._core.progress import stage, track
from fynjax.radiation import (
    Accuracy,
    Cells,
    Light,
    LightInWindows,
    RayLattice,
    Tiling,
    VoxelScene,
    check_light,
    cut_cells,
    render_tile,
    render_window,
    solve_cells,
    solve_light,
    tile_picture,
    voxel_values,
    window_cells,
)
from fynjax.scene._instances import hard_scene, standing_plants
from fynjax.scene._observe import AimedSensor
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._planting import OF_PLANTS, no_plants
from fynjax.scene._scene import Scene, Window
from fynjax.sensors import BandSet

_MOST_RAYS = 1500**2
"""Rays up to which a picture is rendered in one piece."""
_MOST_VOXELS, _MOST_FINEST = 5_000_000, 100_000_000
"""Voxels, and finest voxels, up to which a scene is in memory in one piece."""
_TILE = 500
"""Edge of a tile [rays], at most."""
_HELD = 2**29
"""Numbers of voxels in memory at once, about, where voxels are held window by window."""


def is_large(aimed: AimedSensor, scene: Scene) -> bool:
    """Whether a picture has so many rays, or a scene so many voxels, that it is to be rendered in
    tiles, and can be.

    Rays of a tilted camera cannot be cut, nor the light of more bands than are solved for.

    **Arguments:** `aimed`, the sensor; `scene`, what it is aimed at.
    """
    most = aimed.accuracy.solves
    few = most is None or len(aimed.sensor.bands) <= most
    rays, voxels = aimed.rays, math.prod(scene.class_grid.shape)
    finest = math.prod(scene.grid.shape) * scene.finer**3
    many = math.prod(rays.shape) > _MOST_RAYS or voxels > _MOST_VOXELS or finest > _MOST_FINEST
    return few and isinstance(rays, RayLattice) and many


class TiledPicture:
    """A large picture, rendered tile by tile with light that is solved once for the whole scene.

    It is that of `AimedSensor.observe`, without air and noise. On level ground the voxels of a
    large scene, and its plants' area elements, are made window by window: memory is that of the
    diffuse light on its coarse cells. Who watches, keeps or stops it does so between the `tiles`.

    **Arguments:**

    - `aimed`, `scene`, `parameters`: the sensor, without air, and what it is aimed at.
    - `tile`: edge of a tile [rays], at most.

    **Raises:** `InputError` where the light does not fit in memory, for rays that cannot be cut and
    for more bands than are solved for.

    Not differentiable: see `fynjax.radiation.render_tiles`.
    """

    tiles: list[tuple[int, int]]
    """Row and column of each tile."""

    def __init__(
        self, aimed: AimedSensor, scene: Scene, parameters: PlotParameters, *, tile: int = _TILE
    ) -> None:
        scene = scene.faded(False)
        accuracy, bands, rays = aimed.accuracy, aimed.sensor.bands, aimed.rays
        assert isinstance(rays, RayLattice)  # else `tile_picture` refuses them
        bare = eqx.tree_at(lambda s: s.planting, scene, no_plants(scene.dtype))
        whole = _without_voxels(bare, parameters, bands)
        # Placing the elements takes about as much again for each class.
        held = _HELD // (voxel_values(whole) + 3 * whole.area_density.shape[0])
        if scene.terrain is None and math.prod(whole.shape) > held:
            windows = _Windows(aimed, scene, parameters, whole, held)
            light_in_windows = windows.light()
            tiling = windows.tiling(light_in_windows, rays, tile)
            tiling = tiling._replace(steepest=aimed.steepest)  # layers cut as those of the whole
            draw = partial(windows.tile, light_in_windows, rays, tiling, windows.room(tiling))
        else:
            check_light(whole, accuracy)
            with stage("Light"):
                # Plants that do not stand take memory only.
                voxels = _voxels(hard_scene(scene, parameters), parameters, bands)
                light = _light(voxels, accuracy)
            tiling = tile_picture(light, rays, tile)._replace(steepest=aimed.steepest)
            draw = partial(_tile, light, rays, tiling)
        self._draw: Callable[[Array, Array], Array] = draw
        self._aimed, self._whole, self._tiling = aimed, whole, tiling
        self._factor = np.empty((len(bands), *rays.shape), scene.dtype)
        self.tiles = [*np.ndindex(*tiling.shape)]

    def render(self, tile: tuple[int, int]) -> Float[Array, "band row column"]:
        """Reflectance factor along the rays of a tile [-]."""
        return self._draw(*map(jnp.asarray, tile))

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


class _Windows:
    """A scene whose voxels are made window by window, of the plants that reach into each."""

    def __init__(
        self,
        aimed: AimedSensor,
        scene: Scene,
        parameters: PlotParameters,
        whole: VoxelScene,
        held: int,
    ) -> None:
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
            + whole.horizontal
        )
        self._planting, self._crown = planting, crown[standing]
        self._sides, self._periodic = scene.grid.extent[:2], scene.boundary == "periodic"
        self._whole, self._held, self._accuracy = whole, held, aimed.accuracy
        bare = eqx.tree_at(lambda s: s.planting, scene, no_plants(scene.dtype))
        self._make = bare, parameters, aimed.sensor.bands

    def light(self) -> LightInWindows:
        """The light of the scene."""
        whole, accuracy = self._whole, self._accuracy
        cut = cut_cells(whole, accuracy, self._held)
        room, fields = self.room(cut), None
        for place in track(np.ndindex(cut.shape), "Light", math.prod(cut.shape)):
            window, at = self._window(cut, room, *place), map(jnp.asarray, place)
            part = _cells(whole, *self._make, window, accuracy, cut, *at)
            if fields is None:
                sides = [axis.starts[-1] + axis.pixels for axis in (cut.y, cut.x)]
                fields = [np.empty((*f.shape[:-2], *sides), f.dtype) for f in part]
            for field, tile in zip(fields, part, strict=True):
                field[..., *cut.pixels(*place)] = tile
        assert fields is not None
        cells = Cells(*map(jnp.asarray, fields))
        fields.clear()
        return _solve(whole, cells, accuracy)

    def tiling(self, light: LightInWindows, rays: RayLattice, tile: int) -> Tiling:
        """A picture in tiles of `tile` rays at most, of windows that can be held."""
        most = max(rays.shape)
        for parts in range(-(-most // tile), most + 1):
            tiling = tile_picture(light, rays, -(-most // parts))
            if tiling.is_narrow(self._whole, self._held):
                break
        check_light(self._whole, self._accuracy, tiling.voxels(self._whole))
        return tiling

    def tile(
        self,
        light: LightInWindows,
        rays: RayLattice,
        tiling: Tiling,
        room: tuple[int, int],
        row: Array,
        column: Array,
    ) -> Array:
        """Reflectance factor of a tile."""
        window = self._window(tiling, room, int(row), int(column))
        return _tile_of_window(light, *self._make, window, rays, tiling, row, column)

    def room(self, tiling: Tiling) -> tuple[int, int]:
        """Most plants, and most elements, of a window."""
        found = [self._within(tiling, *place)[0] for place in np.ndindex(tiling.shape)]
        elements = [int(self._planting.count[index].sum(dtype=np.int64)) for index in found]
        return max(map(len, found)), max(elements)

    def _window(self, tiling: Tiling, room: tuple[int, int], row: int, column: int) -> Window:
        """The window of a tile, with room for as many plants and elements as any has."""
        index, foot = self._within(tiling, row, column)
        few = dataclasses.replace(self._planting.plants(index), foot=foot).with_elements()
        # One plant more at the end, without area, to which the elements left over belong.
        plants, elements = room[0] + (room[1] > 0), room[1]
        longer = lambda field, to, fill=0: np.pad(  # noqa: E731
            field, [(0, to - len(field))] + [(0, 0)] * (field.ndim - 1), constant_values=fill
        )
        few = dataclasses.replace(
            few,
            **{name: longer(getattr(few, name), plants) for name in OF_PLANTS},
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
        edge, sides = self._whole.horizontal, np.array(self._sides)
        first, columns = (np.array(pair[::-1]) * edge for pair in tiling.window(row, column))
        repeats = [range(1)] * 2
        if self._periodic:
            wide = self._reach.max(initial=0.0)
            low, high = (first - wide) / sides - 1, (first + columns + wide) / sides
            repeats = [range(math.ceil(a), math.floor(b) + 1) for a, b in zip(low, high)]
        index, feet = [], []
        for by in itertools.product(*repeats):
            foot = self._planting.foot + (by * sides - first).astype(self._planting.foot.dtype)
            reach = self._reach[:, None]
            inside = np.flatnonzero(((foot > -reach) & (foot < columns + reach)).all(axis=1))
            index.append(inside)
            feet.append(foot[inside])
        return np.concatenate(index), np.concatenate(feet)


@eqx.filter_jit
def _visible_crowns(scene: Scene, parameters: PlotParameters) -> Float[Array, " plant"]:
    return scene.visible_crowns(parameters)


@eqx.filter_jit
def _without_voxels(bare: Scene, parameters: PlotParameters, bands: BandSet) -> VoxelScene:
    """The scene as light meets it, with shapes in place of the voxels' area."""
    voxels = bare.voxels(parameters, bands)
    area, structure = jax.eval_shape(lambda: (voxels.area_density, voxels.structure))
    return dataclasses.replace(voxels, area_density=area, structure=structure)


@eqx.filter_jit
def _cells(
    whole: VoxelScene,
    bare: Scene,
    parameters: PlotParameters,
    bands: BandSet,
    window: Window,
    accuracy: Accuracy,
    cut: Tiling,
    row: Array,
    column: Array,
) -> Cells:
    voxels = bare.voxels(parameters, bands, window)
    return window_cells(whole, voxels, accuracy, cut, row, column)


@eqx.filter_jit(donate="all-except-first")
def _solve(whole: VoxelScene, cells: Cells, accuracy: Accuracy) -> LightInWindows:
    return solve_cells(whole, cells, accuracy)


@eqx.filter_jit
def _tile_of_window(
    light: LightInWindows,
    bare: Scene,
    parameters: PlotParameters,
    bands: BandSet,
    window: Window,
    rays: RayLattice,
    tiling: Tiling,
    row: Array,
    column: Array,
) -> Float[Array, "band row column"]:
    voxels = bare.voxels(parameters, bands, window)
    radiance = render_window(light, voxels, rays, tiling, row, column)
    return jnp.pi * radiance.total / voxels.illumination.incident[:, None, None]


@eqx.filter_jit
def _voxels(scene: Scene, parameters: PlotParameters, bands: BandSet) -> VoxelScene:
    return scene.voxels(parameters, bands)


@eqx.filter_jit(donate="all")
def _light(voxels: VoxelScene, accuracy: Accuracy) -> Light:
    return solve_light(voxels, accuracy)


@eqx.filter_jit
def _tile(
    light: Light, rays: RayLattice, tiling: Tiling, row: Array, column: Array
) -> Float[Array, "band row column"]:
    radiance = render_tile(light, rays, tiling, row, column)
    return jnp.pi * radiance.total / light.scene.illumination.incident[:, None, None]
