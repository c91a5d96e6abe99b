"""Explicit three-dimensional meshes of the taxa of table 1: stems, and every leaf.

Shapes follow the growth forms of `FORM_DEFAULTS`: its crowns and shoots, its leaf angles and its
areas. Dimensions come from table 1, leaf sizes from `data/leaf_sizes.csv` (a source each). What a
mesh adds to the parametric form is the leaf as a body of its own, on a twig of its own, so that
the same plant can stand in a mesh renderer and, voxelised, in this one.
"""

from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._angles import leaf_angle
from fynjax.canopy._counts import modelled_diameter
from fynjax.canopy._forms import (
    _FLOWERS_ABOVE,
    _QUANTILES,
    FORM_DEFAULTS,
    _quantile,
    quasi_random,
)
from fynjax.canopy._generate_forms import Skeleton, climber, deadwood, shrub, tussock
from fynjax.canopy._generate_parts import (
    EMPTY,
    OUTLINES,
    Surface,
    blades,
    frames,
    join,
    outline_area,
    outline_triangles,
    tubes_of_area,
    unit,
)
from fynjax.canopy._mesh_plant import PlantMesh
from fynjax.canopy._plant import Organ
from fynjax.canopy._table import table1_2006

if TYPE_CHECKING:
    import pandas as pd

_GOLDEN_ANGLE = 2.399963  # rad: the usual spiral of leaves along a stem
_LEAVES_PER_TWIG = {"upright_ericoid": 100, "rounded_shrub": 45, "broad_leaved": 12}
_ANGLE_TO_TWIG = {"upright_ericoid": 25.0, "rounded_shrub": 50.0, "broad_leaved": 55.0}
_MOST_TWIGS = 900
_FLOWER_SIDE = 0.004
_SPIKELET = (0.006, 0.0012)
_LEAF_SIZE_SPREAD = 0.15
_FIT_STEPS = 12
_TRIAL = 100
_GREEN = {"climber": climber, "tussock": tussock}
_GREEN_SIDES = {"climber": 3, "tussock": 4}
_LEAVES, _FLOWERS = 21, 22


class GeneratedPlant(eqx.Module):
    """A generated plant and what it was made with."""

    mesh: PlantMesh
    """Its triangles; materials "leaf", "wood" and "flower", those it has."""
    taxon: str = eqx.field(static=True)
    """Row of table 1."""
    form: str = eqx.field(static=True)
    """Growth form."""
    diameter: float = eqx.field(static=True)
    """Mean of the extents along x and y [m]."""
    height: float = eqx.field(static=True)
    """Extent along z [m]."""
    n_leaves: int = eqx.field(static=True)
    """Leaf blades, or culms or threads where those count as leaf."""
    leaf_scale: float = eqx.field(static=True)
    """Length of a modelled leaf (or thickness of a culm) per that of the table of leaf sizes [-].
    1 but for rounding, more where `max_triangles` asked for fewer and larger leaves."""
    twig_radius: float = eqx.field(static=True)
    """Radius of the thinnest stems [m]; 0 without wood."""


@dataclass(frozen=True)
class _Leaf:
    kind: str
    outline: str
    length: float
    width: float


def leaf_sizes() -> "pd.DataFrame":
    """Leaf size of each taxon of table 1, with its source.

    Columns: taxon, organ_form (blade, culm, thread or none), outline, length_mm, width_mm (the
    diameter of culms and threads) [mm], basis (species, genus or assumed), source.
    """
    import pandas as pd  # late: the command line need not wait for it

    with (resources.files("fynjax.canopy") / "data" / "leaf_sizes.csv").open() as table:
        return pd.read_csv(table, keep_default_na=False)


