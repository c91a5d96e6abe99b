"""What is kept from run to run: in one folder of the user's, each entry with its hash.

An entry is a file: a hash of its kind, key and content under a secret of the folder's owner, and
the content. What has no such hash, is too large or another user's is as if it were not there. A
folder in which others may write is not used.
"""

import functools
import hashlib
import hmac
import os
import secrets
import stat
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from fynjax._core.errors import refusing

_SECRET, _TAG = "secret", hashlib.sha256().digest_size
_MADE = ("jax", "leaves", "right-sums", "locks")
"""Folders that this version or one before it has made."""
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_AS_IT_IS = getattr(os, "O_BINARY", 0)


def cache_folder() -> Path:
    """Folder of all that is kept: `XDG_CACHE_HOME/fynjax`, or `~/.cache/fynjax`.

    **Raises:** `OSError` where the process has no home.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:  # one that is relative is none, as its standard says
        return (base if base.is_absolute() else Path.home() / ".cache") / "fynjax"
    except RuntimeError as error:
        raise OSError(str(error)) from error


@functools.cache
def code_hash(*parts: str) -> str:
    """A hash of the source of the package, or of those `parts` of it, which are files or folders:
    what is kept is of the code that made it, whatever the version says."""
    package = Path(__file__).parents[1]
    total = hashlib.sha256()
    for part in parts or (".",):
        path = package / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            content = hashlib.sha256(file.read_bytes()).digest()
            total.update(file.relative_to(package).as_posix().encode() + b"\0" + content)
    return total.hexdigest()


class Store:
    """Entries of one kind, by key. What cannot be kept is not: that costs time and nothing else."""

    def __init__(self, kind: str, largest: int, entry: int) -> None:
        """A store in the folder named `kind`, whose entries take at most `largest` bytes together,
        each at most `entry` bytes."""
        self._kind, self._largest, self._entry = kind, largest, entry
        self._held: int | None = None

    def folder(self) -> Path | None:
        """The folder of the entries, which is made; None where there can be none."""
        return _own_folder(self._kind)

    def get(self, key: str) -> bytes | None:
        """The content that was put under a key; None where there is none, or no whole one. What is
        damaged is removed."""
        folder, secret = _own_folder(self._kind, make=False), _secret(make=False)
        if folder is None or secret is None:
            return None
        path = folder / _file_of(key)
        data = _read_own(path, self._entry + _TAG)
        if data is None:
            return None
        if not hmac.compare_digest(self._tag(secret, key, data[_TAG:]), data[:_TAG]):
            with suppress(OSError):
                path.unlink()
            return None
        with suppress(OSError):
            os.utime(path)  # the last one used is the last to go
        return data[_TAG:]

    def put(self, key: str, content: bytes) -> None:
        """Keep content under a key; the entries that were not used for longest make room."""
        folder, secret = self.folder(), _secret()
        if folder is None or secret is None or len(content) > self._entry:
            return
        data = self._tag(secret, key, content) + content
        with suppress(OSError):
            if _write_own(folder / _file_of(key), data) and self._held is not None:
                self._held += len(data)
            if self._held is None or self._held > self._largest:
                self._held = self._make_room(folder)

    def _tag(self, secret: bytes, key: str, content: bytes) -> bytes:
        name = f"{self._kind}\0{key}\0".encode()
        return hmac.digest(secret, name + hashlib.sha256(content).digest(), "sha256")

    def _make_room(self, folder: Path) -> int:
        """Remove the oldest entries until all take what they may; gives the bytes that are left."""
        found = sorted(_files(folder), key=lambda one: one[1].st_mtime)
        held = sum(status.st_size for _, status in found)
        for path, status in found:
            if held <= self._largest:
                break
            with suppress(OSError):
                path.unlink()
                held -= status.st_size
        return held


def clear() -> tuple[int, int]:
    """Remove all that is kept; gives the number of files and their bytes.

    **Raises:** `InputError` where the process has no home.
    """
    count = size = 0
    with refusing(OSError, words="nothing is kept: {error}"):
        root = cache_folder()
    for kind in _MADE:
        folder = root / kind
        for path, status in list(_files(folder)):
            with suppress(OSError):
                path.unlink()
                count, size = count + 1, size + status.st_size
        with suppress(OSError):
            folder.rmdir()
    with suppress(OSError):
        (root / _SECRET).unlink()
    return count, size


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """The files of a folder, unless that is a link."""
    with suppress(OSError):
        if folder.is_symlink():
            return
        for one in os.scandir(folder):
            with suppress(OSError):
                if one.is_file(follow_symlinks=False):
                    yield Path(one.path), one.stat(follow_symlinks=False)


def _file_of(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


def _own_folder(kind: str = "", *, make: bool = True) -> Path | None:
    """The folder of a kind, or of all, for its owner alone; None where it is not there, cannot be
    made or is not ours."""
    try:
        root = cache_folder()
        if make:
            root.parent.mkdir(parents=True, exist_ok=True)
        folder = root / kind
        for each in dict.fromkeys((root, folder)):
            if make:
                with suppress(FileExistsError):
                    each.mkdir(mode=0o700)
            status = each.lstat()
            if not stat.S_ISDIR(status.st_mode) or not _is_own(status):
                _warn_of(each)
                return None
            if os.name == "posix" and status.st_mode & 0o077:
                each.chmod(0o700)
    except OSError:
        return None
    return folder


@functools.cache
def _warn_of(folder: Path) -> None:
    warnings.warn(
        f"{folder} is a link, no folder, or another user's, so nothing is kept there and each run "
        "computes anew. Remove it, or set XDG_CACHE_HOME to a folder of your own",
        stacklevel=4,
    )


def is_own(path: Path) -> bool:
    """Whether a file or folder belongs to the user of this process; also where there is none."""
    try:
        return _is_own(path.stat())
    except OSError:
        return True


def _is_own(status: os.stat_result) -> bool:
    user: int = getattr(os, "geteuid", lambda: status.st_uid)()  # Unix alone has it
    return status.st_uid == user


def _read_own(path: Path, largest: int) -> bytes | None:
    """Content of a plain file of the user's own; None for any other, and for a larger one."""
    try:
        number = os.open(path, os.O_RDONLY | _NO_LINK | _AS_IT_IS)
    except OSError:
        return None
    with suppress(OSError), os.fdopen(number, "rb") as file:
        status = os.fstat(number)
        if stat.S_ISREG(status.st_mode) and _is_own(status) and status.st_size <= largest:
            return file.read(largest + 1)
    return None


def _write_own(path: Path, data: bytes, *, replace: bool = True) -> bool:
    """Write a file that its owner alone can read, whole or not at all; gives whether it was."""
    partial = path.with_name(f".{secrets.token_hex(8)}")
    number = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINK | _AS_IT_IS, 0o600)
    try:
        with os.fdopen(number, "wb") as file:
            file.write(data)
        if replace:
            os.replace(partial, path)
        else:
            os.link(partial, path)  # fails where another process was first
        return True
    finally:
        with suppress(OSError):
            partial.unlink()


def _secret(*, make: bool = True) -> bytes | None:
    """Secret under which entries are hashed, made by the first process that keeps one: what others
    put into the folder has no hash under it."""
    root = _own_folder(make=make)
    if root is None:
        return None
    path = root / _SECRET
    found = _read_own(path, _TAG)
    if make and (found is None or len(found) != _TAG):
        with suppress(OSError):
            if found is not None:
                path.unlink()
            _write_own(path, secrets.token_bytes(_TAG), replace=False)
        found = _read_own(path, _TAG)
    return found if found is not None and len(found) == _TAG else None
