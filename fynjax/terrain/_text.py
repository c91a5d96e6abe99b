"""Point clouds as text: XYZ, CSV and their like."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError

_NAMES = {
    "x": ("x", "easting", "east", "e"),
    "y": ("y", "northing", "north", "n"),
    "z": ("z", "height", "elevation", "elev", "altitude", "alt", "h"),
    "classification": ("classification", "class", "scalar_classification", "label"),
}
_DEGREES = ("lon", "longitude", "lat", "latitude", "long")
_HEAD = 50


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


def _split(line: str, separator: str) -> list[str]:
    tokens = line.split() if separator == r"\s+" else line.split(separator)
    return [token.strip().strip('"') for token in tokens]


def _plain(name: str) -> tuple[str, str]:
    """A column's name and its unit: "X [cm]" is ("x", "cm")."""
    found = re.fullmatch(
        r"(.*?)[\s_\[(]+(m|cm|mm|ft|feet|foot|us_?ft|deg|degrees?|metres?|meters?)[\])]*",
        name.strip().lower(),
    )
    return (found.group(1).strip(), found.group(2)) if found else (name.strip().lower(), "")


def _head(path: Path) -> list[str]:
    """The first lines; `InputError` for a file that is no text."""
    with path.open("rb") as file:
        raw = b"".join(file.readline(10_000) for _ in range(_HEAD))
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise InputError("expected a point cloud as text, but this is a binary file", file=path)
    return text.splitlines()


def _columns(names: list[str], path: Path, row: int, unit_stated: bool) -> dict[str, int]:
    """Where x, y, z (and the class) stand, by the header's names."""
    plain = [_plain(name) for name in names]
    places: dict[str, int] = {}
    for wanted, known in _NAMES.items():
        for k, (name, _) in enumerate(plain):
            if name in known and wanted not in places:
                places[wanted] = k
    missing = [axis for axis in "xyz" if axis not in places]
    if missing:
        degrees = any(name in _DEGREES for name, _ in plain)
        hint = (
            " Longitude and latitude? Reproject to a metric system first."
            if degrees
            else " Name the columns x, y, z."
        )
        raise InputError(
            f"expected columns x, y and z, but the header has {', '.join(names)}.{hint}",
            file=path,
            row=row,
        )
    for axis in "xyz":
        unit = plain[places[axis]][1]
        if (unit and not unit.startswith("m")) or unit == "mm":
            if unit.startswith("deg"):
                raise InputError(
                    "expected metres, but the header says degrees. Reproject to a metric system "
                    "first.",
                    file=path,
                    row=row,
                    column=names[places[axis]],
                )
            if not unit_stated:
                raise InputError(
                    f"expected metres, but the header says {unit!r}. State the unit.",
                    file=path,
                    row=row,
                    column=names[places[axis]],
                )
    return places


def read_text_cloud(path: Path, *, unit_stated: bool) -> tuple[Any, Any, Any, Any]:
    """x, y, z and classes (or `None`) of a cloud written as text.

    Commas, semicolons, tabs or blanks separate; points are decimal. Lines that start with `#` or
    `//` may come first, the last of which may be the header.

    **Raises:** `InputError` with the row of a cell that is no number.
    """
    import pandas as pd

    lines = _head(path)
    start = next((k for k, line in enumerate(lines) if not re.match(r"\s*(#|//|$)", line)), None)
    if start is None:
        raise InputError("expected a point cloud as text, but it has no numbers", file=path)
    first = lines[start]
    separator = next((mark for mark in (";", "\t", ",") if mark in first), r"\s+")
    tokens = _split(first, separator)
    header, skip, header_row = None, start, start + 1
    if not all(_is_number(token) for token in tokens if token):
        if separator != "," and any(re.fullmatch(r"-?\d+,\d+", token) for token in tokens):
            raise InputError(
                "expected points in numbers, but these have decimal commas",
                file=path,
                row=start + 1,
            )
        header, skip = tokens, start + 1
    elif start and (comment := re.sub(r"^\s*(#|//)\s*", "", lines[start - 1])):
        named = _split(comment, separator)
        if len(named) == len(tokens) and {"x", "y", "z"} <= {_plain(n)[0] for n in named}:
            header, header_row = named, start
    if header is None and len(tokens) < 3:
        raise InputError(
            f"expected x, y and z in each row, but got {first.strip()[:40]!r}",
            file=path,
            row=start + 1,
        )
    places = (
        {"x": 0, "y": 1, "z": 2}
        if header is None
        else _columns(header, path, header_row, unit_stated)
    )
    try:
        table = pd.read_csv(
            path,
            sep=separator,
            header=None,
            skiprows=skip,
            usecols=sorted(places.values()),
            encoding="utf-8-sig",
            low_memory=False,
        )
    except (ValueError, UnicodeDecodeError) as error:  # pandas' parser errors are ValueErrors
        reason = " ".join(str(error).split())
        raise InputError(f"cannot be read as columns of numbers ({reason})", file=path) from error
    found = {}
    for name, place in places.items():
        values = pd.to_numeric(table[place], errors="coerce").to_numpy(np.float64)
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"expected a number, but got {str(table[place].iloc[row])!r}"
                f" ({int(bad.sum())} such rows)",
                file=path,
                row=row + skip + 1,
                column=name,
            )
        found[name] = values
    labels = found.get("classification")
    return found["x"], found["y"], found["z"], None if labels is None else labels.astype(np.uint8)
