"""Plant models of the growth forms of low-stature shrubland, drawn from parametric crowns.

A crown is an envelope with an uneven outline, in which leaves stand in bunches at the ends of
shoots; each seed is another individual. All shapes are stated assumptions, meant to be replaced by
meshes (`plant_model_from_mesh`) where there are some. Positions are quasi-random (scrambled Halton
points), so that a few dozen elements already cover a crown. Lengths: x and y in crown diameters, z
in plant heights.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._angles import leaf_angle
from fynjax.canopy._plant import Organ, PlantModel

_QUANTILES = 512


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

    def points(self, uniform: np.ndarray, lowest: float = 0.0) -> np.ndarray:
        """Points for uniform numbers [n, 3], drawn from the foliage density above `lowest`."""
        height = np.linspace(max(self.base, lowest), 1.0, _QUANTILES)
        # Foliage at a height: its density times the area of the crown's cross-section.
        weight = self.radius(height) ** 2 * np.maximum(height, 1e-9) ** self.height_power
        z = _quantile(uniform[:, 0], height, weight)
        even = _around(self.radius(z) * np.sqrt(uniform[:, 1]), uniform[:, 2], z)
        return self._outwards(even, max(self.base, lowest))

    def _outwards(self, point: np.ndarray, lowest: float) -> np.ndarray:
        """Points of an even crown, moved away from its middle as `shell_power` asks."""
        middle = np.array([0.0, 0.0, max(self.widest, lowest)])
        away = point - middle
        inner, outer = np.ones(len(point)), np.full(len(point), 1e3)
        for _ in range(40):  # how far the envelope is, in distances of the point
            half = np.sqrt(inner * outer)
            x, y, z = (middle + half[:, None] * away).T
            inside = (z >= lowest) & (z <= 1.0)
            inside &= np.hypot(x, y) <= self.radius(np.clip(z, self.base, 1.0))
            inner, outer = np.where(inside, half, inner), np.where(inside, outer, half)
        share = 1.0 / inner
        further = share ** (3.0 / (3.0 + self.shell_power)) / share
        return middle + further[:, None] * away


@dataclass(frozen=True)
class Shoots:
    """Stems or culms that rise from the base and spread outwards."""

    number: int
    base_radius: float
    tip_radius: tuple[float, float]
    """Distance of the tips from the axis, least and largest."""
    tip_height: tuple[float, float]
    """Height of the tips: of the outermost, of the innermost."""
    arch: float
    """Distance from the axis grows with height to this power; 1 is a straight shoot."""
    thinning: float
    """Part of the base's thickness that is lost at the tip, 0 to 1."""

    def draw(self, number: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """`number` shoots: part of a full turn, distance of foot and of tip from the axis, height
        of the tip.

        Fixed by the seed alone, so that wood, culms and spikelets sit on the same shoots.
        """
        uniform = quasi_random(number, 3, [seed, len(Organ)])
        outward = np.sqrt(uniform[:, 1] / uniform[:, 1].max())
        low, high = self.tip_radius
        tip = low + (high - low) * outward
        outer, inner = self.tip_height
        top = inner + (outer - inner) * outward * (0.6 + 0.4 * uniform[:, 2])
        top *= inner / top.max()
        return uniform[:, 0], self.base_radius * outward, tip, top


@dataclass(frozen=True)
class Foliage:
    """How leaves stand together in a crown, and how uneven the crown is. Assumptions, chosen for
    the eye of a botanist and not fitted to anything."""

    bunches: int
    """Leafy shoots, or clumps of leaves, of a plant; an individual has 0.7 to 1.4 times as many."""
    radius: float
    """Of a bunch across its shoot, in crown diameters."""
    length: float
    """Of a bunch along its shoot, in plant heights."""
    outline: float
    """Variation of the outline: standard deviation over mean of the square of its distance from the
    axis, which keeps its area."""
    uneven: float
    """Share of their height by which the lowest shoots stay below the others."""
    bare: float
    """Share of the shoots that bear no leaves: dead tops."""


@dataclass(frozen=True)
class FormDefaults:
    """What a growth form has where the user gives nothing; see `FORM_DEFAULTS`."""

    leaf_area_index: float
    """One-sided area of leaves (or of green culms and threads) over the ground area of its crowns
    as seen from above [m2 m-2]."""
    wood_area_index: float
    """Half the surface of stems and branches below the shoots, and of dead stubs at the base, over
    the ground area of its crowns as seen from above [m2 m-2]."""
    flower_fraction: float
    """Flower area at full bloom per leaf area [-]."""
    shoot_clumping: float
    """Probability that light which a leaf scatters meets another leaf of its shoot [-], as far
    as the voxels do not show it. 0.44 is a pine shoot (Smolander and Stenberg 2005)."""
    dead_fraction: float
    """Share of the one-sided area of live shoots that is dead or woody [-]: old leaves and bracts,
    dead culms and sheaths on live ones, the twig that bears the leaves; see `FORM_DEFAULTS`."""
    leaf_angle: str
    """Distribution of the leaf normals (`leaf_angle`)."""
    leaf_diameter: float
    """Four times the area of a leaf's outline over its perimeter [m]: the diameter of a round leaf,
    and of the disc whose overlap with itself falls as fast when it is shifted a little, so that it
    makes the same hot spot."""
    description: str
    """The shape, in words."""


FORM_DEFAULTS: dict[str, FormDefaults] = {
    "upright_ericoid": FormDefaults(
        4.2, 0.40, 0.05, 0.19, 0.62, "erectophile", 0.0015,
        "Broom-like: crown widens upwards to 70 % of the height, long ascending shoots of uneven "
        "height with gaps between, small leaves pressed along them, flowers at their ends.",
    ),
    "rounded_shrub": FormDefaults(
        4.2, 0.50, 0.05, 0.21, 0.55, "spherical", 0.004,
        "Dome resting near the ground, foliage in many small tufts in its outer shell, many fine "
        "stems.",
    ),
    "tussock": FormDefaults(
        4.4, 0.05, 0.03, 0.10, 0.67, "erectophile", 0.0024,
        "Leafless green culms that fan out from a small base and arch over, some more than others, "
        "longer to one side; counted as leaf. "
        "Dead stubs at the base are wood, spikelets at the tips are flowers.",
    ),
    "broad_leaved": FormDefaults(
        5.4, 0.50, 0.01, 0.12, 0.41, "plagiophile", 0.023,
        "Ellipsoidal crown on a few stout stems, foliage in large clumps in its outer shell, "
        "oblique leaves.",
    ),
    "climber": FormDefaults(
        2.4, 0.0, 0.0, 0.12, 0.49, "planophile", 0.0024,
        "Shallow mat of green threads (counted as leaf) that wander over the top of its height, "
        "with holes, falling towards its rim: its height is that of the plants that it lies on. No "
        "wood and no visible flowers.",
    ),
    "deadwood": FormDefaults(
        0.0, 0.80, 0.0, 0.0, 0.0, "spherical", 0.005,
        "Bare stems from the base, eight to twelve, forked above, upright to leaning far outwards, "
        "some of them low; wood only.",
    ),
}  # fmt: skip
"""Areas, dead tissue, clumping and leaf angles of each growth form: starting values for a
calibration. Leaf area indices, shares of dead tissue and clumping are the means of the shipped
prior, learned from the spectra of 18 BioSCape plots (`fynjax learn`), to two digits; its file has
their errors and the spread between plots. Leaf area counts dead tissue: some half of it is green.
Areas of wood and flowers and leaf angles are assumed. Leaf diameters are the means over the taxa of
each form in `data/leaf_sizes.csv`, which has a source each, but for Clutia, whose leaves are those
of no ericoid shrub; outlines are taken for rectangles, culms and threads for strips. That of
deadwood is assumed."""

CROWNS = {
    "upright_ericoid": Crown(0.12, 0.70, 1.6, 2.5, height_power=2.0, shell_power=1.0),
    "rounded_shrub": Crown(0.0, 0.35, 2.5, 2.2, height_power=0.3, shell_power=1.5),
    "broad_leaved": Crown(0.12, 0.60, 2.0, 2.0, height_power=0.3, shell_power=1.5),
}
SHOOTS = {
    "upright_ericoid": Shoots(12, 0.03, (0.05, 0.40), (0.75, 0.95), 1.4, 0.7),
    "rounded_shrub": Shoots(20, 0.03, (0.05, 0.42), (0.35, 0.90), 1.1, 0.7),
    "tussock": Shoots(48, 0.12, (0.05, 0.50), (0.55, 1.00), 1.6, 0.3),
    "broad_leaved": Shoots(8, 0.04, (0.10, 0.40), (0.60, 0.90), 1.5, 0.6),
    "deadwood": Shoots(12, 0.04, (0.05, 0.50), (0.25, 1.00), 1.0, 0.6),
}
FOLIAGE = {
    "upright_ericoid": Foliage(34, 0.085, 0.45, outline=0.40, uneven=0.25, bare=0.08),
    "rounded_shrub": Foliage(70, 0.085, 0.18, outline=0.30, uneven=0.12, bare=0.03),
    "broad_leaved": Foliage(24, 0.15, 0.24, outline=0.45, uneven=0.15, bare=0.05),
    "tussock": Foliage(48, 0.0, 0.0, outline=0.45, uneven=0.0, bare=0.0),
    "climber": Foliage(20, 0.03, 0.0, outline=0.60, uneven=0.0, bare=0.0),
    "deadwood": Foliage(12, 0.0, 0.0, outline=0.45, uneven=0.0, bare=0.0),
}
_LOBES = 5
"""Waves round the axis of which an outline is made: the first shifts it to a side, the second makes
it longer than wide, the others are lobes."""
_LEAST_REACH = 0.15
"""Least square of an outline's distance from the axis, over its mean."""
_FEWEST_DEAD, _LEANING = 8, 0.25
"""Fewest stems of dead wood, and the share of its stems that lean low."""
_SINKS, _THICK = 0.2, 0.15
"""How far a climber's mat lies lower at its rim than in its middle, and how thick it is, in parts
of its height: it rests on what bears it."""
_STEPS = 64
"""Places of which a thread is made."""
_FLOWERS_ABOVE = 0.75
_FLOWERING = 0.8
"""Flowers stand beyond this part of a bunch's half length."""
_SHARE = {Organ.LEAF: 0.75, Organ.WOOD: 0.17, Organ.FLOWER: 0.08}


def plant_model(
    form: str,
    n_elements: int,
    *,
    seed: int,
    share: Mapping[Organ, float] = MappingProxyType(_SHARE),
) -> PlantModel:
    """The plant model of a growth form, as area elements in crown coordinates.

    **Arguments:**

    - `form`: upright_ericoid, rounded_shrub, tussock, broad_leaved, climber or deadwood;
      `FORM_DEFAULTS[form].description` describes the shape of each.
    - `n_elements`: number of area elements, at least 3. Where a form has several organs about 75 %
      are leaf, 17 % wood and 8 % flower, whatever their areas: the areas come with `instantiate`.
    - `seed`: the same seed gives the same plant.
    - `share`: of the elements that each organ gets, in any unit, instead of these. Organs that the
      form does not have count for nothing.

    The outline of the crown departs from a circle by lobes, and has its area. Leaves stand in
    bunches at the ends of shoots, with gaps between; some shoots are bare. Flowers stand on the
    highest. Leaf normals follow the form's leaf angle distribution, those of stems and culms are
    perpendicular to them, flowers are planophile. Azimuths are uniform.

    **Returns:** a `PlantModel`. Its shape is fixed: there is nothing to differentiate in.

    **Raises:** `InputError` for another form, or fewer than 3 elements.

    >>> from fynjax.canopy import Organ, plant_model
    >>> plant = plant_model("rounded_shrub", 100, seed=1)
    >>> plant.position.shape, int((plant.organ == Organ.LEAF).sum())
    ((100, 3), 75)
    >>> round(float(plant.area_fraction[plant.organ == Organ.LEAF].sum()), 6)
    1.0
    """
    if form not in FORM_DEFAULTS:
        raise InputError(f"`form` must be one of {', '.join(FORM_DEFAULTS)}, but is {form!r}")
    if n_elements < 3:
        raise InputError(f"`n_elements` must be at least 3, one an organ, but is {n_elements}")
    defaults = FORM_DEFAULTS[form]
    bears = {
        Organ.LEAF: defaults.leaf_area_index > 0.0,
        Organ.WOOD: defaults.wood_area_index > 0.0,
        Organ.FLOWER: defaults.flower_fraction > 0.0,
    }
    counts = split_elements(n_elements, {organ: share[organ] for organ in Organ if bears[organ]})
    plant = individual_of(form, seed, max(counts.get(Organ.LEAF, 1), 1))
    positions, normals = [], []
    for organ, count in counts.items():
        # Own stream for each organ: the leaves stay where they are if the stems change.
        uniform = quasi_random(count, 6, [seed, int(organ)])
        position, normal = _ELEMENTS[organ](form, uniform, seed, plant)
        positions.append(position)
        normals.append(normal)
    return build_plant(
        np.concatenate(positions),
        np.concatenate(normals),
        np.repeat([int(organ) for organ in counts], list(counts.values())),
    )


def build_plant(position: np.ndarray, normal: np.ndarray, organ: np.ndarray) -> PlantModel:
    """Plant model of elements that share their organ's area equally."""
    per_organ = np.bincount(organ, minlength=len(Organ))
    normal = np.where(normal[:, 2:] < 0.0, -normal, normal)
    return PlantModel(
        jnp.asarray(position),
        jnp.asarray(1.0 / per_organ[organ]),
        jnp.asarray(normal),
        jnp.asarray(organ, jnp.int32),
    )


def shoot_number(form: str) -> int:
    """Stems or culms of a growth form's model; 0 of one without.

    **Arguments:** `form`, a key of `FORM_DEFAULTS`.
    """
    return SHOOTS[form].number if form in SHOOTS else 0


def split_elements(n_elements: int, share: dict[Organ, float]) -> dict[Organ, int]:
    """Whole numbers of elements, at least one each, in proportion to `share`."""
    total = sum(share.values())
    counts = {organ: max(1, round(n_elements * part / total)) for organ, part in share.items()}
    largest = max(counts, key=lambda organ: counts[organ])
    counts[largest] += n_elements - sum(counts.values())
    return counts


def quasi_random(count: int, dimensions: int, seed: int | list[int]) -> np.ndarray:
    """Scrambled Halton points [count, dimensions] in [0, 1)."""
    from scipy.stats import qmc  # late: it takes half of the package's import time

    return qmc.Halton(dimensions, scramble=True, rng=np.random.default_rng(seed)).random(count)


@dataclass(frozen=True)
class Individual:
    """What the organs of one plant share: its outline and where its shoots end."""

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
    turn = 2.0 * np.pi * np.arange(_QUANTILES) / _QUANTILES
    waves = np.arange(1, _LOBES + 1)
    size = variation * rng.rayleigh(1.0, _LOBES) / np.sqrt(waves * np.sum(1.0 / waves))
    phase = rng.uniform(0.0, 2.0 * np.pi, _LOBES)
    square = 1.0 + np.sum(size * np.cos(np.outer(turn, waves) + phase), axis=1)
    square = np.maximum(square, _LEAST_REACH)
    return np.sqrt(square / square.mean())


def individual_of(form: str, seed: int, most_bunches: int) -> Individual:
    """One plant of a growth form, with `most_bunches` at most."""
    foliage = FOLIAGE[form]
    rng = np.random.default_rng([seed, len(Organ) + 1])
    reach = _outline(foliage.outline, rng)
    number = max(1, min(round(foliage.bunches * rng.uniform(0.7, 1.4)), most_bunches))
    if form not in CROWNS:
        nothing = np.zeros((number, 3))
        return Individual(reach, nothing, nothing, np.full(number, 1.0 / number))
    centre = CROWNS[form].points(quasi_random(number, 3, [seed, len(Organ) + 2]))
    lower = 1.0 - foliage.uneven * rng.random(number) ** 2
    highest = np.argmax(centre[:, 2])  # it makes the height of the plant
    lower[highest] = 1.0
    # Along its shoot, which rises from the foot of the plant and bends outwards.
    direction = centre.copy()
    direction[:, 2] = np.maximum(centre[:, 2], 0.5)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along = 0.5 * foliage.length * direction
    centre[:, :2] *= 1.0 - 1.6 * foliage.radius
    rise = along[:, 2]
    centre[:, 2] = np.clip(centre[:, 2], rise, 1.0 - rise) * lower
    leafy = np.exp(0.3 * rng.standard_normal(number))
    bare = rng.random(number) < foliage.bare
    bare[highest] = False
    leafy[bare] = 0.0
    plant = Individual(reach, centre, along, leafy / leafy.sum())
    return Individual(reach, plant.widened(centre), along, plant.leafy)


def _leaf_elements(
    form: str, uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    if form == "tussock":
        position, normal = _along_shoots(form, uniform, seed)
        return plant.widened(position), normal
    normal = _normals(uniform[:, 3:5], FORM_DEFAULTS[form].leaf_angle)
    if form == "climber":
        return plant.widened(_threads(uniform, seed, len(plant.leafy))), normal
    return in_bunches(uniform, plant, plant.leafy, FOLIAGE[form].radius), normal


def in_bunches(
    uniform: np.ndarray,
    plant: Individual,
    share: np.ndarray,
    radius: float,
    lowest: float = -1.0,
) -> np.ndarray:
    """Points in bunches that have the `share` of them, for uniform numbers [n, 6]; above `lowest`
    of their half lengths."""
    bunch = np.searchsorted(np.cumsum(share), uniform[:, 0] * share.sum(), side="right")
    bunch = np.minimum(bunch, len(share) - 1)
    # Even in an ellipsoid: its cross-section falls as 1 - part^2 to both ends.
    ends = np.linspace(lowest, 1.0, _QUANTILES)
    part = _quantile(uniform[:, 5], ends, 1.0 - ends**2)
    distance = radius * np.sqrt((1.0 - part**2) * uniform[:, 1])
    aside = _around(distance, uniform[:, 2], np.zeros(len(uniform)))
    position = plant.centre[bunch] + plant.along[bunch] * part[:, None] + aside
    position[:, 2] = np.clip(position[:, 2], 0.0, 1.0)
    return position


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


def _threads(uniform: np.ndarray, seed: int, number: int) -> np.ndarray:
    """Points along the threads of a mat."""
    paths = thread_paths(seed, number)
    at = uniform[:, 1] * (_STEPS - 1)
    low = np.minimum(at.astype(int), _STEPS - 2)
    thread = np.minimum((uniform[:, 0] * number).astype(int), number - 1)
    point = paths[thread, low] + (at - low) * (paths[thread, low + 1] - paths[thread, low])
    radius = FOLIAGE["climber"].radius
    aside = radius * np.sqrt(uniform[:, 5]) * np.exp(2j * np.pi * uniform[:, 2])
    depth = np.random.default_rng([seed, len(Organ) + 6]).random(number)
    return on_mat(point + aside, depth[thread])


def _wood_elements(
    form: str, uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    if form in CROWNS:
        return _along_stems(form, uniform, plant)
    position, normal = _along_shoots(form, uniform, seed, (0.0, 0.3 if form == "tussock" else 1.0))
    if form == "deadwood":
        position = _forked(position, uniform, seed)
    return plant.widened(position), normal


def _flower_elements(
    form: str, uniform: np.ndarray, seed: int, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    if form == "tussock":
        position, normal = _along_shoots(form, uniform, seed, (0.85, 1.0))
        return plant.widened(position), normal
    # On the upper ends of the shoots that reach so high.
    end = plant.centre[:, 2] + _FLOWERING * plant.along[:, 2]
    high = (plant.leafy > 0.0) & (end >= min(_FLOWERS_ABOVE, end[plant.leafy > 0.0].max()))
    radius = FOLIAGE[form].radius
    position = in_bunches(uniform, plant, high.astype(float), radius, lowest=_FLOWERING)
    return position, _normals(uniform[:, 3:5], "planophile")


_ELEMENTS = {
    Organ.LEAF: _leaf_elements,
    Organ.WOOD: _wood_elements,
    Organ.FLOWER: _flower_elements,
}


ShootsDrawn = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def crown_stems(form: str, plant: Individual) -> ShootsDrawn:
    """Stems that rise from the foot into the highest bunches, as `Shoots.draw` has them."""
    shoots = SHOOTS[form]
    ends = plant.centre[np.argsort(-plant.centre[:, 2])[: shoots.number]]
    turn = np.arctan2(ends[:, 1], ends[:, 0]) / (2.0 * np.pi)
    tip = np.hypot(ends[:, 0], ends[:, 1])
    return turn, np.minimum(shoots.base_radius, tip), tip, ends[:, 2]


def free_shoots(form: str, seed: int, number: int) -> tuple[ShootsDrawn, np.ndarray]:
    """Culms, or stems of dead wood, at most `number`, and how each of them is arched: some bend
    over more than others."""
    shoots = SHOOTS[form]
    rng = np.random.default_rng([seed, len(Organ) + 5])
    bend = rng.uniform(0.6, 1.6, number)
    if form == "deadwood":
        number = int(rng.integers(min(_FEWEST_DEAD, number), number + 1))
    drawn = shoots.draw(number, seed)
    if form == "deadwood":
        top = drawn[3]  # the highest stands; it makes the height of the plant
        leaning = (rng.random(number) < _LEANING) & (np.arange(number) != np.argmax(top))
        drawn = (*drawn[:3], top * np.where(leaning, rng.uniform(0.3, 0.8, number), 1.0))
    return drawn, shoots.arch * bend[:number]


def _along_stems(
    form: str, uniform: np.ndarray, plant: Individual
) -> tuple[np.ndarray, np.ndarray]:
    """Elements on the stems of a crown."""
    drawn = crown_stems(form, plant)
    arch = np.full(len(drawn[0]), SHOOTS[form].arch)
    return _on_shoots(SHOOTS[form], drawn, uniform, (0.0, 1.0), arch)


def _along_shoots(
    form: str, uniform: np.ndarray, seed: int, part: tuple[float, float] = (0.0, 1.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Elements on shoots of a form, between two relative heights of each."""
    drawn, arch = free_shoots(form, seed, SHOOTS[form].number)
    return _on_shoots(SHOOTS[form], drawn, uniform, part, arch)


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


def _on_shoots(
    shoots: Shoots,
    drawn: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
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
    along = np.linspace(part[0], part[1], _QUANTILES)
    s = _quantile(uniform[:, 1], along, 1.0 - shoots.thinning * along)
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
    side = _around(np.ones(len(turn)), turn + 0.25, np.zeros(len(turn)))
    roll = 2.0 * np.pi * uniform[:, 5:6]
    return position, np.cos(roll) * side + np.sin(roll) * np.cross(tangent, side)


def _normals(uniform: np.ndarray, name: str) -> np.ndarray:
    """Unit normals [n, 3] of a leaf angle distribution, for uniform numbers [n, 2]."""
    inclination = np.linspace(0.0, 0.5 * np.pi, _QUANTILES)
    density = np.asarray(leaf_angle(name).inclination_density(jnp.asarray(inclination)), float)
    tilt = _quantile(uniform[:, 0], inclination, np.maximum(density, 0.0))
    normal = _around(np.sin(tilt), uniform[:, 1], np.cos(tilt))
    return normal


def _quantile(uniform: np.ndarray, nodes: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Quantiles of a density given at equally spaced `nodes` (need not be normalised)."""
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.interp(uniform, mass / mass[-1], nodes)


def _around(distance: np.ndarray, turn: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Cartesian points for a distance from the axis, a part of a full turn, and a height."""
    angle = 2.0 * np.pi * turn
    return np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=-1)
