"""What a calibration says of itself: nearer or farther than the table, what is not described."""

import numpy as np
import pandas as pd
import pytest

from fynjax.inversion import Calibration, Data
from fynjax.inversion._verdict import (
    GROUPS,
    compare_means,
    gain_sentences,
    group_of,
    is_worse,
    misfit_without,
)
from fynjax.scene import ModelError
from tests.helpers import stand_in
from tests.scene.plots import small_parameters

NAMES = ("red.mean", "nir.mean", "red_edge.mean", "red.std", "NDVI.mean")
REAL = np.array([0.05, 0.30, 0.10, 0.02, 0.70])
TABLE, ESTIMATE = small_parameters(), small_parameters()


def calibration(before, after):
    return stand_in(
        Calibration,
        data=Data(NAMES, REAL, 0.01 * REAL),
        statistics_before=REAL * before,
        statistics_after=REAL * after,
        statistics_with_gain=REAL,
        before=TABLE,
        after=ESTIMATE,
        misfit=5.0,
        degrees=5,
    )


def test_each_mean_is_held_against_the_table():
    table = compare_means(NAMES, REAL, 1.1 * REAL, REAL * [0.8, 1.02, 1.095, 1.0, 0.7], REAL)
    assert table["statistic"].tolist() == [name for name in NAMES if name.endswith(".mean")]
    assert table["band"].tolist() == [True, True, True, False]
    assert table["moved"].tolist() == ["away", "nearer", "", "away"]
    np.testing.assert_allclose(table["after_error_percent"], [-20.0, 2.0, 9.5, -30.0])
    np.testing.assert_allclose(table["with_gain_error_percent"], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("after", "worse"),
    [
        ([0.7, 0.7, 1.0, 1.0, 1.0], True),  # two bands away, one nearer
        ([0.7, 1.0, 1.0, 1.0, 0.5], False),  # one away, two nearer; an index does not count
        ([1.1, 1.1, 1.1, 1.0, 1.0], False),  # nothing moved
        ([np.nan, 0.7, 1.0, 1.0, 1.0], True),  # what is not finite is not nearer
    ],
)
def test_a_fit_that_leads_away_from_the_bands_offers_the_table(after, worse):
    found = calibration(1.1, np.array(after))
    assert found.worse == worse
    assert found.offered is (TABLE if worse else ESTIMATE)
    said = found.doubts()
    assert bool(said) == worse
    if worse and np.isfinite(after).all():
        assert said[0].startswith("Worse than the table: of 3 bands 2 moved away")
        assert "+10.0 % before and -30.0 % after" in said[0]


def test_without_bands_indices_decide():
    names = ("NDVI.mean", "SR.mean")
    ones = np.ones(2)
    assert is_worse(compare_means(names, ones, 1.02 * ones, 1.5 * ones, ones))
    assert not is_worse(compare_means(names, ones, 1.5 * ones, 1.02 * ones, ones))


def test_groups_of_statistics():
    names = ("red.mean", "red.q05", "NDVI.std", "spectrum.550nm", "lidar.rugosity")
    assert [*map(group_of, names)] == [
        *("means of bands", "spreads of bands", "indices", "a spectrum", "structure")
    ]


def test_a_group_that_is_left_out_has_errors_without_bound():
    """Against the normal equations with an error of the group that is a million times as large."""
    random = np.random.default_rng(4)
    jacobian, rest = random.normal(size=(7, 3)), 3.0 * random.normal(size=7)
    root = random.normal(size=(7, 7)) + 3.0 * np.eye(7)
    covariance = root @ root.T
    group = np.array([0, 0, 1, 0, 0, 1, 0], bool)
    weights = np.linalg.inv(np.linalg.cholesky(covariance))
    found, degrees = misfit_without(weights, rest, jacobian, group)
    wide = covariance + 1e8 * np.diag(group.astype(float))
    want = rest @ np.linalg.solve(wide + jacobian @ jacobian.T, rest)
    assert found == pytest.approx(want, rel=1e-5)
    assert degrees == 5
    every, degrees = misfit_without(weights, rest, jacobian, np.zeros(7, bool))
    assert every == pytest.approx(
        rest @ np.linalg.solve(covariance + jacobian @ jacobian.T, rest), rel=1e-9
    )
    assert (degrees, every > found) == (7, True)


