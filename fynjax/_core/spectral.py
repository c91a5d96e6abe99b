"""Spectra on wavelength grids: checks, and band averages as weight matrices.

A band average is the mean of a spectrum weighted by the band's response R,

    S_band = ∫ R(λ) S(λ) dλ / ∫ R(λ) dλ,

with S linear between the points of its grid. Then S_band is a weighted sum of the grid's values
and each weight is the integral of R times one hat function, which needs only two cumulative
moments of R: ∫ R and ∫ λ R. For Gaussian, box and tabulated (piecewise linear) responses both
are closed forms, so the weights are exact on any increasing grid, however coarse or uneven.

The weights are NumPy constants in float64: applying them is a matrix product, differentiable
with respect to the spectrum and quick to trace.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from fynjax._core.errors import InputError

Moments = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""∫ R and ∫ (λ - centre) R from -inf to each point [nm], with R of integral one."""

Curve = tuple[ArrayLike, ArrayLike]
"""A tabulated response: wavelengths [nm] and relative response [-], zero outside."""

FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
"""Full width at half maximum of a Gaussian, in standard deviations."""
_LONGEST = 1e9
"""Longest wavelength that a grid may have [nm]: 1 m."""


def check_wavelength(
    wavelength: ArrayLike, what: str = "wavelength"
) -> Float[np.ndarray, " wavelength"]:
    """Return a wavelength grid as float64 NumPy, or say why it cannot be one [nm].

    Raises `InputError` if the grid is not one-dimensional, has a value that is not finite or not
    positive, is not strictly increasing, lies below 100 nm and so looks like µm, or beyond 1 m.
    """
    grid = np.asarray(wavelength, dtype=np.float64)
    if grid.ndim != 1 or grid.size == 0:
        raise InputError(f"{what} must be a list of wavelengths in nm, but has shape {grid.shape}.")
    if not np.all(np.isfinite(grid)) or np.any(grid <= 0.0):
        raise InputError(f"{what} must be finite and positive, but holds {_first_bad(grid)}.")
    if grid.max() < 100.0:
        raise InputError(
            f"{what} must be in nm, but runs from {grid.min():g} to {grid.max():g}. "
            "These look like µm: multiply by 1000."
        )
    if grid.max() > _LONGEST:
        raise InputError(f"{what} must be in nm, but one is {grid.max():g}. Is it damaged?")
    steps = np.diff(grid)
    if np.any(steps <= 0.0):
        if np.all(steps < 0.0):
            raise InputError(f"{what} must increase, but is descending: reverse it and its data.")
        at = int(np.argmax(steps <= 0.0))
        slip = "a duplicate" if steps[at] == 0.0 else "a step back: sort it with its data"
        raise InputError(
            f"{what} must increase strictly, but {grid[at]:g} nm is followed by "
            f"{grid[at + 1]:g} nm ({slip})."
        )
    return grid


def gaussian_matrix(
    wavelength: ArrayLike,
    centre: ArrayLike,
    fwhm: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    max_loss: float = 1e-3,
) -> Float[np.ndarray, "band wavelength"]:
    """Weights that average a spectrum over Gaussian bands [-]; each row sums to one.

    **Arguments:** `wavelength` grid of the spectrum [nm], increasing; `centre` and `fwhm` (full
    width at half maximum) of each band [nm]; `names` of the bands, for messages; `max_loss`, the
    largest fraction of a response that may fall outside the grid (the rest is renormalised).

    Raises `InputError` if the grid is no wavelength grid in nm, a width is not positive, or a
    band loses more than `max_loss`.
    """
    return _of_widths(_gaussian_moments, wavelength, centre, fwhm, names, max_loss)


def box_matrix(
    wavelength: ArrayLike,
    centre: ArrayLike,
    width: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    max_loss: float = 1e-3,
) -> Float[np.ndarray, "band wavelength"]:
    """Weights that average a spectrum over bands of constant response [-]; rows sum to one.

    As `gaussian_matrix`, with `width` the full width of each band [nm].
    """
    return _of_widths(_box_moments, wavelength, centre, width, names, max_loss)


def _gaussian_moments(centre: float, fwhm: float) -> Moments:
    sigma = fwhm / FWHM_PER_SIGMA

    def moments(x: NDArray) -> tuple[NDArray, NDArray]:
        z = (x - centre) / sigma
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        return ndtr(z), -sigma * density

    return moments


def _box_moments(centre: float, width: float) -> Moments:
    def moments(x: NDArray) -> tuple[NDArray, NDArray]:
        t = np.clip(x - centre, -0.5 * width, 0.5 * width)
        return t / width + 0.5, (t**2 - 0.25 * width**2) / (2.0 * width)

    return moments


