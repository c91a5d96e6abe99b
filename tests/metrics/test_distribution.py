"""Statistics of pixel distributions against NumPy and SciPy; smooth ones against the exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fynjax._core.errors import InputError
from fynjax.metrics import (
    histogram_intersection,
    ks_distance,
    mean,
    quantiles,
    smooth_histogram_intersection,
    smooth_ks_distance,
    soft_histogram,
    standard_deviation,
    wasserstein_distance,
)


def ndvi_like(seed: int, size: int, shift: float = 0.0, spread: float = 1.0) -> np.ndarray:
    """Skewed, bounded values like an NDVI image: most near 0.75, a tail of bare ground."""
    rng = np.random.default_rng(seed)
    plants = rng.beta(14.0, 4.5, size)
    bare = rng.beta(4.0, 6.0, size)
    mixed = np.where(rng.uniform(size=size) < 0.1, bare, plants)
    return 0.75 + spread * (mixed - 0.75) + shift


def numpy_intersection(x: np.ndarray, y: np.ndarray, bins: int) -> float:
    limits = (min(x.min(), y.min()), max(x.max(), y.max()))
    a, b = (np.histogram(v, bins, limits)[0] / v.size for v in (x, y))
    return float(np.minimum(a, b).sum())


PROBABILITIES = np.array([0.0, 0.025, 0.5, 0.777, 1.0])
SIZES = (900, 600)
ALL = tuple(np.ones(size, bool) for size in SIZES)


def distances(x: jax.Array, y: jax.Array, wx: jax.Array, wy: jax.Array) -> dict[str, jax.Array]:
    masks = {"real_valid": wx, "simulated_valid": wy}
    return {
        "intersection": histogram_intersection(x, y, **masks),
        "coarse intersection": histogram_intersection(x, y, bins=20, **masks),
        "ks": ks_distance(x, y, **masks),
        "wasserstein": wasserstein_distance(x, y, **masks),
        "smooth intersection": smooth_histogram_intersection(x, y, **masks),
        "smooth ks": smooth_ks_distance(x, y, **masks),
    }


def statistics(x: jax.Array, wx: jax.Array) -> dict[str, jax.Array]:
    return {
        "mean": mean(x, wx),
        "std": standard_deviation(x, wx),
        "quantiles": quantiles(x, jnp.asarray(PROBABILITIES, x.dtype), wx),
    }


# Compiled once and used on one pair of sizes throughout: compilation is the cost of this file.
compiled = jax.jit(distances)
compiled_statistics = jax.jit(statistics)
slopes = jax.jit(jax.jacrev(lambda y, x, wx, wy: distances(x, y, wx, wy)))


def pair(shift: float = -0.03, spread: float = 1.3) -> tuple[np.ndarray, np.ndarray]:
    return ndvi_like(0, SIZES[0]), ndvi_like(1, SIZES[1], shift, spread)


@pytest.mark.parametrize("kept", [(900, 600), (400, 99), (1, 3)])
@pytest.mark.parametrize("decimals", [None, 2, "edges"])
def test_exact_distances(kept: tuple[int, int], decimals: int | str | None) -> None:
    x, y = pair()
    if decimals == "edges":  # 256 bins of width one from 0 to 256: every value is an edge
        x, y = np.rint(150.0 * x), np.rint(150.0 * y)
        x[:], y[:] = np.clip(x, 0, 256), np.clip(y, 0, 256)
        decimals = 0
    if decimals is not None:  # ties, within and between the samples
        x, y = x.round(decimals), y.round(decimals)
    rng = np.random.default_rng(4)
    wx, wy = (rng.permutation(size) < keep for size, keep in zip(SIZES, kept))
    if decimals == 0:
        x[np.flatnonzero(wx)[0]], y[np.flatnonzero(wy)[0]] = 0.0, 256.0
    got = compiled(np.where(wx, x, np.nan), np.where(wy, y, -99.0), wx, wy)
    x, y = x[wx], y[wy]
    assert float(got["ks"]) == pytest.approx(stats.ks_2samp(x, y).statistic, abs=1e-14)
    expected = stats.wasserstein_distance(x, y)
    assert float(got["wasserstein"]) == pytest.approx(expected, rel=1e-10)
    for name, bins in (("intersection", 256), ("coarse intersection", 20)):
        assert float(got[name]) == pytest.approx(numpy_intersection(x, y, bins), abs=1e-12)


def test_moments_and_quantiles() -> None:
    x = ndvi_like(2, 900)
    for keep in (ALL[0], np.random.default_rng(0).uniform(size=900) < 0.4):
        got = compiled_statistics(np.where(keep, x, np.nan), keep)
        assert float(got["mean"]) == pytest.approx(x[keep].mean(), rel=1e-13)
        assert float(got["std"]) == pytest.approx(x[keep].std(), rel=1e-12)
        expected = np.quantile(x[keep], PROBABILITIES)
        np.testing.assert_allclose(got["quantiles"], expected, rtol=1e-12)
    # Any shape, and without a mask.
    cube = x.reshape(5, 12, 15)
    assert float(mean(cube)) == pytest.approx(x.mean(), rel=1e-13)
    assert float(standard_deviation(cube)) == pytest.approx(x.std(), rel=1e-12)
    np.testing.assert_allclose(quantiles(cube, 0.25), [np.quantile(x, 0.25)], rtol=1e-12)


def test_a_mask_is_the_same_as_leaving_pixels_out() -> None:
    """Half the pixels masked: the rest, taken twice, fill the same shape and weigh the same."""
    x, y = pair()
    rng = np.random.default_rng(9)
    wx, wy = rng.permutation(900) < 450, rng.permutation(600) < 300
    masked = compiled(np.where(wx, x, np.nan), np.where(wy, y, 50.0), wx, wy)
    doubled = compiled(np.tile(x[wx], 2), np.tile(y[wy], 2), *ALL)
    for name, value in masked.items():
        assert float(value) == pytest.approx(float(doubled[name]), rel=1e-12), name
    for name, slope in slopes(np.where(wy, y, np.nan), np.where(wx, x, np.nan), wx, wy).items():
        assert bool(jnp.all(jnp.isfinite(slope))), name
        np.testing.assert_array_equal(slope[~wy], 0.0)
        assert bool(jnp.any(slope != 0.0)) == (name.startswith("smooth") or name == "wasserstein")


def test_a_nan_that_is_not_masked_shows() -> None:
    x, y = pair()
    holed = [v.copy() for v in (x, y)]
    for v in holed:
        v[7] = np.nan
    none = [np.zeros(size, bool) for size in SIZES]
    for arguments in (
        (holed[0], y, *ALL), (x, holed[1], *ALL), (x, y, none[0], ALL[1]), (x, y, ALL[0], none[1]),
    ):  # fmt: skip
        got = compiled(*arguments)
        assert all(np.isnan(float(value)) for value in got.values()), got
    for arguments in ((holed[0], ALL[0]), (x, none[0])):
        got = compiled_statistics(*arguments)
        assert all(np.all(np.isnan(value)) for value in got.values()), got


def test_equal_disjoint_and_constant_samples() -> None:
    x = ndvi_like(0, 300)
    alike = {k: float(v) for k, v in compiled(np.tile(x, 3), np.tile(x, 2), *ALL).items()}
    apart = {k: float(v) for k, v in compiled(np.tile(x, 3), np.tile(x, 2) + 5.0, *ALL).items()}
    constant = compiled(np.full(900, 0.4), np.full(600, 0.4), *ALL)
    flat_slopes = slopes(jnp.full(600, 0.4), jnp.full(900, 0.4), *ALL)
    for name in alike:
        same, distant = (1.0, 0.0) if "intersection" in name else (0.0, 1.0)
        distant = 5.0 if name == "wasserstein" else distant
        assert alike[name] == pytest.approx(same, abs=1e-12), name
        assert apart[name] == pytest.approx(distant, abs=1.1e-3), name
        assert float(constant[name]) == pytest.approx(same, abs=1e-12), name
        assert bool(jnp.all(jnp.isfinite(flat_slopes[name]))), name
    for size in (0.3, 0.1):  # neither is a sum of powers of two
        value, slope = jax.value_and_grad(standard_deviation)(jnp.full((4, 5), size))
        assert float(value) == 0.0
        np.testing.assert_array_equal(slope, 0.0)


def test_smooth_distances_are_near_the_exact() -> None:
    whole = 160_000
    both = jax.jit(distances)
    sharp = jax.jit(
        lambda x, y, wx, wy: smooth_histogram_intersection(
            x, y, smoothing=0.0, real_valid=wx, simulated_valid=wy
        )
    )
    for shift, spread in ((0.0, 1.0), (-0.02, 1.0), (-0.03, 2.0), (-0.1, 1.2)):
        x, y = ndvi_like(0, whole), ndvi_like(1, whole, shift, spread)
        for size in (10_000, whole):
            keep = np.arange(whole) < size
            got = both(x, y, keep, keep)
            assert -0.01 < float(got["smooth ks"] - got["ks"]) < 0.005
            # Counting noise of 256 bins, which smoothing removes, is about sqrt(bins / (pi size)).
            noise = np.sqrt(256 / (np.pi * size))
            assert -0.005 < float(got["smooth intersection"] - got["intersection"]) < 0.01 + noise
            near = float(sharp(x, y, keep, keep) - got["intersection"])
            assert -0.005 < near < 0.01 + 0.5 * noise
            # The two overlap measures bound each other.
            assert float(got["intersection"]) <= 1.0 - float(got["ks"]) + 5e-3


def test_smooth_distances_of_known_distributions() -> None:
    """Two Gaussians one deviation apart overlap by 2 Φ(-1/2) and are 2 Φ(1/2) - 1 apart in K-S."""
    q = stats.norm.ppf((np.arange(160_000) + 0.5) / 160_000)
    overlap = smooth_histogram_intersection(q, q + 1.0)
    assert float(overlap) == pytest.approx(2 * stats.norm.cdf(-0.5), abs=2e-3)
    expected = 2 * stats.norm.cdf(0.5) - 1
    assert float(smooth_ks_distance(q, q + 1.0)) == pytest.approx(expected, abs=5e-3)


def test_soft_histogram_keeps_mass_and_mean() -> None:
    x = ndvi_like(4, 900)
    centres = -1.0 + 3.0 * (np.arange(64) + 0.5) / 64
    for smoothing in (0.0, 1.5):
        h = np.asarray(soft_histogram(x, (-1.0, 2.0), bins=64, smoothing=smoothing))
        assert h.sum() == pytest.approx(1.0, rel=1e-12)
        assert h @ centres == pytest.approx(x.mean(), rel=1e-9)  # linear binning keeps the mean
        spread = np.sqrt(h @ centres**2 - (h @ centres) ** 2)
        widened = np.sqrt(x.var() + (3.0 / 64 * smoothing) ** 2)
        assert spread == pytest.approx(widened, abs=0.003)
    # A pixel on a bin's centre is in that bin alone; beyond the limits it is in the edge bin.
    h = soft_histogram(jnp.array([0.5, 1.25, 99.0, -99.0]), (0.0, 4.0), bins=4)
    np.testing.assert_allclose(h, [0.5 + 0.0625, 0.1875, 0.0, 0.25], atol=1e-15)
    with pytest.raises(InputError, match="bins"):
        soft_histogram(x, (0.0, 1.0), bins=1)
    with pytest.raises(InputError, match="smoothing"):
        soft_histogram(x, (0.0, 1.0), smoothing=-1.0)


def test_slopes() -> None:
    """Each output's derivative in each pixel, one by one, against central differences."""
    x, y = jnp.asarray(ndvi_like(1, 25)), jnp.asarray(ndvi_like(3, 12))
    few = {"bins": 8, "limits": (-0.2, 1.1)}

    @jax.jit
    def outputs(v: jax.Array) -> jax.Array:
        parts = (
            mean(v),
            standard_deviation(v),
            quantiles(v, jnp.array([0.1, 0.33, 0.5, 0.9])),
            wasserstein_distance(x, v),
            soft_histogram(v, (-0.2, 1.1), bins=8, smoothing=1.0),
            smooth_histogram_intersection(x, v, smoothing=1.0, **few),
            smooth_ks_distance(x, v, sharpness=20.0, **few),
        )
        return jnp.concatenate([jnp.ravel(part) for part in parts])

    reverse = jax.jacrev(outputs)(y)
    np.testing.assert_allclose(jax.jacfwd(outputs)(y), reverse, rtol=1e-9, atol=1e-14)
    assert np.all(np.any(np.abs(reverse) > 1e-6, axis=1))  # every output moves
    for k in range(y.size):
        step = 1e-6 * jnp.zeros(y.size).at[k].set(1.0)
        difference = (outputs(y + step) - outputs(y - step)) / 2e-6
        np.testing.assert_allclose(reverse[:, k], difference, rtol=1e-5, atol=1e-8)


