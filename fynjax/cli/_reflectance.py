"""`fynjax reflectance`."""

from pathlib import Path
from typing import Annotated

import typer

from fynjax.cli._runtime import Job, command

Images = Annotated[
    list[Path],
    typer.Argument(
        metavar="FOLDER_OR_FILES...",
        help="Raw pictures of a MicaSense camera: a folder of captures, or NAME_1.tif, NAME_2.tif, "
        "...",
    ),
]


@command("reflectance")
def reflectance(
    images: Images,
    panel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Capture that shows a panel: its name, such as IMG_0000, or one of its files. "
            "Again for more panels, which make an empirical line.",
        ),
    ] = None,
    panel_reflectance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="R[,R...]",
            help="Reflectance of the panel: a number, one for each band in order, or a CSV file "
            "(band,reflectance or wavelength_nm,reflectance).",
        ),
    ] = None,
    panel_area: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"X,Y X,Y ..."',
            help="Corners of its area, columns and rows of pixels; found in the picture if left "
            "out.",
        ),
    ] = None,
    light: Annotated[
        str | None,
        typer.Option(
            help="panel: steady since the panel; sensor: pi L / E by the light sensor; both: the "
            "panel, and the sensor for changes since.",
        ),
    ] = None,
    panel_sd: Annotated[
        float, typer.Option(help="Relative standard deviation of the panel's reflectance.")
    ] = 0.02,
    light_sd: Annotated[
        float, typer.Option(help="Relative standard deviation of the light.")
    ] = 0.05,
    height: Annotated[
        float | None, typer.Option(metavar="M", help="Height of flight above the ground [m].")
    ] = None,
    pixel: Annotated[
        float | None, typer.Option(metavar="M", help="Or the side of a pixel on it [m].")
    ] = None,
    align: Annotated[
        bool, typer.Option("--align/--no-align", help="Align the bands of a capture.")
    ] = True,
) -> Job:
    """Turn raw pictures of a multispectral drone camera into reflectance.

    Writes a GeoTIFF of each capture with all bands aligned, its uncertainty, pictures of captures
    and panels, and a record of the calibration.

    Example:  fynjax reflectance flight --panel IMG_0000 --panel-reflectance panel.csv --height 70
    """
    from fynjax import jobs

    return lambda folder: jobs.reflectance(
        images,
        folder,
        panels=panel or (),
        reflectances=panel_reflectance or (),
        areas=panel_area or (),
        light=light,
        panel_sd=panel_sd,
        light_sd=light_sd,
        height=height,
        pixel=pixel,
        align=align,
    )
