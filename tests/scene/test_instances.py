"""The plants that stand: counts of eq. (10), places and sizes, and cover in closed form."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest, spearmanr, uniform

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.canopy import table1_2006
from fynjax.scene import Instances, hard_instances, hard_scene, height_profile, projected_cover
from fynjax.scene._planting import INDIVIDUALS
from tests.scene.plots import densities, small_parameters, small_plot

PLOT = read_plot(example_folder() / "plot.toml").replace(structure_m="even")
TABLE = table1_2006()


def discs(
    x: list[float], y: list[float], diameter: list[float], height: list[float], species: list[int]
) -> Instances:
    """Upright plants on 4 m x 4 m."""
    places = [np.array(values, float) for values in (x, y)]
    none = np.zeros(len(x))
    return Instances(
        ("a", "b", "c"), (4.0, 4.0), np.array(species), *places, none, none, none,
        np.array(diameter, float), np.array(height, float),
    )  # fmt: skip


def test_wide_plants_are_tall_and_heights_lie_evenly() -> None:
    """Rank correlation of a Gaussian copula, 6/pi asin(r/2), in plants of all sizes of a species;
    heights that lie evenly whatever it is; and not the same order in every species."""
    planting = build_plot(PLOT)[0].planting
    size, stature = np.asarray(planting.size), np.asarray(planting.stature)
    first, other = (np.flatnonzero(np.asarray(planting.species) == i)[:300] for i in (0, 12))
    mine = np.asarray(planting.species) == 0
    assert mine.sum() > 2000
    ranks = 6.0 / np.pi * np.arcsin(0.6 / 2.0)
    assert spearmanr(size[mine], stature[mine])[0] == pytest.approx(ranks, abs=0.04)
    assert kstest(stature[mine], uniform(0.6, 0.4).cdf).pvalue > 0.01
    assert abs(spearmanr(size[first], stature[other])[0]) < 0.2


def test_counts_are_those_of_equation_10_for_any_seed() -> None:
    """Table 1 with half of every living crown over others, 10 m x 10 m, counted by hand."""
    crown = np.pi / 4.0 * (TABLE.mean_diameter_cm.to_numpy() / 100.0) ** 2
    packing = np.where(TABLE.growth_form == "deadwood", 0.0, 0.5)
    wanted = np.ceil(TABLE.cover_percent.to_numpy() / ((1.0 - packing) * crown)).astype(int)
    cover = []
    for seed in range(4):
        model, parameters = build_plot(PLOT, seed=seed)
        instances = hard_instances(model, parameters)
        assert instances.counts.tolist() == wanted.tolist()
        measured = projected_cover(instances, cell=0.01)
        cover.append(measured.crowns * (1.0 - packing))
        assert measured.total == pytest.approx(measured.visible.sum(), abs=1e-12)
        assert np.all(measured.visible <= measured.species + 1e-12)
        assert np.all(measured.species <= measured.crowns + 1e-12)
        # Plants keep apart, so more ground has a crown over it than under a Boolean model.
        random = 1.0 - np.exp(-measured.crowns.sum())
        assert random + 0.03 < measured.total < random + 0.1
    # Crown areas vary by 0.4 about their mean, so a species' cover by 0.4 / sqrt(n); mean of four.
    share = TABLE.cover_percent.to_numpy() / 100.0
    scatter = share * (4.5 * 0.4 / np.sqrt(4.0 * wanted) + 1.0 / wanted)
    assert np.all(np.abs(np.mean(cover, axis=0) - share) < scatter)


def test_a_plot_of_another_side_has_the_counts_of_its_area() -> None:
    plot = PLOT.replace(size_m=(5.0, 5.0))
    model, parameters = build_plot(plot)
    crown = np.pi / 4.0 * plot.diameter_m**2
    packing = np.array([species.packing for species in plot.species])
    wanted = np.ceil(25.0 * plot.cover / (crown * (1.0 - packing)))
    assert hard_instances(model, parameters).counts.tolist() == wanted.tolist()


@pytest.mark.parametrize("seed", [0, 5])
def test_the_hard_scene_has_the_area_that_sensors_see(seed: int) -> None:
    parameters = small_parameters()
    model = small_plot(rotation_spread=[8.0, 0.0, 20.0])
    if seed:
        model = model.reordered(seed)
    hard = hard_scene(model, parameters)
    seen, whole = (np.asarray(densities(m, parameters)) for m in (model, hard))
    np.testing.assert_allclose(whole, seen, rtol=1e-12, atol=1e-12)
    assert len(hard.planting.plant) < 0.6 * len(model.planting.plant)

    # And of the instances' own sizes: leaf area of each species, in closed form.
    instances = hard_instances(model, parameters)
    crown = np.bincount(instances.species, np.pi / 4.0 * instances.diameter**2)
    every = crown.sum() / 1.6**2
    each = np.pi / 4.0 * instances.diameter**2 / 1.6**2
    crown *= (1.0 - np.prod(1.0 - each)) / every  # those seen from above, at random
    own = parameters.species
    leaf = crown * np.asarray(own.leaf_area_index * (1.0 - own.shoot_clumping))
    found = whole.sum(axis=(1, 2, 3)) * model.grid.voxel_volume
    np.testing.assert_allclose(found[:2], leaf[:2], rtol=1e-5)
    assert found[2] == pytest.approx(crown @ np.asarray(own.wood_area_index), rel=1e-5)
    profile = height_profile(hard, parameters, np.linspace(0.0, 1.0, 6))
    areas = profile.sum(axis=-1) * 0.2 * 1.6**2
    np.testing.assert_allclose(areas[0, :2], leaf[:2], rtol=1e-9)
    np.testing.assert_allclose(areas[1], crown * np.asarray(own.wood_area_index), rtol=1e-9)


def test_instances_are_the_plants_of_the_planting() -> None:
    """Places, turns and sizes against the elements that the scene deposits."""
    parameters, model = small_parameters(), small_plot(rotation_spread=[8.0, 5.0, 20.0])
    instances, planting = hard_instances(model, parameters), model.planting
    across, along = planting.unit_shapes()
    plants = [
        np.flatnonzero(np.asarray(planting.species) == one)[:count]
        for one, count in enumerate(instances.counts)
    ]
    for number, plant in enumerate(np.concatenate(plants)):
        mine = np.asarray(planting.plant) == plant
        if number % 7:
            continue
        element = (
            np.pad(planting.foot, ((0, 0), (0, 1)))[np.asarray(planting.plant)]
            + instances.diameter[number] * np.asarray(across)
            + instances.height[number] * np.asarray(along)
        )[mine]
        own = np.asarray(planting.shapes.position)[np.asarray(planting.part)[mine]]
        turn, lean = np.deg2rad(instances.azimuth[number]), np.deg2rad(instances.tilt[number])
        ahead = np.array([np.sin(turn), np.cos(turn), 0.0])
        right = np.array([np.cos(turn), -np.sin(turn), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        axis = np.cos(lean) * up + np.sin(lean) * ahead
        front = np.cos(lean) * ahead - np.sin(lean) * up
        expected = (
            np.array([instances.x[number], instances.y[number], 0.0])
            + instances.diameter[number] * (own[:, :1] * right + own[:, 1:2] * front)
            + instances.height[number] * own[:, 2:] * axis
        )
        np.testing.assert_allclose(element, expected, atol=1e-12)


def test_more_plants_than_sites_are_refused_with_numbers() -> None:
    model, parameters = small_plot(), small_parameters()
    more = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.array([0.9, 0.15, 0.06]))
    with pytest.raises(InputError, match=r"'Erica irregularis' is to have \d+ plants, but \d+"):
        hard_instances(model, more)


def test_a_plot_without_plants() -> None:
    parameters = small_parameters()
    bare = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.zeros(3))
    model = small_plot()
    instances = hard_instances(model, bare)
    assert len(instances) == 0
    cover = projected_cover(instances, cell=0.1)
    assert cover.total == 0.0
    assert np.all(np.asarray(hard_scene(model, bare).area_density(bare)) == 0.0)


def lens(radius: float, distance: float) -> float:
    """Area that two discs share."""
    half = distance / (2.0 * radius)
    return 2.0 * radius**2 * (np.arccos(half) - half * np.sqrt(1.0 - half**2))


def test_two_discs_overlap_in_a_lens() -> None:
    """The taller one is seen whole; of one species, the lens counts once."""
    disc, shared = np.pi * 0.5**2, lens(0.5, 0.6)
    pair = {"x": [1.7, 2.3], "y": [2.0, 2.0], "diameter": [1.0, 1.0], "height": [1.0, 2.0]}
    two = projected_cover(discs(**pair, species=[0, 1]), cell=0.005)
    area = 16.0
    np.testing.assert_allclose(two.crowns * area, [disc, disc, 0.0], rtol=2e-3)
    np.testing.assert_allclose(two.species * area, [disc, disc, 0.0], rtol=2e-3)
    np.testing.assert_allclose(two.visible * area, [disc - shared, disc, 0.0], rtol=4e-3)
    assert two.total * area == pytest.approx(2 * disc - shared, rel=2e-3)
    one = projected_cover(discs(**pair, species=[2, 2]), cell=0.005)
    np.testing.assert_allclose(one.crowns * area, [0, 0, 2 * disc], rtol=2e-3)
    np.testing.assert_allclose(one.species * area, [0, 0, 2 * disc - shared], rtol=2e-3)
    assert set(np.unique(two.top)) == {-1, 0, 1}


def test_crowns_at_the_border_and_crowns_that_lean() -> None:
    corner = discs([0.1], [3.9], [1.0], [1.0], [0])
    disc = np.pi * 0.25 / 16.0
    around = projected_cover(corner, cell=0.005)
    assert around.total == pytest.approx(disc, rel=2e-3)
    assert around.top[0, -1] == 0  # it came in at the other corner
    open_border = projected_cover(corner, cell=0.005, periodic=False)
    assert open_border.crowns[0] == pytest.approx(disc, rel=2e-3)
    assert open_border.total < 0.6 * disc
    assert open_border.top[0, -1] == -1

    leaning = dataclasses.replace(
        discs([2.0], [2.0], [0.2], [1.0], [0]), tilt=np.array([30.0]), azimuth=np.array([90.0])
    )
    row, column = np.nonzero(projected_cover(leaning, cell=0.01).top >= 0)
    assert (column.mean() + 0.5) * 0.01 == pytest.approx(2.25, abs=0.005)
    assert (row.mean() + 0.5) * 0.01 == pytest.approx(2.0, abs=0.005)


def test_random_discs_cover_as_the_boolean_model_says() -> None:
    """Ground left bare is exp(-sum of the discs' areas over the plot's) (Matheron 1975)."""
    rng = np.random.default_rng(3)
    bare, full = [], []
    for _ in range(20):
        n = 300
        random = discs(
            rng.uniform(0, 4, n), rng.uniform(0, 4, n), rng.uniform(0.1, 0.4, n),
            rng.uniform(0.2, 2, n), rng.integers(0, 3, n),
        )  # fmt: skip
        found = projected_cover(random, cell=0.01)
        bare.append(1.0 - found.total)
        full.append(found.crowns.sum())
        exact = np.pi / 4.0 * np.sum(random.diameter**2) / 16.0
        assert full[-1] == pytest.approx(exact, rel=1e-3)
    error = np.std(bare) / np.sqrt(len(bare))
    assert np.mean(bare) == pytest.approx(np.exp(-np.mean(full)), abs=4 * error)
    assert error < 0.01


@pytest.mark.parametrize(
    ("cell", "word"), [(0.0, "positive"), (0.3, "divide"), (1e-4, "coarser"), (np.nan, "positive")]
)
def test_bad_cells(cell: float, word: str) -> None:
    with pytest.raises(InputError, match=word):
        projected_cover(discs([1.0], [1.0], [1.0], [1.0], [0]), cell=cell)


def test_plants_of_a_species_have_one_of_a_few_shapes_each() -> None:
    """And each carries all of its organs' area, whichever shape it has."""
    planting = small_plot().planting
    plant, part = np.asarray(planting.plant), np.asarray(planting.part)
    species, organ = np.asarray(planting.species), np.asarray(planting.organ)
    first = part[np.searchsorted(plant, np.arange(len(species)))]
    for one in range(3):
        mine = first[species == one]
        assert len(set(mine)) == min(len(mine), INDIVIDUALS)
    sums = np.zeros((len(species), 3))
    np.add.at(sums, (plant, organ), np.asarray(planting.fraction, float))
    np.testing.assert_allclose(sums[sums > 0], 1.0, rtol=1e-6)
