"""A run of a job: its folder, what it may replace there, how it ends, and its summary."""

import _thread
import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TextIO

from fynjax._core.compiler import keep_compiled
from fynjax._core.dry_run import DryRunEnd, dry_run
from fynjax._core.errors import InputError, printable

if TYPE_CHECKING:
    from fynjax.app.jobs import JobResult

DOUBTFUL = 3
"""Exit status with `--strict` where a result is to be doubted."""
_TERMINATED = 143
"""Exit status of `kill`, as shells have it."""


def _messages(caught: Sequence[warnings.WarningMessage]) -> list[str]:
    return list(dict.fromkeys(" ".join(str(warning.message).split()) for warning in caught))


def _say(line: str, file: TextIO | None = None) -> None:
    """Print a line, which may show names from files, on stdout or `file`."""
    print(printable(line), file=file)


def show_dry_run(
    start: Callable[[], "JobResult"], output: Path, *, as_json: bool, quiet: bool
) -> None:
    """Print what a command would write, once its inputs are read and checked."""
    try:
        with dry_run():
            start()
    except DryRunEnd as end:
        for line in end.warnings:
            _say(f"fynjax: warning: {line}", file=sys.stderr)
        if as_json:
            record = {"output": str(output), "files": end.files, "warnings": end.warnings}
            record |= {} if end.plan is None else {"plan": end.plan.record()}
            print(json.dumps(record, indent=2))
        elif not quiet:
            print("Every input was read and checked; nothing was computed or written.")
            if end.plan is not None:
                print(end.plan)
            _say(f"The run would write to {output}, among others")
            show_files(end.files)


def _stated_files() -> list[Path]:
    """Files that the command line may name: input, which no run replaces or removes."""
    return [Path(text.split("=", 1)[-1]).absolute() for text in sys.argv[1:] if text]


def _ways(path: Path) -> set[str]:
    """A path as it is, where links lead, if they do, and the file itself, whatever its names."""
    found = {os.path.normcase(path)}
    with suppress(OSError, RuntimeError, ValueError):  # a loop of links, no name
        found.add(os.path.normcase(path.resolve()))
        state = path.stat()
        found.add(f"{state.st_dev}:{state.st_ino}")
    return found


class _Guard:
    """Lets a run replace and remove in its folder what an earlier run of the command wrote there
    and nobody changed since, and never an input of its own."""

    def __init__(self, output: Path, command: str, overwrite: bool, read: Collection[Path]) -> None:
        """`read` has the inputs of the run, as it goes on; with `overwrite` other files are
        replaced, too."""
        from fynjax.app.io.text import SUMMARY, EarlierRun

        self._output, self._overwrite, self._read = output, overwrite, read
        self._earlier = EarlierRun(output, command)
        self._earlier_names = list(self._earlier.hashes)
        inputs = self._inputs()
        self._refuse_strange(
            name for name in (SUMMARY, *self._earlier_names)
            if not _ways(output.absolute() / name) & inputs  # stays, edited or not
        )  # fmt: skip

    def _inputs(self) -> set[str]:
        return set().union(*map(_ways, [*_stated_files(), *self._read]))

    def check(self, names: Iterable[str]) -> None:
        """Raise `InputError` where a file of these names may not be replaced."""
        names, inputs = list(names), self._inputs()
        for name in names:
            path = self._output.absolute() / name
            if _ways(path) & inputs and os.path.lexists(path):
                raise InputError(
                    "this is an input of the run, which its result of the same name would "
                    "replace. Give another --output",
                    file=self._output / name,
                )
        for name, why in self._earlier.in_the_way(names).items():
            raise InputError(
                f"no result can be written here: {why}. Give another --output",
                file=self._output / name,
            )
        self._refuse_strange(names)

    def _refuse_strange(self, names: Iterable[str]) -> None:
        for name, why in self.strange(names).items():
            if not self._overwrite:
                raise InputError(
                    f"this file is kept: {why}. Give another --output, or --overwrite to replace "
                    "what is not of such a run",
                    file=self._output / name,
                )

    def strange(self, names: Iterable[str]) -> dict[str, str]:
        """Files of these names that no earlier run wrote so."""
        return self._earlier.strange(names)

    def said(self, names: Sequence[str]) -> list[str]:
        """Warnings of a run whose results are the files `names`: a line for each file that it
        replaces and no earlier run wrote as it is, and for each that stays beside the new ones."""
        lines = [f"replaced {self._output / n}: {why}" for n, why in self.strange(names).items()]
        left = [name for name in self._earlier_names if name not in names]
        return lines + [
            f"kept {self._output / name} of an earlier run: {why}"
            for name, why in self.strange(left).items()
        ]

    def removable(self) -> list[str]:
        """Files of the earlier run that are as it wrote them."""
        return self._earlier.unchanged()

    def kept(self) -> list[Path]:
        """Input, which stays."""
        return [*_stated_files(), *self._read]


