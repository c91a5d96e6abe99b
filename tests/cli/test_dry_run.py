"""A dry run reads and checks what the run would, ends as it would, and writes nothing."""

import json
import re
from pathlib import Path

import pytest

from fynjax.app.cli import main
from tests.frozen.cases import CASES

FROZEN = Path(__file__).parents[1] / "frozen"
COMMANDS = [name for name in CASES if name not in ("init", "sensors", "doctor", "identify", "view")]


def call(capsys, line):
    """Exit status, stdout, stderr of `fynjax ...`."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main([str(part) for part in line])
    return caught.value.code, *capsys.readouterr()


def listed(folder):
    return sorted(folder.rglob("*"))


def plant_nothing(monkeypatch):
    """Let it fail to draw plants, and to render."""
    monkeypatch.setattr("fynjax.scene._scene.draw_planting", None)
    monkeypatch.setattr("fynjax.scene._scene.known_planting", None)
    monkeypatch.setattr("fynjax.scene._observe.solve_light", None)


MARKED = [pytest.param(c, marks=pytest.mark.study) if c == "map" else c for c in COMMANDS]


@pytest.mark.parametrize("command", MARKED)
def test_a_dry_run_names_files_that_the_run_writes_and_writes_none(
    command, capsys, tmp_path, monkeypatch
):
    frozen = json.loads((FROZEN / f"{command}.json").read_text("utf-8"))
    written = {name.partition(": ")[0] for name in frozen}
    out = tmp_path / "out"
    lines = CASES[command].runs(tmp_path)
    for name, line in lines.items():
        line = [*line, "--output", out / name]
        before = listed(tmp_path)
        with monkeypatch.context() as patched:
            plant_nothing(patched)
            status, shown, err = call(capsys, [*line, "--dry-run", "--json"])
        assert status == 0, err
        assert listed(tmp_path) == before
        files = json.loads(shown)["files"]
        assert files
        missing = {f for f in files if f"{name}/{f}" not in written and "html" not in f}
        assert not missing
        if any(str(out / name) in str(part) for parts in lines.values() for part in parts):
            assert call(capsys, [*line, "--quiet"])[0] == 0


PLANTING = ("render", "build", "calibrate", "posterior", "sensitivity", "information", "design")


@pytest.mark.parametrize("command", PLANTING)
def test_a_dry_run_of_a_hectare_counts_its_plants_and_plants_none(
    command, capsys, tmp_path, monkeypatch
):
    line = next(iter(CASES[command].runs(tmp_path).values()))
    for file in tmp_path.glob("*.toml"):
        file.write_text(re.sub(r"size_m = \S+", "size_m = 100.0", file.read_text()))
    if command == "build":
        line = [part for part in line if part not in ("--mesh", "--triangles", 20_000)]
    plant_nothing(monkeypatch)
    line = [*line, "--output", tmp_path / "out", "--dry-run"]
    status, shown, err = call(capsys, [*line, "--json"])
    assert status == 0, err
    plan = json.loads(shown)["plan"]
    assert plan["voxels"][:2] == [1000, 1000]
    assert sum(plan["plants"].values()) > 10_000
    assert plan["elements"] > 100_000
    assert plan["memory_gib"] > 1
    assert plan["seconds"] > 60
    _, shown, _ = call(capsys, line)
    assert f"{sum(plan['plants'].values())} plants of {len(plan['plants'])} species" in shown
    assert f"about {plan['memory_gib']} GiB of memory" in shown


DAMAGED = {
    "render": "species.csv",
    "simulate": "camera/plot.toml",
    "build": "species.csv",
    "calibrate": "target.csv",
    "bioscape-calibrate": "tables/*waves.csv",
    "posterior": "target.csv",
    "sensitivity": "species.csv",
    "information": "plot.toml",
    "diversity": "species.csv",
    "design": "species.csv",
    "fit-leaf": "leaves.csv",
    "convert": "leaves.csv",
    "bioscape-learn": "tables/*VegCenters.csv",
    "map": "out/train/training.nc",
    "terrain": "plot.csv",
    "reflectance": "flight/IMG_0001_3.tif",  # the last file of the last capture
    "frames": "flight/cameras.json",
    "bioscape-plots": "tables/*CoverData.csv",
    "pattern": "a.tif",
    "validate": "simulated.las",
    "bioscape-validate": "tables/*waves.csv",
}
WRONG = {
    "plant": ["--diameter", "40"],
    "train": ["--simulations", "2"],
    "sensitivity": ["--sobol", "3"],
    "information": ["--bands", "3,8"],
    "diversity": ["--pixels", "0.125,0.3"],
    "design": ["--widths", "50,20"],
    "bioscape-learn": ["--plot", "none_of_these"],
    "fit-leaf": ["--background", "0.5"],
}


def check_ends_as_the_run_does(capsys, line, folder):
    before = listed(folder)
    dry, real = call(capsys, [*line, "--dry-run"]), call(capsys, line)
    assert dry == real
    assert real[0] == 2
    assert real[2].startswith("fynjax: error: ")
    assert listed(folder) == before


@pytest.mark.parametrize("command", DAMAGED)
def test_a_damaged_file_ends_a_dry_run_as_it_ends_the_run(command, capsys, tmp_path):
    lines = CASES[command].runs(tmp_path)
    line = lines["map" if command == "map" else next(iter(lines))]
    (tmp_path / "out" / "train").mkdir(parents=True)
    (tmp_path / "out" / "train" / "training.nc").touch()
    (file,) = tmp_path.glob(DAMAGED[command])
    file.write_bytes(b"no such thing\n")
    line = [*line, "--output", tmp_path / "results"]
    check_ends_as_the_run_does(capsys, line, tmp_path)


@pytest.mark.parametrize("command", WRONG)
def test_a_wrong_setting_ends_a_dry_run_as_it_ends_the_run(command, capsys, tmp_path):
    line = next(iter(CASES[command].runs(tmp_path).values()))
    line = [*line, *WRONG[command], "--output", tmp_path / "results"]
    check_ends_as_the_run_does(capsys, line, tmp_path)


def test_a_dry_run_says_what_would_be_written_where(capsys, tmp_path):
    line = next(iter(CASES["render"].runs(tmp_path).values()))
    (tmp_path / "mine").write_text("mine")
    status, _, err = call(capsys, [*line, "--dry-run", "--output", tmp_path / "mine"])
    assert (status, "this is a file" in err) == (2, True)
    output = tmp_path / "a" / "b"
    status, out, err = call(capsys, [*line, "--dry-run", "--output", output])
    assert (status, err) == (0, "")
    assert f"would write to {output}" in out
    assert "image.tif    " in out
    assert "20 rows and 20 columns of pixels, 4 bands" in out
    assert not (tmp_path / "a").exists()
    assert call(capsys, [*line, "--dry-run", "--quiet", "--output", output]) == (0, "", "")
