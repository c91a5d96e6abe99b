"""Everything of a plot that may be calibrated, in one pytree."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.html import as_html
from fynjax._core.parameters import CENTIMETRES, PERCENT, Parameter, parameter_field, parameters_of
from fynjax.leaf import LEAF_PARAMETERS, LeafParameters

if TYPE_CHECKING:
    import pandas as pd

LEAF_FIELDS = (
    "structure",
    "chlorophyll",
    "carotenoids",
    "anthocyanins",
    "brown_pigments",
    "water",
    "dry_matter",
)
"""Leaf parameters of a plot: those of PROSPECT-D, in the order of a leaf table's columns."""


OF_A_PLOT = 0.5
"""Share of the prior variance of a trait that the species of one plot have in common [-]: site, age
and season move all of them. The shipped prior is learned from plots whose species move together; in
how far they also differ spectra of whole plots do not say, so half is assumed."""


def _share(**record: Any) -> Any:
    bounds: dict[str, Any] = {"lower": 0.0, "upper": 1.0, "usual": (0.0, 1.0)}
    return parameter_field(
        unit="-", relative_sd=0.3, distribution="logit-normal", **bounds, **record
    )


class SpeciesParameters(eqx.Module):
    """Size and number of the plants of each species: vectors over species.

    What each means, its unit, bounds and prior: `PARAMETERS`.
    """

    cover: Float[Array, " species"] = parameter_field(
        symbol="c",
        name="Cover",
        unit="-",
        shown=PERCENT,
        lower=0.0,
        upper=1.0,
        usual=(0.0, 0.6),
        relative_sd=0.25,
        distribution="logit-normal",
        source="Article on the scene, species table and equation (10), or Boolean model "
        "(Matheron 1975); bounds by definition. Prior assumed.",
        description="Share of the ground under the crowns of a species, overlap with other species "
        "counted twice. How overlap among its own crowns counts is the plot's cover_definition. "
        "Field crews judge it by eye, to about a quarter.",
    )
    diameter: Float[Array, " species"] = parameter_field(
        symbol="D",
        name="Mean crown diameter",
        unit="m",
        shown=CENTIMETRES,
        lower=0.01,
        upper=10.0,
        usual=(0.1, 2.0),
        relative_sd=0.25,
        source="Article on the scene, species table and equation (7). Bounds and prior assumed.",
        description="Mean of a crown's two horizontal extents, equation (7). A smaller plant "
        "is less than a tenth of a voxel, a larger one is a tree.",
    )
    height: Float[Array, " species"] = parameter_field(
        symbol="H",
        name="Greatest height in the plot",
        unit="m",
        lower=0.01,
        upper=20.0,
        usual=(0.1, 4.0),
        relative_sd=0.15,
        source="Article on the scene, species table. Bounds and prior assumed.",
        description="Of the tallest plant of the species. A smaller plant is less than a tenth of "
        "a voxel, a larger one is a tree.",
    )
    packing: Float[Array, " species"] = parameter_field(
        required=True,
        symbol="PE",
        name="Packing",
        unit="-",
        shown=PERCENT,
        lower=0.0,
        upper=0.99,
        usual=(0.0, 0.7),
        default=0.0,
        relative_sd=0.3,
        distribution="logit-normal",
        source="Article on the scene, species table and equation (8). Bounds and prior assumed.",
        description="Share of a crown that lies over its neighbours, PE of equation (8). The "
        "number of plants is as 1 / (1 - PE): a hundredfold at the upper bound.",
    )
    fill: Float[Array, " species"] = parameter_field(
        required=True,
        symbol="FF",
        name="Fill",
        unit="-",
        shown=PERCENT,
        lower=0.01,
        upper=1.0,
        usual=(0.5, 1.0),
        default=1.0,
        relative_sd=0.3,
        distribution="logit-normal",
        source="Article on the scene, species table and equation (9). Bounds and prior assumed.",
        description="Share of the crown circle that the plant fills, FF of equation (9). The "
        "number of plants is as 1 / FF: a hundredfold at the lower bound.",
    )
    leaf_area_index: Float[Array, " species"] = parameter_field(
        symbol="LAI",
        name="Leaf area index of the crowns",
        unit="m2 m-2",
        lower=0.0,
        upper=20.0,
        usual=(0.5, 6.0),
        relative_sd=0.3,
        shared=OF_A_PLOT,
        source="Values of growth forms learned from 18 BioSCape plots. Bounds and prior assumed.",
        description="One-sided leaf area, dead tissue of the shoots included, over the ground area "
        "of the crowns as seen from above: where crowns overlap it counts once. Crowns are taken "
        "to stand at random, so that the share (1 - product of (1 - a)) / sum of a of them is seen "
        "from above, with a the area of each crown over that of the plot. Leaves at random "
        "would let a share exp(-20/2) = 5e-5 of the light through at the upper bound.",
    )
    wood_area_index: Float[Array, " species"] = parameter_field(
        symbol="WAI",
        name="Wood area index of the crowns",
        unit="m2 m-2",
        lower=0.0,
        upper=20.0,
        usual=(0.0, 1.5),
        relative_sd=0.3,
        shared=OF_A_PLOT,
        source="Assumed: values of growth forms, bounds and prior.",
        description="One-sided area of wood, half of its surface, over the ground area of the "
        "crowns as seen from above; counted and bounded as the leaf area index. Wood is stems and "
        "branches below the leafy shoots, and the dead stubs at the base of a tussock; what is "
        "dead or woody on the shoots themselves is dead tissue.",
    )
    shoot_clumping: Float[Array, " species"] = parameter_field(
        symbol="p",
        name="Shoot clumping",
        unit="-",
        lower=0.0,
        upper=0.8,
        usual=(0.0, 0.6),
        relative_sd=0.3,
        distribution="logit-normal",
        shared=OF_A_PLOT,
        source="Smolander and Stenberg 2003, 2005; values of growth forms learned from "
        "18 BioSCape plots. Bounds and prior assumed.",
        description="Probability that light which a leaf scatters meets another leaf of its "
        "shoot: 0 for leaves at random in their voxel, 0.44 in a pine shoot (Smolander and "
        "Stenberg 2005). At 0.8 light meets a shoot's leaves five times on average.",
    )
    dead_fraction: Float[Array, " species"] = parameter_field(
        symbol="f_d",
        name="Dead tissue in live shoots",
        unit="-",
        lower=0.0,
        upper=1.0,
        usual=(0.0, 0.8),
        sd=0.25,
        distribution="logit-normal",
        shared=OF_A_PLOT,
        source="Values of growth forms learned from 18 BioSCape plots, prior chosen "
        "after fits to them; bounds by definition.",
        description="Share of the one-sided area of live shoots that is dead or woody: old leaves "
        "and bracts, dead culms and the sheaths on live ones, the twig that bears the leaves. "
        "Stems and branches below the shoots are wood. It reflects as bark, or as the spectrum "
        "that a plot file gives, times the wood brightness, lets no light through, and shares the "
        "shoot's clumping. The prior's standard deviation is absolute: fits to 18 plots ask for "
        "anything from 0 to 0.9 (sd 0.29).",
    )
    leaf_spread: Float[Array, " species"] | None = parameter_field(
        optional=True,
        symbol="s_l",
        name="Spread of leaves within a species",
        unit="-",
        lower=0.0,
        upper=5.0,
        usual=(0.0, 2.0),
        default=1.0,
        relative_sd=0.5,
        source="Ours. Bounds and prior assumed: beyond 2 some leaves lose all of a trait, and the "
        "mean leaf changes.",
        description="Factor on what the leaves of a species differ from their mean by: 0 gives all "
        "plants the mean leaf, 1 the leaves as stated or drawn. Of a plot in which a species has "
        "several leaves, of which each plant has one.",
    )
    leaf_angle: Float[Array, " species"] | None = parameter_field(
        optional=True,
        symbol="theta_l",
        name="Mean leaf angle",
        unit="degree",
        lower=5.0,
        upper=85.0,
        usual=(20.0, 75.0),
        sd=12.0,
        distribution="logit-normal",
        source="Tilt of least relative entropy (Kullback 1959). Prior that of a uniform canopy, "
        "`fit_canopy`. Bounds assumed: beyond, nearly all leaves lie flat or stand upright.",
        description="Angle of a leaf from the horizontal, on the mean over the leaf area: 57.3 "
        "where leaves face all ways alike. The distribution of the growth form, or of the species' "
        "mesh, times a factor that grows or falls exponentially with the angle has this mean. Of a "
        "plot in which some species states it; its other species have the mean of their form.",
    )


