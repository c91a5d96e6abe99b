"""A good plot file gives SI records; every slip is told with file, row, column and value."""

import json
import shutil
import warnings

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import plot_parameters
from fynjax.app.assembly._ground import plot_ground
from fynjax.app.io.plot import example_folder, read_plot, read_sky, read_statistics
from fynjax.canopy import FORMS, table1_2006
from fynjax.scene import USUAL_LEAF, SpeciesRow, leaves_of


@pytest.fixture
def folder(tmp_path):
    target = tmp_path / "plot"
    shutil.copytree(example_folder(), target)
    return target


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert text.count(old) >= 1, f"{old!r} is not in {path.name}"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def row_of(path, start):
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(n for n, line in enumerate(lines, start=1) if line.startswith(start))


def test_example_is_table_1_of_the_paper(folder, shared_data):

    paper = json.loads((shared_data / "paper" / "reference_values.json").read_text("utf-8"))
    table = paper["table1_species_2006"]
    plot = read_plot(folder / "plot.toml")
    assert list(plot.taxa) == [row["taxon"] for row in table]
    np.testing.assert_allclose(plot.diameter_m, [r["mean_diameter_cm"] / 100 for r in table])
    np.testing.assert_allclose(plot.cover, [r["cover_percent"] / 100 for r in table])
    np.testing.assert_allclose(plot.height_m, [r["height_max_m"] for r in table])
    assert plot.size_m == (10.0, 10.0)


def test_example_is_the_table_that_the_canopy_ships(folder):
    shipped = table1_2006().set_index("taxon")["growth_form"].to_dict()
    read = read_plot(folder / "plot.toml").species
    assert {row.taxon: row.growth_form for row in read} == shipped


def test_a_species_table_takes_every_growth_form_that_the_canopy_has():
    choice = SpeciesRow.model_json_schema()["properties"]["growth_form"]
    assert choice["enum"] == list(FORMS)


def test_example_statistics_are_table_4_of_the_paper(folder, shared_data):

    paper = json.loads((shared_data / "paper" / "reference_values.json").read_text("utf-8"))
    read = read_statistics(folder / "statistics.csv")
    values = {row.statistic: row.value for row in read}
    bands = paper["table4_implied_real_band_means_derived"]
    for name, key in (("green", "G"), ("red", "R"), ("red_edge", "RE"), ("nir", "N")):
        assert values[f"{name}.mean"] == bands[key]
    for name in ("NDVI", "GNDVI"):
        assert values[f"{name}.mean"] == paper["table4_vegetation_indices"][name]["real_mean"]
        assert values[f"{name}.std"] == paper["table4_vegetation_indices"][name]["real_std"]
    assert read[0].sd < 0.0005  # the bands are known to three decimals
    assert next(row for row in read if row.statistic == "NDVI.mean").sd is None


def test_leaf_rows_fall_back_to_the_star_row(folder):
    plot = read_plot(folder / "plot.toml")
    leaf = dict(zip(plot.taxa, leaves_of(plot.species, plot.leaves), strict=True))
    assert leaf["Deadwood"] == (USUAL_LEAF,)
    assert [own.dry_matter for own in leaf["Restio eleocharis"]] == [0.0419]
    (usual,) = leaf["Clutia alaternoides"]
    assert (usual.taxon, usual.water) == ("*", 0.0185)


def test_paths_start_from_the_file_not_from_the_working_folder(folder, monkeypatch, tmp_path):
    edit(folder / "leaves.csv", "*,,53.6,10.7,1.5,0.03,0.0185,0.0168,", "*,,,,,,,,spectra/leaf.csv")
    (folder / "spectra").mkdir()
    (folder / "spectra" / "leaf.csv").write_text("wavelength_nm,reflectance\n400,0.1\n")
    monkeypatch.chdir(tmp_path)
    plot = read_plot("plot/plot.toml")
    (leaf,) = leaves_of(plot.species, plot.leaves)[plot.taxa.index("Chironia baccifera")]
    assert leaf.spectrum == (folder / "spectra" / "leaf.csv").resolve()
    assert leaf.spectrum in plot.inputs
    assert leaf.chlorophyll is None


