"""Real runs that are killed, interrupted and disturbed at random moments, and given again.

`python -m tests.fuzz.faults --minutes 12 [--command NAME] [--fault NAME] [--seed N]`: after each
fault the command is given again, and its files are compared with those of a run that nothing
disturbed. `equal`: to the bit. `says why`: it ends with one line. `other`: anything else. With
`--each N` every fault is tried so often on every command.
"""

import argparse
import os
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil

ROOT = Path(__file__).parents[2]
_TIMED = ("summary.json", "report.html")
"""Files that tell when and how long a run was."""
_PATIENCE = 300.0
"""Seconds that a run may take."""


# -- the runs -------------------------------------------------------------------------------


def child(largest: int | None) -> None:
    """A command with few draws, parts of few rows or leaves, and a clock that stands.

    **Arguments:** `largest`, bytes of a file beyond which it cannot be written, as on a full disk.
    """
    if largest is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    import pytest

    from fynjax._core import checkpoint, parts
    from fynjax.app.cli import main
    from fynjax.app.io.raster import CubeBlocks, _netcdf
    from fynjax.app.jobs import _fit_leaf
    from fynjax.leaf import _result
    from tests.small import search_quickly

    class Noon(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> "Noon":
            return cls(2026, 1, 1, 12, tzinfo=UTC)

    change: Any = pytest.MonkeyPatch()
    search_quickly(change)
    for module in (_netcdf, _result):
        change.setattr(module, "datetime", Noon)
    change.setattr(CubeBlocks, "rows_at_once", 1)
    change.setattr(_fit_leaf, "_PART", 1)
    change.setattr(checkpoint, "_KEEP_SECONDS", 0.0)
    change.setattr(parts, "_machine", lambda: (2, 8 * 2**30))
    line = sys.argv[1:]
    at = line.index("--workers") if "--workers" in line else len(line)
    sys.argv = ["fynjax", *line[:at], *line[at + 2 :]]  # which results record
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main(line)


def _commands(folder: Path, names: Sequence[str]) -> dict[str, tuple[list[str], str]]:
    """Inputs of commands in `folder`, and there their lines and the file that may change."""
    from tests.frozen.cases import CASES, TRAIN, _fit_leaf, _map, _small
    from tests.studies.test_bioscape_validate import write_tables

    others: dict[str, tuple[list[str], str]] = {}
    for name, own in [one for one in _AS_FROZEN.items() if one[0] in names]:
        (folder / name).mkdir()
        line = next(iter(CASES[name].runs(folder / name).values()))
        line = [str(part).replace(f"{folder}/", "") for part in line]
        others[name] = line, next(iter(sorted(folder.glob(own)))).relative_to(folder).as_posix()
    plot, target = (path.name for path in _small(folder))
    leaves = str(_fit_leaf(folder)["D"][1].relative_to(folder))
    _map(folder)
    write_tables(folder / "tables")
    lines = {
        **others,
        "calibrate": (["calibrate", plot, "--target", target], target),
        "posterior": (
            ["posterior", plot, "--target", target, "--steps", "8", "--draws", "10"], target
        ),
        "train": ([*map(str, TRAIN)], ""),
        "map": (["map", "cube.tif", "--training", "training.nc", "--keep-unlike"], "cube.tif"),
        "fit-leaf": (["fit-leaf", leaves, "--posterior", "emcee"], leaves),
        "calibrate-plots": (
            ["bioscape", "calibrate", "tables", "--size", "2"], _spectra_table(folder)
        ),
    }  # fmt: skip
    return {
        name: ([*line, "--output", "out", "--quiet"], own) for name, (line, own) in lines.items()
    }


def _spectra_table(folder: Path) -> str:
    return next(str(p.relative_to(folder)) for p in (folder / "tables").glob("*waves.csv"))


_AS_FROZEN = {
    "diversity": "diversity/species.csv", "design": "design/species.csv",
    "sensitivity": "sensitivity/species.csv", "frames": "frames/species.csv",
    "crowns": "crowns/rendered/*.tif",
}  # fmt: skip
"""Commands that run as `tests.frozen` has them, and their file that may change."""
NAMES = ["calibrate", "posterior", "train", "map", "fit-leaf", "calibrate-plots", *_AS_FROZEN]
_WITH_WORKERS = ("train", "map", "calibrate-plots")


class Ended(NamedTuple):
    """How a process ended."""

    status: int
    error: str

    @property
    def said(self) -> bool:
        """Whether it ended with one line of its own."""
        lines = [line for line in self.error.splitlines() if "cpu_aot_loader" not in line]
        return self.status > 0 and len(lines) == 1 and lines[0].startswith("fynjax: ")


def _begin(line: list[str], folder: Path, largest: int | None = None) -> "subprocess.Popen[str]":
    code = f"import signal; signal.signal({signal.SIGINT:d}, signal.SIG_DFL); "  # until it listens
    code += f"from tests.fuzz.faults import child; child({largest})"
    return subprocess.Popen(
        [sys.executable, "-c", code, *line], cwd=folder, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TF_CPP_MIN_LOG_LEVEL": "3"},
    )  # fmt: skip


def _end(process: "subprocess.Popen[str]") -> Ended:
    try:
        _, error = process.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        _, error = process.communicate()
        error += "\nhangs"
    return Ended(process.returncode, error)


def _content(path: Path) -> bytes:
    """Bytes of a file without the time at which it was made."""
    if path.name in _TIMED:
        return b""
    if path.suffix == ".gpkg":
        with closing(sqlite3.connect(path)) as base:  # it keeps the time of each layer
            rows = [line for line in base.iterdump() if "gpkg_contents" not in line]
        return "\n".join(rows).encode()
    if path.suffix == ".npz":
        with np.load(path) as file:  # it names the folder of the inputs
            arrays = {name: file[name].tobytes() for name in file.files}
        return repr(sorted(arrays.items())).replace(str(path.parents[1]), "").encode()
    if path.name != "posterior.nc":
        return path.read_bytes()
    import netCDF4

    with netCDF4.Dataset(path) as data:  # arviz writes the time into each group
        parts = [v for group in data.groups.values() for v in group.variables.values()]
        return "".join(f"{v.group().name}/{v.name}: {v[...].tolist()}" for v in parts).encode()


def _files(folder: Path) -> dict[str, bytes]:
    """What a run leaves in its folder: results, and the names of what stands beside them. A folder
    `.out.*.partial` of a killed run is cleared away by one that begins later."""
    results = [path for path in sorted((folder / "out").rglob("*")) if path.is_file()]
    beside = {p.name: b"" for p in folder.iterdir() if p.name.startswith("out.")}
    return {path.relative_to(folder).as_posix(): _content(path) for path in results} | beside


# -- the faults -----------------------------------------------------------------------------


def _signals(*numbers: int) -> Callable[["subprocess.Popen[str]", Path], None]:
    def send(process: "subprocess.Popen[str]", folder: Path) -> None:
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.2)

    return send


