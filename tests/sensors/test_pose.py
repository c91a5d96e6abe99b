"""Where a camera hung, and its lens: against projections made by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fynjax._core.errors import InputError
from fynjax.radiation import perspective_rays
from fynjax.sensors import Frame, Lens, Pose, lens_of, pose_of_axes, shipped_sensor

LENS = Lens((201, 101), (100.0, 100.0), (100.0, 50.0))
"""A hundred pixels a focal length, its axis in the middle."""
TAN = {angle: np.tan(np.radians(angle)) for angle in (10, 20, 30)}


def at(pose: Pose, *point: float, lens: Lens = LENS) -> list[float]:
    return Frame(pose, lens).pixels(point).tolist()


@pytest.mark.parametrize(
    ("angles", "point", "pixel"),
    [
        # Ten metres up, looking straight down: a metre is ten pixels.
        ((0, 0, 0), (1.0, 2.0, 0.0), (110.0, 30.0)),
        ((0, 0, 0), (1.0, 2.0, 5.0), (120.0, 10.0)),  # half way up, twice as far out
        ((90, 0, 0), (1.0, 2.0, 0.0), (80.0, 40.0)),  # the upper edge is east, the right one south
        ((-90, 0, 0), (1.0, 2.0, 0.0), (120.0, 60.0)),
        # Looking ahead: the axis meets the ground ahead, and 10 degrees nearer lies below it.
        ((0, 30, 0), (0.0, 10.0 * TAN[30], 0.0), (100.0, 50.0)),
        ((0, 30, 0), (0.0, 10.0 * TAN[20], 0.0), (100.0, 50.0 + 100.0 * TAN[10])),
        ((90, 30, 0), (10.0 * TAN[30], 0.0, 0.0), (100.0, 50.0)),
        ((90, 30, 0), (10.0 * TAN[20], 0.0, 0.0), (100.0, 50.0 + 100.0 * TAN[10])),
        # The right side down: it looks to the left, and what is below it lies to the right.
        ((0, 0, 20), (-10.0 * TAN[20], 0.0, 0.0), (100.0, 50.0)),
        ((0, 0, 10), (0.0, 0.0, 0.0), (100.0 + 100.0 * TAN[10], 50.0)),
        ((180, 0, 10), (10.0 * TAN[10], 0.0, 0.0), (100.0, 50.0)),
        # Rolled after it was pitched: about its own axis ahead, which leans.
        ((0, 30, 20), (-10.0 * TAN[20] / np.cos(np.radians(30)), 10.0 * TAN[30], 0), (100, 50)),
    ],
)
def test_points_of_the_ground_lie_where_they_are_seen(angles, point, pixel):
    assert at(Pose([0.0, 0.0, 10.0], *angles), *point) == pytest.approx(pixel, abs=1e-3)


def test_angles_are_those_of_aircraft():
    """Against another library's: yaw, pitch and roll about the body's own axes, in north, east and
    down; and back."""
    for angles in ((30.0, 20.0, -7.0), (-170.0, -35.0, 12.0), (271.0, 80.0, 3.0)):
        body = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
        forward, right, down = body[[1, 0, 2]].T * [1.0, 1.0, -1.0]
        pose = Pose([1.0, 2.0, 30.0], *angles)
        np.testing.assert_allclose(pose.axes, [right, -forward, down], atol=1e-12)
        assert float(pose.tilt) == pytest.approx(np.degrees(np.arccos(body[2, 2])))
        again = pose_of_axes(np.asarray(pose.position), np.asarray(pose.axes))
        np.testing.assert_allclose(again.axes, pose.axes, atol=1e-12)
        assert float(again.pitch) == pytest.approx(angles[1])
        assert float(again.roll) == pytest.approx(angles[2])


def test_axes_that_are_no_rotation_are_refused():
    mirrored = np.diag([1.0, 1.0, -1.0])
    assert float(pose_of_axes(np.array([0, 0, 9.0]), mirrored * [1, -1, 1]).tilt) == pytest.approx(
        0.0
    )
    for axes in (mirrored, 2.0 * np.eye(3), np.eye(2)):
        with pytest.raises(InputError, match="a rotation"):
            pose_of_axes(np.array([0.0, 0.0, 9.0]), axes)
    with pytest.raises(InputError, match="three numbers"):
        Pose([0.0, 0.0])


def test_lines_of_sight_are_those_of_a_picture_in_perspective():
    """Against the rays of `perspective_rays`, which states no angles."""
    camera, target = (0.5, -10.0, 10.0), (4.0, 1.0, 0.0)
    rays = perspective_rays(camera, target, rows=4, columns=6, field_of_view=20.0, dtype=float)
    away = np.subtract(target, camera)
    yaw = np.degrees(np.arctan2(away[0], away[1]))
    pitch = np.degrees(np.arctan2(np.hypot(*away[:2]), -away[2]))
    pitch_of_pixel = 2.0 * np.tan(np.radians(10.0)) / 6
    right, up = np.meshgrid(np.arange(6) - 2.5, np.arange(4) - 1.5)
    sight = np.stack([right, -up], axis=-1) * pitch_of_pixel
    slopes = Pose(camera, yaw, pitch).slopes(sight)
    np.testing.assert_allclose(slopes, np.stack([rays.slope_x, rays.slope_y], -1), atol=1e-12)


def test_a_lens_bends_lines_of_sight_by_browns_model():
    bent = Lens((201, 101), (100.0, 90.0), (100.0, 50.0), (0.1, -0.02, 0.003), (0.01, -0.02))
    x, y = 0.3, -0.4
    square = 0.25
    swollen = 1 + 0.1 * square - 0.02 * square**2 + 0.003 * square**3
    column = 100 + 100 * (x * swollen + 2 * 0.01 * x * y - 0.02 * (square + 2 * x * x))
    row = 50 + 90 * (y * swollen + 0.01 * (square + 2 * y * y) + 2 * -0.02 * x * y)
    pose = Pose([0.0, 0.0, 10.0])
    assert at(pose, 10 * x, -10 * y, 0.0, lens=bent) == pytest.approx((column, row))
    # A fisheye counts angles: 45 degrees are pi / 4 focal lengths, bent by the angle's powers.
    round_ = Lens((201, 101), (100.0, 100.0), (100.0, 50.0), (0.1,), fisheye=True)
    angle = np.pi / 4
    expected = 100 + 100 * angle * (1 + 0.1 * angle**2)
    assert at(pose, 10.0, 0.0, 0.0, lens=round_) == pytest.approx((expected, 50.0))
    # A row further down is a little further right where columns and rows do not stand upright.
    askew = Lens((201, 101), (100.0, 100.0), (100.0, 50.0), skew=2.0)
    assert at(pose, 0.0, -5.0, 0.0, lens=askew) == pytest.approx((101.0, 100.0))


def test_what_a_lens_does_not_have_is_not_in_its_picture():
    """A barrel bends back: by its polynomial, what lies far outside would end in the middle."""
    barrel = Lens((201, 101), (100.0, 100.0), (100.0, 50.0), (-0.5,))
    frame = Frame(Pose([0.0, 0.0, 10.0]), barrel)
    edge = 10.0 * np.sqrt(1 / 1.5)  # where r - r3 / 2 has its largest value
    points = np.array([[2.0, 0.0, 0.0], [0.98 * edge, 0.0, 0.0], [1.02 * edge, 0.0, 0.0]])
    assert frame.sees(points).tolist() == [True, True, False]
    assert np.isnan(frame.pixels([1.4 * edge, 0.0, 0.0])).all()
    # Beyond the picture's edge, half a pixel out of the middle of its last one; and behind it.
    frame = Frame(frame.pose, LENS)
    for inside, outside in (((10.04, 0), (10.06, 0)), ((-10.04, 0), (-10.06, 0)),
                            ((0, -5.04), (0, -5.06)), ((0, 5.04), (0, 5.06))):  # fmt: skip
        assert frame.sees([*inside, 0.0])
        assert not frame.sees([*outside, 0.0])
    assert not frame.sees([0.0, 0.0, 11.0])
    with pytest.raises(InputError, match="DJI_1 has none"):
        Frame(frame.pose, name="DJI_1").sees([0.0, 0.0, 0.0])


def test_the_view_of_a_point_is_that_of_its_camera():
    frame = Frame(Pose([3.0, 3.0, 10.0], 77.0, 30.0))
    angles = frame.view([[3.0, 3.0, 0.0], [3.0 - 10.0, 3.0, 0.0], [3.0, 3.0 + 5.0, 5.0]])
    np.testing.assert_allclose(angles, [[0, 0], [45, 90], [45, 180]], atol=1e-6)


def test_a_sensors_own_lens_has_its_pixels_on_the_ground():
    sensor = shipped_sensor("mavic_3m")
    lens = lens_of(sensor.camera)
    frame = Frame(Pose([0.0, 0.0, 50.0]), lens)
    (column, row), (further, _) = frame.pixels([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert further - column == pytest.approx(1.0 / float(sensor.ground_sample_distance(50.0)))
    assert (2 * column + 1, 2 * row + 1) == pytest.approx(lens.size) == sensor.camera.array


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal_length": (0.0, 1.0)}, "a positive focal length"),
        ({"size": (0, 5)}, "a picture with pixels"),
        ({"radial": (np.nan,)}, "finite numbers"),
        ({"radial": (0.0,) * 5}, "four radial ones"),
    ],
)
def test_a_lens_that_cannot_be_is_refused(change, message):
    numbers = {"size": (5, 5), "focal_length": (9.0, 9.0), "centre": (2.0, 2.0)}
    with pytest.raises(InputError, match=message):
        Lens(**numbers | change)
