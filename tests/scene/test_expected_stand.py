"""Whole plants in the value, the expected stand in the slope.

A plot of 1.5 m with three species and few voxels. What is held against each other is worked out
apart: plants are counted, and the derivative of the mean over plantings is a difference of means.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import element_weight, rounded_count
from fynjax.inversion import structure_view
from fynjax.scene import (
    hard_counts,
    hard_instances,
    hard_scene,
    observe_lidar,
    room_needed,
    slope_of_fading,
    stand_realisation,
)
from fynjax.scene._planting import no_plants
from fynjax.scene._scene import _relative
from fynjax.sensors import shipped_lidar
from tests.scene.plots import EXACT, densities, drone, reflectance, small_parameters, small_plot

PLANTINGS = 60
KINDS = ("cover", "diameter", "leaf_area_index", "height")
_COVER = lambda p: p.species.cover  # noqa: E731


def scaled(log_factors: jax.Array):
    """The parameters with each kind times a factor."""
    parameters = small_parameters()
    fields = lambda p: [getattr(p.species, kind) for kind in KINDS]  # noqa: E731
    return eqx.tree_at(
        fields, parameters, [v * jnp.exp(x) for v, x in zip(fields(parameters), log_factors)]
    )


@pytest.fixture(scope="module")
def plot():
    return small_plot(extent=(1.5, 1.5))


def test_the_mean_number_of_plants_is_the_real_one(plot) -> None:
    """Over plantings; the ceiling of eq. (10) has half a plant more of each species."""
    parameters = small_parameters()
    real = np.asarray(plot.counts(parameters))
    found = [hard_counts(stand_realisation(plot, seed), parameters) for seed in range(400)]
    part = real % 1.0
    error = np.sqrt(part * (1.0 - part) / 400)
    assert np.all(np.abs(np.mean(found, axis=0) - real) < 4 * error)
    assert np.ptp(found, axis=0).max() == 1
    up = small_plot(extent=(1.5, 1.5), rounding="up")
    for seed in range(3):
        np.testing.assert_array_equal(
            hard_counts(stand_realisation(up, seed), parameters), np.ceil(real)
        )


def test_rounding_keeps_the_mean_and_whole_numbers() -> None:
    drawn = (np.arange(10_000) + 0.5) / 10_000
    for count in (0.05, 0.7, 3.0, 12.34):
        assert float(rounded_count(count, drawn).mean()) == pytest.approx(count, abs=2e-4)
    single = jnp.float32(52.0) * (1 + 2 * jnp.finfo(jnp.float32).eps)
    assert float(rounded_count(single)) == 52.0


@pytest.mark.parametrize("share", [0.0, 1e-3, 0.2, 0.5, 0.93, 1.0])
def test_a_plant_that_is_cut_keeps_its_area_with_slope_one(share: float) -> None:
    fraction = np.random.default_rng(2).dirichlet(np.full(40, 0.7))
    before = np.cumsum(fraction) - fraction
    area = lambda share: fraction @ element_weight(share, before, fraction)  # noqa: E731
    assert float(area(share)) == pytest.approx(share, abs=1e-12)
    for slope in (jax.jacfwd(area), jax.grad(area)):
        assert float(slope(share)) == pytest.approx(1.0 if share < 1.0 else 0.0, abs=1e-9)
    weight = element_weight(share, before, fraction)
    assert np.all(np.diff(weight) <= 1e-12)
    if share == 0.5:  # a cut, not a thinner crown
        assert np.count_nonzero((weight > 0.01) & (weight < 0.99)) < 0.45 * 40


def test_voxels_hold_the_same_whole_plants(plot) -> None:
    """As the list of plants does, whether spare plants are held ready or not."""
    parameters = small_parameters()
    alone = hard_scene(plot, parameters)
    assert len(hard_instances(plot, parameters)) == len(alone.planting.species)
    np.testing.assert_allclose(
        densities(plot, parameters), densities(alone, parameters), rtol=1e-9, atol=1e-12
    )


@pytest.mark.study
def test_every_sensor_sees_the_same_whole_plants(plot) -> None:
    """Camera and LiDAR, whether spare plants are held ready or not."""
    parameters = small_parameters()
    alone, camera = hard_scene(plot, parameters), drone(plot)
    np.testing.assert_allclose(
        reflectance(camera, plot, parameters), reflectance(camera, alone, parameters), rtol=1e-6
    )
    lidar = shipped_lidar("flash_lidar_paper")
    waves = [observe_lidar(s, parameters, lidar).waveforms.total for s in (plot, alone)]
    np.testing.assert_allclose(*waves, rtol=1e-6, atol=1e-12)


@pytest.fixture(scope="module")
def image(plot):
    """A camera, and a function of its image with its derivatives: the mean of weighted pixels, and
    a share of the mean NDVI."""
    camera = drone(plot, dataclasses.replace(EXACT, tolerance=1e-3), pixel=0.05)

    def figure(x: jax.Array, scene, weight: jax.Array, share: float) -> jax.Array:
        seen = camera.observe(scene, scaled(x)).reflectance
        _, red, _, nir = seen
        return (weight * seen).mean() + share * ((nir - red) / (nir + red)).mean()

    return camera, eqx.filter_jit(jax.value_and_grad(figure))


def test_the_slope_is_that_of_plants_that_fade(plot, image) -> None:
    """Of each pixel relative to the mean of both images; and the value is that of whole plants."""
    (camera, figure), parameters, none = image, small_parameters(), jnp.zeros(len(KINDS))
    whole, fades = (reflectance(camera, s, parameters) for s in (plot, plot.faded()))
    value, slope = figure(none, plot, jnp.ones_like(whole), jnp.zeros(()))
    _, same = figure(none, plot.faded(), 2.0 * whole / (whole + fades), jnp.zeros(()))
    assert float(value) == pytest.approx(float(whole.mean()), rel=1e-9)
    assert np.abs(whole / fades - 1.0).max() > 0.05
    np.testing.assert_allclose(slope, same, rtol=1e-9)


def test_a_slope_by_covers_alone(plot) -> None:
    """Of gap and structure, whose slopes by number are taken apart; in both modes, and of a plot
    without plants."""
    parameters, view = small_parameters(), structure_view(("gap_fraction",), grain=1.5)
    cover = _COVER(parameters)
    for function in (plot.gap_fraction, lambda p: view.observe(plot, p)[1][0]):
        by_cover = lambda x, f=function: f(eqx.tree_at(_COVER, parameters, x))  # noqa: E731
        slope = eqx.filter_jit(jax.grad(by_cover))(cover)
        assert float(slope[0]) < -0.1
        along = eqx.filter_jit(lambda x, f=by_cover: jax.jvp(f, (x,), (x,))[1])(cover)
        assert float(along) == pytest.approx(float(slope @ cover), rel=1e-6)
    bare = eqx.tree_at(lambda s: s.planting, plot, no_plants(plot.dtype))
    by_cover = lambda x: bare.gap_fraction(eqx.tree_at(_COVER, parameters, x))  # noqa: E731
    np.testing.assert_array_equal(eqx.filter_jit(jax.grad(by_cover))(cover), 0.0)


def test_the_value_beside_a_slope_has_the_same_slope(plot) -> None:
    """So that a derivative of a value that was computed with its gradient is no other one."""
    gap = lambda x: plot.gap_fraction(scaled(x))  # noqa: E731
    both = lambda x: jax.value_and_grad(gap)(x)[0]  # noqa: E731
    none = jnp.zeros(len(KINDS))
    found = eqx.filter_jit(lambda x: (jax.grad(both)(x), jax.grad(gap)(x)))(none)
    np.testing.assert_allclose(*found, rtol=1e-9)


def test_a_hard_scene_is_that_of_its_own_plants(plot) -> None:
    """Whatever a cover is set to later, and however often it is made."""
    parameters = small_parameters()
    once = hard_scene(plot, parameters)
    twice = hard_scene(once, parameters)
    np.testing.assert_array_equal(hard_counts(once, parameters), hard_counts(plot, parameters))
    assert len(hard_instances(twice, parameters)) == len(once.planting.species)
    assert not room_needed(once, parameters, once.counts(parameters)).any()
    none = eqx.tree_at(_COVER, parameters, jnp.zeros(3))
    np.testing.assert_array_equal(once.standing(none), 1.0)


def test_without_a_slope_the_scene_is_seen_once(plot) -> None:
    seen = []

    @slope_of_fading
    def count(scene, parameters):
        seen.append(scene)
        return scene.standing(parameters).sum()

    parameters = small_parameters()
    count(plot, parameters)
    assert len(seen) == 1
    jax.grad(lambda cover: count(plot, eqx.tree_at(_COVER, parameters, cover)))(_COVER(parameters))
    assert len(seen) == 3


def over_plantings(plot, value, slope, plantings=PLANTINGS):
    """Over plantings: a function's values, derivatives by differences, and the slopes taken."""
    steps = np.array([0.28, 0.28, 0.1, 0.1])
    values, differences, slopes = [], [], []
    for seed in range(plantings):
        scene = stand_realisation(plot, seed)
        values.append(float(value(jnp.zeros(4), scene)))
        ends = [[float(value(s * step, scene)) for s in (1, -1)] for step in np.diag(steps)]
        differences.append([(up - down) / (2 * step) for (up, down), step in zip(ends, steps)])
        slopes.append(np.asarray(slope(jnp.zeros(4), scene)))
    return np.array(values), np.array(differences), np.array(slopes)


