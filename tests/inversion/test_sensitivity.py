"""Sensitivities against closed forms: slopes, and the function of Ishigami and Homma (1990)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError, MissingExtraError
from fynjax.inversion import ParameterSpace, derivative_measures, local_sensitivity, sobol_indices
from fynjax.inversion import _sensitivity as module

A, B = 7.0, 0.1
CUBE = ParameterSpace(
    ("x1", "x2", "x3"), jnp.full(3, -jnp.pi), jnp.full(3, jnp.pi), jnp.zeros(3), jnp.ones(3)
)
VARIANCE = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
FIRST = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0.0]) / VARIANCE
TOTAL = FIRST + np.array([1.0, 0.0, 1.0]) * B**2 * np.pi**8 * 8 / 225 / VARIANCE


def ishigami(x):
    value = jnp.sin(x[0]) + A * jnp.sin(x[1]) ** 2 + B * x[2] ** 4 * jnp.sin(x[0])
    return jnp.stack([value, 2.0 * x[1]])


METRICS = ("ishigami", "twice x2")


def sobol(**options):
    pytest.importorskip("SALib", reason="the extra `sensitivity` is not installed")
    return sobol_indices(ishigami, CUBE, METRICS, over="bounds", **options)


def test_sobol_indices_are_those_of_the_closed_form():
    found = sobol(samples=4096)
    np.testing.assert_allclose(found.variance[0], VARIANCE, rtol=0.01)
    np.testing.assert_allclose(found.first[0], FIRST, atol=0.02)
    np.testing.assert_allclose(found.total[0], TOTAL, atol=0.02)
    np.testing.assert_allclose(found.total[1], [0, 1, 0], atol=1e-3)
    assert np.all(np.abs(found.total[0] - TOTAL) < 3 * found.total_error[0] + 1e-3)


def test_mean_squared_slopes_are_those_of_the_closed_form_and_bound_the_totals():
    found = derivative_measures(ishigami, CUBE, METRICS, over="bounds", samples=8192)
    own = np.array(
        [
            0.5 * (1 + 2 * B * np.pi**4 / 5 + B**2 * np.pi**8 / 9),
            A**2 / 2,
            8 * B**2 * np.pi**6 / 7,
        ]
    )
    np.testing.assert_allclose(found.measure[0], own * (2 * np.pi) ** 2, rtol=0.02)
    assert np.all(found.bound[0] >= TOTAL)
    np.testing.assert_allclose(found.bound[1], [0, 12 / np.pi**2, 0], rtol=1e-3)


def test_over_the_prior_a_linear_model_meets_its_bound():
    """For a normal parameter the bound is sharp where the model is linear."""
    wide = ParameterSpace(
        ("a", "b"), jnp.full(2, -1e5), jnp.full(2, 1e5), jnp.ones(2), jnp.array([0.5, 2.0])
    )
    linear = lambda x: jnp.stack([2.0 * x[0] + x[1]])  # noqa: E731
    found = derivative_measures(linear, wide, ("sum",), samples=1024)
    share = np.array([1.0, 4.0]) / 5.0
    np.testing.assert_allclose(found.bound[0], share, rtol=0.02)
    pytest.importorskip("SALib", reason="the extra `sensitivity` is not installed")
    totals = sobol_indices(linear, wide, ("sum",), samples=1024)
    np.testing.assert_allclose(totals.total[0], share, atol=0.02)


@pytest.mark.parametrize("mode", ["auto", "forward", "reverse"])
@pytest.mark.parametrize("size", [1, 9])
def test_slopes_and_elasticities_are_those_of_a_power_law(mode, size):
    """y = x^p has the elasticity p, whatever x; in either mode, wide or tall."""
    power = np.arange(1.0, 4.0) - 0.5

    def predict(x):
        return jnp.stack([jnp.prod(x ** (power * (k + 1))) for k in range(size)])

    at = np.array([0.5, 2.0, 3.0])
    metrics = tuple(f"m{k}" for k in range(size))
    found = local_sensitivity(predict, ("a", "b", "c"), metrics, at, mode=mode)
    np.testing.assert_allclose(found.elasticity, np.outer(np.arange(size) + 1, power), rtol=1e-10)
    np.testing.assert_allclose(found.jacobian, found.elasticity * found.value[:, None] / at)


def test_a_metric_of_zero_has_no_elasticity():
    found = local_sensitivity(lambda x: x - 1.0, ("a",), ("m",), np.ones(1))
    assert np.isnan(found.elasticity).all()
    np.testing.assert_allclose(found.jacobian, 1.0)


def test_progress_counts_every_run():
    from contextlib import nullcontext

    class Count:
        done = 0

        def stage(self, name, total=None):
            self.total = total
            return nullcontext()

        def advance(self, n=1, **info):
            self.done += n

    count = Count()
    derivative_measures(ishigami, CUBE, METRICS, samples=64, batch=24, progress=count)
    assert count.done == count.total == 64


def test_wrong_arguments_and_values_are_refused(monkeypatch):
    with pytest.raises(InputError, match="power of two"):
        derivative_measures(ishigami, CUBE, METRICS, samples=100)
    with pytest.raises(InputError, match="'normal'"):
        derivative_measures(ishigami, CUBE, METRICS, over="normal")
    with pytest.raises(InputError, match="1 metrics are named, but `predict` gives 2"):
        derivative_measures(ishigami, CUBE, ("one",))
    with pytest.raises(InputError, match="not finite"):
        derivative_measures(lambda x: jnp.log(x[:1]), CUBE, ("log",), over="bounds", samples=16)
    with pytest.raises(InputError, match="mode"):
        local_sensitivity(ishigami, CUBE.names, METRICS, np.ones(3), mode="sideways")
    with pytest.raises(InputError, match="`at` has shape"):
        local_sensitivity(ishigami, CUBE.names, METRICS, np.ones(2))
    import sys

    monkeypatch.setitem(sys.modules, "SALib", None)
    with pytest.raises(MissingExtraError, match=r"fynjax\[sensitivity\]"):
        sobol_indices(ishigami, CUBE, METRICS)


def test_interrupted_runs_go_on_and_give_what_one_run_does(tmp_path, monkeypatch):
    """Slopes, then indices, in one checkpoint, interrupted in both."""
    pytest.importorskip("SALib", reason="the extra `sensitivity` is not installed")
    memory, calls, real = [], [], module._values

    def both(journal=None):
        options = {"over": "bounds", "samples": 16, "journal": journal}
        slopes = derivative_measures(ishigami, CUBE, METRICS, **options)
        return slopes, sobol_indices(ishigami, CUBE, METRICS, **options)

    def interrupted(points, function, batch):
        calls.append(len(points))
        if len(calls) in (2, 5):
            raise KeyboardInterrupt
        return real(points, function, batch)

    def memory_batch(*_):
        memory.append(True)
        return 2 * len(memory)  # ever more is free

    monkeypatch.setattr(module, "memory_batch", memory_batch)
    monkeypatch.setattr(module, "_BATCHES", 4)
    whole = both()
    memory.clear()
    monkeypatch.setattr(module, "_values", interrupted)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            both(Journal(tmp_path / "kept", "s"))
    again = both(Journal(tmp_path / "kept", "s"))
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    # 16 points of slopes by 4 times 2, then 80 runs by 4 times 4.
    assert calls == [8, 8, 8, 16, 16, 16, 16, 16, 16]