def test_priors_of_the_user_win_over_defaults(folder):
    edit(folder / "plot.toml", '"*.cover" = 0.25', '"species.Erica*.cover" = 0.1')
    calibration = read_plot(folder / "plot.toml").calibration
    assert calibration.relative_sd("species.Erica irregularis.cover") == 0.1
    assert calibration.relative_sd("species.Deadwood.cover") == 0.25
    assert calibration.relative_sd("ground.brightness") == 0.5


def test_everything_but_plot_may_be_left_out(folder):
    (folder / "small.toml").write_text('[plot]\nsize_m = [5, 10]\nspecies_table = "species.csv"\n')
    plot = read_plot(folder / "small.toml")
    assert plot.size_m == (5.0, 10.0)
    assert plot.leaves == ()
    assert plot.sun.zenith == 30.0


def without_priors_of_species(path):
    lines = path.read_text("utf-8").splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith('"species.')), "utf-8")


def test_growth_form_of_a_shipped_taxon_may_be_left_out(folder):
    without_priors_of_species(folder / "plot.toml")
    (folder / "species.csv").write_text(
        "taxon,mean_diameter_cm,cover_percent,height_max_m\nDeadwood,10,10,0.5\n"
    )
    (folder / "leaves.csv").write_text(
        "taxon,structure,chlorophyll,carotenoids,water,dry_matter\n*,1.5,30,8,0.01,0.01\n"
    )
    assert read_plot(folder / "plot.toml").species[0].growth_form == "deadwood"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks_are_no_slip(folder, encoding):
    text = (folder / "species.csv").read_text(encoding="utf-8")
    (folder / "species.csv").write_bytes(text.encode(encoding))
    assert read_plot(folder / "plot.toml").taxa[0] == "Metalasia muricata"


def test_cells_may_have_the_unit_of_their_column(folder):
    before = read_plot(folder / "plot.toml").species
    edit(folder / "species.csv", E40 + "20,0.67", "Erica irregularis,40 cm,20 %,0.67m")
    assert read_plot(folder / "plot.toml").species == before


E40 = "Erica irregularis,40,"
SPECIES_SLIPS = [
    (E40, "Erica irregularis,-40,", "mean_diameter_cm", ["-40", "1 to 1000"]),
    (E40, "Erica irregularis,0.40,", "mean_diameter_cm", ["0.4", "Metres", "40"]),
    (E40, "Erica irregularis,nan,", "mean_diameter_cm", ["nan", "number"]),
    (E40, "Erica irregularis,40 m,", "mean_diameter_cm", ["Leave out the unit"]),
    (E40, 'Erica irregularis,"40,5",', "mean_diameter_cm", ["decimal comma", "40.5"]),
    (E40, "Erica irregularis,,", "mean_diameter_cm", ["missing"]),
    (E40 + "20,", "Erica irregularis,40,120,", "cover_percent", ["120", "0 to 100"]),
    (E40 + "20,0.67", E40 + "20,67", "height_max_m", ["67", "Centimetres", "0.67"]),
    (
        "0.67,rounded_shrub",
        "0.67,round_shrub",
        "growth_form",
        ["round_shrub", "Did you mean 'rounded_shrub'"],
    ),
]


@pytest.mark.parametrize(("old", "new", "column", "words"), SPECIES_SLIPS)
def test_a_wrong_cell_is_named_with_its_row(folder, old, new, column, words):
    path = folder / "species.csv"
    edit(path, old, new)
    with pytest.raises(InputError) as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.file == path
    assert caught.value.row == row_of(path, "Erica")
    assert caught.value.column == column
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_decimal_comma_without_quotes_is_named(folder):
    edit(folder / "species.csv", "Chironia baccifera,15,0.5,", "Chironia baccifera,15,0,5,")
    with pytest.raises(InputError, match="decimal comma") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == row_of(folder / "species.csv", "Chironia")


@pytest.mark.parametrize("separator", [";", "\t", "|"])
def test_any_separator_is_read(folder, separator):
    plain = read_plot(folder / "plot.toml").species
    text = (folder / "species.csv").read_text(encoding="utf-8")
    (folder / "species.csv").write_text(text.replace(",", separator), encoding="utf-8")
    assert read_plot(folder / "plot.toml").species == plain


