"""Recipe of `water_regression.csv`: water from what fits of PROSPECT-D leave in spectra.

Run `python -m tools.estimate_regression FOLDER [OUTPUT]` with the folder of
`estimate_error_model`; the table is written into the folder OUTPUT.

A Gaussian process on the logarithm of measured over fitted trait, linear in the derivative along
the wavelength of log(measured / fitted spectrum), less its median in the set. Campaigns and species
have random effects, campaigns also slopes of their own, so that only the slopes that campaigns
share reach a new one; standard deviations are the most probable. Each campaign is fitted with an
error model that excludes it. How much of the correction is applied, nothing to all, is chosen by
campaigns left out. For water the share is all from R and three quarters from R and T. For other
traits it hangs on which campaigns choose it (nothing to all), so they are left alone.
"""

import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.stats import t as student

from fynjax.leaf._error_model import bin_centres
from fynjax.leaf._fit import LeafFit, fit_leaf
from fynjax.leaf._regression import WINDOW, bounded, remains
from tools.estimate_error_model import CAMPAIGNS, DATA, LeafSet, estimate_spectral, read

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


class Case(NamedTuple):
    """What is predicted of what."""

    folder: Path
    trait: str
    through: bool
    """Whether transmittance is known."""


class Correction(NamedTuple):
    """Of each leaf the logarithm by which a trait is changed, and half of its 90 % interval."""

    log: np.ndarray
    half: np.ndarray


def sets_of(case: Case, without: tuple[str, ...] = ()) -> list[LeafSet]:
    """Sets that can train or judge: the trait was measured, and T if it is asked for."""
    sets = [s for name in CAMPAIGNS if name not in without for s in read(case.folder, name)]
    return [
        s for s in sets
        if np.isfinite(s.measured(case.trait)).any()
        and (not case.through or np.isfinite(s.spectra[:, 1]).any())
    ]  # fmt: skip


@cache
def fit(folder: Path, leaves: LeafSet, without: frozenset[str], through: bool) -> LeafFit:
    """Fit of a set with an error model that excludes some campaigns."""
    sets = [s for name in CAMPAIGNS if name not in without for s in read(folder, name)]
    return fit_leaf(
        bin_centres(), leaves.spectra[:, 0], leaves.spectra[:, 1] if through else None,
        measurement=leaves.measurement(), leaf_shape=leaves.shape,
        error_model=estimate_spectral(sets),
    )  # fmt: skip


def fitted(case: Case, leaves: LeafSet, without: Sequence[str]) -> LeafFit:
    return fit(case.folder, leaves, frozenset(without), case.through)


def log_value(of: LeafFit, trait: str) -> np.ndarray:
    return np.log(np.asarray(getattr(of.parameters, trait)))


def log_error(case: Case, leaves: LeafSet, without: Sequence[str]) -> np.ndarray:
    """Logarithm of measured over fitted trait, NaN where either is missing."""
    of = fitted(case, leaves, without)
    error = np.log(leaves.measured(case.trait)) - log_value(of, case.trait)
    return np.where(of.converged, error, np.nan)


def derivatives(case: Case, leaves: LeafSet, without: Sequence[str]) -> np.ndarray:
    """`remains` of the fits of a set, of R, and of T if known [leaf, number]."""
    return remains(fitted(case, leaves, without), case.trait, (0, 1) if case.through else (0,))


class Process:
    """Gaussian process of log errors; logarithms of its standard deviations have wide priors."""

    def __init__(
        self,
        y: np.ndarray,
        x: np.ndarray,
        campaign: np.ndarray,
        species: np.ndarray,
        of: np.ndarray,
    ) -> None:
        """Errors y [leaf] at x [leaf, number]; names of campaign, species and set [leaf]."""
        self.x, same = x, (campaign[:, None] == campaign) * 1.0
        linear = x @ x.T
        kinds = np.char.add(of, species)
        self.kernels = [same, (kinds[:, None] == kinds) * 1.0, linear, linear * same]
        self.sets, self.member = np.unique(of, return_inverse=True)
        self.y = y
        count = self.sets.size
        self.guess = np.log([0.15, 0.1, 0.05, 0.1] + [0.15] * count)
        self.width = np.array([0.5, 0.5, 1.0, 1.0] + [0.7] * count)
        bounds = [(np.log(1e-3), np.log(3.0))] * self.guess.size
        found = minimize(
            self._surprise, self.guess, jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": 60},
        )  # fmt: skip
        self.deviation = np.exp(found.x)
        self.root = cho_factor(self._covariance(found.x), lower=True)
        self.weight = cho_solve(self.root, y)

    def _covariance(self, log: np.ndarray) -> np.ndarray:
        total = sum(np.exp(2 * s) * k for s, k in zip(log, self.kernels))
        return total + np.diag(np.exp(2 * log[4:])[self.member] + 1e-8)

    def _surprise(self, log: np.ndarray) -> tuple[float, np.ndarray]:
        root = cho_factor(self._covariance(log), lower=True)
        weight, inverse = cho_solve(root, self.y), cho_solve(root, np.eye(self.y.size))
        off = (log - self.guess) / self.width
        value = 0.5 * self.y @ weight + np.log(np.diag(root[0])).sum() + 0.5 * off @ off
        rest = inverse - np.outer(weight, weight)
        slope = [np.sum(rest * kernel) for kernel in self.kernels]
        slope += [np.diag(rest)[self.member == i].sum() for i in range(self.sets.size)]
        return value, np.exp(2 * log) * slope + off / self.width

    def predict(self, x: np.ndarray) -> Correction:
        """Of leaves of a new campaign."""
        campaign, species, shared, own = self.deviation[:4] ** 2
        cross, size = shared * x @ self.x.T, (x**2).sum(1)
        known = shared * size - (cross * cho_solve(self.root, cross.T).T).sum(1)
        noise = np.mean(self.deviation[4:] ** 2)
        total = np.maximum(known, 0.0) + own * size + campaign + species + noise
        freedom = max(int(np.unique(self.kernels[0], axis=0).shape[0]) - 1, 1)
        return Correction(cross @ self.weight, student.ppf(0.95, freedom) * np.sqrt(total))


