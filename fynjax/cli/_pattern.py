"""`fynjax pattern`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax._core.errors import InputError
from fynjax.cli._runtime import Job, Seed, command

Images = Annotated[
    list[Path],
    typer.Argument(
        metavar="IMAGE...",
        help="Image of several bands (GeoTIFF), or the single-band files of one capture in order.",
    ),
]


@command("pattern", work=lambda given: {"files": given["images"]})
def pattern(
    images: Images,
    clusters: Annotated[int, typer.Option(min=2, max=255, help="Number of clusters.")] = 3,
    bands: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...",
            help="Names of the bands or their wavelengths [nm], in order, where files lack them.",
        ),
    ] = None,
    greenness: Annotated[
        str,
        typer.Option(
            help="What orders the clusters: auto, ndvi, excess_green, or a band that is brighter "
            "where plants are (-BAND: darker)."
        ),
    ] = "auto",
    greenness_weight: Annotated[
        float,
        typer.Option(min=0.0, help="How much greenness counts in clustering; 0: the bands alone."),
    ] = 1.0,
    levels: Annotated[
        str | None,
        typer.Option(
            metavar="N,N,...",
            help="Grey of each cluster, least green first; evenly up to 255 if left out. 0 keeps "
            "a cluster free of plants.",
        ),
    ] = None,
    pixel: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a pixel [m], for an image without a place."),
    ] = None,
    align: Annotated[
        bool, typer.Option("--align/--no-align", help="Align the files of a capture.")
    ] = True,
    seed: Seed = 0,
) -> Job:
    """Make a probability map from an image: where plants are likely to stand.

    Writes map.tif for `probability_map` of a plot file, and a picture. Pixels are clustered by
    K-means and the clusters ordered by greenness.

    Example:  fynjax pattern orthophoto.tif --levels 0,128,255 --output pattern
    """
    from fynjax import jobs

    greys = None if levels is None else [_grey(text) for text in levels.split(",")]
    return lambda folder: jobs.pattern(
        images,
        folder,
        clusters=clusters,
        bands=None if bands is None else bands.split(","),
        greenness=greenness,
        greenness_weight=greenness_weight,
        levels=greys,
        pixel=pixel,
        align=align,
        seed=seed,
    )


def _grey(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise InputError(
            f"`--levels` must be whole numbers from 0 to 255 with commas, such as 0,128,255, but "
            f"has {text.strip()!r}"
        ) from None
