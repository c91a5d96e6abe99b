"""Sensitivities against closed forms: slopes, and the function of Ishigami and Homma (1990)."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError, MissingExtraError
from fynjax._core.parts import Pool
from fynjax.inversion import (
    ParameterSpace,
    derivative_measures,
    expected_sensitivity,
    sobol_indices,
)
from fynjax.inversion import _sensitivity as module
from fynjax.inversion._sensitivity import local_sensitivity
from tests.heard import hearing

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
    pytest.importorskip("SALib", reason="the extra `analysis` is not installed")
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
        [0.5 * (1 + 2 * B * np.pi**4 / 5 + B**2 * np.pi**8 / 9), A**2 / 2, 8 * B**2 * np.pi**6 / 7]
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
    pytest.importorskip("SALib", reason="the extra `analysis` is not installed")
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


def line(x, offset, slopes):
    return (offset + slopes @ x)[None]


SLOPES, AT = np.array([2.0, -1.0, 0.0]), np.array([1.0, 0.5, 1.0])


def lines(spread, seed=0):
    """Plantings of a linear metric: slopes of a known mean and standard deviation, and an offset
    of mean 3 that is skewed and goes with the first slope."""

    def planting(number):
        chance = np.random.default_rng([seed, number]).normal(size=3)
        return 3.0 + chance[0] + 0.5 * (chance[0] ** 2 - 1.0), SLOPES + spread * chance

    return planting


def expected(planting, **options):
    return expected_sensitivity(line, ("a", "b", "c"), ("m",), AT, planting, **options)


def test_slopes_over_plantings_have_the_known_mean_and_error():
    """Of many runs: truth and spread of the estimates are what each run states."""
    runs = [expected(lines(0.8, seed), accuracy=0.0, most=16) for seed in range(150)]
    truths = {"jacobian": SLOPES, "elasticity": SLOPES * AT / (3.0 + SLOPES @ AT)}
    for key, truth in truths.items():
        found = np.stack([getattr(run, key)[0] for run in runs])
        error = np.stack([getattr(run, key + "_error")[0] for run in runs])
        spread = found.std(axis=0, ddof=1)
        np.testing.assert_allclose(np.sqrt((error**2).mean(axis=0)), spread, rtol=0.2)
        assert np.all(np.abs(found.mean(axis=0) - truth) < 3.5 * spread / np.sqrt(len(runs)))
        held = (np.abs(found - truth) < runs[0].quantile * error).mean(axis=0)
        assert np.all((held > 0.89) & (held < 0.99))
    told = np.mean([run.distinguished[0] for run in runs], axis=0)
    assert told[0] == 1.0
    assert 0.01 < told[2] < 0.11  # one in twenty of those that do nothing


def test_errors_of_elasticities_are_those_of_the_jackknife():
    planting, count = lines(0.8), 40
    found = expected(planting, accuracy=0.0, most=count)
    each = [planting(i) for i in range(count)]
    values = np.array([offset + slopes @ AT for offset, slopes in each])
    moves = np.array([slopes * AT for _, slopes in each])
    without = (moves.sum(axis=0) - moves) / (values.sum() - values)[:, None]
    jackknife = np.sqrt((count - 1) * without.var(axis=0))
    np.testing.assert_allclose(found.elasticity_error[0], jackknife, rtol=0.05)
    np.testing.assert_allclose(found.elasticity[0], moves.mean(axis=0) / values.mean())
    np.testing.assert_allclose(found.value, values.mean())
    np.testing.assert_allclose(found.value_sd, values.std(ddof=1))


def test_what_moves_metric_and_slope_alike_is_no_error_of_an_elasticity():
    """y = c x^p with c by chance: the elasticity is p in every planting."""
    found = expected_sensitivity(
        lambda x, c: (c * x[0] ** 1.5)[None], ("a",), ("m",), np.array([2.0]),
        lambda number: (np.random.default_rng(number).uniform(1.0, 3.0),),
    )  # fmt: skip
    np.testing.assert_allclose(found.elasticity, 1.5)
    assert found.elasticity_error < 1e-12
    assert found.jacobian_error > 0.05


def test_there_are_as_many_plantings_as_the_leading_elasticities_need():
    """Of four parameters the least counts for nothing, whatever its error; of the others the error
    of the least decides: 0.5 / sqrt(n) of it."""

    def planting(number):
        chance = np.random.default_rng(number).normal(size=4)
        return 9.0, np.array([4.0, 1.0, -2.0, 0.01]) * (1.0 + np.array([0, 0.5, 0, 9]) * chance)

    def run(**options):
        return expected_sensitivity(line, "abcd", ("m",), np.ones(4), planting, **options)

    found = run()
    assert 16 <= found.plantings <= 40
    assert found.leading_error <= 0.1
    assert run(accuracy=0.0, most=found.plantings - 8).leading_error > 0.1
    assert run(accuracy=0.5).plantings == 8
    short = run(most=11)
    assert short.plantings == 11
    assert short.leading_error > 0.1
    with pytest.raises(InputError, match="at least 2 plantings, but 1"):
        run(most=1)


def kept(folder):
    """How parts are done that a folder keeps."""
    return partial(Pool().all, journal=Journal(folder, "s"))


def test_plantings_are_kept_and_counted(tmp_path):
    asked = []

    def planting(number):
        if len(asked) == 10:
            asked.append(None)
            raise KeyboardInterrupt
        asked.append(number)
        return lines(0.8)(number)

    options = {"accuracy": 0.0, "most": 20}
    with pytest.raises(KeyboardInterrupt):
        expected(planting, do=kept(tmp_path), **options)
    with hearing() as heard:
        again = expected(planting, do=kept(tmp_path), **options)
    assert asked == [*range(10), None, *range(10, 20)]
    assert heard.count == sum(total for _, total in heard.stages) == 20
    assert heard.stages[-1] == ("Slopes of plantings 17 to 20", 4)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(expected(lines(0.8), **options))):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(InputError, match="planting 2: a metric or its slope is not finite"):
        expected(lambda number: (np.inf if number == 1 else 1.0, SLOPES), most=2)


def test_progress_counts_every_run():
    with hearing() as heard:
        derivative_measures(ishigami, CUBE, METRICS, samples=64, batch=24)
    assert heard.stages == [("Run the model", 64)]
    assert heard.count == 64


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
    with pytest.raises(MissingExtraError, match=r"fynjax\[analysis\]"):
        sobol_indices(ishigami, CUBE, METRICS)


def test_interrupted_runs_go_on_and_give_what_one_run_does(tmp_path, monkeypatch):
    """Slopes, then indices, in one checkpoint, interrupted in both."""
    pytest.importorskip("SALib", reason="the extra `analysis` is not installed")
    memory, calls, real = [], [], module._values

    def both(**how):
        options = {"over": "bounds", "samples": 16, **how}
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
            both(do=kept(tmp_path / "kept"))
    again = both(do=kept(tmp_path / "kept"))
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    # 16 points of slopes by 4 times 2, then 80 runs by 4 times 4.
    assert calls == [8, 8, 8, 16, 16, 16, 16, 16, 16]
