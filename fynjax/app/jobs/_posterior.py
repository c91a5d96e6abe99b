"""The job of `fynjax posterior`: the posterior of a plot's parameters."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float
from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.checkpoint import Journal, signature
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.precision import double_precision
from fynjax._core.sampling import ChainState
from fynjax.app.assembly import placed_by_image, plot_problem, read_targets
from fynjax.app.io.plot import NO_PRIOR, Plot, as_plot, with_prior
from fynjax.app.io.text import atomic_path
from fynjax.app.jobs._calibration_page import misfit_sentence
from fynjax.app.jobs._calibration_tables import offered_stand
from fynjax.app.jobs._doubt import doubt_targets
from fynjax.app.jobs._follow import calibrated as calibrated_plot
from fynjax.app.jobs._result import JobResult, Number, ParameterSummary
from fynjax.app.jobs._run import Run, paths_of
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.inversion import (
    Calibration,
    Posterior,
    PosteriorSampler,
    SamplingMethod,
    fit_surrogate,
    parameter_columns,
    shown_unit,
    stand_sentence,
    stand_table,
    surrogate_renders,
)


class PosteriorParameter(ParameterSummary):
    """One parameter: prior, posterior mean and quantiles, and how its chain mixed."""

    median: Number
    ess_bulk: Number = None
    ess_tail: Number = None
    r_hat: Number = None
    laplace_q05: Number = Field(
        default=None, description="5 % quantile of the Gaussian about the estimate."
    )
    laplace_q95: Number = Field(
        default=None, description="95 % quantile of the Gaussian about the estimate."
    )


class PosteriorResult(JobResult):
    """Result of `posterior`: summary of every parameter."""

    command: Literal["posterior"] = "posterior"
    parameters: list[PosteriorParameter]
    posterior_status: str


_PAIRS = 7
"""Parameters of which pairs are drawn."""
_COMPARED = 16
"""Parameters that are drawn side by side, by each method."""
_STANDS = 400
"""Draws of the posterior whose stands are computed, at most."""


@double_precision
def posterior(
    plot: Plot | str | Path,
    targets: str | Path | Sequence[str | Path],
    output: str | Path,
    *,
    method: SamplingMethod = "emcee",
    free: Sequence[str] | None = None,
    target_size: Annotated[float, Field(ge=1.0)] = 400.0,
    max_steps: Annotated[int, Field(ge=1)] = 5000,
    prior: str | Path = NO_PRIOR,
    checkpoint: str | Path,
    bands: Names | None = None,
    seed: Seed | None = None,
) -> PosteriorResult:
    """Sample which parameters of a plot real measurements leave possible.

    By one sensor or several at once. The plot is calibrated first, with the likelihood that the
    sampling then explores: the data are one draw of the statistics over plantings, with the errors
    of data, model and camera. Chains ask for more renders than there is time for, so that a
    surrogate stands for their expectation, its error stated (`fit_surrogate`). An interrupted run
    goes on when the same command is given again.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `targets`: what was measured, as `fynjax calibrate` takes it; of a plot whose plants are known
      the statistics of its image, not every pixel.
    - `output`: folder of the results, made if missing.
    - `method`: way to draw: emcee, an ensemble of walkers; nuts, Hamiltonian sampling; laplace, the
      Gaussian about the fit.
    - `free`: parameters to sample, such as species.*.cover; the plot file's if left out.
    - `target_size`: effective draws to reach.
    - `max_steps`: most steps of the chain.
    - `prior`: population that the plot is of, for what its files leave open: the name of a shipped
      one, a file that `fynjax bioscape learn` wrote, or none.
    - `checkpoint`: folder that keeps the calibration and the chain, from which an interrupted run
      goes on.
    - `bands`: what each band of the drone image is, names with commas between, where the file does
      not say: green, red, red_edge, nir, others as the sensor calls them, such as blue, and any
      other name for bands that are not used.
    - `seed`: seed of everything random; the plot file's if left out.

    **Returns:** `PosteriorResult`. Writes `posterior.nc`, `parameters.csv`, figures and a page into
    `output`.

    **Raises:** `InputError` as `calibrate`; `MissingExtraError` without the extra `posterior`.

    Example: `jobs.posterior("plot.toml", Path("drone.tif"), Path("results"),
    checkpoint=Path("chain"))`.
    """
    require("arviz", "posterior")
    if method == "nuts":
        require("blackjax", "posterior")
    checkpoint, paths = Path(checkpoint), paths_of(targets)
    read = with_prior(placed_by_image(as_plot(plot), paths), prior)
    run = Run(output, seed=seed, plot=read)
    data = read_targets(read, paths, bands=bands, seed=run.seed)
    if data is None:
        raise InputError("expected what was measured (--target)")
    doubt_targets(run, read, data)
    with run.stage("Build the plot"):
        problem = plot_problem(read, data, free, seed=run.seed)
    inputs = (*(p for p in read.inputs if p is not None), *paths)
    parameters = f"{len(problem.free.names)} parameters"
    draws = f"{parameters}, {max_steps} steps of the sampler at most"
    begin_work({"posterior.nc": draws, "parameters.csv": parameters, "report.html": ""})
    with run.stage("Calibrate", total=problem.settings.evaluations):
        calibrated = calibrated_plot(problem, run, checkpoint / "calibration")
    sampled, surrogate_error = _sampled(
        read, calibrated, method, target_size, max_steps, checkpoint
    )
    stand, table = tables = _tables(calibrated, sampled)
    doubts = calibrated.doubts()
    headline = [
        *doubts,
        stand_sentence(stand),
        *_headline(read, sampled, table),
        misfit_sentence(calibrated),
    ]
    stand = offered_stand(stand, calibrated)
    table = table.assign(
        offered=table["prior"] if calibrated.worse else table["estimate"],
        worse_than_table=calibrated.worse,
    )
    if not sampled.converged and sampled.method != "laplace" and checkpoint.is_dir():
        headline.append(f"The chain is kept in {checkpoint}: the same command goes on with it.")
    record = run.record(inputs)
    with run.stage("Write"):
        run.table("stand.csv", stand, "prior and posterior of the whole stand")
        run.table("parameters.csv", table, "prior and posterior of every parameter")
        path = run.path("posterior.nc", "every draw, as arviz reads it (InferenceData)")
        with atomic_path(path) as work:
            sampled.inference_data({k: str(v) for k, v in record.items()}).to_netcdf(str(work))
        page = _page(read, sampled, tables, headline, record, surrogate_error)
        unsure = " ".join([*doubts, *([] if sampled.converged else [sampled.status])])
        run.page(replace(page, result=headline[len(doubts)], trust=unsure))
    return run.result(
        PosteriorResult,
        headline=headline,
        parameters=table.filter(list(PosteriorParameter.model_fields)).to_dict("records"),
        converged=sampled.converged and not calibrated.worse,
        status=unsure or "ok",
        posterior_status=sampled.status,
    )


def _sampled(
    plot: Plot,
    calibrated: Calibration,
    method: SamplingMethod,
    target_size: float,
    max_steps: int,
    checkpoint: Path,
) -> tuple[Posterior, Float[np.ndarray, " statistic"]]:
    """The draws by a surrogate, and the error of that; what the folder `checkpoint` keeps is not
    computed again."""
    seed = calibrated.problem.settings.seed
    found = signature(calibrated.fit.whitened, seed)
    renders = surrogate_renders(calibrated, seed=seed)
    rendered = Journal(checkpoint / "surrogate", found)(lambda: np.stack([*renders]))
    surrogate, surrogate_error = fit_surrogate(calibrated, seed=seed, rendered=rendered)
    sampler = PosteriorSampler(
        surrogate,
        calibrated.data,
        calibrated.problem.free,
        method=method,
        start=calibrated.fit,
        target=target_size,
        max_steps=max_steps,
        seed=seed,
    )
    end = None
    if method != "laplace":
        journal = Journal(checkpoint / method, signature(sampler.signed))
        (end,) = deque(journal.states("chain", ChainState, sampler.states), maxlen=1)
    sampled = sampler.posterior(end)
    if not sampled.whitened.size:
        raise InputError(f"no posterior: {sampled.status}", file=plot.file)
    return sampled, surrogate_error


def _tables(calibrated: Calibration, sampled: Posterior) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The whole stand, and every parameter beside the quantiles of the Gaussian."""
    table = sampled.table()
    if sampled.method != "laplace":
        low, high = calibrated.fit.quantiles(0.05, 0.95)
        others = {"laplace_q05": low, "laplace_q95": high}
        table = table.join(parameter_columns(sampled.names, others)[list(others)])
    drawn = sampled.whitened.reshape(-1, len(sampled.names))
    draws = drawn[:: -(-len(drawn) // _STANDS)]
    stand = stand_table(
        calibrated.scene, calibrated.problem.scene.parameters, calibrated.fit, draws=draws
    )
    return stand, table


def _headline(plot: Plot, sampled: Posterior, table: pd.DataFrame) -> list[str]:
    shown = table.iloc[np.argsort(-sampled.constrained)[:5]]
    named = "; ".join(
        f"{figures.short_name(row.name)} {row.median:.3g} ({row.q05:.3g} to {row.q95:.3g})"
        f"{'' if row.unit == '-' else f' {row.unit}'}, "
        f"{max(100.0 * (row.constrained or 0.0), 0.0):.0f} %"
        for row in map(PosteriorParameter.model_validate, shown.to_dict("records"))
    )
    worst = int(np.argmax(np.abs(sampled.misfit)))
    off = abs(float(sampled.misfit[worst]))
    trust = ": the model does not explain it, so do not trust the intervals" if off > 3.0 else ""
    halved = len(sampled.well_constrained())
    return [
        f"{plot.name}: {sampled.effective_size:.0f} effective draws by {sampled.method}.",
        f"Largest misfit: {figures.words(sampled.data.names[worst])}, {off:.1f} standard errors"
        f"{trust}.",
        f"The data at least halve the error of {halved} of {len(sampled.names)} parameters.",
        f"Best known, with median, 90 % interval and share of the prior variance removed: {named}.",
    ]


def _page(
    plot: Plot,
    sampled: Posterior,
    tables: tuple[pd.DataFrame, pd.DataFrame],
    headline: list[str],
    record: dict[str, str | int],
    surrogate_error: Float[np.ndarray, " statistic"],
) -> Page:
    stand, table = tables
    order = np.argsort(-sampled.constrained)
    best = order[:_PAIRS]
    units = [shown_unit(name) for name in sampled.names]
    factor = np.array([f for _, _, f in units])
    draws = sampled.values.reshape(-1, len(sampled.names)) * factor
    values, density = (np.asarray(part) for part in sampled.space.density())
    prior = factor * values, density / factor
    data = sampled.data
    parts: list[Part] = [f"Status: {sampled.status}.", Table(stand, "The stand.")]
    worst = int(surrogate_error.argmax())
    parts.append(
        "Chains ask a surrogate for the statistics, linear in all parameters and bent along those "
        "that the data know most: renders that it was not fitted to differ from it by "
        f"{np.median(surrogate_error):.2g} standard errors of the data (median over statistics), "
        f"at worst {surrogate_error[worst]:.2g} ({figures.words(data.names[worst])}). "
        "Its slopes are means over a few draws: what of them is chance counts as knowledge in a "
        "chain, so that its intervals may be narrower than those of the method 'laplace', which "
        "leaves that out. That statistics bend is part of the errors as well as of the surrogate, "
        "which widens both."
    )
    shown = table.iloc[order[:_COMPARED]]
    methods: list[Part] = []
    if "laplace_q05" in table:  # by the Gaussian and by a chain side by side
        kinds = {"laplace": ("laplace_q05", "laplace_q95"), sampled.method: ("q05", "q95")}
        what = "90 % intervals of the parameters best known, by both methods"
        methods = [Picture("methods.png", figures.interval_plot(shown, kinds), what)]
    parts += [
        Picture(
            "corner.png",
            figures.corner_plot(
                {sampled.method: draws[:, best]},
                [f"{sampled.names[i]} [{units[i][1]}]" for i in best],
                prior=(prior[0][:, best], prior[1][:, best]),
            ),
            "draws of the parameters that the data constrain most, and of their pairs",
        ),
        Picture(
            "predictive.png",
            figures.predictive_plot(sampled.predicted, data.value, data.sd, data.names),
            "statistics that the posterior predicts against the measured ones",
        ),
        Picture(
            "parameters.png",
            figures.parameter_plot(table),
            "prior and posterior of every parameter",
        ),
        *methods,
        Table(table, "Every parameter.", folded=True),
    ]
    keys = {
        "effective draws": f"{sampled.effective_size:.0f}",
        "accepted": f"{100 * sampled.acceptance:.0f} %",
        "parameters": str(len(sampled.names)),
    }
    title = f"Posterior: {plot.name}"
    return Page("posterior", title, " ".join(headline), [Section("", parts)], keys, record)
