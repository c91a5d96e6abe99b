"""The job of `fynjax sensitivity`: how far each parameter moves each metric of a plot."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.app.assembly import batch_for_device, image_view, plot_problem
from fynjax.app.io.plot import Plot, as_plot, drone_sensor
from fynjax.app.jobs._result import JobResult, Rows
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.inversion import (
    LEADING_ELASTICITIES,
    DerivativeMeasures,
    ExpectedSensitivity,
    PlotForward,
    SobolIndices,
    check_samples,
    coarser,
    derivative_measures,
    expected_sensitivity,
    other_plantings,
    search_form,
    shown_unit,
    sobol_indices,
)
from fynjax.metrics import check_statistics
from fynjax.scene import Scene

METRICS = ("red.mean", "nir.mean", "NDVI.mean", "NDVI.std")
"""Metrics of a run that names none."""
PLANTINGS = 64
"""Plantings over which slopes are taken, at most."""
_ACCURACY = 0.1
"""Standard error of the leading elasticities, relative [-], at which no more are taken."""


class SensitivityResult(JobResult):
    """Result of `sensitivity`: slopes at the plot's parameters, shares of variance over priors."""

    command: Literal["sensitivity"] = "sensitivity"
    slopes: Rows
    """Rows of slopes.csv."""
    variance: Rows
    """Rows of variance.csv; none where no samples were asked for."""


@double_precision
def sensitivity(
    plot: Plot | str | Path,
    output: str | Path,
    *,
    metrics: Names = METRICS,
    free: Sequence[str] | None = None,
    plantings: Annotated[int, Field(ge=2)] = PLANTINGS,
    derivatives: Annotated[int, Field(ge=0)] = 0,
    sobol: Annotated[int, Field(ge=0)] = 0,
    seed: Seed | None = None,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
) -> SensitivityResult:
    """Find which parameters of a plot change which statistics of its image.

    Slopes and elasticities at the plot's parameters are of the expectation over plantings, of which
    so many are taken that the standard errors of each metric's three largest elasticities are below
    10 % of them. Shares of variance over the priors, if asked for, are of one planting.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `output`: folder of the results, made if missing.
    - `metrics`: statistics of the image.
    - `free`: parameters to vary, such as species.*.cover; the plot file's if left out.
    - `plantings`: plantings over which slopes are taken, at most.
    - `derivatives`: samples for derivative-based global sensitivity (DGSM), a power of two; 0:
      none.
    - `sobol`: points of the Sobol design, a power of two; takes N (parameters + 2) renders; 0:
      none.
    - `seed`: seed of everything random; the plot file's if left out.
    - `checkpoint`: folder that keeps what plantings and samples gave, from which an interrupted run
      goes on; none by default.
    - `workers`: where plantings and samples are computed; in this process by default.

    **Returns:** `SensitivityResult`, whose `status` says where errors stayed above 10 %. Writes
    `slopes.csv`, with samples `variance.csv`, figures and a page into `output`.

    **Raises:** `InputError` as `read_plot`, for a metric that is unknown or missing, or not finite
    at the plot's parameters, fewer than 2 plantings, and a checkpoint of another run;
    `MissingExtraError` for Sobol indices without SALib.

    Example: `jobs.sensitivity("plot.toml", Path("results"), metrics=["NDVI.mean"])`.
    """
    names = tuple(metrics)
    read = as_plot(plot)
    if not names:
        raise InputError("no metric is named; an example is NDVI.mean")
    check_statistics(names, drone_sensor(read).bands)
    if sobol:
        require("SALib", "analysis")
    for samples in filter(None, (derivatives, sobol)):
        check_samples(samples)
    run = Run(output, seed=seed, plot=read)
    with run.stage("Build the plot"):
        problem = plot_problem(read, None, free, seed=run.seed)
    scene, space, parameters = problem.scene, problem.free, problem.scene.parameters
    views = [image_view(read, scene, parameters, names)]
    stand, coarse_views = search_form(scene, parameters, views)
    predict = PlotForward(parameters, space.names, coarse_views)
    at = np.asarray(space.prior)
    size = f"{len(names)} metrics by {len(space.names)} parameters"
    tables = ["slopes.csv", *(["variance.csv"] if derivatives or sobol else [])]
    begin_work(dict.fromkeys(tables, size) | {"report.html": ""})
    asked = (names, space.names, plantings, derivatives, sobol)
    journal = run.journal(checkpoint, read, asked, files=read.inputs)
    with at_work(workers) as pool:
        do = partial(pool.all, journal=journal)
        slopes = expected_sensitivity(
            predict,
            space.names,
            names,
            at,
            partial(_planting, scene),
            accuracy=_ACCURACY,
            most=2 if scene.known_plants else plantings,  # which are the same in each
            do=do,
        )
        over: dict[str, Any] = {
            "context": (stand,), "seed": run.seed, "batch": batch_for_device(), "do": do
        }  # fmt: skip
        measures = indices = spread = None
        if derivatives:
            samples = derivatives
            measures = derivative_measures(predict, space, names, samples=samples, **over)
        if sobol:
            indices = sobol_indices(predict, space, names, samples=sobol, **over)
    table = _slope_table(slopes)
    status = _status(slopes)
    known = (
        f"Means over {slopes.plantings} plantings; standard errors of the leading elasticities are "
        f"at most {100 * slopes.leading_error.max():.0f} % of them."
    )
    headline = [*_headline(table), status or known]
    with run.stage("Write"):
        run.table("slopes.csv", table, "slope and elasticity of every metric by every parameter")
        sections = [_slope_section(table, slopes.quantile)]
        if measures is not None or indices is not None:
            spread = _spread_table(names, space.names, measures, indices)
            run.table("variance.csv", spread, "shares of the metrics' variance over the priors")
            picture = Picture(
                "variance.png",
                figures.indices_plot(spread),
                "shares of each metric's variance over the priors",
                "Shares of each metric's variance while all priors vary, with the plants of one "
                "planting.",
            )
            every = Table(spread, "Every share.", folded=True)
            sections.append(Section("Over the priors", [picture, every]))
        record = run.record(read.inputs)
        title, lead = f"Sensitivity: {read.name}", " ".join(headline)
        run.page(Page("sensitivity", title, lead, sections, record=record))
    return run.result(
        SensitivityResult,
        status=status or "ok",
        headline=headline,
        slopes=table,
        variance=[] if spread is None else spread,
    )


