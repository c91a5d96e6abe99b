"""Where a frame camera hung when it took a picture, and its lens.

Yaw, pitch and roll turn a body whose axes are forward, right and down (the picture's upper edge is
forward, the optical axis down) from north, east and down, in this order about its own axes: the
angles of aircraft, with a camera that looks straight down at zero. A gimbal's pitch is 90 degrees
less.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError
from fynjax._core.math import real_array
from fynjax.sensors._camera import FrameCamera


class Pose(eqx.Module):
    """Position and attitude of a camera over a plot. Differentiable.

    With angles of zero it looks straight down, the picture's upper edge to the north. Raises
    `InputError` for a position that is not three numbers.
    """

    position: Float[Array, " 3"] = eqx.field(converter=real_array)
    """East and north of the plot's south-west corner, and height above the mean level of its
    ground [m]."""
    yaw: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Direction that the picture's upper edge points to, clockwise from the plot's north
    [degrees]."""
    pitch: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Angle by which the camera looks ahead, towards the upper edge, from straight down [degrees];
    90 is the horizon."""
    roll: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Angle by which its right side is down, so that it looks to the left [degrees]."""

    def __check_init__(self) -> None:
        if jnp.shape(self.position) != (3,):
            raise InputError(
                "expected a position of three numbers, east, north and height [m], but got shape "
                f"{jnp.shape(self.position)}"
            )

    @property
    def axes(self) -> Float[Array, "3 3"]:
        """Unit vectors (east, north, up) of the picture's right and lower edge and of the optical
        axis, one a row."""
        yaw, pitch, roll = (jnp.deg2rad(angle) for angle in (self.yaw, self.pitch, self.roll))
        (sy, cy), (sp, cp), (sr, cr) = ((jnp.sin(a), jnp.cos(a)) for a in (yaw, pitch, roll))
        right = cr * cy + sr * sp * sy, sr * sp * cy - cr * sy, -sr * cp
        lower = -cp * sy, -cp * cy, -sp
        ahead = cr * sp * sy - sr * cy, cr * sp * cy + sr * sy, -cr * cp
        return jnp.stack([jnp.stack(axis) for axis in (right, lower, ahead)])

    @property
    def tilt(self) -> Float[Array, ""]:
        """Angle of the optical axis from straight down [degrees]."""
        return jnp.rad2deg(jnp.arccos(jnp.clip(-self.axes[2, 2], -1.0, 1.0)))

    def slopes(self, sight: Float[Array, "*ray 2"]) -> Float[Array, "*ray 2"]:
        """Eastward and northward distance per height along lines of sight [-].

        **Arguments:** `sight`, distances to the right and down the picture over that along the
        optical axis, of each line [-]. Differentiable in both.
        """
        ahead = jnp.concatenate([sight, jnp.ones_like(sight[..., :1])], axis=-1)
        away = jnp.matmul(ahead, self.axes.astype(sight.dtype), precision="highest")
        return away[..., :2] / away[..., 2:]


def pose_of_axes(position: Float[np.ndarray, " 3"], axes: Float[np.ndarray, "3 3"]) -> Pose:
    """The pose of a camera of known axes.

    **Arguments:**

    - `position`: as `Pose.position` [m].
    - `axes`: as `Pose.axes`.

    **Returns:** the `Pose`, with a pitch from -90 to 90 degrees.

    **Raises:** `InputError` where the axes are no rotation.
    """
    axes = np.asarray(axes, float)
    straight = axes.shape == (3, 3) and np.allclose(axes @ axes.T, np.eye(3), atol=1e-4)
    if not (straight and np.linalg.det(axes) > 0.0):
        raise InputError("expected axes of a camera that stand upright on each other: a rotation")
    (right_up, (ahead_east, ahead_north, ahead_up), axis_up) = axes[0, 2], -axes[1], axes[2, 2]
    yaw = np.degrees(np.arctan2(ahead_east, ahead_north))
    pitch = np.degrees(np.arcsin(np.clip(ahead_up, -1.0, 1.0)))
    roll = np.degrees(np.arctan2(-right_up, -axis_up))
    return Pose(*(jnp.asarray(np.asarray(v, float)) for v in (position, yaw, pitch, roll)))


