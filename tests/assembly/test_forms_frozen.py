"""What growth forms make stays as it is: plants, meshes, and stands that a prior draws."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from fynjax.app.assembly import StandSettings, stand_numbers
from fynjax.app.assembly._stands import _draw
from fynjax.app.io.plot import read_prior
from fynjax.canopy import generate_plant, plant_model

FROZEN = json.loads(Path(__file__).with_name("forms_frozen.json").read_text("utf-8"))
"""Sums that were written before the forms became records; `stand` since means are drawn by the
symmetric root of their covariance."""


def sums(*arrays: np.ndarray) -> list[float]:
    """Of each array: the sum of its numbers, each times the sine of its place."""
    return [float(np.sin(np.arange(1, a.size + 1)) @ np.asarray(a, float).ravel()) for a in arrays]


def model_sums(form: str, n_elements: int, seed: int) -> list[float]:
    plant = plant_model(form, n_elements, seed=seed)
    return sums(plant.position, plant.normal, plant.area_fraction, plant.organ)


def mesh_sums(taxon: str) -> list[float]:
    made = generate_plant(taxon, 3, flowering=0.5, max_triangles=5000)
    mesh = made.mesh
    size = np.array([made.n_leaves, made.leaf_scale, made.twig_radius])
    return sums(mesh.vertices, mesh.faces, mesh.material, size)


def stand_sums() -> list[float]:
    """Of a draw of the shipped prior: sizes, areas, leaves, ground and light of a stand."""
    prior = read_prior("fynbos_2023")
    common, own = stand_numbers(prior)
    rng = np.random.default_rng(2)
    drawn = _draw(prior, StandSettings(), rng.normal(size=common), rng.normal(size=(12, own)))
    made = (drawn.species, drawn.light, drawn.optics, drawn.leaf_mass, drawn.water)
    return [common, own, *sums(*jax.tree.leaves(made))]


@pytest.mark.parametrize("key", FROZEN["plants"])
def test_plants_are_the_same(key: str) -> None:
    form, n_elements, seed = key.split()
    np.testing.assert_allclose(
        model_sums(form, int(n_elements), int(seed)), FROZEN["plants"][key], rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("taxon", FROZEN["meshes"])
def test_meshes_are_the_same(taxon: str) -> None:
    np.testing.assert_allclose(mesh_sums(taxon), FROZEN["meshes"][taxon], rtol=1e-7, atol=1e-7)


def test_drawn_stands_are_the_same() -> None:
    np.testing.assert_allclose(stand_sums(), FROZEN["stand"], rtol=1e-9, atol=1e-9)
