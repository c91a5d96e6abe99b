"""Rays of a sensor: parallel, of a frame camera, or any."""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import abc
import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax._core.geometry import direction
from fynjax._core.programs import concrete
from fynjax.canopy import AbstractLeafAngle, projections
from fynjax.radiation._check import (
    check_attitude,
    check_camera,
    check_pixels,
    check_shape,
    check_view,
    check_whole,
)
from fynjax.radiation._resample import axis_weights, nearest_cells, resample, sample_near

_NEAR, _MANY, _MANY_OF_EACH = 3, 64, 201
"""Cells under a pixel up to which, and along a lattice from which on, they are read one by one: of
one field, and of several."""


class Lattice(NamedTuple):
    """Cells of a layer: those of the voxels, or of the beams of the sun."""

    rows: int
    """Number of cells along y."""
    columns: int
    """Number of cells along x."""
    spacing: float
    """Side of a cell [m]."""
    boundary: str
    """Rule for what stands beside the cells, as in `VoxelScene`."""


class AbstractRays(eqx.Module):
    """Rays of a sensor, one for each pixel.

    The ray of a pixel passes the bottom of the grid at (`x`, `y`) and height z at
    (x + z `slope_x`, y + z `slope_y`).
    """

    @property
    @abc.abstractmethod
    def sensor_height(self) -> float:
        """Height of the sensor above the bottom of the grid [m]; infinite for parallel rays."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int]:
        """Rows and columns of pixels."""

    @property
    @abc.abstractmethod
    def cosine(self) -> Float[Array, "row column"]:
        """Cosine of the view zenith angle [-]."""

    @property
    @abc.abstractmethod
    def towards(self) -> Float[Array, "row column 3"]:
        """Unit vectors towards the sensor; one row and column where all rays are parallel."""

    @property
    @abc.abstractmethod
    def central(self) -> Float[Array, " 3"]:
        """Unit vector towards the sensor from the middle of the field of view."""

    @abc.abstractmethod
    def angular(self, function: Callable[[Array], Array]) -> Float[Array, "*value row column"]:
        """Evaluate a smooth function of the direction for every pixel.

        `function` maps unit vectors towards the sensor [n, 3] to [*value, n]. It is evaluated
        at a few Chebyshev points of the field of view and interpolated between.
        """

    @abc.abstractmethod
    def together(self, size: int) -> AbstractRays:
        """Rays along the middle of each block of `size` x `size` rays, as wide as the block."""

    @abc.abstractmethod
    def sampler(
        self,
        height: Array,
        lattice: Lattice,
        offset: tuple[Array, Array] | None = None,
        *,
        smooth: bool = False,
    ) -> Callable[[Array], Array]:
        """How a pixel's footprint at `height` [m] averages a field [..., y, x] on `lattice`,
        whose corner lies at minus `offset` [m]. `smooth`: the field is linear between the centres
        of its cells, in place of the same all over a cell."""

    def sine_to(self, vector: Float[Array, " 3"]) -> Float[Array, "row column"]:
        """Sine of the angle between a unit vector and the ray [-]."""
        cross = jnp.cross(self.towards, vector)
        # The root of 1 in place of 0, times 0: no slope without bound where they are parallel.
        square = jnp.sum(cross**2, axis=-1)
        return jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)


class RayLattice(AbstractRays):
    """Rays of a parallel projection, or of a frame camera that looks straight down: they meet
    every horizontal plane in a rectangular lattice, which makes them cheap."""

    x: Float[Array, " column"]
    """Easting of the pixel's centre on the ground [m]."""
    y: Float[Array, " row"]
    """Northing of the pixel's centre on the ground [m], increasing."""
    slope_x: Float[Array, " column"]
    """Eastward distance per height along the ray, towards the sensor [-]."""
    slope_y: Float[Array, " row"]
    footprint: float = eqx.field(static=True)
    """Edge of the pixel's square footprint on the ground [m]."""
    nodes: int = eqx.field(static=True)
    """Directions per axis at which angular functions are evaluated; 1 for parallel rays."""
    altitude: float = eqx.field(static=True, default=math.inf)
    """Height of the sensor above the bottom of the grid [m]; infinite for parallel rays."""
    picture: Float[Array, "2 2"] | None = None
    """Slopes of the first and the last pixel (columns) along x and y (rows) of the picture that
    these rays are a part of; None: they are all of it."""

    @property
    def sensor_height(self) -> float:
        return self.altitude

    @property
    def shape(self) -> tuple[int, int]:
        return self.y.shape[0], self.x.shape[0]

    @property
    def cosine(self) -> Float[Array, "row column"]:
        return 1.0 / jnp.sqrt(1.0 + self.slope_x**2 + self.slope_y[:, None] ** 2)

    @property
    def towards(self) -> Float[Array, "row column 3"]:
        if self.nodes == 1:
            return self.central[None, None]
        along, across = jnp.broadcast_arrays(self.slope_x[None, :], self.slope_y[:, None])
        vectors = jnp.stack([along, across, jnp.ones_like(along)], axis=-1)
        return vectors * self.cosine[..., None]

    def angular(self, function: Callable[[Array], Array]) -> Float[Array, "*value row column"]:
        ends_x, ends_y = self.ends
        node_x, weight_x = _chebyshev(self.slope_x, self.nodes, ends_x)
        node_y, weight_y = _chebyshev(self.slope_y, self.nodes, ends_y)
        sx, sy = (a.ravel() for a in jnp.meshgrid(node_x, node_y, indexing="xy"))
        vectors = jnp.stack([sx, sy, jnp.ones_like(sx)], axis=-1)
        vectors = vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True)
        values = function(vectors)
        values = values.reshape(*values.shape[:-1], self.nodes, self.nodes)
        if self.nodes == 1:
            return values
        return jnp.einsum("rj,...ji,ci->...rc", weight_y, values, weight_x)

    def rows(self, start: Array | int, size: int) -> RayLattice:
        """The rays of `size` rows from `start` on, which may be a traced value: a part of the
        picture that these are."""
        cut = lambda axis: jax.lax.dynamic_slice_in_dim(axis, start, size)  # noqa: E731
        y, slope_y = cut(self.y), cut(self.slope_y)
        return dataclasses.replace(self, y=y, slope_y=slope_y, picture=self.ends)

    def together(self, size: int) -> RayLattice:
        mean = lambda axis: axis.reshape(-1, size).mean(axis=1)  # noqa: E731
        return RayLattice(
            mean(self.x),
            mean(self.y),
            mean(self.slope_x),
            mean(self.slope_y),
            self.footprint * size,
            self.nodes,
            self.altitude,
            self.ends,
        )

    @property
    def central(self) -> Float[Array, " 3"]:
        vector = jnp.append(self.ends.mean(axis=1), 1.0)
        return vector / jnp.linalg.norm(vector)

    @property
    def ends(self) -> Float[Array, "2 2"]:
        """Slopes at the ends of the field of view, as `picture`."""
        if self.picture is not None:
            return self.picture
        return jnp.stack([slope[jnp.array([0, -1])] for slope in (self.slope_x, self.slope_y)])

    def sampler(
        self,
        height: Array,
        lattice: Lattice,
        offset: tuple[Array, Array] | None = None,
        *,
        smooth: bool = False,
    ) -> Callable[[Array], Array]:
        right, up = (0.0, 0.0) if offset is None else offset
        spacing, boundary = lattice.spacing, lattice.boundary
        # The mean over a cell's width of what is even in cells is linear between their centres.
        width = max(self.footprint, spacing) if smooth else self.footprint
        x, y = self.x + height * self.slope_x + right, self.y + height * self.slope_y + up
        if smooth and boundary == "open":
            x, y = (
                _inside(place, count * spacing, width)
                for place, count in ((x, lattice.columns), (y, lattice.rows))
            )
        axes = (
            (y, width, lattice.rows, spacing, boundary),
            (x, width, lattice.columns, spacing, boundary),
        )

        def average(field: Array) -> Array:
            # Of many cells those are read that are wanted; of few, a product is cheaper.
            many = _MANY if field.ndim == 2 else _MANY_OF_EACH
            if width <= _NEAR * spacing and min(field.shape[-2:]) >= many:
                return sample_near(field, *(nearest_cells(*axis) for axis in axes))
            return resample(field, *(axis_weights(*axis) for axis in axes))

        return average


