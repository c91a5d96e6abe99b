"""What sensors of other pixels, bands and noise could know about a plot."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.inversion._calibrate import COARSE, coarser
from fynjax.inversion._fit_result import Data, repeated_information
from fynjax.inversion._information import Information, bounds_of
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._vectorised import value_and_jacobian
from fynjax.metrics import mean, quantiles, standard_deviation
from fynjax.radiation import Accuracy
from fynjax.scene import (
    AimedSensor,
    Placement,
    PlotParameters,
    Scene,
    aim,
    stand_realisation,
    with_values,
)
from fynjax.sensors import BandSet, Sensor

_SHARES = (0.1, 0.5, 0.9)
_SPREAD_FROM, _TAILS_FROM = 4, 25
"""Pixels from which a standard deviation, and quantiles, are worth computing."""


class SensorSetting(NamedTuple):
    """One sensor of a sweep."""

    gsd: float
    """Side of a pixel on the ground [m]."""
    bands: int
    noise: float
    """Standard deviation of a pixel's noise over its reflectance [-]."""
    sun_zenith: float
    """[degrees]"""
    pixels: int
    """Pixels over the plot."""


def even_bands(count: int, lowest: float, highest: float) -> BandSet:
    """Adjacent box-shaped bands of equal width.

    **Arguments:**

    - `count`: number of bands, at least 1.
    - `lowest`, `highest`: where the first begins and the last ends, between 400 and 2500 nm.

    **Returns:** `BandSet`, its bands named by their centres.

    **Raises:** `InputError` for other numbers.
    """
    if count < 1 or not 400.0 < lowest < highest < 2500.0:
        raise InputError(
            "expected one band or more between 400 and 2500 nm, but got "
            f"{count} from {lowest:g} to {highest:g} nm"
        )
    width = (highest - lowest) / count
    centre = lowest + width * (np.arange(count) + 0.5)
    return BandSet(
        tuple(f"b{c:.0f}" for c in centre),
        tuple(centre.tolist()),
        (width,) * count,
        response="box",
    )  # fmt: skip


