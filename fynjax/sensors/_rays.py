"""From a camera to the rays that the radiation layer renders along."""

import math

import jax
from jaxtyping import Array

from fynjax.radiation import AbstractRays, RayField, RayLattice, nadir_rays, parallel_rays
from fynjax.sensors._camera import AbstractCamera, FrameCamera, OrthographicCamera
from fynjax.sensors._pushbroom import PushbroomCamera


def camera_rays(camera: AbstractCamera) -> AbstractRays:
    """Rays of all pixels of a camera, for `fynjax.radiation.render` and `reflectance_factor`.

    The camera's zero level is the bottom of the grid. Orthographic cameras, frame cameras that
    look straight down with the upper edge north, and pushbroom sensors that fly north give
    lattices of rays, which render fast; all others, and cameras with traced fields, give free
    rays. Their positions and directions are differentiable in the camera's fields.
    """
    if isinstance(camera, OrthographicCamera):
        x, y = camera.ground_coordinates()
        zenith, azimuth = camera.view_zenith, camera.view_azimuth
        return parallel_rays(x[0], y[:, 0], camera.pixel_size, zenith, azimuth)
    frame = camera.line if isinstance(camera, PushbroomCamera) else camera
    if isinstance(frame, FrameCamera) and _known(camera):
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


def _known(camera: AbstractCamera) -> bool:
    leaves: list[Array] = jax.tree.leaves(camera)
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)
