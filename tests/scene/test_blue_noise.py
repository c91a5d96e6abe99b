"""Where plants stand: blue noise of the whole plants, spare ones between them, groups."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.scene import Scene, clark_evans_indices, hard_instances, projected_cover
from tests.reference.bridson import bridson

TABLE = [
    {"taxon": "a", "growth_form": "rounded_shrub", "mean_diameter_cm": 20,
     "cover_percent": 12, "height_max_m": 0.5},
    {"taxon": "b", "growth_form": "tussock", "mean_diameter_cm": 15,
     "cover_percent": 9, "height_max_m": 0.4},
]  # fmt: skip


def index(feet: np.ndarray, side: float) -> float:
    """Of Clark and Evans, on a plot that repeats itself: nine copies, without a border."""
    shifts = side * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2)
    every = np.concatenate([feet + shift for shift in shifts])
    near = cKDTree(every).query(feet, k=2)[0][:, 1]
    return float(near.mean() / (0.5 * side / np.sqrt(len(feet))))


def standing(scene: Scene, cover: float = 1.0) -> np.ndarray:
    """Feet of the plants that stand, all species, with so many times the covers."""
    parameters = scene.scaled({"species.*.cover": cover}).parameters
    plants = hard_instances(scene, parameters)
    return np.stack([plants.x, plants.y], axis=1)


@pytest.fixture(scope="module")
def article() -> Scene:
    """The plot burnt in 2006, as the package ships it."""
    plot = read_plot(example_folder() / "plot.toml").replace(size_m=(10.0, 10.0))
    return build_plot(plot.replace(structure_m="even", voxel_m=0.25))[0]


def test_plants_of_the_article_are_blue_noise(article) -> None:
    """As evenly as Bridson's printed steps set as many points, in other plantings too; species
    among each other stand at random."""
    printed = np.mean([index(bridson(1.0, 0.03, 30, seed, True), 1.0) for seed in range(3)])
    for scene in (article, article.realisation(1), article.reordered(1)):
        feet = standing(scene)
        assert len(feet) > 4000
        assert index(feet, 10.0) > 1.6
        assert index(feet, 10.0) == pytest.approx(printed, abs=0.03)
        near = cKDTree(feet, boxsize=10.0).query(feet, k=2)[0][:, 1]
        spacing = np.sqrt(0.615 * 100.0 / len(feet))
        assert near.min() > 0.97 * spacing
    plants = hard_instances(article, article.parameters)
    found = clark_evans_indices(plants, periodic=True)
    assert found[-1] == pytest.approx(index(standing(article), 10.0), rel=1e-6)
    many = plants.counts > 100
    assert np.all((found[:-1][many] > 0.95) & (found[:-1][many] < 1.3))


def test_free_ground_is_that_between_bridsons_points(article) -> None:
    """Discs of the plants' sizes about points of the printed steps, drawn at random for them."""
    plants = hard_instances(article, article.parameters)
    bare = 1.0 - projected_cover(plants, cell=0.02).total
    free = []
    for seed in range(2):
        spacing = 0.998 * np.sqrt(0.6155 * 100.0 / len(plants))
        points = bridson(10.0, spacing, 30, seed, True)
        feet = np.random.default_rng(seed).permutation(points)[: len(plants)]
        x, y = feet.T
        moved = dataclasses.replace(plants, x=x[: len(plants)], y=y[: len(plants)])
        free.append(1.0 - projected_cover(moved, cell=0.02).total)
    assert bare == pytest.approx(np.mean(free), abs=0.015)
    assert bare < 0.11  # at random 0.145


def small(**options) -> Scene:
    given = {"size": 6.0, "voxel": 0.5, "structure": "even", "seed": 4} | options
    return Scene.from_table(given.pop("table", TABLE), **given)


def test_spare_sites_lie_between_those_of_the_whole_plants() -> None:
    """More plants stand nearer than the whole ones, and these stay; fewer leave gaps."""
    scene = small()
    whole, more, fewer = (standing(scene, times) for times in (1.0, 1.5, 0.6))
    for feet in (whole, fewer):
        spacing = np.sqrt(0.615 * 36.0 / len(whole))
        assert cKDTree(feet, boxsize=6.0).query(feet, k=2)[0][:, 1].min() > 0.95 * spacing
    assert cKDTree(more).query(whole)[0].max() == 0.0
    assert cKDTree(whole).query(fewer)[0].max() == 0.0
    near = cKDTree(more, boxsize=6.0).query(more, k=2)[0][:, 1]
    assert 0.6 * spacing < near.min() < 0.95 * spacing
    # Nearly as evenly as a plot that was drawn for so many.
    anew = [row | {"cover_percent": 1.5 * row["cover_percent"]} for row in TABLE]
    assert index(more, 6.0) > 1.45
    assert index(standing(small(table=anew)), 6.0) > 1.6
    # The number of sites held ready does not move the plants.
    lots = np.asarray(scene.planting.lot)
    assert lots.min() == 0
    np.testing.assert_array_equal(np.sort(np.unique(lots)), np.arange(5))


