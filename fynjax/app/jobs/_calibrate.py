"""The job of `fynjax calibrate`: parameters of a plot that explain its measurements."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import (
    Measured,
    parameter_columns,
    placed_by_image,
    plant_twin,
    prepare,
    read_targets,
    twin_image,
)
from fynjax.app.io.plot import NO_PRIOR, Plot, as_plot, with_prior
from fynjax.app.io.raster import write_run
from fynjax.app.jobs._calibrate_known import known_plants
from fynjax.app.jobs._calibration_page import (
    agreement_sentences,
    calibration_page,
    parameter_sentences,
    status_of,
    twin_sentence,
    write_results,
)
from fynjax.app.jobs._calibration_tables import (
    ReferenceImage,
    calibration_dataset,
    offered_stand,
    parameter_table,
    statistic_table,
)
from fynjax.app.jobs._doubt import doubt_targets
from fynjax.app.jobs._follow import calibrated
from fynjax.app.jobs._render import check_finite
from fynjax.app.jobs._result import JobResult, Number, ParameterSummary, Record, StatisticSummary
from fynjax.app.jobs._run import Run, paths_of
from fynjax.inversion import (
    Calibration,
    KnownPlants,
    stand_sentence,
    stand_values,
)
from fynjax.scene import PlotParameters, Scene, with_values


class TargetSummary(Record):
    """What one sensor measured."""

    kind: str
    file: str
    description: str
    target_valid_share: Number = None
    spectra: int | None = None
    spectrum_bands: int | None = None
    returns: int | None = None
    ground: str | None = None
    grain_m: Number = None


class StartSummary(Record):
    """Where the searches ended."""

    objective: list[float]
    apart_sd: list[Number]
    minima: int


class CalibrateResult(JobResult):
    """Result of `calibrate` and `demo`: parameters and statistics before and after."""

    command: Literal["calibrate", "demo"] = "calibrate"
    targets: list[TargetSummary]
    parameters: list[ParameterSummary]
    statistics: list[StatisticSummary]
    weakly_constrained_directions: list[dict[str, float]]
    starts: StartSummary
    worse_than_table: bool = Field(
        default=False,
        description="Whether more bands moved away from what was measured than nearer: then the "
        "values to use, `offered`, are those of the table.",
    )
    misfit_times: Number = Field(
        default=None,
        description="Misfit and distance from the prior over what is expected of both.",
    )


@double_precision
def calibrate(
    plot: Plot | str | Path,
    targets: str | Path | Sequence[str | Path],
    output: str | Path,
    *,
    prior: str | Path = NO_PRIOR,
    bands: Sequence[str] | None = None,
    seed: int | None = None,
    checkpoint: Path | None = None,
    twin: bool = False,
) -> CalibrateResult:
    """Calibrate a plot to the measurements of one or several sensors.

    **Arguments:**

    - `plot`: a plot, or the path of its plot file.
    - `targets`: files of the measurements, at most one of each kind: a drone image (GeoTIFF) or
      its statistics (CSV); a spectrum, or an image of many bands; a point cloud or its structure
      (CSV). Of a plot with crowns an image (GeoTIFF) of the whole plot counts alone, pixel by
      pixel (`calibrate_known_plants`).
    - `output`: folder of the results, made if missing.
    - `prior`: learned population of what the plot's files leave open (`with_prior`); none by
      default.
    - `bands`: what each band of a drone's image is, as `read_drone_image` has it; known by name or
      wavelength by default.
    - `seed`: seed of every random number; that of the plot file by default.
    - `checkpoint`: folder that keeps every step, from which an interrupted run goes on; none by
      default.
    - `twin`: calibrate a twin of the plot in place of the plot, whose parameters are drawn from the
      prior, to what the sensors of the targets would measure of it, or its drone where there are no
      targets; tables and page have the truth beside the estimate.

    **Returns:** `CalibrateResult`. Writes `parameters.csv`, `statistics.csv`, the images before and
    after (GeoTIFF) of a drone's camera, `run.nc`, figures and a page into `output`.

    **Raises:** `InputError` as `read_plot` and the readers of the measurements, for a rendered
    image that is not finite, for a checkpoint of another run, and without targets or a twin.

    Example: `jobs.calibrate("plot.toml", Path("drone.tif"), Path("results"))`.
    """
    paths = paths_of(targets)
    if not paths and not twin:
        raise InputError("expected what was measured (--target), or --twin")
    read = with_prior(placed_by_image(as_plot(plot), paths), prior)
    run = Run(output, seed=seed, plot=read)
    if read.known_crowns is not None and any(p.suffix.lower() in (".tif", ".tiff") for p in paths):
        if twin:
            raise InputError(
                "expected no twin of a plot whose crowns are known and whose image counts pixel by "
                "pixel; leave the image out, for a twin by its statistics",
                file=paths[0],
            )
        if len(paths) > 1:
            raise InputError(
                "expected the image alone: where plants are known it counts pixel by pixel, beside "
                "which other targets would say nothing",
                file=paths[1],
            )
        found, parameters, table, headline = known_plants(read, paths[0], run, bands, checkpoint)
        target = TargetSummary(
            kind="image",
            file=paths[0].name,
            description=f"{paths[0].name}: {found.degrees} means of blocks of pixels.",
            target_valid_share=float(np.isfinite(found.measured[0]).mean()),
        )
        return _result(run, found, parameters, table, targets=[target], headline=headline)
    measured = read_targets(read, paths, bands=bands, seed=run.seed)
    return calibrate_to(
        read, measured or (twin_image(read),), run,
        inputs=(*read.inputs, *paths), checkpoint=checkpoint, twin=twin,
    )  # fmt: skip


def _result(
    run: Run,
    result: Calibration | KnownPlants,
    parameters: pd.DataFrame,
    statistics: pd.DataFrame,
    **fields: Any,
) -> CalibrateResult:
    """The result of a calibration with the tables of its parameters and of its statistics."""
    fit, ends = result.fit, result.ends
    rows = statistics.rename(columns={"real": "target"})
    return run.result(
        CalibrateResult,
        converged=bool(fit.converged) and not result.worse,
        worse_than_table=result.worse,
        misfit_times=result.misfit / result.degrees,
        status=status_of(result),
        parameters=parameters[list(ParameterSummary.model_fields)].to_dict("records"),
        statistics=rows.filter(list(StatisticSummary.model_fields)).to_dict("records"),
        weakly_constrained_directions=fit.weakly_constrained_directions(),
        starts=StartSummary(
            objective=ends.objective.tolist(), apart_sd=ends.apart.tolist(), minima=ends.minima
        ),
        **fields,
    )


@double_precision
def calibrate_to(
    plot: Plot,
    measured: Sequence[Measured],
    run: Run,
    *,
    inputs: Sequence[Path | None],
    reference: ReferenceImage | None = None,
    checkpoint: Path | None = None,
    command: Literal["calibrate", "demo"] = "calibrate",
    twin: bool = False,
) -> CalibrateResult:
    """Calibrate a plot to measurements that are already read: the common part of two jobs.

    **Arguments:**

    - `plot`: the plot.
    - `measured`: the statistics of each sensor with their errors.
    - `run`: the job at work.
    - `inputs`: the files that the plot and the measurements are from, for the provenance.
    - `reference`: published statistics of the real image, to compare with; none by default.
    - `checkpoint`: as for `calibrate`.
    - `command`: name of the command in the result.
    - `twin`: as for `calibrate`, of which `measured` says what sensors measure.

    **Returns:** `CalibrateResult`. Writes the files of `calibrate` into the folder of `run`.

    **Raises:** `InputError` as `calibrate`.
    """
    if not twin:
        doubt_targets(run, plot, measured)
    with run.stage("Build the plot", "build"):
        ready = prepare(plot, None, seed=run.seed)
        views = [sensor.view_of(ready.scene, ready.parameters) for sensor in measured]
    images = any(sensor.kind == "image" for sensor in measured)
    begin_work(
        {"parameters.csv": f"{len(ready.space.names)} parameters", "statistics.csv": ""}
        | (dict.fromkeys(["image_before.tif", "image_after.tif"], "") if images else {})
        | {"run.nc": f"rounds of at most {ready.settings.max_steps} steps", "report.html": ""}
    )
    known = None
    if twin:
        with run.stage("Measure the twin", "twin"):
            known = plant_twin(ready, measured, seed=run.seed)
        measured = known.measured
    with run.stage("Calibrate", "calibrate", total=ready.settings.evaluations):
        result = calibrated(ready, measured, views, run, checkpoint)
    if result.image_after is not None:
        check_finite(result.image_after, plot)
    reference = ReferenceImage() if reference is None else reference
    stand = offered_stand(result.stand(), result)
    parameters_of_fit = parameter_table(result)
    truth = []
    if known is not None:
        space, u = result.fit.space, jnp.asarray(known.whitened)
        there = with_values(result.before, result.scene.taxa, space.named(u))
        of_stand = stand_values(result.scene.expected(), there).values()
        stand["truth"] = [float(value) for value in of_stand]
        columns = parameter_columns(result.fit.names, {"truth": space.physical(u)})
        parameters_of_fit["truth"] = columns["truth"]
        truth = [twin_sentence(result, known, stand, parameters_of_fit)]
    tables = stand, parameters_of_fit, (statistics := statistic_table(result, reference))
    agreement = agreement_sentences(plot, measured, statistics, reference)
    headline = [
        *result.doubts(),
        *truth,
        stand_sentence(stand),
        *agreement,
        *parameter_sentences(result),
    ]
    with run.stage("Write"):
        record = run.record(inputs)
        words = "every band and index" if images else "every statistic", "field table"
        write_results(run, plot, result, tables, result.camera, record, words)
        dataset = calibration_dataset(result.scene, result)
        if len(factors := result.factors()):
            run.table("bands.csv", factors, "gain and model's error of every band, apart")
        write_run(run.path("run.nc", "the whole run, NetCDF"), dataset, record)
        lead = [*truth, stand_sentence(stand), *agreement]
        run.page(calibration_page(run, plot, result, measured, tables, reference, lead, record))
    targets = [
        TargetSummary(kind=one.kind, file=one.file.name, description=one.description, **one.extra)
        for one in measured
    ]
    return _result(
        run,
        result,
        parameters_of_fit,
        statistics,
        command=command,
        headline=headline,
        warnings=_short_of_sites(result.scene, result.after),
        targets=targets,
    )


def _short_of_sites(scene: Scene, parameters: PlotParameters) -> list[str]:
    """Species of which more plants are wanted than sites were held ready."""
    ready = np.bincount(np.asarray(scene.planting.species), minlength=len(scene.taxa))
    return [
        f"{taxon}: the estimate asks for {wanted:.0f} plants, but {sites} sites were held ready; "
        "its cover is too high for its diameter to be planted, so trust neither"
        for taxon, wanted, sites in zip(scene.taxa, np.asarray(scene.counts(parameters)), ready)
        if wanted > sites
    ]
