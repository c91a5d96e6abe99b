"""Write beside, then rename: a reader finds the old file, the new file, or none."""

import errno
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fynjax._core.errors import InputError, refusing
from fynjax._core.files import may_be_limited, why_failed

_FULL = 1 << 20
"""Bytes left on a disk that is full: less than any result takes."""


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` if the block succeeds.

    If the block raises, the temporary file is removed and `path` is left as it was. Missing
    parent folders are made.

    **Arguments:** `path`: the file to write.

    **Returns:** a context manager that gives the temporary path, in the same folder.

    **Raises:** `OSError` where the folder cannot be made or written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # The suffix stays last: GDAL and matplotlib choose the format by it.
    partial = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.partial{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to the file `path` in UTF-8, whole or not at all (`atomic_path`)."""
    with atomic_path(path) as partial:
        partial.write_text(text, encoding="utf-8")


def remove_replaced(
    folder: str | Path, names: Iterable[str], kept: Iterable[str | Path]
) -> list[str]:
    """Remove files of an earlier run from its folder.

    What is no plain file, or leads out of the folder, stays, and so does what cannot be removed.

    **Arguments:**

    - `folder`: of the earlier run and of this one.
    - `names`: files that the earlier run listed, relative to `folder`.
    - `kept`: files that stay, relative to `folder` or absolute.

    **Returns:** the names of the files that were removed.
    """
    root = Path(folder).resolve()

    def ways(path: Path) -> set[str]:
        return {os.path.normcase(p).casefold() for p in (path, path.resolve())}

    stay = set().union(*(ways(root / each) for each in kept))
    removed = []
    for name in names:
        path = root / name
        inside = path.parent.resolve().is_relative_to(root) and ".." not in Path(name).parts
        if not inside or ways(path) & stay or path.is_symlink() or not path.is_file():
            continue
        with suppress(OSError):
            path.unlink()
            removed.append(name)
    return removed


def remove_abandoned(folder: str | Path) -> None:
    """Remove what killed runs left beside `folder` (`staged_folder`), if it is older than a week.

    A younger one may belong to a run of another machine on the same disk.
    """
    path = Path(folder).resolve()
    ours = re.compile(rf"\.{re.escape(path.name)}\.[0-9a-f]{{8}}\.partial")
    long_ago = time.time() - 7 * 86_400.0
    with suppress(OSError):
        for each in path.parent.iterdir():
            if ours.fullmatch(each.name) and each.is_dir() and each.stat().st_mtime < long_ago:
                shutil.rmtree(each, ignore_errors=True)


def _beside(folder: Path, partial: Path) -> Path:
    """Keep results that may not go where they should in a new folder beside; gives that."""
    for number in range(2, 1000):
        free = folder.with_name(f"{folder.name}-{number}")
        with suppress(OSError):
            free.mkdir()  # fails where it is there: a rename would replace an empty one
            os.replace(partial, free)
            return free
    return partial.rename(partial.with_suffix(".results"))


def _move(
    folder: Path, target: Path, names: Iterable[str], one: Callable[[Path, Path], object]
) -> None:
    """Move files of these names to another folder, by `one` each."""
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        one(folder / name, target / name)


def _is_elsewhere(error: BaseException, folder: Path) -> bool:
    """Whether an error names a file that is not below a folder: an input, such as a link."""
    name = getattr(error, "filename", None)
    return name is not None and not Path(os.fsdecode(name)).is_relative_to(folder)


@contextmanager
def staged_folder(
    folder: str | Path, check: Callable[[list[str]], None] | None = None
) -> Iterator[Path]:
    """Give an empty folder beside `folder`; move its files into `folder` if the block succeeds.

    If the block raises or is interrupted nothing reaches `folder`, and `folder` is not made. A file
    that stands there under the same name is replaced only where `check` lets it; others are left
    alone.

    **Arguments:**

    - `folder`: where the files shall be.
    - `check`: is given the names of all files before the first is moved, and raises `InputError`
      where one may not be replaced. Without it none is.

    **Returns:** a context manager that gives the empty folder.

    **Raises:** `InputError` if `folder` is a file or cannot be written, where the disk is full, and
    where a file may not be replaced: then it says in which new folder the results are.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError("expected a folder for the output, but this is a file", file=folder)
    target = folder.resolve()  # `--output .` has no name to put a folder beside
    partial = target.with_name(f".{target.name}.{secrets.token_hex(4)}.partial")
    missing = [parent for parent in target.parents if not parent.exists()]
    with refusing(OSError, words="cannot write here: {error.strerror}", file=folder):
        partial.mkdir(parents=True)
    try:
        try:
            yield partial
        except Exception as error:  # the libraries of formats say 'HDF error' and the like
            why = why_failed(error)
            if why is None and may_be_limited(error):
                why = why_failed(OSError(errno.EFBIG, ""))
            if isinstance(error, InputError):
                if "cannot write here" not in str(error):
                    raise
            elif why is not None and not _is_elsewhere(error, partial):
                raise InputError(f"no results were written: {why}", file=folder) from error
            if shutil.disk_usage(partial).free > _FULL:
                raise
            raise InputError("the disk is full, so no results were written", file=folder) from error
        sources = sorted(p for p in partial.rglob("*") if p.is_file())
        names = [source.relative_to(partial).as_posix() for source in sources]
        there = [name for name in names if os.path.lexists(target / name)]
        try:
            if check is not None:
                check(names)
            elif there:
                raise InputError(f"{there[0]!r} is there already", file=folder)
        except InputError as error:
            where = _beside(target, partial)
            raise InputError(
                f"{error.message}. The results are in {where.name}, beside it", file=error.file
            ) from error
        try:
            target.mkdir(exist_ok=True)
            try:
                _move(partial, target, names, os.replace)
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                # A mounted disk: all is on it before the first file replaces another.
                near = target / partial.name
                try:
                    _move(partial, near, names, shutil.copyfile)
                    _move(near, target, names, os.replace)
                finally:
                    shutil.rmtree(near, ignore_errors=True)
        except OSError as error:
            where = _beside(target, partial)
            raise InputError(
                f"cannot write here: {why_failed(error) or error.strerror}. The results are in "
                f"{where.name}, beside it",
                file=folder,
            ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        for parent in missing:  # the innermost first; none that holds anything
            with suppress(OSError):
                parent.rmdir()
