"""Bands of a sensor, chosen by gradient for what they inform of in a stand.

Whatever its bands, a sensor averages one spectrum. So the image of each planting and its slopes are
computed once, on a grid of wavelengths. Means over the pixels are linear in a band's response, and
covariances over the pixels quadratic: the information of any camera follows in a millisecond, with
its gradient by centres and widths.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float, Int
from scipy.optimize import minimize
from scipy.special import stdtrit

from fynjax._core.errors import InputError, did_you_mean, listed
from fynjax._core.html import as_html
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.spectral import FWHM_PER_SIGMA
from fynjax.diversity import shannon
from fynjax.inversion._calibrate import COARSE, coarser, free_space
from fynjax.inversion._functionals import Functional, functional_slopes, stand_functionals
from fynjax.inversion._sensor_sweep import image_and_slopes
from fynjax.inversion._space import ParameterSpace
from fynjax.metrics import spectral_mask
from fynjax.scene import (
    Placement,
    PlotAir,
    PlotParameters,
    Scene,
    aim,
    stand_realisation,
    truth_of_pixels,
)
from fynjax.sensors import (
    SPACE,
    BandSet,
    OrthographicCamera,
    Sensor,
    shipped_sensor,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DESIGN_FREE = (
    *(f"species.*.{kind}" for kind in ("cover", "diameter", "dead_fraction")),
    *(f"species.*.leaf.{name}" for name in ("chlorophyll", "water", "dry_matter")),
    *("ground.brightness", "ground.moisture"),
)
"""Patterns of the parameters that are unknown in a design, by default."""
DESIGN_TARGET = ("green_leaf_area", "dead_share", "canopy_chlorophyll", "crown_cover", "shannon")
"""Numbers of a stand that a design is for by default."""
CAMERAS = ("mavic_3m", "rededge_3", "sentinel_2a")
"""Shipped sensors that a design is compared with by default."""
_CHANNELS = "aviris_ng"
"""Sensor of which as many channels as the design has bands are chosen, to compare."""
_STEP = 10.0
"""Step of the grid of wavelengths [nm]."""
_RANGE = (400.0, 2500.0)
"""Range of the spectra of plants and ground [nm]."""
_WITHIN = 1.4
"""Least distance of a band's centre from either end of the range, over its full width at half
maximum [-]: beyond it lies 5e-4 of the response, which has fallen to 4e-3 of its peak."""
_REFERENCE = 550.0, 10.0, 0.1
"""Centre and width [nm] of the band, and the reflectance, that `snr` is of."""
_KEPT = 1e-9
"""Share of the variance of spectra that the few components leave out in which pixels are kept."""
_LEADING, _FEWEST = 0.5, 10
"""Share of a pixel that makes it one of a species, and the number of such pixels that a species
needs, where species are to separate."""
_RASTER = 80
"""Centres in the raster from which the first ascent starts."""
_DRAWS = 20
"""Random sets of bands of that raster of which the best is a start."""
_SHRUNK = 0.5
"""Share of the covariance between plantings that is taken from that between pixels."""
_OPAQUE = 1e-8
"""Photons in the water windows, over the most at any wavelength."""
_TINY = 1e-30
_SHANNON = Functional(
    "Shannon entropy of the covers", "-", lambda scene, plot: shannon(plot.species.cover)
)
_OTHER_TARGETS = {
    "information": "information on the parameters one by one [bit]",
    "separability": "mean Jeffries-Matusita distance of two species [0 to 2]",
}
"""Targets that are no quantities, in words."""


class _Spectra(eqx.Module):
    """Spectra of the images of all plantings, and their slopes, on a grid of wavelengths."""

    grid: Float[Array, " wavelength"]
    """Wavelengths [nm]."""
    mean: Float[Array, "planting wavelength"]
    """Mean reflectance factor of the pixels [-]."""
    mean_slope: Float[Array, "planting wavelength free"]
    """Slopes of the mean reflectance factor by the parameters in units of their priors [-]."""
    basis: Float[Array, "wavelength component"]
    """Spectra of which those of all pixels, less their mean, are combinations."""
    second: Float[Array, "planting component component"]
    """Covariance over the pixels of the weights of the spectra in `basis` [-]."""
    second_slope: Float[Array, "planting component component free"]
    """Slopes of that covariance by the parameters in units of their priors [-]."""
    photons: Float[Array, " wavelength"]
    """Photons that a pixel collects per nm from a white ground."""
    asked: Float[Array, "planting quantity free"]
    """Slopes by the whitened coordinates of the quantities that are asked for: of these coordinates
    themselves for "information", of none for "separability"."""
    species: Float[Array, "planting species"]
    """Pixels that are mostly of each species, 0 where they are fewer than ten."""
    species_mean: Float[Array, "planting species wavelength"]
    """Mean reflectance factor of these [-]."""
    species_second: Float[Array, "planting species component component"]
    """Covariance of these."""
    pixels: int = eqx.field(static=True)
    """Pixels of an image."""
    error: float = eqx.field(static=True)
    """Independent error of every statistic, relative [-]."""
    target: str = eqx.field(static=True)
    """"information", "separability" or "quantities"."""


class _Measured(NamedTuple):
    """What some bands measure of every planting; `chosen` takes some of the bands."""

    mean: Float[Array, "planting band"]
    covariance: Float[Array, "planting band band"]
    mean_slope: Float[Array, "planting band free"]
    variance_slope: Float[Array, "planting band free"]
    noise: Float[Array, " band"]
    species_mean: Float[Array, "planting species band"]
    species_covariance: Float[Array, "planting species band band"]

    def chosen(self, at: Int[Array, " chosen"]) -> "_Measured":
        return _Measured(
            self.mean[:, at],
            self.covariance[:, at[:, None], at],
            self.mean_slope[:, at],
            self.variance_slope[:, at],
            self.noise[at],
            self.species_mean[:, :, at],
            self.species_covariance[:, :, at[:, None], at],
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
    above = (z[:, 1:] * sigma * zeroth - first) / jnp.diff(grid)
    weights = jnp.pad(above, ((0, 0), (0, 1))) + jnp.pad(zeroth - above, ((0, 0), (1, 0)))
    return weights / weights.sum(axis=1, keepdims=True)


def _measured(
    spectra: _Spectra, weights: Float[Array, "band wavelength"], width: Float[Array, " band"]
) -> _Measured:
    """What bands of some weights and widths [nm] measure: means weighted by the light as well.

    A pixel collects N = width * sum(weights * photons * reflectance) photons, and its shot noise is
    reflectance / sqrt(N) (Janesick 2007, Photon transfer, chapter 3).
    """
    lit = weights * spectra.photons
    weights = lit / lit.sum(axis=1, keepdims=True)
    rows = weights @ spectra.basis
    mean = spectra.mean @ weights.T
    count = width * (lit @ spectra.mean.mean(axis=0))
    return _Measured(
        mean,
        jnp.einsum("bi,pij,cj->pbc", rows, spectra.second, rows),
        jnp.einsum("bw,pwk->pbk", weights, spectra.mean_slope),
        jnp.einsum("bi,pijk,bj->pbk", rows, spectra.second_slope, rows),
        mean.mean(axis=0) ** 2 / count,
        spectra.species_mean @ weights.T,
        jnp.einsum("bi,psij,cj->psbc", rows, spectra.species_second, rows),
    )


def _scores(
    spectra: _Spectra, seen: _Measured, among: Float[Array, " planting"]
) -> Float[Array, "planting quantity"]:
    """Share of each quantity's variance that bands remove in each planting [-], by an estimate that
    the other plantings of `among` (1 or 0) make.

    The estimate of a quantity is linear in mean and standard deviation of each band over the
    pixels, and is the best on average over the others. So slopes that are only where the others'
    plants stand do not help in the planting itself: its share of the variance removed is below 0
    where they lead astray.

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
    of_sd = (2.0 * variance * seen.noise + seen.noise**2) / (2.0 * pixel)

    def left(share: Array, value: Array, slope: Array, asked: Array) -> Array:
        """Variance of each quantity that is left, over that of its prior."""
        count = jnp.sum(share > 0.0)
        centre = share @ values
        apart = jnp.sqrt(share)[:, None] * (values - centre)
        between = apart.T @ apart * (count / (count - 1.0))
        covariance = jnp.tensordot(share, seen.covariance, axes=1)
        root = jnp.sqrt(jnp.diagonal(covariance) + _TINY)
        of_means, of_spreads = _chance(spectra, share)
        alike = covariance**2 / jnp.outer(root, root)
        suggested = jax.scipy.linalg.block_diag(of_means * covariance, of_spreads * alike)
        # Errors of the sensor: relative, and shot noise in a mean and a standard deviation.
        noise = jnp.concatenate([seen.noise, share @ of_sd]) / spectra.pixels
        own = jnp.diag((spectra.error * centre) ** 2 + noise)
        total = (1.0 - _SHRUNK) * between + _SHRUNK * suggested + own
        total += jnp.einsum("p,psk,ptk->st", share, slopes, slopes)
        known = jnp.einsum("p,psk,pqk->sq", share, slopes, spectra.asked)
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


