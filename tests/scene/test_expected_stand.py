"""Whole plants, and the stand in expectation whose slopes are taken.

A plot of 1.5 m with three species and few voxels. What is held against each other is worked out
apart: plants are counted, and the derivative of the mean over plantings is a difference of means.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from fynjax.canopy import expected_count, rounded_count
from fynjax.inversion import stand_values, structure_view
from fynjax.scene import PlotParameters, Scene, hard_counts, hard_instances, hard_scene, room_needed
from fynjax.scene._lidar import observe_lidar
from fynjax.scene._planting import no_plants
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
    found = [hard_counts(plot.reordered(seed), parameters) for seed in range(400)]
    part = real % 1.0
    error = np.sqrt(part * (1.0 - part) / 400)
    assert np.all(np.abs(np.mean(found, axis=0) - real) < 4 * error)
    assert np.ptp(found, axis=0).max() == 1
    up = small_plot(extent=(1.5, 1.5), rounding="up")
    for seed in range(3):
        np.testing.assert_array_equal(hard_counts(up.reordered(seed), parameters), np.ceil(real))


def test_numbers_of_species_are_rounded_apart(plot) -> None:
    """And anew in each planting."""
    drawn = np.array([plot.reordered(seed).rounding for seed in range(400)])
    assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 0.2
    assert np.abs(np.corrcoef(drawn[1:, 0], drawn[:-1, 0])[0, 1]) < 0.2
    np.testing.assert_allclose(drawn.mean(axis=0), 0.5, atol=4 * 0.29 / 20)


def test_rounding_keeps_the_mean_and_whole_numbers() -> None:
    drawn = (np.arange(10_000) + 0.5) / 10_000
    for count in (0.05, 0.7, 3.0, 12.34):
        assert float(rounded_count(count, drawn).mean()) == pytest.approx(count, abs=2e-4)
    single = jnp.float32(52.0) * (1 + 2 * jnp.finfo(jnp.float32).eps)
    assert float(rounded_count(single)) == 52.0


@pytest.mark.parametrize("count", [0.05, 0.3, 0.5, 0.7, 1.0, 12.34])
def test_a_number_in_expectation_has_the_real_one_as_its_mean(count: float) -> None:
    """Its slope has the mean 1, the nearest whole number is that of whole plants, and of half a
    plant or more the share of the last is any from 0 to 1 as likely."""
    drawn = jnp.asarray((np.arange(10_000) + 0.5) / 10_000)
    some, slope = jax.vmap(jax.value_and_grad(expected_count), (None, 0))(count, drawn)
    assert float(some.mean()) == pytest.approx(count, abs=1e-6)
    assert float(slope.mean()) == pytest.approx(1.0, abs=1e-6)
    if count >= 0.5:
        np.testing.assert_array_equal(jnp.round(some), rounded_count(count, drawn))
        np.testing.assert_allclose(np.sort(some % 1.0), drawn, atol=1e-4)


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


def one_species(dtype: str = "float64") -> Scene:
    """A plot of 1.6 m for a few rounded shrubs of 50 cm."""
    shrub = "Erica", "rounded_shrub", 50.0, 10.0, 0.6
    columns = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
    row = dict(zip(columns, shrub))
    return Scene.from_table([row], size=1.6, seed=2, structure="even", dtype=dtype)


SHARES = 6
"""Parts of the range of the rounding number, in the middle of which each it is set."""


@pytest.fixture(scope="module")
def few():
    """Gap and near infrared of a few plants: of whole ones by their number; and in expectation, in
    the mean over rounding numbers and plantings, with slopes by the number."""
    scene = one_species()
    camera = drone(scene, dataclasses.replace(EXACT, tolerance=1e-3), pixel=0.2)

    def seen(number: jax.Array, stand: Scene) -> jax.Array:
        stand = dataclasses.replace(stand, number=number)
        image = camera.observe(stand, scene.parameters).reflectance
        return jnp.stack([stand.gap_fraction(scene.parameters), image[3].mean()])

    value = eqx.filter_jit(seen)
    one = jnp.ones(1)
    both = eqx.filter_jit(lambda n, stand: jax.jvp(lambda n: seen(n, stand), (n,), (one,)))
    plantings = [scene.reordered(seed) for seed in range(6)]
    whole = [[value(jnp.array([1.0 * n]), plot) for n in range(4)] for plot in plantings]

    def in_part(number: float) -> np.ndarray:
        found = [
            both(jnp.array([number]), dataclasses.replace(plot, rounding=jnp.array([u])))
            for plot in plantings
            for u in (np.arange(SHARES) + 0.5) / SHARES
        ]
        return np.mean(found, axis=0)

    return np.mean(whole, axis=0), in_part


@pytest.mark.parametrize("number", [1.0, 1.45, 2.0])
def test_the_slope_of_a_few_plants_is_what_one_more_makes(few, number: float) -> None:
    """Of a species of one or two plants, in the mean over rounding numbers and plantings: between
    two whole numbers the difference of both, on one the mean of that before and after. The value is
    that of whole plants: what is seen grows with the share of a plant that stands in part."""
    whole, in_part = few
    before = int(number)
    steps = np.diff(whole, axis=0)
    value, slope = in_part(number)
    half = abs(number - before - 0.5)  # of the window of one plant that is in the step beside
    beside = steps[before - 1] if number - before < 0.5 else steps[before + 1]
    made = (1.0 - half) * steps[before] + half * beside
    np.testing.assert_allclose(slope, made, rtol=0.05)
    line = whole[before] + (number - before) * steps[before]
    np.testing.assert_allclose((value - line) / steps[before], 0.0, atol=0.05)


def test_a_derivative_is_taken_of_the_stand_in_expectation(plot) -> None:
    """With its value beside it; without one whole plants are seen, and by what moves no number the
    slope is that of these."""
    gap = lambda x, scene: scene.gap_fraction(scaled(x))  # noqa: E731
    none = jnp.zeros(len(KINDS))
    value, slope = eqx.filter_jit(jax.value_and_grad(gap))(none, plot)
    same, own = eqx.filter_jit(jax.value_and_grad(gap))(none, plot.expected())
    whole = eqx.filter_jit(gap)(none, plot)
    assert float(value) == pytest.approx(float(same), rel=1e-12)
    np.testing.assert_allclose(slope, own, rtol=1e-12)
    assert abs(float(whole / value) - 1.0) > 1e-4

    def by_leaf_area(x: jax.Array) -> jax.Array:
        moved = small_parameters().species.leaf_area_index * jnp.exp(x)
        leafy = eqx.tree_at(lambda p: p.species.leaf_area_index, small_parameters(), moved)
        return plot.gap_fraction(leafy)

    value, slope = jax.jit(jax.value_and_grad(by_leaf_area))(0.0)
    assert float(value) == pytest.approx(float(whole), rel=1e-12)
    step = 1e-5
    difference = (by_leaf_area(step) - by_leaf_area(-step)) / (2 * step)
    assert float(slope) == pytest.approx(float(difference), rel=1e-6)


def test_a_stand_in_expectation_is_a_smooth_function() -> None:
    """Gap, numbers of the stand and image by all that a plot is; what has no light in it, to second
    order by what moves no area element."""
    scene = one_species().expected()
    camera = drone(scene, dataclasses.replace(EXACT, tolerance=1e-12), pixel=0.4)
    parameters = scene.parameters

    def plot_at(x: jax.Array) -> PlotParameters:
        fields = lambda p: [  # noqa: E731
            *(getattr(p.species, kind) for kind in KINDS), p.leaf.chlorophyll
        ]  # fmt: skip
        moved = [v * jnp.exp(by) for v, by in zip(fields(parameters), x)]
        return eqx.tree_at(fields, parameters, moved)

    def seen(x: jax.Array, east: jax.Array) -> jax.Array:
        plot, foot = plot_at(x), scene.planting.foot.at[0, 0].add(east)
        stand = eqx.tree_at(lambda s: s.planting.foot, scene, foot)
        image = camera.observe(stand, plot)
        return stand.gap_fraction(plot) + image["red"].mean() + image.index("NDVI").std()

    def numbers(leaf_area: jax.Array) -> jax.Array:
        plot = plot_at(jnp.zeros(5).at[2].set(leaf_area))
        return scene.gap_fraction(plot) + stand_values(scene, plot)["green_leaf_area"]

    x = jnp.array([0.03, 0.01, 0.02, 0.04, 0.01])
    check_grads(jax.jit(seen), (x, jnp.asarray(0.0131)), order=1, eps=1e-6, rtol=1e-5)
    check_grads(jax.jit(numbers), (0.02,), order=2, eps=1e-4, rtol=1e-5)


def test_slopes_by_places_are_those_of_differences() -> None:
    """Of the plants that stand, one by one; those that do not have none."""
    scene = one_species()
    camera = drone(scene, dataclasses.replace(EXACT, tolerance=1e-12), pixel=0.2)

    @eqx.filter_jit
    @jax.value_and_grad
    def bright(foot: jax.Array, scene: Scene) -> jax.Array:
        stand = eqx.tree_at(lambda s: s.planting.foot, scene, foot)
        return camera.observe(stand, scene.parameters)["nir"].mean()

    foot, step = scene.planting.foot, 1e-6
    standing = np.asarray(scene.standing(scene.parameters))
    value, slope = bright(foot, scene)
    assert float(value) == float(reflectance(camera, scene, scene.parameters)[3].mean())
    assert np.abs(slope[standing > 0.0]).max() > 1e-4
    np.testing.assert_array_equal(slope[standing == 0.0], 0.0)
    for plant, axis in ((0, 0), (0, 1), (1, 0)):
        up, down = (bright(foot.at[plant, axis].add(by), scene)[0] for by in (step, -step))
        difference = float(up - down) / (2 * step)
        assert float(slope[plant, axis]) == pytest.approx(difference, rel=1e-5, abs=1e-9)


def test_a_slope_by_covers_alone(plot) -> None:
    """Of gap and structure; in both modes, and of a plot without plants."""
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


def over_plantings(plot, value, slope, plantings=PLANTINGS):
    """Over plantings: a function's values, derivatives by differences, and the slopes taken."""
    steps = np.array([0.28, 0.28, 0.1, 0.1])
    values, differences, slopes = [], [], []
    for seed in range(plantings):
        scene = plot.reordered(seed)
        values.append(float(value(jnp.zeros(4), scene)))
        ends = [[float(value(s * step, scene)) for s in (1, -1)] for step in np.diag(steps)]
        differences.append([(up - down) / (2 * step) for (up, down), step in zip(ends, steps)])
        slopes.append(np.asarray(slope(jnp.zeros(4), scene)))
    return np.array(values), np.array(differences), np.array(slopes)


