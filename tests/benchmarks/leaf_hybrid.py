"""Physics plus regression of leaf traits: `python -m tests.benchmarks.leaf_hybrid [FOLDER]`.

FOLDER holds the leaf data (default: `FYNJAX_SHARED_DATA`/leaf). Three ways to correct what
`fit_leaf` says, none of which the package uses, since none is better than the fit in most sets and
traits:

- *process*: a Gaussian process on the logarithm of measured over fitted trait, linear in the
  derivative along the wavelength of log(measured / fitted spectrum), which no change of brightness
  moves. Campaigns and species have random effects, campaigns also slopes of their own, so that only
  the slopes that campaigns share reach a new one. Standard deviations by marginal likelihood.
- *centred*: the same with the derivatives less their median in the set, as if all spectra that are
  fitted together were of one campaign and it said nothing of the campaign's mean.
- *without T*: the logarithms of the fits to R and T and to R alone, with a weight.

Nested: of the campaign that is judged nothing enters. How much of a process's correction is applied
(nothing to all), and the weight, is decided by the other campaigns, each predicted by the rest,
with error models that exclude both.
"""

import sys
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.stats import t as student

from fynjax.leaf import LeafFit
from fynjax.leaf._error_model import bin_centres
from fynjax.leaf.data.estimate_error_model import (
    CAMPAIGNS,
    CHEMISTRY,
    LeafSet,
    estimate_spectral,
    read,
)
from tests.benchmarks.leaf_campaigns import UNIT, difference, leaf_folder, physics, rmse

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
WINDOW = {"chlorophyll": 500, "carotenoids": 450, "water": 1000, "dry_matter": 1100}
"""Where the derivatives of a trait begin [nm]; those of pigments end at 780, others at 2400."""
SMOOTHING = 15.0


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
    return physics(leaves, through, estimate_spectral(sets))


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
    """Smoothed derivative of log(measured / fitted) of R, and of T if known [leaf, number]."""
    centres = bin_centres()
    end = 780.0 if case.trait in ("chlorophyll", "carotenoids") else 2400.0
    inside = (centres >= WINDOW[case.trait]) & (centres <= end)
    at = centres[inside]
    near = np.exp(-0.5 * ((at[:, None] - at) / SMOOTHING) ** 2)
    near /= near.sum(1, keepdims=True)
    of, parts = fitted(case, leaves, without), []
    for part in range(2 if case.through else 1):
        measured = np.maximum(leaves.spectra[:, part, inside], 0.005)
        ratio = np.log(measured / np.maximum(of.fitted[:, part, inside], 0.005))
        for row in ratio:
            have = np.isfinite(row)
            row[:] = np.interp(at, at[have], row[have]) if have.any() else 0.0
        parts.append(np.gradient(ratio @ near.T, at, axis=1))
    return np.concatenate(parts, axis=1)


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


def by_process(
    case: Case, leaves: LeafSet, without: tuple[str, ...], centred: bool
) -> Correction | None:
    """Correction learned from all campaigns but those in `without`; none from a single one."""
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
    x, new = np.concatenate(inputs), derivatives(case, leaves, without)
    new = new - np.median(new, axis=0) if centred else new
    # Leaves beyond those known count as at their edge.
    limit = np.quantile(np.linalg.norm(x, axis=1), 0.95)
    x, new = (
        a * np.minimum(1.0, limit / np.maximum(np.linalg.norm(a, axis=1), 1e-12))[:, None]
        for a in (x, new)
    )
    scale = np.sqrt((x**2).sum(1).mean())
    process = Process(np.concatenate(errors), x / scale, *labels)
    return process.predict(new / scale)


