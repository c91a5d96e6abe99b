"""What a calibration found, as files and a page: of a command, and of a script."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from pydantic import Field

from fynjax._core.precision import double_precision
from fynjax._core.saved import save
from fynjax.app.assembly import Twin
from fynjax.app.io.plot import Place, Plot, plot_place
from fynjax.app.io.raster import write_run
from fynjax.app.jobs._calibration_page import (
    agreement_sentences,
    block_errors,
    calibration_page,
    is_image,
    parameter_sentences,
    pixel_page,
    status_words,
    twin_sentence,
    write_results,
)
from fynjax.app.jobs._calibration_tables import (
    ReferenceImage,
    band_table,
    calibration_dataset,
    offered_stand,
    seen_images,
    statistic_table,
)
from fynjax.app.jobs._render import check_finite
from fynjax.app.jobs._result import JobResult, Number, ParameterSummary, Record, StatisticSummary
from fynjax.app.jobs._run import Run
from fynjax.inversion import Calibration, parameter_columns, stand_sentence, stand_values
from fynjax.scene import PlotParameters, Scene, with_values

FIT_FILE = "fit.npz"


class TargetSummary(Record):
    """The target that one sensor measured: its file, and how it is weighed."""

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
def fit_report(
    fit: Calibration,
    run: Run | str | Path,
    name: str = "plot",
    *,
    plot: Plot | None = None,
    inputs: Sequence[Path | None] = (),
    reference: ReferenceImage | None = None,
    twin: Twin | None = None,
    command: Literal["calibrate", "demo"] = "calibrate",
) -> CalibrateResult:
    """Write what a calibration found, with a page.

    **Arguments:**

    - `fit`: of `fynjax.fit`.
    - `run`: the job at work, or the folder to write into.
    - `name`: of the plot.
    - `plot`: where it lies, and its files; without one images are in the plot's own frame.
    - `inputs`: the files that the plot and the measurements are from, for the provenance.
    - `reference`: published statistics of the real image, to compare with; none by default.
    - `twin`: whose truth is known.
    - `command`: name of the command in the result.

    **Returns:** `CalibrateResult`.

    **Raises:** `InputError` for a rendered image that is not finite.
    """
    run = run if isinstance(run, Run) else Run(run, seed=fit.problem.settings.seed)
    for _, image in seen_images(fit, "after"):
        check_finite(image, plot)
    place = Place() if plot is None else plot_place(plot)
    reference = ReferenceImage() if reference is None else reference
    data = fit.problem.measured
    stand, parameters = offered_stand(fit.stand(), fit), fit.table()
    truth = []
    if twin is not None:
        space, u = fit.fit.space, jnp.asarray(twin.whitened)
        there = with_values(fit.before, fit.scene.taxa, space.named(u))
        of_stand = stand_values(fit.scene.expected(), there).values()
        stand["truth"] = [float(value) for value in of_stand]
        columns = parameter_columns(fit.fit.names, {"truth": space.physical(u)})
        parameters["truth"] = columns["truth"]
        truth = [twin_sentence(fit, twin, stand, parameters)]
    by_pixel = fit.blocks is not None
    statistics = band_table(fit) if by_pixel else statistic_table(fit, reference)
    if by_pixel:
        agreement = _pixel_sentences(fit, name, plot)
    else:
        agreement = agreement_sentences(name, data, statistics, reference)
    lead = [*truth, stand_sentence(stand), *agreement]
    if by_pixel:
        lead = [stand_sentence(stand), agreement[0]]
    headline = [
        *fit.doubts(), *truth, stand_sentence(stand), *agreement, *parameter_sentences(fit)
    ]  # fmt: skip
    tables = stand, parameters, statistics
    with run.stage("Write"):
        record = run.record(inputs)
        each = "every band and index" if any(map(is_image, data.parts)) else "every statistic"
        words = ("every band", "plot file") if by_pixel else (each, "field table")
        write_results(run, place, fit, tables, record, words)
        if not by_pixel:
            if len(factors := fit.factors()):
                run.table("bands.csv", factors, "gain and model's error of every band, apart")
            dataset = calibration_dataset(fit.scene, fit)
            write_run(run.path("run.nc", "the whole run, NetCDF"), dataset, record)
        try:
            save(run.folder / FIT_FILE, (fit.problem, fit.states))
            run.path(FIT_FILE, "the fit, for fynjax.read_fit")
        except TypeError as error:  # of a view or a function of one's own
            warnings.warn(f"no {FIT_FILE} is written: {error}", stacklevel=2)
        page = (
            pixel_page(run, name, fit, tables, [*fit.doubts(), *lead], record)
            if by_pixel
            else calibration_page(run, name, fit, tables, reference, lead, record)
        )
        run.page(page)
    rows = statistics.rename(columns={"real": "target"})
    ends = fit.ends
    return run.result(
        CalibrateResult,
        command=command,
        converged=bool(fit.fit.converged) and not fit.worse,
        worse_than_table=fit.worse,
        misfit_times=fit.misfit / fit.degrees,
        status=status_words(fit),
        headline=headline,
        warnings=[] if by_pixel else _short_of_sites(fit.scene, fit.after),
        targets=_targets(fit),
        parameters=parameters[list(ParameterSummary.model_fields)].to_dict("records"),
        statistics=rows.filter(list(StatisticSummary.model_fields)).to_dict("records"),
        weakly_constrained_directions=fit.fit.weakly_constrained_directions(),
        starts=StartSummary(
            objective=ends.objective.tolist(), apart_sd=ends.apart.tolist(), minima=ends.minima
        ),
    )


def _pixel_sentences(fit: Calibration, name: str, plot: Plot | None) -> list[str]:
    """How well an image is met pixel by pixel."""
    blocks = fit.blocks
    assert blocks is not None
    before, after, with_error = block_errors(fit)
    note = None if plot is None else plot.crowns_note
    return [
        f"{name}: {fit.degrees} means of {blocks.size} x {blocks.size} pixels compared; "
        f"their relative error {before:.2f} % before, {after:.2f} % after, {with_error:.2f} % with "
        "the camera's gains and the model's error as estimated.",
        *([] if note is None else [note]),
        "Covers follow from the crowns and are not free.",
    ]


def _targets(fit: Calibration) -> list[TargetSummary]:
    """What each sensor measured."""
    sources = [part.source for part in fit.problem.measured.parts]
    return [
        TargetSummary(
            kind="image" if one.kind == "pixels" else one.kind,
            file="" if one.file is None else one.file.name,
            description=one.description,
            **one.extra,
        )
        for one in sources
        if one is not None
    ]


def _short_of_sites(scene: Scene, parameters: PlotParameters) -> list[str]:
    """Species of which more plants are wanted than sites were held ready."""
    ready = np.bincount(np.asarray(scene.planting.species), minlength=len(scene.taxa))
    return [
        f"{taxon}: the estimate asks for {wanted:.0f} plants, but {sites} sites were held ready; "
        "its cover is too high for its diameter to be planted, so trust neither"
        for taxon, wanted, sites in zip(scene.taxa, np.asarray(scene.counts(parameters)), ready)
        if wanted > sites
    ]
