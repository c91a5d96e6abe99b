"""Radiance at a sensor: first order on the fine grid, the rest from the diffuse field.

Down each ray, a layer contributes the light it scatters times the gap to the sensor. For direct
sunlight scattered once, the gaps to sun and sensor are integrated along the ray as a product of
exponentials. Extinction does not depend on the band, so the way down is followed once for all
bands: it leaves the sunlit area of each class within a pixel, and for each slab of layers the path
in view. Leaf optics and light then enter linearly.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.math import mean_transmittance, transmittance_beyond
from fynjax.canopy import projections
from fynjax.radiation._blocks import upsample
from fynjax.radiation._check import check_picture
from fynjax.radiation._hotspot import POINT_WEIGHTS, POINTS, kinds, overlaps
from fynjax.radiation._multiple import DiffuseField
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._phase import area_scattering_of
from fynjax.radiation._rays import AbstractRays, Lattice, RayLattice, pixel_projection
from fynjax.radiation._reduced import ReducedField
from fynjax.radiation._scene import OpticalClasses, VoxelScene
from fynjax.radiation._sun import SunField, unshaded_beams
from fynjax.radiation._terrain import covered

MOST_RAYS = 1500**2
"""Rays of a lattice that are followed at once."""


class Radiance(eqx.Module):
    """Radiance at the sensor, and its parts [irradiance unit sr-1]."""

    sunlit_leaves: Float[Array, "band row column"]
    """Direct sun, scattered once by the canopy."""
    diffuse_leaves: Float[Array, "band row column"]
    """Sky light and light scattered before, scattered towards the sensor by the canopy."""
    ground: Float[Array, "band row column"]
    """Light that the ground sends, direct and diffuse."""
    gap: Float[Array, "row column"]
    """Share of the ray that reaches the ground unhit [-]."""

    @property
    def total(self) -> Float[Array, "band row column"]:
        """Sum of the parts."""
        return self.sunlit_leaves + self.diffuse_leaves + self.ground


class Sight(eqx.Module):
    """What the rays of a sensor meet first. The shares of a ray sum to one [-]."""

    canopy: Float[Array, "class row column"]
    """Share of the ray that ends on each class of the canopy [-]."""
    sunlit_ground: Float[Array, "row column"]
    """Share of the ray that ends on ground that the sun reaches [-]."""
    shaded_ground: Float[Array, "row column"]
    """Share of the ray that ends on ground in the shade of the canopy or of the terrain [-]."""


class _GroundInView(NamedTuple):
    """Ground at one height within each pixel."""

    height: Array
    """Height of this ground above the bottom of the grid [m]."""
    gap: Float[Array, "row column"]
    """Share of the ray that ends on it [-]."""
    sunlit: Float[Array, "row column"]
    """Share of the ray that ends on it, times the share of sunlight that the canopy lets through on
    the way there [-]."""


class _Slab(NamedTuple):
    """What the rays meet between two heights, close enough for its classes to be mixed alike."""

    height: Array
    """Height of the middle of the slab [m]."""
    viewed: Float[Array, "row column"]
    """Path through it times the gap to the sensor, per mean area of its voxels [m]."""
    ground: _GroundInView | None
    """Terrain within it; None: level ground, below the last."""


class _View(NamedTuple):
    """What a sensor views of a scene; the same for all bands."""

    sunlit: Float[Array, "class row column"]
    """Area of each class within a pixel, times the gaps to sun and sensor [-]."""
    ground: _GroundInView | None
    """Level ground in view; None on terrain."""
    gap: Float[Array, "row column"]
    met: Float[Array, "class row column"] | None
    """Share of the ray that ends on each class [-]; None where it is not asked for."""


class _Cut(NamedTuple):
    """How the layers are cut for one sensor."""

    sublayers: int
    """Pieces of a layer of the finest voxels."""
    pieces: int
    """Pieces of a slab."""
    slabs: int
    """Slabs of a cell of the diffuse light."""


def render_rays(
    scene: VoxelScene,
    sun: SunField,
    diffuse: DiffuseField | ReducedField,
    rays: AbstractRays,
    ordinates: Ordinates,
    sublayers: int,
    lean: float,
    chunk: int,
    together: int = 1,
) -> Radiance:
    """Radiance along each ray, in `sublayers` pieces of each layer of the finest voxels, of which
    a ray crosses `lean` sideways in a layer, at most; means of blocks of `together` x `together`.

    `chunk` bands of a reduced field are held at once. Its rays are followed one by one through the
    plants, once for all bands; the diffuse light, which is smooth, is taken along the middle of a
    block. Differentiable in everything but the lattice's integers. Rays take the floating type of
    the scene.
    """
    rays = jax.tree.map(lambda numbers: jnp.asarray(numbers, scene.area_density.dtype), rays)
    cut = _cut(scene, diffuse.factor(scene), sublayers, lean)
    rows = _rows_at_once(rays, together) if isinstance(diffuse, DiffuseField) else rays.shape[0]
    slabs_of_scene = scene.shape[0] * scene.structure_factor[0] * sublayers // cut.pieces
    check_picture(scene, rows * rays.shape[1], slabs_of_scene, together)
    composition = _composition(scene, cut)
    layers = _layers(scene, sun, cut, composition)
    if isinstance(diffuse, DiffuseField):
        scattered = _scattered(scene, diffuse, rays, ordinates, composition, cut)

        def radiance(rays: AbstractRays) -> Radiance:
            lit = _Lit.create(scene, sun, diffuse, rays, ordinates, scattered)
            view, sums = _look(scene, sun, rays, layers, cut, lit)
            made = Radiance(*_radiance(scene, sun, rays, lit, view, sums), view.gap)
            return jax.tree.map(lambda image: _mean_of_blocks(image, together), made)

        if not isinstance(rays, RayLattice) or rows == rays.shape[0]:
            return radiance(rays)
        # The rows of a picture are like chunks of bands, along the last axis but one.
        of_rows = lambda start: radiance(rays.rows(start, rows))  # noqa: E731
        return _in_chunks(of_rows, rays.shape[0], rows, axis=-2, together=together)
    view, slabs = _look(scene, sun, rays, layers, cut, None, together)
    rays = rays.together(together)
    count = scene.illumination.sun.shape[0]
    size = min(chunk, count)

    def radiance_of(start: Array) -> tuple[Array, ...]:
        part, field = scene.bands(start, size), diffuse.bands(start, size)
        scattered = _scattered(part, field, rays, ordinates, composition, cut)
        lit = _Lit.create(part, sun, field, rays, ordinates, scattered)
        none = jnp.zeros((size, *rays.shape), view.gap.dtype)
        return _radiance(part, sun, rays, lit, view, lit.add_all((none, none), slabs))

    leaves, more, ground = _in_chunks(radiance_of, count, size, axis=0)
    return Radiance(leaves, more, ground, view.gap)


def _rows_at_once(rays: AbstractRays, together: int) -> int:
    """Rows of rays that are followed at once: all of a small picture, and of rays in any directions
    whose middle is that of all of them."""
    rows, columns = rays.shape
    if rows * columns <= MOST_RAYS or not isinstance(rays, RayLattice):
        return rows
    return max(MOST_RAYS // columns // together, 1) * together


def _in_chunks(
    function: Callable[[Array], Any], count: int, size: int, *, axis: int, together: int = 1
) -> Any:
    """What a function of the start of a chunk of `size` gives of all `count`, one chunk after
    another: arrays with the chunk along `axis`, as means of `together`. Chunks are computed anew
    in the backward pass, so that memory is that of one."""
    # The last chunk ends with the last one and repeats some of the chunk before.
    starts = np.minimum(np.arange(0, count, size), count - size)
    parts = jax.lax.map(jax.checkpoint(function), jnp.asarray(starts))
    # Which chunk holds each row or band, and where in it: the first that does.
    place = np.arange(count // together)
    chunk = place // (size // together)
    within = place - starts[chunk] // together

    def join(field: Array) -> Array:
        field = jnp.moveaxis(field, axis if axis < 0 else axis + 1, 1)
        return jnp.moveaxis(field[chunk, within], 0, axis)

    return jax.tree.map(join, parts)


def sight_of_rays(
    scene: VoxelScene,
    sun: SunField,
    rays: AbstractRays,
    sublayers: int,
    lean: float,
    together: int = 1,
) -> Sight:
    """What each ray meets first, as `render_rays` follows it; means of blocks of `together` x
    `together`. Differentiable in everything but the lattice's integers."""
    rays = jax.tree.map(lambda numbers: jnp.asarray(numbers, scene.area_density.dtype), rays)
    cut = _cut(scene, (1, 1), sublayers, lean)
    composition = _composition(scene, cut)
    check_picture(scene, math.prod(rays.shape), len(composition), together)
    layers = _layers(scene, sun, cut, composition)
    view, slabs = _look(scene, sun, rays, layers, cut, None, together, classes_met=True)
    ground = view.ground
    if ground is None:  # of terrain, some in each slab
        ground = jax.tree.map(lambda of_slabs: of_slabs.sum(axis=0), slabs.ground)
    assert view.met is not None
    return Sight(view.met, ground.sunlit, ground.gap - ground.sunlit)


