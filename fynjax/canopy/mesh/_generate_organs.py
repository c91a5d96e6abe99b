"""Leaves, stems and flowers of generated plants: surfaces on a skeleton, of given areas."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from fynjax.canopy._angles import leaf_angle
from fynjax.canopy._elements import FLOWERS_ABOVE, QUANTILES, quantile, quasi_random
from fynjax.canopy._form import GrowthForm, MeshLeaf
from fynjax.canopy._lines import Skeleton, unit
from fynjax.canopy._plant import Organ
from fynjax.canopy.mesh._generate_parts import (
    EMPTY,
    OUTLINES,
    Surface,
    blades,
    frames,
    outline_area,
    tubes_of_area,
)

_GOLDEN_ANGLE = 2.399963  # rad: the usual spiral of leaves along a stem
_FLOWER_SIDE = 0.004
_SPIKELET = (0.006, 0.0012)
_LEAF_SIZE_SPREAD = 0.15
_LEAVES, _FLOWERS = 21, 22


@dataclass(frozen=True)
class Foliage:
    """Where each leaf sits: twig and place along it; how it points; its relative size."""

    twig: np.ndarray
    place: np.ndarray
    axis: np.ndarray
    normal: np.ndarray
    size: np.ndarray


def lay_out(
    form: GrowthForm,
    skeleton: Skeleton,
    n_leaves: int,
    leaf: MeshLeaf,
    leaf_area: float,
    seed: int,
) -> Foliage | None:
    """Leaves in a spiral along the twigs, whose normals have the angle distribution of the form."""
    if skeleton.leafy is None or n_leaves == 0 or leaf_area == 0.0:
        return None
    paths = skeleton.leafy
    length = np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1)
    # In proportion to the twigs' lengths, but for a part each gets alike.
    mass = np.cumsum(length + 0.3 * length.mean())
    position = (np.arange(n_leaves) + 0.5) / n_leaves * mass[-1]
    twig = np.minimum(np.searchsorted(mass, position), len(mass) - 1)
    before = np.concatenate([[0.0], mass])[twig]
    share = (position - before) / np.diff(np.concatenate([[0.0], mass]))[twig]
    place = 0.15 + 0.85 * share  # a twig is bare at its foot
    rng = np.random.default_rng([seed, _LEAVES])

    along, side, second = (_at(vectors, twig, place) for vectors in frames(paths))
    roll = _GOLDEN_ANGLE * np.arange(n_leaves) + rng.normal(0.0, 0.3, n_leaves)
    out = np.cos(roll)[:, None] * side + np.sin(roll)[:, None] * second
    opening = np.deg2rad(form.mesh.angle_to_twig * np.exp(rng.normal(0.0, 0.25, n_leaves)))
    cos, sin = np.cos(opening)[:, None], np.sin(opening)[:, None]
    natural = unit(sin * along - cos * out)
    natural = np.where(natural[:, 2:] < 0.0, -natural, natural)

    # The steepest leaf gets the steepest inclination of the distribution, and so on.
    tilt = np.empty(n_leaves)
    rank = (np.arange(n_leaves) + 0.5) / n_leaves
    tilts = _inclinations(rank, form.leaf_angle)
    tilt[np.argsort(-natural[:, 2], kind="stable")] = tilts
    azimuth = np.arctan2(natural[:, 1], natural[:, 0])
    normal = np.stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)], axis=-1
    )
    axis = cos * along + sin * out
    axis = unit(axis - (axis * normal).sum(axis=1, keepdims=True) * normal)
    size = np.exp(rng.normal(0.0, _LEAF_SIZE_SPREAD, n_leaves))
    return Foliage(twig, place, axis, normal, size)


def _inclinations(uniform: np.ndarray, name: str) -> np.ndarray:
    """Quantiles of the inclination of the normal of a leaf angle distribution [rad]."""
    grid = np.linspace(0.0, 0.5 * np.pi, QUANTILES)
    density = np.asarray(leaf_angle(name).inclination_density(jnp.asarray(grid)), float)
    return quantile(uniform, grid, np.maximum(density, 0.0))


def _at(values: np.ndarray, path: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values [path, point, 3] at parts of the way along paths."""
    last = values.shape[1] - 1
    low = np.minimum((place * last).astype(int), last - 1)
    share = (place * last - low)[:, None]
    return (1.0 - share) * values[path, low] + share * values[path, low + 1]


