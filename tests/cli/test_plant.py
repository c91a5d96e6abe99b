"""`fynjax plant`: its files, and its errors."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
import typer
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.cli._plant import plant

app = typer.Typer()
app.command()(plant)


def run(*arguments: str) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(app, [*arguments, "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)


def elements(folder: Path) -> list[dict[str, str]]:
    with (folder / "elements.csv").open() as table:
        return list(csv.DictReader(table))


def areas(rows: list[dict[str, str]], column: str, name: str) -> float:
    return sum(float(row["area_m2"]) for row in rows if row[column] == name)


def test_a_taxon_becomes_a_mesh_and_elements(tmp_path: Path) -> None:
    summary = run("Chironia baccifera", "--elements", "400", "--output", str(tmp_path / "made"))
    rows = elements(tmp_path / "made")
    assert len(rows) == 400
    for organ in ("leaf", "wood"):
        assert areas(rows, "organ", organ) == pytest.approx(summary["area_m2"][organ], rel=1e-6)
    assert summary["area_m2"]["leaf"] == pytest.approx(3.0 * np.pi * 0.075**2, rel=1e-6)
    assert summary["height_m"] == pytest.approx(0.5, rel=1e-3)
    assert set(summary["files"]) == {"elements.csv", "plant.obj", "plant.mtl"}

    # The mesh it wrote is read again, as a branch, with optics of one's own.
    table = tmp_path / "materials.csv"
    table.write_text("material,organ,optics,solid\nleaf,leaf,chironia,no\nwood,wood,bark,yes\n")
    again = run(
        str(tmp_path / "made" / "plant.obj"),
        *("--materials", str(table), "--branches", "3", "--rotation-spread", "10"),
        *("--elements", "300", "--output", str(tmp_path / "bush")),
    )
    assert again["area_m2"]["leaf"] == pytest.approx(3 * summary["area_m2"]["leaf"], rel=1e-5)
    rows = elements(tmp_path / "bush")
    assert {row["optics"] for row in rows} == {"chironia", "bark"}
    assert areas(rows, "optics", "bark") == pytest.approx(again["area_m2"]["wood"], rel=1e-6)
    whole = trimesh.load(tmp_path / "bush" / "plant.obj", process=False)
    assert sum(len(piece.faces) for piece in whole.geometry.values()) > 30000


def test_a_scan_becomes_elements(tmp_path: Path) -> None:
    drawn = np.random.default_rng(0).normal(size=(500, 3))
    normals = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    path = tmp_path / "scan.xyz"
    np.savetxt(path, np.column_stack([0.2 * normals, normals]), fmt="%.7g")
    summary = run(str(path), "--elements", "100", "--output", str(tmp_path / "out"))
    assert summary["area_m2"]["leaf"] == pytest.approx(4 * np.pi * 0.04, rel=0.1)
    assert len(elements(tmp_path / "out")) == 100


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("material,kind\nleaf,leaf\n", r"row 1: .*organ"),
        ("material,organ\nleaf,leaf\nwood,bark\n", r"row 3, column 'organ'"),
        ("material,organ,solid\nleaf,leaf,2\n", r"row 2, column 'solid'"),
    ],
)
def test_a_bad_table_of_materials(text: str, word: str, tmp_path: Path) -> None:
    table = tmp_path / "materials.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=word):
        run("Deadwood", "--materials", str(table), "--output", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_bad_sources(tmp_path: Path) -> None:
    for source, word in (("none.obj", "no such file"), ("Protea repens", "`taxon` must be")):
        with pytest.raises(InputError, match=word):
            run(source, "--output", str(tmp_path / "out"))
    with pytest.raises(InputError, match="`--up`"):
        run("Deadwood", "--up", "x", "--output", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()
