"""Cameras: where lines of sight come from, and how wide a pixel is on the ground.

Images lie on a map, so that a camera's own pixels play no part but by their width: `map_rays` lays
the line of sight of each pixel of the map.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.math import real_array
from fynjax._core.programs import concrete

Real = float | Float[Array, ""]


class AbstractCamera(eqx.Module):
    """Geometry of an imaging sensor."""

    @property
    @abc.abstractmethod
    def ground_sample_distance(self) -> Float[Array, ""]:
        """Pixel spacing on the ground, for optics straight below the camera [m]."""


class FrameCamera(AbstractCamera):
    """Pinhole camera with a flat array of square pixels and no lens distortion.

    Raises `InputError` for a line of sight at or above the horizon (where the values are known,
    that is outside a transformation).
    """

    position: Float[Array, " 3"] = eqx.field(converter=real_array)
    """East, north and altitude above the plot's zero level [m]."""
    focal_length_mm: Float[Array, ""] = eqx.field(converter=real_array)
    """Focal length [mm]."""
    pixel_pitch_um: Float[Array, ""] = eqx.field(converter=real_array)
    """Distance between pixel centres on the array [µm]."""
    array: tuple[int, int] = eqx.field(static=True, converter=tuple)
    """Columns and rows of the array."""
    tilt: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Angle of the optical axis from nadir, toward the heading [degrees]; 0 looks straight down."""
    heading: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Azimuth that the upper edge of the image points to, clockwise from north [degrees]."""

    def __check_init__(self) -> None:
        if not concrete(self.focal_length_mm, self.pixel_pitch_um, self.tilt):
            return
        half_field = np.degrees(np.arctan(0.5 * self.array[1] * float(self.pixel_at(1.0))))
        if not abs(float(self.tilt)) + half_field < 90.0:
            raise InputError(
                f"camera tilt must leave every pixel below the horizon, but {float(self.tilt):g} "
                f"degrees plus a half field of view of {half_field:.3g} degrees reaches it. "
                "Tilt is counted from nadir: was a gimbal pitch passed instead?"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the array."""
        return int(self.array[1]), int(self.array[0])

    @property
    def ground_sample_distance(self) -> Float[Array, ""]:
        return self.pixel_at(self.position[2])

    def pixel_at(self, altitude: Real) -> Float[Array, ""]:
        """Pixel spacing on the ground straight below, from `altitude` above it [m], by the optics
        [m]."""
        dtype = self.position.dtype
        pitch, focal = self.pixel_pitch_um.astype(dtype), self.focal_length_mm.astype(dtype)
        return pitch * 1e-3 / focal * altitude


class PushbroomCamera(AbstractCamera):
    """A line of pixels flown straight and level towards its heading: an image is its lines one
    after another. Raises `InputError` if `line` has more than one row."""

    line: FrameCamera
    """Camera of one line: a frame of one row, where the sensor is at the middle of the image."""

    def __check_init__(self) -> None:
        if self.line.shape[0] != 1:
            raise InputError(f"`line` must have one row, but has {self.line.shape[0]}.")

    @property
    def ground_sample_distance(self) -> Float[Array, ""]:
        return self.line.ground_sample_distance


class OrthographicCamera(AbstractCamera):
    """Camera at infinity: all lines of sight are parallel and pixels are equal on the ground.

    Raises `InputError` for a view that does not look down, where it is known.
    """

    pixel_size: float = eqx.field(static=True, converter=float)
    """Side of a pixel on the ground [m]."""
    view_zenith: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Angle between the vertical and the direction to the camera [degrees], in [0, 90)."""
    view_azimuth: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Azimuth of the direction from the ground to the camera, clockwise from north [degrees]."""

    def __check_init__(self) -> None:
        if concrete(self.view_zenith) and not 0.0 <= float(self.view_zenith) < 90.0:
            raise InputError(
                f"`view_zenith` must be in [0, 90) degrees, but is {float(self.view_zenith):g}."
            )

    @property
    def ground_sample_distance(self) -> Float[Array, ""]:
        return jnp.asarray(self.pixel_size, dtype=self.view_zenith.dtype)


def frame_of(camera: AbstractCamera) -> FrameCamera | None:
    """The optics of a frame camera, or of a pushbroom sensor's line.

    **Arguments:**

    - `camera`: of any kind.

    **Returns:** the `FrameCamera`, or None for a camera without one.
    """
    frame = camera.line if isinstance(camera, PushbroomCamera) else camera
    return frame if isinstance(frame, FrameCamera) else None
