"""A scene from a species table in Python, against the same plot from its files."""

import equinox as eqx
import jax
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.assembly import aim_without_air, build_plot
from fynjax.io.plot import plot_instrument, read_plot
from fynjax.scene import Placement, Scene, Spectrum, observe
from fynjax.sensors import shipped_sensor
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
    return Scene.from_table(TABLE, size_m=2.0, structure_m="even", seed=3)


def test_a_table_gives_the_scene_and_the_image_of_its_plot_file(built, tmp_path):
    plot = read_plot(write_plot(tmp_path, "[sensor]\npixel_m = 0.1\n"))
    from_files = build_plot(plot, seed=3, rounding="random")
    same = jax.tree.map(np.array_equal, from_files, built)
    assert all(jax.tree.leaves(same))
    camera = aim_without_air(plot, *from_files, plot_instrument(plot))
    image = observe(*built, shipped_sensor("mavic_3m"), Placement(50.0, 0.1)).reflectance
    assert image.shape == (4, 20, 20)
    of_file = eqx.filter_jit(lambda view, *plot: view.observe(*plot).reflectance)
    np.testing.assert_allclose(image, of_file(camera, *from_files), rtol=1e-5)


def test_a_table_takes_dead_tissue_and_sizes_of_leaves(built):
    grey = Spectrum.of(np.array([400.0, 1000.0]), np.array([0.3, 0.3]), "dead tissue")
    table = [TABLE[0] | {"dead_fraction": 0.7}, TABLE[1]]
    scene, parameters = Scene.from_table(table, size_m=2.0, dead_tissue=grey, hot_spot=True)
    np.testing.assert_allclose(parameters.species.dead_fraction, [0.7, 0.67])
    # What is learned of the shipped bark is not of this spectrum.
    assert (parameters.ground.wood_brightness, built[1].ground.wood_brightness) == (1.0, 1.3)
    assert eqx.tree_equal(scene.dead_tissue, grey)
    assert scene.hot_spot
    assert not built[0].hot_spot


def test_structure_that_is_left_out_is_that_of_leaves_as_heavy():
    leaf = {name: value for name, value in LEAF.items() if name != "structure"}
    leaves = {"*": leaf | {"dry_matter": 0.01}}
    _, parameters = Scene.from_table(TABLE, size_m=2.0, leaves=leaves)
    np.testing.assert_allclose(parameters.leaf.structure, np.exp(0.275 * np.log(100.0) - 0.689))


def test_a_frame_is_as_good_as_records_and_leaves_are_by_taxon(built):
    leaf = {**LEAF, "chlorophyll": 60.0}
    frame = pd.DataFrame(TABLE).assign(packing_percent=[5.0, np.nan], branches=[pd.NA, 3])
    scene, parameters = Scene.from_table(
        frame, size_m=(2.0, 2.0), leaves={"Restio eleocharis": leaf}
    )
    assert scene.taxa == built[0].taxa
    assert scene.branches == (1.0, 3.0)
    np.testing.assert_allclose(parameters.leaf.chlorophyll, [54.3, 60.0])
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
            "row 1, column 'cover_percent'.*'Erica irregularis' from 0 to 100 %, but got 130",
        ),
        ({"branches": 0}, "column 'branches'.*branches of 'Erica irregularis' from 1 to 1000"),
        ({"branches": 2.5}, "column 'branches'.*whole number.*but got 2.5"),
        ({"rotation_spread_deg": -3}, "'rotation_spread_deg'.*from 0 to 90 degree, but got -3"),
        ({"minimum_object_area_m2": 1e4}, "'minimum_object_area_m2'.*from 0 to 100 m2"),
        ({"packing_percent": "much"}, "'packing_percent'.*as a number, but got 'much'"),
        ({"mean_diameter_cm": "40"}, "row 1, column 'mean_diameter_cm'.*but got '40'"),
        ({"leaf_area_index": True}, "'leaf_area_index'.*as a number, but got True"),
        ({"leaf_area_index": [1, 2]}, "'leaf_area_index'.*as a number, but got"),
        ({"height_max_m": pd.NA}, "'height_max_m'.*of 'Erica irregularis', but it is empty"),
        ({"taxon": 7}, "row 1, column 'taxon'.*as text, but got 7"),
        ({"growth_form": "tussok"}, "Did you mean 'tussock'"),
        ({"cover_percnt": 30}, "'cover_percnt': unknown column. Did you mean 'cover_percent'"),
        ({"taxon": "Restio eleocharis"}, "row 2, column 'taxon'.*twice"),
    ],
)
def test_a_row_that_cannot_serve_is_named(change, words):
    with pytest.raises(InputError, match=words):
        Scene.from_table([TABLE[0] | change, TABLE[1]], size_m=2.0)


@pytest.mark.parametrize(
    ("leaves", "words"),
    [
        ({"Erica irregulars": LEAF}, "'Erica irregulars'"),
        ({"*": {"water": 0.02}}, "chlorophyll"),
        (
            {"*": LEAF | {"water": 200.0}},
            r"column 'water': expected equivalent water thickness of '\*' from",
        ),
        ({"*": LEAF | {"water": None}}, r"as a number, but got None"),
    ],
)
def test_leaves_that_belong_to_no_plant_are_refused(leaves, words):
    with pytest.raises(InputError, match=words):
        Scene.from_table(TABLE, size_m=2.0, leaves=leaves)


@pytest.mark.parametrize(("table", "words"), [("species.csv", "frame or records"), ([], "rows")])
def test_what_is_no_table_is_refused(table, words):
    with pytest.raises(InputError, match=words):
        Scene.from_table(table, size_m=2.0)
