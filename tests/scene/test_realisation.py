"""Realisations of a scene: other plants of the same plot, by the recipe that the scene keeps."""

import ast
import dataclasses
from collections import Counter
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax
from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot, plot_problem
from fynjax.app.io.plot import read_plot
from fynjax.canopy import Organ, PlantModel
from fynjax.scene import (
    Ground,
    PlantingRules,
    Recipe,
    Scene,
    build_scene,
    element_count,
    hard_counts,
    hard_scene,
)
from tests.io.test_crowns import CROWNS, write
from tests.scene.plots import small_parameters, small_plot
from tests.small import write_plot

TABLE = [
    {"taxon": "Erica", "growth_form": "rounded_shrub", "mean_diameter_cm": 40.0,
     "cover_percent": 30.0, "height_max_m": 0.6},
    {"taxon": "Restio", "growth_form": "tussock", "mean_diameter_cm": 25.0,
     "cover_percent": 15.0, "height_max_m": 0.5},
]  # fmt: skip
WEST = np.repeat([[255, 255, 40, 0]], 4, axis=0).astype(np.uint8)
HILL = np.tile(np.linspace(0.0, 0.4, 16), (16, 1))


def ball(seed: int = 0, count: int = 60) -> PlantModel:
    """A given shape: leaves on a ball."""
    normal = np.random.default_rng(seed).normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    place = 0.5 * normal + np.array([0.0, 0.0, 0.5])
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    leaf = jnp.full(count, int(Organ.LEAF))
    return PlantModel(jnp.asarray(place), jnp.full(count, 1.0 / count), jnp.asarray(normal), leaf)


SHAPES = (ball(), None, None)
PLOTS = {
    "mesh": {"plants": SHAPES, "voxel": 0.16, "structure": None},
    "map": {"probability": WEST},
    "projected covers on a map, open": {
        "probability": WEST, "cover_definition": "projected", "boundary": "open"
    },
    "terrain": {"terrain": HILL, "boundary": "open"},
    "patches of ground": {"ground": Ground(patch=0.4)},
    "eq. (10)": {"rounding": "up"},
    "room for each species": {"room": np.array([4.0, 2.5, 7.0])},
    "flowers": {"flowering": 0.5, "softness": 0.0, "softness_plants": 0.0},
}  # fmt: skip


def from_table(**options):
    return Scene.from_table(TABLE, **{"size": 1.2, "seed": 5} | options)


def check_alike(scene, other):
    """Two plantings of one plot: other feet, and all else that follows from the recipe."""
    one, two = scene.planting, other.planting
    assert jax.tree.map(np.shape, one) == jax.tree.map(np.shape, two)
    assert not np.isin(np.asarray(one.foot), np.asarray(two.foot)).any()
    np.testing.assert_array_equal(one.count, two.count)
    assert scene.recipe is other.recipe


@pytest.mark.parametrize(
    ("voxel", "structure", "variation"),
    [
        (0.06, None, 0.0), (0.1, "even", PlantingRules.size_variation), (0.125, "even", 0.5),
        (0.15, None, PlantingRules.size_variation), (0.2, None, 0.5), (0.25, "even", 0.0),
    ],
)  # fmt: skip
def test_realisation_0_is_the_scene_to_the_bit(voxel, structure, variation):
    size = voxel * round(1.2 / voxel)
    scene = from_table(size=size, voxel=voxel, structure=structure, size_variation=variation)
    assert bool(eqx.tree_equal(scene.realisation(0), scene))
    other = scene.realisation(2)
    check_alike(scene, other)
    assert bool(eqx.tree_equal(scene.realisation(2), other))
    assert bool(eqx.tree_equal(other.realisation(0), other))


@pytest.mark.parametrize("name", PLOTS)
def test_every_plot_has_realisations(name, monkeypatch):
    options = {"dtype": "float32"} | PLOTS[name]
    if options.get("cover_definition") == "projected":  # which know no packing and no fill
        whole = lambda p: (p.species.packing, p.species.fill)  # noqa: E731
        own = eqx.tree_at(whole, small_parameters(), (jnp.zeros(3), jnp.ones(3)))
        monkeypatch.setattr("tests.scene.plots.small_parameters", lambda: own)
    scene = small_plot(**options)
    assert bool(eqx.tree_equal(scene.realisation(0), scene))
    other = scene.realisation(1)
    check_alike(scene, other)
    if "probability" in PLOTS[name]:
        assert np.asarray(other.planting.foot)[:, 0].max() < 1.2  # nobody where nobody may be
    if "plants" in PLOTS[name]:  # a plant of the shape that was given
        first = other.planting.shapes.position[: len(ball().organ)]
        np.testing.assert_allclose(first, ball().position, rtol=1e-6)
    if "terrain" in PLOTS[name]:
        np.testing.assert_array_equal(other.terrain, HILL)
    patched = scene.ground.patches is not None
    assert patched == (name == "patches of ground")
    if patched:
        assert np.abs(np.log(other.ground.patches / scene.ground.patches)).mean() > 0.5


