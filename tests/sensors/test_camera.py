"""Camera geometry against trigonometry, optics and the paper's numbers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.sensors import AbstractCamera, FrameCamera, OrthographicCamera, shipped_sensor
from tests.helpers import assert_gradients


def frame(**changes: object) -> FrameCamera:
    settings: dict = {
        "position": (5.0, 4.0, 50.0),
        "focal_length_mm": 4.0,
        "pixel_pitch_um": 2.0,
        "array": (8, 6),
    }
    return FrameCamera(**{**settings, **changes})


def placed(name: str, position: object = (5.0, 5.0, 50.0)) -> AbstractCamera:
    x, y, altitude = jnp.asarray(position)
    return shipped_sensor(name).camera.over(x, y, altitude=altitude)


def test_paper_and_maker_cameras() -> None:
    paper, maker = placed("mavic_3m_paper"), placed("mavic_3m")
    assert paper.shape == (480, 640)
    assert maker.shape == (1944, 2592)
    # Table 2 of the paper, and DJI's own 2170 px focal length.
    assert float(paper.ground_sample_distance) == pytest.approx(0.025, rel=1e-12)
    assert float(maker.ground_sample_distance) == pytest.approx(50.0 / 2170.0, rel=1e-12)
    x, y = paper.ground_coordinates()
    assert x.shape == (480, 640)
    np.testing.assert_allclose(np.diff(x, axis=1), 0.025, rtol=1e-9)  # columns run east
    np.testing.assert_allclose(np.diff(y, axis=0), 0.025, rtol=1e-9)  # rows run north
    np.testing.assert_allclose(x.mean(), 5.0, rtol=1e-12)
    assert float(x.max() - x.min()) + 0.025 == pytest.approx(16.0, rel=1e-9)
    assert float(y.max() - y.min()) + 0.025 == pytest.approx(12.0, rel=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 25.0])
@pytest.mark.parametrize("height", [0.0, 1.7])
def test_lines_of_sight_join_ground_and_camera(tilt: float, height: float) -> None:
    camera = frame(tilt=tilt, heading=70.0)
    ground = camera.ground_coordinates(height)
    point = jnp.stack([*ground, jnp.full(camera.shape, height)])
    line = camera.position[:, None, None] - point
    expected = line / jnp.linalg.norm(line, axis=0)
    np.testing.assert_allclose(camera.view_directions(), expected, atol=1e-12)
    np.testing.assert_allclose(jnp.linalg.norm(camera.view_directions(), axis=0), 1.0, rtol=1e-12)
    tx, ty = camera.tangents()
    base = camera.ground_coordinates()
    np.testing.assert_allclose(ground[0], base[0] + tx * height, atol=1e-12)
    np.testing.assert_allclose(ground[1], base[1] + ty * height, atol=1e-12)


def test_tilt_and_heading_point_where_they_say() -> None:
    # One pixel, camera at the origin's vertical: it sees height * tan(tilt) along the heading.
    for heading, expected in ((0.0, (0.0, 1.0)), (90.0, (1.0, 0.0)), (225.0, (-1.0, -1.0))):
        camera = frame(position=(0.0, 0.0, 10.0), array=(1, 1), tilt=30.0, heading=heading)
        distance = 10.0 * np.tan(np.radians(30.0))
        direction = np.array(expected) / np.linalg.norm(expected)
        np.testing.assert_allclose(
            camera.ground_coordinates()[:, 0, 0], distance * direction, atol=1e-12
        )
    # The upper edge of the image looks toward the heading, its right edge a quarter turn clockwise.
    x, y = frame(position=(0.0, 0.0, 10.0), heading=90.0).ground_coordinates()
    assert x[-1, 0] > x[0, 0]
    assert y[0, -1] < y[0, 0]
    # A tilted camera sees farther, and coarser, at the upper edge.
    x, y = frame(position=(0.0, 0.0, 10.0), tilt=30.0).ground_coordinates()
    assert y[-1, 0] - y[-2, 0] > y[1, 0] - y[0, 0] > 0


def test_footprint_of_a_tilted_view_by_angles() -> None:
    camera = frame(position=(0.0, 0.0, 10.0), array=(1, 101), tilt=30.0)
    off_axis = np.arctan((np.arange(101) - 50) * 2e-6 / 4e-3)
    expected = 10.0 * np.tan(np.radians(30.0) + off_axis)
    np.testing.assert_allclose(camera.ground_coordinates()[1, :, 0], expected, rtol=1e-12)


def test_orthographic_views() -> None:
    nadir = OrthographicCamera((0.0, 0.0, 10.0, 5.0), 0.1)
    assert nadir.shape == (50, 100)
    x, y = nadir.ground_coordinates()
    np.testing.assert_allclose(x[0], np.arange(100) * 0.1 + 0.05, atol=1e-12)
    np.testing.assert_allclose(y[:, 0], np.arange(50) * 0.1 + 0.05, atol=1e-12)
    np.testing.assert_array_equal(nadir.view_directions()[2], 1.0)
    east = OrthographicCamera((0.0, 0.0, 1.0, 1.0), 0.5, 45.0, 90.0)
    tx, ty = east.tangents()
    np.testing.assert_allclose(tx, 1.0, rtol=1e-12)
    np.testing.assert_allclose(ty, 0.0, atol=1e-12)
    np.testing.assert_allclose(east.ground_coordinates(2.0)[0, 0], [2.25, 2.75], rtol=1e-12)
    # A camera in the north-north-west: lines of sight climb 1 m while going tan(40°) toward it.
    view = OrthographicCamera((0.0, 0.0, 1.0, 1.0), 0.5, 40.0, 330.0)
    moved = view.ground_coordinates(1.0) - view.ground_coordinates()
    expected = np.tan(np.radians(40.0)) * np.array([-0.5, np.sqrt(0.75)])
    np.testing.assert_allclose(moved, np.broadcast_to(expected[:, None, None], (2, 2, 2)))
    direction = view.view_directions()[:, 0, 0]
    np.testing.assert_allclose(np.linalg.norm(direction), 1.0, rtol=1e-12)
    np.testing.assert_allclose(direction[:2] / direction[2], expected, rtol=1e-12)


def test_a_distant_camera_is_orthographic() -> None:
    far = frame(position=(1.0, 1.0, 1e6), focal_length_mm=1e3, pixel_pitch_um=0.5, array=(4, 4))
    near = OrthographicCamera((0.0, 0.0, 2.0, 2.0), 0.5)
    np.testing.assert_allclose(far.ground_coordinates(), near.ground_coordinates(), atol=1e-8)
    np.testing.assert_allclose(far.view_directions(), near.view_directions(), atol=2e-6)


def test_gradients_and_precision() -> None:
    at = {
        "position": jnp.array([5.0, 4.0, 50.0]),
        "focal_length_mm": jnp.array(4.0),
        "pixel_pitch_um": jnp.array(2.0),
        "tilt": jnp.array(20.0),
        "heading": jnp.array(30.0),
    }

    def lines(p: dict) -> tuple:
        camera = frame(**p)
        return camera.ground_coordinates(0.5), camera.view_directions()

    assert_gradients(lines, at, rtol=1e-5)
    # At nadir the slopes exist too, and jit sees no concrete values.
    gradient = jax.jit(jax.grad(lambda p: jnp.sum(lines(p)[0] ** 2)))(
        {**at, "tilt": jnp.array(0.0)}
    )
    assert all(bool(jnp.all(jnp.isfinite(g))) for g in jax.tree.leaves(gradient))
    single = placed("mavic_3m_paper", jnp.array([5.0, 5.0, 50.0], jnp.float32))
    assert single.ground_coordinates().dtype == jnp.float32
    np.testing.assert_allclose(
        single.ground_coordinates(), placed("mavic_3m_paper").ground_coordinates(), atol=5e-6
    )
    camera = eqx.filter_jit(lambda c: c.ground_coordinates())(placed("mavic_3m_paper"))
    assert camera.shape == (2, 480, 640)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position": (0.0, 0.0, 0.0)}, "altitude"),
        ({"position": (0.0, 0.0)}, "position"),
        ({"focal_length_mm": 0.0}, "focal_length"),
        ({"pixel_pitch_um": float("nan")}, "pixel_pitch"),
        ({"array": (0, 4)}, "array"),
        ({"tilt": -90.0}, "gimbal"),
    ],
)
def test_bad_frame_cameras(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        frame(**changes)


def test_bad_views() -> None:
    with pytest.raises(InputError, match="above the plane"):
        frame().ground_coordinates(50.0)
    with pytest.raises(InputError, match="multiple"):
        OrthographicCamera((0.0, 0.0, 1.0, 1.0), 0.3)
    with pytest.raises(InputError, match="pixel size"):
        OrthographicCamera((0.0, 0.0, 1.0, 1.0), 0.0)
    with pytest.raises(InputError, match="view_zenith"):
        OrthographicCamera((0.0, 0.0, 1.0, 1.0), 0.5, 90.0)
