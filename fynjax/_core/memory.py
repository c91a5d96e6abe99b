"""Memory that the machine, a container and limits (`ulimit`) leave this process, in bytes."""

import sys
import threading
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
    return int(min([psutil.virtual_memory().total, *_limits(0), *_own_limits().values()]))


def free_memory() -> int:
    """Memory that this process can still take without others being moved out [bytes]."""
    used = psutil.Process().memory_info()
    taken = {"RLIMIT_AS": used.vms, "RLIMIT_DATA": getattr(used, "data", used.vms)}
    left = [limit - taken[kind] for kind, limit in _own_limits().items()]
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
    with _Budget.shared() as budget:
        try:
            yield
        except MemoryError as error:
            raise InputError(
                f"it unfolds to more than the {budget / 2**30:.2g} GiB that there is room for: "
                "damaged?",
                file=file,
            ) from error


class _Budget:
    """The limit of this process's data while files are unfolded: set by the first of the threads
    that do so, taken back by the last."""

    lock = threading.Lock()
    users = 0
    before, bytes = (0, 0), 0

    @classmethod
    @contextmanager
    def shared(cls) -> Iterator[int]:
        import resource

        kind = resource.RLIMIT_DATA
        with cls.lock:
            if cls.users == 0:
                cls.bytes = max(free_memory() // 2, _LEAST)
                cls.before = now, most = resource.getrlimit(kind)
                limit = int(psutil.Process().memory_info().data) + cls.bytes
                if now == resource.RLIM_INFINITY or limit < now:
                    resource.setrlimit(kind, (limit, most))
            cls.users += 1
        try:
            yield cls.bytes
        finally:
            with cls.lock:
                cls.users -= 1
                if cls.users == 0:
                    resource.setrlimit(kind, cls.before)


def _own_limits() -> dict[str, int]:
    """Limits of the address space and of the data of this process [bytes], those that are set."""
    if sys.platform == "win32":
        return {}
    import resource

    kinds = ("RLIMIT_AS", "RLIMIT_DATA")
    found = {kind: resource.getrlimit(getattr(resource, kind))[0] for kind in kinds}
    return {kind: limit for kind, limit in found.items() if limit != resource.RLIM_INFINITY}


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
