"""Found crowns as a GeoPackage that any GIS opens."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fynjax._core.extras import require
from fynjax.app.io.plot._place import Place
from fynjax.app.io.text import atomic_path

if TYPE_CHECKING:
    import pandas as pd

_CORNERS = 16
"""Corners in a quarter of the outline of a crown."""


def write_crowns(path: Path, crowns: "pd.DataFrame", place: Place) -> None:
    """Write crowns as polygons, discs of their diameters, whole or not at all.

    **Arguments:**

    - `path`: the GeoPackage.
    - `crowns`: as of `FoundPlants.crowns`; every column becomes a field.
    - `place`: of the plot. Without a place on Earth coordinates are metres from its south-west
      corner.

    The file is one that `crowns` of a plot file takes: diameters and heights are there by name.

    **Raises:** `MissingExtraError` without the packages of the extra `tables`.
    """
    pyogrio = require("pyogrio", "tables")
    shapely = require("shapely", "tables")
    x, y = place.origin_m
    feet = shapely.points(crowns["x_m"].to_numpy() + x, crowns["y_m"].to_numpy() + y)
    radius = 0.005 * crowns["diameter_cm"].to_numpy()
    shapes = shapely.buffer(feet, radius, quad_segs=_CORNERS)
    fields = [c for c in crowns.columns if c not in ("x_m", "y_m")]
    with atomic_path(path) as partial, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that there is no system, without a place
        pyogrio.raw.write(
            partial, shapely.to_wkb(shapes), [crowns[c].to_numpy() for c in fields],
            np.array(fields), geometry_type="Polygon", crs=place.crs, layer="crowns",
            driver="GPKG",
        )  # fmt: skip