class GroundParameters(eqx.Module):
    """What is not green.

    What each means, its unit, bounds and prior: `PARAMETERS`.
    """

    brightness: Float[Array, ""] = parameter_field(
        symbol="b",
        name="Soil brightness",
        unit="-",
        lower=0.1,
        upper=2.5,
        usual=(0.4, 1.5),
        default=1.0,
        relative_sd=0.3,
        source="Assumed: bounds after char and quartz sand, default, and prior.",
        description="Factor on the soil's reflectance: a tenth of the shipped dry soil is as "
        "dark as char, 2.5 times as bright as white quartz sand.",
    )
    moisture: Float[Array, ""] = _share(
        symbol="m",
        name="Soil moisture",
        default=0.0,
        source="Bounds by definition. Default and prior assumed.",
        description="Share of the wet in the mixed dry and wet soil.",
    )
    litter_fraction: Float[Array, ""] = _share(
        symbol="f_l",
        name="Litter",
        default=0.2,
        source="Bounds by definition. Default and prior assumed.",
        description="Share of the ground under litter.",
    )
    char_fraction: Float[Array, ""] = _share(
        symbol="f_c",
        name="Char",
        default=0.0,
        source="Bounds by definition. Default and prior assumed.",
        description="Share of the ground under ash and charcoal.",
    )
    rock_fraction: Float[Array, ""] = _share(
        symbol="f_r",
        name="Rock",
        default=0.0,
        source="Bounds by definition. Default and prior assumed.",
        description="Share of the ground that is rock.",
    )
    wood_brightness: Float[Array, ""] = parameter_field(
        symbol="b_w",
        name="Wood brightness",
        unit="-",
        lower=0.1,
        upper=2.5,
        usual=(0.5, 2.0),
        default=1.29,
        relative_sd=0.3,
        source="Default learned from 18 BioSCape plots. Bounds and prior assumed.",
        description="Factor on the reflectance of bark, deadwood and the dead tissue of shoots: "
        "from charred to bleached. The default is that of the shipped prior, on the shipped bark; "
        "where a spectrum of dead tissue is given, it is 1.",
    )


