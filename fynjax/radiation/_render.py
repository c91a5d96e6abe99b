"""The public entry point of the radiation layer."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.radiation._image import Radiance, see
from fynjax.radiation._multiple import DiffuseField, block_mean, solve_diffuse
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._rays import RayLattice, parallel_rays
from fynjax.radiation._scene import VoxelScene, check_scene
from fynjax.radiation._sun import SunField, trace_sun


class Accuracy(eqx.Module):
    """How finely the light is resolved. All fields are static; each may be refined alone."""

    lattice: int = eqx.field(static=True, default=2)
    """Sunbeams along the edge of a voxel."""
    sublayers: int = eqx.field(static=True, default=1)
    """Pieces a layer is cut in along beams and rays; raise it for slant sun or view."""
    coarsening: tuple[int, int] = eqx.field(static=True, default=(2, 2))
    """Voxels (in height, in width) in a cell of the diffuse field; must divide the grid."""
    levels: int = eqx.field(static=True, default=2)
    """Zenith angles of the diffuse field per hemisphere."""
    azimuths: int = eqx.field(static=True, default=6)
    """Azimuths of the diffuse field."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Residual of the diffuse solve, relative to its right-hand side."""
    iterations: int = eqx.field(static=True, default=100)
    """Most iterations of the diffuse solve."""
    margin: int | None = eqx.field(static=True, default=None)
    """Voxels by which the sunbeams' lattice exceeds an open scene. By default from the sun's
    zenith; must be given where the sun is a traced value."""

    @property
    def ordinates(self) -> Ordinates:
        return Ordinates.create(self.levels, self.azimuths)


class Light(eqx.Module):
    """The light in a scene: solve it once, look at it from anywhere."""

    scene: VoxelScene
    sun: SunField
    diffuse: DiffuseField
    accuracy: Accuracy


class Fluxes(eqx.Module):
    """Where the incident light goes, as shares of the irradiance above the canopy [-]."""

    albedo: Float[Array, " band"]
    absorbed: Float[Array, "band class"]
    """Absorbed by each optical class."""
    transmitted: Float[Array, " band"]
    """Downward flux at the ground, light between ground and canopy included."""
    transmitted_direct: Float[Array, " band"]
    """Of it, direct sun."""
    ground_absorbed: Float[Array, " band"]


def solve_light(scene: VoxelScene, accuracy: Accuracy | None = None) -> Light:
    """Solve for the light in `scene`.

    **Arguments:**

    - `scene`: the canopy, its optics, its ground and its illumination.
    - `accuracy`: how finely; the defaults suit 10 cm voxels and a view within 30 degrees of
      nadir.

    Raises `InputError` for shapes that do not go together and, outside `jit`, for values out of
    range. Differentiable, in forward and reverse mode, in every array of `scene`; the derivative
    of the diffuse field is one solve with the transposed operator.
    """
    accuracy = Accuracy() if accuracy is None else accuracy
    check_scene(scene)
    for size, block, axis in zip(
        scene.shape, (accuracy.coarsening[0], *[accuracy.coarsening[1]] * 2), "zyx"
    ):
        if size % block:
            raise InputError(
                f"`accuracy.coarsening` must divide the grid, but {block} does not divide the "
                f"{size} voxels along {axis}; pad the scene or choose another factor"
            )
    sun = trace_sun(scene, accuracy.lattice, accuracy.sublayers, _margin(scene, accuracy))
    diffuse = solve_diffuse(
        scene, sun, accuracy.coarsening, accuracy.ordinates, accuracy.tolerance, accuracy.iterations
    )
    return Light(scene, sun, diffuse, accuracy)


def _margin(scene: VoxelScene, accuracy: Accuracy) -> int:
    if scene.boundary == "periodic":
        return 0
    if accuracy.margin is not None:
        return accuracy.margin
    zenith = scene.illumination.sun_zenith
    if isinstance(zenith, jax.core.Tracer):
        raise InputError(
            "`accuracy.margin` must be given for an open scene whose sun is a traced value: the "
            "height of the grid times tan(largest sun zenith), in voxels"
        )
    return math.ceil(scene.height * math.tan(math.radians(float(zenith))) / scene.horizontal)


