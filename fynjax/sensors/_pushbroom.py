"""Pushbroom sensor: one line of pixels that a flight sweeps over the ground."""

import dataclasses
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.sensors._camera import AbstractCamera, FrameCamera, Real


def _spacing(value: Any) -> Array | None:
    return None if value is None else jnp.asarray(value, dtype=float)


class PushbroomCamera(AbstractCamera):
    """A line of pixels flown straight and level towards its heading; rows are lines in time.

    Raises `InputError` if `line` has more than one row, or for numbers that are not positive.
    """

    line: FrameCamera
    """One line: a frame of one row, placed where the sensor is at the middle of the strip."""
    lines: int = eqx.field(static=True, default=1)
    """Number of lines."""
    spacing: Float[Array, ""] | None = eqx.field(converter=_spacing, default=None)
    """Distance flown between lines [m]; left out, the ground sample distance, so that pixels on
    the ground are square."""

    def __check_init__(self) -> None:
        if self.line.shape[0] != 1:
            raise InputError(f"`line` must have one row, but has {self.line.shape[0]}.")
        if self.lines != int(self.lines) or self.lines < 1:
            raise InputError(f"`lines` must be at least 1, but is {self.lines}.")
        known = self.spacing is not None and not isinstance(self.spacing, jax.core.Tracer)
        if known and not float(self.spacing) > 0.0:  # type: ignore[arg-type]
            raise InputError(f"`spacing` must be positive, in m, but is {self.spacing}.")

    @property
    def shape(self) -> tuple[int, int]:
        return int(self.lines), self.line.shape[1]

    @property
    def ground_sample_distance(self) -> Float[Array, ""]:
        return self.line.ground_sample_distance

    def over(
        self,
        x: Real,
        y: Real,
        *,
        altitude: Real | None = None,
        shape: tuple[int, int] | None = None,
    ) -> Self:
        lines, columns = self.shape if shape is None else shape
        line = self.line.over(x, y, altitude=altitude, shape=(1, columns))
        return dataclasses.replace(self, line=line, lines=lines)

    def ground_coordinates(self, height: float | Float[Array, ""] = 0.0) -> Float[Array, "2 y x"]:
        dtype = self.line.position.dtype
        spacing = self.ground_sample_distance if self.spacing is None else self.spacing
        flown = (jnp.arange(self.lines, dtype=dtype) - 0.5 * (self.lines - 1)) * spacing
        heading = jnp.deg2rad(self.line.heading.astype(dtype))
        ahead = jnp.stack([jnp.sin(heading), jnp.cos(heading)])
        steps = ahead[:, None, None] * flown.astype(dtype)[:, None]
        return self.line.ground_coordinates(height) + steps

    def view_directions(self) -> Float[Array, "3 y x"]:
        return jnp.broadcast_to(self.line.view_directions(), (3, *self.shape))

    def pixel_widths(self) -> Float[Array, "y x"]:
        return jnp.broadcast_to(self.line.pixel_widths(), self.shape)


def frame_of(camera: AbstractCamera) -> FrameCamera | None:
    """The optics of a frame camera, or of a pushbroom sensor's line.

    **Arguments:**

    - `camera`: of any kind.

    **Returns:** the `FrameCamera`, or None for a camera without one.
    """
    frame = camera.line if isinstance(camera, PushbroomCamera) else camera
    return frame if isinstance(frame, FrameCamera) else None
