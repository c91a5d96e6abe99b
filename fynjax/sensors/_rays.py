"""From a camera to the rays of the pixels of a map."""

import dataclasses
import math

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from fynjax.radiation import RayField, RayLattice, nadir_rays, parallel_rays
from fynjax.sensors._camera import AbstractCamera, FrameCamera, OrthographicCamera, PushbroomCamera

_NARROW = 0.02
"""Spread of the rays' slopes, 1.1 degrees, up to which the leaves' projection is taken as the same
for all of them."""


def map_rays(
    camera: AbstractCamera,
    x: Float[ArrayLike, " column"],
    y: Float[ArrayLike, " row"],
    footprint: float,
) -> RayLattice | RayField:
    """Rays from a regular grid of the ground to a camera: those of an orthorectified image.

    **Arguments:**

    - `camera`: its own pixels play no part. All rays of a frame camera end at one place, whatever
      its tilt and heading; those of a pushbroom sensor end where its line of sight passes over the
      pixel.
    - `x`, `y`: centres of the pixels on the zero level, which is the bottom of the grid [m].
    - `footprint`: their edge [m], positive.

    **Raises:** `InputError` as `nadir_rays`; `TypeError` for another kind of camera.

    Differentiable in `x` and `y`; the camera's fields must be known.
    """
    x, y = jnp.asarray(x), jnp.asarray(y)
    if isinstance(camera, OrthographicCamera):
        return parallel_rays(x, y, footprint, camera.view_zenith, camera.view_azimuth)
    if isinstance(camera, FrameCamera):
        east, north, altitude = (float(v) for v in camera.position)
        rays = nadir_rays(x, y, footprint, (east, north, altitude))
        return dataclasses.replace(rays, nodes=_nodes(rays.slope_x, rays.slope_y))
    if not isinstance(camera, PushbroomCamera):
        raise TypeError(f"no rays are known for a {type(camera).__name__}")
    line = camera.line
    east, north, altitude = (float(v) for v in line.position)
    heading, fore = math.radians(float(line.heading)), math.tan(math.radians(float(line.tilt)))
    # Whole numbers where the flight is along an axis.
    ahead = round(math.sin(heading), 12), round(math.cos(heading), 12)
    right = ahead[1], -ahead[0]

    def slopes(x: Array, y: Array) -> list[Array]:
        across = ((x - east) * right[0] + (y - north) * right[1]) / altitude
        return [-fore * ahead[k] - across * right[k] for k in (0, 1)]

    # Flown along an axis, slopes along it are the same everywhere: the rays are a lattice.
    if 0.0 in ahead:
        zero = jnp.zeros((), x.dtype)
        slope_x = slopes(x, zero + north)[0] if right[0] else jnp.full_like(x, -fore * ahead[0])
        slope_y = slopes(zero + east, y)[1] if right[1] else jnp.full_like(y, -fore * ahead[1])
        nodes = _nodes(slope_x, slope_y)
        return RayLattice(x, y, slope_x, slope_y, footprint, nodes, altitude)
    columns, rows = jnp.meshgrid(x, y)
    width = jnp.full_like(columns, footprint)
    slope_x, slope_y = slopes(columns, rows)
    return RayField(columns, rows, slope_x, slope_y, width, altitude)


def _nodes(*slopes: Array) -> int:
    """Directions per axis at which functions of the angle are evaluated: one for a narrow view."""
    return 1 if max(float(jnp.ptp(s)) for s in slopes) < _NARROW else 5
