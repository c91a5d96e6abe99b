"""Sensitivity of metrics to parameters: at a point by derivatives, for one scene or as a mean over
plantings; over a range by variance."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import ndtri, stdtrit

from fynjax._core.errors import InputError, whole_number
from fynjax._core.extras import require
from fynjax._core.parts import Do, in_order
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.inversion._fit import Predict
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._vectorised import evaluate_many, memory_batch, value_and_jacobian

_BATCHES = 8
"""Batches of runs that are sent to a worker at once."""
LEADING_ELASTICITIES = 3
"""So many elasticities of a metric, the largest in size, are its leading ones."""
_PLANTINGS = 8
"""Plantings after which errors are looked at, and again after as many more."""
Over = Literal["prior", "bounds"]
"""What a parameter ranges over: its prior, or evenly over its bounds."""


class LocalSensitivity(eqx.Module):
    """Slopes of metrics at one set of parameters."""

    names: tuple[str, ...] = eqx.field(static=True)
    metrics: tuple[str, ...] = eqx.field(static=True)
    at: Float[np.ndarray, " free"]
    """The parameters, in their own units."""
    value: Float[np.ndarray, " metric"]
    jacobian: Float[np.ndarray, "metric free"]
    """Change of the metric by that of the parameter, both in their own units."""
    elasticity: Float[np.ndarray, "metric free"]
    """Relative change of the metric by the relative change of the parameter [-]; NaN where the
    metric is zero."""


@double_precision
def local_sensitivity(
    predict: Predict,
    names: Sequence[str],
    metrics: Sequence[str],
    at: Float[np.ndarray, " free"],
    *,
    context: tuple[Any, ...] = (),
    mode: str = "auto",
) -> LocalSensitivity:
    """Jacobian and elasticities of `predict` at the parameters `at`, in their own units.

    **Arguments:**

    - `predict`, `context`: as `fit` has them. Of a plot, the context is one scene, and so one
      planting: `expected_sensitivity` is of all that could be.
    - `names`: of the parameters.
    - `metrics`: names of what `predict` gives.
    - `at`: the parameters, in their own units.
    - `mode`: of differentiation, "forward", "reverse" or "auto": the one of fewer runs.

    **Returns:** `LocalSensitivity`.

    **Raises:** `InputError` if the numbers of names differ from those of values.
    """
    point = jnp.asarray(at, float)
    if point.shape != (len(names),):
        raise InputError(f"{len(names)} parameters are named, but `at` has shape {point.shape}")
    value, jacobian = _slopes(predict, context, point, mode)
    if value.shape != (len(metrics),):
        raise InputError(f"{len(metrics)} metrics are named, but `predict` gives {value.shape}")
    found, slopes = np.asarray(value, float), np.asarray(jacobian, float)
    scale = np.where(found == 0.0, np.nan, found)
    return LocalSensitivity(
        tuple(names),
        tuple(metrics),
        np.asarray(point),
        found,
        slopes,
        slopes * np.asarray(point) / scale[:, None],
    )


@eqx.filter_jit
def _slopes(predict: Predict, context: Any, point: Array, mode: str) -> tuple[Array, Array]:
    return value_and_jacobian(lambda x: predict(x, *context), point, mode=mode)


class ExpectedSensitivity(eqx.Module):
    """Slopes of the expectation of metrics over plantings, at one set of parameters."""

    names: tuple[str, ...] = eqx.field(static=True)
    metrics: tuple[str, ...] = eqx.field(static=True)
    at: Float[np.ndarray, " free"]
    """The parameters, in their own units."""
    plantings: int
    """Number of plantings that gave the means and their errors."""
    value: Float[np.ndarray, " metric"]
    """Mean over the plantings."""
    value_sd: Float[np.ndarray, " metric"]
    """Standard deviation between plantings."""
    jacobian: Float[np.ndarray, "metric free"]
    """Change of the mean by that of the parameter, both in their own units."""
    jacobian_error: Float[np.ndarray, "metric free"]
    """Standard error of it."""
    elasticity: Float[np.ndarray, "metric free"]
    """Relative change of the mean by the relative change of the parameter [-]; NaN where the mean
    is zero."""
    elasticity_error: Float[np.ndarray, "metric free"]
    """Standard error of it: that of a ratio of two means, by the delta method."""

    @property
    def quantile(self) -> float:
        """Half of a 95 % interval, in standard errors: Student's t for the number of plantings."""
        return float(stdtrit(self.plantings - 1, 0.975))

    @property
    def distinguished(self) -> Bool[np.ndarray, "metric free"]:
        """Whether the 95 % interval of a slope leaves out zero. That of one slope in twenty does
        where the true slope is zero."""
        return np.abs(self.jacobian) > self.quantile * self.jacobian_error

    @property
    def leading_error(self) -> Float[np.ndarray, " metric"]:
        """Largest relative standard error of each metric's leading elasticities [-], of which
        `LEADING_ELASTICITIES` says how many there are."""
        size = np.abs(self.elasticity)
        known = size > 0
        relative = np.where(known, self.elasticity_error / np.where(known, size, 1.0), 0.0)
        first = np.argsort(-size, axis=1)[:, :LEADING_ELASTICITIES]
        return np.take_along_axis(relative, first, axis=1).max(axis=1)


