"""Statistics of pixel distributions against NumPy; the overlap of two against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fynjax._core.errors import InputError
from fynjax.metrics import histogram_intersection, mean, quantiles, standard_deviation


def ndvi_like(seed: int, size: int, shift: float = 0.0, spread: float = 1.0) -> np.ndarray:
    """Skewed, bounded values like an NDVI image: most near 0.75, a tail of bare ground."""
    rng = np.random.default_rng(seed)
    plants = rng.beta(14.0, 4.5, size)
    bare = rng.beta(4.0, 6.0, size)
    mixed = np.where(rng.uniform(size=size) < 0.1, bare, plants)
    return 0.75 + spread * (mixed - 0.75) + shift


PROBABILITIES = np.array([0.0, 0.025, 0.5, 0.777, 1.0])


@jax.jit
def statistics(x: jax.Array, wx: jax.Array) -> dict[str, jax.Array]:
    return {
        "mean": mean(x, wx),
        "std": standard_deviation(x, wx),
        "quantiles": quantiles(x, jnp.asarray(PROBABILITIES, x.dtype), wx),
    }


def test_moments_and_quantiles() -> None:
    x = ndvi_like(2, 900)
    for keep in (np.ones(900, bool), np.random.default_rng(0).uniform(size=900) < 0.4):
        got = statistics(np.where(keep, x, np.nan), keep)
        assert float(got["mean"]) == pytest.approx(x[keep].mean(), rel=1e-13)
        assert float(got["std"]) == pytest.approx(x[keep].std(), rel=1e-12)
        expected = np.quantile(x[keep], PROBABILITIES)
        np.testing.assert_allclose(got["quantiles"], expected, rtol=1e-12)
    # Any shape, and without a mask.
    cube = x.reshape(5, 12, 15)
    assert float(mean(cube)) == pytest.approx(x.mean(), rel=1e-13)
    assert float(standard_deviation(cube)) == pytest.approx(x.std(), rel=1e-12)
    np.testing.assert_allclose(quantiles(cube, 0.25), [np.quantile(x, 0.25)], rtol=1e-12)


def test_masked_pixels_have_no_slope() -> None:
    """Half the pixels masked: the rest, taken twice, fill the same shape and weigh the same."""
    y = ndvi_like(1, 600)
    keep = np.random.default_rng(9).permutation(600) < 300
    masked = statistics(np.where(keep, y, 50.0), keep)
    doubled = statistics(np.tile(y[keep], 2), np.ones(600, bool))
    for name in ("mean", "std"):
        assert float(masked[name]) == pytest.approx(float(doubled[name]), rel=1e-12), name
    slopes = jax.jacrev(statistics)(np.where(keep, y, np.nan), keep)
    for name, slope in slopes.items():
        assert bool(jnp.all(jnp.isfinite(slope))), name
        assert not np.any(slope[..., ~keep]), name
        assert np.any(slope[..., keep]), name


def test_a_nan_that_is_not_masked_shows() -> None:
    x = ndvi_like(0, 900)
    holed = x.copy()
    holed[7] = np.nan
    for values, keep in ((holed, np.ones(900, bool)), (x, np.zeros(900, bool))):
        got = statistics(values, keep)
        assert all(np.all(np.isnan(value)) for value in got.values()), got
    assert np.isnan(histogram_intersection(holed, x))
    assert np.isnan(histogram_intersection(x, holed))
    assert np.isnan(histogram_intersection(x, []))


def test_equal_pixels_have_no_spread_and_no_slope() -> None:
    for size in (0.3, 0.1):  # neither is a sum of powers of two
        value, slope = jax.value_and_grad(standard_deviation)(jnp.full((4, 5), size))
        assert float(value) == 0.0
        np.testing.assert_array_equal(slope, 0.0)


def test_slopes() -> None:
    """Each output's derivative in each pixel, one by one, against central differences."""
    y = jnp.asarray(ndvi_like(3, 12))

    @jax.jit
    def outputs(v: jax.Array) -> jax.Array:
        parts = (mean(v), standard_deviation(v), quantiles(v, jnp.array([0.1, 0.33, 0.5, 0.9])))
        return jnp.concatenate([jnp.ravel(part) for part in parts])

    reverse = jax.jacrev(outputs)(y)
    np.testing.assert_allclose(jax.jacfwd(outputs)(y), reverse, rtol=1e-9, atol=1e-14)
    assert np.all(np.any(np.abs(reverse) > 1e-6, axis=1))  # every output moves
    for k in range(y.size):
        step = 1e-6 * jnp.zeros(y.size).at[k].set(1.0)
        difference = (outputs(y + step) - outputs(y - step)) / 2e-6
        np.testing.assert_allclose(reverse[:, k], difference, rtol=1e-5, atol=1e-8)


def test_single_precision_stays() -> None:
    x = ndvi_like(0, 900).astype(np.float32)
    assert all(v.dtype == jnp.float32 for v in statistics(x, np.ones(900, bool)).values())


def test_bad_samples() -> None:
    with pytest.raises(InputError, match="empty"):
        mean(jnp.zeros(0))
    with pytest.raises(InputError, match="shape"):
        mean(jnp.zeros(4), jnp.ones(3, bool))


def test_intersection_of_known_distributions() -> None:
    """Two Gaussians one deviation apart overlap by 2 Φ(-1/2); equal samples by 1, those apart by
    0."""
    q = stats.norm.ppf((np.arange(160_000) + 0.5) / 160_000)
    assert histogram_intersection(q, q + 1.0) == pytest.approx(2 * stats.norm.cdf(-0.5), abs=2e-3)
    x = ndvi_like(0, 300)
    assert histogram_intersection(np.tile(x, 3), np.tile(x, 2)) == pytest.approx(1.0, abs=1e-12)
    assert histogram_intersection(x, x + 5.0) == 0.0
    assert histogram_intersection(np.full(9, 0.4), np.full(6, 0.4)) == 1.0
    # Never more than one minus the Kolmogorov-Smirnov distance, but for the width of a bin.
    y = ndvi_like(1, 600, -0.03, 1.3)
    assert histogram_intersection(x, y) <= 1.0 - stats.ks_2samp(x, y).statistic


def test_values_on_edges_are_in_the_upper_bin() -> None:
    """256 bins of width one from 0 to 256: every value is an edge, and the last bin is closed."""
    rng = np.random.default_rng(4)
    x, y = (np.r_[0, 256, rng.integers(0, 257, n)] for n in (400, 300))
    shares = [np.bincount(np.minimum(v, 255), minlength=256) / v.size for v in (x, y)]
    assert histogram_intersection(x, y) == pytest.approx(np.minimum(*shares).sum(), abs=1e-12)


def test_intersection_between_limits_counts_the_rest_in_the_edge_bins() -> None:
    rng = np.random.default_rng(8)
    x, y = rng.normal(size=4000), rng.normal(0.4, 1.2, size=3000)
    edges = np.r_[-np.inf, np.linspace(-1.0, 1.5, 33)[1:-1], np.inf]
    shares = [np.histogram(v, edges)[0] / v.size for v in (x, y)]
    got = histogram_intersection(x, y, bins=32, limits=(-1.0, 1.5))
    assert got == pytest.approx(np.minimum(*shares).sum(), rel=1e-12)
