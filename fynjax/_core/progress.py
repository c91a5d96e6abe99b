"""How a long job reports its progress to its caller. The job knows nothing of terminals."""

from contextlib import AbstractContextManager, nullcontext
from typing import Protocol, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """What a job may call. Stages may nest; `advance` moves the innermost open stage."""

    def stage(self, name: str, total: int | None = None) -> AbstractContextManager[None]:
        """Open a stage called `name` of `total` steps (`None`: unknown), until the block ends."""
        ...

    def advance(self, n: int = 1, **info: float | str) -> None:
        """Count `n` steps of the open stage; `info` is shown beside it, such as `loss=0.3`."""
        ...


class NullProgress:
    """Reports nothing: the default of every job."""

    def stage(self, name: str, total: int | None = None) -> AbstractContextManager[None]:
        """Open a stage that is not reported."""
        return nullcontext()

    def advance(self, n: int = 1, **info: float | str) -> None:
        """Do nothing."""
