"""A scene of plants that are known: their crowns as stated, whatever covers are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.app.assembly import plot_problem
from fynjax.app.io.plot import read_plot
from fynjax.scene import hard_instances, room_needed, with_values
from tests.io.test_crowns import CROWNS, write
from tests.scene.plots import densities

FOOT = np.array([[0.5, 0.5], [1.5, 0.6], [1.0, 1.5]])
DIAMETER = np.array([0.4, 0.3, 0.3])


@pytest.fixture(scope="module")
def ready(tmp_path_factory):
    plot = read_plot(write(tmp_path_factory.mktemp("plot"), CROWNS))
    return plot_problem(plot, None, ("species.*.cover", "species.*.diameter"), seed=0)


def test_every_crown_stands_whole_where_it_is(ready):
    areas = np.asarray(ready.scene.crown_areas(ready.scene.parameters))
    np.testing.assert_allclose(areas, np.pi / 4 * DIAMETER**2, rtol=1e-6)
    there = hard_instances(ready.scene, ready.scene.parameters)
    np.testing.assert_allclose(np.stack([there.x, there.y], axis=1), FOOT, atol=1e-6)
    np.testing.assert_allclose(there.diameter, DIAMETER, rtol=1e-6)
    np.testing.assert_allclose(there.height, [0.6, 0.4, 0.5], rtol=1e-6)
    # Leaf area of Erica: of its crowns as seen from above, both with leaves of the form's area.
    share = 1.0 - np.prod(1.0 - np.pi / 4 * DIAMETER**2 / 4.0)
    share /= np.sum(np.pi / 4 * DIAMETER**2 / 4.0)
    species = ready.scene.parameters.species
    leaf = np.pi / 4 * (0.4**2 + 0.3**2) * share
    leaf *= float(species.leaf_area_index[0] * (1.0 - species.shoot_clumping[0]))
    density = densities(ready.scene, ready.scene.parameters)
    assert float(jnp.sum(density[0])) * 0.1**3 == pytest.approx(leaf, rel=1e-5)


def test_covers_plant_nobody_and_diameters_scale_the_crowns(ready):
    assert ready.free.names == tuple(f"species.{taxon}.diameter" for taxon in ready.scene.taxa)
    scene = ready.scene
    changed = with_values(
        ready.scene.parameters,
        scene.taxa,
        {"species.Erica irregularis.cover": 0.9, "species.Erica irregularis.diameter": 0.7},
    )
    assert not room_needed(scene, ready.scene.parameters, scene.counts(changed)).any()
    diameter = hard_instances(scene, changed).diameter
    mean = np.sqrt((0.4**2 + 0.3**2) / 2)
    np.testing.assert_allclose(diameter, DIAMETER * [0.7 / mean, 0.7 / mean, 1.0], rtol=1e-6)


def test_no_chance_plants_them_anew(ready):
    for other in (ready.scene.reordered(5), ready.scene.realisation(3)):
        assert jax.tree.all(
            jax.tree.map(
                lambda a, b: bool(jnp.array_equal(a, b)), other.planting, ready.scene.planting
            )
        )