def test_stated_spacing_and_attempts() -> None:
    scene = small(spacing_m=0.1)
    feet = standing(scene)
    assert cKDTree(feet, boxsize=6.0).query(feet, k=2)[0][:, 1].min() >= 0.1 - 1e-6
    assert 1.0 < index(feet, 6.0) < index(standing(small()), 6.0) - 0.1
    few = small(attempts=2)
    assert len(standing(few)) == len(standing(small()))
    assert index(standing(few), 6.0) < 1.62 < index(standing(small()), 6.0)
    with pytest.raises(
        InputError, match=r"0\.5 m apart there are \d+: take a spacing \(`spacing_m`\) of at most"
    ):
        small(spacing_m=0.5)


def test_the_same_seed_sets_the_same_plants() -> None:
    one, two, other = (small(seed=seed).planting.foot for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, two)
    assert cKDTree(one).query(other)[0].min() > 0.0


def test_plants_stand_in_groups_where_they_do() -> None:
    rows = [TABLE[0] | {"clumping_m": 0.8}, TABLE[1]]
    rows[0]["cover_percent"] = 6
    even, groups = (
        small(size=12.0, table=[TABLE[0] | {"cover_percent": 6}, TABLE[1]]),
        small(size=12.0, table=rows),
    )
    for scene in (groups, groups.realisation(1), groups.reordered(1)):
        plants = hard_instances(scene, scene.parameters)
        first, second, every = clark_evans_indices(plants, periodic=True)
        before = clark_evans_indices(hard_instances(even, even.parameters), periodic=True)
        assert first < 0.85 * before[0]
        assert second == pytest.approx(before[1], abs=0.12)
        assert every > 1.6  # the sites are as before
    assert plants.counts.tolist() == hard_instances(even, even.parameters).counts.tolist()
    # Within 80 cm of a plant there are more of its species than elsewhere.
    pairs = []
    for scene in (even, groups):
        feet = np.asarray(scene.planting.foot)[np.asarray(scene.planting.species) == 0]
        feet = feet[: int(scene.counts(scene.parameters)[0])]
        tree = cKDTree(feet, boxsize=12.0)
        pairs.append(tree.count_neighbors(tree, 0.8) / len(feet))
    assert pairs[1] > 1.3 * pairs[0]
    assert "Clark-Evans index" in str(groups)


def test_covers_of_groups_are_those_that_are_asked() -> None:
    """Counted on a grid, in the mean over plantings."""
    rows = [TABLE[0] | {"clumping_m": 0.8, "cover_percent": 15}, TABLE[1] | {"cover_percent": 40}]
    scene = small(size=8.0, table=rows)
    plantings = [scene.realisation(number) for number in range(6)]
    covered = [
        projected_cover(hard_instances(s, s.parameters), cell=0.02).species for s in plantings
    ]
    np.testing.assert_allclose(np.mean(covered, axis=0), [0.15, 0.4], rtol=0.03)
    fewer = np.asarray(small(size=8.0, table=[rows[0] | {"clumping_m": 0}, rows[1]]).whole)
    assert scene.whole[0] > 1.02 * fewer[0]  # since crowns overlap more


def test_one_more_plant_is_nearly_what_it_is_where_all_stand_anew() -> None:
    """Free ground of covers 15 % up: at spare sites, and of plots drawn for them."""
    rows = [row | {"cover_percent": 3.0 * row["cover_percent"]} for row in TABLE]
    options = {"cover_definition": "article"}
    anew = [row | {"cover_percent": 1.15 * row["cover_percent"]} for row in rows]
    bare = lambda scene, times: (  # noqa: E731
        1.0
        - projected_cover(
            hard_instances(scene, scene.scaled({"species.*.cover": times}).parameters), cell=0.02
        ).total
    )
    seeds = range(4)
    here = np.mean([bare(small(table=rows, seed=s, **options), 1.0) for s in seeds])
    spare = np.mean([bare(small(table=rows, seed=s, **options), 1.15) for s in seeds])
    drawn = np.mean([bare(small(table=anew, seed=s, **options), 1.0) for s in seeds])
    assert (spare - here) / (drawn - here) == pytest.approx(1.0, abs=0.2)


def test_no_plants_and_single_ones_have_sites() -> None:
    for cover in (0.0, 1.5):
        rows = [TABLE[0] | {"cover_percent": cover}, TABLE[1] | {"cover_percent": 0.0}]
        scene = small(size=2.0, table=rows)
        assert np.all(np.isfinite(np.asarray(scene.planting.foot)))
        assert bool(jnp.all(scene.planting.foot < 2.0))
        assert str(scene)


def test_a_scene_is_said_with_feet_that_moved_or_have_slopes():
    """Over the border of a plot that repeats itself, and inside a derivative."""
    scene = Scene.from_table([TABLE[0]], size=1.0, voxel=0.25, structure="even", seed=1)
    beyond = eqx.tree_at(lambda s: s.planting.foot, scene, scene.planting.foot - 0.3)
    assert str(beyond).split("index")[-1] == str(scene).split("index")[-1]
    said = []

    def total(foot):
        said.append(str(eqx.tree_at(lambda s: s.planting.foot, scene, foot)))
        return foot.sum()

    jax.grad(total)(scene.planting.foot)
    assert said[0].startswith("A plot of 1 m x 1 m")


def test_a_spacing_wider_than_a_plot_that_repeats_itself_is_refused_by_name():
    with pytest.raises(InputError, match=r"at most 0\.5 m apart.*`spacing_m`\) of 5 m"):
        Scene.from_table(TABLE, size=1.0, voxel=0.25, structure="even", spacing_m=5.0)
