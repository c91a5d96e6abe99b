"""The parts of a job: done here one after another, or by dask on many processes and machines.

A part is a function of what can be sent to another process, and gives arrays. dask sends it there,
tries it again where a process died, and brings the arrays back; nothing of that is done here. What
is done here is the same wherever a part is computed: each result is kept as it comes, progress is
shown over all parts and not within them, and a part that fails leaves the others alone.

All processes compute with the settings of the one that asked (precision, compiler, versions), so
that numbers are the same to the bit on processors of one kind.
"""

import asyncio
import concurrent.futures
import contextlib
import getpass
import logging
import os
import pickle
import platform
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.memory import free_memory
from fynjax._core.progress import advance, listening

Arrays = tuple[np.ndarray, ...]
"""What a part gives."""
PartFunction = Callable[..., tuple[Array | np.ndarray, ...]]
"""`function(part, *shared)`: of a module, so that another process can import it."""

_RETRIES = 2
"""How often a part is tried again where a disk or memory failed; it may be another machine's."""
_AHEAD = 4
"""Parts sent for each worker before the first of them is back."""
_POLL_SECONDS = 5.0
_CONNECT_SECONDS = 15.0
_LARGEST_SHARE = 0.9
"""Of the free memory, for all workers together."""
_LEAST_MEMORY = 2 * 2**30
"""Of a worker: compiling alone takes about half of it [bytes]."""
_WAIT_FOR_DEVICE = 2.0
_SHOWN = 3
_CANCELLED = (asyncio.CancelledError, concurrent.futures.CancelledError)


@dataclass(frozen=True)
class Workers:
    """Where the parts of a job are done: in this process, unless one of the two is given.

    `count` processes on this machine, of one thread and an equal share of the memory each; or the
    workers of a dask `scheduler` that runs already, by its address. Both need the extra `cluster`.
    Results are the same. Processes import the caller's script: one that uses `count` runs its
    commands under `if __name__ == "__main__":`.

    Raises `InputError` for both at once, and for a count below one.
    """

    count: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.count is not None and self.scheduler is not None:
            raise InputError(
                "workers are started here (a number of them), or are those of a scheduler; give "
                "one of the two"
            )
        if self.count is not None and self.count < 1:
            raise InputError(f"the number of workers must be at least 1, but is {self.count}")


@dataclass(frozen=True)
class _Settings:
    """What a process must have in common with the one that asks."""

    versions: dict[str, str]
    environment: dict[str, str]
    config: dict[str, Any]
    pinned: bool
    """Each worker to a core of its own."""


@dataclass(frozen=True)
class _Answer:
    """Of a part: its arrays, or why there are none."""

    arrays: Arrays | None
    error: str = ""
    where: str = ""
    """A traceback."""
    warnings: tuple[str, ...] = ()


@dataclass
class _Failures:
    """Of the parts of one call."""

    lines: list[str] = field(default_factory=list)
    file: Path | None = None


class Pool:
    """Does parts; `at_work` makes one."""

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
        first = 0 if journal is None else journal.reserve(len(parts))
        open_parts = []
        for i in range(len(parts)):
            kept = None if journal is None else journal.kept(first + i)
            if kept is None:
                open_parts.append(i)
                continue
            advance(1 if sizes is None else sizes[i], part=names[i])
            yield i, kept
        failures = _Failures()
        answers = self._answers(function, parts, open_parts, shared)
        with contextlib.closing(answers):
            for i, answer in answers:
                for text in answer.warnings:
                    warnings.warn(text, stacklevel=2)
                if answer.arrays is None:
                    failures.lines.append(f"{names[i]}: {answer.error}")
                    if journal is not None:
                        text = _report(names[i], function, parts[i], answer)
                        failures.file = journal.put_failure(first + i, text)
                else:
                    if journal is not None:
                        journal.put(first + i, answer.arrays)
                    yield i, answer.arrays
                advance(1 if sizes is None else sizes[i], part=names[i])
        if failures.lines:
            raise InputError(_sentence(failures, len(parts), journal is not None))

    def all(
        self, function: PartFunction, parts: Sequence[Any], *shared: Any, **how: Any
    ) -> list[Arrays]:
        """The arrays of all parts, in their order; arguments and errors as `each`."""
        done = dict(self.each(function, parts, *shared, **how))
        return [done[i] for i in range(len(parts))]

    def _answers(
        self,
        function: PartFunction,
        parts: Sequence[Any],
        open_parts: Sequence[int],
        shared: tuple[Any, ...],
    ) -> Generator[tuple[int, _Answer], None, None]:
        for i in open_parts:
            yield i, _here(function, parts[i], shared)


