"""The parts of a job: done here one after another, or by dask on many processes and machines.

A part is a function of what can be sent to another process, and gives arrays. dask sends it there,
tries it again where a process died, and brings the arrays back. What is done here is the same
wherever a part is computed: each result is kept as it comes, progress is shown over all parts and
not within them, and a part that fails leaves the others alone.

All processes compute with the settings of the one that asked (precision, compiler, versions), so
that numbers are the same to the bit on processors of one kind.
"""

import contextlib
import logging
import os
import platform
import signal
import tempfile
import traceback
import warnings
from asyncio import CancelledError
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError as OtherCancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from fynjax._core.checkpoint import Journal
from fynjax._core.compiler import keep_compiled
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.memory import free_memory
from fynjax._core.progress import advance, listening

Arrays = tuple[np.ndarray, ...]
"""The arrays that a part gives."""
PartFunction = Callable[..., tuple[Array | np.ndarray, ...]]
"""`function(part, *shared)`: of a module, so that another process can import it."""
_Answer = tuple[Arrays | None, tuple[str, ...], str]
"""The arrays of a part and its warnings; or none, why, and the traceback."""

_RETRIES = 2
"""How often a part is tried again where a disk or memory failed; it may be another machine's."""
_CONNECT_SECONDS = 15.0
_LARGEST_SHARE = 0.9
"""Share of the free memory that all workers together may take [-]."""
_LEAST_MEMORY = 2 * 2**30
"""Least memory of a worker, of which compiling alone takes about half [bytes]."""
_SHOWN = 3
_LARGE_PARTS = {"distributed.admin.large-graph-warning-threshold": "1 TiB"}
"""dask warns from 10 MB on, of what a user could load elsewhere; here nobody can."""
_NUMBERS = (
    "jax_platforms",
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
)
"""Settings of JAX that decide numbers."""
_CACHE = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)


@dataclass(frozen=True)
class Workers:
    """Where the parts of a job are done: in this process, unless one of the two is given.

    `count` processes on this machine, of one thread and an equal share of the memory each; or the
    workers of a dask `scheduler` that runs already, by its address. Both need the extra `map`.
    Results are the same. Processes import the caller's script: one that uses `count` runs its
    commands under `if __name__ == "__main__":`.

    Raises `InputError` for both at once, and for a negative count.
    """

    count: int = 0
    """Do the parts in so many processes of this machine, one core each; same results. Needs the
    extra `map`. 0 does them in this process."""
    scheduler: str | None = None
    """Do the parts on the workers of a dask scheduler, such as tcp://192.168.0.10:8786."""

    def __post_init__(self) -> None:
        if self.count and self.scheduler is not None:
            raise InputError(
                "workers are started here (a number of them), or are those of a scheduler; give "
                "one of the two"
            )
        if self.count < 0:
            raise InputError(f"the number of workers must be at least 0, but is {self.count}")


@dataclass(frozen=True)
class _Settings:
    """What a process must have in common with the one that asks."""

    versions: tuple[tuple[str, str], ...]
    """Names and versions of Python and packages."""
    environment: tuple[tuple[str, str], ...]
    """Names and values of environment variables."""
    config: tuple[tuple[str, Any], ...]
    """Names and values of the settings of JAX."""


