"""Information that bands of a camera give of a stand, and its slopes by centres and widths.

Whatever its bands, a sensor averages one spectrum. So the image of each planting and its slopes are
computed once, on a grid of wavelengths. Means over the pixels are linear in a band's response, and
covariances over the pixels quadratic: what any camera says follows in a millisecond.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float, Int

from fynjax._core.progress import track
from fynjax._core.spectral import FWHM_PER_SIGMA
from fynjax.inversion._search import COARSE, coarser
from fynjax.inversion._sensor_sweep import image_and_slopes
from fynjax.inversion._space import ParameterSpace
from fynjax.metrics import spectral_mask
from fynjax.scene import ModelError, Placement, PlotAir, PlotParameters, Scene, aim, truth_of_pixels
from fynjax.sensors import ASSUMED, SPACE, BandSet, Gains, OrthographicCamera, Sensor

STEP = 10.0
"""Step of the grid of wavelengths [nm]."""
RANGE = (400.0, 2500.0)
"""Range of the spectra of plants and ground [nm]."""
FEWEST = 10
"""Pixels that a species needs in a planting, where species are to separate."""
_LEADING = 0.5
"""Share of a pixel that makes it one of a species [-]."""
_REFERENCE = 550.0, 10.0, 0.1
"""Centre and width [nm] of the band, and the reflectance, that a signal-to-noise ratio is of."""
_KEPT = 1e-9
"""Share of the variance of spectra that the few components leave out in which pixels are kept."""
_SHRUNK = 0.5
"""Share of the covariance between plantings that is taken from that between pixels."""
_OPAQUE = 1e-8
"""Photons in the water windows, over the most at any wavelength."""
_TINY = 1e-30


class PlantingSpectra(eqx.Module):
    """Spectra of the images of all plantings, and their slopes, on a grid of wavelengths.

    Slopes are by the parameters in units of their priors; reflectance factors and slopes [-].
    """

    grid: Float[Array, " wavelength"]
    """Wavelengths [nm]."""
    mean: Float[Array, "planting wavelength"]
    """Mean reflectance factor of the pixels."""
    mean_slope: Float[Array, "planting wavelength free"]
    """Slopes of `mean`."""
    basis: Float[Array, "wavelength component"]
    """Spectra of which those of all pixels, less their mean, are combinations."""
    second: Float[Array, "planting component component"]
    """Covariance over the pixels of the weights of the spectra in `basis`."""
    second_slope: Float[Array, "planting component component free"]
    """Slopes of `second`."""
    photons: Float[Array, " wavelength"]
    """Photons that a pixel collects per nm from a white ground."""
    asked: Float[Array, "planting quantity free"]
    """Slopes of the quantities that are asked for: of the parameters themselves for "information",
    of none for "separability"."""
    species: Float[Array, "planting species"]
    """Pixels that are mostly of each species, 0 where they are fewer than `FEWEST`."""
    species_mean: Float[Array, "planting species wavelength"]
    """Mean reflectance factor of these."""
    species_second: Float[Array, "planting species component component"]
    """Covariance of these."""
    pixels: Float[Array, ""]
    """Pixels of an image."""
    model_error: Float[Array, "wavelength wavelength"]
    """Covariance of the logarithms of factors that the model is off by."""
    relative_sd: float = eqx.field(static=True)
    """Independent error of every statistic, relative [-]."""
    target: str = eqx.field(static=True)
    """"information", "separability" or "quantities"."""


class BandStatistics(NamedTuple):
    """Statistics that some bands measure of every planting."""

    mean: Float[Array, "planting band"]
    covariance: Float[Array, "planting band band"]
    mean_slope: Float[Array, "planting band free"]
    variance_slope: Float[Array, "planting band free"]
    noise: Float[Array, " band"]
    species_mean: Float[Array, "planting species band"]
    species_covariance: Float[Array, "planting species band band"]
    model_error: Float[Array, "band band"]
    """Covariance of the logarithms of factors that the model is off by."""
    gain_sd: Float[Array, " band"]
    """Standard deviation of the logarithm of the gain of each band."""
    gain_shared: Float[Array, ""]
    """Share of its variance that all bands have in common."""

    @property
    def factors(self) -> Float[Array, "band band"]:
        """Covariance of the logarithms of the factors that bands are off by."""
        common = self.gain_shared + (1.0 - self.gain_shared) * jnp.eye(len(self.gain_sd))
        return self.model_error + self.gain_sd[:, None] * self.gain_sd * common

    def chosen(self, at: Int[Array, " chosen"]) -> "BandStatistics":
        """Statistics of the bands at some places."""
        return BandStatistics(
            self.mean[:, at],
            self.covariance[:, at[:, None], at],
            self.mean_slope[:, at],
            self.variance_slope[:, at],
            self.noise[at],
            self.species_mean[:, :, at],
            self.species_covariance[:, :, at[:, None], at],
            self.model_error[at[:, None], at],
            self.gain_sd[at],
            self.gain_shared,
        )


def gaussian_weights(
    grid: Float[Array, " wavelength"], centre: Float[Array, " band"], fwhm: Float[Array, " band"]
) -> Float[Array, "band wavelength"]:
    """Weights of a spectrum, linear between the points of `grid` [nm], in Gaussian bands: those of
    `BandSet.weights`, differentiable in centre and full width at half maximum [nm]."""
    sigma = (fwhm / FWHM_PER_SIGMA)[:, None]
    z = (grid - centre[:, None]) / sigma
    zeroth = jnp.diff(ndtr(z), axis=1)
    first = jnp.diff(-sigma * jnp.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi), axis=1)
    # Zeroth and first moment of the response in each step of the grid share it out between the
    # two ends of the step, as a spectrum that is linear between them asks for.
    above = (z[:, 1:] * sigma * zeroth - first) / jnp.diff(grid)
    weights = jnp.pad(above, ((0, 0), (0, 1))) + jnp.pad(zeroth - above, ((0, 0), (1, 0)))
    return weights / weights.sum(axis=1, keepdims=True)


def measured(
    spectra: PlantingSpectra,
    weights: Float[Array, "band wavelength"],
    width: Float[Array, " band"],
    gains: Gains = ASSUMED,
) -> BandStatistics:
    """Statistics that bands of some weights and widths [nm] measure, weighted by the light as well.

    The model's error in a band is the mean of that at its wavelengths, weighted by what it sees.
    A pixel collects N = width * sum(weights * photons * reflectance) photons, and its shot noise is
    reflectance / sqrt(N) (Janesick 2007, Photon transfer, chapter 3).
    """
    lit = weights * spectra.photons
    weights = lit / lit.sum(axis=1, keepdims=True)
    # A band is a weighted mean of the spectrum: covariances follow from those of the components.
    rows = weights @ spectra.basis
    mean = spectra.mean @ weights.T
    count = width * (lit @ spectra.mean.mean(axis=0))
    share = weights * spectra.mean.mean(axis=0)
    share = share / share.sum(axis=1, keepdims=True)
    return BandStatistics(
        mean,
        jnp.einsum("bi,pij,cj->pbc", rows, spectra.second, rows),
        jnp.einsum("bw,pwk->pbk", weights, spectra.mean_slope),
        jnp.einsum("bi,pijk,bj->pbk", rows, spectra.second_slope, rows),
        mean.mean(axis=0) ** 2 / count,
        spectra.species_mean @ weights.T,
        jnp.einsum("bi,psij,cj->psbc", rows, spectra.species_second, rows),
        share @ spectra.model_error @ share.T,
        jnp.asarray(gains.of_bands(len(weights))),
        jnp.asarray(gains.shared),
    )


def scores(
    spectra: PlantingSpectra, seen: BandStatistics, among: Float[Array, " planting"]
) -> Float[Array, "planting quantity"]:
    """Share of each quantity's variance that bands remove in each planting [-], by an estimate that
    the other plantings of `among` (1 or 0) make; `design` has the formulas.

    Where plants stand changes the statistics with a covariance that is drawn half-way from that
    between the others to that which pixels suggest: of means as of the pixels, of standard
    deviations with the squared correlation of the pixels, as normal samples have it, each as large
    as it is between plantings over all wavelengths.
    """
    others = among * (1.0 - jnp.eye(len(among)))
    others = others / others.sum(axis=1, keepdims=True)
    if spectra.target == "separability":
        return jax.vmap(lambda *of: _separated(spectra, seen, *of))(others, jnp.arange(len(among)))
    variance = jnp.diagonal(seen.covariance, axis1=1, axis2=2)
    pixel = variance + seen.noise
    sd = jnp.sqrt(pixel)
    values = jnp.concatenate([seen.mean, sd], axis=1)
    slopes = jnp.concatenate([seen.mean_slope, seen.variance_slope / (2.0 * sd[..., None])], axis=1)
    # Variance by shot noise of a standard deviation, to first order in a large sample.
    of_sd = (2.0 * variance * seen.noise + seen.noise**2) / (2.0 * pixel)

    def left(share: Array, value: Array, slope: Array, asked: Array) -> Array:
        """Variance of each quantity that is left, over that of its prior."""
        count = jnp.sum(share > 0.0)
        centre = share @ values
        # Scatter of the other plantings about their mean, unbiased.
        apart = jnp.sqrt(share)[:, None] * (values - centre)
        between = apart.T @ apart * (count / (count - 1.0))
        covariance = jnp.tensordot(share, seen.covariance, axes=1)
        root = jnp.sqrt(jnp.diagonal(covariance) + _TINY)
        of_means, of_spreads = _chance(spectra, share)
        # Standard deviations of normal samples scatter together by the squared covariance of the
        # values over both deviations; how far they do follows from plantings (`of_spreads`).
        alike = covariance**2 / jnp.outer(root, root)
        suggested = jax.scipy.linalg.block_diag(of_means * covariance, of_spreads * alike)
        # Errors of the sensor: relative, and shot noise in a mean and a standard deviation.
        noise = jnp.concatenate([seen.noise, share @ of_sd]) / spectra.pixels
        own = jnp.diag((spectra.relative_sd * centre) ** 2 + noise)
        # Mean and standard deviation of a band scale with its factor.
        own += centre[:, None] * centre * jnp.tile(seen.factors, (2, 2))
        total = (1.0 - _SHRUNK) * between + _SHRUNK * suggested + own
        total += jnp.einsum("p,psk,ptk->st", share, slopes, slopes)
        known = jnp.einsum("p,psk,pqk->sq", share, slopes, spectra.asked)
        # The best linear estimate by the other plantings, and what it leaves in this one: slopes
        # that it misses, where plants stand, and noise.
        estimate = jnp.linalg.solve(total, known)
        astray = jnp.sum((asked - estimate.T @ slope) ** 2, axis=1)
        chance = (value - centre) @ estimate
        noisy = jnp.sum(estimate * (own @ estimate), axis=0)
        wrong = astray + count / (count + 1.0) * chance**2 + noisy
        return wrong / jnp.sum(asked**2, axis=1)

    rest = jax.vmap(left)(others, values, slopes, spectra.asked)
    if spectra.target == "information":
        return -0.5 * jnp.log2(rest).sum(axis=1, keepdims=True)
    return 1.0 - rest


def _chance(spectra: PlantingSpectra, share: Float[Array, " planting"]) -> tuple[Array, Array]:
    """Variance of means between plantings over that of pixels, and relative variance of standard
    deviations, over all wavelengths."""
    pixel = jnp.einsum("wi,pij,wj->pw", spectra.basis, spectra.second, spectra.basis)
    count = jnp.sum(share > 0)

    def between(values: Array) -> Array:
        return jnp.sum(share @ (values - share @ values) ** 2) * count / (count - 1.0)

    of_means = between(spectra.mean) / jnp.sum(share @ pixel)
    return of_means, between(jnp.sqrt(jnp.abs(pixel))) / jnp.sum(share @ pixel)


def _separated(
    spectra: PlantingSpectra,
    seen: BandStatistics,
    share: Float[Array, " planting"],
    at: Int[Array, ""],
) -> Float[Array, " 1"]:
    """Mean Jeffries-Matusita distance of two species in a planting, along the line that parts them
    best in the others, as normal classes of the same covariance, with the noise."""
    first, second = np.triu_indices(spectra.species.shape[1], 1)
    number = share[:, None] * spectra.species
    number = number / jnp.maximum(number.sum(axis=0), _TINY)

    def apart(mean: Array, covariance: Array) -> tuple[Array, Array]:
        both = 0.5 * (covariance[first] + covariance[second]) + jnp.diag(seen.noise)
        return mean[first] - mean[second], both

    off, both = apart(
        jnp.einsum("ps,psb->sb", number, seen.species_mean),
        jnp.einsum("ps,psbc->sbc", number, seen.species_covariance),
    )
    line = jnp.linalg.solve(both, off[..., None])[..., 0]
    # Fisher's line is that of the others; how far it parts the species is asked of this planting.
    off, both = apart(seen.species_mean[at], seen.species_covariance[at])
    along = jnp.maximum(jnp.sum(line * off, axis=1), 0.0)
    square = along**2 / jnp.maximum(jnp.einsum("cb,cbd,cd->c", line, both, line), _TINY)
    there = (spectra.species[at] > 0) & (number.sum(axis=0) > 0)
    known = there[first] & there[second]
    # Jeffries-Matusita: 2 (1 - exp(-B)), of equal covariances with B an eighth of the squared
    # Mahalanobis distance.
    distance = -2.0 * jnp.expm1(-square / 8.0)
    return jnp.atleast_1d(jnp.sum(known * distance) / jnp.maximum(jnp.sum(known), 1))


class Errors(NamedTuple):
    """What statistics of a sensor that is designed are off by."""

    snr: float
    """Signal over shot noise of one of the smallest pixels, as of `design`."""
    relative_sd: float
    """Independent error of every statistic, relative [-]."""
    of_model: ModelError | None
    """None where the model is believed."""


def render_plantings(
    stands: Sequence[Scene],
    space: ParameterSpace,
    asked: Float[np.ndarray, "planting quantity free"],
    grid: Float[np.ndarray, " wavelength"],
    pixels: Sequence[float],
    errors: Errors,
    target: str,
) -> list[PlantingSpectra]:
    """Images of all plantings with their slopes, in light of the accuracy `COARSE`: for each edge
    of `pixels` [m], multiples of the first, whose means collect as many more photons."""
    scene, parameters, pixel = stands[0], stands[0].parameters, pixels[0]
    steps = [round(one / pixel) for one in pixels]
    names = tuple(f"{one:g}" for one in grid)
    bands = BandSet(names, tuple(grid), (STEP,) * len(grid), response="box")
    sensor = Sensor("grid", bands, OrthographicCamera(pixel))
    aimed = aim(
        coarser(scene, parameters), parameters, sensor, Placement(pixel=pixel),
        accuracy=COARSE, point_spread=False,
    ).sampled(1)  # fmt: skip
    none = jnp.zeros(len(space.names))
    whiten = np.asarray(jax.jacfwd(space.physical)(none), np.float32)
    at = space.physical(none)
    kept: list[list[tuple[np.ndarray, ...]]] = [[] for _ in steps]
    scale = into = np.ones(0)
    for stand in track(stands, "Render the plantings"):
        quick = coarser(stand, parameters)
        image, slopes = map(np.asarray, image_and_slopes(aimed, quick, parameters, space.names, at))
        side = image.shape[1:]
        off = image.reshape(len(grid), -1).astype(float)
        off_slope = slopes.reshape(*off.shape, -1) @ whiten
        mean, mean_slope = off.mean(axis=1), off_slope.mean(axis=1, dtype=float)
        off -= mean[:, None]
        off_slope -= mean_slope[:, None].astype(np.float32)
        if not into.any():
            scale = mean[:, None]
            into = _components(off, off_slope, scale)
        change = np.tensordot(into.astype(np.float32), off_slope, 1)
        # Species by what is in sight, which no band shows.
        share = np.asarray(truth_of_pixels(aimed, quick, parameters).species)
        fine = into @ off, change, share.reshape(len(share), -1)
        for of_pixel, step in zip(kept, steps, strict=True):
            of_pixel.append((mean, mean_slope, *_of_pixels(*fine, side, step)))
    # Orthonormal in spectra over the mean, so that the way back scales by its square.
    basis = (into * (scale * scale).T).T
    photons = _photons(parameters, bands, errors.snr)
    believed = np.zeros((len(grid), len(grid)))
    off_by = believed if errors.of_model is None else errors.of_model.covariance(grid)
    found = []
    for step, of_pixel in zip(steps, kept, strict=True):
        means, slope, second, second_slope, number, centre, spread = map(np.stack, zip(*of_pixel))
        arrays = {
            "grid": grid, "mean": means, "mean_slope": slope, "basis": basis, "second": second,
            "second_slope": second_slope, "photons": photons * step**2, "asked": asked,
            "species": number, "species_mean": means[:, None] + centre @ basis.T,
            "species_second": spread, "pixels": float(np.prod(side) // step**2),
            "model_error": off_by,
        }  # fmt: skip
        arrays = jax.tree.map(jnp.asarray, arrays)
        found.append(PlantingSpectra(**arrays, relative_sd=errors.relative_sd, target=target))
    return found


def _components(
    off: Float[np.ndarray, "wavelength pixel"],
    slopes: Float[np.ndarray, "wavelength pixel free"],
    scale: Float[np.ndarray, "wavelength 1"],
) -> Float[np.ndarray, "component wavelength"]:
    """Makes of spectra their weights in the few of which nearly all image and slopes are made."""
    # Principal components relative to the mean spectrum, the dark wavelengths as much as others.
    every = (off, *(one.astype(float) for one in np.moveaxis(slopes, 2, 0)))
    values, vectors = np.linalg.eigh(sum(one @ one.T for one in every) / (scale * scale.T))
    return vectors[:, np.cumsum(values) > _KEPT * values.sum()].T / scale.T


def _of_pixels(
    weight: Float[np.ndarray, "component pixel"],
    change: Float[np.ndarray, "component pixel free"],
    share: Float[np.ndarray, "species pixel"],
    side: tuple[int, int],
    step: int,
) -> tuple[np.ndarray, ...]:
    """Covariance of weights and its slopes, and of each species the number, mean and covariance of
    pixels, in pixels of `step` finer ones on a side; zero where they are too few."""
    rows, columns = (count // step for count in side)

    def wider(values: np.ndarray) -> np.ndarray:
        parts = values.reshape(len(values), rows, step, columns, step, *values.shape[2:])
        return parts.mean(axis=(2, 4)).reshape(len(values), rows * columns, *values.shape[2:])

    weight, change, share = wider(weight), wider(change), wider(share)
    # d(w w') = dw w' + w dw'.
    half = np.einsum("ixk,jx->ijk", change, weight) / weight.shape[1]
    size = len(weight)
    none = np.zeros(()), np.zeros(size), np.zeros((size, size))
    species = []
    for of_one in share > _LEADING:
        own = weight[:, of_one]
        enough = of_one.sum() >= FEWEST
        species.append((of_one.sum(), own.mean(axis=1), np.cov(own)) if enough else none)
    second = weight @ weight.T / weight.shape[1]
    return second, half + half.swapaxes(0, 1), *map(np.stack, zip(*species, strict=True))


def _photons(
    parameters: PlotParameters, bands: BandSet, snr: float
) -> Float[np.ndarray, " wavelength"]:
    """Photons that a pixel collects per nm from a white ground, in each box of the grid; next to
    none in the water windows, where air is opaque."""
    air = PlotAir().atmosphere(parameters.light, SPACE)
    grid = np.array(air.wavelength)
    light = np.asarray(air.upward_transmittance * (air.direct + air.diffuse)) * grid
    nm, width, reflectance = _REFERENCE
    # Shot noise: the square of signal over noise is the number of photons.
    per = snr**2 / (float(np.interp(nm, grid, light)) * width * reflectance)
    clear = spectral_mask(np.array(bands.centre), RANGE)
    return per * np.where(clear, bands.weights(grid) @ light, _OPAQUE * light.max())
