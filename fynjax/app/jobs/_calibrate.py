"""The job of `fynjax calibrate`: parameters of a plot that explain its measurements."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import placed_by_image, plant_twin, plot_problem, read_targets, twin_image
from fynjax.app.io.plot import NO_PRIOR, Plot, as_plot, with_prior
from fynjax.app.jobs._calibration_tables import ReferenceImage
from fynjax.app.jobs._doubt import doubt_targets
from fynjax.app.jobs._fit_report import FIT_FILE, CalibrateResult, fit_report
from fynjax.app.jobs._follow import calibrated
from fynjax.app.jobs._run import Run, paths_of
from fynjax.inversion import Data, ImageView


@double_precision
def calibrate(
    plot: Plot | str | Path,
    targets: str | Path | Sequence[str | Path],
    output: str | Path,
    *,
    prior: str | Path = NO_PRIOR,
    bands: Names | None = None,
    seed: Seed | None = None,
    checkpoint: Path | None = None,
    twin: bool = False,
) -> CalibrateResult:
    """Find the parameters of a plot that explain what was measured of it.

    By one sensor or several at once. An interrupted run goes on when the same command is given
    again.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `targets`: what was measured, at most one of each kind. Drone image (GeoTIFF, reflectance) or
      a table with statistic, value, sd. Spectrum (CSV, ASD, ENVI library) or image of many bands
      (ENVI, NetCDF, GeoTIFF), of which the mean counts. Point cloud (LAS, LAZ) or a table with
      metric, value, sd, grain_m, returns_m2. Of a plot with crowns an image (GeoTIFF) of the whole
      plot counts alone, pixel by pixel. Left out, the views that the plot file states.
    - `output`: folder of the results, made if missing.
    - `prior`: population that the plot is of, for what its files leave open: the name of a shipped
      one, a file that `fynjax bioscape learn` wrote, or none.
    - `bands`: what each band of the drone image is, names with commas between, where the file does
      not say: green, red, red_edge, nir, others as the sensor calls them, such as blue, and any
      other name for bands that are not used.
    - `seed`: seed of everything random; the plot file's if left out.
    - `checkpoint`: folder that keeps every step, from which an interrupted run goes on; none by
      default.
    - `twin`: calibrate a twin instead, whose truth is known: drawn from the prior, planted with a
      seed of its own, measured by the sensors of the targets, or by its drone without any, with
      noise and gains. Tables and page have the truth beside the estimate.

    **Returns:** `CalibrateResult`. Writes `parameters.csv`, `statistics.csv`, the images before and
    after (GeoTIFF) of a drone's camera, `run.nc`, `fit.npz` (`fynjax.read_fit` opens it again in
    Python), figures and a page into `output`.

    **Raises:** `InputError` as `read_plot` and the readers of the measurements, for a rendered
    image that is not finite, for a checkpoint of another run, and without targets or a twin.

    Example: `jobs.calibrate("plot.toml", Path("drone.tif"), Path("results"))`.
    """
    paths = paths_of(targets)
    read = with_prior(placed_by_image(as_plot(plot), paths), prior)
    if not paths and not twin and not read.targets:
        raise InputError(
            "expected what was measured (--target, or [[target]] in the plot file), or --twin"
        )
    run = Run(output, seed=seed, plot=read)
    data = read_targets(read, paths, bands=bands, seed=run.seed, by_pixel=True)
    if twin and data is not None and data.pixels is not None:
        raise InputError(
            "expected no twin of a plot whose crowns are known and whose image counts pixel by "
            "pixel; leave the image out, for a twin by its statistics",
            file=paths[0],
        )
    return calibrate_to(
        read, twin_image(read) if data is None else data, run,
        inputs=(*read.inputs, *paths), checkpoint=checkpoint, twin=twin,
    )  # fmt: skip


@double_precision
def calibrate_to(
    plot: Plot,
    data: Data,
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
    - `data`: the statistics of each sensor with their errors.
    - `run`: the job at work.
    - `inputs`: the files that the plot and the measurements are from, for the provenance.
    - `reference`: published statistics of the real image, to compare with; none by default.
    - `checkpoint`: as for `calibrate`.
    - `command`: name of the command in the result.
    - `twin`: as for `calibrate`, of which `data` say what sensors measure.

    **Returns:** `CalibrateResult`. Writes the files of `calibrate` into the folder of `run`.

    **Raises:** `InputError` as `calibrate`.
    """
    if not twin:
        doubt_targets(run, plot, data)
    with run.stage("Build the plot", "build"):
        problem = plot_problem(plot, data, seed=run.seed)
    views = [view for view in problem.views if isinstance(view, ImageView)]
    images = [f"image_{when}{f'_{v.view}' if v.view else ''}.tif" for v in views for when in _WHEN]
    of_chance = data is None or data.pixels is None
    begin_work(
        {"parameters.csv": f"{len(problem.free.names)} parameters", "statistics.csv": ""}
        | dict.fromkeys(images, "")
        | ({"run.nc": f"rounds of at most {problem.settings.max_steps} steps"} if of_chance else {})
        | {FIT_FILE: "", "report.html": ""}
    )
    known = None
    if twin:
        with run.stage("Measure the twin", "twin"):
            known = plant_twin(problem, plot.calibration.target_sd, seed=run.seed)
        problem = problem.with_data(known.measured)
    with run.stage("Calibrate", "calibrate", total=problem.settings.evaluations):
        fit = calibrated(problem, run, checkpoint)
    return fit_report(
        fit, run, plot.name, plot=plot, inputs=inputs, reference=reference, twin=known,
        command=command,
    )  # fmt: skip


_WHEN = "before", "after"
