"""Structure and biochemistry of a leaf, in the terms and units of PROSPECT."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax._core.math import real_array
from fynjax._core.parameters import parameter_field, parameters_of

# PROSPECT's unit of water, dry matter and what that is made of.
_PER_AREA = "it is in g/cm2: was mg/cm2, g/m2 or a percentage given?"


class LeafParameters(eqx.Module):
    """Structure and biochemistry of a leaf, the input of PROSPECT.

    One instance is one leaf: every field is a scalar. Many leaves are
    `LeafParameters.many(chlorophyll=array, ...)`, and functions of a leaf are mapped over them by
    `jax.vmap`. PROSPECT-5 ignores `anthocyanins`; PROSPECT-5 and -D read `dry_matter`
    and ignore `proteins` and `carbon_constituents`; PROSPECT-PRO reads those two and ignores
    `dry_matter`.

    **Raises:** `InputError` for a field that is not a scalar and, where values are known (outside
    `jit`), for a field outside the bounds of its parameter (`LEAF_PARAMETERS`).

    >>> import fynjax as fx
    >>> leaf = fx.LeafParameters(chlorophyll=45.0, water=0.012)
    >>> float(leaf.structure)
    1.5
    >>> fx.LeafParameters.many(chlorophyll=[30.0, 60.0]).water.shape
    (2,)
    """

    if TYPE_CHECKING:  # fields are arrays, and numbers make them

        def __init__(
            self,
            structure: ArrayLike = ...,
            chlorophyll: ArrayLike = ...,
            carotenoids: ArrayLike = ...,
            anthocyanins: ArrayLike = ...,
            brown_pigments: ArrayLike = ...,
            water: ArrayLike = ...,
            dry_matter: ArrayLike = ...,
            proteins: ArrayLike = ...,
            carbon_constituents: ArrayLike = ...,
        ) -> None: ...

    structure: Float[Array, ""] = parameter_field(
        symbol="N",
        name="Structure parameter N",
        unit="-",
        lower=0.8,
        upper=5.0,
        usual=(1.0, 3.0),
        default=1.5,
        relative_sd=0.15,
        population=(1.5, 0.44),
        distribution="logit-normal",
        source="Jacquemoud and Baret 1990; Feret et al. 2008. Default and prior assumed.",
        description="Number of elementary layers of the leaf (Jacquemoud and Baret 1990). Broad "
        "leaves have 1 to 2.7 (ANGERS, LOPEX: Feret et al. 2008); PROSPECT goes on below 1, where "
        "fits of thin leaves and needles end; 5 leaves room for thick, hard leaves.",
        hint="it is the number of layers, usually 1 to 3",
    )
    chlorophyll: Float[Array, ""] = parameter_field(
        symbol="Cab",
        name="Chlorophyll a+b",
        unit="ug cm-2",
        lower=0.0,
        upper=150.0,
        usual=(0.0, 120.0),
        default=40.0,
        relative_sd=0.3,
        population=(35.0, 0.61),
        source="Feret et al. 2008; Di Vittorio 2009. Default and prior assumed.",
        description="Per leaf area. Measured up to 107 in ANGERS (Feret et al. 2008) and 123 in "
        "conifer needles (Di Vittorio 2009).",
        hint="is it in µg/cm2?",
    )
    carotenoids: Float[Array, ""] = parameter_field(
        symbol="Car",
        name="Carotenoids",
        unit="ug cm-2",
        lower=0.0,
        upper=50.0,
        usual=(0.0, 30.0),
        default=8.0,
        relative_sd=0.3,
        population=(8.0, 0.64),
        source="Feret et al. 2008. Upper bound, default and prior assumed.",
        description="Per leaf area. Measured up to 25 in ANGERS (Feret et al. 2008); twice that "
        "leaves room for leaves in strong sun.",
        hint="is it in µg/cm2?",
    )
    anthocyanins: Float[Array, ""] = parameter_field(
        symbol="Ant",
        name="Anthocyanins",
        unit="ug cm-2",
        lower=0.0,
        upper=50.0,
        usual=(0.0, 40.0),
        default=0.0,
        relative_sd=0.5,
        population=(0.5, 1.5),
        source="Feret et al. 2017. Upper bound and prior assumed.",
        description="Per leaf area. Red leaves have up to about 40 (Feret et al. 2017).",
        hint="is it in µg/cm2?",
    )
    brown_pigments: Float[Array, ""] = parameter_field(
        symbol="Cbrown",
        name="Brown pigments",
        unit="-",
        lower=0.0,
        upper=2.0,
        usual=(0.0, 1.0),
        default=0.0,
        relative_sd=0.5,
        population=(0.02, 1.5),
        source="Jacquemoud et al. 2009. Upper bound and prior assumed.",
        description="Amount relative to PROSPECT's specific absorption (Jacquemoud et al. 2009): 0 "
        "in a green leaf, about 1 in a dead one; 2 darkens a green leaf by half at 550 nm.",
        hint="it is a dimensionless amount, usually 0 to 1",
    )
    water: Float[Array, ""] = parameter_field(
        symbol="Cw",
        name="Equivalent water thickness",
        unit="cm",
        lower=0.0,
        upper=0.2,
        usual=(0.0, 0.06),
        default=0.01,
        relative_sd=0.3,
        population=(0.01, 0.54),
        source="Jacquemoud et al. 1996; BioSCape trait library. Default and prior assumed.",
        description="Water per leaf area, in cm or g cm-2. Up to 0.05 in LOPEX (Jacquemoud et al. "
        "1996); culms of restios reach 0.1 and succulents 0.17 (BioSCape trait library, per half "
        "of the surface).",
        hint="it is in cm (= g/cm2): was mg/cm2 or a percentage given?",
    )
    dry_matter: Float[Array, ""] = parameter_field(
        symbol="Cm",
        name="Dry matter, leaf mass per area",
        unit="g cm-2",
        lower=0.0,
        upper=0.1,
        usual=(0.001, 0.04),
        default=0.009,
        relative_sd=0.3,
        population=(0.008, 0.69),
        source="Wright et al. 2004; BioSCape trait library. Prior assumed.",
        description="Median 0.009 over the plants of the world (Wright et al. 2004); shrubs of "
        "California reach 0.039, culms and iris leaves of the Cape 0.061 (BioSCape trait library, "
        "per half of the surface).",
        hint=_PER_AREA,
    )
    proteins: Float[Array, ""] = parameter_field(
        symbol="Cp",
        name="Proteins",
        unit="g cm-2",
        lower=0.0,
        upper=0.01,
        usual=(0.0, 0.003),
        default=0.001,
        population=(0.0008, 0.52),
        source="Feret et al. 2021. Bounds, default and prior assumed.",
        description="Per leaf area, PROSPECT-PRO (Feret et al. 2021); a tenth of the largest dry "
        "matter.",
        hint=_PER_AREA,
    )
    carbon_constituents: Float[Array, ""] = parameter_field(
        symbol="CBC",
        name="Carbon-based constituents",
        unit="g cm-2",
        lower=0.0,
        upper=0.1,
        usual=(0.0, 0.037),
        default=0.008,
        population=(0.007, 0.7),
        source="Feret et al. 2021. Bounds, default and prior assumed.",
        description="Cellulose, lignin, starch and sugars per leaf area, PROSPECT-PRO (Feret et "
        "al. 2021); bounded as the dry matter of which they are the most.",
        hint=_PER_AREA,
    )

    def __check_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if jnp.shape(value) != ():
                raise InputError(
                    f"`LeafParameters.{field.name}` must be a scalar, but has shape "
                    f"{jnp.shape(value)}. For many leaves use `LeafParameters.many(...)`."
                )
            if isinstance(value, jax.core.Tracer):
                continue
            record = field.metadata["parameter"]
            record.check(float(np.asarray(value)), f"`LeafParameters.{field.name}`")

    @staticmethod
    def many(**fields: Any) -> "LeafParameters":
        """Many leaves at once: every field becomes a vector over leaves, to map over by `jax.vmap`.

        **Arguments:** fields by name, each a number or a vector [leaf]; numbers, and fields left
        out, are the same for all leaves.

        **Raises:** `InputError` for vectors of different length; values are not checked.
        """
        unknown = set(fields) - set(LEAF_PARAMETERS)
        if unknown:
            raise TypeError(
                f"`LeafParameters` has no field {sorted(unknown)[0]!r}; it has "
                f"{', '.join(LEAF_PARAMETERS)}"
            )
        defaults = {f.name: f.default for f in dataclasses.fields(LeafParameters)}
        values = [real_array(fields.get(name, default)) for name, default in defaults.items()]
        columns = jnp.broadcast_arrays(*jnp.atleast_1d(*values))
        return jax.vmap(LeafParameters)(*columns)


LEAF_PARAMETERS = parameters_of(LeafParameters)
"""Name, unit, bounds, default and prior of each parameter of a leaf. A leaf fit searches between
the bounds, with the wide prior of leaves at large."""


def structure_from_dry_matter(dry_matter: Any) -> Any:
    """PROSPECT's structure parameter N of a leaf of known mass, where it was not measured [-].

    **Arguments:**

    - `dry_matter`: dry matter, leaf mass per area [g cm-2], 0 or more.

    **Returns:** exp(0.275 ln LMA - 0.689) with LMA in g m-2, within the bounds of `structure`: a
    regression over the 657 leaves of ANGERS, LOPEX, NASA's Forest Functional Types and
    Californian shrubs for which mass and spectrum are at hand (LMA 17 to 389 g m-2), with N as
    fitted. Thick, hard leaves have more layers. NumPy arrays and numbers; not differentiable.

    >>> from fynjax.leaf import structure_from_dry_matter
    >>> round(float(structure_from_dry_matter(0.01)), 2)
    1.78
    """
    record = LEAF_PARAMETERS["structure"]
    layers = np.exp(-0.689) * (1e4 * np.asarray(dry_matter, float)) ** 0.275
    return np.clip(layers, record.lower, record.upper)


Leaf = LeafParameters
"""Short name of `LeafParameters`."""
