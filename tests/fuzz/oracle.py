"""A second opinion on what a reader accepts: that of another library on the same bytes, and the
undamaged file's where the damage did not touch a value.

Where the other library reads nothing, or something of another shape, it has no opinion.
"""

import re
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import netCDF4
import numpy as np
import pandas as pd
import rasterio
import spectral
import trimesh
import zarr

from tests.fuzz.variants import numbers_of, plain

_LARGEST = 1e15
"""Numbers beyond it are missing to a reader, whatever a library says."""
_TEXT = {
    "xyz": "cloud.xyz", "cloud-csv": "cloud.csv", "statistics": "statistics.csv",
    "structure": "structure.csv", "atmosphere": "air.csv",
}  # fmt: skip
"""Readers of tables, a row of the result for each line, and their files."""


TOUCHED = {*_TEXT, "las", "cube-envi", "blocks-envi", "envi-library"}
"""Readers whose values can be told apart by their bytes."""


def _apart(ours: Any, theirs: Any, what: str, missing: np.ndarray | None = None) -> str | None:
    """Where numbers differ, or are missing that the other library has and does not mask."""
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    if ours.shape != theirs.shape:
        return None
    absent = ~(np.abs(theirs) <= _LARGEST) if missing is None else missing | ~np.isfinite(theirs)
    absent |= ~(np.abs(theirs) <= _LARGEST)
    with np.errstate(all="ignore"):
        same = np.isclose(ours, theirs, rtol=1e-5, atol=1e-9) | (absent & np.isnan(ours))
    same |= ~np.isfinite(theirs)
    if same.all():
        return None
    at = tuple(int(i) for i in np.argwhere(~same)[0]) if same.ndim else ()
    return f"{what} reads {theirs[at]:.6g} at {list(at)}, we {ours[at]:.6g}"


def _either(ours: np.ndarray, theirs: np.ndarray, what: str, missing: np.ndarray) -> str | None:
    """As `_apart` of cubes [band, row, column], of rows from the south or as they stand."""
    found = [_apart(ours[:, ::step], theirs, what, missing) for step in (1, -1)]
    return found[0] if all(found) else None


def _spectral(name: str) -> Callable[[str, Path, Any], str | None]:
    def ask(reader: str, folder: Path, result: Any) -> str | None:
        image = spectral.open_image(str(folder / name))
        header = image.metadata
        if any(key not in header for key in ("byte order", "data type", "interleave")):
            return None  # it would guess
        scale = float(header.get("reflectance scale factor", 1.0))
        ignore = float(header.get("data ignore value", "nan"))
        if reader == "envi-library":
            theirs = np.asarray(image.spectra, float)
            missing = theirs == ignore
            ours = np.stack([one.reflectance for one in result])
            if (centres := image.bands.centers) is not None:  # ours are in their order
                theirs = theirs[:, np.argsort(centres, kind="stable")]
                missing = theirs == ignore
            # What no reflectance can be is missing.
            missing |= (theirs / scale < -0.05) | (theirs / scale > 1.5)
            return _apart(ours, theirs / scale, "spectral", missing)
        image.scale_factor = 1.0
        theirs = np.asarray(image.load(dtype=float)).transpose(2, 0, 1)
        missing = theirs == ignore
        if reader == "blocks-envi":
            missing = missing | (theirs == 0.0).all(axis=0)
            ours = np.concatenate(result[1]).transpose(2, 0, 1)
            # In reflectance, or as it stands with a scale beside it.
            found = [
                _apart(ours / by, theirs / scale, "spectral", missing | (np.abs(theirs) > 1e6))
                for by in (1.0, result[0])
            ]
            return found[0] if all(found) else None
        return _either(result.values, theirs / scale, "spectral", missing)

    return ask


def _rasterio(name: str) -> Callable[[str, Path, Any], str | None]:
    def ask(reader: str, folder: Path, result: Any) -> str | None:
        with rasterio.open(folder / name) as file:
            raw = file.read()
            masked = file.read_masks() == 0
            scale, offset = np.array(file.scales), np.array(file.offsets)
            rising = file.transform.e > 0
        with np.errstate(all="ignore"):
            theirs = raw.astype(float) * scale[:, None, None] + offset[:, None, None]
        if reader == "blocks-geotiff":
            masked = masked | (raw == 0).all(axis=0)
            ours = np.concatenate(result[1]).transpose(2, 0, 1)
            found = [_apart(ours, t, "rasterio", masked | (np.abs(t) > 1e6)) for t in (theirs, raw)]
            return found[0] if all(found) else None
        if reader == "terrain":
            ours, theirs = result.heights, theirs[0]
            known = result.gap == 0.0
            if ours.shape != theirs.shape:
                return None
            return _apart(np.where(known, ours[::-1], theirs), theirs, "rasterio")
        ours = result.values
        if reader == "image":  # its bands in an order of their own
            if len(result.taken) != len(theirs):
                return None
            masked = masked | (raw == 0).all(axis=0) | ~np.isfinite(theirs).all(axis=0)
            both = ~masked.any(axis=0)
            if result.step != 1 or ours.shape != theirs.shape:
                return None
            sets = (np.sort(one[:, both if k else both[:: -1 if not rising else 1]].ravel())
                    for k, one in enumerate((ours, theirs)))  # fmt: skip
            mine, other = sets
            return _apart(mine, other, "rasterio") if mine.shape == other.shape else None
        return _either(ours, theirs, "rasterio", masked)

    return ask


