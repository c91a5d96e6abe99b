"""A plot whose truth is known, and what sensors would measure of it."""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.precision import double_precision
from fynjax._core.seeds import generator
from fynjax.app.assembly._targets import image_sight, target_rules
from fynjax.app.io.plot import Plot, drone_sensor, sensor_place
from fynjax.inversion import (
    AbstractView,
    BandFactors,
    BandView,
    Data,
    ImageView,
    Problem,
    Source,
    compared_statistics,
    factors_by_view,
    join_data,
    look,
    weigh_targets,
)
from fynjax.metrics import fitting_statistics
from fynjax.scene import with_values

PIXEL_NOISE = 0.01
"""Noise of a pixel of a camera over its reflectance [-]: an assumption, as no source states that of
the shipped cameras."""
_FARTHEST = 2.2
"""Largest distance of a truth from the middle of the prior [standard deviations]."""
_PLANTING = 1000
"""Number of the seed that plants a twin; those of a search are small."""


class Twin(NamedTuple):
    """A plot whose truth is known."""

    measured: Data
    """Data of simulated sensors over the twin, in place of the targets of the real plot."""
    whitened: Float[np.ndarray, " free"]
    """True parameters of the twin, in whitened coordinates of the prior [-]."""
    gain: Float[np.ndarray, " band"] | None
    """True factor by which each band of the twin's camera is off [-]; None without a camera."""
    model_error: tuple[Float[np.ndarray, " _band"], ...] = ()
    """True factor by which reality is off from the model in each band of each sensor with bands
    [-]."""


def draw_truth(free: int, random: np.random.Generator) -> Float[np.ndarray, " free"]:
    """Whitened coordinates of a truth, drawn from the prior."""
    return random.normal(size=free).clip(-_FARTHEST, _FARTHEST)


@double_precision
def measure_truth(
    problem: Problem,
    view: AbstractView,
    u: Float[Array | np.ndarray, " free"],
    number: int,
    random: np.random.Generator,
    model_error: Float[np.ndarray, " band"] | None = None,
    gain: Float[np.ndarray, " band"] | None = None,
) -> tuple[Float[np.ndarray, " statistic"], Float[np.ndarray, " band"] | None]:
    """A plot whose parameters are known, planted by a seed of its own, as a sensor measures it.

    **Arguments:**

    - `problem`: the plot. The scene is rendered in full, at the camera's own pixels and blur.
    - `view`: the sensor's; an image gets the camera's gains, drawn from what they may be off by,
      and noise (`PIXEL_NOISE`). Other sensors get their gains alone.
    - `u`: whitened coordinates of the parameters.
    - `number`: of the seed that plants it, unlike those of a search.
    - `random`: draws gains and noise.
    - `model_error`: factors by which reality is off from the model in the view's bands; one by
      default.
    - `gain`: factors by which the view's bands are off; drawn here by default.

    **Returns:** the statistics, and the gains, None of a sensor that has no bands. Not
    differentiable.
    """
    scene = problem.scene
    plot = with_values(scene.parameters, scene.taxa, problem.free.named(jnp.asarray(u)))
    value, *image = look((view,), scene.realisation(_PLANTING + number), plot)
    if not isinstance(view, BandView):
        return np.asarray(value, float), None
    seen = np.asarray(image[0], float)
    bands = len(seen)
    if gain is None:
        gain = np.exp(random.multivariate_normal(np.zeros(bands), view.gains.covariance(bands)))
    off = gain if model_error is None else gain * model_error
    if isinstance(view, ImageView):  # gains are common to all pixels of a band; noise is of each
        seen = seen * (1.0 + PIXEL_NOISE * random.normal(size=seen.shape))
    return np.asarray(view.statistics(jnp.asarray(seen), jnp.log(jnp.asarray(off))), float), gain


@double_precision
def plant_twin(problem: Problem, relative_sd: float, *, seed: int) -> Twin:
    """Draw a truth from the prior of a plot, plant it, and measure it as the real plot was.

    **Arguments:**

    - `problem`: the plot, and which statistics of which sensors were measured of the real one, or
      `twin_image`. Those of an image get the errors of `measure_truth`; others are drawn with the
      errors that they have here.
    - `relative_sd`: error of a mean or quantile of an image as a share of it [-].
    - `seed`: of truth and errors.
    """
    random = generator(seed, 101)
    truth = draw_truth(len(problem.free.names), random)
    found, gain = [], None
    views, factors = problem.views, BandFactors.of(problem.views, problem.error)
    # One error of the model for all sensors, wherever they see the same wavelength.
    logs = factors.draw_errors(random)
    errors = [
        None if log is None else np.exp(np.asarray(log))
        for log in factors_by_view(views, jnp.asarray(logs))
    ]
    # Views of one camera share its gains; a single view draws them where it always did.
    shared = len({v.instrument for v in views if isinstance(v, ImageView)}) < sum(
        isinstance(v, ImageView) for v in views
    )
    of_gains, drawn_gains = np.asarray(factors.of_gains), None
    if shared:
        none = np.zeros(len(of_gains))
        drawn_gains = jnp.asarray(random.multivariate_normal(none, of_gains, method="eigh"))
    gains = factors_by_view(views, drawn_gains)
    for data, view, error, log in zip(problem.measured.parts, views, errors, gains, strict=True):
        known = None if log is None else np.exp(np.asarray(log))
        value, own = measure_truth(problem, view, truth, 0, random, error, known)
        source = data.source
        assert source is not None
        if not isinstance(view, ImageView):
            covariance = np.asarray(data.covariance)
            # Other sensors err as the real ones are taken to, correlations included.
            value = random.multivariate_normal(value, covariance, method="eigh")
            data = dataclasses.replace(data, value=jnp.asarray(value))
        else:
            gain = own if gain is None else gain
            drawn = weigh_targets(view.names, value, relative_sd)
            data = dataclasses.replace(drawn, names=data.names)
        text = f"Of a plot whose truth is known, not of a real one: {source.description}"
        curve = None if source.bands is None else (np.asarray(source.bands.centre), value)
        source = dataclasses.replace(source, spectrum=curve, description=text, image=None)
        found.append(dataclasses.replace(data, source=source))
    return Twin(join_data(found), truth, gain, tuple(e for e in errors if e is not None))


def twin_image(plot: Plot) -> Data:
    """The image of a plot's drone, for a twin of a plot of which nothing was measured.

    **Arguments:** `plot`, as `read_plot` gives it.

    **Returns:** every statistic that is compared with a whole image, without values.

    **Raises:** `InputError` as `image_sight`, and where the plot file's targets fit none of them.
    """
    pixel = sensor_place(plot)[1]
    bands = drone_sensor(plot).bands
    every = fitting_statistics(compared_statistics(bands), min(plot.size_m), pixel)
    used = target_rules(plot).used(every, "the statistics")
    names = tuple(every[i] for i in used)
    description = f"{len(names)} statistics of a drone's image in {', '.join(bands.names)}."
    source = Source("image", image_sight(plot, names), description, plot.file)
    return Data(names, jnp.zeros(len(names)), jnp.ones(len(names)), source=source)
