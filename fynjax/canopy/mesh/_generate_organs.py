"""Leaves, stems and flowers of generated plants, at the area elements of their growth form.

Blades and petals lie at elements as the form draws them, with the elements' normals. Culms, threads
and stems are the lines that elements make which differ in their place along a shoot alone; each
part of a line between two such elements has the same area. A blade begins on the stem or twig that
is nearest to its element. Nothing else says where organs are.
"""

from dataclasses import dataclass, replace

import numpy as np

from fynjax.canopy._elements import Elements, Individual, individual_of, quasi_random
from fynjax.canopy._form import GrowthForm, LeafGeometry
from fynjax.canopy._plant import Organ
from fynjax.canopy.mesh._generate_parts import (
    OUTLINES,
    Surface,
    blades,
    outline_area,
    outline_triangles,
    tangents,
    tubes_of_area,
    unit,
)

_TUBES = {"culm": (10, 4), "thread": (32, 3), "stem": (12, 8)}
"""Points along a leaf that is no blade, and edges round it."""
_FINE, _COARSE, _FINE_FROM = (12, 5), (5, 3), 20_000
"""Points along a woody stem, and edges round it: from this number of triangles of the plant on, and
below."""
_TWIG_SIDES = 3
_MOST_TWIGS, _TRIANGLES_PER_TWIG = 900, 200
_ON_A_TWIG = 0.06
"""Width of all leaves of a twig, side by side [m]; more where there are the most twigs."""
_FORKS = 3
"""Lines that are looked for along a woody shoot."""
_CROOKED = 0.006
"""Size of one of the waves that bend a stem or culm, in crown diameters at the plant's top."""
_HANGING = 32
"""One in so many threads that lie on other plants hangs to the ground."""
_PETAL = LeafGeometry("blade", "petal", 0.004, 0.004)
_FLOWER_AREA, _TRIANGLES_PER_FLOWER = _PETAL.length * _PETAL.width, 80
_TWIG_POINTS = 6
_RISE = 0.7
"""Least slope at which a twig leaves its bearer: height gained over sideways reach."""
_FLOW_POWER = 1.0 / 2.2
"""A twig's radius grows with the number of tips that it carries to this power (1/3 in Murray's law,
1/2 in the pipe model)."""
_SIZE_SPREAD = 0.15
_TRIAL = 100
_LINES, _SIZES, _BENDS = 21, 22, 23  # streams of random numbers


@dataclass(frozen=True)
class Sheets:
    """Blades or petals."""

    shape: LeafGeometry
    """Usual size of the blades."""
    base: np.ndarray
    """Points at which blades sit on a twig [blade, 3] [m]."""
    normal: np.ndarray
    """Unit normals [blade, 3]."""
    axis: np.ndarray
    """Unit vectors from base to tip [blade, 3]."""
    size: np.ndarray
    """Length over that of all [blade]."""

    def surface(self, stretch: np.ndarray, area: float) -> tuple[Surface, float]:
        """The blades at stretched places, of a total area [m2], and their size per the usual."""
        outline = OUTLINES[self.shape.outline]
        scale = float(np.sqrt(area / (leaf_area(self.shape) * (self.size**2).sum())))
        for _ in range(2):  # the arch adds a little area, in proportion
            long, wide = (
                scale * side * self.size for side in (self.shape.length, self.shape.width)
            )
            made = blades(self.base * stretch, self.axis, self.normal, long, wide, outline)
            scale *= float(np.sqrt(area / made.area))
        return made, scale


@dataclass(frozen=True)
class Tubes:
    """Stems and twigs, culms, threads or spikelets."""

    lines: list[tuple[np.ndarray, np.ndarray]]
    """Paths [path, point, 3] [m] and relative radii [path, point]."""
    sides: list[int]
    """Edges round each of them."""
    beside: np.ndarray | None = None
    """Direction [path, 1, 3] in which the first paths stand off from their line by their radius,
    so that those that run along one line lie side by side."""

    def surface(self, stretch: np.ndarray, area: float) -> tuple[Surface, float]:
        """Closed tubes along stretched paths, half of whose surface is `area` [m2], and the factor
        of the radii."""
        lines = [(paths * stretch, radii) for paths, radii in self.lines]
        made, factor = tubes_of_area(lines, self.sides, area)
        if self.beside is not None:
            paths, radii = lines[0]
            lines[0] = paths + 1.2 * factor * radii[..., None] * self.beside, radii
            made, factor = tubes_of_area(lines, self.sides, area)
        return made, factor


