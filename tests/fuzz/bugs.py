"""Bugs put into readers and checks on purpose: the damaged files must find each of them.

`python -m tests.fuzz --bugs` copies the package, puts in one bug at a time, and tries damaged files
until one of them is neither refused clearly nor read as what it is.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]


class Bug(NamedTuple):
    """A change of one place in a file of the package."""

    file: str
    """From the package's folder."""
    old: str
    """Text that stands there once."""
    new: str
    readers: tuple[str, ...]
    """Readers that pass through it."""


BUGS = {
    "checkpoint without its hash": Bug(
        "_core/checkpoint.py",
        "if self._hash(name, raw[size:]) != raw[:size]:",
        "if False:",
        ("checkpoint", "unfinished-maps"),
    ),
    "infinite pixels are data": Bug(
        "app/io/raster/_reader.py",
        "valid &= np.isfinite(values) & ~wrong",
        "valid &= ~np.isnan(values)",
        ("image", "bands", "terrain"),
    ),
    "a place beyond the Earth": Bug(
        "app/io/raster/_reader.py",
        "if not all(abs(number) < LARGEST for number in dataset.transform):",
        "if False:",
        ("image", "ground-map", "terrain"),
    ),
    "gzip that ends too early": Bug(
        "_core/files.py", "refusing(EOFError, words=", "refusing(ZeroDivisionError, words=",
        ("spectra-gzip",),
    ),
    "units of an atmosphere that are numbers": Bug(
        "app/io/instruments/_atmosphere_file.py",
        'plain = str(unit or "").strip()',
        'plain = (unit or "").strip()',
        ("atmosphere-netcdf",),
    ),
    "numbers of TOML that Python cannot hold": Bug(
        "app/io/text/_toml.py",
        "except (RecursionError, ValueError) as error:",
        "except tomllib.TOMLDecodeError as error:",
        ("prior", "sensor", "plot"),
    ),
    "a training that was changed": Bug(
        "app/jobs/_train.py",
        "if record.get(_SEAL) != _sealed(data, record):",
        "if False:",
        ("training",),
    ),
    "what libraries raise at damaged cubes": Bug(
        "app/io/raster/_blocks.py",
        "*(OSError, ValueError, LookupError, RuntimeError, AttributeError, TypeError),",
        "OSError,",
        ("blocks-zarr", "blocks-zarr3", "blocks-netcdf"),
    ),
    "impossible values of a cube are data": Bug(
        "app/io/raster/_blocks.py",
        "values = np.where(np.abs(values) > 1e6, np.nan, values)",
        "values = np.array(values)",
        ("blocks-zarr", "blocks-netcdf"),
    ),
}  # fmt: skip
"""By what is wrong with them."""


def found(bug: Bug, each: int, seed: int = 0) -> tuple[bool, str]:
    """Try `each` damaged files of every reader of a bug.

    **Returns:** whether one of them found it, and the first line that says so, or the last words.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT / "fynjax", folder / "fynjax")
        for beside in ("tests", "data_schemas", "pyproject.toml"):
            (folder / beside).symlink_to(ROOT / beside)
        path = folder / "fynjax" / bug.file
        path.write_text(path.read_text("utf-8").replace(bug.old, bug.new), "utf-8")
        readers = [part for reader in bug.readers for part in ("--reader", reader)]
        done = subprocess.run(
            [sys.executable, "-m", "tests.fuzz", *readers, "--each", str(each),
             "--seed", str(seed), "--save", str(folder / "saved")],
            cwd=folder, env={**os.environ, "PYTHONPATH": str(folder)}, capture_output=True,
            text=True, check=False,
        )  # fmt: skip
    lines = done.stdout.splitlines()
    first = next((line for line in lines if line.startswith(bug.readers)), "")
    return done.returncode == 1 and "tried" in done.stdout, first or done.stderr[-200:]


def study(each: int, seed: int = 0) -> int:
    """Print which of the bugs are found; gives how many are not."""
    missed = 0
    for name, bug in BUGS.items():
        was_found, line = found(bug, each, seed)
        missed += not was_found
        print(f"{'found' if was_found else 'MISSED':<7} {name}: {line[:150]}", flush=True)
    print(f"{len(BUGS) - missed} of {len(BUGS)} found in {each} tries of each reader")
    return missed
