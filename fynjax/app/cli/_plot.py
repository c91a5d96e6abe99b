"""Commands about one plot: its files, its plants, its ground, its image, its page."""

import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fynjax._core.errors import InputError
from fynjax.app.cli._runtime import (
    Align,
    Json,
    PlotPath,
    Quiet,
    Seed,
    Truth,
    Twin,
    command,
    listed,
    option,
    show,
)

_PAGE = "report.html"


@command("demo", "fynjax.studies.fynbos_2006:demo", "seed")
def demo(
    drone_alone: Annotated[
        bool,
        typer.Option(
            "--drone-alone",
            help="Fit the drone's image alone, without the published numbers of the plot's "
            "AVIRIS-NG spectrum. Takes two thirds of the time; the camera's gains are known less "
            "well.",
        ),
    ] = False,
    twin: Twin = False,
) -> None:
    """Calibrate the 2006 burn plot to its real drone image and spectrum, from shipped input.

    Builds the 10 m x 10 m plot from the paper's species table, renders the drone image, calibrates
    cover, crown diameter, leaves and ground against the published statistics of the real image and
    of its AVIRIS-NG spectrum, and writes image, tables, figures and a report page.

    Example:  fynjax demo --output my_demo
    """


@command("article", "fynjax.studies.fynbos_2006:article", "seed", "checkpoint", forget=True)
def article(
    calibration: Annotated[
        Path | None,
        option(
            "DIR",
            "Results of `fynjax demo`, or of another calibration of the same plot; left out, "
            "the demo is run first.",
        ),
    ] = None,
    size: Annotated[float, option("M", "Edge of the plot that is looked at [m].", min=1.0)] = 10.0,
    pixel: Annotated[float, option("M", "Pixel of the drone's image [m].", min=0.005)] = 0.025,
    channels: Annotated[
        int, option("N", "About so many of AVIRIS-NG's 425 channels.", min=10)
    ] = 425,
) -> None:
    """Every number of the article beside those of its plot, before and after calibration.

    Looks at the 2006 plot with the drone's camera, AVIRIS-NG and two LiDAR systems, and puts what
    the article prints as real, what its DIRSIG made of it and fynjax's numbers side by side, each
    with its definition. An interrupted run goes on when the same command is given again.

    Example:  fynjax article --calibration output/demo
    """


