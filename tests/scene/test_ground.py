"""What the ground is made of: shares that add up, in patches of the width asked for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.scene._ground import ground_shares, random_patches

SHAPE = (60, 80)


@pytest.mark.parametrize("fractions", [(0.2, 0.0, 0.0), (0.3, 0.25, 0.1), (0.5, 0.5, 0.0)])
def test_each_cover_has_its_share(fractions):
    density = random_patches(SHAPE, 5.0, periodic=True, seed=1)
    shares = np.asarray(ground_shares(jnp.asarray(fractions), jnp.asarray(density)))
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(shares[1:].mean(axis=(1, 2)), fractions, atol=1e-5)
    assert shares.min() >= 0.0
    # Patches, not a mixture.
    assert shares.max(axis=0).mean() > 0.7


def test_a_map_comes_back_as_it_is():
    shares = np.random.default_rng(0).dirichlet([2.0, 1.0, 0.5, 0.2], SHAPE)
    shares = np.moveaxis(shares, -1, 0)
    got = ground_shares(jnp.asarray(shares[1:].mean(axis=(1, 2))), jnp.asarray(shares))
    np.testing.assert_allclose(got, shares, atol=1e-12)


def test_covers_mixed_alike_are_their_fractions():
    got = ground_shares(jnp.array([0.3, 0.2, 0.1]), jnp.ones((4, 1, 1)))
    np.testing.assert_allclose(got[:, 0, 0], [0.4, 0.3, 0.2, 0.1], rtol=1e-12)
    crowded = ground_shares(jnp.array([1.0, 0.5, 0.5]), jnp.ones((4, 1, 1)))
    np.testing.assert_allclose(crowded[:, 0, 0], [0.0, 0.5, 0.25, 0.25], atol=1e-12)


@pytest.mark.parametrize("scale", [4.0, 10.0])
def test_patches_are_as_wide_as_asked(scale):
    """White noise smoothed by a Gaussian of standard deviation s has the correlation
    exp(-(d / 2 s)^2) over the distance d."""
    logs = np.log(random_patches((400, 400), scale, periodic=True, seed=2))
    lag = round(scale)
    found = np.mean(logs * np.roll(logs, lag, axis=2)) / np.mean(logs**2)
    assert found == pytest.approx(np.exp(-((lag / scale) ** 2)), abs=0.06)


def test_derivative_by_the_fractions():
    density = jnp.asarray(random_patches((12, 15), 4.0, periodic=False, seed=3))
    weight = jnp.asarray(np.random.default_rng(4).normal(size=density.shape))

    def total(fractions):
        return jnp.sum(weight * ground_shares(fractions, density))

    at, step = jnp.array([0.3, 0.2, 0.1]), jnp.array([0.5, -0.3, 0.4])
    h = 1e-5
    difference = float(total(at + h * step) - total(at - h * step)) / (2 * h)
    assert float(jax.grad(total)(at) @ step) == pytest.approx(difference, rel=1e-6)
    # Nothing there: the slope of its first appearance, and no NaN.
    none = jnp.array([0.2, 0.0, 0.0])
    forward = [(float(total(none.at[k].set(h)) - total(none)) / h) for k in (1, 2)]
    np.testing.assert_allclose(jax.grad(total)(none)[1:], forward, rtol=2e-2)
