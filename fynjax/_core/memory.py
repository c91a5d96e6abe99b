"""Memory of this machine and of this process, on any system, in bytes."""

import sys

import psutil


def total_memory() -> int:
    """Memory of this machine [bytes]."""
    return int(psutil.virtual_memory().total)


def free_memory() -> int:
    """Memory that a process can still take without others being moved out [bytes]."""
    return int(psutil.virtual_memory().available)


def peak_memory() -> int:
    """Most memory that this process has held so far [bytes]."""
    peak = getattr(psutil.Process().memory_info(), "peak_wset", None)  # Windows alone keeps it
    if peak is None:
        import resource  # Unix alone has it

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        peak *= 1 if sys.platform == "darwin" else 1024
    return int(peak)
