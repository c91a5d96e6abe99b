"""Plants followed on voxels finer than those of the classes."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import FORMS, leaf_angle
from fynjax.errors import InputError
from fynjax.radiation import Accuracy, nadir_rays, render, solve_light
from fynjax.scene import Species
from fynjax.scene._optics import seen_from_above
from fynjax.sensors import shipped_sensor
from tests.scene.plots import small_parameters, small_plot

LIGHT = Accuracy(levels=1, azimuths=4, refine=False)


def image(scene, parameters):
    x = (jnp.arange(64) + 0.5) * 0.025
    rays = nadir_rays(x, x, 0.025, (0.8, 0.8, 50.0))
    bands = shipped_sensor("mavic_3m").bands
    radiance = render(solve_light(scene.voxels(parameters, bands), LIGHT), rays)
    means = jnp.append(jnp.pi * radiance.total.mean(axis=(1, 2)), radiance.gap.mean())
    return means, radiance.total[3].std()


image = eqx.filter_jit(image)


def test_gap_and_image_do_not_depend_on_the_voxel():
    """And single crowns are sharper in the near infrared than in voxels filled evenly."""
    parameters = small_parameters()
    both = (
        image(small_plot(voxel=voxel, structure=structure), parameters)
        for voxel, structure in ((0.1, "even"), (0.1, 0.025), (0.05, 0.025), (0.1, 0.0125))
    )
    means, spreads = zip(*both)
    filled, coarse, fine, limit = map(np.asarray, means)
    assert float(spreads[1]) > 1.05 * float(spreads[0])
    np.testing.assert_allclose(coarse, fine, rtol=2e-3)
    np.testing.assert_allclose(coarse, limit, rtol=0.015)
    assert np.log(filled[-1]) < 1.1 * np.log(limit[-1])  # too dense by a tenth and more


def test_structure_holds_the_area_of_the_classes():
    scene, parameters = small_plot(structure=0.025), small_parameters()
    voxels = scene.voxels(parameters, shipped_sensor("mavic_3m").bands)
    total = np.asarray(voxels.area_density).sum(axis=0)
    nz, ny, nx = total.shape
    blocks = np.asarray(voxels.structure).reshape(nz, 4, ny, 4, nx, 4).mean(axis=(1, 3, 5))
    np.testing.assert_allclose(blocks, total, atol=1e-9 * total.max())


def test_derivatives_of_cover_and_diameter_are_those_of_differences():
    scene, parameters = small_plot(structure=0.025).expected(), small_parameters()

    @eqx.filter_jit
    @jax.value_and_grad
    def loss(by, scene):
        species = parameters.species
        moved = eqx.tree_at(
            lambda p: (p.species.cover, p.species.diameter),
            parameters,
            (species.cover * (1.0 + by[0]), species.diameter * (1.0 + by[1])),
        )
        return (image(scene, moved)[0] ** 2).sum()

    slope = loss(jnp.zeros(2), scene)[1]
    for i, unit in enumerate(np.eye(2)):
        up, down = (loss(jnp.asarray(step * unit), scene)[0] for step in (1e-6, -1e-6))
        difference = (up - down) / 2e-6
        assert float(slope[i]) == pytest.approx(float(difference), rel=1e-4)


def test_elements_lie_and_carry_area_as_their_plants_do():
    scene, parameters = small_plot(structure=0.025), small_parameters()
    crowns, standing = scene.visible_crowns(parameters), scene.standing(parameters)
    planting, species = scene.planting, parameters.species
    across, along = planting.unit_shapes()
    places, areas = scene._elements(parameters, planting, crowns, standing)
    index = np.asarray(scene.organ_index(parameters))
    for element in np.flatnonzero(standing[planting.plant] > 0.0)[::47]:
        plant, organ = planting.plant[element], planting.organ[element]
        kind = planting.species[plant]
        width = species.diameter[kind] * planting.size[plant]
        height = species.height[kind] * planting.stature[plant]
        place = width * across[element] + height * along[element]
        place += jnp.append(planting.foot[plant], 0.0)
        np.testing.assert_allclose(places[element], place, rtol=1e-6, atol=1e-9)
        area = crowns[plant] * index[kind, organ] * planting.fraction[element] * standing[plant]
        np.testing.assert_allclose(areas[element], area, rtol=1e-6)


def test_thinned_plants_carry_the_same_area():
    scene, parameters = small_plot(structure=0.025), small_parameters()
    most = [50 + 10 * i for i in range(len(scene.forms))]
    thin = dataclasses.replace(scene, planting=scene.planting.thinned(most))
    before, after = scene.planting, thin.planting
    per_plant = np.bincount(after.plant, minlength=len(after.species))
    assert (per_plant <= np.array(most)[after.species] + 1).all()
    assert len(after.plant) < 0.5 * len(before.plant)

    # Each plant keeps the shares of its organs, and its own shape.
    classes = len(scene.forms) + 2
    for planting in (before, after):
        total = np.zeros((len(planting.species), classes))
        np.add.at(total, (planting.plant, planting.optical_class), planting.fraction)
        assert np.isin(np.round(total, 5), [0.0, 1.0]).all()
    ((whole, _), (few, _)) = (
        jax.tree.map(
            np.asarray,
            s._elements(
                parameters, s.planting, s.visible_crowns(parameters), s.standing(parameters)
            ),
        )
        for s in (scene, thin)
    )
    centres = [
        np.stack([np.bincount(p.plant, p.fraction * xyz[:, i]) for i in range(3)])
        for p, xyz in ((before, whole), (after, few))
    ]
    assert np.abs(centres[0] - centres[1]).mean() < 0.02
    np.testing.assert_allclose(
        thin.area_density(parameters).sum(axis=(1, 2, 3)),
        scene.area_density(parameters).sum(axis=(1, 2, 3)),
        rtol=1e-6,
    )
    same = scene.planting.thinned([10**6] * len(scene.forms))
    assert eqx.tree_equal(same, scene.planting)


@pytest.mark.parametrize(
    ("voxel", "structure", "finer", "tuft"),
    [(0.1, 0.02, 5, 0.04), (0.04, 0.025, 2, 0.04), (0.08, None, 4, 0.04), (0.4, None, 4, 0.05)],
)
def test_other_voxels_hold_the_same_area(voxel, structure, finer, tuft):
    scene, parameters = small_plot(voxel=voxel, structure=structure), small_parameters()
    assert (scene.finer, scene.tuft) == (finer, pytest.approx(tuft))
    voxels = scene.voxels(parameters, shipped_sensor("mavic_3m").bands)
    fine = float(voxels.structure.mean()) * voxels.height
    plot = scene.area_density(parameters)
    whole = float(plot.sum(axis=0).mean()) * scene.grid.extent[2]
    assert fine == pytest.approx(whole, rel=1e-9)


def test_a_structure_needs_an_edge():
    with pytest.raises(InputError, match="positive lengths"):
        small_plot(structure=-0.1)


def test_leaves_show_the_area_of_their_inclination_and_all_else_half_of_it():
    """Whether a species has the inclination of its form or its own."""
    forms = ("tussock", "rounded_shrub")
    species = [Species(form, form) for form in forms]
    species.append(Species("own", "tussock", leaf_angle=leaf_angle("planophile")))
    names = (*(FORMS[form].leaf_angle for form in forms), "planophile")
    expected = [leaf_angle(name).projection(jnp.ones(())) for name in names]
    assert expected[0] != expected[1]
    np.testing.assert_allclose(seen_from_above(species), [*expected, 0.5, 0.5], rtol=1e-6)
