"""Sampling a layer of voxels at shifted, scaled positions, one axis at a time.

Rays that share a direction, and the rays of a camera that looks straight down, meet every
horizontal plane in a rectangular lattice. A layer is then sampled by one small matrix per axis:
no gathers, and the derivative is the transposed product.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


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

    def covered(x: Float[Array, "*turn point"]) -> Float[Array, "*turn point cell"]:
        """Length of each cell that lies below x, in cells."""
        return jnp.clip(x[..., None] / spacing - cell, 0.0, 1.0)

    def overlap(x: Float[Array, "*turn point"]) -> Float[Array, "*turn point cell"]:
        return covered(x + 0.5 * width) - covered(x - 0.5 * width)

    if boundary == "periodic":
        # All turns at once: a third as many operations to compile.
        turns = np.array([[0.0], [-length], [length]], centres.dtype)
        total = overlap(jnp.mod(centres, length) + turns).sum(axis=0)
    else:
        total = overlap(centres)
    return total * (spacing / width)


def nearest_cells(
    centres: Float[Array, " point"], width: float, count: int, spacing: float, boundary: str
) -> tuple[Int[Array, "near point"], Float[Array, "near point"]]:
    """The same as the cells that the interval of `width` around each centre may touch, and its
    share in each: for wide grids."""
    # An interval may begin within a cell: it touches one more than it is long.
    near = math.ceil(width / spacing - 1e-6) + 1
    low = (centres - 0.5 * width) / spacing
    first = jnp.floor(jax.lax.stop_gradient(low))
    start = low - first
    cell = jnp.arange(near, dtype=centres.dtype)[:, None]
    length = width / spacing
    share = jnp.clip(start + length - cell, 0.0, 1.0) - jnp.clip(start - cell, 0.0, 1.0)
    index = first.astype(int) + jnp.arange(near)[:, None]
    if boundary == "periodic":
        return index % count, share / length
    inside = (index >= 0) & (index < count)
    return jnp.clip(index, 0, count - 1), jnp.where(inside, share, 0.0) / length


def sample_near(
    field: Float[Array, "*batch y x"],
    rows: tuple[Int[Array, "near row"], Float[Array, "near row"]],
    columns: tuple[Int[Array, "near column"], Float[Array, "near column"]],
) -> Float[Array, "*batch row column"]:
    """Sample the last two axes of `field` from the cells of `nearest_cells` along each."""
    # All that is near at once: each reading is a loop of its own in the derivative.
    (row, row_share), (column, column_share) = rows, columns
    by_row = jnp.sum(row_share[..., None] * field[..., row, :], axis=-3)
    return jnp.sum(column_share * by_row[..., column], axis=-2)


def resample(
    field: Float[Array, "*batch y x"],
    rows: Float[Array, "row y"],
    columns: Float[Array, "column x"],
) -> Float[Array, "*batch row column"]:
    """Sample the last two axes of `field` with one weight matrix each."""
    return jnp.einsum("ry,...yx,cx->...rc", rows, field, columns, optimize="optimal")
