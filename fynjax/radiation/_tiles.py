"""Light and pictures of scenes on level ground that are too large to be held in one piece.

The diffuse light is smooth and takes little memory on its coarse cells: it is solved once, for the
whole scene. Its cells are means over voxels, and these are made window by window, twice: once for
the cells, once for what rays meet. A window is a tile, of cells or of pixels, with a rim as wide as
sunbeams and rays cross on their way down, so that the picture is that of the whole: without seams.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.geometry import direction
from fynjax._core.progress import track
from fynjax.radiation._image import Sight
from fynjax.radiation._multiple import Cells, DiffuseField, cells_of
from fynjax.radiation._rays import RayLattice
from fynjax.radiation._reduced import ReducedField
from fynjax.radiation._render import (
    Accuracy,
    Light,
    check_light,
    diffuse_light,
    fit_grids,
    follow_sun,
    in_whole_cells,
    look_up_to,
    render_up_to,
    sun_margin,
)
from fynjax.radiation._scene import VoxelScene
from fynjax.radiation._sun import SunField

_MOST_RIM = 25
"""Voxels of all windows together over those of the scene, up to which windows are narrowed."""


class Axis(NamedTuple):
    """How tiles and their windows lie along one axis."""

    pixels: int
    """Pixels, or cells of the diffuse light, in a tile."""
    starts: tuple[int, ...]
    """First pixel of each tile; the last may begin within the one before."""
    cells: int
    """Cells of the diffuse light in a window."""
    first: tuple[int, ...]
    """First such cell of each window; below zero, or beyond the last, where sides repeat."""

    @classmethod
    def cut(
        cls, scene: VoxelScene, count: int, places: np.ndarray, tile: int, reach: float, wide: int
    ) -> "Axis":
        """An axis of `count` voxels, with pixels at rising `places` [m] that each need the scene as
        far as `reach` [m] to either side, in tiles of `tile` pixels at most and windows of whole
        cells of `wide` voxels."""
        cell = wide * scene.horizontal
        pixels = min(tile, len(places))
        starts = tuple(min(i, len(places) - pixels) for i in range(0, len(places), pixels))
        # Whole cells that hold a tile and its rim, and one more for linear interpolation.
        lowest = [math.floor((places[i] - reach) / cell) - 1 for i in starts]
        highest = [math.ceil((places[i + pixels - 1] + reach) / cell) + 1 for i in starts]
        cells = max(high - low for low, high in zip(lowest, highest, strict=True))
        if scene.boundary == "open":
            whole = count // wide
            cells = min(cells, whole)
            lowest = [min(max(low, 0), whole - cells) for low in lowest]
        return cls(pixels, starts, cells, tuple(lowest))


class Tiling(NamedTuple):
    """Tiles of a picture, or of the cells of the diffuse light, and the window of each."""

    y: Axis
    x: Axis
    wide: int
    """Voxels along the edge of a cell of the diffuse light."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return len(self.y.starts), len(self.x.starts)

    def pixels(self, row: int, column: int) -> tuple[slice, slice]:
        """Rows and columns of the picture that are those of a tile."""
        at = ((self.y.starts[row], self.y.pixels), (self.x.starts[column], self.x.pixels))
        rows, columns = (slice(start, start + count) for start, count in at)
        return rows, columns

    def window(self, row: int, column: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Voxel columns of the window of a tile, along y and x: the first, and how many."""
        first = self.y.first[row] * self.wide, self.x.first[column] * self.wide
        return first, (self.y.cells * self.wide, self.x.cells * self.wide)

    def voxels(self, scene: VoxelScene) -> int:
        """Voxels of a window."""
        return self.y.cells * self.x.cells * self.wide**2 * scene.shape[0]


class LightInWindows:
    """The light of a scene whose voxels are not held: of windows as they are wanted.

    **Arguments:**

    - `scene`: on level ground, its sun known; of its voxels the shapes count, as of
      `jax.eval_shape`.
    - `accuracy`: as for `solve_light`; every band is solved for.
    - `held`: voxels of a window, about, where sunbeams let it be so narrow.
    - `windows`: of a `Tiling`, what makes the voxels of the window of the tile in a row and column
      (`Tiling.window`): a `VoxelScene` with open sides, of the same shape for all tiles.

    **Raises:** `InputError` where light or windows do not fit in memory.

    Not differentiable.
    """

    def __init__(
        self,
        scene: VoxelScene,
        accuracy: Accuracy,
        held: int,
        windows: Callable[[Tiling], Callable[[int, int], VoxelScene]],
    ) -> None:
        self._scene, self._accuracy, self._held, self._windows = scene, accuracy, held, windows
        self._sun_slope, self._wide, tiling = light_tiling(scene, accuracy, held)
        y, x = (n // self._wide for n in scene.shape[1:])
        voxels, fields = windows(tiling), None
        for place in track(np.ndindex(tiling.shape), "Light", math.prod(tiling.shape)):
            at = map(jnp.asarray, place)
            part = _cells_of_tile(scene, voxels(*place), accuracy, tiling, *at)
            if fields is None:
                fields = [np.empty((*f.shape[:-2], y, x), f.dtype) for f in part]
            for field, tile in zip(fields, part, strict=True):
                field[..., *tiling.pixels(*place)] = tile
        assert fields is not None
        cells = Cells(*map(jnp.asarray, fields))
        fields.clear()
        diffuse = _solve(scene, cells, accuracy)
        assert isinstance(diffuse, DiffuseField)  # every band is solved for
        self._diffuse = diffuse

    def picture(
        self, rays: RayLattice, tile: int, steepest: float
    ) -> tuple[Tiling, Callable[[int, int], Float[Array, "band row column"]]]:
        """Tiles of a picture, and what renders the one in a row and column: reflectance factor [-].

        **Arguments:**

        - `rays`: known, their rows and columns in increasing order.
        - `tile`: edge of a tile [pixels], at most.
        - `steepest`: zenith angle that no ray exceeds [degrees].

        **Raises:** `InputError` where the windows do not fit in memory.
        """
        tiling = self._tiling(rays, tile, self._held)
        voxels = self._windows(tiling)

        def render(row: int, column: int) -> Float[Array, "band row column"]:
            window, at = voxels(row, column), (jnp.asarray(row), jnp.asarray(column))
            how = self._accuracy, rays, tiling, steepest
            return _reflectance_of_tile(self._scene, self._diffuse, window, *how, at)

        return tiling, render

    def sight(
        self,
        rays: RayLattice,
        tile: int,
        steepest: float,
        held: int,
        windows: Callable[[Tiling], Callable[[int, int], VoxelScene]],
    ) -> tuple[Tiling, Callable[[int, int], Sight]]:
        """Tiles of a picture, and what rays of the one in a row and column meet first: `first_met`.

        **Arguments:** `rays`, `tile`, `steepest`, and errors, as for `picture`; `held` and
        `windows` as the class has them, whose classes may be others.
        """
        tiling = self._tiling(rays, tile, held)
        voxels = windows(tiling)

        def met(row: int, column: int) -> Sight:
            window, at = voxels(row, column), (jnp.asarray(row), jnp.asarray(column))
            how = self._accuracy, rays, tiling, steepest
            return _sight_of_tile(self._scene, window, *how, at)

        return tiling, met

    def _tiling(self, rays: RayLattice, tile: int, held: int) -> Tiling:
        slopes = np.abs([*np.asarray(rays.slope_x), *np.asarray(rays.slope_y)]).max()
        # What a ray crosses and what shades it.
        reach = float(self._scene.height * (slopes + self._sun_slope) + rays.footprint)
        y, x = np.asarray(rays.y), np.asarray(rays.x)
        return _cut(self._scene, self._accuracy, self._wide, y, x, tile, reach, held)


def light_tiling(scene: VoxelScene, accuracy: Accuracy, held: int) -> tuple[float, int, Tiling]:
    """Windows in which `LightInWindows` solves the light of a scene.

    **Arguments:** `scene`, `accuracy` and `held` as of `LightInWindows`.

    **Returns:** columns that the sun's beams cross, over layers; voxels in a cell, in width; and
    the windows.

    **Raises:** `InputError` where light or windows do not fit in memory.
    """
    sun = scene.illumination
    towards = np.asarray(direction(sun.sun_zenith, sun.sun_azimuth))
    slope = float(np.abs(towards[:2] / towards[2]).max())
    wide = fit_grids(scene, accuracy).finest[1]
    y, x = ((np.arange(n // wide) + 0.5) * wide * scene.horizontal for n in scene.shape[1:])
    reach = scene.height * slope
    return slope, wide, _cut(scene, accuracy, wide, y, x, max(len(y), len(x)), reach, held)


def _cut(
    scene: VoxelScene,
    accuracy: Accuracy,
    wide: int,
    y: np.ndarray,
    x: np.ndarray,
    tile: int,
    reach: float,
    held: int,
) -> Tiling:
    """Pixels at rising `y` and `x` [m] in tiles of `tile` at most, each with a rim of `reach` [m]:
    as wide as can be held; or as narrow as rims let it be worth while."""
    most = max(len(y), len(x))
    # More and smaller tiles until a window can be held, or rims outweigh what they save.
    for parts in range(-(-most // tile), most + 1):
        along_y, along_x = (
            Axis.cut(scene, count, places, -(-most // parts), reach, wide)
            for count, places in zip(scene.shape[1:], (y, x), strict=True)
        )
        tiling = Tiling(along_y, along_x, wide)
        each = tiling.voxels(scene)
        every = math.prod(tiling.shape) * each
        if each <= held or every > _MOST_RIM * math.prod(scene.shape):
            break
    check_light(scene, accuracy, each)
    return tiling


def _lit(scene: VoxelScene, window: VoxelScene, accuracy: Accuracy) -> tuple[VoxelScene, SunField]:
    """A window of a scene, in whole cells, and the sun in it."""
    window = in_whole_cells(window, fit_grids(scene, accuracy).factor)
    return window, follow_sun(window, accuracy, sun_margin(scene, accuracy))


@eqx.filter_jit
def _cells_of_tile(
    scene: VoxelScene,
    window: VoxelScene,
    accuracy: Accuracy,
    tiling: Tiling,
    row: Array,
    column: Array,
) -> Cells:
    """The cells of a tile, from the voxels of its window."""
    cells = cells_of(*_lit(scene, window, accuracy), fit_grids(scene, accuracy).finest)
    y, x = (
        jnp.asarray(np.subtract(axis.starts, axis.first))[at]
        for axis, at in ((tiling.y, row), (tiling.x, column))
    )

    def inner(field: Array) -> Array:
        field = jax.lax.dynamic_slice_in_dim(field, y, tiling.y.pixels, -2)
        return jax.lax.dynamic_slice_in_dim(field, x, tiling.x.pixels, -1)

    return jax.tree.map(inner, cells)


@eqx.filter_jit(donate="all-except-first")
def _solve(scene: VoxelScene, cells: Cells, accuracy: Accuracy) -> DiffuseField | ReducedField:
    return diffuse_light(scene, cells, fit_grids(scene, accuracy), accuracy)


@eqx.filter_jit
def _reflectance_of_tile(
    scene: VoxelScene,
    diffuse: DiffuseField,
    window: VoxelScene,
    accuracy: Accuracy,
    rays: RayLattice,
    tiling: Tiling,
    steepest: float,
    at: tuple[Array, Array],
) -> Float[Array, "band row column"]:
    """Reflectance factor along the rays of a tile [-], from the voxels of its window."""
    window, sun = _lit(scene, window, accuracy)

    def cut(field: Array) -> Array:
        """The window of a map of the cells, which repeats itself."""
        for place, axis, tile in ((-2, tiling.y, at[0]), (-1, tiling.x, at[1])):
            index = jnp.asarray(axis.first)[tile] + jnp.arange(axis.cells)
            field = jnp.take(field, index % field.shape[place], axis=place)
        return field

    diffuse = dataclasses.replace(
        diffuse,
        intensity=cut(diffuse.intensity),
        falling=cut(diffuse.falling),
        ground=cut(diffuse.ground),
    )
    part = _rays_of_tile(rays, tiling, scene.horizontal, *at)
    radiance = render_up_to(Light(window, sun, diffuse, accuracy), part, steepest)
    return jnp.pi * radiance.total / window.illumination.incident[:, None, None]


@eqx.filter_jit
def _sight_of_tile(
    scene: VoxelScene,
    window: VoxelScene,
    accuracy: Accuracy,
    rays: RayLattice,
    tiling: Tiling,
    steepest: float,
    at: tuple[Array, Array],
) -> Sight:
    """What rays of a tile meet first, in the voxels of its window."""
    window, sun = _lit(scene, window, accuracy)
    part = _rays_of_tile(rays, tiling, scene.horizontal, *at)
    return look_up_to(window, sun, accuracy, part, steepest)


def _rays_of_tile(
    rays: RayLattice, tiling: Tiling, horizontal: float, row: Array, column: Array
) -> RayLattice:
    """Rays of a tile, from the corner of its window."""
    of_tile = []
    for axis, at, *fields in (
        (tiling.y, row, rays.y, rays.slope_y),
        (tiling.x, column, rays.x, rays.slope_x),
    ):
        start, first = jnp.asarray(axis.starts)[at], jnp.asarray(axis.first)[at]
        place, slope = (jax.lax.dynamic_slice_in_dim(f, start, axis.pixels) for f in fields)
        # Counted from the corner of the window.
        corner = first * tiling.wide * horizontal
        of_tile.append((place - corner.astype(place.dtype), slope))
    (y, slope_y), (x, slope_x) = of_tile
    return dataclasses.replace(rays, x=x, y=y, slope_x=slope_x, slope_y=slope_y, picture=rays.ends)
