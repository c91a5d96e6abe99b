"""Structure of a scene as a LiDAR from above is expected to measure it."""

import dataclasses
import re
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, did_you_mean
from fynjax.canopy import VoxelGrid
from fynjax.metrics.structure import (
    STRUCTURE_METRICS,
    StructureSettings,
    voxel_height_percentiles,
    voxel_structure,
)
from fynjax.scene._optics import seen_from_above
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene

_EVEN = 0.5
"""Area projected over area of surfaces that face all directions alike [-]."""
_CANOPY_CELL = 0.5  # m
_GRAINS = (1.0, 2.0, 3.0, 4.0, 5.0)
_PERCENTILE = re.compile(r"height_p(\d+(?:\.\d+)?)")


def fitting_structure(voxel: float, side: float) -> tuple[StructureSettings, tuple[float, ...]]:
    """Settings and grains [m] of structure that fit voxels of an edge in a plot of a side [m].

    **Arguments:** `voxel` edge and `side` of the plot [m].

    **Raises:** `InputError` where cells of no grain are whole voxels.
    """
    cell = max(1, round(_CANOPY_CELL / voxel)) * voxel
    grains = []
    for grain in _GRAINS:
        # Voxels along the canopy cells into which a grain is divided: they must be whole.
        across = grain / max(1, round(grain / cell)) / voxel
        if abs(across - round(across)) < 1e-6 <= across and grain <= side + 1e-9:
            grains.append(grain)
    if not grains:
        raise InputError(
            f"a plot of {side:g} m with voxels of {voxel:g} m has no cells of whole "
            f"voxels among {', '.join(f'{g:g}' for g in _GRAINS)} m for a cloud's structure. "
            "Voxels of 0.1 m have."
        )
    return StructureSettings(canopy_cell=cell), tuple(grains)


def scene_structure(
    scene: Scene,
    parameters: PlotParameters,
    names: Sequence[str],
    settings: StructureSettings,
    *,
    grain: float,
    pulses: float,
    grid: VoxelGrid | None = None,
) -> Float[Array, " metric"]:
    """Structure metrics that a LiDAR from above is expected to measure (`voxel_structure`).

    Means over the cells of the plot. What a leaf hides of a beam is by the inclination of its
    species' leaves. Differentiable in `parameters`, see `Scene.standing`.

    **Arguments:**

    - `scene`, `parameters`: the plot.
    - `names`: some of `STRUCTURE_METRICS`, or a percentile of the heights of first returns above
      the ground over all of the plot [m], such as "height_p95".
    - `settings`: what the metrics are.
    - `grain`: side of a cell [m]; whole canopy cells, and these whole voxels.
    - `pulses`: for each square metre [m-2].
    - `grid`: voxels instead of the scene's: structure depends on their height, and needs no light.

    **Raises:** `InputError` for another name, and as `voxel_structure`.
    """
    percents = {name: _percent(name) for name in names if name not in STRUCTURE_METRICS}

    if grid is not None:
        scene = dataclasses.replace(scene, grid=grid)
    density = scene.area_density(parameters)
    projected = seen_from_above(scene.species, parameters.species.leaf_angle) / _EVEN
    terrain = None if scene.terrain is None else jnp.asarray(scene.terrain, density.dtype)
    # The classes together, each with the area that blocks as much where leaves face evenly.
    density = jnp.tensordot(projected.astype(density.dtype), density, axes=1)
    voxel = scene.grid.horizontal_size, scene.grid.vertical_size
    found: dict[str, Array] = {}
    if percents:
        heights = voxel_height_percentiles(
            density, list(percents.values()), thick=voxel[1], projection=_EVEN, ground=terrain
        )
        found |= dict(zip(percents, heights, strict=True))
    if len(percents) < len(names):
        layers = int(np.ceil((scene.grid.extent[2] - settings.base) / settings.layer - 1e-9))
        found |= voxel_structure(
            density,
            settings,
            voxel=voxel,
            grain=grain,
            pulses=pulses,
            layers=max(layers, settings.first_layer(settings.lowest) + 1),
            projection=_EVEN,
            ground=terrain,
        ).means()
    return jnp.stack([found[name] for name in names])


def _percent(name: str) -> float:
    """The percentile that a name such as "height_p95" asks for [0 to 100]."""
    match = _PERCENTILE.fullmatch(name)
    if match is None or not 0.0 <= float(match[1]) <= 100.0:
        known = (*STRUCTURE_METRICS, "height_p95")
        raise InputError(
            f"expected a structure metric ({', '.join(STRUCTURE_METRICS)}) or a percentile of "
            f"height such as 'height_p95', but got {name!r}.{did_you_mean(name, known)}"
        )
    return float(match[1])
