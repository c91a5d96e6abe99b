"""Free parameters: bounds, priors, and the unbounded coordinates a fit moves in.

A parameter x in (lower, upper) is lower + (upper - lower) sigmoid(z). A fit moves u, which is z
counted from the prior's centre in units of the prior's width: the prior is then a unit normal in
u, and all parameters have the same scale whatever their units.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError


class ParameterSpace(eqx.Module):
    """The free parameters of a fit."""

    names: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, " free"]
    """Bounds, in the parameters' own units."""
    upper: Float[Array, " free"]
    prior: Float[Array, " free"]
    """Centre of the prior."""
    prior_sd: Float[Array, " free"]
    """Its standard deviation."""

    def __check_init__(self) -> None:
        arrays = (self.lower, self.upper, self.prior, self.prior_sd)
        if any(jnp.shape(a) != (len(self.names),) for a in arrays):
            raise InputError(
                f"a parameter space of {len(self.names)} names must have as many bounds, priors "
                f"and widths, but has the shapes {[jnp.shape(a) for a in arrays]}"
            )
        if any(isinstance(a, jax.core.Tracer) for a in arrays):
            return
        for i, name in enumerate(self.names):
            low, high, centre, sd = (float(a[i]) for a in arrays)
            if not low < centre < high:
                raise InputError(
                    f"the prior of {name} must lie inside its bounds ({low:g}, {high:g}), but is "
                    f"{centre:g}"
                )
            if not sd > 0:
                raise InputError(f"the prior of {name} must have a positive width, but has {sd:g}")

    @property
    def _centre(self) -> Array:
        share = (self.prior - self.lower) / (self.upper - self.lower)
        return jnp.log(share) - jnp.log1p(-share)

    @property
    def _width(self) -> Array:
        """Prior width in z: its width in x over the slope of x at the prior."""
        share = (self.prior - self.lower) / (self.upper - self.lower)
        return self.prior_sd / ((self.upper - self.lower) * share * (1.0 - share))

    def physical(self, u: Float[Array, " free"]) -> Float[Array, " free"]:
        """Parameters in their own units from whitened coordinates. Differentiable."""
        z = self._centre + self._width * u
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(z)

    def whitened(self, values: Float[Array, " free"]) -> Float[Array, " free"]:
        """Inverse of `physical`, for values strictly inside the bounds."""
        share = (values - self.lower) / (self.upper - self.lower)
        z = jnp.log(share) - jnp.log1p(-share)
        return (z - self._centre) / self._width

    def slope(self, u: Float[Array, " free"]) -> Float[Array, " free"]:
        """d physical / d u."""
        share = jax.nn.sigmoid(self._centre + self._width * u)
        return (self.upper - self.lower) * share * (1.0 - share) * self._width

    def log_slope(self, u: Float[Array, " free"]) -> Float[Array, " free"]:
        """log |d physical / d u|, finite far out; what a density over values gains over u."""
        z = self._centre + self._width * u
        both = jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)
        return jnp.log(self.upper - self.lower) + jnp.log(self._width) + both

    def named(self, u: Float[Array, " free"]) -> dict[str, Array]:
        """Parameters by name."""
        values = self.physical(u)
        return {name: values[i] for i, name in enumerate(self.names)}


PLAUSIBLE: dict[str, tuple[float, float]] = {
    "cover": (0.0, 1.0),
    "diameter": (0.01, 10.0),
    "height": (0.02, 20.0),
    "packing": (0.0, 0.95),
    "fill": (0.05, 1.0),
    "leaf_area_index": (0.0, 12.0),
    "wood_area_index": (0.0, 6.0),
    "shoot_clumping": (0.0, 0.8),
    "structure": (1.0, 3.5),
    "chlorophyll": (0.0, 120.0),
    "carotenoids": (0.0, 30.0),
    "anthocyanins": (0.0, 40.0),
    "brown_pigments": (0.0, 2.0),
    "water": (0.0005, 0.08),
    "dry_matter": (0.0005, 0.06),
    "brightness": (0.1, 2.0),
    "moisture": (0.0, 1.0),
    "litter_fraction": (0.0, 1.0),
    "char_fraction": (0.0, 1.0),
    "rock_fraction": (0.0, 1.0),
    "wood_brightness": (0.1, 2.5),
    "sun_zenith": (0.0, 85.0),
    "aerosol": (0.0, 1.0),
}
"""Plausible range of each kind of parameter, by the last word of its name: what fynbos plants,
soils and skies can be, in the parameter's own unit. Assumptions, meant wide."""
# Cover and diameter stay where the sites held ready suffice.
_RELATIVE: dict[str, tuple[float, float]] = {"cover": (0.3, 1.8), "diameter": (0.65, 1.6)}


def make_space(values: dict[str, float], relative_sd: dict[str, float]) -> ParameterSpace:
    """The space of the parameters in `values`, with plausible bounds.

    **Arguments:** `values`, the prior centre by name, in the parameters' own units; `relative_sd`,
    the prior's standard deviation over its centre, by name. A centre at or beyond a bound is
    moved just inside, a width of zero (a parameter whose centre is zero) to a tenth of the range.
    """
    names = tuple(values)
    bounds, priors, widths = [], [], []
    for name in names:
        kind, value = name.rsplit(".", 1)[-1], float(values[name])
        if kind not in PLAUSIBLE:
            raise InputError(f"{name} cannot be free: only {', '.join(PLAUSIBLE)} can")
        low, high = PLAUSIBLE[kind]
        if kind in _RELATIVE and value > 0:
            low, high = (
                max(low, _RELATIVE[kind][0] * value),
                min(high, _RELATIVE[kind][1] * value),
            )
        inside = float(np.clip(value, low + 0.02 * (high - low), high - 0.02 * (high - low)))
        sd = relative_sd[name] * abs(value)
        bounds.append((low, high))
        priors.append(inside)
        widths.append(sd if sd > 0 else 0.1 * (high - low))
    limits = np.asarray(bounds, float).reshape(-1, 2)
    return ParameterSpace(
        names,
        jnp.asarray(limits[:, 0]),
        jnp.asarray(limits[:, 1]),
        jnp.asarray(priors),
        jnp.asarray(widths),
    )


def match_names(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """Names that fit one of the shell-style patterns; `InputError` for a pattern without any."""
    from fnmatch import fnmatchcase

    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(
                f"no parameter is called {pattern!r}; the names are such as {', '.join(names[:3])}"
            )
    return [name for name in names if any(fnmatchcase(name, p) for p in patterns)]
