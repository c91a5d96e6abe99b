"""A scene is fitted, and asked what an image can say of it, with the library alone."""

import re

import numpy as np
import pytest

import fynjax as fx
from fynjax.errors import InputError
from fynjax.inversion import CalibrationSettings

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
PLANTS = ("Erica", "rounded_shrub", 40, 30, 0.6), ("Restio", "tussock", 30, 15, 0.5)
ROWS = [dict(zip(COLUMNS, plant, strict=True)) for plant in PLANTS]
QUICK = CalibrationSettings(
    rounds=1, stand_realisations=2, scatter_draws=6, full_renders=1, max_steps=3
)


def test_statistics_in_memory_are_fitted_and_the_posterior_is_drawn():
    scene = fx.Scene.from_table(ROWS, size=1.0, voxel=0.25, structure="even", seed=1)
    free = fx.free(scene, "species.*.cover", "ground.brightness")
    image = fx.observe(scene, "mavic_3m", pixel=0.25)
    seen = {name: float(np.mean(image[name])) for name in image.bands}
    of_image = fx.Data.from_image(image, statistics=["*.mean"])
    of_table = fx.Data.from_table({f"{name}.mean": mean for name, mean in seen.items()}, pixel=0.25)
    shared = [of_image.names.index(name) for name in of_table.names]
    np.testing.assert_allclose(np.asarray(of_image.value)[shared], of_table.value, rtol=1e-6)
    problem = fx.Problem(scene, of_table, free, settings=QUICK)
    assert problem.error is not None  # the learned one, which ships
    found = fx.fit(problem)
    assert np.isfinite(found.fit.estimate).all()
    draws = fx.sample(problem, "laplace")
    middle = np.median(draws.values, axis=(0, 1))
    np.testing.assert_allclose(middle, found.fit.estimate, rtol=0.3)
    bounds = fx.information(scene, free, gsd=[0.25, 0.5], plantings=2)
    assert (bounds.to_numpy() > 0).all()
    for wrong in ({"max_steps": 1}, {"error": "none"}, {"settings": QUICK}):
        with pytest.raises(InputError, match="a problem alone"):
            fx.fit(problem, **wrong)
    with pytest.raises(InputError, match="`max_steps` or `settings`"):
        fx.fit(scene, of_table, free, settings=QUICK, max_steps=2)
    with pytest.raises(InputError, match="with a scene"):
        fx.fit(lambda x: x[:4], of_table, free, error="none")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"NDVI.mean": "0.5x"}, "a number for NDVI.mean, but got '0.5x'"),
        ({"statistic": ["nir.mean"], "value": [0.3], "sd": ["a"]}, "a number for nir.mean"),
        (5, "a table of statistics, as columns or a mapping of names to values"),
        ({"statistic": ["nir.mean"] * 2, "value": [0.3, 0.4]}, "nir.mean is there again"),
        ({}, "the table has none"),
    ],
)
def test_a_table_that_is_none_is_refused(table, words):
    with pytest.raises(InputError, match=re.escape(words)):
        fx.Data.from_table(table, pixel=0.25)


def test_what_a_camera_measured_is_checked():
    scene = fx.Scene.from_table(ROWS, size=1.0, voxel=0.25, structure="even", seed=1)
    image = fx.observe(scene, "mavic_3m", pixel=0.25)
    with pytest.raises(InputError, match="a `footprint` above 0 m"):
        fx.Data.from_image(image, footprint=0.0)
    with pytest.raises(InputError, match="`statistics` fits none of"):
        fx.Data.from_image(image, statistics=["blue.*"])
    pixels = fx.Data.from_pixels(image).pixels
    np.testing.assert_array_equal(pixels.image[3], np.asarray(image["nir"], float))
    free = fx.free(scene, "species.*.cover")
    data = fx.Data.from_image(image)
    with pytest.raises(InputError, match="a `start` of finite numbers"):
        fx.fit(scene, data, free, start=np.full(2, np.nan))
