"""A small plot whose plants are known, calibrated to a noisy image of other traits."""

import json
import re

import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import aim_without_air, plot_problem, read_targets
from fynjax.app.io.plot import drone_sensor, read_plot
from fynjax.app.io.raster import write_geotiff
from fynjax.app.jobs import calibrate
from fynjax.app.jobs._schemas import json_schema
from fynjax.inversion import Data, Problem, block_of, fit, free
from fynjax.inversion._known_plants import PixelModel
from fynjax.metrics import BANDS
from tests.io.test_crowns import CROWNS, write
from tests.scene.plots import small_plot

pytestmark = pytest.mark.slow
MORE = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.Erica*.leaf.chlorophyll", "species.*.dead_fraction", "ground.brightness",
        "species.Erica*.diameter", "species.*.cover"]
pixel_sd = 0.01
model_error = 0
"""
CROWDED = (
    CROWNS
    + """Erica irregularis,0.4,1.5,50,0.5
Restio eleocharis,1.6,1.3,40,0.4
Restio eleocharis,0.9,0.8,30,0.4
"""
)
GAIN = np.array([1.03, 0.98, 1.0, 1.02])
TRUTH = np.array([1.0, -0.8, 0.6, -1.0, 0.7])
"""In whitened coordinates."""


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    """(plot file, image file, pixel model, its space, the truth, result)."""
    folder = tmp_path_factory.mktemp("known")
    path = write(folder, CROWDED, more=MORE)
    plot = read_plot(path)
    problem = plot_problem(plot, None, seed=0)
    scene, space = problem.scene, problem.free
    camera = aim_without_air(plot, scene, scene.parameters, drone_sensor(plot), pixel=0.1)
    model = PixelModel(scene, scene.parameters, space.names, camera, 1)
    truth = space.physical(jnp.asarray(TRUTH))
    image = np.asarray(model.image(truth), float) * GAIN[:, None, None]
    image *= 1.0 + 0.01 * np.random.default_rng(3).normal(size=image.shape)
    write_geotiff(folder / "drone.tif", image, list(BANDS), pixel_m=0.1)
    result = calibrate(path, folder / "drone.tif", folder / "out")
    return path, folder / "drone.tif", model, space, truth, result


def test_traits_of_known_plants_come_out_within_their_intervals(twin):
    *_, space, truth, result = twin
    assert len(space.names) == 5  # covers are not free
    assert result.converged
    rows = {row.name: row for row in result.parameters}
    for name, value in zip(space.names, np.asarray(truth)):
        row = rows[name]
        shown = value * (100.0 if row.unit == "cm" else 1.0)
        assert abs(row.estimate - shown) < 3.0 * row.sd, name
        assert row.constrained > 0.9, name
    # Noise of 1 % and nothing else: the misfit is the chi-square of as many values.
    said = " ".join(result.headline)
    chi2 = float(said.split("Chi-square ")[1].split(" ")[0])
    assert abs(chi2 - 1600) < 4.0 * np.sqrt(2 * 1600)
    error = float(said.split(" % with the camera")[0].split()[-1])
    assert 0.9 < error < 1.2  # of the band's mean, as the noise is of a pixel
    found = [float(gain) for gain in re.findall(r"([\d.]+) ±", said.split("What all")[0])]
    np.testing.assert_allclose(found, GAIN, atol=0.01)


def test_the_result_and_its_files_are_as_documented(twin):
    path, *_, result = twin
    jsonschema.validate(json.loads(result.model_dump_json()), json_schema("summary"))
    page = (path.parent / "out" / "report.html").read_text("utf-8")
    before, after = re.search(r"relative error ([\d.]+) % before, ([\d.]+) % after", page).groups()
    pair = re.search("<b>([\\d.]+)\xa0→\xa0([\\d.]+)\xa0%</b>", page).groups()
    np.testing.assert_allclose([*map(float, pair)], [float(before), float(after)], atol=0.051)
    assert 'data-label="False colour"' in page
    assert page.count('class="ground"') > 3 * 8  # residuals too move with the image
    for file in ("band_nir.png", "image_after.tif", "residual.png", "parameters.csv"):
        assert (path.parent / "out" / file).is_file()
    assert {row.statistic for row in result.statistics} == {f"{band}.mean" for band in BANDS}


def test_slopes_of_pixels_are_those_of_differences(twin):
    _, _, model, space, truth, _ = twin
    values = np.asarray(truth)
    image, slopes = model.slopes(jnp.asarray(values))
    weight = np.random.default_rng(0).normal(size=image.shape)
    for i, name in enumerate(space.names):
        # Elements that move should not change their voxel; light alone is rounded to 32 bits.
        by, within = (0.0005, 0.02) if name.endswith("diameter") else (0.01, 0.003)
        step = by * values[i] * np.eye(len(values))[i]
        up, down = (np.asarray(model.image(jnp.asarray(values + s)), float) for s in (step, -step))
        difference = np.sum(weight * (up - down)) / (2.0 * step[i])
        assert np.sum(weight * slopes[i]) == pytest.approx(difference, rel=within), name


def test_images_that_do_not_fit_are_refused(twin, tmp_path):
    path, image, model, space, *_ = twin
    half = np.full((4, 10, 20), 0.2)
    write_geotiff(tmp_path / "half.tif", half, list(BANDS), pixel_m=0.1)
    with pytest.raises(InputError, match="expected an image of the whole plot"):
        calibrate(path, tmp_path / "half.tif", tmp_path / "out")
    with pytest.raises(InputError, match="the image alone"):
        calibrate(path, [image, image], tmp_path / "out")
    full = np.full((4, 20, 20), 0.2)

    def fitted(scene, image, **options):
        return fit(Problem(scene, Data.from_pixels(image, pixel=0.1, **options), space))

    with pytest.raises(InputError, match="4 bands, 20 rows"):
        fitted(model.scene, half)
    with pytest.raises(InputError, match="no block of"):
        fitted(model.scene, np.nan * full)
    with pytest.raises(InputError, match="must be positive"):
        fitted(model.scene, full, pixel_sd=0.0)
    with pytest.raises(InputError, match="of the 4 bands of 'mavic_3m'"):
        fitted(model.scene, full[:3])
    chance = small_plot(extent=(2.0, 2.0))
    asked = Problem(chance, Data.from_pixels(full, pixel=0.1), free(chance, "ground.brightness"))
    with pytest.raises(InputError, match="plants are known"):
        fit(asked)


def test_blocks_are_as_small_as_the_values_allow():
    assert block_of(4, (100, 100)) == 1
    assert block_of(4, (200, 200)) == 2
    assert block_of(4, (400, 400)) == 4


def test_an_image_in_the_plot_file_counts_pixel_by_pixel_too(twin, tmp_path):
    path, image, *_ = twin
    beside = path.with_name("views.toml")
    target = f'\n[[target]]\nfile = "{image.name}"\n'
    beside.write_text(path.read_text() + target)
    stated = read_targets(read_plot(beside), [], by_pixel=True)
    given = read_targets(read_plot(path), [image], by_pixel=True)
    assert stated.names == given.names
    np.testing.assert_array_equal(stated.value, given.value)
    assert read_targets(read_plot(beside), []).pixels is None  # for draws by statistics
    beside.write_text(path.read_text() + target + "sun = {zenith_deg = 60, azimuth_deg = 300}\n")
    with pytest.raises(InputError, match="under the plot's sun"):
        read_targets(read_plot(beside), [], by_pixel=True)
