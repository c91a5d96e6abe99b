"""The pixels of an image on the ground, and what share each has in cells smaller than it."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError


def axis_pixels(length: float, pixel: float, *, periodic: bool) -> tuple[int, float]:
    """Number of whole pixels along a side of a plot, and where the first begins [m].

    They lie in the middle of the side. A periodic plot, which goes on for ever, has at least one;
    raises `InputError` where an open plot has room for none.
    """
    count = int(np.floor(length / pixel + 1e-6))
    if count < 1 and not periodic:
        raise InputError(
            f"an open plot must be at least as wide as a pixel of {pixel:g} m, but is "
            f"{length:g} m wide: make the plot larger or fly lower, or let it repeat itself "
            '(boundary = "periodic")'
        )
    count = max(count, 1)
    start = 0.5 * (length - count * pixel)
    return count, 0.0 if abs(start) < 1e-6 * pixel else float(start)


def footprint_shares(
    centres: Float[np.ndarray, " pixel"],
    width: float,
    cells: int,
    length: float,
    *,
    periodic: bool,
    kernel: Float[Array, " tap"] | None = None,
) -> Float[Array, "pixel cell"]:
    """Share of each cell of an axis of `length` [m] in each pixel [-]; rows sum to one.

    **Arguments:** `centres` and `width` of the pixels [m]; `kernel`, weights of a pixel's
    neighbours (an odd number, itself in the middle), by which the sensor blurs its image.

    Beyond its ends a periodic axis repeats itself; an open one repeats its outermost pixels.
    """
    reach = 0 if kernel is None else kernel.shape[0] // 2
    taps = centres[0] + width * np.arange(-reach, centres.size + reach)
    if not periodic:
        taps = np.clip(taps, centres[0], centres[-1])
    edge = np.arange(cells) * (length / cells)

    def below(x: Float[np.ndarray, " pixel"]) -> Float[np.ndarray, "pixel cell"]:
        """Length of each cell, copies included, between 0 and x."""
        turns = np.floor(x / length)[:, None]
        inside = np.clip((x[:, None] - turns * length) - edge, 0.0, length / cells)
        return turns * (length / cells) + inside

    # Overlap of pixels and cells as a difference of two cumulated lengths.
    box = jnp.asarray((below(taps + 0.5 * width) - below(taps - 0.5 * width)) / width)
    if kernel is None:
        return box
    near = np.arange(centres.size)[:, None] + np.arange(2 * reach + 1)
    return jnp.einsum("t,ptc->pc", kernel, box.astype(kernel.dtype)[near])