class LightParameters(eqx.Module):
    """Sun and sky.

    What each means, its unit, bounds and prior: `PARAMETERS`.
    """

    sun_zenith: Float[Array, ""] = parameter_field(
        symbol="theta_s",
        name="Sun zenith angle",
        unit="degree",
        lower=0.0,
        upper=89.0,
        usual=(5.0, 75.0),
        default=30.0,
        relative_sd=0.3,
        distribution="normal",
        source="Bounds by definition. Default and prior assumed.",
        description="Angle from straight up to the sun, which is above the horizon.",
    )
    sun_azimuth: Float[Array, ""] = parameter_field(
        symbol="phi_s",
        name="Sun azimuth",
        unit="degree",
        lower=0.0,
        upper=360.0,
        usual=(0.0, 360.0),
        default=0.0,
        source="Bounds by definition. Default assumed.",
        description="Direction to the sun, clockwise from north (90 is east). It repeats itself, "
        "so that it has no prior.",
    )
    aerosol: Float[Array, ""] = parameter_field(
        symbol="tau_a",
        name="Aerosol optical depth",
        unit="-",
        lower=0.0,
        upper=2.0,
        usual=(0.02, 0.5),
        default=0.1,
        relative_sd=0.3,
        source="Of the clear-sky model, Bird and Riordan 1986. Bounds, default and prior assumed.",
        description="At 500 nm, of the clear-sky model. Above 2 smoke or dust hides the sun.",
    )


