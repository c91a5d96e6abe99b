"""The recipe of the error model: correlation and discrepancy of traits from known ones."""

import numpy as np
import pytest

from fynjax.leaf import default_error_model
from fynjax.leaf._error_model import POPULATION_TRAITS
from fynjax.leaf.data.estimate_error_model import correlation, discrepancy


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


def test_the_shipped_model_is_a_prior():
    """A correlation that a Gaussian can have, and a discrepancy of each trait of laboratories."""
    model = default_error_model()
    assert np.linalg.eigvalsh(model.trait_correlation).min() > 0.02
    np.testing.assert_allclose(np.diag(model.trait_correlation), 1.0)
    level = dict(zip(POPULATION_TRAITS, np.exp(model.trait_discrepancy[:, 0])))
    assert level.pop("structure") == 0.0
    assert all(0.05 < value < 0.5 for value in level.values())
