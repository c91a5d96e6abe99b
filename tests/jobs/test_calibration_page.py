"""What the page of a calibration shows, from its numbers, without a search."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fynjax.app.assembly import RealImage
from fynjax.app.jobs._calibration_page import (
    _goal_sentences,
    _image_sections,
    agreement_sentences,
    error_pictures,
    real_sentence,
)
from fynjax.app.jobs._calibration_tables import ReferenceImage
from fynjax.app.report.pages import Picture, Views
from fynjax.inversion import Calibration, Data, ImageView, Source
from fynjax.sensors import shipped_sensor
from tests.helpers import stand_in

BANDS = shipped_sensor("rededge_3").bands


@pytest.fixture
def statistics():
    names = ["green.mean", "nir.mean", "NDVI.mean", "nir.std", "nir.q50", "SR.mean"]
    table = pd.DataFrame({"statistic": names, "fitted": [True] * 5 + [False], "real": 0.2})
    errors = {
        "before": [10.0, -20.0, 5.0, 40.0, 90.0, 3.0],
        "after": [1.0, 2.0, 3.0, 30.0, 80.0, 2.0],
        "with_gain": [0.5, 1.0, 1.5, 25.0, 70.0, np.nan],
        "with_error": [0.2, 0.4, 0.6, 20.0, 60.0, np.nan],
        "reference": [12.0, 13.0, 14.0, 15.0, 16.0, 17.0],
    }
    for column, error in errors.items():
        table[f"{column}_error_percent"] = error
        table[column] = 0.2 * (1.0 + np.array(error) / 100.0)
    return table.assign(image_after=0.2)


@pytest.fixture
def result():
    level = np.random.default_rng(0).uniform(0.5, 1.0, (8, 6))
    before = 0.5 * np.array([0.04, 0.08, 0.1, 0.2, 0.4])[:, None, None] * level
    sensor = SimpleNamespace(bands=BANDS)
    view = ImageView(("nir.mean",), SimpleNamespace(sensor=sensor, pixel=0.1, shape=level.shape))
    images = {"images_before": (before,), "images_after": (2.0 * before,)}
    return stand_in(Calibration, views=(view,), **images)


def measured(image):
    source = Source("image", lambda *_: None, image=image)
    return Data(("nir.mean",), np.ones(1), np.ones(1), source=source)


def sections(image, result, statistics):
    return _image_sections(measured(image), result.views[0], result, statistics, ReferenceImage())


def panels(picture):
    shown = [axes for axes in picture.figure.axes if axes.get_gid() == "ground"]
    return {axes.get_title(loc="left"): axes.images[0].get_array() for axes in shown}


def test_the_real_image_stands_beside_the_simulated_ones_with_its_own_stretch(result, statistics):
    """Of a camera that has blue and an image that lacks it; the plot after is twice as bright."""
    names = ("green", "red", "red_edge", "nir")
    values = result.images_before[0][[BANDS.names.index(name) for name in names]]
    real = RealImage(values, names, 0.1, (0.6, 0.8), 1, values.reshape(4, -1))
    image, against = sections(real, result, statistics)
    (views,) = (part for part in image.parts if isinstance(part, Views))
    for label in ("Nearly natural", "False colour", "NIR", "NDVI"):
        assert list(panels(views.pictures[label])) == ["Real", "Before", "After"], label
    assert list(panels(views.pictures["Blue"])) == ["Before", "After"]
    shown = panels(views.pictures["Nearly natural"])
    np.testing.assert_array_equal(shown["Real"], shown["Before"])
    assert shown["Real"].max() == 1.0
    np.testing.assert_allclose(
        shown["After"], np.minimum(2.0**0.5 * shown["Real"], 1.0), rtol=1e-6, atol=0.01
    )
    assert shown["After"].mean() > 1.2 * shown["Real"].mean()
    scales = {axes.images[0].get_clim() for axes in views.pictures["NIR"].figure.axes[:3]}
    assert scales == {tuple(np.percentile(values[-1], [1, 99]))}
    files = [part.file for part in against.parts if isinstance(part, Picture)]
    assert files == ["errors.png", "bands.png", "indices.png"]
    assert "has no partner in the real image" in against.parts[1].caption
    curves = against.parts[1].figure.legends[0].get_texts()
    assert [text.get_text() for text in curves][:3] == ["real", "before", "after"]


def test_without_the_image_itself_the_page_says_so(result, statistics):
    image, _ = sections(None, result, statistics)
    assert "only statistics are known" in image.parts[0]
    assert list(panels(image.parts[-1].pictures["NIR"])) == ["Before", "After"]


@pytest.mark.parametrize(
    ("size", "block", "said"),
    [
        ((2.0, 1.0), 1, "looks so."),
        ((4.0, 3.0), 1, "Of the real image, 4 x 3 m, the middle is shown"),
        ((1.0, 1.0), 1, "The real image, 1 x 1 m, is smaller than the plot, 2 x 1 m"),
        ((2.0, 1.0), 3, "means of 3 x 3 pixels are shown."),
    ],
)
def test_a_real_image_of_another_size_is_said_to_be(size, block, said):
    none = np.ones((4, 1, 1))
    real = RealImage(none, ("green",), 0.1, size, block, none[..., 0])
    sentence = real_sentence(real, (2.0, 1.0))
    assert said in sentence
    assert ("plot" in sentence) == (size != (2.0, 1.0))


def test_bars_have_before_after_with_gains_and_the_reference(statistics):
    """Means and spreads apart."""
    simulated = ReferenceImage(simulated={"nir.mean": 0.2})
    for reference, count in ((ReferenceImage(), 4), (simulated, 5)):
        (picture,) = error_pictures(statistics, reference)
        means, spreads = picture.figure.axes
        assert len(means.containers) == count
        assert [label.get_text() for label in means.get_yticklabels()] == [
            *("green", "NIR", "NDVI", "SR")
        ]
        assert [bars[0].get_width() for bars in spreads.containers] == [40, 30, 25, 20, 15][:count]
    assert [bars[1].get_width() for bars in means.containers] == [20, 2, 1, 0.4, 13]
    assert error_pictures(statistics[statistics["statistic"] == "nir.q50"], simulated) == []


def test_headlines_have_the_pair_before_and_after_whatever_was_fitted(statistics):
    first, second = agreement_sentences("Plot", measured(None), statistics, ReferenceImage())
    assert "a band mean 20.0 % before, 2.0 % after, 1.0 % with the camera's gains" in first
    assert "a fitted index mean 5.0 % before, 3.0 % after" in second
    spreads = statistics[statistics["statistic"].isin(["nir.std", "SR.mean"])]
    (only,) = agreement_sentences("Plot", measured(None), spreads, ReferenceImage())
    assert "largest error of a statistic of the image 40.0 % before, 30.0 % after" in only


def test_a_goal_is_reached_by_what_the_camera_reads_of_the_plants():
    """With gains; not by what the model is off by too, which would excuse everything."""
    statistics = pd.DataFrame(
        {
            "statistic": ["red.mean", "nir.mean", "NDVI.mean", "NDVI.std"],
            "fitted": True,
            "before_error_percent": 50.0,
            "after_error_percent": 20.0,
            "with_gain_error_percent": [2.0, -3.5, 4.0, 90.0],
            "with_error_error_percent": 0.0,
        }
    )
    goals = ReferenceImage({}, goals={"a band mean": 3.0, "a fitted index mean": 5.0})
    assert _goal_sentences(statistics, goals) == [
        "Aimed at, with the camera's gains: a band mean within 3 % (missed), a fitted index mean "
        "within 5 % (reached)."
    ]
    assert _goal_sentences(statistics, ReferenceImage({})) == []
