"""Point clouds in: LAS and LAZ, PLY, E57, PTX, and text (XYZ, PTS, CSV)."""

import logging
import re
import struct
import warnings
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyproj
from jaxtyping import Float64, UInt8
from numpy.typing import NDArray
from rasterio.crs import CRS

from fynjax._core.errors import InputError, in_file, listed, refusing
from fynjax._core.extras import require
from fynjax._core.tables import name_and_unit, open_points, places_of
from fynjax.app.io.raster import UNITS, check_lengths, check_metric, parse_crs, unit_of_length
from fynjax.app.io.text import check_fits, check_stated_size, existing_file
from fynjax.app.terrain._units import (
    Bounds,
    check_bounds,
    check_coordinates,
    check_height_range,
    unit_factor,
)

GROUND_CLASSES = (2, 8, 9)
"""ASPRS classes that are ground: ground, model key points, water (LAS 1.4 R15, table 17)."""

_STRAY = 1000
"""One of so many points may lie far from all others and be left out."""
_NORMAL_CELL, _NORMAL_LEVEL = 5.0, 0.15
"""Cells and level [m] by which heights above the ground are known."""
_CUT, _CUT_EDGE = (0.2, 3.0), 0.05
"""Heights [m] at which low returns are cut away, and the depth of the layers compared above it."""
_FEWEST_AT_CUT = 20
_NOISE_CLASSES = (7, 18)
CLOUD_SUFFIXES = (".las", ".laz", ".ply", ".e57", ".ptx", ".pts", ".xyz")
"""Endings of files that are point clouds, and nothing else."""
_PTX_HEADER = 10
"""Lines before the points of a station: columns, rows, the scanner's place, and a matrix."""


@dataclass(frozen=True)
class PointCloud:
    """Points in metres: x east, y north, z up."""

    x: Float64[np.ndarray, " point"]
    """Easting [m]."""
    y: Float64[np.ndarray, " point"]
    """Northing [m]."""
    z: Float64[np.ndarray, " point"]
    """Height [m]."""
    classification: UInt8[np.ndarray, " point"] | None = None
    """ASPRS class of each point (2 is ground), where the file has one."""
    crs: str | None = None
    """Coordinate reference system as WKT; `None` where the file states none."""

    def __len__(self) -> int:
        return len(self.x)

    @property
    def bounds(self) -> Bounds:
        """The rectangle that holds all points."""
        west, south = float(self.x.min()), float(self.y.min())
        return west, south, float(self.x.max()), float(self.y.max())

    def select(self, keep: NDArray[np.bool_]) -> "PointCloud":
        """The points where `keep` is true."""
        labels = self.classification
        return replace(
            self,
            x=self.x[keep],
            y=self.y[keep],
            z=self.z[keep],
            classification=None if labels is None else labels[keep],
        )

    def crop(self, bounds: Bounds, margin: float = 0.0) -> "PointCloud":
        """The points in a rectangle and up to `margin` [m] around it."""
        west, south, east, north = check_bounds(bounds)
        inside = (self.x >= west - margin) & (self.x <= east + margin)
        inside &= (self.y >= south - margin) & (self.y <= north + margin)
        if not inside.any():
            w, s, e, n = self.bounds
            raise InputError(
                f"the plot ({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}) has no point of "
                f"the cloud, which covers ({w:.1f}, {s:.1f}) to ({e:.1f}, {n:.1f}). Are both in "
                "the same coordinate reference system, x first?"
            )
        return self.select(inside)


