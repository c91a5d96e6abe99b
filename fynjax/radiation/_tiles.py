"""Scenes too large for one solve: tiles with a rim of their surroundings.

Light is local: what stands farther off than a few heights of the canopy, or than the longest
shadow, changes little. Each tile is solved and rendered together with a rim around it, whose outer
edge is that of a scene of its own; of the picture only the tile is kept. All tiles have one shape,
so that they share one compilation; memory is that of one, and time grows with the area.
"""

import dataclasses
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fynjax._core.errors import InputError
from fynjax.radiation._check import check_scene, check_whole, concrete, default_rim
from fynjax.radiation._image import Radiance
from fynjax.radiation._rays import RayLattice
from fynjax.radiation._render import (
    Accuracy,
    aspect,
    check_fit,
    pieces,
    render,
    solve_light,
    sun_margin,
)
from fynjax.radiation._scene import VoxelScene


def render_tiles(
    scene: VoxelScene,
    rays: RayLattice,
    accuracy: Accuracy | None = None,
    *,
    tile: int = 200,
    rim: int | None = None,
    mesh: jax.sharding.Mesh | None = None,
) -> Radiance:
    """Radiance along each ray of a large scene, solved and rendered tile by tile.

    **Arguments:**

    - `scene`: as for `solve_light`, of any size.
    - `rays`: `parallel_rays` or `nadir_rays` whose pixels cover the scene evenly from its
      south-west corner, a whole number to a tile.
    - `accuracy`: as for `solve_light`.
    - `tile`: edge of a tile [voxels]; must divide the scene's sides.
    - `rim`: width of the surroundings solved with each tile [voxels]. By default what the longest
      shadow and the most slanted ray cross, and twice the height of the scene.
    - `mesh`: devices that share the tiles, with one axis; their number must divide that of the
      tiles. By default one after another on one device.

    **Returns:** `Radiance` [irradiance unit sr-1]. It differs from that of the whole scene by what
    lies beyond the rim (measured in `tests/radiation/test_tiles.py`).

    **Raises:** `InputError` where tiles, pixels and devices do not go together.

    Differentiable as `render`; the backward pass solves each tile once more.
    """
    check_scene(scene)
    _, ny, nx = scene.shape
    if not isinstance(rays, RayLattice):
        raise InputError(
            "`rays` must be those of `parallel_rays` or `nadir_rays`, whose pixels can be cut "
            f"along the tiles, but are a {type(rays).__name__}: for a tilted camera render the "
            "whole scene (`solve_light`, `render`)"
        )
    check_whole("tile", tile)
    if rim is not None:
        check_whole("rim", rim, 0)
    for size, axis in ((ny, "y"), (nx, "x")):
        if size % tile:
            raise InputError(
                f"`tile` must divide the scene, but {tile} does not divide its {size} voxels "
                f"along {axis}"
            )
    rows, columns = ny // tile, nx // tile
    for pixels, tiles, axis in ((rays.y.shape[0], rows, "y"), (rays.x.shape[0], columns, "x")):
        if pixels % tiles:
            raise InputError(
                f"each tile must have the same number of pixels, but {pixels} along {axis} do "
                f"not spread over {tiles} tiles"
            )
        _check_cover(axis, getattr(rays, axis), scene.horizontal * tiles * tile)
    devices = 1 if mesh is None else mesh.size
    if rows * columns % devices:
        raise InputError(
            f"the number of devices must divide the tiles, but there are {devices} for "
            f"{rows * columns}"
        )
    if mesh is not None and len(mesh.axis_names) != 1:
        raise InputError(f"`mesh` must have one axis, but has {len(mesh.axis_names)}")
    rim = _default_rim(scene, rays) if rim is None else rim + rim % 2
    width = tile + 2 * rim
    accuracy = Accuracy() if accuracy is None else accuracy
    check_fit(scene, accuracy, width)
    sublayers = accuracy.sublayers or pieces(scene.illumination.sun_zenith, aspect(scene))
    accuracy = dataclasses.replace(
        accuracy, margin=sun_margin(scene, accuracy), sublayers=sublayers
    )
    high, wide = rays.y.shape[0] // rows, rays.x.shape[0] // columns
    surrounded = _surrounded(scene, rim)

    def render_tile(place: Array, surrounded: VoxelScene, rays: RayLattice) -> Radiance:
        row, column = place[0], place[1]

        def cut(field: Array, times: int) -> Array:
            wide = width * times
            field = jax.lax.dynamic_slice_in_dim(field, row * tile * times, wide, -2)
            return jax.lax.dynamic_slice_in_dim(field, column * tile * times, wide, -1)

        part = _with_maps(surrounded, cut)
        pixels = lambda axis, at, size: jax.lax.dynamic_slice_in_dim(axis, at * size, size)  # noqa: E731
        # The part's own origin is the outer corner of its rim.
        shift = lambda at: (at * tile - rim) * scene.horizontal  # noqa: E731
        rays_of_tile = eqx.tree_at(
            lambda r: (r.x, r.y, r.slope_x, r.slope_y),
            rays,
            (
                pixels(rays.x, column, wide) - shift(column),
                pixels(rays.y, row, high) - shift(row),
                pixels(rays.slope_x, column, wide),
                pixels(rays.slope_y, row, high),
            ),
        )
        return render(solve_light(part, accuracy), rays_of_tile)

    def render_in_turn(places: Array, surrounded: VoxelScene, rays: RayLattice) -> Radiance:
        return jax.lax.map(
            jax.checkpoint(lambda place: render_tile(place, surrounded, rays)), places
        )

    places = jnp.asarray(list(np.ndindex(rows, columns)))
    if mesh is not None:
        (axis,) = mesh.axis_names
        split = jax.sharding.PartitionSpec(axis)
        whole = jax.sharding.PartitionSpec()
        # Devices only: how arrays lie on them outside is the compiler's business.
        mesh = jax.sharding.Mesh(mesh.devices, mesh.axis_names)
        render_in_turn = jax.shard_map(
            render_in_turn,
            mesh=mesh,
            in_specs=(split, whole, whole),
            out_specs=split,
            check_vma=False,
        )
    parts = render_in_turn(places, surrounded, rays)

    def join(field: Array) -> Array:
        """[tile, ..., row, column] to [..., row, column]."""
        field = field.reshape(rows, columns, *field.shape[1:])
        field = jnp.moveaxis(jnp.moveaxis(field, 0, -3), 0, -2)
        return field.reshape(*field.shape[:-4], rows * high, columns * wide)

    return jax.tree.map(join, parts)


