"""Rays from a map to a camera are those that the camera's own pixels look along."""

import numpy as np
import pytest

from fynjax.radiation import RayField, RayLattice
from fynjax.sensors import FrameCamera, OrthographicCamera, PushbroomCamera, map_rays


def slopes(rays):
    """Of the ray at the first row and the second column."""
    x, y = np.asarray(rays.slope_x), np.asarray(rays.slope_y)
    return (x[0, 1], y[0, 1]) if isinstance(rays, RayField) else (x[1], y[0])


CAMERAS = {
    "frame": FrameCamera((3.0, -20.0, 60.0), 8.0, 3.5, (12, 8), 25.0, 30.0),
    "pushbroom north": PushbroomCamera(FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1)), 5),
    "pushbroom west": PushbroomCamera(
        FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1), 0.0, 270.0), 5
    ),
    "pushbroom fore": PushbroomCamera(
        FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1), 20.0, 180.0), 5
    ),
    "pushbroom oblique": PushbroomCamera(
        FrameCamera((3.0, 7.0, 300.0), 8.0, 350.0, (12, 1), -15.0, 33.0), 5
    ),
    "orthographic": OrthographicCamera((0.0, 0.0, 3.0, 2.0), 0.5, 35.0, 120.0),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_map_rays_follow_the_cameras_lines_of_sight(name):
    camera = CAMERAS[name]
    ground, tangents = np.asarray(camera.ground_coordinates()), np.asarray(camera.tangents())
    rows, columns = camera.shape
    for row, column in ((0, 0), (rows - 1, columns // 3), (rows // 2, columns - 1)):
        x, y = ground[:, row, column]
        rays = map_rays(camera, np.array([x - 1.0, x]), np.array([y, y + 2.0]), 0.1)
        np.testing.assert_allclose(slopes(rays), tangents[:, row, column], rtol=1e-9, atol=1e-12)
    kind = RayField if name.endswith("oblique") else RayLattice
    assert isinstance(rays, kind)
    assert rays.shape == (2, 2)
