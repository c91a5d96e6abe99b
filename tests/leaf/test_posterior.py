"""The sampler against the closed form, the Laplace fit, and simulated truth."""

import sys
import time

import jax
import numpy as np
import pytest

from fynjax._core.errors import MissingExtraError
from fynjax.leaf import LeafParameters, fit_leaf, prospect, sample_leaf_posterior
from fynjax.leaf._problem import LeafSettings, make_setup
from tests.benchmarks.leaf_ranks import DRAWS, ranks, simulate

GRID = np.arange(400.0, 2501.0)
LEAF = prospect(LeafParameters())
R, T = np.asarray(LEAF.reflectance)[None], np.asarray(LEAF.transmittance)[None]


@pytest.mark.slow
def test_posterior_agrees_with_the_gaussian_of_the_fit_where_that_holds():
    start = time.process_time()
    posterior = sample_leaf_posterior(GRID, R, T, draws=2000, target=400.0)
    assert time.process_time() - start < 120
    fit = fit_leaf(GRID, R, T)
    assert posterior.names == fit.names
    assert posterior.status.tolist() == ["converged"]
    texts = [x for x in jax.tree.leaves(posterior) if x.dtype.kind == "U"]
    assert len(texts) == 1  # no text is a part of the structure, by which functions compile
    for i, name in enumerate(fit.names):
        if name in ("structure", "chlorophyll", "water", "dry_matter"):
            draws, spread = posterior.samples[0, :, i], fit.standard_deviation[0, i]
            centre = float(np.asarray(getattr(fit.parameters, name))[0])
            assert abs(np.median(draws) - centre) < 0.3 * spread, name
            assert 0.75 < draws.std() / spread < 1.3, name
    spread = fit.transmittance_deviation[0]
    inner = fit.transmittance[0] > 2 * spread  # elsewhere draws end at T = 0
    assert inner[10:-10].mean() > 0.7
    deviation = posterior.transmittance[0].std(0)
    inner[:10] = inner[-10:] = False
    np.testing.assert_allclose(deviation[inner], spread[inner], rtol=0.35)


@pytest.mark.study
def test_the_two_samplers_agree():
    """Ensemble and Hamiltonian draws share nothing but the density."""
    pytest.importorskip("blackjax", reason="the extra `posterior` is not installed")
    posteriors = [
        sample_leaf_posterior(GRID, R, T, draws=6000, target=1500.0, sampler=name)
        for name in ("emcee", "nuts")
    ]
    assert [p.status.tolist() for p in posteriors] == [["converged"]] * 2
    for i in range(len(posteriors[0].names)):
        emcee, nuts = (f.samples[0, :, i] for f in posteriors)
        # Two means of 1500 effective draws differ by 0.04 sd.
        assert abs(emcee.mean() - nuts.mean()) < 0.14 * emcee.std()
        assert 0.9 < nuts.std() / emcee.std() < 1.1


@pytest.fixture
def simulated():
    """Leaves from prior and error model: the truth, and the problems that they pose."""
    setup = make_setup(LeafSettings())
    return setup, *simulate(setup, 24, 0, reflectance_only=False)


@pytest.mark.study
def test_the_truth_has_any_rank_among_the_draws(simulated):
    """`python -m tests.benchmarks.leaf_ranks` does so with hundreds of leaves."""
    setup, truth, problems = simulated
    rank, short = ranks(setup, truth, problems, "emcee")
    assert short == 0
    # Uniform ranks have this mean and spread; both within four standard errors.
    share = (rank + 0.5) / (DRAWS + 1)
    error = 12**-0.5 / rank.shape[0] ** 0.5
    assert np.all(np.abs(share.mean(axis=0) - 0.5) < 4.0 * error)
    inside = np.mean(np.abs(share - 0.5) < 0.34)
    assert inside == pytest.approx(0.68, abs=4.0 * (0.68 * 0.32 / rank.size * 2.0) ** 0.5)


def test_a_missing_extra_names_the_line_to_type(monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(MissingExtraError, match=r'pip install "fynjax\[posterior\]"'):
        sample_leaf_posterior(GRID, R, sampler="nuts")
    with pytest.raises(ValueError, match="sampler"):
        sample_leaf_posterior(GRID, R, sampler="gibbs")


def test_an_empty_leaf_fails_alone():
    both = np.concatenate([R, np.full_like(R, np.nan)])
    posterior = sample_leaf_posterior(GRID, both, draws=16, target=50.0, max_steps=300)
    assert posterior.status[1].startswith("failed")
    assert np.isnan(posterior.samples[1]).all()
    assert np.isfinite(posterior.samples[0]).all()
    again = sample_leaf_posterior(GRID, both, draws=16, target=50.0, max_steps=300)
    np.testing.assert_array_equal(again.samples, posterior.samples)