class _DaskPool(Pool):
    """Of the workers of a dask client."""

    def __init__(self, client: Any, settings: _Settings) -> None:
        self._client, self._settings = client, settings

    def _answers(
        self,
        function: PartFunction,
        parts: Sequence[Any],
        open_parts: Sequence[int],
        shared: tuple[Any, ...],
    ) -> Generator[tuple[int, _Answer], None, None]:
        distributed = require("distributed", "cluster")
        client = self._client
        if not open_parts:
            return
        todo = list(reversed(open_parts))
        doing: dict[Any, int] = {}
        try:
            # By a task, not by scatter: that of a worker that died is done again.
            given = _submitted(client, _same, shared)
            while todo or doing:
                threads = sum(client.nthreads().values())
                while todo and len(doing) < _AHEAD * max(threads, 1):
                    i = todo.pop()
                    call = (_there, function, parts[i], given, self._settings)
                    doing[_submitted(client, *call, retries=_RETRIES)] = i
                try:
                    with client.as_current():
                        done = distributed.wait(
                            list(doing), timeout=_POLL_SECONDS, return_when="FIRST_COMPLETED"
                        ).done
                except TimeoutError:
                    advance(0, workers=len(client.nthreads()))
                    continue
                for future in sorted(done, key=doing.__getitem__):
                    if future.status in ("lost", "pending"):
                        continue  # its worker died before it was fetched: it is done again
                    i = doing.pop(future)
                    if future.status == "finished":
                        yield i, future.result()
                    elif future.status == "error":
                        yield i, _died(future.exception())
                    else:
                        raise _lost(client)
                    future.release()
        except (*_CANCELLED, OSError, RuntimeError) as error:
            if isinstance(error, RuntimeError) and client.status == "running":
                raise
            raise _lost(client) from error
        finally:
            with contextlib.suppress(Exception):
                client.cancel(list(doing), force=True)


@contextmanager
def at_work(workers: Workers | None = None) -> Iterator[Pool]:
    """Where the parts of a job are done, until the block ends; in this process by default.

    **Raises:** `InputError` for more workers than this machine has cores or memory for, and for a
    scheduler that does not answer, has no workers, or workers that are not fit: of another version,
    of several threads, more than accelerators on one machine. `MissingExtraError` without dask.
    """
    if workers is None or workers == Workers():
        yield Pool()
        return
    distributed = require("distributed", "cluster")
    with _quiet():
        if workers.count is not None:
            settings = _settings(this_machine=True)
            memory = _share_of_memory(workers.count)
            keep: dict[str, Any] = {
                f"distributed.worker.memory.{name}": False for name in ("target", "spill", "pause")
            }
            dask = require("dask", "cluster")
            with contextlib.ExitStack() as stack:
                scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="fynjax-workers-"))
                # One part at a time, so that none is blamed for a worker that died of another.
                keep["distributed.scheduler.worker-saturation"] = 1.0
                stack.enter_context(dask.config.set(keep))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of ports, which nobody asked for
                    cluster = distributed.LocalCluster(
                        n_workers=workers.count, threads_per_worker=1, processes=True,
                        host="127.0.0.1", dashboard_address="127.0.0.1:0",
                        scheduler_kwargs={"dashboard": False}, memory_limit=memory,
                        silence_logs=logging.CRITICAL, local_directory=scratch,
                        env=settings.environment,
                    )  # fmt: skip
                stack.enter_context(cluster)
                client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
                _check_workers(client, settings, "here")
                yield _DaskPool(client, settings)
            return
        settings = _settings(this_machine=False)
        address = str(workers.scheduler)
        try:
            client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(
                f"no dask scheduler answers at {address!r}; start one with `dask scheduler`, which "
                "prints its address, such as tcp://192.168.0.10:8786"
            ) from error
        try:
            try:
                client.wait_for_workers(1, timeout=_CONNECT_SECONDS)
            except TimeoutError as error:
                raise InputError(
                    f"the scheduler at {address} has no workers; start some with "
                    f"`dask worker {address} --nthreads 1 --nworkers 2`"
                ) from error
            _check_workers(client, settings, f"at {address}")
            yield _DaskPool(client, settings)
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=2)


