"""A plant's mesh, what its materials stand for, and the plant model that is made of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax.canopy._counts import modelled_diameter
from fynjax.canopy._plant import Organ, PlantModel, organ_named, organ_of_name
from fynjax.canopy.mesh._facets import closed_faces, facets

_COLOURS = {Organ.LEAF: (0.24, 0.42, 0.14), Organ.WOOD: (0.36, 0.27, 0.20)}
_FLOWER_COLOUR = (0.85, 0.55, 0.65)
_LARGEST_SHRUB = 12.0
"""Beyond, a plant is more likely in another unit than so large [m]."""
_SMALLEST_EXTENT = 0.005
"""No plant of a plot is smaller [m]."""


@dataclass(frozen=True)
class PlantMaterial:
    """What a material of a mesh stands for."""

    organ: Organ | str
    """Organ: leaf, wood or flower."""
    optics: str = ""
    """Name of its optics, as a leaf table describes them; the organ's name if empty."""
    solid: bool | None = None
    """Whether it bounds solid bodies, so that half of its area counts; None leaves that to
    `solid_materials`."""


class PlantMesh(eqx.Module):
    """The triangles of one plant, each with a material."""

    vertices: Float[np.ndarray, "vertex 3"]
    """Corners, z upwards [m]."""
    faces: Int[np.ndarray, "face 3"]
    """Corners of each triangle, counter-clockwise from outside (or from a blade's upper side)."""
    material: Int[np.ndarray, " face"]
    """Index into `materials` of each triangle."""
    materials: tuple[str, ...] = eqx.field(static=True)
    """Names of the materials."""

    @property
    def triangles(self) -> Float[np.ndarray, "face 3 3"]:
        """The three corners of each triangle [m]."""
        return self.vertices[self.faces]

    @property
    def material_area(self) -> Float[np.ndarray, " material"]:
        """Area of all triangles of each material, both sides of a closed surface [m2]."""
        _, area = facets(self.triangles)
        return np.bincount(self.material, weights=area, minlength=len(self.materials))

    def is_closed(self, material: str) -> bool:
        """Whether the triangles of a material bound bodies: no edge is left open."""
        triangles = self.triangles[self.material == self.materials.index(material)]
        return len(triangles) > 0 and bool(closed_faces(triangles).all())

    def obj(self, material_file: str) -> tuple[str, str]:
        """The mesh as Wavefront OBJ (lengths to 1 nm) and the MTL text it names.

        `material_file` is the name the MTL text is to have. Materials are named as in
        `materials`; their colours are for show.
        """
        lines = ["# lengths in metres, z upwards", f"mtllib {material_file}"]
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in self.vertices.tolist()]
        colours = []
        for index, name in enumerate(self.materials):
            lines.append(f"usemtl {name}")
            corners = self.faces[self.material == index] + 1
            lines += [f"f {a} {b} {c}" for a, b, c in corners.tolist()]
            organ = organ_of_name(name)
            red, green, blue = _COLOURS.get(organ or Organ.LEAF, _FLOWER_COLOUR)
            colours.append(f"newmtl {name}\nKd {red} {green} {blue}\nillum 1\n")
        return "\n".join(lines) + "\n", "\n".join(colours)


class MeshPlant(eqx.Module):
    """A mesh (or a scan) as a plant model, with the sizes, areas and materials it had."""

    plant: PlantModel
    """Shape of the plant."""
    width: float = eqx.field(static=True)
    """Extent along x [m]."""
    height: float = eqx.field(static=True)
    """Extent along y, "height" in the paper's eq. (7) [m]."""
    depth: float = eqx.field(static=True)
    """Extent along z: how tall the plant is [m]."""
    organ_area: Float[Array, " organ"]
    """One-sided area of leaf, wood and flower [m2]; scale with the square of the size."""
    material: Int[Array, " element"]
    """Index into `materials` and `optics` of each element."""
    materials: tuple[str, ...] = eqx.field(static=True)
    """Names of the materials."""
    optics: tuple[str, ...] = eqx.field(static=True)
    """Name of the optics of each material; its organ's where none was stated."""
    solid_share: tuple[float, ...] = eqx.field(static=True)
    """Part of each material's area that bounds bodies, so that half of it counted [-]."""

    @property
    def modelled_diameter(self) -> float:
        """Crown diameter, eq. (7) [m]."""
        return float(modelled_diameter(self.width, self.height))

    @property
    def position(self) -> Float[Array, "element 3"]:
        """Elements in metres: x, y from the middle of the bounding box, z from its bottom."""
        diameter = self.modelled_diameter
        return jnp.asarray(self.plant.position) * jnp.asarray([diameter, diameter, self.depth])

    @property
    def area(self) -> Float[Array, " element"]:
        """One-sided area of each element [m2]."""
        return jnp.asarray(self.plant.area_fraction) * self.organ_area[self.plant.organ]


