"""The lit picture of a scene against closed forms of its light, and where shadows must fall."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax.app.report.figures._scene_lit import _COLOURS, _columns, _direction, _lit, _reaching
from fynjax.app.report.figures._scene_oblique import view_of
from fynjax.scene import hard_instances, hard_scene

SIDE, CELL = 2.0, 0.01
UP = np.array([0.0, 0.0, 1.0])


def scattered(count: int, height: float = 0.5) -> np.ndarray:
    random = np.random.default_rng(3)
    return random.uniform(0.0, [SIDE, SIDE, height], (count, 3))


@pytest.mark.parametrize("zenith", [0.0, 40.0])
def test_leaves_at_random_let_as_much_light_through_as_the_formula_says(zenith):
    """Level leaves of area a at random, area index L: of the depth of a cell, a Poisson number of
    leaves times a / cell², the mean of exp(-depth) is exp(-L cell² / a (1 - exp(-a / cell²)))."""
    leaf, count = 0.5 * CELL**2, 120_000
    index = leaf * count / SIDE**2
    normal, area = np.tile(UP, (count, 1)), np.full(count, leaf)
    _, ground = _reaching((SIDE, SIDE), scattered(count), normal, area, _direction(zenith, 60.0))
    expected = np.exp(-index * CELL**2 / leaf * (1.0 - np.exp(-leaf / CELL**2)))
    assert ground.mean() == pytest.approx(expected, rel=0.01)


def test_light_reaches_the_upper_of_two_leaves_in_full():
    place = np.array([[0.505, 0.505, 0.1], [0.505, 0.505, 0.4]])
    normal, area = np.tile(UP, (2, 1)), np.array([1e-4, 0.5e-4])
    share, ground = _reaching((SIDE, SIDE), place, normal, area, UP)
    np.testing.assert_allclose(share, [np.exp(-0.5), 1.0])
    assert ground.min() == pytest.approx(np.exp(-1.5))
    assert (ground < 1.0).sum() == 1


def test_shadows_fall_away_from_the_sun():
    place, normal, area = np.array([[1.0, 1.0, 0.5]]), UP[None], np.array([1e-4])
    for azimuth, away in ((0.0, (0, -1)), (90.0, (-1, 0))):  # north, east
        _, ground = _reaching((SIDE, SIDE), place, normal, area, _direction(45.0, azimuth))
        row, column = np.argwhere(ground < 1.0)[0]
        shift = np.array([column, row]) * CELL - 1.0
        np.testing.assert_allclose(shift, 0.5 * np.array(away), atol=1.5 * CELL)


def test_shadows_fall_on_ground_that_is_not_level():
    """A leaf 0.5 m above ground of 0.3 m: the sun at 45 degrees in the east meets it 0.2 m west."""
    place, east = np.array([[1.0, 1.0, 0.5]]), _direction(45.0, 90.0)
    _, ground = _reaching((SIDE, SIDE), place, UP[None], np.array([1e-4]), east)
    x = np.arange(0.005, SIDE, CELL)
    hill = np.stack([x, np.full_like(x, 1.0), np.full_like(x, 0.3)], axis=-1)
    shaded = ground[_columns((SIDE, SIDE), hill, east)] < 1.0
    np.testing.assert_allclose(x[shaded], 0.8, atol=1.5 * CELL)


TABLE = pd.DataFrame(
    {
        "taxon": ["Shrub"],
        "growth_form": ["rounded_shrub"],
        "mean_diameter_cm": [50],
        "cover_percent": [20],
        "height_max_m": [0.5],
    }
)


@pytest.fixture(scope="module")
def scene():
    return fx.Scene.from_table(TABLE, size=1.0, structure="even", seed=2)


def test_bare_ground_has_the_colour_of_soil_and_plants_are_green(scene):
    picture = fx.lit_view(scene, size=(300, 300), points=20_000)
    assert picture.shape[2] == 3
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0
    shown = picture[(picture < 1.0).any(axis=2)] ** 2  # not the white beside the plot
    red, green, _ = shown.T
    assert 0.05 < (green > 1.1 * red).mean() < 0.9
    bright = shown[red > 0.8]
    soil = np.asarray(scene.ground_map(scene.parameters, _COLOURS)).ravel()
    np.testing.assert_allclose(
        (bright / bright[:, :1]).mean(axis=0)[1:], soil[1:] / soil[0], rtol=0.1
    )


def test_plants_behind_a_hill_are_hidden(scene):
    """A ridge along the middle, in one view with and without it."""
    behind = jnp.asarray(scene.planting.foot).at[:, 1].set(0.85)
    scene = eqx.tree_at(lambda s: s.planting.foot, scene, behind)
    plants, hard = hard_instances(scene, scene.parameters), hard_scene(scene, scene.parameters)
    y = np.linspace(0.0, 1.0, 40)
    ridge = 0.6 * np.exp(-(((y - 0.5) / 0.08) ** 2))[:, None] * np.ones(40)
    view = view_of(plants, ridge, (200, 200))
    soil = np.asarray(hard.ground_map(scene.parameters, _COLOURS)).ravel()[:3]
    seen = []
    for ground in (np.zeros((40, 40)), ridge):
        image = _lit(plants, dataclasses.replace(hard, terrain=ground), view, 20_000)
        ratio = image / soil
        seen.append((np.ptp(ratio, axis=2) > 0.3 * ratio.max(axis=2)).sum())  # not of bare ground
    assert seen[1] < 0.5 * seen[0]


def test_a_photo_is_the_image_with_one_stretch_for_all_colours(scene):
    image = fx.observe(scene, "mavic_3m", pixel=0.1)
    photo = fx.photo(image)
    red, green = np.asarray(image["red"]), np.asarray(image["green"])
    darkest = np.argsort(red.ravel())[:10]
    ratio = (photo[..., 0] ** 2 / photo[..., 1] ** 2).ravel()[darkest]
    np.testing.assert_allclose(ratio, (red / green).ravel()[darkest], rtol=1e-5)
    with pytest.raises(fx.errors.InputError, match="'nir'"):
        fx.photo(dataclasses.replace(image, bands=(*image.bands[:3], "other")), "false_colour")
