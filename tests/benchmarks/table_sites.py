"""Processor time and evenness of the sites of plants.

    python -m tests.benchmarks.table_sites [--points 1000000]

Points of `poisson_disk` on a plot that repeats itself: time, points times the square of their least
distance over the area, and the index of Clark and Evans, each also over that of the printed steps
of Bridson (compiled by numba, one point after the other). Then the time of a plot's planting, of so
many plants on sites for two and a half times as many.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from fynjax.canopy import SITES, clark_evans, poisson_disk
from fynjax.scene import Scene
from tests.benchmarks._measure import options
from tests.reference.bridson import bridson


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--points", type=int, default=1_000_000, help="about how many")
    given = parser.parse_args(arguments)
    number = 2000 if given.tiny else given.points
    radius, square = float(np.sqrt(SITES / number)), (1.0, 1.0)
    bridson(1.0, 0.1, 30, 0, True)  # compiled
    rows = []
    for attempts in (5, 30):
        rules = {"attempts": attempts, "seed": 0, "periodic": True}
        a, a_time = _timed(partial(poisson_disk, square, radius, **rules))
        b, b_time = _timed(partial(bridson, 1.0, radius, attempts, 0, True))
        even = [clark_evans(points, square, periodic=True) for points in (a, b)]
        rows.append(
            {
                "attempts": attempts,
                "points": len(a),
                "seconds": a_time,
                "over printed": a_time / b_time,
                "n r2 / A": len(a) * radius**2,
                "its ratio": len(a) / len(b),
                "Clark-Evans": even[0],
                "ratio": even[0] / even[1],
            }
        )
    print(pd.DataFrame(rows).to_string(index=False, float_format=lambda v: f"{v:.4g}"))
    # One shrub of 20 cm for each 0.06 m2.
    side = float(np.ceil(np.sqrt(0.06 * number)))
    table = [{"taxon": "a", "growth_form": "rounded_shrub", "mean_diameter_cm": 20,
              "cover_percent": 40, "height_max_m": 0.5}]  # fmt: skip
    scene, seconds = _timed(
        lambda: Scene.from_table(
            table, size=side, voxel=1.0, structure="even", cover_definition="article"
        )
    )
    plants, sites = float(np.sum(np.asarray(scene.planting.lot) == 0)), len(scene.planting.species)
    print(
        f"{sites} sites for {plants:.0f} plants with their shapes: {seconds:.1f} s of a processor"
    )


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Result of a call and its processor time [s]."""
    start = time.process_time()
    result = call()
    return result, time.process_time() - start


if __name__ == "__main__":
    main()
