"""The record of when studies last passed."""

from types import SimpleNamespace

import pytest

from tests import passes


def report(file, outcome, when="call", marks=("study",)):
    return SimpleNamespace(
        keywords=dict.fromkeys(marks), nodeid=f"{file}::test_a", when=when,
        passed=outcome == "passed", failed=outcome == "failed",
    )  # fmt: skip


def test_every_file_with_studies_has_a_row_and_no_other():
    assert passes.read().keys() == passes.with_studies()


@pytest.fixture
def record(tmp_path, monkeypatch):
    record = tmp_path / "studies.csv"
    record.write_text("file,tests,date,commit\nb.py,2,2026-01-01,abc\nc.py,1,2026-01-02,abd\n")
    monkeypatch.setattr(passes, "_passed", {})
    monkeypatch.setattr(passes, "_failed", set())
    return record


def test_files_whose_studies_passed_are_noted_and_others_keep_their_row(record):
    for one in (
        report("a.py", "passed"), report("a.py", "passed"), report("a.py", "passed", "setup"),
        report("a.py", "passed", marks=()), report("b.py", "passed"), report("b.py", "failed"),
        report("d.py", "failed", "setup"), report("d.py", "passed"), report("e.py", "skipped"),
    ):  # fmt: skip
        passes.pytest_runtest_logreport(one)
    passes.note(passes._passed, passes._failed, ("2026-02-01", "def"), record)
    assert record.read_text().splitlines() == [
        "file,tests,date,commit",
        "a.py,2,2026-02-01,def",
        "b.py,2,2026-01-01,abc",
        "c.py,1,2026-01-02,abd",
    ]


WHOLE = {"keyword": "", "markexpr": "study", "deselect": None}


@pytest.mark.parametrize(
    ("asked", "args", "status"),
    [
        ({"keyword": "a"}, ["tests"], 0),
        ({"markexpr": "study and not slow"}, ["tests"], 0),
        ({"deselect": ["tests/a.py::test_a"]}, ["tests"], 0),
        ({}, ["tests/a.py::test_a"], 0),
        ({}, ["tests"], 2),
        ({}, ["tests"], None),
        ({}, ["tests"], 1),
    ],
)
def test_a_part_of_a_file_is_not_noted(asked, args, status, monkeypatch):
    noted = []
    monkeypatch.setattr(passes, "note", lambda *_: noted.append(1))
    monkeypatch.setattr(passes, "_run", "abc")
    config = SimpleNamespace(option=SimpleNamespace(**WHOLE | asked), args=args)
    if status is None:
        config.workerinput = {}
    session = SimpleNamespace(config=config, shouldfail=False, shouldstop=False)
    passes.pytest_sessionfinish(session, status or 0)
    assert len(noted) == (status == 1)
