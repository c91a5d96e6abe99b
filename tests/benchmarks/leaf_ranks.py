"""Rank histograms of a leaf's posterior: `python -m tests.benchmarks.leaf_ranks [--leaves 200]`.

Simulation-based calibration (Talts et al. 2018, arXiv:1804.06788): traits drawn from the prior,
spectra of them by PROSPECT with an error drawn from the error model, and the posterior of each
sampled as `sample_leaf_posterior` does, without what a leaf that fits badly has its errors grown
by. The rank of the truth among the draws must be uniform. Printed: the p value of that for each
parameter, and coverage. `--save FILE.png` draws the histograms.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy import stats

from fynjax._core.progress import progress, track
from fynjax._core.sampling import Ensemble, Hamiltonian
from fynjax.leaf._error_model import bin_centres
from fynjax.leaf._posterior import free_columns, leaf_density, of_many
from fynjax.leaf._problem import LeafSettings, Setup, leaf_problems, make_setup
from fynjax.leaf._residual import MeasuredLeaf, observed, solve, to_physical
from tests.benchmarks._measure import options

DRAWS = 63
BINS = 8


def simulate(
    setup: Setup, count: int, seed: int, reflectance_only: bool
) -> tuple[np.ndarray, MeasuredLeaf]:
    """True z of the free parameters [leaf, free], and each leaf's problem."""
    random = np.random.default_rng(seed)
    columns = free_columns(setup)
    spread = np.diagonal(setup.prior_precision) ** -0.5
    z = np.tile(setup.prior_mean, (count, 1))
    z[:, columns] += spread[columns] * random.normal(size=(count, columns.size))
    seen = jax.vmap(lambda one: observed(to_physical(one, setup.optics), setup.optics))(z)
    shared = np.einsum(
        "lf,fsb->lsb", random.normal(size=(count, len(setup.factors))), setup.factors
    )
    own = np.sqrt(setup.noise**2 + setup.distrust**2)
    data = np.asarray(seen) + shared + own * random.normal(size=seen.shape)
    centres = bin_centres()
    use = np.broadcast_to((centres >= 445.0) & (centres <= 2405.0), data.shape).copy()
    if reflectance_only:
        use[:, 1] = False
    prior = (np.tile(setup.prior_mean, (count, 1)), np.tile(setup.prior_precision, (count, 1, 1)))
    return z[:, columns], leaf_problems(setup, data, use, prior, np.ones(count))


def ranks(
    setup: Setup, truth: np.ndarray, problems: MeasuredLeaf, sampler: str, seed: int = 0
) -> tuple[np.ndarray, int]:
    """Rank of the truth among `DRAWS` draws [leaf, free], and how many chains fell short."""
    columns = free_columns(setup)
    state = solve(np.tile(setup.prior_mean, (len(truth), 1)), problems, setup.factors, setup.optics)
    random = np.random.default_rng([seed, 1])
    found, short = [], 0
    for i, true in enumerate(track(truth, "Leaves")):
        density = leaf_density(setup, MeasuredLeaf(*(part[i] for part in problems)))
        covariance = np.linalg.inv(state.hessian[i])[np.ix_(columns, columns)]
        options: dict[str, Any] = {"target": 4.0 * DRAWS, "steps": 20_000, "seed": seed + i}
        if sampler == "emcee":
            start = random.multivariate_normal(state.z[i, columns], covariance, 32)
            drawn = Ensemble(partial(of_many, density), start, **options).run()
        else:
            start = random.multivariate_normal(state.z[i, columns], covariance, 4)
            drawn = Hamiltonian(density, start, covariance, **options).run()
        short += drawn.status != "converged"
        flat = drawn.chain.reshape(-1, columns.size)
        picked = flat[random.choice(len(flat), DRAWS, replace=False)]
        found.append((picked < true).sum(axis=0))
    return np.array(found), short


def uniform(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Counts in `BINS` bins [bin, free], and the chance of as uneven ones (chi square)."""
    counts = np.stack(
        [np.bincount(r * BINS // (DRAWS + 1), minlength=BINS) for r in found.T], axis=1
    )
    return counts, stats.chisquare(counts, axis=0).pvalue


def gaussian_scores(setup: Setup, truth: np.ndarray, problems: MeasuredLeaf) -> np.ndarray:
    """Truth less estimate over standard deviation of the fit's Gaussian [leaf, free]."""
    columns = free_columns(setup)
    state = solve(np.tile(setup.prior_mean, (len(truth), 1)), problems, setup.factors, setup.optics)
    deviation = np.sqrt(np.diagonal(np.linalg.inv(state.hessian), axis1=1, axis2=2))
    return (truth - state.z[:, columns]) / deviation[:, columns]


def draw(counts: np.ndarray, names: Sequence[str], path: Path) -> None:
    from matplotlib.figure import Figure

    from fynjax.app.report.figures._style import BLUE, GREY, save_figure, style

    total = counts[:, 0].sum()
    low, high = stats.binom.interval(0.95, total, 1.0 / BINS)
    with style():
        figure = Figure(figsize=(1.9 * len(names), 2.2))
        for axes, name, column in zip(figure.subplots(1, len(names), sharey=True), names, counts.T):
            axes.axhspan(low, high, color=GREY, alpha=0.3, lw=0)
            axes.bar(np.arange(BINS), column, width=0.9, color=BLUE)
            axes.set_title(name, fontsize=9)
            axes.set_xticks([])
        figure.supxlabel("rank of the truth among the draws", fontsize=9)
        figure.supylabel("leaves", fontsize=9)
    save_figure(figure, path)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--leaves", type=int, default=200)
    parser.add_argument("--sampler", choices=("emcee", "nuts"), default="emcee")
    parser.add_argument("--reflectance-only", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path)
    given = parser.parse_args(arguments)
    given.leaves = 1 if given.tiny else given.leaves
    setup = make_setup(LeafSettings())
    truth, problems = simulate(setup, given.leaves, given.seed, given.reflectance_only)
    with progress():
        found, short = ranks(setup, truth, problems, given.sampler, given.seed)
    counts, chance = uniform(found)
    inside = [np.abs(found / DRAWS - 0.5) <= level / 2 for level in (0.68, 0.95)]
    score = gaussian_scores(setup, truth, problems)
    width = max(map(len, setup.free))
    print(f"{given.leaves} leaves, {DRAWS} draws each, {short} chains short of convergence")
    print(f"{'':<{width}}  p uniform   68 %   95 %   of the Gaussian: 68 %   95 %   counts")
    for i, name in enumerate(setup.free):
        own = [np.mean(np.abs(score[:, i]) < limit) for limit in (1.0, 1.96)]
        print(
            f"{name:<{width}}  {chance[i]:>9.3f}  {inside[0][:, i].mean():.3f}  "
            f"{inside[1][:, i].mean():.3f}                   {own[0]:.3f}  {own[1]:.3f}   "
            f"{' '.join(map(str, counts[:, i]))}"
        )
    error = np.sqrt(0.68 * 0.32 / given.leaves), np.sqrt(0.95 * 0.05 / given.leaves)
    print(f"binomial error of a share: {error[0]:.3f} at 68 %, {error[1]:.3f} at 95 %")
    if given.save is not None:
        draw(counts, setup.free, given.save)


if __name__ == "__main__":
    main()
