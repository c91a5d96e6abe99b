"""`fynjax build`: its files against each other, its meshes, and its errors."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
import xarray as xr
from typer.testing import CliRunner

from fynjax._core.errors import InputError
from fynjax.app.cli import app
from fynjax.canopy import FORMS
from fynjax.scene import USUAL_LEAF
from tests.helpers import assert_valid_summary

SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form,packing_percent
Euclea racemosa,35,30,1.5,broad_leaved,20
Deadwood,10,4,0.5,deadwood,0
"""
PLOT = """[plot]
name = "Small"
size_m = 1.0
voxel_m = 0.1
structure_m = "even"
boundary = "periodic"
species_table = "species.csv"
cover_definition = "article"
[sun]
zenith_deg = 30.0
[scene]
seed = 4
"""


@pytest.fixture
def plot(tmp_path: Path) -> Path:
    (tmp_path / "species.csv").write_text(SPECIES)
    (tmp_path / "plot.toml").write_text(PLOT)
    return tmp_path / "plot.toml"


def run(*arguments: object) -> dict:
    """The summary of a successful run."""
    result = CliRunner().invoke(
        app, ["build", *map(str, arguments), "--json"], catch_exceptions=False
    )
    assert result.exit_code == 0
    return json.loads(result.stdout)


def test_the_files_of_a_build_agree(plot: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    summary = run(plot, "--output", out, "--size", 2, "--mesh", "--triangles", 200_000)
    assert_valid_summary(summary)
    plants = pd.read_csv(out / "instances.csv")
    wanted = {
        "Euclea racemosa": int(np.ceil(4.0 * 0.30 / (0.8 * np.pi * 0.175**2))),
        "Deadwood": int(np.ceil(4.0 * 0.04 / (np.pi * 0.05**2))),
    }
    assert plants.taxon.value_counts().to_dict() == wanted == summary["plants"]
    assert list(plants.columns[1:]) == [
        "x_m", "y_m", "z_m", "azimuth_deg", "tilt_deg", "diameter_m", "height_m",
    ]  # fmt: skip

    cover = pd.read_csv(out / "cover.csv").set_index("taxon")
    disc = np.pi / 4 * plants.diameter_m**2
    full = 100.0 * disc.groupby(plants.taxon).sum() / 4.0
    for taxon in wanted:
        assert cover.crowns_percent[taxon] == pytest.approx(full[taxon], rel=0.02)
    assert cover.species_percent["all"] == pytest.approx(cover.visible_percent["all"], abs=1e-3)
    assert cover.planted_percent["Euclea racemosa"] == pytest.approx(0.8 * full.iloc[1], rel=0.02)

    with xr.open_dataset(out / "voxels.nc") as voxels:
        density = voxels.area_density
        assert density.dims == ("class", "z", "y", "x")
        assert density.attrs["units"] == "m2 m-3"
        names = voxels["class"].values.tolist()
        assert names == ["Euclea racemosa, leaf", "wood", "flower"]
        leaf = float(density.isel({"class": 0}).sum()) * 1e-3
    euclea = disc[plants.taxon == "Euclea racemosa"].sum()
    every = disc.sum() / 4.0
    seen = euclea * (1 - np.prod(1 - disc / 4.0)) / every  # crowns overlap
    form = FORMS["broad_leaved"]
    area, dead = form.leaf_area_index, form.dead_fraction
    assert leaf == pytest.approx(area * (1 - form.shoot_clumping) * seen, rel=1e-3)
    stand = pd.read_csv(out / "stand.csv").set_index("taxon")
    assert stand.leaf_area_index["all"] == pytest.approx((1 - dead) * area * seen / 4.0, abs=1e-3)
    assert stand.dead_area_index["all"] == pytest.approx(dead * area * seen / 4.0, abs=1e-3)
    deadwood = disc[plants.taxon == "Deadwood"].sum() * seen / euclea
    assert stand.wood_area_index["all"] * 4.0 == pytest.approx(
        0.5 * seen + 0.8 * deadwood, abs=1e-3
    )
    mass = 1e4 * USUAL_LEAF.dry_matter  # of g cm-2
    assert stand.leaf_mass_g_m2["all"] == pytest.approx(mass * area * seen / 4.0, rel=1e-3)
    gap = summary["gap_fraction"]
    assert f"{100 * gap:.1f} %" in " ".join(summary["headline"])
    said = summary["headline"][-1]  # where values are from: on page and in products too
    assert said.startswith("Species, covers, diameters, heights: species.csv. Leaf area, dead")
    assert said in html.unescape((out / "report.html").read_text())
    with xr.open_dataset(out / "voxels.nc") as voxels:
        assert voxels.attrs["plants"] == said
    assert 1 - every < gap < 1.0

    scene = trimesh.load(out / "scene.obj", process=False)
    pieces = list(scene.geometry.values())
    assert sum(len(piece.faces) for piece in pieces) == summary["triangles"]
    assert scene.bounds[1][2] == pytest.approx(plants.height_m.max(), rel=0.01)
    text = (out / "scene.obj").read_text()
    assert len(re.findall(r"^o ", text, re.M)) == len(plants)
    for name in ("plan.png", "oblique.png", "profile.png", "report.html"):
        assert (out / name).stat().st_size > 5000


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--mesh", "--triangles", 3000), r"\d+ plants of 2000 triangles each are \d+"),
        (("--size", 1.05), "whole number of voxels"),
        (("--size", 0.2), "widest crown, 0.35 m"),
        (("--cell", 0.03), "does not divide"),
    ],
)
def test_what_cannot_be_built(
    options: tuple[object, ...], word: str, plot: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=word):
        run(plot, "--output", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_cushions_and_columns_are_built_with_meshes_of_their_form(
    plot: Path, tmp_path: Path
) -> None:
    """Leaf area in the voxels against that of the crowns, of which overlaps count once."""
    forms = {"Muraltia mitior": "cushion", "Hoodia gordonii": "column"}
    rows = ("Muraltia mitior,30,25,0.12,cushion,0", "Hoodia gordonii,40,15,0.5,column,0")
    (tmp_path / "species.csv").write_text("\n".join([SPECIES.splitlines()[0], *rows]) + "\n")
    out = tmp_path / "out"
    summary = run(plot, "--output", out, "--size", 2, "--mesh", "--triangles", 200_000)
    said = [line for line in summary["warnings"] if "usual leaf of its growth form" in line]
    assert [line.rpartition(": ")[0].split()[-1] for line in said] == list(forms.values())
    plants = pd.read_csv(out / "instances.csv")
    disc = np.pi / 4 * plants.diameter_m**2
    once = 4.0 * (1 - np.prod(1 - disc / 4.0)) / disc.sum()
    with xr.open_dataset(out / "voxels.nc") as voxels:
        leaf = voxels.area_density.sum(("x", "y", "z")) * 1e-3
        for taxon, name in forms.items():
            area = FORMS[name].leaf_area_index * (1 - FORMS[name].shoot_clumping)
            wanted = area * once * disc[plants.taxon == taxon].sum()
            assert float(leaf.sel({"class": f"{taxon}, leaf"})) == pytest.approx(wanted, rel=1e-3)


def test_a_table_of_ones_own_says_what_is_asked_planted_and_seen_from_above(
    plot: Path, tmp_path: Path
) -> None:
    """Projected covers, of plants that are counted once more: 45 % asked is no longer 36 %."""
    table = SPECIES.replace("35,30,1.5,broad_leaved,20", "35,45,1.5,broad_leaved,0")
    (tmp_path / "species.csv").write_text(table)
    plot.write_text(PLOT.replace('cover_definition = "article"\n', ""), encoding="utf-8")
    summary = run(plot, "--output", tmp_path / "out", "--size", 6)
    cover = pd.read_csv(tmp_path / "out" / "cover.csv").set_index("taxon")
    plants = pd.read_csv(tmp_path / "out" / "instances.csv")
    centre = (np.arange(300) + 0.5) * 0.02
    under = np.zeros((300, 300), bool)
    for one in plants[plants.taxon == "Euclea racemosa"].itertuples():
        x, y = (np.abs((centre - at + 3.0) % 6.0 - 3.0) for at in (one.x_m, one.y_m))
        under |= y[:, None] ** 2 + x**2 < (one.diameter_m / 2) ** 2
    planted = cover.planted_percent["Euclea racemosa"]
    assert planted == pytest.approx(100.0 * under.mean(), abs=0.2)
    assert planted == pytest.approx(45.0, abs=2.0)
    assert cover.planted_percent["Deadwood"] > cover.visible_percent["Deadwood"]
    said = " ".join(summary["headline"])
    assert re.search(
        r"relevé .* asked 49\.0 %, planted \d\d\.\d %, seen from above \d\d\.\d %", said
    )
    assert "eq. (10)" not in said
    parameters = "name,unit,estimate\nspecies.Euclea racemosa.packing,%,20\n"
    (tmp_path / "p.csv").write_text(parameters)
    plot.write_text(plot.read_text(encoding="utf-8") + 'parameters = "p.csv"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"p\.csv.*packing_percent.*covers here are projected"):
        run(plot, "--output", tmp_path / "other")


def test_a_plot_beyond_the_memory_is_refused_at_once(plot: Path, tmp_path: Path) -> None:
    """0.3 x 1e6 m2 of crowns of 0.096 m2, of which 0.8 counts, and 0.04 x 1e6 m2 of 0.0079 m2;
    3000 elements for the one and 2784 for the other, 80 bytes; 2.5 sites each, 700 bytes."""
    plot.write_text(
        PLOT.replace("size_m = 1.0", "size_m = 1000.0").replace("0.1", "0.01", 1), encoding="utf-8"
    )
    with pytest.raises(InputError, match="1942 GiB"):
        run(plot, "--output", tmp_path / "out")


@pytest.mark.slow
def test_meshes_in_the_picture(plot: Path, tmp_path: Path) -> None:
    run(plot, "--output", tmp_path / "out", "--view", "meshes")
    assert (tmp_path / "out" / "oblique.png").stat().st_size > 20_000