def test_missing_and_misspelt_columns_are_named_with_the_nearest(folder):
    edit(folder / "species.csv", "mean_diameter_cm", "diameter_cm")
    with pytest.raises(InputError, match=r"'mean_diameter_cm'.*'diameter_cm' in this table"):
        read_plot(folder / "plot.toml")
    edit(folder / "species.csv", "diameter_cm", "mean_diameter_cm")
    edit(folder / "species.csv", "growth_form,", "growthform,")
    with pytest.raises(InputError, match=r"'growthform'. Did you mean 'growth_form'"):
        read_plot(folder / "plot.toml")


def test_absurd_total_cover_and_double_taxa_are_refused(folder):
    path = folder / "species.csv"
    header = "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form\n"
    path.write_text(header + "".join(f"T{k},20,90,1,tussock\n" for k in range(4)))
    with pytest.raises(InputError, match="360 %"):
        read_plot(folder / "plot.toml")
    path.write_text(header + "A b,20,9,1,tussock\nA b,20,9,1,tussock\n")
    with pytest.raises(InputError, match=r"there twice, first in row 2\. Add the covers") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == 3


def test_fractions_for_covers_are_a_warning_only(folder):
    (folder / "species.csv").write_text(
        "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form\n"
        "A,20,0.12,1,tussock\nB,20,0.4,1,tussock\n"
    )
    edit(folder / "plot.toml", 'leaf_table = "leaves.csv"', "")
    without_priors_of_species(folder / "plot.toml")
    with pytest.warns(UserWarning, match="0.4 would be 40"):
        plot = read_plot(folder / "plot.toml")
    assert plot.cover[1] == 0.004


OWN = "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form\nThymus vulgaris,20,9,.2,mat\n"


def test_a_table_of_one_s_own_in_the_example_says_what_of_it_must_go(folder):
    """First the priors of species that are not there, then the rows of leaves."""
    (folder / "species.csv").write_text(OWN)
    line = row_of(folder / "plot.toml", '"species.Restio*.leaf.structure"')
    with pytest.raises(InputError, match=rf"line {line}, key 'species\.Restio.*Delete the line"):
        read_plot(folder / "plot.toml")
    edit(folder / "plot.toml", '"species.Restio*.leaf.structure"', '"species.T*.structure"')
    edit(folder / "plot.toml", '"species.Restio*.leaf.*"', '"species.Thymus vulgaris.leaf.*"')
    with pytest.raises(InputError, match=r"leaves\.csv, row .*'Euclea racemosa'.*delete this row"):
        read_plot(folder / "plot.toml")


def test_columns_of_notes_are_the_users_own(folder):
    text = OWN.replace("form\n", "form,Note on age\n").replace("mat\n", "mat,old\n")
    (folder / "own.toml").write_text('[plot]\nsize_m = 2\nspecies_table = "own.csv"\n')
    (folder / "own.csv").write_text(text)
    assert read_plot(folder / "own.toml").taxa == ("Thymus vulgaris",)
    (folder / "own.csv").write_text(text.replace("Note on age", "age"))
    with pytest.raises(InputError, match=r"unknown column 'age'.*begin with note"):
        read_plot(folder / "own.toml")


def test_groups_wider_than_the_plot_are_refused(folder):
    (folder / "own.toml").write_text('[plot]\nsize_m = 2\nspecies_table = "own.csv"\n')
    text = OWN.replace("form\n", "form,clumping_m\n")
    for radius, refused in ((2, False), (2.1, True)):
        (folder / "own.csv").write_text(text.replace("mat\n", f"mat,{radius}\n"))
        if refused:
            with pytest.raises(InputError, match=r"row 2, column 'clumping_m': .*2 m.*2\.1 m"):
                read_plot(folder / "own.toml")
        else:
            assert read_plot(folder / "own.toml").species[0].groups == 2.0


