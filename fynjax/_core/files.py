"""What a user, or a file of a user, names must be a file, and hold no more than memory can take."""

import errno
import gzip
import hashlib
import io
import os
import re
import stat
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_core import CoreSchema, core_schema

from fynjax._core.errors import InputError, did_you_mean, refusing

LARGEST_TEXT = 1 << 29
"""Bytes of a text file, or of what a compressed one unfolds to: spectra of a thousand plots are a
tenth of it."""

_TIGHTEST = 3000
"""Bytes for each byte of a compressed file above which it cannot hold them: deflate packs no
tighter than 1 in 1032, and few measurements tighter than 1 in 10."""
_FREELY = 1 << 28
"""Bytes that a file may state whatever its size."""


_read: ContextVar[set[Path] | None] = ContextVar("fynjax.read", default=None)


@contextmanager
def noting_files() -> Iterator[set[Path]]:
    """Give a set that takes every file that is read in the block as an input, as it was named and
    where links lead."""
    read: set[Path] = set()
    before = _read.set(read)
    try:
        yield read
    finally:
        _read.reset(before)


def note_file(path: Path) -> None:
    """Count a file among those that are read (`noting_files`)."""
    if (read := _read.get()) is not None:
        read |= {path.absolute(), path.resolve()}


def existing_file(path: str | Path, what: str) -> Path:
    """The path of a file that must exist.

    **Arguments:** `path`: the file; `what`: names the file in errors, such as "a species table".

    **Returns:** `path`.

    **Raises:** `InputError` for a product of PRISMA, which nothing reads (.he5), for a folder, a
    pipe or a device, a link that leads nowhere or back to itself, a name that is too long or no
    text (`check_name`), and where there is no file, with the nearest name beside it.
    """
    path = Path(path)
    check_name(path)
    try:
        mode = path.stat().st_mode
    except (OSError, RuntimeError, ValueError) as error:  # a null character is a ValueError
        raise InputError(f"expected {what}, but {why_not(path, error)}", file=path) from error
    if stat.S_ISREG(mode):
        if path.suffix.lower() == ".he5":
            raise InputError(
                f"expected {what}, but this is HDF-EOS (.he5), as PRISMA's products are, which "
                f"fynjax does not read.{how_to_import(path)}",
                file=path,
            )
        note_file(path)
        return path
    came = "this is a folder" if stat.S_ISDIR(mode) else "this is a pipe or a device, not a file"
    raise InputError(f"expected {what}, but {came}", file=path)


_PRODUCTS = {"PRS_": "PRISMA L2D", "ENMAP": "EnMAP L2A", "DESIS": "DESIS L2A", "EMIT_": "EMIT L2A"}


def how_to_import(path: Path) -> str:
    """Advice on a file whose name is that of a product of an imaging spectrometer in space: a
    sentence after a space, or nothing. These keep their wavelengths in a form of their own."""
    upper = path.name.upper()
    product = next((product for key, product in _PRODUCTS.items() if upper.startswith(key)), None)
    if product is None and path.suffix.lower() != ".he5":
        return ""
    product, bring = product or "PRISMA L2D", " Bring"
    if product.startswith("EMIT"):
        bring = " `fynjax map` reads it as it is; for other commands bring"
    return (
        f"{bring} it to a GeoTIFF that states wavelengths and a scale first: EnMAP-Box in QGIS, "
        f"'Import {product} product'."
    )


def is_elsewhere(path: Path, part: Path) -> bool:
    """Whether a file that belongs to another, such as the data to a header, lies in no folder of
    that one: neither where the user named it nor, of a link, where that leads.

    **Arguments:** `path`, the file that the user named; `part`, what belongs to it.
    """
    folders = path.absolute().parent.resolve(), path.resolve().parent
    return part.resolve().parent not in folders


_LONGEST_NAME = 255
"""Bytes of a name that file systems take."""

_WHY = {
    errno.ENAMETOOLONG: "the name is too long",
    errno.ELOOP: "links lead back to themselves",
    errno.EFBIG: "a file would be larger than this disk, or the limit of the process "
    "(`ulimit -f`), allows",
    errno.ENOSPC: "the disk is full",
    errno.EROFS: "this disk cannot be written",
    errno.EACCES: "this user may not read or write it",
    errno.EPERM: "this user may not read or write it",
    errno.EMFILE: "too many files are open (`ulimit -n`)",
} | ({errno.EDQUOT: "your quota on this disk is used up"} if hasattr(errno, "EDQUOT") else {})


_OF_WRITING = re.compile(r"HDF|NetCDF|[Ww]rit|I/O|TIFF")


def why_failed(error: BaseException) -> str | None:
    """The reason why the operating system refused a file (`OSError`, or a loop of links), in words
    that say what to change; None for any other error."""
    if isinstance(error, RuntimeError) and "ymlink loop" in str(error):
        return _WHY[errno.ELOOP]
    return _WHY.get(error.errno or 0) if isinstance(error, OSError) else None


def may_be_limited(error: BaseException) -> bool:
    """Whether an error of a library of files, which does not say what stopped it, may be that of a
    file that is larger than this process may write."""
    try:
        import resource
    except ImportError:  # of Unix alone
        return False
    limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    return limit != resource.RLIM_INFINITY and bool(_OF_WRITING.search(str(error)))


def check_folder(path: Path) -> None:
    """Refuse a folder for results that no system can make: a name that is no text or too long
    (`check_name`), or links that lead back to themselves.

    **Raises:** `InputError`.
    """
    check_name(path)
    try:
        path.resolve().exists()
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write here: {why_failed(error) or error}", file=path) from error


