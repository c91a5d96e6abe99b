"""The descent whose slopes each step corrects, on models that bend."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from fynjax.errors import InputError
from fynjax.inversion import BroydenLM
from tests.helpers import descend

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


def residual(u):
    return np.concatenate([ROOT @ (bent(u) - bent(TRUTH)), u])


def jacobian(u):
    return residual(u), np.concatenate([ROOT @ slopes(u), np.eye(2)])


def descended(start, most=12, **options):
    """From slopes at the start alone; its states, and how often the model was evaluated."""
    evaluated = []

    def evaluate(u):
        evaluated.append(u)
        return jnp.asarray(residual(np.asarray(u)))

    steps = descend(
        evaluate, BroydenLM(atol=1e-4, **options), jnp.asarray(start), max_steps=most,
        jacobian=lambda u: jacobian(np.asarray(u)),
    )  # fmt: skip
    return list(steps), len(evaluated)


def test_corrected_slopes_save_jacobians():
    """With one Jacobian the descent reaches the minimum in eight evaluations and ends with slopes
    nearer to those there; with those of the start, kept as they are, it takes over thirty."""
    states, evaluations = descended(np.zeros(2))
    u, state, reason = states[-1]
    best = minimum()
    sd = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac)))
    assert reason == optx.RESULTS.successful
    assert evaluations <= 8
    np.testing.assert_array_less(np.abs(u - best.x), 0.1 * sd)
    np.testing.assert_allclose(state.residual, residual(np.asarray(u)), rtol=1e-12)
    kept = np.linalg.norm(jacobian(np.zeros(2))[1] - best.jac)
    assert np.linalg.norm(state.jacobian - best.jac) < 0.6 * kept


def test_a_corrected_slope_explains_the_step_just_made():
    """Broyden's condition: along the last step the new slopes give the change of the residuals."""
    states, _ = descended(np.zeros(2), most=1)
    u, state, reason = states[-1]
    change = residual(np.asarray(u)) - residual(np.zeros(2))
    np.testing.assert_allclose(state.jacobian @ u, change)
    assert reason == optx.RESULTS.nonlinear_max_steps_reached


@pytest.mark.parametrize("renew", [False, True])
@pytest.mark.parametrize("start", [[0.0, 0.0], [1.5, 0.5], [-1.0, -1.0]])
def test_the_descent_ends_where_the_objective_is_least(start, renew):
    states, _ = descended(np.array(start), most=60, renew=renew)
    _, state, reason = states[-1]
    best = minimum()
    assert reason == optx.RESULTS.successful
    assert 0.5 * float(state.residual @ state.residual) < best.cost + 0.01


def test_a_share_of_the_objective_may_be_left():
    """A descent ends at the first step where no more than five times the objective is to gain."""
    states, _ = descended(np.array([1.5, 0.5]))
    (*_, last), _ = descended(np.array([1.5, 0.5]), rtol=5.0)
    assert len(states) > int(last[1].steps) + 1
    objective = [0.5 * float(s.residual @ s.residual) for _, s, _ in states]
    ended = [float(s.gain) <= 1e-4 + 5.0 * o for (_, s, _), o in zip(states, objective)]
    assert int(last[1].steps) == ended.index(True)


def test_new_slopes_are_those_of_the_point():
    states, _ = descended(np.zeros(2), renew=True)
    u, state, _ = states[-1]
    np.testing.assert_allclose(state.jacobian, jacobian(np.asarray(u))[1], rtol=1e-12)


def test_no_step_is_longer_than_asked():
    states, _ = descended(np.zeros(2), most=60, renew=True, longest=0.1)
    places = np.array([u for u, *_ in states])
    moves = np.abs(np.diff(places, axis=0)).max(axis=1)
    assert moves.max() <= 0.1 * (1 + 1e-12)
    assert moves.max() > 0.05
    assert states[-1][2] == optx.RESULTS.successful


def test_weak_data_leave_the_prior_its_pull():
    """A linear model ends at the mean of the normal posterior, wherever it started from."""
    random = np.random.default_rng(3)
    matrix, weights = random.normal(size=(3, 2)), random.normal(size=(3, 3))
    target = random.normal(size=3)
    rows = weights @ matrix
    information = rows.T @ rows
    mean = np.linalg.solve(np.eye(2) + information, rows.T @ weights @ target)
    assert np.linalg.eigvalsh(information).min() < 1.0  # the prior counts
    linear = lambda u: jnp.concatenate([rows @ u - weights @ target, u])  # noqa: E731
    for start in (np.zeros(2), np.array([3.0, -2.0])):
        *_, (u, _, reason) = descend(linear, BroydenLM(atol=1e-10), jnp.asarray(start), max_steps=5)
        assert reason == optx.RESULTS.successful
        np.testing.assert_allclose(u, mean, rtol=1e-6)