def test_small_covers_in_a_usual_table_are_no_warning(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_plot(folder / "plot.toml")  # Chironia baccifera covers 0.5 %


def test_unknown_taxon_in_the_leaf_table_names_the_nearest(folder):
    edit(folder / "leaves.csv", "Restio eleocharis", "Restio eleochoris")
    with pytest.raises(InputError, match="Did you mean 'Restio eleocharis'") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == row_of(folder / "leaves.csv", "Restio")
    assert caught.value.column == "taxon"


def test_a_taxon_has_as_many_leaves_as_rows_that_differ(folder):
    path = folder / "leaves.csv"
    rows = path.read_text().splitlines()
    one = next(line for line in rows if line.startswith("Restio"))
    path.write_text("\n".join([*rows, one.replace("0.0419", "0.0298")]))
    plot = read_plot(folder / "plot.toml")
    leaves = leaves_of(plot.species, plot.leaves)[plot.taxa.index("Restio eleocharis")]
    assert [leaf.dry_matter for leaf in leaves] == [0.0419, 0.0298]
    path.write_text("\n".join([*rows, one]))
    with pytest.raises(
        InputError, match=r"this leaf of 'Restio eleocharis' is there twice"
    ) as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == len(rows) + 1


LEAF_SLIPS = [
    ("0.0461,0.0419,", "0.0461,398,", "dry_matter", r"g m-2\? In g cm-2 .* 0.0398"),
    ("0.0461,0.0419,", "42.8,0.0419,", "water", "g m-2"),
    (",44.6,8.93", "0.5,44.6,8.93", "structure", "from 0.8 to 5"),
    ("0.0461,0.0419,", "0.0461,0.0419,leaf.asd", None, "got both"),
    (",44.6,8.93,1.5,0.03,0.0461,0.0419,", ",,,,,,,", None, "all are empty"),
]


@pytest.mark.parametrize(("old", "new", "column", "words"), LEAF_SLIPS)
def test_a_wrong_leaf_row_is_named(folder, old, new, column, words):
    path = folder / "leaves.csv"
    edit(path, old, new)
    with pytest.raises(InputError, match=words) as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == row_of(path, "Restio")
    assert caught.value.column == column


def test_a_missing_spectrum_names_table_row_and_neighbour(folder):
    (folder / "leaf_1.csv").write_text("x")
    edit(folder / "leaves.csv", ",44.6,8.93,1.5,0.03,0.0461,0.0419,", ",,,,,,,leaf_2.csv")
    with pytest.raises(InputError, match=r"'leaf_2.csv'.*Did you mean 'leaf_1.csv'") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == row_of(folder / "leaves.csv", "Restio")


def test_a_species_without_leaf_optics_is_refused(folder):
    edit(folder / "leaves.csv", "*,", "Clutia alaternoides,")
    with pytest.raises(InputError, match=r"'Chironia baccifera'.*row '\*'"):
        read_plot(folder / "plot.toml")


PLOT_SLIPS = [
    ("zenith_deg = 27.0", "zenith_deg = 95", "sun.zenith_deg", "below the horizon"),
    ("azimuth_deg = 0.0", 'azimuth_deg = "north"', "sun.azimuth_deg", "'north'"),
    ("size_m = 10.0", "size_m = 10.05", "plot.size_m", "nearest is 10 m"),
    ("size_m = 10.0", "size_m = [10]", "plot.size_m", r"\[east-west, north-south\].* got \[10\]"),
    ("size_m = 10.0", "size_m = -10", "plot.size_m", "0.5 to 1000"),
    ("voxel_m = 0.1", "voxel = 0.1", "plot.voxel", "Did you mean 'voxel_m'"),
    ('boundary = "periodic"', 'boundary = "period"', "plot.boundary", "Did you mean 'periodic'"),
    ('"species.csv"', '"specie.csv"', "plot.species_table", "Did you mean 'species.csv'"),
    ("brightness = 0.8", "brightness = 20", "ground.brightness", "from 0.1 to 2.5"),
    (
        "aerosol_optical_depth = 0.1",
        "aerosol_optical_depth = 5",
        "sky.aerosol_optical_depth",
        "0 to 2",
    ),
    ('soil = "dry"', 'soil = "species.csv"', None, "moisture"),
    ("zenith_deg = 27.0", "zenith_deg = 89.9", "sun.zenith_deg", "Is it the elevation"),
    ("altitude_m = 50.0", "altitude_m = 0", "sensor.altitude_m", "from 1 to 1e"),
    ("altitude_m = 50.0", "altitude_m = 1", "sensor.altitude_m", "above the plants"),
    ("altitude_m = 50.0", "tilt_deg = -90", "sensor.tilt_deg", "A gimbal pitch"),
    ("pixel_m = 0.025", 'path = "species.csv"', None, "expected name or path"),
    ("azimuth_deg = 0.0", "latitude_deg = -34.5", None, "longitude_deg is missing"),
    ('name = "mavic_3m"', 'name = "mavic3m"', "sensor.name", "Did you mean 'mavic_3m'"),
    ("seed = 0", "seed = 0.5", "scene.seed", "whole number"),
    ('"*.diameter" = 0.25', '"*.diameter" = -1', None, "-1"),
    ("[sun]", "[sunn]", "sunn", "Did you mean 'sun'"),
    ("zenith_deg = 27.0", "zenith_deg = ", 14, "TOML"),
]


@pytest.mark.parametrize(("old", "new", "column", "words"), PLOT_SLIPS)
def test_a_wrong_plot_file_names_the_line(folder, old, new, column, words):
    path = folder / "plot.toml"
    edit(path, old, new)
    with pytest.raises(InputError, match=words) as caught:
        read_plot(path)
    assert caught.value.file == path
    if isinstance(column, str):
        assert caught.value.column == column
    lines = path.read_text(encoding="utf-8").splitlines()
    if column is not None:
        assert new.split("=")[0].strip() in lines[caught.value.row - 1]
    assert "\n" not in str(caught.value)


def test_a_changed_plot_is_another_and_has_no_new_names(folder):
    plot = read_plot(folder / "plot.toml")
    small = plot.replace(size_m=(2.0, 2.0), sensor=plot.sensor.replace(pixel_m=0.1))
    assert (small.size_m, small.sensor.pixel_m, small.sun) == ((2.0, 2.0), 0.1, plot.sun)
    assert plot.size_m == (10.0, 10.0)
    with pytest.raises(TypeError, match="has no size"):
        plot.replace(size=2.0)


def test_wet_soil_is_a_moisture_of_one_unless_stated(folder):
    edit(folder / "plot.toml", 'soil = "dry"', 'soil = "wet"')
    stated = plot_parameters(read_plot(folder / "plot.toml")).ground.moisture
    edit(folder / "plot.toml", "moisture = 0.5", "# moisture = 0.5")
    left_out = plot_parameters(read_plot(folder / "plot.toml")).ground.moisture
    assert (float(stated), float(left_out)) == (0.5, 1.0)


def test_missing_plot_table_is_named(tmp_path):
    (tmp_path / "plot.toml").write_text("[sun]\nzenith_deg = 10\n")
    with pytest.raises(InputError, match="'plot'"):
        read_plot(tmp_path / "plot.toml")


def test_sky_table_rises_in_nm(folder):
    edit(folder / "plot.toml", "# table =", "table =")
    sky = folder / "sky.csv"
    sky.write_text("wavelength_nm,diffuse_fraction\n400,0.4\n900,0.1\n")
    wavelength, diffuse_fraction = read_sky(read_plot(folder / "plot.toml").sky.table)
    np.testing.assert_array_equal(wavelength, [400, 900])
    np.testing.assert_array_equal(diffuse_fraction, [0.4, 0.1])
    sky.write_text("wavelength_nm,diffuse_fraction\n0.4,0.4\n")
    with pytest.raises(InputError, match="Micrometres\\? In nm this is 400"):
        read_plot(folder / "plot.toml")
    sky.write_text("wavelength_nm,diffuse_fraction\n900,0.4\n400,0.4\n")
    with pytest.raises(InputError, match="400 follows 900") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.row == 3
    sky.write_text("wavelength_nm,diffuse_fraction\n400,40\n")
    with pytest.raises(InputError, match="Percent"):
        read_plot(folder / "plot.toml")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04abc", "Excel"),
        (b"", "empty"),
        (b"statistic,value,sd\n", "only a header"),
        (b"statistic,value\nnir.mean,\xc3\xa9\nnir.mean,\xe9\n", "row 3: .*UTF-8"),
        (b"statistic,value\nnir.mean,22.6\n", "Percent\\? This is 0.226"),
        (b"statistic,value\nnir,0.226\n", "nir.mean"),
        (b"statistic,value\nnir.mean,0.2\nnir.mean,0.2\n", "first in row 2"),
        (b"statistic,value,sd\nnir.mean,0.2,0\n", "above 0"),
        (b"statistic,value\nNDVI.std,-0.1\n", "at least 0"),
        (b"statistic,value\nNDVII.mean,0.7\n", "Did you mean 'NDVI'"),
        (b"statistic,value\nNDVI.mean,n/a\n", "'n/a'"),
    ],
)
def test_wrong_statistics_are_named(tmp_path, content, words):
    path = tmp_path / "stats.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_statistics(path, known=("nir", "NDVI"))


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_plot(tmp_path / "nothing" / "plot.toml")
    with pytest.raises(InputError, match="folder"):
        read_plot(tmp_path)


