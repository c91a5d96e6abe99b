"""The job of `fynjax design`: the most informative bands of a sensor on a plot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.precision import double_precision
from fynjax.app.assembly import plot_problem
from fynjax.app.io.instruments import load_instrument
from fynjax.app.io.plot import Plot, as_plot
from fynjax.app.io.text import write_text
from fynjax.app.jobs._result import JobResult, Rows
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.inversion import CAMERAS, DESIGN_FREE, DESIGN_TARGET, BandDesign, check_design, design


class DesignResult(JobResult):
    """Result of `design`: the bands, and their information beside that of other sensors."""

    command: Literal["design"] = "design"
    bands: Rows
    """Rows of design.csv."""
    sensors: Rows
    """Rows of sensors.csv."""


@double_precision
def design_bands(
    plot: Plot | str | Path,
    output: str | Path,
    *,
    bands: Annotated[int, Field(ge=1)] = 4,
    target: Names = DESIGN_TARGET,
    free: Sequence[str] | None = None,
    pixel: float | Sequence[float] = 0.1,
    spectrum: tuple[float, float] = (400.0, 2500.0),
    widths: tuple[float, float] = (10.0, 100.0),
    snr: float = 100.0,
    plantings: Annotated[int, Field(ge=4)] = 6,
    compare: Names = CAMERAS,
    starts: Annotated[int, Field(ge=1)] = 8,
    seed: Seed | None = None,
) -> DesignResult:
    """Find the most informative bands of a sensor on a plot, beside those of other sensors.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `output`: folder of the results, made if missing.
    - `bands`: bands of the sensor.
    - `target`: what the bands are to inform of: numbers of the stand (green_leaf_area, crown_cover,
      shannon, ...), names or patterns of free parameters; or information, or separability.
    - `free`: unknown parameters, such as species.*.cover. If left out, covers, diameters, dead
      tissue, chlorophyll, water, dry matter and the ground.
    - `pixel`: side of a pixel [m]; of several, multiples of the smallest, the best is taken.
    - `spectrum`: range of the detector [nm], such as 400,2500.
    - `widths`: least and greatest width of a band [nm], such as 10,100.
    - `snr`: signal over shot noise of a pixel, the smallest, in 10 nm at 550 nm over a reflectance
      of 0.1.
    - `plantings`: plantings over which the target is a mean.
    - `compare`: other sensors, by name or file.
    - `starts`: ascents.
    - `seed`: seed of everything random; the plot file's if left out.

    **Returns:** `DesignResult`. Writes `design.csv`, `designed.toml` (a sensor file),
    `sensors.csv`, `pixels.csv`, `spectra.nc`, figures and a page into `output`.

    **Raises:** `InputError` as `read_plot` and `fynjax.inversion.design`.

    Example: `jobs.design_bands("plot.toml", Path("results"), bands=3, target=["dead_share"])`.
    """
    read = as_plot(plot)
    run = Run(output, seed=seed, plot=read)
    with run.stage("Build the plot"):
        problem = plot_problem(read, None, DESIGN_FREE if free is None else free, seed=run.seed)
    names = ("design.csv", "designed.toml", "sensors.csv", "pixels.csv", "spectra.nc")
    files = dict.fromkeys((*names, "report.html"), "")
    wanted: str | Sequence[str] = target[0] if len(target) == 1 else target
    settings: dict[str, Any] = {
        "free": problem.free, "pixel": pixel, "spectrum": spectrum, "widths": widths, "snr": snr,
        "plantings": plantings, "compare": [load_instrument(one) for one in compare],
        "starts": starts, "seed": run.seed,
    }  # fmt: skip
    check_design(problem.scene, bands, wanted, **settings)
    begin_work(files)
    found = design(problem.scene, bands, wanted, error=problem.error, **settings)
    chosen = pd.DataFrame(
        {"band": found.bands.names, "centre_nm": found.bands.centre, "fwhm_nm": found.bands.fwhm}
    )
    with run.stage("Write"):
        run.table("design.csv", chosen, "centre and width of each band")
        run.table(
            "sensors.csv", found.table, "the target of each sensor, and what the design gains"
        )
        run.table("pixels.csv", found.pixels, "the target in pixels of each size")
        write_text(run.path("designed.toml", "the bands as a sensor file"), _sensor_file(found))
        found.spectra.to_netcdf(
            run.path("spectra.nc", "responses, spectra and slopes over wavelength")
        )
        record = run.record(read.inputs)
        headline = str(found).splitlines()
        title, sections = f"Design: {read.name}", _sections(found, chosen)
        run.page(Page("design", title, " ".join(headline), sections, record=record))
    return run.result(DesignResult, headline=headline, bands=chosen, sensors=found.table)


def _sensor_file(found: BandDesign) -> str:
    names, centres, widths = (
        ", ".join(f'"{v}"' if isinstance(v, str) else f"{v:.1f}" for v in values)
        for values in (found.bands.names, found.bands.centre, found.bands.fwhm)
    )
    return (
        f'name = "designed"\nsource = "fynjax design: {found.target}"\n\n[geometry]\n'
        f'kind = "orthographic"\npixel_m = {found.pixel:g}\n\n[bands]\nresponse = "gaussian"\n'
        f"name = [{names}]\ncentre_nm = [{centres}]\nfwhm_nm = [{widths}]\n"
    )


def _sections(found: BandDesign, chosen: pd.DataFrame) -> list[Section]:
    shown = Picture(
        "design.png", figures.design_plot(found), "the bands over spectra and their slopes",
        "Designed bands (shaded) over spectra of pixels that are mostly of one species (above) and "
        "over the change of the plot's mean spectrum that goes with one prior standard deviation "
        "of each quantity (middle). Below the bands of all sensors.",
    )  # fmt: skip
    gain = Picture(
        "gain.png", figures.gain_plot(found),
        "the target of each sensor, and the gain of the design",
        f"{found.target.capitalize()}, in plantings left out of the design (points), and by how "
        "much the design has more, with the interval of 5 to 95 % over these plantings.",
    )  # fmt: skip
    ends = ", ".join(f"{value:.4g}" for value in found.starts)
    pixels = Table(found.pixels, "The target of the best bands in pixels of each size.")
    every = Table(found.quantities.rename_axis("sensor").reset_index(), found.target)
    return [
        Section("Bands", [shown, Table(chosen, "The bands; designed.toml has them as a sensor.")]),
        Section("Other sensors", [gain, Table(found.table, "The target of each sensor.")]),
        Section("Pixels", [pixels]),
        Section("Every quantity", [every, f"Ends of the ascents: {ends}."]),
    ]