def _remove_output(process: "subprocess.Popen[str] | None", folder: Path) -> None:
    for path in [*folder.glob("out*"), *folder.glob(".out*")]:
        shutil.rmtree(path, ignore_errors=True)


def _kill_worker(process: "subprocess.Popen[str]", folder: Path) -> None:
    with suppress(psutil.NoSuchProcess):
        workers = [
            one
            for one in psutil.Process(process.pid).children(recursive=True)
            if "spawn_main" in " ".join(one.cmdline())
        ]
        if workers:
            random.choice(workers).kill()


FAULTS = {
    "SIGKILL": _signals(signal.SIGKILL),
    "SIGTERM": _signals(signal.SIGTERM),
    "Ctrl-C twice": _signals(signal.SIGINT, signal.SIGINT),
    "full disk": None,
    "output removed": _remove_output,
    "input changed": _signals(signal.SIGKILL),
    "two runs": None,
    "worker killed": _kill_worker,
}


def _change(path: Path) -> None:
    if path.suffix == ".tif":
        import rasterio

        with rasterio.open(path, "r+") as file:
            file.write(file.read() * 0.99)
        return
    text = path.read_text("utf-8")
    at = max(i for i, letter in enumerate(text) if letter in "12345678")
    path.write_text(f"{text[:at]}{int(text[at]) + 1}{text[at + 1 :]}", "utf-8")


