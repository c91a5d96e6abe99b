"""The fit against a closed form: a linear model with a normal prior has a normal posterior."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxopt
import numpy as np
import optimistix as optx
import pytest

from fynjax.errors import InputError
from fynjax.inversion import BroydenLM, Data, FitStatus, ParameterSpace, fit, whitened_residual
from fynjax.inversion._fit_result import _posterior as laplace
from fynjax.inversion._fit_result import scatter_covariance
from tests.helpers import descend
from tests.inversion.linear import DATA, MATRIX, SPACE, posterior, predict


@pytest.mark.parametrize("solver", [None, BroydenLM()], ids=["default", "BroydenLM"])
def test_estimate_and_uncertainty_are_the_normal_posterior(solver):
    result = fit(predict, DATA, SPACE, solver=solver, tolerance=1e-8, max_steps=100)
    mean, covariance = posterior()
    np.testing.assert_allclose(result.estimate, mean, rtol=2e-4)
    np.testing.assert_allclose(result.sd, np.sqrt(np.diag(covariance)), rtol=1e-3)
    share = 1 - np.diag(covariance) / np.asarray(SPACE.prior_sd) ** 2
    np.testing.assert_allclose(result.constrained, share, atol=1e-3)
    np.testing.assert_allclose(result.predicted, predict(result.estimate), rtol=1e-6)
    assert result.converged
    assert result.well_constrained() == ("a.cover", "b.cover")


SOLVERS = {
    "LevenbergMarquardt": optx.LevenbergMarquardt(1e-8, 1e-8),
    "Dogleg": optx.Dogleg(1e-8, 1e-8),
    "BFGS": optx.BFGS(1e-6, 1e-6),  # less is lost in the rounding of the objective
    "jaxopt.LBFGSB": jaxopt.LBFGSB(fun=jnp.sum, tol=1e-6),
    "jaxopt.LBFGS": jaxopt.LBFGS(fun=jnp.sum, tol=1e-6),
    "jaxopt.LevenbergMarquardt": jaxopt.LevenbergMarquardt(
        residual_fun=jnp.sum, tol=1e-5, materialize_jac=True, solver="cholesky"
    ),
    "BroydenLM": BroydenLM(),
}


def bent(x):
    """Not linear, and bent at the estimate too: the misfit that is left matters."""
    return jnp.exp(predict(x) / 4)


BENT = Data(DATA.names, jnp.exp(DATA.value / 4) * jnp.array([1.1, 0.9, 1.2, 1.0]), DATA.sd)


LONG = dict.fromkeys(("Dogleg", "jaxopt.LBFGS"), pytest.mark.study)
"""Of their kind another is tried anyway."""


@pytest.mark.parametrize("name", [pytest.param(name, marks=LONG.get(name, ())) for name in SOLVERS])
def test_solvers_end_at_the_same_minimum(name):
    named = fit(bent, BENT, SPACE, tolerance=1e-9, max_steps=100)
    tolerance = 1e-9 if name == "BroydenLM" else 1e-3  # the others have their own
    result = fit(bent, BENT, SPACE, solver=SOLVERS[name], tolerance=tolerance, max_steps=200)
    assert result.converged, result.explanation
    np.testing.assert_allclose(result.estimate, named.estimate, rtol=1e-5)
    np.testing.assert_allclose(result.covariance, named.covariance, rtol=1e-3, atol=1e-6)


def test_steps_from_outside_are_those_of_a_whole_run():
    """`descend` steps BroydenLM as `optx.least_squares` does: with the same end and state."""
    residual = whitened_residual(bent, BENT, SPACE)
    solver = BroydenLM(atol=1e-6)
    whole = optx.least_squares(residual, solver, jnp.zeros(len(SPACE.names)), max_steps=64)
    steps = list(descend(residual, solver, jnp.zeros(len(SPACE.names)), max_steps=64))
    u, state, reason = steps[-1]
    assert reason == optx.RESULTS.successful
    assert all(r == optx.RESULTS.nonlinear_max_steps_reached for *_, r in steps[:-1])
    assert int(state.steps) == int(whole.stats["steps"]) == len(steps) - 1
    np.testing.assert_allclose(u, whole.value, rtol=1e-9, atol=1e-12)
    named = fit(bent, BENT, SPACE, tolerance=1e-9, max_steps=100)
    np.testing.assert_allclose(u, named.whitened, atol=2e-3)


def many_data():
    shifts = 0.1 * np.random.default_rng(2).normal(size=(3, 4))
    return jnp.asarray(BENT.value * (1 + shifts))


@pytest.mark.parametrize(
    "name", ["default", "BroydenLM", "BFGS", pytest.param("jaxopt.LBFGSB", marks=pytest.mark.study)]
)
def test_fits_mapped_over_data_are_those_of_a_loop(name):
    solver = SOLVERS.get(name)

    def one(value):
        data = Data(BENT.names, value, BENT.sd)
        return fit(bent, data, SPACE, solver=solver, tolerance=1e-6, max_steps=40)

    several = jax.jit(jax.vmap(one))(many_data())
    assert several.converged.shape == (3,)
    assert several.converged.all()
    assert several.loss.shape == (3, 2)
    for i, value in enumerate(many_data()):
        single = one(value)
        assert int(several.steps[i]) == int(single.steps)
        np.testing.assert_allclose(several.loss[i], single.loss, rtol=1e-6)
        np.testing.assert_allclose(several.estimate[i], single.estimate, rtol=1e-6)
        np.testing.assert_allclose(several.sd[i], single.sd, rtol=1e-5)


def test_the_estimate_has_the_derivative_of_a_minimum():
    """By data, prior and a parameter of the model, against differences of whole fits; and of a
    linear model against its normal equations."""

    def estimate(value, centre, power):
        data = Data(BENT.names, value, BENT.sd)
        space = eqx.tree_at(lambda s: s.location, SPACE, centre)  # it is the prior's mean
        model = lambda x, power: jnp.exp(predict(x) * power)  # noqa: E731
        result = fit(model, data, space, context=(power,), tolerance=1e-12, max_steps=80)
        return jnp.array([1.0, -2.0, 0.5]) @ result.estimate + result.predicted.sum()

    at = (BENT.value, SPACE.prior, jnp.asarray(0.25))
    slopes = jax.jit(jax.grad(estimate, argnums=(0, 1, 2)))(*at)
    compiled = jax.jit(estimate)
    for k, slope in enumerate(slopes):
        for i in range(slope.size):
            # Wide, since a search ends some 1e-8 beside its minimum.
            step = 1e-3 * jnp.zeros(slope.size).at[i].set(1.0).reshape(slope.shape)
            ends = [compiled(*at[:k], at[k] + s * step, *at[k + 1 :]) for s in (1, -1)]
            difference = (ends[0] - ends[1]) / 2e-3
            assert float(slope.ravel()[i]) == pytest.approx(float(difference), rel=1e-3, abs=2e-5)
    linear = jax.jit(
        jax.jacfwd(lambda v: fit(predict, Data(DATA.names, v, DATA.sd), SPACE).estimate)
    )
    _, covariance = posterior()
    gain = covariance @ np.asarray(MATRIX).T / np.asarray(DATA.sd) ** 2
    np.testing.assert_allclose(linear(DATA.value), gain, rtol=1e-3, atol=1e-6)


def test_the_reason_is_enumerated():
    assert fit(predict, DATA, SPACE, tolerance=1e-8).status == FitStatus.flat  # the third one
    fields = [a[:2] for a in (SPACE.lower, SPACE.upper, SPACE.prior, SPACE.prior_sd)]
    two = ParameterSpace(("a", "b"), *fields)
    every = lambda x: MATRIX[:, :2] @ x  # noqa: E731
    good = fit(every, DATA, two)
    assert good.status == FitStatus.successful
    assert good.explanation.startswith("Converged after ")
    narrow = ParameterSpace(("a", "b"), fields[0], jnp.array([1.1, 1e4]), *fields[2:])
    bound = fit(every, dataclasses.replace(DATA, value=40 * DATA.value), narrow, max_steps=100)
    assert bound.status == FitStatus.at_bound
    assert "At a bound: a." in bound.explanation
    assert bound.converged
    assert fit(bent, BENT, SPACE, max_steps=1).status == FitStatus.max_steps


def test_a_bound_of_a_solver_that_is_in_the_way_is_no_convergence():
    """Data that want more than the four standard deviations of the prior that it goes."""
    far = dataclasses.replace(BENT, value=1e3 * BENT.value)
    solver = SOLVERS["jaxopt.LBFGSB"]
    assert not fit(bent, far, SPACE, solver=solver, max_steps=100).converged


class Own(jaxopt.LBFGSB):
    """A user's own variant of a solver of jaxopt."""


