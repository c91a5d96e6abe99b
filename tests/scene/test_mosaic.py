"""Mosaics of frames: every pixel as the camera that it is from saw it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.inversion._views import BlendView, ImageSight
from fynjax.radiation import RayField
from fynjax.scene import Placement, aim
from fynjax.sensors import Frame, Gains, Lens, Pose
from tests.scene.plots import small_parameters
from tests.scene.test_pose import FAST, nir, plot  # noqa: F401

LENS = Lens((400, 300), (400.0, 400.0), (199.5, 149.5))
HALVES = (
    Frame(Pose([-6.0, 0.8, 12.0], 90.0, 20.0), LENS, "west"),
    Frame(Pose([7.6, 0.8, 12.0], 270.0, 20.0), LENS, "east"),
)
"""Two cameras as far from the middle of a plot of 1.6 m: each is the nearest of its half."""
MOSAIC = Frame(Pose([0.8, 0.8, 12.0]), LENS, "both", HALVES)


def test_each_point_is_of_the_nearest_camera_that_sees_it():
    points = np.array([[0.3, 0.5, 0.0], [1.3, 0.5, 0.0], [1.3, 1.5, 0.0]])
    np.testing.assert_allclose(MOSAIC.camera_over(points)[:, 0], [-6.0, 7.6, 7.6])
    narrow = Lens((400, 300), (4000.0, 4000.0), (199.5, 149.5))  # sees next to nothing
    blind = Frame(HALVES[1].pose, narrow, "east")
    only = Frame(MOSAIC.pose, LENS, "both", (HALVES[0], blind))
    np.testing.assert_allclose(only.camera_over(points)[:, 0], [-6.0] * 3)
    np.testing.assert_allclose(HALVES[0].camera_over(points), [[-6.0, 0.8, 12.0]] * 3)
    zenith = np.degrees(np.arctan2(np.hypot(6.3, 0.3), 12.0))
    np.testing.assert_allclose(MOSAIC.view(points)[0], [zenith, 270 + 2.726], atol=0.01)
    corners = np.stack(np.meshgrid([0.0, 0.8, 1.6], [0.0, 1.6], [0.0]), -1)[:, :, 0]
    assert only.sees_cells(corners).all()


def test_a_mosaic_is_its_frames_side_by_side(plot, nir):  # noqa: F811
    images = [
        fx.observe(plot, nir, pixel=0.1, pose=frame, accuracy=FAST).reflectance
        for frame in (*HALVES, MOSAIC)
    ]
    west, east, both = map(np.asarray, images)
    # Frames have rays in lattices, mosaics each its own: their angular parts differ by little.
    np.testing.assert_allclose(both[..., :8], west[..., :8], rtol=5e-3)
    np.testing.assert_allclose(both[..., 8:], east[..., 8:], rtol=5e-3)
    assert np.abs(west / east - 1.0).max() > 0.05


def test_the_mean_of_a_mosaics_frames_counts_where_each_sees(plot, nir):  # noqa: F811
    bands = nir.bands
    gains = Gains(0.0)
    sight = ImageSight(
        ("nir.mean",), nir, Placement(pixel=0.1, frame=MOSAIC), gains, False, blended=True
    )
    view = sight(plot, small_parameters())
    assert isinstance(view, BlendView)
    assert len(view.frames) == 2
    found = view.image(plot, small_parameters())
    each = [frame.image(plot, small_parameters()) for frame in view.frames]
    np.testing.assert_allclose(found, 0.5 * (each[0] + each[1]), rtol=1e-5)
    assert len(bands) == 1
    # A frame that sees the southern half alone adds nothing to the other.
    half = jnp.zeros((16, 16), bool).at[:8].set(True)
    first = view.frames[0]
    cut = dataclasses.replace(first, camera=dataclasses.replace(first.camera, seen=half))
    cut = dataclasses.replace(view, frames=(cut, view.frames[1]))
    image = np.asarray(cut.image(plot, small_parameters()))
    np.testing.assert_allclose(image[:, 8:], each[1][:, 8:], rtol=1e-5)
    np.testing.assert_allclose(image[:, :8], np.asarray(found)[:, :8], rtol=1e-5)


def test_a_mosaic_has_no_pose_to_be_moved(plot, nir):  # noqa: F811
    camera = aim(plot, small_parameters(), nir, Placement(pixel=0.1, frame=MOSAIC), accuracy=FAST)
    assert isinstance(camera.rays, RayField)
    with pytest.raises(InputError, match="aimed with a pose"):
        camera.from_pose(MOSAIC.pose)
    assert camera.sampled(2).seen.shape == camera.sampled(2).shape
