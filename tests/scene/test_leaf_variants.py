"""Several leaves among the plants of a species."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import read_plot
from fynjax.canopy import table1_2006
from fynjax.errors import InputError
from fynjax.leaf import fit_leaf_groups
from fynjax.scene import (
    LEAF_FIELDS,
    PARAMETERS,
    USUAL_LEAF,
    Crowns,
    PlotParameters,
    Scene,
    SpeciesRow,
    drawn_leaves,
    hard_instances,
    leaf_classes,
    named_values,
    species_rows,
    truth_of_pixels,
)
from fynjax.scene._optics import _leaves
from fynjax.scene._planting import _drawn_leaves
from fynjax.sensors import shipped_sensor
from tests.scene.plots import ruled
from tests.small import write_plot

from .plots import drone, render, small_parameters, small_plot

BANDS = shipped_sensor("mavic_3m").bands
RATIOS = np.ones((3, len(LEAF_FIELDS)))
RATIOS[:, LEAF_FIELDS.index("chlorophyll")] = 0.5, 1.2, 1.3
RATIOS[:, LEAF_FIELDS.index("dry_matter")] = 1.4, 0.7, 0.9


def varied(
    ratios: np.ndarray = RATIOS, seed: int = 5, **changes: Any
) -> tuple[Scene, PlotParameters]:
    """The small plot whose first species has three leaves, one of them drawn for each plant."""
    scene, parameters = small_plot(**changes), small_parameters()
    first = dataclasses.replace(scene.species[0], leaf_ratios=jnp.asarray(ratios))
    owner = np.asarray(scene.planting.species)
    leaf = np.where(owner == 0, np.random.default_rng(seed).integers(3, size=len(owner)), 0)
    # Classes of all further organs come after those of the two leaves more.
    kind = scene.planting.shape_class
    planting = dataclasses.replace(
        scene.planting,
        leaf=jnp.asarray(leaf, jnp.int32),
        shape_class=jnp.where(kind > 0, kind + 2, 0),
    )
    scene = dataclasses.replace(scene, planting=planting, species=(first, *scene.species[1:]))
    return scene, with_spread(parameters, 1.0)


def with_spread(parameters: PlotParameters, spread: Any) -> PlotParameters:
    spreads = jnp.ones(3).at[0].set(spread)
    species = dataclasses.replace(parameters.species, leaf_spread=spreads)
    return dataclasses.replace(parameters, species=species)


def test_one_leaf_a_species_is_the_default_and_adds_no_parameter():
    scene = Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.5)
    assert scene.planting.leaf is None
    assert scene.parameters.species.leaf_spread is None
    assert not any("leaf_spread" in name for name in named_values(scene.parameters, scene.taxa))
    assert hard_instances(scene, scene.parameters).leaf is None


def test_leaves_that_are_alike_make_the_image_of_one():
    scene, parameters = varied(np.ones_like(RATIOS))
    one = render(small_plot(), small_parameters())
    np.testing.assert_allclose(render(scene, parameters), one, rtol=1e-9)
    scene, parameters = varied()
    np.testing.assert_allclose(render(scene, with_spread(parameters, 0.0)), one, rtol=1e-9)
    assert float(jnp.abs(render(scene, parameters) / one - 1.0).max()) > 0.01


def test_traits_stay_within_their_bounds():
    """A spread of leaves may ask for more than a leaf can have, and for less."""
    for factor, end in ((1e3, "upper"), (-1e3, "lower")):
        scene, parameters = varied(np.full_like(RATIOS, factor))
        leaves, _, _ = _leaves(scene.species, parameters, np.array([0, 0, 0, 1, 2]), jnp.float64)
        for name in LEAF_FIELDS:
            bound = getattr(PARAMETERS[name], end)
            np.testing.assert_allclose(getattr(leaves, name)[:3], bound, rtol=1e-6)


def test_the_names_of_leaves_do_not_matter_but_whose_they_are_does():
    scene, parameters = varied()
    turn, leaf = np.array([2, 0, 1]), np.asarray(scene.planting.leaf)
    renamed = np.where(scene.planting.species == 0, np.argsort(turn)[leaf], leaf)
    again = eqx.tree_at(
        lambda s: (s.species[0].leaf_ratios, s.planting.leaf),
        scene,
        (jnp.asarray(RATIOS[turn]), jnp.asarray(renamed, jnp.int32)),
    )
    image = render(scene, parameters)
    np.testing.assert_allclose(render(again, parameters), image, rtol=1e-12)
    others, _ = varied(seed=6)
    assert float(jnp.abs(render(others, parameters) / image - 1.0).max()) > 0.01


def test_thin_plants_of_several_leaves_are_the_mixture_of_plants_of_each():
    """Where leaves hardly shade each other what they add to the image is the sum over plants."""
    scene, parameters = varied()
    species = parameters.species
    thin = dataclasses.replace(
        species,
        leaf_area_index=jnp.asarray([2e-3, 0.0, 0.0]),
        wood_area_index=jnp.zeros(3),
        shoot_clumping=jnp.zeros(3),
    )
    parameters = dataclasses.replace(parameters, species=thin)
    image = lambda scene: render(scene, parameters).mean(axis=(1, 2))  # noqa: E731
    crowns = scene.crown_areas(parameters) * (scene.planting.species == 0)
    share = jnp.bincount(scene.planting.leaf, crowns, length=3) / crowns.sum()
    assert float(share.min()) > 0.05
    mine = scene.planting.species == 0
    alone = [
        image(eqx.tree_at(lambda s: s.planting.leaf, scene, jnp.where(mine, jnp.int32(k), 0)))
        for k in range(3)
    ]
    none = dataclasses.replace(thin, leaf_area_index=jnp.zeros(3))
    bare = render(scene, dataclasses.replace(parameters, species=none)).mean(axis=(1, 2))
    added = image(scene) - bare
    mixture = share @ (jnp.stack(alone) - bare)
    each = (jnp.stack(alone) - bare)[:, 3]
    assert float(each.max() - each.min()) > 0.05 * float(jnp.abs(each).max())  # they differ
    np.testing.assert_allclose(added, mixture, rtol=0.03)


def test_slope_by_the_spread_of_leaves_is_a_difference():
    scene, parameters = varied()
    exact = ruled(scene, softness=0.0, softness_plants=0.0)

    def spread_of_image(scene, spread):
        return jnp.std(render(scene, with_spread(parameters, spread)), axis=(1, 2))

    slope = jax.jvp(lambda spread: spread_of_image(exact, spread), (1.0,), (1.0,))[1]
    difference = (spread_of_image(scene, 1.02) - spread_of_image(scene, 0.98)) / 0.04
    assert float(jnp.abs(slope).min()) > 1e-5
    np.testing.assert_allclose(slope, difference, rtol=1e-3)


def test_a_trait_at_its_bound_has_the_slope_of_one_leaf():
    """The optics of leaves that differ in other traits, by brown pigments, of which there are none
    as yet: those of one leaf where the spread is 0."""
    scene, parameters = varied()
    parameters = with_spread(parameters, 0.0)
    parameters = eqx.tree_at(lambda p: p.leaf.brown_pigments, parameters, jnp.zeros(3))

    def optics(scene, parameters):
        def of(brown):
            changed = eqx.tree_at(lambda p: p.leaf.brown_pigments, parameters, brown)
            return scene.optics(changed, BANDS)[0].reflectance

        return jax.jvp(of, (jnp.zeros(3),), (jnp.ones(3),))[1]

    one = optics(small_plot(), small_parameters())
    assert float(jnp.abs(one[0]).max()) > 1e-3
    np.testing.assert_allclose(optics(scene, parameters)[2:], one, rtol=1e-6, atol=1e-9)


def test_voxels_by_organ_have_the_mean_of_the_leaves_of_a_species():
    scene, parameters = varied()
    by_organ = scene.voxels_by_organ(parameters, BANDS).classes.reflectance
    by_class = scene.voxels(parameters, BANDS).classes.reflectance
    np.testing.assert_allclose(by_organ[0], by_class[:3].mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(by_organ[jnp.array([1, 2, 3])], by_class[jnp.array([-2, -1, 3])])


def test_what_a_pixel_shows_of_a_species_does_not_depend_on_its_leaves():
    scene, parameters = varied()
    camera = drone(scene)
    truth = truth_of_pixels(camera, scene, parameters)
    one = truth_of_pixels(camera, small_plot(), small_parameters())
    assert truth.live.shape[0] == 3
    np.testing.assert_allclose(truth.live, one.live, atol=1e-12)
    np.testing.assert_allclose(truth.sunlit_ground, one.sunlit_ground, atol=1e-12)


def test_area_of_leaves_is_that_of_their_plants():
    scene, parameters = varied()
    area = scene.area_density(parameters)
    one = small_plot().area_density(small_parameters())
    np.testing.assert_allclose(area[:3].sum(axis=0), one[0], rtol=1e-12)
    np.testing.assert_allclose(area[3:], one[1:], rtol=1e-12)
    crowns = scene.crown_areas(parameters) * (scene.planting.species == 0)
    of_leaf = jnp.bincount(scene.planting.leaf, crowns, length=3)
    np.testing.assert_allclose(
        area[:3].sum(axis=(1, 2, 3)) / area[:3].sum(), of_leaf / of_leaf.sum(), rtol=1e-9
    )


def test_traits_of_leaves_are_those_stated_and_the_spread_scales_them():
    rows = table1_2006()[:3]
    leaves = [
        {"chlorophyll": c, "carotenoids": 10.0, "water": 0.02, "dry_matter": m, "structure": 2.0}
        for c, m in ((30.0, 0.01), (60.0, 0.02))
    ]
    taxon = rows["taxon"][1]
    scene = Scene.from_table(
        rows, size=1.0, voxel=0.5, structure="even", leaves={taxon: leaves}, dtype="float64"
    )
    assert [list(own) for own in leaf_classes(scene.species).values()] == [[0], [1, 2], [3]]
    assert float(scene.parameters.leaf.chlorophyll[1]) == 45.0
    alone = [
        Scene.from_table(
            rows, size=1.0, voxel=0.5, structure="even", leaves={taxon: leaf}, dtype="float64"
        )
        for leaf in (*leaves, leaves[0] | {"chlorophyll": 0.0, "dry_matter": 0.0})
    ]
    optics = scene.optics(scene.parameters, BANDS)[0].reflectance
    own = [one.optics(one.parameters, BANDS)[0].reflectance[1] for one in alone]
    np.testing.assert_allclose(optics[1:3], jnp.stack(own[:2]), rtol=1e-6)
    none = scene.with_values({f"species.{taxon}.leaf_spread": 0.0})
    mean = scene.with_values({f"species.{taxon}.leaf_spread": 2.0}).parameters
    alike = none.optics(none.parameters, BANDS)[0].reflectance
    np.testing.assert_array_equal(alike[1], alike[2])
    wide = scene.optics(mean, BANDS)[0].reflectance
    middle = alike[1]
    assert jnp.all(jnp.abs(wide[1] - middle) > jnp.abs(optics[1] - middle))
    far = scene.with_values({f"species.{taxon}.leaf_spread": 5.0}).parameters
    beyond = scene.optics(far, BANDS)[0].reflectance  # no less chlorophyll than none
    np.testing.assert_allclose(beyond[1], own[2], rtol=1e-6)


def test_a_plant_keeps_its_leaf_when_there_are_more_plants_or_others_stand():
    rows = table1_2006()[:3]
    few, many = (
        Scene.from_table(
            rows.assign(cover_percent=rows["cover_percent"] * times),
            size=2.0,
            voxel=0.5,
            structure="even",
            leaf_variants=4,
        )
        for times in (0.5, 1.0)
    )
    for species in range(3):
        own = [np.asarray(s.planting.leaf)[np.asarray(s.planting.species) == species]
               for s in (few, many)]  # fmt: skip
        assert len(own[0]) < len(own[1])
        np.testing.assert_array_equal(own[0], own[1][: len(own[0])])
        assert set(own[1]) == {0, 1, 2, 3}
    other = few.with_values({"species.*.diameter": 0.5})
    assert other.planting is few.planting
    instances = hard_instances(few, few.parameters)
    assert instances.leaf is not None
    assert len(instances.leaf) == len(instances)


def test_branches_of_a_known_plant_have_one_leaf():
    from fynjax.scene import PlantingRules, Species, build_scene

    foot = np.random.default_rng(0).uniform(0.2, 1.4, (20, 2))
    crowns = Crowns(np.zeros(20, int), foot, np.full(20, 0.3), np.full(20, 0.5))
    row = species_rows(table1_2006()[:1])[0]
    leaves = drawn_leaves([(USUAL_LEAF,)], 3, 0)[0]
    one = dataclasses.replace(Species.of(row, leaves), branches=4.0)
    parameters = jax.tree.map(lambda v: v[:1] if jnp.ndim(v) else v, small_parameters())
    scene = build_scene(
        [one], with_first_spread(parameters), extent=(1.6, 1.6), voxel=0.2, seed=0,
        rules=PlantingRules(structure="even"), crowns=crowns,
    )  # fmt: skip
    leaf = np.asarray(scene.planting.leaf).reshape(20, 4)
    assert (leaf == leaf[:, :1]).all()
    assert set(leaf[:, 0]) == {0, 1, 2}


def with_first_spread(parameters: PlotParameters) -> PlotParameters:
    species = dataclasses.replace(parameters.species, leaf_spread=jnp.ones(1))
    return dataclasses.replace(parameters, species=species)


def test_drawn_leaves_spread_as_learned_about_the_one_stated():
    ratios: dict[int, list[np.ndarray]] = {2: [], 8: []}
    for count, found in ratios.items():
        for seed in range(800 // count):
            (own,) = drawn_leaves([(USUAL_LEAF,)], count, seed)
            traits = pd.DataFrame([leaf.model_dump() for leaf in own])[list(LEAF_FIELDS)]
            stated = np.array([getattr(USUAL_LEAF, name) for name in LEAF_FIELDS])
            np.testing.assert_allclose(traits.mean(), stated, rtol=1e-9)
            found.append(np.log(traits.to_numpy() / stated))
    spread = {n: np.sqrt(np.mean([np.var(v, axis=0) for v in f], 0)) for n, f in ratios.items()}
    for trait, sd in {"chlorophyll": 0.34, "structure": 0.23, "dry_matter": 0.17}.items():
        k = LEAF_FIELDS.index(trait)
        assert spread[8][k] == pytest.approx(sd, rel=0.08)
        assert spread[2][k] == pytest.approx(sd, rel=0.12)
    assert drawn_leaves([(USUAL_LEAF,)], 1, 0) == [(USUAL_LEAF,)]


def test_the_spread_within_species_is_that_of_californian_shrubs(shared_data):
    table = pd.read_csv(shared_data / "leaf" / "california_asd_chemistry.csv.gz")
    spectra = np.load(shared_data / "leaf" / "california_asd_spectra.npz")
    broad = ~table["species_code"].isin(["ABCO", "PILA", "CADE", "PIPO"]).to_numpy()  # no conifers
    code = table["species_code"][broad]
    groups = fit_leaf_groups(
        spectra["wl"].astype(float), spectra["refl"][broad], groups=code.tolist()
    )
    drawn = groups.variants(1000)
    own = drawn_leaves([(USUAL_LEAF,)], 50, 0)[0]
    for trait in ("structure", "chlorophyll", "carotenoids", "water", "dry_matter"):
        learned = np.median(np.log(np.asarray(getattr(drawn, trait))).std(axis=1))
        ours = np.log([getattr(leaf, trait) for leaf in own]).std(ddof=1)
        assert ours == pytest.approx(learned, rel=0.3), trait
    measured = (
        table[broad].groupby("species_code")[["ewt", "lma"]].agg(lambda v: v.std() / v.mean())
    )
    assert measured.median().to_numpy() == pytest.approx([0.24, 0.24], abs=0.02)


def test_a_plot_file_asks_for_leaves_that_stay_when_its_plants_are_drawn_anew(tmp_path):
    plot = read_plot(write_plot(tmp_path, "leaf_variants = 3\n"))
    one, other = (build_plot(plot, seed=seed)[0] for seed in (1, 2))
    assert [own.leaves for own in one.species] == [3, 3]
    np.testing.assert_array_equal(one.species[0].leaf_ratios, other.species[0].leaf_ratios)
    assert not np.array_equal(one.planting.leaf[:50], other.planting.leaf[:50])
    np.testing.assert_allclose(one.parameters.leaf.water, USUAL_LEAF.water)


def test_fewer_than_one_leaf_is_refused():
    rows = table1_2006()[:1]
    with pytest.raises(InputError, match="1 leaf variant or more, but got 0"):
        Scene.from_table(rows, size=1.0, voxel=0.5, leaf_variants=0)
    with pytest.raises(InputError, match="expected a leaf of 'Metalasia muricata', or several"):
        Scene.from_table(rows, size=1.0, voxel=0.5, leaves={"Metalasia muricata": []})


def test_a_fit_frees_the_spread_of_species_that_have_one():
    rows = table1_2006()[:2]
    leaves = [
        {"chlorophyll": c, "carotenoids": 10.0, "water": 0.02, "dry_matter": 0.01}
        for c in (30.0, 60.0)
    ]
    scene = Scene.from_table(
        rows, size=1.0, voxel=0.5, structure="even", leaves={rows["taxon"][0]: leaves}
    )
    free = fx.free(scene, "species.*.leaf_spread")
    assert free.names == (f"species.{rows['taxon'][0]}.leaf_spread",)
    assert isinstance(species_rows(rows)[0], SpeciesRow)


def test_plants_of_two_species_draw_their_leaves_apart():
    """As many plants of each, and the same seed: leaves agree in a third of the plants by chance,
    with a standard error of 1 in 65."""
    first, second = (_drawn_leaves(1000, species, 3, seed=4) for species in (0, 1))
    assert abs(np.mean(first == second) - 1 / 3) < 5 / 65
    for drawn in (first, second):
        assert np.abs(np.bincount(drawn, minlength=3) / 1000 - 1 / 3).max() < 5 / 65
    np.testing.assert_array_equal(_drawn_leaves(1500, 0, 3, seed=4)[:1000], first)
    assert np.mean(_drawn_leaves(1000, 0, 3, seed=5) == first) < 0.5