def test_a_solver_is_known_by_its_class_wherever_it_was_written():
    assert fit(bent, BENT, SPACE, solver=Own(fun=jnp.sum, tol=1e-6), max_steps=100).converged


def test_what_is_no_solver_in_jax_is_refused():
    """Of jaxopt too: what runs in SciPy, looks for a root, or takes the minimum to be known."""
    of_jaxopt = (
        jaxopt.ScipyMinimize(fun=jnp.sum, method="bfgs"),
        jaxopt.Broyden(fun=jnp.sum),
        jaxopt.PolyakSGD(fun=jnp.sum),
    )
    for solver in (optx.Newton(1e-3, 1e-3), "newton", *of_jaxopt):
        with pytest.raises(InputError, match="must be a solver of optimistix or jaxopt"):
            fit(predict, DATA, SPACE, solver=solver)
    with pytest.raises(InputError, match="the class BFGS itself: make an object of it"):
        fit(predict, DATA, SPACE, solver=optx.BFGS)


def test_what_the_data_cannot_see_stays_at_its_prior_and_is_named():
    result = fit(predict, DATA, SPACE, tolerance=1e-8)
    assert float(result.estimate[2]) == pytest.approx(3.0)
    assert float(result.constrained[2]) == pytest.approx(0.0, abs=1e-9)
    (direction,) = result.weakly_constrained_directions(1)
    assert abs(direction["c.cover"]) == pytest.approx(1.0, abs=1e-6)


