"""Point clouds as text: XYZ, CSV and their like."""

from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError, listed
from fynjax._core.tables import name_and_unit, open_points, places_of
from fynjax.terrain._cloud import PointCloud

_NAMES = {
    "x": ("x", "easting", "east", "e"),
    "y": ("y", "northing", "north", "n"),
    "z": ("z", "height", "elevation", "elev", "altitude", "alt", "h"),
    "classification": ("classification", "class", "scalar_classification", "label"),
}
_DEGREES = ("lon", "longitude", "lat", "latitude", "long")


def _columns(names: tuple[str, ...], path: Path, row: int, unit_stated: bool) -> dict[str, int]:
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


def read_text_cloud(path: Path, *, unit_stated: bool) -> PointCloud:
    """Points of a cloud written as text, as `open_points` takes it, in its unit.

    **Raises:** `InputError` with the row of a cell that is no number.
    """
    table = open_points(path, "a point cloud", "xyz")
    if not table.headed:
        table.names = (*"xyz", *table.names[3:])
    places = _columns(table.names, path, table.row, unit_stated)
    columns = table.columns(list(places.values())).to_numpy()
    x, y, z, *classes = columns.T
    return PointCloud(x, y, z, classes[0].astype(np.uint8) if classes else None)
