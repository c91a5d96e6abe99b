"""The job of `fynjax plant`: from a mesh, a scan or a taxon to area elements."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.io.raster import UNITS
from fynjax.app.io.text import Strict, did_you_mean, existing_file, read_rows, write_text
from fynjax.app.jobs._result import JobResult, Record
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Table
from fynjax.canopy import (
    FORMS,
    FORMS_SHOWN,
    GeneratedPlant,
    MeshPlant,
    Organ,
    PlantMaterial,
    PlantMesh,
    generate_plant,
    plant_from_branches,
    plant_model_from_mesh,
    plant_model_from_points,
    read_plant_mesh,
    read_scan,
    table1_2006,
)
from fynjax.canopy.mesh import default_up, find_up, organ_of_name

_MESHES = (".obj", ".ply", ".stl", ".glb", ".gltf")
_SCANS = (".xyz", ".csv", ".txt")
_ORGANS = tuple(organ.name.lower() for organ in Organ)
_MAXIMUM_EXTENT = 4.0
_LARGEST_LEAF_SCALE = 1.1
# Arguments that mean nothing for a source of another kind.
_ONLY_FOR = {
    "form": ("taxon",),
    "materials": ("mesh", "taxon"),
    "up": ("mesh", "scan"),
    "unit": ("mesh", "scan"),
    "maximum_extent": ("mesh", "scan"),
    "diameter": ("taxon",),
    "height": ("taxon",),
    "flowering": ("taxon",),
    "max_triangles": ("taxon",),
}


class MaterialRow(Strict):
    """A material of a mesh."""

    unique = "material"

    material: str = Field(description="name of the material in the mesh", min_length=1)
    organ: Literal["leaf", "wood", "flower"]
    optics: str = Field(
        "",
        description="name of its optics, a material of the plot's leaf table; left out, as all of "
        "its organ",
    )
    solid: bool | None = Field(None, description="yes, no or nothing")


class MaterialSummary(Record):
    """A material of the plant, and what it counts as."""

    name: str
    organ: str
    optics: str
    area_m2: float
    solid_share: float

    @property
    def surface(self) -> str:
        """Sheets, closed surfaces, or a share of both."""
        if self.solid_share == 0.0:
            return "sheets"
        closed = "closed surfaces (half of the area counts)"
        if self.solid_share > 0.9999:
            return closed
        return f"{100 * self.solid_share:.3g} % {closed}, else sheets"


class PlantResult(JobResult):
    """What `plant` made: size, areas and materials. `None` is what the source does not have."""

    command: Literal["plant"] = "plant"
    form: str | None
    n_leaves: int | None
    leaf_scale: float | None
    twig_radius_m: float | None
    up: str | None
    triangles: int | None
    area_m2: dict[str, float]
    """One-sided area of all elements of an organ [m2]."""
    diameter_m: float
    height_m: float
    materials: list[MaterialSummary]


_SHORT = {"m": "metre", "cm": "centimetre", "mm": "millimetre", "ft": "foot", "in": "inch"}
"""Other names of units."""


@double_precision
def plant(
    source: str,
    output: str | Path,
    *,
    n_elements: Annotated[int, Field(ge=1, le=5_000_000)] = 2000,
    materials: str | Path | None = None,
    up: Literal["y", "z"] | None = None,
    unit: str | None = None,
    maximum_extent: float | None = None,
    form: str | None = None,
    branches: Annotated[int, Field(ge=1)] = 1,
    rotation_spread: float | None = None,
    diameter: float | None = None,
    height: float | None = None,
    flowering: float | None = None,
    max_triangles: int | None = None,
    seed: Seed = 0,
) -> PlantResult:
    """Turn a plant mesh or a scan into area elements, or generate a taxon or growth form.

    Closed surfaces count half.

    **Arguments:**

    - `source`: mesh (OBJ, PLY, STL, GLB; metres), scan with normals (XYZ, CSV, TXT, PLY without
      faces), or a taxon of table 1 or growth form to generate.
    - `output`: folder of the results, made if missing.
    - `n_elements`: number of area elements.
    - `materials`: file (CSV) with columns material, organ and, if wanted, optics and solid.
    - `up`: vertical axis of the file: y for .glb and .gltf if left out, as their standard says; y,
      with a warning, if a plant reaches below 0 in z and not in y; else z. GLB that trimesh made of
      a mesh with z up needs z.
    - `unit`: unit of the mesh or scan: metre (if left out), cm, mm, foot, inch.
    - `maximum_extent`: a larger mesh or scan [m] is taken to be in other units; 4 if left out.
    - `form`: growth form of a taxon that is not in table 1, to generate it.
    - `branches`: number of copies that a plant is made of, where the source is one branch.
    - `rotation_spread`: spread of the branches' tilt [degrees]; grows with them if left out.
    - `diameter`: crown of a taxon [m]; that of table 1 if left out.
    - `height`: height of a taxon [m]; that of table 1 if left out.
    - `flowering`: part of full bloom of a taxon, 0 to 1; 0 if left out.
    - `max_triangles`: about the most triangles of a taxon; fewer make larger leaves; 200000 if left
      out.
    - `seed`: seed of everything random.

    **Returns:** `PlantResult`. Writes `elements.csv`, a picture and a page into `output`, and for a
    taxon or a mesh made of branches also `plant.obj` and `plant.mtl`.

    **Raises:** `InputError` for arguments that do not apply to the source, and as these functions.

    Example: `jobs.plant("shrub.obj", "results", n_elements=5000)`.
    """
    run = Run(output, seed=seed)
    if form is not None and form not in FORMS:
        raise InputError(
            f"`form` must be one of {', '.join(FORMS)}, but is {form!r}. {FORMS_SHOWN}"
        )
    kind = _kind(source) if form is None or Path(source).exists() else "taxon"
    sizes: dict[str, Any] = {
        "diameter": diameter,
        "height": height,
        "flowering": flowering,
        "max_triangles": max_triangles,
    }
    given: dict[str, object] = {"form": form, "materials": materials, "up": up, "unit": unit}
    given |= {"maximum_extent": maximum_extent, **sizes}
    for name, kinds in _ONLY_FOR.items():
        if given[name] is not None and kind not in kinds:
            raise InputError(
                f"`{name}` is for a {' or a '.join(kinds)}, but {source!r} is a {kind}: leave it "
                "out",
                file=None if kind == "taxon" else source,
            )
    if rotation_spread is not None and branches == 1:
        raise InputError("`rotation_spread` is the tilt of branches: give `branches` too")
    unit = "metre" if unit is None else _SHORT.get(unit, unit)
    if unit not in UNITS:
        raise InputError(f"`unit` must be one of {', '.join(UNITS)}, but is {unit!r}")
    metres = UNITS[unit]
    axis = up or default_up(source)
    limit = _MAXIMUM_EXTENT if maximum_extent is None else maximum_extent
    copies: dict[str, Any] = {"seed": seed, "rotation_spread": rotation_spread}
    made, mesh = None, None
    doing = "Grow the plant" if kind == "taxon" else "Read the plant"
    with run.stage(doing), _named(source, kind):
        if kind == "scan":
            points, normals, organ = read_scan(source)
            model = plant_model_from_points(
                metres * points, normals, n_elements, Organ.LEAF if organ is None else organ,
                up=axis, maximum_extent=limit, seed=seed,
            )  # fmt: skip
            if branches > 1:
                model = plant_from_branches(model, branches, **copies)
        else:
            if kind == "taxon":
                limit = np.inf  # `generate_plant` has limits of its own
                stated = {name: value for name, value in sizes.items() if value is not None}
                made = generate_plant(form or source, seed, **stated)
                mesh = made.mesh
            else:
                mesh = read_plant_mesh(source, up="z")
                axis = up or find_up(source, mesh)
                scaled = metres * mesh.vertices
                mesh = PlantMesh(scaled, mesh.faces, mesh.material, mesh.materials)
                mesh = read_plant_mesh(mesh, up=axis)
            known = None if materials is None else _read_materials(materials, mesh, made)
            if branches > 1:
                mesh = plant_from_branches(mesh, branches, **copies)
            model = plant_model_from_mesh(
                mesh, n_elements, known, seed, solid_materials="closed", maximum_extent=limit
            )
    begin_work({"elements.csv": f"{len(model.area)} area elements", "report.html": ""})
    with run.stage("Write"):
        if mesh is not None and (made is not None or branches > 1):  # not the source itself
            obj, mtl = mesh.obj("plant.mtl")
            write_text(run.path("plant.obj", "its mesh, in metres"), obj)
            write_text(run.path("plant.mtl", "its materials"), mtl)
        run.table("elements.csv", _elements(model), "the plant as area elements", "%.9g")
    return _result(run, source, model, made, mesh, axis, materials)


@contextmanager
def _named(source: str, kind: str) -> Iterator[None]:
    """Errors name the file of the source, and this job's argument instead of a function's."""
    try:
        yield
    except InputError as error:
        text = str(error).replace("`organ_of_material`", "`materials`")
        if error.file is None and kind != "taxon":
            raise InputError(text, file=source) from error
        error.args = (text,)
        raise


def _kind(source: str) -> str:
    """Whether the source is a mesh, a scan or a taxon (or growth form)."""
    taxa = [*table1_2006().taxon, *FORMS]
    if source in taxa:
        return "taxon"
    path = Path(source)
    suffix = path.suffix.lower()
    if suffix in _MESHES + _SCANS:
        existing_file(path, "a mesh or a scan")
        return "mesh" if suffix in _MESHES and (suffix != ".ply" or _has_faces(path)) else "scan"
    if path.exists() or re.fullmatch(r"\.[a-z]\w{1,5}", suffix) or "/" in source:
        raise InputError(
            f"expected a mesh ({', '.join(_MESHES)}) or a scan ({', '.join(_SCANS)}, .ply without "
            "faces): export it as one of these",
            file=source,
        )
    raise InputError(
        f"{source!r} is no file, no taxon of table 1 and no growth form."
        f"{did_you_mean(source, taxa)} Known are {', '.join(taxa)}. Another taxon needs its `form`."
    )


def _has_faces(path: Path) -> bool:
    """Whether a PLY file's header announces faces."""
    with path.open("rb") as file:
        head = file.read(16384).split(b"end_header")[0]
    words = [line.split() for line in head.splitlines()]
    return any(line[:2] == [b"element", b"face"] and line[2:] != [b"0"] for line in words)


