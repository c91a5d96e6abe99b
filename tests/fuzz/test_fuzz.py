"""A minute of damaged files with a fixed seed, and what the fuzzer itself must notice."""

import random
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from tests.fuzz.bugs import BUGS, ROOT
from tests.fuzz.mutate import damaged
from tests.fuzz.readers import READERS, Reader
from tests.fuzz.run import Input, _tried, fuzz


@pytest.mark.skipif(sys.platform == "win32", reason="limits of memory are set as Unix has them")
def test_damaged_files_end_in_one_clear_error() -> None:
    counts, broken = fuzz(list(READERS), seed=0, each=16)
    assert [f"{o.reader} {o.number}: {o.text}" for o in broken] == []
    assert all(count["refused"] > 1 for count in counts.values())
    assert sum(count["accepted"] for count in counts.values()) > 100


def test_every_seed_is_a_valid_file(tmp_path: Path) -> None:
    for name, reader in READERS.items():
        (tmp_path / name).mkdir()
        reader.write(tmp_path / name)
        assert reader.read(tmp_path / name) is not None, name


def test_every_bug_can_be_put_in_as_its_study_does() -> None:
    for name, bug in BUGS.items():
        assert (ROOT / "fynjax" / bug.file).read_text("utf-8").count(bug.old) == 1, name
        assert set(bug.readers) <= set(READERS), name


def test_the_same_numbers_damage_a_file_alike() -> None:
    data = b"name = 1.5\n" * 20
    one, again, other = (damaged(data, random.Random(seed)) for seed in (1, 1, 2))
    assert one == again != other
    assert data not in (one, other)


def _says(message: str) -> Reader:
    def read(folder: Path) -> None:
        raise InputError(message, file=folder / "a.csv")

    return Reader(Path.mkdir, read)


def _warns(folder: Path) -> None:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)


def _deprecates(folder: Path) -> None:
    warnings.warn("in a later version", DeprecationWarning, stacklevel=1)


def _fails(folder: Path) -> None:
    raise IndexError("out of range")


@pytest.mark.parametrize(
    ("reader", "kind", "words"),
    [
        (_says("expected a number"), "refused", "expected a number"),
        (_says("expected a number, but got " + "0, 1, 2, " * 60), "other", "repeats the content"),
        (Reader(Path.mkdir, _fails), "other", "IndexError at "),
        (Reader(Path.mkdir, _warns), "other", "RuntimeWarning at "),
        (Reader(Path.mkdir, _deprecates), "accepted", ""),
        (Reader(Path.mkdir, lambda folder: {"a": [np.nan]}), "other", "accepted with NaN"),
        (Reader(Path.mkdir, lambda folder: {"a": [np.nan]}, missing=True), "accepted", ""),
        (Reader(Path.mkdir, lambda folder: (1.0, 1e266), missing=True), "other", "impossible"),
        (Reader(Path.mkdir, lambda folder: np.arange(3.0)), "accepted", ""),
    ],
)
def test_what_counts_as_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: Reader, kind: str, words: str
) -> None:
    monkeypatch.setitem(READERS, "own", reader)
    found, text = _tried("own", tmp_path, Input({"a.csv": b"0, 1, 2, " * 60}))
    assert found == kind
    assert words in text
