"""Coordinate reference systems: those whose coordinates are metres to the east and north."""

import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import rasterio
from rasterio import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from fynjax._core.errors import InputError, listed
from fynjax.app.io.text import stated_number

UNITS: dict[str, float] = {
    "metre": 1.0,
    "centimetre": 0.01,
    "millimetre": 0.001,
    "foot": 0.3048,
    "us_survey_foot": 1200.0 / 3937.0,
    "inch": 0.0254,
}
"""Metres in each unit that coordinates may be stated in."""


_LONGEST = 1 << 16
"""Characters of a coordinate reference system; WKT of one takes some two thousand."""


def parse_crs(text: str | int, file: Path | None = None) -> CRS:
    """A coordinate reference system from text.

    **Arguments:** `text`: WKT, "EPSG:32734" or an EPSG number; `file`: that states it, for errors.

    **Raises:** `InputError` for a system that is not known.
    """
    try:
        if len(str(text)) > _LONGEST:
            raise ValueError
        with rasterio.Env():  # GDAL's own words go to the log
            system = CRS.from_user_input(text)
            system.to_wkt()  # GDAL takes some damaged texts that it cannot write
        return system
    except (CRSError, RecursionError, ValueError) as error:  # the text may be JSON too
        raise InputError(
            f"expected a coordinate reference system such as EPSG:32734, but got "
            f"{str(text)[:60]!r}, which is not known",
            file=file,
        ) from error


def is_local(crs: CRS) -> bool:
    """Whether a system is a frame of a plot's own, without a place on Earth."""
    return not (crs.is_projected or crs.is_geographic)


def unit_of_length(factor: float) -> str:
    """Name of a unit of `factor` [m]."""
    near = min(UNITS, key=lambda name: abs(UNITS[name] / factor - 1.0))
    return near if abs(UNITS[near] / factor - 1.0) < 1e-7 else f"units of {factor:g} m"


def check_metric(crs: CRS, *, unit_stated: bool | None = None, height_stated: bool = False) -> None:
    """Refuse a system whose coordinates are not metres to the east and north.

    **Arguments:**

    - `crs`: the system.
    - `unit_stated`, `height_stated`: the user has stated the unit of coordinates or of heights, so
      that the system need not be in metres; `None` where the user cannot.

    **Raises:** `InputError` for degrees, feet and other units, and geocentric coordinates.
    """
    wkt = crs.to_wkt()
    remedy = "Reproject to a metric system first, such as the plot's UTM zone."
    if crs.is_geographic:
        raise InputError(
            "expected coordinates in metres, but they are in degrees (longitude, latitude). "
            + remedy
        )
    if wkt.startswith(("GEOCCS", "GEODCRS")):
        raise InputError(
            "expected x east, y north and z up, but the file's coordinates are geocentric (from "
            f"the middle of the Earth). {remedy}"
        )
    factor = crs.units_factor[1]
    if abs(factor - 1.0) > 1e-9 and not unit_stated:
        raise InputError(
            "expected coordinates in metres, but the file's system is in "
            f"{unit_of_length(factor)}. "
            + (remedy if unit_stated is None else f"{remedy[:-1]}, or state the unit.")
        )
    try:
        axes = pyproj.CRS.from_wkt(wkt).axis_info
    except pyproj.exceptions.CRSError as error:
        raise InputError(
            f"its coordinate reference system is damaged ({' '.join(str(error).split())}). State "
            "it anew: gdal_edit.py -a_srs EPSG:..."
        ) from error
    directions = [axis.direction for axis in axes]
    if not is_local(crs) and {"west", "south"} & set(directions):
        raise InputError(
            "expected a system whose coordinates grow to the east and north, but those of this "
            f"one grow to the {' and '.join(directions)}. {remedy}"
        )
    for axis in axes:  # those of a compound system have heights too
        factor = axis.unit_conversion_factor
        if axis.direction in ("up", "down") and abs(factor - 1.0) > 1e-9 and not height_stated:
            raise InputError(
                f"expected heights in metres, but the file's system has them in "
                f"{unit_of_length(factor)}. State the height unit ({unit_of_length(factor)})."
            )


