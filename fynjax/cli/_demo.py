"""`fynjax demo`."""

from pathlib import Path

from fynjax.cli._runtime import Json, Output, Quiet, Seed, run_job


def demo(
    output: Output = Path("output/demo"),
    seed: Seed = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate the 2006 burn plot to its real drone image, from shipped input.

    Builds the 10 m x 10 m plot from the paper's species table, renders the drone image, calibrates
    cover, crown diameter, leaves and ground against the real image's statistics, and writes image,
    tables, figures and a report page.

    Example:  fynjax demo --output my_demo
    """
    from fynjax.studies import fynbos_2006

    run_job(
        "demo",
        lambda folder, progress: fynbos_2006.demo(folder, seed=seed, progress=progress),
        output,
        as_json=json,
        quiet=quiet,
    )
