"""A dry run: a job reads and checks its inputs, and ends before its work."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

_plans: ContextVar[list[Any] | None] = ContextVar("fynjax.dry_run", default=None)
"""Scenes that a dry run has counted; None: this is none."""
_checks: ContextVar[list[Callable[[Iterable[str]], None]]] = ContextVar("fynjax.checks")
"""What looks at the names of the files before the work begins; empty once it has."""


class DryRunEnd(Exception):
    """The end of a dry run: every input was read and checked, nothing was computed or written."""

    def __init__(self, files: Mapping[str, str], plan: Any = None) -> None:
        super().__init__("every input was read and checked; nothing was computed or written")
        self.files = dict(files)
        """The main files that the job would write, by name, with their sizes where known."""
        self.plan = plan
        """Plan of the scene that the job would plant, with its memory; None: none so far."""
        self.warnings: list[str] = []
        """What the command warned of until then."""


@contextmanager
def dry_run() -> Iterator[None]:
    """Jobs in the block read and check their inputs, and end before their work with `DryRunEnd`,
    or with the error that the run would end with. Scenes that are built there have no plants.

    >>> from fynjax import jobs
    >>> try:
    ...     with jobs.dry_run():
    ...         jobs.plant("Metalasia muricata", "plant", n_elements=500)
    ... except jobs.DryRunEnd as end:
    ...     print(end.files["elements.csv"])
    500 area elements
    """
    before = _plans.set([])
    try:
        yield
    finally:
        _plans.reset(before)


@contextmanager
def checked_before_work(check: Callable[[Iterable[str]], None]) -> Iterator[None]:
    """The first job that begins its work in the block gives the names of its files to `check`,
    which raises where they cannot be written: an hour of work is not done in vain."""
    before = _checks.set([check])
    try:
        yield
    finally:
        _checks.reset(before)


def rehearsing() -> bool:
    """Whether this is a dry run: what takes long is left out."""
    return _plans.get() is not None


def counted(plan: Callable[[Any], Any]) -> bool:
    """Whether this is a dry run, for which `plan` counts what would be planted; it is given what
    was counted before, or None."""
    plans = _plans.get()
    if plans is None:
        return False
    plans.append(plan(plans[-1] if plans else None))
    return True


def begin_work(files: Mapping[str, str], inputs: Iterable[object] = ()) -> None:
    """What a job calls when every input is read and checked: a dry run ends here.

    **Arguments:**

    - `files`: the main files that will be written, by name, with their sizes where known.
    - `inputs`: those that a run reads one by one as it works on them; a dry run reads them here.

    **Raises:** `DryRunEnd` in the block of `dry_run`, with the last scene that was counted; what a
    check of the names raises (`checked_before_work`).
    """
    checks = _checks.get([])
    if checks:
        checks.pop()(files)
    plans = _plans.get()
    if plans is not None:
        for _ in inputs:
            pass
        raise DryRunEnd(files, plans[-1] if plans else None)


def image_size(shape: tuple[int, ...], bands: int) -> str:
    """An image of rows and columns in words."""
    return f"{shape[0]} rows and {shape[1]} columns of pixels, {bands} bands"
