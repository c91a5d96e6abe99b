"""The costly steps of a run, kept as they come: an interrupted run goes on without loss.

A run whose steps follow from each other the same way each time need not keep its state. It keeps
what its steps returned, and a run that starts again is given those instead of computing them.
"""

import dataclasses
import errno
import hashlib
import io
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar, get_origin, get_type_hints
from zipfile import BadZipFile

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fynjax._core.errors import InputError, refusing
from fynjax._core.store import code_hash, is_own

State = TypeVar("State")


class Journal:
    """Keeps the arrays that each step returns in a file of its own, by the step's number."""

    def __init__(self, folder: str | Path, signature: str) -> None:
        """Open the journal in `folder`, or begin one.

        `signature` names the run: all that its steps follow from. Raises `InputError` if the
        folder has the journal of another run.
        """
        self._folder, self._signature = Path(folder), signature
        self._count = 0
        if not is_own(self._folder):
            raise InputError(
                "this checkpoint belongs to another user; choose another folder for your own",
                file=self._folder,
            )
        mark = self._folder / _MARK
        if mark.is_file():
            if mark.read_text("utf-8", "replace").strip() != signature:
                raise InputError(
                    "this checkpoint is of another run: other files, data, parameters, settings "
                    "or seed, or of another version of fynjax. Choose another output, or remove it "
                    "to start again",
                    file=self._folder,
                )
            return
        words = "cannot write here: {error.strerror}"
        with refusing(OSError, words=words, file=self._folder):
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(mark, f"{signature}\n".encode())

    def __call__(self, step: Callable[..., Array | np.ndarray], *of: Any) -> np.ndarray:
        """Do a step and keep the array that it returns; or, if an earlier run did it, give that
        back. `of` are the arguments of the step."""
        number = self.reserve(1)
        kept = self.kept(number)
        if kept is None:
            kept = (np.asarray(step(*of)),)
            self.put(number, kept)
        return kept[0]

    def reserve(self, count: int) -> int:
        """The number of the next of `count` steps, which may be done in any order."""
        self._count += count
        return self._count - count

    def kept(self, number: int) -> tuple[np.ndarray, ...] | None:
        """What a step returned in an earlier run; None if it was not done."""
        arrays = self._load(_STEP.format(number))
        return None if arrays is None else tuple(arrays.values())

    def put(self, number: int, arrays: Sequence[Array | np.ndarray]) -> None:
        """Keep what a step returned, and forget how it failed before."""
        self._save(_STEP.format(number), {f"a{i}": value for i, value in enumerate(arrays)})
        with suppress(OSError):
            (self._folder / _FAILED.format(number)).unlink(missing_ok=True)

    def put_state(self, name: str, state: Any) -> None:
        """Keep a state, a dataclass of arrays, of tuples of these and of such dataclasses, in place
        of the last of this name."""
        self._save(_STATE.format(name), dict(_leaves(state, "")))

    def kept_state(self, name: str, kind: type[State]) -> State | None:
        """The last state of a name, of the dataclass `kind`; None if none was kept."""
        arrays = self._load(_STATE.format(name))
        return None if arrays is None else _built(kind, arrays, "")

    def states(
        self, name: str, kind: type[State], go_on: Callable[[State | None], Iterator[State]]
    ) -> Iterator[State]:
        """The states that `go_on` gives, from the one that an earlier run kept, or else from None.

        They are kept, every few seconds and the last at the end or an interruption, as `put_state`
        does.
        """
        last, written = None, -np.inf
        try:
            for state in go_on(self.kept_state(name, kind)):
                last = state
                if time.monotonic() - written > _KEEP_SECONDS:
                    last, written = None, time.monotonic()
                    self.put_state(name, state)
                yield state
        finally:
            if last is not None:
                self.put_state(name, last)

    def _save(self, name: str, arrays: dict[str, Any]) -> None:
        """Write arrays by name, behind the hash of the run, the file's name and what follows."""
        content = io.BytesIO()
        try:
            named: dict[str, Any] = {key: np.asarray(value) for key, value in arrays.items()}
            np.savez(content, **named)
            data = content.getvalue()
            _write(self._folder / name, self._hash(name, data) + data)
        except OSError as error:
            after = "What was kept before stays, and the same command goes on from it"
            if not (self._folder / _MARK).is_file():
                after = "The checkpoint was removed meanwhile: the same command begins anew"
            words = f"cannot keep what was done: {error.strerror}. {after}"
            raise InputError(words, file=self._folder) from error

    def _hash(self, name: str, data: bytes) -> bytes:
        return hashlib.sha256(f"{self._signature}/{name}\n".encode() + data).digest()

    def _load(self, name: str) -> dict[str, np.ndarray] | None:
        """The arrays of the file `name`; None where there is none. `InputError` for content that
        this run did not write under this name."""
        path = self._folder / name
        with refusing(OSError, words="it cannot be opened ({error.strerror})", file=path):
            try:
                raw = path.read_bytes()
            except FileNotFoundError:
                return None
        size = hashlib.sha256().digest_size
        damaged = InputError(
            "no checkpoint of this step, or a damaged one; remove its folder to start again",
            file=path,
        )
        if self._hash(name, raw[size:]) != raw[:size]:
            raise damaged
        try:  # a hash keeps nobody from writing another file with its own
            with np.load(io.BytesIO(raw[size:]), allow_pickle=False) as file:
                if sum(part.file_size for part in file.zip.infolist()) > len(raw):
                    raise damaged
                return dict(file)
        except (OSError, ValueError, EOFError, MemoryError, AttributeError, TypeError, BadZipFile):
            raise damaged from None

    def put_failure(self, number: int, text: str) -> Path | None:
        """Keep how a step failed; gives the file, or None where nothing can be written."""
        path = self._folder / _FAILED.format(number)
        try:
            _write(path, text.encode())
        except OSError:
            return None
        return path


