"""Sampling a layer of voxels at shifted, scaled positions, one axis at a time.

Rays that share a direction, and the rays of a camera that looks straight down, meet every
horizontal plane in a rectangular lattice. A layer is then sampled by one small matrix per axis:
no gathers, and the derivative is the transposed product.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def axis_weights(
    centres: Float[Array, " point"], width: float, count: int, spacing: float, boundary: str
) -> Float[Array, "point cell"]:
    """Share of the interval of `width` around each centre that lies in each cell [-].

    Cell i spans [i, i + 1] * `spacing`. Rows sum to one for `boundary="periodic"`; for "open"
    what lies outside counts as empty. Sampling with it averages a piecewise constant field over
    the interval; the transpose puts what was found there back, conserving the sum.
    Differentiable in `centres` except where an end of the interval crosses a cell's edge.
    """
    length = count * spacing
    cell = jnp.arange(count, dtype=centres.dtype)

    def covered(x: Float[Array, " point"]) -> Float[Array, "point cell"]:
        """Length of each cell that lies below x, in cells."""
        return jnp.clip(x[:, None] / spacing - cell, 0.0, 1.0)

    def overlap(x: Float[Array, " point"]) -> Float[Array, "point cell"]:
        return covered(x + 0.5 * width) - covered(x - 0.5 * width)

    if boundary == "periodic":
        wrapped = jnp.mod(centres, length)
        total = overlap(wrapped) + overlap(wrapped - length) + overlap(wrapped + length)
    else:
        total = overlap(centres)
    return total * (spacing / width)


def sample(
    field: Float[Array, "*batch y x"],
    rows: Float[Array, "row y"],
    columns: Float[Array, "column x"],
) -> Float[Array, "*batch row column"]:
    """Sample the last two axes of `field` with one weight matrix each."""
    return jnp.einsum("ry,...yx,cx->...rc", rows, field, columns, optimize="optimal")
