"""How well the spectra of plots tell of the diversity of what stands there."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError, listed
from fynjax._core.resampling import DRAWS, INTERVAL, correlation_over, plot_draws

FEWEST_PLOTS = 5
"""Plots that a score over plots needs, at least."""
_PENALTIES = np.logspace(-5, 2, 15)
"""Penalties of a regression that are tried, over the spectra's mean square."""
_LEAST_SIZE = 1e-200
"""Mean square that penalties are taken over where all spectra are the same."""


def metric_agreement(
    metrics: Mapping[str, ArrayLike], diversity: Mapping[str, ArrayLike], *, seed: int = 0
) -> pd.DataFrame:
    """Correlation over plots of each spectral metric with each diversity.

    **Arguments:**

    - `metrics`: of the plots' spectra, by name; [plot] each, NaN where not known.
    - `diversity`: of what stands there, by name; [plot] each, NaN where not known.
    - `seed`: of the draws.

    **Returns:** a row for each diversity and metric: `value`, the correlation [-]; `q05` and `q95`,
    its interval over bootstrapped plots; `p_value`, the probability that plots exchanged have one
    as large, of either sign; and `p_of_all`, that the largest of all metrics then is as large
    (Westfall and Young 1993): the best of many metrics is large by accident. NaN of what does not
    vary.

    **Raises:** `InputError` for fewer than five plots, numbers that differ, and no metric.

    >>> import numpy as np
    >>> from fynjax.diversity import metric_agreement
    >>> shannon = np.array([0.2, 0.5, 0.9, 1.1, 1.6, 2.0])
    >>> table = metric_agreement({"variance": 3.0 * shannon}, {"shannon": shannon})
    >>> round(float(table["value"][0]), 3), bool(table["p_value"][0] < 0.01)
    (1.0, True)
    """
    if not metrics:
        raise InputError("expected one metric or more, but got none")
    count = _plot_count(metrics, diversity)
    drawn, exchanged = plot_draws(count, seed)
    rows = []
    for asked, values in diversity.items():
        y = np.asarray(values, np.float64)
        found = {name: np.asarray(x, np.float64) for name, x in metrics.items()}
        by_chance = [np.abs(correlation_over(x, y[exchanged])) for x in found.values()]
        greatest = np.max(np.nan_to_num(by_chance), axis=0)
        for (name, x), chance in zip(found.items(), by_chance, strict=True):
            of_draws = correlation_over(x[drawn], y[drawn])
            size = abs(of_draws[0])
            row = {"diversity": asked, "metric": name} | _with_interval(of_draws)
            rows.append(row | {"p_value": _p(size, chance), "p_of_all": _p(size, greatest)})
    return pd.DataFrame(rows)


def regression_agreement(
    spectra: ArrayLike, diversity: Mapping[str, ArrayLike], *, seed: int = 0
) -> pd.DataFrame:
    """Skill of a regression from the spectra of plots to each diversity, of plots left out.

    Ridge regression, whose penalty is chosen, for each plot left out, by leaving out each of the
    others.

    **Arguments:**

    - `spectra`: [plot, band], finite; mostly `normalise_brightness` of them.
    - `diversity`, `seed`: as for `metric_agreement`.

    **Returns:** a row for each diversity: `value`, the skill 1 - squared error over that of the
    mean of the other plots [-]: 1 is perfect, 0 no better than that mean; `q05` and `q95`, its
    interval over bootstrapped predictions; and `p_value`, the probability that plots exchanged have
    a skill as large.

    **Raises:** `InputError` as `metric_agreement`, and for spectra with NaN or infinity.

    >>> import numpy as np
    >>> from fynjax.diversity import regression_agreement
    >>> spectra = np.random.default_rng(0).normal(size=(12, 3))
    >>> skill = regression_agreement(spectra, {"shannon": spectra @ [1.0, 0.5, 0.0]})["value"][0]
    >>> bool(skill > 0.99)
    True
    """
    data = np.asarray(spectra, np.float64)
    if data.ndim != 2 or not np.isfinite(data).all():
        raise InputError(f"expected finite spectra [plot, band], but got shape {data.shape}")
    _plot_count({"spectra": data[:, 0]}, diversity)
    rows = []
    for asked, values in diversity.items():
        y = np.asarray(values, np.float64)
        known = np.flatnonzero(np.isfinite(y))
        if len(known) < FEWEST_PLOTS or not np.ptp(y[known]) > 0.0:
            none = dict.fromkeys(("value", "q05", "q95", "p_value"), np.nan)
            rows.append({"diversity": asked} | none)
            continue
        drawn, exchanged = plot_draws(len(known), seed)
        # The values themselves first, then all exchanges of plots, as columns of one regression.
        every = y[known][np.concatenate([np.arange(len(known))[None], exchanged])].T
        error = (_left_out_by_ridge(data[known], every) - every) ** 2
        base = ((every.sum(axis=0) - every) / (len(known) - 1) - every) ** 2
        skill = 1.0 - error.sum(axis=0) / base.sum(axis=0)
        of_draws = 1.0 - error[drawn, 0].sum(axis=1) / base[drawn, 0].sum(axis=1)
        row = {"diversity": asked} | _with_interval(of_draws)
        rows.append(row | {"p_value": _p(skill[0], skill[1:])})
    return pd.DataFrame(rows)


