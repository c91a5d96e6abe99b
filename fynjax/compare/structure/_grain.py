"""The cells of a plot: how their size is chosen, and the table of what was tried."""

from typing import Any

import numpy as np
import pandas as pd

from fynjax._core.errors import InputError
from fynjax.compare.structure._cloud import HeightCloud
from fynjax.compare.structure._settings import ComparisonSettings
from fynjax.metrics import (
    BinnedReturns,
    CellGrid,
    GrainCheck,
    StructureSettings,
    bin_returns,
    cell_grid,
    cell_structure,
    choose_grain,
)
from fynjax.metrics.structure import check_grains
from fynjax.terrain import Bounds

PAPER_GRAINS = {1.0: (17.9, 51.3), 2.0: (6.1, 10.6)}
"""Change of the paper's metrics to the next larger grain [%], by grain [m]: median over metrics,
and largest. It took 2 m."""


def binned_returns(
    cloud: HeightCloud, grid: CellGrid, settings: StructureSettings
) -> BinnedReturns:
    """A cloud's returns in the cells of a plot."""
    return bin_returns(cloud.x, cloud.y, cloud.height, grid, settings)


def choose_cells(
    cloud: HeightCloud, bounds: Bounds, slack: float, settings: ComparisonSettings
) -> tuple[CellGrid, tuple[GrainCheck, ...]]:
    """The cells of the plot, and how each size that was tried did.

    For a stated grain the checks say how much the metrics change to the next larger one.
    """
    side = min(bounds[2] - bounds[0], bounds[3] - bounds[1]) + slack
    grains = [g for g in sorted(settings.grains) if g <= side]
    rule: dict[str, Any] = {
        "least_returns": settings.least_returns,
        "least_cells": settings.least_cells,
        "median_returns": settings.median_returns,
    }
    try:
        if settings.grain is not None:
            larger = [g for g in grains if g > settings.grain][:1]
            grids = [cell_grid(bounds, g, slack=slack) for g in (settings.grain, *larger)]
        elif not grains:
            raise InputError(
                f"expected a plot wider than the grains to choose from, {settings.grains} m, but "
                f"it is {side:.2f} m. State a smaller one (`grain`; --grain)."
            )
        else:
            grids = [cell_grid(bounds, g, slack=slack) for g in grains]
        structures = [cell_structure(binned_returns(cloud, g, settings.structure)) for g in grids]
        if settings.grain is not None:
            return grids[0], check_grains(structures, **rule)
        return choose_grain(structures, **rule, largest_change=settings.largest_change)
    except InputError as error:
        raise InputError(str(error), file=cloud.file) from error


def cut_off(plot: Bounds, cells: Bounds) -> float:
    """Share of the area of `plot` that lies outside `cells` [-]; both are bounds [m]."""
    area, used = ((b[2] - b[0]) * (b[3] - b[1]) for b in (plot, cells))
    return max(0.0, 1.0 - used / area)


def grain_table(checks: tuple[GrainCheck, ...], taken: float, plot: Bounds) -> pd.DataFrame:
    """A row for each grain that was tried, with its cells and the paper's changes beside it.

    **Arguments:**

    - `checks`: of the grains.
    - `taken`: the grain that was taken [m].
    - `plot`: bounds of the plot [m].
    """
    rows = []
    for check in checks:
        west, south, east, north = check.bounds
        paper = PAPER_GRAINS.get(check.grain, (np.nan, np.nan))
        rows.append(
            {
                "grain_m": check.grain,
                "taken": "yes" if check.grain == taken else "no",
                "fits": "yes" if check.fits else "no",
                "cells": check.cells,
                "area_m2": (east - west) * (north - south),
                "cut_off_percent": 100.0 * cut_off(plot, check.bounds),
                "counted_percent": 100.0 * check.counted_share,
                "least_returns": check.least_returns,
                "median_returns": check.median_returns,
                "median_change_percent": _percent(check.median_change),
                "largest_change_percent": _percent(check.largest_change),
                "paper_median_change_percent": paper[0],
                "paper_largest_change_percent": paper[1],
                "west_m": west,
                "south_m": south,
                "east_m": east,
                "north_m": north,
            }
        )
    return pd.DataFrame(rows)


def _percent(share: float | None) -> float:
    return np.nan if share is None else 100.0 * share
