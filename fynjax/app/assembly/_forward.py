"""What the jobs on a plot's parameters share: the problem that a plot file states."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax

from fynjax._core.precision import double_precision
from fynjax.app.assembly._build import build_plot
from fynjax.app.assembly._targets import image_sight, placed_by_image, read_targets
from fynjax.app.io.plot import NO_PRIOR, Plot, as_plot, free_parameters, plot_error, with_prior
from fynjax.inversion import CalibrationSettings, Data, ImageView, Problem, free_space
from fynjax.scene import PlotParameters, Scene, own_spread


@double_precision
def read_problem(
    plot: Plot | str | Path,
    targets: Sequence[str | Path] = (),
    free: Sequence[str] | None = None,
    *,
    prior: str | Path = NO_PRIOR,
    bands: Sequence[str] | None = None,
    seed: int | None = None,
) -> Problem:
    """The problem that `fynjax calibrate` solves: a plot file, and files of what was measured.

    **Arguments:**

    - `plot`: a plot, or the path of its plot file.
    - `targets`: files of the measurements, as `jobs.calibrate` takes them.
    - `free`: patterns of the names of the parameters to be free; those of the plot file by default.
    - `prior`: learned population of what the plot's files leave open (`with_prior`); none by
      default.
    - `bands`: what each band of a drone's image is.
    - `seed`: of everything random; that of the plot file by default.

    **Raises:** `InputError` as the readers, `build_plot` and `free_space`.

    >>> import fynjax as fx
    >>> from fynjax.app.io.plot import example_folder, read_plot
    >>> plot = read_plot(example_folder() / "plot.toml").replace(size_m=(1.0, 1.0))
    >>> problem = fx.read_problem(plot, free=["species.*.cover"])  # or "plot.toml", ["ortho.tif"]
    >>> len(problem.free.names)
    13
    """
    paths = [Path(path) for path in targets]
    read = with_prior(placed_by_image(as_plot(plot), paths), prior)
    seed = read.seed if seed is None else seed
    data = read_targets(read, paths, bands=bands, seed=seed, by_pixel=True)
    return plot_problem(read, data, free, seed=seed)


@double_precision
def plot_problem(
    plot: Plot, data: Data | None, free: Sequence[str] | None = None, *, seed: int
) -> Problem:
    """The problem of a plot that is read, and of what was measured of it.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `data`: of its sensors (`read_targets`); None where nothing was measured.
    - `free`: patterns of the names of the parameters to be free; those of the plot file if `None`
      (`free_parameters`).
    - `seed`: of everything random.

    The number of plants is rounded at random, so that its mean over plantings is that of the
    covers.

    **Raises:** `InputError` as `build_plot`, and as `free_space`.
    """
    scene, parameters = build_plot(plot, seed=seed, rounding="random")
    patterns = free_parameters(plot) if free is None else tuple(free)
    space = free_space(
        scene, parameters, patterns, lambda name: _prior_sd(plot, name, dict(scene.spreads))
    )
    table = plot.calibration
    settings = CalibrationSettings(
        rounds=table.rounds, max_steps=table.max_iterations, starts=table.starts, seed=seed
    )
    return Problem(scene, data, space, error=plot_error(plot), settings=settings)


def _prior_sd(plot: Plot, name: str, spreads: Mapping[str, float]) -> float | None:
    """Relative standard deviation of a parameter's prior: that of the tables and spectra themselves
    (`spreads`, as of `Scene.spreads`), unless `calibration.priors` has another (`own_spread`)."""
    own = own_spread(name, spreads, plot.calibration.priors)
    return plot.calibration.relative_sd(name) if own is None else own


def image_view(
    plot: Plot, scene: Scene, parameters: PlotParameters, statistics: Sequence[str]
) -> ImageView:
    """Statistics of the image that a plot's drone takes, from where its file has it.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `scene`, `parameters`: of the plot, from `build_plot`.
    - `statistics`: names such as `nir.mean` or `NDVI.std`.

    **Raises:** `InputError` as `image_sight` and `fynjax.scene.aim`.
    """
    return image_sight(plot, statistics)(scene, parameters)


def batch_for_device() -> int | None:
    """Renders at once: as many as fit on an accelerator; on a processor one fills it."""
    return 1 if jax.default_backend() == "cpu" else None
