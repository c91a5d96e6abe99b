"""`fynjax demo`."""

from collections.abc import Mapping
from typing import Any

from fynjax.cli._runtime import Job, Seed, command


def _work(given: Mapping[str, Any]) -> Mapping[str, Any]:
    from fynjax.io.plot import example_folder, read_plot

    return {"plot": read_plot(example_folder() / "plot.toml")}


@command("demo", work=_work)
def demo(
    seed: Seed = 0,
) -> Job:
    """Calibrate the 2006 burn plot to its real drone image, from shipped input.

    Builds the 10 m x 10 m plot from the paper's species table, renders the drone image, calibrates
    cover, crown diameter, leaves and ground against the real image's statistics, and writes image,
    tables, figures and a report page.

    Example:  fynjax demo --output my_demo
    """
    from fynjax.studies import fynbos_2006

    return lambda folder: fynbos_2006.demo(folder, seed=seed)
