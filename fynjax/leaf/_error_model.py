"""Covariance of the errors of PROSPECT along the wavelength.

A leaf's reflectance and transmittance differ from PROSPECT at its measured chemistry by up to some
hundredths, and the differences at neighbouring bands are nearly the same. Treated as independent
noise, a thousand bands would give intervals that are far too narrow. Here the discrepancy of R and
T together is Gaussian with the covariance F^T F + diag(noise^2): a few smooth factors F shared by R
and T, and a small rest. It is kept on bins of 5 nm (pigments) and 10 nm, wide
enough to average the instrument's noise and narrow enough for PROSPECT's bands.
"""

from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Literal

import equinox as eqx
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from fynjax._core.errors import InputError


def bin_centres() -> np.ndarray:
    """Centres of the bins on which spectra are fitted [nm]: every 5 to 780, every 10 to 2500.

    Absorption is averaged over a bin before, not after, it acts. With bins of 10 nm that lowers
    fitted chlorophyll by 2.6 % and carotenoids by 5 %, with 5 nm by 0.5 % and 1 %; water and dry
    matter, whose bands are wider, change by 0.4 % with 10 nm.
    """
    return np.concatenate([np.arange(400.0, 781.0, 5.0), np.arange(790.0, 2501.0, 10.0)])


ErrorName = Literal["exact", "laboratory", "field"]
"""What a fit takes spectra to depart from PROSPECT by, see `fit_leaf`."""
OFFSETS: dict[ErrorName, float] = {"laboratory": 0.02, "field": 0.04}
"""Prior standard deviation of an offset of R, the same at all bands, that a kind of instrument
adds: of a sphere's calibration, of the shine under a leaf clip or contact probe [-]."""
EXACT_NOISE = 1e-6
"""Least standard deviation of R and T of a fit without an error of the model, that of computed
spectra; a larger one is found from what the fit leaves [-]."""

POPULATION_TRAITS = ("structure", "chlorophyll", "carotenoids", "water", "dry_matter")
"""Traits whose correlation and discrepancy an error model holds."""


class ErrorModel(eqx.Module):
    """Covariance of what PROSPECT leaves unexplained in R and T, on `bin_centres()`, and what the
    same leaves say of traits."""

    reflectance_factors: Float[np.ndarray, "factor bin"]
    """Change of R by one standard deviation of each factor [-]."""
    transmittance_factors: Float[np.ndarray, "factor bin"]
    """Change of T by one standard deviation of the same factor [-]."""
    reflectance_noise: Float[np.ndarray, " bin"]
    """Standard deviation of the independent rest of R [-]."""
    transmittance_noise: Float[np.ndarray, " bin"]
    """Standard deviation of the independent rest of T [-]."""
    distrust: Float[np.ndarray, " bin"]
    """Further independent standard deviation of R and T while parameters are sought, because the
    covariance was learned on other leaves and instruments; no part of the band of T [-]."""
    trait_correlation: Float[np.ndarray, "trait trait"]
    """Correlation of the logarithms of `POPULATION_TRAITS` among leaves: that of the prior."""
    trait_discrepancy: Float[np.ndarray, "trait 2"]
    """Standard deviation between the trait measured in a laboratory and the trait that explains the
    spectrum, besides the errors of the spectrum: specific absorption that varies between species,
    and laboratory errors. In the logit coordinate, where it is nearly the relative standard
    deviation, for a leaf of inflation 1. The first column is its logarithm at a dry matter of 0.008
    g cm-2, the second the change of that with the logarithm of dry matter [-]."""
    species_share: Float[np.ndarray, " trait"]
    """Share of a trait's error, as variance, that leaves of one species have in common; NaN where
    it is unknown [-]."""
    reflectance_share: float
    """Weight of the fit to R alone in dry matter where T was measured as well, 0 to 1: light that T
    misses counts as absorbed, by dry matter most of all [-]."""


# Sub-domains that estimate N, Car, Chl, and EWT with LMA best in several campaigns: Féret et al.
# 2019 (RSE 231, 110959), Spafford et al. 2021 (RSE 252, 112176).
PUBLISHED_DOMAINS = ((520.0, 560.0), (700.0, 720.0), (1120.0, 1140.0), (1700.0, 2400.0))
_DISTRUST = 0.03
# Widest gap between bands that is filled [nm].
_WIDEST = 25.0


def inside(
    centres: Float[np.ndarray, " bin"], windows: Sequence[tuple[float, float]]
) -> Bool[np.ndarray, " bin"]:
    """Which bins lie in one of the windows [nm], ends included."""
    return np.any([(centres >= low) & (centres <= high) for low, high in windows], axis=0)


def distrust() -> Float[np.ndarray, " bin"]:
    """Nothing in the published sub-domains, the size of the model's own error elsewhere.

    A covariance of 40 factors from a few hundred leaves promises contrasts between bands that
    leaves of another campaign do not have. This term lowers the errors of every trait on every
    data set that was not used to estimate the covariance; from 0.02 to 0.04 they hardly change.
    """
    centres = bin_centres()
    return np.where(inside(centres, PUBLISHED_DOMAINS), 0.0, _DISTRUST)


