"""What a calibration must say of itself: whether it is nearer to what was measured than the field
table was, and what of the data the model does not describe."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.special import ndtri

from fynjax.metrics import VEGETATION_INDICES, without_view

_SAME = 0.01
"""Change of an error, as a share of the measured value, that counts as none [-]."""


def compare_means(
    names: Sequence[str],
    measured: Float[np.ndarray, " statistic"],
    before: Float[np.ndarray, " statistic"],
    after: Float[np.ndarray, " statistic"],
    with_gain: Float[np.ndarray, " statistic"],
) -> pd.DataFrame:
    """The mean of every band and index against what was measured, before and after a calibration.

    **Arguments:**

    - `names`: of statistics. Means are those that end with ".mean", and all of a spectrum.
    - `measured`, `before`, `after`, `with_gain`: values of the statistics; simulated ones before
      and after a calibration, and after with the gains of cameras.

    **Returns:** a row for each mean: its statistic; whether it is of a band, and not of an index;
    the errors before, after and with gains [%]; and `moved`, "nearer", "away" or "" for what
    differs by less than 1 % of what was measured.
    """
    rows = [
        i
        for i, name in enumerate(names)
        if name.endswith(".mean") or without_view(name).startswith("spectrum.")
    ]
    real = np.asarray(measured, float)[rows]
    scale = np.where(real == 0.0, 1.0, np.abs(real))
    error = {
        f"{what}_error_percent": 100.0 * (np.asarray(value, float)[rows] - real) / scale
        for what, value in (("before", before), ("after", after), ("with_gain", with_gain))
    }
    farther = np.abs(error["after_error_percent"]) - np.abs(error["before_error_percent"])
    farther = np.where(np.isfinite(farther), farther, np.inf)  # of no use: farther than anything
    moved = np.where(farther > 100.0 * _SAME, "away", "nearer")
    return pd.DataFrame(
        {
            "statistic": [names[i] for i in rows],
            "band": [without_view(names[i]).split(".")[0] not in VEGETATION_INDICES for i in rows],
            **error,
            "moved": np.where(np.abs(farther) > 100.0 * _SAME, moved, ""),
        }
    )


def is_worse(means: pd.DataFrame) -> bool:
    """Whether more bands of a table of `compare_means` moved away from what was measured than
    nearer; without a band, more indices."""
    counted = means[means["band"]] if means["band"].any() else means
    return bool((counted["moved"] == "away").sum() > (counted["moved"] == "nearer").sum())


def worse_sentence(means: pd.DataFrame) -> str:
    """What `is_worse` found, in words for the first sentence of a page."""
    bands = means[means["band"]] if means["band"].any() else means
    away = bands[bands["moved"] == "away"]
    worst = away.iloc[int(away["after_error_percent"].abs().argmax())]
    what = "bands" if means["band"].any() else "indices"
    return (
        f"Worse than the table: of {len(bands)} {what} {len(away)} moved away from what was "
        f"measured, by more than 1 % of it, and {(bands['moved'] == 'nearer').sum()} nearer; most "
        f"{worst['statistic']}, off by {worst['before_error_percent']:+.1f} % before and "
        f"{worst['after_error_percent']:+.1f} % after. The values to use are those of "
        "the table, not the estimate."
    )


GROUPS = {
    "means of bands": "the means of bands",
    "spreads of bands": "the spreads of bands",
    "indices": "the indices",
    "a spectrum": "the spectrum",
    "structure": "the structure of the cloud",
}
"""Groups of statistics that are left out together, with words for each."""


def group_of(name: str) -> str:
    """The group of `GROUPS` that a statistic belongs to."""
    layer, _, kind = without_view(name).partition(".")
    if layer in ("spectrum", "lidar"):
        return "a spectrum" if layer == "spectrum" else "structure"
    if layer in VEGETATION_INDICES:
        return "indices"
    return "means of bands" if kind == "mean" else "spreads of bands"


def misfit_without(
    weights: Float[np.ndarray, "direction statistic"],
    rest: Float[np.ndarray, " statistic"],
    jacobian: Float[np.ndarray, "statistic free"],
    group: Bool[np.ndarray, " statistic"],
) -> tuple[float, int]:
    """Least misfit and distance from the prior of a linear model that need not explain a `group`.

    **Arguments:**

    - `weights`: make of misfits independent ones of unit size.
    - `rest`: data less what is predicted at the prior's centre.
    - `jacobian`: slopes by whitened parameters.
    - `group`: statistics that count no more.

    **Returns:** the chi-square, and its degrees: the directions that are left.
    """
    free = jacobian.shape[1]
    shifts = weights[:, group]
    # Whatever those statistics are: a shift of each, without a prior.
    rank = int(np.linalg.matrix_rank(shifts)) if shifts.size else 0
    rows = np.concatenate([weights @ jacobian, np.eye(free)])
    columns = np.concatenate([shifts, np.zeros((free, shifts.shape[1]))])
    target = np.concatenate([weights @ rest, np.zeros(free)])
    solved = np.linalg.lstsq(np.concatenate([rows, columns], axis=1), target)[0]
    left = target - np.concatenate([rows, columns], axis=1) @ solved
    return float(left @ left), len(weights) - rank


def gain_sentences(
    names: Sequence[str],
    gain: Float[np.ndarray, " band"],
    covariance: Float[np.ndarray, "band band"],
) -> list[str]:
    """What is known of the gains of a camera, in words: those of all bands, what they have in
    common, and the ratio of two that differs most surely from one.

    **Arguments:** `names` of the bands; estimated `gain` of each [-]; `covariance` of their
    logarithms [-], without which, all zero or not finite, there is nothing to say.
    """
    if not (covariance.any() and np.isfinite(covariance).all() and np.isfinite(gain).all()):
        return []
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    each = ", ".join(f"{n} {g:.3f} ± {g * s:.3f}" for n, g, s in zip(names, gain, sd, strict=True))
    lines = [f"Gains of the camera: {each}; beforehand 1."]
    if len(gain) < 2:
        return lines

    def sure(log: float, sd: float, of: int = 1) -> str:
        # The most extreme of several ratios is held to as much as all of them together.
        least = -float(ndtri(0.5 * _CHANCE / of))
        return "different from 1" if abs(log) > least * sd else "1 within its error"

    log = np.log(gain)
    level, of_level = log.mean(), np.sqrt(max(covariance.mean(), 0.0))
    apart = log[:, None] - log
    variance = sd[:, None] ** 2 + sd**2 - 2.0 * covariance
    spread = np.sqrt(np.maximum(variance, 0.0))
    known = np.triu(spread > 1e-6 * sd.max(), 1)
    lines.append(
        f"What all have in common, their level, is {np.exp(level):.2f} ± "
        f"{np.exp(level) * of_level:.2f}, {sure(level, of_level)}"
    )
    if not known.any():  # one factor of all bands: its ratios are one, and nothing is learned
        return [*lines[:-1], f"{lines[-1]}."]
    surely = np.divide(np.abs(apart), spread, out=np.full_like(apart, -1.0), where=known)
    one, other = divmod(int(np.argmax(surely)), len(gain))
    ratio, of_ratio = apart[one, other], spread[one, other]
    lines[-1] += (
        f"; the ratio that differs most surely from 1, {names[one]} over {names[other]}, is "
        f"{np.exp(ratio):.2f} ± {np.exp(ratio) * of_ratio:.2f}, "
        f"{sure(ratio, of_ratio, int(known.sum()))}."
    )
    return lines


_CHANCE = 0.0455
"""Chance below which a level or a ratio of gains counts as surely not one [-]: two standard
deviations."""