def mantel(first: ArrayLike, second: ArrayLike, *, seed: int = 0) -> dict[str, float]:
    """Mantel's correlation of two distances between plots, such as of their spectra and species.

    **Arguments:** `first`, `second`: [plot, plot], symmetric, of any unit; `seed`: of the draws.

    **Returns:** `value`, the correlation over pairs of plots [-]; `q05` and `q95`, its interval
    over bootstrapped plots, without pairs of a plot and itself; `p_value`, the probability that
    plots exchanged have one as large.

    **Raises:** `InputError` for fewer than five plots, and distances of other shapes.

    Source: Mantel (1967), Cancer Research 27, 209.
    """
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[0] != a.shape[1] or len(a) < FEWEST_PLOTS:
        raise InputError(
            f"expected two distances [plot, plot] of at least {FEWEST_PLOTS} plots, but got the "
            f"shapes {a.shape} and {b.shape}"
        )
    drawn, exchanged = plot_draws(len(a), seed)
    i, j = np.triu_indices(len(a), 1)

    def pairs(distance: np.ndarray, places: np.ndarray) -> np.ndarray:
        x, y = places[:, i], places[:, j]
        return np.where(x == y, np.nan, distance[x, y])

    chance = correlation_over(pairs(a, drawn[:1])[0], pairs(b, exchanged))
    of_draws = correlation_over(pairs(a, drawn), pairs(b, drawn))
    return _with_interval(of_draws) | {"p_value": _p(of_draws[0], chance)}


def _plot_count(metrics: Mapping[str, ArrayLike], diversity: Mapping[str, ArrayLike]) -> int:
    shapes = {np.shape(values) for values in (*metrics.values(), *diversity.values())}
    shape = shapes.pop() if len(shapes) == 1 else ()
    if len(shape) != 1 or shape[0] < FEWEST_PLOTS:
        raise InputError(
            "expected metrics and diversities of the same plots, a number a plot each, of at least "
            f"{FEWEST_PLOTS} plots, but got arrays of shapes {listed(map(str, shapes or {shape}))}"
        )
    return int(shape[0])


def _with_interval(of_draws: Float[np.ndarray, " draw"]) -> dict[str, float]:
    """The first value, and the interval of all."""
    if not np.isfinite(of_draws[0]):
        return dict.fromkeys(("value", "q05", "q95"), np.nan)
    low, high = np.nanquantile(of_draws[1:], INTERVAL)
    return {"value": float(of_draws[0]), "q05": float(low), "q95": float(high)}


def _p(value: float, by_chance: Float[np.ndarray, " draw"]) -> float:
    if not np.isfinite(value):
        return np.nan
    return float((1.0 + np.sum(by_chance >= value - 1e-12 * abs(value))) / (1.0 + DRAWS))


def _left_out_by_ridge(
    spectra: Float[np.ndarray, "plot band"], values: Float[np.ndarray, "plot draw"]
) -> Float[np.ndarray, "plot draw"]:
    """Values that each plot's spectrum predicts from the values of all other plots.

    The residual of a plot left out follows from that of the fit with it, over 1 less its leverage
    (Golub, Heath and Wahba 1979, Technometrics 21, 215).
    """
    predicted = np.empty_like(values)
    for plot in range(len(spectra)):
        others = np.arange(len(spectra)) != plot
        mean, centre = values[others].mean(axis=0), spectra[others].mean(axis=0)
        x, y = spectra[others] - centre, values[others] - mean
        # Plots are fewer than bands: the dual form, of one matrix for all penalties.
        size, axes = np.linalg.eigh(x @ x.T)
        size = np.maximum(size, 0.0)
        along = axes.T @ y
        weights = (spectra[plot] - centre) @ x.T @ axes
        least, best = np.full(values.shape[1], np.inf), np.zeros(values.shape[1])
        for penalty in _PENALTIES * max(size.mean(), _LEAST_SIZE):
            kept = size / (size + penalty)
            # That of the mean, and that of the regression.
            leverage = 1.0 / len(x) + axes**2 @ kept
            residual = y - axes @ (kept[:, None] * along)
            error = ((residual / (1.0 - leverage)[:, None]) ** 2).sum(axis=0)
            better = error < least
            least = np.where(better, error, least)
            best = np.where(better, (weights / (size + penalty)) @ along, best)
        predicted[plot] = mean + best
    return predicted
