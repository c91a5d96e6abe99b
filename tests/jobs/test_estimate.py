"""Estimates beforehand: counts of the files, costs as measured, nothing written."""

import json
from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.cli import main
from fynjax.io.plot import example_folder, read_plot
from fynjax.io.raster import write_geotiff
from fynjax.jobs import estimate
from fynjax.metrics import BANDS
from fynjax.studies.bioscape import Resolution

PLOT = read_plot(example_folder() / "plot.toml")


@pytest.mark.parametrize(
    ("size", "voxel", "seconds"),
    # As the README states them, of one core after compilation.
    [(10.0, 0.1, 3.0), (10.0, 0.025, 8.9), (100.0, 0.1, 403.0)],
)
def test_time_of_an_image_is_as_measured_within_a_factor_of_two(size, voxel, seconds):
    sensor = PLOT.sensor.replace(pixel_m=0.1 if size > 10 else 0.025)
    plot = PLOT.replace(size_m=(size, size), voxel_m=voxel, sensor=sensor)
    some, none = estimate("render", "out", plot=plot), estimate(
        "render", "out", plot=plot.replace(size_m=(1e-3, 1e-3))
    )  # fmt: skip
    assert 0.45 < (some.seconds - none.seconds) / seconds < 2.2


def test_time_of_the_demo_is_as_measured_within_a_factor_of_two():
    demo = estimate("demo", "out", plot=PLOT)
    assert 0.5 < (demo.seconds + demo.compilation_s) / 250.0 < 2.0
    assert 0.5 < demo.memory_gib / 3.1 < 2.0
    assert "min of one core" in demo.sentence()
    assert demo.is_long()
    unknown = estimate("fit-leaf", "out", files=(), posterior="emcee")
    assert unknown.seconds is None
    assert "not measured" in unknown.sentence()


@pytest.mark.parametrize(
    ("command", "options", "measured"),
    # CPU s of one run each of the commands, compilation included, on the example and BioSCape's
    # tables.
    [
        ("calibrate", {"plot": PLOT}, 612.0),
        ("sensitivity", {"plot": PLOT, "metrics": ("a", "b", "c", "d")}, 65.0),
        ("information", {"plot": PLOT, "realisations": 2}, 263.0),
        ("simulate", {"plot": PLOT, "sensor": "flash_lidar_paper"}, 52.0),
        ("build", {"plot": PLOT}, 17.0),
        ("build", {"plot": PLOT, "size": 20.0}, 22.0),
        ("build", {"plot": PLOT, "size": 100.0}, 150.0),
        ("plant", {"elements": 200_000}, 8.4),
        ("train", {"simulations": 2000}, 115.0),
        ("validate-plots", {"plots": 2, "resolution": Resolution(5.0, 0.1)}, 75.0),
        ("calibrate-plots", {"plots": 2, "resolution": Resolution(5.0, 0.25)}, 142.0),
        ("calibrate-plots", {"plots": 18, "resolution": Resolution(5.0, 0.25)}, 1380.0),
        ("map", {"pixels": 1_000_000_000, "bands": 425}, 36_000.0),
    ],
)
def test_time_announced_is_as_measured_within_a_factor_of_two(command, options, measured):
    expected = estimate(command, "out", **options)
    assert 0.5 < (expected.seconds + expected.compilation_s) / measured < 2.0


def test_a_dry_run_of_train_counts_spectra(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["train", "aviris_ng", "--simulations", "20000", "--dry-run"])
    shown = capsys.readouterr().out
    assert "spectra 20 000" in shown
    assert "7 min of one core" in shown
    assert not list(tmp_path.iterdir())


def test_a_dry_run_says_what_it_would_do_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plot = example_folder() / "plot.toml"
    with pytest.raises(SystemExit) as end:
        main(["calibrate", str(plot), "--target", str(plot), "--dry-run", "--output", "out"])
    shown = capsys.readouterr().out
    assert end.value.code == 0
    assert f"reads   {plot}" in shown
    assert "writes  out\n" in shown
    assert "100 x 100" in shown
    assert "160 000 pixels in 4 bands" in shown
    with pytest.raises(SystemExit):
        main(["fit-leaf", str(plot), "--dry-run", "--json", "--output", "out"])
    assert json.loads(capsys.readouterr().out)["writes"] == "out"
    assert not list(tmp_path.iterdir())


def test_a_dry_run_counts_what_a_file_holds(tmp_path, capsys, monkeypatch):
    """Plants of a build on the side asked for, points of a cloud, pixels of an image."""
    monkeypatch.chdir(tmp_path)
    Path("cloud.laz").write_bytes(bytes(12_000_000))
    write_geotiff("image.tif", np.full((4, 300, 200), 0.2), BANDS, pixel_m=0.1)
    for arguments, said in (
        (["build", str(PLOT.file), "--size", "20"], "20 m x 20 m, 200 x 200 x 27 voxels of 10 cm"),
        (["terrain", "cloud.laz"], "12 MB, about 2 000 000 points"),
        (["pattern", "image.tif"], "60 000 pixels in 4 bands"),
        (["plant", "Metalasia muricata", "--elements", "5000"], "5 000 area elements"),
        (["simulate", str(PLOT.file), "--sensor", "flash_lidar_paper"], "66 000 pulses"),
    ):
        with pytest.raises(SystemExit) as end:
            main([*arguments, "--dry-run"])
        shown = capsys.readouterr().out
        assert end.value.code == 0
        assert said in shown
        assert "of one core" in shown
    assert sorted(p.name for p in Path().iterdir()) == ["cloud.laz", "image.tif"]


def test_where_nothing_was_measured_no_accuracy_is_claimed(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("leaf.csv").write_text("wavelength_nm,leaf\n400,0.1\n", encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["fit-leaf", "leaf.csv", "--posterior", "emcee", "--dry-run"])
    shown = capsys.readouterr().out
    assert "not measured" in shown
    assert "factor of" not in shown


@pytest.mark.parametrize("name", ["pixel", "altitude"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -1.0])
def test_nothing_is_estimated_for_what_is_no_length(name, value):
    with pytest.raises(InputError, match=f"`{name}` must be a positive number of m"):
        estimate("simulate", "out", plot=PLOT, **{name: value})
