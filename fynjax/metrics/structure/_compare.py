"""What comparing two clouds takes besides metrics: grain, density, intervals, distributions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fynjax._core.errors import InputError
from fynjax.metrics.structure._metrics import CellGrid, CellStructure

LEAST_RETURNS = 5
"""Returns with which a cell counts, in the paper's rule."""
LEAST_CELLS = 0.9
"""Share of a plot's cells that must count, in the paper's rule [-]."""
MEDIAN_RETURNS = 30
"""Median of the returns of cells, at least, in the paper's rule."""
LARGEST_CHANGE = 0.1
"""Change of metrics to the next larger grain, in their median, up to which a grain is taken [-].
The paper prints no limit; it took 2 m at 6.1 % and not 1 m at 17.9 %, and this lies between."""


@dataclass(frozen=True)
class GrainCheck:
    """One grain size under the paper's rule."""

    grain: float
    """Side of a cell [m]."""
    cells: int
    """Whole cells in the plot."""
    counted_share: float
    """Share of cells with enough returns [-]."""
    least_returns: int
    """Returns in the emptiest cell."""
    median_returns: float
    """Median of the returns of cells."""
    fits: bool
    """Whether enough cells count and their median is high enough."""
    median_change: float | None
    """Median over metrics of the change of their mean to the next larger grain, over its value
    here [-]; none for the largest grain."""
    largest_change: float | None
    """The largest of these changes [-]."""
    bounds: tuple[float, float, float, float] = (np.nan,) * 4
    """Edges of its whole cells [m]: west, south, east, north."""


def choose_grain(
    structures: Sequence[CellStructure],
    *,
    least_returns: int = LEAST_RETURNS,
    least_cells: float = LEAST_CELLS,
    median_returns: float = MEDIAN_RETURNS,
    largest_change: float | None = LARGEST_CHANGE,
) -> tuple[CellGrid, tuple[GrainCheck, ...]]:
    """The grain by the paper's rule, and how each of those tried did.

    A grain fits if at least `least_cells` of its cells have `least_returns` or more, and the median
    cell `median_returns` or more. Of those that fit, the smallest is taken whose metrics change no
    more than `largest_change` [-], in the median over metrics, to the next larger grain. Where none
    does, or with `None`, it is the one whose metrics change least, the smaller one of equals. The
    largest grain has no next one: it is taken where no other fits.

    Least change alone takes any grain of several, by chance: large ones hold so few cells that a
    change can be small, and cut off more of the plot.

    **Arguments:**

    - `structures`: of one cloud, with grains that grow.
    - `least_returns`: returns with which a cell counts.
    - `least_cells`: share of cells that must count [-], 0 to 1.
    - `median_returns`: median of the returns of cells, at least.
    - `largest_change`: change of metrics up to which a grain is taken [-]; None takes the least.

    **Returns:** cells of the grain chosen, and a `GrainCheck` for each of `structures`. Not
    differentiable.

    **Raises:** `InputError` if no grain fits; the message lists what each of them lacks.
    """
    checks = check_grains(
        structures,
        least_returns=least_returns,
        least_cells=least_cells,
        median_returns=median_returns,
    )
    fitting = [c for c in checks if c.fits]
    if not fitting:
        tried = "; ".join(
            f"{c.grain:g} m: {100 * c.counted_share:.0f} % of {c.cells} cells have "
            f"{least_returns}, median {c.median_returns:g}"
            for c in checks
        )
        raise InputError(
            f"no grain has {least_returns} returns in {100 * least_cells:.0f} % of its cells and "
            f"a median of {median_returns:g} ({tried}). Try larger grains (`grains`), or state one "
            "(`grain`; --grain)."
        )
    known = [c for c in fitting if c.median_change is not None]
    if largest_change is not None:
        steady = [c for c in known if c.median_change <= largest_change]  # type: ignore[operator]
        known = steady[:1] or known
    chosen = min(known, key=lambda c: c.median_change or 0.0) if known else fitting[-1]
    return structures[checks.index(chosen)].grid, checks


def check_grains(
    structures: Sequence[CellStructure],
    *,
    least_returns: int = LEAST_RETURNS,
    least_cells: float = LEAST_CELLS,
    median_returns: float = MEDIAN_RETURNS,
) -> tuple[GrainCheck, ...]:
    """How each grain does under the paper's rule.

    **Arguments:**

    - `structures`: of one cloud, with grains that grow.
    - `least_returns`, `least_cells`, `median_returns`: as in `choose_grain`.

    **Raises:** `InputError` for grains that do not grow.
    """
    grains = [structure.grid.grain for structure in structures]
    if not grains or any(b <= a for a, b in pairwise(grains)):
        raise InputError(f"grains must grow, but are {grains}")
    means = [structure.means(least_returns) for structure in structures]
    checks = []
    for i, structure in enumerate(structures):
        number = structure.returns
        share = float(structure.counted(least_returns).mean())
        middle = float(np.median(number))
        changes = []
        if i + 1 < len(structures):
            for name, value in means[i].items():
                change = abs(means[i + 1][name] - value)
                if np.isfinite(change) and value != 0.0:
                    changes.append(change / abs(value))
        checks.append(
            GrainCheck(
                grain=grains[i],
                cells=number.size,
                counted_share=share,
                least_returns=int(number.min()),
                median_returns=middle,
                fits=share >= least_cells and middle >= median_returns,
                median_change=float(np.median(changes)) if changes else None,
                largest_change=max(changes) if changes else None,
                bounds=structure.grid.bounds,
            )
        )
    return tuple(checks)


