"""Where a plot lies on Earth: its corner and the reference system of the maps its file names."""

import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pyproj import Geod
from rasterio.warp import transform

from fynjax._core.errors import InputError
from fynjax.app.io.frames import grid_north
from fynjax.app.io.plot._plot import Plot
from fynjax.app.io.raster import RasterFile, open_raster


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
    """The plot with the latitude and longitude of the first of some rasters that lies on Earth, and
    with its north.

    Whether plants are those of fynbos depends on the place (`Plot.shrubland`), and from which
    north the azimuth of the sun counts where place and time give it, on the raster's grid.

    **Arguments:**

    - `plot`: as `read_plot` gives it; what is known of its place and north stays.
    - `maps`: rasters. Those that cannot be read are left to who reads them.

    Warns where a raster lies more than 100 km from the plot, and of plants that are stated as
    fynbos outside the Cape.
    """
    for path in maps:
        place, turn = None, 0.0
        with suppress(InputError), open_raster(path, "a map") as file:
            place = raster_place(file)
            if place is not None:
                assert file.crs is not None
                turn = grid_north(file.crs.to_wkt(), *place[::-1])
        if place is None:
            continue
        if plot.grid_north_deg is None:
            own = plot.sun == plot.sun_table.position()  # and not one that was put in its place
            sun = plot.sun_table.position(turn) if own else plot.sun
            plot = plot.replace(grid_north_deg=turn, sun=sun)
        if plot.place_deg is None:
            plot = plot.replace(place_deg=place)
        elif (apart := _distance_km(plot.place_deg, place)) > _FAR_KM:
            stated, lies = (f"{north:.2f}, {east:.2f}" for north, east in (plot.place_deg, place))
            warnings.warn(
                f"{path.name} lies at {lies} (latitude, longitude), {apart:.0f} km from the plot "
                f"of {plot.file.name} at {stated}. Is it of this plot?",
                stacklevel=2,
            )
        break
    if plot.plants == "fynbos" and plot.place_deg is not None and not plot.in_the_cape:
        north, east = plot.place_deg
        warnings.warn(
            f'{plot.file.name} has plants = "fynbos", but lies outside the Cape, at {north:.2f}, '
            f'{east:.2f} (latitude, longitude): write plants = "generic", or leave it out.',
            stacklevel=2,
        )
    return plot


def raster_place(file: RasterFile) -> tuple[float, float] | None:
    """Latitude and longitude [degree] of the middle of a raster; `None` where it lies nowhere on
    Earth.

    **Arguments:** `file`, open.
    """
    if file.crs is None or not file.on_earth:
        return None
    rows, columns = file.shape
    x, y = file.dataset.transform @ (0.5 * columns, 0.5 * rows)
    (longitude,), (latitude,) = transform(file.crs, "EPSG:4326", [x], [y])[:2]
    return float(latitude), float(longitude)


_FAR_KM = 100.0


def _distance_km(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Distance of two places, of latitude and longitude, on the ellipsoid [km]."""
    _, _, metres = Geod(ellps="WGS84").inv(*a[::-1], *b[::-1])
    return float(metres) / 1000.0
