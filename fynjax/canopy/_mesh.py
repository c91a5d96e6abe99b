"""Plant models from triangle meshes.

One-sided area. A leaf blade, flat and without thickness, counts once: the area of its triangles.
A closed surface, such as a stem built as a tube, counts half of its area, because light that
enters it also leaves it: half of it intercepts, whatever its shape (for a convex body that is
Cauchy's mean silhouette times two; Chen and Black 1992). Both are the areas of `FORM_DEFAULTS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax.canopy._counts import modelled_diameter
from fynjax.canopy._forms import quasi_random, split_elements
from fynjax.canopy._mesh_facets import (
    check_vertex_normals,
    draw_evenly,
    facets,
    is_closed,
    volume,
)
from fynjax.canopy._plant import Organ, PlantModel

_COLOURS = {Organ.LEAF: (0.24, 0.42, 0.14), Organ.WOOD: (0.36, 0.27, 0.20)}
_FLOWER_COLOUR = (0.85, 0.55, 0.65)


@dataclass(frozen=True)
class PlantMaterial:
    """What a material of a mesh stands for."""

    organ: Organ | str
    """Organ: leaf, wood or flower."""
    optics: str = ""
    """Name of its optical class (a spectrum of the user's); the material's own name if empty."""
    solid: bool | None = None
    """Whether it bounds solid bodies, so that half of its area counts; None leaves that to
    `solid_materials`."""


class PlantMesh(eqx.Module):
    """The triangles of one plant, each with a material."""

    vertices: Float[np.ndarray, "vertex 3"]
    """Corners, z upwards [m]."""
    faces: Int[np.ndarray, "face 3"]
    """Corners of each triangle, counter-clockwise from outside (or from a blade's upper side)."""
    material: Int[np.ndarray, " face"]
    """Index into `materials` of each triangle."""
    materials: tuple[str, ...] = eqx.field(static=True)
    """Names of the materials."""

    @property
    def triangles(self) -> Float[np.ndarray, "face 3 3"]:
        """The three corners of each triangle [m]."""
        return self.vertices[self.faces]

    @property
    def material_area(self) -> Float[np.ndarray, " material"]:
        """Area of all triangles of each material, both sides of a closed surface [m2]."""
        _, area = facets(self.triangles)
        return np.bincount(self.material, weights=area, minlength=len(self.materials))

    def is_closed(self, material: str) -> bool:
        """Whether the triangles of a material bound bodies: no edge is left open."""
        triangles = self.triangles[self.material == self.materials.index(material)]
        return len(triangles) > 0 and is_closed(triangles)

    def obj(self, material_file: str) -> tuple[str, str]:
        """The mesh as Wavefront OBJ (lengths to 1 nm) and the MTL text it names.

        `material_file` is the name the MTL text is to have. Materials are named as in
        `materials`; their colours are for show.
        """
        lines = ["# lengths in metres, z upwards", f"mtllib {material_file}"]
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in self.vertices.tolist()]
        colours = []
        for index, name in enumerate(self.materials):
            lines.append(f"usemtl {name}")
            corners = self.faces[self.material == index] + 1
            lines += [f"f {a} {b} {c}" for a, b, c in corners.tolist()]
            organ = _organ_of_name(name)
            red, green, blue = _COLOURS.get(organ or Organ.LEAF, _FLOWER_COLOUR)
            colours.append(f"newmtl {name}\nKd {red} {green} {blue}\nillum 1\n")
        return "\n".join(lines) + "\n", "\n".join(colours)


class MeshPlant(eqx.Module):
    """A mesh (or a scan) as a plant model, with the sizes, areas and materials it had."""

    plant: PlantModel
    """Its shape."""
    width: float = eqx.field(static=True)
    """Extent along x [m]."""
    height: float = eqx.field(static=True)
    """Extent along y, "height" in the paper's eq. (7) [m]."""
    depth: float = eqx.field(static=True)
    """Extent along z: how tall the plant is [m]."""
    organ_area: Float[Array, " organ"]
    """One-sided area of leaf, wood and flower [m2]; scale with the square of the size."""
    material: Int[Array, " element"]
    """Index into `materials` and `optics` of each element."""
    materials: tuple[str, ...] = eqx.field(static=True)
    """Names of the materials."""
    optics: tuple[str, ...] = eqx.field(static=True)
    """Name of the optical class of each material."""

    @property
    def modelled_diameter(self) -> float:
        """Crown diameter, eq. (7) [m]."""
        return float(modelled_diameter(self.width, self.height))

    @property
    def position(self) -> Float[Array, "element 3"]:
        """Elements in metres: x, y from the middle of the bounding box, z from its bottom."""
        diameter = self.modelled_diameter
        return self.plant.position * jnp.asarray([diameter, diameter, self.depth])

    @property
    def area(self) -> Float[Array, " element"]:
        """One-sided area of each element [m2]."""
        return self.plant.area_fraction * self.organ_area[self.plant.organ]


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


def mesh_plant(
    point: np.ndarray,
    normal: np.ndarray,
    area: np.ndarray,
    material: np.ndarray,
    names: tuple[str, ...],
    materials: list[PlantMaterial],
    low: np.ndarray,
    high: np.ndarray,
) -> MeshPlant:
    """Record of elements in metres, whose plant fills the box from `low` to `high` [m]."""
    organs = [int(_organ(one.organ, name)) for one, name in zip(materials, names)]
    organ = np.array(organs)[material]
    organ_area = np.bincount(organ, weights=area, minlength=len(Organ))
    width, height, depth = (float(side) for side in high - low)
    diameter = modelled_diameter(width, height)
    axis = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    plant = PlantModel(
        jnp.asarray((point - axis) / np.array([diameter, diameter, depth])),
        jnp.asarray(area / organ_area[organ]),
        jnp.asarray(np.where(normal[:, 2:] < 0.0, -normal, normal)),
        jnp.asarray(organ, jnp.int32),
    )
    optics = tuple(one.optics or name for one, name in zip(materials, names))
    return MeshPlant(
        plant,
        width,
        height,
        depth,
        jnp.asarray(organ_area),
        jnp.asarray(material, jnp.int32),
        names,
        optics,
    )


def check_extent(
    points: np.ndarray, maximum_extent: float, file: str | None, what: str = "a plant mesh"
) -> tuple[np.ndarray, np.ndarray]:
    """Opposite corners of the bounding box of points [n, 3], checked."""
    if not np.isfinite(points).all():
        raise InputError(f"the vertices of {what} must be finite, but some are not", file=file)
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    box = f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}"
    if size.max() > maximum_extent:
        raise InputError(
            f"{what} must be in metres and at most {maximum_extent:g} m large, but is {box}: is "
            "it in centimetres or millimetres?",
            file=file,
        )
    if size.min() <= 0.0:
        raise InputError(f"{what} must extend in x, y and z, but is flat: {box} m", file=file)
    return low, high


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


def _organ_of_name(name: str) -> Organ | None:
    """The organ a material's name begins with."""
    for organ in Organ:
        if name.lower().startswith(organ.name.lower()):
            return organ
    return None


def _materials(
    mesh: PlantMesh,
    organ_of_material: Mapping[str, Organ | str | PlantMaterial] | None,
    file: str | None,
) -> list[PlantMaterial]:
    """What each material of the mesh stands for."""
    if organ_of_material is None:
        by_name = {name: _organ_of_name(name) for name in mesh.materials}
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
        used.append(PlantMaterial(_organ(one.organ, name), one.optics, one.solid))
    return used


def _organ(organ: Organ | str, name: str) -> Organ:
    if isinstance(organ, str):
        if organ.upper() not in Organ.__members__:
            raise InputError(
                f"the organ of material {name!r} must be leaf, wood or flower, but is {organ!r}"
            )
        return Organ[organ.upper()]
    return Organ(organ)
