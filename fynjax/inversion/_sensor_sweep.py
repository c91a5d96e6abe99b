"""What sensors of other pixels, bands and noise could know about a plot."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, whole_number
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax.inversion._expected import other_plantings
from fynjax.inversion._factors import BandFactors
from fynjax.inversion._fit_result import scatter_covariance
from fynjax.inversion._information import Information, fisher_information, shared_slopes
from fynjax.inversion._search import COARSE, coarser
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._vectorised import value_and_jacobian
from fynjax.metrics import quantiles, standard_deviation
from fynjax.radiation import Accuracy
from fynjax.scene import AimedSensor, ModelError, Placement, PlotParameters, Scene, aim, with_values
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


@double_precision
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
    relative_sd: float = 0.01,
    model_error: ModelError | None = None,
    stand_realisations: int = 15,
    draws: int = 4,
    coarse: Accuracy = COARSE,
    seed: int = 0,
) -> list[tuple[SensorSetting, Information]]:
    """Bounds on the parameters of a plot, for each combination of sensor properties.

    What a sensor gives are statistics of its image: of each band the mean and, with four pixels or
    more, the standard deviation; with 25 or more also the quantiles 10, 50 and 90 %. An image can
    be made coarser and its bands wider afterwards, so a sensor gives those of every larger pixel
    and every divisor of its number of bands in the sweep too, with the noise of such a sensor.
    (Where the sides of pixels do not divide, that takes resampling by parts of a pixel.) All
    statistics of the sweep have one covariance and one set of slopes, and each sensor takes its
    part of both. So smaller pixels, or a multiple of the bands, never have a larger bound.

    Errors are the noise of the pixels, an independent error of `relative_sd` times each statistic,
    factors that bands are off by in all pixels, and where the plants stand: nobody measured that,
    so its covariance is estimated from the stand and other `stand_realisations`
    (`scatter_covariance`), and only slopes that these share are information (`shared_slopes`). The
    fewer they are, the less certain the bounds: on a plot of 4 m of fynbos (15 parameters, ten
    sensors, bands without factors), over those of 1350 plantings, 0.96 (0.45 to 1.84 in 80 of 100
    cases) with 4 realisations, 1.04 (0.57 to 1.63) with 15, 1.06 (0.78 to 1.36) with 64.

    The factor of a band is the gain of the sensor (`Sensor.gains`) times the model's error at its
    wavelength. To first order their covariance F adds J F J' to that of the statistics, with J the
    slopes of the statistics by the logarithms of the factors. The factor of a wide band is that of
    the narrow ones in it together; its gain has a part of its own too, so that it is as uncertain
    as theirs. With factors no bound is smaller than without.

    Each planting and sun is rendered once with its derivatives by forward mode, in the finest
    pixels and the sensor's bands; coarser pixels and wider bands are averages of those. Light has
    the accuracy `coarse`.

    **Arguments:**

    - `scene`, `parameters`, `space`: the plot, and the parameters in question with their priors.
    - `sensor`, `placement`: lines of sight; its bands must be adjacent and of equal width, as
      `even_bands` makes them, and its pixels are those of `gsd`.
    - `gsd`: sides of a pixel [m], multiples of the smallest; what is left of the plot beyond whole
      pixels is cut off, though not from means.
    - `bands`: numbers of bands, which divide the sensor's number; they share its range.
    - `noise`: of a pixel, over its reflectance [-].
    - `sun_zenith`: [degrees]; the plot's own if left out.
    - `relative_sd`: standard deviation of a further error of every statistic, relative [-].
    - `model_error`: what the model is off by over wavelength; it is believed if left out.
    - `stand_realisations`: at least 2.
    - `draws`: realisations of the noise.
    - `coarse`: accuracy of the light.
    - `seed`: of the noise.

    **Returns:** each setting with its bounds, by sun, then pixel, number of bands and noise.

    **Raises:** `InputError` for settings that do not fit scene or sensor.
    """
    whole_number("seed", seed)
    quick = coarser(scene, parameters)
    steps, lights, cameras = check_sweep(
        quick, parameters, sensor, placement, gsd=gsd, bands=bands, noise=noise,
        sun_zenith=sun_zenith, stand_realisations=stand_realisations, coarse=coarse,
    )  # fmt: skip
    others = other_plantings(scene, range(1, stand_realisations + 1))
    plantings = [quick, *(coarser(other, parameters) for other in others)]
    at = space.physical(jnp.zeros(len(space.names)))
    factors = BandFactors.of_bands([(sensor.bands, sensor.gains())], model_error)
    bounds = []
    for lit, camera in zip(lights, cameras):
        sun = float(np.asarray(lit.light.sun_zenith))
        # A free zenith starts from this sun too, not from its prior's.
        free = "light.sun_zenith" in space.names
        here = at.at[space.names.index("light.sun_zenith")].set(sun) if free else at
        camera = camera.sampled(1)  # one ray a pixel, or a voxel
        measured = []
        for planted in track(plantings, f"Render, sun at {sun:g} degrees"):
            rendered = image_and_slopes(camera, planted, lit, space.names, here)
            image, slopes = jax.device_get(rendered)
            measured.append(_measure(image, slopes, steps, bands, noise, draws, seed))
        together = {
            level: _Sweep.of([every[level] for every in measured], space, relative_sd, factors)
            for level in noise
        }
        for step, size in zip(steps, gsd):
            for count in bands:
                for level in noise:
                    pixels, information = together[level].bounds(step, count)
                    setting = SensorSetting(float(size), count, float(level), sun, pixels)
                    bounds.append((setting, information))
    return bounds


@double_precision
def check_sweep(
    scene: Scene,
    parameters: PlotParameters,
    sensor: Sensor,
    placement: Placement | None = None,
    *,
    gsd: Sequence[float],
    bands: Sequence[int],
    noise: Sequence[float] = (0.01,),
    sun_zenith: Sequence[float] | None = None,
    stand_realisations: int = 15,
    coarse: Accuracy = COARSE,
) -> tuple[list[int], list[PlotParameters], list[AimedSensor]]:
    """Check the settings of `sweep_sensors` and aim its sensor, without rendering.

    **Arguments:** `scene`, whose plants do not count, `parameters`, `sensor`, `placement`, `gsd`,
    `bands`, `noise`, `sun_zenith`, `stand_realisations` and `coarse` as of `sweep_sensors`.

    **Returns:** finest pixels on the side of each pixel; and of each sun the parameters and the
    sensor, in the finest pixels.

    **Raises:** `InputError` for settings that do not fit scene or sensor.
    """
    most = len(sensor.bands)
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
    placement = dataclasses.replace(placement or Placement(), pixel=fine)
    own = [float(np.asarray(parameters.light.sun_zenith, float))]
    lights = [
        eqx.tree_at(lambda p: p.light.sun_zenith, parameters, jnp.asarray(float(sun)))
        for sun in (own if sun_zenith is None else sun_zenith)
    ]
    cameras = [
        aim(scene, lit, sensor, placement, accuracy=coarse, point_spread=False) for lit in lights
    ]
    return steps, lights, cameras


@eqx.filter_jit
def image_and_slopes(
    camera: AimedSensor, scene: Scene, parameters: PlotParameters, names: tuple[str, ...], at: Array
) -> tuple[Float[Array, "band y x"], Float[Array, "band y x free"]]:
    def image(values: Array) -> Array:
        named = {name: values[i] for i, name in enumerate(names)}
        plot = with_values(parameters, scene.taxa, named)
        return camera.observe(scene, plot).reflectance

    # The value of whole plants, whose chance is a measured plot's, and not that beside slopes.
    return image(at), value_and_jacobian(image, at, mode="forward")[1]


def _degrade(
    values: Float[np.ndarray, "band y x *free"], step: int, count: int
) -> Float[np.ndarray, "_band _y _x *free"]:
    """An image, or its slopes, in pixels of `step` finer ones, in `count` bands."""
    bands, ny, nx = values.shape[:3]
    ny, nx = ny // step, nx // step
    cut = values[:, : ny * step, : nx * step]
    blocks = cut.reshape(count, bands // count, ny, step, nx, step, *values.shape[3:])
    return blocks.mean(axis=(1, 3, 5))


@jax.jit
def _spread(image: Array, slopes: Array, noisy: Array) -> tuple[Array, Array, Array]:
    """Spread and tails of each band: their mean over draws of the noise (relative, unit mean), its
    slopes, and the variance over the draws."""

    def of_band(band: Array) -> Array:
        parts = [standard_deviation(band)[None]]
        if band.size >= _TAILS_FROM:
            parts.append(quantiles(band, jnp.asarray(_SHARES, band.dtype)))
        return jnp.concatenate(parts)

    def statistics(image: Array) -> Array:
        return jax.vmap(lambda noise: jax.vmap(of_band)(image * noise).ravel())(noisy)

    values, push = jax.linearize(statistics, image)
    columns = jax.lax.map(lambda t: push(t).mean(axis=0), jnp.moveaxis(slopes, -1, 0))
    return values.mean(axis=0), columns.T, values.var(axis=0, ddof=1)


class _Block(NamedTuple):
    """Statistics of one kind of pixel and number of bands."""

    step: int
    """Finest pixels on the side of one of these pixels; 0 for means over the plot."""
    bands: int
    values: Float[np.ndarray, " statistic"]
    slopes: Float[np.ndarray, "statistic free"]
    variance: Float[np.ndarray, " statistic"]
    """Variance by the noise of pixels; zeros for means, whose variance depends on the pixel
    (`_Measured.mean_noise`)."""
    by_factor: Float[np.ndarray, "statistic band"]
    """Slopes by the logarithms of factors on the sensor's bands."""


