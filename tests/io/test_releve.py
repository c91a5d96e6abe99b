"""A table of plants in its writer's own words: what each column and each cell is taken for."""

from pathlib import Path

import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.plot import HEATH_TABLE, read_releve
from fynjax.app.io.plot._column_words import form_of_words, ground_of_words, heading
from fynjax.canopy import FORMS, form_of_taxon


def releve(folder: Path, text: str, name: str = "releve.csv"):
    (folder / name).write_text(text, "utf-8")
    return read_releve(folder / name)


def column(read, name: str) -> list[str]:
    return [plant.cells[name] for plant in read.plants]


@pytest.mark.parametrize(
    ("name", "role", "unit"),
    [("Espèce", "taxon", ""), ("Nombre científico", "taxon", ""), ("Artname", "taxon", ""),
     ("Recouvrement (%)", "cover", "%"), ("% cover", "cover", "%"), ("Deckung in %", "cover", "%"),
     ("Cover [fraction]", "cover", "fraction"), ("Abondance-dominance", "cover", ""),
     ("Hauteur max. (cm)", "height", "cm"), ("Wuchshöhe [m]", "height", "m"),
     ("Hoogte", "height", ""),
     ("CrownDiameter_m", "diameter", "m"), ("diam. houppier (cm)", "diameter", "cm"),
     ("Stem diameter (cm)", "", "cm"), ("Altitude", "", ""), ("Type biologique", "form", ""),
     ("Strate", "layer", ""), ("Famille", "family", ""), ("N° relevé", "plot", "")],
)  # fmt: skip
def test_headings_in_several_languages(name: str, role: str, unit: str) -> None:
    assert (heading(name).role, heading(name).unit) == (role, unit)


@pytest.mark.parametrize(
    ("words", "form"),
    [("chaméphyte", "rounded_shrub"), ("Zwergstrauch", "rounded_shrub"), ("graminée", "tussock"),
     ("Gräser", "tussock"), ("Nanophanérophyte", "broad_leaved"), ("NP", "broad_leaved"),
     ("Moose", "moss_layer"), ("climber", "climber"), ("cushion plant", "cushion"), ("?", "")],
)  # fmt: skip
def test_life_forms_in_several_languages(words: str, form: str) -> None:
    assert form_of_words(words) == form


def test_a_genus_and_a_family_belong_to_one_form_each() -> None:
    named: dict[str, str] = {}
    for form, record in FORMS.items():
        for taxa in (record.flat_leaved, record.round_leaved):
            for one in (*taxa.genera.split(), *taxa.families.split()):
                assert named.setdefault(one, form) == form
                assert one.endswith("aceae") == (one in taxa.families.split())
    assert form_of_taxon("Quercus", "Poaceae").growth_form == "broad_leaved"
    assert form_of_taxon("Nowhere", "Poaceae").source == "family"
    assert form_of_taxon("Nowhere") is None


GARRIGUE = """Espèce;Recouvrement;Hauteur (cm);Famille;Type biologique;Strate;Remarque
Quercus coccifera;37,5;95;Fagaceae;Nanophanérophyte;arbustive;dense
Rosmarinus officinalis;12;80;Lamiaceae;chaméphyte;arbustive;
Brachypodium retusum;30;25;;graminée;herbacée;
Xyzus ignotus;3;40;Cistaceae;;herbacée;
Ignota alta;2;210;;;arbustive;
Sol nu;10;;;;;
Rocher;30;;;;;
Total;124,5;;;;;
"""


def test_a_garrigue_in_french(tmp_path: Path) -> None:
    """Semicolons, decimal commas, heights in cm, no crown diameters, rows that are no plants."""
    read = releve(tmp_path, GARRIGUE)
    assert column(read, "cover_percent") == ["37.5", "12", "30", "3", "2"]
    assert column(read, "height_max_m") == ["0.95", "0.8", "0.25", "0.4", "2.1"]
    forms = ["broad_leaved", "rounded_shrub", "tussock", "rounded_shrub", "broad_leaved"]
    assert column(read, "growth_form") == forms
    assert [p.form_from for p in read.plants] == ["genus", "genus", "genus", "family", "height"]
    usual = [f"{100 * FORMS[form].diameter:.6g}" for form in forms]
    assert column(read, "mean_diameter_cm") == usual
    assert {plant.assumed for plant in read.plants} == {("mean_diameter_cm",)}
    assert read.ground == {"bare": 10.0, "rock": 30.0}
    assert read.note_columns == ("Remarque",)
    assert read.plants[0].notes == {"Remarque": "dense"}
    said = " ".join(read.said)
    for words in ("'Recouvrement'", "Crown diameters of all plants are usual", "row 9 (Total)",
                  "by height alone: Ignota alta broad_leaved. Look at these"):  # fmt: skip
        assert words in said


