"""Free parameters: bounds, priors, and the unbounded coordinates a fit moves in.

A fit moves u, in which the prior is a unit normal: all parameters have the same scale whatever
their units. The prior of a parameter x is normal in z = location + width u, where z is

- log((x - lower) / (upper - x)) if it is logit-normal, as shares are,
- log(x) if it is lognormal, as sizes, areas and amounts are,
- x if it is normal.

A lognormal or normal prior is cut at the bounds: z is then location + width t, with t the quantile
of the cut normal distribution at the probability that u has in a whole one.

Where priors of several parameters are correlated, as those of a trait of the species of a plot are,
the coordinates above are v = R^(1/2) u instead of u, with R their correlation matrix: u stays a
unit normal, and each parameter keeps its own prior.
"""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike
from scipy import special
from scipy.optimize import brentq

from fynjax._core.errors import InputError
from fynjax._core.html import as_html
from fynjax._core.math import symmetric_power
from fynjax._core.parameters import Distribution, Parameter
from fynjax._core.precision import in_double
from fynjax.scene import PARAMETERS, parameter_kind

if TYPE_CHECKING:
    import pandas as pd

_NEAR, _FAR = 5.0, 37.0
_U = np.linspace(-8.5, 8.5, 1701)
_WEIGHT = np.exp(-0.5 * _U**2) / np.exp(-0.5 * _U**2).sum()
"""Points and weights of means over a unit normal; in so many points good to 1e-14."""
_NODES, _NODE_WEIGHT = np.polynomial.hermite_e.hermegauss(24)
_NODE_WEIGHT /= _NODE_WEIGHT.sum()
"""The same, fewer: good to 1e-6 up to a lognormal width of one."""


