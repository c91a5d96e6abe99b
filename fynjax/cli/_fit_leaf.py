"""`fynjax fit-leaf`."""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax.cli._runtime import (
    Checkpoint,
    Job,
    SchedulerAddress,
    Seed,
    WorkerCount,
    command,
)


class Version(StrEnum):
    """PROSPECT versions."""

    D = "D"
    PRO = "PRO"


class LeafShapeOption(StrEnum):
    """Shapes of leaves."""

    broad = "broad"
    needle = "needle"
    mat = "mat"
    culm = "culm"


class Area(StrEnum):
    """Areas that contents are stated per."""

    projected = "projected"
    half_total = "half_total"


class Domain(StrEnum):
    """Wavelengths that enter the fit."""

    full = "full"
    optimal = "optimal"


class Sampler(StrEnum):
    """How the posterior is sampled."""

    none = "none"
    emcee = "emcee"
    nuts = "nuts"


Spectra = Annotated[
    list[Path],
    typer.Argument(
        metavar="SPECTRUM...",
        help="Files of spectra, or folders of them: ASD, SVC, Spectral Evolution, CSV, text, ENVI.",
    ),
]


def _wavelengths(text: str) -> list[float]:
    """Wavelengths [nm] of a list with commas."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        message = f"expected wavelengths in nm such as 1000,1830, but found {text!r}"
        raise typer.BadParameter(message, param_hint="--detector-changes") from None


PanelTable = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Table of the white panel's own reflectance, where files lack it."
    ),
]


def existing_panel(path: Path | None) -> None:
    """Refuse what is no file."""
    from fynjax.io.text import existing_file

    if path is not None:
        existing_file(path, "a table of the panel's reflectance")


def existing_spectra(paths: list[Path]) -> None:
    """Refuse what is neither a file nor a folder."""
    from fynjax.io.text import existing_file

    for path in paths:
        if not path.is_dir():
            existing_file(path, "a file of spectra")


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"files": given["spectra"], "posterior": given["posterior"].value}


@command("fit-leaf", forget=True, work=_work)
def fit_leaf(
    spectra: Spectra,
    version: Annotated[Version, typer.Option(help="PROSPECT version.")] = Version.D,
    measurement: Annotated[
        str,
        typer.Option(
            help="How it was measured: sphere, leaf-clip, probe, or stack (piles, optically thick)."
        ),
    ] = "sphere",
    background: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NUMBER",
            help="Reflectance behind the leaf of a clip or probe; black by default.",
        ),
    ] = None,
    over_background: Annotated[
        list[Path] | None,
        typer.Option(
            help="Second readings of the same leaves over --background (repeat for files); the "
            "first are then over black, and transmittance follows."
        ),
    ] = None,
    leaf_shape: Annotated[
        LeafShapeOption,
        typer.Option(
            help="needle: single or apart; mat: needles side by side; culm: culms side by side. "
            "Gaps, and light between those side by side, are estimated where transmittance is."
        ),
    ] = LeafShapeOption.broad,
    area: Annotated[
        Area,
        typer.Option(help="Contents per projected area, or per half of the surface of the leaf."),
    ] = Area.projected,
    domain: Annotated[
        Domain, typer.Option(help="Wavelengths to fit: all, or the published sub-domains.")
    ] = Domain.full,
    panel: PanelTable = None,
    detector_changes: Annotated[
        str | None,
        typer.Option(
            metavar="NM,...",
            help="Where detectors change, such as 1000,1830; ASD files state it themselves.",
        ),
    ] = None,
    groups: Annotated[
        Path | None,
        typer.Option(help="CSV with columns name and species: fit leaves of a species together."),
    ] = None,
    regression: Annotated[
        bool,
        typer.Option(
            "--regression",
            help="Correct water by what fits leave in the spectra, all of one campaign.",
        ),
    ] = False,
    posterior: Annotated[
        Sampler, typer.Option(help="Sample the posterior of each leaf as well.")
    ] = Sampler.none,
    checkpoint: Checkpoint = None,
    workers: WorkerCount = None,
    scheduler: SchedulerAddress = None,
    seed: Seed = 0,
) -> Job:
    """Fit PROSPECT to measured leaf spectra.

    Writes traits.csv (one row for each spectrum: parameters, standard deviations, fit error,
    status), spectra.nc (measured, fitted reflectance, predicted transmittance) and a figure.
    A table with reflectance and transmittance has a column of each, such as oak_R and oak_T.

    Example:  fynjax fit-leaf leaf_1.asd leaf_2.asd --output traits
    """
    from fynjax.io.text import existing_file

    existing_spectra(spectra)
    further: dict[str, Any] = {}
    existing_panel(panel)
    if background is not None:
        further["background"] = background
    if over_background:
        further["over_background"] = [
            existing_file(path, "a reading over the background") for path in over_background
        ]
    if area is not Area.projected:
        further["area"] = area.value
    if detector_changes is not None:
        further["detector_changes"] = _wavelengths(detector_changes)
    if groups is not None:
        existing_file(groups, "a table of species")
        further["groups"] = groups
    if regression:
        further["regression"] = True
    if posterior is not Sampler.none:
        further["posterior"] = posterior.value
    from fynjax import jobs

    return lambda folder: jobs.fit_leaf(
        spectra,
        folder,
        version=version.value,
        measurement=measurement,
        leaf_shape=leaf_shape.value,
        domain=domain.value,
        panel=panel,
        seed=seed,
        checkpoint=checkpoint,
        workers=jobs.Workers(workers, scheduler),
        **further,
    )
