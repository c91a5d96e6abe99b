"""Diversity of covers: scikit-bio, plain loops, closed forms, difference quotients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import skbio.diversity.alpha as skbio

from fynjax.diversity import (
    additive_partition,
    bray_curtis,
    hill_evenness,
    hill_number,
    hill_partition,
    pielou_evenness,
    rao_entropy,
    richness,
    shannon,
    simpson,
)
from fynjax.errors import InputError

ORDERS = [0.0, 0.3, 0.9, 1.0, 1.1, 1.6, 2.0, 5.0, 40.0, np.inf]
DISTANCE = np.abs(np.subtract.outer(np.arange(5.0), np.arange(5.0))) / 4.0


def covers(seed: int = 0, plots: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    cover = rng.gamma(0.7, 20.0, size=(plots, 5))
    cover[0, 2] = cover[1, 0] = 0.0
    return cover


def test_indices_are_those_of_scikit_bio() -> None:
    """Compared with scikit-bio 0.7.4, which counts nothing of this package's code."""
    for cover in covers():
        assert float(richness(cover)) == skbio.sobs(cover)
        assert float(shannon(cover)) == pytest.approx(skbio.shannon(cover, base=np.e), rel=1e-12)
        assert float(simpson(cover)) == pytest.approx(skbio.simpson(cover), rel=1e-12)
        assert float(pielou_evenness(cover)) == pytest.approx(skbio.pielou_e(cover), rel=1e-12)
        for order in ORDERS:
            expected = skbio.hill(cover, order=order)
            assert float(hill_number(cover, order)) == pytest.approx(expected, rel=1e-10), order


