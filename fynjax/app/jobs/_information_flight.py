"""What the frames of a flight, and the pulses of a LiDAR, can know about a plot."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.progress import track
from fynjax.app.io.plot import Plot, drone_sensor, plot_instrument
from fynjax.app.jobs._result import JobResult, Rows
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.inversion import (
    COARSE,
    BandFactors,
    Information,
    Problem,
    coarser,
    fisher_information,
    other_plantings,
    parameter_columns,
    scatter_covariance,
    scatter_of_views,
    shared_slopes,
    stand_functionals,
    stand_values,
    value_and_jacobian,
)
from fynjax.radiation import parallel_rays, reflectance_factor, solve_light
from fynjax.scene import PlotParameters, Scene, fitting_structure, scene_structure, with_values
from fynjax.sensors import FrameCamera, Sensor

OBLIQUE_DEG = 45.0
"""Zenith angle of oblique frames, which stand evenly round the plot."""
_SHARES = (25.0, 50.0, 75.0, 90.0, 95.0, 99.0)
_BESIDE = 2.0
"""Shares of first returns below the heights that count [%], and how far off density is read."""
_MODEL_SD = 0.05
"""Error of the model of a cloud, relative to its values, half of its variance in common [-]."""


class FlightInformationResult(JobResult):
    """Result of `information` of frames and pulses."""

    command: Literal["information"] = "information"
    bounds: Rows
    """Rows of flight.csv."""


class FlightSetting(NamedTuple):
    """What is flown: frames of a camera, or a LiDAR."""

    frames: int
    """Nearest to the plot, of a flight that looks straight down."""
    oblique: int
    pulses: float
    """First returns of a LiDAR for each square metre [m-2]; 0 without."""


def frame_directions(sensor: Sensor, count: int, overlap: float) -> Float[np.ndarray, "frame 2"]:
    """Zenith angle and azimuth [degrees] of the frames of a flight to a plot in its middle.

    **Arguments:**

    - `count`: frames, those nearest to the plot.
    - `overlap`: share that neighbouring frames have in common, along and across the flight [%].

    The places of frames grow with the height, so the directions do not depend on it.

    **Raises:** `InputError` for a sensor without frames, and where fewer frames see the plot.
    """
    camera = sensor.camera
    if not isinstance(camera, FrameCamera):
        raise InputError(f"expected a camera with frames, but {sensor.name!r} has none")
    if not 0.0 <= overlap < 100.0:
        raise InputError(f"expected an overlap of 0 to below 100 %, but got {overlap:g}")
    half = 5e-4 * np.asarray(camera.array) * camera.pixel_pitch_um / float(camera.focal_length_mm)
    step = 2.0 * half * (1.0 - overlap / 100.0)
    reach = np.floor(half / step + 1e-9).astype(int)
    x, y = np.meshgrid(*(np.arange(-n, n + 1) * s for n, s in zip(reach, step)))
    zenith = np.rad2deg(np.arctan(np.hypot(x, y))).ravel()
    azimuth = np.rad2deg(np.arctan2(x, y)).ravel() % 360.0
    if count > len(zenith):
        raise InputError(
            f"expected at most {len(zenith)} frames, as many as see a plot with {overlap:g} % of "
            f"overlap, but got {count}"
        )
    order = np.lexsort((azimuth, zenith.round(6)))[:count]
    return np.column_stack([zenith, azimuth])[order]


@eqx.filter_jit
def _frames(
    scene: Scene, parameters: PlotParameters, sensor: Sensor, names: tuple[str, ...], at: Array,
    views: Array, steepest: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Mean and spread of each band in each frame, and their slopes [frame, statistic, free]."""
    nx, ny, _ = scene.grid.shape
    width = scene.grid.horizontal_size
    x, y = (jnp.arange(n) * width + 0.5 * width for n in (nx, ny))

    def statistics(values: Array) -> Array:
        named = {name: values[i] for i, name in enumerate(names)}
        plot = with_values(parameters, scene.taxa, named)
        light = solve_light(scene.voxels(plot, sensor.bands), COARSE)

        def of_view(view: Array) -> Array:
            rays = parallel_rays(x, y, width, view[0], view[1])
            image = reflectance_factor(light, rays, steepest=steepest)
            return jnp.concatenate([image.mean(axis=(1, 2)), image.std(axis=(1, 2))])

        return jax.lax.map(of_view, views)

    return value_and_jacobian(statistics, at, mode="forward")


