"""Parts of a job on processes: the same results, and what is left when one of them is killed."""

import contextlib
import errno
import hashlib
import io
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import dask
import jax
import jax.numpy as jnp
import numpy as np
import psutil
import pytest

from fynjax._core import parts
from fynjax._core.checkpoint import Journal, forget_journal
from fynjax._core.errors import InputError
from fynjax._core.parts import Pool, Workers, at_work
from tests.heard import hearing
from tests.helpers import unix

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""dask leaves pipes and sockets of processes that died to the garbage collection."""


@contextlib.contextmanager
def pool_of(count: int) -> Iterator[Pool]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts, "_machine", lambda: (2, 8 * 2**30))
        with at_work(Workers(count)) as pool:
            yield pool


@pytest.fixture(scope="module")
def two() -> Iterator[Pool]:
    with pool_of(2) as pool:
        yield pool


def called(folder: Path, number: int) -> int:
    """Calls of a part so far."""
    return len(list(folder.glob(f"{number}.*")))


def note(folder: Path, number: int) -> int:
    (folder / f"{number}.{os.getpid()}.{time.monotonic_ns()}").touch()
    return called(folder, number)


def scaled(number: int, factor: float) -> tuple[np.ndarray, ...]:
    if number == 5:
        warnings.warn("five is odd", stacklevel=1)
    return np.array([number * factor]), np.array(os.getpid())


def light(number: int, matrix: np.ndarray) -> tuple[jax.Array, ...]:
    """Sums and products in both precisions, long enough to be shared among threads."""
    a = jnp.asarray(matrix) + number
    wide = jnp.sin(a) @ jnp.cos(a).T
    return wide, wide.sum(), a.astype(jnp.float32) @ a.astype(jnp.float32), jnp.exp(a).mean(axis=0)


def numbered(number: int, folder: Path, faulty: str) -> tuple[np.ndarray, ...]:
    """The square of a number; part 2 has a fault at its first call, or at all."""
    calls = note(folder, number)
    if number == 2 and (calls == 1 or faulty.startswith("always")):
        match faulty.split()[-1]:
            case "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            case "full":
                raise OSError(errno.ENOSPC, "No space left on device")
            case "wrong":
                raise ValueError("no leaves")
    return (np.array(number**2),)


def length(part: np.ndarray, shared: np.ndarray) -> tuple[np.ndarray, ...]:
    return (np.array(part.size + shared.size),)


def same(*arrays: jax.Array) -> tuple[jax.Array, ...]:
    return arrays


def place(number: int) -> tuple[np.ndarray, ...]:
    return (np.array(sorted(os.sched_getaffinity(0))),)


def quick(number: int, folder: Path) -> tuple[np.ndarray, ...]:
    note(folder, number)
    return (np.array(number),)


def slow(number: int, folder: Path) -> tuple[np.ndarray, ...]:
    found = quick(number, folder)
    time.sleep(0.2)
    return found


def test_two_processes_give_what_one_does(two) -> None:
    names = [f"plot {i}" for i in range(7)]
    with hearing() as heard, pytest.warns(UserWarning, match="five is odd"):
        there = two.all(scaled, range(7), 0.1, names=names)
    with pytest.warns(UserWarning, match="five is odd"), at_work(Workers(0)) as pool:
        here = pool.all(scaled, range(7), 0.1)
    assert [a[0].tobytes() for a in there] == [a[0].tobytes() for a in here]
    assert os.getpid() not in {int(pid) for _, pid in there}
    assert {int(pid) for _, pid in here} == {os.getpid()}
    assert heard.count == 7
    assert {info["part"] for info in heard.shown} == set(names)


def test_none_one_and_two_processes_give_the_same_bits(two) -> None:
    matrix = np.random.default_rng(1).normal(size=(300, 300))
    with pool_of(1) as one:
        found = [pool.all(light, range(4), matrix) for pool in (Pool(), one, two)]
    for parts_of in zip(*found, strict=True):
        first, *others = ([(x.dtype, x.tobytes()) for x in arrays] for arrays in parts_of)
        assert all(other == first for other in others)


def test_arrays_of_64_bits_come_whole_through_a_scheduler_of_32(two) -> None:
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            third = jnp.arange(4.0) / 3.0
            (found,) = two.all(same, [third], third)
    finally:
        jax.config.update("jax_enable_x64", True)
    assert [array.tobytes() for array in found] == 2 * [np.asarray(third).tobytes()]


def test_large_parts_are_sent_without_a_warning(two) -> None:
    million = np.zeros(1_000_000)
    found = two.all(length, [million, million], np.zeros(2_000_000))
    assert [int(a) for (a,) in found] == [3_000_000] * 2


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="cores are not chosen here")
def test_each_worker_keeps_to_a_core_of_its_own(two) -> None:
    places = {tuple(a.tolist()) for (a,) in two.all(place, range(8))}
    assert len(places) == min(2, len(os.sched_getaffinity(0)))
    assert all(len(cores) == 1 for cores in places)


def test_nobody_without_the_certificate_reaches_the_workers(two) -> None:
    from distributed import Client
    from distributed.security import Security

    addresses = [two._client.scheduler.address, *two._client.nthreads()]
    assert all(address.startswith("tls://127.0.0.1:") for address in addresses)
    for address in addresses:
        for other in (Security.temporary(), None):
            plain = address if other else address.replace("tls", "tcp")
            with pytest.raises((OSError, TimeoutError, ValueError)):
                Client(plain, timeout=1, security=other, set_as_default=False)
    listens = [c.laddr for c in psutil.Process().net_connections() if c.status == "LISTEN"]
    for child in psutil.Process().children(recursive=True):
        listens += [c.laddr for c in child.net_connections() if c.status == "LISTEN"]
    assert {address.ip for address in listens} == {"127.0.0.1"}


@unix
@pytest.mark.parametrize("fault", ["dies", "full"])
def test_what_fails_once_costs_its_part_only(two, tmp_path: Path, fault: str) -> None:
    found = two.all(numbered, range(6), tmp_path, fault)
    assert [int(a) for (a,) in found] == [0, 1, 4, 9, 16, 25]
    assert called(tmp_path, 2) == 2
    # With the process goes what it had done and nobody had fetched.
    assert sum(called(tmp_path, i) for i in range(6)) <= 7 + 4


@unix
def test_results_that_die_with_their_workers_are_computed_again(tmp_path: Path) -> None:
    """All parts are done, and none but the first fetched, when both workers are killed."""
    with pool_of(2) as pool:
        found = pool.each(numbered, [0, 1, 3, 4, 5], tmp_path, "")
        first = next(found)
        until(lambda: all(called(tmp_path, i) for i in (0, 1, 3, 4, 5)))
        for pid in pool._client.run(os.getpid).values():
            os.kill(pid, signal.SIGKILL)
        numbers = {i: int(a) for i, (a,) in [first, *found]}
    assert numbers == {0: 0, 1: 1, 2: 9, 3: 16, 4: 25}
    assert sum(called(tmp_path, i) for i in (0, 1, 3, 4, 5)) > 5


@pytest.mark.parametrize("where", ["here", "there"])
@pytest.mark.parametrize(("fault", "why"), [("wrong", "no leaves"), ("full", "No space left")])
def test_a_part_that_fails_is_named_and_the_others_are_kept(two, tmp_path, where, fault, why):
    pool = two if where == "there" else Pool()
    calls, kept = tmp_path / "calls", tmp_path / "kept"
    calls.mkdir()
    names = [f"plot {i}" for i in range(4)]
    with pytest.raises(InputError, match=f"1 of 4 parts failed: plot 2: .*{why}"):
        pool.all(
            numbered, range(4), calls, f"always {fault}", names=names, journal=Journal(kept, "s")
        )
    assert called(calls, 3) == 1
    (failed,) = kept.glob("*.failed.txt")
    assert failed.read_text().startswith("plot 2\n")
    assert "numbered of\n2\n" in failed.read_text()
    found = pool.all(numbered, range(4), calls, "", names=names, journal=Journal(kept, "s"))
    assert [int(a) for (a,) in found] == [0, 1, 4, 9]
    assert [called(calls, i) for i in (0, 1, 3)] == [1, 1, 1]
    assert not list(kept.glob("*.failed.txt"))
    forget_journal(kept)
    assert not kept.exists()


@unix
def test_what_cannot_be_removed_of_a_journal_stays(tmp_path: Path) -> None:
    """The results are there: nothing of the journal ends the run any more."""
    kept, link = tmp_path / "kept", tmp_path / "link"
    Journal(kept, "s").put(0, [np.ones(2)])
    (kept / "calibration.0001.npz").mkdir()
    (kept / "notes.txt").write_text("mine")
    link.symlink_to(kept)
    forget_journal(link)
    assert {path.name for path in kept.iterdir()} == {"calibration.0001.npz", "notes.txt"}


@unix
def test_a_part_that_kills_every_worker_is_named(tmp_path: Path) -> None:
    failures = dask.config.set({"distributed.scheduler.allowed-failures": 1})
    with (
        failures,
        pool_of(1) as pool,
        pytest.raises(InputError, match="1 of 3 parts failed: 3: every worker that tried it died"),
    ):
        pool.all(numbered, range(3), tmp_path, "always dies")
    assert called(tmp_path, 2) == 2
    assert called(tmp_path, 1) >= 1


def test_a_part_that_cannot_be_sent_is_refused(two) -> None:
    with pytest.raises(TypeError, match="pickle"):
        two.all(scaled, [threading.Lock()], 1.0)
    assert len(two.all(scaled, range(2), 1.0)) == 2


def test_a_full_disk_of_the_checkpoint_ends_in_one_line(tmp_path: Path, monkeypatch) -> None:
    journal = Journal(tmp_path / "kept", "s")

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    Pool().all(scaled, [1], 1.0, journal=journal)
    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(InputError, match="cannot keep what was done: No space left"):
        Pool().all(scaled, [2], 1.0, journal=journal)
    assert sorted(p.name for p in (tmp_path / "kept").iterdir()) == [
        "calibration.0000.npz",
        "calibration.mark",
    ]


def test_a_checkpoint_that_was_removed_meanwhile_is_not_said_to_stay(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "kept", "s")
    journal.put(0, (np.arange(3),))
    forget_journal(tmp_path / "kept")
    with pytest.raises(InputError, match="removed meanwhile: the same command begins anew"):
        journal.put(1, (np.arange(3),))


def test_a_flipped_bit_of_a_checkpoint_is_refused(tmp_path: Path) -> None:
    Journal(tmp_path, "s").put(0, (np.arange(6.0), np.array(3)))
    kept = Journal(tmp_path, "s").kept(0)
    assert kept is not None
    np.testing.assert_array_equal(kept[0], np.arange(6.0))
    (path,) = tmp_path.glob("*.npz")
    whole = path.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged one") as error:
            Journal(tmp_path, "s").kept(0)
        assert error.value.file == path
    path.write_bytes(whole[:-1])
    with pytest.raises(InputError, match="damaged one"):
        Journal(tmp_path, "s").kept(0)
    mark = tmp_path / "calibration.mark"
    for place in range(8):
        mark.write_bytes(bytes([ord("s") ^ 1 << place]) + b"\n")
        with pytest.raises(InputError, match="another run"):
            Journal(tmp_path, "s")


def test_a_checkpoint_from_somebody_else_runs_nothing_and_unfolds_to_nothing(tmp_path) -> None:
    Journal(tmp_path, "s").put(0, ())
    (path,) = tmp_path.glob("*.npz")
    contents = [b"", b"none", b"PK\5\6" + bytes(18)]
    for save, arrays in [
        (np.savez, {"a0": np.array([print], object)}),
        (np.savez_compressed, {"a0": np.zeros(1 << 22)}),
    ]:
        made = io.BytesIO()
        save(made, **arrays)
        contents.append(made.getvalue())
    made = io.BytesIO()
    np.save(made, np.arange(3))
    for content in [*contents, made.getvalue()]:
        name = f"s/{path.name}\n".encode()
        path.write_bytes(hashlib.sha256(name + content).digest() + content)
        if content[:4] == b"PK\5\6":  # an archive of nothing
            assert Journal(tmp_path, "s").kept(0) == ()
            continue
        with pytest.raises(InputError, match="damaged one"):
            Journal(tmp_path, "s").kept(0)


def test_more_workers_than_the_machine_has_room_for(monkeypatch) -> None:
    monkeypatch.setattr(parts, "_machine", lambda: (2, 3 * 2**30))
    for count, why in ((3, "may use 2 cores, but 3 workers"), (2, "1.3 GiB of memory each")):
        with pytest.raises(InputError, match=why), at_work(Workers(count)):
            pass
    with pytest.raises(InputError, match="at least 0"):
        Workers(-1)
    with pytest.raises(InputError, match="one of the two"):
        Workers(2, "tcp://127.0.0.1:8786")


def test_a_scheduler_that_does_not_answer(monkeypatch) -> None:
    monkeypatch.setattr(parts, "_CONNECT_SECONDS", 1.0)
    for address in ("tcp://127.0.0.1:9", "nowhere at all"):
        with (
            pytest.raises(InputError, match="no dask scheduler answers"),
            at_work(Workers(scheduler=address)),
        ):
            pass


def test_a_worker_of_another_version_is_not_fit(monkeypatch) -> None:
    settings = parts._settings(this_machine=True)
    other = {**dict(settings.versions), "jax": "0.1"}
    monkeypatch.setattr(parts, "_versions", lambda: tuple(other.items()))
    assert parts._unfit.__wrapped__(settings).startswith("it has jax 0.1, not ")


def test_each_worker_takes_an_accelerator_of_its_own(monkeypatch) -> None:
    monkeypatch.setattr(parts.metadata, "entry_points", lambda **_: ["cuda"])
    monkeypatch.setattr(parts.os, "sched_setaffinity", lambda *_: None, raising=False)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6")
    monkeypatch.setattr(parts.signal, "signal", lambda *_: None)
    monkeypatch.setattr(parts, "_machine", lambda: (3, 8 * 2**30))
    before = jax.config.jax_platforms
    try:
        jax.config.update("jax_platforms", None)
        with pytest.raises(InputError, match="2 accelerators, but 3 workers"), at_work(Workers(3)):
            pass
        for number, device in enumerate(("4", "6")):
            monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6")
            parts.dask_setup(SimpleNamespace(name=number))
            assert os.environ["CUDA_VISIBLE_DEVICES"] == device
    finally:
        jax.config.update("jax_platforms", before)


CLIENT = """
import sys
from pathlib import Path
from fynjax._core import parts
from fynjax._core.checkpoint import Journal
from fynjax._core.parts import Workers, at_work
from tests.test_parts import slow