class RayField(AbstractRays):
    """Rays in any directions, such as those of a tilted frame camera."""

    x: Float[Array, "row column"]
    """Easting at which the pixel's ray meets the bottom of the grid [m]."""
    y: Float[Array, "row column"]
    """Northing at which the pixel's ray meets the bottom of the grid [m]."""
    slope_x: Float[Array, "row column"]
    """Eastward distance per height along the ray, towards the sensor [-]."""
    slope_y: Float[Array, "row column"]
    width: Float[Array, "row column"]
    """Edge of the square over which a pixel averages on the ground [m]; voxels are averaged over
    one voxel at most, or over `widest` if that is more, so use more pixels where they are larger.
    """
    altitude: float = eqx.field(static=True, default=math.inf)
    nodes: int = eqx.field(static=True, default=7)
    """Directions per axis at which angular functions are evaluated."""
    widest: float = eqx.field(static=True, default=0.0)
    """Width up to which a pixel averages cells that are smaller, such as beams of the sun [m]."""

    @property
    def sensor_height(self) -> float:
        return self.altitude

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.x.shape
        return rows, columns

    @property
    def cosine(self) -> Float[Array, "row column"]:
        return 1.0 / jnp.sqrt(1.0 + self.slope_x**2 + self.slope_y**2)

    @property
    def towards(self) -> Float[Array, "row column 3"]:
        vectors = jnp.stack([self.slope_x, self.slope_y, jnp.ones_like(self.slope_x)], axis=-1)
        return vectors * self.cosine[..., None]

    def together(self, size: int) -> RayField:
        rows, columns = self.shape

        def mean(field: Array) -> Array:
            return field.reshape(rows // size, size, columns // size, size).mean(axis=(1, 3))

        return RayField(
            mean(self.x),
            mean(self.y),
            mean(self.slope_x),
            mean(self.slope_y),
            mean(self.width) * size,
            self.altitude,
            self.nodes,
            self.widest * size,
        )

    @property
    def central(self) -> Float[Array, " 3"]:
        middle = jnp.mean(self.towards, axis=(0, 1))
        return middle / jnp.linalg.norm(middle)

    def angular(self, function: Callable[[Array], Array]) -> Float[Array, "*value row column"]:
        east, north = self.towards[..., 0], self.towards[..., 1]
        # Over east and north of the unit vector, which stay within a square for any tilt.
        node_x, weight_x = _chebyshev(east.ravel(), self.nodes, _range(east))
        node_y, weight_y = _chebyshev(north.ravel(), self.nodes, _range(north))
        sx, sy = (a.ravel() for a in jnp.meshgrid(node_x, node_y, indexing="xy"))
        # The corners of the box may lie beyond the horizon, where no pixel looks.
        height = jnp.sqrt(jnp.maximum(1.0 - sx**2 - sy**2, 1e-3))
        vectors = jnp.stack([sx, sy, height], axis=-1)
        values = function(vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True))
        values = values.reshape(*values.shape[:-1], self.nodes, self.nodes)
        flat = jnp.einsum("pj,...ji,pi->...p", weight_y, values, weight_x)
        return flat.reshape(*flat.shape[:-1], *self.shape)

    def sampler(
        self,
        height: Array,
        lattice: Lattice,
        offset: tuple[Array, Array] | None = None,
        *,
        smooth: bool = False,
    ) -> Callable[[Array], Array]:
        right, up = (0.0, 0.0) if offset is None else offset
        spacing = lattice.spacing
        # A footprint is no wider than so many cells here, and lies in one more along each axis.
        reach = max(1, math.ceil(self.widest / spacing - 1e-6))
        width = jnp.minimum(self.width, reach * spacing)
        if smooth:
            width = jnp.maximum(width, spacing)
        axes = [
            (self.y + height * self.slope_y + up, lattice.rows),
            (self.x + height * self.slope_x + right, lattice.columns),
        ]
        if smooth and lattice.boundary == "open":
            edge = max(self.widest, spacing)
            axes = [(_inside(place, count * spacing, edge), count) for place, count in axes]
        rows, columns = (_cells(place, width, count, lattice, reach) for place, count in axes)

        def gather(field: Array) -> Array:
            """Cell values lie side by side, so that each corner is one read."""
            cells = jnp.moveaxis(field.reshape(-1, lattice.rows * lattice.columns), 0, 1)
            total = jnp.zeros((*self.shape, cells.shape[1]), field.dtype)
            for row, row_share in rows:
                for column, column_share in columns:
                    at = cells[row * lattice.columns + column]
                    total = total + (row_share * column_share)[..., None] * at
            return jnp.moveaxis(total, -1, 0).reshape(*field.shape[:-2], *self.shape)

        return gather