class ParameterSpace(eqx.Module):
    """The free parameters of a fit.

    **Arguments:**

    - `names`: of the parameters.
    - `lower`, `upper`: bounds, in the parameters' own units; of a normal prior they may be
      infinite, of a lognormal one 0 and infinite.
    - `prior`: median of each prior, inside the bounds.
    - `prior_sd`: its standard deviation, exact in the parameter's own unit; or instead
    - `width`: the standard deviation of the normal coordinate.
    - `distribution`: "logit-normal", "lognormal" or "normal", of all or one of each.
    - `correlation`: of the normal coordinates of the priors; none by default.

    Made of numbers, not of traced arrays: inside `jax.jit` or `jax.grad` change `location` and
    `width` of a space by `equinox.tree_at`.

    **Raises:** `InputError` for a median that is not inside its bounds, a standard deviation or
    width that is not positive or wider than any such distribution between the bounds, and a
    `correlation` that is none.

    >>> import jax.numpy as jnp
    >>> from fynjax.inversion import ParameterSpace
    >>> space = ParameterSpace(("diameter",), [0.0], [10.0], [0.4], [0.1], distribution="lognormal")
    >>> space.physical(jnp.array([-1.0])).round(3).tolist()
    [0.315]
    """

    names: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, " free"]
    """Lower bound, in the parameter's own unit."""
    upper: Float[Array, " free"]
    """Upper bound, in the parameter's own unit."""
    prior: Float[Array, " free"]
    """Median of the prior, in the parameter's own unit."""
    prior_sd: Float[Array, " free"]
    """Standard deviation of the prior, in the parameter's own unit."""
    location: Float[Array, " free"]
    """Mean of the coordinate z, were it not cut."""
    width: Float[Array, " free"]
    """Standard deviation of the coordinate z, were it not cut."""
    cut: Float[Array, "2 free"]
    """Ends below and above at which z is cut, from `location`, in widths."""
    distribution: tuple[Distribution, ...] = eqx.field(static=True)
    mixing: Float[Array, "free free"] | None
    """Root of the correlation of the priors; None: independent."""

    def __init__(
        self,
        names: Sequence[str],
        lower: ArrayLike,
        upper: ArrayLike,
        prior: ArrayLike,
        prior_sd: ArrayLike | None = None,
        *,
        width: ArrayLike | None = None,
        distribution: Distribution | Sequence[Distribution] = "logit-normal",
        correlation: ArrayLike | None = None,
    ) -> None:
        self.names = tuple(names)
        count = len(self.names)
        kinds = (distribution,) * count if isinstance(distribution, str) else tuple(distribution)
        if (prior_sd is None) == (width is None):
            raise InputError("a parameter space takes either `prior_sd` or `width`")
        spread = width if prior_sd is None else prior_sd
        arrays = [np.asarray(a, float) for a in (lower, upper, prior, spread)]
        if any(np.shape(a) != (count,) for a in arrays) or len(kinds) != count:
            raise InputError(
                f"a parameter space of {count} names must have as many bounds, priors and widths, "
                f"but has the shapes {[np.shape(a) for a in arrays]}"
            )
        fitted = []
        for name, low, high, centre, sd, kind in zip(self.names, *arrays, kinds):
            if not sd > 0:
                raise InputError(f"the prior of {name} must have a positive width, but has {sd:g}")
            one = _Prior(name, float(low), float(high), float(centre), kind)
            wide = one.width_of(float(sd)) if width is None else float(sd)
            fitted.append((wide, *one.at(wide), one.sd(wide) if width is not None else sd))
        table = np.array(fitted).reshape(count, 5).T
        self.lower, self.upper, self.prior = (in_double(a) for a in arrays[:3])
        self.width, self.location, self.prior_sd = (in_double(table[i]) for i in (0, 1, 4))
        self.cut = in_double(table[2:4])
        self.distribution = kinds
        self.mixing = None if correlation is None else in_double(_mixing(correlation, count))

    def __str__(self) -> str:
        """Every parameter with its prior, in the unit of field crews."""
        low, high = np.asarray(self.quantiles(0.05, 0.95))
        lines = [f"{len(self.names)} free parameters, prior median and 5 to 95 %:"]
        for name, median, below, above in zip(self.names, self.prior, low, high):
            _, unit, factor = shown_unit(name)
            lines.append(
                f"  {name} [{unit}]: {factor * median:.3g}, {factor * below:.3g} to "
                f"{factor * above:.3g}"
            )
        return "\n".join(lines)

    _repr_html_ = as_html

    def together(self, u: Float[Array | np.ndarray, " free"]) -> Float[Array, " free"]:
        """The normal coordinate v of each parameter's own prior, from whitened coordinates."""
        u = jnp.asarray(u)
        return u if self.mixing is None else jnp.asarray(self.mixing, float) @ u

    def own_variance(self, covariance: Float[Array, "free free"]) -> Float[Array, " free"]:
        """Variance of each parameter's normal coordinate, where the prior's is one, from the
        covariance of the whitened coordinates."""
        if self.mixing is None:
            return jnp.diagonal(covariance)
        mixing = jnp.asarray(self.mixing, float)
        return jnp.sum((mixing @ covariance) * mixing, axis=1)

    def _is(self, kind: Distribution) -> Bool[np.ndarray, " free"]:
        return np.array([own == kind for own in self.distribution], bool)

    def _now(self) -> ParameterSpace:
        """The same in the precision that JAX has now."""
        return jax.tree.map(lambda array: jnp.asarray(array, float), self)

    def _coordinate(self, v: Array) -> Array:
        """z from the normal coordinates."""
        now = self._now()
        if self._is("logit-normal").all():
            return now.location + now.width * v
        return now.location + now.width * _cut_normal(v, *now.cut)

    def physical(self, u: Float[Array | np.ndarray, " free"]) -> Float[Array, " free"]:
        """Parameters in their own units from whitened coordinates. Differentiable."""
        return self.alone(self.together(u))

    def alone(self, v: Float[Array, " free"]) -> Float[Array, " free"]:
        """Parameters in their own units from their own normal coordinates, as if no priors were
        correlated. Differentiable."""
        z, log, logit = self._coordinate(v), self._is("lognormal"), self._is("logit-normal")
        lower, upper = self._now().lower, self._now().upper
        share = jnp.where(logit, lower, 0.0), jnp.where(logit, upper - lower, 1.0)
        # No exponential of what is not its logarithm: it would overflow, and its slope be NaN.
        value = jnp.where(log, jnp.exp(jnp.where(log, z, 0.0)), z)
        return jnp.where(logit, share[0] + share[1] * jax.nn.sigmoid(z), value)

    def whitened(self, values: Float[Array, " free"]) -> Float[Array, " free"]:
        """Inverse of `physical`, for values strictly inside the bounds."""
        log, logit, now = self._is("lognormal"), self._is("logit-normal"), self._now()
        # Of a lognormal parameter log(below / 1), of a normal one the value itself.
        below = jnp.where(logit, values - now.lower, jnp.where(log, values, 1.0))
        above = jnp.where(logit, now.upper - values, 1.0)
        z = jnp.where(log | logit, jnp.log(below) - jnp.log(above), values)
        t = (z - now.location) / now.width
        v = t if logit.all() else _whole_normal(t, *now.cut)
        return v if now.mixing is None else jnp.linalg.solve(now.mixing, v)

    def slope(self, u: Float[Array | np.ndarray, " free"]) -> Float[Array, " free"]:
        """d physical / d v, where v is `together(u)`."""
        return jnp.exp(self.log_slope(u))

    def log_slope(self, u: Float[Array | np.ndarray, " free"]) -> Float[Array, " free"]:
        """log |d physical / d v|, finite far out; what a density over values gains over u, but for
        a constant where priors are correlated."""
        return self._log_slope(self.together(u))

    def _log_slope(self, v: Array) -> Array:
        z, log, logit = self._coordinate(v), self._is("lognormal"), self._is("logit-normal")
        now = self._now()
        extent = jnp.where(logit, now.upper - now.lower, 1.0)
        # A logistic function s has the slope s(z) s(-z).
        both = jnp.log(extent) + jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)
        rate = jnp.where(logit, both, jnp.where(log, z, 0.0)) + jnp.log(now.width)
        return rate if logit.all() else rate + _log_rate(v, *now.cut)

    def named(self, u: Float[Array, " free"]) -> dict[str, Array]:
        """Parameters by name."""
        values = self.physical(u)
        return {name: values[i] for i, name in enumerate(self.names)}

    def quantiles(self, *shares: float) -> Float[Array, "share free"]:
        """Quantiles of the prior of each parameter, in its own unit."""
        return jnp.stack([self.alone(jnp.full(len(self.names), ndtri(p))) for p in shares])

    def prior_columns(self) -> dict[str, Any]:
        """Median, standard deviation and 90 % interval of each prior, in the parameters' own units,
        by the name of the column in a table."""
        low, high = self.quantiles(0.05, 0.95)
        prior = {"prior": self.prior, "prior_sd": self.prior_sd}
        return {**prior, "prior_q05": low, "prior_q95": high}

    def density(self) -> tuple[Float[Array, "point free"], Float[Array, "point free"]]:
        """Values from the lowest to the highest that the prior makes likely, and its density."""
        v = jnp.broadcast_to(jnp.linspace(-4.0, 4.0, 201)[:, None], (201, len(self.names)))
        rate = jax.vmap(self._log_slope)(v)
        return jax.vmap(self.alone)(v), jnp.exp(norm.logpdf(v) - rate)

    def quantiles_about(
        self, u: Float[Array, " free"], sd: Float[Array, " free"], *shares: float
    ) -> Float[Array, "share free"]:
        """Quantiles, in their own units, of parameters whose normal coordinates are normal about
        those of `u` with `sd`."""
        return jnp.stack([self.alone(self.together(u) + ndtri(p) * sd) for p in shares])

    def spread(self, u: Float[Array, " free"], sd: Float[Array, " free"]) -> Float[Array, " free"]:
        """Standard deviation, in their own units, of parameters whose normal coordinates are normal
        about those of `u` with `sd`. Differentiable."""
        v = self.together(u)
        nodes, weight = (jnp.asarray(a, float) for a in (_NODES, _NODE_WEIGHT))
        # Gauss-Hermite quadrature of the value less that in the middle.
        values = jax.vmap(self.alone)(v + nodes[:, None] * sd) - self.alone(v)
        mean = weight @ values
        return jnp.sqrt(weight @ (values - mean) ** 2)

    def at_bound(self, values: Float[Array, " free"]) -> Bool[Array, " free"]:
        """Whether values lie at a bound: nearer than a thousandth of the range, of one without end
        of the prior median's distance from the bound, and than a twentieth of that distance."""
        now = self._now()
        near = jnp.minimum(values - now.lower, now.upper - values)
        usual = jnp.minimum(now.prior - now.lower, now.upper - now.prior)
        extent = now.upper - now.lower
        extent = jnp.where(jnp.isfinite(extent), extent, usual)
        return near < jnp.minimum(_AT_BOUND * extent, _NEARER * usual)


