"""The command `fynjax diversity`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.app.cli._runtime import (
    command,
    listed,
    option,
)

_GRADIENTS = {
    "gradients": (
        "fynjax.studies.communities:Gradients",
        ("richness", "evenness", "cover", "age"),
    )
}


@command(
    "diversity",
    "fynjax.studies.communities:diversity",
    "seed",
    "checkpoint",
    "workers",
    forget=True,
    records=_GRADIENTS,
)
def diversity(
    plot: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PLOT]",
            help="Plot file whose species and leaves communities are drawn from; or a species "
            "table (CSV), with usual leaves on the shipped plot; that plot if left out.",
        ),
    ] = None,
    communities: Annotated[int, option("N", "How many are drawn.", min=10)] = 100,
    size: Annotated[float, option("M", "Side of a simulated plot [m].", min=0.5, max=100.0)] = 10.0,
    sensors: Annotated[
        str, listed(str, "NAME,...", "Imaging sensors, by name or file.")
    ] = "mavic_3m,aviris_ng",
    pixels: Annotated[
        str,
        listed(
            float, "M,...", "Edges of a pixel [m] that divide the side, multiples of the smallest."
        ),
    ] = "0.05,0.1,0.25,0.5,1,1.25,2.5,5",
    noise: Annotated[
        str, listed(float, "SHARE,...", "Noise of a pixel over its reflectance.")
    ] = "0.01",
    bands: Annotated[int, option("N", "Bands of a sensor that are used, at most.", min=1)] = 30,
    samples: Annotated[int, option("N", "Pixels of each species to be recognised.", min=1)] = 20,
    threshold: Annotated[
        float,
        typer.Option(
            help="Squared correlation with a spectral metric, between 0 and 1, below which a "
            "diversity is lost.",
        ),
    ] = 0.25,
    greenness: Annotated[
        float | None,
        option(
            "NDVI",
            "NDVI, from -1 to below 1, that a pixel must have to count in the metrics; all "
            "count if left out.",
        ),
    ] = None,
    richness: Annotated[str, listed(int, "LOW,HIGH", "Fewest and most species.")] = "2,12",
    evenness: Annotated[
        str, listed(float, "LOW,HIGH", "Evenness of the covers after Pielou.")
    ] = "0.4,1",
    cover: Annotated[
        str, listed(float, "LOW,HIGH", "Sum of the covers as shares of the ground.")
    ] = "0.3,0.9",
    age: Annotated[
        str | None,
        listed(
            float,
            "LOW,HIGH",
            "Years since fire, of the article's taxa; sizes as in the table if left out.",
        ),
    ] = None,
) -> None:
    """Find what sensors can know of the diversity of communities, and at which pixel it is lost.

    Draws communities of a plot's species, plants them, and observes them at coarser and coarser
    pixels. Writes how well spectral metrics follow richness, Shannon, Simpson, evenness and cover,
    the pixel at which each is lost, how well species are recognised, figures and a report page.

    Example:  fynjax diversity --communities 20 --size 5 --pixels 0.05,0.1,0.5,1,2.5 --output out
    """