def _chance(spectra: _Spectra, share: Float[Array, " planting"]) -> tuple[Array, Array]:
    """Variance of means between plantings over that of pixels, and relative variance of standard
    deviations, over all wavelengths."""
    pixel = jnp.einsum("wi,pij,wj->pw", spectra.basis, spectra.second, spectra.basis)
    count = jnp.sum(share > 0)

    def between(values: Array) -> Array:
        return jnp.sum(share @ (values - share @ values) ** 2) * count / (count - 1.0)

    of_means = between(spectra.mean) / jnp.sum(share @ pixel)
    return of_means, between(jnp.sqrt(jnp.abs(pixel))) / jnp.sum(share @ pixel)


def _separated(
    spectra: _Spectra, seen: _Measured, share: Float[Array, " planting"], at: Int[Array, ""]
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
    off, both = apart(seen.species_mean[at], seen.species_covariance[at])
    along = jnp.maximum(jnp.sum(line * off, axis=1), 0.0)
    square = along**2 / jnp.maximum(jnp.einsum("cb,cbd,cd->c", line, both, line), _TINY)
    there = (spectra.species[at] > 0) & (number.sum(axis=0) > 0)
    known = there[first] & there[second]
    distance = -2.0 * jnp.expm1(-square / 8.0)
    return jnp.atleast_1d(jnp.sum(known * distance) / jnp.maximum(jnp.sum(known), 1))


class _Limits(NamedTuple):
    """Between which bands are looked for [nm]."""

    lowest: float
    highest: float
    narrowest: float
    widest: float

    def bands(self, x: Float[Array | np.ndarray, " coordinate"]) -> tuple[Array, Array]:
        """Centres and widths [nm] of bands from coordinates between 0 and 1."""
        place, size = jnp.split(jnp.asarray(x), 2)
        width = self.narrowest * (self.widest / self.narrowest) ** size
        room = self.highest - self.lowest - 2.0 * _WITHIN * width
        return self.lowest + _WITHIN * width + room * place, width


def _gaussian(spectra: _Spectra, limits: _Limits, x: Array | np.ndarray) -> _Measured:
    centre, width = limits.bands(x)
    return _measured(spectra, gaussian_weights(spectra.grid, centre, width), width)


def _value(spectra: _Spectra, seen: _Measured, among: Array) -> Float[Array, ""]:
    """Mean over the plantings `among`, and over quantities, of what bands say."""
    return among @ _scores(spectra, seen, among).mean(axis=1) / among.sum()


_seen, _seen_gaussian = eqx.filter_jit(_measured), eqx.filter_jit(_gaussian)
_scores_of = eqx.filter_jit(_scores)


@eqx.filter_jit
def _ascent(x: Array, spectra: _Spectra, limits: _Limits, among: Array) -> tuple[Array, Array]:
    """The negative of the target at bands, and its slopes."""
    return jax.value_and_grad(lambda x: -_value(spectra, _gaussian(spectra, limits, x), among))(x)


@eqx.filter_jit
def _values_of(
    spectra: _Spectra, seen: _Measured, sets: Int[Array, "set band"], among: Array
) -> Float[Array, " set"]:
    """The target of sets of bands among those that are seen."""
    return jax.lax.map(lambda at: _value(spectra, seen.chosen(at), among), sets, batch_size=64)


def best_channels(
    spectra: _Spectra, seen: _Measured, count: int, among: Float[Array, " planting"]
) -> list[int]:
    """The most informative channels of a sensor: each the best beside those before, then exchanged
    one by one until no exchange adds information."""

    def beside(rest: list[int]) -> tuple[float, list[int]]:
        sets = [[*rest, i] for i in range(len(seen.noise)) if i not in rest]
        found = np.asarray(_values_of(spectra, seen, jnp.asarray(sets), among))
        return float(found.max()), sets[int(found.argmax())]

    value, chosen = beside([])
    while len(chosen) < count:
        value, chosen = beside(chosen)
    while True:
        found = max(beside(chosen[:k] + chosen[k + 1 :]) for k in range(count))
        if found[0] <= value + 1e-9 * abs(value):
            return sorted(chosen)
        value, chosen = found


def _ascend(
    spectra: _Spectra, limits: _Limits, start: np.ndarray, among: Array
) -> tuple[float, np.ndarray]:
    """The target and the place of the best bands near a start."""
    found = minimize(
        lambda x: tuple(np.asarray(a, float) for a in _ascent(x, spectra, limits, among)),
        start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(start),
        options={"maxiter": 200},
    )  # fmt: skip
    return -float(found.fun), np.asarray(found.x)


@dataclass(frozen=True)
class BandDesign:
    """The most informative bands on a stand, beside those of other sensors."""

    bands: BandSet
    """The designed bands, by rising centre."""
    target: str
    """Words for what the bands were designed for, with its unit."""
    pixel: float
    """Edge of a pixel on the ground [m]."""
    table: "pd.DataFrame"
    """A row for each sensor, the design first: its number of `bands`, the `value` of the target,
    that in plantings left out of the design (`left_out`), and by how much the design has more of it
    there (`gain`) with its interval of 5 to 95 % (`gain_q05`, `gain_q95`)."""
    quantities: "pd.DataFrame"
    """A row for each sensor, a column for each quantity that was asked for: the share of its prior
    variance that is removed [-], mean over plantings; of another target its value."""
    starts: Float[np.ndarray, " start"]
    """The target where each ascent ended, best first."""
    wavelength: Float[np.ndarray, " wavelength"]
    """Wavelengths on which spectra are given [nm]."""
    spectrum: Float[np.ndarray, " wavelength"]
    """Mean reflectance factor of the plot [-]."""
    slopes: Float[np.ndarray, "quantity wavelength"]
    """Change of the mean spectrum that goes with a prior's standard deviation of each quantity
    [-]; no rows for another target."""
    species: Float[np.ndarray, "taxon wavelength"]
    """Mean reflectance factor of pixels that are mostly of a species; NaN where there are too few
    [-]."""
    taxa: tuple[str, ...]
    """Names of the species."""
    cameras: tuple[Sensor, ...]
    """The other sensors, with the bands that were compared."""

    @property
    def sensor(self) -> Sensor:
        """A sensor with these bands that looks straight down, without noise or blur."""
        return Sensor(
            "designed", self.bands, OrthographicCamera(self.pixel), source="fynjax design"
        )

    def __str__(self) -> str:
        """The bands, and what they gain."""
        bands = ", ".join(
            f"{c:.0f} nm ({w:.0f} nm wide)" for c, w in zip(self.bands.centre, self.bands.fwhm)
        )
        first, *others = self.table.to_dict("records")
        lines = [
            f"Bands at {bands}: {self.target} {first['value']:.3g}, of plantings left out "
            f"{first['left_out']:.3g}."
        ]
        lines += [
            f"{row['sensor']} ({row['bands']} bands): {row['left_out']:.3g}; the design has "
            f"{row['gain']:+.3g} [{row['gain_q05']:.2g}, {row['gain_q95']:.2g}]."
            for row in others
        ]
        return "\n".join(lines)

    _repr_html_ = as_html

    def to_xarray(self) -> "xr.Dataset":
        """Responses of the designed bands, and the spectra, over wavelength."""
        import xarray as xr  # late: the command line need not wait for it

        sigma = np.array(self.bands.fwhm)[:, None] / FWHM_PER_SIGMA
        off = (self.wavelength - np.array(self.bands.centre)[:, None]) / sigma
        factor = {"units": "1", "long_name": "reflectance factor"}
        return xr.Dataset(
            {
                "response": (("band", "wavelength"), np.exp(-0.5 * off**2), {"units": "1"}),
                "spectrum": ("wavelength", self.spectrum, factor),
                "species_spectrum": (("species", "wavelength"), self.species, factor),
                "slope": (("quantity", "wavelength"), self.slopes, {"units": "1"}),
            },
            {
                "wavelength": ("wavelength", self.wavelength, {"units": "nm"}),
                "band": list(self.bands.names),
                "species": list(self.taxa),
                "quantity": list(self.quantities.columns)[: len(self.slopes)],
            },
            {"title": "bands of a designed sensor", "target": self.target},
        )

    def plot(self, **options: Any) -> Any:
        """Draw the responses of the bands over wavelength, by xarray; `options` of its lines."""
        return self.to_xarray()["response"].plot.line(x="wavelength", **options)


@double_precision
def design(
    scenes: Scene | Sequence[Scene],
    bands: int = 4,
    target: str | Sequence[str] = DESIGN_TARGET,
    *,
    free: ParameterSpace | None = None,
    pixel: float = 0.1,
    spectrum: tuple[float, float] = _RANGE,
    widths: tuple[float, float] = (10.0, 100.0),
    snr: float = 100.0,
    error: float = 0.01,
    plantings: int = 6,
    compare: Sequence[str | Sensor] = CAMERAS,
    starts: int = 8,
    seed: int = 0,
    checked: Callable[[], None] = lambda: None,
) -> BandDesign:
    """The most informative bands of a camera on a stand, by gradient through the renderer.

    A camera measures mean and standard deviation of each band over the pixels. A quantity with
    slopes g by whitened parameters u, of which the statistics have the slopes J, is estimated from
    them as a'y with a = (C + mean J J')^-1 mean J g, the best linear estimate: C is the covariance
    of the statistics (where plants stand, an independent relative error of each, shot noise), and
    means are over plantings. In a planting that had no share in them the variance |g - J'a|^2 +
    (a'y)^2 + noise is left of |g|^2, with y less its mean over the others: every planting is judged
    by estimates that others made, so that slopes that are only where plants stand are no knowledge,
    however many bands there are. The target is the mean over plantings and quantities.

    Centres and widths climb (L-BFGS) from the best of a raster and of random places. For each
    planting the design is made anew without it, and so is the choice of channels of AVIRIS-NG, and
    judged in it. As these designs share plantings, the interval of the gain is Student's with the
    variance of Nadeau and Bengio, 1 / P + 1 / (P - 1) of that of P plantings.

    **Arguments:**

    - `scenes`: one, of which other plantings are made; or several plantings of the same species,
      with the parameters of the first.
    - `bands`: their number.
    - `target`: names or patterns of numbers of the stand (`stand_functionals`, "shannon" of the
      covers) and of free parameters, of which the mean share of the variance removed counts;
      patterns leave out those that no free parameter changes.
      Or "information", the sum over all free parameters of -log2(share left) / 2 [bit], at most
      what bands say of them together; or "separability", the mean Jeffries-Matusita distance of two
      species' pixels along the line that parts them best in other plantings.
    - `free`: the unknown parameters with their priors; `DESIGN_FREE` with the usual priors if left
      out.
    - `pixel`: edge of a pixel on the ground [m].
    - `spectrum`: range of the detector [nm]; bands of other sensors beyond it are left out.
    - `widths`: least and greatest full width at half maximum [nm].
    - `snr`: signal over shot noise of one pixel in a band 10 nm wide at 550 nm over a reflectance
      of 0.1, under the plot's own sun and a clear sky; in other bands by the photons they collect,
      the detector alike at all wavelengths. Other sensors count with the same optics.
    - `error`: independent error of every statistic, relative [-].
    - `plantings`: how many are made of one scene, at least 4.
    - `compare`: other sensors, shipped names or objects.
    - `starts`: ascents, the first from a raster of bands.
    - `seed`: of the starts.
    - `checked`: called when all settings are checked, before anything is rendered.

    **Returns:** `BandDesign`. Not differentiable; what it climbs is, in centres and widths.

    **Raises:** `InputError` for settings that do not fit each other, a target that is unknown or
    that no free parameter changes, and species that lead in too few pixels to separate.

    Source: Chaloner and Verdinelli (1995), Statistical Science 10, 273; Nadeau and Bengio (2003),
    Machine Learning 52, 239.
    """
    stands = [scenes] if isinstance(scenes, Scene) else list(scenes)
    limits, grid = _check(stands, bands, pixel, spectrum, widths, snr, error, plantings, starts)
    scene = stands[0]
    space = free
    if space is None:
        space = free_space(scene, scene.parameters, DESIGN_FREE, lambda name: None)
    cameras = [_within(one, grid) for one in compare]
    channels = _within(_CHANNELS, grid)
    if bands > len(channels.bands):
        raise InputError(
            f"expected at most {len(channels.bands)} `bands`, as {_CHANNELS} has, but got {bands}"
        )
    if not np.asarray(scene.planting.place).any():
        raise InputError(
            "expected a plot whose plants are drawn, of which there are several plantings, but its "
            "plants are known and stand where they do: leave the crown map out"
        )
    if len(stands) == 1:
        stands = [scene, *(stand_realisation(scene, i) for i in range(1, plantings))]
    kind = target if isinstance(target, str) and target in _OTHER_TARGETS else "quantities"
    named = {} if kind in _OTHER_TARGETS else _asked(stands, space, target)
    if kind == "quantities" and not named:
        raise InputError("what is asked for does not depend on any of the free parameters")
    checked()
    every_one = np.eye(len(space.names))[: None if kind == "information" else 0]
    asked = np.stack([*named.values()] if named else [every_one] * len(stands), axis=bool(named))
    spectra = _render(stands, space, asked, grid, pixel, snr, error, kind)
    if kind == "separability" and (np.asarray(spectra.species > 0).sum(axis=1) < 2).any():
        raise InputError(
            f"expected two species that lead in {_FEWEST} pixels of {pixel:g} m or more in every "
            "planting: take smaller pixels"
        )
    every = jnp.ones(len(stands))
    ends = _search(spectra, limits, bands, starts, seed, every)
    best = ends[0][1]
    centre, width = (np.asarray(a) for a in limits.bands(best))
    order = np.argsort(centre)
    names = tuple(f"b{i + 1}" for i in range(bands))
    designed = BandSet(names, tuple(centre[order]), tuple(width[order]))
    # Each sensor with every planting, and with the one that its bands were chosen without.
    fine = _bands_of(spectra, channels.bands)
    seen = [_bands_of(spectra, one) for one in (designed, *(camera.bands for camera in cameras))]

    def few(among: Array) -> _Measured:
        return fine.chosen(jnp.asarray(best_channels(spectra, fine, bands, among)))

    rows = [_scores_of(spectra, one, every).mean(axis=0) for one in (*seen, few(every))]
    left = []
    for out in track(range(len(stands)), "Leave out each planting"):
        among = every.at[out].set(0.0)
        again = _seen_gaussian(
            spectra, limits, _search(spectra, limits, bands, starts, seed, among)[0][1]
        )
        those = again, *seen[1:], few(among)
        left.append([float(_scores_of(spectra, one, among)[out].mean()) for one in those])
    chosen = channels.select(best_channels(spectra, fine, bands, every))
    chosen = dataclasses.replace(chosen, name=f"best {bands} of {_CHANNELS}")
    return _record(
        spectra, designed, tuple(named), pixel, np.array(rows), np.array(left),
        np.array([value for value, _ in ends]), scene.taxa, (*cameras, chosen),
    )  # fmt: skip


def _check(
    stands: Sequence[Scene], bands: int, pixel: float, spectrum: tuple[float, float],
    widths: tuple[float, float], snr: float, error: float, plantings: int, starts: int,
) -> tuple[_Limits, Float[np.ndarray, " wavelength"]]:  # fmt: skip
    """Limits of the bands, and the grid of wavelengths."""
    number = plantings if len(stands) == 1 else len(stands)
    if not all(isinstance(one, Scene) for one in stands) or number < 4:
        raise InputError(f"expected a scene and 4 `plantings` or more, or as many scenes: {number}")
    if len({one.taxa for one in stands}) > 1:
        raise InputError("expected scenes of the same species, in the same order")
    for name, pair, least, most in (
        ("spectrum", spectrum, *_RANGE), ("widths", widths, _STEP, np.inf)
    ):  # fmt: skip
        if len(pair) != 2 or not least <= pair[0] <= pair[1] <= most:
            raise InputError(
                f"expected `{name}` as two numbers in order, of {least:g} to {most:g} nm, but got "
                f"{listed(f'{one:g}' for one in pair)}"
            )
    grid = np.arange(spectrum[0] + _STEP / 2.0, spectrum[1] - _STEP / 2.0 + 1e-6, _STEP)
    within = f"{spectrum[0]:g} to {spectrum[1]:g} nm"
    if len(grid) < 2 or 2.0 * _WITHIN * widths[1] > grid[-1] - grid[0]:
        raise InputError(f"a band {widths[1]:g} nm wide does not fit into {within}")
    if not 1 <= bands <= len(grid):
        raise InputError(
            f"expected 1 to {len(grid)} `bands`, the wavelengths from {within}, but got {bands}"
        )
    for name, one in {"pixel": pixel, "snr": snr, "error": error, "starts": starts}.items():
        if not 0.0 < one < np.inf:
            raise InputError(f"`{name}` must be a positive number, but is {one:g}")
    try:
        spectral_mask(grid, _RANGE)
    except InputError as error:
        raise InputError(
            f"no light comes through the air from {within}: take a `spectrum` beyond the water "
            "windows"
        ) from error
    return _Limits(float(grid[0]), float(grid[-1]), *map(float, widths)), grid


def _within(sensor: str | Sensor, grid: Float[np.ndarray, " wavelength"]) -> Sensor:
    """A sensor with the bands that lie within a grid of wavelengths."""
    found = shipped_sensor(sensor) if isinstance(sensor, str) else sensor
    if not isinstance(found, Sensor):
        raise InputError(f"expected imaging sensors in `compare`, but got {found!r:.60}")
    places = found.bands.covered(grid)
    if not places:
        raise InputError(f"{found.name!r} has no band from {grid[0]:g} to {grid[-1]:g} nm")
    return found.select(places)


def _asked(
    stands: Sequence[Scene], space: ParameterSpace, target: str | Sequence[str]
) -> dict[str, Float[np.ndarray, "planting free"]]:
    """Slopes by the whitened coordinates of each quantity whose name is asked for."""
    scene, none = stands[0], jnp.zeros(len(space.names))
    functionals = stand_functionals(scene) | {"shannon": _SHANNON}
    names = [*functionals, *space.names]
    wanted = [target] if isinstance(target, str) else list(target)
    for pattern in wanted:
        if not any(fnmatchcase(name, pattern) for name in names):
            known = (*_OTHER_TARGETS, *functionals)
            raise InputError(
                f"expected a target among {', '.join(known)} or names of free parameters, but got "
                f"{pattern!r}.{did_you_mean(pattern, [*known, *space.names])}"
            )
    values = tuple(one.value for one in functionals.values())
    found = np.stack(
        [
            np.concatenate(
                [
                    functional_slopes(stand, scene.parameters, space, none, values)[1],
                    jax.jacfwd(space.physical)(none),
                ]
            )
            for stand in stands
        ],
        axis=1,
    )
    changed = {
        name: slopes
        for name, slopes in zip(names, found, strict=True)
        if np.abs(slopes).max(axis=1).min() > 0.0
    }
    fixed = [name for name in wanted if name in names and name not in changed]
    if fixed and tuple(wanted) != DESIGN_TARGET:
        raise InputError(
            f"no free parameter changes {listed(fixed)} in every planting: free one that does, or "
            "leave it out of the `target`"
        )
    return {
        name: slopes
        for name, slopes in changed.items()
        if any(fnmatchcase(name, one) for one in wanted)
    }


def _render(
    stands: Sequence[Scene],
    space: ParameterSpace,
    asked: Float[np.ndarray, "planting quantity free"],
    grid: Float[np.ndarray, " wavelength"],
    pixel: float,
    snr: float,
    error: float,
    target: str,
) -> _Spectra:
    """The images of all plantings with their slopes, in light of the accuracy `COARSE`."""
    scene, parameters = stands[0], stands[0].parameters
    names = tuple(f"{one:g}" for one in grid)
    bands = BandSet(names, tuple(grid), (_STEP,) * len(grid), response="box")
    sensor = Sensor("grid", bands, OrthographicCamera(pixel))
    aimed = aim(
        coarser(scene, parameters), parameters, sensor, Placement(pixel=pixel),
        accuracy=COARSE, point_spread=False,
    ).sampled(1)  # fmt: skip
    none = jnp.zeros(len(space.names))
    whiten = np.asarray(jax.jacfwd(space.physical)(none), np.float32)
    at = space.physical(none)
    kept: list[tuple[np.ndarray, ...]] = []
    scale = into = np.ones(0)
    for stand in track(stands, "Render the plantings"):
        quick = coarser(stand, parameters)
        image, slopes = map(np.asarray, image_and_slopes(aimed, quick, parameters, space.names, at))
        off = image.reshape(len(grid), -1).astype(float)
        off_slope = slopes.reshape(*off.shape, -1) @ whiten
        mean, mean_slope = off.mean(axis=1), off_slope.mean(axis=1, dtype=float)
        off -= mean[:, None]
        off_slope -= mean_slope[:, None].astype(np.float32)
        if not kept:
            scale = mean[:, None]
            every = (off, *(one.astype(float) for one in np.moveaxis(off_slope, 2, 0)))
            square = sum(one @ one.T for one in every) / (scale * scale.T)
            values, vectors = np.linalg.eigh(square)
            into = vectors[:, np.cumsum(values) > _KEPT * values.sum()].T / scale.T
        weight = into @ off
        change = np.tensordot(into.astype(np.float32), off_slope, 1)
        half = np.einsum("ixk,jx->ijk", change, weight) / off.shape[1]
        share = np.asarray(truth_of_pixels(aimed, quick, parameters).species)
        of_species = (_of_species(weight[:, one.ravel() > _LEADING]) for one in share)
        kept.append((
            mean, mean_slope, weight @ weight.T / off.shape[1], half + half.swapaxes(0, 1),
            *map(np.stack, zip(*of_species, strict=True)),
        ))  # fmt: skip
    means, mean_slopes, second, second_slopes, number, centre, spread = map(np.stack, zip(*kept))
    basis = (into * (scale * scale).T).T
    arrays: dict[str, Any] = {
        "grid": grid, "mean": means, "mean_slope": mean_slopes, "basis": basis, "second": second,
        "second_slope": second_slopes, "photons": _photons(parameters, bands, snr), "asked": asked,
        "species": number, "species_mean": means[:, None] + centre @ basis.T,
        "species_second": spread,
    }  # fmt: skip
    arrays = {name: jnp.asarray(array) for name, array in arrays.items()}
    return _Spectra(**arrays, pixels=off.shape[1], error=error, target=target)


def _photons(
    parameters: PlotParameters, bands: BandSet, snr: float
) -> Float[np.ndarray, " wavelength"]:
    """Photons that a pixel collects per nm from a white ground, in each box of the grid; next to
    none in the water windows, where air is opaque."""
    air = PlotAir().atmosphere(parameters.light, SPACE)
    grid = np.array(air.wavelength)
    light = np.asarray(air.upward_transmittance * (air.direct + air.diffuse)) * grid
    nm, width, reflectance = _REFERENCE
    per = snr**2 / (float(np.interp(nm, grid, light)) * width * reflectance)
    clear = spectral_mask(np.array(bands.centre), _RANGE)
    return per * np.where(clear, bands.weights(grid) @ light, _OPAQUE * light.max())


def _of_species(weight: Float[np.ndarray, "component pixel"]) -> tuple[np.ndarray, ...]:
    """Number, mean and covariance of pixels; zero where they are too few."""
    enough = weight.shape[1] >= _FEWEST
    size = len(weight)
    if not enough:
        return np.zeros(()), np.zeros(size), np.zeros((size, size))
    return np.asarray(weight.shape[1]), weight.mean(axis=1), np.cov(weight)


def _bands_of(spectra: _Spectra, bands: BandSet) -> _Measured:
    weights = bands.weights(np.asarray(spectra.grid), max_loss=1e-2)
    return _seen(spectra, jnp.asarray(weights), jnp.asarray(bands.fwhm))


def _search(
    spectra: _Spectra, limits: _Limits, bands: int, starts: int, seed: int, among: Array
) -> list[tuple[float, np.ndarray]]:
    """Ends of ascents, best first: the first from the best bands of a raster of centres and widths
    (`best_channels`), the others from the best of random places."""
    raster = np.stack(np.meshgrid(np.linspace(0.0, 1.0, _RASTER), (0.0, 0.5, 1.0)), -1)
    raster = raster.reshape(-1, 2)
    seen = _seen_gaussian(spectra, limits, raster.T.ravel())
    begin = [raster[best_channels(spectra, seen, bands, among)].T.ravel()]
    random = np.random.default_rng([seed, 89])
    for sets in random.integers(len(raster), size=(starts - 1, _DRAWS, bands)):
        values = np.asarray(_values_of(spectra, seen, jnp.asarray(sets), among))
        begin.append(raster[sets[int(values.argmax())]].T.ravel())
    ends = [_ascend(spectra, limits, start, among) for start in track(begin, "Ascend")]
    return sorted(ends, key=lambda end: -end[0])


def half_interval(gain: Float[np.ndarray, "planting sensor"]) -> Float[np.ndarray, " sensor"]:
    """Half of the interval of 90 % of a mean gain over plantings, each judged by the others:
    Student's, with the variance of Nadeau and Bengio."""
    count = len(gain)
    wider = np.sqrt(1.0 / count + 1.0 / (count - 1.0))
    return np.asarray(stdtrit(count - 1, 0.95) * wider * gain.std(axis=0, ddof=1))


def _record(
    spectra: _Spectra,
    designed: BandSet,
    asked: Sequence[str],
    pixel: float,
    rows: Float[np.ndarray, "sensor quantity"],
    left: Float[np.ndarray, "planting sensor"],
    starts: Float[np.ndarray, " start"],
    taxa: tuple[str, ...],
    cameras: tuple[Sensor, ...],
) -> BandDesign:
    import pandas as pd  # late: the command line need not wait for it

    gain = left[:, :1] - left
    half = half_interval(gain)
    labels = ["designed", *(one.name for one in cameras)]
    table = pd.DataFrame(
        {
            "sensor": labels,
            "bands": [len(designed), *(len(one.bands) for one in cameras)],
            "value": rows.mean(axis=1),
            "left_out": left.mean(axis=0),
            "gain": gain.mean(axis=0),
            "gain_q05": gain.mean(axis=0) - half,
            "gain_q95": gain.mean(axis=0) + half,
        }
    )
    words = _OTHER_TARGETS.get(spectra.target, "share of the variance removed")
    of_named = np.asarray(spectra.asked)[:, : len(asked)]
    sd = np.sqrt(np.sum(of_named**2, axis=2, keepdims=True))
    slopes = np.einsum("pwk,pqk->pqw", spectra.mean_slope, of_named / sd)
    number = np.asarray(spectra.species)[..., None]
    with np.errstate(invalid="ignore"):
        species = (number * np.asarray(spectra.species_mean)).sum(axis=0) / number.sum(axis=0)
    return BandDesign(
        bands=designed,
        target=words,
        pixel=pixel,
        table=table,
        quantities=pd.DataFrame(rows, labels, list(asked) or [spectra.target]),
        starts=starts,
        wavelength=np.asarray(spectra.grid),
        spectrum=np.asarray(spectra.mean).mean(axis=0),
        slopes=slopes.mean(axis=0),
        species=species,
        taxa=taxa,
        cameras=cameras,
    )
