"""The voxel grid, and the conservative deposition of area elements on it."""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError

_LARGEST_INDEX = 2**31 - 1


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


class VoxelGrid(eqx.Module):
    """A regular grid of boxes, square from above. All of it is static: it has no gradient."""

    shape: tuple[int, int, int] = eqx.field(static=True)
    """Number of voxels (nx, ny, nz) eastward, northward and upward."""
    horizontal_size: float = eqx.field(static=True, converter=float)
    """Side of a voxel along x and along y [m]."""
    vertical_size: float = eqx.field(static=True, converter=float)
    """Height of a voxel [m]."""
    origin: tuple[float, ...] = eqx.field(static=True, converter=_floats, default=(0.0, 0.0, 0.0))
    """South-west bottom corner (x, y, z) [m]."""

    def __check_init__(self) -> None:
        if len(self.shape) != 3 or any(int(n) != n or n < 1 for n in self.shape):
            raise InputError(
                f"`shape` must be three positive whole numbers (nx, ny, nz), but is {self.shape}"
            )
        for name in ("horizontal_size", "vertical_size"):
            size = getattr(self, name)
            if not (np.isfinite(size) and size > 0.0):
                raise InputError(f"`{name}` must be positive [m], but is {size}")
        if len(self.origin) != 3:
            raise InputError(f"`origin` must be (x, y, z) [m], but is {self.origin}")

    @classmethod
    def cover(
        cls,
        extent: tuple[float, float],
        top: float,
        horizontal_size: float,
        vertical_size: float | None = None,
    ) -> "VoxelGrid":
        """The grid over a plot.

        **Arguments:**

        - `extent`: sides (lx, ly) of the plot [m].
        - `top`: height that the grid reaches at least [m], positive.
        - `horizontal_size`: side of a voxel [m]; must divide both sides of the plot.
        - `vertical_size`: height of a voxel [m]; `horizontal_size` unless given.

        **Raises:** `InputError` where the voxels do not divide the plot's sides, or for sizes that
        are not positive.
        """
        counts = []
        for axis, side in zip("xy", extent, strict=True):
            count = round(side / horizontal_size) if horizontal_size > 0 else 0
            if count < 1 or abs(count * horizontal_size - side) > 1e-6 * side:
                raise InputError(
                    f"`horizontal_size` must be positive and divide the plot's sides, but "
                    f"{horizontal_size} m does not divide {side} m along {axis}"
                )
            counts.append(count)
        height = horizontal_size if vertical_size is None else vertical_size
        if not (height > 0.0 and top > 0.0):
            raise InputError(
                f"`top` and `vertical_size` must be positive [m], but are {top} and {height}"
            )
        layers = max(1, int(np.ceil(top / height - 1e-6)))
        return cls((counts[0], counts[1], layers), horizontal_size, height)

    @property
    def extent(self) -> tuple[float, float, float]:
        """Lengths (lx, ly, lz) [m]."""
        nx, ny, nz = self.shape
        return nx * self.horizontal_size, ny * self.horizontal_size, nz * self.vertical_size

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel [m3]."""
        return self.horizontal_size**2 * self.vertical_size

    @property
    def centres(
        self,
    ) -> tuple[Float[np.ndarray, " x"], Float[np.ndarray, " y"], Float[np.ndarray, " z"]]:
        """Coordinates of the voxel centres along x, y and z [m]."""
        sizes = (self.horizontal_size, self.horizontal_size, self.vertical_size)
        x, y, z = (
            start + (np.arange(n) + 0.5) * size
            for start, n, size in zip(self.origin, self.shape, sizes, strict=True)
        )
        return x, y, z


def deposit(
    positions: Float[Array | np.ndarray, "n 3"],
    area: Float[Array | np.ndarray, " n"],
    class_index: Int[Array | np.ndarray, " n"],
    grid: VoxelGrid,
    n_classes: int,
    *,
    width: float | None = None,
    boundary: Literal["periodic", "open"] = "periodic",
) -> Float[Array, "class z y x"]:
    """Area density that area elements give to a grid [m2 m-3].

    Each element is a box of leaves that is shared among the voxels it overlaps, so that the area
    on the grid is the area planted, at any resolution. A box as large as a voxel is the
    cloud-in-cell of Hockney and Eastwood (1988).

    **Arguments:**

    - `positions`: x, y, z of the elements [m].
    - `area`: their one-sided area [m2].
    - `class_index`: optical class of each, 0 to n_classes - 1.
    - `grid`: the voxels.
    - `n_classes`: number of optical classes.
    - `width`: edge of the box [m], at most that of a voxel or a whole multiple of it. With the same
      width, a coarse grid holds the means of a finer one. None: a voxel's edges, where the centre
      of mass stays.
    - `boundary`: "periodic" wraps sideways. "open" drops what falls outside: an element at the
      very edge keeps half, as if the grid were a window in a larger one, so that the densities
      of neighbouring windows add up to the whole.

    Upwards and downwards nothing is lost: what lies below the bottom or above the top goes to the
    layer there.

    **Returns:** the density of each class in each voxel, in the dtype of `positions` and `area`.

    Differentiable in `area` (linear) and in `positions` (once, piecewise: the slope jumps where
    a box's face crosses a voxel's).

    **Raises:** `InputError` for another `boundary`, a `width` that does not go with the voxels, a
    class index out of range (if it is known before tracing), or a grid of more than 2^31 values.

    >>> import jax.numpy as jnp
    >>> from fynjax.canopy import VoxelGrid, deposit
    >>> grid = VoxelGrid((2, 2, 2), horizontal_size=0.5, vertical_size=0.5)
    >>> density = deposit(
    ...     positions=jnp.array([[0.25, 0.25, 0.25], [0.5, 0.75, 0.75]]),
    ...     area=jnp.array([0.1, 0.2]),
    ...     class_index=jnp.array([0, 0]),
    ...     grid=grid,
    ...     n_classes=1,
    ... )
    >>> density[0, :, :, 0].round(3)  # [z, y] of the western column
    Array([[0.8, 0. ],
           [0. , 0.8]], dtype=float32)
    >>> round(float((density.sum() * grid.voxel_volume)), 6)  # m2: all of it
    0.3
    """
    if boundary not in ("periodic", "open"):
        raise InputError(f"`boundary` must be 'periodic' or 'open', but is {boundary!r}")
    _check_classes(class_index, n_classes)

    dtype = jnp.result_type(positions, area)
    sizes = (grid.horizontal_size, grid.horizontal_size, grid.vertical_size)
    times = tuple(_boxes(width, size) for size in sizes)
    # A box over several voxels is the mean of voxel-sized ones side by side: the first is
    # deposited, on a grid that reaches beyond the ends, and the field then averaged.
    beyond = tuple(
        0 if count == 1 or (axis < 2 and boundary == "periodic") else count
        for axis, count in enumerate(times)
    )
    counts = tuple(count + 2 * more for count, more in zip(grid.shape, beyond, strict=True))
    nx, ny, nz = counts
    size = n_classes * nx * ny * nz
    if n_classes < 1 or size > _LARGEST_INDEX:
        raise InputError(
            f"{n_classes} classes on {nx} x {ny} x {nz} voxels are {size} values, but a grid "
            f"must have between 1 and {_LARGEST_INDEX}; take larger voxels or fewer classes"
        )
    indices, shares = [], []
    for axis, (edge, boxes) in enumerate(zip(sizes, times, strict=True)):
        part = 1.0 if width is None else min(width / edge, 1.0)
        # Lower face of the box in voxels, and the share of the box beyond the next plane.
        start = (positions[:, axis] - grid.origin[axis]) / edge - 0.5 * part * boxes
        floor = jnp.floor(start)
        over = jnp.clip((start - floor - (1.0 - part)) / part, 0.0, 1.0).astype(dtype)
        low = floor.astype(jnp.int32) + beyond[axis]
        rule = "clamp" if axis == 2 else boundary
        # The last from which a box does not reach round to the other end.
        last = counts[axis] - boxes + 1 if beyond[axis] else counts[axis]
        pair = _neighbours(low, low + 1, over, last, rule)
        indices.append(pair[0])
        shares.append(pair[1])

    index, part_of_area = [], []
    amount = area.astype(dtype) / jnp.asarray(grid.voxel_volume, dtype)
    # Flat places on [class, z, y, x], or [z, class, y, x] where fields are widened by layers: two
    # layers, rows and columns for each element.
    kind, wide = jnp.asarray(class_index, jnp.int32), max(times) > 1
    for z, z_part in zip(indices[2], shares[2], strict=True):
        layer = z * n_classes + kind if wide else kind * nz + z
        for y, y_part in zip(indices[1], shares[1], strict=True):
            row = (layer * ny + y) * nx
            row_part = amount * z_part * y_part
            for x, x_part in zip(indices[0], shares[0], strict=True):
                index.append(row + x)
                part_of_area.append(row_part * x_part)
    # One flat scatter with an element's eight shares side by side is faster than one a corner.
    density = jnp.zeros(n_classes * nx * ny * nz, dtype)
    density = density.at[jnp.stack(index, axis=-1).ravel()].add(
        jnp.stack(part_of_area, axis=-1).ravel(), mode="drop"
    )
    if not wide:
        return density.reshape(n_classes, nz, ny, nx)
    widened = _widen(density.reshape(nz, n_classes, ny, nx), times, beyond)
    return jnp.swapaxes(widened, 0, 1)


def _boxes(width: float | None, size: float) -> int:
    """Voxels along the edge of a box of `width`; 1 where it is no wider than one."""
    if width is None:
        return 1
    times = width / size
    if not (width > 0 and (times <= 1 + 1e-6 or abs(times - round(times)) < 1e-6 * times)):
        raise InputError(
            f"`width` must be positive, and at most the edge of a voxel or a whole multiple of it, "
            f"but is {width} m for voxels of {size} m"
        )
    return max(1, round(times))


def _widen(density: Array, times: tuple[int, ...], beyond: tuple[int, ...]) -> Array:
    """Mean of [z, class, y, x] and of itself moved by 0, 1, ... `times` less one voxels along x, y
    and z; without the voxels `beyond` the ends, whose content goes to the ends of z."""

    def layer(below: Array, one: Array) -> tuple[Array, Array]:
        for axis, count, more in zip((2, 1), times, beyond):
            one = sum((jnp.roll(one, by, axis) for by in range(1, count)), start=one) / count
            one = jax.lax.slice_in_dim(one, more, one.shape[axis] - more, axis=axis)
        # As many layers as are yet to be added to those above.
        column = jnp.concatenate([below, one[None]])
        return column[1:], column.mean(axis=0)

    # A layer at a time: whole fields between these steps would be kept for the derivative.
    nz, n_classes, *sides = density.shape
    ny, nx = (size - 2 * more for size, more in zip(sides, beyond[1::-1], strict=True))
    none = jnp.zeros((times[2] - 1, n_classes, ny, nx), density.dtype)
    _, moved = jax.lax.scan(layer, none, density)
    size = nz - 2 * beyond[2]
    ends = np.clip(np.arange(nz) - beyond[2], 0, size - 1)
    return moved if size == nz else jax.ops.segment_sum(moved, ends, size)


def _neighbours(
    low: Array, high: Array, share: Array, count: int, rule: str
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Indices of the two nearest layers along an axis, and the share of each."""
    near = 1.0 - share
    if rule == "periodic":
        return (jnp.mod(low, count), jnp.mod(high, count)), (near, share)
    clamped = jnp.clip(low, 0, count - 1), jnp.clip(high, 0, count - 1)
    if rule == "open":
        near = jnp.where((low >= 0) & (low < count), near, 0.0)
        share = jnp.where((high >= 0) & (high < count), share, 0.0)
    return clamped, (near, share)


def _check_classes(class_index: Any, n_classes: int) -> None:
    """The scatter trusts its indices, so a wrong class must be caught while it is a number."""
    if isinstance(class_index, jax.core.Tracer) or np.size(class_index) == 0:
        return
    known = np.asarray(class_index)
    if known.min() < 0 or known.max() >= n_classes:
        raise InputError(
            f"`class_index` must be in 0..{n_classes - 1}, but ranges from {known.min()} to "
            f"{known.max()}"
        )
