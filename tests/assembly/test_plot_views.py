"""Views of a plot that its file states: names, poses and suns of their own, gains of one camera."""

import dataclasses

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import _targets, read_problem
from fynjax.app.io.plot import TargetTable, read_plot
from fynjax.inversion import COARSE, BandFactors, Data, search_form
from fynjax.inversion._views import under_sun
from fynjax.scene import fitted_accuracy
from fynjax.sensors import Gains
from tests.small import write_plot

TARGETS = """
[[target]]
file = "noon.csv"
view = "noon"

[[target]]
file = "dusk.csv"
view = "dusk"
position_m = [1.0, -8.0, 12.0]
pitch_deg = 35
sun = {zenith_deg = 60, azimuth_deg = 300}
"""


@pytest.fixture
def plot(tmp_path):
    path = write_plot(tmp_path)
    for name, nir in (("noon", 0.3), ("dusk", 0.28)):
        rows = f"statistic,value,sd\nnir.mean,{nir},0.01\nred.mean,0.05,0.005\n"
        (tmp_path / f"{name}.csv").write_text(rows)
    path.write_text(path.read_text() + TARGETS)
    return path


def test_each_view_has_its_name_pose_and_sun(plot):
    problem = read_problem(plot, free=["species.*.cover"])
    assert problem.data.names == (
        "noon.nir.mean",
        "noon.red.mean",
        "dusk.nir.mean",
        "dusk.red.mean",
    )
    assert problem.data.value.tolist() == [0.3, 0.05, 0.28, 0.05]
    noon, dusk = problem.views
    assert (noon.sun, dusk.sun) == (None, (60.0, 300.0))
    assert noon.camera.seen is None
    assert np.asarray(dusk.camera.seen).mean() > 0.9
    scene = problem.scene
    here, there = (np.asarray(v.predict(scene, scene.parameters)) for v in (noon, dusk))
    # The shadow side of shrubs under a low sun: darker, red more than near infrared.
    assert (there < here).all() or (there / here)[1] < (there / here)[0]
    # Under the sun of the plot the same view is another.
    other = dataclasses.replace(dusk, sun=None).predict(scene, scene.parameters)
    assert np.abs(np.asarray(other) / there - 1.0).max() > 0.02


def test_views_of_one_camera_share_its_gains_but_for_their_drift(plot):
    views = read_problem(plot, free=["species.*.cover"]).views
    covariance = np.asarray(BandFactors.of(views, None).of_gains)
    bands, gains = len(views[0].bands), views[0].gains
    own, shared = gains.covariance(bands), covariance[:bands, bands:]
    np.testing.assert_allclose(shared, own, rtol=1e-12)
    np.testing.assert_allclose(covariance[:bands, :bands], own + gains.drift**2, rtol=1e-12)
    alone = np.asarray(BandFactors.of(views[:1], None).of_gains)
    np.testing.assert_allclose(alone, own, rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('view = "dusk"', 'view = "noon"', "'noon' is named twice"),
        ('view = "dusk"', 'view = "two words"', "one word"),
        ("position_m = [1.0, -8.0, 12.0]\n", "", "position_m with pitch_deg"),
        ("pitch_deg = 35", "altitude_m = 50", "position_m or altitude_m"),
        ('file = "dusk.csv"', 'file = "dust.csv"', "Did you mean"),
        ('view = "noon"\n\n', "\n", None),
    ],
)
def test_slips_in_targets_are_named(plot, old, new, words):
    text = plot.read_text()
    assert old in text
    plot.write_text(text.replace(old, new))
    if words is None:  # one of two may do without a name
        assert read_problem(plot, free=["species.*.cover"]).data.names[0] == "nir.mean"
        return
    with pytest.raises(InputError, match=words) as caught:
        read_problem(plot)
    assert caught.value.file == plot.resolve()


def test_keys_of_a_view_count_in_place_of_the_plots(plot):
    text = plot.read_text().replace("pitch_deg = 35\n", "pitch_deg = 35\npixel_m = 0.2\n")
    own = '[sensor]\nname = "mavic_3m"\ncalibrated_by = "panels"\npoint_spread = false\n'
    before, _, after = text.partition("[sensor]")
    rest = after[after.index("\n[") :] if "\n[" in after else ""
    plot.write_text(before + own + rest)
    read = read_plot(plot)
    table = read.targets[1].of_sensor(read.sensor)
    assert (table.name, table.calibrated_by, table.point_spread) == ("mavic_3m", "panels", False)
    assert (table.pixel_m, read.sensor.pixel_m) == (0.2, None)
    other = read.targets[1].replace(name="rededge_mx").model_copy()
    named = TargetTable.model_construct({"file", "name"}, **(dict(other) | {"pixel_m": None}))
    assert named.of_sensor(read.sensor).calibrated_by is None


def test_gains_of_another_way_of_calibration_are_others(plot):
    noon, dusk = read_problem(plot, free=["species.*.cover"]).views
    ways = [dataclasses.replace(noon, gains=Gains(0.05, 0.5, way)) for way in ("panels", "other")]
    covariance = np.asarray(BandFactors.of(ways, None).of_gains)
    bands = len(noon.bands)
    assert not covariance[:bands, bands:].any()
    np.testing.assert_allclose(covariance[:bands, :bands], ways[0].gains.covariance(bands))
    assert (
        np.linalg.eigvalsh(np.asarray(BandFactors.of((noon, dusk), None).of_gains)).min() > -1e-12
    )


def test_an_image_in_the_plot_file_places_the_plot(plot, monkeypatch):
    asked = []
    monkeypatch.setattr(_targets, "placed_by", lambda plot, maps: asked.append([*maps]) or plot)
    plot.with_name("noon.tif").write_bytes(b"")
    plot.write_text(plot.read_text().replace("noon.csv", "noon.tif"))
    read = read_plot(plot)
    _targets.placed_by_image(read, [])
    _targets.placed_by_image(read, [plot.with_name("other.tif")])
    assert [[path.name for path in paths] for paths in asked] == [["noon.tif"], ["other.tif"]]


def test_the_sun_of_a_view_is_stated_from_python_too():
    dusk = Data.from_table({"nir.mean": 0.3}, sun=(60.0, 300.0), name="dusk")
    assert dusk.source.view_of.sun == (60.0, 300.0)
    assert Data.from_table({"nir.mean": 0.3}).source.view_of.sun is None
    with pytest.raises(InputError, match="zenith and azimuth"):
        Data.from_table({"nir.mean": 0.3}, sun=(95.0, 300.0))


def test_the_light_of_a_search_reaches_as_far_as_each_view_needs(plot):
    """Over an open plot beams of a low sun come from farther."""
    text = plot.read_text()
    assert "[plot]" in text
    plot.write_text(text.replace("[plot]", '[plot]\nboundary = "open"'))
    problem = read_problem(plot, free=["species.*.cover"])
    coarse, views = search_form(problem.scene, problem.scene.parameters, problem.views)
    noon, dusk = (view.camera.accuracy for view in views)
    low = under_sun(problem.scene.parameters, (60.0, 300.0))
    assert dusk == fitted_accuracy(COARSE, coarse, low) != noon