def check_name(path: Path) -> None:
    """Refuse a file or folder whose name, or that of a folder above it, has bytes that are no text
    in this system's encoding, which libraries of files cannot open or write, or too many.

    **Raises:** `InputError`.
    """
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError as error:
        byte = os.fsencode(error.object[error.start])[:1].hex()
        raise InputError(
            f"expected names of files and folders in {sys.getfilesystemencoding()}, but the byte "
            f"0x{byte} is none. Rename it, or the folder that it is in",
            file=str(path).encode("utf-8", "backslashreplace").decode(),
        ) from error
    longest = max(path.parts, key=lambda part: len(os.fsencode(part)), default="")
    if len(os.fsencode(longest)) > _LONGEST_NAME:
        raise InputError(
            f"expected names of at most {_LONGEST_NAME} bytes, but {longest[:20]!r}... has "
            f"{len(os.fsencode(longest))}"
        )


def why_not(path: Path, error: Exception) -> str:
    """Why a path leads to no file that can be read: the end of a message."""
    try:
        if path.is_symlink() and isinstance(error, FileNotFoundError):
            return f"this is a link to {str(path.readlink())[:100]!r}, which is not there"
        if path.is_symlink() and not isinstance(error, PermissionError):
            return "this is a link that leads back to itself"
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            beside = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
            return f"there is no such file.{did_you_mean(path.name, beside)}"
    except (OSError, ValueError):
        pass
    return f"it cannot be opened ({getattr(error, 'strerror', None) or error})"


def read_bytes(path: Path, largest: int = LARGEST_TEXT) -> bytes:
    """Content of a text file, unfolded if it is compressed (gzip).

    **Arguments:** `path`: a file that exists; `largest`: most bytes that it may hold, or unfold to.

    **Raises:** `InputError` for a file that is larger or unfolds to more, cannot be opened, or is
    cut short or damaged.
    """
    note_file(path)
    words = "it cannot be opened ({error.strerror})"
    with refusing(OSError, words=words, file=path), path.open("rb") as file:
        data = file.read(min(largest, path.stat().st_size) + 1)
    what = "it has"
    if data[:2] == b"\x1f\x8b":
        what = "it unfolds to"
        with (
            refusing(EOFError, words="the compressed file is cut short", file=path),
            refusing(OSError, zlib.error, words="the compressed file is damaged", file=path),
        ):
            data = gzip.GzipFile(fileobj=io.BytesIO(data)).read(largest + 1)
    if len(data) > largest:
        raise InputError(
            f"expected text of at most {largest >> 20} MiB, but {what} more", file=path
        )
    return data


def _file_beside(
    owner: Path, name: str, what: str, within: Path | None, folder: bool = False
) -> Path:
    place = owner.parent / name
    try:
        path = place.resolve()
        if within is not None and not path.is_relative_to(within.resolve()):
            raise InputError(
                f"expected {what} in this file's folder or below. Copy it there; for a plot file "
                "that you trust, allow other places: --allow-outside (`allow_outside`)"
            )
        if not (folder and place.is_dir()):
            existing_file(place, what)  # as it is named: of a link that leads nowhere it says so
        return path
    except InputError as error:
        text = error.message
    except ValueError:  # a null character
        text = f"expected {what}, but no file can have this name"
    except (OSError, RuntimeError) as error:  # a link in a loop
        text = f"expected {what}, but {why_not(place, error)}"
    raise ValueError(f"{name!r}: {text}")


def file_hash(path: str | Path) -> str:
    """SHA-256 of the file `path`, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class NamedFile:
    """Type of a key that names a file: `Annotated[Path, NamedFile("a sky table")]`.

    Where a record is read from a file, the text becomes the path of a file that is there, from the
    folder of the file that names it; elsewhere the path is taken as it is. A reader may state a
    folder in which it must lie, also behind links: a file from somebody else shall not choose what
    of this machine is read.
    """

    what: str
    """Names the file in errors."""
    words: tuple[str, ...] = ()
    """Texts that stand for something else and are kept."""
    folder: bool = False
    """Whether it may be a folder."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.with_info_wrap_validator_function(
            self._path, core_schema.str_schema(), serialization=core_schema.to_string_ser_schema()
        )

    def _path(self, value: Any, text: Any, info: core_schema.ValidationInfo) -> Path | str:
        if isinstance(value, Path):
            return value
        name = str(text(value))
        if name in self.words:
            return name
        if info.context is None:
            return Path(name)
        owner, within = info.context["owner"], info.context["within"]
        return _file_beside(owner, name, self.what, within, self.folder)


def check_stated_size(path: Path, stated: int, what: str, *, packed: bool, held: int = -1) -> None:
    """Refuse a file whose header states more content than the file can hold, before any is read.

    **Arguments:**

    - `path`: a file that exists.
    - `stated`: bytes of content by the header.
    - `what`: that content, such as "30 000 points".
    - `packed`: whether the content may be compressed.
    - `held`: bytes that it holds; those of the file if left out.

    **Raises:** `InputError`.
    """
    held = path.stat().st_size if held < 0 else held
    if stated < 0 or stated > (max(_TIGHTEST * held, _FREELY) if packed else held):
        raise InputError(
            f"it states {what}, but its {held} bytes cannot hold them. Is it cut short or "
            "damaged? Copy it again.",
            file=path,
        )
