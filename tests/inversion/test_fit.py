"""The fit against a closed form: a linear model with a normal prior has a normal posterior."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.inversion import Data, ParameterSpace, fit
from tests.inversion.linear import DATA, MATRIX, SPACE, posterior, predict


@pytest.mark.parametrize(("method", "tolerance"), [("least_squares", 1e-8), ("lbfgsb", 1e-6)])
def test_estimate_and_uncertainty_are_the_normal_posterior(method, tolerance):
    result = fit(predict, DATA, SPACE, method=method, tolerance=tolerance, max_steps=100)
    mean, covariance = posterior()
    np.testing.assert_allclose(result.estimate, mean, rtol=2e-4)
    np.testing.assert_allclose(result.sd, np.sqrt(np.diag(covariance)), rtol=1e-3)
    share = 1 - np.diag(covariance) / np.asarray(SPACE.prior_sd) ** 2
    np.testing.assert_allclose(result.constrained, share, atol=1e-3)
    np.testing.assert_allclose(result.predicted, predict(result.estimate), rtol=1e-6)
    assert result.converged
    assert result.seen() == ("a.cover", "b.cover")


def test_what_the_data_cannot_see_stays_at_its_prior_and_is_named():
    result = fit(predict, DATA, SPACE, tolerance=1e-8)
    assert float(result.estimate[2]) == pytest.approx(3.0)
    assert float(result.constrained[2]) == pytest.approx(0.0, abs=1e-9)
    (direction,) = result.unseen_directions(1)
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
    assert found.seen() == ()
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
    assert repeated.seen() == ("a.cover",)


def test_of_a_hundred_slopes_by_chance_hardly_one_is_called_seen():
    draw = np.random.default_rng(11)
    names, free = tuple(f"s{i}" for i in range(4)), tuple(f"p{i}.cover" for i in range(3))
    space = ParameterSpace(free, *(jnp.full(3, v) for v in (-1e4, 1e4, 1.0, 1.0)))
    result = fit(
        lambda x: x[:1] * jnp.zeros(4), Data(names, jnp.zeros(4), 0.1 * jnp.ones(4)), space
    )

    def called(others):
        slopes = jnp.asarray(draw.normal(size=(others + 1, 4, 3)))
        moved = dataclasses.replace(result, jacobian=slopes[0])
        return len(moved.marginal(jnp.zeros((others, 4)), slopes[1:]).seen())

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


def test_progress_is_told_and_falls():
    told = []
    result = fit(predict, DATA, SPACE, report=lambda loss, norm: told.append((loss, norm)))
    assert len(told) == len(result.loss) > 1
    assert told[-1][0] <= told[0][0]


def test_too_few_steps_are_not_called_converged():
    result = fit(lambda x: jnp.exp(predict(x) / 4), DATA, SPACE, max_steps=1)
    assert not result.converged
    assert "limit of 1 step." in result.status


def test_a_model_that_is_not_finite_ends_in_a_status():
    result = fit(lambda x: predict(x) * jnp.nan, DATA, SPACE, max_steps=3)
    assert not result.converged
    assert "not finite" in result.status


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
    with pytest.raises(InputError, match="'newton'"):
        fit(predict, DATA, SPACE, method="newton")
    with pytest.raises(InputError, match="max_steps"):
        fit(predict, DATA, SPACE, max_steps=0)