_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_KEEP_SECONDS = 5.0
"""A kill loses at most so much work of a solver, and the step under way."""
_MARK = "calibration.mark"
_STEP = "calibration.{:04d}.npz"
_STATE = "calibration.{}.npz"
_FAILED = "calibration.{:04d}.failed.txt"


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Arrays of a state, each with the way to it."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _leaves(getattr(value, field.name), f"{key}.{field.name}")
    elif isinstance(value, tuple):
        for number, part in enumerate(value):
            yield from _leaves(part, f"{key}.{number}")
    else:
        yield key, value


def _built(kind: Any, leaves: dict[str, np.ndarray], key: str) -> Any:
    """A state of the dataclass `kind` from its leaves."""
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        fields = dataclasses.fields(kind)
        make: Any = kind
        return make(*(_built(hints[f.name], leaves, f"{key}.{f.name}") for f in fields))
    if get_origin(kind) is tuple:
        count = sum(name.startswith(f"{key}.") for name in leaves)
        return tuple(jnp.asarray(leaves[f"{key}.{number}"]) for number in range(count))
    of_numpy = getattr(kind, "array_type", None) is np.ndarray
    return leaves[key] if of_numpy else jnp.asarray(leaves[key])


def forget_journal(folder: str | Path) -> None:
    """Remove a journal, and its folder if nothing else is in it."""
    folder = Path(folder)
    for pattern in (_MARK, "calibration.*.npz", "calibration.*.txt", "calibration.*.work"):
        for path in folder.glob(pattern):
            with suppress(OSError):
                path.unlink()
    with suppress(OSError):  # something else is in it, or it is a link
        folder.rmdir()


def _write(path: Path, data: bytes) -> None:
    """Beside, then renamed: a kill or a full disk leaves a whole file or none."""
    work = path.with_name(path.name + ".work")
    if work.is_symlink():  # what it leads to is no work of ours
        raise OSError(errno.ELOOP, f"{work.name} is a link", work)
    try:
        number = os.open(work, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | _PLAIN, 0o600)
        with os.fdopen(number, "wb") as file:
            file.write(data)
    except OSError:
        work.unlink(missing_ok=True)
        raise
    os.replace(work, path)


def signature(*signed: Any) -> str:
    """A hash of all that a run follows from.

    It is the same in every process, and differs where a type, an array, a number, a text or a
    function within `signed` does, or the source of the package. Functions are known by their names
    and what they close over.

    **Arguments:** `signed`, any values; modules, dataclasses and containers are taken apart.

    **Returns:** 64 hexadecimal digits.
    """
    total = hashlib.sha256()
    entered: set[int] = set()

    def add(value: Any) -> None:
        total.update(f"|{type(value).__module__}.{type(value).__qualname__}:".encode())
        if isinstance(value, jax.Array | np.ndarray):
            array = np.ascontiguousarray(value)
            total.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
            return
        parts = _parts(value)
        if parts is None:
            total.update(repr(value).encode())
        elif id(value) not in entered:  # a function may close over itself
            entered.add(id(value))
            total.update(f"{len(parts)}".encode())
            for part in parts:
                add(part)
            entered.remove(id(value))

    add((code_hash(), signed))
    return total.hexdigest()


class ByContent:
    """A dataclass that equals another of the same content, arrays too. As a static field of a
    record it is no argument of compiled programs, and records of equal content share them."""

    @cached_property
    def _content(self) -> str:
        return signature(self)

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, ByContent) and self._content == other._content


def _parts(value: Any) -> Sequence[Any] | None:
    """What a value is made of; None for a number, a text and the like, which `repr` shows whole."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, set | frozenset):
        return sorted(value, key=repr)
    if isinstance(value, dict):
        return [*value.keys(), *value.values()]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [getattr(value, field.name, None) for field in dataclasses.fields(value)]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if callable(value):
        cells = getattr(value, "__closure__", None) or ()
        names = [getattr(value, name, "") for name in ("__module__", "__qualname__")]
        return [*names, *(cell.cell_contents for cell in cells)]
    return list(vars(value).items()) if hasattr(value, "__dict__") else None
