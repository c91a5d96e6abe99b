"""The vegetation tables as BioSCape publishes them: small tables made to their description."""

import csv
import json
import math
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.cli import main
from fynjax.app.io.plot import read_plot
from fynjax.studies.bioscape import read_bioscape
from fynjax.studies.bioscape._plot_files import DEAD, OTHER, _counts, _median_ratio
from tests.studies.test_bioscape import TRAITS, change, sources_of

VERSION = "v20261007"
SUMMARY = f"bioscape_veg_plot_summary_{VERSION}.csv"
SPECIES = f"bioscape_veg_plot_species_{VERSION}.csv"
QUADRATS = f"bioscape_veg_quadrat_summary_{VERSION}.csv"
QUADRAT_SPECIES = f"bioscape_veg_quadrat_species_{VERSION}.csv"
INTERCEPTS = f"bioscape_veg_line_intercepts_{VERSION}.csv"
PLACES = f"bioscape_veg_spatial_{VERSION}.gpkg"

FILES = {
    "TraitLibrary.csv": TRAITS,
    SUMMARY: """record_id,plot,site_code,percent_live_vegetation,percent_bare_soil,\
percent_bare_rock,percent_dead_vegetation,veg_height_mean_cm,soil_depth_cm,sampled
1,T001,grootbos,60,15,5,20,90,-9999,yes
2,T002,capepoint,100,0,0,20,-9999,30,yes
3,T003,capepoint,-9999,-9999,-9999,-9999,-9999,-9999,no
""",
    SPECIES: """record_id,plot,clonal,accepted_genus,accepted_species,percent_cover_alive,\
percent_cover_dead,abundance_alive_count,abundance_dead_count,mean_canopy_diameter_cm
1,T001,no,Protea,repens,30,10,15,4,100
2,T001,yes,Restio,capensis,10,0,200,0,-9999
3,T001,NA,Erica,NA,0,0,0,0,12
4,T002,no,Erica,baccans,50,-9999,40,0,80
5,T002,no,Erica,baccans,30,-9999,20,0,40
""",
    QUADRATS: """record_id,plot,quadrant,total_cover_check,veg_height_cm,post_fire_age_years
1,T001,NE,150,90,12
2,T001,NW,100,90,16
3,T001,SE,100,90,about 2005
4,T001,SW,-9999,90,38718
5,T002,NE,100,90,NA
""",
    QUADRAT_SPECIES: """record_id,plot,quadrant,accepted_genus,accepted_species
1,T001,NE,Protea,repens
2,T001,NW,Protea,repens
3,T001,NW,Protea,repens
""",
    INTERCEPTS: "record_id,plot,line_transect,metres_along_line,accepted_genus,accepted_species,"
    "other_cover_type\n"
    + "".join(
        f"{i},T001,NS,{i}L,{what}\n"
        for i, what in enumerate(
            [
                "Protea,repens,NA",
                "Protea,repens,NA",
                "Restio,capensis,NA",
                "NA,NA,Bare soil",
                "NA,NA,Bare soil and rock",
                "Protea,repens,Dead plant",
                "NA,NA,Other",
                "NA,NA,NA",
            ]
        )
    ),
}  # fmt: skip