@double_precision
def expected_sensitivity(
    predict: Predict,
    names: Sequence[str],
    metrics: Sequence[str],
    at: Float[np.ndarray, " free"],
    planting: Callable[[int], tuple[Any, ...]],
    *,
    accuracy: float = 0.1,
    most: int = 64,
    do: Do = in_order,
) -> ExpectedSensitivity:
    """Slopes and elasticities of the expectation of `predict` over plantings, with their errors.

    Slopes are means over the plantings 0, 1, 2 and so on; the elasticity of a metric's expectation
    is the mean slope times the parameter over the mean metric. Every eight plantings the errors are
    looked at, and the run ends where those of the leading elasticities of all metrics are small
    enough.

    **Arguments:**

    - `predict`, `names`, `metrics`, `at`: as `local_sensitivity` has them.
    - `planting`: makes the context of `predict`, such as a scene, from the number of a planting.
      Plantings must be independent of each other.
    - `accuracy`: standard error of a leading elasticity, as a share of it, at which the run ends.
    - `most`: plantings, at most; at least 2.
    - `do`: how plantings are done; one after another in this process by default.

    **Returns:** `ExpectedSensitivity`, whose `leading_error` says how near the errors came.

    **Raises:** `InputError` as `local_sensitivity`, for `most` below 2, and where a metric or a
    slope is not finite.
    """
    if most < 2:
        raise InputError(f"an error needs at least 2 plantings, but {most} are allowed")
    done: list[tuple[np.ndarray, ...]] = []
    while True:
        # Always the same plantings in the same order: a run with more goes on from one with fewer.
        next_ones = range(len(done), min(len(done) + _PLANTINGS, most))
        name = f"Slopes of plantings {next_ones[0] + 1} to {next_ones[-1] + 1}"
        with stage(name, len(next_ones)):
            done += do(
                _slopes_of_planting, next_ones, planting, predict, names, metrics, at,
                names=[f"planting {i + 1}" for i in next_ones],
            )  # fmt: skip
        values, slopes = (np.stack(part) for part in zip(*done, strict=True))
        found = _expected(tuple(names), tuple(metrics), np.asarray(at, float), values, slopes)
        if len(done) >= most or (found.leading_error <= accuracy).all():
            return found


