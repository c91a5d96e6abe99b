"""Commands about sensors: which there are, what they measure of a plot, and raw pictures."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fynjax.app.cli._runtime import Align, PlotPath, Truth, command, option


def sensors(
    json: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
) -> None:
    """List the shipped sensors: cameras, imaging spectrometers and LiDAR systems.

    Any of their names goes into a plot file (`[sensor]`) or to `fynjax simulate --sensor`.

    Example:  fynjax simulate plot.toml --sensor scanning_lidar
    """
    from rich.console import Console
    from rich.table import Table

    from fynjax.sensors import sensor_reference

    known = sensor_reference()
    if json:
        print(known.to_json(orient="records"))
        return
    table = Table(box=None)
    for heading in ("name", "kind", "bands", "nm", "pixel, m", "from, m"):
        table.add_column(heading, no_wrap=True)
    for row in known.to_dict("records"):
        ends = dict.fromkeys(f"{row[end]:.0f}" for end in ("lower_nm", "upper_nm"))
        height = "" if row["altitude_m"] != row["altitude_m"] else f"{row['altitude_m']:g}"
        cells = str(row["bands"]), " to ".join(ends), f"{row['pixel_m']:.2g}", height
        table.add_row(str(row["name"]), str(row["kind"]), *cells)
    Console().print(table)


def identify(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Files to look at.", show_default=False)
    ],
    json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Say what a file is taken for, and why: format, layout, unit, quantity, place, number.

    Spectra, images, cubes, point clouds, plot files and tables of plants, as every command reads
    them. Nothing is written. Exit status 1 if no reader takes one of the files.

    Example:  fynjax identify leaves.csv ortho.tif
    """
    from fynjax.app.jobs import identify as identified

    found = [identified(file) for file in files]
    if json:
        from json import dumps

        print(dumps([one.model_dump() for one in found], indent=2))
    for one in () if json else found:
        print(f"{one.file}: {one.kind}")
        for name, value in one.facts.items():
            print(f"  {name + ':':<13}{value}")
        for line in one.evidence:
            print(f"  {line}")
        for other in one.rejected:
            print(f"  not {other.kind}: {other.reason}")
    if any(one.kind == "unknown" for one in found):
        raise typer.Exit(1)


def doctor(
    json: Annotated[bool, typer.Option("--json", help="Print the checks as JSON.")] = False,
    clear: Annotated[
        bool,
        typer.Option(
            "--clear",
            help="Remove what runs have kept for later ones instead: compiled programs, fits of "
            "leaves, and that sums were right.",
        ),
    ] = False,
) -> None:
    """Check that this machine computes what fynjax relies on, and say the way out where not.

    Sums, products, an image and a gradient against other ways to them, 64 bits, memory, and the
    folder of compiled programs. Exit status 1 if anything is wrong.

    Example:  JAX_PLATFORMS=cpu fynjax doctor
    """
    from importlib.metadata import version

    if clear:
        _clear(json)
        return

    import jax

    from fynjax.app.jobs import doctor as checks_of_backend

    checks = checks_of_backend()
    if json:
        from json import dumps

        print(dumps([check._asdict() for check in checks]))
    else:
        print(f"fynjax {version('fynjax')}, JAX {version('jax')}, {jax.devices()[0].device_kind}")
        for check in checks:
            advice = "" if check.passed else f". {check.advice[0].upper()}{check.advice[1:]}."
            print(f"{'right' if check.passed else 'WRONG'}  {check.name}: {check.found}{advice}")
    if not all(check.passed for check in checks):
        raise typer.Exit(1)


def _clear(as_json: bool) -> None:
    """Remove what is kept, and say how much it was."""
    from fynjax._core import store

    files, size = store.clear()
    folder = store.cache_folder()
    if as_json:
        from json import dumps

        print(dumps({"folder": str(folder), "files": files, "bytes": size}))
    else:
        print(f"Removed {files} files, {size / 2**20:.1f} MiB, from {folder}")


def _products(product: str) -> list[str]:
    return ["reflectance", "radiance"] if product == "both" else [product]


