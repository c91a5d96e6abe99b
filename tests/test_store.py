"""What is kept from run to run is the user's own, whole, and of the code that made it."""

import errno
import json
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fynjax._core import store
from fynjax._core.checkpoint import Journal, signature
from fynjax._core.errors import InputError
from fynjax._core.store import Store, code_hash
from fynjax.app.cli import app

unix = pytest.mark.skipif(sys.platform == "win32", reason="links and modes as Unix has them")


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    store._warn_of.cache_clear()
    return tmp_path / "cache" / "fynjax"


def small(kind: str = "leaves", largest: int = 1 << 20, entry: int = 1 << 10) -> Store:
    return Store(kind, largest, entry)


def entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns)


def test_what_is_put_is_given_to_every_process_of_the_user(root: Path) -> None:
    assert small().get("a") is None
    assert not root.exists()  # who asks makes nothing
    small().put("a", b"one")
    small().put("b", b"")
    assert (small().get("a"), small().get("b"), small("jax").get("a")) == (b"one", b"", None)
    small().put("a", b"two")
    assert small().get("a") == b"two"
    small().put("c", bytes(1 << 11))  # larger than an entry may be
    assert small().get("c") is None


@unix
def test_the_folder_is_for_its_owner_alone_whatever_the_umask(root: Path) -> None:
    before = os.umask(0)
    try:
        small().put("a", b"one")
        folders = [root, root / "leaves"]
        files = [root / "secret", *entries(root / "leaves")]
        assert [stat.S_IMODE(path.stat().st_mode) for path in folders] == [0o700] * 2
        assert [stat.S_IMODE(path.stat().st_mode) for path in files] == [0o600] * 2
        root.chmod(0o777)  # as an older version left it
        assert small().get("a") == b"one"
        assert stat.S_IMODE(root.stat().st_mode) == 0o700
    finally:
        os.umask(before)


def test_what_was_changed_swapped_or_put_there_by_others_is_none(root: Path) -> None:
    keys = ("a", "b")
    for key in keys:
        small().put(key, key.encode() * 9)
    first, second = entries(root / "leaves")
    whole = first.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        first.write_bytes(damaged)
        assert small().get("a") is None
        assert not first.exists()
    first.write_bytes(whole[:-1])
    assert small().get("a") is None
    # A whole entry in the place of another, of its kind and of another.
    first.write_bytes(second.read_bytes())
    assert small().get("a") is None
    small("jax").put("b", b"other")
    os.replace(entries(root / "jax")[0], second)
    assert small().get("b") is None
    # One that was hashed with another secret, or where there is none.
    first.write_bytes(whole)
    assert small().get("a") == b"a" * 9
    (root / "secret").write_bytes(bytes(32))
    assert small().get("a") is None
    (root / "secret").write_bytes(b"short")
    assert small().get("a") is None
    small().put("a", b"again")
    assert small().get("a") == b"again"


@unix
def test_links_and_folders_of_others_are_not_used(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small().put("a", b"one")
    (entry,) = entries(root / "leaves")
    kept = tmp_path / "kept"
    entry.rename(kept)
    entry.symlink_to(kept)
    assert small().get("a") is None
    (root / "leaves").rename(tmp_path / "elsewhere")
    (root / "leaves").symlink_to(tmp_path / "elsewhere")
    with pytest.warns(UserWarning, match=r"leaves is a link, no folder, or another user's"):
        small().put("b", b"two")
    assert small().get("b") is None  # said once
    assert len(list((tmp_path / "elsewhere").iterdir())) == 1
    (root / "leaves").unlink()
    kept.rename(tmp_path / "mine")
    small().put("a", b"one")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.warns(UserWarning, match="fynjax is a link, no folder, or another user's"):
        assert small().get("a") is None


def test_the_entries_that_were_not_used_for_longest_make_room(root: Path) -> None:
    """Each takes 132 bytes; four have room."""
    kept = small(largest=600)
    for number, key in enumerate("abcd"):
        kept.put(key, bytes(100))
        os.utime(entries(root / "leaves")[-1], (number, number))
    assert kept.get("a") is not None
    kept.put("e", bytes(100))
    assert [key for key in "abcde" if kept.get(key) is None] == ["b"]
    assert sum(path.stat().st_size for path in entries(root / "leaves")) <= 600
    other = small(largest=200)  # another process, which has put none so far
    other.put("f", bytes(100))
    assert len(entries(root / "leaves")) == 1
    assert other.get("f") is not None


def test_without_a_home_nothing_is_kept_and_nothing_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # which is none, by its standard
    monkeypatch.setattr(Path, "home", none)
    monkeypatch.chdir(tmp_path)
    small().put("a", b"one")
    assert small().get("a") is None
    assert not (tmp_path / "relative").exists()
    with pytest.raises(InputError, match="nothing is kept: Could not determine home"):
        store.clear()


def test_the_hash_of_code_is_of_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_core/store.py", "leaf/a.py", "cli/b.py"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(name)
    monkeypatch.setattr(store, "__file__", str(tmp_path / "_core" / "store.py"))
    of = code_hash.__wrapped__
    whole, leaf = of(), of("leaf", "_core/store.py")
    (tmp_path / "cli" / "b.py").write_text("x = 2")
    assert of("leaf", "_core/store.py") == leaf
    assert of() != whole
    (tmp_path / "leaf" / "a.py").write_text("x = 2")
    assert of("leaf", "_core/store.py") != leaf
    before = of("leaf")
    (tmp_path / "leaf" / "a.py").rename(tmp_path / "leaf" / "c.py")
    assert of("leaf") != before


PROGRAMS = """
import jax, json, sys
from jax import monitoring
hits = []
monitoring.register_event_listener(lambda name, **_: hits.append(name))
import fynjax.scene
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
one = jax.jit(lambda x: x + 1.0)
two = jax.jit(lambda x: x + 99.0)
found = [float(one(1.0)), float(two(1.0))]
print(json.dumps([found, hits.count("/jax/compilation_cache/cache_hits")]))
"""


def test_a_compiled_program_that_was_swapped_is_compiled_anew(root: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}

    def computed() -> tuple[list[float], int]:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAMS], capture_output=True, text=True, check=True,
            env=environment,
        )  # fmt: skip
        found, hits = json.loads(done.stdout)
        return found, hits

    right = [2.0, 100.0]
    assert computed() == (right, 0)
    files = entries(root / "jax")
    found, hits = computed()
    assert found == right
    assert hits == len(files) >= 2
    # JAX's own way of keeping them, in the same place, is not what is read.
    contents = [path.read_bytes() for path in files]
    for path, content in zip(files, [*contents[1:], contents[0]], strict=True):
        path.write_bytes(content)
    assert computed() == (right, 0)
    assert computed() == (right, len(files))


