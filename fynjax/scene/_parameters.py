"""Everything of a plot that may be calibrated, in one pytree."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax.leaf import LeafParameters

LEAF_FIELDS = {
    "structure": "-",
    "chlorophyll": "ug cm-2",
    "carotenoids": "ug cm-2",
    "anthocyanins": "ug cm-2",
    "brown_pigments": "-",
    "water": "cm",
    "dry_matter": "g cm-2",
}
"""Leaf parameters of PROSPECT-D and their units."""


class SpeciesParameters(eqx.Module):
    """Size and number of the plants of each species."""

    cover: Float[Array, " species"]
    """Share of the ground under the crowns, overlap counted twice [-]."""
    diameter: Float[Array, " species"]
    """Mean crown diameter [m]."""
    height: Float[Array, " species"]
    """Greatest height [m]."""
    packing: Float[Array, " species"]
    """Share of a crown over its neighbours, PE of eq. (8) [-], below 1."""
    fill: Float[Array, " species"]
    """Share of the crown circle that the plant fills, FF of eq. (9) [-], above 0."""
    leaf_area_index: Float[Array, " species"]
    """One-sided leaf area over the crown's ground area [m2 m-2]."""
    wood_area_index: Float[Array, " species"]
    """One-sided wood area over the crown's ground area [m2 m-2]."""
    shoot_clumping: Float[Array, " species"]
    """Probability that light which a leaf scatters meets another leaf of its shoot [-], 0 (leaves
    at random in their voxel) to below 1."""


class GroundParameters(eqx.Module):
    """What is not green."""

    brightness: Float[Array, ""]
    """Factor on the soil's reflectance [-]."""
    moisture: Float[Array, ""]
    """Share of the wet soil in the mixture of dry and wet [-]."""
    litter_fraction: Float[Array, ""]
    """Share of the ground under litter [-]."""
    char_fraction: Float[Array, ""]
    """Share of the ground under ash and charcoal [-]."""
    rock_fraction: Float[Array, ""]
    """Share of the ground that is rock [-]."""
    wood_brightness: Float[Array, ""]
    """Factor on the reflectance of bark and deadwood [-]."""


class LightParameters(eqx.Module):
    """Sun and sky."""

    sun_zenith: Float[Array, ""]
    """[degrees], 0 to below 90."""
    sun_azimuth: Float[Array, ""]
    """Clockwise from north [degrees]."""
    aerosol: Float[Array, ""]
    """Aerosol optical depth at 500 nm [-]."""


class PlotParameters(eqx.Module):
    """All parameters of a plot. `names` gives each number its name."""

    species: SpeciesParameters
    leaf: LeafParameters
    """Vectors over species; those of a species without leaves have no effect."""
    ground: GroundParameters
    light: LightParameters


def parameter_units() -> dict[str, str]:
    """Unit of each kind of parameter, by the last word of its name."""
    return {
        "cover": "-",
        "diameter": "m",
        "height": "m",
        "packing": "-",
        "fill": "-",
        "leaf_area_index": "m2 m-2",
        "wood_area_index": "m2 m-2",
        "shoot_clumping": "-",
        **LEAF_FIELDS,
        "brightness": "-",
        "moisture": "-",
        "litter_fraction": "-",
        "char_fraction": "-",
        "rock_fraction": "-",
        "wood_brightness": "-",
        "sun_zenith": "degree",
        "sun_azimuth": "degree",
        "aerosol": "-",
    }


def named_values(parameters: PlotParameters, taxa: tuple[str, ...]) -> dict[str, Array]:
    """Every parameter by name, such as `species.Restio eleocharis.cover`, as scalars.

    Leaf parameters are `species.<taxon>.leaf.<field>`; the rest `ground.<field>` and
    `light.<field>`. `with_values` is the inverse.
    """
    named: dict[str, Array] = {}
    for field in dataclasses.fields(SpeciesParameters):
        values = getattr(parameters.species, field.name)
        named |= {f"species.{taxon}.{field.name}": values[i] for i, taxon in enumerate(taxa)}
    for name in LEAF_FIELDS:
        values = getattr(parameters.leaf, name)
        named |= {f"species.{taxon}.leaf.{name}": values[i] for i, taxon in enumerate(taxa)}
    for group in ("ground", "light"):
        record = getattr(parameters, group)
        named |= {f"{group}.{f.name}": getattr(record, f.name) for f in dataclasses.fields(record)}
    return named


def with_values(
    parameters: PlotParameters, taxa: tuple[str, ...], values: dict[str, Array]
) -> PlotParameters:
    """`parameters` with the named `values` in place of its own. Differentiable in both."""
    named = named_values(parameters, taxa) | values

    def vector(prefix: str, field: str, like: Array) -> Array:
        return jnp.stack(
            [jnp.asarray(named[f"species.{taxon}.{prefix}{field}"], like.dtype) for taxon in taxa]
        )

    species = SpeciesParameters(
        **{
            f.name: vector("", f.name, getattr(parameters.species, f.name))
            for f in dataclasses.fields(SpeciesParameters)
        }
    )
    leaf = eqx.tree_at(
        lambda l: [getattr(l, name) for name in LEAF_FIELDS],
        parameters.leaf,
        [vector("leaf.", name, getattr(parameters.leaf, name)) for name in LEAF_FIELDS],
    )
    ground = GroundParameters(
        **{f.name: named[f"ground.{f.name}"] for f in dataclasses.fields(GroundParameters)}
    )
    light = LightParameters(
        **{f.name: named[f"light.{f.name}"] for f in dataclasses.fields(LightParameters)}
    )
    return PlotParameters(species, leaf, ground, light)
