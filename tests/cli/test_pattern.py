"""`fynjax pattern`: its files, and its errors."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.app.cli import app
from fynjax.app.io.raster import read_probability_map, write_geotiff
from tests.canopy.test_pattern import BANDS, drawn
from tests.helpers import assert_valid_summary


def run(*arguments: str) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(app, ["pattern", *arguments, "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """An image of known classes with a place on Earth, 6 m wide, one pixel without data."""
    values = drawn()[0]
    values[1, 2, 3] = np.nan
    path = tmp_path / "image.tif"
    write_geotiff(path, values, BANDS, pixel_m=0.1, origin_m=(500.0, 900.0), crs="EPSG:32734")
    return path


def test_an_image_becomes_a_map(image: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    summary = run(str(image), "--levels", "0,128,255", "--output", str(out))
    assert sorted(p.name for p in out.iterdir()) == [
        "map.qml",
        "map.tif",
        "pattern.png",
        "report.html",
        "summary.json",
    ]
    assert (out / "pattern.png").stat().st_size > 20_000
    assert json.loads((out / "summary.json").read_text("utf-8")) == summary
    assert summary["map"]["bounds_m"] == pytest.approx([500.0, 900.0, 506.0, 906.0])
    assert summary["map"]["masked_pixels"] == 1
    assert_valid_summary(summary)
    assert [c["level"] for c in summary["clusters"]] == [0, 128, 255]
    truth = drawn()[1]
    share = np.bincount(truth.ravel()) / truth.size
    assert [c["share"] for c in summary["clusters"]] == pytest.approx(share, abs=1e-3)
    # The plot is the northern half, where the pixel without data is not.
    got = read_probability_map(out / "map.tif", (6.0, 3.0), origin_m=(500.0, 903.0))
    np.testing.assert_array_equal(got, np.array([0, 128, 255])[truth[30:]])
    with pytest.raises(InputError, match="1 of 3600 have none"):
        read_probability_map(out / "map.tif", (6.0, 6.0))


def test_options_reach_the_clustering(image: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    summary = run(
        str(image), "--clusters", "4", "--greenness", "-red", "--greenness-weight", "0.5",
        "--bands", "a,red,c", "--seed", "3", "--output", out,
    )  # fmt: skip
    assert [c["level"] for c in summary["clusters"]] == [64, 128, 191, 255]
    assert [b["name"] for b in summary["bands"]] == ["a", "red", "c"]
    assert summary["greenness"] == {"name": "-red", "formula": "-red", "weight": 0.5}
    assert summary["seed"] == 3


def test_bad_input_leaves_nothing(image: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments, word in (
        ([str(tmp_path / "imag.tif")], "no such file.*image.tif"),
        ([str(image), "--levels", "0,x,255"], "`--levels`.*whole"),
        ([str(image), "--levels", "0,255"], "must be 3"),
        ([str(image), "--bands", "red,nir"], "3 bands, but got 2"),
        ([str(image), "--greenness", "evi"], "auto, ndvi"),
        ([str(image), "--pixel", "0.1"], "Leave it out"),
    ):
        with pytest.raises(InputError, match=word):
            run(*arguments, "--output", str(out))
    assert not out.exists()