def render(light: Light, rays: RayLattice) -> Radiance:
    """Radiance along each ray of a sensor, per band. Differentiable.

    Multiple scattering is taken towards the middle of the field of view; direct sun, scattered
    once, towards each pixel.
    """
    accuracy = light.accuracy
    return see(
        light.scene,
        light.sun,
        light.diffuse,
        rays,
        accuracy.coarsening,
        accuracy.ordinates,
        accuracy.sublayers,
    )


def reflectance_factor(light: Light, rays: RayLattice) -> Float[Array, "band row column"]:
    """pi times radiance over the irradiance above the canopy [-], as a panel calibrates it."""
    incident = light.scene.illumination.sun + light.scene.illumination.sky
    return jnp.pi * render(light, rays).total / incident[:, None, None]


def directional_reflectance(
    light: Light, view_zenith: Float[Array, " view"], view_azimuth: Float[Array, " view"]
) -> Float[Array, "view band"]:
    """Mean reflectance factor of the whole scene for distant views [-].

    `view_zenith` in [0, 90), `view_azimuth` clockwise from north, in degrees. With no sky light
    this is the bidirectional reflectance factor (BRF).
    """
    scene, lattice = light.scene, light.accuracy.lattice
    width = scene.horizontal / lattice
    _, ny, nx = scene.shape
    dtype = scene.area_density.dtype
    x = ((jnp.arange(nx * lattice) + 0.5) * width).astype(dtype)
    y = ((jnp.arange(ny * lattice) + 0.5) * width).astype(dtype)

    def one(angles: tuple[Array, Array]) -> Array:
        rays = parallel_rays(x, y, width, *angles)
        return reflectance_factor(light, rays).mean(axis=(1, 2))

    zenith, azimuth = jnp.broadcast_arrays(
        jnp.atleast_1d(jnp.asarray(view_zenith, dtype)),
        jnp.atleast_1d(jnp.asarray(view_azimuth, dtype)),
    )
    return jax.lax.map(one, (zenith, azimuth))


def fluxes(light: Light) -> Fluxes:
    """Albedo, absorption and transmission. For periodic sides, they close to rounding."""
    scene, sun, diffuse, accuracy = light.scene, light.sun, light.diffuse, light.accuracy
    classes = scene.classes
    dtype = scene.area_density.dtype
    incident = scene.illumination.sun + scene.illumination.sky
    ordinates = accuracy.ordinates
    cosines = jnp.asarray(np.abs(ordinates.vectors[:, 2]), dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    density = block_mean(scene.area_density, accuracy.coarsening)
    column = scene.vertical * scene.shape[0]  # a mean per volume times this is one per ground area
    lost = 1.0 - classes.reflectance - classes.transmittance
    sun_projection = jnp.stack([a.projection(sun.cosine) for a in classes.angles]).astype(dtype)
    projection = jnp.stack([a.projection(cosines) for a in classes.angles]).astype(dtype)
    owner = jnp.asarray(classes.angle_of_class)
    hit_by_sun = jnp.mean(scene.area_density * sun.voxel_transmittance, axis=(1, 2, 3))
    direct = (hit_by_sun * sun_projection[owner])[None] * (scene.illumination.sun / sun.cosine)[
        :, None
    ]
    seen = jnp.einsum("cw,w,bwzyx,czyx->bc", projection[owner], weights, diffuse.intensity, density)
    scattered = seen / (density[0].size)
    absorbed = (direct + scattered) * lost.T * column
    margin = sun.margin
    beams = jnp.exp(-sun.depth[0])
    beams = beams[margin : beams.shape[0] - margin, margin : beams.shape[1] - margin]
    per_voxel = block_mean(beams[None], (1, sun.per_voxel))[0]
    direct_ground = scene.illumination.sun[:, None, None] * block_mean(
        per_voxel[None], (1, accuracy.coarsening[1])
    )
    down = direct_ground + diffuse.ground
    soil = block_mean(scene.ground_map[:, None], (1, accuracy.coarsening[1]))[:, 0]
    mean = lambda field: field.mean(axis=(1, 2)) / incident  # noqa: E731
    return Fluxes(
        albedo=diffuse.top / incident,
        absorbed=absorbed / incident[:, None],
        transmitted=mean(down),
        transmitted_direct=mean(direct_ground),
        ground_absorbed=mean(down * (1 - soil)),
    )
