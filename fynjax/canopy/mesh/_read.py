"""Mesh files and trimesh's objects as triangles with materials."""

import io
import itertools
import re
import string
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.memory import bounded_memory
from fynjax.canopy._plant import organ_of_name
from fynjax.canopy.mesh._bounds import check_mesh_file, check_mesh_triangles
from fynjax.canopy.mesh._plant_mesh import PlantMesh

_USEMTL = re.compile(r"^[ \t]*usemtl[ \t](.*)", re.MULTILINE)
_GROUPS = {kind: re.compile(rf"^[ \t]*{kind}[ \t](.*)", re.MULTILINE) for kind in "go"}
_RELATIVE = re.compile(r"^[ \t]*[flp][ \t].*-\d", re.MULTILINE)
_COMMENT = re.compile(r"^([ \t]*[vflp][nt]?[ \t][^#\n]*)#.*", re.MULTILINE)
_ZERO = re.compile(r"^[ \t]*[flp][ \t](?:.*[ \t])?0(?:/|\s|$)", re.MULTILINE)
_COMMA = re.compile(r"^[ \t]*v[ \t].*?(\d+,\d+)", re.MULTILINE)
_BELOW = 0.05
"""Part of a plant's extent that reaches below the ground of its frame without being its height."""


def default_up(mesh: Any) -> Literal["y", "z"]:
    """The vertical axis that a mesh is taken to have.

    **Arguments:**

    - `mesh`: a file, or any object.

    **Returns:** "y" for a glTF file (.glb, .gltf), as that standard defines, else "z".
    """
    gltf = isinstance(mesh, str | Path) and Path(mesh).suffix.lower() in (".glb", ".gltf")
    return "y" if gltf else "z"


def find_up(mesh: Any, read: PlantMesh) -> Literal["y", "z"]:
    """The vertical axis of a mesh, found where no standard says it.

    **Arguments:**

    - `mesh`: a file, or any object.
    - `read`: its triangles as they stand in the file.

    **Returns:** `default_up`; but "y", with a warning, of a file whose plant reaches below 0 in z
    and not in y. Warns too where the plant stands on 0 in y as in z, or on neither but hangs from 0
    or stands on it in another axis.
    """
    up = default_up(mesh)
    if up == "y" or not isinstance(mesh, str | Path):
        return up
    low, high = read.vertices.min(axis=0), read.vertices.max(axis=0)
    size = np.where(high > low, high - low, 1.0)
    # A plant with its foot far from 0, as in map coordinates, says nothing.
    stands = (low >= -_BELOW * size) & (low <= size)
    hangs = (high <= _BELOW * size) & (high >= -size)
    below = low[2] < -_BELOW * size[2]
    if below and stands[1]:
        up, why = "y", "the plant reaches below 0 in z and not in y. Is it z?"
    elif stands[1] and stands[2]:
        why = "no file of this kind says which it is, and the plant stands on 0 in y too. Is it y?"
    elif below and (stands[0] or hangs.any()):
        found = [f"stands on 0 in {axis}" for axis, is_so in zip("xyz", stands) if is_so]
        found += [f"hangs from 0 in {axis}" for axis, is_so in zip("xyz", hangs) if is_so]
        why = (
            f"no file of this kind says which it is, but the plant {' and '.join(found)}. If "
            "another axis points up, or z down, turn the mesh first. Is it z?"
        )
    else:
        return up
    warnings.warn(
        f"{mesh}: {up} is taken for the vertical axis, upwards, since {why} Then say so (`up`, "
        "--up)",
        stacklevel=3,
    )
    return up


def plant_mesh_of(mesh: Any) -> PlantMesh:
    """Triangles and materials of a file or an object of trimesh, in one frame.

    Raises `InputError` as `read_plant_mesh`.
    """
    import trimesh

    file = str(mesh) if isinstance(mesh, str | Path) else None
    names_of_file: dict[str, str] = {}
    if file is not None:
        check_mesh_file(file)
        try:
            if file.lower().endswith(".obj"):
                mesh, names_of_file = _load_obj(file)
            else:
                with np.errstate(all="ignore"), bounded_memory(file):
                    mesh = trimesh.load(file, process=False)
        except InputError:
            raise
        except Exception as error:  # trimesh's readers raise whatever they stumble over
            if "allow_" in (reason := str(error)):  # it would have said how to let it
                reason = "it names files outside of its folder. Save it as one file (GLB)"
            raise InputError(f"the mesh cannot be read: {reason}", file=file) from error
    pieces: list[tuple[str, Any, np.ndarray]] = []
    if isinstance(mesh, trimesh.Trimesh):
        pieces = [("", mesh, np.eye(4))]
    elif isinstance(mesh, trimesh.Scene):
        pieces = [(str(n), mesh.geometry[n], frame) for n, frame in _placed(mesh.graph, file)]
    check_mesh_triangles(sum(len(getattr(one, "faces", ())) for _, one, _ in pieces), file)
    vertices, faces, material, names, first = [], [], [], dict[str, int](), 0
    for geometry_name, geometry, frame in pieces:
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        name = str(
            getattr(getattr(geometry.visual, "material", None), "name", None) or geometry_name
        )
        name = names_of_file.get(name, name)
        corners = np.asarray(geometry.faces)
        _check_shape(np.asarray(geometry.vertices), corners, file)
        vertices.append(np.asarray(geometry.vertices, float) @ frame[:3, :3].T + frame[:3, 3])
        # A frame that mirrors turns the triangles over.
        faces.append(first + (corners if np.linalg.det(frame[:3, :3]) > 0 else corners[:, ::-1]))
        material.append(np.full(len(corners), names.setdefault(name, len(names))))
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