def read_cloud(
    path: str | Path,
    *,
    unit: str | None = None,
    height_unit: str | None = None,
    crs: str | None = None,
) -> PointCloud:
    """Read a point cloud from a drone's photographs or a laser scanner.

    **Arguments:**

    - `path`: LAS or LAZ; PLY; E57 and PTX, whose stations are put together; or text (.xyz, .pts,
      .txt, .csv): x, y, z as the first three columns or named in a header, which may also have
      `classification`.
    - `unit`: one of `UNITS`, for files that are not in metres. Coordinates are then converted,
      and a reference system, whose coordinates they are no more, is dropped.
    - `height_unit`: the same for z alone; `unit` unless given.
    - `crs`: reference system of a file that states none, such as "EPSG:32734".

    Points marked as noise (classes 7 and 18) or withheld are left out.

    **Returns:** `PointCloud`, in metres.

    **Raises:** `InputError` for a file that is missing, cut short, of another format, has NaN, is
    in degrees or in another unit than metres that was not stated. Units are known from the
    reference system, the header, and numbers that cannot be metres of a plot (a point in 25 m2,
    relief of twice the plot's width); feet without any of these look like metres. Refused too are a
    system in which lengths are not those on the ground (EPSG:3857), and text without names whose
    first column counts the points. Warns of a northing first, and of points beyond the count.
    Single heights below -500 or above 9000 m are refused; if all are, that is a warning, as are
    heights that begin so sharply from 0.2 to 3 m that low returns seem to be cut away.
    `MissingExtraError` for LAS without the extra `terrain`, and E57 without the extra `e57`.
    """
    path = existing_file(path, "a point cloud")
    if path.stat().st_size == 0:
        raise InputError("expected a point cloud, but the file is empty", file=path)
    suffix, system = path.suffix.lower(), None
    unit_stated, height_stated = unit is not None, unit is not None or height_unit is not None
    if suffix in (".las", ".laz"):
        cloud, system = _read_las(path, unit_stated, height_stated, crs_stated=crs is not None)
    elif suffix == ".ply":
        cloud = _read_ply(path)
    elif suffix == ".e57":
        cloud = _read_e57(path)
    elif suffix == ".ptx":
        cloud = _read_ptx(path)
    elif suffix in (".xyz", ".pts", ".txt", ".csv"):
        cloud = _read_text(path, unit_stated)
    else:
        raise InputError(
            f"expected a point cloud ({', '.join(CLOUD_SUFFIXES)}, .txt or .csv), but this is a "
            f"{suffix or 'file without a suffix'}",
            file=path,
        )
    system = system if crs is None else parse_crs(crs, path)
    if system is not None:
        with in_file(path):
            check_metric(system, unit_stated=unit_stated, height_stated=height_stated)
            if not unit_stated:
                middle = float(np.median(cloud.x)), float(np.median(cloud.y))
                check_lengths(system, *middle, "Reproject it first, such as to {zone}.")
    factor = unit_factor(unit or "metre")
    height_factor = unit_factor(height_unit or unit or "metre")
    if factor != 1.0:
        system = None
    cloud = replace(
        cloud,
        x=cloud.x * factor,
        y=cloud.y * factor,
        z=cloud.z * height_factor,
        crs=None if system is None else system.to_wkt(),
    )
    labels = cloud.classification
    if labels is not None and (noise := np.isin(labels, _NOISE_CLASSES)).any():
        cloud = cloud.select(~noise)
    cloud = _without_strays(cloud, path)
    check_coordinates(cloud.x, cloud.y, cloud.z, path, unit_stated=unit_stated)
    # Another unit than that of x and y would show in the relief.
    check_height_range(cloud.z, path, "Take these points out.", unit_known=True)
    if (height := _cut_height(cloud)) is not None:
        warnings.warn(
            f"{path}: heights begin sharply at {height:.1f} m, as those above the ground do whose "
            "low returns were cut away. What is found for ground is then plants: take the cloud "
            "with its ground",
            stacklevel=2,
        )
    return cloud