class Pool:
    """Does parts, in this process or on the workers of a dask client; `at_work` makes one."""

    def __init__(self, client: Any = None, settings: _Settings | None = None) -> None:
        self._client, self._settings = client, settings

    def each(
        self,
        function: PartFunction,
        parts: Sequence[Any],
        *shared: Any,
        names: Sequence[str] | None = None,
        sizes: Sequence[int] | None = None,
        journal: Journal | None = None,
    ) -> Iterator[tuple[int, Arrays]]:
        """The number and the arrays of each part, in the order in which they are done.

        **Arguments:**

        - `function`: called as `function(part, *shared)`, gives a tuple of arrays.
        - `parts`: what differs between the calls.
        - `shared`: what all have in common; sent once to each worker.
        - `names`: of the parts, for progress and errors; their numbers by default.
        - `sizes`: steps of progress that each part is; one by default.
        - `journal`: keeps the arrays of each part; those of an earlier run are given at once. The
          next `len(parts)` of its steps are these.

        **Raises:** after all others are done, `InputError` that says which parts failed and why;
        and where the scheduler is lost or results cannot be kept. Warnings of parts are given here.
        """
        names = [f"{i + 1}" for i in range(len(parts))] if names is None else names
        sizes = [1] * len(parts) if sizes is None else sizes
        first = 0 if journal is None else journal.reserve(len(parts))
        missing = {}
        for i, part in enumerate(parts):
            kept = None if journal is None else journal.kept(first + i)
            if kept is None:
                missing[i] = part
                continue
            advance(sizes[i], part=names[i])
            yield i, kept
        failed, report = [], None
        answers = self._answers(function, missing, shared)
        with contextlib.closing(answers):
            for i, (arrays, words, where) in answers:
                if arrays is None:
                    failed.append(f"{names[i]}: {words[0]}")
                    if journal is not None:
                        what = f"{function.__module__}.{function.__qualname__} of\n{parts[i]!r}"
                        text = f"{names[i]}\n{words[0]}\n\n{where}\nComputed by {what}\n"
                        report = journal.put_failure(first + i, text)
                else:
                    for text in words:
                        warnings.warn(text, stacklevel=2)
                    if journal is not None:
                        journal.put(first + i, arrays)
                    yield i, arrays
                advance(sizes[i], part=names[i])
        if failed and len(parts) == 1:
            raise InputError(failed[0])
        if failed:
            text = f"{len(failed)} of {len(parts)} parts failed: " + "; ".join(failed[:_SHOWN])
            if len(failed) > _SHOWN:
                text += f"; and {len(failed) - _SHOWN} more"
            if report is not None:
                text += f". Inputs and tracebacks are in {report.parent}"
            if journal is not None:
                text += ". The others are kept, and the same command tries only these again"
            raise InputError(text)

    def all(
        self, function: PartFunction, parts: Sequence[Any], *shared: Any, **how: Any
    ) -> list[Arrays]:
        """The arrays of all parts, in their order; arguments and errors as `each`."""
        done = dict(self.each(function, parts, *shared, **how))
        return [done[i] for i in range(len(parts))]

    def _answers(
        self, function: PartFunction, parts: dict[int, Any], shared: tuple[Any, ...]
    ) -> Generator[tuple[int, _Answer], None, None]:
        if self._client is not None and parts:
            yield from self._answers_of_dask(function, parts, shared)
            return
        for i, part in parts.items():
            try:
                yield i, _done(part, function, shared)
            except (OSError, MemoryError) as error:
                yield i, (None, (_words(error),), traceback.format_exc())

    def _answers_of_dask(
        self, function: PartFunction, parts: dict[int, Any], shared: tuple[Any, ...]
    ) -> Generator[tuple[int, _Answer], None, None]:
        client = self._client
        number: dict[Any, int] = {}
        # As bytes: the scheduler unpacks what it is sent, and where it computes in 32 bits, JAX
        # cuts arrays of 64 down to them.
        pack = require("distributed.protocol.pickle", "map").dumps
        try:
            # By a task, not by scatter: that of a worker that died is done again.
            given = client.submit(bytes, pack(shared), pure=False)
            same = ([value] * len(parts) for value in (function, given, self._settings))
            packed = [pack(part) for part in parts.values()]
            sent = client.map(_there, packed, *same, pure=False, retries=_RETRIES)
            number.update(zip(sent, parts, strict=True))
            completed = require("distributed", "map").as_completed(sent, loop=client.loop)
            del sent  # a worker keeps a result as long as somebody holds its future
            for future in completed:
                failed = future.status == "error"
                answer = _given_up(future.exception()) if failed else future.result()
                yield number.pop(future), answer
        except (CancelledError, OtherCancelledError, OSError, RuntimeError) as error:
            if isinstance(error, RuntimeError) and client.status == "running":
                raise
            raise InputError(
                "the dask scheduler is gone, and with it what its workers were doing. Results that "
                "had come back are kept where the command keeps a checkpoint: start the scheduler "
                "and its workers, and give the same command again"
            ) from error
        finally:
            with contextlib.suppress(Exception):
                client.cancel(list(number), force=True)


