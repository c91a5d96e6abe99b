"""Dead plants that stand."""

import numpy as np

from fynjax.canopy._elements import Foliage, Individual, Shoots, shoot_elements
from fynjax.canopy._form import GrowthForm, LeafGeometry
from fynjax.canopy._plant import Organ


def _forked(position: np.ndarray, uniform: np.ndarray, seed: int) -> np.ndarray:
    """Deadwood whose upper parts lean aside as forks: each third of a stem's height its own way."""
    rng = np.random.default_rng([seed, len(Organ) + 4])
    turn = np.arctan2(position[:, 1], position[:, 0])
    stem = np.unique(np.round(turn, 9), return_inverse=True)[1]
    fork = (3.0 * uniform[:, 5]).astype(int)
    bend = rng.normal(0.0, 0.22, (stem.max() + 1, 3))[stem, fork]
    start = 0.35 + 0.3 * rng.random((stem.max() + 1, 3))[stem, fork]
    aside = bend * np.maximum(position[:, 2] - start, 0.0)
    moved = position.copy()
    moved[:, 0] -= aside * np.sin(turn)
    moved[:, 1] += aside * np.cos(turn)
    return moved


def forked_stems(
    form: GrowthForm, uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    """Elements on stems that are forked above."""
    position, normal = shoot_elements(form, uniform, seed, 0.0, 1.0)
    return plant.widened(_forked(position, uniform, seed)), normal


FORM = GrowthForm(
    description="Bare stems from the base, eight to twelve, forked above, upright to leaning far "
    "outwards, some of them low; wood only.",
    sources="All assumed, but the size. Leaf mass and water of no meaning: it has no leaves.",
    leaf_area_index=0.0,
    wood_area_index=0.80,
    flower_fraction=0.0,
    shoot_clumping=0.0,
    dead_fraction=0.0,
    leaf_angle="spherical",
    leaf_diameter=0.005,
    diameter=0.1,
    height=0.89,
    size_source="mean of 1 taxa of this form in the shipped table of a plot burnt in 2006",
    shoots=Shoots(12, 0.04, (0.05, 0.50), (0.25, 1.00), 1.0, 0.6, fewest=8, leaning=0.25),
    foliage=Foliage(12, 0.0, 0.0, outline=0.45, uneven=0.0, bare=0.0),
    wood_elements=forked_stems,
    leaf=LeafGeometry("none"),
    leaf_mass_per_area=235.0,
    water_content=0.50,
)
