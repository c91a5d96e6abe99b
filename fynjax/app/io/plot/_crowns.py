"""Plants that are known: a table of crowns, or a GeoPackage."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError, names_file
from fynjax._core.extras import require
from fynjax._core.memory import bounded_memory
from fynjax._core.validation import checked_row
from fynjax.app.io.plot._place import plot_place
from fynjax.app.io.plot._plot import Plot
from fynjax.app.io.plot._rows import CrownRow
from fynjax.app.io.plot._sensor import sensor_place
from fynjax.app.io.raster import check_metric, parse_crs
from fynjax.app.io.text import check_geopackage, existing_file, read_rows
from fynjax.scene import Crowns, Instances, check_taxa, projected_cover

_WHAT = "a table of crowns"
_MOST_COVER = 100
"""Times that crowns may cover a plot; ten are much, and each is laid over its cells."""


@names_file
def with_crowns(plot: Plot, path: Path) -> Plot:
    """A plot whose plants are those of a file of crowns.

    **Arguments:**

    - `plot`: with the species table, which gives the traits of each taxon.
    - `path`: a CSV table of `CrownRow`, or a GeoPackage of points or polygons with the columns
      taxon, height_m and diameter_cm. Polygons may leave out the last: it is then that of a circle
      of their area. Coordinates of a GeoPackage are those of the plot's maps if it has a reference
      system, else metres from the plot's south-west corner.

    **Returns:** the plot with `known_crowns`, and with the cover, the mean diameter and the
    greatest height of each species that follow from them; species without crowns have a cover of 0.

    **Raises:** `InputError` with file, row (of a GeoPackage the number of the feature) and column
    for a crown of another taxon, outside the plot, of no size, or that is there twice; for map
    coordinates of a plot that lies nowhere; `MissingExtraError` for a GeoPackage without the
    packages to read it.
    """
    path = existing_file(path, _WHAT)
    geopackage = path.suffix.lower() == ".gpkg"
    rows = _read_geopackage(path, plot) if geopackage else read_rows(path, CrownRow, _WHAT)
    check_taxa(rows, plot.taxa, path)
    corner: tuple[float, float] | None = None
    altitude, _ = sensor_place(plot)
    places: dict[tuple[str, float, float], int] = {}
    for number, row in rows:
        if row.x_m is None or row.y_m is None:
            corner = _corner(plot) if corner is None else corner
            assert row.easting_m is not None  # the record has one of the two places
            assert row.northing_m is not None
            place = (row.easting_m - corner[0], row.northing_m - corner[1])
            columns = ("easting_m", "northing_m")
        else:
            place, columns = (row.x_m, row.y_m), ("x_m", "y_m")
        for at, side, column in zip(place, plot.size_m, columns, strict=True):
            if not 0.0 <= at < side:
                raise InputError(
                    f"expected a foot in the plot, 0 to below {side:g} m from its south-west "
                    f"corner, but this is at {at:g} m"
                    + (". Map coordinates? Call them easting_m and northing_m." * (at > 1e4)),
                    row=number,
                    column=None if geopackage else column,
                )
        if 0.01 * row.diameter_cm > min(plot.size_m):
            raise InputError(
                f"expected a crown smaller than the plot ({min(plot.size_m):g} m), but got "
                f"{row.diameter_cm:g} cm",
                row=number,
                column="diameter_cm",
            )
        if row.height_m >= altitude:
            raise InputError(
                f"expected a plant below the sensor at {altitude:g} m, but got {row.height_m:g} m",
                row=number,
                column="height_m",
            )
        first = places.setdefault((row.taxon, *place), number)
        if first != number:
            raise InputError(f"{row.taxon!r} stands here in row {first} already", row=number)
    times = sum(np.pi / 4.0 * (0.01 * row.diameter_cm) ** 2 for _, row in rows)
    if (times := times / float(np.prod(plot.size_m))) > _MOST_COVER:
        raise InputError(
            f"expected crowns that cover the plot at most {_MOST_COVER} times over each other, but "
            f"these do so {times:.0f} times. Are diameters in centimetres?"
        )
    crowns = Crowns(
        species=np.array([plot.taxa.index(row.taxon) for _, row in rows]),
        foot=np.array([(x, y) for _, x, y in places]),
        diameter=np.array([0.01 * row.diameter_cm for _, row in rows]),
        height=np.array([row.height_m for _, row in rows]),
    )
    return _with_sizes(plot, crowns, path)


def _with_sizes(plot: Plot, crowns: Crowns, path: Path) -> Plot:
    """The plot with `crowns`, and the covers and sizes that follow from them."""
    projected = np.zeros(len(plot.species))
    if plot.cover_definition == "projected":
        none = np.zeros(len(crowns.species))
        x, y = crowns.foot.T
        plants = Instances(
            plot.taxa, plot.size_m, crowns.species, x, y, none, none, none,
            crowns.diameter, crowns.height,
        )  # fmt: skip
        columns = np.prod(plot.size_m) / plot.voxel_m**2
        # Cells of a centimetre, or larger ones of a large plot, whose crowns are many.
        times = max(1, min(round(plot.voxel_m / 0.01), int(np.sqrt(3e7 / columns))))
        projected = projected_cover(
            plants, cell=plot.voxel_m / times, periodic=plot.boundary == "periodic"
        ).species
    species, bare = list(plot.species), []
    differ = np.zeros(3)
    for i, stated in enumerate(plot.species):
        mine = crowns.species == i
        if not mine.any():
            bare.append(stated.taxon)
            species[i] = stated.replace(cover=0.0)
            continue
        mean, greatest = crowns.sizes(i)
        if plot.cover_definition == "projected":
            share = float(projected[i])
        else:
            disc = np.pi / 4.0 * mean**2 * (1.0 - stated.packing) * stated.fill
            share = min(1.0, float(mine.sum() * disc / np.prod(plot.size_m)))
        species[i] = stated.replace(cover=share, diameter=mean, height=greatest)
        change = (
            abs(share - stated.cover),
            abs(mean / stated.diameter - 1.0),
            abs(greatest / stated.height - 1.0),
        )
        differ = np.maximum(differ, change)
    cover, diameter, height = (f"{100 * change:.0f}" for change in differ)
    note = (
        f"{len(crowns.species)} crowns of {path.name} give cover, mean diameter and greatest "
        f"height of the species, which differ from the species table's by up to {cover} "
        f"percentage points, {diameter} and {height} %."
    )
    if bare:
        note += f" Without crowns, and so without plants: {', '.join(bare)}."
    return plot.replace(species=tuple(species), known_crowns=crowns, crowns_note=note)


def _corner(plot: Plot) -> tuple[float, float]:
    """The plot's south-west corner in the coordinates of its maps [m]."""
    if plot.map_origin_m is not None:
        return plot.map_origin_m
    place = plot_place(plot)
    if place.crs is None:
        raise InputError(
            "expected x_m and y_m from the plot's south-west corner, but got map coordinates, and "
            "none of the plot's maps says where it lies. Say so: map_origin_m of the plot file is "
            "that corner in these coordinates."
        )
    return place.origin_m


