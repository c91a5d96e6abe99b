"""The job of `fynjax train`: from a learned prior to a regression for spectra of a sensor."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jax.typing import ArrayLike
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.app.assembly import STAND_QUANTITIES, StandSettings, simulate_stands, stand_forms
from fynjax.app.io.instruments import load_sensor
from fynjax.app.io.plot import DEFAULT_PRIOR, LearnedPrior, read_prior
from fynjax.app.io.raster import check_netcdf, file_hash, open_blocks, write_run
from fynjax.app.io.text import existing_file
from fynjax.app.jobs._result import JobResult, Number, Record
from fynjax.app.jobs._run import Run
from fynjax.app.report.pages import Table
from fynjax.inversion import (
    INTERVALS,
    AmortisedPosterior,
    HeldOut,
    NetworkSettings,
    train_posterior,
)
from fynjax.sensors import BandSet, Channels, group_bands

_PART = 4
"""Planted stands of one part."""
_FEWEST = 200
_GRID = np.arange(400.0, 2501.0)
"""Wavelengths of the responses [nm]."""
_KIND = "fynjax training of maps"
_CHANNEL = {
    "lower": "lower end of the channel",
    "upper": "upper end of the channel",
    "centre": "mean of the centres of its bands",
}
"""Attributes of a channel in a training file [nm]."""
_PARTS = {
    "middle": (("channel",), "mean logarithm of reflectance"),
    "rows": (("feature", "channel"), "features of that"),
    "within": (("direction", "channel"), "directions in which simulations spread"),
    "points": (("point", "direction"), "simulations along these, errors are 1"),
    "outside": (("rest", "channel"), "all other directions"),
    "values": (("quantity", "score"), "quantities at normal scores -4 to 4"),
    "distance": (
        ("place", "probability"),
        "quantiles of the distance of held-out spectra, within and outside",
    ),
}
"""Arrays of a regression in a training file, with their dimensions; its layers come besides."""


SCORES = (
    "Errors of each quantity on simulations that were held out, the share of their variance that "
    "is explained, and the share of the truths inside the 50, 68 and 90 % intervals."
)
"""Caption of the scores of a training."""


class QuantityScore(Record):
    """Errors of a quantity on simulations that were held out."""

    quantity: str
    unit: str
    rmse: Number
    explained: Number = Field(description="Share of the variance of the simulations [-].")
    inside_50: Number = Field(description="Share of the truths inside the 50 % interval [-].")
    inside_68: Number
    inside_90: Number


class TrainResult(JobResult):
    """Result of `train`."""

    command: Literal["train"] = "train"
    sensor: str
    channels: int
    simulations: int
    held_out: int
    sun_zenith_deg: tuple[float, float]
    prior: str
    scores: list[QuantityScore]


@dataclass(frozen=True)
class Training:
    """A regression, and the spectra that it is for."""

    posterior: AmortisedPosterior
    channels: Channels
    responses: BandSet
    """Bands that the channels measure."""
    settings: StandSettings
    """Settings by which its stands were simulated."""
    bands: int
    """Number of bands of the sensor that it was trained for."""
    record: dict[str, Any]
    """Origin of the training."""


@double_precision
def train(
    output: str | Path,
    sensor: str | Path | None = None,
    *,
    like: str | Path | None = None,
    sun_zenith: float | tuple[float, float] = 30.0,
    prior: str | Path = DEFAULT_PRIOR,
    simulations: Annotated[int, Field(ge=1)] = 20000,
    steps: Annotated[int, Field(ge=1)] = 6000,
    seed: Seed = 0,
    checkpoint: str | Path,
    workers: Workers | None = None,
) -> TrainResult:
    """Train a regression from spectra of a sensor to covers and leaves, for `fynjax map`.

    Draws stands from a learned prior, simulates their spectra and trains a small network that gives
    mean and covariance. One file serves all cubes of the sensor under that sun.

    **Arguments:**

    - `output`: folder of the results, made if missing.
    - `sensor`: shipped sensor (aviris_ng, emit, enmap, sentinel_2a, ...) or a sensor file.
    - `like`: instead of a sensor: a cube, for its good bands.
    - `sun_zenith`: zenith angle of the sun [degrees], or a range of it, such as 25-35.
    - `prior`: name of a shipped population, or a file that `fynjax bioscape learn` wrote. Stands
      have its growth forms.
    - `simulations`: spectra to simulate, rounded up to whole stands; some 30 a second.
    - `steps`: steps of the optimisation.
    - `seed`: seed of everything random.
    - `checkpoint`: folder that keeps the simulations, from which an interrupted run goes on.
    - `workers`: where stands are simulated; in this process by default.

    **Returns:** `TrainResult`. Writes `training.nc` and `scores.csv` into `output`.

    **Raises:** `InputError` for a prior of "none", neither or both of `sensor` and `like`, angles
    out of order, and too few simulations; `MissingExtraError` without optax.
    """
    run = Run(output, seed=seed)
    require("optax", "map")
    task = _task(sensor, like, sun_zenith, simulations, prior)
    channels, settings, count = task.channels, task.settings, task.simulations
    inputs = [task.prior.path, like]
    size = f"{count} spectra in {len(channels.centre)} channels"
    begin_work({"training.nc": size, "scores.csv": "", "report.html": ""})
    quantities, spectra, residual = _simulate(run, task, checkpoint, workers)
    with run.timed("training"):
        posterior, held_out = train_posterior(
            spectra,
            quantities,
            task.prior.model_error.covariance(channels.centre),
            together=settings.together,
            training=NetworkSettings(steps=steps),
            seed=seed,
        )
    scores = _scores(held_out)
    table = pd.DataFrame([s.model_dump() for s in scores])
    record = {**run.record(inputs), **_record(task, residual, table)}
    with run.stage("Write"):
        write_training(
            run.path("training.nc", "the regression, for `fynjax map --training`"),
            Training(posterior, channels, task.responses, settings, task.bands, record),
        )
        what = "errors and coverage of intervals on simulations held out"
        run.table("scores.csv", table, what)
    headline = _headline(task, held_out, scores)
    shown = table.sort_values("explained", ascending=False)
    run.pictures("train", f"Training: {task.sensor}", headline, [Table(shown, SCORES)], inputs)
    return run.result(
        TrainResult,
        headline=headline,
        sensor=task.sensor,
        channels=len(channels.centre),
        simulations=count,
        held_out=held_out.count,
        sun_zenith_deg=settings.sun_zenith,
        prior=task.prior.file.title,
        scores=scores,
    )


class _Task(NamedTuple):
    """The channels that a regression is trained for, and the stands that are simulated for it."""

    sensor: str
    bands: int
    channels: Channels
    responses: BandSet
    settings: StandSettings
    prior: LearnedPrior
    stands: int

    @property
    def simulations(self) -> int:
        """Number of spectra."""
        return self.stands * self.settings.together


def _task(
    sensor: str | Path | None,
    like: str | Path | None,
    sun_zenith: float | tuple[float, float],
    simulations: int,
    prior: str | Path,
) -> _Task:
    if (sensor is None) == (like is None):
        raise InputError("expected either a sensor or a cube whose bands to train for (--like)")
    if isinstance(sun_zenith, int | float):
        sun_zenith = (sun_zenith, sun_zenith)
    low, high = sun_zenith
    if not 0.0 <= low <= high <= 75.0:
        raise InputError(
            f"expected zenith angles of the sun from 0 to 75 degrees, the least first, but got "
            f"{low:g} and {high:g}"
        )
    if simulations < _FEWEST:
        raise InputError(f"expected {_FEWEST} simulations or more, but got {simulations}")
    learned = read_prior(prior)
    if learned is None:
        raise InputError("expected a learned prior to draw stands from, but got none")
    name, bands, good = _bands(sensor, like)
    settings = StandSettings(sun_zenith=(low, high))
    stands = -(-simulations // settings.together)
    return _Task(name, len(bands), *group_bands(bands, good), settings, learned, stands)


def _simulate(
    run: Run, task: _Task, checkpoint: str | Path, workers: Workers | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Quantities of stands, their spectra, and the largest residual of light."""
    ends = [*range(0, task.stands, _PART), task.stands]
    parts = [tuple(range(start, end)) for start, end in pairwise(ends)]
    signed = task.settings, task.responses, task.stands
    journal = run.journal(checkpoint, *signed, files=[task.prior.path])
    with run.stage("Simulate", "simulation", total=len(parts)), at_work(workers) as pool:
        made = pool.all(
            _simulated, parts, task.responses, task.prior, task.settings, run.seed,
            names=[f"stands {part[0]} to {part[-1]}" for part in parts],
            journal=journal,
        )  # fmt: skip
    quantities, spectra, left = zip(*made, strict=True)
    return np.concatenate(quantities), np.concatenate(spectra), max(float(one) for one in left)