def mesh_plant(
    point: np.ndarray,
    normal: np.ndarray,
    area: np.ndarray,
    material: np.ndarray,
    materials: Mapping[str, PlantMaterial],
    box: tuple[np.ndarray, np.ndarray],
    solid_share: tuple[float, ...],
) -> MeshPlant:
    """Plant model of elements given in metres, with the sizes and areas it had.

    **Arguments:**

    - `point`: [element, 3] places of the elements [m].
    - `normal`: [element, 3] unit normals; their sign does not matter.
    - `area`: [element] one-sided areas [m2].
    - `material`: [element] index into `materials`.
    - `materials`: what each material stands for, by its name.
    - `box`: opposite corners of the box that the plant fills, lowest and highest [m].
    - `solid_share`: part of each material's area that bounds bodies [-].

    **Raises:** `InputError` where the elements of an organ have no area.
    """
    organs = [int(organ_named(kind.organ, name)) for name, kind in materials.items()]
    organ = np.array(organs)[material]
    organ_area = np.bincount(organ, weights=area, minlength=len(Organ))
    for kind in np.unique(organ):
        if not organ_area[kind] > 0.0:
            raise InputError(
                f"the {Organ(kind).name.lower()} of a plant must have area, but all of it is "
                f"{organ_area[kind]:g} m2: duplicate points?"
            )
    low, high = box
    width, height, depth = (float(side) for side in high - low)
    diameter = modelled_diameter(width, height)
    axis = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    plant = PlantModel(
        jnp.asarray((point - axis) / np.array([diameter, diameter, depth])),
        jnp.asarray(area / organ_area[organ]),
        jnp.asarray(np.where(normal[:, 2:] < 0.0, -normal, normal)),
        jnp.asarray(organ, jnp.int32),
    )
    optics = tuple(
        kind.optics or Organ(of).name.lower()
        for of, kind in zip(organs, materials.values(), strict=True)
    )
    return MeshPlant(
        plant,
        width,
        height,
        depth,
        jnp.asarray(organ_area),
        jnp.asarray(material, jnp.int32),
        tuple(materials),
        optics,
        solid_share,
    )


def check_extent(
    points: np.ndarray, maximum_extent: float, file: str | None, what: str = "a plant mesh"
) -> tuple[np.ndarray, np.ndarray]:
    """Opposite corners of the bounding box of points [n, 3], checked."""
    if not np.isfinite(points).all():
        raise InputError(f"the vertices of {what} must be finite, but some are not", file=file)
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    box = f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}"
    if size.max() > maximum_extent:
        larger = ". Where it is so large, raise `maximum_extent`"
        raise InputError(
            f"{what} must be in metres and at most {maximum_extent:g} m large, but is {box}: is "
            "it in centimetres or millimetres? Then scale it, or state its unit"
            f"{larger if size.max() <= _LARGEST_SHRUB else ''}",
            file=file,
        )
    if 0.0 < size.max() < _SMALLEST_EXTENT:
        raise InputError(
            f"{what} must be in metres and at least {_SMALLEST_EXTENT:g} m large, but is {box}: is "
            "it in kilometres?",
            file=file,
        )
    if size.min() <= 0.0:
        raise InputError(f"{what} must extend in x, y and z, but is flat: {box} m", file=file)
    return low, high
