"""Twining parasites: Cassytha."""

import numpy as np

from fynjax.canopy._elements import Foliage, Individual, normals
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa
from fynjax.canopy._plant import Organ

_SINKS, _THICK = 0.2, 0.15
"""How far the mat lies lower at its rim than in its middle, and how thick it is, in parts of its
height: it rests on what bears it."""
_STEPS = 64
"""Places of which a thread is made."""


def thread_paths(seed: int, number: int) -> np.ndarray:
    """Threads that wander over a round mat, as complex places [thread, step] in crown diameters."""
    rng = np.random.default_rng([seed, len(Organ) + 3])
    place = 0.5 * np.sqrt(rng.random(number)) * np.exp(2j * np.pi * rng.random(number))
    heading = 2.0 * np.pi * rng.random(number)
    paths = np.empty((number, _STEPS), complex)
    for step in range(_STEPS):
        paths[:, step] = place
        heading += rng.normal(0.0, 0.25, number)
        # At the rim a thread turns back to the middle.
        home = np.angle(np.exp(1j * (np.angle(-place) - heading)))
        heading += np.where(np.abs(place) > 0.42, 0.5 * home, 0.0)
        place = place + 0.02 * np.exp(1j * heading)
        place *= np.minimum(1.0, 0.5 / np.maximum(np.abs(place), 1e-9))
    return paths


def on_mat(point: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Points [..., 3] of a round mat at complex places, `depth` parts of its thickness down."""
    point = point * np.minimum(1.0, 0.5 / np.maximum(np.abs(point), 1e-9))
    level = 1.0 - _SINKS * (2.0 * np.abs(point)) ** 2 - _THICK * depth
    return np.stack([point.real, point.imag, level], axis=-1)


def on_threads(
    form: GrowthForm, uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    """Elements along the threads of a mat."""
    number = len(plant.leafy)
    paths = thread_paths(seed, number)
    at = uniform[:, 1] * (_STEPS - 1)
    low = np.minimum(at.astype(int), _STEPS - 2)
    thread = np.minimum((uniform[:, 0] * number).astype(int), number - 1)
    point = paths[thread, low] + (at - low) * (paths[thread, low + 1] - paths[thread, low])
    radius = form.foliage.radius
    aside = radius * np.sqrt(uniform[:, 5]) * np.exp(2j * np.pi * uniform[:, 2])
    depth = np.random.default_rng([seed, len(Organ) + 6]).random(number)
    position = plant.widened(on_mat(point + aside, depth[thread]))
    return position, normals(uniform[:, 3:5], form.leaf_angle)


FORM = GrowthForm(
    description="Shallow mat of green threads (counted as leaf) that wander over the top of its "
    "height, with holes, falling towards its rim: its height is that of the plants that it lies "
    "on. No wood and no visible flowers.",
    sources="Dead tissue, leaf area, clumping: assumed, no plot of the shipped prior has climbers. "
    "Shrublands at large: the same, with half as much spread again in leaf area and clumping. "
    "Leaf diameter: mean over its taxa in `leaf_sizes`. Leaf mass and water: as of broad leaves. "
    "All else: assumed.",
    leaf_area_index=1.5,
    wood_area_index=0.0,
    flower_fraction=0.0,
    shoot_clumping=0.20,
    dead_fraction=0.30,
    leaf_angle="planophile",
    leaf_diameter=0.0024,
    prior=FormPrior(
        dead_fraction=(0.30, 0.21), leaf_area_index=(1.5, 0.75), shoot_clumping=(0.2, 0.1)
    ),
    generic=FormPrior(
        dead_fraction=(0.3, 0.21), leaf_area_index=(1.5, 1.1), shoot_clumping=(0.2, 0.15)
    ),
    diameter=0.5,
    height=0.5,
    size_source="mean of 1 taxa of this form in the shipped table of a plot burnt in 2006",
    foliage=Foliage(20, 0.03, 0.0, outline=0.60, uneven=0.0, bare=0.0),
    leaf_elements=on_threads,
    leaf=LeafGeometry("thread", width=0.0012),
    leaf_mass_per_area=235.0,
    water_content=0.61,
    round_leaves=True,
    stand_share=0.05,
    chlorophyll=15.0,
    carotenoids=5.0,
    anthocyanins=2.0,
    flat_leaved=Taxa(
        genera="Aristolochia Bryonia Calystegia Clematis Convolvulus Dioscorea Hedera "
        "Humulus Lonicera Rubia Smilax Tamus Vitis",
        families="Convolvulaceae Cucurbitaceae Dioscoreaceae Menispermaceae Smilacaceae Vitaceae",
    ),
    round_leaved=Taxa(genera="Cassytha Cuscuta"),
)
