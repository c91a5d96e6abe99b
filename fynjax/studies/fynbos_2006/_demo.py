"""The job of `fynjax demo`: the 2006 plot calibrated to the statistics of its real drone image."""

from pathlib import Path

import numpy as np

from fynjax._core.precision import double_precision
from fynjax.assembly import Measured, drone_view
from fynjax.compare import bands_2006, consistent_targets, table4_2006
from fynjax.inversion import weigh_targets
from fynjax.io.plot import Plot, example_folder, free_parameters, read_plot
from fynjax.jobs import CalibrateResult, ReferenceImage, Run, calibrate_to
from fynjax.metrics import BANDS
from fynjax.studies.fynbos_2006._aviris import aviris_target

_LAST_DIGIT = 0.0005 / 3**0.5
"""Standard deviation of a number that is printed with three decimals."""
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
    seed: int,
    with_aviris: bool = False,
    twin: bool = False,
    checkpoint: Path | None = None,
) -> CalibrateResult:
    """Calibrate the shipped 2006 plot to the published statistics of its real drone image.

    **Arguments:**

    - `output`: folder of the results, made if missing.
    - `seed`: seed of every random number.
    - `with_aviris`: fit the published numbers of the plot's AVIRIS-NG spectrum too, by which the
      gains of the drone's camera are known better; water of the leaves is then free as well.
    - `twin`: calibrate a twin of the plot, whose truth is known, as `jobs.calibrate` does.
    - `checkpoint`: folder that keeps every step, from which an interrupted run goes on; none by
      default.

    **Returns:** `CalibrateResult`. Writes the files of `jobs.calibrate` into `output`.
    """
    plot = read_plot(example_folder() / "plot.toml")
    if with_aviris:
        table = plot.calibration
        free = [*free_parameters(plot), "species.*.leaf.water"]
        plot = plot.replace(calibration=table.model_copy(update={"free": free}))
    rows = table4_2006().items()
    reference = ReferenceImage(
        {t.key: t.value for t in consistent_targets()},
        {f"{n}.mean": r.sim_mean for n, r in rows} | {f"{n}.std": r.sim_std for n, r in rows},
        {f"{n}.mean": 100.0 * b.sim_abs_difference for n, b in bands_2006().items()},
        goals={"mean of a band": 3.0, "mean of an index": 5.0},
    )
    return calibrate_to(
        plot,
        demo_targets(plot, with_aviris=with_aviris),
        Run(output, seed=seed, plot=plot),
        inputs=plot.inputs,
        reference=None if twin else reference,
        command="demo",
        checkpoint=checkpoint,
        twin=twin,
    )


@double_precision
def demo_targets(plot: Plot | None = None, *, with_aviris: bool = False) -> tuple[Measured, ...]:
    """Targets of `demo`: published statistics of the real drone image.

    **Arguments:**

    - `plot`: whose file says how the camera looks, and the model's error; the shipped one by
      default.
    - `with_aviris`: the published numbers of the plot's AVIRIS-NG spectrum too.

    **Returns:** of each sensor the numbers with their errors (`data`), and how it sees a scene
    (`view_of`).
    """
    plot = read_plot(example_folder() / "plot.toml") if plot is None else plot
    targets = [t for t in consistent_targets() if t.key in DEMO_TARGETS]
    names, share = tuple(t.key for t in targets), plot.calibration.target_sd
    value = np.array([t.value for t in targets])
    # The band means are known to three decimals.
    sd = np.where([t.derived for t in targets], np.hypot(share * value, _LAST_DIGIT), np.nan)
    data = weigh_targets(names, value, share, sd=sd)
    description = f"{len(names)} published statistics of the real drone image."
    image = Measured("image", plot.file, data, drone_view(plot, names), description)
    return (image, aviris_target(plot.file)) if with_aviris else (image,)