def _laspy(name: str) -> Callable[[str, Path, Any], str | None]:
    def ask(reader: str, folder: Path, result: Any) -> str | None:
        las = laspy.read(folder / name)
        return next(
            filter(None, (_apart(getattr(result, a), las[a], f"laspy's {a}") for a in "xyz")), None
        )

    return ask


def _trimesh(name: str) -> Callable[[str, Path, Any], str | None]:
    def ask(reader: str, folder: Path, result: Any) -> str | None:
        loaded: Any = trimesh.load(folder / name, process=False)
        if reader.startswith("cloud"):
            ours = np.stack([result.x, result.y, result.z], axis=1)
            return _apart(ours, loaded.vertices, "trimesh")
        shape = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        used = shape.vertices[np.unique(shape.faces)]
        x, y, z = np.ptp(used, axis=0)
        ours = result.width, result.height, result.depth
        found = [_apart(ours, sides, "trimesh's extent") for sides in ((x, y, z), (x, z, y))]
        if all(found):
            return found[0]
        area = float(np.sum(result.organ_area))  # of solids one side
        shares = [_apart(area, shape.area * part, "trimesh's area") for part in (1.0, 0.5)]
        return shares[0] if all(shares) and (result.solid_share == 0.0).all() else None

    return ask


def _pandas(name: str) -> Callable[[str, Path, Any], str | None]:
    def ask(reader: str, folder: Path, result: Any) -> str | None:
        path = folder / name
        if path.suffix == ".xlsx":
            table = pd.read_excel(path)
        elif path.suffix == ".xyz":
            table = pd.read_csv(path, sep=r"\s+", header=None, comment="#")
            table.columns = [*"xyz", *map(str, range(3, table.shape[1]))][: table.shape[1]]
        else:
            table = pd.read_csv(path, comment="#", skip_blank_lines=True)
        table.columns = [str(c).strip().lower() for c in table.columns]
        if hasattr(result, "x"):
            columns = {a: getattr(result, a) for a in "xyz"}
        else:
            columns = {"value": [row.value for row in result]}
        if any(table.columns.tolist().count(name) != 1 for name in columns):
            return None
        for column, ours in columns.items():
            if not pd.api.types.is_numeric_dtype(table[column]):
                return None  # what it does not take for numbers may be ours
            if wrong := _apart(ours, table[column], f"pandas' {column}"):
                return wrong
        return None

    return ask


def _cube_of_arrays(name: str) -> Callable[[str, Path, Any], str | None]:
    """NetCDF by netCDF4, zarr by zarr: the numbers of the variable `reflectance`, by value."""

    def ask(reader: str, folder: Path, result: Any) -> str | None:
        ours = result.values if reader == "cube-netcdf" else np.concatenate(result[1])
        if name.endswith(".nc"):
            with netCDF4.Dataset(folder / name) as data:
                values = np.ma.filled(data["reflectance"][...].astype(float), np.nan)
        else:
            array: Any = zarr.open_group(folder / name, mode="r")["reflectance"]
            facts = dict(array.attrs)
            values = np.asarray(array[...], float)
            if "_FillValue" in facts or "missing_value" in facts:
                return None
            if array.metadata.zarr_format == 2 and array.fill_value is not None:
                values[values == float(array.fill_value)] = np.nan
            values = values * float(facts.get("scale_factor", 1.0))
            values = values + float(facts.get("add_offset", 0.0))
        theirs = values[np.abs(values) <= 1e6]
        scales = [1.0] if reader == "cube-netcdf" else [1.0, result[0]]
        mine = ours[np.isfinite(ours)]
        if reader == "cube-netcdf":  # spectra with gaps are left out
            known = all(np.isclose(theirs, one, rtol=1e-5, atol=1e-9).any() for one in mine)
            return None if known else "netCDF4 has other values"
        if mine.size != theirs.size:  # of pixels that are 0 in all bands ours are missing
            mine, theirs = mine[mine != 0.0], theirs[theirs != 0.0]
        if mine.size != theirs.size:
            return f"another library has {theirs.size} finite values, we {mine.size}"
        found = [_apart(np.sort(mine.ravel() / by), np.sort(theirs), "it") for by in scales]
        return found[0] if all(found) else None

    return ask


