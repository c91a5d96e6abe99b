"""What a user names must be a file, and hold no more text than memory can take."""

import stat
import zlib
from pathlib import Path

from fynjax._core.errors import InputError, did_you_mean

LARGEST_TEXT = 1 << 29
"""Bytes of a text file, or of what a compressed one unfolds to: spectra of a thousand plots are a
tenth of it."""


def existing_file(path: str | Path, what: str) -> Path:
    """The path of a file that must exist.

    **Arguments:**

    - `path`: the file.
    - `what`: names the file in errors, such as "a species table".

    **Returns:** `path`.

    **Raises:** `InputError` for a folder, a pipe or a device, a link that leads nowhere or back to
    itself, a name that is too long, and where there is no file, with the nearest name beside it.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except (OSError, RuntimeError, ValueError) as error:  # a null character is a ValueError
        raise InputError(f"expected {what}, but {why_not(path, error)}", file=path) from error
    if stat.S_ISREG(mode):
        return path
    came = "this is a folder" if stat.S_ISDIR(mode) else "this is a pipe or a device, not a file"
    raise InputError(f"expected {what}, but {came}", file=path)


def why_not(path: Path, error: Exception) -> str:
    """Why a path is none of a file."""
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

    **Arguments:**

    - `path`: a file that exists.
    - `largest`: most bytes that it may hold, or unfold to.

    **Raises:** `InputError` for a file that is larger or unfolds to more, cannot be opened, or is
    cut short or damaged.
    """
    try:
        with path.open("rb") as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise InputError(f"it cannot be opened ({error.strerror})", file=path) from error
    what = "it has"
    if data[:2] == b"\x1f\x8b":
        what = "it unfolds to"
        unfolded = b""
        try:
            while data and len(unfolded) <= largest:  # a file may hold several parts
                part = zlib.decompressobj(wbits=31)
                unfolded += part.decompress(data, largest + 1 - len(unfolded))
                if not part.eof and len(unfolded) <= largest:
                    raise InputError("the compressed file is cut short", file=path)
                data = part.unused_data.lstrip(b"\0")
        except zlib.error as error:
            raise InputError("the compressed file is damaged", file=path) from error
        data = unfolded
    if len(data) > largest:
        raise InputError(
            f"expected text of at most {largest >> 20} MiB, but {what} more", file=path
        )
    return data
