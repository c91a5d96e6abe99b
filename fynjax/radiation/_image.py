"""Radiance at a sensor: first order on the fine grid, the rest from the diffuse field.

Down each ray, a layer contributes the light it scatters times the gap to the sensor. For direct
sunlight scattered once, the gaps to sun and sensor are integrated along the ray as a product of
exponentials. Extinction does not depend on the band, so the sum over layers is made once for all
bands, as the sunlit area of each class within a pixel; leaf optics then enter linearly.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax._core.math import mean_transmittance
from fynjax.radiation._blocks import upsample
from fynjax.radiation._hotspot import POINT_WEIGHTS, POINTS, kinds, overlaps
from fynjax.radiation._multiple import DiffuseField
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._rays import AbstractRays, Lattice, pixel_projection
from fynjax.radiation._scene import OpticalClasses, VoxelScene
from fynjax.radiation._sun import SunField, unshaded_beams
from fynjax.radiation._terrain import covered


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
        """Sum of the parts."""
        return self.sunlit_leaves + self.diffuse_leaves + self.ground


def render_rays(
    scene: VoxelScene,
    sun: SunField,
    diffuse: DiffuseField,
    rays: AbstractRays,
    ordinates: Ordinates,
    sublayers: int,
) -> Radiance:
    """Radiance along each ray. Differentiable in everything but the lattice's integers."""
    nz, ny, nx = scene.shape
    factor = diffuse.factor(scene)
    classes, light = scene.classes, scene.illumination
    dtype = scene.area_density.dtype
    source = _diffuse_source(scene, diffuse, rays.central, factor, ordinates)
    projection = pixel_projection(classes.angles, rays)
    # The source is that towards the middle of the view. Elsewhere the same leaves have
    # another projected area, and their radiance changes in proportion to it.
    in_middle = jnp.stack([a.projection(rays.central[2]) for a in classes.angles]).astype(dtype)
    turning = projection / in_middle[:, None, None]
    if projection.shape[1:] == (1, 1):  # parallel rays
        source, turning = source.sum(axis=0, keepdims=True), jnp.ones_like(turning[:1])
    owner = jnp.asarray(classes.angle_of_class)
    cosine = rays.cosine
    step = scene.vertical / sublayers
    towards_sun = jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
    overlap = overlaps(classes, rays, towards_sun, step)
    members = [_members(classes, kind) for kind in kinds(classes)]
    voxels = Lattice(ny, nx, scene.horizontal, scene.boundary)
    ground = _ground_light(scene, sun, diffuse, rays, factor, ordinates)

    def beams(height: Array) -> Callable[[Array], Array]:
        """Sampler of a plane of `sun.depth`."""
        return rays.sampler(height, sun.lattice(scene), sun.offset(height, scene))

    def on_ground(height: Array, through: Array) -> Array:
        """Radiance of the ground where the rays meet `height`; `through` is the sun's share."""
        sampler = rays.sampler(height, voxels)
        lit, shaded = sampler(ground.direct), sampler(ground.diffuse)
        return through * lit * ground.towards_sensor + shaded

    def piece(carry: tuple[Any, ...], layer: tuple[Any, ...]) -> tuple[tuple[Any, ...], None]:
        depth, above, sunlit_area, diffuse_radiance, states, end = carry
        density, emitted, top_depth, height, terrain = layer
        # The piece begins at `height` and lies above it; the sun's depth is linear between planes.
        sampler = rays.sampler(height + 0.5 * step, voxels)
        area = sampler(density)
        turned = jnp.sum(area * projection[owner], axis=0)
        along = turned * (step / cosine)
        below = beams(height)(top_depth)
        crossed = along + below - above
        common = [jnp.tensordot(m, area, axes=1) for m in members] if overlap else []
        if overlap:
            shared = _sum_points([o.at_points(s, a) for o, s, a in zip(overlap, states, common)])
            weight = jnp.zeros_like(depth)
            for share, portion, extra in zip(POINTS, POINT_WEIGHTS, shared):
                weight = weight + portion * jnp.exp(extra - crossed * share)
            weight = jnp.exp(-depth - above) * weight
            states = tuple(o.advance(s, a) for o, s, a in zip(overlap, states, common))
        else:
            weight = jnp.exp(-depth - above) * mean_transmittance(crossed)
        mean = jnp.exp(-depth) * mean_transmittance(along)
        if terrain is not None:
            covering, unshaded = terrain
            blocked, ground_radiance = end
            mean = mean * (1.0 - blocked)
            weight = weight * (1.0 - blocked) * beams(height + step)(unshaded)
        sunlit_area = sunlit_area + weight * (step / cosine) * area
        for sent, area_ratio in zip(emitted, turning):
            diffuse_radiance = diffuse_radiance + mean * (step / cosine) * area_ratio * sampler(
                sent
            )
        depth = depth + along
        if terrain is not None:
            # The ray ends on the ground by the largest share of it that it has met.
            now = jnp.maximum(blocked, rays.sampler(height, voxels)(covering))
            through = jnp.exp(shared[-1] - below) if overlap else jnp.exp(-below)
            ground_radiance = ground_radiance + (now - blocked) * jnp.exp(-depth) * on_ground(
                height, through
            )
            end = now, ground_radiance
        return (depth, below, sunlit_area, diffuse_radiance, states, end), None

    # One entry per piece of a layer, from the ground up; the plane below each piece carries the
    # sun's depth at its height along the beam.
    planes = _planes(sun.depth, sublayers)
    repeat = lambda field, axis: jnp.moveaxis(jnp.repeat(field, sublayers, axis=axis), axis, 0)  # noqa: E731
    heights = (jnp.arange(nz * sublayers) * step).astype(dtype)
    n_class, n_band = classes.reflectance.shape
    terrain, end = None, None
    if scene.terrain is not None:
        covering = covered(scene, heights).at[0].set(1.0)  # nothing falls out of the grid
        terrain = covering, unshaded_beams(scene, sun, heights + step)
        end = jnp.zeros(rays.shape, dtype), jnp.zeros((n_band, *rays.shape), dtype)
    layers = (repeat(scene.area_density, 1), repeat(source, 2), planes[:-1], heights, terrain)
    start = (
        jnp.zeros(rays.shape, dtype),
        beams(jnp.asarray(scene.height, dtype))(planes[-1]),
        jnp.zeros((n_class, *rays.shape), dtype),
        jnp.zeros((n_band, *rays.shape), dtype),
        tuple(o.start(rays.shape) for o in overlap),
        end,
    )
    # Recomputing a layer in the backward pass keeps memory to one layer's arrays.
    (depth, at_ground, sunlit_area, diffuse_radiance, states, end), _ = jax.lax.scan(
        jax.checkpoint(piece), start, layers, reverse=True
    )

    travel = -towards_sun

    def phase(vectors: Array) -> Array:
        """[reflection or transmission, angle, n]"""
        pairs = [area_scattering(angle, travel[None], vectors) for angle in classes.angles]
        return jnp.stack([jnp.stack([r[0] for r, _ in pairs]), jnp.stack([t[0] for _, t in pairs])])

    reflect, transmit = rays.angular(phase)
    beam = light.sun.astype(dtype) / sun.cosine / jnp.pi
    first = beam[:, None, None] * (
        jnp.einsum("cb,crk->brk", classes.reflectance, sunlit_area * reflect[owner])
        + jnp.einsum("cb,crk->brk", classes.transmittance, sunlit_area * transmit[owner])
    )
    gap = jnp.exp(-depth)
    if end is not None:
        return Radiance(first, diffuse_radiance, end[1], gap)
    shared = sum((state[0] + state[1] for state in states), start=jnp.zeros((), dtype))
    bare = on_ground(jnp.zeros((), dtype), jnp.exp(shared - at_ground))
    return Radiance(first, diffuse_radiance, gap * bare, gap)


