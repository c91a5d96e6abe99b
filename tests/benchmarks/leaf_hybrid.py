"""Physics plus regression of leaf traits: `python -m tests.benchmarks.leaf_hybrid [FOLDER]`.

FOLDER holds the leaf data (default: `FYNJAX_SHARED_DATA`/leaf). Two ways to correct what
`fit_leaf` says. Of these the package has the second for water (`regress_water`); elsewhere none is
better than the fit in most sets:

- *process*: a Gaussian process on the logarithm of measured over fitted trait, linear in the
  derivative along the wavelength of log(measured / fitted spectrum), which no change of brightness
  moves. Campaigns and species have random effects, campaigns also slopes of their own, so that only
  the slopes that campaigns share reach a new one. Standard deviations by marginal likelihood.
- *centred*: the same with the derivatives less their median in the set, as if all spectra that are
  fitted together were of one campaign and it said nothing of the campaign's mean.

Nested: of the campaign that is judged nothing enters. How much of a process's correction is applied
(nothing to all) is decided by the other campaigns, each predicted by the rest,
with error models that exclude both.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.benchmarks.leaf_campaigns import UNIT, difference, leaf_folder, rmse
from tools.estimate_error_model import CHEMISTRY, LeafSet
from tools.estimate_regression import (
    Case,
    Correction,
    log_error,
    process,
    sets_of,
)

METHODS: dict[str, Callable[[Case, LeafSet], Correction | None]] = {
    "process": lambda case, leaves: process(case, leaves, False),
    "centred": lambda case, leaves: process(case, leaves, True),
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
