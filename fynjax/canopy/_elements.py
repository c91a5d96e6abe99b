"""Where the area elements of a plant lie: crowns, shoots, bunches of leaves.

A crown is an envelope with an uneven outline, in which leaves stand in bunches at the ends of
shoots; each seed is another individual. Positions are quasi-random (scrambled Halton points), so
that a few dozen elements already cover a crown. Lengths: x and y in crown diameters, z in plant
heights.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import jax.numpy as jnp
import numpy as np

from fynjax._core.seeds import generator
from fynjax.canopy._angles import leaf_angle
from fynjax.canopy._plant import Organ

if TYPE_CHECKING:
    from fynjax.canopy._form import GrowthForm

Part = TypeVar("Part", bound=Hashable)
QUANTILES = 512


@dataclass(frozen=True)
class Crown:
    """An envelope of revolution and how the foliage is spread in it.

    The radius is 1/2 at the height `widest` and falls to zero at `base` and at the top, as
    (1/2) sqrt(1 - distance^p), with p = `taper_below` or `taper_above` (2 is an ellipse, less is
    nearer a cone, more is nearer a cylinder).
    """

    base: float
    widest: float
    taper_below: float
    taper_above: float
    height_power: float
    """Foliage density grows with height to this power; 0 is even."""
    shell_power: float
    """Foliage density grows with the distance from the axis at `widest`, as a share of that of the
    envelope, to this power; 0 is even."""

    def radius(self, height: np.ndarray) -> np.ndarray:
        below = np.clip((self.widest - height) / (self.widest - self.base), 0.0, 1.0)
        above = np.clip((height - self.widest) / (1.0 - self.widest), 0.0, 1.0)
        distance = np.where(height < self.widest, below**self.taper_below, above**self.taper_above)
        return 0.5 * np.sqrt(1.0 - distance)

    def points(self, uniform: np.ndarray) -> np.ndarray:
        """Points for uniform numbers [n, 3], drawn from the foliage density."""
        height = np.linspace(self.base, 1.0, QUANTILES)
        # Foliage at a height: its density times the area of the crown's cross-section.
        weight = self.radius(height) ** 2 * np.maximum(height, 1e-9) ** self.height_power
        z = quantile(uniform[:, 0], height, weight)
        even = _around(self.radius(z) * np.sqrt(uniform[:, 1]), uniform[:, 2], z)
        # From an even crown away from its middle, as `shell_power` asks.
        middle = np.array([0.0, 0.0, self.widest])
        away = even - middle
        inner, outer = np.ones(len(even)), np.full(len(even), 1e3)
        for _ in range(40):  # how far the envelope is, in distances of the point
            half = np.sqrt(inner * outer)
            x, y, z = (middle + half[:, None] * away).T
            inside = (z >= self.base) & (z <= 1.0)
            inside &= np.hypot(x, y) <= self.radius(np.clip(z, self.base, 1.0))
            inner, outer = np.where(inside, half, inner), np.where(inside, outer, half)
        # Of even points the share s of the way out is below x with probability x^3; with foliage as
        # s^p it is so for s^(3 / (3 + p)).
        share = 1.0 / inner
        further = share ** (3.0 / (3.0 + self.shell_power)) / share
        return middle + further[:, None] * away


@dataclass(frozen=True)
class Shoots:
    """Stems or culms that rise from the base and spread outwards.

    In a crown stems end in its highest bunches, and `tip_radius` and `tip_height` do nothing.
    """

    number: int
    base_radius: float
    tip_radius: tuple[float, float]
    """Distance of the tips from the axis, least and largest."""
    tip_height: tuple[float, float]
    """Height of the tips: of the outermost, of the innermost."""
    arch: float
    """Distance from the axis grows with height to this power: 1 is a straight shoot, more rises
    first and then bends outwards, less leaves the axis first and then rises."""
    thinning: float
    """Part of the base's thickness that is lost at the tip, 0 to 1, of a straight shoot."""
    fewest: int | None = None
    """Fewest shoots of an individual; None: all have `number`."""
    leaning: float = 0.0
    """Share of the shoots that lean low."""

    def draw(self, number: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """`number` shoots: part of a full turn, distance of foot and of tip from the axis, height
        of the tip.

        Fixed by the seed alone, so that wood, culms and spikelets sit on the same shoots.
        """
        uniform = quasi_random(number, 3, [seed, len(Organ)])
        # Even over a disc, of which the outermost shoot stands on the edge.
        outward = np.sqrt(uniform[:, 1] / uniform[:, 1].max())
        low, high = self.tip_radius
        tip = low + (high - low) * outward
        outer, inner = self.tip_height
        top = inner + (outer - inner) * outward * (0.6 + 0.4 * uniform[:, 2])
        top *= inner / top.max()
        return uniform[:, 0], self.base_radius * outward, tip, top


@dataclass(frozen=True)
class Foliage:
    """Bunches of leaves in a crown, and the unevenness of its outline. Assumptions, chosen for
    the eye of a botanist and not fitted to anything."""

    bunches: int
    """Leafy shoots, or clumps of leaves, of a plant; an individual has 0.7 to 1.4 times as many."""
    radius: float
    """Radius of a bunch of leaves across its shoot [crown diameters]."""
    length: float
    """Length of a bunch of leaves along its shoot [plant heights]."""
    outline: float
    """Variation of the outline: standard deviation over mean of the square of its distance from the
    axis, which keeps its area. A side that reaches less far has as many leaves, closer together."""
    uneven: float
    """Share of their height by which the lowest shoots stay below the others."""
    bare: float
    """Share of the shoots that bear no leaves: dead tops."""


_LOBES = 5
"""Waves round the axis of which an outline is made: the first shifts it to a side, the second makes
it longer than wide, the others are lobes."""
_LEAST_REACH = 0.15
"""Least square of an outline's distance from the axis, over its mean."""
FLOWERS_ABOVE = 0.75
"""Flowers stand on shoots that reach this part of the height."""
_FLOWERING = 0.8
"""Flowers stand beyond this part of a bunch's half length."""


def split_elements(n_elements: int, share: dict[Part, float]) -> dict[Part, int]:
    """Whole numbers of elements, at least one each, in proportion to `share`."""
    total = sum(share.values())
    counts = {organ: max(1, round(n_elements * part / total)) for organ, part in share.items()}
    largest = max(counts, key=lambda organ: counts[organ])
    counts[largest] += n_elements - sum(counts.values())
    return counts


def quasi_random(count: int, dimensions: int, seed: int | list[int]) -> np.ndarray:
    """Scrambled Halton points [count, dimensions] in [0, 1)."""
    from scipy.stats import qmc  # late: it takes half of the package's import time

    return qmc.Halton(dimensions, scramble=True, rng=generator(*np.ravel(seed).tolist())).random(
        count
    )


@dataclass(frozen=True)
class Individual:
    """Outline of one plant and ends of its shoots, on which all its organs are laid."""

    reach: np.ndarray
    """Distance of the outline from the axis over even parts of a full turn, in crown radii."""
    centre: np.ndarray
    """Middles of the bunches [bunch, 3]."""
    along: np.ndarray
    """Half of a bunch along its shoot [bunch, 3]."""
    leafy: np.ndarray
    """Share of the leaves of each bunch; 0 of bare shoots."""

    def outline(self, turn: np.ndarray) -> np.ndarray:
        """Distance of the outline in parts of a full turn, in crown radii."""
        place = np.linspace(0.0, 1.0, len(self.reach) + 1)
        return np.interp(turn % 1.0, place, np.append(self.reach, self.reach[0]))

    def widened(self, position: np.ndarray) -> np.ndarray:
        """Points of a round crown in the plant's own outline."""
        turn = np.arctan2(position[:, 1], position[:, 0]) / (2.0 * np.pi)
        return position * np.stack([self.outline(turn)] * 2 + [np.ones(len(turn))], axis=-1)


def _outline(variation: float, rng: np.random.Generator) -> np.ndarray:
    """Distance of an outline from the axis over even parts of a full turn, in crown radii.

    The mean of its square is 1, so that the area is that of the circle.
    """
    turn = 2.0 * np.pi * np.arange(QUANTILES) / QUANTILES
    waves = np.arange(1, _LOBES + 1)
    # Amplitudes of a Gaussian outline: their variances fall as 1 / wave, and add up to that of
    # the square of the distance.
    size = variation * rng.rayleigh(1.0, _LOBES) / np.sqrt(waves * np.sum(1.0 / waves))
    phase = rng.uniform(0.0, 2.0 * np.pi, _LOBES)
    square = 1.0 + np.sum(size * np.cos(np.outer(turn, waves) + phase), axis=1)
    square = np.maximum(square, _LEAST_REACH)
    return np.sqrt(square / square.mean())


def individual_of(form: "GrowthForm", seed: int, most_bunches: int) -> Individual:
    """One plant of a growth form, with `most_bunches` at most."""
    foliage = form.foliage
    rng = generator(seed, len(Organ) + 1)
    reach = _outline(foliage.outline, rng)
    number = max(1, min(round(foliage.bunches * rng.uniform(0.7, 1.4)), most_bunches))
    if form.crown is None:
        nothing = np.zeros((number, 3))
        return Individual(reach, nothing, nothing, np.full(number, 1.0 / number))
    centre = form.crown.points(quasi_random(number, 3, [seed, len(Organ) + 2]))
    lower = 1.0 - foliage.uneven * rng.random(number) ** 2
    highest = np.argmax(centre[:, 2])  # it makes the height of the plant
    lower[highest] = 1.0
    # Along its shoot, which rises from the foot of the plant and bends outwards.
    direction = centre.copy()
    direction[:, 2] = np.maximum(centre[:, 2], 0.5)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along = 0.5 * foliage.length * direction
    # Bunches reach beyond their middles, which stand back from the edge, the top and the ground.
    centre[:, :2] *= 1.0 - 1.6 * foliage.radius
    rise = along[:, 2]
    centre[:, 2] = np.clip(centre[:, 2], rise, 1.0 - rise) * lower
    leafy = np.exp(0.3 * rng.standard_normal(number))
    bare = rng.random(number) < foliage.bare
    bare[highest] = False
    leafy[bare] = 0.0
    plant = Individual(reach, centre, along, leafy / leafy.sum())
    return replace(plant, centre=plant.widened(centre))


Elements = Callable[["GrowthForm", np.ndarray, int, Individual], tuple[np.ndarray, np.ndarray]]
"""Positions and normals [n, 3] of the elements of an organ: of a growth form, for uniform numbers
[n, 6], the plant's seed and its individual.

Of organs along shoots the first number chooses the shoot (of `form.shoots.number`, or of the
individual's strands) and the second the place along it; the third and sixth may move it aside. A
mesh has its stems, culms and threads along the elements that differ in the second alone."""


def leaves_in_bunches(
    form: "GrowthForm", uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    """Leaves in the bunches of a crown, inclined as the form has it (`Elements`)."""
    position = in_bunches(uniform, plant, plant.leafy, form.foliage.radius)
    return position, normals(uniform[:, 3:5], form.leaf_angle)


def flowers_on_top(
    form: "GrowthForm", uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    """Level flowers on the upper ends of the shoots that reach high (`Elements`)."""
    end = plant.centre[:, 2] + _FLOWERING * plant.along[:, 2]
    high = (plant.leafy > 0.0) & (end >= min(FLOWERS_ABOVE, end[plant.leafy > 0.0].max()))
    radius = form.foliage.radius
    position = in_bunches(uniform, plant, high.astype(float), radius, lowest=_FLOWERING)
    return position, normals(uniform[:, 3:5], "planophile")


def wood_of_stems(
    form: "GrowthForm", uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    """Wood on the stems of a crown (`Elements`)."""
    assert form.shoots is not None
    drawn = crown_stems(form, plant)
    arch = np.full(len(drawn[0]), form.shoots.arch)
    return _on_shoots(form.shoots, drawn, uniform, (0.0, 1.0), arch)


def along_shoots(low: float, high: float) -> Elements:
    """Elements on the free shoots of a form, between two parts of the length of each, in the
    outline of the individual."""

    def elements(
        form: "GrowthForm", uniform: np.ndarray, seed: int, plant: Individual
    ) -> tuple[np.ndarray, np.ndarray]:
        position, normal = shoot_elements(form, uniform, seed, low, high)
        return plant.widened(position), normal

    return elements


def shoot_elements(
    form: "GrowthForm", uniform: np.ndarray, seed: int, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and normals on the free shoots of a form, in a round plant."""
    assert form.shoots is not None
    drawn, arch = free_shoots(form.shoots, seed, form.shoots.number)
    return _on_shoots(form.shoots, drawn, uniform, (low, high), arch)


def in_bunches(
    uniform: np.ndarray, plant: Individual, share: np.ndarray, radius: float, lowest: float = -1.0
) -> np.ndarray:
    """Points in bunches that have the `share` of them, for uniform numbers [n, 6]; above `lowest`
    of their half lengths."""
    # The first number chooses the bunch, the sixth the place along it, two the place across it.
    bunch = np.searchsorted(np.cumsum(share), uniform[:, 0] * share.sum(), side="right")
    bunch = np.minimum(bunch, len(share) - 1)
    # Even in an ellipsoid: its cross-section falls as 1 - part^2 to both ends.
    ends = np.linspace(lowest, 1.0, QUANTILES)
    part = quantile(uniform[:, 5], ends, 1.0 - ends**2)
    distance = radius * np.sqrt((1.0 - part**2) * uniform[:, 1])
    aside = _around(distance, uniform[:, 2], np.zeros(len(uniform)))
    position = plant.centre[bunch] + plant.along[bunch] * part[:, None] + aside
    position[:, 2] = np.clip(position[:, 2], 0.0, 1.0)
    return position


ShootsDrawn = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def crown_stems(form: "GrowthForm", plant: Individual) -> ShootsDrawn:
    """Stems that rise from the foot into the highest bunches, as `Shoots.draw` has them."""
    assert form.shoots is not None
    ends = plant.centre[np.argsort(-plant.centre[:, 2])[: form.shoots.number]]
    turn = np.arctan2(ends[:, 1], ends[:, 0]) / (2.0 * np.pi)
    tip = np.hypot(ends[:, 0], ends[:, 1])
    return turn, np.minimum(form.shoots.base_radius, tip), tip, ends[:, 2]


def free_shoots(shoots: Shoots, seed: int, number: int) -> tuple[ShootsDrawn, np.ndarray]:
    """Culms or bare stems, at most `number`, and how each of them is arched: some bend over more
    than others."""
    rng = np.random.default_rng([seed, len(Organ) + 5])
    # Drawn for the most there can be: where there are fewer, they are the first of these.
    bend = rng.uniform(0.6, 1.6, number)
    if shoots.fewest is not None:
        number = int(rng.integers(min(shoots.fewest, number), number + 1))
    drawn = shoots.draw(number, seed)
    if shoots.leaning > 0.0:
        top = drawn[3]  # the highest stands; it makes the height of the plant
        low = (rng.random(number) < shoots.leaning) & (np.arange(number) != np.argmax(top))
        drawn = (*drawn[:3], top * np.where(low, rng.uniform(0.3, 0.8, number), 1.0))
    return drawn, shoots.arch * bend[:number]


def _on_shoots(
    shoots: Shoots,
    drawn: "ShootsDrawn",
    uniform: np.ndarray,
    part: tuple[float, float],
    arch: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Elements on the surfaces of shoots as `Shoots.draw` has them, between two relative heights.

    A shoot's elements stand for half its surface, with normals all round it: from any side
    their projected area is the silhouette of a thin cylinder (Chen and Black 1992).
    """
    turn, foot, tip, top = drawn
    shoot = np.minimum((uniform[:, 0] * len(turn)).astype(int), len(turn) - 1)
    along = np.linspace(part[0], part[1], QUANTILES)
    s = quantile(uniform[:, 1], along, 1.0 - shoots.thinning * along)
    arch = arch[shoot]
    distance = foot[shoot] + (tip - foot)[shoot] * s**arch
    turn = turn[shoot]
    position = _around(distance, turn, top[shoot] * s)

    # The inclination of a shoot is that of a plant as tall as its crown is wide.
    slope = (tip - foot)[shoot] * arch * s ** (arch - 1.0)
    radial = _around(np.ones(len(turn)), turn, np.zeros(len(turn)))
    tangent = radial * slope[:, None]
    tangent[:, 2] = top[shoot]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # Normals stand square on the shoot, at an even angle about it.
    side = _around(np.ones(len(turn)), turn + 0.25, np.zeros(len(turn)))
    roll = 2.0 * np.pi * uniform[:, 5:6]
    return position, np.cos(roll) * side + np.sin(roll) * np.cross(tangent, side)


def normals(uniform: np.ndarray, name: str) -> np.ndarray:
    """Unit normals [n, 3] of a leaf angle distribution, for uniform numbers [n, 2]."""
    inclination = np.linspace(0.0, 0.5 * np.pi, QUANTILES)
    density = np.asarray(leaf_angle(name).inclination_density(jnp.asarray(inclination)), float)
    tilt = quantile(uniform[:, 0], inclination, np.maximum(density, 0.0))
    return _around(np.sin(tilt), uniform[:, 1], np.cos(tilt))


def quantile(uniform: np.ndarray, nodes: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Quantiles of a density given at equally spaced `nodes` (need not be normalised)."""
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.interp(uniform, mass / mass[-1], nodes)


def _around(distance: np.ndarray, turn: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Cartesian points for a distance from the axis, a part of a full turn, and a height."""
    angle = 2.0 * np.pi * turn
    return np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=-1)
