"""The field tables of BioSCape as plot files: small tables by hand, and the real ones."""

import csv
import json
import math
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.cli import main
from fynjax.app.io.plot import read_plot
from fynjax.canopy import FORMS
from fynjax.scene import leaves_of
from fynjax.studies.bioscape._plot_files import (
    DEAD,
    OTHER,
    leaf_parameters,
    run_bioscape,
    write_plot_files,
)
from fynjax.studies.bioscape._plots import BioscapePlot, read_bioscape

COVER = """Plot,PercentBareSoil,PercentBareRock,PercentDeadVegetation,PercentLiveVegetation
A1,15,5,20,60
B2,0,0,0,100
"""
SPECIES = """Plot,GenusSpecies,Genus,Family,PercentCoverAlive
A1,Protea repens,Protea,Proteaceae,30
A1,Restio capensis,Restio,Restionaceae,10
B2,Erica baccans,Erica,Ericaceae,80
B2,Carpobrotus edulis,Carpobrotus,Aizoaceae,40
"""
TRAITS = """GenusSpecies,Family,Mean_Nitrogen,Mean_Carbon,Mean_Leaf_Mass_Per_Area,Mean_Water_Content
"Protea repens","Proteaceae",6,500,300,50
"Restio capensis","Restionaceae",NA,NA,NA,NA
"Restio triticeus","Restionaceae",5,450,600,40
"Restio cincinnatus","Restionaceae",3,450,800,60
"Elegia juncea","Restionaceae",3,450,100,60
"Erica muscosa","Ericaceae",8,530,160,45
"Carpobrotus edulis","Aizoaceae",5,360,900,90
"""
VISITS = """BScpPID,Name,Region,QltyFlg,X,Y,fid,start_time,Band_1
A1,x,y,On Boundary,18.4,-34.2,f1,2023-11-09 13:31:24+00:00,-0.01
A1,x,y,On Boundary,18.4,-34.2,f2,2023-11-26 10:18:52+00:00,-0.01
A1,x,y,On Boundary,18.4,-34.2,f3,2023-11-26 09:15:42+00:00,-0.01
"""
FILES = {
    "CleanCoverData.csv": COVER,
    "CleanVegData.csv": SPECIES,
    "TraitLibrary.csv": TRAITS,
    "VegCenters.csv": VISITS,
}


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    folder = tmp_path / "tables"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


def change(folder: Path, name: str, old: str, new: str) -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))


def sources_of(folder: Path) -> dict[tuple[str, str], dict[str, str]]:
    with (folder / "sources.csv").open() as file:
        return {(row["taxon"], row["quantity"]): row for row in csv.DictReader(file)}


def test_covers_and_leaves_by_hand(tables: Path, tmp_path: Path) -> None:
    a1, b2 = read_bioscape(tables)
    assert (a1.live, a1.dead, a1.soil, a1.rock) == (0.6, 0.2, 0.15, 0.05)
    assert a1.other_cover == pytest.approx(0.2)
    assert a1.standing_dead == pytest.approx(0.1)  # half of 20 %
    assert a1.litter_fraction == pytest.approx(1 / 3)  # 10 of 10 + 15 + 5
    # Random crowns, live and dead, cover 70 % where their areas sum to -ln(0.3) of the ground.
    assert a1.packing == pytest.approx(1 - 0.7 / -math.log(0.3))
    assert b2.packing == pytest.approx(
        1 - 1.2 / -math.log(0.05)
    )  # a closed plot is planted as 95 %
    protea, restio = a1.species
    assert restio.traits["leaf_mass_per_area"].value == 700  # mean of two Restio, Elegia left out
    assert restio.traits["leaf_mass_per_area"].source == "genus mean"
    assert protea.traits["nitrogen"].value == 6

    write_plot_files(a1, tmp_path / "A1")
    plot = read_plot(tmp_path / "A1" / "plot.toml")
    assert plot.taxa == ("Protea repens", "Restio capensis", "Other species", DEAD)
    np.testing.assert_allclose(plot.cover, [0.3, 0.1, 0.2, 0.1])
    assert [s.growth_form for s in plot.species] == [
        "broad_leaved", "tussock", "rounded_shrub", "deadwood",
    ]  # fmt: skip
    leaves = plot.leaves
    # Flat leaf: 300 g/m2; half water. Culm: 700 g/m2 projected over pi/2; 50 % water.
    np.testing.assert_allclose([leaves[0].dry_matter, leaves[0].water], 0.03, rtol=1e-5)
    culm = 0.07 / (math.pi / 2)
    np.testing.assert_allclose([leaves[1].dry_matter, leaves[1].water], culm, rtol=1e-5)
    assert leaves[2].dry_matter == pytest.approx(0.75 * 0.03 + 0.25 * culm, rel=1e-5)
    sources = sources_of(tmp_path / "A1")
    assert sources["Protea repens", "dry_matter"]["source"] == "measured"
    assert sources["Restio capensis", "dry_matter"]["source"] == "genus mean"
    assert sources["Protea repens", "chlorophyll"]["source"] == "growth form default"


