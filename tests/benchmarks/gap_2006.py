"""Why ground shows between the plants of the plot burnt in 2006: one cause after the other.

    python -m tests.benchmarks.gap_2006 [--size 5]

From leaves and wood at random over the whole plot to the plants as they are. Each row is the share
of the ground that is seen from straight above, and what it differs by from the row before.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
import pandas as pd

from fynjax.app.assembly import build_plot
from fynjax.canopy import FORMS, leaf_angle
from fynjax.scene import PlotParameters, Scene
from tests.benchmarks._measure import example_plot, options

STEP = 0.01  # m


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=5.0, help="side of the plot [m]")
    given = parser.parse_args(arguments)
    scene, parameters = build_plot(example_plot(1.0 if given.tiny else given.size, given.tiny))
    clumping = parameters.species.shoot_clumping
    apart = replace(parameters, species=replace(parameters.species, shoot_clumping=0.0 * clumping))
    crowns, area = even_discs(scene, parameters)
    gap = {
        "leaves and wood at random": np.exp(-even_discs(scene, apart)[1].mean()),
        "leaves of a shoot hide each other": np.exp(-area.mean()),
        "crowns as even discs, of the same area wherever any covers": np.where(
            crowns > 0, np.exp(-area.sum() / (crowns > 0).sum()), 1.0
        ).mean(),
        "where crowns overlap, the area of each": np.exp(-area).mean(),
        "bunches, lobes and dead tops": eqx.filter_jit(Scene.gap_fraction)(scene, parameters),
    }
    table = pd.DataFrame({"seen": pd.Series(gap, dtype=float)})
    table["more"] = table["seen"].diff()
    print(f"bare of crowns as discs: {(crowns == 0).mean():.3f}")
    print(table.to_string(float_format=lambda v: f"{v:.3f}", na_rep=""))


def even_discs(scene: Scene, parameters: PlotParameters) -> tuple[np.ndarray, np.ndarray]:
    """How many crowns as full discs lie over each point of a plot that repeats itself, and their
    area of leaves and wood as seen from above, evenly spread over each disc."""
    side = scene.grid.extent[0]
    place = (np.arange(round(side / STEP)) + 0.5) * STEP
    down = [float(leaf_angle(FORMS[f].leaf_angle).projection(1.0)) for f in scene.forms]
    species = parameters.species
    leaf = np.asarray(species.leaf_area_index * (1.0 - species.shoot_clumping)) * np.array(down)
    each = float(scene.crown_share(parameters)) * (leaf + 0.5 * np.asarray(species.wood_area_index))
    crown = np.asarray(scene.crown_areas(parameters))
    count, area = np.zeros((2, len(place), len(place)))
    for i in np.flatnonzero(crown > 0.0):
        x, y = (np.abs((place - at + side / 2) % side - side / 2) for at in scene.planting.foot[i])
        inside = x**2 + y[:, None] ** 2 < crown[i] / np.pi
        count += inside
        area += inside * each[scene.planting.species[i]]
    return count, area


if __name__ == "__main__":
    main()
