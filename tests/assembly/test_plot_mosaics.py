"""Orthomosaics among the targets of a plot file: with the places of their cameras, and without."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import read_problem
from fynjax.app.assembly._targets import ONE_PICTURE
from fynjax.app.io.raster import write_geotiff
from fynjax.inversion._views import BlendView
from fynjax.metrics import BANDS
from tests.io.flight_pictures import LEVELS, WAVES
from tests.small import write_plot

CAMERAS = """frame,east_m,north_m,height_m,seen
a,-9.0,1.0,30.0,1
b,11.0,1.0,30.0,1
far,400.0,1.0,30.0,0
"""


@pytest.fixture
def plot(tmp_path):
    noise = 1.0 + 0.1 * np.random.default_rng(0).normal(size=(1, 20, 20))
    image = LEVELS[:, None, None] * noise
    write_geotiff(tmp_path / "ortho.tif", image, BANDS, pixel_m=0.1, wavelengths=WAVES)
    (tmp_path / "cameras.csv").write_text(CAMERAS)
    return write_plot(tmp_path)


def targeted(plot, more):
    text = plot.read_text().partition("[[target]]")[0]
    plot.write_text(f'{text}[[target]]\nfile = "ortho.tif"\n{more}\n')
    return read_problem(plot, free=["species.*.cover"])


def test_a_mosaic_is_seen_by_the_cameras_that_are_stated(plot):
    problem = targeted(plot, 'cameras = "cameras.csv"')
    (view,), (part,) = problem.views, problem.data.parts
    mosaic = part.source.view_of.placement.frame
    assert [frame.name for frame in mosaic.mosaic] == ["camera 1", "camera 2"]
    edge = view.camera.margin
    slope = np.asarray(view.camera.rays.slope_x)[:, edge:-edge]
    # Each half by the nearer camera, 9 to 10 m away and 30 m up.
    np.testing.assert_allclose(slope[:, [0, -1]].mean(axis=0), [-9.05 / 30, 9.05 / 30], rtol=1e-5)
    assert "nearest of 2 cameras" in part.source.description
    assert ONE_PICTURE not in part.source.description
    assert view.camera.pixel == pytest.approx(0.1)


def test_or_it_is_the_mean_of_what_they_saw(plot):
    problem = targeted(plot, 'cameras = "cameras.csv"\nblend = "mean"')
    (view,), (part,) = problem.views, problem.data.parts
    assert isinstance(view, BlendView)
    assert len(view.frames) == 2
    assert "the mean of those of 2 cameras" in part.source.description
    scene = problem.scene
    values = np.asarray(view.predict(scene, scene.parameters))
    assert np.isfinite(values).all()
    # In the form of a search too, with slopes.
    images = [np.asarray(one.image(scene, scene.parameters)) for one in view.frames]
    blend = np.asarray(view.image(scene, scene.parameters))
    np.testing.assert_allclose(blend, np.mean(images, axis=0), rtol=1e-5)


def test_without_them_it_says_what_it_was_taken_for(plot):
    (part,) = targeted(plot, "").data.parts
    assert part.source.description.endswith(ONE_PICTURE)
    assert "%" in ONE_PICTURE


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('blend = "mean"', "expected cameras with blend"),
        ('cameras = "cameras.csv"\naltitude_m = 30', "cameras or altitude_m"),
        ('cameras = "cameras.csv"\nposition_m = [1, 1, 30]', "position_m or cameras"),
        ('cameras = "camera.csv"', "Did you mean"),
    ],
)
def test_slips_are_named(plot, more, words):
    with pytest.raises(InputError, match=words) as caught:
        targeted(plot, more)
    assert caught.value.file == plot.resolve()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("30.0,1\n", "-3.0,1\n", "height_m"),
        ("north_m", "north", "north_m"),
        ("seen", "GimbalPitchDegree", "unknown column 'GimbalPitchDegree'. Did you mean pitch_deg"),
        ("-9.0,1.0,30.0,1\nb,11.0", "-900.0,1.0,30.0,1\nb,1100.0", "none of 3 does"),
    ],
)
def test_damaged_tables_of_cameras_are_refused(plot, old, new, words):
    path = plot.with_name("cameras.csv")
    path.write_text(CAMERAS.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as caught:
        targeted(plot, 'cameras = "cameras.csv"')
    assert caught.value.file.name == "cameras.csv"
