"""A scene from a species table in Python, against the same plot from its files."""

import equinox as eqx
import jax
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import aim_without_air, build_plot
from fynjax.app.io.plot import plot_instrument, read_plot
from fynjax.scene import Scene, SpeciesRow, Spectrum, observe
from tests.small import write_plot

TABLE = [
    {
        "taxon": "Erica irregularis",
        "growth_form": "rounded_shrub",
        "mean_diameter_cm": 40,
        "cover_percent": 30,
        "height_max_m": 0.6,
    },
    {
        "taxon": "Restio eleocharis",
        "growth_form": "tussock",
        "mean_diameter_cm": 30,
        "cover_percent": 15,
        "height_max_m": 0.5,
    },
]


@pytest.fixture(scope="module")
def built():
    scene = Scene.from_table(TABLE, size=2.0, structure="even", seed=3)
    return scene, scene.parameters


def test_a_table_gives_the_scene_and_the_image_of_its_plot_file(built, tmp_path):
    path = write_plot(tmp_path, "[sensor]\npixel_m = 0.1\n")
    path.write_text(path.read_text().replace('cover_definition = "article"\n', ""))
    plot = read_plot(path)
    assert plot.cover_definition == "projected"
    assert np.asarray(build_plot(plot, seed=3)[0].rounding).any()  # at random, as a mean needs it
    from_files = build_plot(plot, seed=3, rounding="random")
    same = jax.tree.map(np.array_equal, from_files, built)
    assert all(jax.tree.leaves(same))
    camera = aim_without_air(plot, *from_files, plot_instrument(plot))
    image = observe(built[0], "mavic_3m", pixel=0.1, altitude=50.0).reflectance
    assert image.shape == (4, 20, 20)
    of_file = eqx.filter_jit(lambda view, *plot: view.observe(*plot).reflectance)
    np.testing.assert_allclose(image, of_file(camera, *from_files), rtol=1e-5)


def test_a_table_takes_dead_tissue_and_sizes_of_leaves(built):
    grey = Spectrum.of(np.array([400.0, 1000.0]), np.array([0.3, 0.3]), "dead tissue")
    table = [TABLE[0] | {"dead_fraction": 0.7}, TABLE[1]]
    scene = Scene.from_table(table, size=2.0, dead_tissue=grey, hot_spot=True)
    parameters = scene.parameters
    np.testing.assert_allclose(parameters.species.dead_fraction, [0.7, 0.68])
    # What is learned of the shipped bark is not of this spectrum.
    assert (parameters.ground.wood_brightness, built[1].ground.wood_brightness) == (1.0, 1.29)
    assert eqx.tree_equal(scene.dead_tissue, grey)
    assert scene.hot_spot
    assert not built[0].hot_spot


def test_structure_that_is_left_out_is_that_of_leaves_as_heavy():
    leaf = {name: value for name, value in LEAF.items() if name != "structure"}
    leaves = {"*": leaf | {"dry_matter": 0.01}}
    parameters = Scene.from_table(TABLE, size=2.0, leaves=leaves).parameters
    np.testing.assert_allclose(parameters.leaf.structure, np.exp(0.275 * np.log(100.0) - 0.689))


def test_a_frame_is_as_good_as_records_and_leaves_are_by_taxon(built):
    leaf = {**LEAF, "chlorophyll": 60.0}
    frame = pd.DataFrame(TABLE).assign(packing_percent=[5.0, np.nan], branches=[pd.NA, 3])
    scene = Scene.from_table(frame, size=(2.0, 2.0), leaves={"Restio eleocharis": leaf})
    parameters = scene.parameters
    assert scene.taxa == built[0].taxa
    assert scene.branches == (1.0, 3.0)
    np.testing.assert_allclose(parameters.leaf.chlorophyll, [53.6, 60.0])
    np.testing.assert_allclose(parameters.species.packing, [0.05, 0.0])