def generate_plant(
    taxon: str,
    seed: int = 0,
    *,
    diameter: float | None = None,
    height: float | None = None,
    leaf_area_index: float | None = None,
    wood_area_index: float | None = None,
    flowering: float = 0.0,
    max_triangles: int = 200_000,
) -> GeneratedPlant:
    """A mesh of one plant of a taxon of table 1, with individual leaves and stems.

    **Arguments:**

    - `taxon`: its name in `table1_2006()`.
    - `seed`: fixes everything random; the same seed gives the same mesh.
    - `diameter`, `height`: of the crown and of the plant [m], positive; those of table 1 (mean
      diameter, maximum height) if left out.
    - `leaf_area_index`, `wood_area_index`: one-sided area of leaves, half the surface of the wood,
      per area of the crown's disc [-]; those of `FORM_DEFAULTS` if left out. Leaves are added
      until their area is met; stems are made as thick as their area asks.
    - `flowering`: part of full bloom, 0 to 1; full bloom is `FORM_DEFAULTS[...].flower_fraction`
      of the leaf area.
    - `max_triangles`: roughly the most triangles of the mesh. Where the leaves would take more,
      there are fewer and larger ones (`leaf_scale`).

    Leaf blades are flat sheets of two to five triangles, slightly arched; their normals follow
    the leaf angle distribution of the form. Stems, culms, threads and spikelets are closed tubes,
    of which half the surface is the one-sided area: `plant_model_from_mesh(mesh, n,
    solid_materials="closed")` counts so. Threads of the climber lie nearly level and have the
    normals of level cylinders.

    The areas are met to rounding, diameter and height to 1e-3. Raises `InputError` for an unknown
    taxon or sizes and areas out of range.
    """
    table = table1_2006().set_index("taxon")
    if taxon not in table.index:
        raise InputError(f"`taxon` must be one of {', '.join(table.index)}, but is {taxon!r}")
    row: dict[Any, Any] = table.loc[taxon].to_dict()
    form = row["growth_form"]
    defaults = FORM_DEFAULTS[form]
    crown = row["mean_diameter_cm"] / 100.0 if diameter is None else float(diameter)
    tall = float(row["height_max_m"]) if height is None else float(height)
    leaf_index = defaults.leaf_area_index if leaf_area_index is None else float(leaf_area_index)
    wood_index = defaults.wood_area_index if wood_area_index is None else float(wood_area_index)
    _check(crown, tall, leaf_index, wood_index, flowering, max_triangles)
    disc = np.pi * crown**2 / 4.0
    leaf_area = leaf_index * disc if defaults.leaf_area_index > 0.0 else 0.0
    wood_area = wood_index * disc if defaults.wood_area_index > 0.0 else 0.0
    flower_area = leaf_area * defaults.flower_fraction * flowering
    size: dict[Any, Any] = leaf_sizes().set_index("taxon").loc[taxon].to_dict()
    leaf = _Leaf(
        size["organ_form"],
        size["outline"],
        float(size["length_mm"] or 0.0) / 1000.0,
        float(size["width_mm"] or 0.0) / 1000.0,
    )

    n_leaves = _leaf_count(leaf, leaf_area, max_triangles)
    skeleton = _skeleton(form, crown, tall, n_leaves, leaf, leaf_area, max_triangles, seed)
    # Laid out once on the plain skeleton, so that fitting it to its size only moves them.
    foliage = _lay_out(form, skeleton, n_leaves, leaf, leaf_area, seed)
    stretch = np.ones(3)
    for _ in range(_FIT_STEPS):
        surfaces, scale, radius = _build(
            form, skeleton, foliage, stretch, leaf, leaf_area, wood_area, flower_area, seed
        )
        vertices = np.concatenate([surface.vertices for surface in surfaces.values()])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        wide = modelled_diameter(high[0] - low[0], high[1] - low[1])
        miss = np.array([crown / wide, crown / wide, tall / (high[2] - low[2])])
        if np.abs(miss - 1.0).max() < 1e-4:
            break
        stretch = stretch * miss
    middle = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    whole = join(list(surfaces.values()))
    counts = [len(surface.faces) for surface in surfaces.values()]
    mesh = PlantMesh(
        whole.vertices - middle,
        whole.faces,
        np.repeat(np.arange(len(counts)), counts),
        tuple(organ.name.lower() for organ in surfaces),
    )
    number = _number(skeleton, foliage)
    tallness = float(high[2] - low[2])
    return GeneratedPlant(mesh, taxon, form, float(wide), tallness, number, scale, radius)