def test_a_tuft_as_stated_decides_the_elements():
    """The tuft that goes with voxels of 15 cm is none that goes with their structure."""
    scene = small_plot(extent=(1.5, 1.5), voxel=0.15, structure=None, tuft=0.09, dtype="float32")
    assert scene.tuft != scene.rules.tuft == 0.09
    count = np.asarray(scene.realisation(4).planting.count)
    assert count.max() == element_count(0.41, 0.67, 0.09, structured=True)


def test_the_image_of_realisation_0_is_that_of_the_scene():
    scene = from_table(voxel=0.15, structure="even", size_variation=0.0)
    seen = [fynjax.observe(one, "mavic_3m", pixel=0.3) for one in (scene, scene.realisation(0))]
    np.testing.assert_array_equal(*(one.reflectance for one in seen))


def test_plots_from_files_have_realisations_and_known_plants_stay(tmp_path):
    more = "[scene]\nsize_variation = 0.5\n[ground]\npatch_m = 0.5\nlitter_fraction = 0.3\n"
    plot = read_plot(write_plot(tmp_path, more))
    scene, _ = build_plot(plot, rounding="random")
    assert scene.rules.size_variation == plot.size_variation == 0.5
    assert bool(eqx.tree_equal(scene.realisation(0), scene))
    check_alike(scene, scene.realisation(1))
    wide = plot.calibration.replace(free=("*.diameter",), priors={"*": 0.5})
    ready = plot_problem(plot.replace(calibration=wide), None, seed=3)
    assert np.max(ready.scene.rules.room) > PlantingRules.room  # the prior's sites
    assert bool(eqx.tree_equal(ready.scene.realisation(0), ready.scene))
    check_alike(ready.scene, ready.scene.realisation(1))
    known, _ = build_plot(read_plot(write(tmp_path, CROWNS)))
    assert known.realisation(0) is known
    assert known.realisation(3) is known


def test_plantings_have_the_law_that_is_stated():
    """Spread of the crowns, number of plants, and places over all of the plot."""
    for variation in (0.0, 0.5):
        scene = from_table(size=3.0, structure="even", voxel=0.25, size_variation=variation)
        plantings = [scene.realisation(i) for i in range(6)]
        spread = []
        for one in plantings:
            for kind in (0, 1):
                size = np.asarray(one.planting.size)[np.asarray(one.planting.species) == kind]
                assert np.mean(size**2) == pytest.approx(1.0, rel=1e-4)
                spread.append(np.std(size) / np.mean(size))
        assert np.mean(spread) == pytest.approx(variation, rel=0.05, abs=1e-5)
        feet = np.concatenate([np.asarray(one.planting.foot) for one in plantings])
        np.testing.assert_allclose(feet.mean(axis=0), 1.5, atol=0.1)
    numbers = [hard_counts(scene.realisation(i), scene.parameters) for i in range(24)]
    real = np.asarray(scene.counts(scene.parameters))
    error = np.sqrt(real % 1.0 * (1.0 - real % 1.0) / 24)
    assert np.all(np.abs(np.mean(numbers, axis=0) - real) < 3 * error)


def test_other_parameters_leave_the_recipe_as_it_is():
    """More cover finds sites where they are asked for, beside those that there were."""
    scene = from_table(structure="even", voxel=0.2)
    more = scene.scaled({"species.*.cover": 3.0, "species.*.height": 0.5})
    assert bool(eqx.tree_equal(more.realisation(0), more))
    counts = np.asarray(more.counts(more.parameters))
    grown = more.realisation(0, counts)
    assert (np.bincount(grown.planting.species) >= counts).all()
    feet = {tuple(foot) for foot in np.asarray(grown.planting.foot).tolist()}
    assert {tuple(foot) for foot in np.asarray(scene.planting.foot).tolist()} < feet
    assert bool(eqx.tree_equal(grown.realisation(0), grown))
    assert grown.realisation(0, counts).recipe is grown.recipe


def test_forms_with_other_plants_than_were_drawn_are_refused():
    scene = from_table(structure="even", voxel=0.2)
    for form in (scene.padded(), hard_scene(scene, scene.parameters)):
        with pytest.raises(InputError, match="take a realisation of the scene itself"):
            form.realisation(1)
    with pytest.raises(InputError, match="`planted` must be known, but is traced"):
        eqx.filter_jit(lambda scene: scene.realisation(1).planting.foot)(scene)


