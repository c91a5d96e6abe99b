"""Mesh files and trimesh's objects as triangles with materials."""

import io
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy.mesh._plant_mesh import PlantMesh

_USEMTL = re.compile(r"^[ \t]*usemtl[ \t]+(.*?)[ \t]*\r?$", re.MULTILINE)


def default_up(mesh: Any) -> Literal["y", "z"]:
    """The vertical axis that a mesh is taken to have.

    **Arguments:**

    - `mesh`: a file, or any object.

    **Returns:** "y" for a glTF file (.glb, .gltf), as that standard defines, else "z".
    """
    gltf = isinstance(mesh, str | Path) and Path(mesh).suffix.lower() in (".glb", ".gltf")
    return "y" if gltf else "z"


def plant_mesh_of(mesh: Any) -> PlantMesh:
    """Triangles and materials of a file or an object of trimesh, in one frame.

    Raises `InputError` as `read_plant_mesh`.
    """
    import trimesh

    file = str(mesh) if isinstance(mesh, str | Path) else None
    names_of_file: dict[str, str] = {}
    if file is not None:
        try:
            if file.lower().endswith(".obj"):
                mesh, names_of_file = _load_obj(file)
            else:
                with np.errstate(all="ignore"):  # of numbers that are checked below
                    mesh = trimesh.load(file, process=False)
        except Exception as error:  # trimesh's readers raise whatever they stumble over
            if "allow_" in (reason := str(error)):  # it would have said how to let it
                reason = "it names files outside of its folder. Save it as one file (GLB)"
            raise InputError(f"the mesh cannot be read: {reason}", file=file) from error
    pieces: list[tuple[str, Any, np.ndarray]] = []
    if isinstance(mesh, trimesh.Trimesh):
        pieces = [("", mesh, np.eye(4))]
    elif isinstance(mesh, trimesh.Scene):
        for node in mesh.graph.nodes_geometry:
            frame, name = mesh.graph[node]
            pieces.append((str(name), mesh.geometry[name], np.asarray(frame, float)))
    vertices, faces, material, names, first = [], [], [], list[str](), 0
    for geometry_name, geometry, frame in pieces:
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        name = str(
            getattr(getattr(geometry.visual, "material", None), "name", None) or geometry_name
        )
        name = names_of_file.get(name, name)
        corners = np.asarray(geometry.faces)
        _check_shape(np.asarray(geometry.vertices), corners, file)
        if name not in names:
            names.append(name)
        vertices.append(np.asarray(geometry.vertices, float) @ frame[:3, :3].T + frame[:3, 3])
        # A frame that mirrors turns the triangles over.
        faces.append(first + (corners if np.linalg.det(frame[:3, :3]) > 0 else corners[:, ::-1]))
        material.append(np.full(len(corners), names.index(name)))
        first += len(geometry.vertices)
    if not faces:
        raise InputError(
            "a plant mesh must have faces, but has none; is it a point cloud? One with "
            "normals is a scan: XYZ, CSV or a PLY without faces (`read_scan`)",
            file=file,
        )
    return PlantMesh(
        np.concatenate(vertices), np.concatenate(faces), np.concatenate(material), tuple(names)
    )


def _check_shape(vertices: np.ndarray, corners: np.ndarray, file: str | None) -> None:
    """`InputError` unless each face has three corners that are there, each with three numbers."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(
            f"each vertex must have x, y and z, but the shape is {vertices.shape}", file=file
        )
    if corners.ndim != 2 or corners.shape[1] != 3:
        raise InputError(
            f"each face must have three corners, but the shape is {corners.shape}", file=file
        )
    if corners.min() < 0 or corners.max() >= len(vertices):
        wrong = int(corners.min() if corners.min() < 0 else corners.max())
        raise InputError(
            f"each corner of a face must be one of {len(vertices)} vertices, counted from 0, but "
            f"one is {wrong}",
            file=file,
        )


def _load_obj(file: str) -> tuple[Any, dict[str, str]]:
    """What trimesh makes of an OBJ file, and the material for each of its own names.

    The names stand in the file itself, so that its material file (MTL) may be missing: trimesh
    gets one with nothing but names.
    """
    import trimesh

    text = Path(file).read_text(encoding="utf-8", errors="replace")
    names = list(dict.fromkeys(_USEMTL.findall(text)))
    short_name = {name: f"material{index}" for index, name in enumerate(names)}
    text = _USEMTL.sub(lambda match: f"usemtl {short_name[match[1]]}", text)
    library = "".join(f"newmtl {name}\nKd 1 1 1\n" for name in short_name.values())
    loaded = trimesh.load(
        io.BytesIO(f"mtllib names\n{text}".encode()),
        file_type="obj",
        resolver={"names": library.encode()},
        process=False,
    )
    return loaded, {short: name for name, short in short_name.items()}