def test_scatter_that_moves_all_statistics_together_is_an_error_like_any_other():
    """Against the normal equations with the full covariance of the errors."""
    result = fit(predict, DATA, SPACE, tolerance=1e-8)
    draws = jnp.array([[0.4, 0.1, -0.2, 0.3], [-0.1, 0.5, 0.2, 0.0]])
    same = jnp.repeat(result.jacobian[None], 2, axis=0)
    found = result.marginal(draws, same)
    moments = np.asarray(draws).T @ np.asarray(draws) / 2
    shrunk = 0.5 * (moments + np.diag(np.diag(moments)))
    error = np.diag(np.asarray(DATA.sd) ** 2) + shrunk
    a, prior = np.asarray(MATRIX), np.diag(1.0 / np.asarray(SPACE.prior_sd) ** 2)
    covariance = np.linalg.inv(prior + a.T @ np.linalg.solve(error, a))
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(covariance)), rtol=1e-3)
    assert np.all(found.sd >= result.sd * (1 - 1e-9))
    np.testing.assert_allclose(found.estimate, result.estimate)


def oracle_shrinkage(correlation, count):
    """The share of the identity by iterating the oracle's rule (Chen et al. 2010, section III.C):
    the estimate takes the place of the unknown truth until both agree."""
    size, trace, share = len(correlation), np.trace(correlation), 0.5
    for _ in range(10_000):
        estimate = (1.0 - share) * correlation + share * trace / size * np.eye(size)
        both, square = np.trace(estimate @ correlation), np.trace(estimate) ** 2
        share = ((1.0 - 2.0 / size) * both + square) / (
            (count + 1.0 - 2.0 / size) * both + (1.0 - count / size) * square
        )
    return share


@pytest.mark.parametrize(("count", "size"), [(12, 4), (30, 8), (60, 8)])
def test_shrinkage_is_the_fixed_point_of_the_oracle(count, size):
    random = np.random.default_rng(count)
    root = np.eye(size) + 0.7 * np.eye(size, k=1)
    draws = random.normal(size=(count, size)) @ root
    correlation = np.corrcoef(draws.T)
    # The mean is estimated from the draws too, so that they count as one less.
    share = oracle_shrinkage(correlation, count - 1)
    assert 0.1 < share < 0.9
    found = scatter_covariance(draws) / np.outer(*[draws.std(axis=0, ddof=1)] * 2)
    want = (1.0 - share) * correlation + share * np.eye(size)
    np.testing.assert_allclose(found, want, rtol=1e-6, atol=1e-9)


def test_without_chance_nothing_changes():
    result = fit(predict, DATA, SPACE, tolerance=1e-8)
    same = jnp.repeat(result.jacobian[None], 3, axis=0)
    found = result.marginal(jnp.zeros((3, 4)), same)
    np.testing.assert_allclose(found.covariance, result.covariance, atol=1e-9)


