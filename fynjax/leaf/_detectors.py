"""Jumps between neighbouring detectors of a spectrometer."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError

_REACH = 12.0
LARGEST_JUMP = 0.15
"""Largest jump that counts as drift of a detector, relative [-]."""
DARKEST_JUMP = 0.1
"""Where a spectrum is darker at a change of detectors, an offset would look like a gain [-]."""


def correct_detector_jumps(
    wavelength: Float[np.ndarray, " band"],
    spectra: Float[np.ndarray, "*leaf band"],
    changes: Sequence[float],
    measured: Sequence[float] | None = None,
) -> tuple[Float[np.ndarray, "*leaf band"], Float[np.ndarray, "*leaf change"]]:
    """Scale the detectors of each spectrum so that it runs smoothly across their changes.

    On either side of a change a straight line through the bands of 12 nm is drawn to the middle of
    the step; the ratio of the two is the jump. The detector with most bands is the reference (the
    first SWIR detector of an ASD, the one that does not drift while the instrument warms up) and
    the others are multiplied. A ratio further than 15 % from 1 is a fault other than drift and
    is not corrected, nor is a change without three good bands on each side, nor one where the
    spectrum is below 0.1, as in the water band about 1905 nm: there a jump says more of an offset
    than of a gain.

    **Arguments:**

    - `wavelength`: band centres [nm], ascending.
    - `spectra`: reflectance or transmittance [-], NaN where missing.
    - `changes`: last wavelength of each detector but the last [nm], such as 1000 and 1830.
    - `measured`: the jump at each change [-], where both detectors saw the same bands; NaN for one
      that is to be found by the lines.

    **Returns:** the corrected spectra, of the shape of `spectra`, and the jump at each change, the
    ratio right over left minus 1 [-], NaN where it could not be measured. NumPy; not
    differentiable.

    **Raises:** `InputError` for changes that are not finite or do not ascend.
    """
    changes = [float(c) for c in changes]
    if not np.isfinite(changes).all() or any(b <= a for a, b in pairwise(changes)):
        raise InputError(f"`changes` must be wavelengths that ascend, but are {changes}")
    grid = np.asarray(wavelength, float)
    spectra = np.asarray(spectra, float)
    rows = np.atleast_2d(spectra).reshape(-1, grid.size)
    place = np.searchsorted(np.array(changes), grid, side="left")
    members = np.bincount(place, minlength=len(changes) + 1)
    reference = int(np.argmax(members))
    jumps = np.full((len(rows), len(changes)), np.nan)
    bright = np.zeros(jumps.shape, bool)
    for number in range(len(changes)):
        left, right = grid[place <= number], grid[place > number]
        if left.size == 0 or right.size == 0:
            continue
        middle = (left[-1] + right[0]) / 2
        ends = [
            _extrapolated(grid, rows, (place == side) & (np.abs(grid - middle) <= _REACH), middle)
            for side in (number, number + 1)
        ]
        with np.errstate(invalid="ignore", divide="ignore"):
            jump = ends[1] / ends[0] - 1.0
            jumps[:, number] = np.where((ends[0] > 0) & (ends[1] > 0), jump, np.nan)
            bright[:, number] = np.minimum(*ends) >= DARKEST_JUMP
    if measured is not None:
        known = np.asarray(measured, float)
        jumps = np.where(np.isfinite(known), known, jumps)
    usable = np.isfinite(jumps) & (np.abs(np.nan_to_num(jumps)) <= LARGEST_JUMP) & bright
    ratio = np.where(usable, 1.0 + np.nan_to_num(jumps), 1.0)
    gains = np.ones((len(rows), len(changes) + 1))
    # Outwards from the reference: each detector takes the gain of its neighbour and the jump.
    for side in range(reference - 1, -1, -1):
        gains[:, side] = gains[:, side + 1] * ratio[:, side]
    for side in range(reference + 1, len(changes) + 1):
        gains[:, side] = gains[:, side - 1] / ratio[:, side - 1]
    lead = spectra.shape[:-1]
    return (rows * gains[:, place]).reshape(spectra.shape), jumps.reshape(*lead, len(changes))


def _extrapolated(
    grid: np.ndarray, rows: np.ndarray, near: np.ndarray, at: float
) -> Float[np.ndarray, " leaf"]:
    """Value at `at` of the line through the bands `near`; NaN with less than three of them."""
    x, y = grid[near] - at, rows[:, near]
    good = np.isfinite(y)
    count = good.sum(1)
    y = np.where(good, y, 0.0)
    # Sums of a regression line, of all leaves at once, over the bands that each has.
    sx, sy = (good * x).sum(1), y.sum(1)
    sxx, sxy = (good * x**2).sum(1), (y * x).sum(1)
    spread = count * sxx - sx**2
    with np.errstate(invalid="ignore", divide="ignore"):
        value = (sxx * sy - sx * sxy) / spread
    return np.where((count >= 3) & (spread > 0), value, np.nan)
