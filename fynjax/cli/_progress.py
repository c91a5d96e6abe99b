"""Progress bars on stderr."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichProgress
from rich.text import Text

from fynjax._core.progress import NullProgress, Progress


class _Count(ProgressColumn):
    """'3/10' where the total is known, nothing where it is not."""

    def __init__(self) -> None:
        super().__init__()
        self._known = MofNCompleteColumn()

    def render(self, task: Task) -> Text:
        return self._known.render(task) if task.total is not None else Text("")


def _shown(info: dict[str, float | str]) -> str:
    return "  ".join(
        f"{name} {value if isinstance(value, str) else f'{value:.4g}'}"
        for name, value in info.items()
    )


class TerminalProgress:
    """One bar for each stage: name, bar, count, time used, time left, and what the job reports."""

    def __init__(self, console: Console) -> None:
        self._bars = RichProgress(
            SpinnerColumn(finished_text="✓"),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            _Count(),
            TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=False),
            TextColumn("{task.fields[info]}"),
            console=console,
        )
        self._open: list[tuple[int, int | None]] = []

    @contextmanager
    def stage(self, name: str, total: int | None = None) -> Iterator[None]:
        """Show a bar called `name` until the block ends."""
        label = "  " * len(self._open) + name
        if not self._open:
            self._bars.start()
        task = self._bars.add_task(label, total=total, info="")
        self._open.append((task, total))
        try:
            yield
            # A job may end early (converged) or not count at all: the bar is full all the same.
            done = total if total is not None else 1
            self._bars.update(task, total=done, completed=done)
        finally:
            self._bars.stop_task(task)
            self._open.pop()
            if not self._open:
                self._bars.stop()

    def advance(self, n: int = 1, **info: float | str) -> None:
        """Move the innermost bar by `n` and show `info` beside it."""
        if self._open:
            task = self._open[-1][0]
            self._bars.update(task, advance=n)  # type: ignore[arg-type]
            if info:
                self._bars.update(task, info=_shown(info))  # type: ignore[arg-type]


def make_progress(*, quiet: bool) -> Progress:
    """Bars if stderr is a terminal and the user wants them, else silence."""
    console = Console(stderr=True)
    return NullProgress() if quiet or not console.is_terminal else TerminalProgress(console)
