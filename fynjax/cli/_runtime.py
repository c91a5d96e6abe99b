"""What every command shares: options, JAX settings, the summary, and one line for an error."""

import functools
import hashlib
import inspect
import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fynjax._core.errors import InputError

if TYPE_CHECKING:
    from fynjax.jobs import JobResult

Seed = Annotated[
    int, typer.Option(min=0, max=2**31 - 1, help="Seed of everything random.", show_default=True)
]
Checkpoint = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder of the unfinished run; OUTPUT.checkpoint if left out. The same command goes "
        "on from it.",
    ),
]
WorkerCount = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        min=1,
        help="Do the parts in N processes of this machine, one core each; same results. Needs the "
        "extra `cluster`.",
    ),
]
SchedulerAddress = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Do the parts on the workers of a dask scheduler, such as tcp://192.168.0.10:8786.",
    ),
]
OwnSeed = Annotated[
    int | None,
    typer.Option(
        min=0, max=2**31 - 1, help="Seed of everything random; the plot file's if left out."
    ),
]
PlotPath = Annotated[
    Path, typer.Argument(metavar="PLOT.toml", help="Plot file; `fynjax init` writes one.")
]
Output = Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")]
Json = Annotated[
    bool, typer.Option("--json", help="Print a summary as JSON on stdout, and nothing else.")
]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Exit status 3 where the result is to be doubted, such as a search that did not "
        "converge. The files are written all the same.",
    ),
]
AllowOutside = Annotated[
    bool,
    typer.Option(
        "--allow-outside",
        help="The plot file may name files outside its folder; for plot files that you trust.",
    ),
]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Say what would be read and written, and about how long and how much memory it "
        "takes; compute and write nothing.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars and no text.")]

Job = Callable[[Path], "JobResult"]
"""What a command runs: writes into a folder, returns its result."""

DOUBTFUL = 3
"""Exit status with `--strict` where a result is to be doubted."""
_TERMINATED = 143
"""Exit status of `kill`, as shells have it."""


_COMPILER = (
    "--xla_backend_extra_options=xla_cpu_disable_slp_vectorizer --xla_cpu_use_fusion_emitters=false"
)
"""A command compiles some thousand small loops. Without these two parts of the compiler, which
concern processors only, that takes a third less time of an image and a sixth of a gradient; what
comes out is the same, and as fast."""


def prepare_jax() -> None:
    """Compile quickly, unless `XLA_FLAGS` says how, and keep compiled programs for the next run
    (`keep_compiled`). Before JAX is used."""
    os.environ.setdefault("XLA_FLAGS", _COMPILER)
    from fynjax._core.compiler import keep_compiled

    keep_compiled()


def _message(warning: warnings.WarningMessage) -> str:
    return " ".join(str(warning.message).split())


def checkpoint_beside(output: Path, checkpoint: Path | None) -> Path:
    """The folder of an unfinished run, the user's or one beside the output."""
    return output.with_name(f"{output.name}.checkpoint") if checkpoint is None else checkpoint


Work = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""What of a command's options tells its cost, as arguments of `fynjax.jobs.estimate`."""


