"""Options of the command line: those of a job, from its signature, and those of all commands."""

import inspect
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fynjax._core.errors import InputError, is_odd_number
from fynjax.app.cli._signatures import REQUIRED, Argument, Kind

# What only the command line has.


def _folder(text: str | Path) -> Path:
    """The path of a folder, which an empty text does not name: it comes from a shell's variable
    that is not set, and would be the working folder."""
    if not str(text).strip():
        raise InputError("expected the name of a folder, but got an empty text; here is `.`")
    return Path(text)


def _option(kind: Any, default: Any, help: str, *flags: str, **more: Any) -> tuple[Any, Any]:
    return Annotated[kind, typer.Option(*flags, help=help, **more)], default


def of_all_commands(output: Path) -> dict[str, tuple[Any, Any]]:
    """Options of every command that writes a folder, with their defaults."""
    return {
        "output": _option(Path, output, "Folder for the results.", metavar="DIR", parser=_folder),
        "overwrite": _option(
            bool, False,
            "Replace files in the folder for the results too that no earlier run of this command "
            "wrote, or that were changed since; a warning names them. Input is never replaced.",
            "--overwrite",
        ),
        "json": _option(
            bool, False, "Print a summary as JSON on stdout, and nothing else.", "--json"
        ),
        "quiet": _option(bool, False, "No progress and no text.", "--quiet", "-q"),
        "strict": _option(
            bool, False,
            "Exit status 3 where the result is to be doubted, such as a search that did not "
            "converge. The files are written all the same.",
            "--strict",
        ),
        "dry_run": _option(
            bool, False,
            "Read and check every input as the run would, and say what would be written; compute "
            "and write nothing.",
            "--dry-run",
        ),
    }  # fmt: skip


ALLOW_OUTSIDE = _option(
    bool,
    False,
    "The plot file may name files outside its folder; for plot files that you trust.",
    "--allow-outside",
)
CHECKPOINT = _option(
    Path | None,
    None,
    "Folder of the unfinished run; OUTPUT.checkpoint if left out. The same command goes on from "
    "it.",
    metavar="DIR",
    parser=_folder,
)


# Those of a job.


_NAMES = {"count": "workers"}
"""Options of several commands that are named otherwise than the field of a record."""


def flag_of(argument: Argument, names: Mapping[str, str]) -> str:
    """The option of an argument: its name, without the unit; of what is given again and again, the
    name of one. `names` has others."""
    name = {**_NAMES, **names}.get(argument.name)
    if name is None:
        name = re.sub(r"_(m|nm|deg)$", "", argument.name)
        name = name.removesuffix("s") if argument.kind.repeated else name
    return f"--{name.replace('_', '-')}"


def parameter_of(
    argument: Argument, flag: str, help: str, metavar: str | None, panel: str | None
) -> inspect.Parameter:
    """An argument of a job as typer takes it; with `metavar`, one without a flag."""
    kind, default = argument.kind, argument.default
    more: dict[str, Any] = {"help": help}
    if panel:
        more["rich_help_panel"] = panel
    named = _metavar(argument, help)
    taken: Any = kind.of
    if kind.choices:
        taken = Literal[kind.choices]  # a tuple of texts has each of them
    elif kind.of is bool:
        flag = flag if default is False else f"{flag}/--no-{flag[2:]}"
    elif kind.counts is not None:
        taken, more["callback"] = str, _listed(kind, flag, help)
        default = _joined(default) if default and default is not REQUIRED else default
    elif kind.of is not str:
        more |= {"min": kind.least, "max": kind.most}
    if kind.of is not bool and not kind.choices:
        more["metavar"] = metavar or named
    if kind.repeated:
        taken, default = list[taken], default or None
    if default is None:
        taken = taken | None
    short = ["-q"] * (flag == "--quiet")
    described = typer.Argument(**more) if metavar else typer.Option(flag, *short, **more)
    return inspect.Parameter(
        argument.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if default is REQUIRED else default,
        annotation=Annotated[taken, described],
    )


def _metavar(argument: Argument, help: str) -> str:
    """What stands for the value in help: its unit, or what it names."""
    kind = argument.kind
    unit = re.search(r"\[(m|nm|degrees?)\]", help)
    if kind.of is not str:
        one = {"m": "M", "nm": "NM"}.get(unit[1], "DEG") if unit else "NUMBER"
        one = "N" if kind.of is int else one
        if kind.counts is None:
            return one
        if not kind.counts:
            return f"{one},..."
        return "|".join(",".join([one] * count) for count in kind.counts)
    if kind.counts is not None:
        return "NAME,..."
    if not kind.file:
        return "TEXT"
    if help.startswith("Folder"):
        return "DIR"
    return "NAME|FILE" if _NAME.search(help) else "FILE"


_NAME = re.compile(r"\bname of a |\bthe name\b|by name or file", re.IGNORECASE)


def _joined(values: Any) -> str:
    values = values if isinstance(values, tuple) else (values,)
    return ",".join(v if isinstance(v, str) else f"{v:g}" for v in values)


def _listed(kind: Kind, flag: str, help: str) -> Callable[[Any], Any]:
    """Reads values with commas between; given several times, a list of such."""
    counts = kind.counts or ()
    what = {str: "names", int: "whole numbers", float: "numbers"}[kind.of]
    expected = f"{' or '.join(map(str, counts))} {what} with commas between".strip()
    ranges = re.search(r"\d-\d", help)  # else a hyphen may be a sign

    def read(given: Any) -> Any:
        if given is None or isinstance(given, list):
            return given and [read(text) for text in given]
        text = str(given)
        parts = [part.strip() for part in text.split(",")]
        if ranges and (two := _RANGE.fullmatch(text)):
            parts = [two[1], two[2]]
        try:
            found = tuple(kind.of(part) for part in parts)
        except ValueError:
            found = ()
        if kind.of is not str:  # 1_0 is no ten
            odd = any(map(is_odd_number, parts))
            found = () if odd or not all(math.isfinite(float(one)) for one in found) else found
        if not found or (counts and len(found) not in counts):
            raise InputError(f"`{flag}` must be {expected}, but is {text!r}. It is: {help}")
        return found[0] if found[1:] == () and 1 in counts else found

    return read


_RANGE = re.compile(r"\s*(\d+(?:\.\d*)?)\s*-\s*(\d+(?:\.\d*)?)\s*")
"""Such as 930-960, where the docstring shows one."""


def naming_options(text: str, flags: Mapping[str, str]) -> str:
    """A text that names options instead of a job's arguments."""
    return re.sub(r"`(\w+)`", lambda m: f"`{flags.get(m[1], m[1])}`", text)
