"""`fynjax plant`."""

import csv
from pathlib import Path
from typing import Annotated, Any

import typer

from fynjax._core.errors import InputError
from fynjax._core.progress import Progress
from fynjax.cli._runtime import Json, Output, Quiet, Seed, run_job

Source = Annotated[
    str,
    typer.Argument(
        metavar="MESH|TAXON",
        help="Mesh (OBJ, PLY, STL, GLB; metres), scan with normals (XYZ, CSV, PLY without faces), "
        "or a taxon of table 1 to generate.",
    ),
]
_MESHES = (".obj", ".ply", ".stl", ".glb", ".gltf")
_SCANS = (".xyz", ".csv", ".txt")


def plant(
    source: Source,
    elements: Annotated[int, typer.Option(min=1, help="Number of area elements.")] = 2000,
    materials: Annotated[
        Path | None,
        typer.Option(help="CSV with columns material, organ and, if wanted, optics and solid."),
    ] = None,
    up: Annotated[str, typer.Option(help="Vertical axis of the mesh: z or y.")] = "z",
    branches: Annotated[
        int, typer.Option(min=1, help="The mesh is one branch: make a plant of so many copies.")
    ] = 1,
    rotation_spread: Annotated[
        float | None,
        typer.Option(help="Spread of the branches' tilt [degrees]; grows with them if left out."),
    ] = None,
    output: Output = Path("output/plant"),
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Turn a plant mesh into area elements, or generate the mesh of a taxon.

    Writes elements.csv (position, normal, one-sided area, organ, optics of each element) and, for
    a taxon or a plant made of branches, plant.obj with plant.mtl. Closed surfaces count half.

    Example:  fynjax plant "Erica irregularis" --elements 5000 --output erica
    """
    if up not in ("y", "z"):
        raise InputError(f"`--up` must be y or z, but is {up!r}")
    known = None if materials is None else _read_materials(materials)
    options: dict[str, Any] = {
        "n_elements": elements,
        "materials": known,
        "up": up,
        "branches": branches,
        "rotation_spread": rotation_spread,
        "seed": seed,
    }
    run_job(
        "plant",
        lambda folder, progress: _run(source, folder, progress, **options),
        output,
        seed=seed,
        as_json=json,
        quiet=quiet,
    )


def _run(
    source: str,
    folder: Path,
    progress: Progress,
    *,
    n_elements: int,
    materials: dict[str, Any] | None,
    up: Any,
    branches: int,
    rotation_spread: float | None,
    seed: int,
) -> dict[str, Any]:
    from fynjax.canopy import (
        generate_plant,
        plant_from_branches,
        plant_model_from_mesh,
        plant_model_from_points,
        read_plant_mesh,
        read_scan,
    )

    suffix = Path(source).suffix.lower()
    headline, files = [], {"elements.csv": "the plant as area elements"}
    if suffix in _MESHES + _SCANS and not Path(source).is_file():
        raise InputError("expected a mesh or a scan, but there is no such file", file=source)
    if suffix in _SCANS or (suffix == ".ply" and not _has_faces(Path(source))):
        points, normals, organ = read_scan(source)
        given: dict[str, Any] = {} if organ is None else {"organ": organ}
        model = plant_model_from_points(points, normals, n_elements, up=up, seed=seed, **given)
    else:
        if suffix in _MESHES:
            mesh = read_plant_mesh(source, up=up)
            write = branches > 1
        else:
            mesh = generate_plant(source, seed).mesh
            write = True
        if branches > 1:
            mesh = plant_from_branches(mesh, branches, seed=seed, rotation_spread=rotation_spread)
        if write:
            obj, mtl = mesh.obj("plant.mtl")
            (folder / "plant.obj").write_text(obj, encoding="utf-8")
            (folder / "plant.mtl").write_text(mtl, encoding="utf-8")
            files |= {"plant.obj": "its mesh, in metres", "plant.mtl": "its materials"}
            headline.append(f"{len(mesh.faces)} triangles")
        model = plant_model_from_mesh(mesh, n_elements, materials, seed, solid_materials="closed")

    with (folder / "elements.csv").open("w", newline="", encoding="utf-8") as table:
        writer = csv.writer(table)
        writer.writerow(["x_m", "y_m", "z_m", "nx", "ny", "nz", "area_m2", "organ", "optics"])
        names = ("leaf", "wood", "flower")
        for place, normal, area, organ_index, material in zip(
            model.position.tolist(),
            model.plant.normal.tolist(),
            model.area.tolist(),
            model.plant.organ.tolist(),
            model.material.tolist(),
            strict=True,
        ):
            numbers = [f"{value:.9g}" for value in (*place, *normal, area)]
            writer.writerow([*numbers, names[organ_index], model.optics[material]])
    areas = dict(zip(("leaf", "wood", "flower"), model.organ_area.tolist(), strict=True))
    size = {"diameter_m": model.modelled_diameter, "height_m": model.depth}
    headline.insert(
        0,
        f"{len(model.area)} elements of a plant {model.depth:.3g} m tall and "
        f"{model.modelled_diameter:.3g} m wide; one-sided area "
        + ", ".join(f"{name} {area:.4g} m2" for name, area in areas.items() if area > 0.0),
    )
    return {"headline": headline, "files": files, "area_m2": areas, **size}


def _has_faces(path: Path) -> bool:
    """Whether a PLY file's header announces faces."""
    with path.open("rb") as file:
        head = file.read(16384).split(b"end_header")[0]
    words = [line.split() for line in head.splitlines()]
    return any(line[:2] == [b"element", b"face"] and line[2:] != [b"0"] for line in words)


def _read_materials(path: Path) -> dict[str, Any]:
    """Organ, optical class and solidity of each material, from a CSV."""
    from fynjax.canopy import PlantMaterial
    from fynjax.io._tables import existing_file

    existing_file(path, "a table of materials")
    with path.open(newline="", encoding="utf-8") as table:
        reader = csv.DictReader(table)
        absent = {"material", "organ"} - set(reader.fieldnames or [])
        if absent:
            raise InputError(
                f"expected the columns material and organ, but there is no {sorted(absent)[0]}",
                file=path,
                row=1,
            )
        found: dict[str, Any] = {}
        for number, row in enumerate(reader, start=2):
            solid = (row.get("solid") or "").strip().lower()
            if solid not in ("", "yes", "no", "true", "false"):
                raise InputError(
                    f"expected yes, no or nothing, but found {solid!r}",
                    file=path,
                    row=number,
                    column="solid",
                )
            organ = (row["organ"] or "").strip().lower()
            if organ not in ("leaf", "wood", "flower"):
                raise InputError(
                    f"expected leaf, wood or flower, but found {organ!r}",
                    file=path,
                    row=number,
                    column="organ",
                )
            found[(row["material"] or "").strip()] = PlantMaterial(
                organ,
                (row.get("optics") or "").strip(),
                None if not solid else solid in ("yes", "true"),
            )
    return found