def test_slopes_by_chance_are_no_knowledge():
    """Derivatives that differ from draw to draw say nothing, however steep each of them is."""
    size = 40
    space = ParameterSpace(
        ("a.cover",), jnp.array([-1e4]), jnp.array([1e4]), jnp.array([1.0]), jnp.array([1.0])
    )
    draw = np.random.default_rng(3)
    slopes = draw.normal(size=(9, size, 1))
    names = tuple(f"s{i}" for i in range(size))
    data = Data(names, jnp.asarray(slopes[0, :, 0]), jnp.ones(size))
    result = fit(lambda x: jnp.asarray(slopes[0]) @ x, data, space, tolerance=1e-8)
    assert float(result.constrained[0]) > 0.95
    found = result.marginal(jnp.zeros((8, size)), jnp.asarray(slopes[1:]))
    assert float(found.constrained[0]) < 0.75
    assert found.well_constrained() == ()
    many = 60  # more parameters than statistics
    space = ParameterSpace(
        tuple(f"p{i}.cover" for i in range(many)), *(jnp.full(many, v) for v in (-1e4, 1e4, 1, 1))
    )
    slopes_of_many = jnp.asarray(draw.normal(size=(5, 10, many)))
    few = Data(names[:10], jnp.zeros(10), jnp.ones(10))
    wide = fit(lambda x: slopes_of_many[0] @ (x - 1), few, space, tolerance=1e-8)
    assert float(wide.constrained.mean()) > 0.1
    assert float(wide.marginal(jnp.zeros((4, 10)), slopes_of_many[1:]).constrained.mean()) < 0.06
    repeated = result.marginal(jnp.zeros((8, size)), 1.0 + 0.3 * jnp.asarray(slopes[1:]))
    assert repeated.well_constrained() == ("a.cover",)


def test_of_a_hundred_slopes_by_chance_hardly_one_is_called_constrained():
    draw = np.random.default_rng(11)
    names, free = tuple(f"s{i}" for i in range(4)), tuple(f"p{i}.cover" for i in range(3))
    space = ParameterSpace(free, *(jnp.full(3, v) for v in (-1e4, 1e4, 1.0, 1.0)))
    result = fit(
        lambda x: x[:1] * jnp.zeros(4), Data(names, jnp.zeros(4), 0.1 * jnp.ones(4)), space
    )

    def called(others):
        slopes = jnp.asarray(draw.normal(size=(others + 1, 4, 3)))
        moved = dataclasses.replace(result, jacobian=slopes[0])
        return len(moved.marginal(jnp.zeros((others, 4)), slopes[1:]).well_constrained())

    assert sum(called(4) for _ in range(100)) <= 18  # of 300
    assert called(1) == 0


def test_a_parameter_without_a_slope_stays_at_its_prior():
    result = fit(predict, DATA, SPACE, tolerance=1e-8)
    flat = dataclasses.replace(result, jacobian=result.jacobian.at[:, 0].set(0.0))
    found = flat.marginal(jnp.zeros((3, 4)), jnp.repeat(flat.jacobian[None], 3, axis=0))
    assert float(found.constrained[0]) == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.isfinite(found.covariance))


def test_chance_in_one_slope_leaves_the_knowledge_of_another():
    """Steep slopes by chance of two parameters, however they fall, do not touch a third's."""
    draw = np.random.default_rng(8)
    size, count = 30, 3
    names = tuple(f"s{i}" for i in range(size))
    data = Data(names, jnp.zeros(size), jnp.ones(size))
    space = ParameterSpace(
        tuple(f"p{i}.cover" for i in range(count)), *(jnp.full(count, v) for v in (-1e4, 1e4, 1, 1))
    )
    for _ in range(6):
        slopes = draw.normal(size=(5, size, count)) * np.array([8.0, 8.0, 0.1])
        slopes[:, :, 2] += 0.5
        result = fit(lambda x, a=slopes[0]: jnp.asarray(a) @ (x - 1), data, space)
        found = result.marginal(jnp.zeros((4, size)), jnp.asarray(slopes[1:]))
        known = 1 / (1 + size * 0.25)
        assert float(found.constrained[2]) == pytest.approx(1 - known, abs=0.08)


def test_an_offset_is_part_of_the_prediction():
    shift = jnp.array([0.2, -0.1, 0.0, 0.3])
    moved = Data(DATA.names, DATA.value + shift, DATA.sd)
    plain = fit(predict, DATA, SPACE, tolerance=1e-8)
    shifted = fit(predict, moved, SPACE, tolerance=1e-8, offset=shift)
    np.testing.assert_allclose(shifted.estimate, plain.estimate, rtol=1e-6)


