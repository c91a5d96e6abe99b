"""The posterior of a plot's parameters: what `fynjax posterior` does."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.checkpoint import Journal, signature
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.progress import track
from fynjax.assembly import (
    Prepared,
    parameter_columns,
    prepare,
    read_targets,
    shown_unit,
)
from fynjax.inversion import (
    KNOWN,
    NARROWER,
    OFF,
    RENDERS,
    WIDER,
    Posterior,
    RegressedPosterior,
    SamplingMethod,
    TooFewSimulationsError,
    calibration,
    fit_surrogate,
    join_data,
    plot_search,
    sample_posterior,
    search_starts,
    simulated_parts,
    simulation_posterior,
    surrogate_renders,
)
from fynjax.io.plot import NO_PRIOR, Plot, as_plot, with_prior
from fynjax.io.text import atomic_path
from fynjax.jobs._calibration_page import misfit_sentence
from fynjax.jobs._follow import follow
from fynjax.jobs._result import JobResult, Number, ParameterSummary
from fynjax.jobs._run import Run
from fynjax.report.figures import (
    corner_plot,
    interval_plot,
    parameter_plot,
    predictive_plot,
    short_name,
    words,
)
from fynjax.report.pages import Page, Part, Picture, Section, Table


class PosteriorParameter(ParameterSummary):
    """One parameter: prior, posterior mean and quantiles, and how its chain mixed."""

    median: Number
    ess_bulk: Number = None
    ess_tail: Number = None
    r_hat: Number = None
    laplace_q05: Number = Field(
        default=None, description="End of the 90 % interval of the Gaussian about the estimate."
    )
    laplace_q95: Number = Field(default=None, description="Its other end.")
    regression_q05: Number = Field(
        default=None, description="The same by a regression on simulations of the prior."
    )
    regression_q95: Number = Field(default=None, description="Its other end.")


class PosteriorResult(JobResult):
    """Result of `posterior`: summary of every parameter."""

    command: Literal["posterior"] = "posterior"
    parameters: list[PosteriorParameter]
    posterior_status: str


_FEWEST = 100
"""Simulations of a regression: of the 24 directions of an image it needs 96."""
_NAMED, _COMPARED = 5, 16
"""Parameters that are named where methods differ, and that are drawn side by side."""


def posterior(
    plot: Plot | str | Path,
    targets: Path | Sequence[Path],
    output: Path,
    *,
    method: SamplingMethod = "emcee",
    free: Sequence[str] | None = None,
    target_size: float = 400.0,
    max_steps: int = 5000,
    simulations: int = 300,
    prior: str | Path = NO_PRIOR,
    checkpoint: Path,
    bands: Sequence[str] | None = None,
    seed: int | None = None,
) -> PosteriorResult:
    """Sample the posterior of a plot's parameters given the measurements of one or several sensors.

    The plot is calibrated first, with the likelihood that the sampling then explores: the data are
    one draw of the statistics over plantings, with the errors of data, model and camera. Chains ask
    for more renders than there is time for, so that a surrogate stands for their expectation, its
    error stated (`fit_surrogate`).

    **Arguments:**

    - `plot`: a plot, or the path of its plot file.
    - `targets`: files of the measurements, as `calibrate` takes them.
    - `output`: folder of the results, made if missing.
    - `method`: "emcee" (ensemble), "nuts" (Hamiltonian), or "laplace" (the Gaussian at the
      estimate).
    - `free`: patterns of parameters to sample; those of the plot file by default.
    - `target_size`: effective draws to reach.
    - `max_steps`: most steps of the sampler.
    - `simulations`: of the prior, for a regression that checks the posterior; 0 for none.
    - `prior`: learned population of what the plot's files leave open (`with_prior`); none by
      default.
    - `checkpoint`: folder that keeps the calibration and the chain, from which an interrupted run
      goes on.
    - `bands`: what each band of a drone's image is, as `read_drone_image` has it; known by name or
      wavelength by default.
    - `seed`: seed of every random number; that of the plot file by default.

    **Returns:** `PosteriorResult`. Writes `posterior.nc`, `parameters.csv`, figures and a page into
    `output`.

    **Raises:** `InputError` as `calibrate`; `MissingExtraError` without the extra `posterior`, or
    `nuts` for that method.

    Example: `jobs.posterior("plot.toml", Path("drone.tif"), Path("results"),
    checkpoint=Path("chain"))`.
    """
    for package in ("arviz", "h5py") if method == "emcee" else ("arviz",):
        require(package, "posterior")
    if 0 < simulations < _FEWEST or simulations < 0:
        raise InputError(
            f"expected {_FEWEST} simulations or more, or 0 for none, but got {simulations}"
        )
    if simulations:
        require("sklearn", "posterior", "scikit-learn")
    if method == "nuts":
        require("blackjax", "nuts")
    read = with_prior(as_plot(plot), prior)
    run = Run(output, seed=read.seed if seed is None else seed)
    paths = [targets] if isinstance(targets, Path) else list(targets)
    measured = read_targets(read, paths, bands=bands, seed=run.seed)
    data = join_data([m.data for m in measured])
    with run.stage("Build the plot"):
        ready = prepare(read, free, seed=run.seed)
        views = [sensor.view_of(ready.scene, ready.parameters) for sensor in measured]
    inputs = (*(p for p in ready.plot.inputs if p is not None), *paths)
    steps = ready.settings.max_steps
    parameters = f"{len(ready.space.names)} parameters"
    draws = f"{parameters}, {max_steps} steps of the sampler at most"
    begin_work({"posterior.nc": draws, "parameters.csv": parameters, "report.html": ""})
    with run.stage("Calibrate", total=steps + (steps + 1) // 2):
        search = plot_search(
            ready.scene,
            ready.parameters,
            data,
            ready.space,
            views,
            ready.settings,
            replant=ready.replant,
        )
        ends = follow(search, search_starts(search), run, checkpoint / "calibration")
        calibrated = calibration(search, ends)
    found = signature(calibrated.fit.whitened, run.seed)
    plot_of = calibrated, ready.parameters, calibrated.coarse_views
    renders = surrogate_renders(*plot_of, seed=run.seed)

    def render_all() -> tuple[Any, ...]:
        return (np.stack([*track(renders, "Fit a surrogate", RENDERS)]),)

    (rendered,) = Journal(checkpoint / "surrogate", found)(render_all)
    surrogate, surrogate_error = fit_surrogate(
        *plot_of, seed=run.seed, rendered=np.asarray(rendered)
    )
    regressed, unchecked = None, ""
    if simulations:
        try:
            parts = simulated_parts(*plot_of, simulations=simulations, seed=run.seed)
            keep = Journal(checkpoint / "simulations", found)
            done = [keep(partial(_alone, part))[0] for part in track(parts, "Simulate the prior")]
            regressed = simulation_posterior(
                *plot_of,
                simulations=simulations,
                seed=run.seed,
                rendered=np.concatenate([np.asarray(one) for one in done]),
            )
        except TooFewSimulationsError as error:  # what is left unchecked may be sound
            unchecked = f"Not checked by a regression: {error}."
    sampled = sample_posterior(
        surrogate,
        calibrated.data,
        ready.space,
        method=method,
        start=calibrated.fit,
        target=target_size,
        max_steps=max_steps,
        seed=run.seed,
        checkpoint=None if method == "laplace" else checkpoint / f"{method}.chain",
    )
    if not sampled.whitened.size:
        raise InputError(f"no posterior: {sampled.status}", file=read.file)
    table = posterior_table(sampled)
    others: dict[str, Any] = {}
    if sampled.method != "laplace":
        others["laplace_q05"], others["laplace_q95"] = calibrated.fit.quantiles(0.05, 0.95)
    if regressed is not None:
        others["regression_q05"], others["regression_q95"] = regressed.quantiles(
            ready.space, 0.05, 0.95
        )
    table = table.join(parameter_columns(sampled.names, others)[list(others)])
    headline = [*_headline(ready, sampled, table), misfit_sentence(calibrated)]
    if simulations:
        headline.append(unchecked if regressed is None else _agreement(sampled, regressed))
    if not sampled.converged and sampled.method != "laplace":
        headline.append(f"The chain is kept in {checkpoint}: the same command goes on with it.")
    record = run.record(inputs)
    with run.stage("Write"):
        run.table("parameters.csv", table, "prior and posterior of every parameter")
        path = run.path("posterior.nc", "every draw, as arviz reads it (InferenceData)")
        with atomic_path(path) as work:
            sampled.inference_data({k: str(v) for k, v in record.items()}).to_netcdf(str(work))
        run.page(_page(ready, sampled, table, headline, record, surrogate_error, regressed))
    return run.result(
        PosteriorResult,
        headline=headline,
        parameters=table.to_dict("records"),
        converged=sampled.converged,
        status="ok" if sampled.converged else sampled.status,
        posterior_status=sampled.status,
    )


def _alone(part: Callable[[], Any]) -> tuple[Any, ...]:
    """What a part gives, as a `Journal` keeps it."""
    return (part(),)


def posterior_table(sampled: Posterior) -> pd.DataFrame:
    """Every parameter: prior, mean, sd, quantiles, how far it is constrained, how it mixed."""
    values = sampled.values.reshape(-1, len(sampled.names))
    low, middle, high = sampled.quantiles(0.05, 0.5, 0.95)
    prior_low, prior_high = sampled.space.quantiles(0.05, 0.95)
    table = parameter_columns(
        sampled.names,
        {
            "prior": sampled.space.prior,
            "prior_sd": sampled.space.prior_sd,
            "prior_q05": prior_low,
            "prior_q95": prior_high,
            "estimate": values.mean(axis=0),
            "sd": values.std(axis=0),
            "q05": low,
            "median": middle,
            "q95": high,
        },
    )
    table["constrained"] = sampled.constrained
    diagnostics = sampled.diagnostics() if sampled.method != "laplace" else {}
    for kind in ("ess_bulk", "ess_tail", "r_hat"):
        if diagnostics:
            table[kind] = [diagnostics[name][kind] for name in sampled.names]
    return table


def _headline(ready: Prepared, sampled: Posterior, table: pd.DataFrame) -> list[str]:
    shown = table.iloc[np.argsort(-sampled.constrained)[:5]]
    named = "; ".join(
        f"{short_name(row.name)} {row.median:.3g} ({row.q05:.3g} to {row.q95:.3g})"
        f"{'' if row.unit == '-' else f' {row.unit}'}, "
        f"{max(100.0 * (row.constrained or 0.0), 0.0):.0f} %"
        for row in map(PosteriorParameter.model_validate, shown.to_dict("records"))
    )
    worst = int(np.argmax(np.abs(sampled.misfit)))
    off = abs(float(sampled.misfit[worst]))
    trust = ": the model does not explain it, so do not trust the intervals" if off > 3.0 else ""
    halved = len(sampled.well_constrained())
    return [
        f"{ready.plot.name}: {sampled.effective_size:.0f} effective draws by {sampled.method}.",
        f"Largest misfit: {words(sampled.data.names[worst])}, {off:.1f} standard errors{trust}.",
        f"The data at least halve the error of {halved} of {len(sampled.names)} parameters.",
        f"Best known, with median, 90 % interval and share of the prior variance removed: {named}.",
    ]


def _agreement(sampled: Posterior, regressed: RegressedPosterior) -> str:
    """What a regression on simulations of the prior says of the draws."""
    own = sampled.own.reshape(-1, len(sampled.names))
    found = regressed.compare(own.mean(axis=0), own.std(axis=0), sampled.effective_size)
    count, off = int(found.known.sum()), np.flatnonzero(found.off)
    named = off[np.argsort(-found.distance[off])][:_NAMED]
    names = ", ".join(short_name(sampled.names[i]) for i in named)
    more = f" and {len(off) - _NAMED} others" if len(off) > _NAMED else ""
    either = f"parameters that it or {sampled.method} knows"
    if not count:
        text = f"knows, as {sampled.method} does, no single parameter"
    elif off.size:
        text = f"agrees in {count - len(off)} of {count} {either}, not in {names}{more}"
    elif count == 1:
        text = f"agrees in the one {either.replace('parameters', 'parameter')}"
    else:
        text = f"agrees in all {count} {either}"
    if found.narrower.any():
        surer = int(found.narrower.sum())
        text += f"; {sampled.method} claims to know {surer} of those that agree far better"
    if found.scatter > found.usual:
        text += (
            f"; over all parameters the means lie {found.scatter:.2f} times as far apart as they "
            f"should (up to {found.usual:.2f} is chance): do not trust the intervals"
        )
    farther = 100.0 * regressed.farther
    text += f"; {farther:.0f} % of the simulations lie at least as far out as the measurement"
    odd = ": the prior does not make such data" if regressed.impossible else ""
    return f"A regression on {regressed.simulations} simulations of the prior {text}{odd}."


def _page(
    ready: Prepared,
    sampled: Posterior,
    table: pd.DataFrame,
    headline: list[str],
    record: dict[str, str | int],
    surrogate_error: np.ndarray,
    regressed: RegressedPosterior | None,
) -> Page:
    order = np.argsort(-sampled.constrained)
    units = [shown_unit(name) for name in sampled.names]
    factor = np.array([f for _, _, f in units])
    draws = sampled.values.reshape(-1, len(sampled.names)) * factor
    values, density = (np.asarray(part) for part in sampled.space.density())
    prior = factor * values, density / factor
    data = sampled.data
    parts: list[Part] = [f"Status: {sampled.status}."]
    worst = int(surrogate_error.argmax())
    parts.append(
        "Chains ask a surrogate for the statistics, linear in all parameters and bent along those "
        "that the data know most: renders that it was not fitted to differ from it by "
        f"{np.median(surrogate_error):.2g} standard errors of the data (median over statistics), "
        f"at worst {surrogate_error[worst]:.2g} ({words(data.names[worst])}). Its slopes are means "
        "over a few draws: what of them is chance counts as knowledge in a chain, so that its "
        "intervals may be narrower than those of the method 'laplace', which leaves that out. That "
        "statistics bend is part of the errors as well as of the surrogate, which widens both."
    )
    parts += [
        Picture(
            "corner.png",
            corner_plot(
                draws[:, order],
                [f"{sampled.names[i]} [{units[i][1]}]" for i in order],
                prior=(prior[0][:, order], prior[1][:, order]),
            ),
            "draws of the parameters that the data constrain most, and of their pairs",
        ),
        Picture(
            "predictive.png",
            predictive_plot(sampled.predicted, data.value, data.sd, data.names),
            "statistics that the posterior predicts against the measured ones",
        ),
        Picture("parameters.png", parameter_plot(table), "prior and posterior of every parameter"),
        *_methods(sampled, table.iloc[order[:_COMPARED]], regressed),
        Table(table, "Every parameter.", folded=True),
    ]
    keys = {
        "effective draws": f"{sampled.effective_size:.0f}",
        "accepted": f"{100 * sampled.acceptance:.0f} %",
        "parameters": str(len(sampled.names)),
    }
    title = f"Posterior: {ready.plot.name}"
    return Page(title, " ".join(headline), [Section("", parts)], keys, record)


def _methods(
    sampled: Posterior, best: pd.DataFrame, regressed: RegressedPosterior | None
) -> list[Part]:
    """The parameters best known by every method, side by side."""
    kinds = {"laplace": ("laplace_q05", "laplace_q95")} | {sampled.method: ("q05", "q95")}
    if regressed is not None:
        kinds["regression on simulations"] = ("regression_q05", "regression_q95")
    kinds = {kind: ends for kind, ends in kinds.items() if ends[0] in best}
    if len(kinds) < 2:
        return []
    parts: list[Part] = [
        Picture(
            "methods.png",
            interval_plot(best, kinds),
            "90 % intervals of the parameters best known, by every method",
        )
    ]
    if regressed is not None:
        parts.append(
            "The regression follows no slopes by parameters and no search, but knows only what is "
            "linear in the statistics over the whole prior: where a parameter bends them, others "
            "may be right and narrower. Parameters count as known from "
            f"{100 * KNOWN:.0f} % of their prior variance on; a method does not agree where its "
            f"mean lies more than {OFF:g} of the regression's standard deviations off, or it is "
            f"more than {WIDER:g} times as wide, and claims far more below {NARROWER:g} times."
        )
    return parts
