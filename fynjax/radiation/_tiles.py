"""Pictures too large to be rendered in one piece.

The light is solved once, for the whole scene; its diffuse part is smooth and takes little memory
on its coarse cells. What grows with the picture is what the rays meet on their way down, so the
picture is rendered tile by tile, each from the window of the scene that its rays and the sunbeams
which they meet can cross. The tiles together are the picture of the whole: there are no seams.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fynjax._core.errors import InputError
from fynjax.radiation._check import check_whole, concrete
from fynjax.radiation._image import Radiance
from fynjax.radiation._multiple import DiffuseField
from fynjax.radiation._rays import RayLattice
from fynjax.radiation._render import Light, render_up_to


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

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return len(self.y.starts), len(self.x.starts)

    def pixels(self, row: int, column: int) -> tuple[slice, slice]:
        """Rows and columns of the picture that are those of a tile."""
        at = ((self.y.starts[row], self.y.pixels), (self.x.starts[column], self.x.pixels))
        rows, columns = (slice(start, start + count) for start, count in at)
        return rows, columns


def tile_picture(light: Light, rays: RayLattice, tile: int = 500) -> Tiling:
    """Cut the picture of `rays` in tiles of `tile` pixels, or fewer where it is smaller.

    **Arguments:**

    - `light`: from `solve_light`.
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
    if not concrete(rays, light.sun.slope):
        raise InputError(
            "sun and rays must be known where a picture is cut in tiles, but are traced: call "
            "`tile_picture` outside the transformation"
        )
    scene = light.scene
    slopes = np.abs([*np.asarray(rays.slope_x), *np.asarray(rays.slope_y)]).max()
    # What a ray crosses and what shades it; a cell more, for the light is interpolated.
    reach = scene.height * (slopes + float(jnp.abs(light.sun.slope).max())) + rays.footprint
    cell = light.diffuse.factor(scene)[1] * scene.horizontal
    axes = []
    for centres, count in ((rays.y, scene.shape[1]), (rays.x, scene.shape[2])):
        at, whole = np.asarray(centres, float), round(count * scene.horizontal / cell)
        pixels = min(tile, len(at))
        starts = tuple(min(i, len(at) - pixels) for i in range(0, len(at), pixels))
        lowest = [math.floor((at[i] - reach) / cell) - 1 for i in starts]
        highest = [math.ceil((at[i + pixels - 1] + reach) / cell) + 1 for i in starts]
        cells = max(high - low for low, high in zip(lowest, highest, strict=True))
        if scene.boundary == "open":
            cells = min(cells, whole)
            lowest = [min(max(low, 0), whole - cells) for low in lowest]
        axes.append(_Axis(pixels, starts, cells, tuple(lowest)))
    steepest = math.hypot(*(np.abs(np.asarray(s)).max() for s in (rays.slope_x, rays.slope_y)))
    return Tiling(axes[0], axes[1], math.degrees(math.atan(steepest)))


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
    along = (tiling.y, row), (tiling.x, column)
    first = [jnp.asarray(axis.first)[at] for axis, at in along]
    start = [jnp.asarray(axis.starts)[at] for axis, at in along]
    window = _window(light, (first[0], first[1]), (tiling.y.cells, tiling.x.cells))
    cell = light.diffuse.factor(light.scene)[1] * light.scene.horizontal
    cut = [
        [jax.lax.dynamic_slice_in_dim(field, at, axis.pixels) for field in fields]
        for (axis, _), at, fields in zip(
            along, start, ((rays.y, rays.slope_y), (rays.x, rays.slope_x)), strict=True
        )
    ]
    (y, slope_y), (x, slope_x) = cut
    part = dataclasses.replace(
        rays,
        x=x - (first[1] * cell).astype(x.dtype),
        y=y - (first[0] * cell).astype(y.dtype),
        slope_x=slope_x,
        slope_y=slope_y,
        picture=rays.ends,
    )
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


def _window(light: Light, first: tuple[Array, Array], cells: tuple[int, int]) -> Light:
    """The light in a part of its scene: `cells` of the diffuse light from the `first` on."""
    scene, sun, diffuse = light.scene, light.sun, light.diffuse
    assert isinstance(diffuse, DiffuseField)
    wide = diffuse.factor(scene)[1]

    def cut(field: Array, times: int, more: int = 0) -> Array:
        """Of a map with `times` entries along a cell, and `more` at each end."""
        for axis, start, count in ((-2, first[0], cells[0]), (-1, first[1], cells[1])):
            index = start * times + jnp.arange(count * times + 2 * more)
            field = jnp.take(field, index % field.shape[axis], axis=axis)
        return field

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
    field = dataclasses.replace(
        diffuse, intensity=cut(diffuse.intensity, 1), falling=cut(diffuse.falling, 1)
    )
    return dataclasses.replace(light, scene=part, sun=beams, diffuse=field)