LIBRARIES: dict[str, Callable[[str, Path, Any], str | None]] = {
    "envi-library": _spectral("lib.hdr"), "cube-envi": _spectral("cube.hdr"),
    "blocks-envi": _spectral("cube.hdr"),
    "cube-geotiff": _rasterio("cube.tif"), "blocks-geotiff": _rasterio("cube.tif"),
    "bands": _rasterio("bands.tif"), "image": _rasterio("image.tif"),
    "terrain": _rasterio("terrain.tif"),
    "las": _laspy("cloud.las"), "laz": _laspy("cloud.laz"),
    "cloud-ply": _trimesh("cloud.ply"), "cloud-ply-text": _trimesh("cloud.ply"),
    "mesh-stl": _trimesh("plant.stl"), "mesh-ply": _trimesh("plant.ply"),
    "mesh-obj": _trimesh("plant.obj"), "mesh-glb": _trimesh("plant.glb"),
    "xyz": _pandas("cloud.xyz"), "cloud-csv": _pandas("cloud.csv"),
    "statistics": _pandas("statistics.csv"), "structure": _pandas("structure.csv"),
    "workbook": _pandas("statistics.xlsx"),
    "cube-netcdf": _cube_of_arrays("cube.nc"), "blocks-netcdf": _cube_of_arrays("cube.nc"),
    "blocks-zarr": _cube_of_arrays("cube.zarr"), "blocks-zarr3": _cube_of_arrays("cube.zarr"),
}  # fmt: skip
"""By reader, the library that reads the same files."""


def other_opinion(reader: str, folder: Path, result: Any) -> str | None:
    """What another library reads otherwise in the files of `folder`; nothing where it cannot."""
    ask = LIBRARIES.get(reader)
    if ask is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return ask(reader, folder, result)
        except Exception:  # whatever a library says to such files
            return None


# -- what the damage did not touch ----------------------------------------------------------


def untouched(
    reader: str, before: dict[str, bytes], after: dict[str, bytes], whole: Any, found: Any
) -> str | None:
    """Which value of the undamaged file is another although its bytes, and those that say what it
    means, are the same."""
    changed = [name for name in before if before[name] != after.get(name)]
    if len(changed) != 1 or before.keys() != after.keys():
        return None
    (name,) = changed
    old, new = before[name], after[name]
    if reader in _TEXT and name == _TEXT[reader]:
        return _lines_apart(old, new, whole, found)
    if len(old) != len(new):
        return None
    if reader == "las":
        (start,), (size,) = struct.unpack_from("<I", old, 96), struct.unpack_from("<H", old, 105)
        if old[:start] != new[:start] or not np.array_equal(found.x.shape, whole.x.shape):
            return None
        same = _records(old, start, size) == _records(new, start, size)
        same = same.all(axis=1)[: whole.x.size]
        parts = ((getattr(whole, a)[same], getattr(found, a)[same]) for a in "xyz")
        found_apart = (_apart(mine, first, "before, we") for first, mine in parts)
        return next(filter(None, found_apart), None)
    if Path(name).suffix in (".dat", ".sli"):
        same = (_records(old, 0, 4) == _records(new, 0, 4)).all(axis=1)
        first = np.frombuffer(old, "<f4")[same]
        shown = [v for _, v in numbers_of(plain(reader, found))]
        every = np.concatenate([v.ravel() for v in shown])
        near = np.sort(every[np.isfinite(every)])
        at = np.clip(np.searchsorted(near, first), 1, len(near) - 1)
        off = np.minimum(np.abs(near[at] - first), np.abs(near[at - 1] - first))
        lost = off > 1e-5 * np.abs(first)
        return f"{first[lost][0]:.6g} is no longer there" if lost.any() else None
    return None


def _records(data: bytes, start: int, size: int) -> np.ndarray:
    count = (len(data) - start) // size
    return np.frombuffer(data, np.uint8, count * size, start).reshape(count, size)


def _lines_apart(old: bytes, new: bytes, whole: Any, found: Any) -> str | None:
    """Rows of a table whose lines are the same, behind the same header."""
    before, after = old.split(b"\n"), new.split(b"\n")
    header = 0 if re.match(rb"[-+.\d]", before[0]) else 1
    if len(before) != len(after) or before[:header] != after[:header]:
        return None
    rows = [k for k, line in enumerate(before) if line and k >= header]
    if [bool(line.strip()) for line in before] != [bool(line.strip()) for line in after]:
        return None
    same = np.array([before[k] == after[k] for k in rows])
    wanted, came = dict(numbers_of(whole)), dict(numbers_of(found))
    for name, values in wanted.items():
        listed = re.match(r"\[(\d+)\]", name)
        if listed:
            if not isinstance(found, list) or len(found) != len(rows) or not same[int(listed[1])]:
                continue
            kept = np.ones(values.shape, bool)
        elif values.ndim == 1 and len(values) == len(rows):
            kept = same
        else:
            continue
        other = came.get(name)
        if other is None or other.shape != values.shape:
            continue
        if wrong := _apart(other[kept], values[kept], f"the line before, {name},"):
            return wrong
    return None
