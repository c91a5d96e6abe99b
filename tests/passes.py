"""When the studies of each file last passed, in `studies.csv`: `pytest -m study -p tests.passes`
notes it of files that it ran whole.

`python -m tests.passes` prints them, those first of which the library changed most since.
"""

import csv
import re
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import pytest

RECORD = Path(__file__).with_name("studies.csv")
STUDY = re.compile(r"mark\.study|@_case\(.*\"study\"")


class Pass(NamedTuple):
    """A row of the record."""

    file: str
    """From this folder's parent."""
    tests: int
    """Number of studies that passed."""
    date: str
    """Of the end of the run; empty before the first."""
    commit: str
    """That was run; with + where files were changed beside it."""


def read(record: Path = RECORD) -> dict[str, Pass]:
    """Rows of the record by file."""
    with record.open(encoding="utf-8", newline="") as lines:
        rows = csv.reader(lines)
        assert next(rows) == [*Pass._fields]
        return {file: Pass(file, int(n), *rest) for file, n, *rest in rows}


def note(
    passed: dict[str, int], failed: set[str], now: tuple[str, str], record: Path = RECORD
) -> None:
    """Write which files passed into the record; those that failed keep their row.

    **Arguments:** number of studies that passed by file, files with one that failed, date and
    commit."""
    rows = read(record)
    rows |= {f: Pass(f, n, *now) for f, n in passed.items() if f not in failed}
    with record.open("w", encoding="utf-8", newline="") as lines:
        csv.writer(lines, lineterminator="\n").writerows([Pass._fields, *sorted(rows.values())])


def with_studies() -> set[str]:
    """Files that have studies, as the record names them."""
    here = Path(__file__).parent
    files = [*here.rglob("test_*.py"), here / "frozen/cases.py"]
    names = {
        f.relative_to(here.parent).as_posix() for f in files if STUDY.search(f.read_text("utf-8"))
    }
    return {name.replace("/cases.py", "/test_frozen.py") for name in names}


def _git(*words: str) -> str:
    command = ["git", *words]
    try:
        run = subprocess.run(command, cwd=RECORD.parent, capture_output=True, text=True)
    except OSError:  # no git
        return ""
    return run.stdout.strip()


def _commit() -> str:
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":!studies.csv")
    return _git("rev-parse", "--short=10", "HEAD") + "+" * bool(changed)


_run = _commit()  # as it is when the run begins
_passed: dict[str, int] = {}
_failed: set[str] = set()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Count a study that passed or failed."""
    if "study" in report.keywords:
        file = report.nodeid.partition("::")[0]
        if report.failed:
            _failed.add(file)
        elif report.passed and report.when == "call":
            _passed[file] = _passed.get(file, 0) + 1


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Note them where files were run whole."""
    asked, config = session.config.option, session.config
    some = asked.keyword or asked.deselect or getattr(asked, "lf", False)
    whole = asked.markexpr == "study" and not some and _run.strip("+")
    ended = exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
    if hasattr(config, "workerinput") or any("::" in word for word in config.args):
        return
    if not (whole and ended) or session.shouldfail or session.shouldstop:
        return
    note(_passed, _failed, (datetime.now(UTC).strftime("%Y-%m-%d"), _run))


if __name__ == "__main__":
    since = lambda row: f"{row.commit.rstrip('+')}..HEAD"  # noqa: E731
    count = lambda row: _git("rev-list", "--count", since(row), "--", "../fynjax")  # noqa: E731
    rows = read().values()
    # Of a commit that is not there, as in a clone without history, more than any.
    behind = {row: float(count(row) or "inf") for row in rows if row.date}
    print(*(f"{row.file:50s} no pass is noted" for row in rows if not row.date), sep="\n")
    for row, count in sorted(behind.items(), key=lambda pair: -pair[1]):
        print(f"{row.file:50s} {row.tests:4d} on {row.date}, {count:g} changes of the library ago")