@command("simulate", "fynjax.app.jobs:simulate", "seed")
def simulate(
    plot: PlotPath,
    sensor: Annotated[
        str | None,
        option(
            "NAME|FILE",
            "Shipped sensor (aviris_ng, emit, mavic_3m, flash_lidar_paper, ...) or a sensor "
            "file; the plot file's if left out.",
        ),
    ] = None,
    altitude: Annotated[float | None, option("M", "Height above the ground [m].")] = None,
    pixel: Annotated[
        float | None, option("M", "Side of a pixel; from the optics if left out.")
    ] = None,
    atmosphere: Annotated[
        str | None,
        option("NAME|FILE", "table (6S), clear-sky, none, or curves of your own (CSV, NetCDF)."),
    ] = None,
    noise: Annotated[
        bool | None,
        typer.Option("--noise/--no-noise", help="Draw noise; if the sensor has a model, yes."),
    ] = None,
    products: Annotated[
        Literal["both", "reflectance", "radiance"],
        typer.Option("--product", callback=_products, help="Images to write."),
    ] = "both",
    truth: Truth = False,
) -> None:
    """Simulate what any sensor measures over a plot.

    Writes radiance at the sensor and calibrated reflectance (GeoTIFF, ENVI, NetCDF), pictures and
    a record of the run; of a LiDAR the point cloud.

    Example:  fynjax simulate plot.toml --sensor aviris_ng --pixel 3 --output aviris
    """


@command("frames", "fynjax.app.jobs:frames")
def frames(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="FLIGHT",
            help="Poses of the frames: OpenDroneMap's shots.geojson, Pix4D's "
            "*_calibrated_external_camera_parameters.txt, Metashape's cameras.xml, or a folder of "
            "one of these or of pictures of a DJI or MicaSense camera.",
        ),
    ],
    plot: Annotated[Path, option("FILE", "Plot file of the plot that was flown over.")],
    crs: Annotated[
        str | None, option("EPSG:N", "Reference system of the plot, if its file names no map.")
    ] = None,
    origin: Annotated[
        tuple[float, float] | None,
        option("E N", "South-west corner of the plot in that system [m]."),
    ] = None,
    ground: Annotated[
        float | None,
        option(
            "M",
            "Height of its ground in the system of the frames' heights [m]; if left out, that of "
            "its terrain, or of pictures of a DJI their point of take-off.",
        ),
    ] = None,
    pixel: Annotated[float, option("M", "Side of a pixel on the ground [m].", min=0.005)] = 0.1,
) -> None:
    """Find which frames of a flight see a plot, and from which angles.

    Writes a table of the frames, the pixels of the plot in each with their view angles (NetCDF),
    a polar figure and a report page.

    Example:  fynjax frames odm_report/shots.geojson --plot plot.toml --ground 312.4
    """


@command("reflectance", "fynjax.app.jobs:reflectance")
def reflectance(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER_OR_FILES...",
            help="Raw pictures of a MicaSense camera (RedEdge, RedEdge-P, Altum), a Mavic 3 "
            "Multispectral or a Phantom 4 Multispectral: a folder of captures, or files of bands.",
        ),
    ],
    panels: Annotated[
        list[str] | None,
        option(
            "NAME",
            "Capture that shows a panel: its name, such as IMG_0000, or one of its files. "
            "Again for more panels, which make an empirical line.",
            "--panel",
        ),
    ] = None,
    reflectances: Annotated[
        list[str] | None,
        option(
            "R[,R...]",
            "Reflectance of the panel: a number, one for each band in order, or a CSV file "
            "(band,reflectance or wavelength_nm,reflectance).",
            "--panel-reflectance",
        ),
    ] = None,
    areas: Annotated[
        list[str] | None,
        option(
            '"X,Y X,Y ..."',
            "Corners of its area, columns and rows of pixels; found in the picture if left out.",
            "--panel-area",
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
        float | None,
        typer.Option(
            help="Relative standard deviation of light and camera; if left out, 0.18 by the light "
            "sensor alone, 0.10 by a panel, 0.04 by several panels."
        ),
    ] = None,
    height: Annotated[
        float | None,
        option(
            "M",
            "Height of flight above the ground [m]; that above the take-off, as a DJI states "
            "it, if left out.",
        ),
    ] = None,
    pixel: Annotated[float | None, option("M", "Or the side of a pixel on it [m].")] = None,
    align: Align = True,
) -> None:
    """Turn raw pictures of a multispectral drone camera into reflectance.

    Writes a GeoTIFF of each capture with all bands aligned, its uncertainty, pictures of captures
    and panels, and a record of the calibration.

    Example:  fynjax reflectance flight --panel IMG_0000 --panel-reflectance panel.csv --height 70
    """
