"""Explicit three-dimensional meshes of taxa and growth forms: stems, and every leaf.

Shapes are those of the growth forms (`FORMS`) and of the individuals that `plant_model` makes: of
one seed the same outline and bunches, stems or strands, leaf angles and areas. What differs: a mesh
has as many culms and threads as its area takes, fewer stems where its crown is narrow, and is as
wide as stated on the mean of its two extents, lobes included. Dimensions come from table 1, leaf
sizes from `data/leaf_sizes.csv` (a source each), for other taxa both from the growth form. What a
mesh adds to the parametric form is the leaf as a body of its own, on a twig of its own, so that the
same plant can stand in a mesh renderer and, voxelised, in this one.
"""

from importlib import resources
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._counts import modelled_diameter
from fynjax.canopy._form import GrowthForm, MeshLeaf
from fynjax.canopy._lines import Skeleton
from fynjax.canopy._plant import Organ
from fynjax.canopy._table import table1_2006
from fynjax.canopy.forms import FORMS
from fynjax.canopy.mesh._generate_organs import Foliage, build_organs, lay_out
from fynjax.canopy.mesh._generate_parts import (
    OUTLINES,
    Surface,
    join,
    outline_area,
    outline_triangles,
)
from fynjax.canopy.mesh._plant_mesh import PlantMesh

if TYPE_CHECKING:
    import pandas as pd

_MOST_TWIGS = 900
_FIT_STEPS = 24
_LARGEST_MISS = 1e-3
_TRIAL = 100


class GeneratedPlant(eqx.Module):
    """A generated plant and what it was made with."""

    mesh: PlantMesh
    """Its triangles; materials "leaf", "wood" and "flower", those it has."""
    taxon: str = eqx.field(static=True)
    """Row of table 1, or the growth form again."""
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
    Near 1, but more where `max_triangles` asked for fewer and larger leaves, and less or more for
    plants so small, or area indices so low, that the least number of leaves is reached."""
    twig_radius: float = eqx.field(static=True)
    """Radius of the thinnest stems [m]; 0 without wood."""


def leaf_sizes() -> "pd.DataFrame":
    """Leaf size of each taxon of table 1, with its source.

    **Returns:** a pandas frame with the columns taxon, organ_form (blade, culm, thread or none),
    outline, length_mm, width_mm (the diameter of culms and threads) [mm], basis (species, genus or
    assumed) and source.
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
    """A mesh of one plant of a taxon or growth form, with individual leaves and stems.

    **Arguments:**

    - `taxon`: its name in `table1_2006()`, or that of a growth form (`FORMS`) for a plant of its
      usual size and leaves.
    - `seed`: fixes everything random; the same seed gives the same mesh.
    - `diameter`, `height`: of the crown and of the plant [m], 0.01 to 10; those of table 1 (mean
      diameter, maximum height) or of the form if left out.
    - `leaf_area_index`, `wood_area_index`: one-sided area of leaves, half the surface of the wood,
      per area of the crown's disc [-], 0 to 20; those of the form if left out. Leaves are
      added until their area is met; stems get the thickness that their area needs.
    - `flowering`: part of full bloom, 0 to 1; full bloom is the form's
      `flower_fraction` of the leaf area.
    - `max_triangles`: roughly the most triangles of the mesh, at least 2000. Where the leaves would
      take more, there are fewer and larger ones (`leaf_scale`).

    **Returns:** a `GeneratedPlant`. Leaf blades are flat sheets of two to five triangles, slightly
    arched; their normals follow the leaf angle distribution of the form. Stems, culms, threads and
    spikelets are closed tubes, of which half the surface is the one-sided area:
    `plant_model_from_mesh(mesh, n, solid_materials="closed")` counts so. Threads of the climber lie
    nearly level and have the normals of level cylinders. The areas are met to rounding, diameter
    and height to 1e-3. Not differentiable.

    **Raises:** `InputError` for an unknown taxon, sizes and areas out of range, and areas that do
    not fit into the size.

    >>> from fynjax.canopy import generate_plant, plant_model_from_mesh, table1_2006
    >>> taxon = table1_2006()["taxon"][0]
    >>> plant = generate_plant(taxon, seed=1, max_triangles=2000)
    >>> plant.mesh.materials
    ('leaf', 'wood')
    >>> model = plant_model_from_mesh(plant.mesh, 100, solid_materials="closed")
    >>> model.plant.position.shape
    (100, 3)
    """
    name, usual, leaf = _usual(taxon)
    form = FORMS[name]
    crown = usual[0] if diameter is None else float(diameter)
    tall = usual[1] if height is None else float(height)
    leaf_index = form.leaf_area_index if leaf_area_index is None else float(leaf_area_index)
    wood_index = form.wood_area_index if wood_area_index is None else float(wood_area_index)
    _check(crown, tall, leaf_index, wood_index, flowering, max_triangles)
    disc = np.pi * crown**2 / 4.0
    leaf_area = leaf_index * disc if form.leafy else 0.0
    wood_area = wood_index * disc if form.wood_area_index > 0.0 else 0.0
    flower_area = leaf_area * form.flower_fraction * flowering

    n_leaves = _leaf_count(leaf, leaf_area, max_triangles)
    skeleton = _skeleton(form, crown, tall, n_leaves, leaf, leaf_area, max_triangles, seed)
    # Laid out once on the plain skeleton, so that fitting it to its size only moves them.
    foliage = lay_out(form, skeleton, n_leaves, leaf, leaf_area, seed)
    stretch = np.ones(3)
    for _ in range(_FIT_STEPS):
        surfaces, scale, radius = build_organs(
            form, skeleton, foliage, stretch, leaf, leaf_area, wood_area, flower_area, seed
        )
        vertices = np.concatenate([surface.vertices for surface in surfaces.values()])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        wide = modelled_diameter(high[0] - low[0], high[1] - low[1])
        miss = np.array([crown / wide, crown / wide, tall / (high[2] - low[2])])
        if np.abs(miss - 1.0).max() < 1e-4:
            break
        stretch = stretch * miss
    _check_size(taxon, surfaces, wide, float(high[2] - low[2]), crown, tall, usual)
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
    return GeneratedPlant(mesh, taxon, name, float(wide), tallness, number, scale, radius)


