"""Branch-level models: one branch, instanced many times, makes a plant.

The paper turns each copy at random, with a spread sigma_rot that grows with the number of branches
towards an asymptote. It prints neither the curve nor its numbers, so both are assumptions here:
`branch_rotation_spread` is a saturating exponential that starts at zero for a single branch, which
then stands upright as a full-plant model does.
"""

from typing import TypeVar

import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._instances import random_orientation
from fynjax.canopy._plant import Organ
from fynjax.canopy.mesh._plant_mesh import MeshPlant, PlantMaterial, PlantMesh, mesh_plant

_Branch = TypeVar("_Branch", MeshPlant, PlantMesh)
_MOST_PARTS = 5_000_000
_MOST_SPREAD, _GROWTH = 35.0, 8.0
"""Spread of very many branches [degrees], and how many it takes to come near it."""


def branch_rotation_spread(branches: int) -> float:
    """sigma_rot of a plant made of so many copies of one branch [degrees]; 0 of a single one."""
    return -_MOST_SPREAD * float(np.expm1(-(branches - 1.0) / _GROWTH))


def plant_from_branches(
    branch: _Branch, branches: int, *, seed: int, rotation_spread: float | None = None
) -> _Branch:
    """A whole plant: copies of one branch, turned and tilted about its foot.

    **Arguments:**

    - `branch`: as elements (`plant_model_from_mesh`) or as triangles (`read_plant_mesh`); the
      result is of the same kind. Its foot is the middle of the bottom of its bounding box.
    - `branches`: number of copies, at least 1.
    - `seed`: fixes their azimuths (uniform) and tilts (sizes of normal numbers), which are those
      of `random_orientation`: elements and triangles of a branch make the same plant.
    - `rotation_spread`: sigma_rot [degrees, 0 to 90]; 35 (1 - exp(-(`branches` - 1) / 8)) if left
      out.

    **Returns:** the plant. All areas are `branches` times those of the branch. The bounding box is
    that of the copies (of the elements, which lie a little inside that of the triangles), so that
    `modelled_diameter` and `depth` suit eq. (5) to (9) with sigma_rot = 0. To instance the branch
    itself in a scene instead, give its species `branches` and `rotation_spread`. Not
    differentiable.

    **Raises:** `InputError` for fewer than one branch, a spread out of range, or more than 5
    million triangles or elements in all.
    """
    if int(branches) != branches or branches < 1:
        raise InputError(f"`branches` must be a whole number of at least 1, but is {branches}")
    spread = branch_rotation_spread(branches) if rotation_spread is None else rotation_spread
    if not 0.0 <= spread <= 90.0:
        raise InputError(f"`rotation_spread` must be 0 to 90 degrees, but is {spread}")
    is_mesh = isinstance(branch, PlantMesh)
    each = len(branch.faces if isinstance(branch, PlantMesh) else branch.material)
    if branches * each > _MOST_PARTS:
        parts = "triangles" if is_mesh else "elements"
        raise InputError(
            f"the copies of a branch may have {_MOST_PARTS} {parts} in all, but {branches} of "
            f"{each} make {branches * each}: lower `branches` to {max(_MOST_PARTS // each, 1)}, or "
            "take a coarser branch"
        )
    turns = _rotations(*random_orientation(int(branches), seed=seed, rotation_spread=spread))
    if isinstance(branch, PlantMesh):
        return _copy_mesh(branch, turns)
    return _copy_elements(branch, turns)


def _rotations(azimuth: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Matrices [copy, 3, 3] that lean a plant towards north, then turn it clockwise."""
    from scipy.spatial.transform import Rotation  # late: the parametric forms do without

    return Rotation.from_euler("xz", np.stack([-tilt, -azimuth], axis=-1), degrees=True).as_matrix()


def _copy_mesh(branch: PlantMesh, turns: np.ndarray) -> PlantMesh:
    low, high = branch.triangles.min(axis=(0, 1)), branch.triangles.max(axis=(0, 1))
    foot = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    copies = np.einsum("nij,vj->nvi", turns, branch.vertices - foot)
    first = np.arange(len(turns))[:, None, None] * len(branch.vertices)
    return PlantMesh(
        copies.reshape(-1, 3),
        (branch.faces[None] + first).reshape(-1, 3),
        np.tile(branch.material, len(turns)),
        branch.materials,
    )


def _copy_elements(branch: MeshPlant, turns: np.ndarray) -> MeshPlant:
    position = np.asarray(branch.position)
    point = np.einsum("nij,ej->nei", turns, position).reshape(-1, 3)
    normal = np.einsum("nij,ej->nei", turns, np.asarray(branch.plant.normal)).reshape(-1, 3)
    organ = np.asarray(branch.plant.organ)
    materials = {}
    for index, (name, optics) in enumerate(zip(branch.materials, branch.optics, strict=True)):
        owned = organ[np.asarray(branch.material) == index]
        materials[name] = PlantMaterial(Organ(int(owned[0])) if len(owned) else Organ.LEAF, optics)
    foot = np.array([np.inf, np.inf, 0.0])
    return mesh_plant(
        point,
        normal,
        np.tile(np.asarray(branch.area), len(turns)),
        np.tile(np.asarray(branch.material), len(turns)),
        materials,
        (np.minimum(point.min(axis=0), foot), point.max(axis=0)),
        branch.solid_share,
    )
