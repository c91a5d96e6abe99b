"""Direct sunlight on the fine grid.

All sun rays are parallel: in a lattice that is sheared along with them every beam is a column,
and the optical depth is a cumulative sum down it, free of step-by-step numerical diffusion.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax._core.geometry import direction
from fynjax._core.math import mean_transmittance
from fynjax.canopy import projections
from fynjax.radiation._blocks import block_mean, spread
from fynjax.radiation._rays import Lattice
from fynjax.radiation._resample import axis_weights, resample
from fynjax.radiation._scene import VoxelScene
from fynjax.radiation._terrain import covered, sun_on_ground


class SunField(eqx.Module):
    """Optical depth of the sun's beams, and its mean transmittance in each voxel."""

    depth: Float[Array, "interface row column"]
    """Optical depth towards the sun [-] on the planes between layers, from the ground up.

    The beam of lattice point (row, column) meets height z at its point on the ground plus
    z times `slope`."""
    voxel_transmittance: Float[Array, "z y x"]
    """Mean transmittance towards the sun in each voxel [-]."""
    on_ground: Float[Array, "y x"]
    """Direct irradiance on the ground's surface in each voxel column, over that above the canopy
    on a level plane [-]."""
    incidence: Float[Array, "y x"] | None
    """`on_ground` without the canopy; None: level ground."""
    cosine: Float[Array, ""]
    """Cosine of the sun's zenith angle [-]."""
    slope: Float[Array, " 2"]
    """Horizontal distance per height along a beam, (x, y) [-]."""
    margin: int = eqx.field(static=True)
    """Lattice points added on each side (open boundary only)."""
    per_voxel: int = eqx.field(static=True)
    """Lattice points along a voxel's edge."""

    def lattice(self, scene: VoxelScene) -> Lattice:
        """The lattice of the beams as cells."""
        rows, columns = self.depth.shape[1:]
        return Lattice(rows, columns, scene.horizontal / self.per_voxel, scene.boundary)

    def offset(self, height: Array, scene: VoxelScene) -> tuple[Array, Array]:
        """How far the corner of that lattice at `height` lies from that of the scene, in x and
        y, as samplers take it."""
        shift = self.margin * scene.horizontal / self.per_voxel
        return shift - height * self.slope[0], shift - height * self.slope[1]