LEAF = {
    "structure": 1.8, "chlorophyll": 40.0, "carotenoids": 9.0, "anthocyanins": 1.5,
    "brown_pigments": 0.1, "water": 0.02, "dry_matter": 0.02,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"growth_form": "palm"}, "row 1, column 'growth_form'.*'palm'"),
        ({"height_max_m": None}, "row 1, column 'height_max_m'"),
        (
            {"cover_percent": 130},
            "row 1, column 'cover_percent'.*a number from 0 to 100 %, but got 130",
        ),
        ({"branches": 0}, "column 'branches'.*a whole number from 1 to 1000, but got 0"),
        ({"branches": 2.5}, "column 'branches'.*whole number.*but got 2.5"),
        ({"rotation_spread_deg": -3}, "'rotation_spread_deg'.*from 0 to 90 degree, but got -3"),
        ({"minimum_object_area_m2": 1e4}, "'minimum_object_area_m2'.*from 0 to 100 m2"),
        ({"packing_percent": "much"}, "'packing_percent'.*a number from 0 to 99 %, but got 'much'"),
        ({"mean_diameter_cm": 0.4}, "row 1, column 'mean_diameter_cm'.*Metres. In cm this is 40"),
        ({"leaf_area_index": True}, "'leaf_area_index'.*a number.*, but got 'True'"),
        ({"leaf_area_index": [1, 2]}, "'leaf_area_index'.*a number.*, but got"),
        ({"height_max_m": pd.NA}, "'height_max_m'.*0.01 to 20 m.*but it is missing"),
        ({"taxon": 7}, "row 1, column 'taxon'.*name.*, but got 7"),
        ({"growth_form": "tussok"}, "Did you mean 'tussock'"),
        ({"cover_percnt": 30}, "'cover_percnt'.*Did you mean 'cover_percent'"),
        (
            {"taxon": "Erica irregulars", "growth_form": None},
            "row 1, column 'growth_form'.*'Erica irregulars'.*Did you mean 'Erica irregularis'",
        ),
        ({"plant": "shrub.obj"}, "'plant'.*only a plot file"),
        ({"taxon": "Restio eleocharis"}, "row 2, column 'taxon'.*first in row 1. Add the covers"),
    ],
)
def test_a_row_that_cannot_serve_is_named(change, words):
    with pytest.raises(InputError, match=words):
        Scene.from_table([TABLE[0] | change, TABLE[1]], size=2.0)


def test_tables_in_python_are_checked_as_files_are():
    many = [TABLE[0] | {"taxon": str(k), "cover_percent": 90} for k in range(4)]
    with pytest.raises(InputError, match=r"sum to 360 %. Are these counts"):
        Scene.from_table(many, size=2.0)
    with pytest.raises(InputError, match=r"column 'cover_percent'.*Is it 'cover' in this table"):
        Scene.from_table(pd.DataFrame(TABLE).rename(columns={"cover_percent": "cover"}), size=2.0)
    fractions = [row | {"cover_percent": row["cover_percent"] / 100} for row in TABLE]
    with pytest.warns(UserWarning, match="species table.*0.3 would be 30"):
        Scene.from_table(fractions, size=2.0)


def test_a_shipped_taxon_has_its_growth_form(built):
    nameless = [{k: v for k, v in row.items() if k != "growth_form"} for row in TABLE]
    scene = Scene.from_table(nameless, size=2.0, structure="even", seed=3)
    assert scene.forms == built[0].forms


def test_a_row_is_in_the_units_of_the_package():
    row = SpeciesRow.model_validate(TABLE[0] | {"fill_percent": "80", "rotation_spread_deg": 5})
    assert (row.diameter, row.cover, row.height, row.fill) == (0.4, 0.3, 0.6, 0.8)
    assert (row.packing, row.branches, row.rotation_spread, row.minimum_area) == (0, 1, 5, 0)
    assert row.replace(cover=0.1).cover == 0.1
    assert (row.dead_fraction, row.plant) == (None, None)


def test_what_a_table_says_of_crowns_counts():
    """Equation (10) by hand: of 0.5 m radius with its lean, and by the least area."""
    lean = {"rotation_spread_deg": 30, "packing_percent": 20, "fill_percent": 50, "branches": 3}
    table = [TABLE[0] | lean, TABLE[1] | {"minimum_object_area_m2": 0.5}]
    scene = Scene.from_table(table, size=2.0, structure="even")
    parameters = scene.parameters
    each = np.pi * 0.5**2 * 0.8 * 0.5
    np.testing.assert_allclose(scene.counts(parameters), [3 * 1.2 / each, 0.6 / 0.5], rtol=1e-6)


@pytest.mark.parametrize(
    ("leaves", "words"),
    [
        ({"Erica irregulars": LEAF}, "'Erica irregulars'"),
        ({"*": {"water": None}}, "chlorophyll.*all are empty"),
        ({"*": {"spectrum": "leaf.csv"}}, "got a spectrum"),
        (
            {"*": LEAF | {"water": 200.0}},
            r"leaves of '\*': column 'water': .*from 0 to 0.2 cm, but got 200. g m-2",
        ),
        ({"*": LEAF | {"taxn": 1.0}}, "taxn"),
    ],
)
def test_leaves_that_belong_to_no_plant_are_refused(leaves, words):
    with pytest.raises(InputError, match=words):
        Scene.from_table(TABLE, size=2.0, leaves=leaves)


@pytest.mark.parametrize(("table", "words"), [("species.csv", "frame or records"), ([], "rows")])
def test_what_is_no_table_is_refused(table, words):
    with pytest.raises(InputError, match=words):
        Scene.from_table(table, size=2.0)
