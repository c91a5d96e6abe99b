"""Sensitivity of metrics to parameters: at a point by derivatives, over a range by variance."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import ndtri
from scipy.stats import qmc

from fynjax._core.checkpoint import Journal, keep_nothing
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.parts import Workers, at_work
from fynjax._core.progress import NullProgress, Progress
from fynjax.inversion._fit import Predict
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._vectorised import evaluate_many, memory_batch, value_and_jacobian

_BATCHES = 8
"""Batches of runs that are sent to a worker at once."""
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

    - `predict`, `context`: as `fit` has them.
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
    """By the parameter alone [-]."""
    first_error: Float[np.ndarray, "metric free"]
    """Half the 95 % interval of it, by bootstrap."""
    total: Float[np.ndarray, "metric free"]
    """With all its interactions [-]."""
    total_error: Float[np.ndarray, "metric free"]


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
    journal: Journal | None = None,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> SobolIndices:
    """First-order and total Sobol indices, by SALib (extra `sensitivity`).

    Saltelli's design on scrambled Sobol points: `samples` times (parameters + 2) runs.

    **Arguments:**

    - `predict`, `space`, `context`: as `fit` has them.
    - `metrics`: names of what `predict` gives.
    - `over`: "prior", or "bounds" for an even distribution between these.
    - `samples`: a power of two.
    - `seed`: of the design and the bootstrap.
    - `batch`: runs computed at once; what the memory holds by default.
    - `journal`: keeps what batches gave, for a run that is interrupted; nothing does by default.
    - `workers`: where batches are computed; in this process by default.
    - `progress`: where to report the runs; nowhere by default.

    **Returns:** `SobolIndices`.

    **Raises:** `InputError` for `samples` that is no power of two, and a metric that is not finite.
    """
    require("SALib", "sensitivity")
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as design

    _check(over, samples)
    model = _OverUnits(predict, space, context, over)
    size = len(space.names)
    problem = {"num_vars": size, "names": list(space.names), "bounds": [[0.0, 1.0]] * size}
    shares = design.sample(problem, samples, calc_second_order=False, seed=seed)
    values = _run(model, model, shares, metrics, batch, journal, workers, progress)
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
    journal: Journal | None = None,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> DerivativeMeasures:
    """Derivative-based global sensitivity measures (DGSM), with slopes by autodiff.

    A total Sobol index is at most C times the mean squared derivative over the variance, where C
    is the Poincaré constant of the parameter's distribution: 1 / pi^2 for an even one of unit
    range, 1 for a unit normal one (Sobol and Kucherenko 2009; Lamboni et al. 2013).

    **Arguments:** `predict`, `space`, `metrics`, `over`, `samples`, `context`, `seed`, `batch`,
    `journal`, `workers` and `progress` as `sobol_indices` has them. Takes `samples` runs with their
    Jacobians.

    **Returns:** `DerivativeMeasures`.

    **Raises:** `InputError` for `samples` that is no power of two, and where a metric or a slope is
    not finite.
    """
    _check(over, samples)
    model = _OverUnits(predict, space, context, over)
    shares = qmc.Sobol(len(space.names), rng=seed).random(samples)
    both = _run(_Slopes(model), model, shares, metrics, batch, journal, workers, progress)
    squared = both[..., 1:] ** 2
    variance = both[..., 0].var(axis=0)
    measure = squared.mean(axis=0)
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
    if samples < 2 or samples & (samples - 1):
        raise InputError(f"`samples` must be a power of two, such as 512, but is {samples}")


def _run(
    function: Callable[[Array], Array],
    model: _OverUnits,
    shares: np.ndarray,
    metrics: Sequence[str],
    batch: int | None,
    journal: Journal | None,
    workers: Workers | None,
    progress: Progress | None,
) -> np.ndarray:
    """`function` at all points, finite, its first axis after that of the points the metrics."""
    progress = NullProgress() if progress is None else progress
    points = model.coordinates(shares)
    count = jax.eval_shape(model, jnp.asarray(points[0])).size
    if count != len(metrics):
        raise InputError(f"{len(metrics)} metrics are named, but `predict` gives {count}")
    if batch is None:  # as in the run that was interrupted, whatever memory is free by now
        keep = keep_nothing if journal is None else journal
        batch = int(keep(lambda: (jnp.asarray(memory_batch(function, points[0])),))[0])
    some = _BATCHES * batch
    cut = [points[first : first + some] for first in range(0, len(points), some)]
    names = [f"runs {i * some + 1} to {i * some + len(p)}" for i, p in enumerate(cut)]
    with progress.stage("Run the model", len(points)), at_work(workers) as pool:
        found = pool.all(
            _values, cut, function, batch,
            names=names, sizes=[*map(len, cut)], journal=journal, progress=progress,
        )  # fmt: skip
    values = np.concatenate([values for (values,) in found]).astype(float)
    bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    if bad.any():
        raise InputError(
            f"{int(bad.sum())} of {len(points)} runs gave a metric or a slope that is not finite: "
            "is a parameter at the end of its range? Narrow its prior"
        )
    return values


def _values(
    points: np.ndarray, function: Callable[[Array], Array], batch: int
) -> tuple[np.ndarray]:
    return (evaluate_many(function, points, batch=batch),)