@pytest.mark.parametrize("order", ORDERS)
def test_alike_species_count_in_full_and_absent_ones_not(order: float) -> None:
    cover = jnp.array([[3.0, 3.0, 3.0, 3.0, 0.0], [7.0, 0.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(hill_number(cover, order), [4.0, 1.0], rtol=1e-12)
    np.testing.assert_allclose(hill_number(100.0 * cover, order), [4.0, 1.0], rtol=1e-12)
    assert float(hill_evenness(cover[0], order)) == pytest.approx(1.0)


def test_order_one_is_a_smooth_limit() -> None:
    """On both sides of 1 the slope by the order is that of the closed form, down to 1e-12.

    With X = ln p under the weights p, d ln D / dq at 1 is -var(X) / 2.
    """
    cover = covers()[2]
    share = cover / cover.sum()
    mean = np.sum(share * np.log(share))
    variance = np.sum(share * (np.log(share) - mean) ** 2)
    at_one = float(hill_number(cover, 1.0))
    for step in (-1e-3, -1e-6, -1e-12, 1e-12, 1e-6, 1e-3):
        expected = at_one * np.exp(-0.5 * variance * step)
        assert float(hill_number(cover, 1.0 + step)) == pytest.approx(expected, rel=1e-6)
    assert float(hill_number(cover, 1.0 - 1e-13)) == pytest.approx(at_one, rel=1e-11)


def test_evenness_by_hill_is_zero_where_one_rules() -> None:
    assert float(hill_evenness([1e9, 1.0, 1.0, 1.0], 2.0)) == pytest.approx(0.0, abs=1e-8)
    share = np.array([0.5, 0.3, 0.2])
    expected = (1.0 / np.sum(share**2) - 1.0) / 2.0
    assert float(hill_evenness(10.0 * share, 2.0)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("order", [0.0, 0.5, 1.0, 2.0, 3.0])
def test_parts_of_hill_are_the_loops_of_jost(order: float) -> None:
    """Equation 11 of Jost (2007) with equal weights, in loops over plots and species."""
    cover = covers(1)
    share = [[c / sum(row) for c in row] for row in cover]
    pooled = [sum(row[i] for row in share) / len(share) for i in range(5)]

    def number(sums: float, entropy: float) -> float:
        return np.exp(entropy) if order == 1.0 else sums ** (1.0 / (1.0 - order))

    power = sum(p**order for row in share for p in row if p > 0) / len(share)
    entropy = -sum(p * np.log(p) for row in share for p in row if p > 0) / len(share)
    alpha = number(power, entropy)
    gamma = number(
        sum(p**order for p in pooled if p > 0), -sum(p * np.log(p) for p in pooled if p > 0)
    )
    parts = hill_partition(cover.reshape(2, 2, 5), order)
    assert float(parts.alpha) == pytest.approx(alpha, rel=1e-12)
    assert float(parts.gamma) == pytest.approx(gamma, rel=1e-12)
    assert float(parts.beta) == pytest.approx(gamma / alpha, rel=1e-12)


@pytest.mark.parametrize("order", [0.0, 0.5, 1.0, 2.0, 3.0])
def test_beta_counts_plots_that_share_nothing_or_all(order: float) -> None:
    apart = np.kron(np.eye(3), np.array([[5.0, 2.0]]))
    assert float(hill_partition(apart, order).beta) == pytest.approx(3.0, rel=1e-12)
    alike = np.array([[5.0, 2.0], [50.0, 20.0]])
    assert float(hill_partition(alike, order).beta) == pytest.approx(1.0, rel=1e-12)


def test_parts_of_an_index_add_up() -> None:
    cover = covers(2)
    share = cover / cover.sum(axis=1, keepdims=True)
    parts = additive_partition(cover, simpson)
    within = np.mean([1.0 - np.sum(row**2) for row in share])
    of_all = 1.0 - np.sum(share.mean(axis=0) ** 2)
    assert float(parts.alpha) == pytest.approx(within, rel=1e-12)
    assert float(parts.beta) == pytest.approx(of_all - within, rel=1e-12)
    entropy, numbers = additive_partition(cover), hill_partition(cover, 1.0)
    assert float(jnp.exp(entropy.beta)) == pytest.approx(float(numbers.beta), rel=1e-12)
    rao = additive_partition(cover, lambda c: rao_entropy(c, DISTANCE))
    assert 0.0 < float(rao.beta) < float(rao.gamma)


def test_bray_curtis_is_its_loop() -> None:
    cover = covers(3)
    got = bray_curtis(cover)
    for i, a in enumerate(cover):
        for j, b in enumerate(cover):
            expected = sum(abs(x - y) for x, y in zip(a, b)) / sum(x + y for x, y in zip(a, b))
            assert got[i, j] == pytest.approx(expected, rel=1e-12)


SLOPED = {
    "shannon": shannon,
    "simpson": simpson,
    "hill 0.5": lambda c: hill_number(c, 0.5),
    "hill 1.2": lambda c: hill_number(c, 1.2),
    "hill 2": lambda c: hill_number(c, 2.0),
    "hill 4": lambda c: hill_number(c, 4.0),
    "rao": lambda c: rao_entropy(c, DISTANCE),
    "pielou": pielou_evenness,
    "hill evenness": hill_evenness,
    "beta": lambda c: hill_partition(c.reshape(2, -1), 1.0).beta,
}


@pytest.mark.parametrize("name", SLOPED)
def test_slopes_are_difference_quotients(name: str) -> None:
    function = SLOPED[name]
    cover = jnp.asarray(covers()[2]) if name != "beta" else jnp.asarray(covers()[2:].ravel())
    slope = jax.grad(function)(cover)
    for i in range(len(cover)):
        step = jnp.zeros_like(cover).at[i].set(1e-4 * cover[i])
        quotient = (function(cover + step) - function(cover - step)) / (2e-4 * cover[i])
        assert float(slope[i]) == pytest.approx(float(quotient), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("name", SLOPED)
def test_slopes_at_zero_cover_are_finite(name: str) -> None:
    """In 64 and in 32 bits; where the slope exists (order above 1), it is the quotient's."""
    function = SLOPED[name]
    cover = jnp.array([20.0, 0.0, 5.0, 1.0, 0.0] * (2 if name == "beta" else 1))
    for precision in (jnp.float64, jnp.float32):
        slope = jax.jit(jax.grad(function))(cover.astype(precision))
        assert bool(jnp.isfinite(slope).all())
    if name in {"simpson", "hill 2", "hill 4", "rao"}:
        ahead = cover.at[1].set(1e-7)
        quotient = (function(ahead) - function(cover)) / 1e-7
        assert float(jax.grad(function)(cover)[1]) == pytest.approx(float(quotient), rel=1e-4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: shannon([1.0, -2.0]), "species 2 has -2"),
        (lambda: shannon([[1.0, 2.0], [np.nan, 1.0]]), "species 1 of plot 2 has nan"),
        (lambda: simpson([[1.0, 2.0], [0.0, 0.0]]), "every species of plot 2 has 0"),
        (lambda: richness(np.zeros((3, 0))), r"shape \(3, 0\)"),
        (lambda: hill_number([1.0], -1.0), "`order` must be at least 0, but is -1"),
        (lambda: hill_number([1.0], np.nan), "but is nan"),
        (lambda: hill_partition([[1.0], [1.0]], np.inf), "finite, but is inf"),
        (lambda: hill_partition([1.0, 2.0]), "two plots or more"),
        (lambda: pielou_evenness([[1.0, 1.0], [0.0, 2.0]]), "there is one of plot 2"),
        (lambda: hill_evenness([4.0]), "two species or more, but there is one"),
    ],
)
def test_wrong_covers_are_refused(call, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()
