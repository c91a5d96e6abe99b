"""Which parameters move which metrics of a plot: what `fynjax sensitivity` does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.parts import Workers
from fynjax._core.progress import Progress
from fynjax.assembly import batch_for_device, image_view, prepare, shown_unit
from fynjax.inversion import (
    DerivativeMeasures,
    PlotForward,
    SobolIndices,
    derivative_measures,
    local_sensitivity,
    search_form,
    signature,
    sobol_indices,
)
from fynjax.io.plot import Plot, as_plot
from fynjax.io.raster import file_hash
from fynjax.jobs._result import JobResult, Rows
from fynjax.jobs._run import Run
from fynjax.metrics import check_statistics
from fynjax.report.figures import indices_plot, short_name, tornado_plot
from fynjax.report.pages import Page, Picture, Section, Table

METRICS = ("red.mean", "nir.mean", "NDVI.mean", "NDVI.std")
"""Metrics of a run that names none."""


class SensitivityResult(JobResult):
    """Result of `sensitivity`: slopes at the plot's parameters, shares of variance over priors."""

    command: Literal["sensitivity"] = "sensitivity"
    slopes: Rows
    """Rows of slopes.csv."""
    variance: Rows
    """Rows of variance.csv; none where no samples were asked for."""


def sensitivity(
    plot: Plot | str | Path,
    output: Path,
    *,
    metrics: Sequence[str] = METRICS,
    free: Sequence[str] | None = None,
    derivative_samples: int = 0,
    sobol_samples: int = 0,
    seed: int | None = None,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> SensitivityResult:
    """Slopes and elasticities of a plot's metrics; over the priors too, if samples are asked for.

    **Arguments:**

    - `plot`: a plot, or the path of its plot file.
    - `output`: folder of the results, made if missing.
    - `metrics`: statistics of the image, such as "NDVI.mean".
    - `free`: patterns of parameters to vary; those of the plot file by default.
    - `derivative_samples`: samples for derivative-based global sensitivity (DGSM), a power of two,
      or 0 for none.
    - `sobol_samples`: samples for Sobol indices, a power of two, or 0 for none. Each sample takes
      as many renders as there are parameters, and two more.
    - `seed`: seed of every random number; that of the plot file by default.
    - `checkpoint`: folder that keeps what samples gave, from which an interrupted run goes on; none
      by default.
    - `workers`: where samples are computed; in this process by default.
    - `progress`: where to report the stages; nowhere by default.

    **Returns:** `SensitivityResult`. Writes `slopes.csv`, with samples `variance.csv`, figures and
    a page into `output`.

    **Raises:** `InputError` as `read_plot`, for a metric that is unknown or missing, and for a
    checkpoint of another run;
    `MissingExtraError` for Sobol indices without SALib.

    Example: `jobs.sensitivity("plot.toml", Path("results"), metrics=["NDVI.mean"])`.
    """
    names = tuple(metrics)
    if not names:
        raise InputError("no metric is named; an example is NDVI.mean")
    check_statistics(names)
    if sobol_samples:
        require("SALib", "sensitivity")
    read = as_plot(plot)
    run = Run(output, seed=read.seed if seed is None else seed, progress=progress)
    with run.stage("Build the plot"):
        ready = prepare(read, free, seed=run.seed)
    space = ready.space
    views = [image_view(read, ready.scene, ready.parameters, names)]
    quick, cheap = search_form(ready.scene, ready.parameters, views)
    predict = PlotForward(ready.parameters, space.names, cheap)
    at = np.asarray(space.prior)
    with run.stage("Slopes"):
        local = local_sensitivity(predict, space.names, names, at, context=(quick,))
    if not (np.isfinite(local.value).all() and np.isfinite(local.jacobian).all()):
        raise InputError(
            "a metric or its slope is not finite at the plot's parameters", file=read.file
        )
    journal = None
    if checkpoint is not None and (derivative_samples or sobol_samples):
        hashes = [file_hash(path) for path in read.inputs]
        asked = (names, space.names, derivative_samples, sobol_samples, run.seed)
        journal = Journal(checkpoint, signature(read, hashes, asked))
    common: dict[str, Any] = {
        "context": (quick,),
        "seed": run.seed,
        "batch": batch_for_device(),
        "journal": journal,
        "workers": workers,
        "progress": run.progress,
    }
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
    headline = []
    for metric, part in table.groupby("metric", sort=False):
        steepest = part.loc[part["elasticity"].abs().sort_values(ascending=False).index[:3]]
        named = ", ".join(
            f"{short_name(str(r.parameter))} ({r.elasticity:+.2g} %)" for r in steepest.itertuples()
        )
        headline.append(f"{metric} changes most, for 1 % more, by {named}.")
    with run.stage("Write"):
        run.table("slopes.csv", table, "slope and elasticity of every metric by every parameter")
        sections = [_slope_section(table)]
        if spread is not None:
            run.table("variance.csv", spread, "shares of the metrics' variance over the priors")
            sections.append(_variance_section(spread))
        record = run.record(read.inputs)
        run.page(Page(f"Sensitivity: {read.name}", " ".join(headline), sections, record=record))
    return run.result(
        SensitivityResult,
        headline=headline,
        slopes=table,
        variance=[] if spread is None else spread,
    )


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


def _slope_section(table: pd.DataFrame) -> Section:
    picture = Picture(
        "elasticities.png",
        tornado_plot(table),
        "largest elasticities of each metric",
        "Change of each metric for 1 % more of a parameter.",
    )
    return Section("At the plot's parameters", [picture, Table(table, "Every slope.", folded=True)])


def _variance_section(spread: pd.DataFrame) -> Section:
    picture = Picture(
        "variance.png",
        indices_plot(spread),
        "shares of each metric's variance over the priors",
        "Shares of each metric's variance while all priors vary.",
    )
    return Section("Over the priors", [picture, Table(spread, "Every share.", folded=True)])
