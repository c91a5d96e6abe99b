"""A minute of damaged files with a fixed seed, and what the fuzzer itself must notice."""

import itertools
import random
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fynjax._core.errors import InputError
from tests.fuzz.bugs import BUGS, ROOT, SILENT, found
from tests.fuzz.mutate import damaged
from tests.fuzz.oracle import LIBRARIES, TOUCHED, other_opinion, untouched
from tests.fuzz.readers import READERS, Reader
from tests.fuzz.run import Input, _contents, _tried, fuzz
from tests.fuzz.variants import VARIANTS, difference, plain, vary
from tests.helpers import unix


@unix
def test_damaged_files_end_in_one_clear_error() -> None:
    counts, broken = fuzz(list(READERS), seed=0, each=10)
    assert [f"{o.reader} {o.number}: {o.text}" for o in broken] == []
    assert all(count["refused"] > 0 for count in counts.values())
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


class InPairs(random.Random):
    """Gives every pair of options once."""

    number, count, pair = 0, 5, ()

    def sample(self, population: Sequence[str], *given: Any, **named: Any) -> list[str]:
        pairs = list(itertools.combinations(population, 2))
        self.count, self.pair = len(pairs), pairs[self.number % len(pairs)]
        return list(self.pair)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("reader", VARIANTS)
def test_a_file_that_says_it_in_another_way_is_read_alike(reader: str, tmp_path: Path) -> None:
    """Scale, ignore value, units, order and more, in pairs."""
    (tmp_path / "seed").mkdir()
    READERS[reader].write(tmp_path / "seed")
    whole = plain(reader, READERS[reader].read(tmp_path / "seed"))
    chance = InPairs(0)
    contents = set()
    while chance.number < chance.count:
        folder = tmp_path / f"{chance.number}"
        shutil.copytree(tmp_path / "seed", folder)
        hidden = vary(reader, folder, chance)
        again = plain(reader, READERS[reader].read(folder))
        assert difference(whole, again, hidden) is None, chance.pair
        contents.add(tuple(_contents(folder).values()))
        chance.number += 1
    assert len(contents) > chance.count // 3


@pytest.mark.filterwarnings("ignore")
def test_numbers_that_are_others_are_seen(tmp_path: Path) -> None:
    rising = np.arange(9.0)
    assert difference({"a": rising}, {"a": rising[::-1]}) == ".a[0] is 8, not 0"
    assert difference({"a": rising}, {"a": rising}) is None
    assert "not nan" in str(difference([np.arange(9.0)], [np.arange(9.0)], np.array([3.0])))
    for reader in ("las", "xyz", "cube-envi"):
        folder = tmp_path / reader
        folder.mkdir()
        READERS[reader].write(folder)
    las, xyz = (READERS[one].read(tmp_path / one) for one in ("las", "xyz"))
    swapped = replace(las, x=las.y, y=las.x)
    assert other_opinion("las", tmp_path / "las", las) is None
    assert "laspy's x reads 412306 at [0], we 6.1912e+06" in str(
        other_opinion("las", tmp_path / "las", swapped)
    )
    assert "pandas' x" in str(other_opinion("xyz", tmp_path / "xyz", replace(xyz, x=xyz.y)))
    cube = READERS["cube-envi"].read(tmp_path / "cube-envi")
    turned = replace(cube, values=cube.values[..., ::-1])
    assert other_opinion("cube-envi", tmp_path / "cube-envi", cube) is None
    assert "spectral reads" in str(other_opinion("cube-envi", tmp_path / "cube-envi", turned))
    before = _contents(tmp_path / "xyz")
    rows = before["cloud.xyz"].split(b"\n")
    after = {"cloud.xyz": b"\n".join([b"1 2 3", *rows[1:]])}
    first = replace(xyz, x=np.r_[1.0, xyz.x[1:]])
    assert untouched("xyz", before, after, xyz, first) is None
    second = replace(xyz, x=np.r_[1.0, 7.0, xyz.x[2:]])
    assert "we 7" in str(untouched("xyz", before, after, xyz, second))


def test_who_judges_what_is_accepted_is_known() -> None:
    assert {*LIBRARIES, *TOUCHED, *VARIANTS} <= set(READERS)
    assert {library.__qualname__.split(".")[0] for library in LIBRARIES.values()} >= {
        "_spectral", "_laspy", "_rasterio", "_pandas", "_trimesh"
    }  # fmt: skip


@pytest.mark.study  # each copies the package and tries 200 files in processes of their own
@pytest.mark.parametrize("name", SILENT)
def test_bugs_without_an_error_are_found_in_200_tries(name: str) -> None:
    was_found, line = found(BUGS[name], 200)
    assert was_found, line
