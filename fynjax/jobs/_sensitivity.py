"""Which parameters move which metrics of a plot: what `fynjax sensitivity` does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.progress import NullProgress, Progress
from fynjax.assembly import STRIDE, batch_for_device, prepare, shown_unit
from fynjax.inversion import (
    DerivativeMeasures,
    SobolIndices,
    derivative_measures,
    local_sensitivity,
    plot_statistics,
    sobol_indices,
)
from fynjax.io.plot import Plot, as_plot
from fynjax.io.raster import provenance
from fynjax.io.text import write_text
from fynjax.jobs._calibrate import peak_memory_mib
from fynjax.metrics import check_statistics
from fynjax.report.figures import indices_plot, save_figure, short_name, tornado_plot
from fynjax.report.pages import Page

METRICS = ("red.mean", "nir.mean", "NDVI.mean", "NDVI.std")
"""Metrics of a run that names none."""


def sensitivity(
    plot: Plot | str | Path,
    output: Path,
    *,
    metrics: Sequence[str] = METRICS,
    free: Sequence[str] | None = None,
    derivative_samples: int = 0,
    sobol_samples: int = 0,
    seed: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Slopes and elasticities of a plot's metrics; over the priors too, if samples are asked for.

    **Arguments:** `metrics`, such as "NDVI.mean"; `free`, patterns of parameters that replace
    those of the plot file; `derivative_samples` (renders with slopes) and `sobol_samples` (times
    parameters and two, renders), powers of two, or 0 for none. Writes tables, figures and a page.
    """
    names = tuple(metrics)
    if not names:
        raise InputError("no metric is named; an example is NDVI.mean")
    check_statistics(names)
    if sobol_samples:
        require("SALib", "sensitivity")
    progress = NullProgress() if progress is None else progress
    read = as_plot(plot)
    seed = read.seed if seed is None else seed
    with progress.stage("Build the plot"):
        ready = prepare(read, free, seed=seed)
    space = ready.space
    predict = plot_statistics(ready.parameters, space.names, names, STRIDE)
    at = np.asarray(space.prior)
    with progress.stage("Slopes"):
        local = local_sensitivity(predict, space.names, names, at, context=(ready.quick,))
    if not (np.isfinite(local.value).all() and np.isfinite(local.jacobian).all()):
        raise InputError(
            "a metric or its slope is not finite at the plot's parameters", file=read.file
        )
    common: dict[str, Any] = {
        "context": (ready.quick,), "seed": seed, "batch": batch_for_device(), "progress": progress,
    }  # fmt: skip
    measures = indices = None
    if derivative_samples:
        measures = derivative_measures(predict, space, names, samples=derivative_samples, **common)
    if sobol_samples:
        indices = sobol_indices(predict, space, names, samples=sobol_samples, **common)
    rows = [
        {
            "metric": metric,
            "parameter": name,
            "unit": shown_unit(name)[1],
            "value": at[i] * shown_unit(name)[2],
            "metric_value": local.value[k],
            "slope": local.jacobian[k, i] / shown_unit(name)[2],
            "elasticity": local.elasticity[k, i],
        }
        for k, metric in enumerate(names)
        for i, name in enumerate(space.names)
    ]
    table = pd.DataFrame(rows)
    over_priors = measures is not None or indices is not None
    spread = _spread_table(names, space.names, measures, indices) if over_priors else None
    with progress.stage("Write"):
        record = provenance(seed=seed, inputs=read.inputs)
        return {"seed": seed, **_write(output, read.name, table, spread, record)}


def _spread_table(
    metrics: Sequence[str],
    names: Sequence[str],
    measures: DerivativeMeasures | None,
    indices: SobolIndices | None,
) -> pd.DataFrame:
    """One row a metric and parameter; NaN where something was not asked for."""
    empty = np.full((len(metrics), len(names)), np.nan)
    columns: dict[str, np.ndarray] = {
        key: empty if indices is None else getattr(indices, key)
        for key in ("first", "first_error", "total", "total_error")
    }
    columns["derivative_measure"] = empty if measures is None else measures.measure
    columns["bound"] = empty if measures is None else measures.bound
    return pd.DataFrame(
        {
            "metric": np.repeat(metrics, len(names)),
            "parameter": np.tile(names, len(metrics)),
            **{key: values.ravel() for key, values in columns.items()},
        }
    )


def _write(
    folder: Path, name: str, table: pd.DataFrame, spread: pd.DataFrame | None, record: Any
) -> dict[str, Any]:
    write_text(folder / "slopes.csv", table.to_csv(index=False, float_format="%.6g"))
    files = {
        "report.html": "all of it on one page",
        "slopes.csv": "slope and elasticity of every metric by every parameter",
        "elasticities.png": "largest elasticities of each metric",
    }
    save_figure(tornado_plot(table), folder / "elasticities.png")
    headline = []
    for metric, part in table.groupby("metric", sort=False):
        most = part.loc[part["elasticity"].abs().sort_values(ascending=False).index[:3]]
        told = ", ".join(
            f"{short_name(str(r.parameter))} ({r.elasticity:+.2g} %)" for r in most.itertuples()
        )
        headline.append(f"{metric} moves most, for 1 % more, by {told}.")
    page = Page(f"Sensitivity: {name}", " ".join(headline))
    page.section("At the plot's parameters").figure(
        folder / "elasticities.png", "Change of each metric for 1 % more of a parameter."
    )
    page.table(table, caption="Every slope.", folded=True)
    if spread is not None:
        write_text(folder / "variance.csv", spread.to_csv(index=False, float_format="%.6g"))
        save_figure(indices_plot(spread), folder / "variance.png")
        files["variance.csv"] = "shares of the metrics' variance over the priors"
        files["variance.png"] = "the same as a picture"
        page.section("Over the priors").figure(
            folder / "variance.png", "Shares of each metric's variance while all priors vary."
        )
        page.table(spread, caption="Every share.", folded=True)
    page.footer(record)
    page.write(folder / "report.html")
    return {
        "headline": headline,
        "files": files,
        "slopes": table.to_dict("records"),
        "variance": [] if spread is None else spread.to_dict("records"),
        "peak_memory_mib": peak_memory_mib(),
    }