def test_a_pixel_larger_than_the_plot_is_named(folder):
    edit(folder / "plot.toml", "size_m = 10.0", "size_m = 2.0")
    edit(folder / "plot.toml", "pixel_m = 0.025", "pixel_m = 2.5")
    with pytest.raises(InputError, match=r"at most the plot's side, 2 m, but got 2\.5 m") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.column == "sensor.pixel_m"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("wavelength_nm,a,b\n400,0.1,0.2\n1000,0.3,0.4\n", "one soil, but got 2"),
        ("wavelength_nm,a\n400,\n700,0.2\n1000,0.3\n", "must cover .* but covers 700-1000"),
    ],
)
def test_a_soil_that_cannot_serve_is_named(folder, content, words):
    (folder / "sand.csv").write_text(content)
    edit(folder / "plot.toml", 'soil = "dry"', 'soil = "sand.csv"')
    edit(folder / "plot.toml", "moisture = 0.5", "")
    with pytest.raises(InputError, match=words):
        plot_ground(read_plot(folder / "plot.toml"), None).soil.check(500.0, 950.0)


def test_dead_tissue_hot_spot_and_structure_of_leaves(folder):
    plain = read_plot(folder / "plot.toml")
    assert (plain.species[0].dead_fraction, plain.dead_tissue, plain.hot_spot) == (
        None,
        None,
        False,
    )
    (heavy,) = leaves_of(plain.species, plain.leaves)[7]  # Restio, 398 g m-2
    assert heavy.structure == pytest.approx(419.0**0.275 * np.exp(-0.689))
    (folder / "dead.csv").write_text("wavelength_nm,reflectance\n400,0.1\n2500,0.4\n")
    lines = 'leaf_table = "leaves.csv"\ndead_tissue = "dead.csv"\nhot_spot = true'
    edit(folder / "plot.toml", 'leaf_table = "leaves.csv"', lines)
    text = (folder / "species.csv").read_text(encoding="utf-8").replace("50\n", "50,\n")
    (folder / "species.csv").write_text(text.replace("deadwood,0", "deadwood,0,"))
    edit(folder / "species.csv", ",packing_percent\n", ",packing_percent,dead_fraction\n")
    edit(folder / "species.csv", "upright_ericoid,50,\n", "upright_ericoid,50,0.7\n")
    plot = read_plot(folder / "plot.toml")
    assert plot.hot_spot
    assert plot.dead_tissue in plot.inputs
    wood = [float(plot_parameters(one).ground.wood_brightness) for one in (plain, plot)]
    assert wood == [1.29, 1.0]
    assert [one.dead_fraction for one in plot.species[:2]] == [0.7, None]
    edit(folder / "species.csv", "50,0.7\n", "50,70\n")
    with pytest.raises(InputError, match=r"0.*1.*got 70") as caught:
        read_plot(folder / "plot.toml")
    assert caught.value.column == "dead_fraction"