def _slopes_of_planting(
    number: int,
    planting: Callable[[int], tuple[Any, ...]],
    predict: Predict,
    names: Sequence[str],
    metrics: Sequence[str],
    at: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    local = local_sensitivity(predict, names, metrics, at, context=planting(number))
    if not (np.isfinite(local.value).all() and np.isfinite(local.jacobian).all()):
        raise InputError("a metric or its slope is not finite at these parameters")
    return local.value, local.jacobian


def _expected(
    names: tuple[str, ...],
    metrics: tuple[str, ...],
    at: np.ndarray,
    values: Float[np.ndarray, "planting metric"],
    slopes: Float[np.ndarray, "planting metric free"],
) -> ExpectedSensitivity:
    """Means over plantings, with their errors."""

    def error(one_each: np.ndarray) -> np.ndarray:
        return one_each.std(axis=0, ddof=1) / np.sqrt(len(values))

    value, jacobian = values.mean(axis=0), slopes.mean(axis=0)
    scale = np.where(value == 0.0, np.nan, value)[:, None]
    elasticity = jacobian * at / scale
    # To first order, what each planting moves the ratio of the means by.
    moved = (slopes * at - elasticity * values[:, :, None]) / scale
    return ExpectedSensitivity(
        names,
        metrics,
        at,
        len(values),
        value,
        values.std(axis=0, ddof=1),
        jacobian,
        error(slopes),
        elasticity,
        error(moved),
    )


class _OverUnits(eqx.Module):
    """A forward model as a function of independent coordinates of known distribution."""

    predict: Predict
    space: ParameterSpace
    context: tuple[Any, ...]
    over: Over = eqx.field(static=True)

    def __call__(self, coordinate: Array) -> Array:
        if self.over == "prior":  # unit normals: indices are of one parameter each
            values = self.space.alone(coordinate)
        else:  # 0 to 1
            values = self.space.lower + (self.space.upper - self.space.lower) * coordinate
        return self.predict(values, *self.context)

    def coordinates(self, shares: np.ndarray) -> np.ndarray:
        """From points that fill the unit cube evenly."""
        if self.over == "bounds":
            return shares
        return ndtri(np.clip(shares, 1e-9, 1 - 1e-9))


class _Slopes(eqx.Module):
    """Value and Jacobian of a function, side by side in one array [value, 1 + free]."""

    function: Callable[[Array], Array]

    def __call__(self, point: Array) -> Array:
        value, jacobian = value_and_jacobian(self.function, point)
        return jnp.concatenate([value[:, None], jacobian], axis=1)


class SobolIndices(eqx.Module):
    """Shares of a metric's variance that parameters explain (Sobol 2001)."""

    names: tuple[str, ...] = eqx.field(static=True)
    metrics: tuple[str, ...] = eqx.field(static=True)
    variance: Float[np.ndarray, " metric"]
    first: Float[np.ndarray, "metric free"]
    """Share of each metric's variance by each parameter alone [-]."""
    first_error: Float[np.ndarray, "metric free"]
    """Half the 95 % interval of `first`, by bootstrap [-]."""
    total: Float[np.ndarray, "metric free"]
    """Share of each metric's variance by each parameter with all its interactions [-]."""
    total_error: Float[np.ndarray, "metric free"]


@double_precision
def sobol_indices(
    predict: Predict,
    space: ParameterSpace,
    metrics: Sequence[str],
    *,
    over: Over = "prior",
    samples: int = 512,
    context: tuple[Any, ...] = (),
    seed: int = 0,
    batch: int | None = None,
    do: Do = in_order,
) -> SobolIndices:
    """First-order and total Sobol indices, by SALib (extra `analysis`).

    Saltelli's design on scrambled Sobol points: `samples` times (parameters + 2) runs.

    **Arguments:**

    - `predict`, `space`, `context`: as `fit` has them.
    - `metrics`: names of what `predict` gives.
    - `over`: "prior", or "bounds" for an even distribution between these.
    - `samples`: a power of two.
    - `seed`: of the design and the bootstrap.
    - `batch`: runs computed at once; what the memory holds by default.
    - `do`: how batches are done; one after another in this process by default.

    **Returns:** `SobolIndices`.

    **Raises:** `InputError` for `samples` that is no power of two, and a metric that is not finite.
    """
    require("SALib", "analysis")
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as design

    _check(over, samples)
    model = _OverUnits(predict, space, context, over)
    size = len(space.names)
    problem = {"num_vars": size, "names": list(space.names), "bounds": [[0.0, 1.0]] * size}
    whole_number("seed", seed)
    shares = design.sample(problem, samples, calc_second_order=False, seed=seed)
    values = _run(model, model, shares, metrics, batch, do)
    found: dict[str, list[np.ndarray]] = {key: [] for key in ("S1", "S1_conf", "ST", "ST_conf")}
    for column in values.T:
        if np.ptp(column) == 0.0:  # nothing to share out
            rows: Any = dict.fromkeys(found, np.zeros(size))
        else:
            rows = analysis.analyze(  # whose bootstrap takes a seed of 0 for none
                problem, column, calc_second_order=False, print_to_console=False, seed=seed + 1
            )
        for key, one in found.items():
            one.append(np.asarray(rows[key], float))
    return SobolIndices(
        space.names, tuple(metrics), values.var(axis=0), *(np.stack(one) for one in found.values())
    )


class DerivativeMeasures(eqx.Module):
    """Mean squared slopes over a range, which bound the total Sobol indices."""

    names: tuple[str, ...] = eqx.field(static=True)
    metrics: tuple[str, ...] = eqx.field(static=True)
    variance: Float[np.ndarray, " metric"]
    measure: Float[np.ndarray, "metric free"]
    """Mean squared derivative by the parameter counted in its range (`over` "bounds") or in its
    prior's standard deviations ("prior")."""
    error: Float[np.ndarray, "metric free"]
    """Standard error of `measure`, as if the points were independent."""
    bound: Float[np.ndarray, "metric free"]
    """No total Sobol index is larger [-]."""


@double_precision
def derivative_measures(
    predict: Predict,
    space: ParameterSpace,
    metrics: Sequence[str],
    *,
    over: Over = "prior",
    samples: int = 256,
    context: tuple[Any, ...] = (),
    seed: int = 0,
    batch: int | None = None,
    do: Do = in_order,
) -> DerivativeMeasures:
    """Derivative-based global sensitivity measures (DGSM), with slopes by autodiff.

    A total Sobol index is at most C times the mean squared derivative over the variance, where C
    is the Poincaré constant of the parameter's distribution: 1 / pi^2 for an even one of unit
    range, 1 for a unit normal one (Sobol and Kucherenko 2009; Lamboni et al. 2013).

    **Arguments:** `predict`, `space`, `metrics`, `over`, `samples`, `context`, `seed`, `batch` and
    `do` as `sobol_indices` has them. Takes `samples` runs with their Jacobians.

    **Returns:** `DerivativeMeasures`.

    **Raises:** `InputError` for `samples` that is no power of two, and where a metric or a slope is
    not finite.
    """
    from scipy.stats import qmc  # late: it takes half a second

    _check(over, samples)
    model = _OverUnits(predict, space, context, over)
    shares = qmc.Sobol(len(space.names), rng=whole_number("seed", seed)).random(samples)
    both = _run(_Slopes(model), model, shares, metrics, batch, do)
    squared = both[..., 1:] ** 2
    variance = both[..., 0].var(axis=0)
    measure = squared.mean(axis=0)
    # Poincaré constants of a unit normal, and of an even distribution of unit length.
    constant = 1.0 if over == "prior" else 1.0 / np.pi**2
    safe = np.where(variance > 0, variance, 1.0)[:, None]
    return DerivativeMeasures(
        space.names,
        tuple(metrics),
        variance,
        measure,
        squared.std(axis=0, ddof=1) / np.sqrt(samples),
        np.where(variance[:, None] > 0, constant * measure / safe, 0.0),
    )


def _check(over: str, samples: int) -> None:
    if over not in ("prior", "bounds"):
        raise InputError(f"`over` must be 'prior' or 'bounds', but is {over!r}")
    check_samples(samples)


def check_samples(samples: int) -> None:
    """Raise `InputError` unless `samples` over the priors is a power of two, 2 or more."""
    if samples < 2 or samples & (samples - 1):
        raise InputError(f"`samples` must be a power of two, such as 512, but is {samples}")


def _run(
    function: Callable[[Array], Array],
    model: _OverUnits,
    shares: np.ndarray,
    metrics: Sequence[str],
    batch: int | None,
    do: Do,
) -> np.ndarray:
    """`function` at all points, finite, its first axis after that of the points the metrics."""
    points = model.coordinates(shares)
    count = jax.eval_shape(model, jnp.asarray(points[0])).size
    if count != len(metrics):
        raise InputError(f"{len(metrics)} metrics are named, but `predict` gives {count}")
    if batch is None:  # a part too: one run has one, whatever memory is free when it goes on
        ((found,),) = do(_memory, [points[0]], function, names=["memory"], sizes=[0])
        batch = int(found)
    # A part is several batches, so that what is sent to a worker is worth the way.
    some = _BATCHES * batch
    cut = [points[first : first + some] for first in range(0, len(points), some)]
    names = [f"runs {i * some + 1} to {i * some + len(p)}" for i, p in enumerate(cut)]
    with stage("Run the model", len(points)):
        done = do(_values, cut, function, batch, names=names, sizes=[*map(len, cut)])
    values = np.concatenate([values for (values,) in done]).astype(float)
    bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    if bad.any():
        raise InputError(
            f"{int(bad.sum())} of {len(points)} runs gave a metric or a slope that is not finite: "
            "is a parameter at the end of its range? Narrow its prior"
        )
    return values


@double_precision
def _memory(point: np.ndarray, function: Callable[[Array], Array]) -> tuple[np.ndarray]:
    return (np.asarray(memory_batch(function, point)),)


@double_precision
def _values(
    points: np.ndarray, function: Callable[[Array], Array], batch: int
) -> tuple[np.ndarray]:
    return (evaluate_many(function, points, batch=batch),)
