"""Every argument of a job is an option: its name, its default, and what its docstring says."""

import importlib
import inspect
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fynjax import jobs
from fynjax._core.parts import Workers
from fynjax.app.cli import _signatures, app, main
from fynjax.app.cli._commands import COMMANDS, Command
from fynjax.app.cli._doors import made
from fynjax.app.cli._signatures import REQUIRED, signature_of, summary_of
from fynjax.studies import bioscape, communities, fynbos_2006
from tests.small import write_plot

OWN = {"output", "overwrite", "json", "quiet", "strict", "dry_run", "allow_outside", "checkpoint"}
"""What only the command line has."""


def job_of(name: str):
    """A function or a class, such as of "fynjax.app.jobs:render_plot"."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_argument_of_a_job_is_an_option(command: Command) -> None:
    """As Python has the signature; the command line reads the source."""
    read = signature_of(command.job)
    arguments = dict(inspect.signature(job_of(command.job)).parameters)
    for name, record in read.records.items():
        del arguments[name]
        kind = job_of(record.kind)
        typed = dict.fromkeys(kind.__annotations__, None)
        arguments |= (
            {key: inspect.Parameter(key, 3, default=value) for key, value in typed.items()}
            if issubclass(kind, dict)
            else inspect.signature(kind).parameters
        )
        usual = {key: inspect.Parameter(key, 3, default=v) for key, v in record.usual.items()}
        arguments |= usual
    known = {argument.name: argument for argument in read.arguments}
    assert known.keys() == arguments.keys()
    for name, argument in known.items():
        default = arguments[name].default
        assert argument.default == (REQUIRED if default is inspect.Parameter.empty else default)
    options = {option.name: option for option in made(command.name).params}
    own = set() if command.plain else OWN
    assert options.keys() - own - {"help"} == arguments.keys() - own
    for name in arguments.keys() - own:
        begin = known[name].text.partition("`")[0]
        assert (options[name].help or "")[1:].startswith(begin[1:])
        assert len(begin) + known[name].text.count("`") > 1
        if known[name].default is not REQUIRED and not known[name].position:
            assert not options[name].required


def test_no_option_is_named_for_nothing() -> None:
    for command in COMMANDS:
        names = {argument.name for argument in signature_of(command.job).arguments}
        assert names >= {*command.names, *command.optional}, command.name


@pytest.fixture
def given(monkeypatch):
    """What the jobs are called with, which do nothing."""
    calls = []

    def job(**stated):
        calls.append({k: v for k, v in stated.items() if k not in ("output", "checkpoint", "plot")})
        raise SystemExit(0)

    for module in (jobs, bioscape, communities, fynbos_2006):
        for command in COMMANDS:
            name = command.job.partition(":")[2]
            if command.job.startswith(f"{module.__name__}:"):
                monkeypatch.setattr(module, name, job, raising=False)
    monkeypatch.setattr("fynjax.app.cli._runtime.keep_compiled", lambda: None)
    return calls


RANGES = {
    "fit-leaf a.csv b.csv --version 5 --workers 2": {
        "paths": ["a.csv", "b.csv"], "version": "5", "workers": Workers(count=2)
    },
    "information PLOT --error 0.02 --sun 20,40 --free a --free b": {
        "error": 0.02, "sun_zenith": (20.0, 40.0), "free": ["a", "b"]
    },
    "train emit --steps 9 --sun-zenith 25-35": {
        "sensor": "emit", "steps": 9, "sun_zenith": (25.0, 35.0)
    },
    "train --like a.hdr --sun-zenith 30": {"like": "a.hdr", "sun_zenith": 30.0},
    "diversity --richness 2,4 --sensors a,b": {
        "gradients": communities.Gradients(richness=(2, 4)), "sensors": ("a", "b")
    },
    "bioscape calibrate a --size 4": {
        "folder": "a", "resolution": bioscape.Resolution(4.0, 0.25)
    },
    "design PLOT --pixel 0.1": {"pixel": (0.1,)},
    "map a --training b --pixel 1,2 --pixel 3,4 --zarr": {
        "cube": "a", "training": "b", "pixels": [(1, 2), (3, 4)], "zarr": True
    },
    "simulate PLOT --no-noise --product radiance": {"noise": False, "products": ["radiance"]},
    "calibrate PLOT --twin": {"targets": (), "twin": True},
    "validate --exclude 930-960 --layer 0.2": {
        "data": ValueError, "exclude": [(930.0, 960.0)], "cloud_options": {"layer": 0.2}
    },
    "pattern a --no-align": {"paths": ["a"], "align": False},
    "demo": {},
}  # fmt: skip


@pytest.mark.parametrize("line", RANGES)
def test_what_is_stated_reaches_the_job_and_nothing_else(line, given, tmp_path, capsys):
    words = line.replace("PLOT", str(write_plot(tmp_path))).split()
    wanted = dict(RANGES[line])
    if wanted.pop("data", None):  # a record that checks itself
        files = {"real_spectra": ["a"], "simulated_spectra": ["b"]}
        wanted["data"] = jobs.ValidationData(**files)
        words += ["--real-spectra", "a", "--simulated-spectra", "b"]
    with pytest.raises(SystemExit):
        main([*words, "--output", str(tmp_path / "out")])
    assert given == [wanted], capsys.readouterr().err


def test_a_hyphen_is_a_range_only_where_help_shows_one(given, tmp_path, capsys):
    plot = str(write_plot(tmp_path))
    for line in (["information", plot, "--spectrum", "450-900"],
                 ["information", plot, "--gsd", "1-5"],
                 ["init", "--table", "a.csv", "--place", "43.7-3.7"],
                 ["train", "emit", "--sun-zenith", "20-25-30"]):  # fmt: skip
        with pytest.raises(SystemExit) as caught:
            main(line)
        err = capsys.readouterr().err
        assert caught.value.code == 2
        assert f"`{line[-2]}` must be" in err
        assert f"numbers with commas between, but is {line[-1]!r}. It is: " in err
    assert given == []


SOURCE = """
from typing import Annotated, Literal
from fynjax._core.arguments import Names