class MaterialParameters(eqx.Module):
    """Traits of the materials of plants that are as leaves: vectors over these."""

    names: tuple[str, ...] = eqx.field(static=True)
    """First words of the names of their parameters: `species.<taxon>.<material>`, or
    `material.<material>` where several species share one."""
    leaf: LeafParameters
    """PROSPECT parameters of each."""


class PlotParameters(eqx.Module):
    """All parameters of a plot. `names` gives each number its name."""

    species: SpeciesParameters
    leaf: LeafParameters
    """Vectors over species; those of a species without leaves have no effect."""
    ground: GroundParameters
    light: LightParameters
    materials: MaterialParameters | None = None
    """Traits of further materials of the plants; None where there are none."""

    def __str__(self) -> str:
        """A line for each species with its main values, for the ground and for the light, in the
        units that `fynjax.scene.with_values` takes."""
        cover = self.species.cover
        lines = [f"Parameters of {jnp.shape(cover)[-1]} species:"]
        if isinstance(cover, jax.core.Tracer) or jnp.ndim(cover) != 1:
            return lines[0].replace(":", f", shape {jnp.shape(cover)}")
        main = {name: getattr(self.species, name) for name in _MAIN}
        main["leaf.chlorophyll"] = self.leaf.chlorophyll
        for i in range(cover.size):
            lines.append(f"  {i + 1}: {_values({k: v[i] for k, v in main.items()})}")
        for group in (self.ground, self.light):
            name = type(group).__name__.removesuffix("Parameters").lower()
            values = {f.name: getattr(group, f.name) for f in dataclasses.fields(group)}
            lines.append(f"  {name}: {_values(values)}")
        return "\n".join(lines)

    _repr_html_ = as_html


_MAIN = ("cover", "diameter", "height", "leaf_area_index", "dead_fraction")
"""Parameters of a species that are printed."""


def _values(values: dict[str, Array]) -> str:
    """Values with their names and units."""
    units = {name: PARAMETERS[parameter_kind(name)].unit for name in values}
    return ", ".join(
        f"{name} {float(v):.4g}{'' if units[name] == '-' else f' {units[name]}'}"
        for name, v in values.items()
    )


PARAMETERS: dict[str, Parameter] = {
    **parameters_of(SpeciesParameters),
    **{name: dataclasses.replace(LEAF_PARAMETERS[name], shared=OF_A_PLOT) for name in LEAF_FIELDS},
    **parameters_of(GroundParameters),
    **parameters_of(LightParameters),
}
"""What is known of each kind of parameter of a plot, by the last word of its name."""


FIXED_PARAMETERS: dict[str, Parameter] = {
    "branches": Parameter(
        symbol="n_b",
        name="Branches",
        unit="-",
        lower=1.0,
        upper=1000.0,
        usual=(1.0, 30.0),
        default=1.0,
        source="Article on the scene, species table. Bounds assumed.",
        description="Branch models that make up one plant, a whole number.",
    ),
    "rotation_spread": Parameter(
        symbol="sigma_rot",
        name="Rotation spread",
        unit="degree",
        lower=0.0,
        upper=90.0,
        usual=(0.0, 30.0),
        default=0.0,
        source="Article on the scene, equation (5). Bounds assumed.",
        description="Spread of the tilt of the branches, sigma_rot of equation (5).",
    ),
    "groups": Parameter(
        symbol="r_g",
        name="Radius of groups",
        unit="m",
        lower=0.0,
        upper=1000.0,
        usual=(0.0, 5.0),
        default=0.0,
        source="Matérn (1960), cluster process. Bounds assumed.",
        description="Radius of the groups in which the plants stand; 0: in none.",
    ),
    "minimum_area": Parameter(
        symbol="A_min",
        name="Least ground area",
        unit="m2",
        lower=0.0,
        upper=100.0,
        usual=(0.0, 1.0),
        default=0.0,
        source="Assumed.",
        description="Ground area that one plant counts for at least.",
    ),
}
"""What is fixed about a species of a scene, by its field of `Species`: no fit changes it."""


