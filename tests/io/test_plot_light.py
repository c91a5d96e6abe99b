"""Pattern of the sky and angular shape of the ground, from a plot file to the scene."""

import shutil

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.radiation import RahmanPintyVerstraete
from fynjax.sensors import shipped_sensor
from fynjax.sensors.lidar._path import canopy_fields, trace_pencils

PATTERN = "zenith_deg,azimuth_deg,radiance\n" + "".join(
    f"{zenith},{azimuth},{1 + zenith / 90 + (azimuth == 180)}\n"
    for zenith in (90, 0, 45)
    for azimuth in (0, 90, 180, 270)
)


@pytest.fixture
def plot(tmp_path):
    shutil.copytree(example_folder(), tmp_path / "plot")
    path = tmp_path / "plot" / "plot.toml"
    text = path.read_text(encoding="utf-8")
    text = text.replace("size_m = 10.0 ", "size_m = 1.0 ").replace(
        "voxel_m = 0.1 ", 'structure_m = "even"\nvoxel_m = 0.5 '
    )
    (tmp_path / "plot" / "pattern.csv").write_text(PATTERN, encoding="utf-8")
    text = text.replace("# pattern =", "pattern =").replace("# rpv =", "rpv =")
    path.write_text(text, encoding="utf-8")
    return path


def change(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_the_lines_that_the_example_leaves_out_reach_the_light(plot):
    scene, parameters = build_plot(read_plot(plot))
    bands = shipped_sensor("mavic_3m").bands
    voxels = scene.voxels(parameters, bands)
    pattern = np.asarray(voxels.illumination.sky_pattern)
    np.testing.assert_allclose(pattern, [[1, 1, 2, 1], [1.5, 1.5, 2.5, 1.5], [2, 2, 3, 2]])
    shape = voxels.ground_shape
    for values, stated in zip((shape.k, shape.theta, shape.rho_c), (0.8, -0.1, 0.3), strict=True):
        np.testing.assert_allclose(values, np.full(4, stated), rtol=1e-6)
    assert plot.parent / "pattern.csv" in read_plot(plot).inputs


def test_dead_tissue_and_leaf_sizes_of_a_plot_file_reach_the_scene(plot):
    rows = "wavelength_nm,reflectance\n400,0.2\n2500,0.6\n"
    (plot.parent / "dead.csv").write_text(rows, encoding="utf-8")
    change(plot, "# dead_tissue =", "dead_tissue =")
    change(plot, "# hot_spot =", "hot_spot =")
    scene, _ = build_plot(read_plot(plot))
    np.testing.assert_allclose(scene.dead_tissue.at(np.array([400.0, 1450.0])), [0.2, 0.4])
    assert scene.hot_spot


def test_lidar_meets_ground_of_that_shape(plot):
    scene, parameters = build_plot(read_plot(plot))
    change(plot, "rpv =", "# rpv =")
    lambert, _ = build_plot(read_plot(plot))
    bands = shipped_sensor("mavic_3m").bands
    origin, slant = jnp.array([0.5, 0.2, 50.0]), np.array([0.3, 0.0, -1.0])
    slant = jnp.asarray(slant / np.linalg.norm(slant))

    def path(voxels):
        fields = canopy_fields(voxels)
        return trace_pencils(voxels, fields, origin, slant, jnp.zeros((1, 2)), 0.0, 1)

    paths = [path(one.voxels(parameters, bands)) for one in (scene, lambert)]
    # Straight back: no distance between the tangent points, a phase angle of zero.
    cosine, k, theta, rho_c = -float(slant[2]), 0.8, -0.1, 0.3
    expected = (2 * cosine**3) ** (k - 1) * (1 - theta**2) / (1 + theta) ** 3 * (2 - rho_c)
    # The spectrum is what is measured from above, lit from 45 degrees: one unit between tangents.
    half = 0.5**0.5
    measured = (half * (1 + half)) ** (k - 1) * (1 - theta**2) * (1 + (1 - rho_c) / 2)
    measured /= (1 + 2 * theta * half + theta**2) ** 1.5
    ratio = float(paths[0].ground[0] / paths[1].ground[0])
    assert ratio == pytest.approx(expected / measured, rel=1e-5)
    assert isinstance(scene.voxels(parameters, bands).ground_shape, RahmanPintyVerstraete)


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ("45,90,1.5", "45,80,1.5", ("pattern.csv", "even azimuths")),
        ("45,90,1.5", "30,90,1.5", ("pattern.csv", "even zenith")),
        ("45,90,1.5", "45,90,-1.5", ("pattern.csv", "radiance", "-1.5")),
        ("45,90,1.5\n", "", ("pattern.csv", "11 rows")),
    ],
)
def test_a_pattern_that_is_no_even_grid_is_refused(plot, old, new, names):
    change(plot.parent / "pattern.csv", old, new)
    with pytest.raises(InputError) as error:
        read_plot(plot)
    assert all(name in str(error.value) for name in names)


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ("[0.8, -0.1, 0.3]", "[8.0, -0.1, 0.3]", ("ground.rpv", "k of 0.1 to 2", "8")),
        ('# terrain = "terrain.tif"', 'terrain = "species.csv"', ("ground.rpv", "level")),
    ],
)
def test_a_shape_that_cannot_be_is_refused(plot, old, new, names):
    change(plot, old, new)
    if "terrain" in new:
        change(plot, 'boundary = "periodic" ', 'boundary = "open" ')
    with pytest.raises(InputError) as error:
        read_plot(plot)
    assert all(name in str(error.value) for name in names)
