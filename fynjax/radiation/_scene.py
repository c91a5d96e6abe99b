"""What radiative transfer takes of a scene: arrays on a voxel grid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.canopy import AbstractLeafAngle
from fynjax.radiation._ground import RahmanPintyVerstraete

_LITTLE = 1e-6
"""Area per volume below which leaves count as spread evenly in a voxel [m2 m-3]: where there are
none, the derivative is that of the first."""


class OpticalClasses(eqx.Module):
    """Optical properties of what fills the voxels: one class for each kind of surface."""

    reflectance: Float[Array, "class band"]
    """Hemispherical reflectance of one side, rho [-]."""
    transmittance: Float[Array, "class band"]
    """Hemispherical transmittance, tau [-]; 0 for wood and other opaque organs."""
    angles: tuple[AbstractLeafAngle, ...]
    """The distinct distributions of normals."""
    angle_of_class: tuple[int, ...] = eqx.field(static=True)
    """Place in `angles` of the distribution of each class."""
    leaf_diameter: Float[Array, " size"] | None = None
    """Diameters of leaves, taken for round [m]; of others four times area over perimeter. They make
    the hot spot. None: points, which have none."""
    size_of_class: tuple[int, ...] | None = eqx.field(static=True, default=None)
    """Place in `leaf_diameter` of the diameter of each class; by default all the first."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """For each class, the place of its diameter."""
        return self.size_of_class or (0,) * len(self.angle_of_class)

    def total_by_angle(
        self, per_class: Float[Array, "class *grid"]
    ) -> Float[Array, " angle *grid"]:
        """Sum a quantity over the classes that share a distribution of normals."""
        members = np.zeros((len(self.angles), len(self.angle_of_class)))
        members[list(self.angle_of_class), range(len(self.angle_of_class))] = 1.0
        return jnp.tensordot(jnp.asarray(members, per_class.dtype), per_class, axes=1)


class Illumination(eqx.Module):
    """Sun and sky above the canopy."""

    sun_zenith: Float[Array, ""]
    """Zenith angle of the sun [degrees], 0 up to less than 90."""
    sun_azimuth: Float[Array, ""]
    """Azimuth of the sun, clockwise from north [degrees]."""
    sun: Float[Array, " band"]
    """Direct irradiance on the horizontal plane [any unit, per band]."""
    sky: Float[Array, " band"]
    """Diffuse irradiance on the horizontal plane [same unit]."""
    sky_pattern: Float[Array, "*band zenith azimuth"] | None = None
    """Relative radiance of the sky [any unit] at even steps of zenith from 0 to 90 degrees (both
    included) and of azimuth from 0 to 360 (not included), for all bands or each; scaled so that
    the irradiance is `sky`. None: the same from everywhere."""

    @property
    def incident(self) -> Float[Array, " band"]:
        """Irradiance above the canopy, which shares are counted of; 1 in a band without light,
        where all shares are 0."""
        total = self.sun + self.sky
        return jnp.where(total > 0, total, 1.0)


class VoxelScene(eqx.Module):
    """A canopy as a turbid medium on a voxel grid, over its ground."""

    area_density: Float[Array, "class z y x"]
    """One-sided area per volume [m2 m-3], layers from the ground up."""
    classes: OpticalClasses
    ground: Float[Array, " band *yx"]
    """Reflectance of the ground [-], one value a band or one a band and voxel column."""
    illumination: Illumination
    horizontal: float = eqx.field(static=True, converter=float)
    """Edge of a voxel in x and y [m]."""
    vertical: float = eqx.field(static=True, converter=float)
    """Height of a voxel [m]."""
    boundary: str = eqx.field(static=True, default="periodic")
    """"periodic": the scene repeats itself without end; "open": nothing stands outside it."""
    ground_shape: RahmanPintyVerstraete | None = None
    """Angular shape of the ground's reflectance, with `ground` its amplitude. None: Lambertian."""
    terrain: Float[Array, "y x"] | None = None
    """Height of the ground above the bottom of the grid at the centre of each voxel column [m],
    linear between centres. None: flat, at the bottom. Plants stand on it, inside the grid."""
    structure: Float[Array, "Z Y X"] | None = None
    """Area per volume of all classes together on finer voxels, a whole number of them along each
    edge of the grid's [m2 m-3]: how the leaves lie within a voxel. Sun and sight follow it; its
    mean over a voxel is the sum of `area_density`. None: leaves fill a voxel evenly."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along z, y, x."""
        z, y, x = self.area_density.shape[1:]
        return z, y, x

    @property
    def structure_factor(self) -> tuple[int, int]:
        """Finest voxels along an edge of the grid's, in height and in width."""
        if self.structure is None:
            return 1, 1
        return self.structure.shape[0] // self.shape[0], self.structure.shape[2] // self.shape[2]

    @staticmethod
    def relative_density(structure: Array, total: Array) -> Array:
        """Area per volume of the finest voxels over that of the grid's, of all classes together
        [-]; 1 where both are empty, so that the derivative there is that of the first leaf.

        **Arguments:** `structure`, `total`: both, sampled at the same places [m2 m-3].
        """
        return (structure + _LITTLE) / (total + _LITTLE)

    @property
    def height(self) -> float:
        """Top of the grid above the ground [m]."""
        return self.shape[0] * self.vertical

    @property
    def ground_map(self) -> Float[Array, "band y x"]:
        """Ground reflectance per voxel column."""
        ground = self.ground if self.ground.ndim == 3 else self.ground[:, None, None]
        return jnp.broadcast_to(ground, (ground.shape[0], *self.shape[1:]))

    def bands(self, start: Array | int, size: int) -> "VoxelScene":
        """The same scene in `size` bands from `start` on, which may be a traced value."""

        def cut(field: Array, axis: int = 0) -> Array:
            return jax.lax.dynamic_slice_in_dim(field, start, size, axis)

        classes, light = self.classes, self.illumination
        pattern = light.sky_pattern
        if pattern is not None and pattern.ndim == 3:
            pattern = cut(pattern)
        optics = (cut(classes.reflectance, 1), cut(classes.transmittance, 1))
        return eqx.tree_at(
            lambda s: (
                s.classes.reflectance,
                s.classes.transmittance,
                s.ground,
                s.illumination.sun,
                s.illumination.sky,
                s.illumination.sky_pattern,
                s.ground_shape,
            ),
            self,
            (
                *optics,
                cut(self.ground),
                cut(light.sun),
                cut(light.sky),
                pattern,
                jax.tree.map(cut, self.ground_shape),
            ),
            is_leaf=lambda leaf: leaf is None,
        )
