"""Between the fine grid and the coarse one: means over blocks of voxels, and back."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def block_mean(
    field: Float[Array, "*batch z y x"], factor: tuple[int, int]
) -> Float[Array, "*batch Z Y X"]:
    """Average over blocks of `factor` = (layers, columns) voxels."""
    *batch, nz, ny, nx = field.shape
    fz, fh = factor
    blocks = field.reshape(*batch, nz // fz, fz, ny // fh, fh, nx // fh, fh)
    return blocks.mean(axis=(-5, -3, -1))


def spread(
    field: Float[Array, "*batch Z Y X"], factor: tuple[int, int]
) -> Float[Array, "*batch z y x"]:
    """Give every voxel the value of its cell."""
    for axis, times in zip((-3, -2, -1), (factor[0], factor[1], factor[1])):
        field = jnp.repeat(field, times, axis=axis)
    return field


def upsample(
    field: Float[Array, "*batch Z Y X"], factor: tuple[int, int], boundary: str
) -> Float[Array, "*batch z y x"]:
    """Linear interpolation of coarse cell means to the fine voxels' centres."""
    # Along x, where neighbours lie next to each other, a product with a small matrix is fastest.
    field = field @ jnp.asarray(_linear(field.shape[-1], factor[1], boundary).T, field.dtype)
    field = _upsample_axis(field, -2, factor[1], boundary)
    return _upsample_axis(field, -3, factor[0], "open")


def _upsample_axis(field: Array, axis: int, factor: int, boundary: str) -> Array:
    count = field.shape[axis]
    part = lambda start, end: jax.lax.slice_in_dim(field, start, end, axis=axis)  # noqa: E731
    first, last = part(0, 1), part(count - 1, count)
    beyond = (last, first) if boundary == "periodic" else (first, last)
    # Not by `jnp.pad`, whose derivative keeps whole fields of zeros.
    below = jnp.concatenate([beyond[0], part(0, count - 1)], axis)
    above = jnp.concatenate([part(1, count), beyond[1]], axis)
    # Centres of the voxels from that of their cell, in cells: a neighbour has that share.
    offsets = (np.arange(factor) + 0.5) / factor - 0.5
    near = lambda o: below if o < 0 else above  # noqa: E731
    pieces = [(1 - abs(o)) * field + abs(o) * near(o) for o in map(float, offsets)]
    shape = list(field.shape)
    shape[axis] *= factor
    return jnp.stack(pieces, axis=field.ndim + axis + 1).reshape(shape)


def _linear(count: int, factor: int, boundary: str) -> np.ndarray:
    """Weights [count * factor, count] of linear interpolation between cell centres."""
    position = (np.arange(count * factor) + 0.5) / factor - 0.5
    low = np.floor(position).astype(int)
    share = position - low
    weights = np.zeros((count * factor, count))
    for index, weight in ((low, 1 - share), (low + 1, share)):
        cell = index % count if boundary == "periodic" else np.clip(index, 0, count - 1)
        np.add.at(weights, (np.arange(count * factor), cell), weight)
    return weights
