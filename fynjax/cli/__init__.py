"""The `fynjax` command. Each subcommand is a module that parses and calls one job."""

import logging
import os
import signal
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

import fynjax
from fynjax._core.errors import InputError, MissingExtraError
from fynjax.cli._bioscape import bioscape
from fynjax.cli._build import build
from fynjax.cli._calibrate import calibrate
from fynjax.cli._calibrate_plots import calibrate_plots
from fynjax.cli._convert import convert
from fynjax.cli._demo import demo
from fynjax.cli._fit_leaf import fit_leaf
from fynjax.cli._information import information
from fynjax.cli._init import init
from fynjax.cli._learn import learn
from fynjax.cli._map import map_command
from fynjax.cli._pattern import pattern
from fynjax.cli._plant import plant
from fynjax.cli._posterior import posterior
from fynjax.cli._reflectance import reflectance
from fynjax.cli._render import render
from fynjax.cli._sensitivity import sensitivity
from fynjax.cli._sensors import sensors
from fynjax.cli._simulate import simulate
from fynjax.cli._terrain import terrain
from fynjax.cli._train import train
from fynjax.cli._validate import validate
from fynjax.cli._validate_plots import validate_plots
from fynjax.cli._view import view

__all__ = ["app", "main"]

app = typer.Typer(
    name="fynjax",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(demo)
app.command()(render)
app.command()(simulate)
app.command()(sensors)
app.command()(build)
app.command()(calibrate)
app.command("calibrate-plots")(calibrate_plots)
app.command()(posterior)
app.command()(sensitivity)
app.command()(information)
app.command("fit-leaf")(fit_leaf)
app.command()(convert)
app.command()(plant)
app.command()(learn)
app.command()(train)
app.command("map")(map_command)
app.command()(terrain)
app.command()(reflectance)
app.command()(bioscape)
app.command()(pattern)
app.command()(validate)
app.command("validate-plots")(validate_plots)
app.command()(init)
app.command()(view)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"fynjax {fynjax.__version__}")
        raise typer.Exit


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit.

    **Arguments:** `arguments` of the command, those of the process by default.

    Exit status 0, 2 for wrong arguments or input, 3 with `--strict` for a result to be doubted, 1
    for anything else, 130 for Ctrl-C, 143 for `kill`; 1, 2 and 130 come with one line on stderr.
    `FYNJAX_DEBUG=1` shows the traceback instead.
    """
    # An exit, unlike the signal itself, lets unfinished results be cleared away.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(_TERMINATED))
    # Compiled programs that are kept are read with lines of false alarm: settings of this machine's
    # own compiler are called features that it lacks. Before JAX is imported.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    # GDAL reports through logging, and a logger without a handler prints to stderr.
    logging.getLogger("rasterio").addHandler(logging.NullHandler())
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
        if hasattr(error, "format_message"):  # a usage error; typer brings a click of its own
            text = error.format_message()
            _fail(f"error: {text}" if text else "error: no command; see fynjax --help", 2)
        if isinstance(error, MissingExtraError):
            _fail(f"error: {error}", 1)
        if type(error).__name__ != "Abort":  # some versions of typer turn Ctrl-C into this
            _fail(f"error: {type(error).__name__}: {error} (FYNJAX_DEBUG=1 shows where)", 1)
        status = _INTERRUPTED
    if status == _INTERRUPTED:  # and others into a status
        _fail("interrupted; nothing was written", _INTERRUPTED)
    sys.exit(status if isinstance(status, int) else 0)
