"""Covers as relevés have them: classes, limits, ranges and traces."""

import shutil

import numpy as np
import openpyxl
import pandas as pd
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.assembly import _forward
from fynjax.app.io.plot import plot_spreads, read_plot
from fynjax.app.io.text import read_rows
from fynjax.scene import SpeciesRow
from fynjax.scene._species import species_rows, table_spreads

HEAD = "taxon;mean_diameter_cm;cover_percent;height_max_m;growth_form\n"


def covers(cells, tmp_path, encoding="utf-8", mark=","):
    path = tmp_path / "species.csv"
    lines = [
        f"Erica {'abcdef'[k]};30;{cell};0{mark}8;rounded_shrub" for k, cell in enumerate(cells)
    ]
    path.write_text(HEAD + "\n".join(lines) + "\n", encoding=encoding)
    return [row for _, row in read_rows(path, SpeciesRow, "a species table")]


def test_each_word_is_its_range(tmp_path):
    for cell, low, high in (
        ("r", 0, 0.1), ("+", 0.1, 1), ("2m", 1, 5), ("2a", 5, 12.5), ("2b", 12.5, 25),
        ("2B", 12.5, 25), ("2 a", 5, 12.5),
        ("<1", 0, 1), ("< 0,5", 0, 0.5), ("≤2 %", 0, 2), (">75", 75, 100), ("5-10", 5, 10),
        ("5 – 10 %", 5, 10), ("2,5 to 5", 2.5, 5), ("trace", 0, 0.1), ("tr.", 0, 0.1),
        ("class 1", 1, 5), ("class 2", 5, 25), ("class 3", 25, 50), ("class 4", 50, 75),
        ("class 5", 75, 100), ("x", 0, 0.1), ("2a.3", 5, 12.5),
    ):  # fmt: skip
        (row,) = covers([cell], tmp_path)
        np.testing.assert_allclose(row.cover_range, (low / 100, high / 100))
        assert row.cover == pytest.approx((low + high) / 200)
    for cell, value in (("12", 12), ("0,5", 0.5), ("3", 3)):
        (row,) = covers([cell], tmp_path)
        assert row.cover_range is None
        assert row.cover == pytest.approx(value / 100)


def test_plain_numbers_are_classes_beside_classes_only(tmp_path):
    rows = covers(["r", "+", "1", "2a", "3"], tmp_path)
    assert [row.cover_range[1] for row in rows] == pytest.approx([0.001, 0.01, 0.05, 0.125, 0.5])
    for cells, which in ((["1", "3", "5"], "1, 3, 5"), (["1.2", "2.3", "3.3"], "1.2, 2.3, 3.3")):
        with pytest.warns(UserWarning, match=f"{which} are taken for percent"):
            rows = covers(cells, tmp_path, mark=".")
        assert [row.cover for row in rows] == pytest.approx([float(cell) / 100 for cell in cells])
    rows = covers(["2a", "15", "0,5"], tmp_path)
    assert [row.cover for row in rows] == pytest.approx([0.0875, 0.15, 0.005])
    with pytest.warns(UserWarning, match="covers of 3 are taken for percent"):
        rows = covers(["2a", "15", "3"], tmp_path)
    assert [row.cover for row in rows] == pytest.approx([0.0875, 0.15, 0.03])
    with pytest.warns(UserWarning, match="3 are taken for percent"):
        covers(["2a", "<1", "3"], tmp_path)
    with pytest.warns(UserWarning, match="4.5 are taken for percent"):
        covers(["+.2", "4.5", "60"], tmp_path, mark=".")
    rows = covers(["4.5", "+.2", "2"], tmp_path, mark=".")  # with sociabilities
    assert [row.cover for row in rows] == pytest.approx([0.625, 0.0055, 0.15])
    for cells, expected in (  # neither zeros nor decimals change the scale, nor do traces make it
        (["+", "0", "1", "2"], [0.0055, 0.0, 0.03, 0.15]),
        (["+", "1,0", "3"], [0.0055, 0.03, 0.375]),
        (["tr", "1", "5"], [0.0005, 0.01, 0.05]),
    ):
        assert [row.cover for row in covers(cells, tmp_path)] == pytest.approx(expected)
    table = {"taxon": ["Erica a", "Erica b"], "mean_diameter_cm": [30, 30], "height_max_m": [1, 1],
             "cover_percent": ["2b", "3"], "growth_form": "rounded_shrub"}  # fmt: skip
    assert [row.cover for row in species_rows(pd.DataFrame(table))] == pytest.approx(
        [0.1875, 0.375]
    )


def test_what_is_none_of_them_is_refused(tmp_path):
    for cell in ("2c", "10-5", "many", "<", "6a"):
        with pytest.raises(InputError, match=r"row 2, column 'cover_percent'"):
            covers([cell], tmp_path)
    (tmp_path / "t.csv").write_text(HEAD.replace(";", ",") + "Erica,3,1,2a,rounded_shrub\n")
    with pytest.raises(InputError, match="row 2, column 'height_max_m'"):
        read_rows(tmp_path / "t.csv", SpeciesRow, "a species table")


def plot_of(folder, shared_data, tmp_path):
    plot = shutil.copytree(shared_data / "field" / "16_species-tables" / folder, tmp_path / folder)
    text = (plot / "plot.toml").read_text()
    (plot / "plot.toml").write_text(
        "".join(line for line in text.splitlines(True) if not line.startswith("leaf_table"))
    )
    return read_plot(plot / "plot.toml")


