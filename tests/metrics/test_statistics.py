"""Statistics of an image by name: spreads over squares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.metrics import (
    bands_needed,
    check_statistics,
    fitting_statistics,
    image_statistics,
    quantiles,
)
from fynjax.sensors import shipped_sensor

NAMES = ("nir.std", "nir.std20cm", "nir.std40cm", "NDVI.std40cm")


def test_spread_over_squares_is_that_of_their_means():
    """Squares of two pixels, light and dark in turn: no pattern is left at twice their side."""
    board = np.kron(np.indices((6, 6)).sum(axis=0) % 2, np.ones((2, 2)))
    image = np.stack([0.05 + 0.0 * board] * 3 + [0.3 + 0.1 * board])
    fine, same, coarse = np.asarray(image_statistics(jnp.asarray(image), NAMES[:3], pixel=0.1))
    assert fine == pytest.approx(0.05)
    assert same == pytest.approx(0.05)
    assert coarse == pytest.approx(0.0, abs=1e-9)


def test_white_noise_falls_with_the_side_and_what_is_masked_does_not_count():
    noise = np.random.default_rng(1).normal(size=(4, 120, 120))
    image = 0.3 + 0.01 * noise
    found = np.asarray(image_statistics(jnp.asarray(image), NAMES[:3], pixel=0.1))
    np.testing.assert_allclose(found[1:] / found[0], [0.5, 0.25], rtol=0.06)
    valid = np.ones((120, 120), bool)
    valid[:40] = False
    spoilt = np.where(valid, image, 9.0)
    masked = image_statistics(jnp.asarray(spoilt), NAMES[:3], jnp.asarray(valid), pixel=0.1)
    np.testing.assert_allclose(
        masked, image_statistics(jnp.asarray(image[:, 40:]), NAMES[:3], pixel=0.1), rtol=1e-9
    )


def test_slopes_of_spreads_over_squares():
    image = jnp.asarray(0.1 + 0.3 * np.random.default_rng(2).random((4, 9, 9)))
    move = jnp.asarray(np.random.default_rng(3).normal(size=image.shape))
    weight = jnp.arange(1.0, 5.0)

    def total(step):
        return weight @ image_statistics(image + step * move, NAMES, pixel=0.1)

    slope = float(jax.grad(total)(0.0))
    assert slope == pytest.approx(float(total(1e-5) - total(-1e-5)) / 2e-5, rel=1e-6)


def test_windowed_quantiles_are_means_about_the_quantile():
    x = np.sort(np.random.default_rng(4).normal(size=1000))
    shares = jnp.array([0.01, 0.25, 0.5, 0.95])
    found = np.asarray(
        quantiles(
            jnp.asarray(np.append(x, 99.0)),
            shares,
            jnp.asarray(np.append(np.ones(1000, bool), False)),
            window=0.05,
        )
    )
    expected = [x[:35].mean(), x[225:275].mean(), x[475:525].mean(), x[925:975].mean()]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    slope = jax.grad(lambda v: quantiles(v, shares[1:2], window=0.05)[0])(jnp.asarray(x))
    np.testing.assert_allclose(slope[225:275], 0.02, rtol=1e-9)
    assert float(slope.sum()) == pytest.approx(1.0)


def test_bands_are_known_by_their_names_whatever_their_order():
    image = jnp.asarray(np.random.default_rng(5).uniform(0.02, 0.3, (5, 8, 8)))
    names = ("blue", "green", "red", "nir", "red_edge")
    found = image_statistics(image, ["blue.mean", "NDVI.q50"], bands=names)
    assert float(found[0]) == pytest.approx(float(image[0].mean()))
    usual = image_statistics(image[jnp.array([1, 2, 4, 3])], ["NDVI.q50"])
    assert float(found[1]) == float(usual[0])
    with pytest.raises(InputError, match=r"'blue\.mean'"):
        image_statistics(image[1:], ["blue.mean"])


def test_indices_are_those_of_the_bands_that_an_image_has():
    bands, image = shipped_sensor("sentinel_2a").bands, np.full((13, 2, 2), 0.1)
    image[bands.names.index("B8")] = 0.3
    image[bands.names.index("B8A")] = 0.5
    found = image_statistics(jnp.asarray(image), ["NDMI.mean", "B4.mean"], bands=bands)
    np.testing.assert_allclose(found, [0.5, 0.1], rtol=1e-5)
    with pytest.raises(InputError, match=r"'NDMI\.mean'"):
        check_statistics(["NDMI.mean"])
    assert bands_needed(["NDVI", "B2"], bands) == {"B2", "B4", "B8"}


def test_squares_that_an_image_does_not_hold_are_refused_and_left_out():
    image = jnp.full((4, 9, 9), 0.2)
    with pytest.raises(InputError, match="`pixel` must be known"):
        image_statistics(image, ["nir.std20cm"])
    with pytest.raises(InputError, match="fewer than two squares of 60cm"):
        image_statistics(image, ["nir.std60cm"], pixel=0.1)
    names = ("nir.mean", "nir.std20cm", "nir.std160cm")
    assert fitting_statistics(names, 5.0, 0.1) == ["nir.mean", "nir.std20cm"]
    assert fitting_statistics(names, 10.0, 0.3) == ["nir.mean", "nir.std160cm"]


def test_the_slope_of_a_percentile_is_that_of_wide_steps_and_its_value_exact():
    """Pixels each move by what is due to their place and three times as much by chance: plants that
    grow move some leaves into the light and others out of it."""
    shares = jnp.array([0.25, 0.5, 0.95])
    random = np.random.default_rng(11)
    pixels = jnp.asarray(random.normal(size=(200, 1000)))
    moves = 0.5 + 0.3 * pixels + 1.5 * jnp.asarray(random.normal(size=pixels.shape))

    def moved(step, x, by, window):
        return quantiles(x + step * by, shares, window=window)

    def slopes(window):
        return np.asarray(
            jax.jit(jax.vmap(lambda x, by: jax.jacfwd(moved)(0.0, x, by, window)))(pixels, moves)
        )

    wide = jax.vmap(lambda x, by: moved(0.3, x, by, 0.0) - moved(-0.3, x, by, 0.0))
    secant = np.asarray(wide(pixels, moves)).mean(axis=0) / 0.6
    default, plain = slopes(None), slopes(0.0)
    error = default.std(axis=0) / np.sqrt(len(default))
    assert np.all(np.abs(default.mean(axis=0) - secant) < 4.0 * error + 0.03)
    assert np.all(default.std(axis=0) < 0.25 * plain.std(axis=0))
    # Reverse mode, under jit and vmap, is forward mode; the value is that without a window.
    first = pixels[0]
    reverse = jax.jit(jax.jacrev(lambda x: quantiles(x, shares)))(first)
    np.testing.assert_allclose(reverse @ moves[0], default[0], rtol=1e-9)
    np.testing.assert_array_equal(quantiles(first, shares), quantiles(first, shares, window=0.0))
    np.testing.assert_allclose(quantiles(first, shares), np.quantile(first, shares), rtol=1e-12)
    # By the share, the slope of the quantile function.
    by_share = jax.jvp(lambda p: quantiles(first, p), (shares,), (jnp.ones(3),))[1]
    plain_by_share = jax.jvp(lambda p: quantiles(first, p, window=0.0), (shares,), (jnp.ones(3),))[
        1
    ]
    np.testing.assert_allclose(by_share, plain_by_share, rtol=1e-12)