def _check(
    diameter: float, height: float, leaf: float, wood: float, flowering: float, triangles: int
) -> None:
    for name, value, highest in (("diameter", diameter, 10.0), ("height", height, 10.0)):
        if not 0.01 <= value <= highest:
            raise InputError(
                f"`{name}` must be 0.01 to {highest:g} m, but is {value:g}: is it in centimetres?"
            )
    for name, value in (("leaf_area_index", leaf), ("wood_area_index", wood)):
        if not 0.0 <= value <= 20.0:
            raise InputError(f"`{name}` must be 0 to 20 [m2 m-2], but is {value:g}")
    if leaf == 0.0 and wood == 0.0:
        raise InputError("a plant must have leaves or wood, but both area indices are 0")
    if not 0.0 <= flowering <= 1.0:
        raise InputError(f"`flowering` must be 0 to 1, a part of full bloom, but is {flowering:g}")
    if triangles < 2000:
        raise InputError(f"`max_triangles` must be at least 2000, but is {triangles}")


def _leaf_count(leaf: _Leaf, leaf_area: float, max_triangles: int) -> int:
    if leaf.kind != "blade" or leaf_area == 0.0:
        return 0
    outline = OUTLINES[leaf.outline]
    one = outline_area(outline) * leaf.length * leaf.width
    most = 0.8 * max_triangles / outline_triangles(outline)
    return int(np.clip(round(leaf_area / one), 12, most))


def _perimeter(sides: int) -> float:
    """Round a regular polygon whose corners are 1 from its middle."""
    return float(2.0 * sides * np.sin(np.pi / sides))


def _lengths(paths: np.ndarray) -> np.ndarray:
    """Length that each point of `paths` [path, point, 3] stands for."""
    step = 0.5 * np.linalg.norm(np.diff(paths, axis=1), axis=2)
    none = np.zeros((len(paths), 1))
    return np.concatenate([step, none], axis=1) + np.concatenate([none, step], axis=1)


def _skeleton(
    form: str,
    diameter: float,
    height: float,
    n_leaves: int,
    leaf: _Leaf,
    leaf_area: float,
    max_triangles: int,
    seed: int,
) -> Skeleton:
    if form == "deadwood":
        return deadwood(diameter, height, 14, seed)
    if form in ("climber", "tussock"):
        # As many as make the area at the thickness of the table, by the lines of a trial.
        trial = _GREEN[form](diameter, height, _TRIAL, seed)
        area = sum(
            0.25 * leaf.width * _perimeter(_GREEN_SIDES[form]) * (_lengths(paths) * radii).sum()
            for paths, radii in trial.green
        )
        faces = sum(2 * _GREEN_SIDES[form] * paths[..., 0].size for paths, _ in trial.green)
        most = 0.8 * max_triangles * _TRIAL / faces
        number = int(np.clip(round(_TRIAL * leaf_area / area), 8, max(8.0, most)))
        return _GREEN[form](diameter, height, number, seed)
    most_twigs = min(_MOST_TWIGS, max(40, max_triangles // 180))
    n_twigs = int(np.clip(n_leaves / _LEAVES_PER_TWIG[form], 40, most_twigs))
    return shrub(form, diameter, height, n_twigs, seed)


@dataclass(frozen=True)
class _Foliage:
    """Where each leaf sits: twig and place along it; how it points; its relative size."""

    twig: np.ndarray
    place: np.ndarray
    axis: np.ndarray
    normal: np.ndarray
    size: np.ndarray


def _lay_out(
    form: str, skeleton: Skeleton, n_leaves: int, leaf: _Leaf, leaf_area: float, seed: int
) -> _Foliage | None:
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
    opening = np.deg2rad(_ANGLE_TO_TWIG[form] * np.exp(rng.normal(0.0, 0.25, n_leaves)))
    cos, sin = np.cos(opening)[:, None], np.sin(opening)[:, None]
    natural = unit(sin * along - cos * out)
    natural = np.where(natural[:, 2:] < 0.0, -natural, natural)

    # The steepest leaf gets the steepest inclination of the distribution, and so on.
    tilt = np.empty(n_leaves)
    rank = (np.arange(n_leaves) + 0.5) / n_leaves
    tilts = _inclinations(rank, FORM_DEFAULTS[form].leaf_angle)
    tilt[np.argsort(-natural[:, 2], kind="stable")] = tilts
    azimuth = np.arctan2(natural[:, 1], natural[:, 0])
    normal = np.stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)], axis=-1
    )
    axis = cos * along + sin * out
    axis = unit(axis - (axis * normal).sum(axis=1, keepdims=True) * normal)
    size = np.exp(rng.normal(0.0, _LEAF_SIZE_SPREAD, n_leaves))
    return _Foliage(twig, place, axis, normal, size)