def lay_out(
    form: GrowthForm,
    leaf: LeafGeometry,
    size: np.ndarray,
    area: dict[Organ, float],
    max_triangles: int,
    seed: int,
) -> dict[Organ, Sheets | Tubes]:
    """The organs that have an area, before they get it.

    **Arguments:**

    - `form`, `leaf`: the growth form, and its leaf.
    - `size`: crown diameter twice, and height [m].
    - `area`: one-sided area of each organ [m2].
    - `max_triangles`: roughly the most triangles of all.
    - `seed`: of the individual.
    """
    plant = individual_of(form, seed, 2 * form.foliage.bunches)
    made: dict[Organ, Sheets | Tubes] = {}

    def drawn(elements: Elements, organ: Organ, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and normals of as many elements, as `plant_model` draws them."""
        uniform = quasi_random(number, 6, [seed, int(organ)])
        position, normal = elements(form, uniform, seed, plant)
        return position * size, normal

    wood = None
    if area[Organ.WOOD] > 0.0 or leaf.kind == "blade":
        wood = _stems(form, plant, size, max_triangles, seed)
    if leaf.tubular and area[Organ.LEAF] > 0.0:
        green = area[Organ.LEAF]
        form, made[Organ.LEAF] = _tubes(form, leaf, plant, size, green, max_triangles, seed)
    elif wood is not None and area[Organ.LEAF] > 0.0:
        most = 0.8 * max_triangles / outline_triangles(OUTLINES[leaf.outline])
        number = int(np.clip(round(area[Organ.LEAF] / leaf_area(leaf)), 12, most))
        position, normal = drawn(form.leaf_elements, Organ.LEAF, number)
        most_twigs = min(_MOST_TWIGS, max_triangles // _TRIANGLES_PER_TWIG)
        tips = position[: int(np.clip(number * leaf.width / _ON_A_TWIG, 10, most_twigs))]
        wood.lines.append(_twigs(wood.lines[0][0], tips))
        wood.sides.append(_TWIG_SIDES)
        spread = np.random.default_rng([seed, _SIZES]).normal(0.0, _SIZE_SPREAD, number)
        made[Organ.LEAF] = _sheets(leaf, position, normal, np.exp(spread), wood)
    if wood is not None and area[Organ.WOOD] > 0.0:
        made[Organ.WOOD] = wood
    if area[Organ.FLOWER] > 0.0:
        most = max_triangles // _TRIANGLES_PER_FLOWER
        number = max(3, min(round(area[Organ.FLOWER] / _FLOWER_AREA), most))
        if leaf.tubular:
            made[Organ.FLOWER] = _spikelets(form, plant, number, size, area[Organ.FLOWER], seed)
        elif wood is not None:
            petals = drawn(form.flower_elements, Organ.FLOWER, number)
            made[Organ.FLOWER] = _sheets(_PETAL, *petals, np.ones(number), wood)
    return made


def leaf_area(leaf: LeafGeometry) -> float:
    """Area of a flat blade [m2]."""
    return outline_area(OUTLINES[leaf.outline]) * leaf.length * leaf.width


def _lines(
    elements: Elements, form: GrowthForm, plant: Individual, number: int, points: int, seed: int
) -> np.ndarray:
    """Lines [line, point, 3] through the elements of evenly spread shoots, in crown units.

    Between neighbouring points lies the same part of a shoot's elements. About its shoot a line
    winds at its own distance.
    """
    rng = np.random.default_rng([seed, _LINES])
    along = np.linspace(1e-9, 1.0, points)  # the slope of an arch is not finite at its foot
    line = np.arange(number)[:, None]
    uniform = np.full((number, points, 6), 0.5)
    uniform[..., 0] = (line + 0.5) / number
    uniform[..., 1] = along
    uniform[..., 2] = (rng.random((number, 1)) + rng.normal(0.0, 2.0, (number, 1)) * along) % 1.0
    uniform[..., 5] = (line % _FORKS + rng.random((number, 1))) / _FORKS
    position, _ = elements(form, uniform.reshape(-1, 6), seed, plant)
    return _crooked(position, seed).reshape(number, points, 3)


def _crooked(position: np.ndarray, seed: int) -> np.ndarray:
    """Places [n, 3] in crown units moved aside, neighbours alike: no stem is straight."""
    rng = np.random.default_rng([seed, _BENDS])
    waves, phase = rng.normal(0.0, 10.0, (4, 2, 3)), rng.uniform(0.0, 2.0 * np.pi, (4, 2))
    bend = np.sin(np.einsum("kds,ns->nkd", waves, position) + phase).sum(axis=1)
    return position + _CROOKED * position[:, 2:] * np.pad(bend, ((0, 0), (0, 1)))


def _radii(paths: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Radii [path, point] with which all parts of a path have one area, in proportion to `weight`
    [path]; 1 on the mean over the lengths. Paths end in a tip."""
    length = np.linalg.norm(np.diff(paths, axis=1), axis=2)
    part = weight[:, None] / np.maximum(length, 1e-3 * length.mean())
    part *= length.sum() / (part * length).sum()
    # A point has the mean radius of the parts before and after it.
    radii = 0.5 * (np.pad(part, ((0, 0), (1, 0)), "edge") + np.pad(part, ((0, 0), (0, 1)), "edge"))
    radii[:, -1] *= 0.5
    return radii


def _stems(
    form: GrowthForm, plant: Individual, size: np.ndarray, max_triangles: int, seed: int
) -> Tubes:
    """Woody stems; the forks of one shoot lie side by side where they run along one line."""
    assert form.shoots is not None
    points, sides = _FINE if max_triangles >= _FINE_FROM else _COARSE
    number = _FORKS * form.shoots.number
    lines = _lines(form.wood_elements, form, plant, number, points, seed)
    lines, weight = np.unique(lines.round(9), axis=0, return_counts=True)
    paths = lines * size
    beside = None
    if weight.min() < _FORKS:  # the lines of a shoot differ: it is forked
        turn = 2.0 * np.pi * np.arange(len(lines))[:, None] / _FORKS
        beside = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    return Tubes([(paths, _radii(paths, weight))], [sides], beside)


def _tubes(
    form: GrowthForm,
    leaf: LeafGeometry,
    plant: Individual,
    size: np.ndarray,
    area: float,
    max_triangles: int,
    seed: int,
) -> tuple[GrowthForm, Tubes]:
    """As many culms or threads as make an area [m2], or the thick stems of the form; and the form
    with as many shoots."""
    points, sides = _TUBES[leaf.kind]

    def drawn(number: int) -> tuple[GrowthForm, np.ndarray]:
        made = form
        if form.shoots is not None:
            made = replace(form, shoots=replace(form.shoots, number=number))
        paths = _lines(made.leaf_elements, made, plant, number, points, seed)
        if paths[..., 2].min() > 0.1:  # nothing stands on the ground
            paths[::_HANGING, :, 2] *= 1.0 - np.linspace(0.0, 1.0, points) ** 1.5
        return made, paths * size

    if leaf.kind == "stem" and form.shoots is not None:
        number = form.shoots.number
    else:
        # As many as make the area at the usual thickness, half the surface of a tube each.
        length = np.linalg.norm(np.diff(drawn(_TRIAL)[1], axis=1), axis=2).sum() / _TRIAL
        each = 0.5 * leaf.width * sides * np.sin(np.pi / sides) * length
        most = 0.8 * max_triangles / (2 * sides * points)
        number = int(np.clip(round(area / each), 8, max(8.0, most)))
    made, paths = drawn(number)
    return made, Tubes([(paths, _radii(paths, np.ones(number)))], [sides])


def _twigs(stems: np.ndarray, tips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twigs to all `tips` [tip, 3], each from the nearest place on `stems` [stem, point, 3] or on
    an earlier twig.

    A twig begins `_RISE` times its sideways reach below its tip, or lower, where it can (greedy
    trees after Cuntz et al. 2010). Returns paths [tip, point, 3] and radii [tip, point], those of
    a stem being 1.
    """
    first = stems.shape[0] * stems.shape[1]
    points = np.empty((first + len(tips) * _TWIG_POINTS, 3))
    ahead = np.empty_like(points)
    points[:first], ahead[:first] = stems.reshape(-1, 3), tangents(stems).reshape(-1, 3)
    near = np.array([np.linalg.norm(points[:first] - tip, axis=1).min() for tip in tips])
    part = np.linspace(0.0, 1.0, _TWIG_POINTS)[:, None]
    bearer = np.empty(len(tips), int)
    # Tips near the stems first: their twigs bear those farther out.
    for index, tip in enumerate(tips[np.argsort(near, kind="stable")]):
        used = first + index * _TWIG_POINTS
        reach = tip - points[:used]
        # A joint that lies too high for the rise counts as farther away by twice as much.
        low = np.maximum(_RISE * np.hypot(reach[:, 0], reach[:, 1]) - reach[:, 2], 0.0)
        joint = bearer[index] = np.argmin(np.linalg.norm(reach, axis=1) + 2.0 * low)
        start = points[joint]
        span = np.linalg.norm(tip - start)
        bend = start + 0.4 * span * unit(ahead[joint] + 0.8 * unit(tip - start))
        # A Bezier curve that leaves its bearer partly along it.
        path = (1 - part) ** 2 * start + 2 * part * (1 - part) * bend + part**2 * tip
        points[used : used + _TWIG_POINTS] = path
        ahead[used : used + _TWIG_POINTS] = tangents(path[None])[0]

    # Tips carried beyond each point of a twig, summed from the last twig to the first.
    carried = np.zeros(len(points))
    for index in range(len(tips) - 1, -1, -1):
        twig = slice(first + index * _TWIG_POINTS, first + (index + 1) * _TWIG_POINTS)
        carried[twig] = 1.0 + np.cumsum(carried[twig][::-1])[::-1]
        carried[bearer[index]] += carried[twig][0]
    radii = (carried[first:].reshape(-1, _TWIG_POINTS) * len(stems) / len(tips)) ** _FLOW_POWER
    return points[first:].reshape(-1, _TWIG_POINTS, 3), np.minimum(radii, 1.0)


def _sheets(
    shape: LeafGeometry, position: np.ndarray, normal: np.ndarray, size: np.ndarray, stems: Tubes
) -> Sheets:
    """Blades that grow from the nearest place on a stem or twig towards their element."""
    from scipy.spatial import KDTree  # late: the parametric forms do without

    wood = np.concatenate([_finer(paths) for paths, _ in stems.lines])
    base = wood[KDTree(wood).query(position)[1]]
    away = position - base + 1e-6 * np.array([1.0, 0.6, 0.2])  # a tip lies at its element
    # Towards the element, as far as the blade can without leaving the normal.
    axis = unit(away - (away * normal).sum(axis=1, keepdims=True) * normal)
    return Sheets(shape, base, normal, axis, size)


def _finer(paths: np.ndarray) -> np.ndarray:
    """Points [n, 3] of paths [path, point, 3], and thirty between each two of them."""
    part = np.linspace(0.0, 1.0, 32)[:, None]
    return (paths[:, :-1, None] * (1.0 - part) + paths[:, 1:, None] * part).reshape(-1, 3)


def _spikelets(
    form: GrowthForm, plant: Individual, number: int, size: np.ndarray, area: float, seed: int
) -> Tubes:
    """Spikelets along the upper ends of culms, about five times as long as thick."""
    ends = []
    for step in (-0.05, 0.05):
        uniform = quasi_random(number, 6, [seed, int(Organ.FLOWER)])
        uniform[:, 1] = np.clip(uniform[:, 1] + step, 0.0, 1.0)
        ends.append(_crooked(form.flower_elements(form, uniform, seed, plant)[0], seed) * size)
    part = np.array([-0.5, -0.1, 0.5])[:, None]
    middle, ahead = 0.5 * (ends[0] + ends[1]), unit(ends[1] - ends[0])
    length = np.sqrt(area / (0.28 * number))
    paths = middle[:, None] + length * part * ahead[:, None]
    return Tubes([(paths, np.tile([0.3, 1.0, 0.2], (number, 1)))], [4])
