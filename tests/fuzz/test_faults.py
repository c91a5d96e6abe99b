"""Two faults of one command; `python -m tests.fuzz.faults` tries all of both."""

from pathlib import Path

import pytest

from tests.fuzz.faults import FAULTS, Ended, Study
from tests.helpers import unix


@unix
def test_a_run_that_is_ended_goes_on_or_says_why(tmp_path: Path) -> None:
    study = Study(tmp_path, 0, ["frames"], warm=False)
    for fault in ("SIGTERM", "full disk"):
        kind, why = study.tried("frames", fault)
        assert kind in ("equal", "says why"), f"{fault}: {why}"


@unix
def test_files_that_differ_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without runs: the second of a pair leaves another file."""
    study = Study(tmp_path, 0, [], warm=False)
    study.whole["calibrate", False] = {"out/map.csv": b"1"}, 0.0
    monkeypatch.setattr("tests.fuzz.faults._begin", lambda *given: _Gone())
    monkeypatch.setattr("tests.fuzz.faults._end", lambda process: Ended(0, ""))
    for content, kind in ((b"1", "equal"), (b"2", "other")):
        files = {"out/map.csv": content}
        monkeypatch.setattr("tests.fuzz.faults._files", lambda folder, files=files: files)
        assert study.tried("calibrate", "SIGKILL")[0] == kind
    monkeypatch.setattr(
        "tests.fuzz.faults._end", lambda process: Ended(1, "Traceback (most recent call last):\n")
    )
    assert study.tried("calibrate", "SIGKILL")[0] == "other"
    assert set(FAULTS) >= {"SIGKILL", "SIGTERM", "Ctrl-C twice", "full disk", "input changed"}


class _Gone:
    """A process that has ended."""

    pid = 2**22 + 1

    def wait(self, seconds: float) -> int:
        return 0

    def poll(self) -> int:
        return 0