def test_sites_beyond_the_memory_are_refused(monkeypatch):
    scene = from_table(structure="even", voxel=0.2)
    monkeypatch.setattr("fynjax.scene._planting.total_memory", lambda: 2**20)
    with pytest.raises(InputError, match=r"need about \d+ GiB of memory"):
        scene.realisation(0, 1e4 * np.ones(2))


@pytest.mark.parametrize("plants", [None, SHAPES])
def test_realisations_share_compiled_programs(plants):
    """And scenes of other seeds and leaves do: a recipe is compared by its content, and is no
    argument of a program."""
    scene, compiled = small_plot(plants=plants, probability=WEST, dtype="float32"), []

    @eqx.filter_jit
    def area(scene, parameters):
        compiled.append(scene)
        return scene.area_density(parameters).sum()

    parameters = small_parameters()
    again = small_plot(
        plants=None if plants is None else (ball(), None, None), probability=WEST.copy(),
        dtype="float32", seed=8,
    )  # fmt: skip
    for one in (scene, scene.realisation(1), scene.realisation(2), scene.reordered(3), again):
        area(one, parameters)
    assert len(compiled) == 1
    assert again.recipe == scene.recipe
    assert hash(again.recipe) == hash(scene.recipe)
    held = {id(leaf) for leaf in jax.tree.leaves(scene)}
    for leaf in jax.tree.leaves((scene.recipe.plants, scene.rules.probability)):
        assert id(leaf) not in held


def test_recipes_of_other_content_differ():
    recipe = small_plot(plants=SHAPES).recipe
    others = [
        Recipe(dataclasses.replace(recipe.rules, **change), recipe.plants, recipe.extent)
        for change in (
            {"size_variation": 0.3}, {"tuft": 0.06}, {"room": 3.0}, {"flowering": 0.1},
            {"structure": 0.05}, {"softness": 0.2}, {"softness_plants": 2.0},
            {"rounding": "up"}, {"cover_definition": "projected"}, {"probability": WEST},
            {"spacing": 0.2}, {"attempts": 10},
        )
    ]  # fmt: skip
    others.append(Recipe(recipe.rules, (ball(seed=1), None, None), recipe.extent))
    others.append(Recipe(recipe.rules, recipe.plants, (1.6, 1.7)))
    assert len({recipe, *others}) == len(others) + 1


def test_forms_that_are_built_alike_are_one_scene():
    """`build_scene` is the road of all: the same arguments, the same scene."""
    scene = small_plot(plants=SHAPES, dtype="float32")
    again = build_scene(
        scene.species, small_parameters(), extent=(1.6, 1.6), voxel=0.1, seed=3,
        rules=PlantingRules(structure="even"), plants=SHAPES,
    )  # fmt: skip
    assert bool(eqx.tree_equal(again.planting, scene.planting))
    # A key, and a static argument.
    thin = scene.with_values({"species.*.cover": 0.01})
    assert hash(again) == hash(scene)
    assert len({scene, again, thin}) == 2
    count = jax.jit(lambda s: s.counts(s.parameters).sum(), static_argnums=0)
    assert float(count(thin)) < float(count(scene))


KEYS = {"structure": "structure_m", "spacing": "spacing_m", "probability": "probability_map"}
"""Rules of planting with another name in a plot file."""
DECLARED = {
    "room": 1, "flowering": 1, "rounding": 2, "softness": 2, "softness_plants": 2, "tuft": 2,
    "size_variation": 2, "probability": 2, "structure": 2, "cover_definition": 3, "spacing": 3,
    "attempts": 2,
}  # fmt: skip
"""Records of a scene and of its files that declare a rule of planting. `Plot` says besides which
definition of cover holds where its file says none; `Scene.rounding` are the numbers that the rule
drew, `Scene.spacing` is that of the sites of the whole plants, `Scene.tuft` the one that goes with
the voxels."""


def test_a_rule_of_planting_is_declared_twice_at_most():
    """By the record that reads it from a file, and by `PlantingRules`. Fewer: lower `DECLARED`."""
    root, found = Path(fynjax.__file__).parent, Counter()
    scene = (root / "scene" / name for name in ("_scene.py", "_planting.py"))
    for path in (*scene, *(root / "app" / "io" / "plot").glob("*.py")):
        for record in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(record, ast.ClassDef):
                lines = (one for one in record.body if isinstance(one, ast.AnnAssign))
                found.update(one.target.id for one in lines if isinstance(one.target, ast.Name))
    rules = [field.name for field in dataclasses.fields(PlantingRules)]
    assert {name: found[name] + found[KEYS.get(name, "")] for name in rules} == DECLARED