def command(
    name: str,
    *,
    forget: bool = False,
    further: Mapping[str, Any] | None = None,
    work: Work | None = None,
) -> Callable[[Callable[..., Job]], Callable[..., None]]:
    """Make a command of a function that takes options and returns a job.

    Adds the options that every command has: --output, --json, --quiet, --strict; and
    --allow-outside to one that takes a plot file. A function with the option `checkpoint` is given
    the folder of the unfinished run; with `forget` its journal goes when the run has succeeded.
    `further`, annotations of options that the function takes as `**options`. With `work`, a command
    that may take long gets --dry-run, and says beforehand how long it takes.
    """
    shared: dict[str, tuple[Any, Any]] = {
        **{key: (annotation, None) for key, annotation in (further or {}).items()},
        "output": (Output, Path("output") / name),
        "json": (Json, False),
        "quiet": (Quiet, False),
        "strict": (Strict, False),
    }

    def decorate(function: Callable[..., Job]) -> Callable[..., None]:
        signature = inspect.signature(function)
        options_of_all = dict(shared)
        has_plot = "plot" in signature.parameters and (
            signature.parameters["plot"].annotation is PlotPath
        )
        if has_plot:
            options_of_all["allow_outside"] = (AllowOutside, False)
        if work is not None:
            options_of_all["dry_run"] = (DryRun, False)

        @functools.wraps(function)
        def run(
            *,
            output: Path,
            json: bool,
            quiet: bool,
            strict: bool,
            allow_outside: bool = False,
            dry_run: bool = False,
            **options: Any,
        ) -> None:
            checkpoint = None
            if "checkpoint" in options:
                checkpoint = checkpoint_beside(output, options["checkpoint"])
                options["checkpoint"] = checkpoint
            ready = functools.partial(_ready, function, options, has_plot, allow_outside)
            if dry_run and work is not None:
                _show_estimate(name, output, ready, work, as_json=json)
                return
            job = _announced(name, output, ready, work)
            result = run_job(
                name, job, output, as_json=json, quiet=quiet, checkpoint=checkpoint, forget=forget
            )
            if strict and result.status != "ok":
                sys.exit(DOUBTFUL)

        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters = [
            p.replace(kind=keyword)
            for p in signature.parameters.values()
            if p.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        parameters += [
            inspect.Parameter(key, keyword, default=default, annotation=kind)
            for key, (kind, default) in options_of_all.items()
        ]
        run.__signature__ = signature.replace(  # type: ignore[attr-defined]
            parameters=parameters, return_annotation=None
        )
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        return run

    return decorate


def _ready(
    function: Callable[..., Job], options: Mapping[str, Any], has_plot: bool, allow_outside: bool
) -> tuple[Job, Mapping[str, Any]]:
    """The job of a command and its options, of which the plot file is read.

    With `allow_outside` it may name files outside its folder.
    """
    if has_plot:
        from fynjax.io.plot import read_plot

        plot = read_plot(options["plot"], allow_outside=allow_outside)
        options = {**options, "plot": plot}
    return function(**options), options


def _announced(
    name: str,
    output: Path,
    ready: Callable[[], tuple[Job, Mapping[str, Any]]],
    work: Work | None,
) -> Job:
    """A job that says beforehand how long it takes, where that is long and progress is shown."""

    def job(folder: Path) -> "JobResult":
        task, options = ready()
        from fynjax._core.progress import is_heard

        if work is not None and is_heard():
            from fynjax.jobs import estimate

            expected = estimate(name, output, **work(options))
            if expected.is_long():
                print(f"fynjax: {expected.sentence()}", file=sys.stderr)
        return task(folder)

    return job


def _show_estimate(
    name: str,
    output: Path,
    ready: Callable[[], tuple[Job, Mapping[str, Any]]],
    work: Work,
    *,
    as_json: bool,
) -> None:
    """What a command would do, on stdout."""
    prepare_jax()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        _, options = ready()
        from fynjax.jobs import estimate

        expected = estimate(name, output, **work(options))
    for line in dict.fromkeys(map(_message, caught)):
        print(f"fynjax: warning: {line}", file=sys.stderr)
    if as_json:
        print(expected.model_dump_json(indent=2))
        return
    rows = [("reads", path) for path in expected.reads]
    rows += [("writes", f"{expected.writes}, whose {name} results would be replaced"
              if _listed_files(output, name) else expected.writes)]  # fmt: skip
    rows += list(expected.counts.items())
    for what, text in rows:
        print(f"{what:<7} {text}")
    print(expected.sentence())
    right = (
        "" if expected.seconds is None else " Such estimates are right within a factor of 2 to 3."
    )
    print(f"Nothing was computed or written.{right}")


def _listed_files(output: Path, command: str) -> list[str]:
    """Files that an earlier run of this command lists in its folder; none if it lists none.

    Those of another command stay: they are other results, and may be what this run reads.
    """
    try:
        earlier = json.loads((output / "summary.json").read_text("utf-8"))
    except (OSError, ValueError):
        return []
    if not isinstance(earlier, dict) or earlier.get("command") != command:
        return []
    files = earlier.get("files")
    return list(files) if isinstance(files, dict) else []


def _stated_files() -> list[Path]:
    """What the command line may name as a file: input, which no run removes."""
    return [Path(text.split("=", 1)[-1]).absolute() for text in sys.argv[1:] if text]


@contextmanager
def _alone(output: Path) -> Iterator[None]:
    """Only one run at a time, of one machine, writes into a folder. What runs left there that were
    killed long ago is cleared away."""
    from filelock import FileLock, Timeout

    from fynjax.io.text import remove_abandoned

    name = hashlib.sha256(os.path.normcase(output.resolve()).encode()).hexdigest()[:16]
    try:
        from fynjax._core.compiler import cache_folder

        locks = cache_folder() / "locks"
        locks.mkdir(parents=True, exist_ok=True)
        lock = FileLock(locks / name)
        lock.acquire(timeout=0)
    except Timeout:
        raise InputError(
            f"another run is writing into {output}: wait for its end, or give another --output"
        ) from None
    except (OSError, RuntimeError):
        yield  # no home, one that cannot be written, or a file system without locks
        return
    try:
        remove_abandoned(output)
        yield
    finally:
        lock.release()


@contextmanager
def _ended_by_kill() -> Iterator[Callable[[], None]]:
    """Let `kill` end a job as Ctrl-C does, so that what is unfinished is cleared away.

    Python drops an exit that is raised inside the callback of a library, such as JAX's after a
    garbage collection. So the block calls what it is given before results are moved.
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

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield check
    finally:
        signal.signal(signal.SIGTERM, before)


def run_job(
    command: str,
    job: Job,
    output: Path,
    *,
    as_json: bool,
    quiet: bool,
    checkpoint: Path | None = None,
    forget: bool = False,
) -> "JobResult":
    """Run `job(folder)`, print its result and return it.

    Where an interrupted job leaves a `checkpoint`, a line names it; with `forget` its journal goes
    in the end. The job writes into a
    folder beside `output`, whose files are moved to `output` when all of it has succeeded. Then
    those files go that an earlier run of the same command listed and this one did not write: they
    would stand beside results that they do not belong to. Warnings wait until then: if the job
    fails, its error is the only line.
    """
    from rich.console import Console

    from fynjax._core.progress import progress
    from fynjax.io.text import remove_replaced, staged_folder, write_text

    console = Console(stderr=True)
    bars = progress(console) if console.is_terminal and not quiet and not as_json else nullcontext()
    with (
        _alone(output),
        nullcontext() if checkpoint is None else _alone(checkpoint),
        _ended_by_kill() as check_killed,
        warnings.catch_warnings(record=True) as caught,
    ):
        earlier = _listed_files(output, command)
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        with staged_folder(output) as folder:
            prepare_jax()
            try:
                with bars:
                    result = job(folder)
            except KeyboardInterrupt:
                if checkpoint is None or not checkpoint.is_dir():
                    raise
                print(
                    f"fynjax: interrupted; {checkpoint} keeps what was done, and the same command "
                    "goes on with it",
                    file=sys.stderr,
                )
                sys.exit(130)
            messages = list(dict.fromkeys(map(_message, caught)))
            result = result.model_copy(
                update={"output": str(output), "warnings": [*result.warnings, *messages]}
            )
            text = result.model_dump_json(indent=2)
            write_text(folder / "summary.json", text + "\n")
            check_killed()
            written = [p.relative_to(folder) for p in folder.rglob("*") if p.is_file()]
        remove_replaced(output, earlier, [*written, *_stated_files()])
        if forget and checkpoint is not None:
            from fynjax._core.checkpoint import forget_journal

            forget_journal(checkpoint)
    for line in result.warnings:
        print(f"fynjax: warning: {line}", file=sys.stderr)
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
        print(line)
    width = max((len(name) for name in result.files), default=0)
    print(f"Written to {result.output}")
    for name, what in result.files.items():
        print(f"  {name:<{width}}  {what}")
