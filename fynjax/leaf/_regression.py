"""Water of leaves of one campaign, corrected by what their fits leave in the spectra."""

from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import NamedTuple

import equinox as eqx
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.leaf._problem import leaf_bounds
from fynjax.leaf._result import LeafFit

WINDOW = {
    "chlorophyll": (500.0, 780.0),
    "carotenoids": (450.0, 780.0),
    "water": (1000.0, 2400.0),
    "dry_matter": (1100.0, 2400.0),
}
"""Where what a fit leaves in a spectrum says something of a trait [nm]."""
# Sd of the smoothing before the derivative [nm], the darkest signal of which a logarithm is taken,
# and the part of the window's bins that must have been measured.
_SMOOTHING, _DARKEST, _ENOUGH = 15.0, 0.005, 0.9


class Regression(NamedTuple):
    """Linear change of the logarithm of a trait."""

    coefficients: Float[np.ndarray, " number"]
    """Of `remains` less their median in the campaign [nm]."""
    limit: float
    """Norm beyond which a leaf is like none of those learned from, and counts as at it [nm-1]."""


def window_bins(fit: LeafFit, trait: str) -> np.ndarray:
    """Which bins `remains` are of."""
    low, high = WINDOW[trait]
    return (fit.wavelength >= low) & (fit.wavelength <= high)


def remains(fit: LeafFit, trait: str, parts: Sequence[int]) -> Float[np.ndarray, "leaf number"]:
    """Smoothed derivative along the wavelength of log(measured / fitted), which no change of
    brightness moves, of R (part 0) and T (1), one after the other [nm-1]."""
    inside = window_bins(fit, trait)
    at = fit.wavelength[inside]
    near = np.exp(-0.5 * ((at[:, None] - at) / _SMOOTHING) ** 2)
    near /= near.sum(1, keepdims=True)
    columns = []
    for part in parts:
        measured = np.maximum(fit.measured[:, part, inside], _DARKEST)
        ratio = np.log(measured / np.maximum(fit.fitted[:, part, inside], _DARKEST))
        for row in ratio:
            have = np.isfinite(row)
            row[:] = np.interp(at, at[have], row[have]) if have.any() else 0.0
        columns.append(np.gradient(ratio @ near.T, at, axis=1))
    return np.concatenate(columns, axis=1)


def bounded(x: np.ndarray, limit: float) -> np.ndarray:
    """Rows [leaf, number] whose norm is at most `limit`."""
    norm = np.maximum(np.linalg.norm(x, axis=1), 1e-12)
    return x * np.minimum(1.0, limit / norm)[:, None]


@cache
def water_regressions() -> dict[str, Regression]:
    """Of fits to R ("R") and to R and T ("RT"), from four campaigns (see `data/README.md`)."""
    path = resources.files("fynjax.leaf") / "data" / "water_regression.csv"
    with resources.as_file(path) as file:
        table = pd.read_csv(file)
    return {
        str(given): Regression(rows["coefficient"].to_numpy(float), float(rows["limit"].iloc[0]))
        for given, rows in table.groupby("given", sort=False)
    }


def regress_water(fit: LeafFit) -> LeafFit:
    """Correct fitted water by what the fits leave in the spectra of leaves of one campaign.

    The logarithm of water changes by a linear function of the derivative along the wavelength of
    log(measured / fitted spectrum), less its median over the leaves: what all leaves share is that
    of an instrument or a model, and says nothing of a leaf. So the campaign's median hardly moves,
    and a single leaf not at all. Coefficients are the mean of a Gaussian process with random
    effects of campaigns, their slopes and species; the share that is applied was chosen by
    campaigns left out. Other traits are not corrected: there it did not help.

    Leaves are left alone of which less than nine tenths of 1000-2400 nm were measured. Intervals
    keep their width (in the logit): with it they held as many values as before. Spectra are those
    of `fit`.

    **Arguments:** `fit`: result of `fit_leaf` over all wavelengths, leaves of one campaign and
    shape, five or more.

    **Returns:** `LeafFit` with other water, its deviation, covariance and interval.

    **Raises:** `InputError` if water was not fitted.

    NumPy; not differentiable.
    """
    if "water" not in fit.names:
        raise InputError(f"a correction of water needs fitted water, but fitted: {fit.names}")
    at, (low, high) = fit.names.index("water"), leaf_bounds(["water"])[0]
    share = np.isfinite(fit.measured[:, :, window_bins(fit, "water")]).mean(2)
    enough = (share >= _ENOUGH) & np.isfinite(fit.standard_deviation[:, at])[:, None]
    change = np.zeros(len(share))
    for given, rows, parts in (
        ("R", enough[:, 0] & (share[:, 1] == 0.0), (0,)),
        ("RT", enough.all(1), (0, 1)),
    ):
        if rows.any():
            coefficients, limit = water_regressions()[given]
            x = remains(fit, "water", parts)[rows]
            change[rows] = bounded(x - np.median(x, axis=0), limit) @ coefficients
    before = np.asarray(fit.parameters.water)
    after = np.minimum(before * np.exp(change), low + 0.999 * (high - low))
    after = np.where(change == 0.0, before, after)

    def logit(value: np.ndarray) -> np.ndarray:
        return np.log((value - low) / (high - value))

    with np.errstate(invalid="ignore", divide="ignore"):
        moved = logit(after) - logit(before)
        ends = [
            low + (high - low) / (1.0 + np.exp(-(logit(end[:, at]) + moved)))
            for end in (fit.lower, fit.upper)
        ]
    slopes = [(value - low) * (high - value) for value in (before, after)]
    ratio = np.where(change == 0.0, 1.0, slopes[1] / slopes[0])
    deviation, covariance = fit.standard_deviation.copy(), fit.covariance.copy()
    deviation[:, at] *= ratio
    covariance[:, at] *= ratio[:, None]
    covariance[:, :, at] *= ratio[:, None]
    limits = [end.copy() for end in (fit.lower, fit.upper)]
    for whole, end in zip(limits, ends):
        whole[:, at] = np.where(change == 0.0, whole[:, at], end)
    return eqx.tree_at(
        lambda of: (of.parameters.water, of.standard_deviation, of.covariance, of.lower, of.upper),
        fit,
        (after, deviation, covariance, *limits),
    )