def _share_of_memory(count: int) -> int:
    """Of each of so many workers here [bytes]; refuses more than there are cores, or room, for."""
    cores, limit = _machine()
    if count > cores:
        raise InputError(
            f"this process may use {cores} cores, but {count} workers were asked for: each takes "
            "one. Ask for fewer, or give the scheduler of a cluster"
        )
    share = int(_LARGEST_SHARE * limit / count)
    if share < _LEAST_MEMORY:
        raise InputError(
            f"{count} workers would have {share / 2**30:.1f} GiB of memory each, but need "
            f"{_LEAST_MEMORY / 2**30:.0f} GiB or more: ask for fewer"
        )
    return share


def _machine() -> tuple[int, int]:
    """Cores and memory [bytes] that this process may take; those of a container where it is in
    one."""
    cores = require("dask.system", "cluster").CPU_COUNT
    limit = require("distributed.system", "cluster").MEMORY_LIMIT
    return int(cores), min(int(limit), free_memory())


def _settings(*, this_machine: bool) -> _Settings:
    """Those of this process."""
    config = {name: getattr(jax.config, name) for name in _CONFIG}
    if this_machine:
        config |= {name: getattr(jax.config, name) for name in _CACHE}
    environment = {
        "JAX_ENABLE_X64": str(int(config["jax_enable_x64"])),
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", ""),
        "TF_CPP_MIN_LOG_LEVEL": os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1"),
        # XLA cuts sums into as many pieces as it has threads, and rounds each: as many as here, on
        # whatever machine. Workers of this machine have them on one core.
        "NPROC": os.environ.get("NPROC") or str(_own_cores()),
        **_ONE_THREAD,
    }
    if config["jax_platforms"]:
        environment["JAX_PLATFORMS"] = config["jax_platforms"]
    return _Settings(_versions(), environment, config, pinned=this_machine)


def _own_cores() -> int:
    """That XLA takes this process to have."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_CONFIG = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_platforms",
)
"""What decides numbers."""
_CACHE = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}


def _versions() -> dict[str, str]:
    names = ("fynjax", "jax", "jaxlib", "numpy", "equinox")
    python = ".".join(platform.python_version_tuple()[:2])
    found = {name: metadata.version(name) for name in names}
    return {"Python": python, **found}


def _check_workers(client: Any, settings: _Settings, where: str) -> None:
    """Prepare all workers that there are, or say why one is not fit."""
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
            f"the workers {where} cannot run fynjax: {_words(error)}. Is the same fynjax installed "
            "there?"
        ) from error
    for address, why in found.items():
        if why:
            raise InputError(f"the worker {address} is not fit: {why}")


def _submitted(client: Any, *call: Any, retries: int = 0) -> Any:
    """The future of a call, which must be one that can be sent."""
    try:
        return client.submit(*call, pure=False, retries=retries)
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise TypeError(
            f"a part of a job must be one that another process can be sent: {_words(error)}"
        ) from error


def _same(value: Any) -> Any:
    return value


def _here(function: PartFunction, part: Any, shared: tuple[Any, ...]) -> _Answer:
    """A part in this process. What of its machine fails, such as a full disk, fails it too."""
    try:
        return _done(function, part, shared)
    except (OSError, MemoryError) as error:
        return _Answer(None, _words(error), traceback.format_exc())


def _there(
    function: PartFunction, part: Any, shared: tuple[Any, ...], settings: _Settings
) -> _Answer:
    """A part on a worker, which may have been started after the others were prepared. What of its
    machine fails is raised: dask tries that again."""
    if why := _unfit(settings):
        return _Answer(None, f"the worker on {platform.node()} is not fit: {why}")
    if settings.pinned:
        _take_core()
    return _done(function, part, shared)


def _done(function: PartFunction, part: Any, shared: tuple[Any, ...]) -> _Answer:
    with listening(None), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        try:
            arrays = tuple(np.asarray(array) for array in function(part, *shared))
        except (OSError, MemoryError):
            raise
        except Exception as error:
            return _Answer(None, _words(error), traceback.format_exc())
    return _Answer(arrays, warnings=tuple(str(w.message) for w in caught))


_preparing = threading.Lock()
_prepared: _Settings | None = None
_core: int | None = None
"""Of this process's own, where it has one."""
_device: Any = None
"""The lock on this process's accelerator, held until it ends."""