def test_slope_of_a_whole_image_with_respect_to_two_parameters() -> None:
    """What an inversion sees: shift and stretch of 20 000 pixels, against finite differences."""
    x, base = ndvi_like(0, 20_000), ndvi_like(1, 20_000)

    @jax.jit
    def objective(p: jax.Array) -> jax.Array:
        y = 0.75 + p[1] * (base - 0.75) + p[0]
        limits = (-0.6, 1.4)
        return jnp.stack(
            [
                wasserstein_distance(x, y),
                smooth_histogram_intersection(x, y, limits=limits),
                smooth_ks_distance(x, y, limits=limits),
            ]
        )

    p, h = jnp.array([-0.03, 1.4]), 1e-4
    jacobian = jax.jacrev(objective)(p)
    for k in range(2):
        step = h * jnp.eye(2)[k]
        difference = (objective(p + step) - objective(p - step)) / (2 * h)
        np.testing.assert_allclose(jacobian[:, k], difference, rtol=2e-2, atol=2e-3)
    assert np.all(np.abs(jacobian[:, 0]) > 0.1)


def test_many_indices_at_once_and_single_precision() -> None:
    x = np.stack([ndvi_like(s, SIZES[0]) for s in range(3)]).astype(np.float32)
    y = np.stack([ndvi_like(s + 9, SIZES[1], -0.02) for s in range(3)]).astype(np.float32)
    masks = [np.broadcast_to(mask, (3, mask.size)) for mask in ALL]
    many = jax.jit(jax.vmap(distances))(x, y, *masks)
    for k in range(3):
        one = compiled(x[k].astype(float), y[k].astype(float), *ALL)
        for name, value in many.items():
            assert value.dtype == jnp.float32, name
            # Six pixels may change their bin of 1/900 and 1/600 by rounding of its edges.
            assert float(value[k]) == pytest.approx(float(one[name]), abs=6e-3), name
    assert all(v.dtype == jnp.float32 for v in statistics(x, jnp.ones(x.shape, bool)).values())