if __name__ == "__main__":
    parts._machine = lambda: (2, 8 * 2**30)
    calls, kept = sys.argv[1:]
    with at_work(Workers(2)) as pool:
        pool.all(slow, range(30), Path(calls), journal=Journal(kept, "s"))
"""


def client(tmp_path: Path) -> subprocess.Popen:
    script = tmp_path / "client.py"
    script.write_text(CLIENT)
    (tmp_path / "calls").mkdir()
    return subprocess.Popen(
        [sys.executable, script, tmp_path / "calls", tmp_path / "kept"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])},
    )  # fmt: skip


def goes_on(tmp_path: Path) -> None:
    """The parts that are missing are done in this process; the others were kept."""
    done = len(finished(tmp_path))
    assert 3 <= done < 30
    before = sum(called(tmp_path / "calls", i) for i in range(30))
    journal = Journal(tmp_path / "kept", "s")
    found = Pool().all(quick, range(30), tmp_path / "calls", journal=journal)
    assert [int(a) for (a,) in found] == list(range(30))
    assert sum(called(tmp_path / "calls", i) for i in range(30)) == before + 30 - done


def until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def finished(tmp_path: Path) -> list[Path]:
    return list((tmp_path / "kept").glob("*.npz"))


def test_a_killed_client_leaves_no_workers_and_goes_on(tmp_path: Path) -> None:
    first = client(tmp_path)
    until(lambda: len(finished(tmp_path)) >= 3)
    workers = psutil.Process(first.pid).children(recursive=True)
    first.kill()
    first.communicate()
    _, alive = psutil.wait_procs(workers, timeout=15)
    assert not alive
    goes_on(tmp_path)


@unix
def test_ctrl_c_ends_the_workers_without_a_word_of_theirs(tmp_path: Path) -> None:
    """A terminal interrupts the workers, too."""
    one = client(tmp_path)
    until(lambda: len(finished(tmp_path)) >= 3)
    workers = psutil.Process(one.pid).children(recursive=True)
    os.killpg(one.pid, signal.SIGINT)
    _, errors = one.communicate(timeout=20)
    _, alive = psutil.wait_procs(workers, timeout=5)
    assert not alive
    assert errors.splitlines()[-1] == "KeyboardInterrupt"
    assert errors.count("Traceback") == 1
    assert 3 <= len(finished(tmp_path)) < 30


def test_a_killed_scheduler_ends_in_one_line_and_the_next_goes_on(tmp_path, monkeypatch) -> None:
    """With the commands of the documentation."""
    monkeypatch.setattr(parts, "_CONNECT_SECONDS", 60.0)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    calls, port = tmp_path / "calls", free_port()
    calls.mkdir()
    started: list[subprocess.Popen] = []

    def start(*arguments: str) -> None:
        command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
        started.append(
            subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment,
                cwd=tmp_path,
            )
        )  # fmt: skip

    def kill_scheduler() -> None:
        until(lambda: len(finished(tmp_path)) >= 3)
        started[0].kill()

    try:
        address = f"tcp://127.0.0.1:{port}"
        start("scheduler", "--host", "127.0.0.1", "--port", str(port))
        start("worker", address, "--nthreads", "1", "--nworkers", "1")
        with at_work(Workers(scheduler=address)) as pool:
            assert [int(a) for (a,) in pool.all(numbered, range(2), calls, "")] == [0, 1]
            for made in calls.iterdir():
                made.unlink()
            killer = threading.Thread(target=kill_scheduler)
            killer.start()
            with pytest.raises(InputError, match=r"^the dask scheduler is gone.*again$"):
                pool.all(slow, range(30), calls, journal=Journal(tmp_path / "kept", "s"))
            killer.join()
    finally:
        for process in started:
            children = psutil.Process(process.pid).children(recursive=True)
            for one in (process, *children):
                with contextlib.suppress(psutil.NoSuchProcess):
                    one.kill()
            process.wait()
    goes_on(tmp_path)


def free_port() -> int:
    import socket

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])
