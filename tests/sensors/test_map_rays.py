"""Rays from a map to a camera against trigonometry of the camera's own pixels."""

import numpy as np
import pytest

from fynjax.radiation import RayField, RayLattice
from fynjax.sensors import FrameCamera, OrthographicCamera, PushbroomCamera, frame_of, map_rays


def slopes(rays):
    """Of the ray at the first row and the second column."""
    x, y = np.asarray(rays.slope_x), np.asarray(rays.slope_y)
    return (x[0, 1], y[0, 1]) if isinstance(rays, RayField) else (x[1], y[0])


def line_of_sight(camera, across, above, flown):
    """Where a pixel sees the ground, and its shift towards the camera per height: of a pixel
    `across` to the right and `above` the middle of the image, in focal lengths, once the sensor has
    flown on by [m]."""
    if isinstance(camera, OrthographicCamera):
        zenith, azimuth = (np.radians(float(a)) for a in (camera.view_zenith, camera.view_azimuth))
        return [across, above], np.tan(zenith) * np.array([np.sin(azimuth), np.cos(azimuth)])
    frame = frame_of(camera)
    tilt, heading = np.radians(float(frame.tilt)), np.radians(float(frame.heading))
    ahead = np.array([np.sin(heading), np.cos(heading)])
    right = np.array([ahead[1], -ahead[0]])
    along, down = np.sin(tilt) + above * np.cos(tilt), np.cos(tilt) - above * np.sin(tilt)
    away = (across * right + along * ahead) / down
    place = np.asarray(frame.position)
    return place[:2] + flown * ahead + place[2] * away, -away


CAMERAS = {
    "frame": FrameCamera((3.0, -20.0, 60.0), 8.0, 3.5, (12, 8), 25.0, 30.0),
    "pushbroom north": PushbroomCamera(FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1))),
    "pushbroom west": PushbroomCamera(
        FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1), 0.0, 270.0)
    ),
    "pushbroom fore": PushbroomCamera(
        FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1), 20.0, 180.0)
    ),
    "pushbroom oblique": PushbroomCamera(
        FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1), -15.0, 33.0)
    ),
    "orthographic": OrthographicCamera(0.5, 35.0, 120.0),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_map_rays_follow_the_cameras_lines_of_sight(name):
    camera = CAMERAS[name]
    line = isinstance(camera, PushbroomCamera)
    for across, second in ((0.0, 0.0), (-0.2, 0.15), (0.24, -0.1)):
        above, flown = (0.0, 60.0 * second) if line else (second, 0.0)
        (x, y), expected = line_of_sight(camera, across, above, flown)
        rays = map_rays(camera, np.array([x - 1.0, x]), np.array([y, y + 2.0]), 0.1)
        np.testing.assert_allclose(slopes(rays), expected, rtol=1e-9, atol=1e-12)
    kind = RayField if name.endswith("oblique") else RayLattice
    assert isinstance(rays, kind)
    assert rays.shape == (2, 2)
