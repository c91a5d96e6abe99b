"""Runs as NetCDF files with CF names, units, and a record of how they came to be."""

import atexit
import hashlib
import json
import math
import os
import shlex
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

import fynjax
from fynjax._core.errors import InputError, names_file, refusing
from fynjax._core.files import file_hash as file_hash
from fynjax.app.io.raster._hdf5 import names_others
from fynjax.app.io.text import atomic_path, check_stated_size

CONVENTIONS = "CF-1.11"
_OPENS_WITHIN = 4.0
"""Seconds of the processor within which a file is opened; milliseconds are usual."""


def _leave() -> None:
    """End the process at once: HDF5 clears up after itself, and falls over a thread within it."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(2)


@names_file
def check_netcdf(path: Path) -> None:
    """Refuse a NetCDF file that reads values of other files, and a damaged one: whose tables of
    contents lead in circles, in which HDF5 goes round for ever, or state more than it can hold.

    **Arguments:** `path`, a file that exists.

    **Raises:** `InputError`.
    """
    import netCDF4  # takes a fifth of a second

    opened = threading.Event()
    outside: list[bool] = []
    stated: list[int] = []

    def attempt() -> None:
        with suppress(Exception):  # whoever reads it says what is wrong
            outside.append(names_others(path))
            if not outside[0]:
                with netCDF4.Dataset(path) as data:
                    stated.append(_stated_size(data))
        opened.set()

    start = time.process_time()
    threading.Thread(target=attempt, daemon=True).start()
    while not opened.wait(1.0):
        if time.process_time() - start > _OPENS_WITHIN:
            atexit.register(_leave)
            raise InputError(
                "cannot be read as NetCDF: its tables of contents do not end. Is it damaged?"
            )
    if any(outside):
        raise InputError(
            "expected a file that holds its own values, but it has links to other files, and those "
            f"are not followed. If you trust it, make it whole: nccopy {path.name} "
            f"{path.stem}_own.nc"
        )
    if stated:
        check_stated_size(path, stated[0], f"{stated[0]} bytes of values", packed=True)


def _stated_size(group: Any) -> int:
    """Bytes of all values by the tables of contents."""
    own = (math.prod(v.shape) * getattr(v.dtype, "itemsize", 8) for v in group.variables.values())
    return sum(own) + sum(map(_stated_size, group.groups.values()))


_SIGNED_WHOLE = 1 << 30
"""Bytes of inputs that are read whole to sign them."""
_SAMPLES = 16


def content_hash(path: str | Path) -> str:
    """A hash of a file, or of all files of a folder with their names; not of the place.

    Beyond a gibibyte each file is read in part: 16 blocks from its beginning to its end. There its
    size and time of change enter too.

    **Arguments:** `path`, a file or a folder, such as a zarr group.

    **Returns:** 64 hexadecimal digits.
    """
    path = Path(path)
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    sizes = {one: one.stat().st_size for one in files}
    whole = sum(sizes.values()) <= _SIGNED_WHOLE
    block = max(_SIGNED_WHOLE // (_SAMPLES * max(len(files), 1)), 1 << 12)
    total = hashlib.sha256()
    for one, size in sizes.items():
        total.update(f"|{one.relative_to(path).as_posix()}|{size}|".encode(errors="replace"))
        if whole or size <= _SAMPLES * block:
            total.update(bytes.fromhex(file_hash(one)))
            continue
        total.update(f"{one.stat().st_mtime_ns}|".encode())
        with one.open("rb") as file:
            for i in range(_SAMPLES):
                file.seek(i * (size - block) // (_SAMPLES - 1))
                total.update(file.read(block))
    return total.hexdigest()


def provenance(
    *, seed: int | None = None, inputs: Iterable[str | Path] = ()
) -> dict[str, str | int]:
    """What made a file: version, command line, seed, date (UTC) and hashes of its input files.

    **Arguments:**

    - `seed`: seed of the run.
    - `inputs`: files that were read; each enters as `name: sha256`, with its folder where others
      have its name.

    **Returns:** file attributes by name.
    """
    paths = dict.fromkeys(map(Path, inputs))
    names = Counter(path.name for path in paths)
    hashes = {p.name if names[p.name] == 1 else p.as_posix(): file_hash(p) for p in paths}
    record: dict[str, str | int] = {
        "source": f"fynjax {fynjax.__version__}",
        "fynjax_version": fynjax.__version__,
        "jax_version": version("jax"),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date_created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "input_sha256": json.dumps(hashes),
    }
    if seed is not None:
        record["seed"] = seed
    return record


def image_array(
    image: ArrayLike,
    band_names: Sequence[str],
    wavelengths: Sequence[float],
    *,
    pixel_m: float,
    origin_m: tuple[float, float] = (0.0, 0.0),
    crs: str | None = None,
    long_name: str,
    standard_name: str | None = "surface_bidirectional_reflectance",
    units: str = "1",
) -> xr.DataArray:
    """An image with CF coordinates band, wavelength, y and x.

    Coordinates are pixel centres; those of a `crs` refer to a variable "crs", see `grid_mapping`.

    **Arguments:**

    - `image`: [band, y, x], y increasing to the north, in `units`.
    - `band_names`: one for each band.
    - `wavelengths`: band centres [nm].
    - `pixel_m`: side of a pixel [m].
    - `origin_m`: (x, y) of the image's south-west corner [m].
    - `crs`: anything rasterio reads, such as "EPSG:32734"; `None` is the plot's local frame.
    - `long_name`, `standard_name`: what the values are, in words and as the CF conventions name it.
    - `units`: of the values.
    """
    values = np.asarray(image)
    attributes = {"long_name": long_name, "units": units}
    if crs is not None:
        attributes["grid_mapping"] = "crs"
    if standard_name:
        attributes["standard_name"] = standard_name
    centre = {
        "units": "nm",
        "standard_name": "sensor_band_central_radiation_wavelength",
        "long_name": "band centre",
    }
    coords: dict[str, Any] = {
        "band": ("band", list(band_names), {"long_name": "band name"}),
        "wavelength": ("band", np.asarray(wavelengths, dtype=float), centre),
    }
    for axis, start, count, way in zip(
        "yx", origin_m[::-1], values.shape[1:], ("north", "east"), strict=True
    ):
        about = {"units": "m", "axis": axis.upper()}
        about["standard_name"] = f"projection_{axis}_coordinate"
        about["long_name"] = f"{axis} of the reference system, to the {way}"
        if crs is None:
            about["long_name"] = f"distance {way} of the plot's south-west corner"
        coords[axis] = (axis, start + (np.arange(count) + 0.5) * pixel_m, about)
    return xr.DataArray(values, coords, ("band", "y", "x"), attrs=attributes)


def grid_mapping(crs: str) -> xr.DataArray:
    """The variable "crs" that says in which reference system coordinates are (CF-1.11, 5.6).

    **Arguments:** `crs`: anything pyproj reads, such as "EPSG:32734".
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # CF has no word for some parameters
        import pyproj  # late: few runs know their place

        system = pyproj.CRS.from_user_input(crs).to_cf()
    # Systems that CF has no name for have their WKT alone. Programs on GDAL look for the older
    # name of that.
    attributes = {**system, "spatial_ref": system["crs_wkt"], "long_name": "reference system"}
    return xr.DataArray(np.int32(0), attrs=attributes)