def parameter_kind(name: str) -> str:
    """Last word of a parameter's `name`, such as `cover` of `species.Erica irregularis.cover`."""
    return name.rsplit(".", 1)[-1]


def parameter_reference() -> "pd.DataFrame":
    """A table of all parameters, with those of leaves that only PROSPECT-PRO has.

    Columns: group, parameter, symbol, name, unit, default, lower, upper, usual_lower, usual_upper,
    prior_relative_sd, prior_sd (where it is not relative), prior_distribution, prior_shared (the
    share of the variance that species of a plot have in common), shown_unit (that of files and
    tables), description and source. All numbers are in `unit`; NaN where there is none.
    """
    import pandas as pd  # late: the command line need not wait for it

    groups = {
        "species": SpeciesParameters,
        "leaf": LeafParameters,
        "ground": GroundParameters,
        "light": LightParameters,
    }
    rows = [
        {
            "group": group,
            "parameter": field,
            **vars(record),
            "usual_lower": record.usual[0],
            "usual_upper": record.usual[1],
            "shown_unit": record.shown_unit,
        }
        for group, module in groups.items()
        for field, record in parameters_of(module).items()
    ]
    of_prior = {n: f"prior_{n}" for n in ("relative_sd", "sd", "distribution", "shared")}
    numbers = ["default", "prior_relative_sd", "prior_sd"]
    frame = pd.DataFrame(rows).drop(columns=["usual", "population", "shown", "hint"])
    return frame.rename(columns=of_prior).astype(dict.fromkeys(numbers, float))


def named_values(parameters: PlotParameters, taxa: tuple[str, ...]) -> dict[str, Array]:
    """Every parameter by name, such as `species.Restio eleocharis.cover`, as scalars.

    **Arguments:**

    - `parameters`: of a plot.
    - `taxa`: names of its species, as `Scene.taxa`.

    Leaf parameters are `species.<taxon>.leaf.<field>`, those of another material
    `species.<taxon>.<material>.<field>` or, where species share it, `material.<material>.<field>`;
    the rest `ground.<field>` and `light.<field>`. `with_values` is the inverse.
    """
    named: dict[str, Array] = {}
    for field in dataclasses.fields(SpeciesParameters):
        if (values := getattr(parameters.species, field.name)) is None:
            continue
        named |= {f"species.{t}.{field.name}": v for t, v in zip(taxa, jnp.unstack(values))}
    for name in LEAF_FIELDS:
        values = getattr(parameters.leaf, name)
        named |= {f"species.{t}.leaf.{name}": v for t, v in zip(taxa, jnp.unstack(values))}
    if (others := parameters.materials) is not None:
        for name in LEAF_FIELDS:
            values = jnp.unstack(jnp.asarray(getattr(others.leaf, name)))
            named |= {f"{m}.{name}": v for m, v in zip(others.names, values, strict=True)}
    for group in ("ground", "light"):
        record = getattr(parameters, group)
        named |= {f"{group}.{f.name}": getattr(record, f.name) for f in dataclasses.fields(record)}
    return named


