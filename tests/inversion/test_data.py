"""Data of several views of one plot: their names, the gains that they share, where they look."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.errors import InputError
from fynjax.inversion import BandFactors, ImageView, look, search_form
from fynjax.metrics import without_view
from fynjax.scene import AimedSensor, ModelError
from fynjax.sensors import Frame, Gains, Pose, shipped_sensor
from tests.helpers import stand_in

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
TABLE = [
    dict(zip(COLUMNS, row, strict=True))
    for row in (("Erica", "rounded_shrub", 40, 30, 0.6), ("Restio", "tussock", 30, 15, 0.5))
]


@pytest.fixture(scope="module")
def scene():
    return fx.Scene.from_table(TABLE, size=2.0, voxel=0.25, structure="even", seed=1)


def test_a_statistic_is_the_same_with_and_without_the_name_of_its_view():
    for name in ("nir.mean", "NDVI.std", "spectrum.550nm", "spectrum.552.5nm", "lidar.rugosity"):
        assert without_view(name) == name
        assert without_view(f"dusk.{name}") == name


def test_two_views_of_a_kind_have_names(scene):
    noon, dusk = (
        fx.Data.from_table({"nir.mean": value, "red.mean": 0.05}, name=name)
        for name, value in (("noon", 0.3), ("dusk", 0.28))
    )
    both = noon + dusk
    names = "noon.nir.mean", "noon.red.mean", "dusk.nir.mean", "dusk.red.mean"
    assert both.names == names
    assert [part.source.name for part in both.parts] == ["noon", "dusk"]
    problem = fx.Problem(scene, both, fx.free(scene, "*.cover"), error="none")
    assert tuple(n for view in problem.views for n in view.statistic_names) == names
    assert problem.views[0].names == ("nir.mean", "red.mean")
    assert noon.renamed("dawn").names == ("dawn.nir.mean", "dawn.red.mean")
    plain = fx.Data.from_table({"nir.mean": 0.3})
    assert (plain + dusk).names == ("nir.mean", "dusk.nir.mean", "dusk.red.mean")
    with pytest.raises(InputError, match=r"'nir\.mean' is in both.*name=\"dusk\""):
        plain + plain
    with pytest.raises(InputError, match=r"'dusk\.nir\.mean' is in both"):
        both + dusk


@pytest.mark.parametrize("name", ["two words", "a.b", "1st", "spectrum", "lidar"])
def test_a_name_of_a_view_is_one_word_and_no_sensor_s(name):
    with pytest.raises(InputError, match="expected a word as the name of a view, such as 'dusk'"):
        fx.Data.from_table({"nir.mean": 0.3}, name=name)


def test_data_of_no_sensor_have_no_view_to_name():
    with pytest.raises(InputError, match="data of one sensor"):
        fx.Data("a", [1.0], [0.1]).renamed("dusk")


def camera(name, bands, gains):
    sensor = shipped_sensor("rededge_3").select(bands)
    sensor = dataclasses.replace(sensor, name=name)
    return ImageView((), stand_in(AimedSensor, sensor=sensor), gains)


def test_views_of_one_camera_share_its_gains_but_for_their_drift():
    """Against draws of what gains are: of the camera one for all of its flights, by wavelength,
    and each flight by a factor that all bands of it have."""
    gains, random = Gains(0.1, 0.4, drift=0.05), np.random.default_rng(0)
    views = [camera("a", [0, 1, 2], gains), camera("a", [2, 1], gains), camera("b", [1], gains)]
    number = 200_000
    own = [
        0.1
        * (0.4**0.5 * random.normal(size=(number, 1)) + 0.6**0.5 * random.normal(size=(number, 3)))
        for _ in range(2)
    ]
    drift = 0.05 * random.normal(size=(number, 2))
    draws = np.concatenate(
        [own[0] + drift[:, :1], own[0][:, [2, 1]] + drift[:, 1:], own[1][:, [1]]], axis=1
    )
    error = ModelError(np.array([400.0, 900.0]), np.array([0.1, 0.2]), np.eye(2))
    for of_model in (None, error):
        found = BandFactors.of(views, of_model)
        np.testing.assert_allclose(found.of_gains, np.cov(draws.T), atol=2e-4)
        total = np.asarray(found.of_gains) + np.asarray(found.of_model)
        np.testing.assert_allclose(found.root @ found.root.T, total, atol=1e-12)
    # A flight alone has the drift in its gains already.
    alone = BandFactors.of(views[:1], None)
    np.testing.assert_allclose(alone.of_gains, gains.covariance(3))


def test_an_oblique_frame_is_compared_where_it_sees_the_plot(scene):
    """Statistics of an observation are those that the view of the same scene predicts, though half
    of the plot is beyond the frame; and a search sees about that."""
    frame = Frame(
        Pose([1.0, -4.0, 8.0], 0.0, 35.0), fx.Lens((60, 40), (380.0, 380.0), (29.5, 19.5))
    )
    seen = fx.observe(scene, "mavic_3m", pose=frame, pixel=0.1)
    assert 0.2 < np.mean(seen.seen) < 0.8
    data = fx.Data.from_image(seen, "mavic_3m", pose=frame, statistics=("*.mean", "nir.std"))
    view = data.source.view(scene, scene.parameters)
    values, image = look((view,), scene, scene.parameters)
    np.testing.assert_allclose(values, data.value, rtol=1e-5)
    at = view.names.index("nir.mean")
    band = np.asarray(image)[view.bands.names.index("nir")]
    counted = band[np.asarray(seen.seen)].mean()
    assert float(values[at]) == pytest.approx(counted, rel=1e-5)
    assert abs(band.mean() / counted - 1.0) > 0.01  # what no pixel of the frame shows
    quick, (coarse,) = search_form(scene, scene.parameters, [view], stride=2)
    found = coarse.predict(quick, scene.parameters)
    assert float(found[at]) == pytest.approx(counted, rel=0.1)
    other = fx.Data.from_image(seen, "mavic_3m", statistics=("*.mean",))
    straight = other.source.view(scene, scene.parameters)
    assert straight.camera.seen is None or np.all(straight.camera.seen)
    assert jnp.abs(straight.predict(scene, scene.parameters)[at] / counted - 1.0) > 0.01
