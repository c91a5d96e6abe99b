"""A scene's generated meshes drawn with PyVista, off screen (the extra `view`)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax.canopy import Organ, PlantMesh
from fynjax.report.figures._scene import BARK, GROUND, SUN, rgb, species_colours
from fynjax.report.figures._scene_oblique import View, height_at
from fynjax.scene import Instances

_MOST_TRIANGLES = 30_000_000


def check_view() -> None:
    """Check that PyVista is installed. Raises `MissingExtraError`."""
    require("pyvista", "view")


def mesh_image(
    instances: Instances,
    meshes: Sequence[PlantMesh | None],
    forms: Sequence[str],
    ground: Float[np.ndarray, "y x"] | None,
    view: View,
) -> Float[np.ndarray, "row column 4"]:
    """The plants as `view` sees them, each a copy of its species' mesh: RGBA, rows from the bottom.

    **Arguments:** `instances`, the plants; `meshes`, a mesh for each species that has plants, else
    `None`; `forms`, growth form of each species; `ground`, its height in the middles of even cells
    over the plot [m], `None` if level; `view`, the direction and the pixels of the picture.

    **Raises:** `MissingExtraError` without PyVista, `InputError` where the copies have more than
    3e7 triangles.
    """
    triangles = sum(len(m.faces) * n for m, n in zip(meshes, instances.counts) if m is not None)
    if triangles > _MOST_TRIANGLES:
        raise InputError(
            f"{len(instances)} plants make {triangles} triangles, but a picture of meshes takes at "
            f"most {_MOST_TRIANGLES}: take a smaller plot (--size), or --view points"
        )
    pyvista, vtk = require("pyvista", "view"), require("vtk", "view")
    # VTK warns of the display that it does not need.
    vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)
    plotter = pyvista.Plotter(off_screen=True, window_size=view.size, lighting="none")
    colours = species_colours(forms)
    for species, mesh in enumerate(meshes):
        mine = np.flatnonzero(instances.species == species)
        if mesh is None or not len(mine):
            continue
        for index, organ in enumerate(mesh.materials):
            wood = organ == Organ.WOOD.name.lower() and forms[species] != "deadwood"
            colour = rgb(BARK if wood else colours[species])
            faces = mesh.faces[mesh.material == index]
            plotter.add_actor(_copies(pyvista, vtk, mesh, faces, instances, mine, colour))
    if ground is not None:
        lx, ly = instances.extent
        x, y = np.meshgrid(np.linspace(0, lx, 400), np.linspace(0, ly, 400))
        surface = pyvista.StructuredGrid(x, y, height_at(ground, (lx, ly), x, y))
        plotter.add_mesh(surface, color=rgb(GROUND), ambient=0.1, diffuse=0.62)
    light = pyvista.Light(position=tuple(1e3 * SUN), light_type="scene light", intensity=0.85)
    plotter.add_light(light)
    plotter.add_light(pyvista.Light(light_type="headlight", intensity=0.35))
    _aim(plotter, view)
    image = plotter.screenshot(transparent_background=True, return_img=True)
    plotter.close()
    return np.asarray(image, float)[::-1] / 255.0


def _copies(
    pyvista: Any,
    vtk: Any,
    mesh: PlantMesh,
    faces: np.ndarray,
    instances: Instances,
    mine: np.ndarray,
    colour: np.ndarray,
) -> Any:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    wide = float((high - low)[:2].mean())
    shape = mesh.vertices / np.array([wide, wide, high[2] - low[2]])
    corners = np.column_stack([np.full(len(faces), 3), faces])
    feet = pyvista.PolyData(np.stack([instances.x[mine], instances.y[mine], instances.z[mine]], -1))
    across, tall = instances.diameter[mine], instances.height[mine]
    feet["size"] = np.stack([across, across, tall], axis=-1)
    # About y, then x, then z, counter-clockwise: the lean first, towards the north.
    none = np.zeros(len(mine))
    feet["turn"] = np.stack([-instances.tilt[mine], none, -instances.azimuth[mine]], axis=-1)
    mapper = vtk.vtkGlyph3DMapper()
    mapper.SetInputData(feet)
    mapper.SetSourceData(pyvista.PolyData(shape, corners.ravel()))
    mapper.SetScaleArray("size")
    mapper.SetScaleModeToScaleByVectorComponents()
    mapper.SetOrientationArray("turn")
    mapper.SetOrientationModeToRotation()
    mapper.SetScalarVisibility(False)
    actor = vtk.vtkActor()
    actor.SetMapper(mapper)
    actor.GetProperty().SetColor(*colour)
    actor.GetProperty().SetAmbient(0.25)
    return actor


def _aim(plotter: Any, view: View) -> None:
    """The same perspective as `View.project`."""
    camera = plotter.camera
    camera.position, camera.focal_point = tuple(view.eye), tuple(view.target)
    camera.up = (0.0, 0.0, 1.0)
    half = np.array(view.size) / 2.0
    camera.view_angle = float(2.0 * np.rad2deg(np.arctan(half[1] / view.scale)))
    off = (view.middle - half) / half
    camera.SetWindowCenter(-float(off[0]), -float(off[1]))
    plotter.reset_camera_clipping_range()
