"""Radiance at a sensor: first order on the fine grid, the rest from the diffuse field.

Down each ray, a layer contributes the light it scatters times the gap to the sensor. For direct
sunlight scattered once, the gaps to sun and sensor are integrated along the ray as a product of
exponentials. Extinction does not depend on the band, so the way down is followed once for all
bands: it leaves the sunlit area of each class within a pixel, and the area of each class that the
pixel views in each layer of the diffuse field. Leaf optics and light then enter linearly.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.math import mean_transmittance
from fynjax.radiation._blocks import block_mean, upsample
from fynjax.radiation._hotspot import POINT_WEIGHTS, POINTS, kinds, overlaps
from fynjax.radiation._multiple import DiffuseField
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._rays import AbstractRays, Lattice, pixel_projection
from fynjax.radiation._reduced import ReducedField
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


class _GroundInView(NamedTuple):
    """Ground at one height within each pixel."""

    height: Array
    """Above the bottom of the grid [m]."""
    gap: Float[Array, "row column"]
    """Share of the ray that ends on it [-]."""
    sunlit: Float[Array, "row column"]
    """The same, times the sun's share that the canopy lets through on the way there."""


class _Slab(NamedTuple):
    """What the rays meet between two heights: a layer of the diffuse field."""

    height: Array
    """Of its middle [m]."""
    viewed: Float[Array, "class row column"]
    """Area of each class within a pixel, times the gap to the sensor, per area across the ray; as
    if the leaves were turned towards the middle of the view [-]."""
    ground: _GroundInView | None
    """Terrain within it; None: level ground, below the last."""


class _View(NamedTuple):
    """What a sensor views of a scene; the same for all bands."""

    sunlit: Float[Array, "class row column"]
    """Area of each class within a pixel, times the gaps to sun and sensor [-]."""
    ground: _GroundInView | None
    """Level ground."""
    gap: Float[Array, "row column"]


def render_rays(
    scene: VoxelScene,
    sun: SunField,
    diffuse: DiffuseField | ReducedField,
    rays: AbstractRays,
    ordinates: Ordinates,
    sublayers: int,
    chunk: int,
) -> Radiance:
    """Radiance along each ray, in `sublayers` pieces of each layer of voxels.

    `chunk` bands of a reduced field are held at once. Differentiable in everything but the
    lattice's integers.
    """
    factor = diffuse.factor(scene)
    # The field is interpolated in height to this many slabs a cell, each of so many layers.
    finer = next((n for n in range(2, factor[0] + 1) if factor[0] % n == 0), 1)
    layers = factor[0] // finer
    if isinstance(diffuse, ReducedField):
        view, slabs = _look(scene, sun, rays, sublayers, layers, None)
        count = scene.illumination.sun.shape[0]
        size = min(chunk, count)

        def radiance_of(start: Array) -> tuple[Array, ...]:
            part, field = scene.bands(start, size), diffuse.bands(start, size)
            lit = _Lit.create(part, sun, field, rays, finer, ordinates)
            none = jnp.zeros((size, *rays.shape), view.gap.dtype)
            return _radiance(part, sun, rays, lit, view, lit.add_all((none, none), slabs))

        # The last chunk ends with the last band and repeats some of the one before.
        starts = np.minimum(np.arange(0, count, size), count - size)
        parts = jax.lax.map(jax.checkpoint(radiance_of), jnp.asarray(starts))
        place = np.arange(count)
        chunk_of_band = place // size
        kept = chunk_of_band * size + place - starts[chunk_of_band]
        leaves, more, ground = (p.reshape(-1, *p.shape[2:])[kept] for p in parts)
        return Radiance(leaves, more, ground, view.gap)
    lit = _Lit.create(scene, sun, diffuse, rays, finer, ordinates)
    view, sums = _look(scene, sun, rays, sublayers, layers, lit)
    return Radiance(*_radiance(scene, sun, rays, lit, view, sums), view.gap)


