"""What a sensor sees: first order on the fine grid, the rest from the diffuse field.

Down each ray, a layer contributes the light it scatters times the gap to the sensor. For direct
sunlight scattered once, the gaps to sun and sensor are integrated along the ray as a product of
exponentials. Extinction does not depend on the band, so the sum over layers is made once for all
bands, as the sunlit area of each class that a pixel sees; leaf optics then enter linearly.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax._core.math import mean_transmittance
from fynjax.radiation._multiple import DiffuseField, upsample
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._rays import RayLattice, pixel_projection
from fynjax.radiation._resample import axis_weights, sample
from fynjax.radiation._scene import VoxelScene
from fynjax.radiation._sun import SunField, interface_depth


class Radiance(eqx.Module):
    """Radiance at the sensor, and its parts [irradiance unit sr-1]."""

    sunlit_leaves: Float[Array, "band row column"]
    """Direct sun, scattered once by the canopy."""
    diffuse_leaves: Float[Array, "band row column"]
    """Sky light and light scattered before, scattered towards the sensor by the canopy."""
    ground: Float[Array, "band row column"]
    """From the ground, direct and diffuse."""
    gap: Float[Array, "row column"]
    """Share of the ray that reaches the ground unhit [-]."""

    @property
    def total(self) -> Float[Array, "band row column"]:
        return self.sunlit_leaves + self.diffuse_leaves + self.ground


def see(
    scene: VoxelScene,
    sun: SunField,
    diffuse: DiffuseField,
    rays: RayLattice,
    factor: tuple[int, int],
    ordinates: Ordinates,
    sublayers: int,
) -> Radiance:
    """Radiance along each ray. Differentiable in everything but the lattice's integers."""
    nz, ny, nx = scene.shape
    classes, light = scene.classes, scene.illumination
    dtype = scene.area_density.dtype
    source = _diffuse_source(scene, diffuse, rays.central, factor, ordinates)
    projection = pixel_projection(classes.angles, rays)
    # The source is that towards the middle of the view. Elsewhere the pixel sees another area of
    # the same leaves, and what they send shrinks or grows with it.
    in_middle = jnp.stack([a.projection(rays.central[2]) for a in classes.angles]).astype(dtype)
    turning = projection / in_middle[:, None, None]
    if rays.nodes == 1:
        source, turning = source.sum(axis=0, keepdims=True), jnp.ones_like(turning[:1])
    owner = jnp.asarray(classes.angle_of_class)
    cosine = rays.cosine
    step = scene.vertical / sublayers

    def axes(height: Array) -> tuple[Array, Array]:
        x, y = rays.x + height * rays.slope_x, rays.y + height * rays.slope_y
        return x, y

    def piece(carry: tuple[Array, ...], layer: tuple[Array, ...]) -> tuple[tuple[Array, ...], None]:
        depth, above, seen, glow = carry
        density, emitted, bottom, top_depth, share = layer
        # Where in its layer the piece lies: the sun's depth is linear between the two planes.
        middle = bottom + (share + 0.5) * step
        x, y = axes(middle)
        columns = axis_weights(x, rays.footprint, nx, scene.horizontal, scene.boundary)
        rows = axis_weights(y, rays.footprint, ny, scene.horizontal, scene.boundary)
        area = sample(density, rows, columns)
        turned = jnp.sum(area * projection[owner], axis=0)
        along = turned * (step / cosine)
        low = bottom + share * step
        x, y = axes(low)
        below = interface_depth(sun, top_depth, low, x, y, scene)
        crossed = along + below - above
        weight = jnp.exp(-depth - above) * mean_transmittance(crossed) * (step / cosine)
        seen = seen + weight * area
        weight = jnp.exp(-depth) * mean_transmittance(along) * (step / cosine)
        for sent, seen_of_middle in zip(emitted, turning):
            glow = glow + weight * seen_of_middle * sample(sent, rows, columns)
        return (depth + along, below, seen, glow), None

    # One entry per piece of a layer, from the ground up; the plane below each piece carries the
    # sun's depth at its height along the beam.
    planes = _planes(sun.depth, sublayers)
    repeat = lambda field, axis: jnp.moveaxis(jnp.repeat(field, sublayers, axis=axis), axis, 0)  # noqa: E731
    bottoms = jnp.repeat(jnp.arange(nz, dtype=dtype) * scene.vertical, sublayers)
    shares = jnp.tile(jnp.arange(sublayers, dtype=dtype), nz)
    layers = (repeat(scene.area_density, 1), repeat(source, 2), bottoms, planes[:-1], shares)
    shape = (rays.y.shape[0], rays.x.shape[0])
    n_class, n_band = classes.reflectance.shape
    x, y = axes(jnp.asarray(scene.height, dtype))
    start = (
        jnp.zeros(shape, dtype),
        interface_depth(sun, planes[-1], jnp.asarray(scene.height, dtype), x, y, scene),
        jnp.zeros((n_class, *shape), dtype),
        jnp.zeros((n_band, *shape), dtype),
    )
    # Recomputing a layer in the backward pass keeps memory to one layer's arrays.
    (depth, at_ground, seen, glow), _ = jax.lax.scan(
        jax.checkpoint(piece), start, layers, reverse=True
    )

    travel = -jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine

    def phase(vectors: Array) -> Array:
        """[reflection or transmission, angle, n]"""
        pairs = [area_scattering(angle, travel[None], vectors) for angle in classes.angles]
        return jnp.stack([jnp.stack([r[0] for r, _ in pairs]), jnp.stack([t[0] for _, t in pairs])])

    reflect, transmit = rays.angular(phase)
    beam = light.sun.astype(dtype) / sun.cosine / jnp.pi
    first = beam[:, None, None] * (
        jnp.einsum("cb,crk->brk", classes.reflectance, seen * reflect[owner])
        + jnp.einsum("cb,crk->brk", classes.transmittance, seen * transmit[owner])
    )
    columns = axis_weights(rays.x, rays.footprint, nx, scene.horizontal, scene.boundary)
    rows = axis_weights(rays.y, rays.footprint, ny, scene.horizontal, scene.boundary)
    gap = jnp.exp(-depth)
    soil = scene.ground_map
    shaded = upsample(diffuse.ground[:, None], (1, factor[1]), scene.boundary)[:, 0] * soil
    direct = (
        light.sun.astype(dtype)[:, None, None] * jnp.exp(-at_ground) * sample(soil, rows, columns)
    )
    ground = gap / jnp.pi * (direct + sample(shaded, rows, columns))
    return Radiance(first, glow, ground, gap)