Do = Callable[..., list[Arrays]]
"""How the parts of some work are done, called as `Pool.all` is."""
in_order: Do = Pool().all
"""One after another in this process."""


@contextmanager
def at_work(workers: Workers | None = None) -> Iterator[Pool]:
    """Where the parts of a job are done, until the block ends; in this process by default.

    Processes that are started here speak by TLS with a certificate made for this once, so that no
    other user of the machine can give them work.

    **Raises:** `InputError` for more workers than this machine has cores, accelerators or memory
    for, and for a scheduler that does not answer, has no workers, or workers that are not fit: of
    another version, or of several threads. `MissingExtraError` without dask.
    """
    if workers is None or workers == Workers():
        yield Pool()
        return
    distributed = require("distributed", "map")
    settings = _settings(this_machine=workers.scheduler is None)
    with contextlib.ExitStack() as stack:
        log = logging.getLogger("distributed")  # of workers that come and go: the errors say it
        stack.callback(log.setLevel, log.level)
        log.setLevel(logging.CRITICAL + 1)
        stack.enter_context(require("dask", "map").config.set(_LARGE_PARTS))
        if workers.scheduler is None:
            where = "here"
            address = stack.enter_context(_cluster(workers.count, settings))
        else:
            where, address = f"at {workers.scheduler}", workers.scheduler
        try:
            client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(
                f"no dask scheduler answers {where}; start one with `dask scheduler`, which "
                "prints its address, such as tcp://192.168.0.10:8786"
            ) from error
        stack.callback(client.close, timeout=2)
        try:
            client.wait_for_workers(1, timeout=_CONNECT_SECONDS)
        except TimeoutError as error:
            raise InputError(
                f"the scheduler {where} has no workers; start some with "
                f"`dask worker {address} --nthreads 1 --nworkers 2`"
            ) from error
        threads = max(client.nthreads().values())
        if threads > 1:
            raise InputError(
                f"expected workers of one thread each, but {where} is one of {threads}: start them "
                f"with `--nthreads 1 --nworkers {threads}`"
            )
        try:
            found = client.run(_unfit, settings)
        except Exception as error:
            raise InputError(
                f"the workers {where} cannot run fynjax: {_words(error)}. Is the same fynjax "
                "installed there?"
            ) from error
        for name, why in found.items():
            if why:
                raise InputError(f"the worker {name} is not fit: {why}")
        yield Pool(client, settings)


@contextmanager
def _cluster(count: int, settings: _Settings) -> Iterator[Any]:
    """Workers of this machine; refuses more than there are cores, or room, for."""
    distributed = require("distributed", "map")
    require("cryptography", "map")  # for dask to make a certificate
    cores, free = _machine()
    if count > cores:
        raise InputError(
            f"this process may use {cores} cores, but {count} workers were asked for: each takes "
            "one. Ask for fewer, or give the scheduler of a cluster"
        )
    memory = int(_LARGEST_SHARE * free / count)
    if memory < _LEAST_MEMORY:
        raise InputError(
            f"{count} workers would have {memory / 2**30:.1f} GiB of memory each, but need "
            f"{_LEAST_MEMORY / 2**30:.0f} GiB or more: ask for fewer"
        )
    devices = _devices()
    if 0 < len(devices) < count:
        raise InputError(
            f"this machine has {len(devices)} accelerators, but {count} workers were asked for: "
            "each takes one. Ask for fewer, or set JAX_PLATFORMS=cpu"
        )
    keep: dict[str, Any] = {
        f"distributed.worker.memory.{name}": False for name in ("target", "spill", "pause")
    }
    # One part at a time, so that none is blamed for a worker that died of another.
    keep["distributed.scheduler.worker-saturation"] = 1.0
    # What workers do is shown to nobody: that would be without the certificate.
    keep |= {f"distributed.{process}.http.routes": [] for process in ("scheduler", "worker")}
    with (
        tempfile.TemporaryDirectory(prefix="fynjax-workers-") as scratch,
        require("dask", "map").config.set(keep),
        distributed.LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, security=True,
            host="127.0.0.1", dashboard_address="127.0.0.1:0", memory_limit=memory,
            silence_logs=logging.CRITICAL, local_directory=scratch,
            env=dict(settings.environment), preload=[__name__],
        ) as cluster,
    ):  # fmt: skip
        yield cluster