def _read_materials(
    path: str | Path, mesh: PlantMesh, made: GeneratedPlant | None
) -> dict[str, PlantMaterial]:
    """Organ, optical class and solidity of each material, from a CSV."""
    known: dict[str, PlantMaterial] = {}
    # A taxon out of bloom has no flowers, but its table may.
    allowed = mesh.materials if made is None else _ORGANS
    for number, row in read_rows(path, MaterialRow, "a table of materials"):
        if row.material not in allowed:
            raise InputError(
                f"material {row.material!r} is not in the mesh, which has "
                f"{', '.join(map(repr, allowed))}.{did_you_mean(row.material, allowed)}",
                file=path,
                row=number,
                column="material",
            )
        known[row.material] = PlantMaterial(row.organ, row.optics, row.solid)
    return known


def _elements(model: MeshPlant) -> pd.DataFrame:
    """A row for each area element."""
    place, normal = np.asarray(model.position).T, np.asarray(model.plant.normal).T
    return pd.DataFrame(
        {
            **dict(zip(("x_m", "y_m", "z_m", "nx", "ny", "nz"), (*place, *normal), strict=True)),
            "area_m2": model.area,
            "organ": np.array(_ORGANS)[np.asarray(model.plant.organ)],
            "optics": np.array(model.optics)[np.asarray(model.material)],
            "crown_diameter_m": model.modelled_diameter,
            "plant_height_m": model.depth,
        }
    )


