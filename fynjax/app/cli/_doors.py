"""Commands, made of their jobs when they are needed."""

import functools
import importlib
import inspect
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import typer
from typer.core import TyperCommand, TyperGroup

from fynjax._core.compiler import check_sums_once
from fynjax._core.errors import InputError, is_odd_number
from fynjax.app.cli import _options as options
from fynjax.app.cli._commands import COMMANDS, Command
from fynjax.app.cli._runtime import DOUBTFUL, run_job, show_dry_run
from fynjax.app.cli._signatures import REQUIRED, Argument, Signature, signature_of, summary_of

if TYPE_CHECKING:
    from fynjax.app.jobs import JobResult

SETTINGS: Any = {
    "no_args_is_help": True,
    "pretty_exceptions_enable": False,
    "rich_markup_mode": "markdown",
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class Door(TyperCommand):
    """A command in the list of all, of which only the first words are read until it is used."""

    def __init__(self, command: Command) -> None:
        super().__init__(
            command.name.rpartition(" ")[2],
            short_help=summary_of(command.job),
            rich_help_panel=command.panel if " " not in command.name else None,
        )
        self._name = command.name

    def make_context(self, *arguments: Any, **more: Any) -> Any:
        return made(self._name).make_context(*arguments, **more)


def group_of(prefix: str) -> type[TyperGroup]:
    """The commands whose names begin with the word `prefix`; of none, those of one word."""

    class Commands(TyperGroup):
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            own = [c for c in COMMANDS if c.name.rpartition(" ")[0] == prefix]
            doors = {command.name.rpartition(" ")[2]: Door(command) for command in own}
            self.commands = {**doors, **self.commands}

    return Commands


def _is_number(annotation: Any) -> bool:
    """Whether an option takes a number, by the annotation of its argument."""
    (kind, *_) = get_args(annotation) or [annotation]
    return not {int, float}.isdisjoint({kind, *get_args(kind)})


def _listed(value: Any) -> list[str]:
    """Texts that an option was given."""
    return [str(one) for one in (value if isinstance(value, list | tuple) else [value])]


class _Strict(TyperCommand):
    """A command that refuses a second value of an option that takes one, which would replace the
    first without a word, and 1_0 for ten."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        texts, _, given = self.make_parser(ctx).parse_args(args=list(args))
        known = inspect.signature(self.callback).parameters if self.callback else {}
        for option in given:
            if option.name in known and _is_number(known[option.name].annotation):
                for text in _listed(texts.get(option.name)):
                    if is_odd_number(text):
                        raise InputError(f"`{option.opts[0]}` must be a number, but is {text!r}")
            if option.param_type_name != "option" or getattr(option, "multiple", False):
                continue
            agrees = getattr(option, "is_flag", False) and not option.secondary_opts
            times = given.count(option)
            if times > 1 and not agrees:
                raise InputError(f"expected `{option.opts[0]}` once, but got it {times} times")
        return super().parse_args(ctx, args)


@functools.cache
def made(name: str) -> TyperCommand:
    """A command with all its options, such as "bioscape learn"."""
    command = next(one for one in COMMANDS if one.name == name)
    job = signature_of(command.job)
    names = {argument.name for argument in job.arguments}
    arguments = [
        argument._replace(default=command.optional.get(argument.name, argument.default))
        for argument in job.arguments
        if command.plain or argument.name not in ("output", "checkpoint")
    ]
    flags = {one.name: options.flag_of(one, command.names) for one in arguments}
    first = next((one.name for one in arguments if one.position), None)
    parameters = [
        options.parameter_of(
            one, flags[one.name], _help(one, flags),
            command.given if one.name == first else None,
            command.panels.get(one.record or ""),
        )
        for one in arguments
    ]  # fmt: skip
    if command.plain:
        run = _printing(command)
    else:
        own = options.of_all_commands(Path("output") / command.name.replace(" ", "-"))
        if "checkpoint" in names:
            own["checkpoint"] = options.CHECKPOINT
        if any(one.name == "plot" and one.default is REQUIRED for one in arguments):
            own["allow_outside"] = options.ALLOW_OUTSIDE
        parameters += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=value, annotation=kind)
            for name, (kind, value) in own.items()
        ]
        run = _writing(command, job, flags)
    context = inspect.Parameter("ctx", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    parameters.insert(0, context)
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    app = typer.Typer(add_completion=False, **SETTINGS)
    about = _about(job, command, {**flags, "output": "--output"})
    app.command(name.rpartition(" ")[2], cls=_Strict, help=about)(run)
    whole = typer.main.get_command(app)
    assert isinstance(whole, TyperCommand)
    return whole


def _help(argument: Argument, flags: Mapping[str, str]) -> str:
    """What the docstring says of an argument, as a sentence about options."""
    text = options.naming_options(argument.text, flags)
    again = " May be given again." if argument.kind.repeated and not argument.position else ""
    return text[:1].upper() + text[1:] + again


def _about(job: Signature, command: Command, flags: Mapping[str, str]) -> str:
    """The help of a command: what its job does and writes, and an example."""
    writes = re.sub(r"^`\w+`[^.]*\.\s*", "", job.returns)
    parts = [options.naming_options(part, flags) for part in (job.about, writes) if part]
    return "\n\n".join([*parts, f"Example:  {command.example}"])


def _stated(context: typer.Context, given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that stand on the command line; for all others the job has its defaults."""
    sources = {key: context.get_parameter_source(key) for key in given}
    return {key: value for key, value in given.items()
            if getattr(sources[key], "name", "") not in ("DEFAULT", "DEFAULT_MAP")}  # fmt: skip


def _printing(command: Command) -> Callable[..., None]:
    """What a command does that writes no folder of results."""

    def run(ctx: typer.Context, **given: Any) -> None:
        _imported(command.job)(**_stated(ctx, given))

    return run


def _writing(command: Command, job: Signature, flags: Mapping[str, str]) -> Callable[..., None]:
    """What a command does whose job writes a folder: the job is given what is stated, by name.
    Errors and warnings that name its arguments name the options instead."""

    def run(
        ctx: typer.Context,
        *,
        output: Path,
        overwrite: bool,
        json: bool,
        quiet: bool,
        strict: bool,
        dry_run: bool,
        allow_outside: bool | None = None,
        **given: Any,
    ) -> None:
        stated: dict[str, Any] = {**command.optional} | _stated(ctx, given)
        checkpoint = None
        if "checkpoint" in given:
            named = output if output.name.strip(".") else output.resolve()
            beside = named.with_name(f"{named.name}.checkpoint")
            checkpoint = stated["checkpoint"] = given["checkpoint"] or beside

        def work(folder: Path) -> "JobResult":
            if allow_outside is not None:
                from fynjax.app.io.plot import read_plot

                stated["plot"] = read_plot(Path(stated["plot"]), allow_outside=allow_outside)
            try:
                result: JobResult = _imported(command.job)(output=folder, **_packed(stated, job))
            except InputError as error:
                error.args = (options.naming_options(str(error), flags),)
                raise
            named = [options.naming_options(text, flags) for text in result.warnings]
            return result.model_copy(update={"warnings": named})

        start = functools.partial(
            run_job, command.name, work, output, as_json=json, quiet=quiet, overwrite=overwrite,
            checkpoint=checkpoint, forget=not command.keeps,
        )  # fmt: skip
        if dry_run:
            show_dry_run(start, output, as_json=json, quiet=quiet)
            return
        check_sums_once()
        if start().status != "ok" and strict:
            sys.exit(DOUBTFUL)

    return run


def _packed(stated: Mapping[str, Any], job: Signature) -> dict[str, Any]:
    """What is stated, the fields of a record in it."""
    given = dict(stated)
    for key, record in job.records.items():
        fields = {one.name for one in job.arguments if one.record == key} & given.keys()
        if fields or record.needed:
            own = {name: given.pop(name) for name in fields}
            given[key] = _imported(record.kind)(**record.usual | own)
    return given


def _imported(name: str) -> Callable[..., Any]:
    module, _, attribute = name.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), attribute)
    return found