@pytest.fixture(scope="module")
def expectation(plot):
    gap = lambda x, scene: scene.gap_fraction(scaled(x))  # noqa: E731
    return over_plantings(plot, eqx.filter_jit(gap), eqx.filter_jit(jax.grad(gap)))


def test_the_slope_is_the_derivative_of_the_mean_over_plantings(expectation) -> None:
    """Of whole plants. Height moves no gap seen from straight above."""
    _, differences, slopes = expectation
    for i, kind in enumerate(KINDS[:3]):
        error = np.hypot(*(x[:, i].std() / np.sqrt(PLANTINGS) for x in (slopes, differences)))
        assert abs(slopes[:, i].mean() - differences[:, i].mean()) < 2.0 * error, kind
        # A median has 1.25 times the error of a mean.
        assert abs(np.median(slopes[:, i]) - differences[:, i].mean()) < 2.5 * error, kind
    # Leaf area changes no number: its slope is that of the whole plants but for the last.
    assert slopes[:, 2].mean() == pytest.approx(differences[:, 2].mean(), rel=0.03)
    np.testing.assert_allclose(slopes[:, 3], 0.0, atol=1e-12)


def test_the_slope_varies_less_than_what_one_more_plant_makes(expectation) -> None:
    """Between plantings, because it is that of several plants."""
    _, _, slopes = expectation
    assert slopes[:, 0].std() < 0.35 * abs(slopes[:, 0].mean())


def test_numbers_that_are_rounded_up_have_shares_of_their_planting() -> None:
    """Half a plant more than the real number on average, in whole plants and in expectation."""
    up = small_plot(extent=(1.5, 1.5), rounding="up")
    parameters, real = small_parameters(), np.asarray(up.counts(small_parameters()))
    stands = [up.reordered(seed).expected() for seed in range(200)]
    species = np.asarray(up.planting.species)
    sums = [np.bincount(species, s.standing(parameters), minlength=3) for s in stands]
    assert np.ptp(sums, axis=0).min() > 0.9
    np.testing.assert_allclose(np.mean(sums, axis=0), real + 0.5, atol=4 * 0.29 / 200**0.5)