def with_history(record: Mapping[str, str | int]) -> dict[str, str | int]:
    """The attributes of a file with the line of history that CF asks for, if they say when and by
    what command it was made."""
    history = f"{record.get('date_created', '')} {record.get('command', '')}".strip()
    return {**record, **({"history": history} if history else {})}


@names_file
def write_run(
    path: str | Path, dataset: xr.Dataset, attributes: Mapping[str, str | int] | None = None
) -> None:
    """Write a dataset as a compressed NetCDF-4 file, whole or not at all.

    **Arguments:**

    - `path`: the file to write.
    - `dataset`: every numeric variable carries `units` ("1" where it has none) and `long_name`,
      as CF-1.11 asks; a grid mapping needs no units.
    - `attributes`: file attributes, such as those of `provenance`.

    **Raises:** `ValueError` for a variable without units or name; `InputError` if the file cannot
    be written.
    """
    for name, variable in dataset.variables.items():
        if "long_name" not in variable.attrs:
            raise ValueError(f"variable {name!r} must have `long_name`, but has none")
        numeric = variable.dtype.kind in "fiu" and "crs_wkt" not in variable.attrs
        if numeric and "units" not in variable.attrs:
            raise ValueError(f"variable {name!r} must have `units`, but has none")
    dataset = dataset.assign_attrs(
        {"Conventions": CONVENTIONS, **dataset.attrs, **with_history(attributes or {})}
    )
    encoding: dict[Any, dict[str, Any]] = {
        name: {
            **({"zlib": True, "complevel": 4} if variable.ndim else {}),
            **{k: v for k, v in variable.encoding.items() if k == "_FillValue"},
        }
        for name, variable in dataset.data_vars.items()
        if variable.dtype.kind in "fiu"
    }
    for name in dataset.coords:  # a coordinate must not have missing values
        encoding[name] = {"_FillValue": None}
    with atomic_path(path) as partial, refusing(OSError, words="cannot write here: {error}"):
        dataset.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)
