"""Metres and nothing else inside: what a file says of its units, and what its numbers betray."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import LARGEST, InputError
from fynjax.app.io.raster import UNITS

Bounds = tuple[float, float, float, float]
"""West, south, east and north edge of a plot, in the coordinates of its cloud or raster [m]."""

# A plot is no thinner than this, whether from photographs or laser [points m-2]: one in 5 m.
_THINNEST = 0.04
# A cloud narrower than this [m] is no plot; in degrees it would be 5 km.
_NARROWEST = 0.05
# Relief and plants over the diagonal of the cloud.
_STEEPEST = 2.0
# No ground above water is lower or higher [m].
_DEEPEST = -500.0
_TALLEST = 9000.0


def unit_factor(unit: str) -> float:
    """Metres in `unit`; `InputError` for another name."""
    if unit not in UNITS:
        raise InputError(f"`unit` must be one of {', '.join(UNITS)}, but is {unit!r}")
    return UNITS[unit]


def check_positive(name: str, value: float) -> None:
    """Check a setting.

    **Arguments:**

    - `name`: of the setting, for the error.
    - `value`: what it is.

    **Raises:** `InputError` unless the value is a positive number.
    """
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(f"`{name}` must be positive, but is {value:g}")


def check_coordinates(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    file: Path | None,
    *,
    unit_stated: bool,
) -> None:
    """Refuse points whose numbers cannot be metres, as far as numbers show it."""
    if len(x) < 3:
        raise InputError(f"expected a point cloud, but it has {len(x)} points", file=file)
    bad = ~np.all([np.abs(axis) < LARGEST for axis in (x, y, z)], axis=0)  # also NaN
    if bad.any():
        raise InputError(
            f"expected finite coordinates, but {int(bad.sum())} of {len(x)} points have NaN or "
            f"infinity, or numbers beyond {LARGEST:g}; the first is point "
            f"{int(np.argmax(bad)) + 1}",
            file=file,
        )
    wide, deep = float(np.ptp(x)), float(np.ptp(y))
    if wide == 0.0 or deep == 0.0:
        raise InputError(
            f"expected points over an area, but they extend {wide:g} by {deep:g} m. "
            "Are the columns in the order x, y, z?",
            file=file,
        )
    if max(wide, deep) < _NARROWEST and abs(x).max() <= 180.0 and abs(y).max() <= 90.0:
        raise InputError(
            f"expected coordinates in metres, but the cloud is {wide:.2g} by {deep:.2g} wide. "
            "Are they degrees of longitude and latitude? Reproject to a metric system first.",
            file=file,
        )
    density = len(x) / (wide * deep)
    if density < _THINNEST and not unit_stated:
        raise InputError(
            f"expected a cloud of a plot in metres, but {len(x)} points over {wide:.0f} by "
            f"{deep:.0f} m are {density:.2g} per m2. Are the coordinates in centimetres or "
            "millimetres? State the unit (metre, if it is).",
            file=file,
        )
    # Not the extremes: one bird must not decide the unit.
    low, high = np.percentile(z, [1.0, 99.0])
    if high - low > _STEEPEST * np.hypot(wide, deep):
        raise InputError(
            f"expected heights in metres, but they span {high - low:.0f} m over a cloud of "
            f"{wide:.0f} by {deep:.0f} m. Are heights in another unit than x and y? State the "
            "height unit.",
            file=file,
        )


def check_height_range(
    heights: NDArray[np.float64], file: Path | None, remedy: str, *, unit_known: bool
) -> None:
    """Refuse finite heights [m] of which some, or all where their unit is a guess, are of no place.

    `remedy` says what to do about a value that stands for missing data. Where all of them are too
    low or too high and the unit is known, the level that they count from is another than the sea:
    that is a warning.
    """
    low, high = float(heights.min()), float(heights.max())
    if low >= _DEEPEST and high <= _TALLEST:
        return
    middle = float(np.median(heights))
    if _DEEPEST <= middle <= _TALLEST:
        value = low if low < _DEEPEST else high
        raise InputError(
            f"expected heights in metres, but got {value:g} among heights of about {middle:.0f}. "
            f"Does it stand for missing data? {remedy}",
            file=file,
        )
    if not unit_known:
        raise InputError(
            f"expected heights in metres, but got {middle:g} in the middle. Are they in "
            "centimetres or feet, or above another level than the sea? State `height_unit` "
            "(metre, if it is).",
            file=file,
        )
    warnings.warn(
        f"{file.name if file is not None else 'the ground'} lies at {middle:.0f} m, which is no "
        "height above the sea. Shapes are kept, but check the file where its level matters.",
        stacklevel=3,
    )


def check_bounds(bounds: Bounds) -> Bounds:
    """Check the edges of a plot.

    **Arguments:**

    - `bounds`: west, south, east and north edge [m].

    **Returns:** the same four numbers.

    **Raises:** `InputError` for numbers that are no rectangle.
    """
    values = tuple(float(value) for value in bounds)
    if len(values) != 4 or not np.all(np.isfinite(values)):
        raise InputError(f"`bounds` must be (west, south, east, north) [m], but are {bounds}")
    west, south, east, north = values
    if west >= east or south >= north:
        raise InputError(
            f"`bounds` must be (west, south, east, north) [m] with west < east and south < north, "
            f"but are {values}"
        )
    return west, south, east, north


def check_inside(
    plot: Bounds, bounds: Bounds, slack: float, what: str, file: Path | None = None
) -> Bounds:
    """`plot`, if it lies within `bounds` or beyond them by up to `slack` [m]; else an `InputError`
    that says what `what` covers."""
    west, south, east, north = check_bounds(plot)
    w, s, e, n = bounds
    if west < w - slack or south < s - slack or east > e + slack or north > n + slack:
        raise InputError(
            f"{what} covers ({w:.2f}, {s:.2f}) to ({e:.2f}, {n:.2f}), but the plot is "
            f"({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}). Choose a smaller plot. Are "
            "both in the same coordinate reference system?",
            file=file,
        )
    return west, south, east, north
