"""`fynjax validate`: its options, and its errors."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.cli._validate import validate
from tests.report.test_validate_spectra import WAVE, cube, write_csv

app = typer.Typer()
app.command()(validate)


def run(*arguments: str) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(app, [*arguments, "--json"], catch_exceptions=False)
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
        ([*spectra, "--matching", "spline"], "nearest, linear"),
        ([*spectra[:3], str(tmp_path / "simulate.csv")], "no such file.*simulated.csv"),
        (["--real-drone", "published"], "needs --simulated-drone"),
    ):
        with pytest.raises(InputError, match=word):
            run(*arguments, "--output", str(out))
    assert not out.exists()