def test_plants_of_a_form_that_the_prior_lacks_have_what_the_form_assumes(
    tables: Path, tmp_path: Path
) -> None:
    change(
        tables, "CleanVegData.csv", "Protea repens,Protea,Proteaceae",
        "Hoodia gordonii,Hoodia,Apocynaceae",
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a family without measured leaves
        made = run_bioscape(tables, tmp_path / "out", plots=["A1"])
    (said,) = [line for line in made.warnings if "no growth form" in line]
    assert "fynbos_2023.toml has no growth form column" in said
    plot = read_plot(tmp_path / "out" / "A1" / "plot.toml")
    hoodia, restio = plot.species[:2]
    column = FORMS["column"]
    assert (hoodia.growth_form, hoodia.diameter) == ("column", column.diameter)
    assert hoodia.leaf_area_index == column.prior.leaf_area_index[0]
    assert hoodia.dead_fraction == column.prior.dead_fraction[0]
    assert restio.leaf_area_index == pytest.approx(3.4515, abs=1e-3)  # of the file
    sources = sources_of(tmp_path / "out" / "A1")
    assert sources["*", "leaf_area_index.column"]["source"] == "assumed by growth form"
    assert sources["*", "leaf_area_index.tussock"]["source"] == "learned (fynbos_2023.toml)"


def test_dead_cover_under_live_cover_does_not_stand(tables: Path) -> None:
    change(tables, "CleanCoverData.csv", "B2,0,0,0,100", "B2,0,0,40,100")
    with pytest.warns(UserWarning, match="sum to 140"):
        plot = read_bioscape(tables, ["B2"])[0]
    assert plot.standing_dead == 0
    assert plot.litter_fraction == 1  # all that is not live is litter


def test_leaves_thicker_than_a_leaf_table_takes_are_cut(tables: Path, tmp_path: Path) -> None:
    b2 = read_bioscape(tables, ["B2"])[0]
    write_plot_files(b2, tmp_path / "B2")  # 0.09 * 9 / (pi / 2) = 0.52 cm of water
    assert read_plot(tmp_path / "B2" / "plot.toml").leaves[1].water == 0.05
    assert "cut" in sources_of(tmp_path / "B2")["Carpobrotus edulis", "water"]["note"]


def test_the_command_writes_chosen_plots(
    tables: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "plots"
    with pytest.raises(SystemExit) as ended:
        main(["bioscape", "plots", str(tables), "--output", str(output), "--plot", "A1", "--json"])
    assert ended.value.code == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["plots"] == ["A1"]
    assert summary["cover_share_by_trait_source"]["measured"] == pytest.approx(0.75)
    with (output / "plots.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["plot"] for row in rows] == ["A1"]
    assert float(rows[0]["measured_percent"]) == pytest.approx(75)
    assert float(rows[0]["leaf_mass_per_area_g_m2"]) == pytest.approx(0.75 * 300 + 0.25 * 700)
    assert not (output / "B2").exists()


def test_place_and_sun_are_of_the_flight_in_the_middle(tables: Path, tmp_path: Path) -> None:
    run_bioscape(tables, tmp_path)
    text = (tmp_path / "A1" / "plot.toml").read_text()
    sun = tomllib.loads(text)["sun"]
    # 21.7 and 56.9 degrees at 09:15:42; the others stand at 12.8 and 44.4.
    assert sun["zenith_deg"] == pytest.approx(21.74, abs=0.15)
    assert "# latitude_deg = -34.2" in text
    assert "On Boundary" in text
    assert "not in the tables" in (tmp_path / "B2" / "plot.toml").read_text()


def test_relatives_stand_in_from_near_to_far(tables: Path) -> None:
    (tables / "CleanVegData.csv").write_text(
        "Plot,GenusSpecies,Family,PercentCoverAlive\n"
        "A1,Thamnochortus lucens,Restionaceae,20\n"  # family: mean of 600, 800, 100
        "A1,Tetraria compar,Cyperaceae,20\n"  # tussock: the same three
        "A1,Searsia lucida,Anacardiaceae,10\n"  # broad-leaved: the Protea
        "A1,Metalasia densa,Asteraceae,5\n"  # upright ericoid: the Erica
        "A1,Hermannia sp.,Malvaceae,5\n"  # rounded shrub: the Carpobrotus
        "A1,Cassytha ciliolata,Lauraceae,5\n"  # climber: none
    )
    change(tables, "CleanCoverData.csv", "B2,0,0,0,100\n", "")
    plot = read_bioscape(tables)[0]
    lma = [(s.traits["leaf_mass_per_area"].value, s.traits["leaf_mass_per_area"].source)
           for s in plot.species]  # fmt: skip
    assert lma == [
        (500, "family mean"),
        (500, "growth form mean"),
        (300, "growth form mean"),
        (160, "growth form mean"),
        (900, "growth form mean"),
        (200, "growth form default"),
    ]
    assert plot.trait_shares()["family mean"] == pytest.approx(20 / 65)


@pytest.mark.parametrize(
    ("name", "warned"),
    [
        ("Protea repens (L.) L.", False),
        ("protea_repens", False),
        ("Protea repens subsp. alba", False),
        ("Protea repenss", True),
        ("Proteas repens", True),
    ],
)
def test_names_meet_the_library(tables: Path, name: str, warned: bool) -> None:
    change(tables, "CleanVegData.csv", "Protea repens", name)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        species = read_bioscape(tables)[0].species[0]
    assert species.traits["leaf_mass_per_area"].source == "measured"
    assert species.library_name == "Protea repens"
    assert bool(caught) is warned


def test_old_genera_and_endings_meet_the_library(tables: Path) -> None:
    change(tables, "CleanVegData.csv", "Restio capensis", "Ischyrolepis triticea")
    restio = read_bioscape(tables)[0].species[1]
    assert restio.library_name == "Restio triticeus"
    assert restio.traits["leaf_mass_per_area"].value == 600


def test_another_species_of_the_genus_is_no_slip(tables: Path) -> None:
    change(tables, "CleanVegData.csv", "Erica baccans", "Erica muscoides")
    assert read_bioscape(tables)[1].species[0].library_name is None


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("CleanVegData.csv", ",30", ",45%", r"row 2, .*CoverAlive'.*45%.*Leave out the unit, '%'"),
        ("CleanVegData.csv", ",30", ",2a", r"row 2.*PercentCoverAlive.*cover class"),
        ("CleanVegData.csv", ",30", ",130", r"row 2.*to 100 %, but got 130"),
        ("CleanVegData.csv", ",30", ",", r"row 2, column 'PercentCoverAlive'.*missing"),
        ("CleanVegData.csv", "PercentCoverAlive", "PercentCoverAliv", r"row 1.*'PercentCoverAliv'"),
        ("CleanVegData.csv", "B2,Carpobrotus edulis,Carpobrotus", "B2,Erica baccans,Erica",
         r"row 5, column 'GenusSpecies'.*twice, first in row 4"),
        ("CleanVegData.csv", "A1,Restio capensis,Restio,Restionaceae,10",
         "A1,Protea repens,Protea,Proteaceae,30", r"row 3.*twice, first in row 2"),
        ("CleanVegData.csv", "Plot,G", "B7,", r"row 1, column 'Plot'"),
        ("CleanCoverData.csv", "B2,", "A1,", r"row 3, column 'Plot'.*twice, first in row 2"),
        ("CleanCoverData.csv", "B2,", "C3,", r"'B2'.*CleanVegData.csv has"),
        ("CleanCoverData.csv", "B2,", "C3,0,0,0,100\nB2,", r"row 3.*species of plot 'C3'"),
        ("CleanCoverData.csv", ",60", ",sixty", r"row 2, column 'PercentLiveVegetation'.*sixty"),
        ("TraitLibrary.csv", ",300,", ",0.03,", r"row 2.*Leaf_Mass.*g cm-2.*300"),
        ("TraitLibrary.csv", ",500,300,50", ",500,300,0.5", r"row 2.*Water.*fraction.*50"),
        ("TraitLibrary.csv", ",6,500", ",0.6,500", r"row 2.*Nitrogen.*Percent.*6"),
        ("TraitLibrary.csv", "Elegia juncea", "Erica muscosa", r"row 7.*twice with other traits"),
        ("VegCenters.csv", "2023-11-09 13:31:24+00:00", "9 November 2023", r"row 2.*start_time"),
    ],
)  # fmt: skip
def test_errors_point_at_the_cell(
    tables: Path, file: str, old: str, new: str, message: str
) -> None:
    change(tables, file, old, new)
    with pytest.raises(InputError, match=message) as caught:
        read_bioscape(tables)
    assert file in str(caught.value)


def test_missing_files_and_plots(tables: Path) -> None:
    with pytest.raises(InputError, match=r"plot 'A11'.*Did you mean 'A1'"):
        read_bioscape(tables, ["A11"])
    (tables / "CleanVegData.csv").rename(tables / "CleanVegDat.csv")
    with pytest.raises(InputError, match=r"VegData\.csv.*Did you mean 'CleanVegDat\.csv'"):
        read_bioscape(tables)
    with pytest.raises(InputError, match="there is none"):
        read_bioscape(tables / "nowhere")


def test_a_plot_whose_name_is_no_folder_is_refused(tables: Path) -> None:
    for file in ("CleanCoverData.csv", "CleanVegData.csv"):
        path = tables / file
        path.write_text(path.read_text().replace("A1,", "../A1,"))
    with pytest.raises(InputError, match=r"column 'Plot'.*letters, digits.*'../A1'"):
        read_bioscape(tables)


def test_covers_as_fractions_are_refused(tables: Path) -> None:
    (tables / "CleanVegData.csv").write_text(
        "Plot,GenusSpecies,PercentCoverAlive\nA1,Protea repens,0.3\nB2,Erica baccans,0.8\n"
    )
    with pytest.raises(InputError, match="fractions"):
        read_bioscape(tables)


def test_a_row_joined_to_two_families_counts_once(tables: Path) -> None:
    change(
        tables, "CleanVegData.csv", "A1,Restio", "A1,Protea repens,Protea,Rosaceae,30\nA1,Restio"
    )
    with pytest.warns(UserWarning, match=r"rows 2 and 3.*counted once"):
        plot = read_bioscape(tables)[0]
    assert plot.listed_cover == pytest.approx(0.4)


def _real(folder: Path) -> list[BioscapePlot]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # T070, T265 sum to more; T098 has a double
        return read_bioscape(folder)


def test_every_real_plot_loads_and_its_mean_leaf_is_the_published_one(
    shared_data: Path, tmp_path: Path
) -> None:
    folder = shared_data / "eco" / "bioscape"
    with (folder / "compatible_SpectraCWM.csv").open() as file:
        published = {r["sample_id"]: float(r["LMA_CWM"]) for r in csv.DictReader(file)}
    estimated, expected = [], []
    for plot in _real(folder):
        write_plot_files(plot, tmp_path / plot.name)
        written = read_plot(tmp_path / plot.name / "plot.toml")
        sources = sources_of(tmp_path / plot.name)
        mass = total = 0.0
        leaves = [own[0] for own in leaves_of(written.species, written.leaves)]
        for species, leaf in zip(written.species, leaves, strict=True):
            if species.taxon in (OTHER, DEAD):
                continue
            assert leaf.dry_matter is not None
            total += species.cover
            # The published means leave species without traits out of the sum, but not of the
            # cover that they divide by.
            if sources[species.taxon, "dry_matter"]["source"] == "measured":
                ratio = float(sources[species.taxon, "leaf_area_ratio"]["value"])
                mass += species.cover * leaf.dry_matter * 1e4 * ratio
        if plot.name in published:
            estimated.append(mass / total)
            expected.append(published[plot.name])
    assert len(estimated) >= 5
    assert np.corrcoef(estimated, expected)[0, 1] > 0.999
    # T098 has a species twice in the published mean; all else is the same to rounding.
    assert np.sqrt(np.mean(np.subtract(estimated, expected) ** 2)) < 1.0
    assert np.median(np.abs(np.subtract(estimated, expected))) < 0.01


def test_real_leaves_lie_where_prospect_is_valid(shared_data: Path) -> None:
    for plot in _real(shared_data / "eco" / "bioscape"):
        assert plot.trait_shares()["measured"] > 0.25
        assert sum(plot.trait_shares().values()) == pytest.approx(1.0)
        assert 0.0 <= plot.packing < 0.8
        for species in plot.species:
            assert species.shape.source != "default"
            leaf = leaf_parameters(species)
            assert 0.003 < leaf["dry_matter"] < 0.1
            assert 0.005 < leaf["water"] <= 0.05
            assert 1.2 < leaf["structure"] < 3.0
