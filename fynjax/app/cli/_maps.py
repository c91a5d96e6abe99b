"""Commands for maps of many pixels."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax._core.errors import InputError
from fynjax.app.cli._runtime import command, listed, option


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


@command("train", "fynjax.app.jobs:train", "seed", "checkpoint", "workers", forget=True)
def train(
    sensor: Annotated[
        str | None,
        typer.Argument(
            metavar="SENSOR",
            help="Shipped sensor (aviris_ng, emit, enmap, sentinel_2a, ...) or a sensor file.",
        ),
    ] = None,
    like: Annotated[
        Path | None, option("CUBE", "Instead of a sensor: a cube, for its good bands.")
    ] = None,
    sun_zenith: Annotated[
        str, option("DEG|DEG-DEG", "Zenith angle of the sun, or a range of it.", callback=_angles)
    ] = "30",
    prior: Annotated[
        str | None, option("NAME|FILE", "Learned prior; the shipped one if left out.")
    ] = None,
    simulations: Annotated[
        int, typer.Option(min=1, help="Spectra to simulate; some 30 a second.")
    ] = 20000,
) -> None:
    """Train a regression from spectra of a sensor to covers and leaves, for `fynjax map`.

    Draws stands from a learned prior, simulates their spectra and trains a small network that gives
    mean and covariance. One file serves all cubes of the sensor under that sun.

    Example:  fynjax train emit --sun-zenith 25-35 --output emit_30
    """


@command("map", "fynjax.app.jobs:map_cube", "seed", "checkpoint", "workers")
def map_command(
    cube: Annotated[
        Path,
        typer.Argument(
            metavar="CUBE", help="Surface reflectance: ENVI, GeoTIFF, NetCDF or zarr, of any size."
        ),
    ],
    training: Annotated[Path, option("FILE", "Training for this sensor and sun (`fynjax train`).")],
    likely: Annotated[
        float,
        option("SHARE", "Pixels less like the simulations than this share of these are masked."),
    ] = 0.99,
    keep_unlike: Annotated[
        bool, typer.Option("--keep-unlike", help="Do not mask them; the map of it stays.")
    ] = False,
    skip_damaged: Annotated[
        bool,
        typer.Option("--skip-damaged", help="Leave rows that cannot be read without data."),
    ] = False,
    zarr: Annotated[
        bool, typer.Option("--zarr", help="Write maps.zarr as well, a variable each.")
    ] = False,
    pixels: Annotated[
        list[str] | None,
        listed(
            int,
            "ROW,COLUMN",
            "Sample the full posterior of this pixel by emcee as well, counted from 1 at the "
            "upper left of the cube; some 13 minutes of a core. May be given again.",
            "--pixel",
            counts=(2,),
            form="a row and a column, such as 12,40",
        ),
    ] = None,
    pixel_steps: Annotated[int, option("N", "Steps of each of its 16 walkers.", min=12)] = 400,
    prior: Annotated[
        str | None,
        option("NAME|FILE", "For --pixel: the prior of the training, if not the shipped one."),
    ] = None,
) -> None:
    """Map covers, leaf area and leaf traits of a cube, each with its uncertainty.

    Writes one cloud-optimised GeoTIFF: of each quantity mean, standard deviation and 5 and 95 %
    quantile, and how unlike the simulations a pixel is. The cube is read block by block. Of pixels
    that are asked for, the full posterior stands beside it.

    Example:  fynjax map flight.hdr --training emit_30/training.nc --output maps
    """
