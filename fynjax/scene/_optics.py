"""Optics of the classes of a plot: the leaves of each species, wood, flowers."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax.canopy import FORMS, AbstractLeafAngle, Organ, TiltedLeafAngle, leaf_angle
from fynjax.leaf import LeafParameters, prospect
from fynjax.radiation import OpticalClasses
from fynjax.scene._parameters import LEAF_FIELDS, PARAMETERS, PlotParameters
from fynjax.scene._planting import leaf_classes, material_classes
from fynjax.scene._species import PETAL, Material, Species
from fynjax.scene._spectra import Spectrum, background_spectrum

with jax.enable_x64(True):  # else programs differ by what the process has at the import
    _PETAL = jax.tree.map(np.asarray, LeafParameters.many(**PETAL))
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
    further = [] if parameters.materials is None else [parameters.materials.leaf]
    further = jax.tree.map(lambda x: jnp.asarray(x, dtype), further)
    leaves = jax.tree.map(lambda *parts: jnp.concatenate(parts), leaves, petal, *further)
    # PROSPECT for all leaves of all species at once, then petals and materials.
    optics = jax.vmap(lambda leaf: prospect(leaf, wavelength))(leaves)
    clumping, dead = (jnp.pad(x, (0, 1))[:, None] for x in (clumping, dead))  # petals have neither
    elements = optics.reflectance, optics.transmittance
    if materials := list(material_classes(species).values()):
        elements = _with_materials(elements, materials, len(owner) + 1, wavelength)
        of_shoots = _of_shoots(parameters, materials, dtype)
        clumping, dead = (jnp.concatenate(pair) for pair in zip((clumping, dead), of_shoots))
    bark, tissue = (
        jnp.clip(parameters.ground.wood_brightness * jnp.asarray(spectrum, dtype), 0.0, 1.0)
        for spectrum in (background_spectrum("bark", wavelength), dead_tissue)
    )
    # Light meets the live and the dead area of a shoot alike, before the shoot lets it go.
    shoots = _shoot_optics(
        (1.0 - dead) * elements[0] + dead * tissue, (1.0 - dead) * elements[1], clumping
    )
    reflectance, transmittance = (spectrum @ average.T for spectrum in shoots)
    bark, n = average @ bark, len(owner)
    # Class order: leaves of the species, wood, flowers, materials.
    reflectance = jnp.concatenate([reflectance[:n], bark[None], reflectance[n:]])
    transmittance = jnp.concatenate(
        [transmittance[:n], jnp.zeros_like(bark)[None], transmittance[n:]]
    )
    sizes: dict[str, Any] = {}
    if hot_spot:
        leaf = [FORMS[species[i].form].leaf_diameter for i in owner.tolist()]
        every = [*leaf, _OTHER_DIAMETER, _OTHER_DIAMETER]
        for _, i, material in materials:
            of_leaf = FORMS[species[i].form].leaf_diameter
            every.append(of_leaf if material.organ == Organ.LEAF else _OTHER_DIAMETER)
        diameter, of_class = np.unique(every, return_inverse=True)
        sizes = {
            "leaf_diameter": jnp.asarray(diameter, dtype), "size_of_class": tuple(of_class.tolist())
        }  # fmt: skip
    angles = class_angles(species, parameters.species.leaf_angle)
    return OpticalClasses(reflectance, transmittance, *angles, **sizes)


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


def _with_materials(
    optics: tuple[Float[Array, "leaf wavelength"], Float[Array, "leaf wavelength"]],
    materials: Sequence[tuple[int, int, Material]],
    first: int,
    wavelength: Float[np.ndarray, " wavelength"],
) -> tuple[Float[Array, "all wavelength"], Float[Array, "all wavelength"]]:
    """Reflectance and transmittance of the `first` leaves and petals, then of the materials, which
    are leaves behind these or have spectra as stated."""

    def of(material: Material, own: Array, stated: Spectrum | None) -> Array:
        if material.reflectance is None:
            return own[first + material.number]
        opaque = jnp.zeros(len(wavelength), own.dtype)
        return opaque if stated is None else jnp.asarray(stated.at(wavelength), own.dtype)

    reflected = [of(one, optics[0], one.reflectance) for _, _, one in materials]
    passed = [of(one, optics[1], one.transmittance) for _, _, one in materials]
    return (
        jnp.concatenate([optics[0][:first], jnp.stack(reflected)]),
        jnp.concatenate([optics[1][:first], jnp.stack(passed)]),
    )


def _of_shoots(
    parameters: PlotParameters, materials: Sequence[tuple[int, int, Material]], dtype: Any
) -> Float[Array, "two material one"]:
    """Clumping and dead share of the shoots that the materials belong to: of no leaves none."""
    owner = np.array([i for _, i, _ in materials])
    leaf = np.array([one.organ == Organ.LEAF for _, _, one in materials])
    of = parameters.species
    both = jnp.stack([jnp.asarray(x, dtype) for x in (of.shoot_clumping, of.dead_fraction)])
    return jnp.where(leaf, both[:, owner], 0.0)[..., None]


def mean_trait(
    species: Sequence[Species], parameters: PlotParameters, trait: str
) -> Float[Array | np.ndarray, " species"]:
    """Mean of a trait over the leaf area of each species, of its leaf and its leaf materials.

    What is stated as a spectrum has no traits and does not count. Differentiable in `parameters`.

    **Arguments:** `species`, of the plot; `parameters`; `trait`, one of `LEAF_FIELDS`.
    """
    own, others = getattr(parameters.leaf, trait), parameters.materials
    if others is None:
        return own
    further, means = getattr(others.leaf, trait), []
    for i, one in enumerate(species):
        leaf = [m for m in one.materials if m.organ == Organ.LEAF and m.reflectance is None]
        shares = [one.share_without_material(Organ.LEAF), *(m.share for m in leaf)]
        total = sum(shares) or 1.0
        parts = [own[i], *(further[m.number] for m in leaf)]
        means.append(sum(part * (share / total) for part, share in zip(parts, shares, strict=True)))
    return jnp.stack([jnp.asarray(mean) for mean in means])


def class_angles(
    species: Sequence[Species], mean: Float[Array, " species"] | None = None
) -> tuple[tuple[AbstractLeafAngle, ...], tuple[int, ...]]:
    """The distinct inclinations of a plot, and for each optical class the place of its own; leaves
    of each species have the `mean` inclination [degrees], where it is given."""
    # Species without angles of their own share those of a name; wood and petals face all ways.
    angles: dict[int | str, AbstractLeafAngle] = {}
    of_species: dict[int, int | str] = {}
    keys: list[int | str] = []
    for i, classes in leaf_classes(species).items():
        given, named = species[i].leaf_angle, FORMS[species[i].form].leaf_angle
        of_species[i] = key = named if given is None and mean is None else i
        angles[key] = leaf_angle(named) if given is None else given
        keys += [key] * len(classes)
    if mean is not None and angles:
        of = [int(key) for key in angles]
        tilted = TiltedLeafAngle.to_means([*angles.values()], jnp.asarray(mean)[jnp.array(of)])
        angles = dict(zip(angles, tilted, strict=True))
    angles["spherical"] = leaf_angle("spherical")
    keys += ["spherical"] * 2
    for _, i, material in material_classes(species).values():
        keys.append(of_species[i] if material.organ == Organ.LEAF else "spherical")
    places = {key: number for number, key in enumerate(angles)}
    return tuple(angles.values()), tuple(places[key] for key in keys)


def seen_from_above(
    species: Sequence[Species], mean: Float[Array, " species"] | None = None
) -> Float[Array, " class"]:
    """Area seen from straight above over one-sided area, of each optical class [-]; `mean` as of
    `class_angles`."""
    angles, of_class = class_angles(species, mean)
    projected = jnp.stack([angle.projection(jnp.ones(())) for angle in angles])
    return projected[jnp.asarray(of_class)]


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