def _without_strays(cloud: PointCloud, path: Path) -> PointCloud:
    """The cloud without the few points that lie farther from all others than these reach."""
    places = np.stack([cloud.x, cloud.y])
    if len(cloud) < _STRAY or not np.isfinite(places).all():
        return cloud
    low, high = np.quantile(places, (1.0 / _STRAY, 1.0 - 1.0 / _STRAY), axis=1)
    reach = max(float((high - low).max()), 1.0)
    far = ((places < (low - reach)[:, None]) | (places > (high + reach)[:, None])).any(axis=0)
    if not far.any() or far.mean() >= 1.0 / _STRAY:
        return cloud
    x, y = places[:, np.argmax(far)]
    warnings.warn(
        f"{path}: {int(far.sum())} of {len(cloud)} points lie far from all others, such as at "
        f"({x:.1f}, {y:.1f}), and are left out",
        stacklevel=3,
    )
    return cloud.select(~far)


def is_normalised(cloud: PointCloud) -> bool:
    """Whether heights seem to be above the ground and not above the sea: the lowest point of
    three in ten cells of 5 m at least is within 0.15 m of 0, and next to none lies deeper.

    **Arguments:** `cloud`, in metres.
    """
    lowest = _lowest(cloud)
    near = np.abs(lowest) <= _NORMAL_LEVEL
    return bool(near.mean() > 0.3 and np.quantile(lowest, 0.01) > -2.0 * _NORMAL_LEVEL)


def _lowest(cloud: PointCloud) -> NDArray[np.float64]:
    """Height of the lowest point of each cell of 5 m that has any [m]."""
    i, j = (np.floor((v - v.min()) / _NORMAL_CELL).astype(np.int64) for v in (cloud.x, cloud.y))
    _, which = np.unique(j * (i.max() + 1) + i, return_inverse=True)
    lowest = np.full(which.max() + 1, np.inf)
    np.minimum.at(lowest, which, cloud.z)
    return lowest


def _cut_height(cloud: PointCloud) -> float | None:
    """Height below which points seem to be cut away [m], or None: a tenth of a metre just below the
    lowest point, which many cells of 5 m reach down to, with about as many points right above it as
    further up. Ground has fewer there, as it scatters, or, where it is flat, nearly all."""
    low = float(cloud.z.min())
    tenth = np.floor(10.0 * low + 1e-6) / 10.0
    if not (_CUT[0] <= low <= _CUT[1] and low - tenth < 0.01):
        return None
    edges = tenth + _CUT_EDGE * np.arange(3)
    first, second = np.histogram(cloud.z, edges)[0]
    even = min(first, second) > 0.5 * max(first, second) and min(first, second) >= _FEWEST_AT_CUT
    if not even or (_lowest(cloud) <= tenth + _NORMAL_LEVEL).mean() <= 0.3:
        return None
    return float(tenth)


def _read_las(
    path: Path, unit_stated: bool, height_stated: bool, *, crs_stated: bool
) -> tuple[PointCloud, CRS | None]:
    """Points of a LAS or LAZ file, in its unit, and its reference system, unless another is
    stated."""
    laspy = require("laspy", "terrain")
    if path.suffix.lower() == ".laz":
        require("lazrs", "terrain")
    _check_las_header(path)
    # A logger without a handler prints to stderr, and the error below is clearer.
    logging.getLogger("laspy").addHandler(logging.NullHandler())
    try:
        # Its parallel decompressor takes whatever memory a damaged table of parts asks for.
        las = laspy.read(path, laz_backend=laspy.LazBackend.Lazrs)
        promised = int(las.header.point_count)
        x, y, z = (np.array(axis, np.float64) for axis in (las.x, las.y, las.z))
        labels = np.array(las.classification, np.uint8)
        # A flag from point format 6 on, and a bit beside the class before it.
        names = set(las.point_format.dimension_names)
        withheld = np.array(las.withheld, bool) if "withheld" in names else np.zeros(len(x), bool)
    except BaseException as error:  # laspy raises whatever it stumbles over, lazrs no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        reason = " ".join(str(error).split())
        raise InputError(
            f"cannot be read as {path.suffix[1:].upper()} ({reason}). Is it cut short, or of "
            "another format? Copy it again.",
            file=path,
        ) from error
    if len(x) != promised:
        raise InputError(
            f"expected {promised} points as the header says, but the file has {len(x)}. "
            "It is cut short: copy it again.",
            file=path,
        )
    # Zero is "created, never classified": a file with nothing else has no classes.
    cloud = PointCloud(x, y, z, labels if labels.any() else None)
    system = None
    if not crs_stated:
        system = _las_crs(las.header, path, unit_stated, height_stated)
    return cloud.select(~withheld), system