def trace_sun(scene: VoxelScene, per_voxel: int, sublayers: int, margin: int) -> SunField:
    """Optical depth and mean transmittance towards the sun. Differentiable in everything.

    `per_voxel` beams lie along an edge of the finest voxels. `margin` [voxels of the grid] widens
    the lattice so that in an open scene each voxel is on a beam.
    """
    _, ny, nx = scene.shape
    dtype = scene.area_density.dtype
    towards = direction(scene.illumination.sun_zenith, scene.illumination.sun_azimuth).astype(dtype)
    cosine = towards[2]
    slope = towards[:2] / cosine
    extinction = _extinction(scene, cosine)
    factor = scene.structure_factor
    # All that follows counts beams along an edge of the voxels of the grid itself.
    fine, per_voxel = per_voxel, per_voxel * factor[1]
    width, pad = scene.horizontal / per_voxel, margin * per_voxel
    layers = extinction.shape[0]
    thickness = scene.height / layers

    # The path through a layer is split in sub-layers, each sampled where the beam is at its
    # middle: a slant beam changes voxel within a layer.
    step = thickness / sublayers
    # Middles of the pieces, the lowest first.
    heights = ((jnp.arange(layers * sublayers) + 0.5) * step).astype(dtype)
    unshaded = None
    if scene.terrain is not None:
        beams = _beams(scene, per_voxel, margin)
        unshaded = _unshaded(scene, slope, beams, width, heights + 0.5 * step)
    by_layer = lambda field: field.reshape(layers, sublayers, *field.shape[1:])  # noqa: E731

    def layer(above: Array, at: tuple[Any, ...]) -> tuple[Array, tuple[Array, Array]]:
        field, heights, unshaded = at
        # The layer on the lattice of beams; beside an open scene it is empty.
        field = jnp.pad(jnp.repeat(jnp.repeat(field, fine, axis=0), fine, axis=1), pad)
        voxels = jnp.zeros_like(field)
        # From the top of the layer down: what each beam crosses, and what of the light is left.
        for sub in reversed(range(sublayers)):
            shift = heights[sub] * slope / width
            crossed = _move(field, shift, scene.boundary) * (step / cosine)
            mean = jnp.exp(-above) * mean_transmittance(crossed)
            if unshaded is not None:
                mean = mean * unshaded[sub]
            # The transpose of the sampling: light found on the beams goes back to the voxels that
            # the beams crossed, so that what the voxels take is what the beams lose.
            voxels = voxels + _move(mean, -shift, scene.boundary)
            above = above + crossed
        return above, (above, _inner_mean(voxels, pad, fine) / sublayers)

    start = jnp.zeros((ny * per_voxel + 2 * pad, nx * per_voxel + 2 * pad), dtype)
    _, (depth, voxel) = jax.lax.scan(
        jax.checkpoint(layer),
        start,
        (extinction, by_layer(heights), None if unshaded is None else by_layer(unshaded)),
        reverse=True,
    )
    interfaces = jnp.concatenate([depth, start[None]])
    if scene.structure is not None:
        # Weighted so that the leaves of a voxel take what its beams lose.
        taken, area = block_mean(jnp.stack([extinction * voxel, extinction]), factor)
        even = block_mean(voxel, factor)
        voxel = jnp.where(area > 0, taken / jnp.where(area > 0, area, 1.0), even)
    if scene.terrain is None:
        on_ground = _inner_mean(jnp.exp(-interfaces[0]), pad, per_voxel)
        return SunField(interfaces, voxel, on_ground, None, cosine, slope, pad, per_voxel)
    steps = max(margin, 2) if scene.boundary == "open" else max(ny, nx)
    incidence = sun_on_ground(scene, towards, steps)
    field = SunField(interfaces, voxel, incidence, incidence, cosine, slope, pad, per_voxel)
    on_ground = incidence * _canopy_above_ground(field, scene)
    return eqx.tree_at(lambda f: f.on_ground, field, on_ground)


def _extinction(scene: VoxelScene, cosine: Array) -> Float[Array, "Z Y X"]:
    """Projected area per volume towards the sun, on the finest voxels [m2 m-3]."""
    dtype = scene.area_density.dtype
    by_angle = scene.classes.total_by_angle(scene.area_density)
    projection = projections(scene.classes.angles, cosine)
    projected = jnp.einsum("a,azyx->zyx", projection.astype(dtype), by_angle)
    if scene.structure is None:
        return projected
    total, projected = spread(jnp.stack([by_angle.sum(axis=0), projected]), scene.structure_factor)
    return projected * scene.relative_density(scene.structure, total)


def _move(
    field: Float[Array, "row column"], shift: Float[Array, " xy"], boundary: str
) -> Float[Array, "row column"]:
    """The field at `shift` cells from each of its points, linear between them; nothing lies beyond
    its ends where they are open. With minus the shift it is the transpose."""
    for axis, by in ((1, shift[0]), (0, shift[1])):
        size = field.shape[axis]
        # Whole cells by a slice of a field that goes on beyond its ends, the rest linearly.
        whole = jnp.floor(jax.lax.stop_gradient(by))
        share = by - whole
        if boundary == "periodic":
            padded, start = jnp.concatenate([field, field, field], axis), whole.astype(int) % size
        else:
            ends = [(size, size) if a == axis else (0, 0) for a in (0, 1)]
            padded, start = jnp.pad(field, ends), whole.astype(int) + size
        near, far = (
            jax.lax.dynamic_slice_in_dim(padded, start + more, size, axis) for more in (0, 1)
        )
        field = (1.0 - share) * near + share * far
    return field