def tabulated_matrix(
    wavelength: ArrayLike,
    curves: Sequence[Curve],
    *,
    names: Sequence[str] | None = None,
    max_loss: float = 1e-3,
) -> Float[np.ndarray, "band wavelength"]:
    """Weights that average a spectrum over tabulated responses [-]; rows sum to one.

    **Arguments:** `curves`, for each band its own wavelengths [nm] and relative response
    (non-negative, any scale, linear between points, zero outside); the rest as `gaussian_matrix`.

    Raises `InputError` also for a curve that is negative, zero everywhere or not finite.
    """
    centres, responses = [], []
    for index, (points, response) in enumerate(curves):
        label = _label(names, index)
        u = check_wavelength(points, f"the response curve of {label}")
        r = np.asarray(response, dtype=np.float64)
        if r.shape != u.shape or u.size < 2:
            raise InputError(
                f"the response curve of {label} needs one response for each of at least two "
                f"wavelengths, but has {r.shape} for {u.shape}."
            )
        if not np.all(np.isfinite(r)) or np.any(r < 0.0) or not np.any(r > 0.0):
            raise InputError(
                f"the response curve of {label} must be finite, non-negative and somewhere "
                f"positive, but holds {_first_bad(r)}."
            )
        r = r / np.trapezoid(r, u)
        c = float(u[np.argmax(r)])
        centres.append(c)
        responses.append(_tabulated_moments(u, r, c))
    return _matrix(wavelength, np.asarray(centres), responses, names, max_loss)


def _tabulated_moments(u: NDArray, r: NDArray, centre: float) -> Moments:
    step = np.diff(u)
    slope = np.diff(r) / step

    def pieces(j: NDArray, t: NDArray) -> tuple[NDArray, NDArray]:
        """Both integrals from node j over a length t within its segment."""
        zeroth = r[j] * t + slope[j] * t**2 / 2.0
        first = (u[j] - centre) * zeroth + r[j] * t**2 / 2.0 + slope[j] * t**3 / 3.0
        return zeroth, first

    whole = pieces(np.arange(step.size), step)
    total0 = np.concatenate([[0.0], np.cumsum(whole[0])])
    total1 = np.concatenate([[0.0], np.cumsum(whole[1])])

    def moments(x: NDArray) -> tuple[NDArray, NDArray]:
        x = np.clip(x, u[0], u[-1])
        j = np.clip(np.searchsorted(u, x, side="right") - 1, 0, step.size - 1)
        zeroth, first = pieces(j, x - u[j])
        return total0[j] + zeroth, total1[j] + first

    return moments


def _matrix(
    wavelength: ArrayLike,
    centres: NDArray,
    responses: Sequence[Moments],
    names: Sequence[str] | None,
    max_loss: float,
) -> Float[np.ndarray, "band wavelength"]:
    grid = check_wavelength(wavelength)
    if grid.size < 2:
        raise InputError("a spectrum needs at least two wavelengths to be averaged over bands.")
    weights = np.zeros((len(responses), grid.size))
    step = np.diff(grid)
    for row, (centre, moments) in enumerate(zip(centres, responses)):
        zeroth, first = (np.diff(m) for m in moments(grid))
        kept = float(zeroth.sum())
        if 1.0 - kept > max_loss:
            raise InputError(
                f"{_label(names, row)} ({centre:g} nm) has {100.0 * (1.0 - kept):.3g} % of its "
                f"response outside the spectrum's range {grid[0]:g} to {grid[-1]:g} nm (allowed: "
                f"{100.0 * max_loss:g} %). Use a wider spectrum, or leave the band out."
            )
        weights[row, :-1] += ((grid[1:] - centre) * zeroth - first) / step
        weights[row, 1:] += (first - (grid[:-1] - centre) * zeroth) / step
    return weights / weights.sum(axis=1, keepdims=True)


def _of_widths(
    moments_of: Callable[[float, float], Moments],
    wavelength: ArrayLike,
    centre: ArrayLike,
    width: ArrayLike,
    names: Sequence[str] | None,
    max_loss: float,
) -> Float[np.ndarray, "band wavelength"]:
    """Weights of bands of one form, each with a centre and a width [nm]."""
    centres = np.atleast_1d(np.asarray(centre, dtype=np.float64))
    widths = np.broadcast_to(np.asarray(width, dtype=np.float64), centres.shape)
    if not np.all(np.isfinite(widths)) or np.any(widths <= 0.0):
        raise InputError(f"band widths must be positive, in nm, but hold {_first_bad(widths)}.")
    if not np.all(np.isfinite(centres)) or centres.max(initial=np.inf) < 100.0:
        raise InputError(
            f"band centres must be finite and in nm, but are {centres.tolist()}. "
            "Values below 100 look like µm: multiply by 1000."
        )
    responses = [moments_of(c, w) for c, w in zip(centres, widths)]
    return _matrix(wavelength, centres, responses, names, max_loss)


def _label(names: Sequence[str] | None, index: int) -> str:
    return f"band {index}" if names is None else f"band {names[index]!r}"


def _first_bad(values: NDArray) -> str:
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))
    at = int(bad[0])
    return f"{values.ravel()[at]:g} at position {at}"
