"""Valid files whose values are extreme, written by the libraries of their formats.

Damaged bytes of a binary format are mostly refused before a value is read; these are not.
"""

import io
import json
import random
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import netCDF4
import numpy as np
import openpyxl
import rasterio
import trimesh
from rasterio import Affine

_NUMBERS = [
    *(0.0, -0.0, 1.0, -1.0, 0.5, 100.0, -9999.0, 1e-9, -1e-9, 1e4, 1e9, 1e15, 1e30, 3.4e38),
    *(5e-324, 1e-40, 1e300, -1e300, np.nan, np.inf, -np.inf, 255.0, 65535.0, 2.0**31, 2.0**63),
]
_TEXTS = ["", " ", "nan", "1e400", "-1", "micrometers", "percent", "0", "m", "\u00e9", "x" * 300]


def _placed(values: np.ndarray, chance: random.Random) -> np.ndarray:
    """An array of which one value, a row of its first axis, or all are extreme, in its type."""
    values = np.array(values)
    number = chance.choice(_NUMBERS)
    if values.dtype.kind in "iu":
        limits = np.iinfo(values.dtype)
        number = chance.choice((limits.min, limits.max, 0, 1))
    if not values.size or values.dtype.kind not in "iuf":
        return values
    kind = chance.randrange(3)
    with np.errstate(all="ignore"):
        if kind == 0:
            values.flat[chance.randrange(values.size)] = number
        elif kind == 1 and values.ndim:
            values[chance.randrange(len(values))] = number
        else:
            values[...] = number
    return values


def _tif(path: Path, chance: random.Random) -> None:
    with rasterio.open(path, "r+") as file:
        kind = chance.randrange(6)
        band = chance.randrange(file.count) + 1
        if kind == 0:
            t = list(file.transform)[:6]
            t[chance.randrange(6)] = chance.choice(_NUMBERS)
            file.transform = Affine(*t)
        elif kind == 1:
            file.update_tags(band, wavelength=str(chance.choice(_NUMBERS)))
            file.update_tags(band, wavelength_units=chance.choice(_TEXTS))
        elif kind == 2:
            file.nodata = chance.choice((0, 1, 200))
        elif kind == 3:
            file.scales = [chance.choice(_NUMBERS)] * file.count
            file.offsets = [chance.choice(_NUMBERS)] * file.count
        else:
            file.write(_placed(file.read(band), chance), band)


def _netcdf(path: Path, chance: random.Random) -> None:
    with netCDF4.Dataset(path, "a") as data:
        data.set_auto_maskandscale(False)
        groups = [data, *data.groups.values()]
        variables = [v for group in groups for v in group.variables.values()]
        variable = chance.choice(variables)
        kind = chance.randrange(4)
        if kind == 0:
            name = chance.choice(("scale_factor", "add_offset", "valid_max", "missing_value"))
            variable.setncattr(name, chance.choice(_NUMBERS))
        elif kind == 1:
            owner = chance.choice((data, variable))
            names = [name for name in owner.ncattrs() if not name.startswith("_")] or ["units"]
            name, new = chance.choice(names), chance.choice((*_TEXTS, *_NUMBERS))
            owner.setncattr(name, new)
        elif variable.dtype is not str:
            variable[...] = _placed(variable[...], chance)


def _zarr(path: Path, chance: random.Random) -> None:
    import zarr

    if chance.random() < 0.4:
        known = sorted(p for p in path.rglob("*") if p.name in (".zarray", "zarr.json"))
        place = chance.choice(known)
        meta = json.loads(place.read_text("utf-8"))
        key = chance.choice(list(meta))
        if chance.random() < 0.4:
            del meta[key]
        elif isinstance(meta.get("shape"), list):
            sizes = meta[chance.choice([k for k in ("shape", "chunks") if k in meta])]
            sizes[chance.randrange(len(sizes))] = chance.choice((0, -1, 1 << 20, 1 << 40, 1e9))
        place.write_text(json.dumps(meta), "utf-8")
        return

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        group = zarr.open_group(path, mode="a")
        _, array = chance.choice(sorted(group.arrays()))
        array[...] = _placed(array[...], chance)
        if chance.random() < 0.3:
            array.attrs["scale_factor"] = chance.choice(_NUMBERS[:20])


def _las(path: Path, chance: random.Random) -> None:
    las = laspy.read(path)
    kind = chance.randrange(3)
    if kind == 0:
        what = chance.choice(("X", "Y", "Z", "classification", "return_number", "intensity"))
        values = np.array(las[what])
        top = {"classification": 255, "return_number": 15}.get(what)
        if top is None:
            las[what] = _placed(values, chance)
        else:
            values[: chance.choice((1, len(values)))] = chance.choice((0, 1, top))
            las[what] = values
    elif kind == 1:
        las.header.scales = _placed(las.header.scales, chance)
    else:
        las.header.offsets = _placed(las.header.offsets, chance)
    with np.errstate(all="ignore"):
        las.write(path)


def _mesh(path: Path, chance: random.Random) -> None:
    shape: Any = trimesh.load(path, process=False)
    if isinstance(shape, trimesh.Scene):
        shape = next(iter(shape.geometry.values()))
    shape.vertices = _placed(shape.vertices, chance)
    with np.errstate(all="ignore"):
        shape.export(path)


def _checkpoint(path: Path, chance: random.Random) -> None:
    """Other arrays behind the hash of those before."""
    seal, data = path.read_bytes()[:32], path.read_bytes()[32:]
    with np.load(io.BytesIO(data)) as file:
        arrays = dict(file)
    name = chance.choice(list(arrays))
    content = io.BytesIO()
    np.savez(content, **arrays | {name: _placed(arrays[name], chance)})
    path.write_bytes(seal + content.getvalue())


def _workbook(path: Path, chance: random.Random) -> None:
    book = openpyxl.load_workbook(path)
    row = chance.choice(list(book.active.iter_rows()))
    numbers = [number for number in _NUMBERS if np.isfinite(number)]
    chance.choice(row).value = chance.choice((*numbers, *_TEXTS, True, None, "=1/0"))
    book.save(path)


_KINDS: dict[str, Callable[[Path, random.Random], None]] = {
    ".tif": _tif, ".nc": _netcdf, ".las": _las, ".laz": _las, ".ply": _mesh, ".obj": _mesh,
    ".stl": _mesh, ".glb": _mesh, ".xlsx": _workbook, ".zarr": _zarr,
    ".npz": _checkpoint,
}  # fmt: skip


def make_extreme(folder: Path, chance: random.Random) -> bool:
    """Give one file of a folder or below, or a zarr group, extreme values.

    **Returns:** false where there is none of a format that is known, or its library refuses them.
    """
    known = sorted(path for path in folder.rglob("*") if path.suffix in _KINDS)
    if not known:
        return False
    path = chance.choice(known)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _KINDS[path.suffix](path, chance)
    except Exception:  # whatever a library says to such values
        return False
    return True