class _Measured(NamedTuple):
    """Statistics of one planting as all sensors of one noise measure them."""

    blocks: list[_Block]
    """Statistics, coarse pixels and few bands first."""
    mean_noise: dict[tuple[int, int], np.ndarray]
    """Variance of the mean of each band by noise, for each step and number of bands."""
    pixels: dict[int, int]
    """Number of pixels for each step."""


def _measure(
    image: np.ndarray,
    slopes: np.ndarray,
    steps: Sequence[int],
    bands: Sequence[int],
    noise: Sequence[float],
    draws: int,
    seed: int,
) -> dict[float, _Measured]:
    measured = {level: _Measured([], {}, {}) for level in noise}
    counts = sorted(set(bands))
    image, slopes = np.asarray(image, float), np.asarray(slopes, float)
    most, free = len(image), slopes.shape[3]
    for count in counts:
        shape = (count, most // count)
        # The mean of a band is the same whatever the pixel, and is kept once.
        parts = image.mean(axis=(1, 2)).reshape(shape)
        change = slopes.mean(axis=(1, 2)).reshape(*shape, free).mean(axis=1)
        means = parts.mean(axis=1), change, np.zeros(count), _placed(parts / shape[1])
        for one in measured.values():
            one.blocks.append(_Block(0, count, *means))
    for step in sorted(set(steps), reverse=True):
        for count in counts:
            coarse, change = (_degrade(values, step, count) for values in (image, slopes))
            # A factor on one of the narrow bands in each: what it adds to their mean.
            narrow = _degrade(image, step, most).reshape(count, -1, *coarse.shape[1:])
            parts = np.moveaxis(narrow, 1, -1) * (count / most)
            change = np.concatenate([change, parts], axis=-1)
            pixels = coarse[0].size
            random = np.random.default_rng(seed)
            noisy = random.normal(size=(draws, *coarse.shape))
            for level, one in measured.items():
                one.pixels[step] = pixels
                one.mean_noise[step, count] = level**2 * (coarse**2).mean(axis=(1, 2)) / pixels
                if pixels >= _SPREAD_FROM:
                    spread = _spread(coarse, change, 1.0 + level * noisy)
                    values, push, variance = jax.device_get(spread)
                    # Each scales with a factor that its bands have in common, quantiles too, of
                    # which the slopes are means over a window.
                    parts = push[:, free:] * (values / push[:, free:].sum(axis=1))[:, None]
                    by_factor = _placed(parts.reshape(count, -1, most // count))
                    one.blocks.append(
                        _Block(step, count, values, push[:, :free], variance, by_factor)
                    )
    return measured


def _placed(of_parts: Float[np.ndarray, "band *kind part"]) -> Float[np.ndarray, "statistic _band"]:
    """Slopes of each band's statistics by factors on the narrow bands in it, as slopes by factors
    on all narrow bands."""
    count, part = of_parts.shape[0], of_parts.shape[-1]
    rows = of_parts.reshape(count, -1, 1, part) * np.eye(count)[:, None, :, None]
    return rows.reshape(-1, count * part)


class _Sweep(NamedTuple):
    """Covariance and slopes of the statistics of all sensors together."""

    space: ParameterSpace
    keys: list[tuple[int, int]]
    """Step of the pixels of each block of statistics, 0 for means, and its number of bands."""
    rows: list[np.ndarray]
    """Places of the statistics of each block."""
    covariance: np.ndarray
    slopes: np.ndarray
    """Slopes of the statistics by the parameters in their own units."""
    mean_noise: dict[tuple[int, int], np.ndarray]
    pixels: dict[int, int]

    @classmethod
    def of(
        cls,
        plantings: Sequence[_Measured],
        space: ParameterSpace,
        relative_sd: float,
        factors: BandFactors,
    ) -> "_Sweep":
        """From what each planting shows."""
        first = plantings[0]
        keys = [(block.step, block.bands) for block in first.blocks]
        sizes = [len(block.values) for block in first.blocks]
        rows = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
        values, slopes, variance, by_factor = (
            np.stack([np.concatenate([getattr(b, name) for b in one.blocks]) for one in plantings])
            for name in ("values", "slopes", "variance", "by_factor")
        )
        noise = variance.mean(axis=0)
        alike = _alike(keys, sizes)
        usual = values.mean(axis=0)
        sd = np.sqrt((relative_sd * usual) ** 2 + noise)
        # Where plants stand, then errors and noise, which statistics of the same bands share.
        covariance = scatter_covariance(values, alike) + alike * sd * sd[:, None]
        scale = np.asarray(space.prior_sd, float)
        # By parameters in units of their priors, so that a threshold means the same for all.
        shared = shared_slopes(slopes * scale, covariance, rows) / scale
        # What plantings share does not depend on what bands are off by: so no bound falls by it.
        covariance = covariance + _of_factors(keys, rows, usual, by_factor.mean(axis=0), factors)
        mean_noise = {
            key: np.mean([one.mean_noise[key] for one in plantings], axis=0)
            for key in first.mean_noise
        }
        return cls(space, keys, rows, covariance, shared, mean_noise, first.pixels)

    def bounds(self, step: int, count: int) -> tuple[int, Information]:
        """Pixels, and bounds of the sensor with such pixels and so many bands."""
        # What this sensor's image gives: its own pixels and bands, and wider ones made of them.
        own = [
            (key, rows)
            for key, rows in zip(self.keys, self.rows)
            if count % key[1] == 0 and (key[0] == 0 or key[0] >= step)
        ]
        rows = np.concatenate([rows for _, rows in own])
        noise = np.concatenate(
            [np.zeros(len(r)) if s else self.mean_noise[step, n] for (s, n), r in own]
        )
        information = fisher_information(
            self.space.names,
            self.slopes[rows],
            self.covariance[np.ix_(rows, rows)] + np.diag(noise),
            np.asarray(self.space.prior_sd, float),
        )
        return self.pixels[step], information


def _alike(keys: Sequence[tuple[int, int]], sizes: Sequence[int]) -> np.ndarray:
    """Correlation of errors of statistics that share bands.

    An error of a wide band is the mean of those of the narrow ones in it, and an own one that
    makes it as large as theirs: an instrument of many bands can do what one of few can.
    Statistics of different kind or pixel have independent errors.
    """
    most = int(np.lcm.reduce([count for _, count in keys]))
    kinds, weights = [], []
    for (step, count), size in zip(keys, sizes):
        of_band = np.kron(np.eye(count), np.full(most // count, count / most))
        # Each band as a mean of the narrowest bands of which all are made.
        weights.append(np.repeat(of_band, size // count, axis=0))
        kinds += [(step, i % (size // count)) for i in range(size)]
    weight = np.concatenate(weights)
    same = np.array([[one == other for other in kinds] for one in kinds])
    shared = same * (weight @ weight.T)
    return shared + np.diag(1.0 - np.diagonal(shared))


def _of_factors(
    keys: Sequence[tuple[int, int]],
    rows: Sequence[np.ndarray],
    values: Float[np.ndarray, " statistic"],
    by_factor: Float[np.ndarray, "statistic band"],
    factors: BandFactors,
) -> Float[np.ndarray, "statistic statistic"]:
    """Covariance of statistics by the factors of bands, to first order.

    The gain of a wide band is the mean of those of the bands that are next narrower, weighted by
    reflectance, and an own part that makes it as uncertain as theirs, as a sensor of few bands has
    it: what is made of many bands then tells nothing beside these.
    """
    of_gains, most = np.asarray(factors.of_gains), by_factor.shape[1]
    found = by_factor @ (of_gains + np.asarray(factors.of_model)) @ by_factor.T
    means = {count: at for (step, count), at in zip(keys, rows) if step == 0}
    # Roots of the own parts of gains, by number of bands, the narrowest first.
    wide = sorted(set(means) - {most}, reverse=True)
    own = {most: np.zeros((most, sum(wide)))}
    for count, start in zip(wide, np.cumsum([0, *wide])):
        weight = by_factor[means[count]] / values[means[count], None]
        finer = min(one for one in own if one % count == 0)
        root = weight.reshape(count, finer, -1).sum(axis=2) @ own[finer]
        known = np.einsum("bi,ij,bj->b", weight, of_gains, weight) + (root**2).sum(axis=1)
        missing = np.maximum(weight @ np.diagonal(of_gains) - known, 0.0)
        root[:, start : start + count] = np.diag(np.sqrt(missing))
        own[count] = root
    every = np.concatenate(
        [np.repeat(own[count], len(at) // count, axis=0) for (_, count), at in zip(keys, rows)]
    )
    every *= values[:, None]
    return np.asarray(found + every @ every.T)