def within_bounds(parameters: PlotParameters, taxa: tuple[str, ...]) -> PlotParameters:
    """`parameters` of the right lengths and within their bounds.

    **Arguments:** `parameters`, of a plot; `taxa`, names of its species.

    Values that are not known, inside a transformation, are set to the bound that they exceed, where
    their slope is zero; NaN stays NaN, and the sun's azimuth, which repeats itself, is as it is.

    **Raises:** `InputError` with the name of a parameter that has another shape, is out of bounds,
    or NaN.
    """
    of_species = [field.name for field in dataclasses.fields(SpeciesParameters)]
    records: dict[str, tuple[Any, Sequence[str], Sequence[str] | None]] = {
        "species": (parameters.species, of_species, [f"species.{t}" for t in taxa]),
        "leaf": (parameters.leaf, LEAF_FIELDS, [f"species.{t}.leaf" for t in taxa]),
    }
    if (others := parameters.materials) is not None:
        records["materials.leaf"] = others.leaf, LEAF_FIELDS, others.names
    for group in ("ground", "light"):
        record = getattr(parameters, group)
        records[group] = record, [field.name for field in dataclasses.fields(record)], None
    places, bounded = [], []
    for group, (record, fields, owners) in records.items():
        for field in fields:
            if (values := getattr(record, field)) is None:
                continue
            shape: tuple[int, ...] = () if owners is None else (len(owners),)
            if jnp.shape(values) != shape:
                expected = "one number" if owners is None else f"a number for each of {len(owners)}"
                raise InputError(
                    f"expected `parameters.{group}.{field}` to be {expected}, of shape {shape}, "
                    f"but its shape is {jnp.shape(values)}"
                )
            known = PARAMETERS[field]
            if not isinstance(values, jax.core.Tracer):
                for i, value in enumerate(np.atleast_1d(np.asarray(values, float)).tolist()):
                    known.check(value, f"{group if owners is None else owners[i]}.{field}")
            elif field != "sun_azimuth":
                places.append((group, field))
                bounded.append(_bounded(values, known.lower, known.upper))
    if not places:
        return parameters
    return eqx.tree_at(
        lambda p: [getattr(attrgetter(group)(p), field) for group, field in places],
        parameters,
        bounded,
    )


@partial(jax.jit, inline=True)  # one step instead of four where it is called alone
def _bounded(values: Array, lower: Any, upper: Any) -> Array:
    # Not `clip`, whose slope at a bound is one half.
    low = jnp.where(values < lower, lower, values)
    return jnp.where(low > upper, upper, low)


def with_values(
    parameters: PlotParameters, taxa: tuple[str, ...], values: Mapping[str, Array | float]
) -> PlotParameters:
    """`parameters` with the named `values` in place of its own.

    **Arguments:**

    - `parameters`: of a plot.
    - `taxa`: names of its species, as `Scene.taxa`.
    - `values`: any of the parameters by name (`named_values`), each in its unit.

    Differentiable in `parameters` and `values`.
    """

    def vector(owners: Sequence[str], field: str, before: Any) -> Any:
        names = [f"{owner}.{field}" for owner in owners]
        if values.keys().isdisjoint(names):
            return before
        own = jnp.unstack(jnp.asarray(before))
        entries = [values.get(name, one) for name, one in zip(names, own)]
        return jnp.stack([jnp.asarray(entry, own[0].dtype) for entry in entries])

    def record(group: str, before: Any) -> Any:
        names = {f.name: f"{group}.{f.name}" for f in dataclasses.fields(before)}
        changes = {field: values[name] for field, name in names.items() if name in values}
        return dataclasses.replace(before, **changes)

    def leaves(owners: Sequence[str], before: LeafParameters) -> LeafParameters:
        return eqx.tree_at(
            lambda l: [getattr(l, name) for name in LEAF_FIELDS],
            before,
            [vector(owners, name, getattr(before, name)) for name in LEAF_FIELDS],
        )

    own = [f"species.{taxon}" for taxon in taxa]
    species = {
        f.name: vector(own, f.name, getattr(parameters.species, f.name))
        for f in dataclasses.fields(SpeciesParameters)
    }
    others = parameters.materials
    if others is not None:
        others = MaterialParameters(others.names, leaves(others.names, others.leaf))
    return PlotParameters(
        SpeciesParameters(**species),
        leaves([f"{owner}.leaf" for owner in own], parameters.leaf),
        record("ground", parameters.ground),
        record("light", parameters.light),
        others,
    )