KINDS = ("a", "b")

def job(output: str, first: str, *, kinds: Names = KINDS, way: Literal["up", "down"] | None = None,
        most: Annotated[int, Field(ge=2**2)] = 2 * 3{more}):
    \"\"\"Do it.

    **Arguments:**

    - `output`: folder.
    - `first`: what comes first.
    - `kinds`, `way`: beside
      `most`.
    - `most`: a number{said}

    **Returns:** `Thing`, of a kind. Writes it.
    \"\"\"
"""


@pytest.fixture
def job(tmp_path, monkeypatch):
    """A job in a package of its own, whose source is written when it is called with more."""
    monkeypatch.setattr(_signatures, "_ROOT", tmp_path)
    os.symlink(Path(jobs.__file__).parents[2], tmp_path / "fynjax")
    monkeypatch.setattr(_signatures, "_module", _signatures._module.__wrapped__)

    def write(more="", said="."):
        (tmp_path / "own.py").write_text(SOURCE.replace("{more}", more).replace("{said}", said))
        return signature_of("own:job")

    return write


def test_an_argument_that_is_added_is_an_option_if_the_docstring_says_what_it_is(job):
    names = [argument.name for argument in job().arguments]
    assert names == ["output", "first", "kinds", "way", "most"]
    with pytest.raises(LookupError, match="says nothing of `share`"):
        job(", share: float = 0.5")
    *_, most, share = job(", share: float = 0.5", ".\n    - `share`: a part [-].").arguments
    assert (most.kind.least, most.default) == (4, 6)
    assert (share.kind.of, share.default, share.text) == (float, 0.5, "a part [-].")
    with pytest.raises(LookupError, match="no option can be of the type dict"):
        job(", share: dict[str, int] = 0", ".\n    - `share`: a part [-].")
    with pytest.raises(LookupError, match="bounds are ge and le, no gt"):
        job(", share: Annotated[int, Field(gt=0)] = 1", ".\n    - `share`: a part [-].")
    with pytest.raises(LookupError, match="no annotation"):
        job(", share=0", ".\n    - `share`: a part [-].")
    assert summary_of("own:job") == "Do it."


def test_help_speaks_of_options_and_says_what_is_written() -> None:
    shown = CliRunner().invoke(app, ["fit-leaf", "--help"], env={"COLUMNS": "300"}).output
    assert "Left out: by --measurement." in shown
    assert "<5|D|PRO>" in shown
    shown = CliRunner().invoke(app, ["render", "--help"], env={"COLUMNS": "300"}).output
    assert "figures and a page into --output; with --truth also truth.tif" in shown
    assert "RenderResult" not in shown