def _unfit(settings: _Settings) -> str:
    """Take the settings of the process that asks; why this worker is not fit, or nothing."""
    global _prepared
    with _preparing:
        if _prepared == settings:
            return ""
        own = _versions()
        other = [
            f"{n} {own[n]}, not {version}"
            for n, version in settings.versions.items()
            if own[n] != version
        ]
        if other:
            return "it has " + ", ".join(other)
        os.environ.update(settings.environment)
        for name, value in settings.config.items():
            if name == "jax_compilation_cache_dir" and value is not None:
                with contextlib.suppress(OSError):
                    Path(value).mkdir(parents=True, exist_ok=True)
            jax.config.update(name, value)
        if why := _take_device():
            return why
        _prepared = settings
        return ""


def _take_core() -> None:
    """Keep the thread that computes, and those that XLA will start from it, on a core of their
    own: that of the worker's number."""
    global _core
    if _core is not None or not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    _core = cores[int(require("distributed", "cluster").get_worker().name) % len(cores)]
    os.sched_setaffinity(0, {_core})


def _take_device() -> str:
    """Take one of this machine's accelerators for this process, before JAX looks for them."""
    global _device
    if _device is not None or os.environ.get("JAX_PLATFORMS", "") == "cpu":
        return ""
    if not metadata.entry_points(group="jax_plugins"):
        return ""
    stated = os.environ.get("CUDA_VISIBLE_DEVICES")
    if stated is None:
        names = [str(i) for i in range(len(list(Path("/dev").glob("nvidia[0-9]*"))))]
    else:
        names = [name.strip() for name in stated.split(",") if name.strip()]
    if not names:
        return ""
    from filelock import FileLock, Timeout

    for name in names:
        lock = FileLock(Path(tempfile.gettempdir()) / f"fynjax-device-{getpass.getuser()}-{name}")
        try:
            lock.acquire(timeout=_WAIT_FOR_DEVICE)  # a worker that died may just be going
        except Timeout:
            continue
        _device = lock
        os.environ["CUDA_VISIBLE_DEVICES"] = name
        return ""
    return (
        f"its machine has {len(names)} accelerators, each taken by another worker: start as many "
        "workers, or set JAX_PLATFORMS=cpu"
    )


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError) else f"{type(error).__name__}: {text}"


def _died(error: BaseException) -> _Answer:
    """Of a part that dask gave up."""
    if type(error).__name__ == "KilledWorker":
        return _Answer(
            None,
            "every worker that tried it died, as one does that takes more memory than it has; give "
            "workers more memory, which fewer of them have",
        )
    return _Answer(None, _words(error))


def _lost(client: Any) -> InputError:
    return InputError(
        "the dask scheduler is gone, and with it what its workers were doing. Results that had "
        "come back are kept where the command keeps a checkpoint: start the scheduler and its "
        "workers, and give the same command again"
    )


def _report(name: str, function: PartFunction, part: Any, answer: _Answer) -> str:
    """How a part failed, with its inputs."""
    what = f"{function.__module__}.{function.__qualname__}"
    return f"{name}\n{answer.error}\n\n{answer.where}\nComputed by {what} of\n{part!r}\n"


def _sentence(failures: _Failures, count: int, kept: bool) -> str:
    """Which parts failed, in one line."""
    lines = failures.lines
    if count == 1 and len(lines) == 1:
        return lines[0]
    text = f"{len(lines)} of {count} parts failed: " + "; ".join(lines[:_SHOWN])
    if len(lines) > _SHOWN:
        text += f"; and {len(lines) - _SHOWN} more"
    if failures.file is not None:
        text += f". Inputs and tracebacks are in {failures.file.parent}"
    if kept:
        text += ". The others are kept, and the same command tries only these again"
    return text


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what dask logs of workers that come and go: the parts' errors say it."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)