@dataclasses.dataclass(frozen=True)
class Lens:
    """How a lens maps lines of sight to pixels: the distortion model of Brown (1966), as OpenCV has
    it, of a perspective or of an equidistant fisheye lens.

    Columns and rows count from the middle of the top left pixel. Raises `InputError` for a picture
    without pixels and a focal length that is not positive.
    """

    size: tuple[int, int]
    """Columns and rows of the picture."""
    focal_length: tuple[float, float]
    """Focal length along columns and rows [pixel]."""
    centre: tuple[float, float]
    """Column and row of the optical axis [pixel]."""
    radial: tuple[float, ...] = ()
    """Radial coefficients k1, k2, k3 and k4 [-]; those left out are zero."""
    tangential: tuple[float, float] = (0.0, 0.0)
    """Tangential coefficients p1 and p2 [-]."""
    skew: float = 0.0
    """Columns by which a line of sight moves to the right for each focal length down [pixel]."""
    fisheye: bool = False
    """Whether the distance from the centre is the angle from the axis, and not its tangent."""

    def __post_init__(self) -> None:
        if not (min(self.size) >= 1 and min(self.focal_length) > 0.0):
            raise InputError(
                "expected a picture with pixels and a positive focal length [pixel], but got "
                f"{self.size[0]} x {self.size[1]} pixels and {self.focal_length}"
            )
        numbers = (*self.focal_length, *self.centre, *self.radial, *self.tangential, self.skew)
        if not np.isfinite(numbers).all() or len(self.radial) > 4:
            raise InputError("expected finite numbers of a lens, and four radial ones at most")

    def distorted(
        self, sight: Float[np.ndarray, "*ray 2"]
    ) -> tuple[Float[np.ndarray, "*ray 2"], Bool[np.ndarray, "*ray"]]:
        """Where lines of sight come to lie, in focal lengths from the centre [-], and whether the
        lens has them: beyond some angle its polynomial turns back.

        **Arguments:** `sight`, as of `Pose.slopes`.
        """
        x, y = np.moveaxis(np.asarray(sight, float), -1, 0)
        if self.fisheye:
            tangent = np.hypot(x, y)
            scale = np.where(tangent > 0.0, np.arctan(tangent) / np.maximum(tangent, 1e-12), 1.0)
            x, y = x * scale, y * scale
        square = x * x + y * y
        p1, p2 = self.tangential
        swollen = np.polyval([*self.radial[::-1], 1.0], square)
        # The distance from the centre, r (1 + k1 r2 + ...), grows until its slope is zero.
        slope = [(2 * k + 3) * value for k, value in enumerate(self.radial)]
        roots = np.roots([*slope[::-1], 1.0])
        turns = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
        known = square < min(turns, default=np.inf)
        placed = np.stack(
            [
                x * swollen + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                y * swollen + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )
        return placed, known

    def pixels(self, sight: Float[np.ndarray, "*ray 2"]) -> Float[np.ndarray, "*ray 2"]:
        """Columns and rows of lines of sight [pixel], NaN beyond what the lens has.

        **Arguments:** `sight`, distances to the right and down the picture over that along the
        optical axis, of each line [-].
        """
        placed, known = self.distorted(sight)
        matrix = np.array([[self.focal_length[0], self.skew], [0.0, self.focal_length[1]]])
        return np.where(known[..., None], placed @ matrix.T + self.centre, np.nan)

    def holds(self, pixels: Float[np.ndarray, "*ray 2"]) -> Bool[np.ndarray, "*ray"]:
        """Whether the picture has places of it, given as columns and rows [pixel]."""
        inside = (pixels >= -0.5) & (pixels <= np.subtract(self.size, 0.5))
        return np.asarray(inside.all(axis=-1))


def lens_of(camera: FrameCamera) -> Lens:
    """The lens of a camera as its file has it: without distortion, its axis in the middle.

    **Arguments:** `camera`, whose optics are known.
    """
    focal = 1e3 * float(camera.focal_length_mm) / float(camera.pixel_pitch_um)
    columns, rows = camera.array
    middle = (0.5 * (columns - 1), 0.5 * (rows - 1))
    return Lens((columns, rows), (focal, focal), middle)


class Frame(eqx.Module):
    """One picture of a flight: its name, and where its pixels lie on the ground."""

    pose: Pose
    lens: Lens | None = eqx.field(static=True, default=None)
    """None: that of the sensor that takes it."""
    name: str = eqx.field(static=True, default="")
    """Name of the picture, such as that of its file; for errors and reports."""
    mosaic: tuple["Frame", ...] = ()
    """Frames that a mosaic was made of: of each point it shows what that of the cameras saw which
    has it in its picture and most nearly below. Its own `pose` then stands for the height.
    Empty: a single picture."""

    def camera_over(self, points: Float[Any, "*point 3"]) -> Float[np.ndarray, "*point 3"]:
        """East, north and height of the camera that sees each of some points over the plot [m].

        Of a mosaic, among the frames that have the point in their picture (of all, where none has
        it), that from which it lies least far from straight below. Arguments as of `sight`.
        """
        points = np.asarray(points, float)
        every = self.mosaic or (self,)
        places = np.stack([np.asarray(frame.pose.position, float) for frame in every])
        if not self.mosaic:
            return np.broadcast_to(places[0], points.shape)
        away = places.reshape(-1, *[1] * (points.ndim - 1), 3) - points
        slant = np.hypot(away[..., 0], away[..., 1]) / np.maximum(away[..., 2], 1e-9)
        seen = np.stack([frame.sees(points) for frame in every])
        return places[np.argmin(np.where(seen, slant, slant + 1e9), axis=0)]

    def sight(self, points: Float[Any, "*point 3"]) -> Float[np.ndarray, "*point 2"]:
        """Lines of sight to points over the plot: their distances to the right and down the picture
        over that along the optical axis [-]; NaN for what lies behind the camera.

        **Arguments:** `points`, east and north of the plot's south-west corner, and height above
        the mean level of its ground [m].
        """
        away = np.asarray(points, float) - np.asarray(self.pose.position, float)
        along = away @ np.asarray(self.pose.axes, float).T
        ahead = along[..., 2:]
        return along[..., :2] / np.where(ahead > 0.0, ahead, np.nan)

    def pixels(self, points: Float[Any, "*point 3"]) -> Float[np.ndarray, "*point 2"]:
        """Columns and rows of points over the plot [pixel]; NaN for what the lens does not have.

        **Arguments:** `points`, as of `sight`. A place is in the picture or beyond its edges.

        **Raises:** `InputError` without a lens.

        >>> import fynjax as fx
        >>> lens = fx.Lens(size=(101, 101), focal_length=(100.0, 100.0), centre=(50.0, 50.0))
        >>> frame = fx.Frame(fx.Pose([0.0, 0.0, 10.0]), lens)
        >>> frame.pixels([1.0, 2.0, 0.0])  # a metre east is 10 pixels, north is up
        array([60., 30.])
        """
        return self._known_lens.pixels(self.sight(points))

    def sees(self, points: Float[Any, "*point 3"]) -> Bool[np.ndarray, "*point"]:
        """Whether points over the plot lie within the picture. Arguments and errors as `pixels`."""
        return self._known_lens.holds(self.pixels(points))

    def sees_cells(self, corners: Float[Any, "row column 3"]) -> Bool[np.ndarray, "y x"]:
        """Whether cells of the ground lie wholly within the picture.

        **Arguments:** `corners` of the cells, one row and one column more than there are of them,
        as points of `sight`.

        **Raises:** `InputError` without a lens.
        """
        if self.mosaic:
            return np.any([frame.sees_cells(corners) for frame in self.mosaic], axis=0)
        corner = self.sees(corners)
        return corner[:-1, :-1] & corner[:-1, 1:] & corner[1:, :-1] & corner[1:, 1:]

    def view(self, points: Float[Any, "*point 3"]) -> Float[np.ndarray, "*point 2"]:
        """Zenith angle of the camera as seen from points over the plot, and its azimuth clockwise
        from the plot's north, 0 to 360 [degrees]. Arguments as of `sight`."""
        east, north, up = np.moveaxis(self.camera_over(points) - np.asarray(points, float), -1, 0)
        zenith = np.degrees(np.arctan2(np.hypot(east, north), up))
        return np.stack([zenith, np.degrees(np.arctan2(east, north)) % 360.0], axis=-1)

    @property
    def _known_lens(self) -> Lens:
        if self.lens is None:
            raise InputError(f"expected a frame with a lens, but {self.name or 'this'} has none")
        return self.lens
