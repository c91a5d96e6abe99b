"""A whole scene as one OBJ: every plant a copy of its taxon's generated mesh."""

import warnings
from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError
from fynjax.app.io.text import atomic_path, write_text
from fynjax.canopy import FORMS, Organ, PlantMesh, generate_plant, table1_2006, unit_shapes
from fynjax.scene import Instances, PlotParameters, Scene

LEAST_TRIANGLES = 2000
"""Fewest triangles that a plant may be asked to be made of."""
_MOST_PER_PLANT = 200_000


def check_triangles(plants: int, max_triangles: int) -> None:
    """Raise `InputError` where so many `plants` have more than `max_triangles`, however few each
    has."""
    least = plants * LEAST_TRIANGLES
    if least > max_triangles:
        raise InputError(
            f"{plants} plants of {LEAST_TRIANGLES} triangles each are {least} triangles, but "
            f"at most {max_triangles} are allowed: take a smaller plot (--size), or allow more "
            f"(--triangles {least})"
        )


def scene_meshes(
    instances: Instances, scene: Scene, parameters: PlotParameters, *, max_triangles: int, seed: int
) -> tuple[list[PlantMesh | None], int]:
    """A mesh for each species that has plants, and the triangles that all its copies make.

    **Arguments:**

    - `instances`: the plants that stand, as `fynjax.scene` places them.
    - `scene`: of the plot; it names the taxa, their growth forms and their sizes.
    - `parameters`: of the plot, in its units.
    - `max_triangles`: most triangles of the whole scene.
    - `seed`: of the shapes.

    **Returns:** for each species its mesh [m], or `None` where it has no plants; and the number of
    triangles of all plants.

    **Raises:** `InputError` with both numbers where the plants need more than `max_triangles`.
    Warns where a taxon is not in table 1, and has the usual leaf of its growth form.
    """
    counts = instances.counts
    check_triangles(int(counts.sum()), max_triangles)
    each = int(
        np.clip(max_triangles // max(int(counts.sum()), 1), LEAST_TRIANGLES, _MOST_PER_PLANT)
    )
    species = parameters.species
    # The area of a plant among others, whose crowns overlap its own.
    share = float(scene.crown_share(parameters))
    meshes: list[PlantMesh | None] = []
    for taxon_index, (taxon, form) in enumerate(zip(scene.taxa, scene.forms)):
        if counts[taxon_index] == 0:
            meshes.append(None)
            continue
        made = generate_plant(
            _known(taxon, form),
            seed + taxon_index,
            diameter=float(species.diameter[taxon_index]),
            height=float(species.height[taxon_index]),
            leaf_area_index=share * float(species.leaf_area_index[taxon_index]),
            wood_area_index=share * float(species.wood_area_index[taxon_index]),
            flowering=scene.rules.flowering,
            max_triangles=each,
        )
        meshes.append(made.mesh)
    total = sum(int(n) * len(mesh.faces) for n, mesh in zip(counts, meshes) if mesh is not None)
    if total > 1.1 * max_triangles:  # `generate_plant` keeps its limit only roughly
        raise InputError(
            f"the scene has {total} triangles, but at most {max_triangles} are allowed: take a "
            f"smaller plot (--size), or allow more (--triangles {total})"
        )
    return meshes, total


def _known(taxon: str, form: str) -> str:
    if taxon in set(table1_2006().taxon):
        return taxon
    if FORMS[form].leafy:
        warnings.warn(
            f"the mesh of {taxon!r} has the usual leaf of its growth form, {form}: leaf sizes are "
            "known for the taxa of table 1 alone",
            stacklevel=4,
        )
    return form


def write_scene_mesh(
    path: str | Path,
    instances: Instances,
    meshes: list[PlantMesh | None],
    colours: list[tuple[float, float, float]],
) -> None:
    """Write the scene as OBJ with its MTL beside, metres, z upwards, one object for each plant.

    Copies are stretched to each plant's diameter and height, turned and tilted. Materials are
    named `taxon_organ`.

    **Arguments:**

    - `path`: the OBJ file to write; the materials get the same name in .mtl.
    - `instances`: the plants that stand.
    - `meshes`: one for each species, as of `scene_meshes`.
    - `colours`: (red, green, blue) of each species, 0 to 1, for show.
    """
    path = Path(path)
    materials: dict[str, tuple[float, float, float]] = {}
    first = 1
    with atomic_path(path) as partial, partial.open("w", encoding="utf-8") as file:
        file.write(f"# lengths in metres, z upwards\nmtllib {path.stem}.mtl\n")
        for taxon_index, mesh in enumerate(meshes):
            if mesh is None:
                continue
            name = instances.taxa[taxon_index].lower().replace(" ", "_")
            low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
            wide = float((high - low)[:2].mean())
            position = mesh.vertices / np.array([wide, wide, high[2] - low[2]])
            parts = []
            for index, organ in enumerate(mesh.materials):
                faces = mesh.faces[mesh.material == index]
                parts.append((f"{name}_{organ}", faces, "f %d %d %d\n" * len(faces)))
                wood = Organ.WOOD.name.lower() == organ
                materials[f"{name}_{organ}"] = (0.36, 0.27, 0.20) if wood else colours[taxon_index]
            rows = "v %.5f %.5f %.5f\n" * len(position)
            for number, plant in enumerate(
                np.flatnonzero(instances.species == taxon_index), start=1
            ):
                per_diameter, per_height = unit_shapes(
                    position, instances.azimuth[[plant]], instances.tilt[[plant]]
                )
                foot = np.array([instances.x[plant], instances.y[plant], instances.z[plant]])
                placed = (
                    foot
                    + instances.diameter[plant] * per_diameter[0]
                    + instances.height[plant] * per_height[0]
                )
                file.write(f"o {name}_{number}\n" + rows % tuple(placed.ravel().tolist()))
                for material, faces, text in parts:
                    file.write(
                        f"usemtl {material}\n" + text % tuple((faces + first).ravel().tolist())
                    )
                first += len(position)
    library = [
        f"newmtl {name}\nKd {red:.3f} {green:.3f} {blue:.3f}\nillum 1\n"
        for name, (red, green, blue) in materials.items()
    ]
    write_text(path.with_suffix(".mtl"), "\n".join(library))
