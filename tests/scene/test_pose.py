"""Images of a camera of known pose: the frame laid on the map, seen from where it hung."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.radiation import Accuracy, RayField
from fynjax.scene import Placement, aim
from fynjax.sensors import Frame, Lens, Pose, shipped_sensor
from tests.helpers import assert_gradients
from tests.scene.plots import small_parameters, small_plot

FAST = Accuracy(
    lattice=1, sublayers=1, levels=1, azimuths=4, refine=False, tolerance=1e-9, iterations=200
)
SLANTED = Pose([2.0, -4.0, 8.0], -15.0, 31.0, 4.0)
"""Sees the plot of 1.6 m from the south."""


@pytest.fixture(scope="module")
def plot():
    return small_plot()


@pytest.fixture(scope="module")
def nir():
    return dataclasses.replace(shipped_sensor("mavic_3m").select([3]), psf=None)


def over(scene, sensor, pose, lens=None, pixel=0.1):
    placement = Placement(pixel=pixel, frame=Frame(pose, lens))
    return aim(scene, small_parameters(), sensor, placement, accuracy=FAST)


def test_from_above_its_middle_a_plot_looks_as_without_a_pose(plot, nir):
    """Straight down, turned, and tilted towards a heading: of a map only the place counts."""
    usual = fx.observe(plot, nir, altitude=30.0, pixel=0.1, accuracy=FAST)
    assert usual.seen is None
    for yaw in (0.0, 130.0):
        above = fx.observe(plot, nir, pose=Pose([0.8, 0.8, 30.0], yaw), pixel=0.1, accuracy=FAST)
        np.testing.assert_allclose(above.reflectance, usual.reflectance, rtol=1e-6)
        assert above.seen.all()
    tilted = Placement(30.0, 0.1, tilt=20.0, heading=40.0)
    usual = aim(plot, small_parameters(), nir, tilted, accuracy=FAST)
    pose = Pose(usual.sensor.camera.position, 40.0, 20.0)
    posed = over(plot, nir, pose)
    for name in ("x", "y", "slope_x", "slope_y"):
        np.testing.assert_allclose(getattr(posed.rays, name), getattr(usual.rays, name), rtol=1e-6)
    assert posed.steepest == usual.steepest
    for name in ("tilt", "heading"):
        assert float(getattr(posed.sensor.camera, name)) == pytest.approx(tilted.__dict__[name])


def test_a_pixel_has_the_size_that_the_lens_makes_of_the_height(plot, nir):
    lens = Lens((400, 300), (500.0, 500.0), (199.5, 149.5))
    image = over(plot, nir, Pose([0.8, 0.8, 20.0]), lens, pixel=None)
    assert image.pixel == pytest.approx(20.0 / 500.0 * nir.pixel_factor)


def test_a_plot_larger_than_a_frame_is_seen_in_part(plot, nir):
    """0.5 x 1 m of 1.6: by hand, the pixels of 10 cm that lie wholly in it; the rest is finite."""
    lens = Lens((50, 100), (1000.0, 1000.0), (24.5, 49.5))
    posed = over(plot, nir, Pose([0.45, 0.8, 10.0]), lens)
    expected = np.zeros((16, 16), bool)
    expected[3:13, 2:7] = True  # 0.3 to 1.3 m north, 0.2 to 0.7 m east
    np.testing.assert_array_equal(posed.seen, expected)
    image = posed.observe(plot, small_parameters())
    assert np.isfinite(image.reflectance).all()
    table, data = image.to_dataframe(), image.to_xarray()
    assert table["seen"].sum() == data["seen"].sum() == 50
    assert data["seen"].dims == ("y", "x")
    mean = np.asarray(image["nir"])[expected].mean()
    assert str(image).endswith(f"mean reflectance of the 20% in the frame nir {mean:.3f}.")
    few = posed.sampled(2)
    np.testing.assert_array_equal(few.seen, expected[::2, ::2])
    np.testing.assert_array_equal(few.sight, posed.sight[::2, ::2])
    # In pixels wider than a voxel, a ray a voxel.
    wide = over(plot, nir, Pose([0.45, 0.8, 10.0]), lens, pixel=0.2)
    assert wide.seen.sum() == 2 * 4  # 0.2 to 0.6 m east, 0.4 to 1.2 m north
    assert wide.sampled(2).seen.shape == (8, 8)
    assert wide.sampled(2).sight.shape == (16, 16, 2)


def test_lines_of_sight_run_from_the_terrain_to_where_the_camera_hung(plot, nir):
    """Over a slope of 1 in 2, whose mean height is that of its middle."""
    height = np.broadcast_to(0.05 + 0.05 * np.arange(16), (16, 16)).copy()
    hill = dataclasses.replace(plot, boundary="open", terrain=height)
    pose = Pose([3.0, -2.0, 9.0], -30.0, 20.0)
    posed = over(hill, nir, pose, Lens((4000, 4000), (1000.0, 1000.0), (2e3, 2e3)))
    rays, again = posed.rays, posed.from_pose(pose).rays
    for name in ("x", "y", "slope_x", "slope_y"):
        np.testing.assert_allclose(getattr(again, name), getattr(rays, name), atol=2e-4)
    ground = height - height.mean()
    camera = 9.0 + height.mean()
    at = (np.arange(16) + 0.5) * 0.1
    for axis, mine, theirs in (("x", at[None], 3.0), ("y", at[:, None], -2.0)):
        start, slope = getattr(rays, axis), getattr(rays, f"slope_{axis}")
        np.testing.assert_allclose(start + camera * slope, theirs, atol=1e-6)
        seen = start + (ground + height.mean()) * slope
        np.testing.assert_allclose(seen, np.broadcast_to(mine, (16, 16)), atol=1e-6)
    peak = dataclasses.replace(hill, terrain=np.where(height == height.max(), 0.9, 0.0))
    with pytest.raises(InputError, match="above all of the terrain"):
        over(peak, nir, Pose([0.8, 0.8, 0.84]))


def test_another_pose_shows_what_the_same_place_in_the_frame_sees(plot, nir):
    posed = over(plot, nir, SLANTED)
    same = posed.from_pose(SLANTED)
    assert isinstance(same.rays, RayField)
    image = posed.observe(plot, small_parameters()).reflectance
    np.testing.assert_allclose(same.observe(plot, small_parameters()).reflectance, image, rtol=2e-3)
    # Moved, not turned: all that it sees lies as much further on.
    moved = posed.from_pose(dataclasses.replace(SLANTED, position=SLANTED.position + 0.3)).rays
    climb = 0.3 * same.rays.slope_x
    np.testing.assert_allclose(moved.x - same.rays.x, 0.3 - climb, atol=1e-9)
    np.testing.assert_allclose(moved.slope_y, same.rays.slope_y, atol=1e-9)
    # A degree more of roll: what lies in the middle moves to the left by that much.
    straight = over(plot, nir, Pose([0.8, 0.8, 30.0]))
    rolled = straight.from_pose(Pose([0.8, 0.8, 30.0], roll=1.0)).rays
    expected = np.tan(np.arctan((0.75 - 0.8) / 30.0) - np.radians(1.0)) * 30.0
    assert float(rolled.x[7, 7]) == pytest.approx(0.8 + expected, abs=2e-4)
    with pytest.raises(InputError, match="aimed with a pose"):
        aim(plot, small_parameters(), nir, accuracy=FAST).from_pose(SLANTED)


def test_images_are_differentiable_in_the_pose(plot, nir):
    posed = over(plot, nir, SLANTED, pixel=0.2)

    def image(pose):
        return posed.observe(plot, small_parameters(), pose=pose).reflectance[0, 2:5, 3:6]

    assert_gradients(image, SLANTED, step=1e-7, rtol=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pose": Frame(Pose([9.0, 0.8, 20.0]), Lens((99, 99), (999.0, 999.0), (49, 49)), "A1")},
         r"but A1, from 9.0 m east and 0.8 m north .* looks at 9.0 m east and 0.8 m north"),
        ({"pose": Pose([0.8, 0.8, 20.0], pitch=-90.0)}, "was a gimbal pitch passed"),
        ({"pose": Pose([0.8, 0.8, 20.0], pitch=40.0)}, "looks at 0.8 m east and 17.6 m north"),
        ({"pose": Pose([0.8, 0.8, 0.2])}, "above the plants"),
        ({"pose": Pose([0.8, 0.8, 20.0]), "altitude": 30.0}, "a pose, or altitude"),
        ({"pose": Pose([0.8, 0.8, 20.0]), "placement": Placement()}, "but got both"),
        ({"lens": Lens((9, 9), (9.0, 9.0), (4, 4))}, "a pose and a lens.*NoneType and Lens"),
        ({"pose": (0.8, 0.8, 20.0)}, "a pose and a lens.*tuple"),
    ],
)  # fmt: skip
def test_a_pose_that_cannot_be_is_refused_by_name(plot, nir, options, message):
    with pytest.raises(InputError, match=message):
        fx.observe(plot, nir, pixel=0.1, **options)


def test_a_pose_is_of_a_frame_camera_and_known(plot):
    pose = Pose([0.8, 0.8, 20.0])
    with pytest.raises(InputError, match=r"frame camera .*PushbroomCamera"):
        fx.observe(plot, "aviris_ng", pose=pose)
    with pytest.raises(InputError, match="no placement or options of the LiDAR"):
        fx.observe(plot, fx.sensors.shipped_lidars()[0], pose=pose)

    def mean(pitch):
        return fx.observe(plot, "mavic_3m", pose=Pose([0.8, 0.8, 20.0], pitch=pitch)).radiance

    with pytest.raises(InputError, match="a pose must be known, but is traced"):
        jax.eval_shape(mean, jnp.asarray(0.0))