@contextmanager
def _alone(output: Path) -> Iterator[None]:
    """Only one run at a time, of one machine, writes into a folder. What runs left there that were
    killed long ago is cleared away."""
    from filelock import FileLock, Timeout

    from fynjax.app.io.text import remove_abandoned

    folder = output.resolve()
    missing = [parent for parent in folder.parents if not parent.exists()]
    # Beside the folder: runs with other homes or caches know it, too.
    path = folder.with_name(f".{folder.name}.lock")
    lock = FileLock(path)
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=0)
        except Timeout:
            raise InputError(
                f"another run is writing into {output}: wait for its end, or give another --output"
            ) from None
        except (OSError, RuntimeError):
            yield  # a file system that cannot be written, which is said later, or without locks
            return
        try:
            remove_abandoned(output)
            yield
        finally:
            with suppress(OSError):  # Windows removes no file that is open
                path.unlink()
            lock.release()
    finally:
        for parent in missing:
            with suppress(OSError):
                parent.rmdir()


_AGAIN_SECONDS = 0.05


@contextmanager
def _ended_by_kill() -> Iterator[Callable[[], None]]:
    """Let `kill` end a job as Ctrl-C does, so that what is unfinished is cleared away.

    Python drops what is raised inside the callback of a library, such as JAX's after a garbage
    collection, and only says so: then the signal is sent again. The block calls what it is given
    before results are moved, in case one was dropped at the very end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    killed = []

    def end(*_: object) -> None:
        killed.append(True)
        sys.exit(_TERMINATED)

    def check() -> None:
        if killed:
            sys.exit(_TERMINATED)

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        again = signal.SIGTERM if killed else signal.SIGINT
        if isinstance(what.exc_value, KeyboardInterrupt | SystemExit):
            # Later: it would be dropped here, too.
            threading.Timer(_AGAIN_SECONDS, _thread.interrupt_main, (again,)).start()
        else:
            say(what)

    say, sys.unraisablehook = sys.unraisablehook, dropped
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield check
    finally:
        signal.signal(signal.SIGTERM, before)
        sys.unraisablehook = say


def ignore_ctrl_c() -> None:
    """Let a process that ends do so: a Ctrl-C would show the traceback of what it interrupts."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _check_written(result: "JobResult", folder: Path, output: Path) -> None:
    """Refuse results that another process removed while the run wrote others."""
    lost = [name for name in result.files if not (folder / name).exists()]
    if lost:
        raise InputError(
            f"{len(lost)} of {len(result.files)} results, such as {lost[0]}, were removed while "
            "the run wrote the others, so none was kept. Give the command again",
            file=output,
        )