@pytest.mark.parametrize(
    ("heads", "cells", "metres"),
    [("height", ("120", "35"), ("1.2", "0.35")), ("height", ("1.2", "0.35"), ("1.2", "0.35")),
     ("height (cm)", ("1.2", "3.5"), ("0.012", "0.035")), ("height", ("4", "8"), ("4", "8")),
     ("height [mm]", ("900", "80"), ("0.9", "0.08")), ("height", ("0.5", "40 cm"), ("0.5", "0.4")),
     ("height", ("8.1", "30"), ("0.081", "0.3"))],
)  # fmt: skip
def test_units_of_heights(tmp_path: Path, heads: str, cells, metres) -> None:
    read = releve(tmp_path, f"taxon,cover,{heads}\nA a,20,{cells[0]}\nB b,10,{cells[1]}\n")
    assert column(read, "height_max_m") == list(metres)


@pytest.mark.parametrize(
    ("cells", "centimetres"),
    [(("0.4", "1.2"), ["40", "120"]), (("40", "120"), ["40", "120"]), (("2", "5"), ["2", "5"]),
     (("6.5", "30"), ["6.5", "30"])],
)  # fmt: skip
def test_units_of_diameters(tmp_path: Path, cells, centimetres) -> None:
    read = releve(tmp_path, f"taxon,cover,crown width\nA a,20,{cells[0]}\nB b,10,{cells[1]}\n")
    assert column(read, "mean_diameter_cm") == centimetres


@pytest.mark.parametrize(
    ("head", "cells", "covers"),
    [("cover", ("0.35", "0.2"), ["35", "20"]), ("cover %", ("0.35", "7"), ["0.35", "7"]),
     ("cover (fraction)", ("0.01", "0.5"), ["1", "50"]),
     ("cover", ("1.1", "0.05"), ["1.1", "0.05"]),
     ("Braun-Blanquet", ("2a", "3"), ["2a", "class 3"]), ("cover", ("5 %", "<1"), ["5", "<1"])],
)  # fmt: skip
def test_covers_as_people_write_them(tmp_path: Path, head: str, cells, covers) -> None:
    read = releve(tmp_path, f"taxon,{head}\nA a,{cells[0]}\nB b,{cells[1]}\n")
    assert column(read, "cover_percent") == covers


def test_a_class_stays_a_class_where_a_row_of_ground_tells_it(tmp_path: Path) -> None:
    read = releve(tmp_path, "taxon,cover\nA a,3\nB b,2\nlitter,2a\n")
    assert column(read, "cover_percent") == ["class 3", "class 2"]
    assert read.ground == {"litter": 8.75}


@pytest.mark.parametrize(
    ("head", "cells", "covers"),
    [("Recouvrement", ("4.5", "+.2", "2,3"), ["class 4", "+.2", "class 2"]),
     ("cover", ("4.5", "r.1", "2a.3"), ["class 4", "r.1", "2a.3"]),
     ("Braun-Blanquet", ("3", "2", "1"), ["class 3", "class 2", "class 1"]),
     ("BB", ("3.4", "2.2", "1.1"), ["class 3", "class 2", "class 1"]),
     ("Artmächtigkeit", ("4", "0", "1"), ["class 4", "0", "class 1"]),
     ("Cover (Braun-Blanquet)", ("37.5", "3", "15"), ["37.5", "3", "15"]),
     ("Cover class", ("3", "+", "r"), ["class 3", "+", "r"]),
     ("CoverClass", ("<1", "5-10", "1-5"), ["<1", "5-10", "1-5"]),
     ("Cover (Domin midpoints)", ("8", "4", "1"), ["8", "4", "1"])],
)  # fmt: skip
def test_the_heading_or_a_sociability_says_that_covers_are_classes(
    tmp_path: Path, head: str, cells, covers
) -> None:
    rows = "\n".join(f"{name};{cell}" for name, cell in zip("ABC", cells, strict=True))
    read = releve(tmp_path, f"taxon;{head}\n{rows}\n")
    assert column(read, "cover_percent") == covers
    assert read.plants[1].record.cover < 0.26


@pytest.mark.parametrize(
    ("head", "words"),
    [("Cover (Domin)", "classes of Domin cannot be read: write the middle"),
     ("Londo", "classes of Londo"), ("Cover class", "not of which scale"),
     ("Braun-Blanquet", "not all cells are classes of Braun-Blanquet"),
     ("CoverClass", "not of which scale"), ("cover,HeightClass", "classes are no height"),
     ("Crown cover (m2)", "covers in m2 are no shares of the ground: divide them"),
     ("Cover (cm)", "covers in cm are no shares"), ("cover,Height class", "classes are no height"),
     ("cover,Crown area", "an area needs its unit")],
)  # fmt: skip
def test_headings_that_say_of_no_percent_and_no_length_are_refused(
    tmp_path: Path, head: str, words: str
) -> None:
    more = ",3" * head.count(",")
    with pytest.raises(InputError, match=words):
        releve(tmp_path, f"taxon,{head}\nA a,8{more}\nB b,7{more}\nC c,10{more}\n")


