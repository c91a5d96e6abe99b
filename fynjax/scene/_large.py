"""Pictures of plots too large to be rendered in one piece."""

import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.checkpoint import Keep, keep_nothing
from fynjax._core.progress import NullProgress, Progress
from fynjax.radiation import (
    Accuracy,
    Light,
    RayLattice,
    Tiling,
    VoxelScene,
    check_light,
    render_tile,
    solve_light,
    tile_picture,
)
from fynjax.scene._instances import standing_scene
from fynjax.scene._observe import AimedSensor
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene
from fynjax.sensors import BandSet

_MOST_RAYS = 1500**2
"""Rays up to which a picture is rendered in one piece."""
_TILE = 500
"""Edge of a tile [rays]."""


def is_large(aimed: AimedSensor) -> bool:
    """Whether a picture has so many rays that it is to be rendered in tiles, and can be.

    Rays of a tilted camera cannot be cut, nor the light of more bands than are solved for.

    **Arguments:** `aimed`, the sensor.
    """
    most = aimed.accuracy.solves
    few = most is None or len(aimed.sensor.bands) <= most
    rays = aimed.rays
    return few and isinstance(rays, RayLattice) and math.prod(rays.shape) > _MOST_RAYS


def observe_in_tiles(
    aimed: AimedSensor,
    scene: Scene,
    parameters: PlotParameters,
    *,
    tile: int = _TILE,
    keep: Keep = keep_nothing,
    progress: Progress | None = None,
) -> Float[Array, "band y x"]:
    """Reflectance factor of the pixels of a large picture, without air and noise [-].

    The light is solved once, for the whole scene, and the picture rendered tile by tile; it is that
    of `AimedSensor.observe`.

    **Arguments:**

    - `aimed`, `scene`, `parameters`: the sensor, without air, and what it is aimed at.
    - `tile`: edge of a tile [rays].
    - `keep`: how a tile is done, such as by a `Journal`, which keeps those of an interrupted run.
    - `progress`: where to report the stages and the tiles; nowhere by default.

    **Raises:** `InputError` where the light does not fit in memory, for rays that cannot be cut and
    for more bands than are solved for.

    Not differentiable: see `fynjax.radiation.render_tiles`.
    """
    report = NullProgress() if progress is None else progress
    bands = aimed.sensor.bands
    check_light(jax.eval_shape(lambda p: scene.voxels(p, bands), parameters), aimed.accuracy)
    with report.stage("Light"):
        # Plants that do not stand take memory only.
        voxels = _voxels(standing_scene(scene, parameters), parameters, bands)
        light = _light(voxels, aimed.accuracy)
    rays = aimed.rays
    assert isinstance(rays, RayLattice)  # else `tile_picture` refuses them
    tiling = tile_picture(light, rays, tile)
    factor = np.empty((len(bands), *rays.shape), scene.dtype)
    with report.stage("Tiles", math.prod(tiling.shape)):
        for row, column in np.ndindex(tiling.shape):
            place = jnp.asarray(row), jnp.asarray(column)
            (part,) = keep(partial(_tile, light, rays, tiling, *place))
            factor[:, *tiling.pixels(row, column)] = part
            report.advance()
    image, _ = aimed.averages(jnp.asarray(factor), light.scene)
    return image


@eqx.filter_jit
def _voxels(scene: Scene, parameters: PlotParameters, bands: BandSet) -> VoxelScene:
    return scene.voxels(parameters, bands)


@eqx.filter_jit(donate="all")
def _light(voxels: VoxelScene, accuracy: Accuracy) -> Light:
    return solve_light(voxels, accuracy)


@eqx.filter_jit
def _tile(
    light: Light, rays: RayLattice, tiling: Tiling, row: Array, column: Array
) -> tuple[Float[Array, "band row column"]]:
    radiance = render_tile(light, rays, tiling, row, column)
    return (jnp.pi * radiance.total / light.scene.illumination.incident[:, None, None],)
