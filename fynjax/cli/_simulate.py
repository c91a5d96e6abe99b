"""`fynjax simulate`."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any

import typer

from fynjax.cli._runtime import Job, OwnSeed, PlotPath, command


class Product(StrEnum):
    """Which images to write."""

    both = "both"
    reflectance = "reflectance"
    radiance = "radiance"


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    return {key: given[key] for key in ("plot", "sensor", "altitude", "pixel")}


@command("simulate", work=_work)
def simulate(
    plot: PlotPath,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Shipped sensor (aviris_ng, emit, mavic_3m, flash_lidar_paper, ...) or a sensor "
            "file; the plot file's if left out.",
        ),
    ] = None,
    altitude: Annotated[
        float | None, typer.Option(metavar="M", help="Height above the ground [m].")
    ] = None,
    pixel: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a pixel; from the optics if left out."),
    ] = None,
    atmosphere: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="table (6S), clear-sky, none, or curves of your own (CSV, NetCDF).",
        ),
    ] = None,
    noise: Annotated[
        bool | None,
        typer.Option("--noise/--no-noise", help="Draw noise; if the sensor has a model, yes."),
    ] = None,
    product: Annotated[Product, typer.Option(help="Images to write.")] = Product.both,
    seed: OwnSeed = None,
) -> Job:
    """Simulate what any sensor measures over a plot.

    Writes radiance at the sensor and calibrated reflectance (GeoTIFF, ENVI, NetCDF), pictures and
    a record of the run; of a LiDAR the point cloud.

    Example:  fynjax simulate plot.toml --sensor aviris_ng --pixel 3 --output aviris
    """
    from fynjax import jobs

    return lambda folder: jobs.simulate(
        plot,
        folder,
        sensor=sensor,
        altitude=altitude,
        pixel=pixel,
        atmosphere=atmosphere,
        noise=noise,
        products=jobs.PRODUCTS if product == Product.both else (product.value,),
        seed=seed,
    )
