"""Plants of a plot's species from files: meshes, or the area elements of `fynjax plant`."""

from collections.abc import Collection
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from fynjax._core.errors import InputError, in_file
from fynjax.app.io.text import Strict, in_unit, read_rows
from fynjax.canopy import MeshPlant, Organ, PlantMaterial, plant_model_from_mesh
from fynjax.canopy.mesh import mesh_plant
from fynjax.scene import check_leafy, undescribed

_ELEMENTS = 3000
"""As many as a plant on a plot has at most."""
_BEYOND = 3.0
"""Places farther out than so many crown radii or heights are in other units; the crown diameter is
the mean of two sides, which may differ."""
_LARGEST = 20.0
"""A plant larger than this is in other units [m]."""


class ElementRow(Strict):
    """One area element of a plant."""

    x_m: float = in_unit("m", of="Place, east of the axis")
    y_m: float = in_unit("m", of="Place, north of the axis")
    z_m: float = in_unit("m", of="Place, above the ground")
    nx: float = in_unit("-", of="Unit normal", ge=-1.001, le=1.001)
    ny: float = in_unit("-", of="Unit normal", ge=-1.001, le=1.001)
    nz: float = in_unit("-", of="Unit normal", ge=-1.001, le=1.001)
    area_m2: float = in_unit("m2", of="One-sided area", ge=0)
    organ: Literal["leaf", "wood", "flower"] = Field(description="What it is part of.")
    optics: str = Field(
        default="",
        description="Name of its optics, a material of the leaf table; left out, or that of its "
        "organ: as all of the organ.",
    )
    crown_diameter_m: float = in_unit("m", of="Crown diameter of the plant", gt=0, le=_LARGEST)
    plant_height_m: float = in_unit("m", of="Height of the plant", gt=0, le=_LARGEST)


def read_plant(path: Path, form: str, described: Collection[str] = ()) -> MeshPlant:
    """The shape and areas of a species' plants.

    From a mesh in metres (closed surfaces count half, as for `fynjax plant`), or from the
    `elements.csv` that `fynjax plant` writes.

    **Arguments:**

    - `path`: the file.
    - `form`: growth form of the species.
    - `described`: materials that the leaf table describes for it.

    **Raises:** `InputError` for a file that is neither, for optics that nothing describes, and a
    plant with leaves where the growth form has none or the other way round.
    """
    with in_file(path):
        if path.suffix.lower() == ".csv":
            plant = _from_elements(path, described)
        else:
            plant = plant_model_from_mesh(
                path, _ELEMENTS, solid_materials="closed", maximum_extent=_LARGEST
            )
    check_leafy(plant, form, file=path)
    return plant


def _from_elements(path: Path, described: Collection[str]) -> MeshPlant:
    rows = []
    for row_number, row in read_rows(path, ElementRow, "the elements of a plant"):
        if row.optics not in ("", row.organ, *described):
            words = undescribed(row.optics, row.organ, described)
            raise InputError(words, file=path, row=row_number, column="optics")
        rows.append(row)
    point = np.array([(r.x_m, r.y_m, r.z_m) for r in rows])
    normal = np.array([(r.nx, r.ny, r.nz) for r in rows])
    length = np.linalg.norm(normal, axis=1)
    if np.any(np.abs(length - 1.0) > 0.01):
        wrong = int(np.argmax(np.abs(length - 1.0)))
        raise InputError(
            f"expected unit normals, but that of element {wrong + 1} has length "
            f"{length[wrong]:.3g}",
            file=path,
        )
    sizes = {(r.crown_diameter_m, r.plant_height_m) for r in rows}
    if len(sizes) > 1:
        raise InputError(
            f"expected the elements of one plant, with one crown diameter and one height, but they "
            f"have {len(sizes)} pairs of these",
            file=path,
        )
    radius, height = 0.5 * rows[0].crown_diameter_m, rows[0].plant_height_m
    # In crown radii and heights, so that one limit serves plants of any size.
    reach = np.abs(point) / np.array([radius, radius, height])
    if reach.max() > _BEYOND:
        element, axis = np.unravel_index(int(reach.argmax()), reach.shape)
        raise InputError(
            f"expected places within the plant, whose crown is {2 * radius:g} m wide and which is "
            f"{height:g} m tall, but element {element + 1} has {'xyz'[axis]} = "
            f"{point[element, axis]:g} m. Other units, or another axis upwards?",
            file=path,
        )
    kinds = [(Organ[r.organ.upper()], "" if r.optics == r.organ else r.optics) for r in rows]
    places = {kind: place for place, kind in enumerate(sorted(set(kinds)))}
    return mesh_plant(
        point,
        normal / length[:, None],
        np.array([r.area_m2 for r in rows]),
        np.array([places[kind] for kind in kinds], int),
        {
            f"{organ.name.lower()} {optics}".rstrip(): PlantMaterial(organ, optics)
            for organ, optics in places
        },
        (np.array([-radius, -radius, 0.0]), np.array([radius, radius, height])),
        (0.0,) * len(places),
    )
