"""Stems and threads of generated plants: lines in space, before they get a thickness.

Lengths in metres, the foot of the plant at the origin. The shapes are those of the parametric
growth forms (`_forms`), with the same numbers: of one seed the same outline, the same bunches in
which the twigs end, the same stems, culms and threads.
"""

from dataclasses import dataclass, field

import numpy as np

from fynjax.canopy._forms import (
    FOLIAGE,
    SHOOTS,
    ShootsDrawn,
    crown_stems,
    free_shoots,
    in_bunches,
    individual_of,
    on_mat,
    quasi_random,
    thread_paths,
)
from fynjax.canopy.mesh._generate_parts import tangents, unit

_STEM_POINTS = 14
_TWIG_POINTS = 6
_HANGING = 0.07
"""Share of a climber's threads that hang down to the ground."""
_FLOW_POWER = 1.0 / 2.2
"""A stem's section grows a little slower than the number of tips it carries (Murray's law is
1/3 for the radius, the pipe model 1/2)."""

# Streams of random numbers of one seed, beside those of `plant_model`.
_WOBBLE, _TIPS, _CULMS, _THREADS = 11, 12, 13, 14


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
    s = np.linspace(0.0, 1.0, _STEM_POINTS)
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


def shrub(form: str, diameter: float, height: float, n_twigs: int, seed: int) -> Skeleton:
    """Stems of an ericoid, rounded or broad-leaved shrub, with twigs into all of its crown."""
    plant = individual_of(form, seed, n_twigs)
    stems = crown_stems(form, plant)
    # A narrow crown has room for fewer stems: as many as stand in one as wide as it is tall.
    number = max(3, round(len(stems[0]) * min(1.0, diameter / height)))
    turn, foot, tip, top = (part[:number] for part in stems)
    arch = np.full(number, SHOOTS[form].arch)
    trunks = shoot_paths((turn, foot, tip, top), arch, diameter, height, seed)
    uniform = quasi_random(n_twigs, 6, [seed, _TIPS])
    tips = in_bunches(uniform, plant, plant.leafy, FOLIAGE[form].radius)
    tips = tips * [diameter, diameter, height]
    return branched(trunks, tips, rise=1.0 if form == "upright_ericoid" else 0.5)


def deadwood(diameter: float, height: float, n_twigs: int, seed: int) -> Skeleton:
    """Bare, leaning stems with a few broken side branches."""
    most = max(3, round(SHOOTS["deadwood"].number * min(1.0, diameter / height)))
    drawn, arch = free_shoots("deadwood", seed, most)
    trunks = shoot_paths(drawn, arch, diameter, height, seed)
    draw = quasi_random(n_twigs, 3, [seed, _TIPS])
    level = 0.25 + 0.7 * draw[:, 2]
    distance = diameter * (0.1 + 0.4 * np.sqrt(draw[:, 1])) * np.sqrt(level)
    turn = 2.0 * np.pi * draw[:, 0]
    tips = np.stack([distance * np.cos(turn), distance * np.sin(turn), height * level], axis=-1)
    bare = branched(trunks, tips, rise=0.7)
    return Skeleton(stems=bare.stems)


def tussock(diameter: float, height: float, n_culms: int, seed: int) -> Skeleton:
    """Culms that fan out and divide in two above the middle, and dead sheaths at their base."""
    shoots = SHOOTS["tussock"]
    plant = individual_of("tussock", seed, 1)
    drawn, arch = free_shoots("tussock", seed, n_culms)
    paths = shoot_paths(drawn, arch, diameter, height, seed)
    paths = plant.widened(paths.reshape(-1, 3)).reshape(paths.shape)
    rng = np.random.default_rng([seed, _CULMS])
    # A second branch leaves each culm above its middle and ends beside its tip.
    joint = rng.integers(_STEM_POINTS // 2, _STEM_POINTS - 4, n_culms)
    part = np.linspace(0.0, 1.0, _STEM_POINTS // 2)
    place = joint[:, None] + part * (_STEM_POINTS - 1 - joint)[:, None]
    low = np.minimum(place.astype(int), _STEM_POINTS - 2)
    share = (place - low)[..., None]
    row = np.arange(n_culms)[:, None]
    second = (1 - share) * paths[row, low] + share * paths[row, low + 1]
    aside = rng.normal(0.0, 0.10 * height, (n_culms, 3)) * [1.0, 1.0, 0.4]
    second = second + part[None, :, None] ** 1.3 * (aside * [1, 1, 0.5])[:, None, :]
    second[..., 2] = np.minimum(second[..., 2], height)
    thickness = np.linspace(1.0, 0.7, _STEM_POINTS)
    green = [
        (paths, np.broadcast_to(thickness, paths.shape[:2])),
        (second, np.broadcast_to(np.linspace(0.8, 0.6, len(part)), second.shape[:2])),
    ]
    # Dead sheaths: stubs round the foot, shorter outside.
    n_stubs = max(6, n_culms // 6)
    turn = rng.uniform(0.0, 2.0 * np.pi, n_stubs)
    distance = shoots.base_radius * diameter * np.sqrt(rng.random(n_stubs))
    level = height * rng.uniform(0.05, 0.16, n_stubs)
    s = np.linspace(0.0, 1.0, 4)
    out = distance[:, None] * (1.0 + 0.5 * s)
    stubs = np.stack(
        [out * np.cos(turn)[:, None], out * np.sin(turn)[:, None], level[:, None] * s], axis=-1
    )
    return Skeleton(
        stems=[(stubs, np.broadcast_to([1.0, 1.1, 1.0, 0.7], (n_stubs, 4)))], green=green
    )


def climber(diameter: float, height: float, n_threads: int, seed: int) -> Skeleton:
    """Threads that twine along the strands of a shallow mat, some hanging to the ground."""
    rng = np.random.default_rng([seed, _THREADS])
    plant = individual_of("climber", seed, n_threads)
    strands = thread_paths(seed, len(plant.leafy))
    mine = np.arange(n_threads) % len(strands)
    # About its strand a thread winds as it will, within the strand's width.
    steps = np.linspace(0.0, 1.0, strands.shape[1])
    turn = rng.random((n_threads, 1)) + rng.normal(0.0, 2.0, (n_threads, 1)) * steps
    aside = FOLIAGE["climber"].radius * np.sqrt(rng.random((n_threads, 1)))
    place = strands[mine] + aside * np.exp(2j * np.pi * turn)
    paths = on_mat(place, np.repeat(rng.random((n_threads, 1)), strands.shape[1], axis=1))
    hanging = rng.random(n_threads) < _HANGING
    paths[hanging, :, 2] *= 1.0 - steps**1.5
    paths = plant.widened(paths.reshape(-1, 3)).reshape(paths.shape)
    paths = paths * [diameter, diameter, height]
    return Skeleton(green=[(paths, np.full(paths.shape[:2], 1.0))])