def _read_geopackage(path: Path, plot: Plot) -> list[tuple[int, CrownRow]]:
    """Crowns of the only layer of a GeoPackage, each with the number of its feature."""
    pyogrio = require("pyogrio", "tables")
    shapely = require("shapely", "tables")
    with path.open("rb") as file:
        # Others name files or addresses, which GDAL would follow whatever the file is called.
        if not file.read(16) == b"SQLite format 3\0":
            raise InputError("expected a GeoPackage, but it is none. Save it as one.")
    path = path.absolute()
    check_geopackage(path)
    try:
        layers = pyogrio.list_layers(path)
        if len(layers) != 1:
            raise InputError(f"expected one layer of crowns, but it has {len(layers)}")
        with warnings.catch_warnings(), bounded_memory(path):
            warnings.simplefilter("ignore")  # of what other programs wrote into it
            meta, numbers, shapes, columns = pyogrio.raw.read(path, return_fids=True)
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        why = str(error).split(";")[0].rstrip(".")  # what follows are drivers to try
        raise InputError(f"expected a GeoPackage, but it cannot be read: {why}") from error
    if shapes is None or not len(shapes):
        raise InputError("expected a layer of points or polygons, but it has none")
    on_map = _on_map(meta["crs"], plot)
    known = ("taxon", "diameter_cm", "height_m")
    fields = {name: values for name, values in zip(meta["fields"], columns) if name in known}
    rows: list[tuple[int, CrownRow]] = []
    for i, (number, shape) in enumerate(zip(numbers, shapely.from_wkb(shapes), strict=True)):
        if shape is None or shape.is_empty:
            raise InputError("expected a point or polygon, but it has none", row=number)
        given: dict[str, Any] = {name: values[i] for name, values in fields.items()}
        given = {name: value for name, value in given.items() if value is not None}
        if shape.area > 0.0:
            given.setdefault("diameter_cm", 200.0 * float(np.sqrt(shape.area / np.pi)))
        middle = shape.centroid
        names = ("easting_m", "northing_m") if on_map else ("x_m", "y_m")
        given |= dict(zip(names, (middle.x, middle.y)))
        rows.append((int(number), checked_row(CrownRow, given, row=int(number))))
    return rows


def _on_map(stated: str | None, plot: Plot) -> bool:
    """Whether coordinates with this reference system are those of the plot's maps."""
    crs = None if stated is None else parse_crs(stated)
    if crs is None or not (crs.is_projected or crs.is_geographic):
        return False
    check_metric(crs)
    place = plot_place(plot)
    if place.crs is not None and parse_crs(place.crs) != crs:
        raise InputError(
            "expected the reference system of the plot's maps, but it has another "
            f"({crs.to_string():.60}). Reproject the layer."
        )
    return True
