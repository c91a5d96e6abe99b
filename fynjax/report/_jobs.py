"""The jobs behind the commands: read, compute, write."""

import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.inversion import IMAGE_STATISTICS, Data, calibrate_plot, free_space, weigh_targets
from fynjax.io import Plot, example_folder, provenance, read_image, read_plot, read_statistics
from fynjax.io._build import build_plot
from fynjax.io._plot_sensor import drone_bands
from fynjax.metrics import (
    BANDS,
    VEGETATION_INDICES,
    bands_2006,
    consistent_targets,
    image_statistics,
    table4_2006,
)
from fynjax.report._run_files import calibration_files, render_files
from fynjax.report._run_tables import Reference
from fynjax.scene import PlotModel, PlotParameters


def run_render(
    plot: Path, output: Path, *, seed: int, progress: Progress | None = None
) -> dict[str, Any]:
    """Render a plot file's image into `output`: GeoTIFF, NetCDF, figures and a page."""
    progress = NullProgress() if progress is None else progress
    read = read_plot(plot)
    seconds: dict[str, float] = {}
    with progress.stage("Build the plot"), _Clock(seconds, "build"):
        model, parameters = build_plot(read, seed=seed, bands=drone_bands(read))
    render = eqx.filter_jit(lambda m, p: (m.image(p), m.counts(p)))
    with progress.stage("Render"):
        with _Clock(seconds, "first_render_with_compilation"):
            jax.block_until_ready(render(model, parameters))
        with _Clock(seconds, "render"):
            image, counts = jax.block_until_ready(render(model, parameters))
    _check_finite(image, read)
    with progress.stage("Write"):
        record = provenance(seed=seed, inputs=read.inputs)
        files = render_files(output, read, model, np.asarray(image), np.asarray(counts), record)
    means = ", ".join(f"{b} {float(v):.4f}" for b, v in zip(BANDS, jnp.mean(image, axis=(1, 2))))
    return {
        "headline": [f"{read.name}: mean reflectance {means}."],
        "files": files,
        "timings_s": seconds,
        "statistics": [
            {"statistic": f"{b}.mean", "target": None, "before": float(v), "after": None}
            for b, v in zip(BANDS, jnp.mean(image, axis=(1, 2)))
        ],
        "peak_memory_mib": peak_memory_mib(),
    }


def run_calibrate(
    plot: Path, target: Path, output: Path, *, seed: int, progress: Progress | None = None
) -> dict[str, Any]:
    """Calibrate a plot file to an image (GeoTIFF) or to a table of statistics (CSV)."""
    read = read_plot(plot)
    data, found = _target(read, target)
    return _calibrate(
        read, data, output, seed=seed, progress=progress, inputs=(*read.inputs, target), extra=found
    )


def run_demo(output: Path, *, seed: int, progress: Progress | None = None) -> dict[str, Any]:
    """Calibrate the shipped 2006 plot to the published statistics of its real drone image."""
    read = read_plot(example_folder() / "plot.toml")
    known = {t.key: t.value for t in consistent_targets()}
    targets = [t for t in consistent_targets() if t.key in DEMO_TARGETS]
    names, share = tuple(t.key for t in targets), read.calibration.target_sd
    value = np.array([t.value for t in targets])
    # The band means are known to three decimals.
    sd = np.where([t.derived for t in targets], np.hypot(share * value, _LAST_DIGIT), np.nan)
    data = weigh_targets(names, value, share, sd=sd)
    return _calibrate(
        read,
        data,
        output,
        seed=seed,
        progress=progress,
        inputs=read.inputs,
        reference=Reference(known, *paper_simulation()),
        goals={"mean of a band": 3.0, "mean of an index": 5.0},
    )


_LAST_DIGIT = 0.0005 / 3**0.5
DEMO_TARGETS = (
    *(f"{layer}.mean" for layer in (*BANDS, "NDVI", "GNDVI", "SR", "GCI")),
    *("NDVI.std", "GNDVI.std"),
)
"""Fitted in the demo. The other consistent indices are functions of the same bands; they are
reported beside, as a check."""


def paper_simulation() -> tuple[dict[str, float], dict[str, float]]:
    """The paper's own DIRSIG simulation of the 2006 plot: statistics where they are printed, and
    the relative errors of the band means, of which it prints only the size [%]."""
    found: dict[str, float] = {}
    for name, row in table4_2006().items():
        found[f"{name}.mean"], found[f"{name}.std"] = row.sim_mean, row.sim_std
    errors = {f"{n}.mean": 100.0 * b.sim_abs_difference for n, b in bands_2006().items()}
    return found, errors


