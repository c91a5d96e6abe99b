"""What sensors of coarser and coarser pixels measure of a community."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.assembly import build_plot
from fynjax.diversity import (
    coefficient_of_variation,
    mean_spectral_angle,
    pielou_evenness,
    shannon,
    simpson,
    spectral_rao,
)
from fynjax.io.plot import Plot
from fynjax.scene import observe, pixel_truth
from fynjax.sensors import PointSpread, Sensor
from fynjax.studies.communities._draw import Gradients, draw_community

DIVERSITIES = ("richness", "shannon", "simpson", "evenness", "cover")
"""What is asked of a community: number of species, Shannon entropy, Simpson's index and evenness
after Pielou of the covers as seen from above, and their sum."""
METRICS = ("cv", "angle", "rao", "variance")
"""What is computed of the spectra of all pixels: coefficient of variation, mean angle to the mean
spectrum, Rao's Q, and variance summed over bands."""
_RAO_PIXELS = 1000
"""Pixels of which Rao's Q is taken, at most: it compares each with each."""
_DRAWS = 10
"""Communities that are drawn anew, at most, where one finds no room on the plot."""
LEADING = 0.5
"""Share of a pixel that its leading species must have for the pixel to count as of it [-]."""


@dataclass(frozen=True)
class Design:
    """How communities are observed."""

    sensors: tuple[Sensor, ...]
    """Imaging sensors, each with the bands that are used."""
    pixels: tuple[float, ...]
    """Edges of a pixel on the ground [m], ascending, multiples of the first."""
    noise: tuple[float, ...]
    """Standard deviations of the noise of a pixel, relative to its reflectance [-]."""
    samples: int
    """Pixels of each species that a community gives to the classification, at most."""
    seed: int
    """Seed of communities, plantings and noise."""


def observe_community(
    number: int, pool: Plot, gradients: Gradients, design: Design
) -> tuple[np.ndarray, ...]:
    """Diversity of the plants of a community, and of its spectra.

    **Returns:** `DIVERSITIES`; spectral `METRICS` [sensor, pixel, noise, metric], NaN of fewer than
    two pixels; the species of sampled pixels [pixel, sample], -1 for none; and for each sensor
    their spectra [pixel, noise, sample, band].
    """
    random = np.random.default_rng([design.seed, 71, number])
    for left in reversed(range(_DRAWS)):
        plot = draw_community(pool, gradients, random)
        try:
            scene, _ = build_plot(plot, seed=int(random.integers(2**31)), rounding="random")
            break
        except InputError:  # no room for the plants of this one
            if not left:
                raise
    scene = scene.padded()  # so that communities share compiled programs
    fine = design.pixels[0]
    truth = pixel_truth(scene, design.sensors[0], pixel=fine, point_spread=False)
    shares = np.asarray(truth.species)
    metrics = np.full((len(design.sensors), len(design.pixels), len(design.noise), 4), np.nan)
    chosen = [
        _sample(_coarser(shares, design.sensors[0].psf, pixel / fine), design.samples, random)
        for pixel in design.pixels
    ]
    species = np.stack([kinds for kinds, _ in chosen])
    spectra = []
    for s, sensor in enumerate(design.sensors):
        image = np.asarray(
            observe(scene, sensor, pixel=fine, point_spread=False).reflectance, np.float32
        )
        kept = np.zeros((*species.shape[:1], len(design.noise), species.shape[1], len(image)))
        for p, pixel in enumerate(design.pixels):
            seen = _coarser(image, sensor.psf, pixel / fine).reshape(len(image), -1).T
            for n, noise in enumerate(design.noise):
                noisy = seen * (1.0 + noise * random.normal(size=seen.shape))
                metrics[s, p, n] = _metrics(noisy, random)
                kept[p, n] = noisy[chosen[p][1]]
        spectra.append(kept.astype(np.float32))
    return _diversities(shares.mean(axis=(1, 2))), metrics, species, *spectra


def _coarser(
    image: Float[np.ndarray, "band y x"], psf: PointSpread | None, times: float
) -> Float[np.ndarray, "band y x"]:
    """Pixels that are `times` as wide, blurred by the optics of a sensor of such pixels."""
    size = round(times)
    if psf is not None:
        image = np.asarray(psf.on_pixels(1.0 / size).blur(jnp.asarray(image), boundary="periodic"))
    bands, rows, columns = image.shape
    ny, nx = rows // size, columns // size
    return image.reshape(bands, ny, size, nx, size).mean(axis=(2, 4))


def _sample(
    shares: Float[np.ndarray, "species y x"], most: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Species and places of some pixels that are mostly of one species; -1 where there are none."""
    flat = shares.reshape(len(shares), -1)
    leading = np.where(flat.max(axis=0) >= LEADING, flat.argmax(axis=0), -1)
    kinds = np.full(len(shares) * most, -1)
    places = np.zeros(len(kinds), int)
    for i in range(len(shares)):
        found = random.permutation(np.flatnonzero(leading == i))[:most]
        kinds[i * most : i * most + len(found)] = i
        places[i * most : i * most + len(found)] = found
    return kinds, places


def _diversities(cover: Float[np.ndarray, " species"]) -> Float[np.ndarray, " diversity"]:
    number = int((cover > 0.0).sum())
    even = float(pielou_evenness(cover)) if number > 1 else np.nan
    return np.array([number, float(shannon(cover)), float(simpson(cover)), even, cover.sum()])


def _metrics(
    spectra: Float[np.ndarray, "pixel band"], random: np.random.Generator
) -> Float[np.ndarray, " metric"]:
    if len(spectra) < 2:
        return np.full(len(METRICS), np.nan)
    some = random.permutation(len(spectra))[:_RAO_PIXELS]
    variance = spectra.var(axis=0, ddof=1).sum()
    found = coefficient_of_variation(spectra), mean_spectral_angle(spectra)
    return np.array([*map(float, found), float(spectral_rao(spectra[some])), variance])
