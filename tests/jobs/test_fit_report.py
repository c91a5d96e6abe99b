"""A fit that is written as files, and opened again."""

import json

import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax._core import saved
from fynjax.errors import InputError
from fynjax.inversion import CalibrationSettings

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
TABLE = [
    dict(zip(COLUMNS, row, strict=True))
    for row in (("Erica", "rounded_shrub", 40, 30, 0.6), ("Restio", "tussock", 30, 15, 0.5))
]
QUICK = CalibrationSettings(
    rounds=1, stand_realisations=2, scatter_draws=6, full_renders=1, max_steps=3
)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """(a fit to two flights of one camera, the folder of its report)."""
    scene = fx.Scene.from_table(TABLE, size=2.0, voxel=0.25, structure="even", seed=1)
    noon = fx.Data.from_table({"nir.mean": 0.3, "red.mean": 0.06}, pixel=0.25, name="noon")
    dusk = fx.Data.from_table({"nir.mean": 0.29}, pixel=0.25, name="dusk")
    free = fx.free(scene, "species.*.cover", "ground.brightness")
    found = fx.fit(scene, noon + dusk, free, settings=QUICK)
    folder = tmp_path_factory.mktemp("report")
    found.report(folder, "heath")
    return found, folder


@pytest.mark.slow
def test_a_report_is_of_every_flight(fitted):
    found, folder = fitted
    files = {path.name for path in folder.iterdir()}
    images = {
        f"image_{when}_{name}.tif" for when in ("before", "after") for name in ("noon", "dusk")
    }
    assert {*images, "fit.npz", "parameters.csv", "statistics.csv", "report.html"} <= files
    page = (folder / "report.html").read_text("utf-8")
    assert "Calibration: heath" in page
    for name in ("noon", "dusk"):
        assert f"<h2>The image, {name}</h2>" in page
        assert f"<h2>The camera, {name}</h2>" in page
    table = pd.read_csv(folder / "statistics.csv")
    assert list(table[table["fitted"]]["statistic"]) == list(found.data.names)
    assert len(pd.read_csv(folder / "bands.csv")) == sum(len(one) for one in found.gains)


@pytest.mark.slow
def test_a_fit_is_opened_again_from_its_report(fitted):
    found, folder = fitted
    for path in (folder, folder / "fit.npz"):
        again = fx.read_fit(path)
        for name in ("estimate", "sd", "covariance", "loss"):
            np.testing.assert_array_equal(getattr(again.fit, name), getattr(found.fit, name))
    pd.testing.assert_frame_equal(again.table(), found.table())
    pd.testing.assert_frame_equal(again.stand(), found.stand())
    pd.testing.assert_frame_equal(again.means(), found.means())
    np.testing.assert_array_equal(again.statistics_after, found.statistics_after)
    assert str(again) == str(found)


def rewritten(source, path, change):
    """The fit with another text of its records."""
    with np.load(source) as file:
        arrays = {name: file[name] for name in file.files}
    text = json.dumps(change(json.loads(arrays["tree"].tobytes())))
    arrays["tree"] = np.frombuffer(text.encode(), np.uint8)
    np.savez_compressed(path, **arrays)
    return path


NOTHING = {"is": "tuple", "each": [None, None]}


def another_class(name):
    def change(tree):
        return json.loads(json.dumps(tree).replace("fynjax.inversion._problem:Problem", name))

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda tree: tree | {"version": "0.0.1"}, "but this is of 0.0.1: calibrate again"),
        (another_class("os:system"), "os:system is not of this package"),
        (another_class("fynjax.scene._gone:Problem"), "calibrate again"),
        (another_class("fynjax.inversion._problem:believed"), "is no class"),
        (lambda tree: tree | {"value": NOTHING}, "expected the fit of a plot"),
    ],
)
def test_a_file_of_another_version_or_of_another_make_is_refused_in_a_line(
    fitted, tmp_path, change, said
):
    path = rewritten(fitted[1] / "fit.npz", tmp_path / "fit.npz", change)
    with pytest.raises(InputError) as raised:
        fx.read_fit(path)
    assert said in str(raised.value)
    assert str(raised.value).count("\n") == 0
    assert "fit.npz" in str(raised.value)


def test_what_is_no_fit_is_refused(tmp_path):
    (tmp_path / "fit.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(InputError, match="expected a fit that fynjax wrote"):
        fx.read_fit(tmp_path)
    np.savez(tmp_path / "fit.npz", numbers=np.ones(3))
    with pytest.raises(InputError, match="expected a fit that fynjax wrote"):
        fx.read_fit(tmp_path)
    with pytest.raises(InputError, match="expected a fit that fynjax wrote"):
        fx.read_fit(tmp_path / "none")


def test_a_function_of_one_s_own_cannot_be_kept(tmp_path):
    def own(scene, parameters):
        return None

    with pytest.raises(TypeError, match="not of this package"):
        saved.save(tmp_path / "fit.npz", (own,))


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        # A function that a module of the package has imported from elsewhere.
        ({"is": "function", "name": "fynjax._core.extras:importlib.import_module"}, "is not of"),
        ({"is": "function", "name": "fynjax._core.saved:Path.unlink"}, "is not of this package"),
        # A method in place of a field.
        (
            {
                "is": "record", "class": "fynjax.inversion._data:Pixels",
                "fields": {"compared": {"is": "function", "name": "fynjax._core.saved:load"}},
            },
            "has no such fields",
        ),
        ({"is": "tuple", "each": [1]}, "expected the fit of a plot"),
        (7, "expected the fit of a plot"),
    ],
)  # fmt: skip
def test_a_file_runs_no_code_and_shadows_no_method(tmp_path, tree, said):
    text = json.dumps({"version": fx.__version__, "value": tree})
    np.savez(tmp_path / "fit.npz", tree=np.frombuffer(text.encode(), np.uint8))
    with pytest.raises(InputError, match=said):
        fx.read_fit(tmp_path)
