"""What a search makes of draws of plants and parameters: errors, and information of slopes."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from fynjax.inversion import Data, ParameterSpace, whitened_residual
from fynjax.inversion._expected import chance_covariance, each, mean_information
from fynjax.inversion._search import posterior_root, unsettled

SD = np.array([1.0, 2.0, 0.5])
"""Of three independent statistics between plantings."""


def deviations(stands, lack_sd, count=2000):
    """Squared difference of a plot from the estimated expectation, and what is stated of it, as
    means over searches [statistic] in units of the variance between plantings."""
    random = np.random.default_rng(5)
    squares, stated = np.zeros(3), np.zeros(3)
    for _ in range(count):
        coarse = SD * random.normal(size=(stands, 3))
        draws = np.concatenate([coarse, coarse])  # each set of sites twice
        lack = lack_sd * SD * random.normal(size=(2, 3))
        expectation = draws.mean(axis=0) + lack.mean(axis=0)
        squares += (SD * random.normal(size=3) - expectation) ** 2 / count
        # The variance of draws that are alike in pairs is low, as that of any few.
        ratio = (stands - 1) / stands * 2 * stands / (2 * stands - 1)
        stated += np.diagonal(chance_covariance(draws, lack, stands)) / ratio / count
    return squares / SD**2, stated / SD**2


@pytest.mark.parametrize(("stands", "lack_sd"), [(3, 0.0), (20, 0.6), (40, 1.5)])
def test_the_error_of_the_expectation_is_part_of_the_covariance(stands, lack_sd):
    """1 + 1 / stands + the variance of two plantings' lack, halved: against simulated searches."""
    squares, stated = deviations(stands, lack_sd)
    want = 1.0 + 1.0 / stands + 0.5 * lack_sd**2
    assert squares.mean() == pytest.approx(want, rel=0.04)
    assert stated.mean() == pytest.approx(want, rel=0.06)


@pytest.mark.parametrize("apart", [0.0, 0.2])
@pytest.mark.parametrize("frames", [3, 25])
def test_chance_that_frames_share_counts_once(frames, apart):
    """A twin of frames that see the same plants, each with a little chance of its own, and as much
    `apart` in how strongly they show plants and parameter: what is estimated from all of them is as
    far off as is stated, where independent frames would be sure of far too much."""
    random = np.random.default_rng(7)
    kinds, count, size = 6, 48, 6 * frames
    names = [f"band {k}" for k in range(kinds)] * frames
    scale = np.exp(apart * random.normal(size=size))
    slope = np.tile(random.normal(size=kinds), frames) * np.exp(apart * random.normal(size=size))

    def draws(number):
        plants, own = (random.normal(size=(number, n, kinds)) for n in (1, frames))
        return (np.sqrt(0.9) * plants + np.sqrt(0.1) * own).reshape(number, size) * scale

    scores = {True: [], False: []}
    for _ in range(150):
        drawn = draws(count)
        misfit = draws(1)[0] - drawn.mean(axis=0)
        for known in scores:
            kind = names if known else None
            error = chance_covariance(drawn, np.zeros((1, size)), count, kind) + 1e-4 * np.eye(size)
            weights = np.linalg.solve(error, slope)
            scores[known].append(weights @ misfit / np.sqrt(slope @ weights))
    found, before = (np.sqrt(np.mean(np.square(scores[known]))) for known in (True, False))
    assert 0.9 < found < 1.2
    assert before > found + 0.1


def test_one_planting_says_nothing_of_what_renders_differ_by():
    draws = np.random.default_rng(0).normal(size=(8, 3))
    one = chance_covariance(draws, np.ones((1, 3)), 4)
    same = chance_covariance(draws, np.ones((2, 3)), 4)
    np.testing.assert_allclose(one, same)


def test_draws_that_are_computed_two_at_a_time_come_back_in_their_order():
    """The first time, when one goes ahead to compile, as later; in 64 bits as here."""
    places = [jnp.asarray(float(i)) for i in range(5)]
    for _ in range(2):
        found = each(lambda stand, place: stand + place / 3.0, list(range(5)), places)
        np.testing.assert_array_equal(found, np.arange(5) + np.arange(5) / 3.0)


