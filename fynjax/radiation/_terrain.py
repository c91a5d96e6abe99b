"""Ground that is not flat: a height field inside the voxel grid.

On each horizontal plane a share of every voxel column lies below the ground. A ray that comes
down has ended on the ground by the largest share that it has met (as the same part of a pixel
stays blocked), which is continuous in the heights, and so differentiable.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.radiation._resample import axis_weights, resample
from fynjax.radiation._scene import VoxelScene

_HORIZON = 128


def terrain_gradient(scene: VoxelScene) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """Slope of the ground eastward and northward [-], by central differences."""
    assert scene.terrain is not None
    height = scene.terrain
    mode = "wrap" if scene.boundary == "periodic" else "edge"
    padded = jnp.pad(height, 1, mode=mode)
    east = padded[1:-1, 2:] - padded[1:-1, :-2]
    north = padded[2:, 1:-1] - padded[:-2, 1:-1]
    # At the edge of an open scene the difference spans one voxel, not two.
    span = jnp.full(height.shape, 2.0 * scene.horizontal, height.dtype)
    if scene.boundary == "open":
        width = scene.horizontal
        return (
            east / span.at[:, 0].set(width).at[:, -1].set(width),
            north / span.at[0].set(width).at[-1].set(width),
        )
    return east / span, north / span


def terrain_normal(scene: VoxelScene) -> Float[Array, "3 y x"]:
    """Upward unit normal of the ground."""
    east, north = terrain_gradient(scene)
    normal = jnp.stack([-east, -north, jnp.ones_like(east)])
    return normal / jnp.linalg.norm(normal, axis=0)


def covered(scene: VoxelScene, heights: Float[Array, " plane"]) -> Float[Array, "plane y x"]:
    """Share of each voxel column that lies below the ground on horizontal planes [-].

    The ground within a column spans what its slope gives, and at least one layer: what a voxel
    cannot resolve is spread over it.
    """
    assert scene.terrain is not None
    east, north = terrain_gradient(scene)
    # Height that the ground spans within a voxel column.
    spread = jnp.maximum(scene.horizontal * (jnp.abs(east) + jnp.abs(north)), scene.vertical)
    above = scene.terrain[None] - heights[:, None, None]
    return jnp.clip(0.5 + above / spread, 0.0, 1.0)


def ground_in_cells(
    scene: VoxelScene, factor: tuple[int, int]
) -> tuple[Float[Array, "Z Y X"], Float[Array, "Z Y X"]]:
    """For cells of `factor` = (layers, columns) voxels: the share of what falls through a cell
    that ends on the ground at its bottom, and of what comes in through a side that ends in it."""
    nz, ny, nx = scene.shape
    fz, fh = factor
    dtype = scene.area_density.dtype
    heights = (jnp.arange(nz // fz + 1) * (fz * scene.vertical)).astype(dtype)
    below = covered(scene, heights).at[0].set(1.0)  # nothing falls out of the grid
    below = below.reshape(-1, ny // fh, fh, nx // fh, fh).mean(axis=(2, 4))
    free = 1.0 - below[1:]
    # Of what is still free at the top of the cell, what is no longer so at its bottom.
    share = jnp.where(free > 1e-6, (below[:-1] - below[1:]) / jnp.maximum(free, 1e-6), 1.0)
    # A column that is mostly under ground at the top of a cell is a wall to its neighbours.
    return share, jnp.clip(2.0 * below[1:] - 1.0, 0.0, 1.0)


def sun_on_ground(
    scene: VoxelScene, towards_sun: Float[Array, " 3"], most_steps: int
) -> Float[Array, "y x"]:
    """Direct irradiance on the ground's surface over that on a level plane, canopy apart [-].

    Lambert's cosine on the slope, times the share that no other ground shades: the clearance of
    the beam above the height field, followed for `most_steps` voxels.
    """
    assert scene.terrain is not None
    _, ny, nx = scene.shape
    height = scene.terrain
    normal = terrain_normal(scene)
    cosine = jnp.maximum(jnp.tensordot(towards_sun, normal, axes=1), 0.0) / towards_sun[2]
    slope = towards_sun[:2] / towards_sun[2]
    # The root is guarded: under a sun overhead nothing is shaded, and nothing is undefined.
    run = jnp.sqrt(jnp.maximum(jnp.sum(slope**2), 1e-6))
    step = scene.horizontal / run  # height gained per voxel of ground
    # An edge of shadow is as soft as a voxel is wide: by so much the clearance of the beams varies
    # over a voxel, level or tilted. (So a plane never shades itself.)
    edge = step * jnp.maximum(cosine / normal[2], 1e-3)
    x = (jnp.arange(nx, dtype=height.dtype) + 0.5) * scene.horizontal
    y = (jnp.arange(ny, dtype=height.dtype) + 0.5) * scene.horizontal
    width = scene.horizontal

    def follow(lit: Array, count: Array) -> tuple[Array, None]:
        rise = count * step
        columns = axis_weights(x + rise * slope[0], width, nx, width, scene.boundary)
        rows = axis_weights(y + rise * slope[1], width, ny, width, scene.boundary)
        inside = rows.sum(axis=1)[:, None] * columns.sum(axis=1)
        clearance = height + rise - resample(height, rows, columns)
        share = jnp.clip(0.5 + clearance / edge, 0.0, 1.0)
        return jnp.minimum(lit, jnp.where(inside > 0.5, share, 1.0)), None

    # The first voxel is the ground's own slope, which the cosine has.
    counts = jnp.arange(2, most_steps + 1).astype(height.dtype)
    lit, _ = jax.lax.scan(follow, jnp.ones_like(height), counts)
    return cosine * lit


def exposure(scene: VoxelScene, vectors: np.ndarray) -> Float[Array, "downward y x"]:
    """The same for light that travels along each of the downward unit `vectors`.

    Not followed for more than some hundred voxels: a horizon farther off than that is left out.
    """
    _, ny, nx = scene.shape
    steps = min(max(ny, nx), _HORIZON)
    assert scene.terrain is not None
    towards = jnp.asarray(-vectors, scene.terrain.dtype)
    return jax.lax.map(jax.checkpoint(lambda s: sun_on_ground(scene, s, steps)), towards)


def with_adjacent_ground(
    scene: VoxelScene, vectors: np.ndarray, fluxes: np.ndarray
) -> Float[Array, "band y x"]:
    """Reflectance of the ground, with what it sends to ground nearby and gets back.

    A slope with the sky view factor V faces ground like itself in the rest of its hemisphere: r is
    then r / (1 - r (1 - V)) (after Dozier and Frew 1990), exact under even light.
    """
    weights = jnp.asarray(fluxes, scene.ground.dtype) / jnp.pi
    sky_view = jnp.tensordot(weights, exposure(scene, vectors), axes=1)
    hidden = jnp.clip(1.0 - sky_view, 0.0, 0.95)
    return scene.ground_map / (1.0 - scene.ground_map * hidden)
