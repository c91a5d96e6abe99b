"""`fynjax train`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax._core.errors import InputError
from fynjax.cli._runtime import Checkpoint, Job, SchedulerAddress, Seed, WorkerCount, command


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """What tells the cost of a training."""
    files = [given["like"]] if given["like"] is not None else []
    return {"files": files, "simulations": given["simulations"]}


@command("train", forget=True, work=_work)
def train(
    sensor: Annotated[
        str | None,
        typer.Argument(
            metavar="SENSOR",
            help="Shipped sensor (aviris_ng, emit, enmap, sentinel_2a, ...) or a sensor file.",
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(metavar="CUBE", help="Instead of a sensor: a cube, for its good bands."),
    ] = None,
    sun_zenith: Annotated[
        str,
        typer.Option(metavar="DEG|DEG-DEG", help="Zenith angle of the sun, or a range of it."),
    ] = "30",
    prior: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="Learned prior; the shipped one if left out."),
    ] = None,
    simulations: Annotated[
        int, typer.Option(min=1, help="Spectra to simulate; some 30 a second.")
    ] = 20000,
    seed: Seed = 0,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
) -> Job:
    """Train a regression from spectra of a sensor to covers and leaves, for `fynjax map`.

    Draws stands from a learned prior, simulates their spectra and trains a small network that gives
    mean and covariance. One file serves all cubes of the sensor under that sun.

    Example:  fynjax train emit --sun-zenith 25-35 --output emit_30
    """
    from fynjax import jobs
    from fynjax.io.plot import DEFAULT_PRIOR

    assert checkpoint is not None
    return lambda folder: jobs.train(
        folder,
        sensor=sensor,
        like=like,
        sun_zenith=_angles(sun_zenith),
        prior=DEFAULT_PRIOR if prior is None else prior,
        simulations=simulations,
        seed=seed,
        checkpoint=checkpoint,
        workers=jobs.Workers(workers, scheduler),
    )


def _angles(text: str) -> tuple[float, float]:
    try:
        values = [float(part) for part in text.split("-")]
    except ValueError:
        values = []
    if len(values) not in (1, 2):
        raise InputError(
            f"`--sun-zenith` must be an angle in degrees such as 30, or two with a hyphen such as "
            f"25-35, but is {text!r}"
        )
    return values[0], values[-1]
