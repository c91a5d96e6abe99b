"""Pictures too large to be rendered in one piece, of scenes too large to be held in one.

The light is solved once, for the whole scene; its diffuse part is smooth and takes little memory
on its coarse cells. What grows with the picture is what the rays meet on their way down, so the
picture is rendered tile by tile, each from the window of the scene that its rays and the sunbeams
which they meet can cross. The tiles together are the picture of the whole: there are no seams.

Nor need all voxels be held for the light: its cells are means over voxels, which are made window by
window (`window_cells`), each with a rim as wide as a sunbeam crosses on its way down.
"""

import dataclasses
import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.geometry import direction
from fynjax.radiation._check import check_whole, concrete
from fynjax.radiation._image import Radiance
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
    render_up_to,
    sun_margin,
)
from fynjax.radiation._scene import VoxelScene

_MOST_RIM = 25
"""Voxels of all windows together over those of the scene, up to which windows are narrowed."""


class _Axis(NamedTuple):
    """How a picture and its scene are cut along one axis."""

    pixels: int
    """Of a tile."""
    starts: tuple[int, ...]
    """First pixel of each tile; the last may begin within the one before."""
    cells: int
    """Of the diffuse light in a window."""
    first: tuple[int, ...]
    """First such cell of each window; below zero, or beyond the last, where sides repeat."""


class Tiling(NamedTuple):
    """How a picture is cut in tiles; `tile_picture` makes one."""

    y: _Axis
    x: _Axis
    steepest: float
    """Largest zenith angle of a ray [degrees]."""
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
        """The voxel columns that a tile takes, along y and x: the first, and how many."""
        first = self.y.first[row] * self.wide, self.x.first[column] * self.wide
        return first, (self.y.cells * self.wide, self.x.cells * self.wide)

    def voxels(self, scene: VoxelScene) -> int:
        """Voxels of a window."""
        return self.y.cells * self.x.cells * self.wide**2 * scene.shape[0]

    def is_narrow(self, scene: VoxelScene, held: int) -> bool:
        """Whether a window has `held` voxels at most; or is so much rim already, as under a low
        sun, that narrower ones would cost more than they save."""
        each = self.voxels(scene)
        return each <= held or math.prod(self.shape) * each > _MOST_RIM * math.prod(scene.shape)


class LightInWindows(eqx.Module):
    """The diffuse light of a scene whose voxels are not held; `solve_cells` makes one."""

    scene: VoxelScene
    """With shapes in place of the voxels' area."""
    diffuse: DiffuseField | ReducedField
    accuracy: Accuracy


def tile_picture(light: Light | LightInWindows, rays: RayLattice, tile: int = 500) -> Tiling:
    """Cut the picture of `rays` in tiles of `tile` pixels, or fewer where it is smaller.

    **Arguments:**

    - `light`: from `solve_light` or `solve_cells`.
    - `rays`: `parallel_rays` or `nadir_rays`.
    - `tile`: edge of a tile [pixels].

    **Raises:** `InputError` for rays that cannot be cut, light of more bands than were solved for,
    and where the sun or the rays are traced values: cut the picture outside the transformation.
    """
    check_whole("tile", tile)
    if not isinstance(rays, RayLattice):
        raise InputError(
            "`rays` must be those of `parallel_rays` or `nadir_rays`, whose pixels can be cut in "
            f"tiles, but are a {type(rays).__name__}: render the picture in one (`render`)"
        )
    if concrete(rays) and any(np.any(np.diff(centres) <= 0) for centres in (rays.y, rays.x)):
        raise InputError(
            "pixels must lie in increasing order, but do not: is the first row of the picture its "
            "northern one?"
        )
    if not isinstance(light.diffuse, DiffuseField):
        raise InputError(
            "a picture in tiles needs the light of every band, but that of many bands was reduced "
            "to a few: render fewer bands at once, or set `accuracy.solves` to None"
        )
    scene = light.scene
    towards = light.sun.slope if isinstance(light, Light) else _sun_slope(scene)
    if not concrete(rays, towards):
        raise InputError(
            "sun and rays must be known where a picture is cut in tiles, but are traced: call "
            "`tile_picture` outside the transformation"
        )
    slopes = np.abs([*np.asarray(rays.slope_x), *np.asarray(rays.slope_y)]).max()
    # What a ray crosses and what shades it; a cell more, for the light is interpolated.
    reach = scene.height * (slopes + float(jnp.abs(towards).max())) + rays.footprint
    wide = light.diffuse.factor(scene)[1]
    y, x = (
        _axis(scene, count, np.asarray(centres, float), tile, reach, wide)
        for centres, count in zip((rays.y, rays.x), scene.shape[1:], strict=True)
    )
    steepest = math.hypot(*(np.abs(np.asarray(s)).max() for s in (rays.slope_x, rays.slope_y)))
    return Tiling(y, x, math.degrees(math.atan(steepest)), wide)


