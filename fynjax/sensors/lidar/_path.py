"""Along the pencils of a beam: what stops the light, what sends it back, where the ground is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.math import mean_transmittance
from fynjax.canopy import AbstractLeafAngle, projections
from fynjax.radiation import Lattice, RayField, VoxelScene
from fynjax.sensors.lidar._late import LateLight

_BISECTIONS = 30
_PLANES = 4  # in a layer: what is thinner than the distance of two may be missed


class PencilPaths(eqx.Module):
    """The canopy along each pencil, in even steps from the top of the grid down, and the ground."""

    depth: Float[Array, "step pencil"]
    """Optical depth of each step [-]."""
    source: Float[Array, "step *group pencil"]
    """Signal of each step, without shade, as the reflectance of a plate [-]: of all classes, or of
    each group of them."""
    late: Float[Array, "step pencil"] | None
    """Signal of each step, without shade, out of light that was scattered before [-]."""
    top: Float[Array, " pencil"]
    """Range of the grid's top [m]."""
    step: Float[Array, " pencil"]
    """Length of a step [m]."""
    ground_range: Float[Array, " pencil"]
    """Range of the ground [m]."""
    ground: Float[Array, " pencil"]
    """Reflectance of the ground times the cosine of incidence [-]."""
    late_ground: Float[Array, " pencil"] | None
    """Signal of the ground out of light that was scattered before [-]."""

    def _place(self, distance: Array) -> tuple[Array, Array]:
        """Step and share of it at ranges [point, pencil]."""
        steps = self.depth.shape[0]
        place = (jnp.minimum(distance, self.ground_range) - self.top) / self.step
        index = jnp.clip(jax.lax.stop_gradient(jnp.floor(place)).astype(int), 0, steps - 1)
        return index, jnp.clip(place - index, 0.0, 1.0)

    def depth_at(self, distance: Float[Array, "point pencil"]) -> Float[Array, "point pencil"]:
        """Optical depth down to a range [m] or to the ground, whichever comes first [-]."""
        index, share = self._place(distance)
        above = jnp.cumsum(self.depth, axis=0) - self.depth
        in_step = jnp.take_along_axis(self.depth, index, axis=0)
        return jnp.take_along_axis(above, index, axis=0) + share * in_step

    def returned(
        self, distance: Float[Array, "point one"], source: Float[Array, "step pencil"]
    ) -> Float[Array, "point pencil"]:
        """What the canopy down to a range [m] sends back of a source [-]: each leaf through the gap
        that the light came by. Exact for even leaf area along a step."""
        index, share = self._place(distance)
        below = jnp.cumsum(self.depth, axis=0)
        above = below - self.depth
        gap = jnp.exp(-above)
        # A leaf in a step is lit, and seen, through the gap above it and its share of the step.
        whole = source * gap * mean_transmittance(self.depth)
        before = jnp.cumsum(whole, axis=0) - whole
        # One read for all: what lies side by side is fetched together.
        table = jnp.stack([before, source * gap, self.depth], axis=-1)
        at = jnp.take_along_axis(table, index[..., None], axis=0)
        return at[..., 0] + share * at[..., 1] * mean_transmittance(share * at[..., 2])

    def hit_by(self, depth: Float[Array, " pencil"]) -> tuple[Array, Array, Array | None, Array]:
        """Where the optical depth reaches `depth`: range [m], what a hit there sends back of
        `source`, by its groups, and of `late` [-], and whether that is above the ground."""
        below = jnp.cumsum(self.depth, axis=0)
        # The step in which the depth is reached; a depth beyond all is in the last.
        index = jnp.minimum(jnp.sum(below <= depth, axis=0), self.depth.shape[0] - 1)[None]
        in_step = jnp.take_along_axis(self.depth, index, axis=0)[0]
        above = jnp.take_along_axis(below, index, axis=0)[0] - in_step
        some = in_step > 0
        share = jnp.where(some, (depth - above) / jnp.where(some, in_step, 1.0), 1.0)
        distance = self.top + self.step * (index[0] + share)

        def sent(source: Array) -> Array:
            place = index.reshape(1, *(1,) * (source.ndim - 2), -1)
            here = jnp.take_along_axis(source, place, axis=0)[0]
            return jnp.where(some, here / jnp.where(some, in_step, 1.0), 0.0)

        late = None if self.late is None else sent(self.late)
        return distance, sent(self.source), late, depth < self.depth_at(self.ground_range[None])[0]


