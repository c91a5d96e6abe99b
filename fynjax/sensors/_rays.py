"""From a camera to the rays that the radiation layer renders along."""

import dataclasses
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax.radiation import AbstractRays, RayField, RayLattice, nadir_rays, parallel_rays
from fynjax.sensors._camera import AbstractCamera, FrameCamera, OrthographicCamera
from fynjax.sensors._pushbroom import PushbroomCamera, frame_of

_NARROW = 0.02
"""Spread of the rays' slopes, 1.1 degrees, up to which the leaves' projection is taken as the same
for all of them."""


def camera_rays(camera: AbstractCamera) -> AbstractRays:
    """Rays of all pixels of a camera, for `fynjax.radiation.render` and `reflectance_factor`.

    **Arguments:**

    - `camera`: its zero level is the bottom of the grid.

    **Returns:** orthographic cameras, frame cameras that point straight down with the upper edge
    north, and pushbroom sensors with a northward track give lattices of rays, which render fast;
    all others, and cameras with traced fields, give free rays. Their positions and directions are
    differentiable in the camera's fields.

    **Raises:** `InputError` as `parallel_rays` and `nadir_rays`.
    """
    if isinstance(camera, OrthographicCamera):
        x, y = camera.ground_coordinates()
        zenith, azimuth = camera.view_zenith, camera.view_azimuth
        return parallel_rays(x[0], y[:, 0], camera.pixel_size, zenith, azimuth)
    frame = frame_of(camera)
    if frame is not None and _known(camera):
        place = (float(frame.position[0]), float(frame.position[1]), float(frame.position[2]))
        if float(frame.heading) == 0.0:
            x, y = camera.ground_coordinates()
            footprint = float(camera.ground_sample_distance)
            if isinstance(camera, PushbroomCamera):
                tx, ty = camera.tangents()
                return RayLattice(x[0], y[:, 0], tx[0], ty[:, 0], footprint, 5, place[2])
            if float(frame.tilt) == 0.0:
                return nadir_rays(x[0], y[:, 0], footprint, place)
        altitude = place[2]
    else:
        altitude = math.inf  # the height above the canopy cannot be checked
    x, y = camera.ground_coordinates()
    tx, ty = camera.tangents()
    return RayField(x, y, tx, ty, camera.pixel_widths(), altitude)


def map_rays(
    camera: AbstractCamera,
    x: Float[Array, " column"],
    y: Float[Array, " row"],
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


def _known(camera: AbstractCamera) -> bool:
    leaves: list[Array] = jax.tree.leaves(camera)
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)
