"""The posterior of a plot's parameters: what `fynjax posterior` does."""

import dataclasses
import hashlib
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.progress import NullProgress, Progress
from fynjax.assembly import (
    STRIDE,
    Prepared,
    batch_for_device,
    parameter_columns,
    prepare,
    read_targets,
    shown_unit,
)
from fynjax.inversion import (
    AbstractView,
    Data,
    FitResult,
    ParameterSpace,
    PlotForward,
    Posterior,
    SamplingMethod,
    calibrate_plot,
    join_data,
    sample_posterior,
)
from fynjax.io.plot import Plot, as_plot
from fynjax.io.raster import file_hash, provenance
from fynjax.io.text import atomic_path, write_text
from fynjax.jobs._calibrate import peak_memory_mib
from fynjax.report.figures import (
    corner_plot,
    parameter_plot,
    predictive_plot,
    save_figure,
    short_name,
)
from fynjax.report.pages import Page

_ARRAYS = tuple(
    f.name
    for f in dataclasses.fields(FitResult)
    if f.name not in ("space", "data", "converged", "status")
)


def posterior(
    plot: Plot | str | Path,
    targets: Path | Sequence[Path],
    output: Path,
    *,
    method: SamplingMethod = "emcee",
    free: Sequence[str] | None = None,
    target_size: float = 400.0,
    max_steps: int = 5000,
    checkpoint: Path,
    seed: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Sample the posterior of a plot's parameters given what one or several sensors measured.

    The plot is calibrated first. The sampling renders as the calibration's search does, corrected
    by what that lacked at the estimate; errors of the statistics hold what other plantings change.

    **Arguments:** `targets`, as `calibrate` takes them; `free`, patterns that replace those of
    the plot file; `target_size`, effective draws; `checkpoint`, a folder that keeps the calibration
    and the chain: an interrupted run goes on from it. Writes posterior.nc, parameters.csv, figures
    and a page.
    """
    for package in ("arviz", "h5py") if method == "emcee" else ("arviz",):
        require(package, "posterior")
    if method == "nuts":
        require("blackjax", "nuts")
    progress = NullProgress() if progress is None else progress
    read = as_plot(plot)
    seed = read.seed if seed is None else seed
    paths = [targets] if isinstance(targets, Path) else list(targets)
    measured = read_targets(read, paths, seed=seed, progress=progress)
    data, views = join_data([one.data for one in measured]), [one.view for one in measured]
    with progress.stage("Build the plot"):
        drone = any(one.kind == "image" for one in measured)
        ready = prepare(read, free, seed=seed, drone=drone)
    inputs = (*(p for p in ready.plot.inputs if p is not None), *paths)
    mark = _mark(ready.space, [file_hash(p) for p in inputs], seed)
    start, grown, offset = _start(
        checkpoint / "calibration.npz", mark, ready, data, views, progress
    )
    cheap = [view.for_search(ready.model, STRIDE) for view in views]
    found = sample_posterior(
        PlotForward(ready.parameters, ready.space.names, cheap),
        grown,
        ready.space,
        method=method,
        start=start,
        offset=offset,
        context=(ready.quick,),
        target=target_size,
        max_steps=max_steps,
        seed=seed,
        batch=batch_for_device(),
        checkpoint=None if method == "laplace" else checkpoint / f"{method}.chain",
        progress=progress,
    )
    if not found.whitened.size:
        raise InputError(f"no posterior: {found.status}", file=read.file)
    with progress.stage("Write"):
        record = provenance(seed=seed, inputs=inputs)
        return {"seed": seed, **_write(output, ready, found, record, checkpoint)}


def _mark(space: ParameterSpace, hashes: Sequence[str], seed: int) -> str:
    text = "\n".join([*space.names, *hashes, str(seed)])
    return hashlib.sha256(text.encode()).hexdigest()


def _start(
    path: Path,
    mark: str,
    ready: Prepared,
    data: Data,
    views: Sequence[AbstractView],
    progress: Progress,
) -> tuple[FitResult, Data, Any]:
    """The calibration, from an earlier run of the same if there was one."""
    if path.exists():
        try:
            with np.load(path) as file:
                kept = dict(file)
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(
                "no checkpoint, or a damaged one; remove it to start again", file=path
            ) from error
        if str(kept.get("mark")) != mark:
            raise InputError(
                "this checkpoint is of other files, parameters or another seed. Choose another "
                "output, or remove it",
                file=path,
            )
        start = FitResult(
            space=ready.space,
            data=data,
            converged=bool(kept["converged"]),
            status=str(kept["status"]),
            **{name: kept[name] for name in _ARRAYS},
        )
        grown = Data(
            data.names, data.value, *(jnp.asarray(kept[k]) for k in ("data_sd", "whitener"))
        )
        return start, grown, jnp.asarray(kept["offset"])
    steps = ready.plot.calibration.max_iterations
    with progress.stage("Calibrate", steps + (steps + 1) // 2):
        result = calibrate_plot(
            ready.model,
            ready.parameters,
            data,
            ready.space,
            views=views,
            stride=STRIDE,
            max_steps=steps,
            report=lambda stage, loss, norm: progress.advance(1, stage=stage, loss=f"{loss:.1f}"),
        )
    fit = result.fit
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = {
        "mark": mark,
        "converged": fit.converged,
        "status": fit.status,
        "offset": result.offset,
        "data_sd": result.data.sd,
        "whitener": result.data.whitener,
        **{name: getattr(fit, name) for name in _ARRAYS},
    }
    work = path.with_name(path.name + ".work")
    with open(work, "wb") as file:
        np.savez(file, **{name: np.asarray(value) for name, value in kept.items()})  # type: ignore[arg-type]
    os.replace(work, path)
    return fit, result.data, result.offset


def posterior_table(found: Posterior) -> pd.DataFrame:
    """Every parameter: prior, mean, sd, quantiles, how far it is constrained, how it mixed."""
    values = found.values.reshape(-1, len(found.names))
    low, middle, high = found.quantiles(0.05, 0.5, 0.95)
    table = parameter_columns(
        found.names,
        {
            "prior": found.space.prior,
            "prior_sd": found.space.prior_sd,
            "estimate": values.mean(axis=0),
            "sd": values.std(axis=0),
            "q05": low,
            "median": middle,
            "q95": high,
        },
    )
    table["constrained"] = found.constrained
    diagnostics = found.diagnostics() if found.method != "laplace" else {}
    for kind in ("ess_bulk", "ess_tail", "r_hat"):
        if diagnostics:
            table[kind] = [diagnostics[name][kind] for name in found.names]
    return table


def _write(
    folder: Path, ready: Prepared, found: Posterior, record: Any, checkpoint: Path
) -> dict[str, Any]:
    table = posterior_table(found)
    write_text(folder / "parameters.csv", table.to_csv(index=False, float_format="%.6g"))
    with atomic_path(folder / "posterior.nc") as partial:
        found.inference_data({k: str(v) for k, v in record.items()}).to_netcdf(str(partial))
    order = np.argsort(-found.constrained)
    factor = np.array([shown_unit(name)[2] for name in found.names])
    draws = found.values.reshape(-1, len(found.names)) * factor
    prior, prior_sd = (
        factor * np.asarray(part) for part in (found.space.prior, found.space.prior_sd)
    )
    figures = {
        "corner": (
            corner_plot(
                draws[:, order],
                [f"{found.names[i]} [{shown_unit(found.names[i])[1]}]" for i in order],
                prior=(prior[order], prior_sd[order]),
            ),
            "draws of the parameters that the data constrain most, and of their pairs",
        ),
        "predictive": (
            predictive_plot(found.predicted, found.data.value, found.data.sd, found.data.names),
            "statistics that the posterior predicts against the measured ones",
        ),
        "parameters": (parameter_plot(table), "prior and posterior of every parameter"),
    }
    for name, (figure, _) in figures.items():
        save_figure(figure, folder / f"{name}.png")
    shown = [i for i in order[:5] if found.constrained[i] > 0.3]
    told = "; ".join(
        f"{short_name(found.names[i])} {table['median'][i]:.3g} "
        f"({table['q05'][i]:.3g} to {table['q95'][i]:.3g}) {table['unit'][i]}"
        for i in shown
    )
    headline = [
        f"{ready.plot.name}: {found.effective_size:.0f} effective draws by {found.method}.",
        f"Constrained most, median and 90 % interval: {told}."
        if told
        else "The data constrain none of the parameters much.",
    ]
    if not found.converged and found.method != "laplace":
        headline.append(f"The chain is kept in {checkpoint}: the same command goes on with it.")
    page = Page(f"Posterior: {ready.plot.name}", " ".join(headline))
    page.key_figures(
        {
            "effective draws": f"{found.effective_size:.0f}",
            "accepted": f"{100 * found.acceptance:.0f} %",
            "parameters": str(len(found.names)),
        }
    )
    page.paragraph(f"Status: {found.status}.")
    if found.method != "laplace":
        page.paragraph(
            "The chain renders one planting; what others change is in the errors of the "
            "statistics, but slopes that are chance of this planting count as knowledge, so that "
            "intervals are too narrow where few plants decide. The method 'laplace' allows for it."
        )
    for name, (_, caption) in figures.items():
        page.figure(folder / f"{name}.png", caption[0].upper() + caption[1:] + ".")
    page.table(table, caption="Every parameter.", folded=True)
    page.footer(record)
    page.write(folder / "report.html")
    return {
        "headline": headline,
        "files": {
            "report.html": "all of it on one page",
            "parameters.csv": "prior and posterior of every parameter",
            "posterior.nc": "every draw, as arviz reads it (InferenceData)",
            **{f"{name}.png": caption for name, (_, caption) in figures.items()},
        },
        "parameters": table.to_dict("records"),
        "converged": found.converged,
        "status": "ok" if found.converged else found.status,
        "posterior_status": found.status,
        "peak_memory_mib": peak_memory_mib(),
    }
