"""Where the light goes: albedo, absorption by class and by voxel, transmission, what is sent on."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.canopy import projections
from fynjax.radiation._blocks import block_mean, spread
from fynjax.radiation._image import ground_towards, scattered_towards
from fynjax.radiation._multiple import DiffuseField, ground_shape
from fynjax.radiation._render import Light
from fynjax.radiation._scene import VoxelScene
from fynjax.radiation._terrain import terrain_normal


class Fluxes(eqx.Module):
    """Where the incident light goes, as shares of the irradiance above the canopy [-]."""

    albedo: Float[Array, " band"]
    """Upward through the top of the grid."""
    absorbed: Float[Array, "band class"]
    """Absorbed by each optical class."""
    transmitted: Float[Array, " band"]
    """Downward flux at the ground, light between ground and canopy included."""
    transmitted_direct: Float[Array, " band"]
    """Direct sun at the ground."""
    ground_absorbed: Float[Array, " band"]
    """Absorbed by the ground."""


def fluxes(light: Light) -> Fluxes:
    """Albedo, absorption and transmission of a scene.

    **Arguments:**

    - `light`: from `solve_light`.

    **Returns:** `Fluxes`, as shares of the irradiance above the canopy [-]. With periodic sides and
    level ground albedo, absorption by canopy and by ground sum to one, to the tolerance of the
    solve. On terrain, upward light that meets a slope counts as lost.

    Differentiable in every array of the scene.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import fluxes, solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> share = fluxes(solve_light(scene))
    >>> share.albedo.round(2)
    Array([0.06, 0.35], dtype=float32)
    >>> (share.albedo + share.absorbed.sum(axis=1) + share.ground_absorbed).round(3)
    Array([1., 1.], dtype=float32)
    """
    return _by_band(light, lambda scene, field: _fluxes(light, scene, field))


def absorption(light: Light) -> Float[Array, "band z y x"]:
    """Light absorbed per volume in each voxel [irradiance unit m-1].

    **Arguments:**

    - `light`: from `solve_light`.

    **Returns:** one grid a band. Times the voxel's height and averaged over the columns it sums to
    the absorbed share of `fluxes` times the irradiance.

    Differentiable in every array of the scene.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import absorption, solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> absorbed = absorption(solve_light(scene))
    >>> absorbed.mean(axis=(2, 3)).round(2)  # [band, layer]: more in red, and in the upper layer
    Array([[0.87, 1.04],
           [0.18, 0.2 ]], dtype=float32)
    """

    def absorbed_per_volume(scene: VoxelScene, field: DiffuseField) -> Array:
        direct, diffuse = _irradiance_on_leaves(light, scene, field)
        classes = scene.classes
        lost = (1.0 - classes.reflectance - classes.transmittance).T  # [band, class]
        area = jax.lax.map(
            lambda share: classes.total_by_angle(share[:, None, None, None] * scene.area_density),
            lost,
        )
        beam = direct[:, :, None, None, None] * light.sun.voxel_transmittance
        return jnp.sum(area * (beam + spread(diffuse, field.factor(scene))), axis=1)

    return _by_band(light, absorbed_per_volume)


def diffuse_sources(
    light: Light, towards: Float[Array, " 3"]
) -> tuple[Float[Array, "band z y x"], Float[Array, "band y x"]]:
    """What leaves and ground send towards a direction out of the diffuse light: all but the light
    of the sun that they scatter first.

    **Arguments:**

    - `light`: from `solve_light`.
    - `towards`: unit vector (east, north, up), up.

    **Returns:** radiance that leaves send per length of the way through each voxel [irradiance
    unit sr-1 m-1], and radiance of the ground below each column [irradiance unit sr-1], both
    without what lies between them and the sensor.

    Differentiable in every array of the scene.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import diffuse_sources, solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> leaves, ground = diffuse_sources(solve_light(scene), jnp.array([0.0, 0.0, 1.0]))
    >>> leaves.shape, ground.shape
    ((2, 2, 4, 4), (2, 4, 4))
    """

    def sources(scene: VoxelScene, field: DiffuseField) -> tuple[Array, Array]:
        ordinates = light.accuracy.ordinates
        composition = jnp.moveaxis(scene.area_density, 1, 0)
        slabs = field.factor(scene)[0]
        leaves = scattered_towards(scene, field, towards, ordinates, composition, slabs)
        ground = ground_towards(scene, field, towards, ordinates)
        return jnp.moveaxis(leaves.sum(axis=1), 0, 1), ground

    return _by_band(light, sources)


def _irradiance_on_leaves(
    light: Light, scene: VoxelScene, field: DiffuseField
) -> tuple[Float[Array, "band angle"], Float[Array, "band angle Z Y X"]]:
    """Irradiance on leaves, both sides counted, of each distribution of normals, per leaf area:
    of the sun where nothing shades it, and of the diffuse light in the cells of its grid."""
    dtype = scene.area_density.dtype
    ordinates, angles = light.accuracy.ordinates, scene.classes.angles
    cosines = jnp.asarray(np.abs(ordinates.vectors[:, 2]), dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    # Irradiance across the beam, times the projected over the whole leaf area.
    beam = scene.illumination.sun / light.sun.cosine
    to_sun = projections(angles, light.sun.cosine).astype(dtype)
    projection = projections(angles, cosines).astype(dtype)
    return beam[:, None] * to_sun, jnp.einsum(
        "ao,bozyx->bazyx", projection * weights, field.intensity
    )


def _fluxes(light: Light, scene: VoxelScene, field: DiffuseField) -> Fluxes:
    classes, sun, factor = scene.classes, light.sun, field.factor(scene)
    incident = scene.illumination.incident
    column = scene.vertical * scene.shape[0]  # a mean per volume times this is one per ground area
    lost = (1.0 - classes.reflectance - classes.transmittance).T
    direct, diffuse = _irradiance_on_leaves(light, scene, field)
    owner = np.asarray(classes.angle_of_class)
    density = block_mean(scene.area_density, factor)
    lit = jnp.mean(scene.area_density * sun.voxel_transmittance, axis=(1, 2, 3))
    diffuse_on_leaves = jnp.einsum("bczyx,czyx->bc", diffuse[:, owner], density) / density[0].size
    absorbed = (direct[:, owner] * lit + diffuse_on_leaves) * lost * column
    # On a slope, the ground's own surface is larger than the level area it stands on.
    larger = jnp.ones_like(sun.on_ground)
    if scene.terrain is not None:
        larger = larger / terrain_normal(scene)[2]
    reached, larger = block_mean(jnp.stack([sun.on_ground * larger, larger]), (1, factor[1]))
    beams = scene.illumination.sun[:, None, None] * reached
    down = beams + field.ground * larger
    soil = block_mean(scene.ground_map[:, None], (1, factor[1]))[:, 0]
    mean = lambda kept: kept.mean(axis=(1, 2)) / incident  # noqa: E731
    # What the ground keeps is what it does not send up; of a shape of its own, that is not known
    # from its amplitude alone.
    kept = down * (1 - soil)
    if scene.ground_shape is not None:
        kept = down - _sent_by_ground(light, scene, field, soil, beams)
    return Fluxes(
        albedo=field.top / incident,
        absorbed=absorbed / incident[:, None],
        transmitted=mean(down),
        transmitted_direct=mean(beams),
        ground_absorbed=mean(kept),
    )


def _sent_by_ground(
    light: Light,
    scene: VoxelScene,
    field: DiffuseField,
    soil: Float[Array, "band Y X"],
    beams: Float[Array, "band Y X"],
) -> Float[Array, "band Y X"]:
    """Upward flux of an anisotropic ground."""
    ordinates, sun = light.accuracy.ordinates, light.sun
    dtype = soil.dtype
    flux = jnp.asarray(ordinates.fluxes.ravel(), dtype)
    sunward = -jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
    shape = ground_shape(scene, ordinates, sunward)
    assert shape is not None
    of_diffuse = jnp.einsum("i,bio,o,biyx->byx", flux, shape.diffuse, flux, field.falling)
    of_sun = (shape.sun @ flux)[:, None, None] * beams
    return soil * (of_diffuse + of_sun) / jnp.pi


def _by_band(light: Light, function: Callable[[VoxelScene, DiffuseField], Any]) -> Any:
    """Apply to all bands at once, or, where they are reduced to few solves, one after another."""
    diffuse = light.diffuse
    if isinstance(diffuse, DiffuseField):
        return function(light.scene, diffuse)
    band_by_band = jax.lax.map(
        lambda band: function(light.scene.bands(band, 1), diffuse.bands(band, 1)),
        jnp.arange(light.scene.illumination.sun.shape[0]),
    )
    return jax.tree.map(lambda leaf: leaf[:, 0], band_by_band)
