"""What a frame camera's counts mean as radiance: dark level, exposure, gain, fall-off to corners.

The model is that which MicaSense publishes for its RedEdge and Altum cameras ("RedEdge Camera
Radiometric Calibration Model"; a RedEdge-P and Altum-PT have the vignetting of its library,
github.com/micasense/imageprocessing), and with other settings that of DJI's multispectral cameras
(Mavic 3M Image Processing Guide, 2023).
"""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.math import real_array, square_root


class CameraRadiometry(eqx.Module):
    """How one band of a camera counted light in one picture.

    One instance is one picture; many are made by `jax.vmap`. Rows count from the top of the
    picture, columns from its left, both from 0.
    """

    sensitivity: Float[Array, ""] = eqx.field(converter=real_array)
    """Coefficient a1: radiance that fills the scale at gain 1 in one second, at the centre of
    `vignetting` and in row 0 [W m-2 sr-1 um-1 s]."""
    exposure: Float[Array, ""] = eqx.field(converter=real_array)
    """Time of exposure t [s]."""
    black_level: Float[Array, ""] = eqx.field(converter=real_array)
    """Counts that covered pixels read [counts]."""
    gain: Float[Array, ""] = eqx.field(converter=real_array, default=1.0)
    """Gain of the amplifier g [-]; ISO speed / 100."""
    full_scale: float = eqx.field(static=True, converter=float, default=65536.0)
    """2 to the number of bits [counts]."""
    row_gradient: Float[Array, " 2"] = eqx.field(converter=real_array, default=(0.0, 0.0))
    """Coefficients a2 [s per row] and a3 [per row]: rows are read one after the other."""
    vignetting_centre: Float[Array, " 2"] = eqx.field(converter=real_array, default=(0.0, 0.0))
    """Column and row from which distance r is counted [pixel]."""
    vignetting: Float[Array, " order"] = eqx.field(converter=real_array, default=(0.0,))
    """Coefficients k0, k1, ... of 1 + k0 r + k1 r^2 + ... [pixel^-1, pixel^-2, ...]."""
    vignetting_is: Literal["response", "correction"] = eqx.field(static=True, default="response")
    """Whether that polynomial is the response of the pixels (MicaSense), or what their counts are
    to be multiplied with (DJI)."""
    vignetting_powers: tuple[tuple[int, int], ...] | None = eqx.field(static=True, default=None)
    """Powers (a, b) of terms (column / columns)^a (row / rows)^b, whose sum with the coefficients
    `vignetting` is then that polynomial (RedEdge-P, Altum-PT); `None` for one of the distance."""

    def response(self, shape: tuple[int, ...]) -> Float[Array, "row column"]:
        """Response of each pixel over that of the centre's in row 0 [-]. Differentiable."""
        dtype = jnp.result_type(self.vignetting, self.sensitivity)
        row = jnp.arange(shape[0], dtype=dtype)[:, None]
        column = jnp.arange(shape[1], dtype=dtype)[None, :]
        falloff = self._falloff(row, column, shape)
        if self.vignetting_is == "correction":
            falloff = 1.0 / falloff
        a2, a3 = self.row_gradient
        return falloff * (1.0 + a2 * row / self.exposure - a3 * row)

    def _falloff(self, row: Array, column: Array, shape: tuple[int, ...]) -> Array:
        if self.vignetting_powers is not None:
            x, y = column / shape[1], row / shape[0]
            terms = zip(self.vignetting, self.vignetting_powers, strict=True)
            return sum((k * x**a * y**b for k, (a, b) in terms), jnp.zeros_like(x * y))
        square = (column - self.vignetting_centre[0]) ** 2 + (row - self.vignetting_centre[1]) ** 2
        r = square_root(square)
        # k0 r + k1 r^2 + ..., by Horner's scheme.
        falloff = jnp.zeros_like(r)
        for k in self.vignetting[::-1]:
            falloff = (falloff + k) * r
        return 1.0 + falloff


def counts_to_radiance(
    counts: Float[ArrayLike, "row column"], camera: CameraRadiometry
) -> Float[Array, "row column"]:
    """Radiance of a picture in counts [W m-2 sr-1 um-1].

    L = a1 / g V (p - p_black) / (t + a2 y - a3 t y), p = counts / full scale, V = 1 / (1 + k0 r +
    ... + k5 r^6). Pixels darker than the dark level come out negative: they are noise, and cutting
    them off would make shadows too bright.

    **Arguments:**

    - `counts`: of the pixels [-], 0 to the camera's full scale.
    - `camera`: coefficients a, k, exposure t, gain g and dark level of the picture.

    Differentiable in all arguments.
    """
    counts = real_array(counts)
    scale = camera.sensitivity / (camera.gain * camera.exposure * camera.full_scale)
    return scale * (counts - camera.black_level) / camera.response(counts.shape)
