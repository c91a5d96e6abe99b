"""Plant models from triangle meshes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.canopy._counts import modelled_diameter
from fynjax.canopy._forms import build_plant, quasi_random, split_elements
from fynjax.canopy._plant import Organ, PlantModel


class MeshPlant(eqx.Module):
    """A mesh as a plant model, with the sizes and areas it had."""

    plant: PlantModel
    """Its shape."""
    width: float = eqx.field(static=True)
    """Extent along x [m]."""
    height: float = eqx.field(static=True)
    """Extent along y, "height" in the paper's eq. (7) [m]."""
    depth: float = eqx.field(static=True)
    """Extent along z: how tall the plant is [m]."""
    organ_area: Float[Array, " organ"]
    """One-sided area of leaf, wood and flower [m2]; scale with the square of the size."""

    @property
    def modelled_diameter(self) -> float:
        """Crown diameter, eq. (7) [m]."""
        return float(modelled_diameter(self.width, self.height))


def plant_model_from_mesh(
    mesh: Any,
    n_elements: int,
    organ_of_material: Mapping[str, Organ | str] | None = None,
    seed: int = 0,
    *,
    up: Literal["y", "z"] = "z",
    solid_materials: tuple[str, ...] = (),
    maximum_extent: float = 20.0,
) -> MeshPlant:
    """Sample a triangle mesh into area elements, in proportion to the area of its facets.

    The elements of an organ share its area equally, so that the one-sided area of the mesh is
    kept exactly, with any number of elements.

    **Arguments:**

    - `mesh`: a file trimesh reads (OBJ with MTL, PLY, STL, GLB), a `trimesh.Trimesh` or a
      `trimesh.Scene`; in metres.
    - `n_elements`: number of elements, shared among the organs by area, at least one each.
    - `organ_of_material`: organ ("leaf", "wood", "flower" or `Organ`) of each material name; a
      geometry without a material goes by its own name, a single mesh by "". Without a mapping
      everything is leaf.
    - `seed`: fixes the draw.
    - `up`: the vertical axis of the mesh; "y" turns it upright first.
    - `solid_materials`: materials modelled as closed surfaces (a stem as a tube). Light meets
      such a surface twice, so half of it is the one-sided area (Chen and Black 1992).
    - `maximum_extent`: a mesh larger than this [m] is taken to be in other units.

    x and y are centred on the bounding box and divided by the modelled diameter (eq. 7), z by
    the depth. Raises `InputError` for a mesh without faces or with no area, flat, not finite, in
    other units, or with a material that has no organ.
    """
    file = str(mesh) if isinstance(mesh, str | Path) else None
    parts = _parts(mesh)
    if not parts:
        raise InputError(
            "a plant mesh must have faces, but has none; is it a point cloud?", file=file
        )
    names = [name for name, _ in parts]
    triangles = np.concatenate([corners for _, corners in parts])
    if up not in ("y", "z"):
        raise InputError(f"`up` must be 'y' or 'z', but is {up!r}")
    if up == "y":  # a quarter turn about x: (x, y, z) -> (x, -z, y)
        triangles = np.stack([triangles[..., 0], -triangles[..., 2], triangles[..., 1]], axis=-1)
    low, high = _bounds(triangles, maximum_extent, file)

    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double = np.linalg.norm(cross, axis=1)
    if not double.sum() > 0.0:
        raise InputError("a plant mesh must have area, but all its faces are degenerate", file=file)
    normal = cross / np.where(double > 0.0, double, 1.0)[:, None]
    material = np.repeat(np.arange(len(parts)), [len(corners) for _, corners in parts])
    solid = np.isin(names, solid_materials)[material]
    area = 0.5 * double * np.where(solid, 0.5, 1.0)
    organ = np.array([int(_organ(name, organ_of_material, file)) for name in names])[material]
    organ_area = np.bincount(organ, weights=area, minlength=len(Organ))

    present = {o: float(organ_area[o]) for o in Organ if organ_area[o] > 0.0}
    if n_elements < len(present):
        raise InputError(f"`n_elements` must be at least {len(present)}, but is {n_elements}")
    chosen, weights = [], []
    for o, count in split_elements(n_elements, present).items():
        uniform = quasi_random(count, 2, [seed, int(o)])
        of_organ = np.flatnonzero(organ == o)
        # Equal steps through the facets' areas, from a random start: every large facet is hit.
        start = np.random.default_rng([seed, int(o)]).random()
        steps = (np.arange(count) + start) / count * organ_area[o]
        mass = np.cumsum(area[of_organ])
        chosen.append(of_organ[np.minimum(np.searchsorted(mass, steps), len(mass) - 1)])
        root = np.sqrt(uniform[:, :1])  # uniform in a triangle
        second = uniform[:, 1:]
        weights.append(np.concatenate([1 - root, root * (1 - second), root * second], axis=1))
    facet = np.concatenate(chosen)
    point = np.einsum("nc,ncd->nd", np.concatenate(weights), triangles[facet])

    width, height, depth = (float(side) for side in high - low)
    diameter = modelled_diameter(width, height)
    axis = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    position = (point - axis) / np.array([diameter, diameter, depth])
    plant = build_plant(position, normal[facet], organ[facet])
    return MeshPlant(plant, width, height, depth, jnp.asarray(organ_area))


