"""A camera as an export states it, in that file's own frame of reference; and as a plot has it."""

import functools
from dataclasses import dataclass

import numpy as np
import pyproj
from jaxtyping import Float

from fynjax._core.errors import LARGEST, InputError, listed, refusing
from fynjax.app.io.text import stated_number
from fynjax.sensors import Frame, Lens, pose_of_axes


@dataclass(frozen=True)
class Shot:
    """One picture, in the coordinates of its file."""

    name: str
    position: Float[np.ndarray, " 3"]
    """East, north and height in `crs` [m], or longitude, latitude [degrees] and height [m]."""
    axes: Float[np.ndarray, "3 3"]
    """Unit vectors (east, north, up) of the picture's right and lower edge and of the optical axis,
    one a row; of a projected system along its grid, else from true north."""
    lens: Lens | None
    crs: pyproj.CRS | None
    """None: no system is stated."""
    above_ground: bool = False
    """Whether the height counts from the ground, by what the camera itself says."""


def placed(
    shots: list[Shot], crs: pyproj.CRS | None, origin: tuple[float, float], ground: float | None
) -> list[Frame]:
    """Shots in the coordinates of a plot with its corner at `origin` in `crs` and its ground at a
    height of `ground` [m].

    Raises `InputError` for none, two of one name, numbers that cannot be, and where a system or a
    height is not known.
    """
    names = [shot.name for shot in shots]
    if not names:
        raise InputError("expected frames with a position and an attitude, but there are none")
    if len(set(names)) < len(names):
        twice = {name for name in names if names.count(name) > 1}
        raise InputError(f"expected one pose of each frame, but there are more of {listed(twice)}")
    return [_placed(shot, crs, origin, ground) for shot in shots]


def _placed(
    shot: Shot, crs: pyproj.CRS | None, origin: tuple[float, float], ground: float | None
) -> Frame:
    if not (np.abs(shot.position) < LARGEST).all():
        raise InputError(f"expected a position of {shot.name} in numbers, but got {shot.position}")
    x, y, height = (float(v) for v in shot.position)
    turn, scale = 0.0, 1.0
    if shot.crs is not None and crs is not None and not _same(shot.crs, crs):
        degrees = between(shot.crs, _DEGREES).transform(x, y)
        (own, unit), (turned, longer) = (_grid(one, *degrees) for one in (shot.crs, crs))
        turn, scale = turned - own, longer / unit
        x, y = between(shot.crs, crs).transform(x, y)
    elif shot.crs is not None and shot.crs.is_geographic:
        raise InputError(
            "expected the reference system of the plot, since the frames are in longitude and "
            'latitude: state `crs`, such as "EPSG:32734"'
        )
    if not np.isfinite([x, y]).all():
        raise InputError(f"expected {shot.name} near the plot, but its position is not on its map")
    if shot.above_ground:
        ground = 0.0
    if ground is None:
        raise InputError(
            "expected `ground`, the height of the plot's ground [m] in the system that the frames' "
            f"heights are in: {shot.name} is at {height:.2f} m there"
        )
    # Grid north is another than true north, and a grid's metres are longer or shorter: heights are
    # stretched as they are, so that angles stay.
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    axes = shot.axes @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    position = np.array([x - origin[0], y - origin[1], (height - ground) * scale])
    try:
        return Frame(pose_of_axes(position, axes), shot.lens, shot.name)
    except InputError as error:
        raise InputError(f"the attitude of {shot.name}: {error.message}") from error


@functools.cache
def between(here: pyproj.CRS, there: pyproj.CRS) -> pyproj.Transformer:
    """What takes easting and northing, or longitude and latitude, from a system to another. Raises
    `InputError` where nothing does."""
    name = here.name[:60]
    words = f"expected frames in a system on Earth, but {name!r} cannot be used ({{error}})"
    with refusing(pyproj.exceptions.ProjError, words=words):
        return pyproj.Transformer.from_crs(here, there, always_xy=True)


_same = functools.cache(pyproj.CRS.__eq__)
_projection = functools.cache(pyproj.Proj)
_DEGREES = pyproj.CRS.from_epsg(4326)


def grid_north(crs: str, longitude: float, latitude: float) -> float:
    """Direction of a system's grid north, clockwise from true north [degrees]: its meridian
    convergence.

    **Arguments:** `crs`, projected; `longitude`, `latitude` of the place [degrees].
    """
    return _grid(pyproj.CRS.from_user_input(crs), longitude, latitude)[0]


def _grid(crs: pyproj.CRS, longitude: float, latitude: float) -> tuple[float, float]:
    """Meridian convergence of a system's grid [degrees], and the length of its metre [-]."""
    if not crs.is_projected:
        return 0.0, 1.0
    try:
        factors = _projection(crs).get_factors(longitude, latitude, errcheck=True)
    except pyproj.exceptions.ProjError as error:
        raise InputError(
            f"expected frames on the map of the plot, but {longitude:.4f}, {latitude:.4f} degrees "
            "is not"
        ) from error
    return factors.meridian_convergence, factors.meridional_scale


def finite(values: object, count: int, what: str) -> Float[np.ndarray, " value"]:
    """`count` numbers. Raises `InputError`, naming `what` they are, for anything else."""
    try:
        numbers = np.array([stated_number(one) for one in np.ravel(np.asarray(values))])
    except (TypeError, ValueError):
        numbers = np.array([])
    if numbers.size != count or not (np.abs(numbers) < LARGEST).all():
        kind = "a number" if count == 1 else f"{count} numbers"
        came = " ".join(map(str, values)) if isinstance(values, list) else str(values)
        raise InputError(f"expected {kind} as {what}, but got {came[:60]!r}")
    return numbers