def _usual(taxon: str) -> tuple[str, tuple[float, float], MeshLeaf]:
    """Growth form, usual crown diameter and height [m] and leaf of a taxon of table 1, or of a
    growth form of this name."""
    if taxon in FORMS:
        form = FORMS[taxon]
        return taxon, (form.diameter, form.height), form.mesh.leaf
    table = table1_2006().set_index("taxon")
    if taxon not in table.index:
        raise InputError(
            f"`taxon` must be one of {', '.join((*table.index, *FORMS))}, but is {taxon!r}"
        )
    row: dict[Any, Any] = table.loc[taxon].to_dict()
    size: dict[Any, Any] = leaf_sizes().set_index("taxon").loc[taxon].to_dict()
    leaf = MeshLeaf(
        size["organ_form"],
        size["outline"],
        float(size["length_mm"] or 0.0) / 1000.0,
        float(size["width_mm"] or 0.0) / 1000.0,
    )
    usual = row["mean_diameter_cm"] / 100.0, float(row["height_max_m"])
    return row["growth_form"], usual, leaf


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


def _check_size(
    taxon: str,
    surfaces: dict[Organ, Surface],
    wide: float,
    high: float,
    diameter: float,
    height: float,
    usual: tuple[float, float],
) -> None:
    """Raise `InputError` where the plant came out larger or smaller than it should."""
    if max(abs(wide / diameter - 1.0), abs(high / height - 1.0)) <= _LARGEST_MISS:
        return
    reach = {}
    for organ, surface in surfaces.items():
        size = np.ptp(surface.vertices, axis=0)
        reach[organ] = max((size[0] + size[1]) / 2.0 / diameter, size[2] / height)
    organ_too_large = max(reach, key=lambda organ: reach[organ]).name.lower()
    raise InputError(
        f"a {taxon} {diameter:g} m wide and {height:g} m tall has no room for its "
        f"{organ_too_large} area: with it the plant is {wide:.3g} m wide and {high:.3g} m tall. "
        "Take a lower `leaf_area_index` or `wood_area_index`, or a `diameter` and `height` nearer "
        f"the usual ({usual[0]:g} m and {usual[1]:g} m)"
    )


def _leaf_count(leaf: MeshLeaf, leaf_area: float, max_triangles: int) -> int:
    if leaf.kind != "blade" or leaf_area == 0.0:
        return 0
    outline = OUTLINES[leaf.outline]
    blade_area = outline_area(outline) * leaf.length * leaf.width
    most = 0.8 * max_triangles / outline_triangles(outline)
    return int(np.clip(round(leaf_area / blade_area), 12, most))


def _perimeter(sides: int) -> float:
    """Round a regular polygon whose corners are 1 from its middle."""
    return float(2.0 * sides * np.sin(np.pi / sides))


def _lengths(paths: np.ndarray) -> np.ndarray:
    """Length that each point of `paths` [path, point, 3] stands for."""
    step = 0.5 * np.linalg.norm(np.diff(paths, axis=1), axis=2)
    none = np.zeros((len(paths), 1))
    return np.concatenate([step, none], axis=1) + np.concatenate([none, step], axis=1)


def _skeleton(
    form: GrowthForm,
    diameter: float,
    height: float,
    n_leaves: int,
    leaf: MeshLeaf,
    leaf_area: float,
    max_triangles: int,
    seed: int,
) -> Skeleton:
    recipe = form.mesh
    number = 0
    if recipe.green_sides:
        # As many as make the area at the thickness of the leaf, by the lines of a trial.
        trial = recipe.lines(form, diameter, height, _TRIAL, seed)
        area = sum(
            0.25 * leaf.width * _perimeter(recipe.green_sides) * (_lengths(paths) * radii).sum()
            for paths, radii in trial.green
        )
        faces = sum(2 * recipe.green_sides * paths[..., 0].size for paths, _ in trial.green)
        most = 0.8 * max_triangles * _TRIAL / faces
        number = int(np.clip(round(_TRIAL * leaf_area / area), 8, max(8.0, most)))
    elif recipe.leaves_per_twig:
        most_twigs = min(_MOST_TWIGS, max(40, max_triangles // 180))
        number = int(np.clip(n_leaves / recipe.leaves_per_twig, 40, most_twigs))
    return recipe.lines(form, diameter, height, number, seed)


def _number(skeleton: Skeleton, foliage: Foliage | None) -> int:
    if foliage is not None:
        return len(foliage.size)
    return sum(len(paths) for paths, _ in skeleton.green)
