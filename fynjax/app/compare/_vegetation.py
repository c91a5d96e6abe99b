"""Whether an image or a spectrum is one that shrubland can have, before anything is fitted."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.special import fdtrc, ndtri

from fynjax._core.errors import InputError
from fynjax.sensors import ASSUMED, BandSet, Gains

PLOTS = 26.0
"""Plots that the shipped spectra count as: 21 of fynbos, and a tile of dry shrubland as five."""
DIRECTIONS = 8
"""Principal components of the bands that are judged apart from the others."""
UNLIKE = 0.003
"""Chance below which an image counts as none of shrubland."""


@dataclass(frozen=True)
class VegetationCheck:
    """How far the bands of an image are from those of measured shrubland."""

    probability: float
    """Chance that an image of shrubland lies as far from the measured ones as this one [-]."""
    distance: float
    """Mahalanobis distance of the logarithms of the bands, squared [-]."""
    pairs: pd.DataFrame
    """A row for each pair of bands: `numerator`, `denominator`, their `ratio`, the 95 % interval of
    shrubland as this sensor would measure it (`low`, `high`), and by how many standard deviations
    the logarithm of the ratio is off (`deviations`); the farthest first."""
    left_out: tuple[str, ...]
    """Bands outside the shipped spectra, or without a positive value, which are not judged."""

    @property
    def unlike(self) -> bool:
        """Whether the image is so far from measured shrubland that its calibration is in doubt."""
        return bool(self.probability < UNLIKE)

    def __str__(self) -> str:
        if not self.unlike:
            return (
                "The bands are such as shrubland has: of images of measured plots "
                f"{100 * self.probability:.0f} % lie as far from their mean, or farther."
            )
        chance = f"{self.probability:.1g}" if self.probability > 1e-6 else "less than 1e-6"
        words = f"These bands are not such as shrubland has (chance {chance})"
        for row in self.pairs.head(1).itertuples():
            words += (
                f": {row.numerator} / {row.denominator} is {row.ratio:.2g}; measured plots have "
                f"{row.low:.2g} to {row.high:.2g}. Is the calibration of these bands right, or "
                "most of the ground bare or burnt?"
            )
        return words


def check_shrubland(
    reflectance: Mapping[str, float] | ArrayLike, bands: BandSet, *, gains: Gains = ASSUMED
) -> VegetationCheck:
    """Compare the mean of an image, or a spectrum, with measured shrubland.

    The logarithms of the bands are compared with their mean and covariance over AVIRIS-NG spectra
    of fynbos plots and an EMIT tile of dry shrubland (`fynjax/app/compare/data/README.md`),
    averaged over the sensor's bands; errors of its calibration are added. The chance follows from
    an F distribution, since the covariance is an estimate of few plots; of more than eight bands
    the leading principal components are judged apart, and the lesser of both chances counts twice.

    **Arguments:**

    - `reflectance`: of each band [-], positive, in the order of `bands`; or by the bands' names, of
      any of them.
    - `bands`: of the sensor. Those outside 420 to 2430 nm, or in water bands, are not judged.
    - `gains`: what the calibration of the bands may be off by.

    **Returns:** a `VegetationCheck`, which prints as a sentence.

    **Raises:** `InputError` where the values do not fit the bands, and where fewer than two bands
    can be judged. Not differentiable: NumPy.

    >>> import fynjax as fx
    >>> bands = fx.sensor("mavic_3m").bands
    >>> fx.compare.check_shrubland([0.05, 0.045, 0.15, 0.22], bands).unlike
    False
    >>> print(fx.compare.check_shrubland([0.05, 0.045, 0.08, 0.22], bands))
    These bands are not such as shrubland has (chance less than 1e-6): red_edge / nir is 0.36; ...
    """
    if isinstance(reflectance, Mapping):
        unknown = [name for name in reflectance if name not in bands.names]
        if unknown:
            raise InputError(f"expected bands of {bands.names}, but got {unknown[0]!r}")
        given = np.array([float(reflectance.get(name, np.nan)) for name in bands.names])
    else:
        given = np.asarray(reflectance, dtype=float)
    if given.shape != (len(bands),):
        raise InputError(
            f"expected one reflectance for each of {len(bands)} bands, but got values of shape "
            f"{given.shape}"
        )
    wavelength, mean, factors, rest = _spectra()
    covered = set(bands.covered(wavelength, max_loss=0.02))
    judged = [i for i in sorted(covered) if np.isfinite(given[i]) and given[i] > 0.0]
    if len(judged) < 2:
        raise InputError(
            "expected two bands at least with a positive value within 420 to 2430 nm, but got "
            f"{len(judged)} of {bands.names}"
        )
    weights = bands.select(judged).weights(wavelength, max_loss=0.02)
    # The logarithm of a band is linear in those of the spectrum, nearly: slopes at the mean.
    expected = weights @ np.exp(mean)
    slopes = weights * np.exp(mean) / expected[:, None]
    loadings = slopes @ factors.T
    covariance = loadings @ loadings.T + (slopes * rest**2) @ slopes.T
    covariance += gains.covariance(len(bands))[np.ix_(judged, judged)]
    values = given[judged]
    off = np.log(values / expected)
    variance, directions = np.linalg.eigh(covariance)
    parts = (directions.T @ off)[::-1] ** 2 / variance[::-1]
    # Where there are many bands, what few directions say is not to drown among the others.
    few, rest_of_bands = parts[:DIRECTIONS], parts[DIRECTIONS:]
    tests = [few, rest_of_bands] if rest_of_bands.size else [few]
    # Of a new draw, where mean and covariance are estimates.
    chances = [fdtrc(t.size, PLOTS - 1, t.mean() / (1.0 + 1.0 / PLOTS)) for t in tests]
    chance = float(min(1.0, len(tests) * min(chances)))
    names = [bands.names[i] for i in judged]
    left = tuple(name for i, name in enumerate(bands.names) if i not in judged)
    pairs = _pairs(names, values, np.log(expected), covariance)
    return VegetationCheck(chance, float(parts.sum()), pairs, left)


def _pairs(
    names: list[str],
    values: Float[np.ndarray, " band"],
    mean: Float[np.ndarray, " band"],
    covariance: Float[np.ndarray, "band band"],
) -> pd.DataFrame:
    """Ratios of two bands beside those of shrubland, the farthest first."""
    first, second = np.triu_indices(len(names), 1)
    variance = np.diag(covariance)
    centre = mean[first] - mean[second]
    sd = np.sqrt(variance[first] + variance[second] - 2.0 * covariance[first, second])
    ratio, wide = values[first] / values[second], ndtri(0.975) * sd
    table = {
        "numerator": np.array(names)[first],
        "denominator": np.array(names)[second],
        "ratio": ratio,
        "low": np.exp(centre - wide),
        "high": np.exp(centre + wide),
        "deviations": (np.log(ratio) - centre) / sd,
    }
    return pd.DataFrame(table).sort_values("deviations", key=np.abs, ascending=False)


@cache
def _spectra() -> tuple[
    Float[np.ndarray, " wavelength"],
    Float[np.ndarray, " wavelength"],
    Float[np.ndarray, "factor wavelength"],
    Float[np.ndarray, " wavelength"],
]:
    """Wavelengths [nm]; of the logarithm of reflectance the mean, the factors of its covariance and
    the standard deviation that these leave."""
    path = files("fynjax.app.compare") / "data" / "vegetation_spectra.csv"
    with path.open() as file:
        table = pd.read_csv(file)
    factors = table.filter(like="factor_").to_numpy().T
    columns = ("wavelength_nm", "mean_log")
    wavelength, mean = (table[name].to_numpy(dtype=float) for name in columns)
    return wavelength, mean, factors, table["rest_sd"].to_numpy()