_POINT = 60
"""Bytes of a point in memory beside two copies of its record."""
_LASZIP, _EXTRA_BYTES = 22204, 14
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of each kind of item in points of format 6 on: point, colour, colour with near infrared,
wave packet."""


def _check_las_header(path: Path) -> None:
    """`InputError` where a LAS or LAZ header states more than its file can hold.

    Fields as in LAS 1.4 R15, tables 3, 5 and 6, and in the LASzip specification 1.4, section 4.
    A table that states too many chunks, or layers larger than the file, make the decompressor end
    the process instead of raising; of layers those of the first chunk are looked at.
    """
    held = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(375).ljust(375, b"\0")
        minor, (header_size,) = head[25], struct.unpack_from("<H", head, 94)
        start, n_records, kind, size, count = struct.unpack_from("<IIBHI", head, 96)
        waves = struct.unpack_from("<Q", head, 227)[0] if minor >= 3 else 0
        first_extended = 0
        if minor >= 4:
            first_extended, n_extended, count = struct.unpack_from("<QIQ", head, 235)
            check_stated_size(
                path, first_extended + 60 * n_extended if n_extended else 0,
                f"{n_extended} extended records", packed=False,
            )  # fmt: skip
        check_stated_size(path, header_size + 54 * n_records, f"{n_records} records", packed=False)
        packed = bool(kind & 0x80)
        check_stated_size(
            path, count * size if packed else start + count * size, f"{count} points", packed=packed
        )
        end = min((place for place in (first_extended, waves) if place > start), default=held)
        if not packed and size and (room := (min(end, held) - start) // size) > count:
            warnings.warn(
                f"{path}: the header counts {count} points, but the file has room for {room}: "
                "those beyond the count are not read. Was it not closed when it was written? "
                "Write it again",
                stacklevel=4,
            )
        advice = "Cut a part of it, or thin it, first"
        check_fits(count * (2 * size + _POINT), f"{count} points", advice, path)
        if not packed:
            return
        file.seek(start)
        table = int.from_bytes(file.read(8), "little", signed=True)
        if table == -1:  # written as a stream: the place stands at the end
            file.seek(max(held - 8, 0))
            table = int.from_bytes(file.read(8), "little", signed=True)
        if not 0 <= table <= held - 8:
            raise InputError(
                "the table of its compressed parts lies outside the file. Is it cut short? Copy it "
                "again.",
                file=path,
            )
        file.seek(table + 4)
        chunks = int.from_bytes(file.read(4), "little")
        # Each part begins with a whole point.
        check_stated_size(path, chunks * size, f"{chunks} compressed parts", packed=False)
        layers, record = 0, _laszip_record(file, header_size, n_records)
        for at in range(34, len(record) - 5, 6):
            item, wide, _ = struct.unpack_from("<HHH", record, at)
            layers += wide if item == _EXTRA_BYTES else _LAYERS.get(item, 0)
        if layers:  # their sizes follow the first point and the number of points of a part
            file.seek(start + 8 + size + 4)
            stated = np.frombuffer(file.read(4 * layers), "<u4")
            check_stated_size(
                path, start + int(stated.sum(dtype=np.int64)), "layers of points", packed=False
            )


def _laszip_record(file: BinaryIO, start: int, count: int) -> bytes:
    """The record that says how points are compressed; empty where there is none."""
    for _ in range(count):
        file.seek(start)
        head = file.read(54)
        if len(head) < 54:
            break
        kind, length = struct.unpack_from("<HH", head, 18)
        if kind == _LASZIP and head[2:18].rstrip(b"\0") == b"laszip encoded":
            return file.read(length)
        start += 54 + length
    return b""


_NO_SYSTEM = "\0 \t\r\n'\""
"""What may stand round the text of a record, or in place of it."""
_UNKNOWN = ("", "unknown", "none", "null", "undefined", "n/a")
"""Texts that state no system."""


def _las_crs(header: Any, path: Path, unit_stated: bool, height_stated: bool) -> CRS | None:
    """The reference system of a LAS header, from its WKT or its GeoTIFF keys (GeoTIFF 1.1)."""
    records = [*header.vlrs, *(header.evlrs or [])]
    for record in records:
        text = getattr(record, "string", "").strip(_NO_SYSTEM)
        if type(record).__name__ == "WktCoordinateSystemVlr" and text.lower() not in _UNKNOWN:
            try:
                return parse_crs(text, path)
            except InputError as error:
                raise InputError(
                    f"{error.message}. If you know it, state it: --crs EPSG:... (`crs`)", file=path
                ) from error
    for record in records:
        if type(record).__name__ != "GeoKeyDirectoryVlr":
            continue
        keys = _geo_keys(record, records)
        for what, factor, stated in (
            ("coordinates", _factor_of_places(keys), unit_stated),
            ("heights", _factor_of_heights(keys), height_stated),
        ):
            if not (stated or abs(factor - 1.0) < 1e-9):
                raise InputError(
                    f"expected {what} in metres, but the file says {unit_of_length(factor)}. "
                    "Reproject to a metric system, or state the unit.",
                    file=path,
                )
        # ProjectedCSType and GeographicType; 32767 is "user-defined".
        for code in (keys.get(3072), keys.get(2048)):
            if code and code != _OWN:
                return parse_crs(code, path)
    return None


_OWN = 32767
"""Code of what a file defines itself."""
_FOOT = re.compile(r"(?<![a-z])(us)?[ _]?(survey[ _])?(ft|feet|foot)[ _]?(us?)?(?![a-z])", re.I)


def _geo_keys(record: Any, records: list[Any]) -> dict[int, Any]:
    """Values of a GeoKeyDirectory, which states a LAS file's reference system: a code, number or
    text by the number of its key."""
    keys: dict[int, Any] = {}
    for key in record.geo_keys:
        if key.tiff_tag_location == 0:
            keys[key.id] = key.value_offset
        for other in (r for r in records if r.record_id == key.tiff_tag_location):
            data, start = other.record_data_bytes(), key.value_offset
            if other.record_id == 34737:
                keys[key.id] = data[start : start + key.count].decode("latin-1")
            elif other.record_id == 34736 and len(data) >= 8 * start + 8:
                keys[key.id] = struct.unpack_from("<d", data, 8 * start)[0]
    return keys


def _factor_of_unit(code: Any) -> float | None:
    """Metres in a unit of EPSG; None for none that is known."""
    units = pyproj.database.get_units_map("EPSG", "linear", allow_deprecated=True).values()
    return next((unit.conv_factor for unit in units if unit.code == str(code)), None)


def _factor_of_words(text: Any) -> float | None:
    """Metres in the unit that the name of a system ends in; None without a word for feet."""
    found = _FOOT.search(str(text or ""))
    return found and (UNITS["us_survey_foot" if "u" in found[0].lower() else "foot"])


def _factor_of_places(keys: dict[int, Any]) -> float:
    """Metres in the unit of x and y by GeoTIFF's keys (ProjLinearUnits and its size, or the name of
    a system that has no code); 1 where they say none."""
    if keys.get(3076) == _OWN and isinstance(size := keys.get(3077), float) and size > 0.0:
        return size
    factor = _factor_of_unit(keys.get(3076))
    if factor is None and keys.get(3072, _OWN) == _OWN:
        named = keys.get(3073) or str(keys.get(1026, "")).partition("+")[0]
        factor = _factor_of_words(named)
    return factor or 1.0


def _factor_of_heights(keys: dict[int, Any]) -> float:
    """Metres in the unit of z by GeoTIFF's keys (VerticalUnits, the system of heights, names); 1
    where they say none."""
    factor = _factor_of_unit(keys.get(4099))
    if factor is None and keys.get(4096, _OWN) != _OWN:
        with suppress(pyproj.exceptions.CRSError):
            factor = pyproj.CRS.from_epsg(keys[4096]).axis_info[-1].unit_conversion_factor
    if factor is None:
        named = keys.get(4097) or str(keys.get(1026, "")).partition("+")[2]
        factor = _factor_of_words(named)
    return factor or 1.0


def _read_ply(path: Path) -> PointCloud:
    """Points of the vertices of a PLY file, in its unit."""
    import trimesh

    try:
        with np.errstate(all="ignore"):  # of numbers that are checked below
            cloud = trimesh.load(str(path), process=False)
    except Exception as error:  # trimesh's readers raise whatever they stumble over
        reason, advice = " ".join(str(error).split()), "Is it cut short? Copy it again."
        if isinstance(error, KeyError) and error.args[0] in ("x", "y", "z"):
            reason = f"its points have no property {reason}"
            advice = "Name the coordinates x, y and z in its header, in small letters."
        raise InputError(f"cannot be read as PLY ({reason}). {advice}", file=path) from error
    points = np.asarray(getattr(cloud, "vertices", np.zeros((0, 3))), np.float64)
    if points.ndim != 2 or len(points) == 0:
        raise InputError("expected a PLY file with points, but it has no vertices", file=path)
    _check_precision(points, path)
    columns = cloud.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
    labels = None
    names = columns if isinstance(columns, dict) else (columns.dtype.names or ())
    for name in names:
        if re.fullmatch(r"(scalar_)?class(ification)?", name.lower()):
            labels = np.asarray(columns[name]).reshape(-1).astype(np.uint8)
    x, y, z = points.T
    return PointCloud(x, y, z, labels)


def _read_e57(path: Path) -> PointCloud:
    """Points of all stations of an E57 file, as they stand together."""
    pye57 = require("pye57", "e57")
    parts = []
    try:
        file = pye57.E57(str(path))
        for number in range(file.scan_count):
            scan = file.read_scan(number, ignore_missing_fields=True)
            parts.append(np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1))
    except Exception as error:  # the library raises whatever it stumbles over
        reason = " ".join(str(error).split())
        raise InputError(
            f"cannot be read as E57 ({reason}). Is it cut short? Copy it again.", file=path
        ) from error
    if not parts or not sum(map(len, parts)):
        raise InputError("expected an E57 file with points, but it has none", file=path)
    return PointCloud(*np.concatenate(parts).astype(np.float64).T)


def _read_ptx(path: Path) -> PointCloud:
    """Points of all stations of a PTX file (Leica), each brought to its place by its matrix."""
    parts = []
    with path.open("rb") as file:
        lines = iter(file)
        row = 0
        for first in lines:
            if not first.strip():
                continue
            head = [first, *(line for _, line in zip(range(_PTX_HEADER - 1), lines))]
            words = "expected the header of a station of PTX, ten lines of numbers ({error})"
            with refusing(ValueError, OverflowError, IndexError, words=words, file=path):
                columns, rows = int(head[0]), int(head[1])
                matrix = np.array([line.split() for line in head[6:]], float)
                if columns < 0 or rows < 0 or matrix.shape != (4, 4):
                    raise ValueError(f"from row {row + 1} on")
            count = columns * rows
            check_stated_size(path, 6 * count, f"{count} points", packed=True)
            with refusing(ValueError, words="expected x, y and z ({error})", file=path):
                texts = [line.split(None, 3)[:3] for _, line in zip(range(count), lines)]
                points = np.array(texts, float).reshape(-1, 3)
            if len(points) != count:
                raise InputError(
                    f"expected {count} points of a station, but there are {len(points)}. It is cut "
                    "short: copy it again.",
                    file=path,
                )
            points = points[(points != 0.0).any(axis=1)]  # 0 0 0: nothing came back
            parts.append(points @ matrix[:3, :3] + matrix[3, :3])
            row += _PTX_HEADER + count
    if not parts or not sum(map(len, parts)):
        raise InputError("expected a PTX file with points, but it has none", file=path)
    return PointCloud(*np.concatenate(parts).T)


def _check_precision(points: NDArray[np.float64], path: Path) -> None:
    """Refuse map coordinates in single precision, which stand on steps of up to half a metre."""
    largest = np.abs(points[np.isfinite(points)]).max(initial=0.0)
    step = float(np.spacing(np.float32(largest)))
    if step > 0.01 and np.array_equal(points.astype(np.float32), points, equal_nan=True):
        raise InputError(
            f"the coordinates are stored in single precision, in which they move in steps of "
            f"{step:.2g} m. Export again in double precision, or with a local origin.",
            file=path,
        )


_NAMES = {
    "x": ("x", "easting", "east", "e"),
    "y": ("y", "northing", "north", "n"),
    "z": ("z", "height", "elevation", "elev", "altitude", "alt", "h"),
    "classification": ("classification", "class", "scalar_classification", "label"),
}
_DEGREES = ("lon", "longitude", "lat", "latitude", "long")


def _text_columns(
    names: tuple[str, ...], path: Path, row: int, unit_stated: bool
) -> dict[str, int]:
    """Where x, y, z (and the class) stand, by the header's names."""
    plain = [name_and_unit(name) for name in names]
    places = places_of(names, _NAMES, file=path, row=row)
    missing = [axis for axis in "xyz" if axis not in places]
    if missing:
        degrees = any(name in _DEGREES for name, _ in plain)
        hint = (
            " Longitude and latitude? Reproject to a metric system first."
            if degrees
            else " Name the columns x, y, z."
        )
        raise InputError(
            f"expected columns x, y and z, but the header has {listed(names)}.{hint}",
            file=path,
            row=row,
        )
    for axis in "xyz":
        unit = plain[places[axis]][1]
        degrees = unit.startswith("deg")
        if ((unit and not unit.startswith("m")) or unit == "mm") and (degrees or not unit_stated):
            hint = "Reproject to a metric system first" if degrees else "State the unit"
            raise InputError(
                f"expected metres, but the header says {'degrees' if degrees else repr(unit)}. "
                f"{hint}.",
                file=path,
                row=row,
                column=names[places[axis]],
            )
    return places


