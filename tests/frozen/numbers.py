"""The files of a folder as a few numbers each, and what of two such sets differs."""

import html
import json
import re
import struct
import tomllib
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pandas as pd
import rasterio
import xarray as xr
from PIL import Image

Numbers = dict[str, list[float]]
"""By file and column: how many values are finite, their mean, the mean of each times the sine of
its place (so that another order is seen), and their root mean square; of one value itself. Of text
how many there are, and of short text, such as names, a checksum. Of a picture the mean colour of
each of 8 x 6 parts of it; of a page, and of sentences, each number in them, on a scale on which a
hundredth of any is as far."""

_ROUGHLY = {": colours of parts": 0.05, ": numbers shown": 0.02, ": said": 0.02}
"""What is shown may differ by: of colours, as letters are drawn otherwise by other versions; and by
a fiftieth of the numbers of sentences, which are rounded."""
_LATER = (*_ROUGHLY, ": gps_time")
"""What is compared where a case has frozen any of its kind."""
_DIGITS = re.compile(
    r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)(?!\s(?:CPU )?(?:s|min|h|[MG]iB)\b)"
)
_OF_A_RUN = re.compile(r"seconds|memory|wall|time|version", re.IGNORECASE)

_DIFFERS_BY_RUN = re.compile(
    r"(^|[._])(timings?|time|timings_s|files?|output|date|version|created|command)(\[\]|[._]|$)"
    r"|memory|seconds|hash|software"
)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers and texts of what JSON or TOML holds, by path; those of a list share theirs."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _leaves(part, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for part in value:
            yield from _leaves(part, f"{path}[]")
    else:
        yield path, value


def _records(value: Any) -> dict[str, np.ndarray]:
    columns: dict[str, list[Any]] = {}
    for path, leaf in _leaves(value):
        columns.setdefault(path, []).append(np.nan if leaf is None else leaf)
    return {path: np.array(column) for path, column in columns.items()}


def _dataset(data: xr.Dataset, group: str = "") -> dict[str, np.ndarray]:
    return {f"{group}{name}": np.asarray(data[name]) for name in data.variables}


def _netcdf(path: Path) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    for group, data in xr.open_groups(path, engine="h5netcdf").items():
        columns |= _dataset(data, group.strip("/") and f"{group.strip('/')}/")
        data.close()
    return columns


def _raster(path: Path) -> dict[str, np.ndarray]:
    with rasterio.open(path) as file:
        names = [name or f"band {i}" for i, name in enumerate(file.descriptions, 1)]
        return {"place": np.array(file.transform), **dict(zip(names, file.read()))}


def _text(path: Path) -> dict[str, np.ndarray]:
    """Numbers in lines that begin with the same word: OBJ."""
    lines: dict[str, list[list[str]]] = {}
    for line in path.read_text("utf-8").splitlines():
        word, *rest = re.split(r"[\s/]+", line.strip()) if line.strip() else ("",)
        lines.setdefault(word, []).append(rest)
    return {
        word: np.array([float(n) for row in rows for n in row])
        for word, rows in lines.items()
        if word in ("v", "vn", "vt", "f", "l", "Kd", "Ks", "Ns", "d")
    }


def _as_numbers(column: pd.Series) -> np.ndarray:
    """Numbers where there are any, beside text or not."""
    numbers = pd.to_numeric(column, errors="coerce")
    return (numbers if numbers.notna().any() else column).to_numpy()


def columns_of(path: Path) -> dict[str, np.ndarray]:
    """What a file holds, by column, variable, band or key."""
    kind = path.suffix.lower()
    if kind == ".csv":
        table = pd.read_csv(path, comment="#")
        return {str(name): _as_numbers(table[name]) for name in table.columns}
    if kind == ".json":
        return _records(json.loads(path.read_text("utf-8")))
    if kind == ".toml":
        return _records(tomllib.loads(path.read_text("utf-8")))
    if kind == ".nc":
        return _netcdf(path)
    if kind == ".zarr":
        with xr.open_zarr(path, consolidated=False) as data:
            return _dataset(data)
    if kind in (".tif", ".tiff", ".bsq", ".img", ".dat"):
        return _raster(path)
    if kind in (".las", ".laz"):
        cloud = laspy.read(path)
        names = ["x", "y", "z", *list(cloud.point_format.dimension_names)[3:]]
        return {name: np.asarray(cloud[name]) for name in names}
    if kind in (".obj", ".mtl"):
        return _text(path)
    if kind == ".png":
        return {
            "pixels": np.array(struct.unpack(">2I", path.read_bytes()[16:24])),
            "colours of parts": _colours(path),
        }
    if path.name == "report.html":
        return {"numbers shown": _page(path.read_text("utf-8"))}
    return {}


