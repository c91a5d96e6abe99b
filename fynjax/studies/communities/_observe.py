"""Measurements of a community by sensors of coarser and coarser pixels."""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import Plot
from fynjax.diversity import (
    VARIETY,
    diversity_indices,
    gower_distance,
    hull_volume,
    principal_components,
    rao_entropy,
    spectral_variety,
)
from fynjax.inversion import COARSE, nadir_imager
from fynjax.scene import Scene, observe, pixel_truth, truth_of_pixels
from fynjax.sensors import PointSpread, Sensor
from fynjax.studies.communities._draw import Gradients, draw_community

DIVERSITIES = ("richness", "shannon", "simpson", "evenness", "cover", "functional")
"""What is asked of a community: number of species, Shannon entropy, Simpson's index and evenness
after Pielou of the covers as seen from straight above, their sum, and Rao's quadratic entropy with
the distance of species in growth form, height and leaf chemistry (`functional_distance`)."""
OF_IMAGE = (*VARIETY, "hull")
"""Spectral metrics of the pixels of an image: `VARIETY`, and the volume of their convex hull in
their own first three principal components."""
CLUSTERED = 200
"""Pixels that a community gives to the spectral species of all communities, at most."""
_TRAITS = ("chlorophyll", "carotenoids", "water", "dry_matter")
"""Traits of leaves in which species differ."""
_DRAWS = 10
"""Communities that are drawn anew, at most, where one finds no room on the plot."""
_NDVI = (670.0, 860.0)
"""Wavelengths of the bands of an NDVI [nm]."""
_NEAR = 40.0
"""Distance from these up to which a band will do [nm]."""
LEADING = 0.5
"""Share of a pixel that its leading species must have for the pixel to count as of it [-]."""


@dataclass(frozen=True)
class Design:
    """Sensors, pixels and noise by which communities are observed."""

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
    greenness: float | None = None
    """NDVI that a pixel must have to count in the metrics [-]; None: all pixels do."""
    related: tuple[tuple[float, ...], ...] = ()
    """Path between each two species of the table in a tree of descent; empty: no tree."""

    @property
    def diversities(self) -> tuple[str, ...]:
        """What is asked of a community: `DIVERSITIES`, and with a tree "phylogenetic", Rao's
        quadratic entropy with the paths in it, in its unit."""
        return DIVERSITIES + ("phylogenetic",) * bool(self.related)


def observe_community(
    number: int, pool: Plot, gradients: Gradients, design: Design
) -> tuple[np.ndarray, ...]:
    """Diversity of the plants of a community, and of its spectra.

    **Returns:** `Design.diversities`; the cover of each species as seen from straight above; the
    spectral metrics `OF_IMAGE` [sensor, pixel, noise, metric]; the species of sampled pixels
    [sensor, pixel, sample], -1 for none; for each sensor their spectra [pixel, noise, sample,
    band]; and for each sensor spectra of other pixels, drawn from all that count [pixel, noise,
    drawn, band], NaN where there are fewer.
    """
    random = np.random.default_rng([design.seed, 71, number])
    for left in reversed(range(_DRAWS)):
        plot = draw_community(pool, gradients, random, design.related)
        try:
            scene, _ = build_plot(plot, seed=int(random.integers(2**31)), rounding="random")
            break
        except InputError:  # no room for the plants of this one
            if not left:
                raise
    scene = scene.padded()  # so that communities share compiled programs
    fine = design.pixels[0]
    above = nadir_imager(design.sensors[0].bands.select([0]), scene, scene.parameters)
    cover = np.asarray(truth_of_pixels(above, scene, scene.parameters).species).mean(axis=(1, 2))
    shape = len(design.sensors), len(design.pixels), len(design.noise), len(OF_IMAGE)
    metrics = np.zeros(shape)
    species, spectra, drawn = [], [], []
    for s, sensor in enumerate(design.sensors):
        coarser = partial(_coarser, psf=sensor.psf, boundary=scene.boundary)
        seen_fine = observe(scene, sensor, pixel=fine, point_spread=False, accuracy=COARSE)
        image = np.asarray(seen_fine.reflectance)
        seen = pixel_truth(scene, sensor, pixel=fine, point_spread=False)
        shares = np.asarray(seen.species)
        kinds, kept = [], []
        some = np.full((*shape[1:3], CLUSTERED, len(image)), np.nan, np.float32)
        for p, pixel in enumerate(design.pixels):
            times = round(pixel / fine)
            of_pixel, places = _sample(coarser(shares, times), design.samples, random)
            clear = coarser(image, times).reshape(len(image), -1).T
            for n, noise in enumerate(design.noise):
                noisy = clear * (1.0 + noise * random.normal(size=clear.shape))
                seen_green = noisy[green(noisy, sensor, design.greenness)]
                found = spectral_variety(seen_green, seed=random)
                metrics[s, p, n] = [*(found[name] for name in VARIETY), hull(seen_green)]
                kept.append(noisy[places])
                few = random.permutation(seen_green)[:CLUSTERED]
                some[p, n, : len(few)] = few
            kinds.append(of_pixel)
        species.append(np.stack(kinds))
        spectra.append(np.reshape(kept, (*shape[1:3], -1, len(image))).astype(np.float32))
        drawn.append(some)
    asked = diversity_indices(cover[None])
    asked["functional"] = np.asarray(rao_entropy(cover[None], functional_distance(pool, scene)))
    if design.related:
        asked["phylogenetic"] = np.asarray(rao_entropy(cover[None], design.related))
    stand = np.array([asked[name][0] for name in design.diversities])
    return stand, cover, metrics, np.stack(species), *spectra, *drawn


