"""Grain, thinning, bootstrap and distributions of heights."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from fynjax._core.errors import InputError
from fynjax.metrics import (
    StructureSettings,
    bin_returns,
    bootstrap_interval,
    cell_grid,
    cell_structure,
    central_interval,
    choose_grain,
    height_intersection,
    height_percentiles,
    height_shares,
    thinnings,
)
from tests.metrics.structure_clouds import fynbos_returns


def at_grains(grains, number=1317):
    returns = fynbos_returns(number)
    return [
        cell_structure(bin_returns(*returns, cell_grid((0, 0, 10, 10), g), StructureSettings()))
        for g in grains
    ]


def with_means(structure, value):
    """The same cells with one number everywhere."""
    metrics = {name: np.full_like(v, value) for name, v in structure.metrics.items()}
    return replace(structure, metrics=metrics)


def test_grain_by_the_papers_rule() -> None:
    """13.17 returns for each square metre are too few in cells of 1 m, and enough in 2 m."""
    grid, checks = choose_grain(at_grains((1.0, 2.0, 3.0, 4.0, 5.0)))
    assert [c.cells for c in checks] == [100, 25, 9, 4, 4]
    assert [c.fits for c in checks] == [False, True, True, True, True]
    assert checks[0].median_returns == pytest.approx(13, abs=1)
    assert checks[1].median_returns == pytest.approx(52, abs=4)
    assert grid.grain == 2.0
    assert checks[1].median_change < 0.1
    assert checks[-1].median_change is None
    assert [c.bounds[2:] for c in checks] == [(10, 10), (10, 10), (9, 9), (8, 8), (10, 10)]


def test_grain_does_not_change_by_chance() -> None:
    """The paper's density, drawn twelve times: always its 2 m, as its 17.9 and 6.1 % ask for."""
    for seed in range(12):
        returns = fynbos_returns(1317, seed=seed)
        found = [
            cell_structure(bin_returns(*returns, cell_grid((0, 0, 10, 10), g), StructureSettings()))
            for g in (1.0, 2.0, 3.0, 4.0, 5.0)
        ]
        assert choose_grain(found)[0].grain == 2.0
    found = at_grains((1.0, 2.0, 3.0, 4.0, 5.0), number=20_000)
    paper = [with_means(one, v) for one, v in zip(found, (1.0, 1.179, 1.251, 1.25, 1.25))]
    assert choose_grain(paper)[0].grain == 2.0


@pytest.mark.parametrize(
    ("means", "limit", "grain"),
    [
        ((1.0, 2.0, 2.1, 2.3, 9.0), None, 2.0),  # changes of 100, 5, 10 and 290 %
        ((1.0, 2.0, 2.4, 2.5, 2.5), None, 4.0),  # of 100, 20, 4 and 0 %
        ((1.0, 2.0, 2.0, 2.0, 2.0), None, 2.0),  # equals: the smallest
        ((1.0, 2.0, 2.4, 2.5, 2.5), 0.05, 3.0),  # the smallest below a limit
        ((1.0, 2.0, 4.0, 7.0, 16.0), 0.05, 3.0),  # none below it: the least
    ],
)
def test_grain_of_least_change(means, limit, grain) -> None:
    found = at_grains((1.0, 2.0, 3.0, 4.0, 5.0))
    found = [with_means(one, value) for one, value in zip(found, means)]
    grid, checks = choose_grain(found, largest_change=limit)
    assert grid.grain == grain
    for check, a, b in zip(checks, means, means[1:], strict=False):
        assert check.median_change == pytest.approx(abs(b - a) / a)
        assert check.largest_change == pytest.approx(abs(b - a) / a)


def test_no_grain_fits() -> None:
    with pytest.raises(InputError, match=r"1 m: 0 % of 100 cells"):
        choose_grain(at_grains((1.0, 2.0), number=60))
    with pytest.raises(InputError, match="must grow"):
        choose_grain(at_grains((2.0, 1.0)))


def test_thinning_draws_without_replacement_and_evenly() -> None:
    rng = np.random.default_rng(1)
    count = np.zeros(500)
    first = []
    for index in thinnings(500, 120, 400, rng):
        assert len(np.unique(index)) == len(index) == 120
        assert index.min() >= 0
        assert index.max() < 500
        count[index] += 1
        first.append(tuple(index))
    assert len(set(first)) == 400
    # Each return is drawn as often as any other: binomial, with 400 x 0.24 expected.
    expected, spread = 400 * 0.24, np.sqrt(400 * 0.24 * 0.76)
    assert abs(count - expected).max() < 4.5 * spread
    assert count.std() == pytest.approx(spread, rel=0.15)
    same = [next(iter(thinnings(500, 120, 1, np.random.default_rng(7)))) for _ in range(2)]
    np.testing.assert_array_equal(*same)
    np.testing.assert_array_equal(next(iter(thinnings(5, 5, 1, rng))), np.arange(5))
    with pytest.raises(InputError, match="thin"):
        next(iter(thinnings(5, 6, 1, rng)))


def test_bootstrap_against_scipy_and_the_normal_law() -> None:
    values = np.random.default_rng(2).normal(3.0, 0.8, 400)
    low, high = bootstrap_interval(values, rng=np.random.default_rng(3))
    peer = stats.bootstrap(
        (values,), np.mean, n_resamples=1000, method="percentile", rng=np.random.default_rng(3)
    ).confidence_interval
    assert (low, high) == (peer.low, peer.high)
    half = 1.96 * values.std() / 20.0
    assert low == pytest.approx(values.mean() - half, abs=0.12 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.12 * half)
    narrower = bootstrap_interval(values, confidence=0.5, rng=np.random.default_rng(3))
    assert low < narrower[0] < narrower[1] < high
    assert bootstrap_interval([1.0], rng=np.random.default_rng(3)) is None


def test_central_interval() -> None:
    assert central_interval(np.arange(1001.0)) == pytest.approx((25.0, 975.0))
    assert central_interval(np.arange(1001.0), 0.5) == pytest.approx((250.0, 750.0))


def test_heights_agree() -> None:
    one = np.array([0.0, 0.05, 0.1, 0.3, 0.3])
    np.testing.assert_allclose(height_shares(one, 0.1, 4), [0.4, 0.2, 0.0, 0.4])
    np.testing.assert_allclose(height_shares(one, 0.1, 2), [0.4, 0.6])  # higher ones in the last
    assert height_intersection(one, one, 0.1) == pytest.approx(1.0)
    assert height_intersection(one, one + 1.0, 0.1) == 0.0
    assert height_intersection(one, one + 0.1, 0.1) == pytest.approx(0.2)
    x, y = (np.random.default_rng(s).gamma(4.0, 0.16 + 0.04 * s, 20_000) for s in (0, 1))
    edges = np.arange(0.0, 9.0, 0.1)
    shares = [np.histogram(v, edges)[0] / 20_000 for v in (x, y)]
    assert height_intersection(x, y, 0.1) == pytest.approx(np.minimum(*shares).sum(), abs=1e-12)
    # Never more than one minus the Kolmogorov-Smirnov distance, but for the width of a bin.
    assert height_intersection(x, y, 0.1) <= 1.0 - stats.ks_2samp(x, y).statistic + 0.03
    got = height_percentiles(x, (5.0, 50.0, 95.0))
    np.testing.assert_allclose(got, stats.gamma(4.0, scale=0.16).ppf([0.05, 0.5, 0.95]), rtol=0.03)
