"""The `fynjax` command. Its commands are jobs: `_commands` names them, and `_doors` makes each of
the signature of its job."""

import io
import logging
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

import fynjax
from fynjax._core.errors import InputError, MissingExtraError
from fynjax.app.cli._doors import SETTINGS, group_of
from fynjax.app.cli._runtime import ignore_ctrl_c

__all__ = ["app", "main"]

app = typer.Typer(name="fynjax", cls=group_of(""), **SETTINGS)
_bioscape = typer.Typer(
    cls=group_of("bioscape"),
    help="Field tables and spectra of BioSCape: plot files, what plots share, simulated beside "
    "measured, and back.",
    **SETTINGS,
)
_bioscape.callback()(lambda: None)
app.add_typer(_bioscape, name="bioscape", rich_help_panel="Many plots")


def _version(wanted: bool) -> bool:
    if wanted:
        print(f"fynjax {fynjax.__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """From a species table and leaf spectra to a drone image, and back.

    Start with `fynjax demo`, or with `fynjax init my_plot` for files of your own.
    """


_INTERRUPTED = 130
"""Exit status of Ctrl-C, as shells have it."""
_TERMINATED = 143
"""Exit status of `kill`."""


def _fail(message: str, status: int) -> None:
    print(f"fynjax: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)


_NO_MEMORY = re.compile(
    "RESOURCE_EXHAUSTED|out of memory|failed to map segment|cannot allocate memory|bad_alloc"
    "|can't start new thread",
    re.IGNORECASE,
)
"""Words of libraries where there is no memory left."""


def _of_this_machine(error: Exception) -> str:
    """The message of an error that no input caused: little memory, no such device, or another."""
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, MemoryError) or _NO_MEMORY.search(text):
        return (
            f"this machine, or the limit of the process, has too little memory ({text:.80}). "
            "Close other programs, or ask for less at once: larger voxels or pixels, fewer bands, "
            "fewer workers"
        )
    if named := os.environ.get("JAX_PLATFORMS"):
        import jax

        try:
            jax.devices()
        except Exception:
            return (
                f"JAX finds no device of JAX_PLATFORMS={named} on this machine. Unset it, or set "
                "JAX_PLATFORMS=cpu"
            )
    return text


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit.

    **Arguments:** `arguments` of the command, those of the process by default.

    Exit status 0, 2 for wrong arguments or input, 3 with `--strict` for a result to be doubted, 1
    for anything else, 130 for Ctrl-C, 143 for `kill`; all but 0 and 3 come with a line on stderr.
    `FYNJAX_DEBUG=1` shows the traceback instead.
    """
    # An exit, unlike the signal itself, lets unfinished results be cleared away.
    signal.signal(signal.SIGTERM, lambda *_: _fail("ended; nothing was written", _TERMINATED))
    # GDAL reports through logging, matplotlib that it has no home, and a logger without a handler
    # prints to stderr.
    for name in ("rasterio", "matplotlib"):
        logging.getLogger(name).addHandler(logging.NullHandler())
    for stream in (sys.stdout, sys.stderr):  # a terminal may lack letters that names of files have
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        _run(arguments)
    finally:
        ignore_ctrl_c()


def _run(arguments: Sequence[str] | None) -> None:
    status: object = 0
    try:
        status = app(args=None if arguments is None else list(arguments), standalone_mode=False)
    except KeyboardInterrupt:
        status = _INTERRUPTED
    except Exception as error:
        if os.environ.get("FYNJAX_DEBUG") == "1":
            raise
        if isinstance(error, InputError):
            _fail(f"error: {error}", 2)
        from fynjax._core.files import why_failed  # late: it is slow to load

        if (why := why_failed(error)) is not None:
            name = getattr(error, "filename", None)
            _fail(f"error: {'' if name is None else f'{name!s:.80}: '}{why}", 2)
        if hasattr(error, "format_message"):  # a usage error; typer brings a click of its own
            text = error.format_message()
            _fail(f"error: {text}" if text else "error: no command; see fynjax --help", 2)
        missing = error if isinstance(error, MissingExtraError) else MissingExtraError.of_app(error)
        if missing is not None:
            _fail(f"error: {missing}", 1)
        if type(error).__name__ != "Abort":  # some versions of typer turn Ctrl-C into this
            _fail(f"error: {_of_this_machine(error)} (FYNJAX_DEBUG=1 shows where)", 1)
        status = _INTERRUPTED
    if status == _INTERRUPTED:  # and others into a status
        _fail("interrupted; nothing was written", _INTERRUPTED)
    sys.exit(status if isinstance(status, int) else 0)
