"""Free parameters: bounds, priors, and the unbounded coordinates a fit moves in.

A parameter x in (lower, upper) is lower + (upper - lower) sigmoid(z). A fit moves u, which is z
counted from the prior's centre in units of the prior's width: the prior is then a unit normal in
u, and all parameters have the same scale whatever their units.
"""

import math
import warnings
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq

from fynjax._core.errors import InputError
from fynjax.scene import PARAMETERS, parameter_kind


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


_ROOM: dict[str, tuple[float, float]] = {"cover": (0.3, 1.8), "diameter": (0.65, 1.6)}
"""Factors on cover and diameter between which the sites held ready for plants suffice."""
_INSET = 0.02
"""How far inside its bound the prior of a value there is centred [usual range]."""
_ROUNDING = 1e-6
"""A value so near its bound lies on it [usual range]."""


def make_space(values: dict[str, float], relative_sd: Mapping[str, float | None]) -> ParameterSpace:
    """The space of the parameters in `values`, within the bounds of `fynjax.scene.PARAMETERS`.

    Covers and diameters are bounded closer where the plants held ready would not suffice.

    A prior is logit-normal between the bounds of its parameter. One that is too wide has two modes,
    with most of its mass at the bounds. Such a prior is fitted into its bounds: its centre moves to
    2 % of the usual range inside where it is nearer to a bound, and its standard deviation is cut
    to the largest with one mode: that of z is sqrt(2) halfway between the bounds, and 2.9 at 1 % of
    their distance. So is that of a value on its bound (dry soil, a leaf without anthocyanins),
    whose stated standard deviation, a share of the value, may be zero. A warning names the
    parameters with their stated and their fitted priors.

    **Arguments:**

    - `values`: the prior's centre by name, in the parameters' own units, within the bounds.
    - `relative_sd`: the prior's standard deviation over its centre by name, positive [-]; None
      takes that of the parameter's record.

    **Returns:** `ParameterSpace`, its parameters in the order of `values`.

    **Raises:** `InputError` for a value outside its bounds, and a parameter that has no prior.
    """
    columns, fitted = [], []
    for name, value in values.items():
        kind = parameter_kind(name)
        record = PARAMETERS.get(kind)
        own = None if record is None else record.prior_sd(value)
        if record is None or own is None:
            free = [k for k, known in PARAMETERS.items() if known.prior_sd(1.0) is not None]
            raise InputError(f"{name} cannot be free: only {', '.join(free)} can")
        record.check(value, f"the prior of {name}")
        low, high = record.lower, record.upper
        usual = record.usual[1] - record.usual[0]
        if kind in _ROOM and value > 0:
            low, high = max(low, _ROOM[kind][0] * value), min(high, _ROOM[kind][1] * value)
            usual = min(usual, high - low)
        relative = relative_sd[name]
        stated = own if relative is None else relative * abs(value)
        centre, sd = _fitted_prior(value, stated, (low, high), usual)
        if (centre, sd) != (value, stated):
            shown = [record.shown_factor * number for number in (value, stated, centre, sd)]
            change = "{:g} (sd {:.3g}) to {:g} (sd {:.3g})".format(*shown)
            unit = "" if record.shown_unit == "-" else f" {record.shown_unit}"
            fitted.append(f"{name} from {change}{unit}")
        columns.append((low, high, centre, sd))
    if fitted:
        warnings.warn(
            f"priors moved or narrowed, since their bounds do not hold them: {'; '.join(fitted)}",
            stacklevel=2,
        )
    limits = np.asarray(columns, float).reshape(-1, 4)
    return ParameterSpace(tuple(values), *map(jnp.asarray, limits.T))


def _fitted_prior(
    value: float, sd: float, bounds: tuple[float, float], usual: float
) -> tuple[float, float]:
    """Centre and standard deviation of a prior with one mode between its bounds."""
    low, high = bounds
    on_bound = min(value - low, high - value) <= _ROUNDING * usual
    if not on_bound and sd <= _widest(value, bounds):
        return value, sd
    centre = min(max(value, low + _INSET * usual), high - _INSET * usual)
    widest = _widest(centre, bounds)
    return centre, widest if on_bound else min(sd, widest)


def _widest(centre: float, bounds: tuple[float, float]) -> float:
    """Largest standard deviation of a logit-normal prior that has one mode.

    With z normal about m with standard deviation s, the modes solve z - m = s^2 tanh(z / 2). The
    right side is steepest, s^2 / 2, at z = 0: up to s^2 = 2 there is one solution wherever m is.
    Beyond, a second one appears where the two sides touch, at tanh(z / 2) = t with
    s^2 (1 - t^2) = 2, that is where |m| = 2 t / (1 - t^2) - 2 artanh t.
    """
    low, high = bounds
    share = (centre - low) / (high - low)
    m = abs(math.log(share) - math.log1p(-share))
    t = brentq(lambda t: 2.0 * t / (1.0 - t**2) - 2.0 * math.atanh(t) - m, 0.0, 1.0 - 1e-9)
    return math.sqrt(2.0 / (1.0 - t**2)) * share * (1.0 - share) * (high - low)


def match_names(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """The `names` that fit one of the shell-style `patterns`, in their order.

    **Raises:** `InputError` for a pattern that fits none.
    """
    from fnmatch import fnmatchcase

    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(
                f"no parameter is called {pattern!r}; the names are such as {', '.join(names[:3])}"
            )
    return [name for name in names if any(fnmatchcase(name, p) for p in patterns)]