@cache
def default_error_model() -> ErrorModel:
    """The error model of the package, from ANGERS, LOPEX and NASA FFT (see `data/README.md`)."""
    with resources.as_file(resources.files("fynjax.leaf") / "data") as folder:
        table = pd.read_csv(folder / "error_model.csv.gz")
        traits = pd.read_csv(folder / "trait_model.csv", index_col="trait")
    if not np.array_equal(table["wavelength_nm"], bin_centres()):
        raise InputError("the error model's table does not stand on the fit's bins")
    names = [c for c in table.columns if c.startswith("r_factor")]
    r = table[names].to_numpy(float).T
    t = table[[n.replace("r_", "t_", 1) for n in names]].to_numpy(float).T
    noise = [table[key].to_numpy(float) for key in ("r_noise", "t_noise")]
    traits = traits.loc[list(POPULATION_TRAITS)]
    correlation = traits[list(POPULATION_TRAITS)].to_numpy(float)
    discrepancy = traits[["log_discrepancy", "dry_matter_slope"]].to_numpy(float)
    share = traits["species_share"].to_numpy(float)
    alone = float(traits["reflectance_share"]["dry_matter"])
    return ErrorModel(
        r, t, noise[0], noise[1], distrust(), correlation, discrepancy, share, alone
    )  # fmt: skip


def to_nanometres(
    wavelength: Float[np.ndarray, " band"], spectra: Float[np.ndarray, "*leaf band"]
) -> tuple[Float[np.ndarray, " nm"], Float[np.ndarray, "*leaf nm"]]:
    """Spectra in steps of 1 nm, by straight lines between bands no more than 25 nm apart.

    The mean of these in a bin is twice as near to that of a whole spectrum as the mean of bands 5
    nm apart is, and nearer whatever their distance.

    **Arguments:** `wavelength` [band], ascending [nm], `spectra` [..., band], NaN where missing.

    **Returns:** 350 to 2500 nm, and the spectra there, NaN where nothing was measured. NumPy; not
    differentiable.
    """
    fine = np.arange(350.0, 2501.0)
    rows = np.asarray(spectra, float).reshape(-1, np.size(wavelength))
    result = np.full((len(rows), fine.size), np.nan)
    for row, into in zip(rows, result):
        have = np.isfinite(row)
        if have.sum() < 2:
            continue
        at = wavelength[have]
        right = np.clip(np.searchsorted(at, fine), 1, at.size - 1)
        below, above = fine - at[right - 1], at[right] - fine
        near = (below + above <= _WIDEST) | (np.minimum(abs(below), abs(above)) <= 0.5)
        into[near] = np.interp(fine[near], at, row[have], left=np.nan, right=np.nan)
    return fine, result.reshape(*np.shape(spectra)[:-1], fine.size)


def to_bins(wavelength: np.ndarray, spectra: np.ndarray) -> np.ndarray:
    """Mean of the finite bands in each bin; bins without a band are filled over gaps to 25 nm.

    **Arguments:** `wavelength` [band], ascending [nm], `spectra` [..., band], NaN where missing.

    **Returns:** [..., bin] on `bin_centres()`, NaN where nothing was measured.
    """
    centres = bin_centres()
    spectra = np.asarray(spectra, float)
    lead = spectra.reshape(-1, spectra.shape[-1])
    between = (centres[1:] + centres[:-1]) / 2
    edges = np.concatenate([[centres[0] - 2.5], between, [centres[-1] + 5.0]])
    place = np.digitize(wavelength, edges) - 1
    inside = np.flatnonzero((place >= 0) & (place < centres.size))
    finite = np.isfinite(lead)

    def per_bin(values: np.ndarray) -> np.ndarray:
        # Not a matrix product: threaded BLAS spends ten times the CPU time on these shapes.
        bins, first = np.unique(place[inside], return_index=True)
        total = np.zeros((len(values), centres.size))
        if inside.size:
            total[:, bins] = np.add.reduceat(values[:, inside], first, axis=1)
        return total

    count = per_bin(finite.astype(float))
    total = per_bin(np.where(finite, lead, 0.0))
    shift = per_bin(finite * wavelength)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, where = total / count, shift / count
    out = mean
    # Spectra of one instrument miss the same bands, and are brought onto the centres at once.
    patterns, member = np.unique(np.nan_to_num(where), axis=0, return_inverse=True)
    for number in range(len(patterns)):
        rows = np.flatnonzero(member == number)
        have = np.flatnonzero(patterns[number] > 0)
        if have.size == 0:
            continue
        # Re-centre coarse bands: the mean belongs to the mean wavelength of its bands.
        at = patterns[number, have]
        right = np.clip(np.searchsorted(at, centres), 1, max(have.size - 1, 1))
        left = right - 1
        right = np.minimum(right, have.size - 1)
        step = np.where(right > left, at[right] - at[left], 1.0)
        share = (centres - at[left]) / step
        between = (centres >= at[0]) & (centres <= at[-1])
        close = between & ((at[right] - at[left] <= _WIDEST) | (patterns[number] > 0))
        values = mean[np.ix_(rows, have)]
        filled = values[:, left] + share * (values[:, right] - values[:, left])
        out[rows] = np.where(close, filled, out[rows])
    return out.reshape(*spectra.shape[:-1], centres.size)
