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
from fynjax.assembly import Measured, build_plot, read_targets
from fynjax.compare import bands_2006, consistent_targets, table4_2006
from fynjax.inversion import ImageView, calibrate_plot, free_space, join_data, weigh_targets
from fynjax.io.plot import Plot, as_plot, drone_bands, example_folder, read_plot
from fynjax.io.raster import provenance
from fynjax.jobs._calibration_page import calibration_files, render_files
from fynjax.jobs._calibration_tables import Reference
from fynjax.metrics import BANDS
from fynjax.scene import PlotModel, PlotParameters


def render(
    plot: Plot | str | Path,
    output: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Render a plot's image into `output`: GeoTIFF, NetCDF, figures and a page.

    **Arguments:** `plot`, or its file; `seed`, the plot's if left out.
    """
    progress = NullProgress() if progress is None else progress
    read = as_plot(plot)
    seed = read.seed if seed is None else seed
    seconds: dict[str, float] = {}
    with progress.stage("Build the plot"), _Clock(seconds, "build"):
        model, parameters = build_plot(read, seed=seed, bands=drone_bands(read))
    render = eqx.filter_jit(lambda m, p: (m.image(p), m.counts(p)))
    with progress.stage("Render"), _Clock(seconds, "render"):
        image, counts = jax.block_until_ready(render(model, parameters))
    _check_finite(image, read)
    with progress.stage("Write"):
        record = provenance(seed=seed, inputs=read.inputs)
        files = render_files(output, read, model, np.asarray(image), np.asarray(counts), record)
    means = ", ".join(f"{b} {float(v):.4f}" for b, v in zip(BANDS, jnp.mean(image, axis=(1, 2))))
    return {
        "headline": [f"{read.name}: mean reflectance {means}."],
        "seed": seed,
        "files": files,
        "timings_s": seconds,
        "statistics": [
            {"statistic": f"{b}.mean", "target": None, "before": float(v), "after": None}
            for b, v in zip(BANDS, jnp.mean(image, axis=(1, 2)))
        ],
        "peak_memory_mib": peak_memory_mib(),
    }


def calibrate(
    plot: Plot | str | Path,
    targets: Path | Sequence[Path],
    output: Path,
    *,
    seed: int | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Calibrate a plot to what one or several sensors measured.

    **Arguments:** `plot`, or its file; `seed`, the plot's if left out; `targets`, at most one of
    each kind: a drone image (GeoTIFF) or its statistics (CSV); a spectrum, or an image of many
    bands; a point cloud or its structure (CSV).
    `checkpoint`, a folder that keeps every step: an interrupted run goes on from it.
    """
    progress = NullProgress() if progress is None else progress
    read = as_plot(plot)
    seed = read.seed if seed is None else seed
    paths = [targets] if isinstance(targets, Path) else list(targets)
    found = read_targets(read, paths, seed=seed, progress=progress)
    return _calibrate(
        read,
        found,
        output,
        seed=seed,
        progress=progress,
        inputs=(*read.inputs, *paths),
        checkpoint=checkpoint,
    )


def demo(output: Path, *, seed: int, progress: Progress | None = None) -> dict[str, Any]:
    """Calibrate the shipped 2006 plot to the published statistics of its real drone image."""
    read = read_plot(example_folder() / "plot.toml")
    known = {t.key: t.value for t in consistent_targets()}
    targets = [t for t in consistent_targets() if t.key in DEMO_TARGETS]
    names, share = tuple(t.key for t in targets), read.calibration.target_sd
    value = np.array([t.value for t in targets])
    # The band means are known to three decimals.
    sd = np.where([t.derived for t in targets], np.hypot(share * value, _LAST_DIGIT), np.nan)
    data = weigh_targets(names, value, share, sd=sd)
    told = f"{len(names)} published statistics of the real drone image."
    return _calibrate(
        read,
        (Measured("image", read.file, data, ImageView(names), told),),
        output,
        seed=seed,
        progress=NullProgress() if progress is None else progress,
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


def _calibrate(
    plot: Plot,
    measured: Sequence[Measured],
    output: Path,
    *,
    seed: int,
    progress: Progress,
    inputs: Sequence[Path],
    reference: Reference | None = None,
    goals: dict[str, float] | None = None,
    checkpoint: Path | None = None,
) -> dict[str, Any]:
    seconds: dict[str, float] = {}
    began = time.perf_counter()
    with progress.stage("Build the plot"), _Clock(seconds, "build"):
        # Without a drone's image the bands are those that the other views bring.
        drone = any(one.kind == "image" for one in measured)
        model, parameters = build_plot(plot, seed=seed, bands=drone_bands(plot) if drone else None)
        space = free_space(model, parameters, plot.calibration.free, plot.calibration.relative_sd)
    steps, starts = plot.calibration.max_iterations, plot.calibration.starts
    evaluations = starts * (steps + (steps + 1) // 2)
    with progress.stage("Calibrate", total=evaluations), _Clock(seconds, "calibrate"):
        result = calibrate_plot(
            model,
            parameters,
            join_data([one.data for one in measured]),
            space,
            views=[one.view for one in measured],
            max_steps=steps,
            starts=starts,
            seed=seed,
            checkpoint=checkpoint,
            report=lambda stage, loss, norm: progress.advance(
                1, stage=stage, loss=f"{loss:.1f}", gradient=f"{norm:.1f}"
            ),
        )
    seconds |= {
        "render": result.seconds["render_s"],
        "search_step": result.seconds["step_s"],
        "search": result.seconds["search_s"],
    }
    if result.image_after is not None:
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
            measured,
            reference or Reference(),
            goals or {},
            record,
            seconds,
            peak_memory_mib(),
        )
    return {
        **summary,
        "seed": seed,
        **{key: value for one in measured for key, value in one.extra.items()},
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