def test_reverse_mode_holds_no_pixels_times_bins() -> None:
    size, bins = 200_000, 256
    gradient = jax.grad(
        lambda v: smooth_histogram_intersection(jnp.ones(4), v, bins=bins, limits=(0, 1))
    )
    memory = jax.jit(gradient).lower(jnp.zeros(size, jnp.float32)).compile().memory_analysis()
    assert memory.temp_size_in_bytes < 40 * size  # [pixel, bin] would be 1024 times size


def test_bad_samples() -> None:
    with pytest.raises(InputError, match="empty"):
        mean(jnp.zeros(0))
    with pytest.raises(InputError, match="shape"):
        mean(jnp.zeros(4), jnp.ones(3, bool))


def test_intersection_between_limits_counts_the_rest_in_the_edge_bins() -> None:
    rng = np.random.default_rng(8)
    x, y = rng.normal(size=4000), rng.normal(0.4, 1.2, size=3000)
    edges = np.linspace(-1.0, 1.5, 33)
    shares = [np.histogram(np.clip(v, -1.0, 1.5), edges)[0] / v.size for v in (x, y)]
    got = histogram_intersection(x, y, bins=32, limits=(-1.0, 1.5))
    assert float(got) == pytest.approx(np.minimum(*shares).sum(), rel=1e-12)
