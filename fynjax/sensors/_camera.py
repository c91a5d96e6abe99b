"""Cameras: the line of sight of every pixel.

A camera knows its geometry only. For each pixel it gives the point where the line of sight through
the pixel's centre meets a horizontal plane, and the unit vector from there to the camera. The
radiation road renders along these lines.

Pixel arrays are [y, x]: columns run to the right of the image, rows upward. With the heading at
north, column index grows eastward and row index northward, as everywhere in fynjax; a raster
file's top-down row order is the business of its writer.
"""

import abc
import dataclasses
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.geometry import direction
from fynjax._core.math import real_array

Real = float | Float[Array, ""]


def _concrete(*values: Any) -> bool:
    return not any(isinstance(v, jax.core.Tracer) for v in values)


class AbstractCamera(eqx.Module):
    """What the renderer needs of a camera. Differentiable in every continuous field."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int]:
        """Rows (y) and columns (x) of the image."""

    @property
    @abc.abstractmethod
    def ground_sample_distance(self) -> Float[Array, ""]:
        """Pixel spacing on the zero level, for optics straight below the camera [m]."""

    @abc.abstractmethod
    def ground_coordinates(self, height: float | Float[Array, ""] = 0.0) -> Float[Array, "2 y x"]:
        """x and y [m] where the line of sight of each pixel meets the plane at `height` [m]."""

    @abc.abstractmethod
    def view_directions(self) -> Float[Array, "3 y x"]:
        """Unit vectors (east, north, up) from the ground to the camera [-]."""

    @abc.abstractmethod
    def pixel_widths(self) -> Float[Array, "y x"]:
        """Edge of each pixel's footprint on the zero level, across its line of sight [m]."""

    @abc.abstractmethod
    def over(
        self,
        x: Real,
        y: Real,
        *,
        altitude: Real | None = None,
        shape: tuple[int, int] | None = None,
    ) -> Self:
        """The same sensor above the point (`x`, `y`) [m].

        **Arguments:** `altitude` above the plot's zero level [m], and `shape`, rows and columns
        about the middle of the image; left out they stay as they are.
        """

    @eqx.filter_jit
    def tangents(self) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
        """Horizontal shift east (tx) and north (ty) of each line of sight per metre of rise [-].

        The line through ground point (x, y) passes (x + tx z, y + ty z) at height z.
        """
        east, north, up = self.view_directions()
        return east / up, north / up


