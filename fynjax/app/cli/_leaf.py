"""Commands about spectra of leaves."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fynjax.app.cli._runtime import command, listed, option

Spectra = Annotated[
    list[Path],
    typer.Argument(
        metavar="SPECTRUM...",
        help="Files of spectra, or folders of them: ASD, SVC, Spectral Evolution, CSV, text, ENVI.",
    ),
]
PanelTable = Annotated[
    Path | None, option("FILE", "Table of the white panel's own reflectance, where files lack it.")
]


@command("convert", "fynjax.app.jobs:convert")
def convert(paths: Spectra, panel: PanelTable = None) -> None:
    """Write spectra of any format as one CSV and one NetCDF.

    Reads ASD, SVC, Spectral Evolution, CSV, text, ECOSTRESS and ENVI libraries, one file or whole
    folders. Writes spectra.csv (wavelengths in nm, a column a spectrum, fractions of 0 to 1),
    spectra.nc (the same with units, file and header of each) and sources.csv.

    Example:  fynjax convert campaign leaf_1.asd --output spectra
    """


@command("fit-leaf", "fynjax.app.jobs:fit_leaf", "seed", "checkpoint", "workers", forget=True)
def fit_leaf(
    paths: Spectra,
    version: Annotated[Literal["D", "PRO"], typer.Option(help="PROSPECT version.")] = "D",
    measurement: Annotated[
        str,
        typer.Option(
            help="How it was measured: sphere, leaf-clip, probe, or stack (piles, optically thick)."
        ),
    ] = "sphere",
    background: Annotated[
        str | None,
        option("FILE|NUMBER", "Reflectance behind the leaf of a clip or probe; black by default."),
    ] = None,
    over_background: Annotated[
        list[Path] | None,
        typer.Option(
            help="Second readings of the same leaves over --background (repeat for files); the "
            "first are then over black, and transmittance follows."
        ),
    ] = None,
    leaf_shape: Annotated[
        Literal["broad", "needle", "mat", "culm"],
        typer.Option(
            help="needle: single or apart; mat: needles side by side; culm: culms side by side. "
            "Gaps, and light between those side by side, are estimated where transmittance is."
        ),
    ] = "broad",
    area: Annotated[
        Literal["projected", "half_total"],
        typer.Option(help="Contents per projected area, or per half of the surface of the leaf."),
    ] = "projected",
    domain: Annotated[
        Literal["full", "optimal"],
        typer.Option(help="Wavelengths to fit: all, or the published sub-domains."),
    ] = "full",
    error_model: Annotated[
        Literal["exact", "laboratory", "field"] | None,
        typer.Option(
            help="What spectra depart from PROSPECT by: laboratory (real leaves, a sphere), field "
            "(real leaves, a clip or probe), exact (simulated spectra). Left out: by --measurement."
        ),
    ] = None,
    panel: PanelTable = None,
    detector_changes: Annotated[
        str | None,
        listed(
            float,
            "NM,...",
            "Where detectors change, such as 1000,1830; ASD files state it themselves.",
            form="wavelengths in nm such as 1000,1830",
        ),
    ] = None,
    transmittance: Annotated[
        list[Path] | None,
        typer.Option(
            help="Transmittance of the same leaves (repeat for files), where no name or file says "
            "it, as oak_R.asd and oak_T.asd do."
        ),
    ] = None,
    groups: Annotated[
        Path | None,
        typer.Option(help="CSV with columns name and species: fit leaves of a species together."),
    ] = None,
    posterior: Annotated[
        Literal["none", "emcee", "nuts"],
        typer.Option(help="Sample the posterior of each leaf as well."),
    ] = "none",
) -> None:
    """Fit PROSPECT to measured leaf spectra.

    Writes traits.csv (one row for each spectrum: parameters, standard deviations, fit error,
    status), spectra.nc (measured, fitted reflectance, predicted transmittance) and a figure.
    A table with reflectance and transmittance has a column of each, such as oak_R and oak_T.

    Example:  fynjax fit-leaf leaf_1.asd leaf_2.asd --output traits
    """
