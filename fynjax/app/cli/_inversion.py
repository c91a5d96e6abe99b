"""Commands from measurements of a plot to its parameters, and about what measurements can say."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fynjax.app.cli._runtime import (
    BANDS,
    PlotOption,
    PlotPath,
    PriorFile,
    Twin,
    command,
    listed,
    option,
)

Targets = Annotated[
    list[Path],
    option(
        "FILE",
        "What was measured; may be given once for each kind. Drone image (GeoTIFF, "
        "reflectance) or a table with statistic, value, sd. Spectrum (CSV, ASD, ENVI library) or "
        "image of many bands (ENVI, NetCDF, GeoTIFF), of which the mean counts. Point cloud (LAS, "
        "LAZ) or a table with metric, value, sd, grain_m, returns_m2.",
        "--target",
    ),
]
Bands = Annotated[
    str | None, listed(str, "A,B,...", f"What each band of the drone image is, {BANDS}")
]
Free = Annotated[
    list[str] | None,
    option(
        "PATTERN",
        "Parameters to free, such as species.*.cover; may be repeated. The plot file's if "
        "left out.",
    ),
]
_TWO = "two wavelengths, such as 450,900"


@command("calibrate", "fynjax.app.jobs:calibrate", "seed", "checkpoint", forget=True)
def calibrate(
    plot: PlotPath,
    targets: Targets = [],  # noqa: B006
    bands: Bands = None,
    prior: PriorFile = "none",
    twin: Twin = False,
) -> None:
    """Find the parameters of a plot that explain what was measured of it.

    By one sensor or several at once. Writes every parameter with prior, estimate and standard
    deviation, the statistics before and after, images, figures and a report page. An interrupted
    run goes on when the same command is given again.

    Example:  fynjax calibrate plot.toml --target statistics.csv --target cloud.laz
    """


@command("crowns", "fynjax.app.jobs:crowns", "seed")
def crowns(
    image: Annotated[
        Path,
        typer.Argument(
            metavar="ORTHO.tif", help="Orthophoto of the plot and nothing else: reflectance."
        ),
    ],
    plot: PlotOption,
    bands: Bands = None,
    heights: Annotated[
        Path | None,
        option(
            "FILE",
            "Height of the canopy above the ground [m], a raster of SfM or LiDAR that "
            "covers the plot.",
        ),
    ] = None,
    rounds: Annotated[int, option("N", "Rounds of each chain of whole stands.", min=2)] = 24,
    free: Free = None,
) -> None:
    """Find which plants stand where, in the pixels of an orthophoto.

    Writes crowns with probabilities of species, diameter and height (GeoPackage), maps of species
    and crowns with their uncertainty (GeoTIFF), plants and covers beside the field table, figures
    and a report page. Needs the extras map and tables.

    Example:  fynjax crowns ortho.tif --plot plot.toml --output crowns
    """


@command("posterior", "fynjax.app.jobs:posterior", "seed", "checkpoint")
def posterior(
    plot: PlotPath,
    targets: Targets,
    bands: Bands = None,
    method: Annotated[
        Literal["emcee", "nuts", "laplace"],
        typer.Option(
            help="An ensemble of walkers, Hamiltonian sampling, or the Gaussian about the fit."
        ),
    ] = "emcee",
    free: Free = None,
    target_size: Annotated[
        int, typer.Option("--draws", min=1, help="Effective draws to reach.")
    ] = 400,
    max_steps: Annotated[
        int, typer.Option("--steps", min=1, help="Most steps of the chain.")
    ] = 5000,
    prior: PriorFile = "none",
) -> None:
    """Sample which parameters of a plot real measurements leave possible.

    By one sensor or several at once. Writes every draw (NetCDF), the parameters with their
    intervals, figures and a report page. An interrupted run goes on when the same command is given
    again.

    Example:  fynjax posterior plot.toml --target statistics.csv --method laplace
    """


@command("sensitivity", "fynjax.app.jobs:sensitivity", "seed", "checkpoint", "workers", forget=True)
def sensitivity(
    plot: PlotPath,
    metrics: Annotated[
        str, listed(str, "NAME,...", "Statistics of the image.")
    ] = "red.mean,nir.mean,NDVI.mean,NDVI.std",
    free: Free = None,
    plantings: Annotated[
        int,
        option(
            "N",
            "Plantings over which slopes are taken, at most; fewer where the errors of each "
            "metric's three largest elasticities are below 10 %.",
            min=2,
        ),
    ] = 64,
    derivative_samples: Annotated[
        int,
        option(
            "N",
            "Samples for derivative-based global sensitivity (DGSM), a power of two; 0: none.",
            "--derivatives",
            min=0,
        ),
    ] = 0,
    sobol_samples: Annotated[
        int,
        option(
            "N",
            "Points of the Sobol design, a power of two; takes N (parameters + 2) renders.",
            "--sobol",
            min=0,
        ),
    ] = 0,
) -> None:
    """Find which parameters of a plot change which statistics of its image.

    Writes slopes and elasticities at the plot's parameters, means over plantings with their
    errors, shares of variance over the priors if asked for, figures and a report page.

    Example:  fynjax sensitivity plot.toml --metrics NDVI.mean,nir.mean --derivatives 64
    """


@command("information", "fynjax.app.jobs:information", "seed")
def information(
    plot: PlotPath,
    gsd: Annotated[
        str, listed(float, "M,...", "Sides of a pixel [m], multiples of the smallest.")
    ] = "0.1,0.2,0.5,1,2,5",
    bands: Annotated[
        str, listed(int, "N,...", "Numbers of bands, divisors of the largest.")
    ] = "2,4,8",
    spectrum: Annotated[
        str,
        listed(float, "LOW,HIGH", "Range that the bands share [nm].", counts=(2,), form=_TWO),
    ] = "450,900",
    noise: Annotated[
        str, listed(float, "SHARE,...", "Noise of a pixel over its reflectance.")
    ] = "0.01",
    sun_zenith: Annotated[
        str | None,
        listed(float, "DEG,...", "Zenith angles of the sun; the plot's if left out.", "--sun"),
    ] = None,
    free: Free = None,
    realisations: Annotated[
        int, typer.Option(min=2, help="Stand realisations used to estimate sampling variance.")
    ] = 15,
) -> None:
    """Bound how well sensors of any pixel, bands and noise can constrain a plot.

    Writes the Cramér-Rao bound on every parameter, the pixel at which each species' cover is
    lost, figures and a report page.

    Example:  fynjax information plot.toml --free 'species.*.cover' --gsd 0.1,0.5,1,5 --bands 2,4,8
    """


@command("design", "fynjax.app.jobs:design", "seed")
def design(
    plot: PlotPath,
    bands: Annotated[int, option("N", "Bands of the sensor.", min=1)] = 4,
    target: Annotated[
        str,
        listed(
            str,
            "NAME,...",
            "What the bands are to inform of: numbers of the stand (green_leaf_area, crown_cover, "
            "shannon, ...), names or patterns of free parameters; or information, or separability.",
        ),
    ] = "green_leaf_area,dead_share,canopy_chlorophyll,crown_cover,shannon",
    spectrum: Annotated[
        str, listed(float, "LOW,HIGH", "Range of the detector [nm].", counts=(2,), form=_TWO)
    ] = "400,2500",
    widths: Annotated[
        str, listed(float, "LOW,HIGH", "Least and greatest width [nm].", counts=(2,), form=_TWO)
    ] = "10,100",
    pixel: Annotated[
        str,
        listed(
            float,
            "M,...",
            "Side of a pixel [m]; of several, multiples of the smallest, the best is taken.",
        ),
    ] = "0.1",
    snr: Annotated[
        float,
        typer.Option(
            help="Signal over shot noise of a pixel, the smallest, in 10 nm at 550 nm over a "
            "reflectance of 0.1."
        ),
    ] = 100.0,
    compare: Annotated[
        str, listed(str, "NAME,...", "Other sensors, by name or file.")
    ] = "mavic_3m,rededge_3,sentinel_2a",
    free: Annotated[
        list[str] | None,
        option(
            "PATTERN",
            "Unknown parameters, such as species.*.cover; may be repeated. If left out, "
            "covers, diameters, dead tissue, chlorophyll, water, dry matter and the ground.",
        ),
    ] = None,
    plantings: Annotated[int, option("N", "Plantings over which the target is a mean.", min=4)] = 6,
    starts: Annotated[int, option("N", "Ascents.", min=1)] = 8,
) -> None:
    """Find the most informative bands of a sensor on a plot.

    Writes centres and widths, a sensor file with them, what they gain over other sensors in
    plantings left out of the design, figures and a report page.

    Example:  fynjax design plot.toml --bands 4 --target dead_share,shannon --output designed
    """
