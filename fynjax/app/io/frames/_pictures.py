"""Pictures whose own metadata say where they were taken: DJI and MicaSense."""

from pathlib import Path

import numpy as np
import pyproj

from fynjax.app.io.captures import read_view
from fynjax.app.io.frames._shot import Shot

SUFFIXES = (".tif", ".tiff", ".jpg", ".jpeg", ".dng")


def picture_shots(paths: list[Path], *, above_ground: bool) -> list[Shot]:
    """Shots of pictures; `above_ground`: heights are above the point of take-off, which is taken
    for the plot's ground."""
    shots = []
    for path in paths:
        view = read_view(path, above_takeoff=above_ground)
        position = np.array([view.longitude, view.latitude, view.height])
        system = pyproj.CRS.from_epsg(4326)
        shots.append(Shot(path.name, position, view.axes, view.lens, system, above_ground))
    return shots