def _record(task: _Task, residual: float, scores: pd.DataFrame) -> dict[str, Any]:
    """Attributes of a training file; `map` reads some of them."""
    return {
        "title": "Regression from spectra to covers and leaves",
        "kind": _KIND,
        "sensor": task.sensor,
        "sensor_bands": task.bands,
        "growth_forms": ", ".join(stand_forms(task.prior)),
        "prior": task.prior.file.title,
        "prior_sha256": file_hash(task.prior.path),
        "simulations": task.simulations,
        "sun_zenith_deg": json.dumps(task.settings.sun_zenith),
        "stand_size_m": task.settings.size_m,
        "voxel_m": task.settings.voxel_m,
        "structure_m": task.settings.structure_m,
        "largest_residual": f"{residual:.2g}",
        "scores": scores.to_json(orient="records"),
    }


def _headline(task: _Task, held_out: HeldOut, scores: Sequence[QuantityScore]) -> list[str]:
    low, high = task.settings.sun_zenith
    inside = [s.inside_90 or 0.0 for s in scores]
    ranked = sorted(scores, key=lambda s: -(s.explained or 0.0))
    return [
        f"{task.simulations} spectra of {task.sensor} in {len(task.channels.centre)} channels, sun "
        f"at {low:g} to {high:g} degrees.",
        f"Growth forms of the stands, those of the prior: {', '.join(stand_forms(task.prior))}.",
        f"On {held_out.count} held out the 90 % intervals hold {100 * min(inside):.0f} to "
        f"{100 * max(inside):.0f} % of the truths.",
        "Share of the variance explained: "
        + ", ".join(f"{s.quantity} {s.explained or 0.0:.2f}" for s in ranked)
        + ".",
    ]


