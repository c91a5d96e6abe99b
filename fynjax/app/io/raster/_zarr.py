"""What a zarr group from somebody else may hold, looked at before anything is decoded."""

import gzip
import json
import math
import os
import zlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.files import check_stated_size, read_bytes
from fynjax.app.io.text import check_fits

_SUMS = ("crc32", "crc32c", "adler32", "fletcher32")
"""Codecs that add a sum of four bytes."""
_PLAIN = (
    *("bytes", "transpose", "shuffle", "delta", "fixedscaleoffset", "quantize", "bitround"),
    *("packbits", "vlen-utf8", "vlen-bytes", *_SUMS),
)
"""Codecs whose values are as large as the numbers that they stand for, or texts."""
_PACKED = ("blosc", "zstd", "lz4", "gzip", "zlib")
"""Codecs that compress, of which one can know before what they unfold to."""
_AT_ONCE = 10
"""Chunks that zarr decodes at the same time."""
_MOST_CHUNKS = 1 << 20
"""Chunks of an array; zarr takes some 50 us for each, also for one that is not there."""
_LONGEST = 1 << 24
"""Bytes of metadata; those of a cube are a thousandth of it."""


def check_zarr(path: Path) -> list[str]:
    """Refuse a zarr group with links, whose values are elsewhere, with codecs that can run code,
    with sizes that memory cannot hold, or whose chunks unfold to more than it states.

    **Arguments:** `path`, a folder.

    **Returns:** names of the arrays of texts and other things than numbers, which are not to be
    opened.

    **Raises:** `InputError`.
    """
    others = []
    _check_links(path)
    for folder in sorted(one for one in path.iterdir() if one.is_dir()):
        for name in (".zarray", "zarr.json"):
            if (folder / name).is_file():
                try:
                    numbers = _check_array(folder, _metadata(folder / name))
                except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
                    if isinstance(error, InputError):
                        raise
                    raise InputError(
                        "expected the metadata of a zarr array, but they lack something or are "
                        f"damaged ({type(error).__name__}: {error})",
                        file=folder / name,
                    ) from error
                if not numbers:
                    others.append(folder.name)
    return others