def _parts(mesh: Any) -> list[tuple[str, np.ndarray]]:
    """(material name, corners [face, 3, 3]) of each geometry, in the frame of the whole."""
    import trimesh

    if isinstance(mesh, str | Path):
        try:
            mesh = trimesh.load(str(mesh), process=False)
        except Exception as error:  # trimesh's readers raise whatever they stumble over
            raise InputError(f"the mesh cannot be read: {error}", file=str(mesh)) from error
    pieces: list[tuple[str, Any, np.ndarray]] = []
    if isinstance(mesh, trimesh.Trimesh):
        pieces = [("", mesh, np.eye(4))]
    elif isinstance(mesh, trimesh.Scene):
        for node in mesh.graph.nodes_geometry:
            frame, name = mesh.graph[node]
            pieces.append((str(name), mesh.geometry[name], np.asarray(frame, float)))
    parts = []
    for own_name, geometry, frame in pieces:
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        vertices = np.asarray(geometry.vertices, float) @ frame[:3, :3].T + frame[:3, 3]
        material = getattr(getattr(geometry.visual, "material", None), "name", None)
        parts.append((str(material or own_name), vertices[np.asarray(geometry.faces)]))
    return parts


def _bounds(
    triangles: np.ndarray, maximum_extent: float, file: str | None
) -> tuple[np.ndarray, np.ndarray]:
    """Opposite corners of the bounding box, checked."""
    if not np.isfinite(triangles).all():
        raise InputError("the vertices of a plant mesh must be finite, but some are not", file=file)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    size = high - low
    if size.max() > maximum_extent:
        raise InputError(
            f"a plant mesh must be in metres and at most {maximum_extent:g} m large, but is "
            f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}: is it in centimetres or millimetres?",
            file=file,
        )
    if size.min() <= 0.0:
        raise InputError(
            f"a plant mesh must extend in x, y and z, but is flat: {size[0]:.4g} x {size[1]:.4g} "
            f"x {size[2]:.4g} m",
            file=file,
        )
    return low, high


def _organ(
    name: str, organ_of_material: Mapping[str, Organ | str] | None, file: str | None
) -> Organ:
    if organ_of_material is None:
        return Organ.LEAF
    if name not in organ_of_material:
        known = ", ".join(repr(key) for key in organ_of_material)
        raise InputError(
            f"material {name!r} must have an organ in `organ_of_material`, which has {known}; if "
            "that is no material of the plant, is the material file (MTL) missing beside the mesh?",
            file=file,
        )
    organ = organ_of_material[name]
    if isinstance(organ, str):
        if organ.upper() not in Organ.__members__:
            raise InputError(
                f"the organ of material {name!r} must be leaf, wood or flower, but is {organ!r}"
            )
        return Organ[organ.upper()]
    return Organ(organ)
