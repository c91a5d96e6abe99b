"""Pictures whose own metadata say where they were taken: DJI and MicaSense."""

import warnings
from pathlib import Path

import numpy as np
import pyproj

from fynjax._core.errors import InputError
from fynjax.app.io.captures import read_view
from fynjax.app.io.frames._shot import Shot

SUFFIXES = (".tif", ".tiff", ".jpg", ".jpeg", ".dng")


def picture_shots(paths: list[Path], *, above_ground: bool) -> list[Shot]:
    """Shots of pictures; `above_ground`: heights are above the point of take-off, which is taken
    for the plot's ground. Warns of pictures that do not say where they were taken; `InputError`
    where none does."""
    shots, skipped = [], list[InputError]()
    for path in paths:
        try:
            view = read_view(path, above_takeoff=above_ground)
        except InputError as error:
            skipped.append(error)
            continue
        position = np.array([view.longitude, view.latitude, view.height])
        system = pyproj.CRS.from_epsg(4326)
        shots.append(Shot(path.name, position, view.axes, view.lens, system, above_ground))
    if skipped and not shots:
        raise skipped[0]
    for left_out in skipped:
        warnings.warn(f"left out: {left_out}", stacklevel=2)
    return shots
