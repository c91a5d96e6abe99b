"""`fynjax plant`: its files, and its errors."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.app.cli import app
from fynjax.canopy import FORMS
from tests.helpers import assert_valid_summary


def run(*arguments: str) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(app, ["plant", *arguments, "--json"], catch_exceptions=False)
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
    area = FORMS["rounded_shrub"].leaf_area_index
    assert summary["area_m2"]["leaf"] == pytest.approx(area * np.pi * 0.075**2, rel=1e-6)
    assert summary["height_m"] == pytest.approx(0.5, rel=1e-3)
    made = tmp_path / "made"
    assert set(summary["files"]) == {
        *("elements.csv", "plant.obj", "plant.mtl", "plant.png", "report.html")
    }
    assert {path.name for path in made.iterdir()} == {*summary["files"], "summary.json"}
    assert_valid_summary(summary)
    assert (made / "plant.png").stat().st_size > 20_000
    assert (summary["form"], summary["n_leaves"]) == ("rounded_shrub", 3222)
    assert summary["leaf_scale"] == pytest.approx(1.0, abs=0.05)
    assert [one["solid_share"] for one in summary["materials"]] == [0.0, 1.0]
    assert summary["warnings"] == []

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


def test_a_growth_form_becomes_a_plant_of_its_usual_size(tmp_path: Path) -> None:
    summary = run("column", "--elements", "100", "--output", str(tmp_path / "made"))
    form = FORMS["column"]
    disc = np.pi / 4 * form.diameter**2
    assert summary["form"] == "column"
    assert summary["area_m2"]["leaf"] == pytest.approx(form.leaf_area_index * disc, rel=1e-6)
    assert summary["height_m"] == pytest.approx(form.height, rel=1e-3)
    size = ("--diameter", "0.4", "--height", "0.3", "--elements", "50", "--output", str(tmp_path))
    summary = run("Calluna vulgaris", "--form", "upright_ericoid", *size)
    assert summary["form"] == "upright_ericoid"
    assert summary["height_m"] == pytest.approx(0.3, rel=1e-3)
    for wrong, word in ((("Calluna", "--form", "bush"), "`--form` must be one of"),
                        (("Calluna",), "Another taxon needs its `--form`")):  # fmt: skip
        with pytest.raises(InputError, match=word):
            run(*wrong, *size)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("material,kind\nleaf,leaf\n", r"row 1.*column 'organ'"),
        ("material,organ\nleaf,leaf\nwood,bark\n", r"row 3, column 'organ'"),
        ("material,organ,solid\nleaf,leaf,2\n", r"row 2, column 'solid'"),
        ("material,organ\nwood,wood\nwod,wood\n", "row 3.*'wod' is not in the mesh.*'wood'"),
        ("material,organ\nwood,wood\nwood,leaf\n", "row 3.*'wood' is there twice"),
        ("material,organ\nleaf,leaf\n", "'wood'.*`--materials`"),
    ],
)
def test_a_bad_table_of_materials(text: str, word: str, tmp_path: Path) -> None:
    table = tmp_path / "materials.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=word):
        run("Deadwood", "--materials", str(table), "--output", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def cloud(path: Path, size: float = 0.2, tall: int = 2) -> Path:
    """A scan of an ellipsoid, half as long again along one axis."""
    drawn = np.random.default_rng(0).normal(size=(500, 3))
    normals = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    points = size * normals
    points[:, tall] *= 1.5
    np.savetxt(path, np.column_stack([points, normals]), fmt="%.9g")
    return path


def test_the_vertical_axis_is_the_files_or_the_users(tmp_path: Path) -> None:
    box = trimesh.creation.box([0.2, 0.9, 0.3])
    for name in ("box.glb", "box.stl"):
        box.export(tmp_path / name)
    scan = cloud(tmp_path / "scan.xyz", tall=1)
    out = ("--elements", "40", "--output", str(tmp_path / "out"))
    for name, options, tall in (
        ("box.glb", (), 0.9),
        ("box.glb", ("--up", "z"), 0.3),
        ("box.stl", (), 0.3),
        ("box.stl", ("--up", "y"), 0.9),
        (scan.name, (), 0.4),
        (scan.name, ("--up", "y"), 0.6),
    ):
        summary = run(str(tmp_path / name), *options, *out)
        assert summary["height_m"] == pytest.approx(tall, rel=0.02)
        axis = options[1] if options else "y" if name == "box.glb" else "z"
        assert summary["up"] == axis
        assert f"Vertical axis of the file: {axis}" in summary["headline"]
        has_warning = any("all of it counts as leaf" in text for text in summary["warnings"])
        assert has_warning == (name != scan.name)


def test_a_scan_may_be_a_branch(tmp_path: Path) -> None:
    path = str(cloud(tmp_path / "scan.xyz"))
    one = run(path, "--elements", "50", "--output", str(tmp_path / "one"))
    spheroid = trimesh.creation.icosphere(4).apply_scale([0.2, 0.2, 0.3])
    assert one["area_m2"]["leaf"] == pytest.approx(spheroid.area, rel=0.15)
    assert len(elements(tmp_path / "one")) == 50
    many = run(path, "--elements", "50", "--branches", "4", "--output", str(tmp_path / "many"))
    assert many["area_m2"]["leaf"] == pytest.approx(4 * one["area_m2"]["leaf"])
    assert len(elements(tmp_path / "many")) == 200
    assert many["diameter_m"] > one["diameter_m"]


def test_size_bloom_and_detail_of_a_taxon(tmp_path: Path) -> None:
    options = ("--diameter", "0.3", "--height", "0.4", "--flowering", "1")
    summary = run(
        "Hermannia ternifolia",
        *options,
        *("--max-triangles", "3000", "--elements", "60", "--output", str(tmp_path / "out")),
    )
    assert (summary["diameter_m"], summary["height_m"]) == pytest.approx((0.3, 0.4), rel=1e-3)
    assert summary["area_m2"]["flower"] == pytest.approx(0.05 * summary["area_m2"]["leaf"])
    assert summary["triangles"] < 10_000  # roughly; 33 thousand else
    assert summary["leaf_scale"] > 1.1
    assert any("allow more `--max-triangles`" in text for text in summary["warnings"])


def test_options_that_mean_nothing_are_refused(tmp_path: Path) -> None:
    scan = str(cloud(tmp_path / "scan.xyz"))
    table = tmp_path / "materials.csv"
    table.write_text("material,organ\nleaf,leaf\n")
    for source, options, word in (
        (scan, ("--materials", str(table)), "scan.xyz: `--materials`"),
        (scan, ("--rotation-spread", "5"), "`--rotation-spread` .* `--branches` too"),
        (scan, ("--flowering", "0.5"), "`--flowering`"),
        ("Deadwood", ("--up", "y"), "`--up`.*'Deadwood'"),
        ("Deadwood", ("--maximum-extent", "9"), "`--maximum-extent`"),
        ("Deadwood", ("--max-triangles", "9"), "`--max-triangles`.*2000"),
        ("Clutia alaternoides", ("--elements", "1"), "`--elements`.* 2"),
        (scan, ("--branches", "1000000"), "scan.xyz: .* lower `--branches` to 10000"),
    ):
        with pytest.raises(InputError, match=word):
            run(source, *options, "--output", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_units_that_are_not_metres(tmp_path: Path) -> None:
    out = ("--elements", "20", "--output", str(tmp_path / "out"))
    for size, word in ((2.0, "centimetres.*raise `--maximum-extent`"), (2e-4, "kilometres")):
        path = cloud(tmp_path / "scan.xyz", size)
        with pytest.raises(InputError, match=f"scan.xyz: .*{word}"):
            run(str(path), *out)
    path = cloud(tmp_path / "scan.xyz", 2.0)
    assert run(str(path), "--maximum-extent", "7", *out)["height_m"] == pytest.approx(6, rel=0.02)


def test_the_unit_of_a_mesh(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "field" / "13_obj-negative-indices-quads-yup-mm"
    path = tmp_path / "large.obj"
    with path.open("w") as file:
        for line in (folder / "batched_quads.obj").read_text().splitlines():
            word, *numbers = line.split()
            if word == "v":
                line = " ".join([word, *(f"{100 * float(number):.6f}" for number in numbers)])
            print(line, file=file)
    out = ("--elements", "50", "--output", str(tmp_path / "out"))
    with pytest.raises(InputError, match="state its unit") as raised:
        run(str(path), *out)
    assert "raise" not in str(raised.value)
    made = run(str(path), "--unit", "cm", *out)
    assert sum(made["area_m2"].values()) == pytest.approx(0.03554, rel=1e-3)
    with pytest.raises(InputError, match="unit` must be one of metre, centimetre"):
        run(str(path), "--unit", "furlong", *out)
    with pytest.raises(InputError, match="`--unit` is for a mesh or a scan"):
        run("Deadwood", "--unit", "foot", *out)
    scan = cloud(tmp_path / "scan.xyz", 200.0)
    made = run(str(scan), "--unit", "millimetre", *out)
    assert made["height_m"] == pytest.approx(0.6, rel=0.02)


def test_bad_sources(tmp_path: Path) -> None:
    (tmp_path / "plant").write_text("solid")
    for source, word in (
        ("none.obj", "no such file"),
        ("Clutia alternoides", "Did you mean 'Clutia alaternoides'"),
        ("shrub.blend", "shrub.blend: expected a mesh .*obj.* or a scan .*xyz"),
        (str(tmp_path / "plant"), "plant: expected a mesh"),
    ):
        with pytest.raises(InputError, match=word):
            run(source, "--output", str(tmp_path / "out"))
    line = ["plant", str(cloud(tmp_path / "s.xyz")), "--up", "x"]
    result = CliRunner().invoke(app, [*line, "--output", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert "'x' is not one of 'y', 'z'" in result.output
    assert not (tmp_path / "out").exists()