pytestmark = [
    pytest.mark.filterwarnings("ignore:.*sum to 120"),
    pytest.mark.filterwarnings("ignore:.*left out. (T002, )?T003"),
]


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    folder = tmp_path / "tables"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    with closing(sqlite3.connect(folder / PLACES)) as base:
        base.execute(
            "CREATE TABLE plot_centers (bioscape_plot_id TEXT, townsend_long REAL, "
            "townsend_lat REAL, quality_flag TEXT)"
        )
        base.execute("INSERT INTO plot_centers VALUES ('T001', 18.4, -34.2, 'Trampled')")
        base.execute("INSERT INTO plot_centers VALUES ('T002', -9999, -9999, 'NA')")
        base.commit()
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_sizes_and_dead_cover_are_taken_from_the_tables(tables: Path) -> None:
    first, second = read_bioscape(tables)
    assert (first.live, first.dead, first.soil, first.rock) == (0.6, 0.2, 0.15, 0.05)
    protea, restio = first.species
    assert protea.size.crown_diameter_m == 1.0
    assert restio.size.crown_diameter_m == read_form_size("tussock")
    assert (protea.size_source[0], restio.size_source[0]) == ("measured", "growth form default")
    # Crowns of 40, 10 and 20 % (the rest): their mean height is that of the vegetation.
    crowns = np.array([0.4, 0.1, 0.2])
    rest = first.height_factor * read_form_size("rounded_shrub", "height_max_m")
    heights = np.array([protea.size.height_m, restio.size.height_m, rest])
    assert 0.8 * crowns @ heights / crowns.sum() == pytest.approx(0.9)
    # A quarter of the Protea's crowns is dead, and the usual share of the rest.
    assert protea.dead_fraction(0.4) == pytest.approx(0.25 + 0.75 * 0.4)
    assert first.standing_dead == 0.0
    assert first.packing == pytest.approx(1 - 0.7 / -math.log(1 - 0.7))
    assert first.litter_fraction == pytest.approx(0.1 / 0.3)
    assert first.age == 14.0
    assert first.visit is not None
    assert (first.visit.longitude, first.visit.remark) == (18.4, "Trampled")
    (erica,) = second.species  # two rows of one species: covers added, diameter by cover
    assert (erica.cover, erica.note.counted) == (0.8, 60.0)
    assert erica.size.crown_diameter_m == pytest.approx((50 * 0.8 + 30 * 0.4) / 80)
    # Not stated: half of the dead cover stands, if it finds room.
    assert erica.dead_fraction(0.4) == 0.4
    assert second.height is None
    assert second.visit is None


def read_form_size(form: str, column: str = "mean_diameter_cm") -> float:
    from fynjax.canopy import table1_2006

    table = table1_2006()
    mean = float(table[table.growth_form == form][column].mean())
    return mean / 100 if column.endswith("_cm") else mean