def _simulated(
    part: tuple[int, ...], bands: BandSet, prior: LearnedPrior, settings: StandSettings, seed: int
) -> tuple[np.ndarray, ...]:
    made = simulate_stands(part, bands, prior, settings, seed)
    if not np.isfinite(made.reflectance).all():
        raise InputError("their spectra are not finite")
    return made.quantities, made.reflectance, np.asarray(made.residual)


def _bands(
    sensor: str | Path | None, like: str | Path | None
) -> tuple[str, BandSet, np.ndarray | None]:
    """Name, bands, and which of them are to be used."""
    if sensor is not None:
        loaded = load_sensor(sensor)
        return loaded.name, loaded.bands, None
    assert like is not None
    with open_blocks(like) as cube:
        centre, width, good = cube.wavelength, cube.fwhm, cube.good
        path = cube.path
    if np.isnan(centre).any():
        raise InputError(
            "expected a cube that states the wavelength of each band, but this one does not. Name "
            "the sensor instead",
            file=path,
        )
    if np.isnan(width).any():  # bands of a spectrometer are about as wide as they lie apart
        width = np.abs(np.gradient(centre))
    names = tuple(f"band {n}" for n in range(1, len(centre) + 1))
    return Path(path).name, BandSet(names, tuple(centre), tuple(width)), good


def _scores(held_out: HeldOut) -> list[QuantityScore]:
    inside = dict(zip(INTERVALS, held_out.coverage, strict=True))
    return [
        QuantityScore(
            quantity=name,
            unit=quantity.unit,
            rmse=held_out.rmse[i],
            explained=held_out.explained[i],
            inside_50=inside[0.5][i],
            inside_68=inside[0.68][i],
            inside_90=inside[0.9][i],
        )
        for i, (name, quantity) in enumerate(STAND_QUANTITIES.items())
    ]


def write_training(path: Path, training: Training) -> None:
    """Write a regression as NetCDF, whole or not at all.

    **Arguments:** `path`; `training`, such as `read_training` gives.
    """
    posterior, channels = training.posterior, training.channels

    def of(dims: tuple[str, ...], values: ArrayLike, name: str, unit: str = "1") -> xr.Variable:
        return xr.Variable(dims, np.asarray(values), {"long_name": name, "units": unit})

    variables = {
        name: of(("channel",), getattr(channels, name), what, "nm")
        for name, what in _CHANNEL.items()
    } | {name: of(dims, getattr(posterior, name), what) for name, (dims, what) in _PARTS.items()}
    response = np.zeros((len(channels.centre), len(_GRID)))
    for row, (at, values) in zip(response, training.responses.curves or (), strict=True):
        row[:] = np.interp(_GRID, at, values, left=0.0, right=0.0)
    variables["response"] = of(
        ("channel", "wavelength"), response.astype(np.float32), "relative response of the channel"
    )
    for i, (weight, offset) in enumerate(posterior.layers):
        variables[f"weight_{i}"] = of((f"in_{i}", f"out_{i}"), weight, f"weights of layer {i}")
        variables[f"offset_{i}"] = of((f"out_{i}",), offset, f"offsets of layer {i}")
    names = ("quantity", list(STAND_QUANTITIES), {"long_name": "quantity"})
    wavelength = ("wavelength", _GRID, {"long_name": "wavelength", "units": "nm"})
    data = xr.Dataset(variables, coords={"quantity": names, "wavelength": wavelength})
    record = training.record
    write_run(path, data, {**record, _SEAL: _sealed(data, record)})