class Study:
    """Runs of all commands, each beside a copy of the inputs."""

    def __init__(self, folder: Path, seed: int, names: Sequence[str], warm: bool = True) -> None:
        self.folder, self.chance = folder, random.Random(seed)
        self.inputs = folder / "inputs"
        self.inputs.mkdir()
        self.commands = _commands(self.inputs, names)
        self.warm = warm
        self.whole: dict[tuple[str, bool], tuple[dict[str, bytes], float]] = {}
        self._count = 0

    def place(self) -> Path:
        """A fresh folder with the inputs."""
        self._count += 1
        place = self.folder / f"run{self._count}"
        shutil.copytree(self.inputs, place)
        return place

    def undisturbed(self, command: str, changed: bool = False) -> tuple[dict[str, bytes], float]:
        """Files of a whole run, and its seconds."""
        if (command, changed) not in self.whole:
            if command == "map" and not (self.inputs / "training.nc").is_file():
                self.undisturbed("train")
            line, own = self.commands[command]
            place = self.place()
            if changed:
                _change(place / own)
            for _ in range(1 + self.warm):  # the second finds its programs compiled
                _remove_output(None, place)
                began = time.monotonic()
                ended = _end(_begin(line, place))
                assert ended.status == 0, ended.error
            self.whole[command, changed] = _files(place), time.monotonic() - began
            if command == "train":
                shutil.copy(place / "out" / "training.nc", self.inputs)
            shutil.rmtree(place)
        return self.whole[command, changed]

    def tried(self, command: str, fault: str) -> tuple[str, str]:
        """One fault at a random moment: how it ended, and why."""
        seconds = self.undisturbed(command)[1]
        line, own = self.commands[command]
        place = self.place()
        if fault == "worker killed":
            line = [*line, "--workers", "2"]
            seconds *= 2.0
        full = int(2 ** self.chance.uniform(10, 18)) if fault == "full disk" else None
        first = _begin(line, place, full)
        moment = self.chance.uniform(0.1, 1.0) * seconds
        try:
            if fault == "two runs":
                time.sleep(moment)
                second = _end(_begin(line, place))
                if not (second.said or second.status == 0):
                    return "other", f"the second run: {second}"
            elif fault != "full disk":
                with suppress(subprocess.TimeoutExpired):
                    first.wait(moment)
                if first.poll() is None:
                    act = FAULTS[fault]
                    assert act is not None
                    act(first, place)
            ended = _end(first)
            if ended.status not in (0, -signal.SIGKILL) and not ended.said:
                silent = ended.error.strip() == "" and ended.status in (130, 143, -2, -15)
                if not silent:  # before Python had begun to listen, nothing is said
                    return "other", f"the disturbed run: {ended}"
            changed = fault == "input changed"
            if changed:
                _change(place / own)
            if ended.status != 0 or changed or not (place / "out").is_dir():
                again = _end(_begin(line, place))
                if again.said and again.status == 2:
                    return "says why", again.error.strip()
                if again.status != 0:
                    return "other", f"the run again: {again}"
            wanted = self.undisturbed(command, changed)[0]
            found = _files(place)
            wrong = {n for n in {*wanted, *found} if wanted.get(n) != found.get(n)}
            if fault == "output removed":  # with what some commands keep beside it
                wrong = {n for n in wrong if n.startswith("out/")}
            if wrong:
                return "other", f"differ: {sorted(wrong)}, status {ended.status}, {moment:.1f} s"
            return "equal", f"after {moment:.1f} of {seconds:.1f} s, status {ended.status}"
        finally:
            with suppress(ProcessLookupError):
                os.killpg(first.pid, signal.SIGKILL)
            shutil.rmtree(place, ignore_errors=True)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.faults")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the processor, about")
    parser.add_argument("--each", type=int, help="tries of each fault, whatever time they take")
    parser.add_argument("--command", action="append", choices=NAMES, help="all of them")
    parser.add_argument("--fault", action="append", choices=list(FAULTS), help="all of them")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    commands, faults = options.command or NAMES, options.fault or list(FAULTS)
    counts: dict[str, Counter[str]] = {name: Counter() for name in [*commands, *faults]}
    seconds = 60.0 * options.minutes if options.each is None else float("inf")
    with tempfile.TemporaryDirectory() as name:
        study = Study(Path(name), options.seed, commands)

        def used() -> float:
            times = os.times()
            return times.children_user + times.children_system

        pairs = [(c, f) for c in commands for f in faults
                 if (f != "worker killed" or c in _WITH_WORKERS)
                 and (f != "input changed" or study.commands[c][1])]  # fmt: skip
        rounds = 0
        while used() < seconds and rounds != options.each:
            rounds += 1
            study.chance.shuffle(pairs)
            for command, fault in pairs:
                if used() >= seconds:
                    break
                kind, why = study.tried(command, fault)
                counts[command][kind] += 1
                counts[fault][kind] += 1
                print(f"{command}, {fault}: {kind}: {' '.join(why.split())[:300]}", flush=True)
    kinds = ("equal", "says why", "other")
    print(f"{'command':<17}{'tried':>7}{'equal':>7}{'says why':>10}{'other':>7}")
    total = sum((counts[name] for name in commands), start=Counter())
    for name, count in [*counts.items(), ("all", total)]:
        equal, why, other = (count[kind] for kind in kinds)
        print(f"{name:<17}{count.total():>7}{equal:>7}{why:>10}{other:>7}")
    return int(total["other"] > 0)


if __name__ == "__main__":
    sys.exit(main())
