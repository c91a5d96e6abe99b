"""Whether a plot fits into this machine's memory."""

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.memory import total_memory
from fynjax.app.io.plot import Plot
from fynjax.canopy import projected_count
from fynjax.scene import MOST_LISTED, PlantingRules, element_count, planting_memory

_EVEN = 'leaves that fill them evenly (structure_m = "even")'


def check_memory(
    plot: Plot,
    *,
    listed: bool = False,
    room: float | Float[np.ndarray, " species"] = PlantingRules.room,
) -> None:
    """Refuse a plot whose plants this machine has no memory for, before it runs out of it.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `listed`: whether the elements of all plants that stand are listed at once; else those of a
      large plot are made window by window.
    - `room`: sites held ready for each plant (`PlantingRules`).

    **Raises:** `InputError` with what is needed and what there is.
    """
    plants, elements, standing = _held_ready(plot, room)
    there = total_memory() / 2**30
    held = min(elements, MOST_LISTED)
    if listed:
        held = max(held, standing)
    needed = planting_memory(plants, held)
    if needed > there:
        raise InputError(
            f"the plants of {plot.size_m[0]:g} m x {plot.size_m[1]:g} m in voxels of "
            f"{plot.voxel_m:g} m need about {needed:.0f} GiB of memory, but this machine has "
            f"{there:.0f} GiB. Take a smaller plot or larger voxels"
            + (f", or {_EVEN}." if _structured(plot) else "."),
            file=plot.file,
        )


def _structured(plot: Plot) -> bool:
    return PlantingRules(structure=plot.structure_m).finer(plot.voxel_m) > 0


def _held_ready(
    plot: Plot, room: float | Float[np.ndarray, " species"]
) -> tuple[float, float, float]:
    """Sites held ready, their area elements, and the elements of the plants that stand."""
    area, plants, elements, standing = float(np.prod(plot.size_m)), 0.0, 0.0, 0.0
    resolved = PlantingRules(structure=plot.structure_m).resolved(plot.voxel_m)
    for s, held_ready in zip(plot.species, np.broadcast_to(room, len(plot.species))):
        crown = np.pi / 4.0 * s.diameter**2
        if plot.cover_definition == "projected":
            count = float(projected_count(s.cover, crown, area))
        else:
            # Ground area of a plant and number of plants by the article's equations (8) to (10).
            crown *= (1.0 - s.packing) * s.fill
            count = s.branches * area * s.cover / max(crown, s.minimum_area)
        plants += held_ready * count
        own = count * element_count(s.diameter, s.height, resolved, structured=_structured(plot))
        standing, elements = standing + own, elements + held_ready * own
    return plants, elements, standing
