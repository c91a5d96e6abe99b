"""A dry run: a job reads and checks its inputs, and ends before its work."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

_asked: ContextVar[bool] = ContextVar("fynjax.dry_run", default=False)


class DryRunEnd(Exception):
    """The end of a dry run: every input was read and checked, nothing was computed or written."""

    def __init__(self, files: Mapping[str, str]) -> None:
        super().__init__("every input was read and checked; nothing was computed or written")
        self.files = dict(files)
        """The main files that the job would write, by name, with their sizes where known."""
        self.warnings: list[str] = []
        """What the command warned of until then."""


@contextmanager
def dry_run() -> Iterator[None]:
    """Jobs in the block read and check their inputs, and end before their work with `DryRunEnd`,
    or with the error that the run would end with.

    >>> from fynjax import jobs
    >>> try:
    ...     with jobs.dry_run():
    ...         jobs.plant("Metalasia muricata", "plant", n_elements=500)
    ... except jobs.DryRunEnd as end:
    ...     print(end.files["elements.csv"])
    500 area elements
    """
    before = _asked.set(True)
    try:
        yield
    finally:
        _asked.reset(before)


def begin_work(files: Mapping[str, str], inputs: Iterable[object] = ()) -> None:
    """What a job calls when every input is read and checked: a dry run ends here.

    **Arguments:**

    - `files`: the main files that will be written, by name, with their sizes where known.
    - `inputs`: those that a run reads one by one as it works on them; a dry run reads them here.

    **Raises:** `DryRunEnd` in the block of `dry_run`.
    """
    if _asked.get():
        for _ in inputs:
            pass
        raise DryRunEnd(files)


def image_size(shape: tuple[int, ...], bands: int) -> str:
    """An image of rows and columns in words."""
    return f"{shape[0]} rows and {shape[1]} columns of pixels, {bands} bands"
