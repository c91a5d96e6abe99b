"""The descent whose slopes each step corrects, on models that bend."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal, norm

from fynjax.inversion import FitStatus
from fynjax.inversion._descent import Descended, descend, objective_of, unsettled

ROOT = np.diag([1.0 / 0.03, 1.0 / 0.05, 1.0 / 0.04])
"""Makes of misfits those in units of their errors."""
TRUTH = np.array([0.9, -0.6])


def bent(u):
    """Three statistics of two parameters, with slopes that double on the way to the truth."""
    a, b = u
    return np.array([np.exp(0.8 * a) + 0.2 * b, np.exp(-b) - 0.3 * a, a * b + b])


def slopes(u):
    a, b = u
    return np.array([[0.8 * np.exp(0.8 * a), 0.2], [-0.3, -np.exp(-b)], [b, a + 1.0]])


def minimum():
    """By scipy, with exact slopes at every step."""

    def residuals(u):
        return np.concatenate([ROOT @ (bent(u) - bent(TRUTH)), u])

    return least_squares(residuals, np.zeros(2), xtol=1e-12, ftol=1e-12, gtol=1e-12)


def descended(start, most=12):
    """From slopes at the start alone, and how often the model was evaluated."""
    evaluated = []

    def evaluate(u):
        evaluated.append(u)
        return bent(u)

    begin = Descended(start, bent(start), slopes(start), FitStatus.max_steps)
    found = descend(
        evaluate, begin, bent(TRUTH), ROOT, most=most, tolerance=1e-4, note=lambda *_: None
    )
    return found, len(evaluated)


def test_corrected_slopes_save_jacobians():
    """With one Jacobian the descent reaches the minimum in eight evaluations and ends with slopes
    nearer to those there; with those of the start, kept as they are, it takes over thirty."""
    found, evaluations = descended(np.zeros(2))
    best = minimum()
    sd = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac)))
    assert found.status == FitStatus.successful
    assert evaluations <= 8
    np.testing.assert_array_less(np.abs(found.u - best.x), 0.1 * sd)
    np.testing.assert_allclose(found.value, bent(found.u), rtol=1e-12)
    kept = np.linalg.norm(slopes(np.zeros(2)) - slopes(best.x))
    assert np.linalg.norm(found.jacobian - slopes(best.x)) < 0.6 * kept


def test_a_corrected_slope_explains_the_step_just_made():
    """Broyden's condition: along the last step the new slopes give the change of the statistics."""
    found, _ = descended(np.zeros(2), most=1)
    np.testing.assert_allclose(found.jacobian @ found.u, found.value - bent(np.zeros(2)))
    assert found.status == FitStatus.max_steps


@pytest.mark.parametrize("start", [[0.0, 0.0], [1.5, 0.5], [-1.0, -1.0]])
def test_the_descent_ends_where_the_objective_is_least(start):
    found, _ = descended(np.array(start), most=60)
    best = minimum()
    reached = 0.5 * (np.sum((ROOT @ (found.value - bent(TRUTH))) ** 2) + found.u @ found.u)
    assert found.status == FitStatus.successful
    assert reached < best.cost + 0.01


def test_weak_data_leave_the_prior_its_pull():
    """A linear model ends at the mean of the normal posterior, wherever it started from."""
    random = np.random.default_rng(3)
    matrix, weights = random.normal(size=(3, 2)), random.normal(size=(3, 3))
    target = random.normal(size=3)
    rows = weights @ matrix
    information = rows.T @ rows
    mean = np.linalg.solve(np.eye(2) + information, rows.T @ weights @ target)
    assert np.linalg.eigvalsh(information).min() < 1.0  # the prior counts
    for start in (np.zeros(2), np.array([3.0, -2.0])):
        begin = Descended(start, matrix @ start, matrix, FitStatus.max_steps)
        found = descend(
            lambda u: matrix @ u, begin, target, weights,
            most=5, tolerance=1e-10, note=lambda *_: None,
        )  # fmt: skip
        assert found.status == FitStatus.successful
        np.testing.assert_allclose(found.u, mean, rtol=1e-6)


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
    none = np.zeros(2)
    left = unsettled(3.0 * weights, u, none, matrix @ u - target, matrix)
    assert left == pytest.approx(2.0)
    moved = axes @ (np.array([3.0, 0.0]) * np.sqrt(variances))
    assert unsettled(3.0 * weights, u, moved, matrix @ u - target, matrix) == pytest.approx(3.0)


def test_the_objective_is_minus_the_logarithm_of_the_posterior_density():
    """But for a constant: of normal errors with a covariance, and of a unit normal prior."""
    random = np.random.default_rng(5)
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, -0.2, 0.5]])
    error = multivariate_normal(np.zeros(3), root @ root.T)

    def both(u, misfit):
        density = error.logpdf(misfit) + norm.logpdf(u).sum()
        return objective_of(np.linalg.inv(root), u, misfit), -density

    one, other = (both(random.normal(size=2), 0.3 * random.normal(size=3)) for _ in range(2))
    assert one[0] - other[0] == pytest.approx(one[1] - other[1])
