"""Plant models from triangle meshes.

One-sided area. A leaf blade, flat and without thickness, counts once: the area of its triangles.
A closed surface, such as a stem built as a tube, counts half of its area, because light that
enters it also leaves it: half of it intercepts, whatever its shape (for a convex body that is
Cauchy's mean silhouette times two; Chen and Black 1992). Both are the areas of `FORM_DEFAULTS`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._forms import quasi_random, split_elements
from fynjax.canopy._mesh_facets import (
    check_vertex_normals,
    draw_evenly,
    facets,
    is_closed,
    volume,
)
from fynjax.canopy._mesh_plant import (
    MeshPlant,
    PlantMaterial,
    PlantMesh,
    check_extent,
    mesh_plant,
    organ_named,
    organ_of_name,
)
from fynjax.canopy._plant import Organ


def read_plant_mesh(mesh: Any, *, up: Literal["y", "z"] = "z") -> PlantMesh:
    """The triangles and material names of a mesh, upright and in one frame.

    `mesh`: a file trimesh reads (OBJ with MTL, PLY, STL, GLB), a `trimesh.Trimesh`, a
    `trimesh.Scene` or a `PlantMesh`; in metres. `up`: its vertical axis. A geometry without a
    material goes by its own name, a single mesh by "". Raises `InputError` for a mesh that cannot
    be read, has no faces, or whose stored vertex normals are zero or point against its faces.
    """
    if up not in ("y", "z"):
        raise InputError(f"`up` must be 'y' or 'z', but is {up!r}")
    if not isinstance(mesh, PlantMesh):
        mesh = _from_trimesh(mesh)
    if up == "z":
        return mesh
    # A quarter turn about x: (x, y, z) -> (x, -z, y).
    vertices = np.stack([mesh.vertices[:, 0], -mesh.vertices[:, 2], mesh.vertices[:, 1]], axis=-1)
    return PlantMesh(vertices, mesh.faces, mesh.material, mesh.materials)


def plant_model_from_mesh(
    mesh: Any,
    n_elements: int | None,
    organ_of_material: Mapping[str, Organ | str | PlantMaterial] | None = None,
    seed: int = 0,
    *,
    up: Literal["y", "z"] = "z",
    solid_materials: tuple[str, ...] | Literal["closed"] = (),
    maximum_extent: float = 10.0,
) -> MeshPlant:
    """Sample a triangle mesh into area elements, in proportion to the area of its facets.

    The elements of a material share its area equally, so that the one-sided area of the mesh is
    kept exactly, with any number of elements.

    **Arguments:**

    - `mesh`: as in `read_plant_mesh`; in metres.
    - `n_elements`: number of elements, shared among the materials by area, at least one each.
      None makes every facet an element: its centre, its area, its normal.
    - `organ_of_material`: organ ("leaf", "wood", "flower" or `Organ`) or `PlantMaterial` of each
      material name. Without it a material whose name begins with an organ's ("wood", "leaf.001")
      is that organ; where none does, everything is leaf.
    - `seed`: fixes the draw.
    - `up`: the vertical axis of the mesh; "y" turns it upright first.
    - `solid_materials`: materials modelled as closed surfaces (a stem as a tube), of which half
      the area counts (see the note on one-sided area of this module). "closed" takes every
      material none of whose edges is open.
    - `maximum_extent`: a mesh larger than this [m] is taken to be in other units.

    x and y are centred on the bounding box and divided by the modelled diameter (eq. 7), z by
    the depth. Raises `InputError` for a mesh without faces or with no area, flat, not finite, in
    other units, with zero or inverted normals, or with a material that has no organ.
    """
    file = str(mesh) if isinstance(mesh, str | Path) else None
    read = read_plant_mesh(mesh, up=up)
    triangles, material = read.triangles, read.material
    low, high = check_extent(triangles.reshape(-1, 3), maximum_extent, file)
    normal, area = facets(triangles)
    if not area.sum() > 0.0:
        raise InputError("a plant mesh must have area, but all its faces are degenerate", file=file)
    used = _materials(read, organ_of_material, file)
    for index, one in enumerate(used):
        if _is_solid(read, index, one, solid_materials, file):
            area = np.where(material == index, 0.5 * area, area)

    share = np.bincount(material, weights=area, minlength=len(used))
    if n_elements is None:
        chosen = np.flatnonzero(area > 0.0)
        point, portion = triangles[chosen].mean(axis=1), area[chosen]
    else:
        chosen, point = _sample(triangles, normal, material, area, share, n_elements, seed)
        per_material = np.bincount(material[chosen], minlength=len(used))
        portion = (share / np.maximum(per_material, 1))[material[chosen]]
    return mesh_plant(
        point,
        normal[chosen],
        portion,
        material[chosen],
        tuple(read.materials),
        used,
        low,
        high,
    )


def _sample(
    triangles: np.ndarray,
    normal: np.ndarray,
    material: np.ndarray,
    area: np.ndarray,
    share: np.ndarray,
    n_elements: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Facets drawn in proportion to area, and a point on each."""
    present = {int(index): float(share[index]) for index in np.flatnonzero(share > 0.0)}
    if n_elements < len(present):
        raise InputError(
            f"`n_elements` must be at least {len(present)}, one a material, but is {n_elements}"
        )
    chosen, weights = [], []
    counts = split_elements(n_elements, present)  # type: ignore[arg-type]  # any key will do
    for index, count in counts.items():
        uniform = quasi_random(count, 2, [seed, index])
        mine = np.flatnonzero(material == index)
        centre = triangles[mine].mean(axis=1)
        chosen.append(mine[draw_evenly(area[mine], normal[mine], centre, count, [seed, index])])
        root = np.sqrt(uniform[:, :1])  # uniform in a triangle
        second = uniform[:, 1:]
        weights.append(np.concatenate([1 - root, root * (1 - second), root * second], axis=1))
    facet = np.concatenate(chosen)
    return facet, np.einsum("nc,ncd->nd", np.concatenate(weights), triangles[facet])


