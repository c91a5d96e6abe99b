"""Memory that the machine, a container and limits (`ulimit`) leave this process, in bytes."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from fynjax._core.errors import InputError

_GROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
_LEAST = 1 << 28
"""Bytes that a file may take at least, where nearly nothing is free."""


def total_memory() -> int:
    """Memory that this process may take in all [bytes]."""
    return int(min([psutil.virtual_memory().total, *_limits(0), *_own_limits()]))


def free_memory() -> int:
    """Memory that this process can still take without others being moved out [bytes]."""
    left = [limit - psutil.Process().memory_info().vms for limit in _own_limits()]
    return max(int(min([psutil.virtual_memory().available, *_limits(1), *left])), 0)


def peak_memory() -> int:
    """Most memory that this process has held so far [bytes]."""
    peak = getattr(psutil.Process().memory_info(), "peak_wset", None)  # Windows alone keeps it
    if peak is None:
        import resource  # Unix alone has it

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        peak *= 1 if sys.platform == "darwin" else 1024
    return int(peak)


@contextmanager
def bounded_memory(file: str | Path) -> Iterator[None]:
    """A block in which a library unfolds a file, to what cannot be known before: on Linux it gets
    half of the free memory, and then an `InputError` that names the file."""
    if sys.platform != "linux":
        yield
        return
    import resource

    budget = max(free_memory() // 2, _LEAST)
    before, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = int(psutil.Process().memory_info().data) + budget
    if before == resource.RLIM_INFINITY or limit < before:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
    try:
        yield
    except MemoryError as error:
        raise InputError(
            f"it unfolds to more than {budget / 2**30:.2g} GiB, half of the free memory: damaged?",
            file=file,
        ) from error
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, most))


def _own_limits() -> list[int]:
    """Limits of the memory of this process [bytes]."""
    if sys.platform == "win32":
        return []
    import resource

    found = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
    return [limit for limit in found if limit != resource.RLIM_INFINITY]


def _limits(free: int) -> list[int]:
    """Limits of the groups that this process is in, or (`free` 1) what they leave [bytes]."""
    found: list[int] = []
    text = _OWN_GROUPS.read_text("utf-8") if _OWN_GROUPS.is_file() else ""
    for kinds, path in (line.split(":", 2)[1:] for line in text.splitlines()):
        names, root = ("memory.max", "memory.current"), _GROUPS
        if "memory" in kinds.split(","):
            names, root = ("memory.limit_in_bytes", "memory.usage_in_bytes"), _GROUPS / "memory"
        elif kinds:
            continue
        for one in (root / path.strip("/") / "end").parents:
            with suppress(OSError, ValueError):  # "max" is no number
                limit, used = (int((one / name).read_text("utf-8")) for name in names)
                found.append(limit - free * used)
    return found
