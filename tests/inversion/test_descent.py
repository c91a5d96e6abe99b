"""The descent whose slopes each step corrects, on models that bend."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from fynjax.inversion import FitStatus
from fynjax.inversion._descent import Descended, descend

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