def test_doctor_clears_what_is_kept_and_nothing_else(root: Path) -> None:
    small().put("a", b"one")
    small("jax").put("b", bytes(968))
    (root / "locks").mkdir()
    (root / "notes.txt").write_text("mine")
    shown = CliRunner().invoke(app, ["doctor", "--clear", "--json"])
    assert json.loads(shown.stdout) == {"folder": str(root), "files": 2, "bytes": 1035}
    assert [path.name for path in root.iterdir()] == ["notes.txt"]
    shown = CliRunner().invoke(app, ["doctor", "--clear"])
    assert shown.stdout.startswith("Removed 0 files, 0.0 MiB, from ")


def test_a_step_of_a_checkpoint_in_the_place_of_another_is_refused(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "kept", "s")
    for number in range(2):
        journal.put(number, (np.arange(3.0) + number,))
    first, second = sorted((tmp_path / "kept").glob("*.npz"))
    whole = first.read_bytes()
    first.write_bytes(second.read_bytes())
    with pytest.raises(InputError, match=r"0000\.npz: no checkpoint of this step"):
        Journal(tmp_path / "kept", "s").kept(0)
    first.write_bytes(whole)
    Journal(tmp_path / "other", "t").put(0, (np.arange(3.0),))
    first.write_bytes((tmp_path / "other" / first.name).read_bytes())
    with pytest.raises(InputError, match="no checkpoint of this step"):
        Journal(tmp_path / "kept", "s").kept(0)


@unix
def test_a_checkpoint_is_its_owners_and_follows_no_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path / "kept", "s")
    assert stat.S_IMODE((tmp_path / "kept").stat().st_mode) == 0o700
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    work = tmp_path / "kept" / "calibration.0000.npz.work"
    work.symlink_to(mine)
    with pytest.raises(InputError, match=r"cannot keep what was done: .*npz\.work is a link"):
        journal.put(0, (np.arange(3),))
    assert mine.read_text() == "mine"
    work.unlink()
    work.write_bytes(bytes(10_000))  # what a killed run left
    journal.put(0, (np.arange(3),))
    assert journal.kept(0)[0].tolist() == [0, 1, 2]
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(InputError, match="belongs to another user"):
        Journal(tmp_path / "kept", "s")


def test_a_checkpoint_is_of_the_code_that_made_it(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signature("a", 1)
    monkeypatch.setattr("fynjax._core.checkpoint.code_hash", lambda: "other")
    assert signature("a", 1) != before


def test_a_signature_differs_wherever_its_parts_do() -> None:
    """Each of these is another run: keys and values of tables, members of sets and records, what
    functions are, are given and close over, types, shapes and precision."""

    def scaled(by: float) -> Callable[[float], float]:
        return lambda x: by * x

    @dataclass
    class Record:
        a: object
        b: object = None

    numbers = np.arange(6.0)
    runs = [
        *({}, {"a": 1}, {"b": 1}, {"a": 2}, {"a": 1, "b": 1}, [], [1], [1, 2], [2, 1], [[1], 2]),
        *({1, 2}, {1, 3}, {(1, 2)}, Record(1), Record(2), Record(None, 1), Record(Record(1))),
        *(
            scaled(2.0),
            scaled(3.0),
            partial(scaled, 2.0),
            partial(scaled, by=2.0),
            partial(scaled, by=3.0),
        ),
        *(1, 1.0, "1", True, None, numbers, numbers[::-1], numbers.reshape(2, 3)),
        *(numbers.astype(np.float32), numbers.astype(int), numbers[:5]),
    ]
    signed = [signature(run) for run in runs]
    assert len(set(signed)) == len(runs)
    assert signed == [signature(run) for run in runs]
    assert signature({2, 1}) == signature({1, 2})
    assert signature(scaled(2.0)) == signature(scaled(2.0))
    assert signature(numbers[::-1]) == signature(numbers[::-1].copy())


def test_what_cannot_be_written_is_not_kept(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    small().put("a", b"one")
    monkeypatch.setattr(os, "replace", full)
    small().put("b", b"two")
    assert small().get("b") is None
    assert len(entries(root / "leaves")) == 1