def _inside(centre: Array, length: float, width: float) -> Array:
    """Centres of intervals of `width` within a line of `length` [m]: beyond its ends a field goes
    on as it is there."""
    half = 0.5 * min(width, length)
    return jnp.clip(centre, half, length - half)


def _cells(
    centre: Array, width: Array, count: int, lattice: Lattice, reach: int
) -> list[tuple[Array, Array]]:
    """The cells that an interval of at most `reach` cells' width touches, and its share in each."""
    # Lower end of the interval in cells; what of it lies below the upper end of each cell.
    low = (centre - 0.5 * width) / lattice.spacing
    first = jnp.floor(jax.lax.stop_gradient(low))
    below = [
        jnp.clip((first + k - low) * lattice.spacing / width, 0.0, 1.0) for k in range(1, reach + 1)
    ]
    shares = [
        above - under
        for under, above in zip([jnp.zeros_like(low), *below], [*below, jnp.ones_like(low)])
    ]
    cell = first.astype(int)
    if lattice.boundary == "periodic":
        return [((cell + k) % count, share) for k, share in enumerate(shares)]
    return [
        (
            jnp.clip(cell + k, 0, count - 1),
            jnp.where((cell + k >= 0) & (cell + k < count), share, 0.0),
        )
        for k, share in enumerate(shares)
    ]


