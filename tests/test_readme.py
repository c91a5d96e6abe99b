"""What the README says can be run, runs, and what it names is there."""

import os
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fynjax.app.cli import app
from fynjax.app.cli._commands import COMMANDS as made_of_jobs
from tests.io.frame_files import SHOTS, write_odm

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text("utf-8")
COMMANDS = (ROOT / "docs/commands/index.md").read_text("utf-8")
PYTHON = (ROOT / "docs/python.md").read_text("utf-8")
SAMPLERS = (ROOT / "docs/solvers.md").read_text("utf-8")


def blocks(language: str, page: str = README) -> list[str]:
    """Code blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


def run(source: str, folder: Path) -> dict[str, Any]:
    """Names that a script leaves."""
    script = folder / "example.py"
    script.write_text(source, "utf-8")
    return runpy.run_path(str(script))


def test_a_screen_is_enough() -> None:
    assert len(README.splitlines()) < 80
    assert README.count("![") + README.count("<img ") == 3  # the plot twice, and the notebooks
    assert len(blocks("sh")) == 2
    assert len(blocks("python")) == 1


def test_a_scene_from_a_table_is_seen_by_a_drone(tmp_path: Path) -> None:
    (source,) = blocks("python")
    assert sum(bool(line.strip()) for line in source.splitlines()) < 10
    image = run(source, tmp_path)["image"].reflectance
    assert image.shape == (4, 20, 20)
    green, red, red_edge, nir = np.asarray(image.mean(axis=(1, 2)))
    assert 0 < green < red < red_edge < nir < 0.6  # much soil between few plants


@pytest.mark.study
def test_gradients_and_leaves_of_the_page_on_python(tmp_path: Path) -> None:
    every = blocks("python", PYTHON)
    (leaves,) = (block for block in every if "fx.prospect(" in block)
    names = run("".join([*every[:4], leaves]), tmp_path)
    standing = names["scene"].standing(names["scene"].parameters) > 0.0
    assert names["by_foot"].shape == (len(standing), 2)
    assert not names["by_foot"][~standing].any()
    assert names["slope"].species.cover.shape == (2,)
    assert bool((names["slope"].species.cover > 0).all())  # more plants, greener
    assert 0 < float(names["canopy"].min()) < float(names["canopy"].max()) < 0.7


@pytest.mark.slow
def test_frames_of_the_page_on_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = [block.replace("pixel=0.1", "pixel=0.25") for block in blocks("python", PYTHON)]
    scene = every[0].replace("seed=1", "seed=1, voxel=0.25, structure='even'")
    first = next(k for k, block in enumerate(every) if "fx.Lens(" in block)
    pose, files, slope = every[first : first + 3]
    write_odm(tmp_path / "flight")
    monkeypatch.chdir(tmp_path)
    slope = slope.replace("[10, 10]", "[4, 4]")
    names = run("\n".join(["import jax", scene, pose, files, slope]), tmp_path)
    assert [frame.name for frame in names["frames"]] == list(SHOTS)
    assert all(view.seen.all() for view in names["views"])
    assert names["oblique"].seen.all()
    assert len({round(float(view["nir"].mean()), 4) for view in names["views"]}) == 3


@pytest.mark.slow
def test_a_loop_of_one_s_own_finds_what_was_measured(tmp_path: Path) -> None:
    """By BFGS and LevenbergMarquardt of optimistix and LBFGS of jaxopt, in the page's own lines,
    in voxels and pixels of 25 cm."""
    every = [block.replace("pixel=0.1", "pixel=0.25") for block in blocks("python", PYTHON)]
    scene = every[0].replace("seed=1", "seed=1, voxel=0.25, structure='even'")
    (loop,) = (block for block in every if "scene.expected()" in block)
    found = "np.save('found.npy', np.exp(np.tanh(np.stack([by_bfgs, by_squares, by_lbfgs]))))"
    script = tmp_path / "page.py"
    script.write_text(f"import jax\nimport numpy as np\n{scene}{loop}{found}\n", "utf-8")
    # In a process of its own: with the digits that a user's has.
    folder = {"PYTHONPATH": str(ROOT), "JAX_ENABLE_X64": "0"}
    subprocess.run([sys.executable, script], cwd=tmp_path, env=os.environ | folder, check=True)
    for values in np.load(tmp_path / "found.npy"):
        np.testing.assert_allclose(values, [0.6, 1.2], rtol=0.01)


def test_samplers_of_the_page_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """emcee's chain in a file, blackjax and numpyro: one posterior."""
    monkeypatch.chdir(tmp_path)
    fitted, by_blackjax, by_numpyro = blocks("python", SAMPLERS)
    names = run(fitted + by_blackjax + by_numpyro, tmp_path)
    assert (tmp_path / "chain.h5").is_file()
    values = names["draws"].get_chain(flat=True)
    for whitened in names["by_blackjax"], names["chains"].get_samples():
        found = np.stack([names["free"].physical(u) for u in whitened])
        off = (found.mean(axis=0) - values.mean(axis=0)) / values.std(axis=0)
        np.testing.assert_allclose(off, 0.0, atol=0.25)
        np.testing.assert_allclose(found.std(axis=0) / values.std(axis=0), 1.0, atol=0.25)