def _default_rim(scene: VoxelScene, rays: RayLattice) -> int:
    zenith = scene.illumination.sun_zenith
    if not concrete(rays, zenith):
        raise InputError(
            "`rim` must be given where the sun or the view is a traced value: twice the height "
            "of the scene and the length of its longest shadow, in voxels"
        )
    slants = np.abs([*np.asarray(rays.slope_x), *np.asarray(rays.slope_y)])
    return default_rim(scene, max(math.tan(math.radians(float(zenith))), float(slants.max())))


def _check_cover(axis: str, centres: Array, length: float) -> None:
    """Raise `InputError` unless pixels, where they are known, divide `length` evenly."""
    if not concrete(centres):
        return
    pitch = length / centres.shape[0]
    place, wanted = np.asarray(centres), (np.arange(centres.shape[0]) + 0.5) * pitch
    off = np.abs(place - wanted)
    if off.max() > 0.05 * pitch:
        worst = int(off.argmax())
        raise InputError(
            f"the pixels must cover the scene evenly from its south-west corner, but along {axis} "
            f"pixel {worst} has its centre at {place[worst]:g} m in place of "
            f"{wanted[worst]:g} m: are these edges of pixels, does the picture cover only a part, "
            "or is its first row the northern one?"
        )


def _with_maps(scene: VoxelScene, change: Callable[[Array, int], Array]) -> VoxelScene:
    """The scene with its maps over y and x changed; `change` also takes the number of their cells
    along a voxel."""
    times = scene.structure_factor[1]
    return dataclasses.replace(
        scene,
        area_density=change(scene.area_density, 1),
        structure=None if scene.structure is None else change(scene.structure, times),
        ground=change(scene.ground_map, 1),
        terrain=None if scene.terrain is None else change(scene.terrain, 1),
    )


def _surrounded(scene: VoxelScene, rim: int) -> VoxelScene:
    """The scene with a rim: of itself, or of nothing where its sides are open."""
    mode = "wrap" if scene.boundary == "periodic" else "constant"

    def widen(field: Array, times: int) -> Array:
        before = [(0, 0)] * (field.ndim - 2)
        sides = (rim * times, rim * times)
        return jnp.pad(field, [*before, sides, sides], mode=mode)

    return _with_maps(scene, widen)