def learn(
    case: Case, without: tuple[str, ...], centred: bool
) -> tuple[Process, float, float] | None:
    """Process of all campaigns but those in `without`, the scale of its inputs, and their limit;
    none from a single campaign that is no inner one."""
    errors, inputs, names = [], [], []
    for other in sets_of(case, without):
        gone = (*without, other.campaign)
        error, x = log_error(case, other, gone), derivatives(case, other, gone)
        x = x - np.median(x, axis=0) if centred else x
        have = np.isfinite(error)
        errors.append(error[have])
        inputs.append(x[have])
        of = np.full(have.sum(), other.name)
        names.append(
            np.stack([np.full(of.shape, other.campaign), other.species()[have], of]).astype(str)
        )
    labels = np.concatenate(names, axis=1)
    if np.unique(labels[0]).size < 2 and len(without) < 2:
        return None
    x = np.concatenate(inputs)
    limit = float(np.quantile(np.linalg.norm(x, axis=1), 0.95))
    x = bounded(x, limit)
    scale = float(np.sqrt((x**2).sum(1).mean()))
    return Process(np.concatenate(errors), x / scale, *labels), scale, limit


def by_process(
    case: Case, leaves: LeafSet, without: tuple[str, ...], centred: bool
) -> Correction | None:
    """Correction learned from all campaigns but those in `without`."""
    learned = learn(case, without, centred)
    if learned is None:
        return None
    process, scale, limit = learned
    new = derivatives(case, leaves, without)
    new = new - np.median(new, axis=0) if centred else new
    return process.predict(bounded(new, limit) / scale)


def share(case: Case, home: tuple[str, ...], centred: bool) -> float:
    """The share of a process's correction that lowers the errors of campaigns most, each predicted
    by the others without `home`, and raises none by more than 5 %; none if the mean falls by less
    than half a per cent."""
    scores = []
    for other in sets_of(case, home):
        gone = (*home, other.campaign)
        found = by_process(case, other, gone, centred) if sets_of(case, gone) else None
        if found is None:
            continue
        error = log_error(case, other, gone)
        truth, have = other.measured(case.trait), np.isfinite(error)
        before = truth * np.exp(-error)
        ratios = []
        for part in SHARES:
            moved = rms((before * np.exp(part * found.log) - truth)[have])
            logs = rms((error - part * found.log)[have]) / rms(error[have])
            ratios.append(0.5 * np.log(moved / rms((before - truth)[have]) * logs))
        scores.append(ratios)
    table = np.array(scores).reshape(-1, len(SHARES))
    if not len(table):
        return 0.0
    mean = np.where((table > 0.05).any(0), np.inf, table.mean(0))
    best = int(np.argmin(mean))
    return SHARES[best] if mean[best] < -0.005 else 0.0


def process(case: Case, leaves: LeafSet, centred: bool) -> Correction | None:
    """The share of the correction by other campaigns that these choose."""
    home = (leaves.campaign,)
    whole = by_process(case, leaves, home, centred)
    if whole is None:
        return None
    return Correction(share(case, home, centred) * whole.log, whole.half)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def estimate(folder: Path) -> pd.DataFrame:
    """Coefficients of water's correction, of R ("R") and of R and T ("RT")."""
    centres = bin_centres()
    low, high = WINDOW["water"]
    centres = centres[(centres >= low) & (centres <= high)]
    tables = []
    for given, through in (("R", False), ("RT", True)):
        case = Case(folder, "water", through)
        learned = learn(case, (), True)
        assert learned is not None
        process, scale, limit = learned
        slopes = process.deviation[2] ** 2 * process.x.T @ process.weight / scale
        parts = list(given)
        table = pd.DataFrame({"part": np.repeat(parts, centres.size)})
        table.insert(0, "given", given)
        table["wavelength_nm"] = np.tile(centres, len(parts))
        table["coefficient"] = share(case, (), True) * slopes
        table["limit"] = limit
        tables.append(table)
    return pd.concat(tables)


if __name__ == "__main__":
    output = Path(sys.argv[2]) if len(sys.argv) > 2 else DATA
    estimate(Path(sys.argv[1])).to_csv(
        output / "water_regression.csv", index=False, float_format="%.5g"
    )