def _axis(
    scene: VoxelScene,
    count: int,
    places: Float[np.ndarray, " pixel"],
    tile: int,
    reach: float,
    wide: int,
) -> _Axis:
    """Cut an axis of `count` voxels, with pixels at rising `places` [m] that each need the scene as
    far as `reach` [m] to either side, in tiles of `tile` pixels and windows of whole cells of
    `wide` voxels."""
    cell = wide * scene.horizontal
    pixels = min(tile, len(places))
    starts = tuple(min(i, len(places) - pixels) for i in range(0, len(places), pixels))
    lowest = [math.floor((places[i] - reach) / cell) - 1 for i in starts]
    highest = [math.ceil((places[i + pixels - 1] + reach) / cell) + 1 for i in starts]
    cells = max(high - low for low, high in zip(lowest, highest, strict=True))
    if scene.boundary == "open":
        whole = count // wide
        cells = min(cells, whole)
        lowest = [min(max(low, 0), whole - cells) for low in lowest]
    return _Axis(pixels, starts, cells, tuple(lowest))


def _sun_slope(scene: VoxelScene) -> Float[Array, " 2"]:
    """Horizontal distance per height along a sunbeam, (x, y) [-]."""
    sun = scene.illumination
    towards = direction(sun.sun_zenith, sun.sun_azimuth)
    return towards[:2] / towards[2]


