"""`fynjax render`."""

from fynjax.cli._runtime import Checkpoint, Job, OwnSeed, PlotPath, command


@command("render", forget=True, work=lambda given: {"plot": given["plot"]})
def render(
    plot: PlotPath,
    checkpoint: Checkpoint = None,
    seed: OwnSeed = None,
) -> Job:
    """Render what the drone sees of a plot.

    Writes the reflectance image (GeoTIFF), the run (NetCDF) and a report page. A large image is
    rendered in tiles; an interrupted run goes on with the same command.

    Example:  fynjax render plot.toml --output render
    """
    from fynjax import jobs

    return lambda folder: jobs.render(plot, folder, seed=seed, checkpoint=checkpoint)