def _read_text(path: Path, unit_stated: bool) -> PointCloud:
    """Points of a cloud written as text, as `open_points` takes it, in its unit."""
    table = open_points(path, "a point cloud", "xyz")
    if not table.headed:
        table.names = (*"xyz", *table.names[3:])
    places = _text_columns(table.names, path, table.row, unit_stated)
    x, y, z, *classes = table.columns(list(places.values())).to_numpy().T
    if not table.headed:
        _check_order(x, y, path)
    return PointCloud(x, y, z, classes[0].astype(np.uint8) if classes else None)


def _check_order(x: NDArray[np.float64], y: NDArray[np.float64], path: Path) -> None:
    """Doubt columns without names that are not x and y by their numbers: those of points, which
    count on, are refused; northing and easting of UTM are a warning."""
    if len(x) > 9 and (np.diff(x) == 1.0).all() and x[0] in (0.0, 1.0):
        raise InputError(
            f"expected x, y and z in the first columns, but the first counts the points from "
            f"{x[0]:g} to {x[-1]:g}. Name the columns in a first line, such as id,x,y,z.",
            file=path,
        )
    east, north = np.median(x), np.median(y)
    if 1.1e6 < east < 1e7 and 1e5 < north < 9e5:
        warnings.warn(
            f"{path}: its columns have no names, and x is taken to be about {east:.0f}, y "
            f"{north:.0f}. Northing first? Then all is mirrored: name the columns, such as y,x",
            stacklevel=4,
        )
