"""Every command writes the numbers that it wrote before, and a page with all its pictures."""

import json
from pathlib import Path

import pytest
import typer

from fynjax.app.cli import app
from tests.frozen.cases import CASES, run
from tests.frozen.numbers import differences

HERE = Path(__file__).parent
MARKED = [
    pytest.param(command, marks=getattr(pytest.mark, case.mark) if case.mark else ())
    for command, case in CASES.items()
]


@pytest.mark.parametrize("command", MARKED)
def test_numbers_are_those_frozen(command: str, tmp_path: Path) -> None:
    frozen = json.loads((HERE / f"{command}.json").read_text("utf-8"))
    lines = differences(frozen, run(command, tmp_path), CASES[command].loose)
    for folder in filter(Path.is_dir, (tmp_path / "out").iterdir()):
        pictures = len(list(folder.glob("*.png")))
        shown = (folder / "report.html").read_text("utf-8").count("<img ") if pictures else 0
        assert shown == pictures, f"{folder.name}: {shown} of {pictures} pictures are on the page"
    more = f"\n... and {len(lines) - 20} more" if len(lines) > 20 else ""
    meant = f"\nIf the change is meant: python -m tests.frozen.write {command}"
    assert not lines, f"fynjax {command}:\n" + "\n".join(lines[:20]) + more + meant


def test_every_command_has_a_case() -> None:
    names = set()
    for name, command in typer.main.get_command(app).commands.items():
        names |= {f"{name}-{part}" for part in getattr(command, "commands", ())} or {name}
    assert names == set(CASES)