def _from_trimesh(mesh: Any) -> PlantMesh:
    import trimesh

    file = str(mesh) if isinstance(mesh, str | Path) else None
    if file is not None:
        try:
            mesh = trimesh.load(file, process=False)
        except Exception as error:  # trimesh's readers raise whatever they stumble over
            raise InputError(f"the mesh cannot be read: {error}", file=file) from error
    pieces: list[tuple[str, Any, np.ndarray]] = []
    if isinstance(mesh, trimesh.Trimesh):
        pieces = [("", mesh, np.eye(4))]
    elif isinstance(mesh, trimesh.Scene):
        for node in mesh.graph.nodes_geometry:
            frame, name = mesh.graph[node]
            pieces.append((str(name), mesh.geometry[name], np.asarray(frame, float)))
    vertices, faces, material, names, first = [], [], [], list[str](), 0
    for own_name, geometry, frame in pieces:
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        name = str(getattr(getattr(geometry.visual, "material", None), "name", None) or own_name)
        corners = np.asarray(geometry.faces)
        check_vertex_normals(geometry, name, file)
        if name not in names:
            names.append(name)
        vertices.append(np.asarray(geometry.vertices, float) @ frame[:3, :3].T + frame[:3, 3])
        # A frame that mirrors turns the triangles over.
        faces.append(first + (corners if np.linalg.det(frame[:3, :3]) > 0 else corners[:, ::-1]))
        material.append(np.full(len(corners), names.index(name)))
        first += len(geometry.vertices)
    if not faces:
        raise InputError(
            "a plant mesh must have faces, but has none; is it a point cloud? A cloud with "
            "normals goes through `plant_model_from_points`",
            file=file,
        )
    return PlantMesh(
        np.concatenate(vertices), np.concatenate(faces), np.concatenate(material), tuple(names)
    )


def _is_solid(
    mesh: PlantMesh,
    index: int,
    one: PlantMaterial,
    solid_materials: tuple[str, ...] | Literal["closed"],
    file: str | None,
) -> bool:
    name = mesh.materials[index]
    if one.solid is not None:
        solid = one.solid
    elif solid_materials == "closed":
        solid = mesh.is_closed(name)
    else:
        solid = name in solid_materials
    triangles = mesh.triangles[mesh.material == index]
    if solid and len(triangles) and is_closed(triangles) and volume(triangles) < 0.0:
        raise InputError(
            f"the closed surfaces of material {name!r} must have their normals outwards, but they "
            "are inverted: flip the faces",
            file=file,
        )
    return solid


def _materials(
    mesh: PlantMesh,
    organ_of_material: Mapping[str, Organ | str | PlantMaterial] | None,
    file: str | None,
) -> list[PlantMaterial]:
    """What each material of the mesh stands for."""
    if organ_of_material is None:
        by_name = {name: organ_of_name(name) for name in mesh.materials}
        if not any(organ is not None for organ in by_name.values()):
            return [PlantMaterial(Organ.LEAF) for _ in mesh.materials]
        organ_of_material = {k: organ for k, organ in by_name.items() if organ is not None}
    used = []
    for name in mesh.materials:
        if name not in organ_of_material:
            known = ", ".join(repr(key) for key in organ_of_material)
            raise InputError(
                f"material {name!r} must have an organ in `organ_of_material`, which has {known}; "
                "if that is no material of the plant, is the material file (MTL) missing beside "
                "the mesh?",
                file=file,
            )
        given = organ_of_material[name]
        one = given if isinstance(given, PlantMaterial) else PlantMaterial(given)
        used.append(PlantMaterial(organ_named(one.organ, name), one.optics, one.solid))
    return used