@eqx.filter_jit
def canopy_fields(
    scene: VoxelScene, groups: tuple[tuple[int, ...], ...] | None = None
) -> Float[Array, "field z y x"]:
    """Area, and area times reflectance of all classes or of each group of them, of each
    distribution of normals."""
    density = scene.area_density
    bright = scene.classes.reflectance[:, 0].astype(density.dtype)[:, None, None, None] * density
    parts = [density, bright]
    if groups is not None:
        mine = np.array([np.isin(np.arange(len(density)), group) for group in groups])
        parts[1:] = [jnp.where(one[:, None, None, None], bright, 0.0) for one in mine]
    return jnp.concatenate([scene.classes.total_by_angle(part) for part in parts])


@eqx.filter_jit
def backscatter(angle: AbstractLeafAngle, cosine: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Gamma_r back along the ray: the mean squared cosine between ray and leaf normal [-].

    `cosine` of the ray's zenith angle. Equals `area_scattering` of a direction and its opposite,
    where flat leaves send nothing that they transmit. Normals are even in azimuth, so the mean is
    linear in the square of `cosine`.
    """
    normals, weight = angle.normals()
    upright = jnp.sum(weight * normals[:, 2] ** 2).astype(cosine.dtype)
    square = cosine**2
    return square * upright + 0.5 * (1.0 - square) * (1.0 - upright)


def trace_pencils(
    scene: VoxelScene,
    fields: Float[Array, "field z y x"],
    origin: Float[Array, " 3"],
    direction: Float[Array, " 3"],
    pencils: Float[Array, "pencil 2"],
    width: float,
    sublayers: int,
    late: LateLight | None = None,
) -> PencilPaths:
    """One beam through a scene, whose `fields` are those of `canopy_fields`. Differentiable in the
    scene, and in origin and direction."""
    nz, ny, nx = scene.shape
    dtype = scene.area_density.dtype
    towards = -_pencil_directions(direction, pencils)
    cosine, platform = towards[:, 2], origin[2]
    slopes = towards[:, :2] / cosine[:, None]
    # Rays are those from the ground to the sensor, which meet the bottom of the grid at `foot`.
    foot = origin[:2] - platform * slopes
    rays = RayField(
        foot[None, :, 0],
        foot[None, :, 1],
        slopes[None, :, 0],
        slopes[None, :, 1],
        (width * platform / cosine)[None],
    )
    angles = scene.classes.angles
    projection = projections(angles, cosine).astype(dtype)
    back = jnp.stack([backscatter(a, cosine).astype(dtype) for a in angles])
    lattice = Lattice(ny, nx, scene.horizontal, scene.boundary)
    groups = len(fields) // len(angles) - 1
    if late is not None:
        fields = jnp.concatenate([fields, late.leaves[None]])
    structure, (high, wide) = scene.structure, scene.structure_factor
    if structure is not None:
        finest = Lattice(ny * wide, nx * wide, scene.horizontal / wide, scene.boundary)
        fields = jnp.concatenate([fields, scene.area_density.sum(axis=0)[None]])
    per_layer = high * sublayers
    length = scene.vertical / per_layer / cosine

    def piece(_: None, number: Array) -> tuple[None, tuple[Array, Array, Array | None]]:
        # Steps are counted from the top: the middle of this one, and the layer that it is in.
        height = ((nz - (number + 0.5) / per_layer) * scene.vertical).astype(dtype)
        layer = nz - 1 - number // per_layer
        here = jax.lax.dynamic_index_in_dim(fields, layer, 1, keepdims=False)
        met = rays.sampler(height, lattice, smooth=structure is not None)(here)[:, 0]
        if structure is not None:
            # The classes are mixed as in the voxel; how much there is of them is the structure's.
            layer = nz * high - 1 - number // sublayers
            fine = jax.lax.dynamic_index_in_dim(structure, layer, 0, keepdims=False)
            total = rays.sampler(height, finest)(fine)[0]
            met = met[:-1] * scene.relative_density(total, met[-1])
        # [angle], [group, angle], and the late light: areas that stop light, and send it back.
        stop, send, more = jnp.split(met, [len(angles), (1 + groups) * len(angles)])
        stop = jnp.sum(projection * stop, axis=0)
        send = jnp.sum(back * send.reshape(groups, len(angles), -1), axis=1)
        send = send[0] if groups == 1 else send
        return None, (stop, send, None if late is None else more[0])

    _, (stop, send, more) = jax.lax.scan(piece, None, jnp.arange(nz * per_layer))
    height, cosine_in, column = _ground(scene, foot, slopes, towards)
    ground = scene.ground_map[0].ravel()[column] * cosine_in
    shape = scene.ground_shape
    if shape is not None:
        ground = ground * jax.vmap(lambda v: shape.shape(-v[None], v[None])[0, 0, 0])(towards)
    return PencilPaths(
        stop * length,
        send * length,
        None if more is None else more * length,
        (platform - scene.height) / cosine,
        length,
        (platform - height) / cosine,
        ground.astype(dtype),
        None if late is None else late.ground.ravel()[column].astype(dtype),
    )


def _pencil_directions(direction: Array, pencils: Array) -> Float[Array, "pencil 3"]:
    """Unit vectors of the pencils about the beam's axis."""
    east = jnp.array([1.0, 0.0, 0.0], direction.dtype)
    # East and north as far as they are square to the axis.
    east = east - direction[0] * direction
    east = east / jnp.linalg.norm(east)
    north = jnp.cross(east, direction)
    vectors = direction + pencils[:, :1] * east + pencils[:, 1:] * north
    return vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True)