def _members(classes: OpticalClasses, kind: tuple[int, int]) -> Float[Array, " class"]:
    """One for the classes of a kind (distribution of normals, leaf size), else zero."""
    pairs = zip(classes.angle_of_class, classes.sizes)
    return jnp.asarray([float(pair == kind) for pair in pairs], classes.reflectance.dtype)


def _sum_points(per_kind: list[list[Array]]) -> list[Array]:
    return [sum(values[1:], start=values[0]) for values in zip(*per_kind)]


class _GroundLight(NamedTuple):
    """Radiance of the bare ground, without canopy above it."""

    direct: Float[Array, "band y x"]
    """In full sun, towards no direction in particular."""
    towards_sensor: Float[Array, "band row column"]
    """What its angular shape makes of that."""
    diffuse: Float[Array, "band y x"]


def _ground_light(
    scene: VoxelScene,
    sun: SunField,
    diffuse: DiffuseField,
    rays: AbstractRays,
    factor: tuple[int, int],
    ordinates: Ordinates,
) -> _GroundLight:
    dtype = scene.area_density.dtype
    soil, shape = scene.ground_map, scene.ground_shape
    direct = scene.illumination.sun.astype(dtype)[:, None, None] * soil / jnp.pi
    if sun.incidence is not None:
        direct = direct * sun.incidence
    fluxes = jnp.asarray(ordinates.fluxes.ravel(), dtype)
    if shape is None:
        towards = jnp.ones((soil.shape[0], 1, 1), dtype)
        received = jnp.einsum("o,boyx->byx", fluxes, diffuse.falling)
    else:
        sunward = -jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
        towards = rays.angular(lambda views: shape.shape(sunward[None], views)[:, 0])
        down = jnp.asarray(ordinates.vectors[: len(fluxes)], dtype)
        kernel = shape.shape(down, rays.central[None])[:, :, 0] * fluxes
        received = jnp.einsum("bo,boyx->byx", kernel, diffuse.falling)
    received = upsample(received[:, None], (1, factor[1]), scene.boundary)[:, 0]
    return _GroundLight(direct, towards, received * soil / jnp.pi)


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