def _range(values: Array) -> Float[Array, " 2"]:
    return jnp.stack([values.min(), values.max()])


def parallel_rays(
    x: Float[ArrayLike, " column"],
    y: Float[ArrayLike, " row"],
    footprint: float,
    view_zenith: Float[ArrayLike, ""],
    view_azimuth: Float[ArrayLike, ""],
) -> RayLattice:
    """Rays of a distant sensor, one direction for all pixels.

    **Arguments:**

    - `x`, `y`: centres of the columns and rows of pixels on the ground [m], increasing.
    - `footprint`: edge of a pixel there [m], positive.
    - `view_zenith`: zenith angle of the sensor [degrees], in [0, 90).
    - `view_azimuth`: azimuth of the sensor, clockwise from north [degrees].

    **Raises:** `InputError` where there is no pixel, for more than one view, and, outside a
    transformation, for values out of range.

    Differentiable in all but `footprint`.
    """
    x, y, footprint = check_pixels(x, y, footprint)
    hint = ": rays have one view, so take one call for each"
    zenith = check_shape("view_zenith", view_zenith, (), hint)
    azimuth = check_shape("view_azimuth", view_azimuth, (), hint)
    check_view(zenith, azimuth)
    towards = direction(zenith, azimuth).astype(x.dtype)
    return RayLattice(
        x,
        y,
        jnp.full_like(x, 1.0) * (towards[0] / towards[2]),
        jnp.full_like(y, 1.0) * (towards[1] / towards[2]),
        footprint,
        nodes=1,
    )


def nadir_rays(
    x: Float[ArrayLike, " column"],
    y: Float[ArrayLike, " row"],
    footprint: float,
    camera: tuple[float, float, float],
) -> RayLattice:
    """Rays of a frame camera that looks straight down.

    **Arguments:**

    - `x`, `y`: centres of the columns and rows of pixels on the ground [m], increasing.
    - `footprint`: edge of a pixel there [m], positive.
    - `camera`: (x, y, altitude) of the camera [m]. The altitude counts from the bottom of the grid;
      it must be known and positive, and may be infinite.

    **Raises:** `InputError` where there is no pixel, and, outside a transformation, for values out
    of range.

    Differentiable in `x`, `y` and the first two numbers of `camera`.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import nadir_rays
    >>> centres = (jnp.arange(8) + 0.5) * 0.125
    >>> rays = nadir_rays(centres, centres, footprint=0.125, camera=(0.5, 0.5, 30.0))
    >>> rays.shape, rays.sensor_height
    ((8, 8), 30.0)
    """
    x, y, footprint = check_pixels(x, y, footprint)
    cx, cy, altitude = check_camera(camera)
    if not (concrete(altitude) and altitude > 0):
        raise InputError(
            f"`camera` must be at a known height above the ground, but its altitude is {altitude} "
            "m: it counts from the bottom of the grid, and comes last of the three numbers"
        )
    return RayLattice(x, y, (cx - x) / altitude, (cy - y) / altitude, footprint, 5, float(altitude))


