"""What a file is taken for: by the readers themselves, with what was rejected."""

import json
from pathlib import Path

import numpy as np
import pytest
from rasterio import Affine
from typer.testing import CliRunner

from fynjax.app.cli import app
from fynjax.app.io.plot import HEATH_TABLE
from fynjax.app.jobs import identify
from tests.helpers import write_raster
from tests.io.test_groups import axes, cube, mapping
from tests.io.test_spectra_layout import columns, rows
from tests.small import write_plot
from tests.terrain.test_cloud import written


def test_each_kind_is_known_with_its_facts(tmp_path: Path) -> None:
    import netCDF4

    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        axes(file, 4.0, 3.0)
        mapping(file)
        cube(file.createGroup("reflectance"), grid_mapping="transverse_mercator")
    place = Affine(0.04, 0, 556370.0, 0, -0.04, 4844330.0)
    image = write_raster(
        tmp_path / "a.tif", np.ones((4, 9, 8), "f4"), transform=place, crs="EPSG:32631"
    )
    plot = write_plot(tmp_path)
    for path, kind, facts in (
        (columns(tmp_path / "c.csv", ["S400", "S450"]), "leaf spectra",
         {"layout": "a column a spectrum: column 1 ('wavelength')", "quantity": "reflectance of 2",
          "bands": "101, 400 to 2400 nm", "spectra": "2: S400, S450"}),
        (rows(tmp_path / "r.csv", "X"), "leaf spectra",
         {"layout": "a row a spectrum: 101 names of columns", "spectra": "12: oak0"}),
        (tmp_path / "a.nc", "cube",
         {"pixel": "4 by 3", "bands": "4, 450 to 860 nm", "place": "latitude -34.12"}),
        (image, "image",
         {"pixel": "0.04 m", "size": "8 x 9", "place": "latitude 43.7499, longitude 3.7"}),
        (written(tmp_path / "a.las"), "point cloud", {"points": "400", "unit": "metres"}),
        (plot, "plot file", {"species": "2", "plot": "small, 2 by 2 m"}),
        (tmp_path / "species.csv", "species table", {"species": "2", "cover": "45 %"}),
        (HEATH_TABLE, "table of plants", {"plants": "9"}),
    ):  # fmt: skip
        found = identify(path)
        assert found.kind == kind, path
        for name, start in facts.items():
            assert found.facts[name].startswith(start), (path, name)


def test_what_was_rejected_is_said_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("nothing that anybody reads\n1 2\n")
    result = CliRunner().invoke(app, ["identify", str(tmp_path / "a.txt"), "--json"])
    assert result.exit_code == 1
    (found,) = json.loads(result.stdout)
    assert found["kind"] == "unknown"
    kinds = ["leaf spectra", "species table", "table of plants", "point cloud"]
    assert [one["kind"] for one in found["rejected"]] == kinds
    assert all(one["reason"] for one in found["rejected"])
    shown = CliRunner().invoke(app, ["identify", str(HEATH_TABLE)]).stdout
    assert "not species table: expected a column 'taxon'" in shown


@pytest.mark.parametrize(
    ("file", "kind", "words"),
    [("22_control-C-and-treatment-T-names/control_treatment.csv", "leaf spectra", "T102: the name"),
     ("21_table-of-spectra-with-numbered-names/table_pca40.csv", "leaf spectra",
      "not 40 names of columns with numbers, 500 to 1397: names of samples"),
     ("26_las-wkt-of-two-quotes/quotes.las", "point cloud", ""),
     ("28_usgs-splib-ascii/splib_leaf.txt", "unknown", "without their wavelengths"),
     ("30_r-write-csv-row-names/species.csv", "species table", ""),
     ("27_open-tubes-of-a-generator/shrub.obj", "plant mesh", "")],
)  # fmt: skip
def test_files_of_the_field_are_identified(shared_data: Path, file, kind, words) -> None:
    found = identify(shared_data / "field" / file)
    assert found.kind == kind
    assert words in " ".join([*found.evidence, *(one.reason for one in found.rejected)])