def test_a_residual_that_is_not_finite_is_a_reason():
    nothing = lambda u: jnp.concatenate([u * jnp.nan, u])  # noqa: E731
    *_, (_, _, reason) = descend(nothing, BroydenLM(), jnp.zeros(2), max_steps=5)
    assert reason == optx.RESULTS.nonlinear_divergence


def test_what_is_left_to_gain_is_half_a_squared_distance_to_the_mean():
    """Of a linear model, in posterior standard deviations."""
    random = np.random.default_rng(3)
    rows, target = random.normal(size=(3, 2)), random.normal(size=3)
    precision = np.eye(2) + rows.T @ rows
    mean = np.linalg.solve(precision, rows.T @ target)
    linear = lambda u: jnp.concatenate([rows @ u - target, u])  # noqa: E731
    start = random.normal(size=2)
    _, state, _ = next(descend(linear, BroydenLM(), jnp.asarray(start), max_steps=5))
    want = 0.5 * (start - mean) @ precision @ (start - mean)
    assert float(state.gain) == pytest.approx(want)


def test_a_descent_is_mapped_and_compiled_in_32_bits():
    """Over starts, of which one is the minimum itself: no step there is a number over none."""
    rows = jnp.asarray([[2.0, 0.5], [0.0, 1.0], [1.0, -1.0]], jnp.float32)

    def linear(u, _):
        return jnp.concatenate([rows @ u, u])

    def ended(start):
        solver = BroydenLM(atol=0.0)
        found = optx.least_squares(linear, solver, start, max_steps=8, throw=False)
        return found.value, found.stats["steps"]

    starts = jnp.asarray([[0.0, 0.0], [1.0, -2.0], [3.0, 0.5]], jnp.float32)
    ends, steps = jax.jit(jax.vmap(ended))(starts)
    assert ends.dtype == jnp.float32
    np.testing.assert_allclose(ends, 0.0, atol=1e-5)
    assert steps[0] == 0
    state = BroydenLM().init(lambda u, a: (linear(u, a), None), starts[0], None, {}, None, None, ())
    _, state, _ = BroydenLM().step(
        lambda u, a: (linear(u, a), None), starts[0], None, {}, state, ()
    )
    assert np.isfinite(state.jacobian).all()


def test_further_outputs_of_a_function_are_refused():
    with pytest.raises(InputError, match="residuals alone"):
        optx.least_squares(lambda u, _: (u, 1.0), BroydenLM(), jnp.ones(2), has_aux=True)


def test_a_step_is_eased_where_it_falls_as_expected_and_damped_where_it_does_not():
    """After Levenberg and Marquardt: a refused step stays where it was, from damping 1; damping
    falls to a quarter where more than half of what was expected is gained."""
    options = {"jacobian": lambda u, _: jacobian(np.asarray(u))}
    call = lambda u, _: (jnp.asarray(residual(np.asarray(u))), None)  # noqa: E731
    solver, start = BroydenLM(), jnp.zeros(2)
    state = solver.init(call, start, None, options, None, None, ())
    worse = lambda u, _: (10.0 * state.residual, None)  # noqa: E731
    u, refused, _ = solver.step(worse, start, None, options, state, ())
    np.testing.assert_array_equal(u, start)
    np.testing.assert_array_equal(refused.residual, state.residual)
    assert not np.allclose(refused.jacobian, state.jacobian)  # it says how the model bends
    assert float(refused.damping) == 1.0
    _, again, _ = solver.step(worse, start, None, options, refused, ())
    assert float(again.damping) == 4.0
    damped = eqx.tree_at(lambda s: s.damping, state, jnp.asarray(8.0))
    explained = lambda u, _: (state.residual + state.jacobian @ u, None)  # noqa: E731
    _, eased, _ = solver.step(explained, start, None, options, damped, ())
    assert float(eased.damping) == 2.0
    hardly = lambda u, _: (state.residual * (1.0 - 1e-6), None)  # noqa: E731
    u, kept, _ = solver.step(hardly, start, None, options, damped, ())
    assert float(kept.damping) == 8.0
    assert np.abs(u).max() > 0.0