def _cut(scene: VoxelScene, factor: tuple[int, int], sublayers: int, lean: float) -> _Cut:
    """Slabs of one piece where leaves fill the voxels evenly. Else of as many as a ray crosses
    half a voxel of the grid sideways in, or a layer."""
    high, wide = scene.structure_factor
    in_cell = factor[0] * high * sublayers
    if scene.structure is None:
        return _Cut(sublayers, 1, in_cell)
    layer = high * sublayers
    # `lean` counts the finest voxels, `wide` of which lie along one of the grid.
    most = 0.5 * wide * sublayers / lean if lean > 0 else layer
    pieces = max(n for n in range(1, layer + 1) if layer % n == 0 and n <= max(most, 1.0))
    return _Cut(sublayers, pieces, in_cell // pieces)


def _composition(scene: VoxelScene, cut: _Cut) -> Float[Array, "slab class y x"]:
    """Area per volume of each class in the slabs [m2 m-3]."""
    density = jnp.moveaxis(scene.area_density, 1, 0)
    return jnp.repeat(density, scene.structure_factor[0] * cut.sublayers // cut.pieces, axis=0)


class _Layers(NamedTuple):
    """What rays pass on their way down: slabs, of one or several pieces each."""

    composition: Float[Array, "slab class y x"]
    """Area per volume of each class in the slabs [m2 m-3]."""
    middles: Float[Array, " slab"]
    """Heights of the middles of the slabs [m]."""
    pieces: tuple[Any, ...]
    """Pieces of each slab: area per volume on the finest voxels, the sun's depth at the bottom,
    the height of that, and on terrain the share of each voxel column that is covered and of each
    sunbeam that is not stopped."""
    top: Float[Array, "row column"]
    """The sun's depth on top of the slabs."""


def _layers(
    scene: VoxelScene, sun: SunField, cut: _Cut, composition: Float[Array, "slab class y x"]
) -> _Layers:
    dtype = scene.area_density.dtype
    count = len(composition) * cut.pieces
    step = scene.height / count
    by_slab = lambda field: field.reshape(-1, cut.pieces, *field.shape[1:])  # noqa: E731
    heights = (jnp.arange(count) * step).astype(dtype)
    structure = terrain = None
    if scene.terrain is not None:
        # By the bottom of a piece the ground has covered so much of a column; by its top it has
        # stopped so much of a beam.
        covering = covered(scene, heights).at[0].set(1.0)  # nothing falls out of the grid
        terrain = by_slab(covering), by_slab(unshaded_beams(scene, sun, heights + step))
    if scene.structure is not None:
        structure = by_slab(jnp.repeat(scene.structure, cut.sublayers, axis=0))
    planes = _planes(sun.depth, cut.sublayers)
    pieces = structure, by_slab(planes[:-1]), by_slab(heights), terrain
    middles = heights[:: cut.pieces] + 0.5 * step * cut.pieces
    return _Layers(composition, middles, pieces, planes[-1])


def _scattered(
    scene: VoxelScene,
    diffuse: DiffuseField,
    rays: AbstractRays,
    ordinates: Ordinates,
    composition: Float[Array, "slab class y x"],
    cut: _Cut,
) -> Float[Array, "slab angle band y x"]:
    """`_Lit.scattered`."""
    field = scattered_towards(scene, diffuse, rays.central, ordinates, composition, cut.slabs)
    if not (rays.shape == (1, 1) or (isinstance(rays, RayLattice) and rays.nodes == 1)):
        return field
    # Parallel rays: a sum of slices, as that over an axis takes three times as long on a CPU.
    parts = (field[:, [i]] for i in range(field.shape[1]))
    return sum(parts, start=jnp.zeros((), field.dtype))


class _Lit(eqx.Module):
    """The diffuse light of some bands as the slabs meet it, and the ground's own radiance."""

    scattered: Float[Array, "slab angle band y x"]
    """Radiance per length that the leaves of each voxel scatter towards the middle of the view,
    for each distribution of their normals; all in one for parallel rays."""
    turning: Float[Array, "angle row column"]
    """Projected area towards a pixel over that towards the middle of the view [-]."""
    ground: "_GroundLight"
    rays: AbstractRays
    voxels: Lattice = eqx.field(static=True)
    smooth: bool = eqx.field(static=True)

    @classmethod
    def create(
        cls,
        scene: VoxelScene,
        sun: SunField,
        diffuse: DiffuseField,
        rays: AbstractRays,
        ordinates: Ordinates,
        scattered: Float[Array, "slab angle band y x"],
    ) -> "_Lit":
        _, ny, nx = scene.shape
        projection = pixel_projection(scene.classes.angles, rays)
        in_middle = projections(scene.classes.angles, rays.central[2])
        turning = projection / in_middle.astype(projection.dtype)[:, None, None]
        if projection.shape[1:] == (1, 1):  # parallel rays
            turning = jnp.ones_like(turning[:1])
        return cls(
            scattered,
            turning,
            _ground_light(scene, sun, diffuse, rays, ordinates),
            rays,
            Lattice(ny, nx, scene.horizontal, scene.boundary),
            scene.structure is not None,
        )

    def on_ground(self, ground: _GroundInView) -> Float[Array, "band row column"]:
        """Radiance of the ground in view."""
        sampler = self.rays.sampler(ground.height, self.voxels)
        direct = sampler(self.ground.direct) * self.ground.towards_sensor
        return ground.sunlit * direct + ground.gap * sampler(self.ground.diffuse)

    def add(self, sums: tuple[Array, Array], slab: _Slab, scattered: Array) -> tuple[Array, Array]:
        """Radiance of leaves and ground, with that of one more slab."""
        # The source is that towards the middle of the view. Elsewhere the same leaves have
        # another projected area, and their radiance changes in proportion to it.
        field = self.rays.sampler(slab.height, self.voxels, smooth=self.smooth)(scattered)
        leaves = sums[0] + slab.viewed * jnp.sum(self.turning[:, None] * field, axis=0)
        return leaves, sums[1] if slab.ground is None else sums[1] + self.on_ground(slab.ground)

    def add_all(self, sums: tuple[Array, Array], slabs: _Slab) -> tuple[Array, Array]:
        """The same with all slabs, stacked along a first axis."""
        one = lambda total, at: (self.add(total, *at), None)  # noqa: E731
        return jax.lax.scan(jax.checkpoint(one), sums, (slabs, self.scattered))[0]


class _Mixture(NamedTuple):
    """What a slab has in the footprint of each pixel."""

    total: Float[Array, "row column"]
    """Area of all classes per volume [m2 m-3]."""
    turned: Float[Array, "row column"]
    """The same, projected along the ray: the ray's extinction [m-1]."""
    common: list[Array]
    """Area of the classes of each kind (`kinds`) that a hot spot is followed of."""


class _Passed(NamedTuple):
    """What a ray has passed on its way down, from piece to piece of a slab."""

    depth: Float[Array, "row column"]
    """Optical depth on the way to the sensor [-]."""
    above: Float[Array, "row column"]
    """Optical depth on the way to the sun [-]."""
    sunlit: Float[Array, "row column"]
    """Path in the slab times the gaps to sun and sensor [m]."""
    viewed: Float[Array, "row column"]
    """Path in the slab times the gap to the sensor [m]."""
    states: tuple[Any, ...]
    """What both ways have had in common, of each kind with a hot spot."""
    end: tuple[Array, Array, Array] | None
    """Share of the ray that terrain has stopped, and in this slab what of it the canopy lets
    through to the sensor, and both to it and to the sun; None on level ground."""


class _Met(NamedTuple):
    """What a ray has met on its way down, from slab to slab."""

    depth: Float[Array, "row column"]
    above: Float[Array, "row column"]
    """As in `_Passed`."""
    sunlit: Float[Array, "class row column"]
    """Area of each class, times the gaps to sun and sensor [-]."""
    states: tuple[Any, ...]
    """As in `_Passed`."""
    blocked: Float[Array, "row column"]
    """Share of the ray that terrain has stopped [-]."""
    classes: Float[Array, "class row column"] | None
    """Share of the ray that ends on each class [-]; None where it is not asked for."""


class _Way:
    """The way of rays down through the pieces of the slabs, and of sunbeams to the same points."""

    def __init__(self, scene: VoxelScene, sun: SunField, rays: AbstractRays, pieces: int) -> None:
        _, ny, nx = scene.shape
        wide = scene.structure_factor[1]
        self.scene, self.sun, self.rays = scene, sun, rays
        self.step = scene.height / pieces
        """Height of a piece [m]."""
        self.path = self.step / rays.cosine
        """Length of each ray in it [m]."""
        # The unit vector towards the sun, from its slope.
        one = jnp.ones(1, scene.area_density.dtype)
        towards_sun = jnp.concatenate([sun.slope, one]) * sun.cosine
        self.overlap = overlaps(scene.classes, rays, towards_sun, self.step)
        self.voxels = Lattice(ny, nx, scene.horizontal, scene.boundary)
        self.finest = Lattice(ny * wide, nx * wide, scene.horizontal / wide, scene.boundary)

    def beams(self, height: Array) -> Callable[[Array], Array]:
        """Sampler of a plane of `sun.depth`."""
        scene, sun = self.scene, self.sun
        return self.rays.sampler(height, sun.lattice(scene), sun.offset(height, scene))

    def footprint(
        self, height: Array, rays: AbstractRays | None = None
    ) -> Callable[[Array], Array]:
        """Sampler of what voxels have at a height, by each of the rays, or of others."""
        return (rays or self.rays).sampler(
            height, self.voxels, smooth=self.scene.structure is not None
        )

    def through(
        self, mixture: _Mixture, carry: _Passed, at: tuple[Any, ...]
    ) -> tuple[_Passed, None]:
        """Through a piece `at` a height: area of its finest voxels, the sun's depth at its bottom,
        that height, which it lies above, and what terrain does there."""
        depth, above, sunlit, viewed, states, end = carry
        structure, plane, height, terrain = at
        # The sun's depth is linear between planes.
        length = self.path
        if structure is not None:
            # Its area over the voxels' mean, which the mixture is counted in.
            here = self.rays.sampler(height + 0.5 * self.step, self.finest)(structure)
            length = self.path * self.scene.relative_density(here, mixture.total)
        # Depths of the piece along the ray, and of both ways, to the sensor and to the sun.
        along = mixture.turned * length
        below = self.beams(height)(plane)
        crossed = along + below - above
        # Chance that leaves of the piece are seen and lit: with a hot spot at points of the piece,
        # as leaves that stand in both ways count once; else in closed form.
        if self.overlap:
            areas = [area * (length / self.path) for area in mixture.common]
            shared = _sum_points(
                [o.at_points(s, a) for o, s, a in zip(self.overlap, states, areas)]
            )
            weight = jnp.zeros_like(depth)
            for share, portion, extra in zip(POINTS, POINT_WEIGHTS, shared):
                weight = weight + portion * jnp.exp(extra - crossed * share - depth - above)
            states = tuple(o.advance(s, a) for o, s, a in zip(self.overlap, states, areas))
        else:
            weight = transmittance_beyond(depth + above, crossed)
        # Chance that they are seen.
        mean = jnp.exp(-depth) * mean_transmittance(along)
        if terrain is not None:
            covering, unshaded = terrain
            assert end is not None
            blocked, gap, through = end
            mean = mean * (1.0 - blocked)
            weight = weight * (1.0 - blocked) * self.beams(height + self.step)(unshaded)
        sunlit, viewed = sunlit + weight * length, viewed + mean * length
        depth = depth + along
        if terrain is not None:
            # The ray ends on the ground by the largest share of it that it has met.
            now = jnp.maximum(blocked, self.rays.sampler(height, self.voxels)(covering))
            ended = (now - blocked) * jnp.exp(-depth)
            lit_share = jnp.exp(shared[-1] - below) if self.overlap else jnp.exp(-below)
            end = now, gap + ended, through + ended * lit_share
        return _Passed(depth, below, sunlit, viewed, states, end), None

    def in_blocks(self, met: _Slab, mixture: _Mixture, mixed: Array, together: int) -> _Slab:
        """A slab as means of blocks of `together` x `together` rays."""
        if together == 1:
            return met
        # Rays count by the area they meet, which light is nearly in proportion to: within a block
        # area changes much, the light of an area little.
        middle = self.footprint(met.height, self.rays.together(together))
        area = middle(mixed.sum(axis=0))
        met = _in_blocks(met._replace(viewed=met.viewed * mixture.total), together)
        return met._replace(
            viewed=jnp.where(area > 0, met.viewed / jnp.where(area > 0, area, 1.0), 0.0)
        )


def _look(
    scene: VoxelScene,
    sun: SunField,
    rays: AbstractRays,
    layers: _Layers,
    cut: _Cut,
    lit: _Lit | None,
    together: int = 1,
    classes_met: bool = False,
) -> tuple[_View, Any]:
    """Follow the rays down through the slabs.

    Returns what they view and, with `lit`, the radiance of leaves and terrain out of the diffuse
    light; without it the `_Slab`s, stacked along a first axis, and all of it as means of blocks of
    `together` x `together` rays. The classes that they meet are counted with `classes_met`.
    """
    classes = scene.classes
    dtype = scene.area_density.dtype
    projection = pixel_projection(classes.angles, rays)[jnp.asarray(classes.angle_of_class)]
    way = _Way(scene, sun, rays, len(layers.middles) * cut.pieces)
    members = [_members(classes, kind) for kind in kinds(classes)]
    none = jnp.zeros(rays.shape, dtype)
    hilly = scene.terrain is not None

    def slab(carry: tuple[_Met, Any], at: tuple[Any, ...]) -> tuple[tuple[_Met, Any], Any]:
        (depth, above, sunlit, states, blocked, met), sums = carry
        pieces, mixed, height, scattered = at
        # Area of each class in the pixel's footprint, and what of it the ray meets.
        area = way.footprint(height)(mixed)
        turned = jnp.sum(area * projection, axis=0)
        common = [jnp.tensordot(jnp.asarray(m, dtype), area, axes=1) for m in members]
        mixture = _Mixture(area.sum(axis=0), turned, common if way.overlap else [])
        # Down through the pieces of the slab, the uppermost first.
        start = _Passed(depth, above, none, none, states, (blocked, none, none) if hilly else None)
        one = partial(way.through, mixture)
        if cut.pieces == 1:
            passed, _ = one(start, jax.tree.map(lambda field: field[0], pieces))
        else:
            passed, _ = jax.lax.scan(jax.checkpoint(one), start, pieces, reverse=True)
        ground = None
        if passed.end is not None:
            blocked = passed.end[0]
            ground = _GroundInView(height - 0.5 * way.step * cut.pieces, *passed.end[1:])
        # What the slab adds: to the sunlit area of each class, and out of the diffuse light.
        in_view = _Slab(height, passed.viewed, ground)
        met = None if met is None else met + passed.viewed * area * projection
        sunlit = sunlit + passed.sunlit * area
        now = _Met(passed.depth, passed.above, sunlit, passed.states, blocked, met)
        if lit is None:
            return (now, sums), way.in_blocks(in_view, mixture, mixed, together)
        return (now, lit.add(sums, in_view, scattered)), None

    dark = jnp.zeros((0 if lit is None else classes.reflectance.shape[1], *rays.shape), dtype)
    no_class = jnp.zeros((len(classes.angle_of_class), *rays.shape), dtype)
    at_top = way.beams(jnp.asarray(scene.height, dtype))(layers.top)
    states = tuple(o.start(rays.shape) for o in way.overlap)
    start = _Met(none, at_top, no_class, states, none, no_class if classes_met else None)
    scattered = None if lit is None else lit.scattered
    # Recomputing a slab in the backward pass keeps memory to one slab's arrays.
    (end, sums), slabs = jax.lax.scan(
        jax.checkpoint(slab),
        (start, (dark, dark)),
        (layers.pieces, layers.composition, layers.middles, scattered),
        reverse=True,
    )
    # What is left of the ray ends on level ground, which the sun reaches as far as both ways share.
    gap = jnp.exp(-end.depth)
    level = None
    if not hilly:
        shared = sum((state[0] + state[1] for state in end.states), start=jnp.zeros((), dtype))
        level = _GroundInView(jnp.zeros((), dtype), gap, gap * jnp.exp(shared - end.above))
    view = _in_blocks(_View(end.sunlit, level, gap, end.classes), together)
    return view, slabs if lit is None else sums


def _in_blocks(of_rays: Any, together: int) -> Any:
    """Means of blocks of `together` x `together` rays, of all that is an image."""
    return jax.tree.map(lambda a: _mean_of_blocks(a, together) if a.ndim > 1 else a, of_rays)


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
        return jnp.stack(area_scattering_of(classes.angles, travel[None], vectors))[:, :, 0]

    # Light of the sun on the sunlit area of each class, sent on by its two sides.
    reflect, transmit = rays.angular(phase)
    beam = scene.illumination.sun.astype(dtype) / sun.cosine / jnp.pi
    first = beam[:, None, None] * (
        jnp.einsum("cb,crk->brk", classes.reflectance, view.sunlit * reflect[owner])
        + jnp.einsum("cb,crk->brk", classes.transmittance, view.sunlit * transmit[owner])
    )
    ground = sums[1] if view.ground is None else lit.on_ground(view.ground)
    return first, sums[0], ground


def _mean_of_blocks(image: Float[Array, "*field row column"], size: int) -> Array:
    """Means of blocks of `size` x `size` pixels."""
    if size == 1:
        return image
    *fields, rows, columns = image.shape
    cut = image.reshape(*fields, rows // size, size, columns // size, size)
    return cut.mean(axis=(-3, -1))


def _members(classes: OpticalClasses, kind: tuple[int, int]) -> list[float]:
    """One for the classes of a kind (distribution of normals, leaf size), else zero."""
    return [float(pair == kind) for pair in zip(classes.angle_of_class, classes.sizes)]


def _sum_points(per_kind: list[list[Array]]) -> list[Array]:
    return [sum(values[1:], start=values[0]) for values in zip(*per_kind)]


class _GroundLight(NamedTuple):
    """Radiance of the bare ground, without canopy above it."""

    direct: Float[Array, "band y x"]
    """Radiance of ground in full sun, towards no direction in particular."""
    towards_sensor: Float[Array, "band row column"]
    """Radiance of ground in full sun towards the sensor, by the angular shape of the ground."""
    diffuse: Float[Array, "band y x"]


def _ground_light(
    scene: VoxelScene,
    sun: SunField,
    diffuse: DiffuseField,
    rays: AbstractRays,
    ordinates: Ordinates,
) -> _GroundLight:
    dtype = scene.area_density.dtype
    soil, shape = scene.ground_map, scene.ground_shape
    direct = scene.illumination.sun.astype(dtype)[:, None, None] * soil / jnp.pi
    if sun.incidence is not None:
        direct = direct * sun.incidence
    if shape is None:
        towards = jnp.ones((soil.shape[0], 1, 1), dtype)
    else:
        sunward = -jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
        towards = rays.angular(lambda views: shape.shape(sunward[None], views)[:, 0])
    return _GroundLight(direct, towards, ground_towards(scene, diffuse, rays.central, ordinates))


def ground_towards(
    scene: VoxelScene, diffuse: DiffuseField, towards: Float[Array, " 3"], ordinates: Ordinates
) -> Float[Array, "band y x"]:
    """Radiance that the bare ground sends towards a direction out of the diffuse light."""
    soil, shape = scene.ground_map, scene.ground_shape
    dtype = diffuse.falling.dtype
    fluxes = jnp.asarray(ordinates.fluxes.ravel(), dtype)
    if shape is None:
        received = jnp.einsum("o,boyx->byx", fluxes, diffuse.falling)
    else:
        down = jnp.asarray(ordinates.vectors[: len(fluxes)], dtype)
        # An angular shape weighs each downward direction by its own reflectance factor.
        kernel = shape.shape(down, towards[None])[:, :, 0] * fluxes
        received = jnp.einsum("bo,boyx->byx", kernel, diffuse.falling)
    factor = diffuse.factor(scene)
    received = upsample(received[:, None], (1, factor[1]), scene.boundary)[:, 0]
    return received * soil / jnp.pi


def _planes(
    depth: Float[Array, "interface row column"], sublayers: int
) -> Float[Array, "plane row column"]:
    """Depth on the planes between pieces, linear between the layers' interfaces."""
    if sublayers == 1:
        return depth
    # Planes from each interface on up to the next, and the last one.
    shares = (jnp.arange(sublayers, dtype=depth.dtype) / sublayers)[:, None, None]
    between = depth[:-1, None] * (1 - shares) + depth[1:, None] * shares
    return jnp.concatenate([between.reshape(-1, *depth.shape[1:]), depth[-1:]])


def scattered_towards(
    scene: VoxelScene,
    diffuse: DiffuseField,
    towards: Float[Array, " 3"],
    ordinates: Ordinates,
    composition: Float[Array, "slab class y x"],
    slabs: int,
) -> Float[Array, "slab angle band y x"]:
    """Radiance per length that leaves scatter towards a direction out of the diffuse field, which
    has so many slabs in a cell.

    The field is smooth and comes from the coarse grid; the leaf area it meets is that of the
    voxels.
    """
    classes, dtype = scene.classes, diffuse.intensity.dtype
    vectors = jnp.asarray(ordinates.vectors, dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    times = slabs, diffuse.factor(scene)[1]
    shares = jnp.stack(area_scattering_of(classes.angles, vectors, towards[None]))[..., 0] * weights
    projection = projections(classes.angles, towards[2]).astype(dtype)
    # By reciprocity they sum to the projection towards the sensor, which scales the quadrature.
    shares = shares * (projection / shares.sum(axis=-1))[..., None]  # [kind, angle, ordinate]
    optics = jnp.stack([classes.reflectance, classes.transmittance])
    mine = np.asarray(classes.angle_of_class) == np.arange(len(classes.angles))[:, None]

    def of_angle(at: tuple[Array, Array]) -> Array:
        """From the leaves that share a distribution of normals."""
        share, mine = at
        field = jnp.einsum("ko,bozyx->kbzyx", share, diffuse.intensity)
        field = upsample(field, times, scene.boundary)
        area = jnp.einsum("kcb,scyx->kbsyx", optics * mine[:, None], composition)
        return area[0] * field[0] + area[1] * field[1]

    # One program for all distributions; recomputed in the backward pass, no field is kept.
    each = jnp.swapaxes(shares, 0, 1), jnp.asarray(mine, dtype)
    sources = jax.lax.map(jax.checkpoint(of_angle), each)
    return jnp.transpose(sources, (2, 0, 1, 3, 4))
