"""Agreement, baselines and skill of many plots, on numbers made by hand."""

import numpy as np
import pytest

from fynjax.app.compare._plots import (
    FLAT,
    FLIGHT,
    MODEL,
    OTHERS,
    PlotSpectraPair,
    agreement_table,
    band_table,
    chance_correlation,
    feature_table,
    feature_values,
    leave_one_out,
    mean_agreement,
    misfit_table,
)
from fynjax.app.report.figures._plots import (
    feature_plot,
    misfit_of_plots,
    residual_plot,
    spectra_plot,
)

GRID = np.concatenate([np.arange(420.0, 1330.0, 30.0), np.arange(1470.0, 1780.0, 30.0),
                       np.arange(2110.0, 2440.0, 30.0)])  # fmt: skip


@pytest.fixture(scope="module")
def pair() -> PlotSpectraPair:
    rng = np.random.default_rng(3)
    real = 0.1 + 0.1 * rng.random((5, 1)) + 0.05 * np.sin(GRID / 300.0 + rng.random((5, 1)))
    flights = [r + 0.01 * rng.standard_normal((3, GRID.size)) for r in real]
    simulated = 1.3 * real - 0.02 + 0.01 * rng.standard_normal(real.shape)
    return PlotSpectraPair(tuple("ABCDE"), GRID, simulated, (*flights[:4], flights[4][:1]))


def test_leave_one_out_by_hand() -> None:
    found = leave_one_out(np.array([[1.0, 4.0], [2.0, np.nan], [6.0, 8.0]]))
    np.testing.assert_array_equal(found, [[4.0, 8.0], [3.5, 6.0], [1.5, 4.0]])
    assert np.isnan(leave_one_out(np.ones((1, 2)))).all()


def test_rows_are_those_of_plain_formulas(pair: PlotSpectraPair) -> None:
    table = agreement_table(pair).set_index(["plot", "predictor", "region"])
    real, simulated = pair.measured[1], pair.simulated[1]
    row = table.loc["B", MODEL, "full"]
    error = np.sqrt(np.mean((simulated - real) ** 2))
    assert row["rmse"] == pytest.approx(error)
    assert row["nrmse"] == pytest.approx(error / np.ptp(real))
    assert row["correlation"] == pytest.approx(np.corrcoef(real, simulated)[0, 1])
    cosine = real @ simulated / np.linalg.norm(real) / np.linalg.norm(simulated)
    assert row["spectral_angle"] == pytest.approx(np.degrees(np.arccos(cosine)))
    others = np.delete(pair.measured, 1, axis=0).mean(axis=0)
    assert table.loc["B", OTHERS, "full"]["rmse"] == pytest.approx(
        np.sqrt(np.mean((others - real) ** 2))
    )
    assert table.loc["B", FLAT, "full"]["rmse"] == pytest.approx(
        np.sqrt(np.mean((others.mean() - real) ** 2))
    )
    swir2 = GRID > 2100
    assert table.loc["B", MODEL, "swir2"]["rmse"] == pytest.approx(
        np.sqrt(np.mean((simulated - real)[swir2] ** 2))
    )
    # Noise of 0.01 in one flight, and of 0.01 / sqrt(2) in the mean of two others.
    repeat = table.loc["A", FLIGHT, "full"]["rmse"]
    assert repeat == pytest.approx(0.01 * np.sqrt(1.5), rel=0.15)
    assert ("E", FLIGHT, "full") not in table.index  # one flight only


def test_skill_is_zero_for_the_mean_of_others_and_one_for_the_truth(pair: PlotSpectraPair) -> None:
    right = PlotSpectraPair(pair.plots, GRID, pair.measured, pair.flights)
    skill = mean_agreement(agreement_table(right)).set_index(["predictor", "region"])["skill"]
    assert skill[OTHERS, "full"] == 0
    assert skill[MODEL, "swir1"] == 1
    assert skill[FLAT, "full"] < 0


def test_bands_residual_and_correlation_across_plots(pair: PlotSpectraPair) -> None:
    table = band_table(pair)
    residual = pair.simulated - pair.measured
    np.testing.assert_allclose(table["residual"], residual.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(table["residual_sd"], residual.std(axis=0, ddof=1), rtol=1e-12)
    for i in (0, 20):
        expected = np.corrcoef(pair.measured[:, i], pair.simulated[:, i])[0, 1]
        assert table["correlation"][i] == pytest.approx(expected)
    assert table["flight_sd"].mean() == pytest.approx(0.01, rel=0.1)


def test_chance_correlation_is_that_of_printed_tables() -> None:
    assert chance_correlation(18) == pytest.approx(0.468, abs=5e-4)
    assert chance_correlation(5) == pytest.approx(0.878, abs=5e-4)


def test_a_gain_and_an_offset_are_told_apart() -> None:
    real = 0.1 + 0.05 * np.sin(GRID / 300.0)
    pair = PlotSpectraPair(("A",), GRID, (1.5 * real - 0.02)[None], (real[None],))
    row = misfit_table(pair).iloc[0]
    assert row["gain"] == pytest.approx(1.5)
    assert row["offset"] == pytest.approx(-0.02)
    assert row["shape_share"] == pytest.approx(0, abs=1e-9)


def test_features_read_the_bands_they_name(pair: PlotSpectraPair) -> None:
    spectrum = np.where(GRID < 700, 0.05, 0.2)[None]
    values = feature_values(GRID, spectrum)
    assert values["ndvi"][0] == pytest.approx((0.2 - 0.05) / 0.25)
    assert values["brownness"][0] == 1
    table = feature_table(pair)
    assert (table["rank_correlation"].abs() <= 1).all()


def test_a_plot_nobody_measured_is_left_out_of_the_comparison(pair: PlotSpectraPair) -> None:
    none = np.zeros((0, GRID.size))
    simulated = np.vstack([pair.simulated, pair.simulated[:1]])
    more = PlotSpectraPair((*pair.plots, "F"), GRID, simulated, (*pair.flights, none))
    assert more.those_measured().plots == pair.plots
    assert np.isnan(more.measured[-1]).all()
    assert len(spectra_plot(more).axes) >= 6


def test_figures_show_every_plot_and_the_parts(pair: PlotSpectraPair) -> None:
    titles = [axes.get_title("left") for axes in spectra_plot(pair).axes]
    assert titles[:2] == ["A (3 flights)", "B (3 flights)"]
    residual = residual_plot(pair).axes
    assert len(residual) == 3
    drawn = residual[0].lines[0].get_xydata()
    # Broken where bands were left out.
    assert np.isnan(np.asarray(drawn)[:, 0]).sum() == 2
    assert len(misfit_of_plots(pair).axes[0].patches) == 15
    assert len(feature_plot(pair).axes[0].lines[1].get_xdata()) == 5  # type: ignore[arg-type]