def _check_links(folder: Path | str) -> None:
    """Refuse links, devices and pipes: who made the group would choose what of this machine is
    read."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                _check_links(entry.path)
            elif not entry.is_file(follow_symlinks=False):
                what = "a link" if entry.is_symlink() else "a pipe or a device"
                raise InputError(
                    f"expected a zarr group that holds its own values, but this is {what}. If you "
                    "trust it, copy the group with what it links to: cp -rL",
                    file=entry.path,
                )


def _metadata(path: Path) -> dict[str, Any]:
    meta = json.loads(read_bytes(path, _LONGEST))
    if meta.get("node_type") == "group":
        return {}
    if path.name == ".zarray":
        return {
            "shape": meta["shape"],
            "chunks": meta["chunks"],
            "type": meta["dtype"],
            "codecs": [*(meta.get("filters") or []), *filter(None, [meta.get("compressor")])],
        }
    return {
        "shape": meta["shape"],
        "chunks": meta["chunk_grid"]["configuration"]["chunk_shape"],
        "type": meta["data_type"],
        "codecs": [*meta["codecs"], *meta.get("storage_transformers", ())],
    }


def _check_array(folder: Path, meta: dict[str, Any]) -> bool:
    """Check an array; gives whether it is one of numbers."""
    if not meta:
        return True
    codecs = [
        one if isinstance(one, str) else one.get("id", one.get("name")) for one in meta["codecs"]
    ]
    codecs = [str(one).removeprefix("numcodecs.") for one in codecs]
    packed = [one for one in codecs if one in _PACKED]
    wrong = [one for one in codecs if one not in (*_PLAIN, *_PACKED)]
    if wrong or len(packed) > 1:
        raise InputError(
            f"expected one of {', '.join(_PACKED)} as compression, but got "
            f"{' and '.join(wrong or packed)}: others can run code, or hide how large they are. "
            "If you trust it, write it anew with one of these",
            file=folder,
        )
    shape, chunks = meta["shape"], meta["chunks"]
    if len(shape) != len(chunks) or any(type(n) is not int or n < 1 for n in (*shape, *chunks)):
        raise InputError(
            "expected whole numbers of 1 or more as shape and chunks, but got "
            f"{shape} and {chunks}",
            file=folder,
        )
    try:
        kind = np.dtype(meta["type"]) if isinstance(meta["type"], str) else np.dtype("O")
    except TypeError:  # a type that NumPy has not, such as texts of any length
        kind = np.dtype("O")
    stated = math.prod(chunks) * kind.itemsize
    count = math.prod(-(-n // m) for n, m in zip(shape, chunks))
    at_once = min(count, _AT_ONCE)
    whole = math.prod(shape) * kind.itemsize if len(shape) < 3 else 0  # of a cube rows are read
    what = f"{shape} numbers in chunks of {chunks}"
    check_fits(2 * max(stated * at_once, whole), what, "Write smaller chunks", folder)
    if count > _MOST_CHUNKS:
        raise InputError(
            f"expected at most {_MOST_CHUNKS} chunks, but {what} are {count}. Write larger chunks",
            file=folder,
        )
    if kind.kind not in "biufmM":
        return False
    held = 0
    behind = codecs[codecs.index(packed[0]) + 1 :] if packed else []
    sums = 4 * sum(one in _SUMS for one in behind)
    for chunk in _files(folder):
        now = chunk.stat()
        held += now.st_size
        if packed and not _fits(chunk.path, packed[0], stated, now.st_size - sums, now.st_mtime_ns):
            raise InputError(
                f"expected chunks of {stated} bytes, but this one unfolds to more, does not say "
                "to how many, or is cut short. Is it damaged?",
                file=chunk.path,
            )
    stated = math.prod(shape) * kind.itemsize
    check_stated_size(folder, stated, f"{shape} numbers", packed=True, held=held)
    return True


def _files(folder: str | Path) -> Iterator["os.DirEntry[str]"]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _files(entry.path)
            elif entry.name not in (".zarray", ".zattrs", "zarr.json"):
                yield entry


@lru_cache(maxsize=1 << 18)  # a cube is opened for each of its blocks
def _fits(path: str, codec: str, most: int, size: int, changed: int) -> bool:
    """Whether a chunk unfolds to `most` bytes or fewer; true also of what is damaged otherwise."""
    with open(path, "rb") as file:
        if codec == "gzip":
            try:
                return len(gzip.GzipFile(fileobj=file).read(most + 1)) <= most
            except (OSError, EOFError, zlib.error):
                return True
        if codec == "zlib":
            try:
                return len(zlib.decompressobj().decompress(file.read(), most + 1)) <= most
            except zlib.error:
                return True
        if codec == "zstd":
            return _fits_zstd(file, most, size)
        head = file.read(16)
    if codec == "blosc" and int.from_bytes(head[12:], "little") != size:
        return False  # it would read on behind the end
    return int.from_bytes(head[4:8] if codec == "blosc" else head[:4], "little") <= most


def _fits_zstd(file: BinaryIO, most: int, whole: int) -> bool:
    """Whether the first `whole` bytes of a file are one frame of zstd (RFC 8878, section 3.1.1)
    that states `most` bytes or fewer: behind a first one others could unfold to anything."""
    data = file.read(18)
    if data[:4] != b"\x28\xb5\x2f\xfd" or len(data) < 6:
        return False
    flags = data[4]
    single = flags >> 5 & 1
    at = 5 + (1 - single) + (0, 1, 2, 4)[flags & 3]
    length = (single, 2, 4, 8)[flags >> 6]
    stated = int.from_bytes(data[at : at + length], "little") + (256 if length == 2 else 0)
    if length == 0 or stated > most:
        return False
    at, last = at + length, False
    while not last and at + 3 <= whole:
        file.seek(at)
        block = int.from_bytes(file.read(3), "little")
        last = bool(block & 1)
        at += 3 + (1 if block >> 1 & 3 == 1 else block >> 3)  # of repeated bytes one is there
    return at + 4 * (flags >> 2 & 1) >= whole  # with a checksum