def _target(plot: Plot, target: Path) -> tuple[Data, dict[str, Any]]:
    """The targets of a file: its statistics, or those of an image."""
    if target.suffix.lower() in (".tif", ".tiff"):
        image, mask, _ = read_image(target, BANDS)
        names = [n for n in IMAGE_STATISTICS if plot.calibration.uses_target(n)]
        if not names:
            raise InputError("`calibration.targets` fits none of the statistics", file=plot.file)
        clean = np.where(mask, image, 0.0)
        value = np.asarray(image_statistics(jnp.asarray(clean), names, jnp.asarray(mask)))
        share = float(mask.mean())
        data = weigh_targets(names, value, plot.calibration.target_sd)
        return data, {"target_valid_share": share}
    read = read_statistics(target, {*BANDS, *VEGETATION_INDICES})
    keep = [i for i, n in enumerate(read.names) if plot.calibration.uses_target(n)]
    if not keep:
        raise InputError("`calibration.targets` fits none of the target's rows", file=plot.file)
    names = [read.names[i] for i in keep]
    return weigh_targets(names, read.value[keep], plot.calibration.target_sd, sd=read.sd[keep]), {}


def _calibrate(
    plot: Plot,
    data: Data,
    output: Path,
    *,
    seed: int,
    progress: Progress | None,
    inputs: Sequence[Path],
    reference: Reference | None = None,
    goals: dict[str, float] | None = None,
    extra: dict[str, Any] | None = None,
) -> dict[str, Any]:
    progress = NullProgress() if progress is None else progress
    seconds: dict[str, float] = {}
    began = time.perf_counter()
    with progress.stage("Build the plot"), _Clock(seconds, "build"):
        model, parameters = build_plot(plot, seed=seed, bands=drone_bands(plot))
        space = free_space(model, parameters, plot.calibration.free, plot.calibration.relative_sd)
    steps = plot.calibration.max_iterations
    evaluations = steps + (steps + 1) // 2
    with progress.stage("Calibrate", total=evaluations), _Clock(seconds, "calibrate"):
        result = calibrate_plot(
            model,
            parameters,
            data,
            space,
            max_steps=steps,
            report=lambda stage, loss, norm: progress.advance(
                1, stage=stage, loss=f"{loss:.1f}", gradient=f"{norm:.1f}"
            ),
        )
    seconds |= {
        "render": result.seconds["render_s"],
        "search_step": result.seconds["step_s"],
        "search": result.seconds["search_s"],
    }
    _check_finite(result.image_after, plot)
    warnings = _short_of_sites(model, result.after)
    with progress.stage("Write"):
        seconds["total"] = time.perf_counter() - began
        record = provenance(seed=seed, inputs=inputs)
        summary = calibration_files(
            output,
            plot,
            model,
            result,
            reference or Reference(),
            goals or {},
            record,
            seconds,
            peak_memory_mib(),
        )
    return {
        **summary,
        **(extra or {}),
        "timings_s": seconds,
        "peak_memory_mib": peak_memory_mib(),
        "warnings": warnings,
        "converged": result.fit.converged,
        "status": "ok" if result.fit.converged else f"not converged: {result.fit.status}",
    }


def _check_finite(image: Float[Array, "band y x"], plot: Plot) -> None:
    """No NaN reaches a product."""
    bad = int(np.sum(~np.isfinite(np.asarray(image))))
    if bad:
        raise InputError(
            f"{bad} values of the rendered image are not finite. Is the sun near the horizon, or a "
            "parameter at the end of its range?",
            file=plot.file,
        )


def _short_of_sites(model: PlotModel, parameters: PlotParameters) -> list[str]:
    """Species of which more plants are wanted than sites were held ready."""
    ready = np.bincount(np.asarray(model.planting.species), minlength=len(model.taxa))
    return [
        f"{taxon}: the estimate asks for {wanted:.0f} plants, but {sites} sites were held ready; "
        "its cover is too high for its diameter to be planted, so trust neither"
        for taxon, wanted, sites in zip(model.taxa, np.asarray(model.counts(parameters)), ready)
        if wanted > sites
    ]


def peak_memory_mib() -> float:
    """Largest resident memory of the process so far [MiB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0**2 if sys.platform == "darwin" else 1024.0)


class _Clock:
    """Adds the wall time of a block to a table, under a name."""

    def __init__(self, table: dict[str, float], name: str) -> None:
        self._table, self._name = table, name

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._table[self._name] = time.perf_counter() - self._began