def test_the_model_s_error_at_any_wavelength():
    error = ModelError(
        np.array([500.0, 700.0]), np.array([0.1, 0.2]), np.array([[1.0, 0.5], [0.5, 1.0]])
    )
    covariance = error.covariance([400.0, 500.0, 600.0, 900.0])
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), [0.1, 0.1, 0.15, 0.2])
    assert covariance[0, 1] == pytest.approx(0.01)  # beyond the ends as there
    # Half-way the mean of both ends: (.01 + .01) / 2 with the first, widened to its deviation.
    between = np.sqrt((0.1**2 + 0.2**2 + 2 * 0.5 * 0.1 * 0.2) / 4.0)
    assert covariance[1, 2] == pytest.approx(0.5 * (0.01 + 0.01) * 0.15 / between)
    np.testing.assert_allclose(error.wider(2.0).covariance([500.0, 700.0]),
                               4.0 * error.covariance([500.0, 700.0]))  # fmt: skip


def test_of_gains_the_level_is_told_apart_from_their_ratios():
    """Errors in common leave ratios known: two bands at 0.7 and 1.0 with a shared error of 20 % and
    2 % of their own."""
    shared = np.full((3, 3), 0.2**2) + np.diag(np.full(3, 0.02**2))
    each, both = gain_sentences(("red", "red_edge", "nir"), np.array([0.98, 0.7, 1.0]), shared)
    assert "red_edge 0.700 ± 0.141" in each
    level = (0.98 * 0.7) ** (1 / 3)
    assert f"level, is {level:.2f} ± {level * np.hypot(0.2, 0.02 / 3**0.5):.2f}, 1 within" in both
    ratio_sd = 0.7 * 0.02 * 2**0.5
    assert f"red_edge over nir, is 0.70 ± {ratio_sd:.2f}, different from 1" in both
    _, apart = gain_sentences(("red", "nir"), np.ones(2), np.diag([0.04, 0.04]))
    assert "level, is 1.00 ± 0.14, 1 within its error" in apart  # a mean of two
    assert gain_sentences(("red",), np.array([0.9]), np.array([[0.01]])) == [
        "Gains of the camera: red 0.900 ± 0.090; beforehand 1."
    ]
    assert gain_sentences(("red", "nir"), np.ones(2), np.zeros((2, 2))) == []


def test_gains_that_are_one_factor_have_a_level_and_no_ratio():
    """Ratios of a factor that all bands share are one to the last digit, which says nothing; of
    equal gains with errors of their own two different bands are named."""
    shared = np.full((3, 3), 0.2**2)
    _, level = gain_sentences(("red", "red_edge", "nir"), np.array([0.6, 0.6, 0.6]), shared)
    assert level == "What all have in common, their level, is 0.60 ± 0.12, different from 1."
    _, both = gain_sentences(("red", "nir"), np.ones(2), np.diag([0.01, 0.01]))
    assert "red over nir, is 1.00 ± 0.14, 1 within its error" in both


def test_the_most_extreme_of_many_ratios_is_held_to_more():
    """One of six pairs lies 2.3 standard deviations off in a fifth of cases by chance alone."""
    apart = np.exp(2.3 * 0.1 * 2**0.5)
    two = gain_sentences(("red", "nir"), np.array([apart, 1.0]), np.diag([0.01, 0.01]))
    four = gain_sentences(tuple("abcd"), np.array([apart, 1.0, 1.1, 1.1]), np.diag([0.01] * 4))
    assert two[1].endswith("different from 1.")
    assert four[1].endswith("1 within its error.")
    assert gain_sentences(("red", "nir"), np.ones(2), np.full((2, 2), np.nan)) == []


def test_the_group_without_which_the_rest_is_described_best_is_named(monkeypatch):
    times = {"none": 4.0, "means of bands": 3.5, "spreads of bands": 1.25, "indices": 3.9}
    table = pd.DataFrame({"left_out": list(times), "times": list(times.values())})
    monkeypatch.setattr(Calibration, "misfit_by_group", lambda self: table)
    found = stand_in(Calibration, misfit=40.0, degrees=10, plantings=()).misfit_sentence()
    assert found == (
        "The misfit is 4 times what was expected; on a line 4, and 1.2 without "
        f"{GROUPS['spreads of bands']}: intervals are widened by it."
    )