@pytest.mark.slow
def test_radiation_example_closes_the_energy(tmp_path: Path) -> None:
    names = run(blocks("python", PYTHON)[-1], tmp_path)
    nadir, share, gradient = names["nadir"], names["share"], names["gradient"]
    closed = share.albedo + share.absorbed.sum(axis=1) + share.ground_absorbed
    np.testing.assert_allclose(closed, 1.0, atol=1e-4)
    # Leaves darken the red of this ground and brighten its near infrared.
    ground = np.array([0.15, 0.25])
    assert nadir[0] < ground[0]
    assert nadir[1] > ground[1]
    assert gradient.shape == names["density"].shape
    assert np.all(np.isfinite(gradient))


def test_commands_and_their_options_exist() -> None:
    shown = CliRunner().invoke(app, ["--help"]).output
    named = set(re.findall(r"^\| \[`([a-z -]+)`\]", COMMANDS, re.MULTILINE))
    commands = {command.name for command in made_of_jobs}
    assert named == commands >= {"demo", "render", "calibrate"}
    assert all(name.split()[0] in shown for name in named)
    for name in named - {"sensors", "doctor", "identify", "view"}:  # which write nothing
        text = CliRunner().invoke(app, [*name.split(), "--help"], env={"COLUMNS": "200"}).output
        for option in ("--output", "--seed", "--json", "--quiet"):
            # In some of them nothing is drawn.
            without = ("terrain", "bioscape plots", "reflectance", "convert", "map", "frames",
                       "fit-canopy")  # fmt: skip
            if option != "--seed" or name not in without:
                assert option in text, f"{name} {option}"
    used = {
        " ".join(line.split()[1 : 3 if "bioscape" in line else 2])
        for text in blocks("sh", COMMANDS)
        for line in text.splitlines()
        if line[:6] == "fynjax"
    }
    assert used <= named


def test_files_and_modules_named_are_there() -> None:
    for path in re.findall(r"\]\(([\w./-]+)\)", README):
        assert (ROOT / path).exists(), path
    for path in ("constraints.txt", "LICENSE"):
        assert path in README
        assert (ROOT / path).is_file()


def test_constraints_are_plain_and_cover_the_dependencies() -> None:
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9._]+", line) for line in lines)
    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    groups = project["dependency-groups"]
    wanted = [*project["project"]["dependencies"], *groups["test"], *groups["lint"]]
    for requirement in wanted:
        name = re.match(r"[A-Za-z0-9._-]+", requirement)
        assert name
        assert re.sub(r"[-_.]+", "-", name.group()).lower() in pinned, requirement


def test_commands_are_those_of_ci() -> None:
    ci = (ROOT / ".ci" / "environment").read_text("utf-8")
    (tests,) = [line for text in blocks("sh") for line in text.splitlines() if "pytest" in line]
    assert "pytest -n 2" in tests
    assert '"$bin/pytest" -n "${FYNJAX_CHECK_WORKERS:-2}"' in ci
    for step in (
        "install -c constraints.txt pip",
        'install -c constraints.txt -e ".[all]" --group dev',
    ):
        assert step in tests
        assert step.replace("install ", "install --quiet ") in ci
