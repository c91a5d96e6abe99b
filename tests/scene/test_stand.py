"""Leaf and wood area of a stand, counted once where crowns overlap, and the ground between."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.scene import Scene, StandArea, hard_scene, stand_area
from fynjax.sensors import mavic_3m
from tests.helpers import assert_gradients
from tests.scene.plots import densities, small_parameters, small_plot


def crowded():
    """Crowns of 1.3 times the plot in all, with an even wood area index of 1."""
    return eqx.tree_at(
        lambda p: (p.species.cover, p.species.wood_area_index),
        small_parameters(),
        (jnp.array([0.5, 0.4, 0.15]), jnp.ones(3)),
    )


def covered_by_random_discs(area, side, throws, points, rng):
    """Mean and standard error of the share of a periodic square that discs cover."""
    share = []
    for _ in range(throws):
        places, tests = rng.uniform(0, side, (len(area), 2)), rng.uniform(0, side, (points, 2))
        apart = np.abs(tests[:, None] - places)
        apart = np.minimum(apart, side - apart)
        inside = (apart**2).sum(axis=-1) < area / np.pi
        share.append(inside.any(axis=1).mean())
    return np.mean(share), np.std(share) / np.sqrt(throws)


def test_area_is_what_is_stated_of_the_ground_that_random_crowns_cover():
    parameters = crowded()
    model = small_plot()
    hard = hard_scene(model, parameters)
    crowns = np.asarray(hard.crown_areas(parameters))
    cover, error = covered_by_random_discs(crowns, 1.6, 1500, 200, np.random.default_rng(1))
    assert error < 0.006
    assert cover < 0.65 * crowns.sum() / 1.6**2  # counted twice it would be half as much again
    stand = stand_area(hard, parameters)
    assert stand.wood.sum() == pytest.approx(cover, abs=3 * error)
    on_grid = np.asarray(densities(hard, parameters)).sum(axis=(1, 2, 3)) * 1e-3
    assert on_grid[-2] / 1.6**2 == pytest.approx(stand.wood.sum(), rel=1e-9)
    leaf = (stand.leaf + stand.dead) * (1 - np.asarray(parameters.species.shoot_clumping))
    np.testing.assert_allclose(stand.dead, [0.3, 0.45, 0.0] * (stand.leaf + stand.dead), rtol=1e-6)
    np.testing.assert_allclose(on_grid[:2] / 1.6**2, leaf[:2], rtol=1e-9)
    mass = 1e4 * (stand.leaf + stand.dead) @ np.asarray(parameters.leaf.dry_matter)
    assert stand.leaf_mass.sum() == pytest.approx(mass)


def test_organs_that_a_shape_lacks_have_no_area():
    """Deadwood bears no leaves, whatever its leaf area index."""
    leafless = eqx.tree_at(
        lambda p: p.species.leaf_area_index, crowded(), jnp.array([2.0, 2.0, 2.0])
    )
    model = small_plot()
    deadwood = model.forms.index("deadwood")
    stand = stand_area(model, leafless)
    assert stand.leaf[deadwood] == stand.dead[deadwood] == stand.leaf_mass[deadwood] == 0.0
    assert stand.wood[deadwood] > 0.0


def test_the_gap_is_that_of_the_columns():
    """Beer's law straight down, by hand; and finer voxels keep gaps that coarse ones fill."""
    parameters, model = crowded(), small_plot()
    density = np.asarray(densities(model, parameters))
    classes = model.voxels(parameters, mavic_3m()).classes
    angles, of_class = classes.angles, classes.angle_of_class
    down = np.array([float(angles[k].projection(jnp.asarray(1.0))) for k in of_class])
    depth = np.tensordot(down, density, axes=1).sum(axis=0) * 0.1
    gap = float(eqx.filter_jit(Scene.gap_fraction)(model, parameters))
    assert gap == pytest.approx(np.exp(-depth).mean(), rel=1e-9)
    assert stand_area(model, parameters).gap == pytest.approx(gap, rel=1e-12)
    fine = small_plot(structure=0.025)
    assert float(eqx.filter_jit(Scene.gap_fraction)(fine, parameters)) > gap + 0.02
    bare = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.zeros(3))
    assert stand_area(model, bare).gap == 1.0
    assert float(model.crown_share(bare)) == 1.0


def test_area_and_gap_have_derivatives_in_cover_and_size():
    parameters, model = crowded(), small_plot().expected()

    @eqx.filter_jit
    def total(values):
        species = dataclasses.replace(parameters.species, cover=values[:3], diameter=values[3:])
        plot = dataclasses.replace(parameters, species=species)
        return jnp.stack([model.area_density(plot).sum() * 1e-3, model.crown_share(plot)])

    at = jnp.concatenate([parameters.species.cover, parameters.species.diameter])
    assert_gradients(total, at, rtol=1e-5)


def test_a_stand_outside_the_range_of_shrublands_is_named():
    none = np.zeros(2)
    stand = StandArea(
        np.array([2.0, 0.5]), np.array([0.3, 0.0]), none, np.array([400.0, 100.0]), 0.3
    )
    assert stand.warnings() == []
    dense = dataclasses.replace(stand, leaf=np.array([4.0, 2.0]))
    assert "live and dead, of 6.30 m2" in dense.warnings()[0]
    sparse = dataclasses.replace(stand, leaf=np.array([0.0, 0.05]))
    assert "deserts" in sparse.warnings()[0]
    heavy = dataclasses.replace(stand, leaf_mass=np.array([1100.0, 100.0]))
    assert "1200 g m-2" in heavy.warnings()[0]
    assert dataclasses.replace(stand, leaf=none, dead=none, leaf_mass=none).warnings() == []