def perspective_rays(
    camera: tuple[float, float, float],
    target: tuple[float, float, float],
    *,
    rows: int,
    columns: int,
    field_of_view: float,
    dtype: Any = jnp.float32,
) -> RayField:
    """Rays of a frame camera in any attitude.

    **Arguments:**

    - `camera`, `target`: place of the camera and the point that its axis meets, (x, y, z) in m, z
      above the bottom of the grid. The picture's upper edge points up, or north where the axis
      points straight down.
    - `rows`, `columns`: pixels, which are square. Rows count from the picture's lower edge, so
      that they run northward in a picture taken straight down.
    - `field_of_view`: full angle that the columns span [degrees], in (0, 170).
    - `dtype`: floating type of the rays.

    **Raises:** `InputError` where the line of sight of a pixel is at or above the horizon, and for
    a camera below the bottom of the grid, or without pixels.

    Not differentiable in these numbers, which must be known; differentiable in the arrays of the
    `RayField` it returns.

    >>> from fynjax.radiation import perspective_rays
    >>> rays = perspective_rays(
    ...     (0.5, -10.0, 10.0), (0.5, 0.5, 0.0), rows=6, columns=8, field_of_view=5.0
    ... )
    >>> rays.shape, rays.sensor_height
    ((6, 8), 10.0)
    """
    check_whole("rows", rows)
    check_whole("columns", columns)
    place, forward = check_attitude(camera, target, field_of_view)
    forward = forward / np.linalg.norm(forward)
    # Where the axis points straight down the vertical has no direction in the picture.
    straight_down = abs(forward[2]) > 1 - 1e-9
    up = np.array([0.0, 1.0, 0.0] if straight_down else [0.0, 0.0, 1.0])
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    up = np.cross(right, forward)
    pitch = 2.0 * np.tan(np.radians(field_of_view) / 2.0) / columns
    across = (np.arange(columns) + 0.5 - columns / 2) * pitch
    along = (np.arange(rows) + 0.5 - rows / 2) * pitch
    sight = forward + along[:, None, None] * up + across[:, None] * right
    if (sight[..., 2] / np.linalg.norm(sight, axis=-1)).max() > -0.02:
        raise InputError(
            "every pixel must look at the ground, but some look at or above the horizon: aim "
            "`target` lower, or take a smaller `field_of_view`"
        )
    # From the camera down the ray to height 0, and the slope back up to it: they are the same.
    slope = sight[..., :2] / sight[..., 2:]
    ground = place[:2] - place[2] * slope
    # The width across the line of sight; along it the pixel's footprint is longer.
    width = pitch * place[2] / -sight[..., 2]
    as_array = lambda a: jnp.asarray(a, dtype)  # noqa: E731
    return RayField(
        as_array(ground[..., 0]),
        as_array(ground[..., 1]),
        as_array(slope[..., 0]),
        as_array(slope[..., 1]),
        as_array(width),
        float(place[2]),
    )


def _chebyshev(
    slopes: Float[Array, " pixel"], count: int, ends: Float[Array, " 2"]
) -> tuple[Float[Array, " node"], Float[Array, "pixel node"]]:
    """Chebyshev nodes between the two `ends` and the Lagrange weights of each pixel."""
    middle = 0.5 * (ends[0] + ends[1])
    half = 0.5 * jnp.abs(ends[1] - ends[0])
    if count == 1:
        return middle[None], jnp.ones((slopes.shape[0], 1), slopes.dtype)
    # Lagrange weights: the product of (x - others) over (own - others).
    unit = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    position = (slopes - middle) / jnp.where(half > 0, half, 1.0)
    others = np.stack([np.delete(unit, node) for node in range(count)])
    apart = jnp.asarray(unit[:, None] - others, slopes.dtype)
    factors = (position[:, None, None] - jnp.asarray(others, slopes.dtype)) / apart
    weights = jnp.prod(factors, axis=2)
    return middle + half * jnp.asarray(unit, slopes.dtype), weights


def pixel_projection(
    angles: tuple[AbstractLeafAngle, ...], rays: AbstractRays
) -> Float[Array, "angle row column"]:
    """G of each distribution towards each pixel."""
    return rays.angular(lambda v: projections(angles, v[:, 2]).astype(v.dtype))