def _planting(plot: Scene, number: int) -> tuple[Scene]:
    """The plot with other plants, in the coarse form: sites of another seed, in another order."""
    (scene,) = other_plantings(plot, [number])
    return (coarser(scene, plot.parameters).reordered(number),)


def _slope_table(slopes: ExpectedSensitivity) -> pd.DataFrame:
    """One row a metric and parameter, in the units of files."""
    _, units, factors = zip(*map(shown_unit, slopes.names), strict=True)
    factor = np.array(factors)
    tables = [
        pd.DataFrame(
            {
                "metric": metric,
                "parameter": slopes.names,
                "unit": units,
                "value": slopes.at * factor,
                "metric_value": slopes.value[k],
                "metric_sd": slopes.value_sd[k],
                "slope": slopes.jacobian[k] / factor,
                "slope_error": slopes.jacobian_error[k] / factor,
                "elasticity": slopes.elasticity[k],
                "elasticity_error": slopes.elasticity_error[k],
                "distinguished": slopes.distinguished[k],
            }
        )
        for k, metric in enumerate(slopes.metrics)
    ]
    return pd.concat(tables, ignore_index=True)


def _headline(table: pd.DataFrame) -> list[str]:
    """For each metric its largest elasticities, of those that are distinguished from zero."""
    lines = []
    for metric, part in table.groupby("metric", sort=False):
        distinct = part[part["distinguished"] & (part["elasticity"].abs() > 0)]
        order = distinct["elasticity"].abs().sort_values(ascending=False).index
        named = ", ".join(
            f"{figures.short_name(str(r.parameter))} ({r.elasticity:+.2g} "
            f"± {r.elasticity_error:.2g} %)"
            for r in distinct.loc[order[:LEADING_ELASTICITIES]].itertuples()
        )
        lines.append(
            f"{metric} changes most, for 1 % more, by {named}."
            if named
            else f"No parameter's effect on {metric} is distinguished from zero."
        )
    return lines


def _status(slopes: ExpectedSensitivity) -> str:
    """Sentence on the metrics whose leading elasticities are not known well enough, "" if none."""
    open_ones = [
        f"{metric} ({100 * error:.1f} %)"
        for metric, error in zip(slopes.metrics, slopes.leading_error, strict=True)
        if error > _ACCURACY
    ]
    if not open_ones:
        return ""
    return (
        f"After {slopes.plantings} plantings the standard error of a leading elasticity is still "
        f"above {100 * _ACCURACY:.0f} % of it: {', '.join(open_ones)}. More plantings "
        "(`--plantings`), or a larger plot, lower it."
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


def _slope_section(table: pd.DataFrame, quantile: float) -> Section:
    picture = Picture(
        "elasticities.png",
        figures.tornado_plot(table.assign(interval=quantile * table["elasticity_error"])),
        "largest elasticities of each metric",
        "Change of each metric for 1 % more of a parameter, mean over plantings, with its 95 % "
        "interval. Grey and hollow: not distinguished from zero.",
    )
    return Section(
        "At the plot's parameters",
        [picture, Table(table, "Every slope, with standard errors over plantings.", folded=True)],
    )
