"""Leaf traits of campaigns left out: `python -m tests.benchmarks.leaf_campaigns`.

Each campaign is left out in turn:
error model, prior and discrepancy of traits are estimated from the others, PLSR is trained on the
others (the number of components, and whether of the logarithm, by leaving out one of these in turn;
by folds if only one is left). Beside them plain PROSPECT: least squares with independent errors in
the published sub-domains, every leaf as a broad one without gaps. Of each: root mean square error,
bias, share of the measured values in the 90 % interval, and median width of that. The differences
of root mean square errors have 90 % intervals by bootstrap over species. Units: ug cm-2 of
pigments, mg cm-2 of water and dry matter.
"""

import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.cross_decomposition import PLSRegression
from sklearn.model_selection import KFold, cross_val_predict

from fynjax.leaf import ErrorModel, LeafFit, fit_leaf
from fynjax.leaf._error_model import bin_centres, default_error_model
from tests.benchmarks._measure import data_folder, options
from tools.estimate_error_model import (
    CAMPAIGNS,
    CHEMISTRY,
    LeafSet,
    estimate,
    independent_error_model,
    read,
)

UNIT = {"chlorophyll": 1.0, "carotenoids": 1.0, "water": 1e3, "dry_matter": 1e3}
COMPONENTS = (2, 4, 6, 8, 10, 12, 15, 20)
DRAWS = 1000


class Estimate(NamedTuple):
    """A trait of each leaf by one method, and its 90 % interval where the method has one."""

    value: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def physics(leaves: LeafSet, through: bool, model: ErrorModel | None) -> LeafFit:
    """fynjax, or plain PROSPECT without an error model."""
    t = leaves.spectra[:, 1] if through else None
    if model is not None:
        return fit_leaf(
            bin_centres(), leaves.spectra[:, 0], t,
            measurement=leaves.measurement(), leaf_shape=leaves.shape, error_model=model,
        )  # fmt: skip
    swir = np.isfinite(leaves.spectra[:, 0, bin_centres() > 1700]).any()
    return fit_leaf(
        bin_centres(), leaves.spectra[:, 0], t,
        domain="optimal" if swir else "full", error_model=independent_error_model(0.01),
    )  # fmt: skip


def of_fit(fit: LeafFit, trait: str) -> Estimate:
    i, unit = fit.names.index(trait), UNIT[trait]
    value = np.asarray(getattr(fit.parameters, trait))
    return Estimate(unit * value, unit * fit.lower[:, i], unit * fit.upper[:, i])


def predictors(leaves: LeafSet, through: bool, bands: np.ndarray) -> np.ndarray:
    chosen = leaves.spectra[:, :, bands]
    return chosen.reshape(len(chosen), -1) if through else chosen[:, 0]


def regression(others: Sequence[LeafSet], leaves: LeafSet, trait: str, through: bool) -> Estimate:
    """PLSR trained on `others`; NaN where no campaign measured the trait at these bands.

    Its interval is the 90 % quantile of its own errors on the campaigns left out of it.
    """
    centres = bin_centres()
    part = slice(None) if through else slice(0, 1)
    measured = np.isfinite(leaves.spectra[:, part]).all(1).mean(0) > 0.9
    bands = measured & (centres >= 450) & (centres <= 2400)
    x, y, group = [], [], []
    for other in others:
        inputs, truth = predictors(other, through, bands), UNIT[trait] * other.measured(trait)
        have = np.isfinite(inputs).all(1) & np.isfinite(truth)
        x.append(inputs[have])
        y.append(truth[have])
        group += [other.campaign] * int(have.sum())
    x_all, y_all, groups = np.concatenate(x), np.concatenate(y), np.array(group)
    target = predictors(leaves, through, bands)
    usable = np.isfinite(target).all(1)
    value = np.full(len(target), np.nan)
    if y_all.size < 20:
        return Estimate(value, value, value)
    names = np.unique(groups)
    best, error = (np.inf, 0, False), np.zeros(0)
    for log in (False, True):
        into, back = (np.log, np.exp) if log else (np.asarray, np.asarray)
        for components in COMPONENTS:
            model = PLSRegression(components, scale=False)
            guess = np.full(y_all.size, np.nan)
            if names.size == 1:
                folds = KFold(5, shuffle=True, random_state=0)
                guess = back(cross_val_predict(model, x_all, into(y_all), cv=folds).ravel())
            for name in names if names.size > 1 else ():
                kept = groups != name
                if kept.sum() > components + 2:
                    trained = model.fit(x_all[kept], into(y_all[kept]))
                    guess[~kept] = back(trained.predict(x_all[~kept]).ravel())
            off = guess - y_all
            score = np.mean([
                np.sqrt(np.nanmean(off[groups == n] ** 2)) / y_all[groups == n].std() for n in names
            ])  # fmt: skip
            if score < best[0]:
                best, error = (score, components, log), off
    _, components, log = best
    into, back = (np.log, np.exp) if log else (np.asarray, np.asarray)
    model = PLSRegression(components, scale=False).fit(x_all, into(y_all))
    value[usable] = back(model.predict(target[usable]).ravel())
    half = np.nanquantile(np.abs(error), 0.9)
    return Estimate(value, value - half, value + half)


