"""`fynjax plant`."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fynjax._core.errors import InputError
from fynjax.cli._runtime import Job, Seed, command

if TYPE_CHECKING:
    from fynjax.jobs import PlantResult

Source = Annotated[
    str,
    typer.Argument(
        metavar="MESH|SCAN|TAXON",
        help="Mesh (OBJ, PLY, STL, GLB; metres), scan with normals (XYZ, CSV, TXT, PLY without "
        "faces), or a taxon of table 1 or growth form to generate.",
    ),
]
# Options whose names are not those of the arguments behind them.
_OPTIONS = {
    "n_elements": "--elements",
    "organ_of_material": "--materials",
    "leaf_area_index": "leaf area index",
    "wood_area_index": "wood area index",
}
_SAME = (
    *("materials", "up", "maximum_extent", "branches", "rotation_spread"),
    *("diameter", "height", "flowering", "max_triangles"),
)


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    is_file = Path(given["source"]).is_file()
    return {"elements": given["elements"], "files": [given["source"]] if is_file else []}


@command("plant", work=_work)
def plant(
    source: Source,
    elements: Annotated[
        int, typer.Option(min=1, max=5_000_000, help="Number of area elements.")
    ] = 2000,
    materials: Annotated[
        Path | None,
        typer.Option(help="CSV with columns material, organ and, if wanted, optics and solid."),
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(
            metavar="z|y",
            help="Vertical axis of the file: y for .glb and .gltf if left out, as their standard "
            "says, else z. GLB that trimesh made of a mesh with z up needs z.",
        ),
    ] = None,
    maximum_extent: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="A larger mesh or scan [m] is taken to be in other units.  [4]"
        ),
    ] = None,
    branches: Annotated[
        int, typer.Option(min=1, help="The source is one branch: make a plant of so many copies.")
    ] = 1,
    rotation_spread: Annotated[
        float | None,
        typer.Option(help="Spread of the branches' tilt [degrees]; grows with them if left out."),
    ] = None,
    diameter: Annotated[
        float | None, typer.Option(metavar="M", help="Crown of a taxon [m]; that of table 1.")
    ] = None,
    height: Annotated[
        float | None, typer.Option(metavar="M", help="Height of a taxon [m]; that of table 1.")
    ] = None,
    flowering: Annotated[
        float | None, typer.Option(help="Part of full bloom of a taxon, 0 to 1.  [0]")
    ] = None,
    max_triangles: Annotated[
        int | None,
        typer.Option(
            help="About the most triangles of a taxon; fewer make larger leaves.  [200000]"
        ),
    ] = None,
    seed: Seed = 0,
) -> Job:
    """Turn a plant mesh or a scan into area elements, or generate the mesh of a taxon or
    growth form.

    Writes elements.csv (position, normal, one-sided area, organ, optics of each element), a
    picture and, of what is generated or made of branches, plant.obj with plant.mtl. Closed
    surfaces count half.

    Example:  fynjax plant "Metalasia muricata" --elements 5000 --output metalasia
    """
    from fynjax import jobs

    options: dict[str, Any] = {
        "n_elements": elements,
        "materials": materials,
        "up": up,
        "maximum_extent": maximum_extent,
        "branches": branches,
        "rotation_spread": rotation_spread,
        "diameter": diameter,
        "height": height,
        "flowering": flowering,
        "max_triangles": max_triangles,
    }

    def job(folder: Path) -> "PlantResult":
        with _naming_options(source):
            result = jobs.plant(source, folder, seed=seed, **options)
        warnings = [_as_options(text) for text in result.warnings]
        return result.model_copy(update={"warnings": warnings})

    return job


def _as_options(text: str) -> str:
    """A message that names the command's options, not the arguments of functions."""
    for name, option in _OPTIONS.items():
        text = text.replace(f"`{name}`", f"`{option}`" if option[0] == "-" else option)
    return re.sub(rf"`({'|'.join(_SAME)})`", lambda m: f"`--{m[1].replace('_', '-')}`", text)


@contextmanager
def _naming_options(source: str) -> Iterator[None]:
    """Errors name the options, and the source where they name no file."""
    try:
        yield
    except InputError as error:
        text = _as_options(str(error))
        if error.file is None and Path(source).is_file():
            raise InputError(text, file=source) from error
        error.args = (text,)
        raise