def shown_unit(name: str) -> tuple[str, str, float]:
    """Kind, unit as field crews write it, and the factor to it, of the parameter called `name`."""
    kind = parameter_kind(name)
    record = PARAMETERS.get(kind)
    return (kind, "-", 1.0) if record is None else (kind, record.shown_unit, record.shown_factor)


def parameter_columns(names: Sequence[str], columns: Mapping[str, Any]) -> pd.DataFrame:
    """A table of parameters: name, kind, unit, and columns converted to that unit.

    **Arguments:**

    - `names`: of the parameters.
    - `columns`: values of the parameters, in their own units, by the name of the column.
    """
    import pandas as pd  # late: the command line need not wait for it

    units = [shown_unit(name) for name in names]
    factor = np.array([f for _, _, f in units])
    return pd.DataFrame(
        {
            "name": list(names),
            "kind": [kind for kind, _, _ in units],
            "unit": [unit for _, unit, _ in units],
            **{key: factor * np.asarray(value, float) for key, value in columns.items()},
        }
    )


def _mixing(correlation: ArrayLike, count: int) -> np.ndarray:
    """The root of a correlation matrix of the parameters."""
    matrix = np.asarray(correlation, float)
    good = matrix.shape == (count, count) and np.allclose(matrix, matrix.T, atol=1e-12)
    if not (good and np.allclose(np.diagonal(matrix), 1.0)):
        raise InputError(
            f"`correlation` must be symmetric with ones on its diagonal, for {count} parameters"
        )
    if np.linalg.eigvalsh(matrix)[:1].min(initial=1.0) <= 1e-9:
        raise InputError("`correlation` must be positive definite: no parameter follows another")
    return symmetric_power(matrix)