def _ground(
    scene: VoxelScene, foot: Array, slopes: Array, towards: Array
) -> tuple[Array, Array, Array]:
    """Height [m] at which pencils meet the ground, cosine of incidence, and voxel column."""
    _, ny, nx = scene.shape

    def column(height: Array) -> Array:
        at = jnp.floor((foot + height[:, None] * slopes) / scene.horizontal).astype(int)
        if scene.boundary == "periodic":
            return (at[:, 1] % ny) * nx + at[:, 0] % nx
        return jnp.clip(at[:, 1], 0, ny - 1) * nx + jnp.clip(at[:, 0], 0, nx - 1)

    if scene.terrain is None:
        height = jnp.zeros_like(foot[:, 0])
        return height, towards[:, 2], column(height)
    terrain = scene.terrain.astype(foot.dtype)

    def surface(height: Array) -> tuple[Array, Array]:
        return _bilinear(terrain, foot + height[:, None] * slopes, scene)

    # The first plane from the top that lies below the ground, then the crossing by halves.
    apart = scene.vertical / _PLANES
    planes = jnp.arange(scene.shape[0] * _PLANES + 1, dtype=foot.dtype) * apart
    under = jax.vmap(lambda z: z < surface(jnp.full_like(foot[:, 0], z))[0])(planes)
    low = jnp.max(jnp.where(under, planes[:, None], 0.0), axis=0)

    def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = 0.5 * (low + high)
        below = middle < surface(middle)[0]
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, low + apart))
    near = jax.lax.stop_gradient(0.5 * (low + high))
    # One step of Newton from there has the right value, and the right derivative.
    level, steep = surface(near)
    facing = 1.0 - jnp.sum(jax.lax.stop_gradient(steep) * slopes, axis=1)
    height = near + (level - near) / facing
    _, gradient = surface(height)
    normal = jnp.concatenate([-gradient, jnp.ones_like(gradient[:, :1])], axis=1)
    normal = normal / jnp.linalg.norm(normal, axis=1, keepdims=True)
    cosine = jnp.maximum(jnp.sum(normal * towards, axis=1), 0.0)
    return height, cosine, column(jax.lax.stop_gradient(height))


def _bilinear(terrain: Array, place: Array, scene: VoxelScene) -> tuple[Array, Array]:
    """Height of the ground and its slopes (x, y) at places [pencil, 2]; beyond the last columns
    of an open scene it goes on as it is there."""
    ny, nx = terrain.shape
    scaled = place / scene.horizontal - 0.5
    first = jax.lax.stop_gradient(jnp.floor(scaled)).astype(int)
    corners = []
    if scene.boundary == "periodic":
        corners = [(first[:, a] % n, (first[:, a] + 1) % n) for a, n in ((0, nx), (1, ny))]
    else:
        first = jnp.clip(first, 0, jnp.maximum(jnp.array([nx, ny]) - 2, 0))
        corners = [
            (first[:, a], jnp.minimum(first[:, a] + 1, n - 1)) for a, n in ((0, nx), (1, ny))
        ]
    (west, east), (south, north) = corners
    fx, fy = (scaled - first).T
    sw, se, nw, ne = (terrain[row, column] for row in (south, north) for column in (west, east))
    height = (1 - fy) * ((1 - fx) * sw + fx * se) + fy * ((1 - fx) * nw + fx * ne)
    slope_x = ((1 - fy) * (se - sw) + fy * (ne - nw)) / scene.horizontal
    slope_y = ((1 - fx) * (nw - sw) + fx * (ne - se)) / scene.horizontal
    return height, jnp.stack([slope_x, slope_y], axis=-1)