class _Lit(eqx.Module):
    """The diffuse light of some bands as the slabs meet it, and the ground's own radiance."""

    scattered: Float[Array, "slab kind angle band Y X"]
    """Radiance per viewed area and per reflectance or transmittance (the two kinds), towards the
    middle of the view, on the cells of the diffuse field."""
    ground: "_GroundLight"
    classes: OpticalClasses
    rays: AbstractRays
    cells: Lattice = eqx.field(static=True)
    voxels: Lattice = eqx.field(static=True)

    @classmethod
    def create(
        cls,
        scene: VoxelScene,
        sun: SunField,
        diffuse: DiffuseField,
        rays: AbstractRays,
        finer: int,
        ordinates: Ordinates,
    ) -> "_Lit":
        factor = diffuse.factor(scene)
        _, ny, nx = scene.shape
        return cls(
            _scattered(scene.classes, diffuse, rays.central, finer, ordinates),
            _ground_light(scene, sun, diffuse, rays, factor, ordinates),
            scene.classes,
            rays,
            Lattice(ny // factor[1], nx // factor[1], scene.horizontal * factor[1], scene.boundary),
            Lattice(ny, nx, scene.horizontal, scene.boundary),
        )

    def leaves(self, scattered: Array, slab: _Slab) -> Float[Array, "band row column"]:
        """Radiance that the leaves of a slab scatter out of its part of `scattered`."""
        field = self.rays.sampler(slab.height, self.cells, smooth=True)(scattered)
        optics = jnp.stack([self.classes.reflectance, self.classes.transmittance])
        owner = np.asarray(self.classes.angle_of_class)
        total = jnp.zeros(field.shape[2:], field.dtype)
        for angle in range(len(self.classes.angles)):
            mine = np.flatnonzero(owner == angle)
            area = jnp.einsum("kcb,crx->kbrx", optics[:, mine], slab.viewed[mine])
            total = total + jnp.sum(area * field[:, angle], axis=0)
        return total

    def on_ground(self, ground: _GroundInView) -> Float[Array, "band row column"]:
        """Radiance of the ground in view."""
        sampler = self.rays.sampler(ground.height, self.voxels)
        direct = sampler(self.ground.direct) * self.ground.towards_sensor
        return ground.sunlit * direct + ground.gap * sampler(self.ground.diffuse)

    def add(self, sums: tuple[Array, Array], slab: _Slab, scattered: Array) -> tuple[Array, Array]:
        """Radiance of leaves and ground, with that of one more slab."""
        leaves = sums[0] + self.leaves(scattered, slab)
        return leaves, sums[1] if slab.ground is None else sums[1] + self.on_ground(slab.ground)

    def add_all(self, sums: tuple[Array, Array], slabs: _Slab) -> tuple[Array, Array]:
        """The same with all slabs, stacked along a first axis."""
        one = lambda total, at: (self.add(total, *at), None)  # noqa: E731
        return jax.lax.scan(jax.checkpoint(one), sums, (slabs, self.scattered))[0]


def _look(
    scene: VoxelScene,
    sun: SunField,
    rays: AbstractRays,
    sublayers: int,
    layers: int,
    lit: _Lit | None,
) -> tuple[_View, Any]:
    """Follow the rays down, through slabs of `layers` layers.

    Returns what they view and, with `lit`, the radiance of leaves and terrain out of the diffuse
    light; without it the `_Slab`s, stacked along a first axis.
    """
    nz, ny, nx = scene.shape
    classes = scene.classes
    dtype = scene.area_density.dtype
    projection = pixel_projection(classes.angles, rays)
    # The diffuse light is that sent towards the middle of the view. Elsewhere the same leaves have
    # another projected area, and their radiance changes in proportion to it.
    in_middle = jnp.stack([a.projection(rays.central[2]) for a in classes.angles]).astype(dtype)
    owner = jnp.asarray(classes.angle_of_class)
    projection = projection[owner]
    turning = projection / in_middle[owner][:, None, None]
    cosine = rays.cosine
    high, wide = scene.structure_factor
    thickness = scene.vertical / high
    step = thickness / sublayers
    path = step / cosine
    towards_sun = jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
    overlap = overlaps(classes, rays, towards_sun, step)
    members = jnp.asarray([_members(classes, kind) for kind in kinds(classes)], dtype)
    voxels = Lattice(ny, nx, scene.horizontal, scene.boundary)
    finest = Lattice(ny * wide, nx * wide, scene.horizontal / wide, scene.boundary)

    def beams(height: Array) -> Callable[[Array], Array]:
        """Sampler of a plane of `sun.depth`."""
        return rays.sampler(height, sun.lattice(scene), sun.offset(height, scene))

    def piece(
        mixture: tuple[Array, Array], carry: tuple[Any, ...], at: tuple[Any, ...]
    ) -> tuple[tuple[Any, ...], None]:
        turned, member = mixture
        depth, above, sunlit, viewed, states, end = carry
        density, plane, height, terrain = at
        # The piece begins at `height` and lies above it; the sun's depth is linear between planes.
        area = rays.sampler(height + 0.5 * step, finest)(density)
        along = jnp.sum(area * turned, axis=0) * path
        below = beams(height)(plane)
        crossed = along + below - above
        if overlap:
            common = [jnp.einsum("c...,crx->rx", m, area) for m in member]
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
            blocked, gap, through = end
            mean = mean * (1.0 - blocked)
            weight = weight * (1.0 - blocked) * beams(height + step)(unshaded)
        sunlit = sunlit + weight * path * area
        viewed = viewed + mean * path * area
        depth = depth + along
        if terrain is not None:
            # The ray ends on the ground by the largest share of it that it has met.
            now = jnp.maximum(blocked, rays.sampler(height, voxels)(covering))
            ended = (now - blocked) * jnp.exp(-depth)
            lit_share = jnp.exp(shared[-1] - below) if overlap else jnp.exp(-below)
            end = now, gap + ended, through + ended * lit_share
        return (depth, below, sunlit, viewed, states, end), None

    def layer(
        mixture: tuple[Array, Array], carry: tuple[Any, ...], at: tuple[Any, ...]
    ) -> tuple[tuple[Any, ...], None]:
        density, bottom, top, height, terrain = at
        if sublayers == 1:
            terrain = jax.tree.map(lambda field: field[0], terrain)
            return piece(mixture, carry, (density, bottom, height, terrain))
        share = (jnp.arange(sublayers, dtype=dtype) / sublayers)[:, None, None]
        planes = bottom + share * (top - bottom)
        heights = height + step * jnp.arange(sublayers, dtype=dtype)
        one = lambda carry, at: piece(mixture, carry, (density, *at))  # noqa: E731
        return jax.lax.scan(jax.checkpoint(one), carry, (planes, heights, terrain), reverse=True)

    def mixed(composition: Array, height: Array) -> Float[Array, "class row column"]:
        """Share of each class in the area that a pixel meets in a slab [-]."""
        area = rays.sampler(height, voxels)(composition)
        total = area.sum(axis=0)
        return jnp.where(total > 0, area / jnp.where(total > 0, total, 1.0), 0.0)

    none = jnp.zeros(rays.shape, dtype)
    no_area = jnp.zeros((len(classes.angle_of_class), *rays.shape), dtype)
    hilly = scene.terrain is not None

    def slab(carry: tuple[Any, ...], at: tuple[Any, ...]) -> tuple[tuple[Any, ...], Any]:
        (depth, above, sunlit, states, blocked), sums = carry
        inside, composition, height, scattered = at
        end = (blocked, none, none) if hilly else None
        if composition is None:
            mixture = projection, members.reshape(*members.shape, 1, 1)
            start = (depth, above, sunlit, no_area, states, end)
        else:
            # Within a slab its classes are mixed alike: only their total is followed.
            share = mixed(composition, height)
            turned = jnp.sum(share * projection, axis=0, keepdims=True)
            mixture = turned, jnp.einsum("kc,crx->krx", members, share)[:, None]
            start = (depth, above, none[None], none[None], states, end)
        # Recomputing a layer in the backward pass keeps memory to one layer's arrays.
        (depth, above, lit_area, viewed, states, end), _ = jax.lax.scan(
            jax.checkpoint(partial(layer, mixture)), start, inside, reverse=True
        )
        if composition is None:
            sunlit = lit_area
        else:
            sunlit, viewed = sunlit + share * lit_area, share * viewed
        viewed = viewed * turning
        ground = None
        if end is not None:
            blocked = end[0]
            ground = _GroundInView(height - 0.5 * layers * scene.vertical, *end[1:])
        met = _Slab(height, viewed, ground)
        carry = depth, above, sunlit, states, blocked
        if lit is None:
            return (carry, sums), met
        return (carry, lit.add(sums, met, scattered)), None

    count = nz // layers
    by_slab = lambda field: field.reshape(count, -1, *field.shape[1:])  # noqa: E731
    heights = (jnp.arange(nz * high) * thickness).astype(dtype)
    terrain = None
    if hilly:
        fine = (jnp.arange(nz * high * sublayers) * step).astype(dtype)
        covering = covered(scene, fine).at[0].set(1.0)  # nothing falls out of the grid
        terrain = jax.tree.map(
            lambda field: by_slab(field.reshape(nz * high, sublayers, *field.shape[1:])),
            (covering, unshaded_beams(scene, sun, fine + step)),
        )
    composition = None
    if scene.structure is None:
        density = jnp.moveaxis(scene.area_density, 1, 0)
    else:
        density = scene.structure[:, None]
        composition = jnp.moveaxis(block_mean(scene.area_density, (layers, 1)), 1, 0)
    inside = (
        by_slab(density),
        by_slab(sun.depth[:-1]),
        by_slab(sun.depth[1:]),
        by_slab(heights),
        terrain,
    )
    middles = ((jnp.arange(count) + 0.5) * layers * scene.vertical).astype(dtype)
    n_band = 0 if lit is None else classes.reflectance.shape[1]
    dark = jnp.zeros((n_band, *rays.shape), dtype)
    top = beams(jnp.asarray(scene.height, dtype))(sun.depth[-1])
    start = (none, top, no_area, tuple(o.start(rays.shape) for o in overlap), none), (dark, dark)
    ((depth, at_ground, sunlit, states, _), sums), slabs = jax.lax.scan(
        jax.checkpoint(slab),
        start,
        (inside, composition, middles, None if lit is None else lit.scattered),
        reverse=True,
    )
    gap = jnp.exp(-depth)
    level = None
    if not hilly:
        shared = sum((state[0] + state[1] for state in states), start=jnp.zeros((), dtype))
        level = _GroundInView(jnp.zeros((), dtype), gap, gap * jnp.exp(shared - at_ground))
    return _View(sunlit, level, gap), slabs if lit is None else sums


def _radiance(
    scene: VoxelScene,
    sun: SunField,
    rays: AbstractRays,
    lit: _Lit,
    view: _View,
    sums: tuple[Array, Array],
) -> tuple[Array, Array, Array]:
    """Radiance of sunlit leaves, of leaves in diffuse light and of the ground."""
    classes, dtype = scene.classes, view.gap.dtype
    travel = -jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
    owner = jnp.asarray(classes.angle_of_class)

    def phase(vectors: Array) -> Array:
        """[reflection or transmission, angle, n]"""
        pairs = [area_scattering(angle, travel[None], vectors) for angle in classes.angles]
        return jnp.stack([jnp.stack([r[0] for r, _ in pairs]), jnp.stack([t[0] for _, t in pairs])])

    reflect, transmit = rays.angular(phase)
    beam = scene.illumination.sun.astype(dtype) / sun.cosine / jnp.pi
    first = beam[:, None, None] * (
        jnp.einsum("cb,crk->brk", classes.reflectance, view.sunlit * reflect[owner])
        + jnp.einsum("cb,crk->brk", classes.transmittance, view.sunlit * transmit[owner])
    )
    ground = sums[1] if view.ground is None else lit.on_ground(view.ground)
    return first, sums[0], ground


def _members(classes: OpticalClasses, kind: tuple[int, int]) -> list[float]:
    """One for the classes of a kind (distribution of normals, leaf size), else zero."""
    return [float(pair == kind) for pair in zip(classes.angle_of_class, classes.sizes)]


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


def _scattered(
    classes: OpticalClasses,
    diffuse: DiffuseField,
    towards: Float[Array, " 3"],
    finer: int,
    ordinates: Ordinates,
) -> Float[Array, "slab kind angle band Y X"]:
    """Radiance towards the sensor per viewed area, and per reflectance or transmittance.

    The field is smooth and comes from the coarse grid, interpolated in height to `finer` slabs a
    cell; the leaf area it meets is that of the voxels.
    """
    dtype = diffuse.intensity.dtype
    vectors = jnp.asarray(ordinates.vectors, dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    shares = []
    for angle in classes.angles:
        projection = angle.projection(towards[2]).astype(dtype)
        for kind in area_scattering(angle, vectors, towards[None]):
            share = kind[:, 0] * weights / jnp.pi
            shares.append(share * (projection / jnp.sum(share)))
    share = jnp.stack(shares).reshape(len(classes.angles), 2, -1)
    field = jnp.einsum("ako,bozyx->kabzyx", share, diffuse.intensity)
    return jnp.moveaxis(upsample(field, (finer, 1), "open"), 3, 0)
