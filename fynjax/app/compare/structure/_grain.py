"""The cells of a plot: how their size is chosen, and the table of what was tried."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pandas as pd

from fynjax._core.errors import InputError, in_file
from fynjax.app.compare.structure._cloud import HeightCloud
from fynjax.app.compare.structure._settings import ComparisonSettings
from fynjax.app.terrain import Bounds
from fynjax.metrics.structure import CellGrid, CellStructure, cell_grid, cell_structure

PAPER_GRAINS = {1.0: (17.9, 51.3), 2.0: (6.1, 10.6)}
"""Change of the paper's metrics to the next larger grain [%], by grain [m]: median over metrics,
and largest. It took 2 m."""


def choose_cells(
    cloud: HeightCloud, bounds: Bounds, slack: float, settings: ComparisonSettings
) -> tuple[CellGrid, pd.DataFrame]:
    """The cells of the plot, and how each size that was tried did (`choose_grain`).

    For a stated grain the table says how much the metrics change to the next larger one.
    """
    side = min(bounds[2] - bounds[0], bounds[3] - bounds[1]) + slack
    grains = [g for g in sorted(settings.grains) if g <= side]
    if settings.grain is not None:
        grains = [settings.grain, *[g for g in grains if g > settings.grain][:1]]
    with in_file(cloud.file):
        if not grains:
            raise InputError(
                f"expected a plot wider than the grains to choose from, {settings.grains} m, but "
                f"it is {side:.2f} m. State a smaller one (`grain`; --grain)."
            )
        grids = [cell_grid(bounds, grain, slack=slack) for grain in grains]
        structures = [cell_structure(cloud.binned(grid, settings.structure)) for grid in grids]
        return choose_grain(structures, settings, bounds)


def choose_grain(
    structures: Sequence[CellStructure], settings: ComparisonSettings, plot: Bounds
) -> tuple[CellGrid, pd.DataFrame]:
    """The grain by the paper's rule, or that which `settings` state, and how each did that was
    tried.

    A grain fits if at least `least_cells` of its cells have `least_returns` or more, and the median
    cell `median_returns` or more. Of those that fit, the smallest is taken whose metrics change no
    more than `largest_change`, in the median over metrics, to the next larger grain. Where none
    does, or with `None`, it is the one whose metrics change least, the smaller one of equals. The
    largest grain has no next one: it is taken where no other fits.

    Least change alone takes any grain of several, by chance: large ones hold so few cells that a
    change can be small, and cut off more of the plot.

    **Arguments:** `structures`: of one cloud, with grains that grow; `settings`: of the rule;
    `plot`: west, south, east and north edge of the plot [m].

    **Returns:** cells of the grain chosen, and a table with a row for each grain: its cells, area
    and edges, the share of the plot that is in no cell, returns in cells, how much the metrics
    change to the next larger grain, in their median and at most, and that of the paper.

    **Raises:** `InputError` if no grain fits; the message lists what each of them lacks.
    """
    grains = [structure.grid.grain for structure in structures]
    if any(b <= a for a, b in pairwise(grains)):
        raise InputError(f"grains must grow, but are {grains}")
    means = [structure.means(settings.least_returns) for structure in structures]
    rows = []
    for i, (structure, grain) in enumerate(zip(structures, grains)):
        west, south, east, north = structure.grid.bounds
        changes = [
            abs(means[i + 1][name] - value) / abs(value)
            for name, value in means[i].items()
            if i + 1 < len(structures) and value != 0.0 and np.isfinite(means[i + 1][name] - value)
        ]
        counted = float(structure.counted(settings.least_returns).mean())
        median = float(np.median(structure.returns))
        paper = PAPER_GRAINS.get(grain, (np.nan, np.nan))
        rows.append(
            {
                "grain_m": grain,
                "taken": "no",
                "fits": counted >= settings.least_cells and median >= settings.median_returns,
                "cells": structure.returns.size,
                "area_m2": (east - west) * (north - south),
                "cut_off_percent": 100.0 * cut_off(plot, structure.grid.bounds),
                "counted_percent": 100.0 * counted,
                "least_returns": int(structure.returns.min()),
                "median_returns": median,
                "median_change_percent": 100.0 * np.median(changes) if changes else np.nan,
                "largest_change_percent": 100.0 * max(changes) if changes else np.nan,
                "paper_median_change_percent": paper[0],
                "paper_largest_change_percent": paper[1],
                "west_m": west,
                "south_m": south,
                "east_m": east,
                "north_m": north,
            }
        )
    table = pd.DataFrame(rows)
    chosen = 0 if settings.grain is not None else _chosen(table, settings)
    table.loc[chosen, "taken"] = "yes"
    table["fits"] = np.where(table["fits"], "yes", "no")
    return structures[chosen].grid, table


def _chosen(table: pd.DataFrame, settings: ComparisonSettings) -> int:
    """Which grain the rule takes."""
    fitting = table[table["fits"]]
    if fitting.empty:
        tried = "; ".join(
            f"{row.grain_m:g} m: {row.counted_percent:.0f} % of {row.cells} cells have "
            f"{settings.least_returns}, median {row.median_returns:g}"
            for row in table.itertuples()
        )
        raise InputError(
            f"no grain has {settings.least_returns} returns in {100 * settings.least_cells:.0f} % "
            f"of its cells and a median of {settings.median_returns:g} ({tried}). Try larger "
            "grains (`grains`), or state one (`grain`; --grain)."
        )
    change = fitting["median_change_percent"].dropna()
    if change.empty:
        return int(fitting.index.to_numpy()[-1])
    if settings.largest_change is not None:
        steady = change[change <= 100.0 * settings.largest_change]
        if not steady.empty:
            return int(steady.index.to_numpy()[0])
    return int(change.index.to_numpy()[change.argmin()])


def cut_off(plot: Bounds, cells: Bounds) -> float:
    """Share of the area of `plot` that lies outside `cells` [-]; both are bounds [m]."""
    area, used = ((b[2] - b[0]) * (b[3] - b[1]) for b in (plot, cells))
    return max(0.0, 1.0 - used / area)
