"""`fynjax validate`."""

import re
from pathlib import Path
from typing import Annotated

import typer

from fynjax._core.errors import InputError
from fynjax.cli._runtime import Json, Output, Quiet, Seed, run_job

_Bands = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,...",
        help="What each band of the file is, in its order: green, red, red_edge, nir, or any other "
        "name for one that is not used. Needed where the file does not say.",
    ),
]


def validate(
    real_drone: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Real drone image (GeoTIFF, reflectance); or 'published': the printed statistics "
            "of the plot burnt in 2006.",
        ),
    ] = None,
    simulated_drone: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Simulated drone image.")
    ] = None,
    real_spectra: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Real spectra: CSV, ASD, ENVI library or cube, GeoTIFF, NetCDF. May be given "
            "several times.",
        ),
    ] = None,
    simulated_spectra: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Simulated spectra, in any of these.")
    ] = None,
    real_cloud: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Real point cloud (LAS, LAZ, PLY, XYZ).")
    ] = None,
    simulated_cloud: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Simulated point cloud.")
    ] = None,
    real_bands: _Bands = None,
    simulated_bands: _Bands = None,
    saturation: Annotated[
        float | None,
        typer.Option(min=0.0, help="Reflectance from which on a drone pixel is left out."),
    ] = None,
    pixels: Annotated[
        int,
        typer.Option(
            min=100, help="Largest number of pixels of an image; larger ones are thinned evenly."
        ),
    ] = 1_000_000,
    matching: Annotated[
        str,
        typer.Option(
            help="How the finer spectra are brought onto the bands of the coarser: auto, nearest, "
            "linear, response."
        ),
    ] = "auto",
    exclude: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOW-HIGH",
            help="Wavelengths to leave out [nm], besides the water windows 1340-1460 and "
            "1790-2100. May be given several times.",
        ),
    ] = None,
    structure_preset: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Conventions of a known tool for the point clouds."),
    ] = None,
    output: Output = Path("output/validate"),
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare simulated with real data: drone images, spectra, point clouds.

    Any of the three pairs may be left out. Writes report.html, a table of every number (CSV and
    validation.nc) and the figures, with the published values of the fynbos scene paper beside them.
    The images need not lie on each other: distributions of pixels are compared.

    Example:  fynjax validate --real-drone plot.tif --simulated-drone image.tif --output validation
    """
    from fynjax.metrics import WATER_WINDOWS
    from fynjax.report._validate_job import ValidationData, run_validate

    data = ValidationData(
        real_drone=real_drone,
        simulated_drone=simulated_drone,
        real_spectra=real_spectra or (),
        simulated_spectra=simulated_spectra or (),
        real_cloud=real_cloud,
        simulated_cloud=simulated_cloud,
    )
    windows = (*WATER_WINDOWS, *map(_window, exclude or ()))
    run_job(
        "validate",
        lambda folder, progress: run_validate(
            data,
            folder,
            real_bands=None if real_bands is None else real_bands.split(","),
            simulated_bands=None if simulated_bands is None else simulated_bands.split(","),
            saturation=saturation,
            most_pixels=pixels,
            matching=matching,  # type: ignore[arg-type]
            windows=windows,
            structure_preset=structure_preset,
            seed=seed,
            progress=progress,
        ),
        output,
        seed=seed,
        as_json=json,
        quiet=quiet,
    )


def _window(text: str) -> tuple[float, float]:
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*-\s*(\d+(?:\.\d+)?)\s*", text)
    if not found:
        raise InputError(f"`--exclude` must be LOW-HIGH in nm, such as 930-960, but is {text!r}")
    return float(found[1]), float(found[2])