_SEAL = "content_sha256"


def _sealed(data: xr.Dataset, record: Mapping[str, object]) -> str:
    """Hash of all that a training holds: arrays by name, and the record without what is added to
    every file."""
    total = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        variable = data[name]
        values = np.asarray(variable.values)
        kept = values.tobytes() if values.dtype.kind == "f" else repr(values.tolist()).encode()
        total.update(f"|{name}|{variable.dims}|{values.shape}|{variable.attrs}|".encode() + kept)
    own = {str(k): str(v) for k, v in record.items() if k not in _ADDED}
    total.update(repr(sorted(own.items())).encode())
    return total.hexdigest()


_ADDED = (_SEAL, "Conventions", "history")


@double_precision
def read_training(path: str | Path) -> Training:
    """Read a regression that `train` wrote.

    **Arguments:** `path` of its `training.nc`.

    **Returns:** `Training`.

    **Raises:** `InputError` for a file that is missing or is none, and for other quantities than
    this version of fynjax has.
    """
    path = existing_file(path, "a training (`fynjax train` writes training.nc)")
    check_netcdf(path)
    try:
        with xr.open_dataset(path, engine="netcdf4") as data:
            data = data.load()
        record = dict(data.attrs)
        if record.get("kind") != _KIND:
            raise KeyError("kind")
        names = [str(name) for name in data["quantity"].values]
        single = lambda name: jnp.asarray(data[name].values, jnp.float32)  # noqa: E731
        count = sum(str(name).startswith("weight_") for name in data.variables)
        posterior = AmortisedPosterior(
            layers=tuple((single(f"weight_{i}"), single(f"offset_{i}")) for i in range(count)),
            **{name: single(name) for name in _PARTS},
        )
        channels = Channels(**{name: np.asarray(data[name].values) for name in _CHANNEL})
        response = np.asarray(data["response"].values, float)
        ends = [np.flatnonzero(row)[[0, -1]] + (0, 1) for row in response]
        curves: Any = [(_GRID[a:b], row[a:b]) for row, (a, b) in zip(response, ends, strict=True)]
        bands = int(record["sensor_bands"])
        low, high = json.loads(record["sun_zenith_deg"])
        settings = StandSettings(
            sun_zenith=(float(low), float(high)),
            size_m=float(record["stand_size_m"]),
            voxel_m=float(record["voxel_m"]),
            structure_m=float(record["structure_m"]),
        )
    except (
        *(OSError, LookupError, TypeError, ValueError, RuntimeError, AttributeError),
        OverflowError,
    ) as error:
        raise InputError(
            "expected a training file as this version's `fynjax train` writes it, but this is "
            "none, one of another version, or damaged",
            file=path,
        ) from error
    if names != list(STAND_QUANTITIES):
        raise InputError(
            f"expected a training for {', '.join(STAND_QUANTITIES)}, but it is for "
            f"{', '.join(names)}. Train again with this version.",
            file=path,
        )
    arrays = [*jax.tree.leaves(posterior), response, *vars(channels).values()]
    if not all(np.isfinite(np.asarray(a)).all() for a in arrays):
        raise InputError("expected a training of finite numbers. Is it damaged?", file=path)
    if record.get(_SEAL) != _sealed(data, record):
        raise InputError(
            "expected a training as `fynjax train` wrote it, but its content has changed since. "
            "Is it damaged? Copy it again.",
            file=path,
        )
    labels = tuple(f"{value:.6g}nm" for value in channels.centre)
    width = tuple(channels.upper - channels.lower)
    responses = BandSet(labels, tuple(channels.centre), width, curves=curves)
    return Training(posterior, channels, responses, settings, bands, record)