def test_tables_as_people_bring_them(shared_data, tmp_path):
    first = {}
    for folder in ("bom_semicolon_decimalcomma", "cover_2a", "cover_lt1"):
        plot = plot_of(folder, shared_data, tmp_path)
        first[folder] = plot.species[0]
        assert plot.species[0].taxon == "Metalasia muricata"
        assert plot.species[1].cover == pytest.approx(0.15)
        assert plot.species[0].height == pytest.approx(1.78)
    assert first["cover_2a"].cover_range == pytest.approx((0.05, 0.125))
    assert first["cover_lt1"].cover == pytest.approx(0.005)


def test_a_workbook_is_read_as_text_is(tmp_path):
    book = openpyxl.Workbook()
    book.active.append(HEAD.strip().split(";"))
    for taxon, cover in (("Erica a", "2a"), ("Erica b", 3), ("Erica c", "+")):
        book.active.append([taxon, 30, cover, 0.8, "rounded_shrub"])
    book.save(tmp_path / "species.xlsx")
    rows = read_rows(tmp_path / "species.xlsx", SpeciesRow, "a species table")
    assert [row.cover for _, row in rows] == pytest.approx([0.0875, 0.375, 0.0055])


def test_a_range_is_the_prior_of_its_cover(shared_data, tmp_path):
    plot = plot_of("cover_2a", shared_data, tmp_path)
    name = "species.Metalasia muricata.cover"
    sd = _forward._prior_sd(plot, name, plot_spreads(plot)) * plot.species[0].cover
    assert plot.species[0].cover - 1.645 * sd == pytest.approx(0.05, rel=1e-3)
    assert plot.species[0].cover + 1.645 * sd == pytest.approx(0.125, rel=1e-3)
    other = "species.Passerina corymbosa.cover"
    assert _forward._prior_sd(plot, other, plot_spreads(plot)) == plot.calibration.relative_sd(
        other
    )
    stated = plot.calibration.model_copy(update={"priors": {name: 0.3}})
    assert (
        _forward._prior_sd(
            plot.model_copy(update={"calibration": stated}), name, plot_spreads(plot)
        )
        == 0.3
    )


def test_python_has_the_priors_of_the_command_line(tmp_path):
    """Of classes and ranges of cover, and of what a table leaves open of generic plants."""
    table = [
        {"taxon": f"Erica {k}", "growth_form": "rounded_shrub", "mean_diameter_cm": 30.0,
         "cover_percent": cover, "height_max_m": 0.8, "dead_fraction": dead}
        for k, (cover, dead) in enumerate((("2a", None), ("5-10", 0.2), ("12", None)))
    ]  # fmt: skip
    pd.DataFrame(table).to_csv(tmp_path / "species.csv", index=False)
    free = ("species.*.cover", "species.*.dead_fraction", "species.*.leaf.water")
    for plants in ("fynbos", "generic"):
        own = fx.Scene.from_table(table, size=1.0, voxel=0.5, plants=plants)
        path = tmp_path / "plot.toml"
        path.write_text(
            "[plot]\nsize_m = 1.0\nvoxel_m = 0.5\n"
            f'species_table = "species.csv"\nplants = "{plants}"\n'
        )
        line = _forward.plot_problem(read_plot(path), None, free, seed=0).free
        for scene in (own, fx.read_scene(path)):
            space = fx.free(scene, *free)
            assert space.names == line.names
            np.testing.assert_allclose(space.prior_sd, line.prior_sd, rtol=1e-6)
    a, b, c = (f"species.Erica {k}" for k in range(3))
    spread = dict(own.spreads)
    assert spread[f"{a}.cover"] == pytest.approx(0.075 / 3.29 / 0.0875)
    assert {f"{b}.cover", f"{a}.dead_fraction", f"{c}.leaf.water"} < set(spread)
    assert {f"{c}.cover", f"{b}.dead_fraction"}.isdisjoint(spread)
    # What is stated counts; a pattern of all covers does not replace what was noted of one.
    at = np.asarray(own.parameters.species.cover)
    for prior, wanted in (({"species.*.cover": 0.3}, [spread[f"{a}.cover"], 0.3]),
                          ({f"{a}.cover": 0.1, "species.*.cover": 0.3}, [0.1, 0.3])):  # fmt: skip
        space = fx.free(own, "species.*.cover", prior=prior)
        found = np.asarray(space.prior_sd)[[0, 2]] / at[[0, 2]]
        np.testing.assert_allclose(found, wanted, rtol=0.02)


def test_names_in_the_letters_of_old_spreadsheets(tmp_path):
    path = tmp_path / "species.csv"
    path.write_bytes((HEAD + "Männertreu;30;12,5;0,8;rounded_shrub\n").encode("cp1252"))
    ((_, row),) = read_rows(path, SpeciesRow, "a species table")
    assert (row.taxon, row.cover) == ("Männertreu", pytest.approx(0.125))


def test_a_class_says_nothing_of_a_cover_that_took_its_place(tmp_path):
    (row,) = covers(["2b"], tmp_path)
    name = f"species.{row.taxon}.cover"
    assert table_spreads([row], "fynbos", ())[name] == pytest.approx(0.125 / 3.29 / 0.1875)
    for cover in (0.0, 0.5):
        assert name not in table_spreads([row.replace(cover=cover)], "fynbos", ())
