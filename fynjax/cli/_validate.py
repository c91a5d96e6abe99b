"""`fynjax validate`."""

import math
import re
from pathlib import Path
from typing import Annotated, Literal

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

_CLOUDS = "Point clouds"
_Ground = Literal["auto", "labels", "smrf", "cloth", "none"]
_DiversityOf = Literal["returns", "leaf_area"]
_Top = Literal["cell", "plot"]
_GapOf = Literal["returns", "canopy", "leaf_area"]
_RugosityOf = Literal["canopy", "columns"]


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
        typer.Option(
            metavar="NAME",
            rich_help_panel=_CLOUDS,
            help="Conventions of a known tool: fynjax, lidR, leafR, PyForestScan, GEDI L2B. "
            "The options below override it.",
        ),
    ] = None,
    grain: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Side of a cell [m]; by the paper's rule, of 1 to 5 m, if left out.",
        ),
    ] = None,
    largest_change: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Change of the metrics to the next larger grain, in their median, up to "
            "which a grain is taken [-]; 0.1 if left out.",
        ),
    ] = None,
    bounds: Annotated[
        str | None,
        typer.Option(
            metavar="XMIN,YMIN,XMAX,YMAX",
            rich_help_panel=_CLOUDS,
            help="The plot, in the real cloud's coordinates [m]; what both cover if left out.",
        ),
    ] = None,
    shift: Annotated[
        str | None,
        typer.Option(
            metavar="DX,DY[,DZ]",
            rich_help_panel=_CLOUDS,
            help="What to add to the simulated cloud's coordinates [m]. Write --shift=-3,4 "
            "where the first is negative.",
        ),
    ] = None,
    real_ground: Annotated[
        _Ground | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="How the real cloud's ground is found: its classes, a filter, or none where "
            "heights are above the ground already; auto takes classes where there are "
            "some, else smrf.",
        ),
    ] = None,
    simulated_ground: Annotated[
        _Ground | None,
        typer.Option(rich_help_panel=_CLOUDS, help="The same of the simulated cloud."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="How far from the lowest surface a filter takes returns for ground [m]; 0.1 "
            "if left out.",
        ),
    ] = None,
    deepest: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Returns farther below the ground are noise [m]; 0.5 if left out.",
        ),
    ] = None,
    tallest: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Returns higher above the ground are left out: birds, wires [m].",
        ),
    ] = None,
    layer: Annotated[
        float | None,
        typer.Option(rich_help_panel=_CLOUDS, help="Thickness of a layer [m]."),
    ] = None,
    lowest: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Height at which layers begin [m]; those of the diversity too, where the "
            "preset has one height for both.",
        ),
    ] = None,
    diversity_lowest: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Height at which the layers of the foliage height diversity begin [m].",
        ),
    ] = None,
    diversity_of: Annotated[
        _DiversityOf | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="What is shared out among layers for the foliage height diversity: returns "
            "are counted, or their leaf area.",
        ),
    ] = None,
    top: Annotated[
        _Top | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Up to where layers count: the highest return of the cell or of the plot.",
        ),
    ] = None,
    ground_height: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS, help="Returns below this are ground, under all layers [m]."
        ),
    ] = None,
    extinction: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS, help="Extinction coefficient k of leaf area density [-]."
        ),
    ] = None,
    gap_height: Annotated[
        float | None,
        typer.Option(rich_help_panel=_CLOUDS, help="Threshold of the gap fraction [m]."),
    ] = None,
    gap_of: Annotated[
        _GapOf | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Gap fraction by the count of returns, of canopy cells, or from leaf area.",
        ),
    ] = None,
    rugosity_of: Annotated[
        _RugosityOf | None,
        typer.Option(
            rich_help_panel=_CLOUDS, help="Rugosity of the canopy's surface, or of the columns."
        ),
    ] = None,
    canopy_cell: Annotated[
        float | None,
        typer.Option(rich_help_panel=_CLOUDS, help="Side of a cell of the canopy's surface [m]."),
    ] = None,
    cv_lowest: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Returns below this do not count for the variation of height [m].",
        ),
    ] = None,
    least_returns: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=_CLOUDS, help="Returns with which a cell counts; 5 if left out."
        ),
    ] = None,
    repetitions: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=_CLOUDS, help="Thinnings of the denser cloud; 100 if left out."
        ),
    ] = None,
    histogram_bin: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=_CLOUDS,
            help="Width of the bins of the height histogram [m]; 0.1 if left out.",
        ),
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
    from fynjax import jobs
    from fynjax.metrics import WATER_WINDOWS

    data = jobs.ValidationData(
        real_drone=real_drone,
        simulated_drone=simulated_drone,
        real_spectra=real_spectra or (),
        simulated_spectra=simulated_spectra or (),
        real_cloud=real_cloud,
        simulated_cloud=simulated_cloud,
    )
    cloud_options = {
        "bounds": _numbers("bounds", bounds, (4,), "XMIN,YMIN,XMAX,YMAX"),
        "shift": _numbers("shift", shift, (2, 3), "DX,DY or DX,DY,DZ"),
        "grain": grain,
        "largest_change": largest_change,
        "tolerance": tolerance,
        "deepest": deepest,
        "tallest": tallest,
        "layer": layer,
        "lowest": lowest,
        "diversity_lowest": diversity_lowest,
        "diversity_of": diversity_of,
        "top": top,
        "ground_height": ground_height,
        "extinction": extinction,
        "gap_height": gap_height,
        "gap_of": gap_of,
        "rugosity_of": rugosity_of,
        "canopy_cell": canopy_cell,
        "cv_lowest": cv_lowest,
        "least_returns": least_returns,
        "repetitions": repetitions,
        "histogram_bin": histogram_bin,
        "real_ground": real_ground,
        "simulated_ground": simulated_ground,
    }
    windows = (*WATER_WINDOWS, *map(_window, exclude or ()))
    run_job(
        "validate",
        lambda folder, progress: jobs.validate(
            data,
            folder,
            real_bands=None if real_bands is None else real_bands.split(","),
            simulated_bands=None if simulated_bands is None else simulated_bands.split(","),
            saturation=saturation,
            most_pixels=pixels,
            matching=matching,  # type: ignore[arg-type]
            windows=windows,
            structure_preset=structure_preset,
            cloud_options=cloud_options,
            seed=seed,
            progress=progress,
        ),
        output,
        as_json=json,
        quiet=quiet,
    )


def _window(text: str) -> tuple[float, float]:
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*-\s*(\d+(?:\.\d+)?)\s*", text)
    if not found:
        raise InputError(f"`--exclude` must be LOW-HIGH in nm, such as 930-960, but is {text!r}")
    return float(found[1]), float(found[2])


def _numbers(
    name: str, text: str | None, counts: tuple[int, ...], form: str
) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        found = tuple(map(float, text.split(",")))
    except ValueError:
        found = ()
    if len(found) not in counts or not all(map(math.isfinite, found)):
        raise InputError(f"`--{name}` must be {form} in metres, but is {text!r}")
    return found
