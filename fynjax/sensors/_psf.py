"""Point-spread function: how far a sensor's optics smear an image."""

from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax._core.spectral import FWHM_PER_SIGMA


def _pair(width: Any) -> Array:
    width = jnp.asarray(width, dtype=float) if not isinstance(width, jax.Array) else width
    return jnp.broadcast_to(width, (2,))


class PointSpread(eqx.Module):
    """Separable blur of an image whose pixels already average over their own footprint.

    Differentiable in the image and in `width`. Raises `InputError` for a width that is not
    finite, negative, or (box) below one pixel.
    """

    kind: Literal["gaussian", "box"] = eqx.field(static=True)
    """'gaussian', the blur of optics; 'box', even response, such as by motion."""
    width: Float[Array, " 2"] = eqx.field(converter=_pair)
    """Width across (x) and along (y) [pixels]. Gaussian: full width at half maximum of the blur
    that comes on top of the pixel's footprint. Box: width of the whole response, at least 1."""
    radius: int | None = eqx.field(static=True, default=None)
    """Reach of the blur [pixels]; left out, taken from `width`, which must then be concrete."""

    def __check_init__(self) -> None:
        if self.kind not in ("gaussian", "box"):
            raise InputError(f"a point spread is 'gaussian' or 'box', but this is {self.kind!r}.")
        if isinstance(self.width, jax.core.Tracer):
            if self.radius is None:
                raise InputError("`radius` must be given where `width` is traced.")
            return
        least = 1.0 if self.kind == "box" else 0.0
        widths = np.asarray(self.width)
        if not np.all(np.isfinite(widths)) or widths.min() < least or widths.max() > 1000.0:
            raise InputError(
                f"the width of a {self.kind} point spread must be from {least:g} to 1000 pixels, "
                f"but is {widths.tolist()}."
            )

    def on_pixels(self, size: float) -> "PointSpread":
        """The same blur of an image of other pixels, as wide as `size` of the present ones [-].

        What blurs beyond a pixel's own footprint keeps its width on the ground.
        """
        own = 1.0 if self.kind == "box" else 0.0
        return PointSpread(self.kind, own + (self.width - own) / size)

    def reach(self) -> int:
        """Pixels on each side that the blur takes from [-]."""
        if self.radius is not None:
            return self.radius
        widest = float(np.asarray(self.width).max())
        if self.kind == "box":
            return int(np.ceil(0.5 * widest))
        return int(np.ceil(6.0 * widest / FWHM_PER_SIGMA)) + 2

    def kernel(self, axis: Literal["x", "y"], dtype: Any = float) -> Float[Array, " tap"]:
        """Weights of the neighbours along an axis [-]; they sum to one."""
        index = 0 if axis == "x" else 1
        return _kernel(self.kind, self.width, index, self.reach(), np.dtype(dtype))

    def blur(
        self,
        image: Float[ArrayLike, "*batch y x"],
        *,
        boundary: Literal["edge", "periodic"] = "edge",
    ) -> Float[Array, "*batch y x"]:
        """Blur images, in their own unit.

        Beyond its sides an image repeats its outermost pixels ('edge') or itself ('periodic').
        """
        if boundary not in ("edge", "periodic"):
            raise InputError(f"`boundary` is 'edge' or 'periodic', but here {boundary!r}.")
        image = jnp.asarray(image)
        if not jnp.issubdtype(image.dtype, jnp.floating):
            image = image.astype(float)
        if image.ndim < 2:
            raise InputError(f"an image has axes y and x, but this has shape {image.shape}.")
        mode = "edge" if boundary == "edge" else "wrap"
        along_x = _convolve(image, self.kernel("x", image.dtype), mode)
        along_y = _convolve(jnp.swapaxes(along_x, -1, -2), self.kernel("y", image.dtype), mode)
        return jnp.swapaxes(along_y, -1, -2)


@partial(jax.jit, static_argnums=(0, 2, 3, 4), inline=True)
def _kernel(
    kind: str, widths: Float[Array, " 2"], index: int, reach: int, dtype: np.dtype
) -> Float[Array, " tap"]:
    width = widths[index].astype(dtype)
    place = np.arange(-reach, reach + 1, dtype=dtype)
    if kind == "box":
        half = 0.5 * width
        weights = jnp.clip(jnp.minimum(place + 0.5, half) - jnp.maximum(place - 0.5, -half), 0)
    else:
        # The discrete Gaussian (Lindeberg 1990, eq. 19): the variance is that of the continuous
        # one at any width, and blurs add up as they do there. Its transform is
        # exp(σ² (cos ω - 1)); the sum over frequencies inverts it to rounding.
        frequency = 2.0 * np.pi * np.arange(4 * reach + 4) / (4 * reach + 4)
        variance = (width / float(FWHM_PER_SIGMA)) ** 2
        transform = jnp.exp(variance * (np.cos(frequency) - 1.0).astype(dtype))
        weights = np.cos(np.outer(place, frequency)).astype(dtype) @ transform
    return weights / jnp.sum(weights)


@partial(jax.jit, static_argnums=2, inline=True)
def _convolve(
    image: Float[Array, "*batch n"], kernel: Float[Array, " tap"], mode: str
) -> Float[Array, "*batch n"]:
    rows = image.reshape(-1, image.shape[-1])
    reach = kernel.shape[0] // 2
    padded = jnp.pad(rows, ((0, 0), (reach, reach)), mode=mode)
    blurred = jax.vmap(lambda row: jnp.convolve(row, kernel, mode="valid", precision="highest"))
    return blurred(padded).reshape(image.shape)