def test_fractions_under_a_heading_of_classes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not of which scale"):
        releve(tmp_path, "taxon,Cover class\nA a,0.625\nB b,0.375\n")


def test_a_column_of_names_says_more_than_one_of_numbers(tmp_path: Path) -> None:
    read = releve(tmp_path, "SPECIES_NR;SPEC_NAME;COVER_PERC\n123;Calluna vulgaris;38\n")
    assert column(read, "taxon") == ["Calluna vulgaris"]
    read = releve(tmp_path, "Genus,Species,Cover (%)\nProtea,repens,30\nErica,,10\n")
    assert column(read, "taxon") == ["Protea repens", "Erica sp."]
    read = releve(tmp_path, "Genus,Species,Cover (%)\nProtea,repens,30\nLitter,,10\n")
    assert read.ground == {"litter": 10.0}
    with pytest.raises(InputError, match="numbers are no names of plants"):
        releve(tmp_path, "Species no,Cover (%)\n12,30\n13,10\n")


@pytest.mark.parametrize(
    ("head", "cells", "centimetres"),
    [("Crown radius (m)", ("0.6",), "120"), ("Rayon", ("30",), "60"),
     ("Crown area (m2)", ("1.2",), "123.608"), ("Kronenfläche [cm²]", ("1000",), "35.6825"),
     ("D1 (cm),D2 (cm)", ("120", "90"), "105"), ("diam1 (cm),diam2 (cm)", ("12", "9"), "10.5"),
     ("Length (m),Width (m)", ("1.2", "0.8"), "100"),
     ("Leaf length (cm),Shoot length (cm),Crown width (m)", ("9", "9", "1.1"), "110"),
     ("Crown radius (m),Crown diameter (m)", ("9", "1.1"), "110")],
)  # fmt: skip
def test_radii_areas_and_two_diameters_make_crown_diameters(
    tmp_path: Path, head: str, cells, centimetres: str
) -> None:
    read = releve(tmp_path, f"taxon,cover,{head}\nErica,20,{','.join(cells)}\n")
    assert column(read, "mean_diameter_cm") == [centimetres]
    assert not read.plants[0].assumed[:-1]


@pytest.mark.parametrize(
    ("head", "cells", "words"),
    [("Height", ("5", "2"), "height of Thymus 5 m, for a usual 0.06 m; Moss 2 m"),
     ("Diameter", ("1", "3"), "diameter of Thymus 0.01 m, for a usual 0.3 m.")],
)  # fmt: skip
def test_sizes_without_a_unit_that_a_form_does_not_have_are_doubted(
    tmp_path: Path, head: str, cells, words: str
) -> None:
    text = "taxon,cover,{}\nThymus,20,{}\nMoss,10,{}\n"
    with pytest.warns(UserWarning, match=words):
        releve(tmp_path, text.format(head, *cells))
    releve(tmp_path, text.format(f"{head} (cm)", *cells))


def test_every_fault_is_told_at_once_with_what_to_write(tmp_path: Path) -> None:
    text = (
        "Species,Cover,Height (m),Diameter (cm)\n"
        "Erica arborea,abc,1.2,50\n,5,0.4,20\nUlex parviflorus,10,tall,30\n"
        "Erica arborea,8,0.8,40\nCistus albidus,,0.5,30\nStipa offneri,7,0.3,4000\n"
    )
    with pytest.raises(InputError) as found:
        releve(tmp_path, text)
    said = str(found.value)
    assert "6 faults" in said
    for row, words in (
        (2, "'Cover': expected a cover, but got 'abc'"), (3, "'Species': the plant has no name"),
        (4, "'Height (m)': expected a height, but got 'tall'"),
        (5, "'Erica arborea' is there twice, first in row 2: add the covers up"),
        (6, "'Cover': no cover: write percent"), (7, "'Diameter (cm)': expected a number from"),
    ):  # fmt: skip
        assert f"row {row}" in said
        assert words in said


def test_columns_that_are_missing_and_plots_that_are_several(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"2 faults: .*no column is the taxon, among .*Call it tax"
    ):
        releve(tmp_path, "Hauteur,Notes\n1,2\n")
    text = "plot,species,cover\nA,Erica a,10\nA,Ulex b,2\nB,Erica a,3\n"
    with pytest.raises(InputError, match=r"column 'plot'.*2 plots are in the table \(A, B\)"):
        releve(tmp_path, text)
    with pytest.raises(InputError, match=r"'Cover 2020', 'Cover 2021' may each be the cover"):
        releve(tmp_path, "species,Cover 2020,Cover 2021\nErica a,1,2\n")