class FrameCamera(AbstractCamera):
    """Pinhole camera with a flat array of square pixels and no lens distortion.

    Raises `InputError` for a size that is not positive or a line of sight at or above the horizon
    (where the values are known, that is outside a transformation).
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
        if self.position.shape != (3,):
            raise InputError(
                f"camera position must be (x, y, altitude) in m, but has shape "
                f"{self.position.shape}."
            )
        if len(self.array) != 2 or any(n != int(n) or n < 1 for n in self.array):
            raise InputError(f"`array` must be (columns, rows) of at least 1, but is {self.array}.")
        optics = (self.position, self.focal_length_mm, self.pixel_pitch_um, self.tilt)
        if not _concrete(*optics):
            return
        for what, value in (
            ("altitude (m)", self.position[2]),
            ("focal_length_mm", self.focal_length_mm),
            ("pixel_pitch_um", self.pixel_pitch_um),
        ):
            if not float(value) > 0.0:
                raise InputError(f"camera {what} must be positive, but is {float(value):g}.")
        half_field = np.degrees(np.arctan(0.5 * self.array[1] * float(self._pitch_per_focal())))
        if not abs(float(self.tilt)) + half_field < 90.0:
            raise InputError(
                f"camera tilt must leave every pixel below the horizon, but {float(self.tilt):g} "
                f"degrees plus a half field of view of {half_field:.3g} degrees reaches it. "
                "Tilt is counted from nadir: was a gimbal pitch passed instead?"
            )

    def _pitch_per_focal(self) -> Float[Array, ""]:
        dtype = self.position.dtype
        pitch, focal = self.pixel_pitch_um.astype(dtype), self.focal_length_mm.astype(dtype)
        return pitch * 1e-3 / focal

    @property
    def shape(self) -> tuple[int, int]:
        return int(self.array[1]), int(self.array[0])

    @property
    def ground_sample_distance(self) -> Float[Array, ""]:
        """Pixel spacing on the zero level straight below the camera, from the optics [m]."""
        return self._pitch_per_focal() * self.position[2]

    def over(
        self,
        x: Real,
        y: Real,
        *,
        altitude: Real | None = None,
        shape: tuple[int, int] | None = None,
    ) -> Self:
        height = self.position[2] if altitude is None else altitude
        dtype = jnp.result_type(0.0, x, y, height)
        position = jnp.stack([jnp.asarray(v, dtype) for v in (x, y, height)])
        array = self.array if shape is None else (shape[1], shape[0])
        return dataclasses.replace(self, position=position, array=array)

    @eqx.filter_jit
    def _sight(self) -> tuple[Array, Array, Array]:
        """To the right [x], ahead and down [y, 1] of each pixel, per length along the axis."""
        # Float32 needs the angles, not the positions: no large coordinates are subtracted here.
        dtype = self.position.dtype
        rows, columns = self.shape
        ratio = self._pitch_per_focal()
        right = (jnp.arange(columns, dtype=dtype) - 0.5 * (columns - 1)) * ratio
        above = (jnp.arange(rows, dtype=dtype)[:, None] - 0.5 * (rows - 1)) * ratio
        tilt = jnp.deg2rad(self.tilt.astype(dtype))
        ahead = jnp.sin(tilt) + above * jnp.cos(tilt)
        return right, ahead, jnp.cos(tilt) - above * jnp.sin(tilt)

    def pixel_widths(self) -> Float[Array, "y x"]:
        down = self._sight()[2]
        return jnp.broadcast_to(self.ground_sample_distance / down, self.shape)

    @eqx.filter_jit
    def view_directions(self) -> Float[Array, "3 y x"]:
        right, ahead, down = self._sight()
        heading = jnp.deg2rad(self.heading.astype(self.position.dtype))
        east = right * jnp.cos(heading) + ahead * jnp.sin(heading)
        north = -right * jnp.sin(heading) + ahead * jnp.cos(heading)
        to_sensor = jnp.stack(jnp.broadcast_arrays(-east, -north, down))
        return to_sensor / jnp.sqrt(jnp.sum(to_sensor**2, axis=0))

    def ground_coordinates(self, height: float | Float[Array, ""] = 0.0) -> Float[Array, "2 y x"]:
        """x and y [m] where the line of sight of each pixel meets the plane at `height` [m].

        Raises `InputError` if the camera is not above that plane (where the values are known).
        """
        if _concrete(height, self.position) and not float(self.position[2]) > float(height):
            raise InputError(
                f"the camera must be above the plane that its lines of sight meet "
                f"({float(height):g} m), but its altitude is {float(self.position[2]):g} m."
            )
        drop = self.position[2] - jnp.asarray(height, dtype=self.position.dtype)
        tx, ty = self.tangents()
        return jnp.stack([self.position[0] - tx * drop, self.position[1] - ty * drop])


class OrthographicCamera(AbstractCamera):
    """Camera at infinity: all lines of sight are parallel and pixels are equal on the ground."""

    extent: tuple[float, float, float, float] = eqx.field(
        static=True, converter=lambda v: tuple(float(x) for x in v)
    )
    """West, south, east and north edge of the image on the zero level [m]."""
    pixel_size: float = eqx.field(static=True, converter=float)
    """Side of a pixel on the ground [m]."""
    view_zenith: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Angle between the vertical and the direction to the camera [degrees], in [0, 90)."""
    view_azimuth: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Azimuth of the direction from the ground to the camera, clockwise from north [degrees]."""

    def __check_init__(self) -> None:
        if len(self.extent) != 4 or not self.pixel_size > 0.0:
            raise InputError(
                "an orthographic camera needs an extent (west, south, east, north) and a positive "
                f"pixel size in m, but has {self.extent} and {self.pixel_size:g}."
            )
        west, south, east, north = self.extent
        for low, high, what in ((west, east, "east-west"), (south, north, "north-south")):
            count = (high - low) / self.pixel_size
            if not count > 0.5 or abs(count - round(count)) > 1e-6 * count:
                raise InputError(
                    f"the {what} extent must be a positive multiple of the pixel size "
                    f"{self.pixel_size:g} m, but is {high - low:g} m."
                )
        if _concrete(self.view_zenith) and not 0.0 <= float(self.view_zenith) < 90.0:
            raise InputError(
                f"`view_zenith` must be in [0, 90) degrees, but is {float(self.view_zenith):g}."
            )

    @property
    def shape(self) -> tuple[int, int]:
        west, south, east, north = self.extent
        return round((north - south) / self.pixel_size), round((east - west) / self.pixel_size)

    @property
    def ground_sample_distance(self) -> Float[Array, ""]:
        return jnp.asarray(self.pixel_size, dtype=self.view_zenith.dtype)

    def pixel_widths(self) -> Float[Array, "y x"]:
        return jnp.broadcast_to(self.ground_sample_distance, self.shape)

    def over(
        self,
        x: Real,
        y: Real,
        *,
        altitude: Real | None = None,
        shape: tuple[int, int] | None = None,
    ) -> Self:
        if altitude is not None:
            raise InputError(
                "an orthographic view has no altitude, only a pixel size: leave `altitude` out."
            )
        rows, columns = self.shape if shape is None else shape
        half_x, half_y = 0.5 * columns * self.pixel_size, 0.5 * rows * self.pixel_size
        east, north = float(x), float(y)
        extent = (east - half_x, north - half_y, east + half_x, north + half_y)
        return dataclasses.replace(self, extent=extent)

    def view_directions(self) -> Float[Array, "3 y x"]:
        toward = direction(self.view_zenith, self.view_azimuth)
        return jnp.broadcast_to(toward[:, None, None], (3, *self.shape))

    def ground_coordinates(self, height: float | Float[Array, ""] = 0.0) -> Float[Array, "2 y x"]:
        rows, columns = self.shape
        dtype = self.view_zenith.dtype
        x = self.extent[0] + (jnp.arange(columns, dtype=dtype) + 0.5) * self.pixel_size
        y = self.extent[1] + (jnp.arange(rows, dtype=dtype) + 0.5) * self.pixel_size
        tx, ty = self.tangents()
        rise = jnp.asarray(height, dtype=dtype)
        return jnp.stack([x + tx * rise, y[:, None] + ty * rise])
