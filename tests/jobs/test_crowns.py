"""Crowns found in an orthophoto with map coordinates: the files, and what is refused."""

import dataclasses
import json

import jsonschema
import numpy as np
import pandas as pd
import pytest
import rasterio

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.io.plot import read_plot
from fynjax.app.io.raster import write_geotiff
from fynjax.app.jobs import _crowns
from fynjax.app.jobs._schemas import json_schema
from fynjax.metrics import BANDS
from tests.inversion.test_places import ROWS, SIDE, plot
from tests.io.test_crowns import CROWNS

pytestmark = pytest.mark.slow
CORNER = (500000.0, 6200000.0)
PLOT = f"""
[plot]
name = "three species"
size_m = {SIDE}
species_table = "species.csv"
cover_definition = "article"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """(folder of plot file, image, heights and results, result)."""
    folder = tmp_path_factory.mktemp("crowns")
    pd.DataFrame(ROWS).to_csv(folder / "species.csv", index=False)
    (folder / "plot.toml").write_text(PLOT)
    image = np.asarray(fx.observe(plot(1), "mavic_3m", pixel=0.05).reflectance)
    where = {"pixel_m": 0.05, "origin_m": CORNER, "crs": "EPSG:32734"}
    write_geotiff(folder / "ortho.tif", image, list(BANDS), **where)
    write_geotiff(folder / "heights.tif", np.full((1, 24, 24), 0.3), ["height"], **where)
    with pytest.MonkeyPatch.context() as patch:
        quick = lambda **given: dataclasses.replace(few, **given)  # noqa: E731
        few = _crowns.PlacesSettings(steps=25, chains=1, jumps=4)
        patch.setattr(_crowns, "PlacesSettings", quick)
        result = _crowns.crowns(
            folder / "ortho.tif", folder / "out", plot=folder / "plot.toml",
            heights=folder / "heights.tif", rounds=4, seed=1,
        )  # fmt: skip
    return folder, result


def test_crowns_lie_where_the_image_does_and_can_be_calibrated_to(folder):
    folder, result = folder
    pyogrio = pytest.importorskip("pyogrio")
    meta, _, shapes, columns = pyogrio.raw.read(folder / "out" / "crowns.gpkg")
    assert "32734" in meta["crs"]
    assert len(shapes) == result.crowns > 0
    fields = dict(zip(meta["fields"], columns, strict=True))
    share = np.sum([fields[f"p_{row['taxon']}"] for row in ROWS], axis=0)
    np.testing.assert_allclose(share, 1.0)
    assert (fields["diameter_q05_cm"] <= fields["diameter_cm"]).all()
    # The layer is a table of crowns of a plot file.
    stated = f'{PLOT}crowns = "out/crowns.gpkg"\nmap_origin_m = {list(CORNER)}\n'
    (folder / "again.toml").write_text(stated)
    known = read_plot(folder / "again.toml").known_crowns
    np.testing.assert_allclose(100.0 * known.diameter, fields["diameter_cm"], rtol=1e-6)
    assert (known.foot >= 0.0).all()


def test_maps_and_tables_are_as_documented(folder):
    folder, result = folder
    jsonschema.validate(json.loads(result.model_dump_json()), json_schema("summary"))
    with rasterio.open(folder / "out" / "species.tif") as file:
        values = file.read()
        assert file.descriptions[:2] == ("species", "probability of another")
        assert (file.bounds.left, file.bounds.bottom) == CORNER
    assert values.shape == (5, 24, 24)
    bare = 1.0 - values[2:].sum(axis=0)
    every = np.concatenate([bare[None], values[2:]])
    np.testing.assert_allclose(values[1], 1.0 - every.max(axis=0), atol=1e-6)
    best = np.take_along_axis(every, values[None, 0].astype(int), axis=0)[0]
    np.testing.assert_allclose(best, every.max(axis=0), atol=1e-6)  # of equals any
    with rasterio.open(folder / "out" / "crowns.tif") as file:
        crown, low, middle, high = file.read()
    np.testing.assert_allclose(crown, 1.0 - bare, atol=1e-6)
    assert (low <= middle).all()
    assert (middle <= high).all()
    table = pd.read_csv(folder / "out" / "plants.csv")
    assert list(table["level"]) == ["species"] * 3 + ["growth form"] * 3 + ["all"]
    page = (folder / "out" / "report.html").read_text("utf-8")
    for text in ("Expected less measured", "Every crown", "Of the field table, and found"):
        assert text in page


def test_images_and_plots_that_do_not_fit_are_refused(folder, tmp_path):
    folder, _ = folder
    plot_file = folder / "plot.toml"
    half = np.full((4, 12, 24), 0.2)
    write_geotiff(tmp_path / "half.tif", half, list(BANDS), pixel_m=0.05)
    with pytest.raises(InputError, match="expected an image of the whole plot"):
        _crowns.crowns(tmp_path / "half.tif", tmp_path / "out", plot=plot_file)
    write_geotiff(tmp_path / "other.tif", half[:3], ["a", "b", "c"], pixel_m=0.05)
    with pytest.raises(InputError, match="expected"):
        _crowns.crowns(tmp_path / "other.tif", tmp_path / "out", plot=plot_file)
    tall = np.full((1, 24, 24), 120.0)
    write_geotiff(tmp_path / "dsm.tif", tall, ["height"], pixel_m=0.05)
    with pytest.raises(InputError, match="Subtract the height of the ground"):
        _crowns.crowns(
            folder / "ortho.tif", tmp_path / "out", plot=plot_file, heights=tmp_path / "dsm.tif"
        )
    (tmp_path / "species.csv").write_text((folder / "species.csv").read_text())
    (tmp_path / "crowns.csv").write_text(CROWNS.split("Restio")[0].replace("1.5,0.6", "1.0,0.6"))
    (tmp_path / "plot.toml").write_text(PLOT + 'crowns = "crowns.csv"\n')
    with pytest.raises(InputError, match="whose plants are to be found"):
        _crowns.crowns(folder / "ortho.tif", tmp_path / "out", plot=tmp_path / "plot.toml")