def _inclinations(uniform: np.ndarray, name: str) -> np.ndarray:
    """Quantiles of the inclination of the normal of a leaf angle distribution [rad]."""
    grid = np.linspace(0.0, 0.5 * np.pi, _QUANTILES)
    density = np.asarray(leaf_angle(name).inclination_density(jnp.asarray(grid)), float)
    return _quantile(uniform, grid, np.maximum(density, 0.0))


def _at(values: np.ndarray, path: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values [path, point, 3] at parts of the way along paths."""
    last = values.shape[1] - 1
    low = np.minimum((place * last).astype(int), last - 1)
    share = (place * last - low)[:, None]
    return (1.0 - share) * values[path, low] + share * values[path, low + 1]


def _build(
    form: str,
    skeleton: Skeleton,
    foliage: _Foliage | None,
    stretch: np.ndarray,
    leaf: _Leaf,
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
        surfaces[Organ.LEAF], factor = tubes_of_area(lines.green, _GREEN_SIDES[form], leaf_area)
        scale = factor / (0.5 * leaf.width)
    elif foliage is not None and lines.leafy is not None:
        base = _at(lines.leafy, foliage.twig, foliage.place)
        one = outline_area(OUTLINES[leaf.outline]) * leaf.length * leaf.width
        scale = float(np.sqrt(leaf_area / (one * (foliage.size**2).sum())))
        for _ in range(2):  # the arch adds a little area, in proportion
            long, wide = (scale * foliage.size * side for side in (leaf.length, leaf.width))
            made = blades(base, foliage.axis, foliage.normal, long, wide, OUTLINES[leaf.outline])
            surfaces[Organ.LEAF] = made
            scale *= float(np.sqrt(leaf_area / made.area))
    if lines.stems and wood_area > 0.0:
        surfaces[Organ.WOOD], factor = tubes_of_area(lines.stems, 4, wood_area)
        radius = factor * min(float(radii.min()) for _, radii in lines.stems)
    if flower_area > 0.0:
        surfaces[Organ.FLOWER] = _flowers(form, lines, flower_area, seed)
    return surfaces, scale, radius


def _flowers(form: str, lines: Skeleton, area: float, seed: int) -> Surface:
    """Spikelets at the tips of culms, or level petals about the upper tips of twigs."""
    rng = np.random.default_rng([seed, _FLOWERS])
    if form == "tussock":
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
    tips = tips[tips[:, 2] >= _FLOWERS_ABOVE * tips[:, 2].max()]
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


def _number(skeleton: Skeleton, foliage: _Foliage | None) -> int:
    if foliage is not None:
        return len(foliage.size)
    return sum(len(paths) for paths, _ in skeleton.green)
