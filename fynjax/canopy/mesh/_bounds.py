"""What a mesh file may unfold to: known before it is read, from what it states."""

import json
import struct
from pathlib import Path
from typing import Any

from fynjax._core.errors import InputError, refusing
from fynjax._core.files import check_stated_size, existing_file

LARGEST_FILE = 1 << 30
"""Bytes of a mesh file; a scanned plant of ten million triangles has a half of it."""
MOST_TRIANGLES = 20_000_000
"""Triangles of a mesh, each copy that its file places counted."""
_PACKED = (".zip", ".gz", ".tgz", ".bz2", ".xz", ".tar", ".7z", ".3mf")
_NUMBERS = 16 * 8
"""Most bytes of an entry of a GLB's accessor: a matrix of four by four."""


def check_mesh_file(path: str | Path, what: str = "a mesh") -> None:
    """Refuse a mesh file, or `what` it is to be, that is packed, too large, or states more than it
    can hold.

    Raises `InputError`, as `existing_file` too. What is packed may unfold to anything, and a reader
    of meshes would unfold it whole.
    """
    path = existing_file(path, what)
    suffix = next((end for end in _PACKED if path.name.lower().endswith(end)), None)
    if suffix is not None:
        raise InputError(
            f"expected a mesh (OBJ, PLY, STL, GLB), but got an archive ({suffix}): unpack it first",
            file=path,
        )
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise InputError(
            f"expected a mesh file of at most {LARGEST_FILE >> 20} MiB, but it has {size >> 20}. "
            "Make the mesh coarser first",
            file=path,
        )
    if path.suffix.lower() in (".glb", ".gltf"):
        _check_gltf(path)


def check_mesh_triangles(count: int, file: str | None) -> None:
    """Refuse more triangles, in all copies, than a plant can need."""
    if count > MOST_TRIANGLES:
        raise InputError(
            f"expected a plant of at most {MOST_TRIANGLES} triangles, but the mesh has {count}, "
            "each copy that it places counted. Make it coarser first",
            file=file,
        )


def _check_gltf(path: Path) -> None:
    """Refuse arrays without data of their own, which are as many zeros as the file says, beyond
    what its size makes likely; and parts of a scene that lead back to themselves or are shared."""
    words = "the mesh cannot be read: it is damaged or cut short"
    with refusing(
        OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, struct.error,
        words=words, file=path,
    ):  # fmt: skip
        content = path.read_bytes()
        if content[:4] == b"glTF":
            (length,) = struct.unpack_from("<I", content, 12)
            content = content[20 : 20 + length]
        record: dict[str, Any] = json.loads(content)
        stated = sum(
            _NUMBERS * int(one.get("count", 0))
            for one in record.get("accessors", [])
            if "bufferView" not in one or "sparse" in one
        )
        children = [int(c) for node in record.get("nodes", []) for c in node.get("children", [])]
    check_stated_size(path, stated, f"{stated >> 20} MiB of arrays without data", packed=True)
    if len(children) != len(set(children)):
        raise InputError(
            "the mesh cannot be read: a part of its scene stands below two others, or itself",
            file=path,
        )