def _end(end: KeyboardInterrupt | SystemExit, checkpoint: Path | None) -> NoReturn:
    """End the process of a run that was interrupted or killed, and say what is kept of it."""
    ignore_ctrl_c()
    killed = isinstance(end, SystemExit)
    if killed and getattr(end, "code", None) != _TERMINATED:
        raise end
    kept = "nothing was written"
    if checkpoint is not None and checkpoint.is_dir():
        kept = f"{checkpoint} keeps what was done, and the same command goes on with it"
    _say(f"fynjax: {'ended' if killed else 'interrupted'}; {kept}", file=sys.stderr)
    sys.exit(_TERMINATED if killed else 130)


def run_job(
    command: str,
    job: Callable[[Path], "JobResult"],
    output: Path,
    *,
    as_json: bool,
    quiet: bool,
    overwrite: bool = False,
    checkpoint: Path | None = None,
    forget: bool = False,
) -> "JobResult":
    """Run `job(folder)`, print its result and return it.

    Where an interrupted job leaves a `checkpoint`, a line names it; with `forget` its journal goes
    in the end. The job writes into a
    folder beside `output`, whose files are moved to `output` when all of it has succeeded. Then
    those files go that an earlier run of the same command wrote and this one did not: they would
    stand beside results that they do not belong to. A file that is no such run's, or that was
    changed since, is neither replaced nor removed, but with `overwrite`; an input of the run never
    (`_Guard`). That is checked before the job, when it begins its work, and at the end. Warnings
    wait until then: if the job fails, its error is the only line.
    """
    from rich.console import Console

    from fynjax._core.dry_run import checked_before_work
    from fynjax._core.files import check_folder, file_hash, noting_files
    from fynjax._core.progress import progress
    from fynjax.app.io.text import SUMMARY, remove_replaced, sealed, staged_folder, write_text

    check_folder(output)
    if checkpoint is not None:
        check_folder(checkpoint)
    console = Console(stderr=True)
    bars = nullcontext() if quiet or as_json else progress(console)
    with (
        _alone(output),
        nullcontext() if checkpoint is None else _alone(checkpoint),
        _ended_by_kill() as check_killed,
        warnings.catch_warnings(record=True) as caught,
        noting_files() as read,
    ):
        guard = _Guard(output, command, overwrite, read)
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        with staged_folder(output, guard.check) as folder:
            keep_compiled()
            try:
                with bars, checked_before_work(guard.check):
                    result = job(folder)
            except (KeyboardInterrupt, SystemExit) as end:
                _end(end, checkpoint)
            except DryRunEnd as end:
                end.warnings = _messages(caught)
                raise
            _check_written(result, folder, output)
            files = sorted(p for p in folder.rglob("*") if p.is_file())
            hashes = {p.relative_to(folder).as_posix(): file_hash(p) for p in files}
            written = [*hashes, SUMMARY]
            messages = [*_messages(caught), *guard.said(written)]
            said = [*result.warnings, *messages]
            of_run = {"output": str(output), "warnings": said, "hashes": hashes}
            result = result.model_copy(update=of_run)
            seal = sealed(json.loads(result.model_dump_json()))
            text = result.model_copy(update={"hash": seal}).model_dump_json(indent=2)
            write_text(folder / SUMMARY, text + "\n")
            check_killed()
        remove_replaced(output, guard.removable(), [*written, *guard.kept()])
        if forget and checkpoint is not None:
            from fynjax._core.checkpoint import forget_journal

            forget_journal(checkpoint)
    for line in result.warnings:
        _say(f"fynjax: warning: {line}", file=sys.stderr)
    if as_json:
        print(text)
    elif not quiet:
        show(result)
    return result


def show(result: "JobResult") -> None:
    """The result in a few lines on stdout; first, why it is to be doubted."""
    if result.status != "ok":
        print(f"Status: {result.status}")
    for line in result.headline:
        _say(line)
    _say(f"Written to {result.output}")
    show_files(result.files)


def show_files(files: Mapping[str, str]) -> None:
    """Files and what they are, a line each, on stdout."""
    width = max(map(len, files), default=0)
    for name, what in files.items():
        _say(f"  {name:<{width}}  {what}".rstrip())
