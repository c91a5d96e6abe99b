"""What a run leaves in its folder: image, run file, tables, figures, page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr

from fynjax.assembly import Measured
from fynjax.inversion import Calibration
from fynjax.io.plot import Plot, plot_place
from fynjax.io.raster import image_array, write_geotiff, write_run
from fynjax.io.text import write_text
from fynjax.jobs._calibration_tables import (
    Reference,
    calibration_dataset,
    largest_errors,
    parameter_table,
    plant_counts,
    statistic_table,
)
from fynjax.metrics import BANDS, VEGETATION_INDICES, vegetation_indices
from fynjax.report.figures import (
    composites,
    constraint_plot,
    convergence_plot,
    error_bars,
    index_histograms,
    parameter_plot,
    save_figure,
)
from fynjax.report.pages import Page, sensor_figure, sensor_headline, sensor_section
from fynjax.scene import PlotModel

Record = Mapping[str, str | int]

_SHOWN = ("NDVI", "GNDVI", "SR", "GCI", "ARI2", "OSAVI", "GSAVI", "NormR")


def _indices(image: np.ndarray, names: tuple[str, ...] = _SHOWN) -> dict[str, np.ndarray]:
    return dict(zip(names, np.asarray(vegetation_indices(jnp.asarray(image), names))))


def _write_image(
    folder: Path, name: str, image: np.ndarray, plot: Plot, model: PlotModel, record: Record
) -> None:
    place = plot_place(plot)
    write_geotiff(
        folder / name,
        image,
        list(BANDS),
        pixel_m=plot.sensor.pixel_m,
        origin_m=place.origin_m,
        crs=place.crs,
        wavelengths=list(model.camera.bands.centre),
        tags={k: str(v) for k, v in record.items()},
    )


def render_files(
    folder: Path,
    plot: Plot,
    model: PlotModel,
    image: np.ndarray,
    counts: np.ndarray,
    record: Record,
) -> dict[str, str]:
    """Write what a render makes; file names with what they hold."""
    _write_image(folder, "image.tif", image, plot, model, record)
    reflectance = image_array(
        image,
        list(BANDS),
        list(model.camera.bands.centre),
        pixel_m=plot.sensor.pixel_m,
        long_name="simulated reflectance factor",
    )
    write_run(
        folder / "run.nc",
        xr.Dataset({"reflectance": reflectance, "plants": plant_counts(model, counts)}),
        record,
    )
    figures = {
        kind: composites({plot.name: image}, BANDS, pixel_m=plot.sensor.pixel_m, kind=kind)
        for kind in ("true_like", "false_colour")
    }
    page = Page(plot.name, "The drone image that the plot file describes.")
    page.key_figures(
        {f"mean {b.replace('_', ' ')}": f"{v:.3f}" for b, v in zip(BANDS, image.mean((1, 2)))}
    )
    for kind, figure in figures.items():
        save_figure(figure, folder / f"{kind}.png")
        page.figure(folder / f"{kind}.png", f"Simulated image, {kind.replace('_', ' ')}.")
    histogram = index_histograms(_indices(image))
    save_figure(histogram, folder / "indices.png")
    page.figure(folder / "indices.png", "Vegetation indices over the pixels.")
    page.table(
        pd.DataFrame({"taxon": model.taxa, "plants": counts}), caption="Plants, equation (10)."
    )
    page.footer(record)
    page.write(folder / "report.html")
    return {
        "image.tif": "simulated reflectance, GeoTIFF",
        "run.nc": "image and plant counts, NetCDF",
        "true_like.png": "image, nearly natural colours",
        "false_colour.png": "image, near infrared as red",
        "indices.png": "histograms of vegetation indices",
        "report.html": "all of it on one page",
    }


def calibration_files(
    folder: Path,
    plot: Plot,
    model: PlotModel,
    result: Calibration,
    measured: Sequence[Measured],
    reference: Reference,
    goals: Mapping[str, float],
    record: Record,
    seconds: Mapping[str, float],
    memory_mib: float,
) -> dict[str, Any]:
    """Write what a calibration makes; the summary for the command line."""
    parameters, statistics = parameter_table(result), statistic_table(result, reference)
    write_text(folder / "parameters.csv", parameters.to_csv(index=False, float_format="%.6g"))
    write_text(folder / "statistics.csv", statistics.to_csv(index=False, float_format="%.6g"))
    files = {
        "report.html": "all of it on one page",
        "parameters.csv": "prior, estimate, sd of every parameter",
        "statistics.csv": "every band and index, real and simulated"
        if result.image_before is not None
        else "every statistic, real and simulated",
    }
    if result.image_before is not None:
        for when, what in (("before", "of the field table"), ("after", "after calibration")):
            image = np.asarray(getattr(result, f"image_{when}"))
            _write_image(folder, f"image_{when}.tif", image, plot, model, record)
            files[f"image_{when}.tif"] = f"image {what}, GeoTIFF"
    write_run(folder / "run.nc", calibration_dataset(plot, model, result), record)

    figures = _figures(plot, result, parameters, statistics, reference)
    for one in measured:
        if one.kind != "image":
            figures[one.kind] = sensor_figure(one, statistics)
    for name, (figure, _) in figures.items():
        save_figure(figure, folder / f"{name}.png")
    headline = _headline(plot, result, measured, statistics, reference)
    _page(
        folder,
        plot,
        result,
        measured,
        parameters,
        statistics,
        headline,
        goals,
        record,
        seconds,
        memory_mib,
    )
    shown = ("name", "kind", "unit", "prior", "prior_sd", "estimate", "sd", "constrained")
    ends = result.ends
    return {
        "headline": headline,
        "files": {
            **files,
            "run.nc": "the whole run, NetCDF",
            **{f"{name}.png": caption for name, (_, caption) in figures.items()},
        },
        "targets": [
            {"kind": one.kind, "file": one.file.name, "told": one.told} for one in measured
        ],
        "parameters": [{k: row[k] for k in shown} for row in parameters.to_dict("records")],
        "statistics": [
            {
                "statistic": r["statistic"],
                "fitted": r["fitted"],
                "target": r["real"],
                "target_sd": r["target_sd"],
                "before": r["before"],
                "after": r["after"],
                "reference": r["reference"],
            }
            for r in statistics.to_dict("records")
        ],
        "unseen_directions": result.fit.unseen_directions(),
        "starts": {
            "objective": ends.objective.tolist(),
            "apart_sd": ends.apart.tolist(),
            "minima": ends.minima,
        },
    }


def _headline(
    plot: Plot,
    result: Calibration,
    measured: Sequence[Measured],
    statistics: pd.DataFrame,
    reference: Reference,
) -> list[str]:
    lines = []
    if result.image_before is not None:
        bands, indices = largest_errors(statistics)
        theirs = list(reference.error_percent.values())
        low, high = (min(theirs), max(theirs)) if theirs else (0.0, 0.0)
        own = f" (the paper's own simulation: {low:.1f} to {high:.1f} %)" if theirs else ""
        told = (("a band mean", bands, own), ("a fitted index mean", indices, ""))
        lines = [
            f"Largest error of {what} {found['before']:.1f} % before, {found['after']:.1f} % after"
            f"{more}."
            for what, found, more in told
            if np.isfinite(found["after"])  # none of the kind may be a target
        ]
        lines[:1] = [f"{plot.name}: {line[0].lower()}{line[1:]}" for line in lines[:1]]
    for one in measured:
        if one.kind != "image":
            lines.append(sensor_headline(one, statistics))
    seen = result.fit.seen()
    lines.append(
        f"The data at least halve the error of {len(seen)} of {len(result.fit.names)} parameters"
        + (f": {', '.join(seen)}. The others rest on the prior." if seen else ".")
    )
    ends = result.ends
    if len(ends.objective) > 1:
        minima = f"{ends.minima} minima" if ends.minima > 1 else "one minimum"
        lines.append(
            f"{len(ends.objective)} starts ended in {minima}, objectives "
            f"{ends.objective.min():.4g} to {ends.objective.max():.4g}, up to "
            f"{ends.apart.max():.2g} posterior sd apart; the best is kept."
        )
    return [*lines, result.fit.status]


def _figures(
    plot: Plot,
    result: Calibration,
    parameters: pd.DataFrame,
    statistics: pd.DataFrame,
    reference: Reference,
) -> dict[str, tuple[Any, str]]:
    common = {
        "parameters": (parameter_plot(parameters), "prior and estimate of every parameter"),
        "constraint": (constraint_plot(parameters), "how far the data pinned each parameter down"),
        "convergence": (
            convergence_plot(result.fit.loss, result.fit.gradient_norm),
            "objective at each evaluation",
        ),
    }
    if result.image_before is None:
        return common
    before, after = np.asarray(result.image_before), np.asarray(result.image_after)
    pair = {"Before": before, "After": after}
    value = dict(zip(statistics["statistic"], statistics["real"]))
    target = {
        name: (value[f"{name}.mean"], value.get(f"{name}.std", float("nan")))
        for name in VEGETATION_INDICES
        if f"{name}.mean" in value
    }
    shown = tuple(n for n in _SHOWN if n in target) or _SHOWN
    means = statistics[statistics["statistic"].str.endswith(".mean")]
    errors = {
        label: dict(zip(means["statistic"].str.removesuffix(".mean"), means[f"{c}_error_percent"]))
        for label, c in (("before", "before"), ("after", "after"))
    }
    if reference.simulated:
        errors["DIRSIG (paper)"] = dict(
            zip(means["statistic"].str.removesuffix(".mean"), means["reference_error_percent"])
        )
    pixel = plot.sensor.pixel_m
    return {
        "true_like": (
            composites(pair, BANDS, pixel_m=pixel, kind="true_like"),
            "image before and after, nearly natural colours",
        ),
        "false_colour": (
            composites(pair, BANDS, pixel_m=pixel),
            "image before and after, near infrared as red",
        ),
        "errors": (error_bars(errors), "error of each mean"),
        "indices": (
            index_histograms(
                _indices(before, shown),
                _indices(after, shown),
                {k: target[k] for k in shown if k in target},
            ),
            "histograms of indices",
        ),
        **common,
    }


def _page(
    folder: Path,
    plot: Plot,
    result: Calibration,
    measured: Sequence[Measured],
    parameters: pd.DataFrame,
    statistics: pd.DataFrame,
    headline: list[str],
    goals: Mapping[str, float],
    record: Record,
    seconds: Mapping[str, float],
    memory_mib: float,
) -> None:
    drone = result.image_before is not None
    about = len(headline) - 2 - (len(result.ends.objective) > 1)
    page = Page(f"Calibration: {plot.name}", " ".join(headline[:about]))
    keys = {
        "evaluations": str(len(result.fit.loss)),
        "wall time": f"{seconds['total']:.0f} s",
        "peak memory": f"{memory_mib / 1024:.1f} GiB",
    }
    if drone:
        bands, indices = largest_errors(statistics)
        both = {"a band mean": bands["after"], "a fitted index mean": indices["after"]}
        largest = {
            f"largest error of {what}": f"{error:.1f} %"
            for what, error in both.items()
            if np.isfinite(error)
        }
        keys = {**largest, **keys}
    page.key_figures(keys)
    if goals:
        page.paragraph(
            "Aimed at: " + ", ".join(f"{k} within {v:g} %" for k, v in goals.items()) + "."
        )
    for one in measured:
        if one.kind != "image":
            sensor_section(page, folder, one, statistics)
            continue
        page.section("The image").figure(folder / "true_like.png", "Nearly natural colours.")
        page.figure(folder / "false_colour.png", "False colour.")
        page.section("Against the real image").figure(
            folder / "errors.png", "Relative error of each mean, before and after."
        )
        page.figure(
            folder / "indices.png", "Indices over the pixels; the real mean and spread marked."
        )
    page.table(statistics, caption="Every statistic.", folded=True)
    page.section("The parameters").paragraph(" ".join(headline[about:]))
    page.figure(folder / "parameters.png", "Prior and estimate, one standard deviation.")
    page.figure(folder / "constraint.png", "Share of the prior variance that the data removed.")
    unseen = result.fit.unseen_directions()
    page.paragraph(
        "Combinations that the data cannot tell (largest members): "
        + "; ".join(", ".join(f"{n} {w:+.2f}" for n, w in d.items()) for d in unseen)
        + "."
    )
    page.table(parameters, caption="Every parameter.", folded=True)
    page.section("The search").figure(folder / "convergence.png", "Objective at each evaluation.")
    if len(result.ends.objective) > 1:
        page.table(
            pd.DataFrame(
                {
                    "start": ["prior's centre"]
                    + [f"draw {i}" for i in range(1, len(result.ends.objective))],
                    "objective": result.ends.objective,
                    "from the best end, posterior sd": result.ends.apart,
                }
            ),
            caption="Where each search ended.",
        )
    page.table(
        pd.DataFrame({"what": list(seconds), "seconds": list(seconds.values())}),
        caption=f"Wall time; peak memory {memory_mib:.0f} MiB.",
    )
    page.footer(record)
    page.write(folder / "report.html")