def _planes(
    depth: Float[Array, "interface row column"], sublayers: int
) -> Float[Array, "plane row column"]:
    """Depth on the planes between pieces, linear between the layers' interfaces."""
    if sublayers == 1:
        return depth
    shares = (jnp.arange(sublayers, dtype=depth.dtype) / sublayers)[:, None, None]
    between = depth[:-1, None] * (1 - shares) + depth[1:, None] * shares
    return jnp.concatenate([between.reshape(-1, *depth.shape[1:]), depth[-1:]])


def _diffuse_source(
    scene: VoxelScene,
    diffuse: DiffuseField,
    towards: Float[Array, " 3"],
    factor: tuple[int, int],
    ordinates: Ordinates,
) -> Float[Array, "angle band z y x"]:
    """Radiance per length that the leaves scatter towards the sensor out of the diffuse field, for
    each distribution of their normals.

    The field is smooth and comes from the coarse grid; the leaf area it meets is the fine one.
    """
    classes = scene.classes
    dtype = scene.area_density.dtype
    vectors = jnp.asarray(ordinates.vectors, dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    sources = []
    for index, angle in enumerate(classes.angles):
        members = jnp.asarray([float(owner == index) for owner in classes.angle_of_class], dtype)
        projection = angle.projection(towards[2]).astype(dtype)
        total = jnp.zeros((diffuse.intensity.shape[0], *scene.shape), dtype)
        for kind, optics in zip(
            area_scattering(angle, vectors, towards[None]),
            (classes.reflectance, classes.transmittance),
        ):
            share = kind[:, 0] * weights / jnp.pi
            share = share * (projection / jnp.sum(share))
            field = upsample(
                jnp.einsum("o,bozyx->bzyx", share, diffuse.intensity), factor, scene.boundary
            )
            area = jnp.einsum("cb,czyx->bzyx", optics * members[:, None], scene.area_density)
            total = total + area * field
        sources.append(total)
    return jnp.stack(sources)
