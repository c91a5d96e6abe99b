"""What a leaf is made of, in PROSPECT's own terms and units."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.math import real_array

# Largest values that can still be meant in the field's unit; the likely slip when exceeded.
_PLAUSIBLE: dict[str, tuple[float, float, str]] = {
    "structure": (0.5, 20.0, "it is the number of layers, usually 1 to 3"),
    "chlorophyll": (0.0, 1000.0, "is it in µg/cm2?"),
    "carotenoids": (0.0, 1000.0, "is it in µg/cm2?"),
    "anthocyanins": (0.0, 1000.0, "is it in µg/cm2?"),
    "brown_pigments": (0.0, 100.0, "it is a dimensionless amount, usually 0 to 1"),
    "water": (0.0, 1.0, "it is in cm (= g/cm2): was mg/cm2 or a percentage given?"),
    "dry_matter": (0.0, 1.0, "it is in g/cm2: was mg/cm2 or g/m2 given?"),
    "proteins": (0.0, 1.0, "it is in g/cm2: was mg/cm2 or a percentage given?"),
    "carbon_constituents": (0.0, 1.0, "it is in g/cm2: was mg/cm2 or a percentage given?"),
}


class LeafParameters(eqx.Module):
    """Structure and biochemistry of one leaf, as PROSPECT reads them.

    One instance is one leaf: every field is a scalar. Many leaves are
    `LeafParameters.many(chlorophyll=array, ...)`, and functions of a leaf are mapped over them by
    `jax.vmap`. PROSPECT-5 ignores `anthocyanins`; PROSPECT-5 and -D read `dry_matter`
    and ignore `proteins` and `carbon_constituents`; PROSPECT-PRO reads those two and ignores
    `dry_matter`.

    **Raises:** `ValueError` for a field that is not a scalar, or, where values are known (outside
    `jit`), one that is negative, not finite, or so large that its unit must be wrong.
    """

    structure: Float[Array, ""] = eqx.field(converter=real_array, default=1.5)
    """Structure parameter N, the number of elementary layers [-]; 1 to 3, valid from 0.5."""
    chlorophyll: Float[Array, ""] = eqx.field(converter=real_array, default=40.0)
    """Chlorophyll a+b content, Cab [µg/cm2]; 0 to 120."""
    carotenoids: Float[Array, ""] = eqx.field(converter=real_array, default=8.0)
    """Carotenoid content, Car [µg/cm2]; 0 to 30."""
    anthocyanins: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Anthocyanin content, Ant [µg/cm2]; 0 to 40."""
    brown_pigments: Float[Array, ""] = eqx.field(converter=real_array, default=0.0)
    """Brown pigments, Cbrown [-]; 0 in a green leaf, about 1 in a dead one."""
    water: Float[Array, ""] = eqx.field(converter=real_array, default=0.01)
    """Equivalent water thickness, EWT or Cw [cm = g/cm2]; 0 to 0.06."""
    dry_matter: Float[Array, ""] = eqx.field(converter=real_array, default=0.009)
    """Dry matter per leaf area, LMA or Cm [g/cm2]; 0.001 to 0.04."""
    proteins: Float[Array, ""] = eqx.field(converter=real_array, default=0.001)
    """Protein content [g/cm2]; 0 to 0.003."""
    carbon_constituents: Float[Array, ""] = eqx.field(converter=real_array, default=0.008)
    """Carbon-based constituents: cellulose, lignin, starch, sugars, CBC [g/cm2]; 0 to 0.037."""

    def __check_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if jnp.shape(value) != ():
                raise ValueError(
                    f"`LeafParameters.{field.name}` must be a scalar, but has shape "
                    f"{jnp.shape(value)}. For many leaves use `LeafParameters.many(...)`."
                )
            if isinstance(value, jax.core.Tracer):
                continue
            lower, upper, hint = _PLAUSIBLE[field.name]
            number = float(np.asarray(value))
            if not lower <= number <= upper:
                raise ValueError(
                    f"`LeafParameters.{field.name}` must be within {lower:g} to {upper:g}, but is "
                    f"{number:g}; {hint}"
                )

    @staticmethod
    def many(**fields: Any) -> "LeafParameters":
        """Many leaves at once: every field becomes a vector over leaves, to map over by `jax.vmap`.

        **Arguments:** fields by name, each a number or a vector [leaf]; numbers, and fields left
        out, are the same for all leaves.

        **Raises:** `ValueError` for vectors of different length; values are not checked.
        """
        unknown = set(fields) - set(_PLAUSIBLE)
        if unknown:
            raise TypeError(f"`LeafParameters` has no field {sorted(unknown)[0]!r}")
        defaults = {f.name: f.default for f in dataclasses.fields(LeafParameters)}
        values = [real_array(fields.get(name, default)) for name, default in defaults.items()]
        columns = jnp.broadcast_arrays(*jnp.atleast_1d(*values))
        return jax.vmap(LeafParameters)(*columns)
