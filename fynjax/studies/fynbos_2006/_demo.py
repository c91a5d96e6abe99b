"""The job of `fynjax demo`: the 2006 plot calibrated to what its drone and AVIRIS-NG measured."""

import dataclasses
from pathlib import Path

import numpy as np

from fynjax._core.arguments import Seed
from fynjax._core.precision import double_precision
from fynjax.app.assembly import image_sight
from fynjax.app.compare import bands_2006, consistent_targets, table4_2006
from fynjax.app.io.plot import Plot, example_folder, free_parameters, read_plot
from fynjax.app.jobs import CalibrateResult, ReferenceImage, Run, calibrate_to
from fynjax.inversion import Data, Source, weigh_targets
from fynjax.metrics import BANDS
from fynjax.studies.fynbos_2006._aviris import aviris_target

_LAST_DIGIT = 0.0005 / 3**0.5
"""Standard deviation of a number that is printed with three decimals."""
_START = (
    "The field table alone is far off, since no leaf spectra of the site are known: leaves, dead "
    "tissue and leaf area are those of 18 plots of the Cape Peninsula, which are less green (mean "
    "NDVI about 0.5; this plot's image has 0.75)."
)
DEMO_TARGETS = (
    *(f"{layer}.mean" for layer in (*BANDS, "NDVI", "GNDVI", "SR", "GCI")),
    *("NDVI.std", "GNDVI.std"),
)
"""Fitted in the demo. The other consistent indices are functions of the same bands; they are
reported beside, as a check."""


@double_precision
def demo(
    output: str | Path,
    *,
    seed: Seed = 0,
    drone_alone: bool = False,
    twin: bool = False,
    checkpoint: Path | None = None,
) -> CalibrateResult:
    """Calibrate the 2006 burn plot to its real drone image and spectrum, from shipped input.

    Builds the 10 m x 10 m plot from the paper's species table, renders the drone image, and
    calibrates cover, crown diameter, leaves and ground against the published statistics of the real
    image and of its AVIRIS-NG spectrum. An interrupted run goes on when the same command is given
    again.

    **Arguments:**

    - `output`: folder of the results, made if missing.
    - `seed`: seed of everything random.
    - `drone_alone`: fit the drone's image alone, without the published numbers of the plot's
      AVIRIS-NG spectrum. Takes two thirds of the time; the camera's gains are known less well, and
      water of the leaves is not free.
    - `twin`: calibrate a twin instead, whose truth is known: drawn from the prior, planted with a
      seed of its own, measured with noise and gains. Tables and page have the truth beside the
      estimate.
    - `checkpoint`: folder that keeps every step, from which an interrupted run goes on; none by
      default.

    **Returns:** `CalibrateResult`. Writes the files of `jobs.calibrate` into `output`.
    """
    plot = read_plot(example_folder() / "plot.toml")
    if not drone_alone:
        table = plot.calibration
        free = [*free_parameters(plot), "species.*.leaf.water"]
        plot = plot.replace(calibration=table.model_copy(update={"free": free}))
    rows = table4_2006().items()
    reference = ReferenceImage(
        {t.key: t.value for t in consistent_targets()},
        {f"{n}.mean": r.sim_mean for n, r in rows} | {f"{n}.std": r.sim_std for n, r in rows},
        {f"{n}.mean": 100.0 * b.sim_abs_difference for n, b in bands_2006().items()},
        goals={"a band mean": 3.0, "a fitted index mean": 5.0},
        start=_START,
    )
    return calibrate_to(
        plot,
        demo_targets(plot, drone_alone=drone_alone),
        Run(output, seed=seed, plot=plot),
        inputs=plot.inputs,
        reference=None if twin else reference,
        command="demo",
        checkpoint=checkpoint,
        twin=twin,
    )


@double_precision
def demo_targets(plot: Plot | None = None, *, drone_alone: bool = False) -> Data:
    """Targets of `demo`: published statistics of the real drone image, and of the plot's AVIRIS-NG
    spectrum.

    **Arguments:**

    - `plot`: whose file says how the camera looks, and the model's error; the shipped one by
      default.
    - `drone_alone`: those of the image alone.

    **Returns:** the numbers of each sensor with their errors, and how it sees a scene.
    """
    plot = read_plot(example_folder() / "plot.toml") if plot is None else plot
    targets = [t for t in consistent_targets() if t.key in DEMO_TARGETS]
    names, share = tuple(t.key for t in targets), plot.calibration.target_sd
    value = np.array([t.value for t in targets])
    # The band means are known to three decimals.
    sd = np.where([t.derived for t in targets], np.hypot(share * value, _LAST_DIGIT), np.nan)
    data = weigh_targets(names, value, share, sd=sd)
    description = f"{len(names)} published statistics of the real drone image."
    source = Source("image", image_sight(plot, names), description, plot.file)
    image = dataclasses.replace(data, source=source)
    return image if drone_alone else image + aviris_target(plot.file)
