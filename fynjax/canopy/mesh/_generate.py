"""Explicit three-dimensional meshes of taxa and growth forms: stems, and every leaf.

Organs lie where the growth form has its area elements (`GrowthForm`), of one seed in the same
individual as `plant_model` makes. Dimensions come from table 1, leaf sizes from
`data/leaf_sizes.csv` (a source each), for other taxa both from the growth form. What a mesh adds:
each leaf is a body of its own, twigs join leaves to stems, and the mean of its two extents is the
stated diameter, lobes included. So the same plant can stand in a mesh renderer and, voxelised, in
this one.
"""

from typing import Any

import equinox as eqx
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._counts import modelled_diameter
from fynjax.canopy._form import LeafGeometry
from fynjax.canopy._plant import Organ
from fynjax.canopy._table import leaf_sizes, table1_2006
from fynjax.canopy.forms import FORMS
from fynjax.canopy.mesh._generate_organs import Sheets, Tubes, lay_out
from fynjax.canopy.mesh._generate_parts import Surface, join
from fynjax.canopy.mesh._plant_mesh import PlantMesh

_FIT_STEPS = 24
_LARGEST_MISS = 1e-3
_ENLARGED = 1.2


class GeneratedPlant(eqx.Module):
    """A generated plant and what it was made with."""

    mesh: PlantMesh
    """Triangles of the plant; materials "leaf", "wood" and "flower", those it has."""
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
      per area of the crown's disc [-], 0 to 20; those of the form if left out. There are as many
      leaves as make their area; stems get the thickness that their area needs.
    - `flowering`: part of full bloom, 0 to 1; full bloom is the form's
      `flower_fraction` of the leaf area.
    - `max_triangles`: roughly the most triangles of the mesh, at least 2000. Where the leaves would
      take more, there are fewer and larger ones (`leaf_scale`).

    **Returns:** a `GeneratedPlant`. Leaf blades are flat sheets of two to five triangles, slightly
    arched, with the normals of the form's area elements, each on the twig nearest to its element.
    Stems, culms, threads and spikelets are closed tubes along the form's elements, of which half
    the surface is the one-sided area, as `plant_model_from_mesh(mesh, n, solid_materials="closed")`
    counts. Twigs are wood that the elements lack. Threads of the climber have the normals of level
    cylinders, where its elements are planophile, and some hang to the ground. The areas are met to
    rounding, diameter and height to 1e-3. Not differentiable.

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
    area = {
        Organ.LEAF: leaf_area,
        Organ.WOOD: wood_index * disc if form.wood_area_index > 0.0 else 0.0,
        Organ.FLOWER: leaf_area * form.flower_fraction * flowering,
    }
    size = np.array([crown, crown, tall])
    organs = lay_out(form, leaf, size, area, max_triangles, seed)
    made, middle, extent = _fitted(organs, area, size)
    surfaces = {organ: surface for organ, (surface, _) in made.items()}
    scale = made[Organ.LEAF][1] if isinstance(organs.get(Organ.LEAF), Sheets) else 1.0
    _check_size(taxon, surfaces, extent, size, usual, scale)
    whole = join(list(surfaces.values()))
    counts = [len(surface.faces) for surface in surfaces.values()]
    mesh = PlantMesh(
        whole.vertices - middle,
        whole.faces,
        np.repeat(np.arange(len(counts)), counts),
        tuple(organ.name.lower() for organ in surfaces),
    )
    # Blades have a size over the usual, tubes a factor of relative radii [m].
    number, scale, radius = 0, 1.0, 0.0
    if Organ.LEAF in made:
        leaves, scale = organs[Organ.LEAF], made[Organ.LEAF][1]
        if isinstance(leaves, Tubes):
            number, scale = len(leaves.lines[0][0]), scale / (0.5 * leaf.width)
        else:
            number = len(leaves.size)
    wood = organs.get(Organ.WOOD)
    if isinstance(wood, Tubes):
        radius = made[Organ.WOOD][1] * min(float(radii.min()) for _, radii in wood.lines)
    return GeneratedPlant(
        mesh, taxon, name, float(extent[0]), float(extent[2]), number, scale, radius
    )