def _quantile(u: Any, low: Any, high: Any, library: Any, special: Any) -> Any:
    """Quantile of a unit normal cut at `low` and `high`, at the probability of u in a whole one.

    Each tail by its own probability, so that neither loses digits.
    """
    given, u = u, library.clip(u, -_FAR, _FAR)
    held = special.ndtr(-low) - special.ndtr(-high)
    # Probability beyond the quantile on its own side: below it for u < 0, above it otherwise.
    below = held * special.ndtr(-library.abs(u)) + special.ndtr(library.where(u < 0, low, -high))
    # The upper tail is the lower one mirrored.
    cut = library.where(u < 0, 1.0, -1.0) * special.ndtri(below)
    # Where no bound is near, lest a fit ends in the rounding of two quantiles.
    whole = library.isinf(low) & library.isinf(high)
    near = library.where((held == 1.0) & (library.abs(u) < _NEAR), u, cut)
    return library.where(whole, given, near)


@jax.custom_jvp
@jax.jit  # many operations, traced once and not wherever a space is used
def _cut_normal(u: Array, low: Array, high: Array) -> Array:
    return _quantile(u, low, high, jnp, jax.scipy.special)


@_cut_normal.defjvp
def _cut_normal_derivative(primals: Any, tangents: Any) -> tuple[Array, Array]:
    # By u alone: a space is not differentiated in its bounds.
    return _cut_normal(*primals), jnp.exp(_log_rate(*primals)) * tangents[0]


def _whole_normal(t: Array, low: Array, high: Array) -> Array:
    """Inverse of `_cut_normal`."""
    held = ndtr(-low) - ndtr(-high)
    # By the smaller tail, which keeps its digits.
    below, above = (ndtr(t) - ndtr(low)) / held, (ndtr(-t) - ndtr(-high)) / held
    return jnp.where(below < 0.5, ndtri(below), -ndtri(above))


@jax.jit
def _log_rate(u: Array, low: Array, high: Array) -> Array:
    """log d `_cut_normal` / d u."""
    whole = jnp.isinf(low) & jnp.isinf(high)
    near = jnp.clip(u, -_FAR, _FAR)
    t = _cut_normal(near, low, high)
    # Equal probabilities lie next to u and t: held * density(u) du = density(t) dt.
    rate = jnp.log(ndtr(-low) - ndtr(-high)) + norm.logpdf(near) - norm.logpdf(t)
    return jnp.where(whole, 0.0, rate)