def process(case: Case, leaves: LeafSet, centred: bool) -> Correction | None:
    """The share of a process's correction that lowers the errors of the other campaigns most, and
    raises none by more than 5 %; none if that is by less than half a per cent."""
    home = leaves.campaign
    scores = []
    for other in sets_of(case, (home,)):
        gone = (home, other.campaign)
        if not sets_of(case, gone):
            continue
        found = by_process(case, other, gone, centred)
        assert found is not None
        error = log_error(case, other, gone)
        truth, have = other.measured(case.trait), np.isfinite(error)
        before = truth * np.exp(-error)
        ratios = []
        for share in SHARES:
            moved = rmse((before * np.exp(share * found.log) - truth)[have])
            logs = rmse((error - share * found.log)[have]) / rmse(error[have])
            ratios.append(0.5 * np.log(moved / rmse((before - truth)[have]) * logs))
        scores.append(ratios)
    whole = by_process(case, leaves, (home,), centred)
    if whole is None or not scores:
        return None
    table = np.array(scores)
    mean = np.where((table > 0.05).any(0), np.inf, table.mean(0))
    best = int(np.argmin(mean))
    share = SHARES[best] if mean[best] < -0.005 else 0.0
    return Correction(share * whole.log, whole.half)


def without_transmittance(case: Case, leaves: LeafSet) -> Correction | None:
    """Weighted mean of the fits with and without T: weight by least squares over the others."""
    if not case.through:
        return None

    def move(of: LeafSet, gone: Sequence[str]) -> np.ndarray:
        alone = fitted(case._replace(through=False), of, gone)
        return log_value(alone, case.trait) - log_value(fitted(case, of, gone), case.trait)

    gain, cost, left = 0.0, 0.0, []
    others = sets_of(case, (leaves.campaign,))
    for other in others:
        gone = (leaves.campaign, other.campaign)
        error, by = log_error(case, other, gone), move(other, gone)
        have = np.isfinite(error)
        size = np.mean(error[have] ** 2)
        gain += np.mean((error * by)[have]) / size
        cost += np.mean(by[have] ** 2) / size
        left.append((error[have], by[have]))
    weight = float(np.clip(gain / (cost + 0.2), 0.0, 1.0))
    rest = [np.mean((error - weight * by) ** 2) for error, by in left]
    half = student.ppf(0.95, max(len(rest) - 1, 1)) * np.sqrt(np.mean(rest))
    change = weight * move(leaves, (leaves.campaign,))
    return Correction(change, np.full(change.shape, half))


METHODS: dict[str, Callable[[Case, LeafSet], Correction | None]] = {
    "process": lambda case, leaves: process(case, leaves, False),
    "centred": lambda case, leaves: process(case, leaves, True),
    "without T": without_transmittance,
}


def report(case: Case, leaves: LeafSet) -> dict[str, tuple[float, float, float]]:
    """Print a line a method; difference of errors from the fit's, and its 90 % interval."""
    error = log_error(case, leaves, (leaves.campaign,))
    truth, have = UNIT[case.trait] * leaves.measured(case.trait), np.isfinite(error)
    before = truth * np.exp(-error)
    result = {}
    for name, method in METHODS.items():
        found = method(case, leaves)
        if found is None:
            continue
        after = before * np.exp(found.log)
        change = difference((after - truth)[have], (before - truth)[have], leaves.species()[have])
        held = np.mean(np.abs(error - found.log)[have] < found.half[have])
        result[name] = change
        print(
            f"{leaves.name:25s} {'RT' if case.through else 'R':2s} {case.trait:11s} {name:9s} "
            f"{rmse((before - truth)[have]):6.2f} to {rmse((after - truth)[have]):6.2f}, by "
            "{:+.2f} ({:+.2f} to {:+.2f})".format(*change)
            + f" | 90 %: {100 * held:3.0f} % in",
            flush=True,
        )
    return result


def main(folder: Path) -> None:
    """Print every figure and a count."""
    start = time.process_time()
    counts = {name: np.zeros(5, int) for name in METHODS}
    for through in (True, False):
        for trait in CHEMISTRY:
            case = Case(folder, trait, through)
            for leaves in sets_of(case):
                for name, (change, low, high) in report(case, leaves).items():
                    small = abs(change) < 0.005
                    kinds = (small, change < 0, high < 0, change > 0, low > 0)
                    counts[name] += [kinds[0], *(kind and not small for kind in kinds[1:])]
    for name, (same, better, surely, worse, surely_worse) in counts.items():
        print(f"{name}: as before {same}, better {better} (beyond the interval {surely}), "
              f"worse {worse} ({surely_worse})")  # fmt: skip
    print(f"{time.process_time() - start:.0f} CPU s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else leaf_folder())