@pytest.fixture(scope="module")
def expectation(plot):
    gap = lambda x, scene: scene.gap_fraction(scaled(x))  # noqa: E731
    return over_plantings(plot, eqx.filter_jit(gap), eqx.filter_jit(jax.grad(gap)))


@pytest.mark.parametrize("power", [1.0, 2.5])
def test_ratios_within_a_pixel_have_the_slope_of_their_mean(power: float) -> None:
    """Of a pixel that is as likely still bright as already dark, whatever the way it fades by: the
    logarithm changes by that of the end over the beginning, in closed form."""
    bright, dark, steps = 0.15, 0.04, 20_000
    way = (jnp.arange(steps) + 0.5) / steps
    fades = bright + (dark - bright) * way**power
    slope = (dark - bright) * power * way ** (power - 1.0)
    found = [np.mean(_relative(jnp.asarray(w), fades, slope) / w) for w in (bright, dark)]
    assert np.mean(found) == pytest.approx(np.log(dark / bright), rel=1e-5)
    np.testing.assert_array_equal(_relative(jnp.zeros(2), jnp.zeros(2), jnp.ones(2)), 1.0)


@pytest.mark.study
def test_an_index_has_the_slope_of_its_mean_over_plantings(plot, image) -> None:
    """The mean NDVI of the drone's pixels: a ratio within each pixel, so that bright and dark ones
    count as they are."""
    camera, figure = image
    none = jnp.zeros_like(reflectance(camera, plot, small_parameters()))

    @eqx.filter_jit
    def ndvi(x: jax.Array, scene) -> jax.Array:
        _, red, _, nir = camera.observe(scene, scaled(x)).reflectance
        return ((nir - red) / (nir + red)).mean()

    _, differences, slopes = over_plantings(
        plot, ndvi, lambda x, scene: figure(x, scene, none, jnp.ones(()))[1], 48
    )
    for i, kind in enumerate(KINDS):
        error = np.hypot(*(x[:, i].std() / np.sqrt(48) for x in (slopes, differences)))
        off = slopes[:, i].mean() - differences[:, i].mean()
        assert abs(off) < 2.0 * error, (kind, off / error)


def test_the_slope_is_the_derivative_of_the_mean_over_plantings(expectation) -> None:
    """Of whole plants. Height moves no gap seen from straight above."""
    _, differences, slopes = expectation
    for i, kind in enumerate(KINDS[:3]):
        error = np.hypot(*(x[:, i].std() / np.sqrt(PLANTINGS) for x in (slopes, differences)))
        assert abs(slopes[:, i].mean() - differences[:, i].mean()) < 2.0 * error, kind
        # A median has 1.25 times the error of a mean.
        assert abs(np.median(slopes[:, i]) - differences[:, i].mean()) < 2.5 * error, kind
    # Leaf area changes no number: its slope is that of the whole plants themselves.
    np.testing.assert_allclose(slopes[:, 2], differences[:, 2], rtol=0.01)
    np.testing.assert_allclose(slopes[:, 3], 0.0, atol=1e-12)


def test_the_slope_varies_less_than_what_one_more_plant_makes(expectation) -> None:
    """Between plantings, because it is that of several plants."""
    _, _, slopes = expectation
    assert slopes[:, 0].std() < 0.35 * abs(slopes[:, 0].mean())