def functional_distance(pool: Plot, scene: Scene) -> Float[np.ndarray, "species species"]:
    """Gower's distance of each two species of a pool in growth form, height and the chlorophyll,
    carotenoids, water and dry matter of their leaves [-]; traits that are the same in all species
    do not count.

    **Arguments:** `pool`, with the species; `scene`, of the same species, with their leaves.
    """
    leaf = scene.parameters.leaf
    traits = pd.DataFrame({
        "form": [row.growth_form for row in pool.species],
        "height": [row.height for row in pool.species],
        **{name: np.asarray(getattr(leaf, name), float) for name in _TRAITS},
    })  # fmt: skip
    varied = traits.loc[:, traits.nunique() > 1]
    if varied.empty:
        return np.zeros((len(traits),) * 2)
    return gower_distance(varied)


def hull(spectra: Float[np.ndarray, "pixel band"]) -> float:
    """Volume of the hull of spectra in their own principal components, three or as many as there
    are bands; NaN of too few pixels, 0 of pixels that are all alike."""
    count = min(3, spectra.shape[1])
    if len(spectra) < count + 2:
        return float("nan")
    if np.ptp(spectra, axis=0).max() <= 1e-10 * np.abs(spectra).max():
        return 0.0
    return hull_volume(principal_components(spectra, count).scores(spectra))


def _coarser(
    image: Float[np.ndarray, "band y x"],
    times: int,
    psf: PointSpread | None,
    boundary: Literal["periodic", "open"],
) -> Float[np.ndarray, "band row column"]:
    """Pixels that are `times` as wide, blurred by the optics of a sensor of such pixels."""
    if psf is not None:
        beyond: Literal["periodic", "edge"] = "periodic" if boundary == "periodic" else "edge"
        image = np.asarray(psf.on_pixels(1.0 / times).blur(jnp.asarray(image), boundary=beyond))
    bands, rows, columns = image.shape
    ny, nx = rows // times, columns // times
    return image.reshape(bands, ny, times, nx, times).mean(axis=(2, 4))


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


def green(
    spectra: Float[np.ndarray, "pixel band"], sensor: Sensor, least: float | None
) -> Bool[np.ndarray, " pixel"]:
    """Mask of pixels with an NDVI of at least `least`, of the bands nearest to 670 and 860 nm.

    **Raises:** `InputError` for a sensor that has no band within 40 nm of these.
    """
    if least is None:
        return np.ones(len(spectra), bool)
    centres = np.array(sensor.bands.centre)
    near = [int(np.argmin(np.abs(centres - nm))) for nm in _NDVI]
    if np.abs(centres[near] - _NDVI).max() > _NEAR:
        raise InputError(
            f"a `greenness` needs bands near {_NDVI[0]:g} and {_NDVI[1]:g} nm, but the "
            f"{len(centres)} of {sensor.name} that are used (`bands`) do not have both"
        )
    red, nir = spectra[:, near].T
    return nir - red >= least * (nir + red)
