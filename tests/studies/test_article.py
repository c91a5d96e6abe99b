"""The article's numbers beside those of a scene: identities between cells, and printed optics."""

import numpy as np
import pytest

import fynjax as fx
from fynjax.app.cli import main
from fynjax.metrics import BANDS
from fynjax.scene import with_values
from fynjax.studies.fynbos_2006 import article_tables
from fynjax.studies.fynbos_2006._article import _measured
from fynjax.studies.fynbos_2006._article_page import _gains

GAINS = (0.9, 0.9, 0.45, 1.1)


@pytest.fixture(scope="module")
def table():
    scene = fx.read_scene(size=2.0, structure="even")
    darker = with_values(scene.parameters, scene.taxa, {"ground.brightness": 0.5})
    found = article_tables(scene, darker, gains=GAINS, pixel=0.25, channels=100)
    assert found.quantity.is_unique
    return found.set_index("quantity")


@pytest.mark.parametrize("column", ["dirsig", "uncalibrated", "calibrated_with_gains"])
def test_cells_obey_the_formulas_between_the_indices(table, column):
    cells = table[column]  # printed to four digits
    assert cells["GRVI.mean"] == pytest.approx(cells["GCI.mean"] + 1.0, rel=1e-4)
    assert cells["IPVI.mean"] == pytest.approx((cells["NDVI.mean"] + 1.0) / 2.0, rel=1e-4)
    assert cells["NDWI.mean"] == pytest.approx(-cells["GNDVI.mean"], rel=1e-4)
    assert cells["NDWI.std"] == pytest.approx(cells["GNDVI.std"], rel=1e-4)


def test_optics_are_those_that_the_article_prints_but_for_some(table):
    """27 um, 26.6 mm and 1 km give 1 m; the maker's camera has 5 megapixels and 4.34 mm."""
    optics = table[table.table.isin(["table 2", "table 3"])]
    ratio = optics.uncalibrated / optics.real
    assert ratio["AVIRIS-NG: pixel [m]"] == pytest.approx(1.015 / 3.0, rel=1e-3)
    other = ["AVIRIS-NG: pixel [m]", "Mavic 3M: columns", "Mavic 3M: rows"]
    assert ratio["Mavic 3M: focal length [mm]"] == pytest.approx(1.085)
    np.testing.assert_allclose(ratio.drop([*other, "Mavic 3M: focal length [mm]"]), 1.0, atol=0.03)


def test_table_1_is_what_the_plot_is_planted_from(table):
    species = table[table.table == "table 1"]
    assert len(species) == 3 * 13
    np.testing.assert_allclose(species.uncalibrated, species.real, rtol=1e-5)


def test_figure_12_has_the_indices_of_our_spectrum(table):
    for column in ("uncalibrated", "calibrated"):
        cells = table[table.table == "figure 12"][column]
        assert len(cells) == 10
        assert np.isfinite(cells).all()
        ndvi = cells["NDVI by AVIRIS-NG"]
        assert cells["IPVI by AVIRIS-NG"] == pytest.approx((ndvi + 1.0) / 2.0, rel=1e-5)
        assert ndvi == pytest.approx(table[column]["NDVI.mean"], abs=0.1)
    assert table.loc["NDVI by AVIRIS-NG", "nearest"] == ""  # the real one is not printed


def test_numbers_that_contradict_the_article_are_not_judged(table):
    doubted = ["EVI_green.mean", "IPVI.std", "TVI.std", "RDVI_root.std", "NormNIR.std", "GRVI.std"]
    assert (table.nearest[[*doubted, "foliage_height_diversity"]] == "").all()
    assert (table.nearest[["NDVI.std", "green.mean", "gap_fraction"]] != "").all()
    assert table.real["range of reflectance, swir2"] == pytest.approx(0.0548 / 1.6122)
    assert table.dirsig["mean reflectance, swir2"] == 0.008


def test_the_nearest_is_least_off(table):
    judged = table[table.nearest != ""]
    for quantity, row in judged.iterrows():
        off = {c: abs(row[f"{c}_off_percent"]) for c in ("dirsig", "uncalibrated", "calibrated")}
        if np.isfinite(row.calibrated_with_gains_off_percent):
            off["calibrated_with_gains"] = abs(row.calibrated_with_gains_off_percent)
        assert off[row.nearest] == min(off.values()), quantity
    by_hand = 100.0 * (table.dirsig["WDRVI_005.mean"] + 0.4623) / 0.4623  # both are negative
    assert table.dirsig_off_percent["WDRVI_005.mean"] == pytest.approx(by_hand)


def test_calibration_and_gains_change_what_they_should(table):
    bands = ["green.mean", "red.mean", "red_edge.mean", "nir.mean"]
    through = table.calibrated_with_gains[bands] / table.calibrated[bands]
    np.testing.assert_allclose(through, GAINS, rtol=1e-5)
    assert (table.calibrated[bands] < table.uncalibrated[bands]).all()  # the ground is darker
    swir2 = "mean reflectance, swir2"
    assert table.calibrated[swir2] < table.uncalibrated[swir2]
    gaps = table.loc["gap_fraction"]  # counted in returns, of which darker ground has no more
    assert 0.8 * gaps.uncalibrated < gaps.calibrated <= gaps.uncalibrated


def test_a_folder_without_a_calibration_is_said(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["article", "--calibration", str(tmp_path), "--output", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "parameters.csv" in capsys.readouterr().err


def test_gains_follow_from_the_statistics_of_a_calibration(tmp_path):
    """An expected mean of 0.10 and an image's of 0.08: a gain of 0.9 changes it by 0.008."""
    rows = [f"{band}.mean,0.1,{0.1 + 0.08 * (gain - 1)},0.08" for band, gain in zip(BANDS, GAINS)]
    header = "statistic,after,with_gain,image_after"
    (tmp_path / "statistics.csv").write_text("\n".join([header, *rows]))
    assert _gains(tmp_path) == pytest.approx(GAINS)
    (tmp_path / "statistics.csv").write_text("\n".join([header, *rows[1:]]))
    assert _gains(tmp_path) is None  # as of a calibration without such a camera


def test_instruments_bring_the_plot_back_but_for_their_noise_and_panels():
    """Air, noise and empirical line of even ground: the reflectance that it has. Of a plot of
    another shape too, with panels that would change its mean by a tenth if they counted."""
    bare = fx.Scene.from_table(
        [{"taxon": "One", "growth_form": "mat", "cover_percent": 2.0, "mean_diameter_cm": 10,
          "height_max_m": 0.1}], size=(2.5, 5.0), voxel=0.25, structure="even"
    )  # fmt: skip
    plain = np.asarray(fx.observe(bare, "mavic_3m", pixel=0.125).reflectance.mean(axis=(1, 2)))
    measured = _measured(bare, bare.parameters, 0.125, 0)
    assert measured.shape == (4, 20 * 40 - (4 + 3) * (2 * 4 + 4))
    np.testing.assert_allclose(measured.mean(axis=1), plain, rtol=0.03)
    assert 0.001 < (measured.std(axis=1) / plain).min() < 0.1  # noise was drawn
    other = _measured(bare, bare.parameters, 0.125, 1)
    assert not np.array_equal(other, measured)
