"""Plots on ground that is not level."""

import numpy as np
import pytest
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.assembly._ground import ground_heights
from fynjax.app.io.plot import read_plot
from fynjax.scene import Placement, hard_instances, observe
from fynjax.sensors import shipped_sensor
from tests.helpers import write_raster

SPECIES = (
    "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form\n"
    "Erica,30,{cover},0.5,rounded_shrub\n"
)
TOML = """
[plot]
plants = "fynbos"
size_m = 3.0
voxel_m = 0.1
structure_m = "even"
boundary = "open"
{line}
[sun]
zenith_deg = 40.0
azimuth_deg = 270.0
[sky]
table = "sky.csv"
[ground]
litter_fraction = 0.0
[sensor]
pixel_m = 0.1
[scene]
softness = 0.0
softness_plants = 0.0
"""
RISE, NORTHWARD = 0.3, 0.1
LINE = 'terrain = "hill.tif"\nmap_origin_m = [500000.5, 6200000.5]'


def plot(folder, line="", cover=20.0, cell=0.1, **options):
    """A plot of one species, with a raster of ground that rises to the east and north beside it."""
    (folder / "species.csv").write_text(SPECIES.format(cover=cover))
    (folder / "sky.csv").write_text("wavelength_nm,diffuse_fraction\n400,0\n1000,0\n")
    middle = (np.arange(round(4.0 / cell)) + 0.5) * cell
    height = 120.0 + RISE * middle + NORTHWARD * middle[::-1, None]  # rows from the north
    place = Affine(cell, 0.0, 500_000.0, 0.0, -cell, 6_200_004.0)
    write_raster(folder / "hill.tif", height[None], transform=place, crs="EPSG:32734", **options)
    (folder / "plot.toml").write_text(TOML.format(line=line))
    return read_plot(folder / "plot.toml")


def test_plants_stand_on_the_ground(tmp_path):
    level = build_plot(plot(tmp_path))
    hill = build_plot(plot(tmp_path, LINE))
    flat, raised = (hard_instances(*each) for each in (level, hill))
    np.testing.assert_array_equal(raised.x, flat.x)
    # The lowest voxel column counts as 0.
    column, row = np.floor(raised.x / 0.1), np.floor(raised.y / 0.1)
    np.testing.assert_allclose(raised.z, 0.1 * (RISE * column + NORTHWARD * row), atol=1e-4)
    low, high = (np.asarray(model.area_density(parameters)) for model, parameters in (level, hill))
    assert high.sum() == pytest.approx(low.sum(), rel=1e-5)
    z = [(np.arange(d.shape[1]) + 0.5) @ d.sum(axis=(0, 2, 3)) * 0.1 / d.sum() for d in (low, high)]
    area = np.pi / 4 * flat.diameter**2  # of a crown, to which its leaf area is proportional
    assert z[1] - z[0] == pytest.approx(np.average(raised.z, weights=area), rel=0.05)


def test_bare_ground_is_lit_as_its_slope_has_it(tmp_path):
    """A plane that rises mostly eastward, the sun in the west: r cos(incidence) / cos(sun zenith),
    and up to r / 50 of it again from ground nearby. Cells of the raster wider than the voxels must
    not make steps."""
    model, parameters = build_plot(plot(tmp_path, LINE, cover=0.0, cell=0.5))
    sensor = shipped_sensor("mavic_3m")
    image = np.asarray(
        observe(model, sensor, parameters=parameters, placement=Placement(50.0, 0.1)).reflectance
    )
    level = np.asarray(model.ground_map(parameters, sensor.bands))
    sun = np.array([-np.sin(np.deg2rad(40.0)), 0.0, np.cos(np.deg2rad(40.0))])
    up = np.array([-RISE, -NORTHWARD, 1.0])
    facing = sun @ up / np.linalg.norm(up) / sun[2]
    middle = image[:, 8:-8, 8:-8]
    np.testing.assert_allclose(
        middle, np.broadcast_to(facing * level[:, None, None], middle.shape), rtol=0.02
    )


@pytest.mark.parametrize("cell", [0.05, 0.25, 0.5, 0.8])
def test_a_plane_is_a_plane_whatever_the_cells_of_its_raster(tmp_path, cell):
    heights = ground_heights(plot(tmp_path, LINE, cell=cell))
    middle = (np.arange(30) + 0.5) * 0.1
    want = RISE * middle + NORTHWARD * middle[:, None]
    np.testing.assert_allclose(heights - heights.min(), want - want.min(), atol=1e-9)


def test_terrain_that_cannot_serve_is_refused(tmp_path):
    plot(tmp_path)
    text = TOML.format(line=LINE)
    (tmp_path / "plot.toml").write_text(text.replace("open", "periodic"))
    with pytest.raises(InputError, match='boundary = "open" with a terrain'):
        read_plot(tmp_path / "plot.toml")
    (tmp_path / "plot.toml").write_text(text.replace("500000.5", "500002.5"))
    with pytest.raises(InputError, match="covers the plot"):
        build_plot(read_plot(tmp_path / "plot.toml"))
    plot(tmp_path, LINE, unit="ft")
    with pytest.raises(InputError, match=r"band says 'ft'.*--height-unit"):
        build_plot(read_plot(tmp_path / "plot.toml"))
