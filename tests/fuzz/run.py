"""Damaged files tried one by one in a process of their own, limited in time and memory."""

import dataclasses
import multiprocessing
import os
import random
import shutil
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from tests.fuzz.extreme import make_extreme
from tests.fuzz.mutate import damaged

SECONDS = 10.0
"""Longest that a reader may take for a file."""
GIBIBYTES = 4
"""Most memory that a reader may take beyond that of the process before."""
_LONGEST_ECHO = 200
"""Most characters of a file in a row that an error may repeat."""
_LARGEST = 1e15
_BATCH = 50
_OF_LATER_VERSIONS = DeprecationWarning | PendingDeprecationWarning | FutureWarning
"""Warnings of libraries that say nothing of the file."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a damaged file."""

    reader: str
    number: int
    kind: str
    """refused: one clear error; accepted; other: anything else."""
    text: str
    """The error, or what was wrong with what was accepted."""


_EXTREME = 0.3
"""Share of inputs that are valid files with extreme values, of formats that have a writer."""


def inputs(seeds: Path, reader: str, seed: int, number: int) -> dict[str, bytes]:
    """Files by name, one of them damaged or with extreme values: the same for the same numbers."""
    folder = seeds / reader
    chance = random.Random(f"{reader} {seed} {number}")
    if chance.random() < _EXTREME:
        with tempfile.TemporaryDirectory() as name:
            copy = Path(name) / "copy"
            shutil.copytree(folder, copy)
            if make_extreme(copy, chance):
                return _contents(copy)
    files = _contents(folder)
    name = chance.choice(list(files))
    return {**files, name: damaged(files[name], chance)}


def _contents(folder: Path) -> dict[str, bytes]:
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _strange(value: Any, missing: bool) -> str | None:
    """What is no sound number among all those of a result."""
    if value is None or isinstance(value, str | bytes | Path | bool | int):
        return None
    if dataclasses.is_dataclass(value):
        parts: Iterable[Any] = (getattr(value, f.name) for f in dataclasses.fields(value))
    elif hasattr(type(value), "model_fields"):
        parts = (getattr(value, name) for name in type(value).model_fields)
    elif isinstance(value, dict):
        parts = value.values()
    elif isinstance(value, tuple | list | set):
        parts = value
    else:
        try:
            numbers = np.asarray(value)
        except (TypeError, ValueError):
            return None
        if numbers.dtype.kind != "f" or not numbers.size:
            return None
        if not missing and np.isnan(numbers).any():
            return "accepted with NaN"
        if (np.abs(numbers[~np.isnan(numbers)]) > _LARGEST).any():
            return "accepted with infinite or impossible numbers"
        return None
    return next((found for part in parts if (found := _strange(part, missing))), None)


