"""How far long work is: work names its stages and counts its steps, and a listener shows them.

Long work says `with stage("Read"):` and `advance()`, or `for item in track(items, "Plantings"):`.
Who listens is a context variable: `progress` shows bars, and where nobody listens nothing is shown.
The beginning and the time of each stage also go to the logger `fynjax`, at the level INFO.
"""

import logging
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from importlib.util import find_spec
from typing import Protocol, TypeVar, runtime_checkable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

Item = TypeVar("Item")
_log = logging.getLogger("fynjax")
_LONG, _EVERY = 1.0, 30.0
"""Stages of so many seconds have a line where there are no bars, and another after so many."""


@runtime_checkable
class Listener(Protocol):
    """Shows stages, which may nest, and the steps of the innermost open one."""

    def stage(self, name: str, total: int | None) -> AbstractContextManager[None]:
        """A stage of `total` steps (`None`: unknown) that is open until the block ends."""
        ...

    def advance(self, n: int, **info: float | str) -> None:
        """`n` steps of the innermost open stage are done; `info` is shown beside its bar."""
        ...


_listener: ContextVar[Listener | None] = ContextVar("fynjax.progress", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Let `listener` alone show the stages of the block; with `None` nobody does."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


@contextmanager
def stage(name: str, total: int | None = None) -> Iterator[None]:
    """A stage of long work, of `total` steps (`None`: unknown), that is open until the block
    ends."""
    listener, began = _listener.get(), time.perf_counter()
    _log.info("%s: begins", name)
    with nullcontext() if listener is None else listener.stage(name, total):
        yield
    _log.info("%s: took %.1f s", name, time.perf_counter() - began)


def advance(n: int = 1, **info: float | str) -> None:
    """Count `n` steps of the innermost open stage; `info`, such as `loss=0.3`, is shown beside."""
    listener = _listener.get()
    if listener is not None:
        listener.advance(n, **info)


def track(items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """The items, one after another, as the steps of a stage; `total` of them, if they cannot say
    how many they are."""
    with stage(name, len(items) if isinstance(items, Sized) else total):
        for item in items:
            yield item
            advance()


@contextmanager
def progress(console: Console | None = None) -> Iterator[None]:
    """Show how far long work is while the block runs, a bar for each of its stages.

    Works in a terminal, and in a notebook that has ipywidgets; elsewhere, as in the log of a batch
    job, each stage of a second or more is a line when it ends, and says every half minute how far
    it is. The logger `fynjax` has the beginning and the time of each stage whether bars are shown
    or not.

    **Arguments:** `console`, of rich; standard error if left out.

    Example: `with fx.progress(): fx.jobs.calibrate("plot.toml", "drone.tif", Path("results"))`.
    """
    if console is None:  # rich shows nothing in a notebook without ipywidgets
        console = Console(stderr=True, force_jupyter=None if find_spec("ipywidgets") else False)
    bars = console.is_terminal or console.is_jupyter
    with listening(_Bars(console) if bars else _Lines(console)):
        yield


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


class _Bars:
    """One bar for each stage: name, bar, count, time used, time left, figures of the step."""

    def __init__(self, console: Console) -> None:
        self._bars = Progress(
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
    def stage(self, name: str, total: int | None) -> Iterator[None]:
        label = "  " * len(self._open) + name
        if not self._open:
            self._bars.start()
        task = self._bars.add_task(label, total=total, info="")
        self._open.append((task, total))
        try:
            yield
            # Work may end early (converged) or not count at all: the bar is full all the same.
            done = total if total is not None else 1
            self._bars.update(task, total=done, completed=done)
        finally:
            self._bars.stop_task(task)
            self._open.pop()
            if not self._open:
                self._bars.refresh()  # in a notebook `stop` does not
                self._bars.stop()

    def advance(self, n: int, **info: float | str) -> None:
        if self._open:
            task = self._open[-1][0]
            self._bars.update(task, advance=n)  # type: ignore[arg-type]
            if info:
                self._bars.update(task, info=_shown(info))  # type: ignore[arg-type]


class _Lines:
    """A line for each stage where nothing can be drawn over: name and time used, and while it lasts
    steps and time left."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._open: list[tuple[str, int | None, list[float]]] = []
        """Name and steps of each open stage; when it last spoke, steps done, and both at the end of
        its first step, which compiles: the time left is counted from there."""

    @contextmanager
    def stage(self, name: str, total: int | None) -> Iterator[None]:
        began = time.perf_counter()
        label = "  " * len(self._open) + name
        self._open.append((label, total, [began, 0.0, began, 0.0]))
        try:
            yield
        finally:
            self._open.pop()
        if (took := time.perf_counter() - began) >= _LONG:
            self._say(f"{label}: {_spell(took)}")

    def advance(self, n: int, **info: float | str) -> None:
        if not self._open:
            return
        label, total, clock = self._open[-1]
        now, first = time.perf_counter(), clock[1] == 0.0
        clock[1] += n
        if first:
            clock[2:] = now, clock[1]
        spoke, done, since, before = clock
        if now - spoke < _EVERY:
            return
        clock[0] = now
        left = "" if total is None else f" of {total}"
        if total is not None and before < done <= total:
            left += f", {_spell((now - since) / (done - before) * (total - done))} left"
        self._say(f"{label}: {done:.0f}{left}  {_shown(info)}")

    def _say(self, line: str) -> None:
        self._console.print(line.rstrip(), markup=False, highlight=False, soft_wrap=True)


def _spell(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{seconds:.0f} s" if minutes < 2 else f"{minutes} min {rest} s"
