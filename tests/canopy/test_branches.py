"""Plants made of copies of a branch: areas, turns, and elements against triangles."""

import numpy as np
import pytest
import trimesh

from fynjax._core.errors import InputError
from fynjax.canopy import Organ, unit_shapes
from fynjax.canopy.mesh._branches import branch_rotation_spread, plant_from_branches
from fynjax.canopy.mesh._model import plant_model_from_mesh, read_plant_mesh
from fynjax.canopy.mesh._plant_mesh import MeshPlant, PlantMesh


def branch() -> PlantMesh:
    """A stem of 0.5 m with a leaf on one side, off the origin."""
    stem = trimesh.creation.cylinder(radius=0.01, height=0.5, sections=8)
    stem.apply_translation([2.0, 1.0, 0.25])
    leaf = trimesh.Trimesh([[2, 1, 0.4], [2.2, 1.05, 0.45], [2.1, 1.15, 0.5]], [[0, 1, 2]])
    scene = trimesh.Scene()
    scene.add_geometry(stem, geom_name="wood")
    scene.add_geometry(leaf, geom_name="leaf")
    return read_plant_mesh(scene)


def elements(mesh: PlantMesh, n: int | None = 400) -> MeshPlant:
    return plant_model_from_mesh(mesh, n, solid_materials="closed")


def test_spread_grows_to_an_asymptote() -> None:
    assert branch_rotation_spread(1) == 0.0
    spread = np.array([branch_rotation_spread(count) for count in range(1, 60)])
    assert (np.diff(spread) > 0).all()
    assert (np.diff(spread, 2) < 0).all()
    assert spread[8] == pytest.approx(35.0 * (1 - 1 / np.e))
    assert branch_rotation_spread(1_000_000) == pytest.approx(35.0)


def test_areas_are_multiplied_and_elements_agree_with_triangles() -> None:
    one = branch()
    whole = plant_from_branches(one, 7, seed=3, rotation_spread=25.0)
    np.testing.assert_allclose(whole.material_area, 7 * one.material_area)
    assert whole.is_closed("wood")
    model = plant_from_branches(elements(one, None), 7, seed=3, rotation_spread=25.0)
    direct = elements(whole, None)
    np.testing.assert_allclose(model.organ_area, 7 * elements(one).organ_area)
    np.testing.assert_allclose(model.organ_area, direct.organ_area)
    # The same copies in the same order: sort both, and allow for the two boxes' middles.
    for organ in (Organ.LEAF, Organ.WOOD):
        places, normals = [], []
        for made in (model, direct):
            mine = np.asarray(made.plant.organ) == organ
            place = np.asarray(made.position)[mine]
            order = np.lexsort(np.round(place - place.mean(axis=0), 9).T)
            places.append((place - place.mean(axis=0))[order])
            normals.append(np.asarray(made.plant.normal)[mine][order])
        np.testing.assert_allclose(places[0], places[1], atol=1e-12)
        flat = np.abs(normals[0][:, 2]) < 1e-9  # a level normal has no upper side
        np.testing.assert_allclose(normals[0][~flat], normals[1][~flat], atol=1e-9)


def test_copies_turn_as_planted_ones_do() -> None:
    """A leaning plant of a scene is the same rotation, about the same foot."""
    one = elements(branch(), 60)
    copy = plant_from_branches(one, 1, seed=11, rotation_spread=30.0)
    azimuth = 360.0 * np.random.default_rng([11, 0]).random(1)
    tilt = 30.0 * np.abs(np.random.default_rng([11, 1]).standard_normal(1))
    across, along = unit_shapes(np.asarray(one.plant.position), azimuth, tilt)
    planted = one.modelled_diameter * across[0] + one.depth * along[0]
    shift = planted - np.asarray(copy.position)
    np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-12)
    np.testing.assert_allclose(copy.area, one.area)


def test_upright_copies_surround_the_axis_and_tilted_ones_spread() -> None:
    one = elements(branch(), 50)
    upright = plant_from_branches(one, 200, seed=0, rotation_spread=0.0)
    assert upright.depth == pytest.approx(float(one.position[:, 2].max()))
    np.testing.assert_allclose(np.asarray(upright.position)[:, :2].mean(axis=0), 0.0, atol=0.02)
    spread = plant_from_branches(one, 200, seed=0)
    assert spread.modelled_diameter > 2.0 * upright.modelled_diameter
    # A stem's rise falls with the cosine of its tilt, whose mean is exp(-sigma^2 / 2).
    sigma = np.deg2rad(branch_rotation_spread(200))
    level = np.asarray(one.position)[:, 2]
    level = np.where(np.asarray(one.plant.organ) == Organ.WOOD, level, np.nan)
    bottom, top = np.nanargmin(level), np.nanargmax(level)
    copies = np.asarray(spread.position).reshape(200, -1, 3)
    rise = float((copies[:, top, 2] - copies[:, bottom, 2]).mean()) / (level[top] - level[bottom])
    assert rise == pytest.approx(np.exp(-(sigma**2) / 2), rel=0.05)
    normals = np.asarray(spread.plant.normal)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    assert normals[:, 2].min() >= 0.0


@pytest.mark.parametrize(
    ("branches", "spread", "word"),
    [(0, 5.0, "`branches`"), (2.5, 5.0, "`branches`"), (3, 95.0, "degrees"), (3, -1.0, "degrees")],
)
def test_bad_input(branches: int, spread: float, word: str) -> None:
    with pytest.raises(InputError, match=word):
        plant_from_branches(branch(), branches, seed=0, rotation_spread=spread)


def test_too_many_copies_say_so() -> None:
    for one in (branch(), elements(branch())):
        with pytest.raises(InputError, match=r"5000000 (triangles|elements) .*`branches`"):
            plant_from_branches(one, 1_000_000, seed=0)