def test_the_command_writes_sources_counts_intercepts_and_oddities(
    tables: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "plots"
    with pytest.raises(SystemExit) as ended:
        main(["bioscape", "plots", str(tables), "--output", str(output), "--json"])
    summary = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0, summary
    plot = read_plot(output / "T001" / "plot.toml")
    assert plot.taxa == ("Protea repens", "Restio capensis", OTHER)  # no plant that is dead alone
    assert DEAD not in plot.taxa
    np.testing.assert_allclose(plot.cover, [0.4, 0.1, 0.2])
    sources = sources_of(output / "T001")
    for quantity in ("cover", "dead_cover", "crown_diameter", "count"):
        row = sources["Protea repens", quantity]
        assert (row["source"], row["note"]) == ("measured", f"{SPECIES}, row 2")
    assert sources["Restio capensis", "crown_diameter"]["source"] == "growth form default"
    assert sources["Protea repens", "height"]["source"] == "vegetation height, by growth form"

    counts = {row["taxon"]: row for row in rows_of(output / "counts.csv")}
    # 30 % of a circle of 10 m in crowns of 1 m: 30 plants, of which 15 were counted.
    assert float(counts["Protea repens"]["from_cover"]) == pytest.approx(30)
    assert float(counts["Protea repens"]["counted_over_from_cover"]) == pytest.approx(0.5)
    assert summary["counted_over_from_cover"] == pytest.approx(
        np.median([0.5, 60 / (80 * (10 / 0.65) ** 2 / 100)])
    )

    shown = {row["shown"]: row for row in rows_of(output / "intercepts.csv")}
    points = {name: int(row["points"]) for name, row in shown.items()}
    assert points == {"live": 3, "dead": 1, "bare": 2, "other": 1,
                      "Protea repens": 2, "Restio capensis": 1}  # fmt: skip
    assert float(shown["bare"]["percent"]) == pytest.approx(200 / 7, rel=1e-4)
    assert float(shown["bare"]["standard_error_percent"]) == pytest.approx(
        100 * math.sqrt(2 / 7 * 5 / 7 / 7), rel=1e-4
    )
    assert float(shown["bare"]["crew_percent"]) == pytest.approx(20)

    index = {row["plot"]: row for row in rows_of(output / "plots.csv")}
    assert float(index["T001"]["intercept_bare_percent"]) == pytest.approx(200 / 7, rel=1e-4)
    assert index["T002"]["intercept_bare_percent"] == ""

    oddities = [(row["file"], row["row"], row["what"]) for row in rows_of(output / "remarks.csv")]
    assert summary["oddities"] == len(oddities) == 11  # and the height that T002 lacks
    for place, word in {
        (SUMMARY, "3"): "sum to 120",
        (SPECIES, "3"): "no diameter of Restio capensis",
        (SPECIES, "4"): "no cover of Erica",
        (SPECIES, "6"): "rows 5 and 6",
        (QUADRATS, "2"): "sum to 150",
        (QUADRATS, "4"): "'about 2005'",
        (QUADRATS, "5"): "'38718'",
        (QUADRAT_SPECIES, "4"): "also in row 3",
        (INTERCEPTS, "9"): "left out",
        (INTERCEPTS, ""): "no line intercepts",
    }.items():
        assert any((*place, True) == (file, row, word in what) for file, row, what in oddities)


def test_clonal_plants_are_not_held_against_their_cover(tables: Path) -> None:
    change(tables, SPECIES, "1,T001,no,Protea", "1,T001,yes,Protea")
    counts = _counts(read_bioscape(tables))
    assert list(counts["clonal"]) == ["yes", "no"]
    assert _median_ratio(counts) == pytest.approx(60 / (80 * (10 / 0.65) ** 2 / 100))
    assert _median_ratio(counts[:1]) is None


def test_plots_without_covers_are_left_out_and_errors_name_the_cell(tables: Path) -> None:
    with pytest.warns(UserWarning, match=r"plot_summary.*without covers or live.*T003"):
        assert [plot.name for plot in read_bioscape(tables)] == ["T001", "T002"]
    for row in ("baccans,50,-9999", "baccans,30,-9999"):  # all of T002 is dead
        change(tables, SPECIES, row, "baccans,0,20")
    with pytest.warns(UserWarning, match=r"without covers or live species.*T002, T003"):
        assert [plot.name for plot in read_bioscape(tables)] == ["T001"]
    with pytest.raises(InputError, match="live species of plot 'T002'"):
        read_bioscape(tables, ["T002"])
    with pytest.raises(InputError, match="row with covers for plot 'T003'"):
        read_bioscape(tables, ["T003"])
    change(tables, SUMMARY, "3,T003", "3,T002")
    with pytest.raises(InputError, match=r"row 4, column 'plot'.*'T002' is there twice.*row 3"):
        read_bioscape(tables)
    change(tables, SUMMARY, "3,T002", "3,T003")
    change(tables, SPECIES, "30,10,15,4,100", "30,10,15,4,big")
    with pytest.raises(InputError, match=r"row 2, column 'mean_canopy_diameter_cm'.*big"):
        read_bioscape(tables, ["T001"])
    change(tables, SPECIES, "mean_canopy_diameter_cm", "mean_canopy_diam_cm")
    with pytest.raises(
        InputError, match=r"column 'mean_canopy_diameter_cm'.*'mean_canopy_diam_cm'"
    ):
        read_bioscape(tables, ["T001"])
    (tables / SPECIES.replace(VERSION, "v20270101")).write_text("plot\n")
    with pytest.raises(InputError, match=r"expected one bioscape_veg_plot_species_v\*.csv"):
        read_bioscape(tables)


def test_a_file_that_is_no_geopackage_is_named(tables: Path) -> None:
    (tables / PLACES).write_text("not a database, but long enough to be read as one" * 20)
    with pytest.raises(InputError, match=r"spatial.*expected a GeoPackage"):
        read_bioscape(tables)
