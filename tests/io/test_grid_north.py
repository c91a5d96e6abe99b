"""A sun by place and time stands where it does on the grid of the plot's maps."""

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Geod, Transformer

from fynjax.app.assembly import placed_by_image
from fynjax.app.io.frames import grid_north
from fynjax.app.io.plot import read_plot
from fynjax.sensors import sun_position
from tests.small import write_plot

PLACE, TIME = (-34.4, 18.05), "2024-10-30T09:00:00+02:00"
"""Near the western edge of zone 34 south, whose grid is turned by 1.7 degrees there."""
CRS = "EPSG:32734"


def raster(path, crs=CRS):
    east, north = Transformer.from_crs(4326, CRS, always_xy=True).transform(*PLACE[::-1])
    known = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": crs}
    place = Affine(0.5, 0.0, round(east), 0.0, -0.5, round(north) + 4.0)
    with rasterio.open(path, "w", width=8, height=8, transform=place, **known) as file:
        file.write(np.full((1, 8, 8), 128.0, np.float32))
    return path


def turn():
    """The direction of grid north, by two points a kilometre apart on it."""
    to_zone = Transformer.from_crs(4326, CRS, always_xy=True)
    east, north = to_zone.transform(*PLACE[::-1])
    (a, b), (c, d) = (to_zone.transform(east, north + dy, direction="INVERSE") for dy in (0, 1e3))
    return Geod(ellps="WGS84").inv(a, b, c, d)[0]


def plot_at(folder, sun, extra=""):
    path = write_plot(folder, f"\n[sun]\n{sun}\n")
    path.write_text(path.read_text().replace("[plot]\n", f"[plot]\n{extra}"))
    return path


BY_TIME = f'latitude_deg = {PLACE[0]}\nlongitude_deg = {PLACE[1]}\ntime = "{TIME}"'


def test_the_sun_counts_from_the_north_of_the_maps(tmp_path) -> None:
    raster(tmp_path / "map.tif")
    true = sun_position(*PLACE, TIME)
    assert abs(turn()) > 1.5
    plain = read_plot(plot_at(tmp_path, BY_TIME))
    assert plain.sun == true
    assert plain.grid_north_deg is None
    mapped = read_plot(plot_at(tmp_path, BY_TIME, 'probability_map = "map.tif"\n'))
    assert mapped.grid_north_deg == pytest.approx(turn(), abs=0.01)
    assert mapped.sun.azimuth == pytest.approx((true.azimuth - turn()) % 360.0, abs=0.01)
    assert mapped.sun.zenith == true.zenith
    # An image of a plot without maps says it too, and the maps are not turned twice.
    for plot in (plain, mapped):
        placed = placed_by_image(plot, [tmp_path / "map.tif"])
        assert placed.sun.azimuth == mapped.sun.azimuth


def test_angles_that_are_stated_count_from_the_maps_as_they_are(tmp_path) -> None:
    raster(tmp_path / "map.tif")
    sun = "zenith_deg = 30\nazimuth_deg = 40"
    assert read_plot(plot_at(tmp_path, sun, 'probability_map = "map.tif"\n')).sun.azimuth == 40.0


def test_a_map_in_degrees_or_without_place_turns_nothing(tmp_path) -> None:
    raster(tmp_path / "map.tif", crs=None)
    plot = placed_by_image(read_plot(plot_at(tmp_path, BY_TIME)), [tmp_path / "map.tif"])
    assert plot.grid_north_deg is None


def test_a_sun_that_was_put_in_place_of_the_files_stays(tmp_path) -> None:
    raster(tmp_path / "map.tif")
    plot = read_plot(plot_at(tmp_path, BY_TIME))
    plot = plot.replace(sun=plot.sun._replace(zenith=12.0))
    placed = placed_by_image(plot, [tmp_path / "map.tif"])
    assert placed.sun == plot.sun
    assert placed.grid_north_deg == pytest.approx(turn(), abs=0.01)


@pytest.mark.parametrize(
    ("crs", "place", "east"),
    [("EPSG:32734", (-34.4, 18.05), 1), ("EPSG:32734", (-34.4, 23.9), -1),
     ("EPSG:32633", (48.0, 12.2), -1), ("EPSG:32633", (48.0, 17.8), 1)],
)  # fmt: skip
def test_a_sun_on_the_grid_is_where_a_way_to_it_leads(tmp_path, crs, place, east) -> None:
    """On both sides of a zone's middle, north and south of the equator, by the end of a way of
    500 m to the sun; grid north lies `east` or west of true north."""
    at = f'latitude_deg = {place[0]}\nlongitude_deg = {place[1]}\ntime = "{TIME}"'
    sun = read_plot(plot_at(tmp_path, at)).sun_table
    turned = grid_north(crs, *place[::-1])
    end = Geod(ellps="WGS84").fwd(*place[::-1], sun.position().azimuth, 500.0)
    to_zone = Transformer.from_crs(4326, crs, always_xy=True)
    way = np.subtract(to_zone.transform(*end[:2]), to_zone.transform(*place[::-1]))
    assert np.sign(turned) == east
    expected = np.degrees(np.arctan2(*way)) % 360.0
    assert sun.position(turned).azimuth == pytest.approx(expected, abs=0.01)