def build_organs(
    form: GrowthForm,
    skeleton: Skeleton,
    foliage: Foliage | None,
    stretch: np.ndarray,
    leaf: MeshLeaf,
    leaf_area: float,
    wood_area: float,
    flower_area: float,
    seed: int,
) -> tuple[dict[Organ, Surface], float, float]:
    """Surfaces of the organs, the size of the leaves per that of the table, the thinnest radius."""
    lines = skeleton.scaled(stretch)
    surfaces: dict[Organ, Surface] = {}
    scale, radius = 1.0, 0.0
    if lines.green and leaf_area > 0.0:
        surfaces[Organ.LEAF], factor = tubes_of_area(lines.green, form.mesh.green_sides, leaf_area)
        scale = factor / (0.5 * leaf.width)
    elif foliage is not None and lines.leafy is not None:
        base = _at(lines.leafy, foliage.twig, foliage.place)
        blade_area = outline_area(OUTLINES[leaf.outline]) * leaf.length * leaf.width
        scale = float(np.sqrt(leaf_area / (blade_area * (foliage.size**2).sum())))
        for _ in range(2):  # the arch adds a little area, in proportion
            long, wide = (scale * foliage.size * side for side in (leaf.length, leaf.width))
            made = blades(base, foliage.axis, foliage.normal, long, wide, OUTLINES[leaf.outline])
            surfaces[Organ.LEAF] = made
            scale *= float(np.sqrt(leaf_area / made.area))
    if lines.stems and wood_area > 0.0:
        surfaces[Organ.WOOD], factor = tubes_of_area(lines.stems, 4, wood_area)
        radius = factor * min(float(radii.min()) for _, radii in lines.stems)
    if flower_area > 0.0:
        surfaces[Organ.FLOWER] = _flowers(lines, flower_area, seed)
    return surfaces, scale, radius


def _flowers(lines: Skeleton, area: float, seed: int) -> Surface:
    """Spikelets at the tips of culms, or level petals about the upper tips of twigs."""
    rng = np.random.default_rng([seed, _FLOWERS])
    if lines.green:
        tips = np.concatenate([paths[:, -2:] for paths, _ in lines.green])
        length, width = _SPIKELET
        number = int(np.clip(round(area / (0.7 * length * 2.0 * width)), 3, len(tips)))
        tips = tips[rng.choice(len(tips), number, replace=False)]
        ahead = unit(tips[:, 1] - tips[:, 0])
        part = np.array([0.0, 0.4, 1.0])[None, :, None]
        paths = tips[:, 1:] + length * part * ahead[:, None, :] - 0.8 * length * ahead[:, None, :]
        return tubes_of_area([(paths, np.tile([0.3, 1.0, 0.2], (number, 1)))], 5, area)[0]
    if lines.leafy is None:
        return EMPTY
    tips = lines.leafy[:, -1]
    tips = tips[tips[:, 2] >= FLOWERS_ABOVE * tips[:, 2].max()]
    number = max(3, round(area / _FLOWER_SIDE**2))
    middle = tips[np.arange(number) % len(tips)]
    middle = middle + rng.normal(0.0, _FLOWER_SIDE, (number, 3)) * [1.0, 1.0, 0.3]
    uniform = quasi_random(number, 3, [seed, _FLOWERS])
    tilt = _inclinations(uniform[:, 0], "planophile")
    azimuth, roll = 2.0 * np.pi * uniform[:, 1], 2.0 * np.pi * uniform[:, 2:]
    down = np.stack(
        [np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), -np.sin(tilt)], axis=-1
    )
    level = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(number)], axis=-1)
    normal = np.cross(down, level)
    axis = np.cos(roll) * down + np.sin(roll) * level
    side = np.full(number, np.sqrt(area / number))
    return blades(middle - 0.5 * side[:, None] * axis, axis, normal, side, side, OUTLINES["petal"])
