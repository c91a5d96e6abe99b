"""`fynjax validate`."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import typer

from fynjax._core.errors import InputError
from fynjax.app.cli._runtime import BANDS, command, listed, option

_Bands = Annotated[str | None, listed(str, "A,B,...", f"What each band of the file is, {BANDS}")]
_Ground = Literal["auto", "labels", "smrf", "cloth", "none"]


def _windows(texts: list[str] | None) -> list[tuple[float, float]]:
    """Wavelengths to leave out, with those of water."""
    from fynjax.metrics import WATER_WINDOWS

    windows = [*WATER_WINDOWS]
    for text in texts or ():
        match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*-\s*(\d+(?:\.\d+)?)\s*", text)
        if not match:
            raise InputError(
                f"`--exclude` must be LOW-HIGH in nm, such as 930-960, but is {text!r}"
            )
        windows.append((float(match[1]), float(match[2])))
    return windows


class CloudOption(NamedTuple):
    """An option on how point clouds are compared; left out, the preset or the comparison says."""

    name: str
    kind: Any
    help: str
    metavar: str | None = None
    counts: tuple[int, ...] = ()
    """Counts of numbers that the option may take."""

    @property
    def annotation(self) -> Any:
        """The option as typer takes it."""
        more: dict[str, Any] = {"rich_help_panel": "Point clouds"}
        if not self.counts:
            made = typer.Option(metavar=self.metavar, help=self.help, **more)
        else:
            more |= {"form": f"{self.metavar} in metres", "counts": self.counts}
            made = listed(float, str(self.metavar), self.help, **more)
        return Annotated[self.kind | None, made]


CLOUD_OPTIONS = (
    CloudOption(
        "grain", float, "Side of a cell [m]; by the paper's rule, of 1 to 5 m, if left out."
    ),
    CloudOption(
        "largest_change",
        float,
        "Change of the metrics to the next larger grain, in their median, up to which a grain is "
        "taken [-]; 0.1 if left out.",
    ),
    CloudOption(
        "bounds",
        str,
        "The plot, in the real cloud's coordinates [m]; what both cover if left out.",
        "XMIN,YMIN,XMAX,YMAX",
        (4,),
    ),
    CloudOption(
        "shift",
        str,
        "What to add to the simulated cloud's coordinates [m]. Write --shift=-3,4 where the first "
        "is negative.",
        "DX,DY[,DZ]",
        (2, 3),
    ),
    CloudOption(
        "real_ground",
        _Ground,
        "How the real cloud's ground is found: its classes, a filter, or none where heights are "
        "above the ground already; auto takes classes where there are some, else smrf.",
    ),
    CloudOption("simulated_ground", _Ground, "The same of the simulated cloud."),
    CloudOption(
        "tolerance",
        float,
        "Largest distance from the lowest surface at which a filter takes returns for ground [m]; "
        "0.1 if left out.",
    ),
    CloudOption(
        "deepest", float, "Returns farther below the ground are noise [m]; 0.5 if left out."
    ),
    CloudOption(
        "tallest", float, "Returns higher above the ground are left out: birds, wires [m]."
    ),
    CloudOption("layer", float, "Thickness of a layer [m]."),
    CloudOption(
        "lowest",
        float,
        "Height at which layers begin [m]; those of the diversity too, where the preset has one "
        "height for both.",
    ),
    CloudOption(
        "diversity_lowest",
        float,
        "Height at which the layers of the foliage height diversity begin [m].",
    ),
    CloudOption(
        "diversity_of",
        Literal["returns", "leaf_area"],
        "What is shared out among layers for the foliage height diversity: returns are counted, or "
        "their leaf area.",
    ),
    CloudOption(
        "top",
        Literal["cell", "plot"],
        "Up to where layers count: the highest return of the cell or of the plot.",
    ),
    CloudOption("ground_height", float, "Returns below this are ground, under all layers [m]."),
    CloudOption("extinction", float, "Extinction coefficient k of leaf area density [-]."),
    CloudOption("gap_height", float, "Threshold of the gap fraction [m]."),
    CloudOption(
        "gap_of",
        Literal["returns", "canopy", "leaf_area"],
        "Gap fraction by the count of returns, of canopy cells, or from leaf area.",
    ),
    CloudOption(
        "rugosity_of",
        Literal["canopy", "columns"],
        "Rugosity of the canopy's surface, or of the columns.",
    ),
    CloudOption("canopy_cell", float, "Side of a cell of the canopy's surface [m]."),
    CloudOption(
        "cv_lowest", float, "Returns below this do not count for the variation of height [m]."
    ),
    CloudOption("least_returns", int, "Returns with which a cell counts; 5 if left out."),
    CloudOption("repetitions", int, "Thinnings of the denser cloud; 100 if left out."),
    CloudOption(
        "histogram_bin", float, "Width of the bins of the height histogram [m]; 0.1 if left out."
    ),
)
"""Named as the settings of `fynjax.app.compare.structure.cloud_settings`."""


_KINDS = ("drone", "spectra", "cloud")
FILES = [f"{side}_{kind}" for kind in _KINDS for side in ("real", "simulated")]


@command(
    "validate",
    "fynjax.app.jobs:validate",
    "seed",
    further={option.name: option.annotation for option in CLOUD_OPTIONS},
    records={
        "data": ("fynjax.app.jobs:ValidationData", FILES),
        "cloud_options": ("builtins:dict", [option.name for option in CLOUD_OPTIONS]),
    },
)
def validate(
    real_drone: Annotated[
        str | None,
        option(
            "FILE",
            "Real drone image (GeoTIFF, reflectance); or 'published': the printed statistics "
            "of the plot burnt in 2006.",
        ),
    ] = None,
    simulated_drone: Annotated[Path | None, option("FILE", "Simulated drone image.")] = None,
    real_spectra: Annotated[
        list[Path] | None,
        option(
            "FILE",
            "Real spectra: CSV, ASD, ENVI library or cube, GeoTIFF, NetCDF. May be given "
            "several times.",
        ),
    ] = None,
    simulated_spectra: Annotated[
        list[Path] | None, option("FILE", "Simulated spectra, in any of these.")
    ] = None,
    real_cloud: Annotated[
        Path | None, option("FILE", "Real point cloud (LAS, LAZ, PLY, XYZ).")
    ] = None,
    simulated_cloud: Annotated[Path | None, option("FILE", "Simulated point cloud.")] = None,
    real_bands: _Bands = None,
    simulated_bands: _Bands = None,
    saturation: Annotated[
        float | None,
        typer.Option(min=0.0, help="Saturation threshold of a drone pixel [-]."),
    ] = None,
    most_pixels: Annotated[
        int,
        typer.Option(
            "--pixels",
            min=100,
            help="Largest number of pixels of an image; larger ones are thinned evenly.",
        ),
    ] = 1_000_000,
    matching: Annotated[
        str,
        typer.Option(
            help="How the finer spectra are brought onto the bands of the coarser: auto, nearest, "
            "linear, response."
        ),
    ] = "auto",
    windows: Annotated[
        list[str] | None,
        option(
            "LOW-HIGH",
            "Wavelengths to leave out [nm], besides the water windows 1340-1460 and "
            "1790-2100. May be given several times.",
            "--exclude",
            callback=_windows,
        ),
    ] = None,
    structure_preset: Annotated[
        str | None,
        option(
            "NAME",
            "Conventions of a known tool: fynjax, lidR, leafR, PyForestScan, GEDI L2B. "
            "The options below override it.",
            rich_help_panel="Point clouds",
        ),
    ] = None,
) -> None:
    """Compare simulated with real data: drone images, spectra, point clouds.

    Any of the three pairs may be left out. Writes report.html, a table of every number (CSV and
    validation.nc) and the figures, with the published values of the fynbos scene paper beside them.
    The images need not lie on each other: distributions of pixels are compared.

    Example:  fynjax validate --real-drone plot.tif --simulated-drone image.tif --output validation
    """