def thinnings(
    returns: int, target: int, repetitions: int, rng: np.random.Generator
) -> Iterator[NDArray[np.int64]]:
    """Random subsets of a cloud's returns, each of the same size.

    **Arguments:**

    - `returns`: number of returns of the cloud.
    - `target`: number of returns of each subset, 1 to `returns`.
    - `repetitions`: number of subsets.
    - `rng`: source of the draws.

    **Returns:** an iterator over the indices of each subset, increasing, drawn without replacement.

    **Raises:** `InputError` if there are fewer returns than `target`.
    """
    if not 0 < target <= returns:
        raise InputError(f"cannot thin {returns} returns to {target}")
    for _ in range(repetitions):
        yield np.sort(rng.choice(returns, target, replace=False, shuffle=False))


def central_interval(values: ArrayLike, confidence: float = 0.95) -> tuple[float, float]:
    """The central part of a sample, by quantiles.

    **Arguments:**

    - `values`: of any unit.
    - `confidence`: share of the values inside [-], 0 to 1.

    **Returns:** lower and upper end, in the unit of the values.
    """
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(np.asarray(values, np.float64), [tail, 100.0 - tail])
    return float(low), float(high)


def bootstrap_interval(
    values: ArrayLike,
    *,
    resamples: int = 1000,
    confidence: float = 0.95,
    rng: np.random.Generator,
) -> tuple[float, float] | None:
    """Percentile interval of the mean over cells, by resampling cells (Efron 1979).

    Cells are taken as independent; neighbours that are alike make the interval too narrow.

    **Arguments:**

    - `values`: one a cell, of any unit.
    - `resamples`: number of resamples.
    - `confidence`: probability that the interval covers [-], 0 to 1.
    - `rng`: source of the draws.

    **Returns:** lower and upper end, in the unit of the values; None for fewer than two cells.
    """
    from scipy.stats import bootstrap

    cells = np.asarray(values, np.float64)
    if cells.size < 2:
        return None
    interval = bootstrap(
        (cells,),
        np.mean,
        n_resamples=resamples,
        confidence_level=confidence,
        method="percentile",
        rng=rng,
        batch=max(1, 10_000_000 // cells.size),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def height_percentiles(height: ArrayLike, percents: Sequence[float]) -> NDArray[np.float64]:
    """Percentiles of heights [m] by linear interpolation (type 7 of R, NumPy's default).

    **Arguments:**

    - `height`: of returns above the ground [m].
    - `percents`: 0 to 100.
    """
    return np.percentile(np.asarray(height, np.float64), percents)


def height_shares(height: ArrayLike, width: float, bins: int) -> NDArray[np.float64]:
    """Share of returns in each bin of heights [-].

    **Arguments:**

    - `height`: of returns above the ground [m].
    - `width`: height of a bin [m], positive; bins begin at the ground.
    - `bins`: number of bins; higher returns count in the last.
    """
    # As for layers, what is a rounding error below an edge is on it.
    index = np.floor(np.asarray(height, np.float64) / width + 1e-6).astype(np.int64)
    counts = np.bincount(np.clip(index, 0, bins - 1), minlength=bins)
    return counts / counts.sum()


def height_intersection(real: ArrayLike, simulated: ArrayLike, width: float) -> float:
    """Overlap of two distributions of heights, the sum over bins of the smaller share [-].

    The value depends on the width, and on the number of returns where they are few for each bin.

    **Arguments:**

    - `real`, `simulated`: heights of returns above the ground [m].
    - `width`: height of a bin [m], positive; bins begin at the ground.

    Not differentiable: see `smooth_height_intersection`.

    >>> from fynjax.metrics import height_intersection
    >>> height_intersection([0.05, 0.15, 0.25, 0.35], [0.05, 0.06, 0.15, 0.25], width=0.1)
    0.75
    """
    both = [np.asarray(h, np.float64) for h in (real, simulated)]
    bins = int(np.floor(max(h.max() for h in both) / width + 1e-6)) + 1
    real_share, simulated_share = (height_shares(h, width, bins) for h in both)
    return float(np.minimum(real_share, simulated_share).sum())
