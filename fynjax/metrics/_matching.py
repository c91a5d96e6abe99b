"""Two spectra on one set of bands: who follows whom, and how."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike, NDArray

from fynjax._core.errors import InputError
from fynjax._core.spectral import check_wavelength, gaussian_matrix

MatchingMethod = Literal["auto", "nearest", "linear", "response"]
"""How the finer of two spectra is brought onto the bands of the coarser one."""

_SAME = 0.1
"""Grids nearer than this are one [nm]: AVIRIS-NG's own yearly fits differ by more."""


@dataclass(frozen=True)
class WavelengthMatch:
    """Weights that bring a real and a simulated spectrum onto common bands."""

    wavelength: Float[np.ndarray, " band"]
    """Centres of the common bands [nm]."""
    real: Float[np.ndarray, "band real"]
    """Weights of the real spectrum in each common band [-]; rows sum to one."""
    simulated: Float[np.ndarray, "band simulated"]
    """Weights of the simulated one."""
    method: str
    """'same', 'nearest', 'linear' or 'response'."""
    statement: str
    """Sentence on how wavelengths were matched."""


def match_wavelengths(
    real: ArrayLike,
    simulated: ArrayLike,
    *,
    real_fwhm: ArrayLike | None = None,
    simulated_fwhm: ArrayLike | None = None,
    method: MatchingMethod = "auto",
) -> WavelengthMatch:
    """Weights that bring two spectra onto common bands.

    The coarser grid (by its median step; the real one if they differ by less than a fifth) gives
    the common bands, and the other spectrum is brought onto them. Bands that the other one does
    not cover are left out: those outside its range and those in a gap of it, further than one of
    its steps (and for `response` half a band's width) from any of its wavelengths.

    **Arguments:**

    - `real`, `simulated`: band centres [nm], increasing.
    - `real_fwhm`, `simulated_fwhm`: full widths at half maximum of the bands [nm]; where they are
      not known, the distance of neighbouring bands stands in for them.
    - `method`: "nearest" takes the nearest wavelength; "linear" interpolates; "response" averages
      over Gaussian bands of the coarser grid's widths; "auto" is "response" where the finer grid
      has at least two steps in a band's width, else "linear".

    **Returns:** a `WavelengthMatch`: common bands, one matrix of weights for each spectrum (the
    weighted spectra are then linear in the given ones), and a statement of what was done.

    **Raises:** `InputError` for a grid that is none in nm, an unknown method, or grids that have
    fewer than two bands in common.

    >>> import numpy as np
    >>> from fynjax.metrics import match_wavelengths
    >>> match = match_wavelengths(np.arange(400.0, 500.0, 20.0), np.arange(400.0, 500.0, 2.0))
    >>> match.method, match.wavelength
    ('response', array([420., 440., 460., 480.]))
    """
    if method not in (known := get_args(MatchingMethod)):
        raise InputError(f"`method` must be one of {', '.join(known)}, but is {method!r}.")
    x = check_wavelength(real, "the wavelengths of the real spectrum")
    y = check_wavelength(simulated, "the wavelengths of the simulated spectrum")
    if min(x.size, y.size) < 2:
        raise InputError("spectra must have at least two bands to be compared.")
    if x.size == y.size and np.abs(x - y).max() <= _SAME:
        same = np.eye(x.size)
        return WavelengthMatch(x, same, same, "same", "Both spectra have the same bands.")
    # A gap, as over water vapour, does not count for the step of a grid.
    step_x, step_y = float(np.median(np.diff(x))), float(np.median(np.diff(y)))
    onto_real = step_x >= 0.8 * step_y
    coarse, fine = (x, y) if onto_real else (y, x)
    given = real_fwhm if onto_real else simulated_fwhm
    width = _widths(coarse, given)
    if method == "auto":
        dense = 2.0 * float(np.median(np.diff(fine))) <= float(np.median(width))
        method = "response" if dense else "linear"
    kept = _covered(coarse, fine, 0.5 * width if method == "response" else np.zeros(coarse.size))
    if kept.sum() < 2:
        raise InputError(
            f"spectra must overlap to be compared, but the real one runs from {x[0]:g} to "
            f"{x[-1]:g} nm and the simulated one from {y[0]:g} to {y[-1]:g} nm, with "
            f"{int(kept.sum())} bands in common."
        )
    target = coarse[kept]
    if method == "response":
        # The tails of an outermost band may reach past the grid; the rest is renormalised.
        weights = gaussian_matrix(fine, target, width[kept], max_loss=0.5)
    elif method == "linear":
        weights = np.stack([np.interp(target, fine, one) for one in np.eye(fine.size)], axis=1)
    else:
        weights = np.eye(fine.size)[np.abs(fine[None, :] - target[:, None]).argmin(axis=1)]
    identity = np.eye(coarse.size)[kept]
    moved, still = ("simulated", "real") if onto_real else ("real", "simulated")
    how = {
        "nearest": "by taking its nearest wavelength",
        "linear": "by linear interpolation",
        "response": "by averaging over Gaussian responses of "
        + ("the stated widths" if given is not None else "a width equal to the bands' distance")
        + f" (median {float(np.median(width)):.3g} nm)",
    }[method]
    statement = f"The {moved} spectrum was brought onto the bands of the {still} one {how}."
    if not kept.all():
        statement += f" {int((~kept).sum())} bands that only the {still} one covers are left out."
    real_weights, simulated_weights = (identity, weights) if onto_real else (weights, identity)
    return WavelengthMatch(target, real_weights, simulated_weights, method, statement)


def _widths(grid: NDArray[np.float64], fwhm: ArrayLike | None) -> NDArray[np.float64]:
    if fwhm is None:
        # The nearer neighbour: across bands that were left out there is none.
        step = np.diff(grid)
        return np.minimum(np.r_[step[:1], step], np.r_[step, step[-1:]])
    widths = np.broadcast_to(np.asarray(fwhm, float), grid.shape)
    if not np.all(np.isfinite(widths) & (widths > 0.0)):
        raise InputError("widths of bands must be positive and finite, in nm.")
    return np.array(widths)


def _covered(
    target: NDArray[np.float64], source: NDArray[np.float64], reach: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Bands of `target` that lie in the range of `source` and not in a gap of it."""
    step = float(np.median(np.diff(source)))
    edge = 1e-6 * step
    inside = (target - reach >= source[0] - edge) & (target + reach <= source[-1] + edge)
    # Distance to the nearer of the two neighbours.
    after = np.clip(np.searchsorted(source, target), 1, source.size - 1)
    nearest = np.minimum(np.abs(target - source[after - 1]), np.abs(source[after] - target))
    return inside & (nearest <= step + edge)