def _fitted(
    organs: dict[Organ, Sheets | Tubes], area: dict[Organ, float], size: np.ndarray
) -> tuple[dict[Organ, tuple[Surface, float]], np.ndarray, np.ndarray]:
    """Surfaces of organs, stretched until the plant has its `size`: across twice, and up [m]. Then
    the middle of its foot, and the size that it got.

    Organs were laid out once, so that this only moves them.
    """
    stretch = np.ones(3)
    for _ in range(_FIT_STEPS):
        made = {organ: laid.surface(stretch, area[organ]) for organ, laid in organs.items()}
        vertices = np.concatenate([surface.vertices for surface, _ in made.values()])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        wide = modelled_diameter(high[0] - low[0], high[1] - low[1])
        extent = np.array([wide, wide, high[2] - low[2]])
        if np.abs(size / extent - 1.0).max() < 1e-4:
            break
        stretch = stretch * (size / extent)
    return made, np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]]), extent


def _usual(taxon: str) -> tuple[str, tuple[float, float], LeafGeometry]:
    """Growth form, usual crown diameter and height [m] and leaf of a taxon of table 1, or of a
    growth form of this name."""
    if taxon in FORMS:
        form = FORMS[taxon]
        return taxon, (form.diameter, form.height), form.leaf
    table = table1_2006().set_index("taxon")
    if taxon not in table.index:
        raise InputError(
            f"`taxon` must be one of {', '.join((*table.index, *FORMS))}, but is {taxon!r}"
        )
    row: dict[Any, Any] = table.loc[taxon].to_dict()
    size: dict[Any, Any] = leaf_sizes().set_index("taxon").loc[taxon].to_dict()
    leaf = LeafGeometry(
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
    for name, value, low, high, unit in (
        ("diameter", diameter, 0.01, 10.0, "m (is it in centimetres?)"),
        ("height", height, 0.01, 10.0, "m (is it in centimetres?)"),
        ("leaf_area_index", leaf, 0.0, 20.0, "m2 m-2"),
        ("wood_area_index", wood, 0.0, 20.0, "m2 m-2"),
        ("flowering", flowering, 0.0, 1.0, "of full bloom"),
    ):
        if not low <= value <= high:
            raise InputError(f"`{name}` must be {low:g} to {high:g} {unit}, but is {value:g}")
    if leaf == 0.0 and wood == 0.0:
        raise InputError("a plant must have leaves or wood, but both area indices are 0")
    if triangles < 2000:
        raise InputError(f"`max_triangles` must be at least 2000, but is {triangles}")


def _check_size(
    taxon: str,
    surfaces: dict[Organ, Surface],
    made: np.ndarray,
    wanted: np.ndarray,
    usual: tuple[float, float],
    leaf_scale: float,
) -> None:
    """Raise `InputError` where the plant came out larger or smaller than it should: extents across
    (twice, their mean) and up [m] as made and as wanted."""
    if np.abs(made / wanted - 1.0).max() <= _LARGEST_MISS:
        return
    reach = {}
    for organ, surface in surfaces.items():
        x, y, z = np.ptp(surface.vertices, axis=0)
        reach[organ] = max(0.5 * (x + y) / wanted[0], z / wanted[2])
    organ_too_large = max(reach, key=lambda organ: reach[organ]).name.lower()
    remedy = "Take"
    if leaf_scale > _ENLARGED:
        remedy = (
            f"Its leaves are {leaf_scale:.2f} times as large as usual, and fewer: allow more "
            "`max_triangles`, or take"
        )
    raise InputError(
        f"a {taxon} {wanted[0]:g} m wide and {wanted[2]:g} m tall has no room for its "
        f"{organ_too_large} area: with it the plant is {made[0]:.3g} m wide and {made[2]:.3g} m "
        f"tall. {remedy} a lower `leaf_area_index` or `wood_area_index`, or a `diameter` and "
        f"`height` nearer the usual ({usual[0]:g} m and {usual[1]:g} m)"
    )