def cut_cells(scene: VoxelScene, accuracy: Accuracy, held: int) -> Tiling:
    """Cut the cells of a scene's diffuse light in tiles, to be made of its voxels window by window.

    **Arguments:**

    - `scene`: on level ground, its sun known; of its voxels the shapes count, as of
      `jax.eval_shape`.
    - `accuracy`: as for `solve_light`.
    - `held`: voxels of a window, about, where sunbeams let it be so narrow.

    **Raises:** `InputError` as `check_light`.
    """
    wide = fit_grids(scene, accuracy).finest[1]
    reach = scene.height * float(jnp.abs(_sun_slope(scene)).max())
    counts = [count // wide for count in scene.shape[1:]]
    centres = [(np.arange(count) + 0.5) * wide * scene.horizontal for count in counts]
    for parts in range(1, max(counts) + 1):
        y, x = (
            _axis(scene, count, places, -(-len(places) // parts), reach, wide)
            for places, count in zip(centres, scene.shape[1:], strict=True)
        )
        tiling = Tiling(y, x, 0.0, wide)
        if tiling.is_narrow(scene, held):
            break
    check_light(scene, accuracy, tiling.voxels(scene))
    return tiling


def window_cells(
    scene: VoxelScene,
    voxels: VoxelScene,
    accuracy: Accuracy,
    tiling: Tiling,
    row: Array | int,
    column: Array | int,
) -> Cells:
    """The cells of a tile of `cut_cells`, from the voxels of its window.

    **Arguments:**

    - `scene`, `accuracy`, `tiling`: as for `cut_cells`, and from it.
    - `voxels`: of the window (`Tiling.window`), with open sides.
    - `row`, `column`: of the tile; may be traced values.
    """
    fit = fit_grids(scene, accuracy)
    voxels = in_whole_cells(voxels, fit.factor)
    sun = follow_sun(voxels, accuracy, sun_margin(scene, accuracy))
    cells = cells_of(voxels, sun, fit.finest)
    y, x = (
        jnp.asarray(np.subtract(axis.starts, axis.first))[at]
        for axis, at in ((tiling.y, row), (tiling.x, column))
    )

    def inner(field: Array) -> Array:
        field = jax.lax.dynamic_slice_in_dim(field, y, tiling.y.pixels, -2)
        return jax.lax.dynamic_slice_in_dim(field, x, tiling.x.pixels, -1)

    return jax.tree.map(inner, cells)


def solve_cells(scene: VoxelScene, cells: Cells, accuracy: Accuracy) -> LightInWindows:
    """Solve for the diffuse light of a scene from the cells of all its windows.

    **Arguments:**

    - `scene`, `accuracy`: as for `cut_cells`.
    - `cells`: from `window_cells`, put together.
    """
    fit = fit_grids(scene, accuracy)
    diffuse = diffuse_light(scene, cells, fit, accuracy)
    whole = jax.eval_shape(partial(in_whole_cells, factor=fit.factor), scene)
    scene = dataclasses.replace(scene, area_density=whole.area_density, structure=whole.structure)
    return LightInWindows(scene, diffuse, accuracy)


def render_tile(
    light: Light, rays: RayLattice, tiling: Tiling, row: Array | int, column: Array | int
) -> Radiance:
    """Radiance of one tile of a picture [irradiance unit sr-1].

    **Arguments:**

    - `light`, `rays`: as for `tile_picture`.
    - `tiling`: from `tile_picture`; static.
    - `row`, `column`: of the tile; may be traced values, so that all tiles share a compilation.

    Differentiable as `render`. Memory is that of the window of the scene that the tile views.
    """
    return _render_through(_window(light, tiling, row, column), rays, tiling, row, column)


def render_window(
    light: LightInWindows,
    voxels: VoxelScene,
    rays: RayLattice,
    tiling: Tiling,
    row: Array | int,
    column: Array | int,
) -> Radiance:
    """`render_tile` of a scene whose voxels are not held.

    **Arguments:**

    - `light`: from `solve_cells`.
    - `voxels`: of the tile's window (`Tiling.window`), with open sides.
    - `rays`, `tiling`, `row`, `column`: as for `render_tile`.
    """
    voxels = in_whole_cells(voxels, fit_grids(light.scene, light.accuracy).factor)
    sun = follow_sun(voxels, light.accuracy, sun_margin(light.scene, light.accuracy))
    assert isinstance(light.diffuse, DiffuseField)
    diffuse = _window_of_field(light.diffuse, tiling, row, column)
    window = Light(voxels, sun, diffuse, light.accuracy)
    return _render_through(window, rays, tiling, row, column)


def _render_through(
    window: Light, rays: RayLattice, tiling: Tiling, row: Array | int, column: Array | int
) -> Radiance:
    """A tile of a picture, of the light in its window."""
    cell = tiling.wide * window.scene.horizontal
    cut = []
    for axis, at, *fields in (
        (tiling.y, row, rays.y, rays.slope_y),
        (tiling.x, column, rays.x, rays.slope_x),
    ):
        start, first = jnp.asarray(axis.starts)[at], jnp.asarray(axis.first)[at]
        place, slope = (jax.lax.dynamic_slice_in_dim(f, start, axis.pixels) for f in fields)
        cut.append((place - (first * cell).astype(place.dtype), slope))
    (y, slope_y), (x, slope_x) = cut
    part = dataclasses.replace(rays, x=x, y=y, slope_x=slope_x, slope_y=slope_y, picture=rays.ends)
    return render_up_to(window, part, tiling.steepest)


def render_tiles(
    light: Light,
    rays: RayLattice,
    tiling: Tiling | None = None,
    *,
    mesh: jax.sharding.Mesh | None = None,
) -> Radiance:
    """Radiance along each ray of a picture, tile by tile: what `render` gives, in less memory.

    **Arguments:**

    - `light`: from `solve_light`.
    - `rays`: `parallel_rays` or `nadir_rays`.
    - `tiling`: from `tile_picture`, by default in tiles of 500 pixels; must be given inside a
      transformation.
    - `mesh`: devices that share the tiles, with one axis; their number must divide that of the
      tiles. By default one after another on one device.

    **Returns:** `Radiance` [irradiance unit sr-1].

    **Raises:** `InputError` as `tile_picture`, and where tiles and devices do not go together.

    Differentiable as `render`; the backward pass renders each tile once more.
    """
    tiling = tile_picture(light, rays) if tiling is None else tiling
    rows, columns = tiling.shape
    devices = 1 if mesh is None else mesh.size
    if rows * columns % devices:
        raise InputError(
            f"the number of devices must divide the tiles, but there are {devices} for "
            f"{rows * columns}"
        )
    if mesh is not None and len(mesh.axis_names) != 1:
        raise InputError(f"`mesh` must have one axis, but has {len(mesh.axis_names)}")

    def in_turn(places: Array, light: Light, rays: RayLattice) -> Radiance:
        one = lambda place: render_tile(light, rays, tiling, *place)  # noqa: E731
        return jax.lax.map(jax.checkpoint(one), places)

    render_in_turn: Any = in_turn
    if mesh is not None:
        (axis,) = mesh.axis_names
        split = jax.sharding.PartitionSpec(axis)
        whole = jax.sharding.PartitionSpec()
        # Devices only: how arrays lie on them outside is the compiler's business.
        mesh = jax.sharding.Mesh(mesh.devices, mesh.axis_names)
        render_in_turn = jax.shard_map(
            in_turn, mesh=mesh, in_specs=(split, whole, whole), out_specs=split, check_vma=False
        )
    parts = render_in_turn(jnp.asarray(list(np.ndindex(rows, columns))), light, rays)

    def join(field: Array) -> Array:
        """[tile, ..., row, column] to [..., row, column]."""
        field = field.reshape(rows, columns, *field.shape[1:])
        for axis, place in ((tiling.y, -2), (tiling.x, -1)):
            pixel = np.arange(axis.starts[-1] + axis.pixels)
            tile = pixel // axis.pixels
            within = pixel - np.asarray(axis.starts)[tile]
            field = jnp.moveaxis(jnp.moveaxis(field, place, 1)[tile, within], 0, place)
        return field

    return jax.tree.map(join, parts)


def _window(light: Light, tiling: Tiling, row: Array | int, column: Array | int) -> Light:
    """The light in the window of a tile."""
    scene, sun, wide = light.scene, light.sun, tiling.wide
    assert isinstance(light.diffuse, DiffuseField)
    cut = partial(_cut, tiling, row, column)
    optional = lambda field, times: None if field is None else cut(field, times)  # noqa: E731
    part = dataclasses.replace(
        scene,
        area_density=cut(scene.area_density, wide),
        structure=optional(scene.structure, wide * scene.structure_factor[1]),
        ground=cut(scene.ground_map, wide),
        terrain=optional(scene.terrain, wide),
        boundary="open",
    )
    beams = dataclasses.replace(
        sun,
        depth=cut(sun.depth, wide * sun.per_voxel, sun.margin),
        incidence=optional(sun.incidence, wide),
    )
    field = _window_of_field(light.diffuse, tiling, row, column)
    return dataclasses.replace(light, scene=part, sun=beams, diffuse=field)


def _window_of_field(
    diffuse: DiffuseField, tiling: Tiling, row: Array | int, column: Array | int
) -> DiffuseField:
    """The diffuse light in the window of a tile."""
    cut = partial(_cut, tiling, row, column, times=1)
    return dataclasses.replace(
        diffuse, intensity=cut(diffuse.intensity), falling=cut(diffuse.falling)
    )


def _cut(
    tiling: Tiling,
    row: Array | int,
    column: Array | int,
    field: Array,
    times: int,
    more: int = 0,
) -> Array:
    """The window of a map with `times` entries along a cell, and `more` at each end."""
    for place, axis, at in ((-2, tiling.y, row), (-1, tiling.x, column)):
        index = jnp.asarray(axis.first)[at] * times + jnp.arange(axis.cells * times + 2 * more)
        field = jnp.take(field, index % field.shape[place], axis=place)
    return field
