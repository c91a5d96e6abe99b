"""How spectra go with diversity: against NumPy, scikit-learn, scikit-bio and every exchange."""

from itertools import permutations

import numpy as np
import pytest

import fynjax as fx
from fynjax.app.compare import PlotSpectraPair, plot_diversity_table
from fynjax.diversity import diversity_indices, mantel, metric_agreement, regression_agreement
from fynjax.diversity._agreement import _PENALTIES, _left_out_by_ridge
from fynjax.errors import InputError


def test_correlations_and_their_probability_are_those_of_all_exchanges():
    random = np.random.default_rng(4)
    x, y = random.normal(size=(2, 6))
    other = -y + 0.2 * random.normal(size=6)  # a negative correlation counts as much
    table = metric_agreement({"x": x, "other": other}, {"y": y}).set_index("metric")
    sizes = np.abs([[np.corrcoef(m, y[list(p)])[0, 1] for m in (x, other)]
                    for p in permutations(range(6))])  # fmt: skip
    for place, metric in enumerate(("x", "other")):
        row, values = table.loc[metric], (x, other)[place]
        assert row["value"] == pytest.approx(np.corrcoef(values, y)[0, 1])
        size = abs(row["value"]) - 1e-12
        assert row["p_value"] == pytest.approx((sizes[:, place] >= size).mean(), abs=0.04)
        assert row["p_of_all"] == pytest.approx((sizes.max(axis=1) >= size).mean(), abs=0.04)
        assert row["q05"] < row["value"] < row["q95"]


def test_intervals_hold_the_correlation_that_plots_were_drawn_with():
    random = np.random.default_rng(5)
    held = 0
    for _ in range(60):
        x = random.normal(size=40)
        y = 0.6 * x + 0.8 * random.normal(size=40)
        row = metric_agreement({"x": x}, {"y": y}).iloc[0]
        held += row["q05"] <= 0.6 <= row["q95"]
    assert 0.78 <= held / 60 <= 0.98


def test_the_best_of_many_metrics_of_noise_is_no_find():
    random = np.random.default_rng(6)
    single, all_of_them = [], []
    for _ in range(30):
        metrics = {str(i): random.normal(size=12) for i in range(12)}
        table = metric_agreement(metrics, {"y": random.normal(size=12)})
        single.append(table["p_value"].min() < 0.05)
        all_of_them.append(table["p_of_all"].min() < 0.05)
    assert np.mean(single) > 0.25
    assert np.mean(all_of_them) < 0.2


def test_what_is_not_known_or_does_not_vary_has_no_score():
    x = np.array([1.0, 2.0, np.nan, 4.0, 5.0, 7.0])
    y = np.array([1.0, 3.0, 9.0, 2.0, 5.0, np.nan])
    row, flat = metric_agreement({"x": x, "flat": np.ones(6)}, {"y": y}).to_dict("records")
    assert row["value"] == pytest.approx(np.corrcoef([1.0, 2.0, 4.0, 5.0], [1, 3, 2, 5])[0, 1])
    assert np.isnan([flat[k] for k in ("value", "q05", "q95", "p_value", "p_of_all")]).all()
    for wrong in ({"x": x[:4]}, {"x": x[:, None]}):
        with pytest.raises(InputError, match="at least 5 plots"):
            metric_agreement(wrong, {"y": y})
    with pytest.raises(InputError, match="finite spectra"):
        regression_agreement(x[:, None], {"y": y})


def test_left_out_predictions_are_those_of_scikit_learn():
    ridge = pytest.importorskip("sklearn.linear_model").RidgeCV
    random = np.random.default_rng(7)
    spectra = random.normal(size=(12, 30)) @ np.diag(np.linspace(3.0, 0.01, 30))
    values = spectra @ random.normal(size=(30, 2)) + random.normal(size=(12, 2))
    found = _left_out_by_ridge(spectra, values)
    for plot in range(12):
        others = np.arange(12) != plot
        size = np.linalg.eigvalsh(np.cov(spectra[others].T, ddof=0)).sum()
        model = ridge(_PENALTIES * size, alpha_per_target=True, gcv_mode="eigen")
        model.fit(spectra[others], values[others])
        np.testing.assert_allclose(found[plot], model.predict(spectra[plot : plot + 1])[0], 1e-6)


