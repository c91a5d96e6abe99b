"""Bugs put into readers and checks on purpose: the damaged files must find each of them.

`python -m tests.fuzz --bugs` copies the package, puts in one bug at a time, and tries damaged files
until one of them is neither refused clearly nor read as what it is.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
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
        "(np.abs(values) > 1e6) | (values < low) | (values > high), np.nan, values)",
        "np.zeros_like(values, bool), np.nan, values)",
        ("blocks-zarr", "blocks-netcdf"),
    ),
    "columns of a cloud by their order": Bug(
        "app/terrain/_cloud.py",
        "table.columns(list(places.values()))",
        "table.columns(sorted(places.values()))",
        ("cloud-csv",),
    ),
    "an ignore value after scaling": Bug(
        "app/io/spectra/_envi.py",
        "np.where((values == ignore) | ~good, np.nan, values)",
        "np.where((values / scale == ignore) | ~good, np.nan, values)",
        ("envi-library",),
    ),
    "swapped axes of a cloud": Bug(
        "app/terrain/_cloud.py",
        "for axis in (las.x, las.y, las.z))",
        "for axis in (las.y, las.x, las.z))",
        ("las",),
    ),
    "rows of an image for columns": Bug(
        "app/io/raster/_blocks.py",
        "*ordered_axes(values, [data, *around])",
        "*[ordered_axes(values, [data, *around])[i] for i in (1, 0, 2)]",
        ("blocks-netcdf",),
    ),
    "rows of an image the other way up": Bug(
        "app/io/raster/_reader.py",
        "if t.is_identity or t.e < 0:\n            values, valid, full",
        "if True:\n            values, valid, full",
        ("cube-geotiff",),
    ),
    "an offset with the other sign": Bug(
        "app/io/raster/_reader.py",
        "values += offset",
        "values -= offset",
        ("cube-geotiff",),
    ),
    "flags for reflectance": Bug(
        "app/compare/_spectra.py",
        'named.sort(key=lambda one: one[0].lower() != "reflectance")',
        "named = [c for c in candidates if 'reflectance' in c[0].lower()]",
        ("cube-netcdf",),
    ),
}  # fmt: skip
"""By what is wrong with them."""
SILENT = list(BUGS)[-7:]
"""Those that give wrong numbers of a valid file, and no error."""


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


def study(each: int, seed: int = 0, names: Iterable[str] = tuple(BUGS)) -> int:
    """Print which of the bugs are found; gives how many are not."""
    missed = 0
    bugs = {name: BUGS[name] for name in names}
    for name, bug in bugs.items():
        was_found, line = found(bug, each, seed)
        missed += not was_found
        print(f"{'found' if was_found else 'MISSED':<7} {name}: {line[:150]}", flush=True)
    print(f"{len(bugs) - missed} of {len(bugs)} found in {each} tries of each reader")
    return missed