@dataclass(frozen=True)
class _Prior:
    """The prior of one parameter, by its width: what `ParameterSpace` has of it, in numpy."""

    name: str
    lower: float
    upper: float
    median: float
    distribution: Distribution

    def __post_init__(self) -> None:
        if self.distribution not in get_args(Distribution):
            raise InputError(
                f"the prior of {self.name} must be one of {', '.join(get_args(Distribution))}, but "
                f"is {self.distribution!r}"
            )
        if not self.lower < self.median < self.upper:
            raise InputError(
                f"the prior of {self.name} must lie inside its bounds ({self.lower:g}, "
                f"{self.upper:g}), but is {self.median:g}"
            )
        if self.distribution == "lognormal" and self.median <= 0:
            raise InputError(
                f"the median of {self.name}, whose prior is lognormal, must be positive, but is "
                f"{self.median:g}"
            )
        if self.distribution == "logit-normal" and not np.isfinite([self.lower, self.upper]).all():
            raise InputError(f"{self.name} has a logit-normal prior, which needs finite bounds")

    @property
    def ends(self) -> tuple[float, float, float]:
        """z at the lower bound, the median and the upper bound; infinite where nothing is cut."""
        low, middle, high = self.lower, self.median, self.upper
        if self.distribution == "logit-normal":
            return -math.inf, math.log(middle - low) - math.log(high - middle), math.inf
        if self.distribution == "normal":
            return low, middle, high
        return math.log(low) if low > 0 else -math.inf, math.log(middle), math.log(high)

    def at(self, width: float) -> tuple[float, float, float]:
        """Location that puts the median where it is stated, and the cuts from there."""
        low, middle, high = self.ends

        def cuts(location: float) -> tuple[float, float]:
            return (low - location) / width, (high - location) / width

        def rest(location: float) -> float:
            return location + width * float(_quantile(0.0, *cuts(location), np, special)) - middle

        location, reach = middle, width
        if rest(middle) != 0.0:
            # Cuts move the median off the location: find where the stated one comes out.
            while rest(middle - reach) * rest(middle + reach) > 0.0 and reach < 64.0 * width:
                reach *= 2.0
            if rest(middle - reach) * rest(middle + reach) > 0.0:
                raise InputError(
                    f"the prior of {self.name} is too wide to have its median at "
                    f"{self.median:g} between {self.lower:g} and {self.upper:g}"
                )
            location = brentq(rest, middle - reach, middle + reach, xtol=1e-15)
        return (location, *cuts(location))

    def sd(self, width: float) -> float:
        """Standard deviation, by quadrature."""
        location, low, high = self.at(width)
        z = location + width * _quantile(_U, low, high, np, special)
        if self.distribution == "logit-normal":
            z = self.lower + (self.upper - self.lower) * special.expit(z)
        elif self.distribution == "lognormal":
            z = np.exp(z)
        # From the median, lest a narrow prior lose digits in a difference of squares.
        from_median = z - self.median
        return float(np.sqrt(_WEIGHT @ from_median**2 - (_WEIGHT @ from_median) ** 2))

    def width_of(self, sd: float) -> float:
        """Width that has a standard deviation."""
        about = sd  # over the slope of the value by z at the median
        if self.distribution == "lognormal":
            about = math.log1p(sd / self.median)
        elif self.distribution == "logit-normal":
            below, above = self.median - self.lower, self.upper - self.median
            about = sd * (below + above) / (below * above)
        high = about
        # Bounds squeeze a wide prior: beyond some width its deviation grows no more.
        while self.sd(high) < sd:
            high *= 2.0
            if high > _MOST_WIDTHS * about:
                raise InputError(
                    f"the prior of {self.name} has a standard deviation of {sd:g}, but a "
                    f"{self.distribution} one about {self.median:g} between {self.lower:g} and "
                    f"{self.upper:g} has at most {self.sd(high):.3g}"
                )
        low = high
        while self.sd(low) > sd:
            low *= 0.5
        return brentq(lambda w: self.sd(w) - sd, low, high, xtol=1e-14, rtol=1e-13)

    @property
    def widest(self) -> float:
        """Largest width that a fit is given: the prior has one mode and loses little to a cut.

        Of a logit-normal one, with z normal about m with standard deviation s, the modes solve
        z - m = s^2 tanh(z / 2). The right side is steepest, s^2 / 2, at z = 0: up to s^2 = 2 there
        is one solution wherever m is. Beyond, a second one appears where the two sides touch, at
        tanh(z / 2) = t with s^2 (1 - t^2) = 2, that is where |m| = 2 t / (1 - t^2) - 2 artanh t.
        """
        low, middle, high = self.ends
        if self.distribution != "logit-normal":
            held = min(middle - low, high - middle) / _CUT_BEYOND
            return held if self.distribution == "normal" else min(held, _WIDEST)
        m = abs(middle)
        t = brentq(lambda t: 2.0 * t / (1.0 - t**2) - 2.0 * math.atanh(t) - m, 0.0, 1.0 - 1e-9)
        return math.sqrt(2.0 / (1.0 - t**2))


_MOST_WIDTHS = 1e3
_AT_BOUND, _NEARER = 1e-3, 0.05
_CUT_BEYOND = 1.5
"""A bound cuts a prior of a fit at least so many widths from its median."""
_WIDEST = 1.2
"""Largest width of a lognormal prior: a factor of 3.3 either way."""
_INSET = 0.02
"""How far inside its bound the prior of a value there is centred [usual range]."""
_ROUNDING = 1e-6
"""A value so near its bound lies on it [usual range]."""


