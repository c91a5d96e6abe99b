"""The recipe of the error model: correlation and discrepancy of traits from known ones."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from fynjax.leaf._error_model import POPULATION_TRAITS, default_error_model
from tools.estimate_error_model import correlation, discrepancy, reflectance_share


def test_correlation_is_that_within_sets_drawn_towards_none():
    """Means that differ between sets the other way do not count, nor does a missing trait."""
    draw = np.random.default_rng(0)
    shared = draw.normal(size=(2, 4000))
    sets = [np.stack([s + 50 * i, 0.6 * s + 0.8 * draw.normal(size=4000) - 50 * i], 1)
            for i, s in enumerate(shared)]  # fmt: skip
    assert correlation(sets)[0, 1] == pytest.approx(0.6 * 2 / 3, abs=0.02)
    sets[1][:, 1] = np.nan
    assert correlation(sets)[0, 1] == pytest.approx(0.6 / 2, abs=0.02)


def test_discrepancy_makes_nine_of_ten_intervals_hold():
    """Errors of known size beside those of the spectrum, growing with dry matter."""
    draw = np.random.default_rng(1)
    errors = []
    for _ in range(4):
        thick = draw.uniform(-1, 1, 3000)
        variance, inflation = draw.uniform(0.01, 0.04, 3000), draw.uniform(1, 2, 3000)
        width = np.sqrt(variance + inflation * np.exp(2 * (np.log(0.3) + 0.4 * thick)))
        error = width * draw.normal(size=3000)
        errors.append({"water": [np.stack([error, variance, inflation, thick], 1)]})
    table = discrepancy(errors)
    water = POPULATION_TRAITS.index("water")
    assert np.exp(table[water, 0]) == pytest.approx(0.3, rel=0.05)
    # Drawn towards none, as forty leaves tell it.
    assert 0.15 < table[water, 1] < 0.4
    assert np.all(np.isneginf(np.delete(table[:, 0], water)))


def _sets_of_unlike_errors(draw: np.random.Generator, sets: int) -> list[np.ndarray]:
    """Errors of sets whose standard deviations are lognormal about 0.2, spread by 0.7."""
    deviations = 0.2 * np.exp(0.7 * draw.normal(size=sets))
    return [np.stack([s * draw.normal(size=100), *np.tile([[0.0], [1.0], [0.0], [0.0]], 100)], 1)
            for s in deviations]  # fmt: skip


def test_discrepancy_holds_for_sets_to_come():
    """Sets differ in the size of their errors: 90 % of the leaves of the next one are held, where
    the level that holds for the known sets holds less."""
    draw = np.random.default_rng(2)
    to_come, known = [], []
    traits = ("structure", "chlorophyll", "carotenoids")
    for _ in range(120):
        sets = {t: _sets_of_unlike_errors(draw, 4) for t in traits}
        table = discrepancy([{t: [sets[t][i]] for t in sets} for i in range(4)])
        trait = POPULATION_TRAITS.index("chlorophyll")
        after = np.concatenate(_sets_of_unlike_errors(draw, 40))[:, 0]
        width = 1.645 * np.exp(table[trait, 0])
        to_come.append(np.mean(np.abs(after) < width))
        errors = np.concatenate(sets["chlorophyll"])[:, 0]
        known.append(np.mean(np.abs(after) < np.quantile(np.abs(errors), 0.9)))
    assert np.mean(to_come) == pytest.approx(0.905, abs=0.015)
    assert np.mean(known) < 0.885


def test_the_discrepancy_of_one_set_is_its_own():
    """Nothing says how the next set differs."""
    draw = np.random.default_rng(3)
    (part,) = _sets_of_unlike_errors(draw, 1)
    table = discrepancy([{"chlorophyll": [part]}])
    width = 1.645 * np.exp(table[POPULATION_TRAITS.index("chlorophyll"), 0])
    assert np.mean(np.abs(part[:, 0]) < width) == pytest.approx(0.9, abs=0.01)


def test_the_shipped_model_is_a_prior():
    """A correlation that a Gaussian can have, and a discrepancy of each trait of laboratories."""
    model = default_error_model()
    assert np.linalg.eigvalsh(model.trait_correlation).min() > 0.02
    np.testing.assert_allclose(np.diag(model.trait_correlation), 1.0)
    level = dict(zip(POPULATION_TRAITS, np.exp(model.trait_discrepancy[:, 0])))
    assert level.pop("structure") == 0.0
    assert all(0.05 < value < 0.5 for value in level.values())


def test_the_weight_of_reflectance_alone_is_that_of_least_squares():
    """Sets count relative to their mean square error, and a fifth draws the weight to none."""
    draw = np.random.default_rng(4)
    way = [draw.normal(0.0, s, 50) for s in (0.1, 0.4)]
    error = [0.6 * way[0] + draw.normal(0.0, 0.1, 50), 0.3 * way[1] + draw.normal(0.0, 0.2, 50)]
    ways = [
        (np.mean(e * w) / np.mean(e**2), np.mean(w**2) / np.mean(e**2)) for e, w in zip(error, way)
    ]

    def left(share):
        rest = [np.mean((e - share * w) ** 2) / np.mean(e**2) for e, w in zip(error, way)]
        return sum(rest) + 0.2 * share**2

    assert reflectance_share(ways) == pytest.approx(minimize_scalar(left).x, abs=1e-6)
    assert reflectance_share([(5.0, 1.0)]) == 1.0
    assert reflectance_share([(-1.0, 1.0), (0.0, 0.0)]) == 0.0
