"""Direct sunlight on the fine grid.

All sun rays are parallel: in a lattice that is sheared along with them every beam is a column,
and the optical depth is a cumulative sum down it, free of step-by-step numerical diffusion.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax._core.geometry import direction
from fynjax._core.math import mean_transmittance
from fynjax.radiation._rays import Lattice
from fynjax.radiation._resample import axis_weights, sample
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

    `margin` [voxels] widens the lattice so that in an open scene each voxel is on a beam.
    """
    nz, ny, nx = scene.shape
    dtype = scene.area_density.dtype
    towards = direction(scene.illumination.sun_zenith, scene.illumination.sun_azimuth).astype(dtype)
    cosine = towards[2]
    slope = towards[:2] / cosine
    by_angle = scene.classes.total_by_angle(scene.area_density)
    projection = jnp.stack([angle.projection(cosine) for angle in scene.classes.angles])
    extinction = jnp.einsum("a,azyx->zyx", projection.astype(dtype), by_angle)

    width = scene.horizontal / per_voxel
    pad = margin * per_voxel
    columns, rows = _beams(scene, per_voxel, margin)

    # The path through a layer is split in sub-layers, each sampled where the beam is at its
    # middle: a slant beam changes voxel within a layer.
    step = scene.vertical / sublayers
    heights = ((jnp.arange(nz * sublayers) + 0.5) * step).astype(dtype).reshape(nz, sublayers)

    def weigh(points: Array, shifts: Array, count: int) -> Array:
        """[z, point, cell]"""
        return jax.vmap(
            lambda shift: axis_weights(
                points + shift, width, count, scene.horizontal, scene.boundary
            )
        )(shifts)

    depths, weights = [], []
    for sub in range(sublayers):
        wx = weigh(columns, heights[:, sub] * slope[0], nx)
        wy = weigh(rows, heights[:, sub] * slope[1], ny)
        crossed = jnp.einsum("zry,zyx,zcx->zrc", wy, extinction, wx, optimize="optimal")
        depths.append(crossed * (step / cosine))
        weights.append((wy, wx))
    pieces = jnp.stack(depths, axis=1).reshape(nz * sublayers, *depths[0].shape[1:])
    below = jnp.cumsum(pieces[::-1], axis=0)[::-1]  # depth at the bottom of each piece
    above = below - pieces
    mean = jnp.exp(-above) * mean_transmittance(pieces)
    mean = mean.reshape(nz, sublayers, *mean.shape[1:])
    interfaces = jnp.concatenate([below[::sublayers], jnp.zeros_like(below[:1])])
    if scene.terrain is not None:
        tops = heights.ravel() + 0.5 * step
        mean = mean * _unshaded(scene, slope, (columns, rows), width, tops).reshape(mean.shape)
    # The transpose of the sampling: light found on the beams goes back to the voxels that the
    # beams crossed, so that what the voxels take is what the beams lose.
    voxel = jnp.asarray(
        sum(
            jnp.einsum("zry,zrc,zcx->zyx", wy, mean[:, sub], wx, optimize="optimal")
            for sub, (wy, wx) in enumerate(weights)
        )
    ) / (sublayers * per_voxel**2)
    if scene.terrain is None:
        beams = jnp.exp(-interfaces[0])
        beams = beams[pad : beams.shape[0] - pad, pad : beams.shape[1] - pad]
        on_ground = beams.reshape(ny, per_voxel, nx, per_voxel).mean(axis=(1, 3))
        return SunField(interfaces, voxel, on_ground, None, cosine, slope, pad, per_voxel)
    steps = max(margin, 2) if scene.boundary == "open" else max(ny, nx)
    incidence = sun_on_ground(scene, towards, steps)
    field = SunField(interfaces, voxel, incidence, incidence, cosine, slope, pad, per_voxel)
    on_ground = incidence * _canopy_above_ground(field, scene)
    return eqx.tree_at(lambda f: f.on_ground, field, on_ground)


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
        now = jnp.minimum(open_above, 1.0 - sample(below_ground, wy, wx))
        return now, now

    start = jnp.ones((rows.shape[0], columns.shape[0]), columns.dtype)
    _, shares = jax.lax.scan(plane, start, (covered(scene, heights), heights), reverse=True)
    return shares


def _canopy_above_ground(sun: SunField, scene: VoxelScene) -> Float[Array, "y x"]:
    """Transmittance of the canopy towards the sun, from the ground of each voxel column."""
    nz, ny, nx = scene.shape
    dtype = sun.depth.dtype
    heights = (jnp.arange(nz + 1) * scene.vertical).astype(dtype)
    x = ((jnp.arange(nx) + 0.5) * scene.horizontal).astype(dtype)
    y = ((jnp.arange(ny) + 0.5) * scene.horizontal).astype(dtype)
    below = covered(scene, heights)
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
        return total + share * (1.0 - sample(-jnp.expm1(-depth), wy, wx)), None

    total, _ = jax.lax.scan(plane, jnp.zeros((ny, nx), dtype), (sun.depth, ends_here, heights))
    return total
