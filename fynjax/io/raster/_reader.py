"""Rasters that lie on the ground: opened, and checked for north, metres and a place."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyproj
import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from fynjax._core.errors import InputError
from fynjax.io.raster._checks import check_north_up
from fynjax.io.text import existing_file

METRES = ("m", "metre", "metres", "meter", "meters")
"""What a raster may call the unit of its heights."""


@contextmanager
def open_raster(path: str | Path, what: str) -> Iterator[Any]:
    """A raster open for reading; what GDAL cannot read is an `InputError`.

    `what` names the file in errors, such as "a probability map".
    """
    path = existing_file(path, what)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                yield file
    except RasterioError as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise InputError(
            f"cannot be read as {what} ({reason}). Is it cut short, or not a GeoTIFF? Copy it "
            "again.",
            file=path,
        ) from error


def has_place(file: Any) -> bool:
    """Whether an open raster has a coordinate reference system and a place in it."""
    return file.crs is not None and not file.transform.is_identity


def is_local(crs: Any) -> bool:
    """Whether a system is a frame of a plot's own, without a place on Earth."""
    return not (crs.is_projected or crs.is_geographic)


def check_frame(file: Any, path: Path) -> None:
    """Refuse an open raster that is not north up, in metres and in a place.

    **Raises:** `InputError` without a coordinate reference system or a place, in degrees or feet,
    and for a raster that is rotated or upside down.
    """
    crs = file.crs
    if not has_place(file):
        raise InputError(
            "expected a raster with a coordinate reference system and a place, but it has "
            f"{'no system' if crs is None else 'no place'}. Give it one: "
            f"gdal_edit.py -a_srs EPSG:... -a_ullr WEST NORTH EAST SOUTH {path.name}",
            file=path,
        )
    unit, factor = crs.units_factor
    if crs.is_geographic or abs(factor - 1.0) > 1e-9:
        raise InputError(
            f"expected coordinates in metres, but they are in units of {unit}. Reproject to a "
            f"metric system first, such as the plot's UTM zone: gdalwarp -t_srs EPSG:... "
            f"{path.name} metric.tif",
            file=path,
        )
    axes = [axis.direction for axis in pyproj.CRS.from_wkt(crs.to_wkt()).axis_info]
    if not is_local(crs) and {"west", "south"} & set(axes):
        raise InputError(
            f"expected a system whose coordinates grow to the east and north, but those of this "
            f"one grow to the {' and '.join(axes)}. Reproject first, such as to the plot's UTM "
            f"zone: gdalwarp -t_srs EPSG:... {path.name} utm.tif",
            file=path,
        )
    check_north_up(file.transform, path, "a raster")