def _colours(path: Path) -> np.ndarray:
    """Mean red, green and blue of 8 x 6 parts of a picture, from 0 to 255."""
    with Image.open(path) as image:
        parts = image.convert("RGB").resize((8, 6), Image.Resampling.BOX)
    return np.asarray(parts, float).round(1)


def _in_text(text: str) -> list[float]:
    """The numbers of a sentence, but for those of paths and dates."""
    text = re.sub(r"\S*[/\\]\S+|\d+-\d\d-\d\d\S*", " ", text)
    return [float(found.replace("−", "-")) for found in _DIGITS.findall(text)]


def _each(numbers: np.ndarray) -> list[float]:
    """Every number, on a scale whose steps are shares of it above a thousandth."""
    scaled = np.arcsinh(1000.0 * numbers)
    return [float(numbers.size), *scaled.round(4).tolist(), 1.0]


def _page(text: str) -> np.ndarray:
    """Numbers that a page says to its reader: its sentences, key figures and tables, without times,
    the lines at its head, which say the first of it again, and the record at its foot."""
    text = re.sub(r"<(style|script|head|header|footer)\b.*?</\1>", " ", text, flags=re.DOTALL)
    parts = re.split(r"(?=<(?:p|section|figure|div class=\"key\")\b)", text)
    shown = [part for part in parts if not _OF_A_RUN.search(re.sub(r"<[^>]*>", " ", part))]
    return np.array(_in_text(html.unescape(re.sub(r"<[^>]*>", " ", " ".join(shown)))))


def _numbers(values: np.ndarray) -> list[float]:
    if values.dtype.kind not in "biuf":
        texts = [str(value) for value in values.ravel().tolist()]
        short = max(map(len, texts), default=0) < 40
        return [float(len(texts)), *([float(zlib.crc32("\n".join(texts).encode()))] * short)]
    flat = values.ravel().astype(float)
    known = np.isfinite(flat)
    if not known.any():
        return [0.0]
    if flat.size == 1:
        return [1.0, float(f"{flat[0]:.9g}")]
    places = np.sin(1.0 + np.arange(flat.size))[known]
    flat = flat[known]
    parts = flat.size, flat.mean(), (places * flat).mean(), np.sqrt((flat**2).mean())
    return [float(f"{part:.9g}") for part in parts]


def numbers_of(folder: Path) -> Numbers:
    """Every file below `folder`, by name, as numbers; nothing that differs from run to run."""
    found: Numbers = {}
    for path in sorted(folder.rglob("*")):
        if any(part.endswith(".checkpoint") for part in path.parts):
            continue  # what an unfinished run keeps is its own affair
        inside = path.relative_to(folder)
        store = path.suffix == ".zarr"
        if (path.is_dir() and not store) or any(p.suffix == ".zarr" for p in inside.parents):
            continue
        found[inside.as_posix()] = [1.0]
        for name, values in columns_of(path).items():
            key = f"{inside.as_posix()}: {name}"
            if name == "colours of parts":
                found[key] = [float(values.size), *values.ravel().tolist(), 255.0]
            elif name == "numbers shown":
                found[key] = _each(values)
            elif name == "gps_time" or not _DIFFERS_BY_RUN.search(name):
                found[key] = _numbers(np.asarray(values))
                if values.dtype.kind not in "biuf" and values.size:
                    said = [n for one in values.ravel() for n in _in_text(str(one))]
                    if len(str(values.ravel()[0])) >= 40 and said:
                        found[f"{key}: said"] = _each(np.array(said))
    return found


def differences(frozen: Numbers, now: Numbers, loose: Mapping[str, float]) -> list[str]:
    """A line for everything that differs by more than 1e-5 of its root mean square.

    `loose` has a larger share for what a pattern finds, also for how many values there are;
    of infinity, whether there are any.
    """
    never = [kind for kind in _LATER if not any(kind in name for name in frozen)]
    now = {k: v for k, v in now.items() if not any(kind in k for kind in never)}
    left_out = [pattern for pattern, share in loose.items() if share == np.inf]
    frozen, now = (
        {k: v for k, v in one.items() if not any(re.search(p, k) for p in left_out)}
        for one in (frozen, now)
    )
    lines = [f"{name}: is new" for name in now.keys() - frozen.keys()]
    lines += [f"{name}: is missing" for name in frozen.keys() - now.keys()]
    for name in frozen.keys() & now.keys():
        old, new = frozen[name], now[name]
        share = max([1e-5, *(s for pattern, s in loose.items() if re.search(pattern, name))])
        share = max([share, *(s for kind, s in _ROUGHLY.items() if name.endswith(kind))])
        sizes = [old[0] * (share > 1e-5), *[abs(old[-1])] * (len(old) - 1)]
        apart = [abs(a - b) > share * size for a, b, size in zip(old, new, sizes)]
        if len(old) != len(new) or any(apart):
            lines.append(f"{name}: {old} was frozen, now {new} (allowed {share:g})")
    return sorted(lines)