def _placed(graph: Any, file: str | None) -> list[tuple[Any, np.ndarray]]:
    """Geometries that a scene places, each with its frame.

    A frame is that of the node above times the node's own: trimesh multiplies all above each anew.
    """
    edges, above = graph.transforms.edge_data, graph.transforms.parents
    frames = {graph.base_frame: np.eye(4)}
    for node in graph.nodes_geometry:
        way = [node]
        while way[-1] not in frames:
            if way[-1] not in above or len(way) > len(above):
                words = "the mesh cannot be read: a part of its scene is below itself, or nowhere"
                raise InputError(words, file=file)
            way.append(above[way[-1]])
        for upper, lower in itertools.pairwise(reversed(way)):
            own = edges[upper, lower].get("matrix")
            frames[lower] = frames[upper] if own is None else frames[upper] @ np.asarray(own, float)
    return [(graph.transforms.node_data[n]["geometry"], frames[n]) for n in graph.nodes_geometry]


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

    code = "utf-16" if Path(file).read_bytes()[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8"
    text = _COMMENT.sub(r"\1", Path(file).read_text(code, errors="replace"))
    if comma := _COMMA.search(text):
        words = f"expected coordinates with a decimal point, but got {comma[1]}"
        raise InputError(words, file=file, row=text.count("\n", 0, comma.end()) + 1)
    if zero := _ZERO.search(text):
        row = text.count("\n", 0, zero.end()) + 1
        raise InputError("expected corners counted from 1, but got 0", file=file, row=row)
    text = _materials_of_groups(_counted_from_first(text, file))
    names = list(dict.fromkeys(map(str.strip, _USEMTL.findall(text))))
    short_name = {name: f"material{index}" for index, name in enumerate(names)}
    text = _USEMTL.sub(lambda match: f"usemtl {short_name[match[1].strip()]}", text)
    library = "".join(f"newmtl {name}\nKd 1 1 1\n" for name in short_name.values())
    try:
        with bounded_memory(file):
            loaded = trimesh.load(
                io.BytesIO(f"mtllib names\n{text}".encode()), file_type="obj", process=False,
                resolver={"names": library.encode()},
            )  # fmt: skip
    except IndexError as error:
        raise _beyond(text, file) from error
    return loaded, {short: name for name, short in short_name.items()}


def _beyond(text: str, file: str) -> InputError:
    """The error of the first face that has a corner beyond the points."""
    rows = [line.split() for line in text.splitlines()]
    count = sum(row[:1] == ["v"] for row in rows)
    for at, row in enumerate(rows, 1):
        corners = re.findall(r"(?<![\d/])\d+", " ".join(row)) if row[:1] == ["f"] else ()
        if (last := max(map(int, corners), default=0)) > count:
            words = f"expected corners among {count} points, but a face has {last}"
            return InputError(words, file=file, row=at)
    return InputError("the mesh cannot be read: a number of a face is too large", file=file)


def _materials_of_groups(text: str) -> str:
    """The text with its groups or objects as materials, where their names and not those of the
    materials say two organs or more; leaf_1 and leaf_2 become leaf."""
    if any(organ_of_name(name) is not None for name in _USEMTL.findall(text)):
        return text
    for pattern in _GROUPS.values():
        organs = {organ_of_name(name) for name in pattern.findall(text)} - {None}
        if len(organs) > 1:
            plain = _USEMTL.sub("", text)
            return pattern.sub(lambda match: f"usemtl {_unnumbered(match[1].strip())}", plain)
    return text


def _unnumbered(name: str) -> str:
    """A name without the number at its end: "Leaf.001" is "Leaf", "12" remains."""
    bare = name.rstrip(string.digits)
    return (name if bare == name else bare.rstrip("-._ ")) or name


def _counted_from_first(text: str, file: str) -> str:
    """The text of an OBJ file with every corner counted from the first vertex.

    A negative number counts back from the vertex before the face; trimesh counts from the last one
    of the file.
    """
    if not _RELATIVE.search(text):
        return text
    counts = {"v": 0, "vt": 0, "vn": 0}
    lines = text.splitlines()
    for number, line in enumerate(lines):
        kind, _, rest = line.strip().partition(" ")
        if kind in counts:
            counts[kind] += 1
        elif kind in ("f", "l", "p") and "-" in rest:
            corners = [corner.split("/") for corner in rest.partition("#")[0].split()]
            lines[number] = f"{kind} " + " ".join(
                "/".join(_absolute(*one, file, number + 1) for one in zip(corner, counts.values()))
                for corner in corners
            )
    return "\n".join(lines) + "\n"


def _absolute(index: str, count: int, file: str, row: int) -> str:
    if not index.startswith("-"):
        return index
    if not index[1:].isdigit() or not 1 <= int(index[1:]) <= count:
        raise InputError(
            f"expected a corner among the {count} before this face, but got {index}",
            file=file,
            row=row,
        )
    return str(count + 1 + int(index))