def test_layers_genus_with_epithet_row_numbers_and_own_columns(tmp_path: Path) -> None:
    text = (
        ',Genus,Epithet,Stratum,Cover,leaf_area_index\n"1",Quercus,ilex,tree,30,2.5\n'
        '"2",Quercus,ilex,shrub,10,\n"3",Thymus,vulgaris,shrub,5,\n'
    )
    read = releve(tmp_path, text)
    taxa = ["Quercus ilex (tree)", "Quercus ilex (shrub)", "Thymus vulgaris"]
    assert column(read, "taxon") == taxa
    assert read.plants[0].record.leaf_area_index == 2.5
    assert read.note_columns == ()
    assert column(read, "growth_form") == ["broad_leaved", "broad_leaved", "mat"]


def test_two_diameters_are_averaged_and_of_heights_the_greatest_is_taken(tmp_path: Path) -> None:
    text = (
        "taxon,cover,diameter 1 (cm),diameter 2 (cm),mean height m,max height m\nA a,9,20,40,1,2\n"
    )
    read = releve(tmp_path, text)
    assert column(read, "mean_diameter_cm") == ["30"]
    assert column(read, "height_max_m") == ["2"]


def test_the_shipped_heath_states_its_source() -> None:
    read = read_releve(HEATH_TABLE)
    assert any("ecotraj" in line for line in read.comments)
    assert sum(plant.record.cover for plant in read.plants) == pytest.approx(1.19)
    assert not any(plant.assumed for plant in read.plants)


@pytest.mark.parametrize(
    ("name", "role", "unit"),
    [
        ("Rec. (%)", "cover", "%"),
        ("PFC (%)", "cover", "%"),
        ("Haut. (cm)", "height", "cm"),
        ("Max ht (mm)", "height", "mm"),
        ("Altura total (m)", "height", "m"),
        ("Kronen-Ø (cm)", "diameter", "cm"),
        ("Crown spread (m)", "diameter", "m"),
        ("Canopy radius (m)", "radius", "m"),
        ("DAS (cm)", "", "cm"),
    ],
)
def test_short_headings_of_other_vegetation_are_known(name, role, unit):
    found = heading(name)
    assert (found.role, found.unit) == (role, unit)


@pytest.mark.parametrize(
    ("words", "form"),
    [
        ("subarbusto", "rounded_shrub"),
        ("arbusto decumbente", "mat"),
        ("palmeira", "rosette"),
        ("capim", "tussock"),
        ("cipó", "climber"),
        ("hummock grass", "tussock"),
        ("grass tree", "rosette"),
        ("mallee", "broad_leaved"),
        ("geoxílio", "rounded_shrub"),
    ],
)
def test_life_forms_of_cerrado_and_kwongan_have_a_growth_form(words, form):
    assert form_of_words(words) == form


def test_ground_in_other_words_is_no_plant():
    found = [ground_of_words(w) for w in ("Solo exposto", "Serapilheira", "terra nua", "mantillo")]
    assert found == ["bare", "litter", "bare", "litter"]


def test_a_row_without_the_greatest_height_has_the_mean_one(tmp_path: Path) -> None:
    text = (
        "Especie;Cobertura (%);Altura media (m);Altura máxima (m);Forma de vida\n"
        "Adesmia arborea;9;1,3;;arbusto\nTrevoa quinquenervia;5;s/d;2,1;arbusto\n"
        "Proustia cuneifolia;5;s/d;sin dato;arbusto\n"
    )
    read = releve(tmp_path, text)
    assert column(read, "height_max_m")[:2] == ["1.3", "2.1"]
    assert [plant.assumed[-1:] == ("height_max_m",) for plant in read.plants] == [
        False,
        False,
        True,
    ]
    assert (
        "Where 'Altura máxima (m)' is empty, the height is that of 'Altura media (m)'." in read.said
    )


def test_of_a_herb_the_family_and_of_a_rosette_its_genus_says_the_form(tmp_path: Path) -> None:
    text = (
        "Especie;Familia;Forma de vida;Cobertura (%)\n"
        "Xyzus altus;Poaceae;Hierba perenne;7\nXyzus minor;Poaceae;H;7\n"
        "Xyzus ruber;Asparagaceae;Arbusto;7\nXyzus albus;Asteraceae;planta herbácea;7\n"
        "Puya chilensis;Bromeliaceae;Roseta suculenta;7\nXyzus planus;;hierba en roseta;7\n"
    )
    forms = column(releve(tmp_path, text), "growth_form")
    assert forms[:4] == ["tussock", "tussock", "rounded_shrub", "rounded_shrub"]
    assert forms[4:] == ["rosette", "rosette"]