def test_an_offset_in_other_bits_than_the_data_compiles_nothing_again():
    traced = []

    def counted(x):
        traced.append(1)
        return predict(x)

    single = Data(DATA.names, *(jnp.asarray(x, jnp.float32) for x in (DATA.value, DATA.sd)))
    counts = []
    for offset in (None, jnp.zeros(4), jnp.zeros(4, jnp.float32)):
        fit(counted, single, SPACE, offset=offset, max_steps=1)
        counts.append(len(traced))
    assert counts[0] == counts[1] == counts[2]


def test_the_objective_falls():
    result = fit(predict, DATA, SPACE)
    before, after = result.loss
    rest = whitened_residual(predict, DATA, SPACE)(jnp.zeros(len(SPACE.names)))
    assert float(before) == pytest.approx(0.5 * float(rest @ rest))
    assert after < before
    assert result.gradient_norm[1] < 1e-3 * result.gradient_norm[0]


def test_too_few_steps_are_not_called_converged():
    result = fit(lambda x: jnp.exp(predict(x) / 4), DATA, SPACE, max_steps=1)
    assert not result.converged
    assert "limit of steps (`max_steps`), after 1 step." in result.explanation


def test_a_refused_step_leaves_everything_where_it_was():
    """A Gauss-Newton step from 5 on an arcus tangens ends at -31, farther from its zero."""
    low, high, prior, sd = (jnp.full(1, v) for v in (-500.0, 500.0, 5.0, 30.0))
    space = ParameterSpace(("x",), low, high, prior, sd)
    zero = Data(("y",), jnp.zeros(1), jnp.full(1, 1e-3))
    stopped, ended = (fit(jnp.arctan, zero, space, max_steps=most) for most in (1, 60))
    assert (stopped.status == FitStatus.max_steps, int(stopped.steps)) == (True, 1)
    assert float(stopped.estimate[0]) == pytest.approx(5.0)
    assert float(stopped.predicted[0]) == pytest.approx(np.arctan(5.0))
    assert stopped.loss[0] == stopped.loss[1]
    assert ended.converged
    assert float(ended.estimate[0]) == pytest.approx(0.0, abs=1e-3)


def test_the_slopes_of_a_model_are_compiled_once_a_fit():
    """They are most of its program: the start's are those of the loop."""
    traced = []

    class Counted(eqx.Module):
        def __call__(self, x):
            return predict(x)

        def jacobian(self, values_at, u):
            traced.append(1)
            return predict(values_at(u)), jax.jacfwd(lambda u: predict(values_at(u)))(u)

    assert fit(Counted(), DATA, SPACE).converged
    assert len(traced) == 1


def test_a_model_that_is_not_finite_ends_in_a_status():
    result = fit(lambda x: predict(x) * jnp.nan, DATA, SPACE, max_steps=3)
    assert not result.converged
    assert "not finite" in result.explanation


def test_scatter_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="must be finite"):
        DATA.with_scatter(jnp.full((3, len(DATA.names)), jnp.nan))


def test_scatter_adds_to_scatter():
    first, second = jnp.array([[0.4, 0.1, -0.2, 0.3]]), jnp.array([[0.0, 0.3, 0.1, 0.1]])
    both = DATA.with_scatter(first).with_scatter(second)
    parts = [np.asarray(d).T @ np.asarray(d) for d in (first, second)]
    expected = np.diag(np.asarray(DATA.sd) ** 2) + sum(
        0.5 * (m + np.diag(np.diag(m))) for m in parts
    )
    whitener = np.asarray(both.whitener)
    np.testing.assert_allclose(np.linalg.inv(whitener.T @ whitener), expected, rtol=1e-10)


def test_bad_targets_and_methods_are_refused():
    with pytest.raises(InputError, match="target b must be finite"):
        Data(("a", "b"), jnp.array([1.0, jnp.nan]), jnp.ones(2))
    with pytest.raises(InputError, match="max_steps"):
        fit(predict, DATA, SPACE, max_steps=0)


def test_no_share_of_the_prior_variance_is_below_zero_by_rounding():
    """Data that say nothing of a parameter take nothing from its variance."""
    count = len(SPACE.names)
    for seed in range(30):
        slope = np.random.default_rng(seed).normal(size=(1, count)) * 1e-9
        share = laplace(SPACE, jnp.zeros(count), jnp.asarray(slope.T @ slope))["constrained"]
        assert share.min() >= 0.0
        assert share.max() < 1e-12