def _refusal(error: Exception, files: dict[str, bytes]) -> str | None:
    """What is wrong with an error; it names its file and repeats no more than a cell of it."""
    text = str(error)
    # Of a folder its own name is enough.
    if not any(part in text for name in files for part in (name, Path(name).parts[0])):
        return "does not name the file"
    if not text.isprintable():
        return "has characters that control a terminal"
    contents = [content.decode("latin-1") for content in files.values()]
    for start in range(0, len(text) - _LONGEST_ECHO, _LONGEST_ECHO // 4):
        if any(text[start : start + _LONGEST_ECHO] in content for content in contents):
            return "repeats the content of the file"
    return None


def _tried(reader: str, folder: Path, files: dict[str, bytes]) -> tuple[str, str]:
    """Kind and text of the outcome of one input."""
    from fynjax._core.errors import InputError
    from tests.fuzz.readers import READERS

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = READERS[reader].read(folder)
        except InputError as error:
            wrong = _refusal(error, files)
            return ("other", f"error {wrong}: {str(error)!r}") if wrong else ("refused", str(error))
        except BaseException as error:  # also the panics of libraries
            frames = [
                f"{Path(frame.filename).name}:{frame.lineno}"
                for frame in traceback.extract_tb(error.__traceback__)
                if "fynjax" in frame.filename
            ]
            last = traceback.extract_tb(error.__traceback__)[-1]
            at = f"{frames[-1] if frames else ''} {Path(last.filename).name}:{last.lineno}"
            return "other", f"{type(error).__name__} at {at}: {str(error)[:200]!r}"
    for warning in caught:
        if not issubclass(warning.category, UserWarning | _OF_LATER_VERSIONS):
            at = f"{Path(warning.filename).name}:{warning.lineno}"
            return "other", f"{warning.category.__name__} at {at}: {str(warning.message)[:200]!r}"
    if wrong := _strange(result, READERS[reader].missing):
        return "other", wrong
    return "accepted", ""


def _work(pipe: Connection, seeds: Path, seed: int) -> None:
    """Try what the pipe asks for, an outcome an input, until it closes."""
    import logging
    import resource

    import tests.fuzz.readers  # noqa: F401

    logging.disable()
    data = next(line for line in Path("/proc/self/status").read_text("utf-8").splitlines()
                if line.startswith("VmData"))  # fmt: skip
    limit = int(data.split()[1]) * 1024 + GIBIBYTES * 2**30
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    pipe.send(None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "input"
        while True:
            try:
                reader, numbers = pipe.recv()
            except EOFError:
                return
            for number in numbers:
                folder.mkdir()
                files = inputs(seeds, reader, seed, number)
                _write(folder, files)
                pipe.send(_tried(reader, folder, files))
                shutil.rmtree(folder)
                left = (one.name for one in threading.enumerate()[1:])
                if not all(name.startswith(("zarr", "asyncio")) for name in left):
                    os._exit(0)  # a reader gave up what goes on for ever


class Worker:
    """A process that reads, and another one after it has died or hung."""

    def __init__(self, seeds: Path, seed: int) -> None:
        self.seeds, self.seed = seeds, seed
        self._context = multiprocessing.get_context("spawn")
        self._start()

    def _start(self) -> None:
        self._pipe, other = self._context.Pipe()
        self._process = self._context.Process(
            target=_work, args=(other, self.seeds, self.seed), daemon=True
        )
        self._process.start()
        other.close()
        self._pipe.recv()  # it has imported

    def close(self) -> None:
        self._process.kill()
        self._process.join()

    def outcomes(self, reader: str, numbers: list[int]) -> Iterator[Outcome]:
        while numbers:
            self._pipe.send((reader, numbers))
            alive = True
            while numbers and alive:
                kind, text = "other", f"takes more than {SECONDS:g} s"
                try:
                    alive = self._answers()
                    if alive:
                        kind, text = self._pipe.recv()
                except (EOFError, ConnectionError):
                    alive = False
                    self._process.join()
                    if self._process.exitcode == 0:  # after the answer before
                        break
                    text = f"ends the process with status {self._process.exitcode}"
                yield Outcome(reader, numbers[0], kind, text)
                numbers = numbers[1:]
            if not alive:
                self.close()
                self._start()

    def _answers(self) -> bool:
        """Whether it answers in time: its own, for others may use the machine."""
        start, waited = self._seconds(), 0
        while not self._pipe.poll(1.0):
            waited += 1
            if self._seconds() > start + SECONDS or waited > 12 * SECONDS:
                return False
        return True

    def _seconds(self) -> float:
        """Of the processor that it has used."""
        if self._process.is_alive():
            times = psutil.Process(self._process.pid).cpu_times()
            return float(times.user + times.system)
        return 0.0


def fuzz(
    readers: list[str], seed: int, *, seconds: float = np.inf, each: int | None = None,
    save: Path | None = None,
) -> tuple[dict[str, Counter[str]], list[Outcome]]:  # fmt: skip
    """Try damaged files of readers in turn, for a time or a number of each.

    **Returns:** counts of outcomes by reader, and the outcomes that are neither an error nor
    accepted, whose inputs are written into the folder `save`.
    """
    from tests.fuzz.readers import READERS

    counts: dict[str, Counter[str]] = {name: Counter() for name in readers}
    broken: list[Outcome] = []
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as name:
        seeds = Path(name)
        for reader in readers:
            (seeds / reader).mkdir()
            READERS[reader].write(seeds / reader)
        worker = Worker(seeds, seed)
        first = 0
        while time.monotonic() < end and (each is None or first < each):
            last = first + _BATCH if each is None else min(first + _BATCH, each)
            for reader in readers:
                for outcome in worker.outcomes(reader, list(range(first, last))):
                    counts[reader][outcome.kind] += 1
                    if outcome.kind == "other":
                        broken.append(outcome)
                        if save is not None:
                            _save(save, outcome, inputs(seeds, reader, seed, outcome.number))
                if time.monotonic() >= end:
                    break
            first = last
        worker.close()
    return counts, broken


def _write(folder: Path, files: dict[str, bytes]) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _save(folder: Path, outcome: Outcome, files: dict[str, bytes]) -> None:
    place = folder / f"{outcome.reader}-{outcome.number}"
    _write(place, files)
    (place / "outcome.txt").write_text(outcome.text + "\n", encoding="utf-8")
