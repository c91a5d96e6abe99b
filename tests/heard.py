"""Who listens to long work in tests."""

from collections.abc import Iterator
from contextlib import contextmanager

from fynjax._core.progress import listening


class Heard:
    """What was told."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, int | None]] = []
        self.steps: list[int] = []
        self.shown: list[dict[str, float | str]] = []

    @property
    def count(self) -> int:
        """Steps of all stages."""
        return sum(self.steps)

    @contextmanager
    def stage(self, name: str, total: int | None) -> Iterator[None]:
        self.stages.append((name, total))
        yield

    def advance(self, n: int, **info: float | str) -> None:
        self.steps.append(n)
        self.shown.append(info)


@contextmanager
def hearing(last: int = 0, error: type[BaseException] = KeyboardInterrupt) -> Iterator[Heard]:
    """Notes what the block tells, and interrupts it with `error` at the step of number `last`."""
    heard = Heard()
    note = heard.advance

    def advance(n: int, **info: float | str) -> None:
        note(n, **info)
        if last and heard.count == last:
            raise error

    heard.advance = advance  # type: ignore[method-assign]
    with listening(heard):
        yield heard
