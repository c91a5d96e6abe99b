"""Fits against certified values of NIST, and whether they say truly that they have converged."""

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from fynjax.inversion import Data, ParameterSpace, fit
from tests.inversion.nist import REGRESSIONS


def digits_and_end(regression, predict, start, solver):
    """Digits of the worst parameter that agree, and the result, from NIST's `start`.

    Errors a thousandth of the residuals: the prior about the start then shifts no digit in
    question, and the objective is of the order of a million.
    """
    certified = np.array(regression.certified)
    freedom = regression.y.size - certified.size
    sd = 1e-3 * np.sqrt(regression.squares / freedom)
    names = tuple(f"b{i}" for i in range(certified.size))
    endless = np.full(certified.size, np.inf)
    width = np.maximum(np.abs(start), np.abs(certified))
    space = ParameterSpace(names, -endless, endless, start, width, distribution="normal")
    y = tuple(f"y{i}" for i in range(regression.y.size))
    data = Data(y, jnp.asarray(regression.y), jnp.full(regression.y.size, sd))
    result = fit(predict, data, space, max_steps=500, solver=solver)
    error = np.max(np.abs(np.asarray(result.estimate) / certified - 1.0))
    return -np.log10(error + 1e-16), result


@pytest.mark.parametrize("name", REGRESSIONS)
def test_the_data_have_the_certified_sum_of_squares(name):
    model, x, y, _, certified, squares = REGRESSIONS[name]
    residual = np.asarray(model(jnp.asarray(certified), x)) - y
    np.testing.assert_allclose(np.sum(residual**2), squares, rtol=1e-9)


def ends(name, solver):
    """From NIST's far start and its near one."""
    regression = REGRESSIONS[name]

    def predict(b):
        return regression.model(b, regression.x)

    return [digits_and_end(regression, predict, start, solver) for start in regression.starts]


@pytest.mark.parametrize("name", REGRESSIONS)
def test_a_fit_that_says_converged_has_four_certified_digits(name):
    far, (digits, near) = ends(name, None)
    assert far[0] > 4.0 or not bool(far[1].converged)
    assert digits > 4.0
    assert bool(near.converged)


def test_a_solver_whose_own_rule_ends_it_early_does_not_say_converged():
    """This one ends where a step changes little: 2 to 6 digits, by the start."""
    for digits, result in ends("Rat43", optx.BFGS(1e-3, 1e-3)):
        assert bool(result.converged) == (digits > 4.0)