def test_slopes_of_opposite_draws_count_as_their_mean():
    """Slopes that change with the parameters differ between opposite draws, and their means over
    pairs do not: nothing of the information is lost, however much they change."""
    random = np.random.default_rng(1)
    mean, bend = random.normal(size=(4, 2)), 3.0 * random.normal(size=(4, 2))
    normals = random.normal(size=4)
    slopes = np.stack([mean + sign * n * bend for n in normals for sign in (1, -1)])
    weights = random.normal(size=(4, 4))
    want = (weights @ mean).T @ (weights @ mean)
    np.testing.assert_allclose(mean_information(weights, slopes), want, rtol=1e-9)


def test_information_of_slopes_by_chance_is_that_of_their_mean_without_bias():
    """Pairs with slopes of chance: on average over searches the information of the expectation."""
    random = np.random.default_rng(2)
    mean = np.array([[2.0], [-1.0], [0.5]])
    found = [
        mean_information(np.eye(3), mean + random.normal(size=(8, 3, 1)))[0, 0] for _ in range(300)
    ]
    assert np.mean(found) == pytest.approx(float(np.sum(mean**2)), rel=0.05)
    single = mean_information(np.eye(3), mean[None])
    np.testing.assert_allclose(single, mean.T @ mean)


def test_draws_of_the_posterior_have_its_covariance():
    """What makes them of unit normal numbers is a root of the inverse of prior and information."""
    random = np.random.default_rng(7)
    weights, slopes = random.normal(size=(4, 4)), random.normal(size=(1, 4, 3))
    rows = weights @ slopes[0]
    root = posterior_root(weights, slopes)
    np.testing.assert_allclose(root @ root.T, np.linalg.inv(np.eye(3) + rows.T @ rows), rtol=1e-9)


def test_what_is_left_to_move_is_in_posterior_standard_deviations():
    """Of a linear model: the distance from the mean of its posterior, along the principal axis
    where it is largest; and no less than what the search just moved."""
    random = np.random.default_rng(3)
    matrix, weights, target = (random.normal(size=n) for n in ((3, 2), (3, 3), 3))
    rows = 3.0 * weights @ matrix
    covariance = np.linalg.inv(np.eye(2) + rows.T @ rows)
    mean = covariance @ rows.T @ (3.0 * weights @ target)
    variances, axes = np.linalg.eigh(covariance)
    u = mean + axes @ (np.array([0.5, -2.0]) * np.sqrt(variances))
    residual = np.concatenate([3.0 * weights @ (matrix @ u - target), u])
    jacobian = np.concatenate([rows, np.eye(2)])
    assert unsettled(residual, jacobian, np.zeros(2)) == pytest.approx(2.0)
    moved = axes @ (np.array([3.0, 0.0]) * np.sqrt(variances))
    assert unsettled(residual, jacobian, moved) == pytest.approx(3.0)


def test_the_whitened_residual_is_minus_the_logarithm_of_the_posterior_density():
    """But for a constant: of normal errors with a covariance, and of a unit normal prior."""
    random = np.random.default_rng(5)
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, -0.2, 0.5]])
    error = multivariate_normal(np.zeros(3), root @ root.T)
    data = Data(("a", "b", "c"), jnp.zeros(3), jnp.ones(3), jnp.asarray(np.linalg.inv(root)))
    low, high, none, one = (jnp.full(2, v) for v in (-50.0, 50.0, 0.0, 1.0))
    space = ParameterSpace(("x", "y"), low, high, none, one, distribution="normal")
    slopes = random.normal(size=(3, 2))
    residual = whitened_residual(lambda x: jnp.asarray(slopes) @ x, data, space)

    def both(u):
        rest = residual(jnp.asarray(u))
        density = error.logpdf(slopes @ np.asarray(space.physical(jnp.asarray(u))))
        return 0.5 * float(rest @ rest), -density - norm.logpdf(u).sum()

    first, other = (both(random.normal(size=2)) for _ in range(2))
    assert first[0] - other[0] == pytest.approx(first[1] - other[1])
