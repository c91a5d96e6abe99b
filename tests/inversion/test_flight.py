"""Frames of a flight together: what each would say alone, at the cost of one light."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.precision import double_precision
from fynjax.inversion import ImageView
from fynjax.inversion._views import FlightView, PlotForward, factors_by_view, look, together
from fynjax.radiation import Accuracy
from fynjax.scene import Placement, aim, named_values
from fynjax.sensors import Frame, Pose, shipped_sensor
from tests.scene.plots import small_parameters, small_plot

FAST = Accuracy(
    lattice=1, sublayers=1, levels=1, azimuths=4, refine=False, tolerance=1e-9, iterations=200
)
NAMES = ("nir.mean", "red.mean", "nir.q25", "NDVI.std")
POSES = [
    Pose([0.8, 0.8, 30.0]),
    Pose([8.0, -12.0, 28.0], -30.0, 25.0),
    Pose([-14.0, 3.0, 25.0], 80.0, 30.0, 2.0),
    Pose([-14.0, -6.0, 26.0], 60.0, 30.0),
]


def view_of(pose, name, sun=None, sensor=None):
    sensor = dataclasses.replace(shipped_sensor("mavic_3m"), psf=None) if sensor is None else sensor
    placement = Placement(pixel=0.2, frame=Frame(pose, name=name))
    camera = aim(small_plot(), small_parameters(), sensor, placement, accuracy=FAST)
    return ImageView(NAMES, camera, view=name, sun=sun)


@pytest.fixture(scope="module")
def views():
    return [view_of(pose, f"v{k}") for k, pose in enumerate(POSES)]


def test_frames_together_are_what_each_is_alone(views):
    (flight,) = together(views)
    assert isinstance(flight, FlightView)
    assert flight.names == tuple(name for view in views for name in view.statistic_names)
    scene, parameters = small_plot(), small_parameters()
    log = jnp.linspace(-0.1, 0.1, 16)
    found, *images = look(views, scene, parameters, log)
    parts = factors_by_view(views, log)
    for k, (view, own) in enumerate(zip(views, parts, strict=True)):
        image, values = view.look(scene, parameters, own)
        np.testing.assert_allclose(images[k], image, rtol=1e-5)
        np.testing.assert_allclose(found[4 * k : 4 * k + 4], values, rtol=1e-5)
    assert abs(float(found[0] / found[4]) - 1.0) > 0.005  # the views differ


@double_precision
def test_slopes_together_are_those_of_each_alone(views):
    scene, parameters = small_plot(), small_parameters()
    free = [
        name
        for name in named_values(parameters, scene.taxa)
        if name.endswith((".leaf_area_index", "ground.brightness", ".leaf.chlorophyll"))
    ][:3]
    values = jnp.asarray([float(named_values(parameters, scene.taxa)[name]) for name in free])
    u = jnp.concatenate([values, jnp.linspace(-0.1, 0.1, 16)])
    alone, joint = (
        PlotForward(parameters, free, group).jacobian(lambda u: u, u, scene)
        for group in (tuple(views), together(views))
    )
    np.testing.assert_allclose(joint[0], alone[0], rtol=1e-5)
    np.testing.assert_allclose(joint[1], alone[1], rtol=2e-4, atol=1e-6)
    assert np.abs(np.asarray(joint[1])).max() > 0.01
    # By few coordinates slopes are taken forward: of three values, and of one of all factors.
    ways = jnp.concatenate([jnp.eye(3, 19), jnp.linspace(-1.0, 1.0, 19)[None].at[:, :3].set(0.0)])
    few = PlotForward(parameters, free, together(views)).jacobian(
        lambda w: u + w @ ways, jnp.zeros(4), scene
    )
    np.testing.assert_allclose(few[0], joint[0], rtol=1e-6)
    np.testing.assert_allclose(few[1], joint[1] @ ways.T, rtol=1e-3, atol=1e-5)


def test_only_frames_of_one_camera_and_sun_share_light(views):
    later = view_of(POSES[1], "later", sun=(60.0, 300.0))
    other = view_of(POSES[2], "other", sensor=dataclasses.replace(
        shipped_sensor("mavic_3m"), psf=None, name="another"))  # fmt: skip
    found = together([*views, later, other])
    assert [type(view) for view in found] == [FlightView, ImageView, ImageView]
    directly = dataclasses.replace(views[0], camera=dataclasses.replace(views[0].camera, seen=None))
    assert together([views[0], directly, views[1]]) == (views[0], directly, views[1])
