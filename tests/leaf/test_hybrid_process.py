"""The Gaussian process of `tests.benchmarks.leaf_hybrid`, on made-up campaigns."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from tests.benchmarks.leaf_hybrid import Process

CAMPAIGNS, LEAVES, INPUTS = 6, 60, 5


def _process(shared: float, own: float) -> tuple[Process, np.ndarray]:
    """Of errors with slopes that all campaigns share and slopes of their own, and the former."""
    draw = np.random.default_rng(0)
    common = shared * draw.normal(size=INPUTS)
    x, y = [], []
    for _ in range(CAMPAIGNS):
        x.append(draw.normal(size=(LEAVES, INPUTS)) / np.sqrt(INPUTS))
        slopes = common + own * draw.normal(size=INPUTS)
        y.append(0.1 * draw.normal() + x[-1] @ slopes + 0.05 * draw.normal(size=LEAVES))
    campaign = np.repeat([f"c{i}" for i in range(CAMPAIGNS)], LEAVES)
    species = np.tile([f"s{i}" for i in range(LEAVES // 2)], 2 * CAMPAIGNS)
    return Process(np.concatenate(y), np.concatenate(x), campaign, species, campaign), common


def test_only_what_campaigns_share_reaches_a_new_one():
    """Shared slopes are found; those of single campaigns widen the interval of a new one."""
    x = np.random.default_rng(1).normal(size=(200, INPUTS)) / np.sqrt(INPUTS)
    process, common = _process(0.5, 0.05)
    np.testing.assert_allclose(process.predict(x).log, x @ common, atol=0.1)
    process, _ = _process(0.0, 0.5)
    assert process.deviation[3] == pytest.approx(0.5, rel=0.3)
    assert process.predict(x).log.std() < 0.15
    draw = np.random.default_rng(2)
    slopes = 0.5 * draw.normal(size=(INPUTS, 500))
    new = x @ slopes + 0.1 * draw.normal(size=500) + 0.05 * draw.normal(size=(200, 500))
    held = np.abs(new) < process.predict(x).half[:, None]
    assert 0.88 < held.mean() < 0.97


def test_the_slope_of_the_marginal_likelihood():
    """Against differences."""
    process, _ = _process(0.3, 0.2)
    at = process.guess + 0.1
    _, slope = process._surprise(at)
    by_differences = approx_fprime(at, lambda log: process._surprise(log)[0], 1e-6)
    np.testing.assert_allclose(slope, by_differences, rtol=1e-3, atol=1e-3)
