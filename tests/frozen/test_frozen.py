"""Every command writes the numbers that it wrote before, and a page with all its pictures."""

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import typer
from PIL import Image

from fynjax.app.cli import app
from tests.frozen.cases import CASES, run
from tests.frozen.numbers import differences, numbers_of

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
        page = (folder / "report.html").read_text("utf-8") if pictures else ""
        shown = page.count('<div class="picture')
        assert shown == pictures, f"{folder.name}: {shown} of {pictures} pictures are on the page"
    more = f"\n... and {len(lines) - 20} more" if len(lines) > 20 else ""
    meant = f"\nIf the change is meant: python -m tests.frozen.write {command}"
    assert not lines, f"fynjax {command}:\n" + "\n".join(lines[:20]) + more + meant


def test_every_command_has_a_case() -> None:
    names = set()
    for name, command in typer.main.get_command(app).commands.items():
        names |= {f"{name}-{part}" for part in getattr(command, "commands", ())} or {name}
    assert names == set(CASES)


def _shown(
    folder: Path, step: int = 1, mean: str = "0.132", turn: int = 1
) -> dict[str, list[float]]:
    """Numbers of a picture, a page, sentences and a cloud."""
    folder.mkdir()
    picture = np.full((60, 80, 3), 240, np.uint8)
    picture[:, :40] = (200, 80, 60)
    Image.fromarray(picture[:, ::step]).save(folder / "maps.png")
    (folder / "report.html").write_text(
        f'<main><p>{folder}/1.nc 2026-11-28</p><div class="key"><b>{mean}</b></div>'
        f"<section><td>1234</td></section><p>Wall time. {len(folder.name)} s</p>"
        "<footer>5</footer></main>"
    )
    sentence = f"The mean of the image in the red is {mean} after the run."
    (folder / "summary.json").write_text(json.dumps({"headline": [sentence]}))
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.x = las.y = las.z = np.arange(5.0)
    las.gps_time = np.arange(5.0)[::turn] ** 2
    las.write(folder / "cloud.las")
    return numbers_of(folder)


def test_pictures_pages_sentences_and_times_of_pulses_are_compared(tmp_path: Path) -> None:
    old = _shown(tmp_path / "a")
    assert differences(old, _shown(tmp_path / "again"), {}) == []
    for name, change, where in (
        ("b", {"step": -1}, ["maps.png: colours of parts"]),
        ("c", {"mean": "0.155"}, ["report.html: numbers shown", "summary.json: headline[]: said"]),
        ("d", {"turn": -1}, ["cloud.las: gps_time"]),
    ):
        lines = differences(old, _shown(tmp_path / name, **change), {})
        assert [line.rpartition(": ")[0].split(": [")[0] for line in lines] == where
    later = ("colours of parts", "numbers shown", ": said", ": gps_time")
    earlier = {name: one for name, one in old.items() if not name.endswith(later)}
    assert differences(earlier, old, {}) == []  # of a case that has frozen none of their kind
