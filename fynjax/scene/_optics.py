"""Optics of the classes of a plot: the leaves of each species, wood, flowers."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax.canopy import (
    FORMS,
    AbstractLeafAngle,
    Organ,
    PlantModel,
    TabulatedLeafAngle,
    leaf_angle,
)
from fynjax.leaf import LeafParameters, prospect
from fynjax.radiation import OpticalClasses
from fynjax.scene._parameters import LEAF_FIELDS, PARAMETERS, PlotParameters
from fynjax.scene._planting import leaf_classes
from fynjax.scene._species import Species
from fynjax.scene._spectra import background_spectrum

# Petals as leaves without chlorophyll: an assumption, for want of measured fynbos petals.
with jax.enable_x64(True):  # else programs differ by what the process has at the import
    _PETAL = LeafParameters.many(
        structure=2.0, chlorophyll=0.0, carotenoids=0.5, anthocyanins=1.0, water=0.008,
        dry_matter=0.003,
    )  # fmt: skip
    _PETAL = jax.tree.map(np.asarray, _PETAL)
_OTHER_DIAMETER = 0.005
"""Diameter of twigs and petals, for the hot spot: an assumption [m]."""


def optical_classes(
    species: Sequence[Species],
    parameters: PlotParameters,
    average: Float[Array, "band wavelength"],
    wavelength: Float[np.ndarray, " wavelength"],
    dead_tissue: Float[np.ndarray, " wavelength"],
    hot_spot: bool = False,
) -> OpticalClasses:
    """Reflectance, transmittance and inclination of each optical class of a plot.

    `average` makes bands of spectra on `wavelength`; `dead_tissue` is the reflectance of the dead
    part of live shoots, which is opaque; with `hot_spot` leaves have the diameters of their forms.
    Differentiable in `parameters`.
    """
    dtype, classes = average.dtype, leaf_classes(species)
    owner = np.repeat(np.array(list(classes), int), [len(own) for own in classes.values()])
    leaves, clumping, dead = _leaves(species, parameters, owner, dtype)
    petal = jax.tree.map(lambda x: jnp.asarray(x, dtype), _PETAL)
    leaves = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), leaves, petal)
    # PROSPECT for all leaves of all species at once, petals last.
    optics = jax.vmap(lambda leaf: prospect(leaf, wavelength))(leaves)
    clumping, dead = (jnp.pad(x, (0, 1))[:, None] for x in (clumping, dead))  # petals have neither
    bark, tissue = (
        jnp.clip(parameters.ground.wood_brightness * jnp.asarray(spectrum, dtype), 0.0, 1.0)
        for spectrum in (background_spectrum("bark", wavelength), dead_tissue)
    )
    # Light meets the live and the dead area of a shoot alike, before the shoot lets it go.
    shoots = _shoot_optics(
        (1.0 - dead) * optics.reflectance + dead * tissue,
        (1.0 - dead) * optics.transmittance,
        clumping,
    )
    reflectance, transmittance = (spectrum @ average.T for spectrum in shoots)
    bark = average @ bark
    # Class order: leaves of the species, wood, flowers.
    reflectance = jnp.concatenate([reflectance[:-1], bark[None], reflectance[-1:]])
    transmittance = jnp.concatenate(
        [transmittance[:-1], jnp.zeros_like(bark)[None], transmittance[-1:]]
    )
    sizes: dict[str, Any] = {}
    if hot_spot:
        leaf = [FORMS[species[i].form].leaf_diameter for i in owner.tolist()]
        every = [*leaf, _OTHER_DIAMETER, _OTHER_DIAMETER]
        diameter, of_class = np.unique(every, return_inverse=True)
        sizes = {
            "leaf_diameter": jnp.asarray(diameter, dtype), "size_of_class": tuple(of_class.tolist())
        }  # fmt: skip
    return OpticalClasses(reflectance, transmittance, *class_angles(species), **sizes)


def _leaves(
    species: Sequence[Species],
    parameters: PlotParameters,
    owner: Int[np.ndarray, " leaf"],
    dtype: Any,
) -> tuple[LeafParameters, Float[Array, " leaf"], Float[Array, " leaf"]]:
    """PROSPECT parameters of every leaf, of the species `owner`, and clumping and dead share of its
    shoots [-]. Each trait is that of its species, the mean, times 1 + leaf_spread (ratio - 1),
    within its bounds."""
    of = parameters.species
    spread = [] if of.leaf_spread is None else [of.leaf_spread]
    traits, form = jax.tree.flatten(parameters.leaf)
    # All of a species is read at once: each reading is a loop of its own in the derivative.
    columns = [jnp.asarray(x, dtype) for x in (of.shoot_clumping, of.dead_fraction, *traits)]
    clumping, dead, *traits = jnp.stack([*columns, *spread])[:, owner]
    if not spread:
        return jax.tree.unflatten(form, traits), clumping, dead
    *traits, spread = traits
    alike = jnp.ones((1, len(LEAF_FIELDS)))
    ratios = [
        alike if (own := species[i].leaf_ratios) is None else own for i in dict.fromkeys(owner)
    ]
    # The empty one is there for a plot without leaves.
    ratio = jnp.concatenate([*ratios, alike[:0]]).astype(dtype)
    leaves = jax.tree.unflatten(form, traits)
    varied = jnp.stack([getattr(leaves, name) for name in LEAF_FIELDS], axis=-1)
    varied = varied * (1.0 + spread[:, None] * (ratio - 1.0))
    lower, upper = (
        jnp.asarray([getattr(PARAMETERS[name], end) for name in LEAF_FIELDS], dtype)
        for end in ("lower", "upper")
    )
    # Not `clip`, which halves the slope of a trait at its bound, such as no brown pigments.
    varied = jnp.where(varied < lower, lower, varied)
    varied = jnp.where(varied > upper, upper, varied)
    where = lambda leaf: [getattr(leaf, name) for name in LEAF_FIELDS]  # noqa: E731
    return eqx.tree_at(where, leaves, list(varied.T)), clumping, dead


def class_angles(
    species: Sequence[Species],
) -> tuple[tuple[AbstractLeafAngle, ...], tuple[int, ...]]:
    """The distinct inclinations of a plot, and for each optical class the place of its own."""
    # Species without angles of their own share those of a name; wood and petals face all ways.
    angles: dict[int | str, AbstractLeafAngle] = {}
    keys: list[int | str] = []
    for i, classes in leaf_classes(species).items():
        given, named = species[i].leaf_angle, FORMS[species[i].form].leaf_angle
        key = named if given is None else i
        angles[key] = leaf_angle(named) if given is None else given
        keys += [key] * len(classes)
    angles["spherical"] = leaf_angle("spherical")
    places = {key: number for number, key in enumerate(angles)}
    return tuple(angles.values()), tuple(places[key] for key in (*keys, *["spherical"] * 2))


def seen_from_above(species: Sequence[Species]) -> Float[Array, " class"]:
    """Area seen from straight above over one-sided area, of each optical class [-]."""
    angles, of_class = class_angles(species)
    projected = jnp.stack([angle.projection(jnp.ones(())) for angle in angles])
    return projected[jnp.asarray(of_class)]


def inclination(plant: PlantModel) -> AbstractLeafAngle | None:
    """How the leaves of a plant model are inclined; None if it has none."""
    leaf = np.asarray(plant.organ) == Organ.LEAF
    if not leaf.any():
        return None
    return TabulatedLeafAngle.from_normals(plant.normal[leaf], plant.area_fraction[leaf])


def _shoot_optics(
    reflectance: Float[Array, "leaf wavelength"],
    transmittance: Float[Array, "leaf wavelength"],
    clumping: Float[Array, "leaf one"],
) -> tuple[Float[Array, "leaf wavelength"], Float[Array, "leaf wavelength"]]:
    """Reflectance and transmittance of shoots of such leaves, each as one scattering element.

    With p the `clumping`, the single scattering albedo w becomes w (1 - p) / (1 - p w) and the
    area that counts becomes 1 - p of the leaves' (Smolander and Stenberg 2003, 2005). What does
    not absorb still loses nothing.
    """
    escaping = (1.0 - clumping) / (1.0 - clumping * (reflectance + transmittance))
    return reflectance * escaping, transmittance * escaping
