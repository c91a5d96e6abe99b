"""The job of `fynjax information`: bounds on what sensors can know about a plot."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import plot_problem
from fynjax.app.io.plot import Plot, as_plot, plot_instrument, sensor_place
from fynjax.app.jobs._information_flight import (
    FlightInformationResult,
    flight_settings,
    information_of_flight,
)
from fynjax.app.jobs._result import JobResult, Rows
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.inversion import (
    Information,
    SensorSetting,
    check_sweep,
    even_bands,
    parameter_columns,
    sweep_sensors,
)
from fynjax.sensors import Sensor


class InformationResult(JobResult):
    """Result of `information`: limits of detecting cover, and weakly constrained directions."""

    command: Literal["information"] = "information"
    limits: Rows
    """Rows of limits.csv."""
    weakly_constrained_directions: list[dict[str, float]]
    """Combinations of parameters that the first sensor does not resolve, with their weights."""


@double_precision
def plot_information(
    plot: Plot | str | Path,
    output: str | Path,
    *,
    free: Sequence[str] | None = None,
    gsd: Sequence[float] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0),
    bands: Sequence[int] = (2, 4, 8),
    spectrum: tuple[float, float] = (450.0, 900.0),
    noise: Sequence[float] = (0.01,),
    sun_zenith: Sequence[float] | None = None,
    error: float = 0.01,
    frames: Sequence[int] | None = None,
    oblique: Sequence[int] = (0,),
    overlap: float = 80.0,
    pulses: Sequence[float] | None = None,
    realisations: Annotated[int, Field(ge=2)] = 15,
    seed: Seed | None = None,
) -> InformationResult | FlightInformationResult:
    """Bound how well sensors of any pixel, bands, noise and sun can constrain a plot.

    **Arguments:**

    - `plot`: plot file (`fynjax init` writes one), or a plot that was read.
    - `output`: folder of the results, made if missing.
    - `free`: parameters to bound, such as species.*.cover; the plot file's if left out.
    - `gsd`: sides of a pixel on the ground [m], multiples of the smallest.
    - `bands`: numbers of bands, divisors of the largest.
    - `spectrum`: first and last wavelength that the bands share [nm], such as 450,900.
    - `noise`: standard deviations of the noise of a pixel, relative to its reflectance [-].
    - `sun_zenith`: zenith angles of the sun [degrees]; the plot's if left out.
    - `error`: standard deviation of a further error of every statistic, relative [-].
    - `frames`: in place of pixels and bands, numbers of frames of the plot file's camera, such as
      1,5,25: those nearest to the plot.
    - `oblique`: numbers of frames beside them that look from 45 degrees, evenly round the plot.
    - `overlap`: share that neighbouring frames have in common [%].
    - `pulses`: in place of pixels and bands, first returns of a LiDAR a square metre [m-2].
    - `realisations`: stand realisations from which their sampling variance, and the slopes that
      they share, are estimated.
    - `seed`: seed of everything random; the plot file's if left out.

    **Returns:** `InformationResult`. Writes `bounds.csv` (conditional, joint and Bayesian
    Cramér-Rao bounds), `limits.csv`, figures and a page into `output`; with `frames` or `pulses`
    `FlightInformationResult` and `flight.csv`.

    **Raises:** `InputError` as `read_plot`, and for settings that do not fit the plot.

    Example: `jobs.plot_information("plot.toml", Path("results"), gsd=(0.5, 1.0), bands=(4,))`.
    """
    if not frames and (tuple(oblique) != (0,) or overlap != 80.0):
        raise InputError("expected frames beside oblique or overlap, but got none")
    read = as_plot(plot)
    if frames and read.boundary == "open":
        raise InputError(
            'expected boundary = "periodic" for frames, but it is "open": oblique views would look '
            "past the plot",
            file=read.file,
        )
    run = Run(output, seed=seed, plot=read)
    with run.stage("Build the plot"):
        problem = plot_problem(read, None, free, seed=run.seed)
    if frames or pulses:
        settings = flight_settings(frames or (), oblique, pulses or ())
        return information_of_flight(
            run, read, problem, settings, overlap=overlap, error=error, realisations=realisations
        )
    altitude, _ = sensor_place(read)
    swept = Sensor("sweep", even_bands(max(bands), *spectrum), plot_instrument(read).camera)
    size = f"{len(problem.free.names)} parameters"
    files = {"bounds.csv": size, "limits.csv": "", "report.html": ""}
    placement = dataclasses.replace(read.sensor.placement, altitude=altitude, pixel=None)
    on = problem.scene, problem.scene.parameters
    sweeps: dict[str, Any] = {"gsd": gsd, "bands": bands, "noise": noise}
    sweeps |= {"sun_zenith": sun_zenith, "stand_realisations": realisations}
    check_sweep(*on, swept, placement, **sweeps)
    begin_work(files)
    sweep = sweep_sensors(
        *on, problem.free, swept, placement,
        relative_sd=error, model_error=problem.error, seed=run.seed, **sweeps,
    )  # fmt: skip
    table = bound_table(sweep, np.asarray(problem.free.prior))
    first, best = sweep[0]
    covers = [n for n in problem.free.names if n.startswith("species.") and n.endswith(".cover")]
    limits = limit_table(table, covers)
    sensor = f"{_bands(first.bands)}, pixels of {first.gsd:g} m, noise {100 * first.noise:g} %"
    weak = best.weakly_constrained_directions()
    headline = [
        *_limit_sentences(table, limits),
        f"{sensor}: {len(weak)} of {len(best.names)} directions of the parameters are weakly "
        f"constrained; {int((best.constrained > 0.75).sum())} parameters have their error halved "
        "or better.",
    ]
    with run.stage("Write"):
        run.table("bounds.csv", table, "bounds on every parameter by every sensor")
        what = "at which pixels each cover is distinguished from absence"
        run.table("limits.csv", limits, what)
        sections = [_cover_section(table, limits, covers)] if covers else []
        sections.append(_direction_section(sensor, weak, table))
        record = run.record(read.inputs)
        title, lead = f"Information: {read.name}", " ".join(headline)
        run.page(Page("information", title, lead, sections, record=record))
    return run.result(
        InformationResult, headline=headline, limits=limits, weakly_constrained_directions=weak
    )


def bound_table(
    sweep: Sequence[tuple[SensorSetting, Information]], value: np.ndarray
) -> pd.DataFrame:
    """A row for each sensor and parameter, in field units."""
    tables = []
    for setting, bounds in sweep:
        kinds = ("prior_sd", "conditional", "bound", "joint", "bayesian")
        numbers = {"value": value} | {kind: getattr(bounds, kind) for kind in kinds}
        table = parameter_columns(bounds.names, numbers).assign(constrained=bounds.constrained)
        of_sensor = {
            "gsd_m": setting.gsd,
            "bands": setting.bands,
            "noise": setting.noise,
            "sun_zenith": setting.sun_zenith,
            "pixels": setting.pixels,
        }
        tables.append(pd.DataFrame(of_sensor, index=table.index).join(table))
    table = pd.concat(tables, ignore_index=True)
    return table.drop(columns="kind").rename(columns={"name": "parameter"})


def limit_table(table: pd.DataFrame, covers: Sequence[str]) -> pd.DataFrame:
    """From which pixel on a species' cover is indistinguishable from absence.

    For each species, number of bands, noise and sun: at which pixels of the sweep it is `detected`,
    its bound at most its cover: "at no pixel", "at fine pixels" or "at every pixel"; and the
    finest at which it is not, `lost_from_gsd_m`: NaN only if detected at every one.
    """
    rows = []
    keys = ["parameter", "bands", "noise", "sun_zenith"]
    for key, part in table[table["parameter"].isin(covers)].groupby(keys, sort=False):
        lost = part["gsd_m"][~(part["bound"] <= part["value"])]
        few = "at no pixel" if len(lost) == len(part) else "at fine pixels"
        rows.append(
            {
                **dict(zip(keys, key)),
                "cover_percent": float(part["value"].iloc[0]),
                "detected": few if len(lost) else "at every pixel",
                "lost_from_gsd_m": float(lost.min()) if len(lost) else np.nan,
            }
        )
    return pd.DataFrame(rows, columns=[*keys, "cover_percent", "detected", "lost_from_gsd_m"])


def _bands(count: int) -> str:
    return f"{count} band{'s' * (count != 1)}"


def _limit_sentences(table: pd.DataFrame, limits: pd.DataFrame) -> list[str]:
    """For each number of bands, and noise and sun where there are several, how many covers are
    lost at which pixels."""
    finest, coarsest = table["gsd_m"].min(), table["gsd_m"].max()
    words: dict[str, Any] = {
        "bands": _bands,
        "noise": lambda share: f"noise {100 * share:g} %",
        "sun_zenith": lambda angle: f"sun at {angle:g} degrees",
    }
    keys = [key for key in words if key == "bands" or limits[key].nunique() > 1]
    lines = []
    for of, part in limits.groupby(keys):
        number = part["detected"].value_counts()
        sensor = ", ".join(words[key](value) for key, value in zip(keys, of, strict=True))
        lines.append(
            f"{sensor}: of {len(part)} covers {number.get('at every pixel', 0)} are detected "
            f"at every size of pixel up to {coarsest:g} m, "
            f"{number.get('at fine pixels', 0)} only at fine ones, "
            f"{number.get('at no pixel', 0)} not even at {finest:g} m."
        )
    return lines


def _cover_section(table: pd.DataFrame, limits: pd.DataFrame, covers: Sequence[str]) -> Section:
    first = table[
        (table["noise"] == table["noise"].iloc[0])
        & (table["sun_zenith"] == table["sun_zenith"].iloc[0])
    ]
    picture = Picture(
        "cover_bounds.png",
        figures.bound_plot(first, covers),
        "bound on each cover against the pixel",
        "Cramér-Rao bound on each species' cover over the cover itself, the other parameters as "
        "uncertain as their priors. In the shaded part the cover is indistinguishable from "
        "absence. At a triangle there is no bound: the plantings share no slope that chance does "
        "not explain. Smaller pixels and a multiple of the bands contain what larger and fewer "
        "tell, so they never know less.",
    )
    rows = limits.assign(parameter=limits["parameter"].map(figures.short_name))
    return Section("Cover", [picture, Table(rows, "Where each cover is lost (–: at no pixel).")])


def _direction_section(
    sensor: str, weak: Sequence[dict[str, float]], table: pd.DataFrame
) -> Section:
    named = "; ".join(
        ", ".join(f"{figures.short_name(name)} {weight:+.2f}" for name, weight in direction.items())
        for direction in weak[:8]
    )
    parts: list[Part] = [
        f"Combinations of parameters that {sensor} constrain weakly (largest members): {named}."
        if weak
        else "Every combination of parameters is well constrained.",
        Table(table, "Every bound.", folded=True),
    ]
    return Section("Weakly constrained directions", parts)