def _result(
    run: Run,
    source: str,
    model: MeshPlant,
    made: GeneratedPlant | None,
    mesh: PlantMesh | None,
    axis: str,
    stated: str | Path | None,
) -> PlantResult:
    areas = dict(zip(_ORGANS, model.organ_area.tolist(), strict=True))
    named = ", ".join(f"{name} {area:.4g} m2" for name, area in areas.items() if area > 0.0)
    headline = [
        f"{len(model.area)} elements of a plant {model.depth:.3g} m tall and "
        f"{model.modelled_diameter:.3g} m wide; one-sided area {named}"
    ]
    warnings = []
    if made is not None:
        leaves = f"{made.n_leaves} leaves, culms or threads of {made.leaf_scale:.3g} times the "
        leaves = f"{leaves}usual size; " if made.n_leaves else ""
        headline.append(f"{made.form.replace('_', ' ')}; {leaves}{len(made.mesh.faces)} triangles")
        headline.append(f"Where its values are from: {FORMS[made.form].sources}")
        if made.leaf_scale > _LARGEST_LEAF_SCALE:
            warnings.append(
                f"the leaves are {made.leaf_scale:.2f} times as large as usual, and fewer: "
                "allow more `max_triangles`"
            )
    else:
        headline.append(f"Vertical axis of the file: {axis}")
    materials = _materials(model)
    if mesh is not None:
        parts = [f"{m.name!r} is {m.organ}, {m.surface}" for m in materials]
        headline.append("Materials: " + "; ".join(parts))
        if stated is None and len(materials) == 1 and organ_of_name(materials[0].name) is None:
            warnings.append(
                f"the mesh has one material, {materials[0].name!r}, whose name says no organ: "
                "all of it counts as leaf"
            )
    what = "the elements from the side and from above"
    picture = Picture("plant.png", figures.plant_figure(model), what)
    rows = Table(pd.DataFrame([m.model_dump() for m in materials]), "Its materials.")
    inputs = [source if made is None else None, stated]
    run.pictures("plant", f"Plant: {Path(source).name}", headline, [picture, rows], inputs)
    return run.result(
        PlantResult,
        headline=headline,
        warnings=warnings,
        form=None if made is None else made.form,
        n_leaves=None if made is None else made.n_leaves,
        leaf_scale=None if made is None else made.leaf_scale,
        twig_radius_m=None if made is None else made.twig_radius,
        up=axis if made is None else None,
        triangles=None if mesh is None else len(mesh.faces),
        area_m2=areas,
        diameter_m=model.modelled_diameter,
        height_m=model.depth,
        materials=materials,
    )


def _materials(model: MeshPlant) -> list[MaterialSummary]:
    """The materials that have elements."""
    organ, material = np.asarray(model.plant.organ), np.asarray(model.material)
    area = np.asarray(model.area)
    return [
        MaterialSummary(
            name=name,
            organ=_ORGANS[organ[material == k][0]],
            optics=model.optics[k],
            area_m2=float(area[material == k].sum()),
            solid_share=model.solid_share[k],
        )
        for k, name in enumerate(model.materials)
        if (material == k).any()
    ]
