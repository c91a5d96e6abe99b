"""Where on Earth a capture was taken, and its picture laid there."""

from dataclasses import dataclass, replace

import numpy as np
import pyproj

from fynjax.app.io.raster import Cube, utm_zone


@dataclass(frozen=True)
class CameraPlace:
    """Position and heading of a camera that looks straight down."""

    latitude: float
    """Latitude [degrees]."""
    longitude: float
    """Longitude [degrees]."""
    heading: float
    """Direction of the picture's upper edge, clockwise from true north [degrees]."""
    tilt_sd: float
    """Standard deviation of the camera's axis from the vertical [degrees]."""
    height: float | None = None
    """Height above the point of take-off [m]; `None` where it is not stated."""
    position_sd: float = 3.0
    """Standard deviation of the position [m]; that of a single receiver of satellites, an
    assumption, where the file states none."""

    def spread(self, height: float) -> float:
        """Standard deviation of where the picture's middle lies, from `height` [m] above it [m]."""
        return float(np.hypot(self.position_sd, height * np.tan(np.radians(self.tilt_sd))))


def is_fix(latitude: float, longitude: float) -> bool:
    """Whether a receiver knew where it was, in a UTM zone; without satellites it writes 0, 0."""
    return abs(latitude) <= 84.0 and abs(longitude) <= 180.0 and (latitude, longitude) != (0.0, 0.0)


def on_earth(cube: Cube, place: CameraPlace, middle: tuple[float, float]) -> Cube:
    """A picture turned to the north and laid where it was taken, in its UTM zone.

    **Arguments:**

    - `cube`: the picture as the camera saw it, its pixels in metres.
    - `place`: of the camera.
    - `middle`: column, and row from below, of the pixel that was straight below it.

    **Returns:** the `Cube` with its reference system. Each pixel is the nearest one of the picture,
    so that no values are mixed; NaN beyond its edges.
    """
    zone = utm_zone(place.longitude, place.latitude)
    projection = pyproj.Proj(zone)
    east, north = projection(place.longitude, place.latitude)
    convergence = projection.get_factors(place.longitude, place.latitude).meridian_convergence
    angle = np.radians(place.heading - convergence)
    c, s = np.cos(angle), np.sin(angle)
    rows, columns = cube.values.shape[1:]
    x, y = (np.array([(0, 0), (0, rows), (columns, 0), (columns, rows)]) - 0.5 - middle).T
    edges = [(np.floor(v.min()), np.ceil(v.max())) for v in (c * x + s * y, c * y - s * x)]
    to_east, to_north = np.meshgrid(*(np.arange(*edge) + 0.5 for edge in edges))
    column = np.rint(middle[0] + c * to_east - s * to_north).astype(int)
    row = np.rint(middle[1] + s * to_east + c * to_north).astype(int)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    values = cube.values[:, np.where(inside, row, 0), np.where(inside, column, 0)]
    (west, _), (south, _) = edges
    return replace(
        cube,
        values=np.where(inside, values, np.nan),
        origin_m=(east + west * cube.pixel_m, north + south * cube.pixel_m),
        crs=zone,
    )
