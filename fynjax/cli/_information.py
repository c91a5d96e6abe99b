"""`fynjax information`."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from fynjax._core.errors import InputError
from fynjax.cli._posterior import Free
from fynjax.cli._runtime import Job, OwnSeed, PlotPath, command


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    suns = (given["sun"] or "plot").split(",")
    return {"plot": given["plot"], "sun_zenith": suns, "realisations": given["realisations"]}


@command("information", work=_work)
def information(
    plot: PlotPath,
    gsd: Annotated[
        str,
        typer.Option(metavar="M,...", help="Sides of a pixel [m], multiples of the smallest."),
    ] = "0.1,0.2,0.5,1,2,5",
    bands: Annotated[
        str, typer.Option(metavar="N,...", help="Numbers of bands, divisors of the largest.")
    ] = "2,4,8",
    spectrum: Annotated[
        str, typer.Option(metavar="LOW,HIGH", help="Range that the bands share [nm].")
    ] = "450,900",
    noise: Annotated[
        str, typer.Option(metavar="SHARE,...", help="Noise of a pixel over its reflectance.")
    ] = "0.01",
    sun: Annotated[
        str | None,
        typer.Option(metavar="DEG,...", help="Zenith angles of the sun; the plot's if left out."),
    ] = None,
    free: Free = None,
    realisations: Annotated[
        int, typer.Option(min=2, help="Stand realisations used to estimate sampling variance.")
    ] = 15,
    seed: OwnSeed = None,
) -> Job:
    """Bound how well sensors of any pixel, bands and noise can constrain a plot.

    Writes the Cramér-Rao bound on every parameter, the pixel at which each species' cover is
    lost, figures and a report page.

    Example:  fynjax information plot.toml --free 'species.*.cover' --gsd 0.1,0.5,1,5 --bands 2,4,8
    """
    sizes, levels = _numbers(gsd, "--gsd"), _numbers(noise, "--noise")
    counts = [int(n) for n in _numbers(bands, "--bands")]
    limits = _numbers(spectrum, "--spectrum")
    if len(limits) != 2:
        raise InputError(
            f"`--spectrum` must be two wavelengths, such as 450,900, but is {spectrum}"
        )
    suns = None if sun is None else _numbers(sun, "--sun")
    from fynjax import jobs

    return lambda folder: jobs.information(
        plot,
        folder,
        free=free,
        gsd=sizes,
        bands=counts,
        spectrum=(limits[0], limits[1]),
        noise=levels,
        sun_zenith=suns,
        realisations=realisations,
        seed=seed,
    )


def _numbers(text: str, option: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(
            f"`{option}` must be numbers with commas between, but is {text!r}"
        ) from None
