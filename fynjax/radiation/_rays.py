"""Rays of a sensor that meet every horizontal plane in a rectangular lattice."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.geometry import direction
from fynjax.canopy import AbstractLeafAngle


class RayLattice(eqx.Module):
    """Rays of a parallel projection, or of a frame camera that looks straight down.

    The ray of pixel (row, column) passes the ground at (x[column], y[row]) and height z at
    (x + z slope_x, y + z slope_y).
    """

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

    @property
    def cosine(self) -> Float[Array, "row column"]:
        """Cosine of the view zenith angle [-]."""
        return 1.0 / jnp.sqrt(1.0 + self.slope_x**2 + self.slope_y[:, None] ** 2)

    def angular(self, function: Callable[[Array], Array]) -> Float[Array, "*value row column"]:
        """Evaluate a smooth function of the direction for every pixel.

        `function` maps unit vectors towards the sensor [n, 3] to [*value, n]. It is evaluated
        at `nodes` x `nodes` Chebyshev points of the field of view and interpolated between.
        """
        node_x, weight_x = _chebyshev(self.slope_x, self.nodes)
        node_y, weight_y = _chebyshev(self.slope_y, self.nodes)
        sx, sy = (a.ravel() for a in jnp.meshgrid(node_x, node_y, indexing="xy"))
        vectors = jnp.stack([sx, sy, jnp.ones_like(sx)], axis=-1)
        vectors = vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True)
        values = function(vectors)
        values = values.reshape(*values.shape[:-1], self.nodes, self.nodes)
        return jnp.einsum("rj,...ji,ci->...rc", weight_y, values, weight_x)

    @property
    def central(self) -> Float[Array, " 3"]:
        """Unit vector towards the sensor from the middle of the field of view."""
        middle = jnp.stack(
            [
                0.5 * (self.slope_x[0] + self.slope_x[-1]),
                0.5 * (self.slope_y[0] + self.slope_y[-1]),
                jnp.ones((), self.slope_x.dtype),
            ]
        )
        return middle / jnp.linalg.norm(middle)


def parallel_rays(
    x: Float[Array, " column"],
    y: Float[Array, " row"],
    footprint: float,
    view_zenith: Float[Array, ""],
    view_azimuth: Float[Array, ""],
) -> RayLattice:
    """Rays of a distant sensor at (zenith < 90, azimuth) in degrees."""
    dtype = jnp.asarray(x).dtype
    towards = direction(jnp.asarray(view_zenith), jnp.asarray(view_azimuth)).astype(dtype)
    return RayLattice(
        jnp.asarray(x),
        jnp.asarray(y),
        jnp.full_like(x, 1.0) * (towards[0] / towards[2]),
        jnp.full_like(y, 1.0) * (towards[1] / towards[2]),
        footprint,
        nodes=1,
    )


def nadir_rays(
    x: Float[Array, " column"],
    y: Float[Array, " row"],
    footprint: float,
    camera: tuple[float, float, float],
) -> RayLattice:
    """Rays of a frame camera at `camera` = (x, y, altitude) in m that looks straight down."""
    x, y = jnp.asarray(x), jnp.asarray(y)
    cx, cy, altitude = camera
    return RayLattice(x, y, (cx - x) / altitude, (cy - y) / altitude, footprint, nodes=5)


def _chebyshev(
    slopes: Float[Array, " pixel"], count: int
) -> tuple[Float[Array, " node"], Float[Array, "pixel node"]]:
    """Chebyshev nodes over the range of `slopes` and the Lagrange weights of each pixel."""
    middle = 0.5 * (slopes[0] + slopes[-1])
    half = 0.5 * jnp.abs(slopes[-1] - slopes[0])
    if count == 1:
        return middle[None], jnp.ones((slopes.shape[0], 1), slopes.dtype)
    unit = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    position = (slopes - middle) / jnp.where(half > 0, half, 1.0)
    weights = []
    for node in range(count):
        others = np.delete(unit, node)
        factors = (position[:, None] - jnp.asarray(others, slopes.dtype)) / jnp.asarray(
            unit[node] - others, slopes.dtype
        )
        weights.append(jnp.prod(factors, axis=1))
    return middle + half * jnp.asarray(unit, slopes.dtype), jnp.stack(weights, axis=1)


def pixel_projection(
    angles: tuple[AbstractLeafAngle, ...], rays: RayLattice
) -> Float[Array, "angle row column"]:
    """G of each distribution towards each pixel."""
    return rays.angular(
        lambda v: jnp.stack([a.projection(v[:, 2]).astype(v.dtype) for a in angles])
    )