def utm_zone(longitude: float, latitude: float) -> str:
    """The UTM zone at `longitude` and `latitude` [degrees], such as "EPSG:32734"."""
    number = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0.0 else 32700) + number}"


def stretch(crs: CRS, x: float, y: float) -> tuple[float, str]:
    """How many times as long as on the ground lengths are in a system of projected coordinates.

    **Arguments:** `crs`; `x`, `y`: a place in it.

    **Returns:** the factor, 1 below a difference of 1 %, and the UTM zone of the place.
    """
    if not crs.is_projected:
        return 1.0, ""
    try:
        # Coordinates of a `Proj` are in the units of its system.
        projection = pyproj.Proj(pyproj.CRS.from_wkt(crs.to_wkt()))
        longitude, latitude = projection(x, y, inverse=True, errcheck=True)
        areal = projection.get_factors(longitude, latitude, errcheck=True).areal_scale
    except (pyproj.exceptions.ProjError, pyproj.exceptions.CRSError):
        return 1.0, ""
    factor = float(np.sqrt(areal))
    if not np.isfinite([factor, longitude, latitude]).all():  # a place that is none
        return 1.0, ""
    zone = utm_zone(longitude, latitude)
    return (factor if abs(factor - 1.0) > 0.01 else 1.0), zone


def check_in_area(crs: CRS, x: float, y: float) -> None:
    """Refuse a place outside the area of its projected system, where in kilometres it is inside.

    **Arguments:** `crs`; `x`, `y`: a place in it.

    **Raises:** `InputError` that says so.
    """
    with suppress(pyproj.exceptions.ProjError, pyproj.exceptions.CRSError):
        code = crs.to_epsg() if crs.is_projected else None
        if code is None:
            return
        system = pyproj.CRS.from_epsg(code)
        if (area := system.area_of_use) is None:
            return
        for factor in (1.0, 1000.0):
            there = pyproj.Proj(system)(factor * x, factor * y, inverse=True, errcheck=True)
            degrees = (area.west - 5.0, area.south - 5.0, area.east + 5.0, area.north + 5.0)
            if degrees[0] < there[0] < degrees[2] and degrees[1] < there[1] < degrees[3]:
                break
        else:
            return
        if factor != 1.0:
            raise InputError(
                f"expected coordinates in metres, but ({x:g}, {y:g}) is outside the area of "
                f"{system.name}. Are they in kilometres? State it: units = 'km' of x and y"
            )


def check_lengths(crs: CRS, x: float, y: float, remedy: str) -> None:
    """Refuse a system in which lengths are not those on the ground.

    **Arguments:** `crs`; `x`, `y`: a place in it; `remedy`: what to do, with "{zone}" for the UTM
    zone of the place.

    **Raises:** `InputError` for a difference of more than 1 %.
    """
    longer, zone = stretch(crs, x, y)
    if longer != 1.0:
        raise InputError(
            f"expected coordinates in metres of the ground, but in its system lengths are "
            f"{longer:.3g} times as long here, as in maps for the web. {remedy.format(zone=zone)}"
        )


def geotransform(numbers: Any, name: str) -> Affine:
    """The affine transform of GDAL's six numbers, as text or an array; the identity of none.

    **Raises:** `InputError` for other than six finite numbers, and a grid that has no area; `name`
    is what the file calls them.
    """
    if numbers is None or (isinstance(numbers, str) and not numbers.strip()):
        return Affine.identity()
    text = re.split(r"[\s,]+", numbers.strip()) if isinstance(numbers, str) else np.ravel(numbers)
    try:
        transform = Affine.from_gdal(*(stated_number(number) for number in text))
        sound = np.isfinite(transform.to_gdal()).all() and transform.determinant != 0.0
    except (TypeError, ValueError):
        sound = False
    if not sound:
        raise InputError(
            f"expected as {name} six numbers that place a grid, but got "
            f"{listed(str(number) for number in text)}"
        )
    return transform
