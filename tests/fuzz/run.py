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
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil

from tests.fuzz.extreme import make_extreme
from tests.fuzz.mutate import damaged
from tests.fuzz.variants import VARIANTS, Hidden, difference, plain, vary

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
_VARIED = 0.25
"""Share of inputs that say the same as the seed in another way."""


class Input(NamedTuple):
    """Files that a reader is given."""

    files: dict[str, bytes]
    """By name."""
    varied: bool = False
    """Whether they must be read as the seed is."""
    hidden: Hidden = None
    """What they state to be missing of it."""


def made(seeds: Path, reader: str, seed: int, number: int) -> Input:
    """Files by name, one of them damaged, with extreme values, or written in another way: the same
    for the same numbers."""
    folder = seeds / reader
    chance = random.Random(f"{reader} {seed} {number}")
    kind = chance.random()
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "copy"
        if reader in VARIANTS and kind > 1.0 - _VARIED:
            shutil.copytree(folder, copy)
            hidden = vary(reader, copy, chance)
            return Input(_contents(copy), True, hidden)
        if kind < _EXTREME:
            shutil.copytree(folder, copy)
            if make_extreme(copy, chance):
                return Input(_contents(copy))
    files = _contents(folder)
    name = chance.choice(list(files))
    return Input({**files, name: damaged(files[name], chance)})


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


def _tried(reader: str, folder: Path, given: Input, seeds: Path | None = None) -> tuple[str, str]:
    """Kind and text of the outcome of one input, judged by the valid files below `seeds` too."""
    from fynjax._core.errors import InputError
    from tests.fuzz.readers import READERS

    files = given.files
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = READERS[reader].read(folder)
        except InputError as error:
            if given.varied:
                return "other", f"a valid file is refused: {str(error)[:200]!r}"
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
    wrong = _strange(result, READERS[reader].missing) or (
        None if seeds is None else _misread(reader, folder, given, result, seeds)
    )
    return ("other", wrong) if wrong else ("accepted", "")


@lru_cache(maxsize=1)
def _valid(reader: str, seeds: Path) -> tuple[dict[str, bytes], Any]:
    """The files of a seed, and what their reader gives."""
    from tests.fuzz.readers import READERS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _contents(seeds / reader), READERS[reader].read(seeds / reader)


def _misread(reader: str, folder: Path, given: Input, result: Any, seeds: Path) -> str | None:
    """What is not as in the valid file, or as another library reads it."""
    from tests.fuzz.oracle import LIBRARIES, TOUCHED, other_opinion, untouched

    if not given.varied and reader not in {*LIBRARIES, *TOUCHED}:
        return None
    before, whole = _valid(reader, seeds)
    if given.varied:
        wrong = difference(plain(reader, whole), plain(reader, result), given.hidden)
        return wrong and f"not read as it was written: {wrong}"
    return other_opinion(reader, folder, result) or untouched(
        reader, before, given.files, whole, result
    )


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
                given = made(seeds, reader, seed, number)
                _write(folder, given.files)
                pipe.send(_tried(reader, folder, given, seeds))
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
                            _save(save, outcome, made(seeds, reader, seed, outcome.number).files)
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