def _machine() -> tuple[int, int]:
    """Cores and memory [bytes] that this process may take, in a container too."""
    return int(require("dask.system", "map").CPU_COUNT), free_memory()


def _settings(*, this_machine: bool) -> _Settings:
    """Settings of this process that a worker's must match."""
    config = {name: getattr(jax.config, name) for name in _NUMBERS}
    if this_machine:
        config |= {name: getattr(jax.config, name) for name in _CACHE}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    environment = (
        ("XLA_FLAGS", os.environ.get("XLA_FLAGS", "")),
        ("JAX_PLATFORMS", config["jax_platforms"] or ""),
        # XLA cuts sums into as many pieces as it has threads, and rounds each: as many as here, on
        # whatever machine. Workers of this machine have them on one core.
        ("NPROC", os.environ.get("NPROC") or str(cores)),
    )
    return _Settings(_versions(), environment, tuple(config.items()))


def _devices() -> tuple[str, ...]:
    """Accelerators that this process may use, as CUDA names them; none where JAX takes none."""
    if getattr(jax.config, _NUMBERS[0]) == "cpu" or not metadata.entry_points(group="jax_plugins"):
        return ()
    found = ",".join(str(i) for i in range(len(list(Path("/dev").glob("nvidia[0-9]*")))))
    stated = os.environ.get("CUDA_VISIBLE_DEVICES", found).split(",")
    return tuple(name.strip() for name in stated if name.strip())


def _versions() -> tuple[tuple[str, str], ...]:
    names = ("fynjax", "jax", "jaxlib", "numpy", "equinox")
    python = ".".join(platform.python_version_tuple()[:2])
    return ("Python", python), *((name, metadata.version(name)) for name in names)


def _there(part: bytes, function: PartFunction, shared: bytes, settings: _Settings) -> _Answer:
    """A part on a worker, which may have been started after the others were prepared. What of its
    machine fails is raised: dask tries that again."""
    if why := _unfit(settings):
        return None, (f"the worker on {platform.node()} is not fit: {why}",), ""
    return _done(_unpacked(part), function, _unpacked_once(shared))


def _unpacked(data: bytes) -> Any:
    """What was packed, in the precision that the worker now has."""
    return require("distributed.protocol.pickle", "map").loads(data)


_unpacked_once = lru_cache(maxsize=1)(_unpacked)


def _done(part: Any, function: PartFunction, shared: tuple[Any, ...]) -> _Answer:
    with listening(None), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        try:
            arrays = tuple(np.asarray(array) for array in function(part, *shared))
        except (OSError, MemoryError):
            raise
        except Exception as error:
            return None, (_words(error),), traceback.format_exc()
    return arrays, tuple(str(w.message) for w in caught), ""


@lru_cache(maxsize=1)
def _unfit(settings: _Settings) -> str:
    """Take the settings of the process that asks; why this worker is not fit, or nothing."""
    own = dict(_versions())
    other = [f"{n} {own[n]}, not {v}" for n, v in settings.versions if own[n] != v]
    if other:
        return "it has " + ", ".join(other)
    os.environ.update(settings.environment)
    keep_compiled()  # before the folder is named: what is read there goes through the store
    for name, value in settings.config:
        jax.config.update(name, value)
    return ""


def dask_setup(worker: Any) -> None:
    """Prepare a worker that `at_work` starts, before it does anything: dask calls this in it.

    It keeps to a core of its own, as do the threads that XLA will start, and to an accelerator of
    its own where there are any. A Ctrl-C is left to the process that asks.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[worker.name % len(cores)]})
    if devices := _devices():
        os.environ["CUDA_VISIBLE_DEVICES"] = devices[worker.name]


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError) else f"{type(error).__name__}: {text}"


def _given_up(error: BaseException) -> _Answer:
    """Answer for a part that dask tries no more."""
    why = _words(error)
    if type(error).__name__ == "KilledWorker":
        why = (
            "every worker that tried it died, as one does that takes more memory than it has; give "
            "workers more memory, which fewer of them have"
        )
    return None, (why,), ""
