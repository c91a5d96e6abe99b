"""Plant models from triangle meshes.

One-sided area. A leaf blade, flat and without thickness, counts once: the area of its triangles.
A closed surface, such as a stem built as a tube, counts half of its area, because light that
enters it also leaves it: half of it intercepts, whatever its shape (for a convex body that is
Cauchy's mean silhouette times two; Chen and Black 1992). Both are the areas of a `GrowthForm`.
"""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._elements import quasi_random
from fynjax.canopy._plant import Organ, organ_named, organ_of_name
from fynjax.canopy.mesh._facets import closed_faces, draw_groups, facets
from fynjax.canopy.mesh._plant_mesh import (
    MeshPlant,
    PlantMaterial,
    PlantMesh,
    check_extent,
    mesh_plant,
)
from fynjax.canopy.mesh._read import find_up, plant_mesh_of


def read_plant_mesh(mesh: Any, *, up: Literal["y", "z"] | None = None) -> PlantMesh:
    """The triangles and material names of a mesh, upright and in one frame.

    **Arguments:**

    - `mesh`: a file trimesh reads (OBJ with MTL, PLY, STL, GLB), a `trimesh.Trimesh`, a
      `trimesh.Scene` or a `PlantMesh`; in metres.
    - `up`: its vertical axis; if left out y in a GLB or glTF file, as that standard defines
      (trimesh exports a mesh to GLB as it is, z upwards if it was so); of another file y, with a
      warning, if the plant reaches below 0 in z and not in y; else z, with a warning if the plant
      seems to stand on another plane than z = 0, or on several.

    **Returns:** a `PlantMesh`, z upwards. A geometry without a material has its own name as
    material, a single mesh "". An OBJ's names are read without its MTL.

    **Raises:** `InputError` for a mesh that cannot be read, or has no faces.
    """
    if up not in ("y", "z", None):
        raise InputError(f"`up` must be 'y' or 'z', but is {up!r}")
    read = mesh if isinstance(mesh, PlantMesh) else plant_mesh_of(mesh)
    up = find_up(mesh, read) if up is None else up
    mesh = read
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
    up: Literal["y", "z"] | None = None,
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
      material name. Without it the organ is read from the words of the name ("Bark", "leaves.001",
      "petal"); a mesh of a single material without such a word is all leaf.
    - `seed`: fixes the draw.
    - `up`: the vertical axis of the mesh, as in `read_plant_mesh`.
    - `solid_materials`: materials modelled as closed surfaces (a stem as a tube), of which half
      the area counts (see the note on one-sided area of this module). "closed" takes every
      surface (triangles of a material that share edges) none of whose edges is open, tubes whose
      ends are open too, and warns where wood has others.
    - `maximum_extent`: a mesh larger than this [m] is taken to be in other units.

    **Returns:** a `MeshPlant`. x and y are centred on the bounding box and divided by the modelled
    diameter (eq. 7), z by the depth. Not differentiable.

    **Raises:** `InputError` for a mesh without faces or with no area, flat, not finite, in other
    units (or smaller than 5 mm), or with a material that has no organ, or several of which none is
    recognised.

    >>> import trimesh
    >>> from fynjax.canopy import plant_model_from_mesh
    >>> box = trimesh.creation.box((0.4, 0.4, 0.6))  # closed, 1.28 m2 of surface
    >>> plant = plant_model_from_mesh(box, 200, {"": "wood"}, solid_materials="closed")
    >>> plant.organ_area.round(3)  # one-sided, of leaf, wood and flower [m2]
    Array([0.  , 0.64, 0.  ], dtype=float32)
    >>> plant.modelled_diameter, plant.depth
    (0.4, 0.6)
    """
    file = str(mesh) if isinstance(mesh, str | Path) else None
    read = read_plant_mesh(mesh, up=up)
    triangles, material = read.triangles, read.material
    box = check_extent(triangles.reshape(-1, 3), maximum_extent, file)
    normal, area = facets(triangles)
    if not area.sum() > 0.0:
        raise InputError("a plant mesh must have area, but all its faces are degenerate", file=file)
    used = _materials(read, organ_of_material, file)
    solid = _solid_faces(read, used, solid_materials)
    whole = np.bincount(material, weights=area, minlength=len(used))
    of_solid = np.bincount(material, weights=area * solid, minlength=len(used))
    solid_share = of_solid / np.where(whole > 0.0, whole, 1.0)
    area = np.where(solid, 0.5 * area, area)
    share = np.bincount(material, weights=area, minlength=len(used))
    if n_elements is None:
        chosen = np.flatnonzero(area > 0.0)
        point, portion = triangles[chosen].mean(axis=1), area[chosen]
    else:
        drawn = draw_groups(material, area, normal, triangles.mean(axis=1), n_elements, seed)
        chosen = np.concatenate(drawn)
        uniform = np.concatenate(
            [quasi_random(len(part), 2, [seed, int(material[part[0]])]) for part in drawn]
        )
        # Barycentric coordinates that are uniform in a triangle: the root makes room at its base.
        root, second = np.sqrt(uniform[:, :1]), uniform[:, 1:]
        corners = np.concatenate([1 - root, root * (1 - second), root * second], axis=1)
        point = np.einsum("nc,ncd->nd", corners, triangles[chosen])
        per_material = np.bincount(material[chosen], minlength=len(used))
        portion = (share / np.maximum(per_material, 1))[material[chosen]]
    return mesh_plant(
        point, normal[chosen], portion, material[chosen], used, box, tuple(solid_share.tolist())
    )


def _solid_faces(
    mesh: PlantMesh,
    used: dict[str, PlantMaterial],
    solid_materials: tuple[str, ...] | Literal["closed"],
) -> np.ndarray:
    """Which triangles bound bodies [face]. Warns where wood is taken for a sheet."""
    solid = np.zeros(len(mesh.faces), bool)
    open_wood = []
    for index, (name, material) in enumerate(used.items()):
        faces = np.flatnonzero(mesh.material == index)
        given = material.solid
        if given is None and solid_materials != "closed":
            given = name in solid_materials
        if given is False or not len(faces):
            continue
        # A stem may taper to a point; of leaves and petals one ring is the rim of a cup.
        least = 1 if material.organ == Organ.WOOD else 2
        closed = closed_faces(mesh.triangles[faces], least_ends=least)
        solid[faces] = closed if given is None else True
        if given is None and material.organ == Organ.WOOD and not closed.all():
            open_wood.append(f"{np.mean(~closed):.0%} of the triangles of {name!r}")
    if open_wood:
        warnings.warn(
            f"{' and '.join(open_wood)} are wood with open edges and count as sheets, with all of "
            "their area instead of half: close the surfaces, or declare the material solid",
            stacklevel=3,
        )
    return solid


def _materials(
    mesh: PlantMesh,
    organ_of_material: Mapping[str, Organ | str | PlantMaterial] | None,
    file: str | None,
) -> dict[str, PlantMaterial]:
    """Organ that each material of the mesh stands for, by its name."""
    if organ_of_material is None:
        by_name = {name: organ_of_name(name) for name in mesh.materials}
        if not any(organ is not None for organ in by_name.values()):
            if len(mesh.materials) > 1:
                raise InputError(
                    f"the materials {', '.join(map(repr, mesh.materials))} name no known organ: "
                    "state which are leaf, wood or flower in `organ_of_material`",
                    file=file,
                )
            return {name: PlantMaterial(Organ.LEAF) for name in mesh.materials}
        organ_of_material = {k: organ for k, organ in by_name.items() if organ is not None}
    used = {}
    for name in mesh.materials:
        if name not in organ_of_material:
            known = ", ".join(repr(key) for key in organ_of_material)
            raise InputError(
                f"material {name!r} must have an organ in `organ_of_material`; known are {known}",
                file=file,
            )
        given = organ_of_material[name]
        material = given if isinstance(given, PlantMaterial) else PlantMaterial(given)
        used[name] = replace(material, organ=organ_named(material.organ, name))
    return used
