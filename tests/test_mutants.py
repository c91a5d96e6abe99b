"""Every fault of `python -m tests.mutants` can still be put in."""

from pathlib import Path

import pytest
import yaml

from tests.mutants import GROUPS, Mutant, is_found, is_there

ALL = [
    pytest.param(one, id=f"{group}-{i}") for group in GROUPS for i, one in enumerate(GROUPS[group])
]


@pytest.mark.parametrize("mutant", ALL)
def test_the_line_that_is_changed_is_there_once(mutant: Mutant) -> None:
    assert is_there(mutant), mutant.old


def test_every_group_is_run_each_night() -> None:
    nightly = Path(__file__).parents[1] / ".github/workflows/nightly.yml"
    matrix = yaml.safe_load(nightly.read_text("utf-8"))["jobs"]["mutants"]["strategy"]["matrix"]
    assert matrix["group"] == [*GROUPS]


@pytest.mark.slow  # copies the package, and runs tests in a process of their own
def test_a_fault_is_told_from_a_change_without_one() -> None:
    mutant = next(one for one in GROUPS["strict"] if one.file == "io/text/_cells.py")
    mutant = mutant._replace(tests=f"{mutant.tests} spreadsheets")
    assert is_found(mutant)
    assert not is_found(mutant._replace(new=mutant.old))