def _inner_mean(field: Float[Array, "row column"], pad: int, size: int) -> Float[Array, "y x"]:
    """Means over blocks of `size` points, without the `pad` points at each end."""
    inner = field[pad : field.shape[0] - pad, pad : field.shape[1] - pad]
    rows, columns = inner.shape
    return inner.reshape(rows // size, size, columns // size, size).mean(axis=(1, 3))


def _beams(
    scene: VoxelScene, per_voxel: int, margin: int
) -> tuple[Float[Array, " column"], Float[Array, " row"]]:
    """Where the beams of the lattice meet the ground's plane [m]."""
    _, ny, nx = scene.shape
    pad, width = margin * per_voxel, scene.horizontal / per_voxel
    columns, rows = (
        ((jnp.arange(-pad, count * per_voxel + pad) + 0.5) * width).astype(scene.area_density.dtype)
        for count in (nx, ny)
    )
    return columns, rows


def unshaded_beams(
    scene: VoxelScene, sun: SunField, heights: Float[Array, " plane"]
) -> Float[Array, "plane row column"]:
    """Share of each beam that terrain has not stopped above each of the rising `heights` [-]."""
    beams = _beams(scene, sun.per_voxel, sun.margin // sun.per_voxel)
    return _unshaded(scene, sun.slope, beams, scene.horizontal / sun.per_voxel, heights)


def _unshaded(
    scene: VoxelScene,
    slope: Float[Array, " 2"],
    beams: tuple[Float[Array, " column"], Float[Array, " row"]],
    width: float,
    heights: Float[Array, " plane"],
) -> Float[Array, "plane row column"]:
    _, ny, nx = scene.shape
    columns, rows = beams

    def plane(open_above: Array, at: tuple[Array, Array]) -> tuple[Array, Array]:
        below_ground, height = at
        wx = axis_weights(columns + height * slope[0], width, nx, scene.horizontal, scene.boundary)
        wy = axis_weights(rows + height * slope[1], width, ny, scene.horizontal, scene.boundary)
        # Terrain that has stopped a share of a beam keeps it stopped on the way down.
        now = jnp.minimum(open_above, 1.0 - resample(below_ground, wy, wx))
        return now, now

    start = jnp.ones((rows.shape[0], columns.shape[0]), columns.dtype)
    _, shares = jax.lax.scan(plane, start, (covered(scene, heights), heights), reverse=True)
    return shares


def _canopy_above_ground(sun: SunField, scene: VoxelScene) -> Float[Array, "y x"]:
    """Transmittance of the canopy towards the sun, from the ground of each voxel column."""
    _, ny, nx = scene.shape
    dtype = sun.depth.dtype
    heights = jnp.linspace(0.0, scene.height, sun.depth.shape[0], dtype=dtype)
    x = ((jnp.arange(nx) + 0.5) * scene.horizontal).astype(dtype)
    y = ((jnp.arange(ny) + 0.5) * scene.horizontal).astype(dtype)
    below = covered(scene, heights)
    # Share of each column whose ground lies between a plane and the next above it.
    ends_here = jnp.concatenate([1.0 - below[1:2], below[1:-1] - below[2:], below[-1:]])

    width = scene.horizontal / sun.per_voxel
    shift = sun.margin * width

    def plane(total: Array, at: tuple[Array, Array, Array]) -> tuple[Array, None]:
        depth, share, height = at
        wx, wy = (
            axis_weights(
                points - height * slope + shift, scene.horizontal, count, width, scene.boundary
            )
            for points, slope, count in zip((x, y), sun.slope, depth.shape[::-1])
        )
        # The mean of what reaches the voxel's area, beam by beam: a beam of their mean depth
        # would bring less. Beside the lattice nothing is in the way.
        return total + share * (1.0 - resample(-jnp.expm1(-depth), wy, wx)), None

    total, _ = jax.lax.scan(plane, jnp.zeros((ny, nx), dtype), (sun.depth, ends_here, heights))
    return total
