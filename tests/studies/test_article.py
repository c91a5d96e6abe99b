"""The article's numbers beside those of a scene: identities between cells, and printed optics."""

import numpy as np
import pytest

import fynjax as fx
from fynjax.studies.fynbos_2006 import article_tables


@pytest.fixture(scope="module")
def table():
    scene = fx.read_scene(size=1.0, structure="even")
    return article_tables(scene, pixel=0.25, channels=20).set_index("quantity")


def test_cells_obey_the_formulas_between_the_indices(table):
    ours, printed = table.fynjax, table.dirsig
    for cells in (ours, printed):  # printed to four digits
        assert cells["RVI.mean"] == pytest.approx(cells["GCI.mean"] + 1.0, rel=1e-4)
        assert cells["IPVI.mean"] == pytest.approx((cells["NDVI.mean"] + 1.0) / 2.0, rel=1e-4)
        assert cells["NDWI.mean"] == pytest.approx(-cells["GNDVI.mean"], rel=1e-4)
        assert cells["NDWI.std"] == pytest.approx(cells["GNDVI.std"], rel=1e-4)


def test_optics_are_those_that_the_article_prints_but_for_aviris_ng(table):
    optics = table[table.table == "tables 2, 3"]
    ratio = optics.fynjax / optics.real
    assert ratio["pixel of AVIRIS-NG [m]"] == pytest.approx(1.015 / 3.0, rel=1e-3)
    np.testing.assert_allclose(ratio.drop("pixel of AVIRIS-NG [m]"), 1.0, atol=0.03)


def test_numbers_that_contradict_the_article_are_left_out(table):
    assert {"EVI.mean", "IPVI.std", "TVI.std", "RDVI.std"}.isdisjoint(table.index)
    assert table.fynjax.notna().all()
    assert table.real["range of reflectance, swir2"] == pytest.approx(0.0548 / 1.6122)
    assert table.dirsig["mean reflectance, swir2"] == 0.008