def make_space(
    values: dict[str, float],
    relative_sd: Mapping[str, float | None],
    correlation: Float[np.ndarray, "free free"] | None = None,
) -> ParameterSpace:
    """The space of the parameters in `values`, within the bounds of `fynjax.scene.PARAMETERS`.

    A prior has the distribution of its parameter's record, its median at the value and the stated
    standard deviation, in the parameter's own unit. One that is too wide has two modes (shares) or
    loses much to a bound. Such a prior is fitted into its bounds: its median moves to 2 % of the
    usual range inside where it is nearer to a bound, and its standard deviation is cut to the
    largest with one mode, and so that a bound lies 1.5 widths from the median. So is that of a
    value on its bound (dry soil, a leaf without anthocyanins), whose stated standard deviation, a
    share of the value, may be zero. A warning names the parameters with their stated and their
    fitted priors.

    **Arguments:**

    - `values`: the prior's median by name, in the parameters' own units, within the bounds.
    - `relative_sd`: the prior's standard deviation over its median by name, positive [-]; None
      takes that of the parameter's record.
    - `correlation`: of the priors; left out, what a prior of a trait is off by is partly common to
      the species of a plot (`Parameter.shared`).

    **Returns:** `ParameterSpace`, its parameters in the order of `values`.

    **Raises:** `InputError` for a value outside its bounds, and a parameter that has no prior.
    """
    columns, kinds, fitted = [], [], []
    for name, value in values.items():
        kind = parameter_kind(name)
        record = PARAMETERS.get(kind)
        own = None if record is None else record.prior_sd(value)
        if record is None or own is None:
            free = [k for k, known in PARAMETERS.items() if known.prior_sd(1.0) is not None]
            raise InputError(f"{name} cannot be free: only {', '.join(free)} can")
        record.check(value, f"the prior of {name}")
        relative = relative_sd[name]
        stated = own if relative is None else relative * abs(value)
        centre, sd = _fitted_prior(name, record, value, stated)
        if (centre, sd) != (value, stated):
            shown = [record.shown_factor * number for number in (value, stated, centre, sd)]
            change = "{:g} (sd {:.3g}) to {:g} (sd {:.3g})".format(*shown)
            unit = "" if record.shown_unit == "-" else f" {record.shown_unit}"
            fitted.append(f"{name} from {change}{unit}")
        columns.append((record.lower, record.upper, centre, sd))
        kinds.append(record.distribution)
    if fitted:
        warnings.warn(
            f"priors moved or narrowed, since their bounds do not hold them: {'; '.join(fitted)}",
            stacklevel=2,
        )
    limits = np.asarray(columns, float).reshape(-1, 4)
    if correlation is None:
        correlation = _correlation(list(values))
    return ParameterSpace(tuple(values), *limits.T, distribution=kinds, correlation=correlation)


def _correlation(names: Sequence[str]) -> Float[np.ndarray, "free free"] | None:
    """Correlation of the priors: a trait of one species with that of the others of the plot."""
    kinds = [parameter_kind(name) for name in names]
    shared = np.array([PARAMETERS[kind].shared for kind in kinds])
    if not shared.any():
        return None
    alike = np.array(kinds)[:, None] == np.array(kinds)
    matrix = np.where(alike, shared, 0.0)
    np.fill_diagonal(matrix, 1.0)
    return matrix


def _fitted_prior(name: str, record: Parameter, value: float, sd: float) -> tuple[float, float]:
    """Median and standard deviation of a prior that its bounds hold."""
    low, high = record.lower, record.upper
    usual = record.usual[1] - record.usual[0]
    on_bound = min(value - low, high - value) <= _ROUNDING * usual

    def widest(median: float) -> float:
        prior = _Prior(name, low, high, median, record.distribution)
        return prior.sd(prior.widest)

    if not on_bound and sd <= widest(value):
        return value, sd
    centre = min(max(value, low + _INSET * usual), high - _INSET * usual)
    return centre, widest(centre) if on_bound else min(sd, widest(centre))


def match_names(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """The `names` that fit one of the shell-style `patterns`, in their order.

    **Raises:** `InputError` for a pattern that fits none.
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(
                f"no parameter is called {pattern!r}; the names are such as {', '.join(names[:3])}"
            )
    return [name for name in names if any(fnmatchcase(name, p) for p in patterns)]
