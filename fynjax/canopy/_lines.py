"""Stems and threads of generated plants: lines in space, before they get a thickness.

Lengths in metres, the foot of the plant at the origin. The shapes are those of the area elements
(`_elements`), with the same numbers: of one seed the same outline, the same bunches in which the
twigs end, the same stems, culms and threads.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fynjax.canopy._elements import (
    ShootsDrawn,
    crown_stems,
    in_bunches,
    individual_of,
    quasi_random,
)

if TYPE_CHECKING:
    from fynjax.canopy._form import GrowthForm

STEM_POINTS = 14
"""Points of a stem or culm."""
_TWIG_POINTS = 6
_FLOW_POWER = 1.0 / 2.2
"""A stem's section grows a little slower than the number of tips it carries (Murray's law is
1/3 for the radius, the pipe model 1/2)."""

_MINIMUM_CROSS = 1e-12

# Streams of random numbers of one seed, beside those of `plant_model`.
_WOBBLE, TIPS = 11, 12


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors [..., 3] at length one; those of length zero stay."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > _MINIMUM_CROSS, length, 1.0)


def tangents(paths: np.ndarray) -> np.ndarray:
    """Unit tangents at the points of `paths` [path, point, 3]."""
    step = np.diff(paths, axis=1)
    inner = unit(step[:, 1:]) + unit(step[:, :-1])
    return unit(np.concatenate([step[:, :1], inner, step[:, -1:]], axis=1))


@dataclass
class Skeleton:
    """Lines that become tubes; all lines of a group have as many points."""

    stems: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    """Wood: paths [path, point, 3] and relative radii [path, point]."""
    green: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    """Culms and threads, which count as leaf."""
    leafy: np.ndarray | None = None
    """Twigs that bear leaves [path, point, 3]."""

    def scaled(self, factor: np.ndarray) -> "Skeleton":
        """The same with its paths stretched by `factor` [3]."""
        return Skeleton(
            [(paths * factor, radii) for paths, radii in self.stems],
            [(paths * factor, radii) for paths, radii in self.green],
            None if self.leafy is None else self.leafy * factor,
        )


def shoot_paths(
    drawn: ShootsDrawn, arch: np.ndarray, diameter: float, height: float, seed: int
) -> np.ndarray:
    """Shoots of a growth form [path, point, 3], a little crooked; `arch` [path] as `Shoots` has
    it."""
    part, foot, tip, top = drawn
    number = len(part)
    s = np.linspace(0.0, 1.0, STEM_POINTS)
    distance = diameter * (foot[:, None] + (tip - foot)[:, None] * s ** arch[:, None])
    turn = 2.0 * np.pi * part[:, None]
    level = height * top[:, None] * s
    paths = np.stack([distance * np.cos(turn), distance * np.sin(turn), level], axis=-1)

    # Three bends along a shoot, none at its foot; at most 2.5 % of its length each.
    rng = np.random.default_rng([seed, _WOBBLE])
    waves = np.arange(1, 4)
    phase = rng.uniform(0.0, 2.0 * np.pi, (number, 2, 3, 1))
    size = rng.normal(0.0, 0.01, (number, 2, 3, 1)) / waves[:, None]
    bend = (size * (np.sin(np.pi * waves[:, None] * s + phase) - np.sin(phase))).sum(axis=2)
    length = np.minimum(top * height, 2.0 * diameter)
    paths[..., :2] += length[:, None, None] * np.moveaxis(bend, 1, 2)
    return paths


def branched(trunks: np.ndarray, tips: np.ndarray, rise: float) -> Skeleton:
    """Twigs from trunks to all tips [tip, 3], each from the nearest place on what is there.

    A twig leaves its bearer at a place `rise` times its sideways reach below its tip, or lower,
    where it can (greedy trees after Cuntz et al. 2010). Radii follow the number of tips carried.
    """
    trunk_points = trunks.reshape(-1, 3)
    nearest = np.array([np.linalg.norm(trunk_points - tip, axis=1).min() for tip in tips])
    tips = tips[np.argsort(nearest, kind="stable")]
    n_trunks, per_trunk = trunks.shape[:2]
    total = n_trunks * per_trunk + len(tips) * _TWIG_POINTS
    points, ahead = np.empty((total, 3)), np.empty((total, 3))
    points[: len(trunk_points)] = trunk_points
    ahead[: len(trunk_points)] = tangents(trunks).reshape(-1, 3)
    bearer = np.empty(len(tips), int)
    twigs = np.empty((len(tips), _TWIG_POINTS, 3))
    part = np.linspace(0.0, 1.0, _TWIG_POINTS)[:, None]
    used = len(trunk_points)
    for index, tip in enumerate(tips):
        reach = tip - points[:used]
        sideways = np.hypot(reach[:, 0], reach[:, 1])
        cost = np.linalg.norm(reach, axis=1) + 2.0 * np.maximum(rise * sideways - reach[:, 2], 0.0)
        joint = int(np.argmin(cost))
        bearer[index] = joint
        start = points[joint]
        span = float(np.linalg.norm(tip - start))
        bend = start + 0.4 * span * unit(ahead[joint] + 0.8 * unit(tip - start))
        twig = (1 - part) ** 2 * start + 2 * part * (1 - part) * bend + part**2 * tip
        twigs[index] = twig
        points[used : used + _TWIG_POINTS] = twig
        ahead[used : used + _TWIG_POINTS] = tangents(twig[None])[0]
        used += _TWIG_POINTS

    # Tips carried beyond each point, summed from the last twig back to the trunks.
    carried = np.zeros(total)
    first = len(trunk_points)
    for index in range(len(tips) - 1, -1, -1):
        points_of_twig = slice(first + index * _TWIG_POINTS, first + (index + 1) * _TWIG_POINTS)
        carried[points_of_twig] = 1.0 + np.cumsum(carried[points_of_twig][::-1])[::-1]
        carried[bearer[index]] += carried[points_of_twig][0]
    on_trunks = carried[:first].reshape(n_trunks, per_trunk)
    on_trunks = 1.0 + np.cumsum(on_trunks[:, ::-1], axis=1)[:, ::-1]
    on_twigs = carried[first:].reshape(len(tips), _TWIG_POINTS)
    # The ends of the trunks bear leaves too.
    place = np.linspace(0.65, 1.0, _TWIG_POINTS) * (per_trunk - 1)
    low = np.minimum(place.astype(int), per_trunk - 2)
    share = (place - low)[:, None]
    ends = (1.0 - share) * trunks[:, low] + share * trunks[:, low + 1]
    # Stems also taper without twigs, by a third from foot to tip.
    taper = np.linspace(1.0, 0.67, per_trunk)
    return Skeleton(
        stems=[
            (trunks, on_trunks**_FLOW_POWER * taper),
            (twigs, on_twigs**_FLOW_POWER * np.linspace(1.0, 0.67, _TWIG_POINTS)),
        ],
        leafy=np.concatenate([twigs, ends]),
    )


def shrub(form: "GrowthForm", diameter: float, height: float, n_twigs: int, seed: int) -> Skeleton:
    """Stems of a form with a crown, and twigs into all of it."""
    assert form.shoots is not None
    plant = individual_of(form, seed, n_twigs)
    stems = crown_stems(form, plant)
    # A narrow crown has room for fewer stems: as many as stand in one as wide as it is tall.
    number = max(3, round(len(stems[0]) * min(1.0, diameter / height)))
    turn, foot, tip, top = (part[:number] for part in stems)
    arch = np.full(number, form.shoots.arch)
    trunks = shoot_paths((turn, foot, tip, top), arch, diameter, height, seed)
    uniform = quasi_random(n_twigs, 6, [seed, TIPS])
    tips = in_bunches(uniform, plant, plant.leafy, form.foliage.radius)
    tips = tips * [diameter, diameter, height]
    return branched(trunks, tips, rise=form.mesh.rise)