def test_regression_has_no_skill_in_noise_and_finds_what_is_there():
    random = np.random.default_rng(8)
    spectra = random.normal(size=(18, 50))
    noise = random.normal(size=18)
    some = spectra[:, 3] + spectra[:, 4]
    some[2] = np.nan
    spectra = np.c_[spectra, np.tile(spectra[:, 3:5], 20)]
    asked = {"noise": noise, "some": some, "one": np.ones(18)}
    table = regression_agreement(spectra, asked).set_index("diversity")
    assert table.loc["noise", "value"] < 0.3
    assert table.loc["noise", "p_value"] > 0.05
    assert table.loc["some", "value"] > 0.6
    assert table.loc["some", "p_value"] < 0.01
    assert np.isnan(table.loc["one", "value"])
    assert (table["q05"] < table["q95"])[:2].all()


def test_equal_spectra_have_no_skill_and_ties_below_zero_count():
    found = regression_agreement(np.ones((8, 3)), {"shannon": np.arange(8.0)}).iloc[0]
    assert found["value"] == 0.0
    assert found["p_value"] == 1.0
    # No exchange has a correlation below -1, and those of the plots that are alike have it too.
    apart = 1.0 - np.eye(6)
    apart[0, 1:] = apart[1:, 0] = 2.0
    opposite = mantel(apart, -apart)
    assert opposite["value"] == pytest.approx(-1.0)
    assert opposite["p_value"] == 1.0
    with pytest.raises(InputError, match="one metric or more"):
        metric_agreement({}, {"shannon": np.arange(8.0)})


def test_mantel_is_that_of_scikit_bio():
    skbio = pytest.importorskip("skbio.stats.distance")
    random = np.random.default_rng(9)
    points = random.normal(size=(9, 3))
    near = points + 1.8 * random.normal(size=points.shape)
    a, b = (np.linalg.norm(p[:, None] - p, axis=-1) for p in (points, near))
    found = mantel(a, b)
    value, p, _ = skbio.mantel(a, b, alternative="greater", permutations=9999, seed=0)
    assert found["value"] == pytest.approx(value)
    assert found["p_value"] == pytest.approx(p, abs=0.02)
    assert 0.005 < p < 0.5
    assert found["q05"] < value < found["q95"]
    # A plot that is drawn twice is no pair of alike plots, which would tie any two distances.
    other = random.normal(size=points.shape)
    unrelated = mantel(a, np.linalg.norm(other[:, None] - other, axis=-1))
    assert unrelated["q05"] < 0.0 < unrelated["q95"]
    with pytest.raises(InputError, match="two distances"):
        mantel(a, b[:4, :4])


def test_indices_of_plots_are_the_functions_and_bare_ones_have_none():
    cover = np.array([[0.2, 0.1, 0.3], [0.0, 0.4, 0.0], [0.0, 0.0, 0.0]])
    found = diversity_indices(cover)
    assert found["richness"].tolist() == [3.0, 1.0, 0.0]
    assert found["shannon"][0] == pytest.approx(float(fx.diversity.shannon(cover[0])))
    assert found["simpson"][:2] == pytest.approx([1.0 - (4 + 1 + 9) / 36, 0.0])
    assert np.isnan(found["evenness"][1:]).all()
    assert np.isnan(found["shannon"][2])
    np.testing.assert_allclose(found["cover"], [0.6, 0.4, 0.0])


def test_measured_spectra_that_follow_diversity_show_it_and_simulated_ones_that_do_not():
    random = np.random.default_rng(10)
    wavelength = np.arange(450.0, 2400.0, 50.0)
    cover = random.uniform(size=(16, 5)) * (random.uniform(size=(16, 5)) < 0.7)
    cover[:, 0] += 0.1
    shannon = diversity_indices(cover)["shannon"]
    nir = (wavelength > 750.0) & (wavelength < 1000.0)
    level = 0.1 + 0.2 * nir * shannon[:, None]
    flights = tuple(
        one * (1.0 + 0.02 * (1.0 + s) * random.normal(size=(4, wavelength.size)))
        for one, s in zip(level, 3.0 * cover.sum(axis=1), strict=True)
    )
    simulated = 0.1 + 0.05 * random.uniform(size=level.shape)
    pair = PlotSpectraPair(tuple(map(str, range(16))), wavelength, simulated, flights)
    table = plot_diversity_table(pair, cover, {"cv": random.uniform(size=16)})
    table = table.set_index(["source", "diversity", "metric"]).sort_index()
    assert table.loc[("measured", "shannon", "nir"), "value"] > 0.95
    assert table.loc[("measured", "shannon", "nir"), "p_of_all"] < 0.01
    assert table.loc[("measured", "shannon", "regression"), "value"] > 0.8
    assert table.loc[("measured", "cover", "cv"), "value"] > 0.5  # of the flights
    assert table.loc[("simulated", "shannon", "nir"), "p_of_all"] > 0.1
    assert ("simulated", "composition", "distance") in table.index
    assert ("simulated", "shannon", "angle") not in table.index  # as none was given