def sweep_sensors(
    scene: Scene,
    parameters: PlotParameters,
    space: ParameterSpace,
    sensor: Sensor,
    placement: Placement | None = None,
    *,
    gsd: Sequence[float],
    bands: Sequence[int],
    noise: Sequence[float] = (0.01,),
    sun_zenith: Sequence[float] | None = None,
    error: float = 0.01,
    stand_realisations: int = 4,
    draws: int = 4,
    coarse: Accuracy = COARSE,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[tuple[SensorSetting, Information]]:
    """Bounds on the parameters of a plot, for each combination of sensor properties.

    What a sensor gives are statistics of its image: of each band the mean and, with four pixels or
    more, the standard deviation; with 25 or more also the quantiles 10, 50 and 90 %. Errors are
    the noise of the pixels, an error of `error` times each statistic (calibration, the model),
    and where the plants stand: nobody measured that, so it is estimated from as many other
    `stand_realisations` as in `calibrate_plot`; only sensitivity that realisations share is
    information.

    Each planting and sun is rendered once with its derivatives by forward mode, in the finest
    pixels and the sensor's bands; coarser pixels and wider bands are averages of those. Light has
    the accuracy `coarse`.

    **Arguments:**

    - `scene`, `parameters`, `space`: the plot, and the parameters in question with their priors.
    - `sensor`, `placement`: lines of sight; its bands must be adjacent and of equal width, as
      `even_bands` makes them, and its pixels are those of `gsd`.
    - `gsd`: sides of a pixel [m], multiples of the smallest; what is left of the plot beyond whole
      pixels is cut off.
    - `bands`: numbers of bands, which divide the sensor's number; they share its range.
    - `noise`: of a pixel, over its reflectance [-].
    - `sun_zenith`: [degrees]; the plot's own if left out.
    - `error`: standard deviation of a further error of every statistic, relative [-].
    - `stand_realisations`: at least 2.
    - `draws`: realisations of the noise.
    - `coarse`: accuracy of the light.
    - `seed`: of the noise.
    - `progress`: where to report the stages; nowhere by default.

    **Returns:** each setting with its bounds, by sun, then pixel, number of bands and noise.

    **Raises:** `InputError` for settings that do not fit scene or sensor.
    """
    fine = min(gsd)
    steps = _check(scene, len(sensor.bands), gsd, bands, noise, stand_realisations)
    progress = NullProgress() if progress is None else progress
    quick = coarser(scene, parameters)
    placement = dataclasses.replace(placement or Placement(), pixel=fine)
    plantings = [
        quick,
        *(stand_realisation(quick, i) for i in range(1, stand_realisations + 1)),
    ]
    centre = np.asarray(parameters.light.sun_zenith, float)
    suns = [float(centre)] if sun_zenith is None else [float(s) for s in sun_zenith]
    at = space.physical(jnp.zeros(len(space.names)))
    bounds = []
    for sun in suns:
        lit = eqx.tree_at(lambda p: p.light.sun_zenith, parameters, jnp.asarray(sun))
        # A free zenith starts from this sun too, not from its prior's.
        free = "light.sun_zenith" in space.names
        here = at.at[space.names.index("light.sun_zenith")].set(sun) if free else at
        camera = aim(quick, lit, sensor, placement, accuracy=coarse, point_spread=False)
        camera = camera.sampled(1)  # one ray a pixel, or a voxel
        with progress.stage(f"Render, sun at {sun:g} degrees", len(plantings)):
            images = []
            for planted in plantings:
                rendered = _image_and_slopes(camera, planted, lit, space.names, here)
                images.append(jax.device_get(rendered))
                progress.advance()
        with progress.stage("Bounds", len(steps) * len(bands) * len(noise)):
            for step, size in zip(steps, gsd):
                for count in bands:
                    measured = [_degrade(image, slopes, step, count) for image, slopes in images]
                    for level in noise:
                        information, pixels = _bounds(measured, space, level, error, draws, seed)
                        setting = SensorSetting(float(size), count, float(level), sun, pixels)
                        bounds.append((setting, information))
                        progress.advance()
    return bounds


def _check(
    scene: Scene,
    most: int,
    gsd: Sequence[float],
    bands: Sequence[int],
    noise: Sequence[float],
    stand_realisations: int,
) -> list[int]:
    """Finest pixels on the side of each pixel."""
    if not gsd or not bands or not noise or min(gsd) <= 0 or min(noise) <= 0:
        raise InputError("`gsd`, `bands` and `noise` must be given and positive")
    if stand_realisations < 2:
        raise InputError(
            "expected `stand_realisations` to be at least 2 (three with the stand itself), but got "
            f"{stand_realisations}"
        )
    fine = min(gsd)
    steps = [round(size / fine) for size in gsd]
    for size, step in zip(gsd, steps):
        if abs(size - step * fine) > 1e-6 * size:
            raise InputError(
                f"pixels must be multiples of the finest, {fine:g} m; {size:g} m is not"
            )
        if size > min(scene.grid.extent[:2]) * (1 + 1e-9):
            raise InputError(f"a pixel of {size:g} m is larger than the plot")
    for count in bands:
        if count < 1 or most % count:
            raise InputError(f"the number of bands must divide {most}, but {count} does not")
    return steps


@eqx.filter_jit
def _image_and_slopes(
    camera: AimedSensor,
    scene: Scene,
    parameters: PlotParameters,
    names: tuple[str, ...],
    at: Array,
) -> tuple[Float[Array, "band y x"], Float[Array, "band y x free"]]:
    def image(values: Array) -> Array:
        named = {name: values[i] for i, name in enumerate(names)}
        plot = with_values(parameters, scene.taxa, named)
        return camera.observe(scene, plot).reflectance

    return value_and_jacobian(image, at, mode="forward")


def _degrade(image: np.ndarray, slopes: np.ndarray, step: int, count: int) -> Any:
    """Image and slopes in pixels of `step` finer ones, in `count` bands."""

    def average(values: np.ndarray) -> np.ndarray:
        bands, ny, nx = values.shape[:3]
        ny, nx = ny // step, nx // step
        cut = values[:, : ny * step, : nx * step]
        rest = values.shape[3:]
        blocks = cut.reshape(count, bands // count, ny, step, nx, step, *rest)
        return blocks.mean(axis=(1, 3, 5))

    return average(image), average(slopes)


@jax.jit
def _statistics(
    image: Float[Array, "band y x"], noisy: Float[Array, "draw band y x"]
) -> Float[Array, "draw statistic"]:
    """Statistics of an image with each draw of its noise (relative, unit mean)."""
    pixels = image.shape[1] * image.shape[2]

    def of_band(band: Array) -> Array:
        parts = [mean(band)[None]]
        if pixels >= _SPREAD_FROM:
            parts.append(standard_deviation(band)[None])
        if pixels >= _TAILS_FROM:
            parts.append(quantiles(band, jnp.asarray(_SHARES, band.dtype)))
        return jnp.concatenate(parts)

    return jax.vmap(lambda noise: jax.vmap(of_band)(image * noise).ravel())(noisy)


@jax.jit
def _statistics_and_slopes(image: Array, slopes: Array, noisy: Array) -> tuple[Array, Array]:
    """Of the noisy images, and the slopes of their mean."""
    values, push = jax.linearize(lambda x: _statistics(x, noisy), image)
    columns = jax.lax.map(lambda t: push(t).mean(axis=0), jnp.moveaxis(slopes, -1, 0))
    return values, columns.T


def _bounds(
    images: Sequence[tuple[np.ndarray, np.ndarray]],
    space: ParameterSpace,
    noise: float,
    error: float,
    draws: int,
    seed: int,
) -> tuple[Information, int]:
    shape = images[0][0].shape
    random = np.random.default_rng(seed)
    noisy = jnp.asarray(1.0 + noise * random.normal(size=(draws, *shape)))
    values, slopes, variances = [], [], []
    for image, change in images:
        every, slope = _statistics_and_slopes(
            jnp.asarray(image, float), jnp.asarray(change, float), noisy
        )
        values.append(every.mean(axis=0))
        slopes.append(slope)
        variances.append(every.var(axis=0, ddof=1))
    value = values[0]
    sd = jnp.sqrt(jnp.stack(variances).mean(axis=0) + (error * jnp.abs(value)) ** 2)
    names = tuple(f"s{i}" for i in range(value.size))
    data = Data(names, value, sd).with_scatter(jnp.stack(values[1:]) - value)
    scale = space.prior_sd
    whitened = jnp.stack([data.whiten(jacobian * scale) for jacobian in slopes])
    matrix = np.asarray(repeated_information(whitened))
    return bounds_of(space.names, matrix, np.asarray(scale, float)), int(np.prod(shape[1:]))