def init(
    folder: Annotated[Path | None, typer.Argument(metavar="DIR", help="Folder to make.")] = None,
    output: Annotated[Path | None, option("DIR", "The same as the argument DIR.")] = None,
    table: Annotated[
        Path | None,
        option(
            "FILE",
            "Table of plants of your own (CSV or Excel), its columns in your own words: name, "
            "cover, and what is known of height, crown diameter, growth or life form, family.",
        ),
    ] = None,
    place: Annotated[
        Any,
        listed(
            float,
            "LAT,LON",
            "Latitude and longitude of the plot in degrees, south and west negative; left out, "
            "those of the image.",
            counts=(2,),
            form="latitude and longitude in degrees, such as 43.75,3.70",
        ),
    ] = None,
    image: Annotated[
        Path | None,
        option("FILE", "Image of the plot: its place, time, camera and pixel become the plot's."),
    ] = None,
    leaves: Annotated[
        Path | None,
        option("DIR", "Folder of leaf spectra, named after their taxon; it is copied."),
    ] = None,
    example: Annotated[
        Literal["heath", "fynbos"] | None,
        typer.Option(
            help="Without a table: a wet heath in Brittany, or the fynbos plot of the article with "
            "its leaves and what the drone measured.  [heath]"
        ),
    ] = None,
    burnt: Annotated[
        int | None,
        option(
            "YEAR",
            "Year of the fynbos plot's last fire. 2006 is the published plot; 2016, 2019 and "
            "others are built on assumptions about recovery, which their files state.  [2006]",
        ),
    ] = None,
    prior: Annotated[
        str | None,
        option(
            "FILE",
            "Population whose means and spreads the files state: a shipped one, a file that "
            "`fynjax bioscape learn` wrote, or none. Left out: of the fynbos plot the shipped "
            "one; of others only which plants are meant, by their place.",
        ),
    ] = None,
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented plot file, of your own table or of an example, that builds as it is.

    Never overwrites a file.

    Example:  fynjax init my_plot --table releve.xlsx --place 43.75,3.70 --image ortho.tif

    Example:  fynjax init my_plot && fynjax build my_plot/plot.toml
    """
    from fynjax.app.io.plot import DEFAULT_PRIOR, HEATH_PLACE, HEATH_TABLE
    from fynjax.app.jobs import init_from_table
    from fynjax.studies import fynbos_2006

    if folder is not None and output is not None and folder != output:
        raise InputError(f"expected one folder, but got {str(folder)!r} and {str(output)!r}")
    target = folder or output or Path("fynjax_plot")
    given = {"--place": place, "--image": image, "--leaves": leaves}
    with_table = [flag for flag, value in given.items() if value is not None]
    if table is None and with_table:
        raise InputError(
            f"expected `--table`, your table of plants, with `{with_table[0]}`, but got none"
        )
    of_example = {"--example": example, "--burnt": burnt}
    stated = [flag for flag, value in of_example.items() if value is not None]
    if table is not None and stated:
        raise InputError(f"expected `--table` or `{stated[0]}`, but got both: leave one out")
    if example == "heath" and burnt is not None:
        raise InputError("expected `--example fynbos` with `--burnt`, but got heath")
    if example == "fynbos" or burnt is not None:
        burnt = fynbos_2006.PUBLISHED if burnt is None else burnt
        result = fynbos_2006.init(target, burnt=burnt, prior=prior or DEFAULT_PRIOR, seed=seed)
    elif table is None:
        result = init_from_table(
            target, HEATH_TABLE, place=HEATH_PLACE, prior=prior, seed=seed, name="Wet heath, Glomel"
        )
    else:
        result = init_from_table(
            target, table, place=place, image=image, leaves=leaves, prior=prior, seed=seed
        )
    if json:
        print(result.model_dump_json(indent=2))
        return
    for line in result.warnings:
        if not any(line in said for said in result.headline):
            print(f"fynjax: warning: {line}", file=sys.stderr)
    if not quiet:
        show(result)
        print(f"Next: fynjax build {target / 'plot.toml'}")


@command("render", "fynjax.app.jobs:render", "seed", "checkpoint", forget=True)
def render(
    plot: PlotPath,
    truth: Truth = False,
) -> None:
    """Render what the drone sees of a plot.

    Writes the reflectance image (GeoTIFF), the run (NetCDF) and a report page. A large image is
    rendered in tiles; an interrupted run goes on with the same command.

    Example:  fynjax render plot.toml --output render
    """


@command("build", "fynjax.app.jobs:build", "seed")
def build(
    plot: PlotPath,
    size: Annotated[
        float | None, option("M", "Side of the plot [m]; the plot file's if left out.")
    ] = None,
    cell: Annotated[float, option("M", "Cells that cover is measured on [m].")] = 0.01,
    mesh: Annotated[
        bool, typer.Option("--mesh", help="Also write the scene as a mesh (OBJ, MTL).")
    ] = False,
    max_triangles: Annotated[
        int, typer.Option("--triangles", min=2000, help="Most triangles of that mesh.")
    ] = 5_000_000,
    view: Annotated[
        Literal["points", "meshes"],
        typer.Option(help="Oblique picture of points, or of meshes in sun and sky."),
    ] = "points",
) -> None:
    """Plant a plot: whole plants, as many as its covers ask for.

    Writes the plants and their cover (CSV), the voxels (NetCDF), pictures and a report page.

    Example:  fynjax build plot.toml --size 20 --output scene
    """


@command("plant", "fynjax.app.jobs:plant", "seed")
def plant(
    source: Annotated[
        str,
        typer.Argument(
            metavar="MESH|SCAN|TAXON",
            help="Mesh (OBJ, PLY, STL, GLB; metres), scan with normals (XYZ, CSV, TXT, PLY without "
            "faces), or a taxon of table 1 or growth form to generate.",
        ),
    ],
    n_elements: Annotated[
        int, typer.Option("--elements", min=1, max=5_000_000, help="Number of area elements.")
    ] = 2000,
    materials: Annotated[
        Path | None,
        typer.Option(help="CSV with columns material, organ and, if wanted, optics and solid."),
    ] = None,
    up: Annotated[
        str | None,
        option(
            "z|y",
            "Vertical axis of the file: y for .glb and .gltf if left out, as their standard "
            "says; y, with a warning, if a plant reaches below 0 in z and not in y; else z. GLB "
            "that trimesh made of a mesh with z up needs z.",
        ),
    ] = None,
    unit: Annotated[
        str | None,
        option("UNIT", "Unit of the mesh or scan: metre (if left out), cm, mm, foot, inch."),
    ] = None,
    maximum_extent: Annotated[
        float | None, option("M", "A larger mesh or scan [m] is taken to be in other units.  [4]")
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(help="Growth form of a taxon that is not in table 1, to generate it."),
    ] = None,
    branches: Annotated[
        int, typer.Option(min=1, help="The source is one branch: make a plant of so many copies.")
    ] = 1,
    rotation_spread: Annotated[
        float | None,
        typer.Option(help="Spread of the branches' tilt [degrees]; grows with them if left out."),
    ] = None,
    diameter: Annotated[float | None, option("M", "Crown of a taxon [m]; that of table 1.")] = None,
    height: Annotated[float | None, option("M", "Height of a taxon [m]; that of table 1.")] = None,
    flowering: Annotated[
        float | None, typer.Option(help="Part of full bloom of a taxon, 0 to 1.  [0]")
    ] = None,
    max_triangles: Annotated[
        int | None,
        typer.Option(
            help="About the most triangles of a taxon; fewer make larger leaves.  [200000]"
        ),
    ] = None,
) -> None:
    """Turn a plant mesh or a scan into area elements, or generate the mesh of a taxon or
    growth form.

    Writes elements.csv (position, normal, one-sided area, organ, optics of each element), a
    picture and, of what is generated or made of branches, plant.obj with plant.mtl. Closed
    surfaces count half.

    Example:  fynjax plant "Metalasia muricata" --elements 5000 --output metalasia
    """


_Unit = Literal["metre", "centimetre", "millimetre", "foot", "us_survey_foot"]


@command("terrain", "fynjax.app.jobs:terrain")
def terrain(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Point cloud (LAS, LAZ, PLY, XYZ, CSV) or height raster (GeoTIFF).",
        ),
    ],
    cell: Annotated[
        float | None, option("M", "Side of a cell [m]; 0.25 for a cloud, a raster's own.")
    ] = None,
    size: Annotated[
        float | None, option("M", "Side of a square plot in the middle of the file [m].")
    ] = None,
    bounds: Annotated[
        tuple[float, float, float, float] | None,
        option("W S E N", "Edges of the plot, in the file's coordinates [m]."),
    ] = None,
    method: Annotated[
        Literal["smrf", "cloth", "labels"] | None,
        typer.Option(
            help="Ground by the file's labels (the usual, where it has them) or by a filter."
        ),
    ] = None,
    tolerance: Annotated[
        float | None, option("M", "Largest distance of ground from the lowest points [m]; 0.3.")
    ] = None,
    slope: Annotated[
        float | None,
        typer.Option(help="SMRF slope threshold [m/m]; 0.15."),
    ] = None,
    window: Annotated[
        float | None,
        option("M", "Radius of the widest closed stand [m] (smrf); 5, or half of a smaller cloud."),
    ] = None,
    largest_gap: Annotated[
        float | None,
        option("M", "Largest distance of a cell from the nearest ground point [m]; 10."),
    ] = None,
    unit: Annotated[
        _Unit | None, typer.Option(help="Unit of a cloud's coordinates, if not metres.")
    ] = None,
    height_unit: Annotated[_Unit | None, typer.Option(help="Unit of heights, if another.")] = None,
    crs: Annotated[
        str | None, option("EPSG:N", "Reference system of a file that states none.")
    ] = None,
    fill_gaps: Annotated[
        bool, typer.Option("--fill-gaps", help="Interpolate cells of a raster without height.")
    ] = False,
    band: Annotated[
        int | None, option("N", "Band of a raster that has the heights, from 1.")
    ] = None,
) -> None:
    """Make the ground of a plot from a point cloud or a height raster.

    Writes the ground as GeoTIFF and OBJ, a picture and, from a cloud, the height of the canopy.

    Example:  fynjax terrain plot.laz --size 66 --output terrain
    """


@command("pattern", "fynjax.app.jobs:pattern", "seed")
def pattern(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="Image of several bands (GeoTIFF), or the single-band files of one capture in "
            "order.",
        ),
    ],
    clusters: Annotated[int, typer.Option(min=2, max=255, help="Number of clusters.")] = 3,
    bands: Annotated[
        str | None,
        listed(
            str,
            "A,B,...",
            "Names of the bands or their wavelengths [nm], in order, where files lack them.",
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
        listed(
            int,
            "N,N,...",
            "Grey of each cluster, least green first; evenly up to 255 if left out. 0 keeps "
            "a cluster free of plants.",
            form="whole numbers from 0 to 255 with commas, such as 0,128,255",
        ),
    ] = None,
    pixel: Annotated[
        float | None, option("M", "Side of a pixel [m], for an image without a place.")
    ] = None,
    align: Align = True,
) -> None:
    """Make a probability map from an image: where plants are likely to stand.

    Writes map.tif for `probability_map` of a plot file, and a picture. Pixels are clustered by
    K-means and the clusters ordered by greenness.

    Example:  fynjax pattern orthophoto.tif --levels 0,128,255 --output pattern
    """


def view(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder of a finished run, or its page.")
    ],
    print_path: Annotated[
        bool, typer.Option("--print", help="Print the path of the page and open nothing.")
    ] = False,
) -> None:
    """Open the report page of a run in the browser.

    Where there is no browser its path is printed.

    Example:  fynjax view output/demo
    """
    from fynjax.app.io.text import existing_file

    if run.is_dir() and not (run / _PAGE).is_file():
        written = sorted(p.name for p in run.iterdir() if p.is_file())
        raise InputError(
            f"expected the folder of a run with {_PAGE}, but this has "
            + (f"{', '.join(written[:8])}" if written else "no files"),
            file=run,
        )
    page = existing_file(run / _PAGE if run.is_dir() else run, "a report page").resolve()
    if print_path or not webbrowser.open(page.as_uri()):
        print(page)
