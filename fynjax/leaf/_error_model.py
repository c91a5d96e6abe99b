"""How wrong PROSPECT is, and how its errors hang together along the wavelength.

A leaf's reflectance and transmittance differ from PROSPECT at its measured chemistry by up to some
hundredths, and the difference at one band says nearly all about the next. Taken as independent
noise, a thousand bands then promise a thousandfold certainty that is not there. Here the
discrepancy of R and T together is Gaussian with the covariance F^T F + diag(noise^2): a few smooth
factors F shared by R and T, and a small rest. It is kept on bins of 10 nm, wide enough to average
the instrument's noise and narrow enough for PROSPECT's bands.
"""

from functools import cache
from importlib import resources

import equinox as eqx
import numpy as np
import pandas as pd
from jaxtyping import Float

BIN_WIDTH = 10.0


def bin_centres() -> np.ndarray:
    """Centres of the bins on which spectra are fitted [nm]: 400, 410, ... 2500."""
    return np.arange(400.0, 2500.0 + BIN_WIDTH / 2, BIN_WIDTH)


class ErrorModel(eqx.Module):
    """Covariance of what PROSPECT leaves unexplained in R and T, on `bin_centres()`."""

    reflectance_factors: Float[np.ndarray, "factor bin"]
    """Change of R by one standard deviation of each factor [-]."""
    transmittance_factors: Float[np.ndarray, "factor bin"]
    """Change of T by one standard deviation of the same factor [-]."""
    reflectance_noise: Float[np.ndarray, " bin"]
    """Standard deviation of the independent rest of R [-]."""
    transmittance_noise: Float[np.ndarray, " bin"]
    """Standard deviation of the independent rest of T [-]."""


def estimate_error_model(
    residuals: Float[np.ndarray, "leaf 2 bin"],
    weights: Float[np.ndarray, " leaf"],
    factors: int,
    noise_floor: float = 2e-3,
) -> ErrorModel:
    """Principal factors of residual spectra of R (first) and T (second).

    The second moment about zero is taken, not about the mean: a mean misfit of the sets at hand is
    an error another set may not share.

    **Arguments:**

    - `residuals`: measured minus modelled R and T on `bin_centres()`; NaN where missing.
    - `weights`: weight of each leaf, for instance so that each data set counts the same.
    - `factors`: how many factors to keep.
    - `noise_floor`: least standard deviation of the rest [-].
    """
    leaves, _, bins = residuals.shape
    flat = residuals.reshape(leaves, 2 * bins)
    known = np.isfinite(flat)
    filled = np.where(known, flat, 0.0)
    share = weights / weights.sum()
    seen = np.sqrt(share) @ (known * np.sqrt(share)[:, None])
    scaled = filled * np.sqrt(share)[:, None] / np.sqrt(np.maximum(seen, 1e-9))
    _, sizes, directions = np.linalg.svd(scaled, full_matrices=False)
    loadings = sizes[:factors, None] * directions[:factors]
    rest = (scaled**2).sum(0) - (loadings**2).sum(0)
    noise = np.sqrt(np.maximum(rest, 0.0) + noise_floor**2)
    return ErrorModel(loadings[:, :bins], loadings[:, bins:], noise[:bins], noise[bins:])


@cache
def default_error_model() -> ErrorModel:
    """The error model shipped with the package, estimated on ANGERS and LOPEX (see `data/README`)."""
    path = resources.files("fynjax.leaf") / "data" / "error_model.csv.gz"
    with resources.as_file(path) as file:
        table = pd.read_csv(file)
    if not np.array_equal(table["wavelength_nm"], bin_centres()):
        raise ValueError("the error model's table does not stand on the fit's bins")
    names = [c for c in table.columns if c.startswith("r_factor")]
    r = table[names].to_numpy(float).T
    t = table[[n.replace("r_", "t_", 1) for n in names]].to_numpy(float).T
    return ErrorModel(r, t, table["r_noise"].to_numpy(float), table["t_noise"].to_numpy(float))


def independent_error_model(standard_deviation: float = 0.01) -> ErrorModel:
    """Independent noise of one size: the assumption of older tools, for comparison with them.

    Its intervals are far too narrow for real leaves.
    """
    bins = bin_centres().size
    none, flat = np.zeros((1, bins)), np.full(bins, standard_deviation)
    return ErrorModel(none, none, flat, flat)


def to_bins(wavelength: np.ndarray, spectra: np.ndarray) -> np.ndarray:
    """Mean of the finite bands in each bin; bins without a band are filled over gaps to 25 nm.

    **Arguments:** `wavelength` [band], ascending [nm], `spectra` [..., band], NaN where missing.

    **Returns:** [..., bin] on `bin_centres()`, NaN where nothing was measured.
    """
    centres = bin_centres()
    spectra = np.asarray(spectra, float)
    lead = spectra.reshape(-1, spectra.shape[-1])
    edges = np.append(centres - BIN_WIDTH / 2, centres[-1] + BIN_WIDTH / 2)
    place = np.digitize(wavelength, edges) - 1
    inside = (place >= 0) & (place < centres.size)
    select = np.zeros((wavelength.size, centres.size))
    select[np.flatnonzero(inside), place[inside]] = 1.0
    finite = np.isfinite(lead)
    count = finite @ select
    total = np.where(finite, lead, 0.0) @ select
    shift = (finite * wavelength) @ select
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, where = total / count, shift / count
    out = np.full(mean.shape, np.nan)
    for i, (row, at) in enumerate(zip(mean, where)):
        have = np.flatnonzero(np.isfinite(row))
        if have.size == 0:
            continue
        # Re-centre coarse bands: the mean belongs to the mean wavelength of its bands.
        value = np.interp(centres, at[have], row[have], left=np.nan, right=np.nan)
        nearest = np.abs(at[have][None, :] - centres[:, None])
        left = np.where(at[have][None, :] <= centres[:, None], nearest, np.inf).min(1)
        right = np.where(at[have][None, :] >= centres[:, None], nearest, np.inf).min(1)
        close = (left + right <= 25.0) | np.isfinite(row)
        out[i] = np.where(np.isfinite(value), np.where(close, value, np.nan), row)
    return out.reshape(*spectra.shape[:-1], centres.size)
