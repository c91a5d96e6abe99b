"""Where a plot lies on Earth: its corner and the reference system of the maps its file names."""

from dataclasses import dataclass

from fynjax.io.plot._plot import Plot
from fynjax.io.raster import open_raster


@dataclass(frozen=True)
class Place:
    """The frame of a plot's products."""

    origin_m: tuple[float, float] = (0.0, 0.0)
    """The plot's south-west corner (x, y) [m]."""
    crs: str | None = None
    """Coordinate reference system as WKT; `None`: the plot's own frame."""

    def corner(self, offset: tuple[float, float]) -> tuple[float, float]:
        """South-west corner of an image that lies `offset` east and north of the plot's [m]."""
        return self.origin_m[0] + offset[0], self.origin_m[1] + offset[1]


def plot_place(plot: Plot) -> Place:
    """Where a plot lies on Earth, by the first of its maps that does.

    The maps are ground heights, probability and ground covers, in this order.

    **Arguments:**

    - `plot`: as of `read_plot`.

    **Returns:** corner [m] and reference system; the plot's own frame where no map lies on Earth.

    **Raises:** `InputError` for a map that cannot be read.
    """
    maps = {
        "a raster of heights": plot.terrain,
        "a probability map": plot.probability_map,
        "a map of ground covers": plot.ground.map,
    }
    for what, path in maps.items():
        if path is None:
            continue
        with open_raster(path, what) as file:
            if file.crs is not None and file.on_earth:
                bounds = file.dataset.bounds
                west, south = plot.map_origin_m or (bounds.left, bounds.bottom)
                return Place((float(west), float(south)), file.crs.to_wkt())
    return Place()
