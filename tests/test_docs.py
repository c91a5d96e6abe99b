"""The documentation: what it says can be typed, can; what it takes from owners, is there."""

import importlib.util
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from typer.testing import CliRunner

from fynjax.app.cli import app

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TUTORIALS = sorted((DOCS / "first-hour").glob("*.md"))
LONG = {"render", "calibrate", "simulate", "information", "sensitivity"}
"""Commands of the tutorials that only the study runs; the others check how they are called."""


def load_site() -> ModuleType:
    """What the site's build takes from the package."""
    spec = importlib.util.spec_from_file_location("_site", DOCS / "_site.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SITE = load_site()


def check_call(line: str) -> None:
    """Fail unless a line of the command line names a command and options that there are."""
    program, name, *arguments = shlex.split(line.removeprefix(".venv/bin/"), comments=True)
    assert program == "fynjax"
    if name.startswith("--"):
        return
    if name not in SITE.commands():
        name, arguments = f"{name} {arguments[0]}", arguments[1:]
    with SITE.commands()[name].make_context(name, arguments):
        pass


def calls(text: str) -> list[str]:
    """Calls of fynjax in the shell blocks of a text, line by line."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    parts = [part.strip() for line in lines for part in line.split(" && ")]
    return [part for part in parts if part.removeprefix(".venv/bin/").startswith("fynjax ")]


def follow(page: Path, *, everything: bool) -> None:
    """Do what a tutorial says, in the current folder."""
    names: dict[str, Any] = {}
    text = page.read_text("utf-8")
    for language, block in re.findall(r"^```(sh|python)\n(.*?)^```$", text, re.M | re.S):
        if language == "python":
            exec(compile(block, str(page), "exec"), names)
            continue
        for line in block.splitlines():
            command, *arguments = shlex.split(line)[1:]
            check_call(line)
            if everything or command not in LONG:
                done = CliRunner().invoke(app, [command, *arguments])
                assert done.exit_code == 0, f"{line}\n{done.output}\n{done.exception!r}"
            if command == "init":  # a plot as small as a test can have it
                plot = Path(arguments[0]) / "plot.toml"
                stated, count = re.subn(
                    r"^size_m = [\d.]+", "size_m = 5.0", plot.read_text("utf-8"), flags=re.M
                )
                assert count == 1
                plot.write_text(stated, "utf-8")


@pytest.mark.parametrize("everything", [False, pytest.param(True, marks=pytest.mark.study)])
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_first_hour_can_be_followed(
    page: Path, everything: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", lambda address: True)
    follow(page, everything=everything)


def test_every_command_has_a_page_whose_examples_can_be_typed() -> None:
    commands = SITE.commands()
    assert {p.stem for p in (DOCS / "commands").glob("*.md")} == {
        "index",
        *(SITE.page_of(name).removesuffix(".md") for name in commands),
    }
    examples = 0
    for name in commands:
        for line in calls(SITE.usage(name)):
            check_call(line)
            examples += 1
        page = (DOCS / "commands" / SITE.page_of(name)).read_text("utf-8")
        assert f"{{{{ options {name} }}}}" in page
        assert f"{{{{ usage {name} }}}}" in page
    assert examples >= len(commands)


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.stem)
def test_every_line_that_a_page_has_to_type_can_be_typed(page: Path) -> None:
    for line in calls(page.read_text("utf-8")):
        check_call(line)


def test_first_pages_need_no_words_that_nothing_explains() -> None:
    """They lead to the glossary, and say how a bare `fynjax` is found."""
    first = [ROOT / "README.md", *(DOCS / name for name in ("index.md", "install.md"))]
    first += [*TUTORIALS, DOCS / "commands" / "index.md"]
    strange = r"DIRSIG|path.traced|\bplantings?\b|clumping|max_iterations|gains of a camera"
    for page in first:
        text = page.read_text("utf-8")
        assert not re.findall(strange, text), page
        assert "glossary.md" in text or page.name == "install.md", page
        assert "bin/activate" in text or "install.md" in text, page


def test_agreement_with_measurements_comes_first_and_faults_last() -> None:
    heads = re.findall(r"^## (.*)$", (DOCS / "validation.md").read_text("utf-8"), re.M)
    assert heads[0] == "BioSCape's plots"
    assert heads[-2:] == ["Time and memory", "Faults and damaged files"]


def test_a_call_that_cannot_be_typed_is_noticed() -> None:
    for wrong in ("fynjax build plot.toml --grain 2", "fynjax render"):
        with pytest.raises(Exception, match=r"No such option|Missing parameter"):
            check_call(wrong)


def test_options_keys_and_parameters_are_all_listed() -> None:
    from fynjax.app.jobs._schemas import SCHEMAS, json_schema
    from fynjax.scene import PARAMETERS

    for name, command in SITE.commands().items():
        listed = SITE.options(name)
        assert all(f"`{o}`" in listed for p in command.params for o in p.opts if o[0] == "-")
    pages = "\n".join(page.read_text("utf-8") for page in PAGES)
    for name in SCHEMAS.keys() - {"summary"}:
        assert f"{{{{ keys {name} }}}}" in pages, name
        listed, schema = SITE.keys(name), json_schema(name)
        for part in (schema, *schema.get("$defs", {}).values()):
            for key, entry in part.get("properties", {}).items():
                assert f"| `{key}` |" in listed or f"{key}]" in listed, key
                words = SITE.plain(entry.get("description", ""))
                assert words in listed or f"{key}]" in listed, key
    listed = SITE.parameters()
    for kind, record in PARAMETERS.items():
        assert f"`{kind}`" in listed
        assert record.description in listed
        assert f"*Source:* {record.source}" in listed


def test_pages_take_what_there_is_and_show_small_pictures() -> None:
    shown = set()
    for page in PAGES:
        text = SITE.filled(page.read_text("utf-8"))  # raises where an owner is unknown
        assert "{{ " not in text, page
        shown |= {(page.parent / p).resolve() for p in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)}
    there = {p for p in (DOCS / "images").iterdir() if p.name != "icon.svg"}
    assert shown == there
    sizes = [path.stat().st_size for path in there]
    assert max(sizes) < 300_000
    assert sum(sizes) < 1_700_000


def test_tests_that_are_named_are_there() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (DOCS / "model.md").read_text("utf-8"))
    assert len(named) > 50
    for path, name in named:
        assert re.search(rf"^def {name}\b", (ROOT / path).read_text("utf-8"), re.M), (path, name)


def test_the_site_needs_no_network() -> None:
    settings = (ROOT / "mkdocs.yml").read_text("utf-8")
    assert "font: false" in settings
    assert "http" not in settings
    for path in [*PAGES, DOCS / "style.css", DOCS / "javascripts" / "iframe-worker.js"]:
        assert not re.search(r"(src|href)=.https?:|@import|\]\(https?:", path.read_text("utf-8"))


def test_the_build_fails_on_a_warning() -> None:
    assert "strict: true" in (ROOT / "mkdocs.yml").read_text("utf-8")
    build = (ROOT / ".ci" / "docs").read_text("utf-8")
    assert '"$bin/mkdocs" build' in build
    assert 'mkdocs" build --quiet' not in build  # which lets warnings pass


def test_every_public_package_has_a_page() -> None:
    public = {
        ".".join(p.parent.relative_to(ROOT).parts)
        for p in (ROOT / "fynjax").rglob("__init__.py")
        if "/_" not in str(p.parent.relative_to(ROOT)) and "__all__" in p.read_text("utf-8")
    }
    assert {*SITE.PACKAGES, "fynjax.app", "fynjax.app.cli"} - {"fynjax.errors"} == public
    for package in SITE.PACKAGES:
        __import__(package)
        names = SITE.public_names(package)
        assert all(hasattr(sys.modules[package], name) for name in names)