@eqx.filter_jit
def _cloud(
    scene: Scene, parameters: PlotParameters, names: tuple[str, ...], at: Array
) -> tuple[Array, Array]:
    """Heights of first returns at `_SHARES`, a little below and above, and their slopes."""
    wanted = [f"height_p{q:g}" for o in (0.0, -1.0, 1.0) for q in np.clip(_at(o), 0.1, 99.9)]
    settings, grains = fitting_structure(scene.grid.horizontal_size, min(scene.grid.extent[:2]))

    def heights(values: Array) -> Array:
        named = {name: values[i] for i, name in enumerate(names)}
        plot = with_values(parameters, scene.taxa, named)
        return scene_structure(scene, plot, wanted, settings, grain=grains[0], pulses=100.0)

    return value_and_jacobian(heights, at, mode="forward")


def _at(side: float) -> Float[np.ndarray, " share"]:
    return np.asarray(_SHARES) + side * np.minimum(_BESIDE, 100.0 - np.asarray(_SHARES) - 0.1)


def frame_covariance(
    values: Float[np.ndarray, "draw frame statistic"], error: float, sensor: Sensor,
    factors: BandFactors,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Covariance of statistics of frames, without and with what is common to all frames.

    **Arguments:** `values` of each planting; `error`, own, of each statistic, relative [-];
    `factors` on bands, the same in all frames: gains and the model's error.

    Frames see the same plants: their chance is as correlated as it is on the mean
    (`scatter_of_views`), and more plantings than there are would be needed to know better. The
    light drifts between frames (`Gains.drift`) on all bands.
    """
    count, frames, size = values.shape
    drawn = values.reshape(count, -1)
    usual = drawn.mean(axis=0)
    own = scatter_of_views(drawn, [str(kind) for kind in range(size)] * frames)
    own += np.diag((error * usual) ** 2)
    of_frame = np.kron(np.eye(frames), np.full((size, size), sensor.gains().drift ** 2))
    root = np.asarray(factors.root)
    band = np.tile(np.arange(len(root)), frames * size // len(root))
    shared = (root @ root.T)[np.ix_(band, band)]
    return own, own + np.outer(usual, usual) * (of_frame + shared)


def cloud_covariance(
    values: Float[np.ndarray, "draw height"], area: float, pulses: float
) -> np.ndarray:
    """Covariance of the heights of first returns at `_SHARES`: where plants stand, the model, and
    that of quantiles of so many returns (Cox & Hinkley 1974, appendix 2)."""
    middle, low, high = np.split(values.mean(axis=0), 3)
    below, above = (np.clip(_at(side), 0.1, 99.9) for side in (-1.0, 1.0))
    spacing = (high - low) / ((above - below) / 100.0)  # one over the density of heights
    share = np.asarray(_SHARES) / 100.0
    order = np.minimum.outer(share, share) - np.outer(share, share)
    drawn = order * np.outer(spacing, spacing) / (pulses * area)
    # Half of the variance of the model's error is common to all heights, as an assumption.
    model = 0.5 * _MODEL_SD**2 * (np.outer(middle, middle) + np.diag(middle**2))
    known = model + 1e-6 * np.eye(len(middle))
    return scatter_covariance(values[:, : len(share)]) + known + drawn


def flight_information(
    problem: Problem, sensor: Sensor, settings: Sequence[FlightSetting], *, overlap: float,
    error: float, realisations: int,
) -> list[Information]:  # fmt: skip
    """Bounds on the free parameters of a plot, for what is flown.

    **Arguments:** `problem`, without data; `sensor`, whose camera makes the frames; `settings`;
    `overlap` of frames [%]; `error`, own, of each statistic of a frame, relative [-];
    `realisations`, other plantings.

    A frame gives mean and spread of each band over the plot, by one Jacobian of all frames; a cloud
    heights of first returns. Errors are those of `frame_covariance` and `cloud_covariance`; slopes
    are those that plantings share (`shared_slopes`). The information of independent frames adds.

    **Raises:** `InputError` as `frame_directions`.
    """
    scene, space = problem.scene, problem.free
    views = _views(sensor, settings, overlap)
    at = space.physical(jnp.zeros(len(space.names)))
    frames: list[Any] = []
    clouds: list[Any] = []
    for planted in track([scene, *other_plantings(scene, range(1, realisations + 1))], "Look"):
        if len(views):
            quick = coarser(planted, scene.parameters)
            most = float(views[:, 0].max())
            where = jnp.asarray(views)
            seen = _frames(quick, scene.parameters, sensor, space.names, at, where, most)
            frames.append(jax.device_get(seen))
        if any(one.pulses for one in settings):
            clouds.append(jax.device_get(_cloud(planted, scene.parameters, space.names, at)))
    scale = np.asarray(space.prior_sd, float)
    factors = BandFactors.of_bands([(sensor.bands, sensor.gains())], problem.error)
    found = []
    for one in settings:
        slopes, covariance = np.zeros((0, len(scale))), np.zeros((0, 0))
        if one.frames or one.oblique:
            rows = [*range(one.frames), *_oblique(one.oblique, views)]
            slopes, covariance = _of_frames(rows, frames, scale, sensor, factors, error)
        if one.pulses:
            slopes, covariance = _of_cloud(clouds, scale, scene.ground_area, one.pulses)
        found.append(fisher_information(space.names, slopes, covariance, scale))
    return found


def _stacked(planted: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of each planting."""
    values, slopes = (np.stack([one[i] for one in planted]).astype(float) for i in (0, 1))
    return values, slopes


def _of_frames(
    rows: Sequence[int],
    frames: list[Any],
    scale: np.ndarray,
    sensor: Sensor,
    factors: BandFactors,
    error: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and covariance of some frames. What plantings share is of all frames of the sweep
    together, so that more of them never know less."""
    values, every = _stacked(frames)
    own, whole = frame_covariance(values, error, sensor, factors)
    flat = every.reshape(len(every), -1, len(scale)) * scale
    blocks = np.split(np.arange(flat.shape[1]), values.shape[1])
    taken = np.concatenate([blocks[i] for i in rows])
    shared = shared_slopes(flat, own, blocks) / scale
    return shared[taken], whole[np.ix_(taken, taken)]


def _of_cloud(
    clouds: list[Any], scale: np.ndarray, area: float, pulses: float
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and covariance of heights. What plantings share does not depend on the pulses."""
    values, every = _stacked(clouds)
    rows = np.arange(len(_SHARES))
    known = cloud_covariance(values, area, np.inf)
    shared = shared_slopes(every[:, rows] * scale, known, [rows]) / scale
    return shared, cloud_covariance(values, area, pulses)


def _oblique(count: int, views: np.ndarray) -> list[int]:
    """Places of so many oblique frames in the views."""
    wanted = [(OBLIQUE_DEG, 360.0 * k / count) for k in range(count)]
    return [int(np.flatnonzero(np.isclose(views, one).all(axis=1))[-1]) for one in wanted]


def _views(
    sensor: Sensor, settings: Sequence[FlightSetting], overlap: float
) -> Float[np.ndarray, "view 2"]:
    """Directions of all frames that any setting has: those straight down, then oblique ones."""
    down = max(one.frames for one in settings)
    parts = [frame_directions(sensor, down, overlap)] if down else [np.zeros((0, 2))]
    for count in sorted({one.oblique for one in settings} - {0}):
        around = np.arange(count) * 360.0 / count
        parts.append(np.column_stack([np.full(count, OBLIQUE_DEG), around]))
    return np.concatenate(parts)


def stand_bounds(problem: Problem, bounds: Information) -> Float[np.ndarray, "functional 2"]:
    """Standard deviation of each of `stand_functionals`, before and after the data."""
    scene, space = problem.scene.expected(), problem.free
    at = space.physical(jnp.zeros(len(space.names)))

    def numbers(values: Array) -> Array:
        named = {name: values[i] for i, name in enumerate(space.names)}
        plot = with_values(scene.parameters, scene.taxa, named)
        return jnp.stack(list(stand_values(scene, plot).values()))

    slopes = np.asarray(value_and_jacobian(numbers, at, mode="forward")[1], float)
    before = np.diag(np.asarray(space.prior_sd, float) ** 2)
    after = np.linalg.inv(bounds.fisher + np.linalg.inv(before))
    return np.sqrt([[row @ c @ row for c in (before, after)] for row in slopes])


def flight_table(
    problem: Problem, settings: Sequence[FlightSetting], bounds: Sequence[Information]
) -> pd.DataFrame:
    """A row for each setting and parameter, and number of the stand: its standard deviation before
    and after."""
    tables = []
    for setting, one in zip(settings, bounds, strict=True):
        table = parameter_columns(
            one.names, {"prior_sd": one.prior_sd, "bayesian": one.bayesian}
        ).drop(columns="kind")
        functionals = stand_functionals(problem.scene)
        stand = pd.DataFrame(stand_bounds(problem, one), columns=["prior_sd", "bayesian"])
        stand.insert(0, "name", [f"stand.{name}" for name in functionals])
        stand.insert(1, "unit", [f.unit for f in functionals.values()])
        table = pd.concat([table, stand], ignore_index=True)
        table["constrained"] = 1.0 - (table["bayesian"] / table["prior_sd"]) ** 2
        tables.append(table.assign(**setting._asdict()))
    whole = pd.concat(tables, ignore_index=True).rename(columns={"name": "parameter"})
    return whole[[*FlightSetting._fields, *whole.columns.drop(list(FlightSetting._fields))]]


def flight_settings(
    frames: Sequence[int], oblique: Sequence[int], pulses: Sequence[float]
) -> list[FlightSetting]:
    """Each number of frames with each of oblique ones, then each density of pulses alone.

    **Raises:** `InputError` for numbers of nothing.
    """
    if min([*frames, *pulses], default=1) <= 0 or min(oblique, default=0) < 0:
        raise InputError("`frames` and `pulses` must be positive, `oblique` 0 or more")
    flown = [FlightSetting(int(n), int(o), 0.0) for o in oblique or (0,) for n in frames]
    return [*flown, *(FlightSetting(0, 0, float(density)) for density in pulses)]


def information_of_flight(
    run: Run, plot: Plot, problem: Problem, settings: Sequence[FlightSetting], *, overlap: float,
    error: float, realisations: int,
) -> FlightInformationResult:  # fmt: skip
    """Bound what frames and pulses can know; write the table, a figure and the page.

    **Arguments:** as of `flight_information`, with the camera of the plot file.
    """
    sensor = (drone_sensor if any(one.frames for one in settings) else plot_instrument)(plot)
    _views(sensor, settings, overlap)
    begin_work({"flight.csv": f"{len(settings)} flights", "report.html": ""})
    bounds = flight_information(
        problem, sensor, settings, overlap=overlap, error=error, realisations=realisations
    )
    table = flight_table(problem, settings, bounds)
    headline = [
        f"{_words(one)}: {int((found.constrained > 0.75).sum())} of {len(found.names)} parameters "
        "have their error halved or better."
        for one, found in zip(settings, bounds)
    ]
    with run.stage("Write"):
        run.table("flight.csv", table, "bounds on every parameter by every flight")
        picture = Picture(
            "flight.png",
            figures.flight_plot(table, {tuple(one): _words(one) for one in settings}),
            "what is left of each error",
            "Standard deviation that is left of the prior's, of heights, covers, leaf areas and "
            "the stand's numbers.",
        )
        parts: list[Part] = [picture, Table(table, "Every bound.", folded=True)]
        record = run.record(plot.inputs)
        lead = " ".join(headline)
        title, sections = f"Information: {plot.name}", [Section("", parts)]
        run.page(Page("information", title, lead, sections, record=record))
    return run.result(FlightInformationResult, headline=headline, bounds=table)


def _words(one: FlightSetting) -> str:
    if one.pulses:
        return f"LiDAR, {one.pulses:g} a m²"
    beside = f" and {one.oblique} oblique" if one.oblique else ""
    return f"{one.frames} frame{'s' * (one.frames != 1)}{beside}"
