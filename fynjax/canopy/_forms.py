"""Plant models of the growth forms of low-stature shrubland, drawn from parametric crowns.

All shapes are stated assumptions, meant to be replaced by meshes (`plant_model_from_mesh`) where
there are some. Positions are quasi-random (scrambled Halton points), so that a few dozen elements
already cover a crown evenly. Lengths: x and y in crown diameters, z in plant heights.
"""

from dataclasses import dataclass

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
    """Foliage density grows with the distance from the axis to this power; 0 is even."""

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
        distance = self.radius(z) * uniform[:, 1] ** (1.0 / (2.0 + self.shell_power))
        return _around(distance, uniform[:, 2], z)


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
class FormDefaults:
    """What a growth form assumes where the user gives nothing. Assumptions, not measurements."""

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
        2.5, 0.40, 0.05, 0.5, 0.40, "erectophile", 0.0015,
        "Broom-like: crown widens upwards to 70 % of the height, foliage towards the top and the "
        "outside on ascending shoots, small leaves pressed along them.",
    ),
    "rounded_shrub": FormDefaults(
        3.0, 0.50, 0.05, 0.4, 0.30, "spherical", 0.004,
        "Dome resting near the ground, foliage in its outer shell, many fine stems.",
    ),
    "tussock": FormDefaults(
        2.0, 0.05, 0.03, 0.2, 0.45, "erectophile", 0.0024,
        "Leafless green culms that fan out from a small base and arch over; counted as leaf. "
        "Dead stubs at the base are wood, spikelets at the tips are flowers.",
    ),
    "broad_leaved": FormDefaults(
        3.5, 0.50, 0.01, 0.2, 0.25, "plagiophile", 0.023,
        "Ellipsoidal crown on a few stout stems, foliage in its outer shell, oblique leaves.",
    ),
    "climber": FormDefaults(
        1.5, 0.0, 0.0, 0.2, 0.30, "planophile", 0.0024,
        "Shallow mat of green threads (counted as leaf) draped over the upper part of its height, "
        "falling towards its rim; no wood and no visible flowers.",
    ),
    "deadwood": FormDefaults(
        0.0, 0.80, 0.0, 0.0, 0.0, "spherical", 0.005,
        "Bare stems and branches from the base, upright to leaning far outwards; wood only.",
    ),
}  # fmt: skip
"""Assumed areas and leaf angles of each growth form. Leaf area indices lie in the range of
0.5 to 4 that shrub crowns commonly show; all are starting values for a calibration. The shares of
dead tissue are near those with which the spectra of 18 BioSCape plots agree best when each form has
one value (0.43 in tussocks, 0.35 in ericoid, 0.25 in broad-leaved shrubs, 0.29 in domes); that of
climbers is assumed. Leaf diameters are the means over the taxa of each form in
`data/leaf_sizes.csv`, which has a source each, but for Clutia, whose leaves are those of no ericoid
shrub; outlines are taken for rectangles, culms and threads for strips. That of deadwood is
assumed."""

_CROWNS = {
    "upright_ericoid": Crown(0.12, 0.70, 1.6, 2.5, height_power=1.0, shell_power=1.0),
    "rounded_shrub": Crown(0.0, 0.35, 2.5, 2.2, height_power=0.3, shell_power=1.5),
    "broad_leaved": Crown(0.12, 0.60, 2.0, 2.0, height_power=0.3, shell_power=1.5),
}
_SHOOTS = {
    "upright_ericoid": Shoots(12, 0.03, (0.05, 0.40), (0.75, 0.95), 1.4, 0.7),
    "rounded_shrub": Shoots(20, 0.03, (0.05, 0.42), (0.35, 0.90), 1.1, 0.7),
    "tussock": Shoots(48, 0.12, (0.05, 0.50), (0.55, 1.00), 1.6, 0.3),
    "broad_leaved": Shoots(8, 0.04, (0.10, 0.40), (0.60, 0.90), 1.5, 0.6),
    "deadwood": Shoots(12, 0.04, (0.05, 0.50), (0.25, 1.00), 1.0, 0.6),
}
_FLOWERS_ABOVE = 0.75
_SHARE = {Organ.LEAF: 0.75, Organ.WOOD: 0.17, Organ.FLOWER: 0.08}


def plant_model(form: str, n_elements: int, *, seed: int) -> PlantModel:
    """The plant model of a growth form, as area elements in crown coordinates.

    **Arguments:**

    - `form`: upright_ericoid, rounded_shrub, tussock, broad_leaved, climber or deadwood;
      `FORM_DEFAULTS[form].description` describes the shape of each.
    - `n_elements`: number of area elements, at least 3. Where a form has several organs about 75 %
      are leaf, 17 % wood and 8 % flower, whatever their areas: the areas come with `instantiate`.
    - `seed`: the same seed gives the same plant.

    Leaf normals follow the form's leaf angle distribution, those of stems and culms are
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
    counts = split_elements(n_elements, {organ: _SHARE[organ] for organ in Organ if bears[organ]})
    positions, normals = [], []
    for organ, count in counts.items():
        # Own stream for each organ: the leaves stay where they are if the stems change.
        uniform = quasi_random(count, 6, [seed, int(organ)])
        position, normal = _ELEMENTS[organ](form, uniform, seed)
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


def _leaf_elements(form: str, uniform: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    if form == "tussock":
        return _along_shoots(_SHOOTS[form], uniform, seed)
    normal = _normals(uniform[:, 3:5], FORM_DEFAULTS[form].leaf_angle)
    if form == "climber":
        distance = 0.5 * np.sqrt(uniform[:, 1])
        surface = 1.0 - 0.35 * (2.0 * distance) ** 2
        return _around(distance, uniform[:, 2], surface - 0.25 * uniform[:, 0]), normal
    return _CROWNS[form].points(uniform), normal


def _wood_elements(form: str, uniform: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    upto = 0.3 if form == "tussock" else 1.0
    return _along_shoots(_SHOOTS[form], uniform, seed, (0.0, upto))


def _flower_elements(form: str, uniform: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    if form == "tussock":
        return _along_shoots(_SHOOTS[form], uniform, seed, (0.85, 1.0))
    normal = _normals(uniform[:, 3:5], "planophile")
    return _CROWNS[form].points(uniform, lowest=_FLOWERS_ABOVE), normal


_ELEMENTS = {
    Organ.LEAF: _leaf_elements,
    Organ.WOOD: _wood_elements,
    Organ.FLOWER: _flower_elements,
}


def _along_shoots(
    shoots: Shoots, uniform: np.ndarray, seed: int, part: tuple[float, float] = (0.0, 1.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Elements on the surfaces of shoots, between two relative heights of each shoot.

    A shoot's elements stand for half its surface, with normals all round it: from any side
    their projected area is the silhouette of a thin cylinder (Chen and Black 1992).
    """
    turn, foot, tip, top = shoots.draw(shoots.number, seed)
    shoot = np.minimum((uniform[:, 0] * shoots.number).astype(int), shoots.number - 1)
    along = np.linspace(part[0], part[1], _QUANTILES)
    s = _quantile(uniform[:, 1], along, 1.0 - shoots.thinning * along)
    distance = foot[shoot] + (tip - foot)[shoot] * s**shoots.arch
    turn = turn[shoot]
    position = _around(distance, turn, top[shoot] * s)

    # The inclination of a shoot is that of a plant as tall as its crown is wide.
    slope = (tip - foot)[shoot] * shoots.arch * s ** (shoots.arch - 1.0)
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