def rmse(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def difference(a: np.ndarray, b: np.ndarray, species: np.ndarray) -> tuple[float, float, float]:
    """Root mean square of errors `a` less that of `b`, and its 90 % interval over species."""
    names, member = np.unique(species, return_inverse=True)
    count = np.bincount(member)
    squares = [np.bincount(member, e**2) for e in (a, b)]
    random = np.random.default_rng(0)
    picked = random.integers(0, names.size, (DRAWS, names.size))
    total = count[picked].sum(1)
    drawn = [np.sqrt(s[picked].sum(1) / total) for s in squares]
    low, high = np.quantile(drawn[0] - drawn[1], [0.05, 0.95])
    return rmse(a) - rmse(b), float(low), float(high)


def report(leaves: LeafSet, trait: str, given: str, methods: dict[str, Estimate]) -> None:
    """Print a line a method, the first of which the others are compared with."""
    truth = UNIT[trait] * leaves.measured(trait)
    known = np.isfinite(truth) & np.all([np.isfinite(m.value) for m in methods.values()], axis=0)
    errors = {name: (m.value - truth)[known] for name, m in methods.items()}
    first = next(iter(errors))
    for name, method in methods.items():
        inside = ((truth >= method.lower) & (truth <= method.upper))[known].mean()
        width = np.median((method.upper - method.lower)[known])
        line = f"{leaves.name:25s} {given:2s} {trait:11s} {known.sum():3d} {name:9s}"
        line += f" {rmse(errors[name]):6.2f} bias {errors[name].mean():+6.2f}"
        line += f" | 90 %: {100 * inside:3.0f} % in, width {width:5.1f}"
        if name != first:
            gain = difference(errors[first], errors[name], leaves.species()[known])
            line += " | {} less it {:+.2f} ({:+.2f} to {:+.2f})".format(first, *gain)
        print(line, flush=True)


def transmittance(leaves: LeafSet, fits: dict[str, LeafFit]) -> None:
    """T predicted from R alone: of one leaf, though in mats it was measured of many."""
    inner = (bin_centres() >= 450) & (bin_centres() <= 2400)
    weight = np.gradient(bin_centres())[inner]
    for name, fit in fits.items():
        error = (leaves.spectra[:, 1] - fit.transmittance)[:, inner]
        have = np.isfinite(error)
        square = np.average(np.where(have, error, 0.0) ** 2, weights=have * weight)
        held = np.abs(error) < 1.645 * fit.transmittance_deviation[:, inner]
        share = np.average(held, weights=have * weight)
        print(
            f"{leaves.name:25s} R  T {name:9s} {np.sqrt(square):.4f} | 90 %: {100 * share:.0f} % in"
        )


def some(leaves: LeafSet, count: int) -> LeafSet:
    """The first leaves of a set."""
    return replace(leaves, spectra=leaves.spectra[:count], chemistry=leaves.chemistry.iloc[:count])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print every figure."""
    tiny, folder = options(__doc__).parse_args(arguments).tiny, data_folder() / "leaf"
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # PLSR of more parts than there are
        for campaign in CAMPAIGNS[:1] if tiny else CAMPAIGNS:
            names = [name for name in CAMPAIGNS if name != campaign][: 2 if tiny else None]
            judge(folder, campaign, names, tiny)
    print(f"{time.process_time() - start:.0f} CPU s")


def judge(folder: Path, campaign: str, names: Sequence[str], tiny: bool) -> None:
    """Print a campaign's figures by what the campaigns `names` say; of 30 leaves of each, with the
    shipped error model, where `tiny`."""
    model = default_error_model() if tiny else estimate(folder, names)
    most = 30 if tiny else None
    others = [some(leaves, most) for name in names for leaves in read(folder, name)]
    for leaves in (some(leaves, most) for leaves in read(folder, campaign)):
        both = np.isfinite(leaves.spectra[:, 1]).any()
        for given in ("RT", "R") if both else ("R",):
            through = given == "RT"
            fits = {
                "fynjax": physics(leaves, through, model),
                "PROSPECT": physics(leaves, through, None),
            }
            if both and not through:
                transmittance(leaves, fits)
            for trait in CHEMISTRY:
                if not np.isfinite(leaves.measured(trait)).any():
                    continue
                methods = {name: of_fit(fit, trait) for name, fit in fits.items()}
                trained = regression(others, leaves, trait, through)
                if np.isfinite(trained.value).any():
                    methods["PLSR"] = trained
                report(leaves, trait, given, methods)


if __name__ == "__main__":
    main()
