"""Where a plot lies on Earth: its corner and the reference system of the maps its file names."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rasterio.warp import transform

from fynjax._core.errors import InputError
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

    **Arguments:** `plot`: as of `read_plot`.

    **Returns:** corner [m] and reference system; the plot's own frame where no map lies on Earth.

    **Raises:** `InputError` for a map that cannot be read.
    """
    for what, path in plot.maps.items():
        with open_raster(path, what) as file:
            if file.crs is not None and file.on_earth:
                bounds = file.dataset.bounds
                west, south = plot.map_origin_m or (bounds.left, bounds.bottom)
                return Place((float(west), float(south)), file.crs.to_wkt())
    return Place()


def placed_by(plot: Plot, maps: Iterable[Path]) -> Plot:
    """The plot with the latitude and longitude of the first of some rasters that lies on Earth.

    Whether plants are those of fynbos depends on it (`Plot.shrubland`).

    **Arguments:**

    - `plot`: as `read_plot` gives it; one whose place is known comes back as it is.
    - `maps`: rasters. Those that cannot be read are left to who reads them.
    """
    for path in maps if plot.place_deg is None else ():
        with suppress(InputError), open_raster(path, "a map") as file:
            if file.crs is not None and file.on_earth:
                west, south, east, north = file.dataset.bounds
                x, y = [0.5 * (west + east)], [0.5 * (south + north)]
                (longitude,), (latitude,) = transform(file.crs, "EPSG:4326", x, y)[:2]
                return plot.replace(place_deg=(float(latitude), float(longitude)))
    return plot
