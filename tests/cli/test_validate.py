"""`fynjax validate`: its options, and its errors."""

import contextlib
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.app.cli import app
from fynjax.app.cli._runtime import run_job
from fynjax.app.io.text._atomic import remove_replaced
from fynjax.app.jobs import JobResult
from tests.compare.test_spectra import WAVE, cube, write_csv
from tests.compare.test_structure import plot, write_las
from tests.helpers import unix


def run(*arguments: str) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(app, ["validate", *arguments, "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)


@pytest.fixture
def spectra(tmp_path: Path) -> list[str]:
    values = cube().reshape(len(WAVE), -1).T
    write_csv(tmp_path / "real.csv", values)
    write_csv(tmp_path / "simulated.csv", 0.9 * values)
    return [
        "--real-spectra", str(tmp_path / "real.csv"),
        "--simulated-spectra", str(tmp_path / "simulated.csv"),
    ]  # fmt: skip


def test_options_reach_the_comparison(spectra: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    summary = run(
        *spectra, "--exclude", "900-1000", "--matching", "linear", "--output", str(out),
        "--seed", "5",
    )  # fmt: skip
    assert summary["seed"] == 5
    assert "900 to 1000 nm" in " ".join(summary["spectra"]["notes"])
    rows = {row["region"]: row for row in summary["spectra"]["regions"]}
    assert rows["vnir"]["upper_nm"] == pytest.approx(880.0)
    assert rows["full"]["difference_percent"] == pytest.approx(-10.0)
    assert rows["full"]["spectral_angle_deg"] == pytest.approx(0.0, abs=1e-5)
    assert sorted(summary["files"]) == sorted(
        p.name for p in out.iterdir() if p.name != "summary.json"
    )
    assert np.isfinite([row["real"] for row in summary["spectra"]["indices"]]).all()


def test_bad_input_leaves_nothing(spectra: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments, word in (
        ([], "at least one pair"),
        ([*spectra, "--exclude", "900 1000"], "LOW-HIGH"),
        ([*spectra, "--exclude", "1000-900"], "lower, upper"),
        ([*spectra[:3], str(tmp_path / "simulate.csv")], "no such file.*simulated.csv"),
        (["--real-drone", "published"], "needs --simulated-drone"),
        ([*spectra, "--bounds", "0,0,10"], "`--bounds` must be 4 numbers.*XMIN,YMIN,XMAX,YMAX"),
        ([*spectra, "--shift", "1,x"], r"`--shift` must be 2 or 3 numbers.*DX,DY\[,DZ\]"),
    ):
        with pytest.raises(InputError, match=word):
            run(*arguments, "--output", str(out))
    line = ["validate", *spectra, "--matching", "spline", "--output", str(out)]
    said = CliRunner().invoke(app, line, env={"COLUMNS": "300"}).output
    assert "not one of 'auto', 'nearest', 'linear'" in said
    assert not out.exists()


def test_every_option_of_clouds_reaches_the_comparison(tmp_path: Path) -> None:
    for name, seed in (("real", 0), ("simulated", 1)):
        x, y, height, _, _ = plot(seed, 13.17)
        write_las(tmp_path / f"{name}.las", x, y, height)
    given = {
        "largest_change": 0.2, "tolerance": 0.2, "deepest": 0.4, "tallest": 9.0, "layer": 0.2,
        "lowest": 0.4, "diversity_lowest": 0.2, "diversity_of": "leaf_area", "top": "plot",
        "ground_height": 0.05, "extinction": 0.6, "gap_height": 0.3, "gap_of": "canopy",
        "rugosity_of": "columns", "canopy_cell": 0.25, "cv_lowest": 0.1, "least_returns": 6,
        "repetitions": 2, "histogram_bin": 0.2,
    }  # fmt: skip
    options = [f"--{name.replace('_', '-')}={value}" for name, value in given.items()]
    summary = run(
        "--real-cloud", str(tmp_path / "real.las"), *options, "--grain=2.5",
        "--simulated-cloud", str(tmp_path / "simulated.las"), "--real-ground=none",
        "--simulated-ground=none", "--bounds=0,0,10,10", "--shift=-0.1,0,0.2",
        "--output", str(tmp_path / "out"),
    )["structure"]  # fmt: skip
    settings = {**summary["settings"], **summary["options"]}
    for side in ("real", "simulated"):
        settings |= {
            name: settings[f"{side}_{name}"] for name in ("tolerance", "deepest", "tallest")
        }
        assert settings[f"{side}_ground"] == "none"
    assert {name: settings[name] for name in given} == given
    assert summary["grain_m"] == 2.5
    assert settings["bounds"] == [0.0, 0.0, 10.0, 10.0]
    assert settings["simulated_shift"] == [-0.1, 0.0, 0.2]


def job(command: str, *names: str, status: int | None = None):  # type: ignore[no-untyped-def]
    """A job that writes these files, and ends with a status."""

    def write(folder: Path) -> JobResult:
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text("new")
        if status is not None:
            raise SystemExit(status)
        return JobResult(
            output=str(folder), command=command, seed=0, files=dict.fromkeys(names, "a file")
        )

    return write


def run_one(name: str, out: Path, *files: str, status: int | None = None) -> list[str]:
    """The files in the folder after a run."""
    try:
        run_job(name, job(name, *files, status=status), out, as_json=False, quiet=True)
    except SystemExit:
        assert status is not None
    return sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())


def test_files_of_an_earlier_run_do_not_stay(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    run_one("validate", out, "a.csv", "b.csv", "deep/c.csv", "input.csv")
    kept = ["a.csv", "b.csv", "deep/c.csv", "input.csv", "mine.txt", "summary.json"]
    assert run_one("validate", out, "a.csv", status=1) == kept
    monkeypatch.setattr("sys.argv", ["fynjax", "validate", str(out / "input.csv")])
    assert run_one("validate", out, "a.csv", "d.csv") == [
        "a.csv", "d.csv", "input.csv", "mine.txt", "summary.json",
    ]  # fmt: skip
    # Results of another command are no older version of these.
    with pytest.raises(InputError, match="belongs to results of `fynjax validate`"):
        run_one("render", out, "e.tif")
    assert "d.csv" in [p.name for p in out.iterdir()]


@unix
def test_nothing_goes_but_listed_files_of_the_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "folder").mkdir(parents=True)
    outside = tmp_path / "outside.csv"
    outside.write_text("x")
    for name in ("old.csv", "New.csv", "unlisted.csv"):
        (out / name).write_text("x")
    (out / "link.csv").symlink_to(outside)
    (out / "away").symlink_to(tmp_path)
    listed = ["old.csv", "New.csv", "folder", "link.csv", "away/outside.csv", "../outside.csv",
              str(outside), "gone.csv", "."]  # fmt: skip
    assert remove_replaced(out, listed, ["new.csv"]) == ["old.csv"]
    assert outside.exists()
    names = ["New.csv", "away", "folder", "link.csv", "unlisted.csv"]
    assert sorted(p.name for p in out.iterdir()) == names


@unix
def test_kill_leaves_nothing_beside_the_output(tmp_path: Path) -> None:
    """Even if a library swallows the exit, as JAX's callbacks do."""
    before = signal.getsignal(signal.SIGTERM)

    def killed(folder: Path) -> JobResult:
        with contextlib.suppress(SystemExit):
            os.kill(os.getpid(), signal.SIGTERM)
        return JobResult(output=str(folder), command="validate", seed=0)

    with pytest.raises(SystemExit) as end:
        run_job("validate", killed, tmp_path / "out", as_json=False, quiet=True)
    assert end.value.code == 143
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is before
